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

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack

from skdgp._compute.typing import Array, Matrix, Vector


class Equations(NamedTuple):
    """Linear equations residual + d_state x_k + d_next x_{k+1} + d_constants c = 0, m for each of n samples k."""

    residual: Matrix  # (n, m)
    d_state: Array  # (n, m, s)
    d_next: Any  # array (n, m, s); None for measurement equations
    d_constants: Array  # (n, m, c)

    def whitened(self, noise: Matrix, places: list[int]) -> Equations:
        """Return the equations in units of their noise, (n, m), by the constants at some places."""
        unit = noise[..., None]
        d_next = None if self.d_next is None else self.d_next / unit
        d_constants = self.d_constants[..., places] / unit
        return Equations(self.residual / noise, self.d_state / unit, d_next, d_constants)

    def changes(self, states: Array, constants: Matrix) -> Array:
        """Return the changes of the residuals, (n, m, k), by k sets of states (N, s, k) and constants (c, k)."""
        total = self.d_state @ states[: len(self.d_state)] + self.d_constants @ constants
        return total if self.d_next is None else total + self.d_next @ states[1:]

    def normal(self) -> Array:
        """Return J^T J of each sample, J = [d_state, d_next, d_constants, residual]."""
        columns = [self.d_state, self.d_constants, self.residual[..., None]]
        if self.d_next is not None:
            columns.insert(1, self.d_next)
        J = np.concatenate(columns, axis=2)
        return J.mT @ J


class GaussianPrior(NamedTuple):
    """Prior knowledge: precision, and the expansion point minus the expected value."""

    states: Matrix  # (n, s) precision
    states_offset: Matrix  # (n, s)
    constants: Vector  # (c,) precision
    constants_offset: Vector  # (c,)


class Posterior(NamedTuple):
    """Solution of the normal equations, and samples from the normal distribution around it."""

    states: Matrix  # (n, s)
    constants: Vector  # (c,)
    covariance: Matrix  # of the constants, (c, c)
    state_draws: Array  # (n, s, k), mean zero
    constant_draws: Matrix  # (c, k)


def solve(
    process: Equations, measurements: Equations, prior: GaussianPrior, draws: Matrix
) -> Posterior:
    """Return the least-squares solution of process and measurement equations.

    ``draws`` are standard normal numbers e, (n s + c, k). With c from the inverse of the Schur
    complement C - B^T A^-1 B, the states L^-T e - A^-1 B c are samples from the posterior.
    """
    n, s = prior.states.shape
    band, border, corner, g, h = _normal_equations(process, measurements, prior)
    L = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    solved = cho_solve_banded((L, True), np.column_stack([border, g]), check_finite=False)
    inner = solved[:, :-1]  # A^-1 B
    shift = solved[:, -1]  # A^-1 g
    covariance = np.linalg.inv(corner - border.T @ inner)
    covariance = (covariance + covariance.T) / 2
    constants = -covariance @ (h - border.T @ shift)
    states = -shift - inner @ constants
    constant_draws = np.linalg.cholesky(covariance) @ draws[n * s :]
    free_draws = lapack.dtbtrs(L, draws[: n * s], uplo="L", trans="T")[0]  # L^-T e
    state_draws = free_draws - inner @ constant_draws
    return Posterior(
        states=states.reshape(n, s),
        constants=constants,
        covariance=covariance,
        state_draws=state_draws.reshape(n, s, -1),
        constant_draws=constant_draws,
    )


def _normal_equations(
    process: Equations, measurements: Equations, prior: GaussianPrior
) -> tuple[Matrix, Matrix, Matrix, Vector, Vector]:
    """Return A in lower banded storage, B, C, g and h."""
    n, s = prior.states.shape
    c = len(prior.constants)
    measured = measurements.normal()  # by state, constants, residual
    linked = process.normal()  # by state, next state, constants, residual
    this = slice(0, s)
    after = slice(s, 2 * s)
    remaining = slice(2 * s, None)
    # blocks on the diagonal of A
    diagonal = prior.states[:, :, None] * np.eye(s) + measured[:, this, this]
    diagonal[:-1] += linked[:, this, this]
    diagonal[1:] += linked[:, after, after]
    # B, and g in the last column
    border = measured[:, this, s:].copy()
    border[:-1] += linked[:, this, remaining]
    border[1:] += linked[:, after, remaining]
    border[..., -1] += prior.states * prior.states_offset
    border = border.reshape(n * s, c + 1)
    # C, and h in the last column
    corner = measured[:, s:-1, s:].sum(axis=0) + linked[:, 2 * s : -1, remaining].sum(axis=0)
    corner[:, :c] += np.diag(prior.constants)
    corner[:, c] += prior.constants * prior.constants_offset
    band = _banded(diagonal, linked[:, this, after])
    return band, border[:, :c], corner[:, :c], border[:, c], corner[:, c]


def _banded(diagonal: Array, coupling: Array) -> Matrix:
    """Return a block-tridiagonal matrix in the lower banded storage of LAPACK: row i - j, column j."""
    n, s, _ = diagonal.shape
    band = np.zeros((2 * s, n, s))
    i, j = np.tril_indices(s)
    band[i - j, :, j] = diagonal[:, i, j].T
    i, j = np.indices((s, s)).reshape(2, -1)
    band[s + i - j, :-1, j] = coupling[:, j, i].T
    return band.reshape(2 * s, n * s)
