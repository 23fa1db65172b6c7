"""Samples packed as bytes, thinned where there are too many."""

from __future__ import annotations

import numpy as np

LEVELS = 65_534
"""Steps between the smallest and the largest value of a column: 0.002 % of its range."""


def pack(values, *, step: float | None = None) -> tuple[float, float, bytes]:
    """Return the smallest value, the step, and the column as bytes that compress well.

    Values are counted in steps from the smallest, 1 on; 0 is a hole. Of the differences d between neighbours
    2 |d| - [d < 0] is stored, little-endian, all first bytes first: those that hardly change stand together.

    Examples
    --------
    >>> low, step, data = pack(np.array([1.0, np.nan, 3.0]), step=0.5)
    >>> low, list(data)
    (1.0, [2, 1, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    """
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    step = step or (high - low) / LEVELS or 1.0
    count = np.where(known, np.rint((np.where(known, values, low) - low) / step) + 1, 0).astype(np.int64)
    change = np.diff(count, prepend=0)
    folded = np.where(change < 0, -2 * change - 1, 2 * change).astype("<u4")
    return float(low), float(step), folded.view(np.uint8).reshape(-1, 4).T.tobytes()


def thinned(values: np.ndarray, every: int) -> np.ndarray:
    """Return a column with one value for ``every`` samples: of each pair of such groups both extremes, in their order.

    Examples
    --------
    >>> thinned(np.array([0.0, 5.0, 1.0, -3.0, 2.0, 2.0, 2.0, 9.0]), 2)
    array([ 5., -3.,  2.,  9.])
    """
    if every == 1:
        return values
    whole = len(values) // (2 * every) * 2 * every
    groups = values[:whole].reshape(-1, 2 * every)
    low = np.argmin(np.where(np.isfinite(groups), groups, np.inf), axis=1)
    high = np.argmax(np.where(np.isfinite(groups), groups, -np.inf), axis=1)
    places = np.sort(np.column_stack([low, high]), axis=1)
    return np.concatenate([np.take_along_axis(groups, places, axis=1).ravel(), values[whole::every]])
