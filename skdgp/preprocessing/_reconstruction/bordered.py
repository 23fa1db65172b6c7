"""Least squares over a chain of states with shared constants: banded Cholesky with a border."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded, lapack

Floats = NDArray[np.float64]


class Rows(NamedTuple):
    """Linear equations residual + here x_k + after x_{k+1} + shared c = 0, in units of their standard deviations.

    A batch of m equations for each of n states. ``after`` is None where they tie a state to nothing.
    """

    residual: Floats
    """(n, m)"""
    here: Floats
    """(n, m, s)"""
    after: Floats | None
    """(n, m, s)"""
    shared: Floats
    """(n, m, c)"""

    def part(self, first, last) -> Rows:
        """Return the batches from first to before last."""
        return Rows(*(None if values is None else values[first:last] for values in self))

    def changed(self, states, constants) -> Floats:
        """Return by how much the residuals change, (n, m, k), with k sets of states (N, s, k) and constants (c, k)."""
        n = len(self.here)
        total = self.here @ states[:n] + self.shared @ constants
        return total if self.after is None else total + self.after @ states[1 : n + 1]


class Prior(NamedTuple):
    """What is known without the rows: precision, and how far the expansion point lies from the expected value."""

    states: Floats
    """(n, s)"""
    states_off: Floats
    """(n, s)"""
    constants: Floats
    """(c,)"""
    constants_off: Floats
    """(c,)"""


class Posterior(NamedTuple):
    """Solution of the bordered normal equations, and samples from the normal distribution around it."""

    states: Floats
    """(n, s)"""
    constants: Floats
    """(c,)"""
    covariance: Floats
    """Of the constants, (c, c)."""
    state_draws: Floats
    """(n, s, k), mean zero."""
    constant_draws: Floats
    """(c, k)"""


def solve(windows: Iterable[tuple[int, Rows, Rows]], prior: Prior, draws: Floats) -> Posterior:
    r"""Return the least-squares solution of ties between neighbours and looks at single states.

    With the states x (n s) and constants c, the normal equations

    .. math:: \begin{pmatrix} A & B \\ B^T & C \end{pmatrix} \begin{pmatrix} x \\ c \end{pmatrix} =
              - \begin{pmatrix} g \\ h \end{pmatrix}

    have a block-tridiagonal A, of half bandwidth 2 s - 1: A = L L^T in O(n s^3), and c from the small Schur complement
    C - B^T A^-1 B. The inverse of the whole matrix is the covariance; x = L^-T e - A^-1 B c with standard normal e and
    c from the inverse of the complement is a sample from it.

    Parameters
    ----------
    windows : iterable of (int, Rows, Rows)
        Number of the first state, ties and looks of consecutive windows: n - 1 and n batches in all.
    prior : Prior
    draws : ndarray (n s + c, k)
        Standard normal numbers.
    """
    n, s = prior.states.shape
    band, border, corner, g, h = _normal_equations(windows, prior)
    factor = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
    solved = cho_solve_banded((factor, True), np.column_stack([border, g]), check_finite=False)
    inner, shift = solved[:, :-1], solved[:, -1]
    covariance = np.linalg.inv(corner - border.T @ inner)
    covariance = (covariance + covariance.T) / 2
    constants = -covariance @ (h - border.T @ shift)
    states = -shift - inner @ constants
    constant_draws = np.linalg.cholesky(covariance) @ draws[n * s :]
    state_draws = _back_substitute(factor, draws[: n * s]) - inner @ constant_draws
    return Posterior(states.reshape(n, s), constants, covariance, state_draws.reshape(n, s, -1), constant_draws)


def _normal_equations(windows, prior):
    """Return A in lower banded storage, B, C, g and h."""
    (n, s), c = prior.states.shape, len(prior.constants)
    diagonal, coupling = prior.states[:, :, None] * np.eye(s), np.zeros((max(n - 1, 0), s, s))
    right, small = np.zeros((n, s, c + 1)), np.zeros((c, c + 1))
    right[..., -1] = prior.states * prior.states_off
    small[:, :c], small[:, c] = np.diag(prior.constants), prior.constants * prior.constants_off
    own, after, rest = slice(0, s), slice(s, 2 * s), slice(2 * s, None)
    for first, ties, looks in windows:
        seen, tied = _gram(looks), _gram(ties)
        at, here, there = (slice(first + k, first + k + m) for k, m in ((0, len(seen)), (0, len(tied)), (1, len(tied))))
        diagonal[at] += seen[:, own, own]
        diagonal[here] += tied[:, own, own]
        diagonal[there] += tied[:, after, after]
        coupling[here] = tied[:, own, after]
        right[at] += seen[:, own, s:]
        right[here] += tied[:, own, rest]
        right[there] += tied[:, after, rest]
        small += seen[:, s:-1, s:].sum(axis=0) + tied[:, 2 * s : -1, rest].sum(axis=0)
    right = right.reshape(n * s, c + 1)
    return _banded(diagonal, coupling), right[:, :c], small[:, :c], right[:, c], small[:, c]


def _gram(rows):
    """Return J^T J of each batch, J = [here, after, shared, residual]."""
    parts = [rows.here, rows.after, rows.shared, rows.residual[..., None]]
    J = np.concatenate([part for part in parts if part is not None], axis=2)
    return J.swapaxes(1, 2) @ J


def _banded(diagonal, coupling):
    """Return a block-tridiagonal matrix in the lower banded storage of LAPACK: row i - j, column j."""
    n, s, _ = diagonal.shape
    band = np.zeros((2 * s, n, s))
    for j in range(s):
        for i in range(j, s):
            band[i - j, :, j] = diagonal[:, i, j]
        for i in range(s):
            band[s + i - j, :-1, j] = coupling[:, j, i]
    return band.reshape(2 * s, n * s)


def _back_substitute(factor, values):
    """Return L^-T values for a lower banded factor."""
    return lapack.dtbtrs(factor, values, uplo="L", trans="T")[0]
