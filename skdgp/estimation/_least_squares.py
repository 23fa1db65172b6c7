r"""Least squares of states in a chain and constants, by a banded Cholesky factor.

Unknowns are the states :math:`x_k` of n samples, s numbers each, and c constants. Equations relate a
state, the next one and the constants, linearly:

.. math:: r_k + J_k x_k + J'_k x_{k+1} + F_k c = 0.

The normal equations are, with border B and corner C of the constants,

.. math:: \begin{pmatrix} A & B \\ B^T & C \end{pmatrix} \begin{pmatrix} x \\ c \end{pmatrix} =
          - \begin{pmatrix} g \\ h \end{pmatrix}.

A is block-tridiagonal, of half bandwidth 2 s - 1, so that :math:`A = L L^T` takes O(n s^3), and c
follows from the Schur complement (Golub & Van Loan 2013, section 4.3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack

from skdgp._compute.typing import Array, Indices, Matrix, Vector


class Equations:
    """Linear equations residual + d_state x_k + d_next x_{k+1} + d_constants c = 0, m for each of n samples k.

    The four are views of ``columns`` (n, m, 2 s + c + 1). ``d_next`` of the last sample is zero.
    """

    def __init__(self, columns: Array, n_states: int) -> None:
        self.columns = columns
        self.n_states = n_states
        self.d_state = columns[..., :n_states]
        self.d_next = columns[..., n_states : 2 * n_states]
        self.d_constants = columns[..., 2 * n_states : -1]
        self.residual = columns[..., -1]

    def whiten(self, noise: Matrix) -> None:
        """Divide the equations by their noise, (n, m)."""
        self.columns /= noise[..., None]

    def changes(self, states: Array, constants: Matrix) -> Array:
        """Return the changes of the residuals (n, m, k), by k sets of states (n, s, k) and constants (c, k)."""
        total = self.d_state @ states + self.d_constants @ constants
        total[:-1] += self.d_next[:-1] @ states[1:]
        return total


class GaussianPrior(NamedTuple):
    """Prior knowledge: precision, and the expansion point minus the expected value."""

    states: Matrix  # (n, s) precision
    states_offset: Matrix  # (n, s)
    constants: Vector  # (c,) precision
    constants_offset: Vector  # (c,)


class Posterior(NamedTuple):
    """Solution of the normal equations, and samples from the normal distribution around it."""

    states: Matrix  # (n, s)
    constants: Vector  # (c,), zero where not free
    covariance: Matrix  # of the free constants, (f, f)
    state_draws: Array  # (n, s, k), mean zero
    constant_draws: Matrix  # (c, k)


def solve(equations: Equations, prior: GaussianPrior, free: Indices, draws: Matrix) -> Posterior:
    """Return the least-squares solution of the equations for the states and the ``free`` constants.

    ``draws`` are standard normal numbers e, (n s + f, k). With c from the inverse of the Schur
    complement C - B^T A^-1 B, the states L^-T e - A^-1 B c are samples from the posterior.
    """
    band, border, corner = _normal_equations(equations, prior)
    B = border[:, free]
    C = corner[np.ix_(free, free)]
    g = border[:, -1:]
    h = corner[free, -1]
    L = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    solved = cho_solve_banded((L, True), np.hstack([B, g]), check_finite=False)
    inner = solved[:, :-1]  # A^-1 B
    shift = solved[:, -1]  # A^-1 g
    covariance = np.linalg.inv(C - B.T @ inner)
    covariance = (covariance + covariance.T) / 2
    constants = covariance @ (B.T @ shift - h)
    states = -shift - inner @ constants
    constant_draws = np.linalg.cholesky(covariance) @ draws[len(B) :]
    free_draws = lapack.dtbtrs(L, draws[: len(B)], uplo="L", trans="T")[0]  # L^-T e
    state_draws = free_draws - inner @ constant_draws
    shape = prior.states.shape
    spread = np.eye(len(prior.constants))[:, free]
    return Posterior(
        states=states.reshape(shape),
        constants=spread @ constants,
        covariance=covariance,
        state_draws=state_draws.reshape(*shape, -1),
        constant_draws=spread @ constant_draws,
    )


def _normal_equations(equations: Equations, prior: GaussianPrior) -> tuple[Matrix, Matrix, Matrix]:
    """Return A in lower banded storage, B with g in its last column, and C with h in its last column."""
    s = equations.n_states
    this = slice(0, s)
    after = slice(s, 2 * s)
    constants = slice(2 * s, -1)
    remaining = slice(2 * s, None)
    J = equations.columns
    products = J.mT @ J
    blocks = products[:, : 2 * s, this].copy()  # of A, on and below its diagonal
    blocks[:, this] += prior.states[:, :, None] * np.eye(s)
    blocks[1:, this] += products[:-1, after, after]
    border = products[:, this, remaining].copy()
    border[1:] += products[:-1, after, remaining]
    border[..., -1] += prior.states * prior.states_offset
    corner = products[:, constants, remaining].sum(axis=0)
    corner[:, :-1] += np.diag(prior.constants)
    corner[:, -1] += prior.constants * prior.constants_offset
    return _banded(blocks), border.reshape(prior.states.size, -1), corner


def _banded(blocks: Array) -> Matrix:
    """Return blocks (n, 2 s, s), each a diagonal one over the one below, in the lower banded storage of LAPACK."""
    n, height, s = blocks.shape
    band = np.zeros((height, n, s))
    for j in range(s):  # entry (i, j) stands in row i - j
        band[: height - j, :, j] = blocks[:, j:, j].T
    return band.reshape(height, n * s)
