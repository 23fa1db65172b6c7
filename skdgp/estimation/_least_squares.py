r"""Least squares of states in a chain and constants, by a banded Cholesky factor.

Unknowns are the states :math:`x_k` of n samples, s numbers each, and c constants. Equations relate a
state, the next one and the constants, linearly:

.. math:: r_k + J_k x_k + J'_k x_{k+1} + F_k c = 0.

The normal equations are, with border B and corner C of the constants,

.. math:: \begin{pmatrix} A & B \\ B^T & C \end{pmatrix} \begin{pmatrix} x \\ c \end{pmatrix} =
          - \begin{pmatrix} g \\ h \end{pmatrix}.

A is block-tridiagonal, of half bandwidth 2 s - 1, so that :math:`A = L L^T` takes O(n s^3), and c
follows from the Schur complement (Golub & Van Loan 2013, section 4.3). Products are of some samples
at a time, as fresh memory for all of a long flight would take as long as the computation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded, lapack
from scipy.linalg.blas import dgemm

from skdgp._compute.typing import Array, Indices, Matrix, Vector

# Whose products fit into the cache of a processor (guess)
SAMPLES_AT_A_TIME = 128


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

    @property
    def parts(self) -> list[slice]:
        """Samples that are computed together."""
        starts = range(0, len(self.columns), SAMPLES_AT_A_TIME)
        return [slice(start, start + SAMPLES_AT_A_TIME) for start in starts]

    def changes(self, samples: slice, states: Array, constants: Matrix) -> Array:
        """Return the changes of the residuals of some samples (l, m, k).

        They are by k sets of states of all samples (n, s, k) and constants (c, k).
        """
        change = self.d_state[samples] @ states[samples] + self.d_constants[samples] @ constants
        later = states[samples.start + 1 : samples.stop + 1]
        change[: len(later)] += self.d_next[samples][: len(later)] @ later
        return change


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

    ``draws`` are standard normal numbers e, (n s + f, k). With V = L^-1 B and c from the inverse of the
    Schur complement C - V^T V, the states L^-T (e - V c) are samples from the posterior.
    """
    band, border, corner = _normal_equations(equations, prior)
    C = corner[np.ix_(free, free)]
    h = corner[free, -1]
    L = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    of_free = border[[*free, -1]].reshape(len(free) + 1, -1).T
    solved = lapack.dtbtrs(L, of_free, uplo="L", overwrite_b=1)[0]
    V = solved[:, :-1]
    covariance = np.linalg.inv(C - V.T @ V)
    covariance = (covariance + covariance.T) / 2
    constants = covariance @ (V.T @ solved[:, -1] - h)
    n_values = len(V)
    constant_draws = np.linalg.cholesky(covariance) @ draws[n_values:]
    weights = np.column_stack([np.append(constants, 1.0), np.pad(constant_draws, ((0, 1), (0, 0)))])
    # of the solution, -L^-1 g - V c, and of the draws
    right = dgemm(-1.0, solved, weights)
    right[:, 1:] += draws[:n_values]
    states = lapack.dtbtrs(L, right, uplo="L", trans="T", overwrite_b=1)[0]
    shape = prior.states.shape
    spread = np.eye(len(prior.constants))[:, free]
    return Posterior(
        states=states[:, 0].reshape(shape),
        constants=spread @ constants,
        covariance=covariance,
        state_draws=states[:, 1:].reshape(*shape, -1),
        constant_draws=spread @ constant_draws,
    )


def _normal_equations(equations: Equations, prior: GaussianPrior) -> tuple[Matrix, Array, Matrix]:
    """Return A in lower banded storage, B with g as its last column, transposed, and C with h as its last column.

    Of n samples, B^T is of the shape (c + 1, n, s).
    """
    n, _, width = equations.columns.shape
    s = equations.n_states
    this = slice(0, s)
    after = slice(s, 2 * s)
    constants = slice(2 * s, -1)
    remaining = slice(2 * s, None)
    # in the order of LAPACK: entry (i, j) of A stands at (j, i - j)
    band = np.zeros((n, s, 2 * s))
    band[..., 0] = prior.states
    border = np.zeros((width - 2 * s, n, s))
    border[-1] = prior.states * prior.states_offset
    offset = prior.constants * prior.constants_offset
    corner = np.column_stack([np.diag(prior.constants), offset])
    for samples in equations.parts:
        J = equations.columns[samples]
        products = J.mT @ J
        # of the next samples, which the last one has none of
        later = slice(samples.start + 1, samples.stop + 1)
        of_later = products[: n - later.start]
        for j in range(s):
            band[samples, j, : 2 * s - j] += products[:, j : 2 * s, j]
            band[later, j, : s - j] += of_later[:, s + j : 2 * s, s + j]
        border[:, samples] += products[:, this, remaining].transpose(2, 0, 1)
        border[:, later] += of_later[:, after, remaining].transpose(2, 0, 1)
        corner += products[:, constants, remaining].sum(axis=0)
    return band.reshape(n * s, 2 * s).T, border, corner
