"""Long records drawn with few points: the extremes of every time slice.

A screen shows about a thousand columns. Of all samples that share a column only the lowest and the highest
can be seen; keeping just those gives the same picture from a fraction of the points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

GAP = 5.0
"""A step longer than this many usual steps is a gap in the log: no line is drawn across it."""


def stretch_starts(time: np.ndarray, window: np.ndarray | None = None) -> np.ndarray:
    """Return the indices where a new stretch begins: after a gap, when time goes back, at a new window."""
    step = np.diff(time)
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= GAP * usual))
    if window is not None:
        cut |= window[1:] != window[:-1]
    return np.flatnonzero(np.concatenate([[True], cut]))


class _Slices(NamedTuple):
    sample: np.ndarray  # indices of the finite samples, in order
    first: np.ndarray  # positions in `sample` where a new slice begins
    stroke: np.ndarray  # for each of `sample`, the number of the unbroken stroke it belongs to


def _slices(time, finite, starts, n_bins) -> _Slices:
    sample = np.flatnonzero(finite)
    t = time[sample]
    width = (t.max() - t.min()) / n_bins if t.size else 0.0
    begins = np.zeros(len(time), dtype=bool)
    begins[starts] = True
    stretch = np.cumsum(begins)[sample]
    # A missing value breaks the stroke only where the hole is wide enough to be seen.
    broken = (np.diff(stretch) != 0) | ((np.diff(sample) > 1) & (np.diff(t) > width))
    new_stroke = np.concatenate([[True], broken])[: len(sample)]
    if len(sample) <= 2 * n_bins or width == 0.0:
        new_slice = np.ones(len(sample), dtype=bool)
    else:
        column = np.floor((t - t.min()) / width)
        new_slice = new_stroke | np.concatenate([[True], np.diff(column) != 0])
    return _Slices(sample, np.flatnonzero(new_slice), np.cumsum(new_stroke))


def line_points(time, values, *, n_bins: int, starts=None) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of a line with the same picture, NaN between its strokes.

    Parameters
    ----------
    time, values : (n,)
        Samples; those that are not finite are holes.
    n_bins : int
        Number of time slices; of each the lowest and the highest sample are kept (both, if it has more).
    starts : (k,) int, optional
        Where a new stretch begins; default: after gaps in ``time``.

    Examples
    --------
    >>> t = np.arange(10_000) / 100.0
    >>> v = np.sin(t); v[5000] = 7.0
    >>> few_t, few_v = line_points(t, v, n_bins=100)
    >>> len(few_t) < 210, float(few_v.max())
    (True, 7.0)
    """
    starts = stretch_starts(time) if starts is None else starts
    sample, first, stroke = _slices(time, np.isfinite(values) & np.isfinite(time), starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0)
    kept = _extremes(values[sample], first, stroke)
    t, v, of = time[sample][kept], values[sample][kept], stroke[kept]
    gaps = np.flatnonzero(np.diff(of)) + 1
    return np.insert(t, gaps, np.nan), np.insert(v, gaps, np.nan)


def _extremes(values, first, stroke) -> np.ndarray:
    """Return the sorted positions of one lowest and one highest value per slice, and of stroke ends."""
    of = np.zeros(len(values), dtype=int)
    of[first[1:]] = 1
    of = np.cumsum(of)
    kept = [np.flatnonzero(np.diff(stroke)), np.flatnonzero(np.diff(stroke)) + 1, [0, len(values) - 1]]
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == extreme.reduceat(values, first)[of])
        kept.append(hits[np.unique(of[hits], return_index=True)[1]])
    return np.unique(np.concatenate(kept).astype(int))


def band_points(time, lower, upper, *, n_bins: int, starts=None):
    """Return times, lower and upper edge of a band with the same picture, NaN between its strokes.

    Per slice the band is the union of the samples' intervals: what drawing all of them would cover.
    """
    starts = stretch_starts(time) if starts is None else starts
    finite = np.isfinite(time) & np.isfinite(lower) & np.isfinite(upper)
    sample, first, stroke = _slices(time, finite, starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0), np.empty(0)
    low, high = np.minimum.reduceat(lower[sample], first), np.maximum.reduceat(upper[sample], first)
    last = np.append(first[1:], len(sample)) - 1
    single = np.array_equal(first, last)
    t = time[sample][first] if single else time[sample][np.column_stack([first, last]).ravel()]
    repeat = 1 if single else 2
    gaps = (np.flatnonzero(np.diff(stroke[first])) + 1) * repeat
    edges = (np.insert(np.repeat(edge, repeat), gaps, np.nan) for edge in (low, high))
    return np.insert(t, gaps, np.nan), *edges


def lonely(values: np.ndarray) -> np.ndarray:
    """Return the indices of finite values without a finite neighbour: a line alone would not show them."""
    padded = np.concatenate([[False], np.isfinite(values), [False]])
    return np.flatnonzero(padded[1:-1] & ~padded[:-2] & ~padded[2:])
