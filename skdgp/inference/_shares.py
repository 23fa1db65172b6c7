"""Sums over samples for sparse inference, in shares that threads or workers sum.

A share is a run of one output's values. The functions of one share stand at module level and get what they need as
arguments, so that a share can be summed by a thread, a process or another machine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import triangular_solve
from skdgp._compute.parallel import share_map
from skdgp.inference._likelihood import Data

ROWS = 512  # samples at a time: their covariances stay in the cache
SHARES = 8  # of each output


class Share(NamedTuple):
    """A run of the observed values of one output: X (n, d), y (n,)."""

    output: int
    X: np.ndarray
    y: np.ndarray


class Statistics(NamedTuple):
    """Sums over the samples of one output, of V = Lu^-1 Kuf: V V^T (c, c), V y (c,), y y, var(y_i), and how many."""

    outer: np.ndarray
    inner: np.ndarray
    square: float
    variance: float
    n: int

    @property
    def missing(self) -> float:
        """What of the prior variance the features do not explain."""
        return self.variance - float(np.trace(self.outer))


def value_shares(data) -> list[Share]:
    """Cut the observed values alike whatever the number of threads: sums keep their bits."""
    return [
        Share(i, *part)
        for i, both in enumerate(zip(data.X, data.y, strict=True))
        if len(both[1])
        for part in zip(*(np.array_split(a, min(SHARES, -(-len(a) // ROWS))) for a in both), strict=True)
    ]


def data_of_values(shares, n_outputs) -> Data:
    """Return the observed values that shares were cut from."""
    nothing = Share(-1, shares[0].X[:0], shares[0].y[:0])
    own = [[nothing, *(share for share in shares if share.output == i)] for i in range(n_outputs)]
    return Data(*([np.concatenate([share[k] for share in parts]) for parts in own] for k in (1, 2)))


def statistics(kernel, features, Lu, shares) -> list[Statistics]:
    """Return the sums for each output; zeros where it has no share."""
    parts = share_map(_statistics, (kernel, features, Lu), shares)
    found = []
    for i in range(kernel.n_outputs):
        own = [part for share, part in zip(shares, parts, strict=True) if share.output == i]
        found.append(summed(own) if own else _nothing(len(features.columns(i))))
    return found


def summed(parts) -> Statistics:
    """Return the sums over the samples of all parts."""
    return Statistics(*map(sum, zip(*parts, strict=True)))


def _nothing(c):
    return Statistics(np.zeros((c, c)), np.zeros(c), 0.0, 0.0, 0)


def _statistics(kernel, features, Lu, share):
    i, X, y = share
    own = own_factor(Lu, features.columns(i))
    outer, inner, variance = np.zeros(own.shape), np.zeros(len(own)), 0.0
    for rows in row_slices(len(y)):
        V = triangular_solve(own, features.Kfu(i, X[rows]).T)
        outer += V @ V.T
        inner += V @ y[rows]
        variance += kernel.block_diag(i, X[rows]).sum()
    return Statistics(outer, inner, y @ y, variance, len(y))


def bound_slope(kernel, features, noise, weights, gap, shares):
    """Return the part of the bound's gradient that sums over samples: by [kernel, features] theta, and of diagonals.

    ``weights`` (K,) is the posterior mean of the features, coloured, and ``gap`` (K, K) is
    Kuu^-1 - (Kuu + sum Kuf Kfu / noise)^-1.
    """
    totals, diagonals = zip(*share_map(_bound_slope, (kernel, features, noise, weights, gap), shares), strict=True)
    return np.sum(totals, axis=0), np.sum(diagonals, axis=0)


def _bound_slope(kernel, features, noise, weights, gap, share):
    i, X, y = share
    c = features.columns(i)
    own, a = gap[np.ix_(c, c)] / noise[i], weights[c]
    total, diagonal = 0.0, 0.0
    for rows in row_slices(len(y)):
        A = features.Kfu(i, X[rows])
        W = np.multiply.outer((y[rows] - A @ a) / noise[i], a)
        W += A @ own
        total = total + features.gradient_fu(i, X[rows], W)
        diagonal = diagonal + kernel.diag_gradient(i, X[rows], np.full(len(W), -0.5 / noise[i]))
    return total, diagonal


def row_slices(n):
    """Cut n rows into slices of at most ROWS."""
    return [slice(a, min(a + ROWS, n)) for a in range(0, n, ROWS)]


def own_factor(Lu, columns):
    """Return the factor of some features alone: Kuu is block diagonal, and columns are whole blocks of it."""
    return np.asfortranarray(Lu[np.ix_(columns, columns)])
