"""The rows that a search learns from.

The time of a likelihood grows with the third power of its values, so of many values a part is learned
from. It holds groups of neighbours, the leaves of a k-d tree, from everywhere: its values are as dense
as the data within a leaf, and show short scales, and as wide apart as the data between leaves, and show
long ones. Of a time series there are several blocks, whose likelihoods add up as if they were independent
(a composite likelihood: Varin, Reid & Firth 2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Indices, Matrix


@dataclass(frozen=True)
class BlockSettings:
    """How many values a search learns from."""

    #: Most values: the time of a fit grows with values^3
    values: int = 1500
    #: Most values of a block of a time series, and most blocks
    series_values: int = 1000
    series_blocks: int = 3
    #: Most rows of a leaf (trials with 64 and 200 were alike), and fewest leaves
    leaf_rows: int = 64
    leaves: int = 8


SETTINGS = BlockSettings()
ROUNDING = 1e-9  # skewness up to which a regressor is symmetric
EQUAL = 6  # decimals of values, in standard deviations, beyond which they count as equal


def blocks_of_rows(
    X: Matrix, Y: Matrix, settings: BlockSettings = SETTINGS, time_series: bool = False
) -> list[Indices]:
    """Return the rows of each block.

    The one block of a table are leaves that are evenly spread over the tree. Rows of a time series are
    evenly spaced, as errors of neighbours are correlated.

    Parameters
    ----------
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    settings : BlockSettings
    time_series : bool
        Whether the rows are in the order of recording.

    Returns
    -------
    list of ndarray of int
        In ascending order.
    """
    n, n_values = len(X), int(np.isfinite(Y).sum())
    if time_series:
        n_parts = -(-n_values // settings.series_values)
        n_blocks = min(n_parts, settings.series_blocks)
        return [np.arange(k * n_parts // n_blocks, n, n_parts) for k in range(n_blocks)]
    part = settings.values / n_values
    if part >= 1.0:
        return [np.arange(n)]
    leaf = leaves(X, min(settings.leaf_rows, int(part * n) // settings.leaves))
    # leaf k is one of a part p of all where the whole part of p k rises
    is_chosen = np.diff(np.floor(part * np.arange(leaf.max() + 2))) > 0
    return [np.flatnonzero(is_chosen[leaf])]


def leaves(X: Matrix, most: int) -> Indices:
    """Return the number of the leaf of each row (n,), of a k-d tree with at most so many rows in a leaf, or one.

    Each step halves a leaf along the regressor in which it is widest. The order of the rows does not
    matter.
    """
    leaf = np.empty(len(X), dtype=int)
    for number, part in enumerate(_parts(X, max(1, most))):
        leaf[part] = number
    return leaf


def spread_rows(X: Matrix, most: int) -> Indices:
    """Return at most so many rows, in ascending order, of which each is the middle one of a leaf."""
    parts = _parts(X, max(1, -(-2 * len(X) // most) if len(X) > most else 1))
    return np.sort([part[len(part) // 2] for part in parts])


def order_of_rows(X: Matrix, Y: Matrix) -> Indices:
    """Return the rows of a table, X (n, d) and Y (n, P) with NaN, in an order that depends on their values alone.

    They are sorted by their distances from the mean, whose rounding, signs and order of columns do not matter.
    """
    distances = []
    for Z in (X, Y):
        off = (Z - np.nanmean(Z, axis=0)) / column_scale(Z)
        distances.append(np.nansum(np.abs(off), axis=1).round(EQUAL))
    return np.lexsort(distances)


def _parts(X, most):
    """Return the rows of each leaf, in the order of the tree.

    They are the same for mirrored regressors, unless these are symmetric, and for regressors that
    differ by rounding: rows with equal values keep their order.
    """
    scaled = (X - X.mean(axis=0)) / column_scale(X)
    scaled[:, np.mean(scaled**3, axis=0) < -ROUNDING] *= -1.0
    scaled = scaled.round(EQUAL)
    parts = [np.arange(len(X))]
    while max(map(len, parts)) > most:
        halves = []
        for part in parts:
            widest = int(np.ptp(scaled[part], axis=0).argmax())
            order = np.argsort(scaled[part, widest], kind="stable")
            halves += np.array_split(part[order], 2)
        parts = [half for half in halves if len(half)]
    return parts
