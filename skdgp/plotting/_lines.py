"""Lines and bands of long records, with few points.

A screen shows about a thousand columns. Of all samples in one column only the lowest and the highest are visible, so a
line of these looks the same.
"""

from __future__ import annotations

import numpy as np

from skdgp._compute.typing import Indices, Mask, Vector
from skdgp._flight.clock import true_runs

GAP = 5.0  # usual steps; no line is drawn across a longer one


def segment_starts(time: Vector, window: np.ndarray | None = None) -> Indices:
    """Return the indices where a new segment begins: after a gap, when time goes back, at a new window."""
    step = np.diff(time)
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= GAP * usual))
    if window is not None:
        cut |= window[1:] != window[:-1]
    return np.flatnonzero(np.concatenate([[True], cut]))


def _slices(time: Vector, finite: Mask, starts: Indices | None, n_bins: int) -> tuple[Indices, Indices, Indices]:
    """Return indices of finite samples; which of these begin a time slice; and of each the number of its line."""
    starts = segment_starts(time) if starts is None else starts
    sample = np.flatnonzero(finite)
    t = time[sample]
    width = (t.max() - t.min()) / n_bins if t.size else 0.0
    segment = np.cumsum(np.bincount(starts, minlength=len(time)))[sample]
    # A missing value breaks the line only if the hole is wide enough to be visible.
    broken = (np.diff(segment) != 0) | ((np.diff(sample) > 1) & (np.diff(t) > width))
    new_line = np.concatenate([[True], broken])[: len(sample)]
    if len(sample) <= 2 * n_bins or width == 0.0:
        first = np.arange(len(sample))
    else:
        column = np.floor((t - t.min()) / width)
        first = np.flatnonzero(new_line | (np.diff(column, prepend=np.nan) != 0))
    return sample, first, np.cumsum(new_line)


def line_points(time: Vector, values: Vector, *, n_bins: int, starts: Indices | None = None) -> tuple[Vector, Vector]:
    """Return the lowest and the highest sample of each of ``n_bins`` time slices, with NaN where the line breaks.

    It breaks at ``starts``, by default after gaps in time, and at values that are not finite.

    >>> t = np.arange(10_000) / 100.0
    >>> v = np.sin(t); v[5000] = 7.0
    >>> few_t, few_v = line_points(t, v, n_bins=100)
    >>> len(few_t) < 210, float(few_v.max())
    (True, 7.0)
    """
    sample, first, line = _slices(time, np.isfinite(values) & np.isfinite(time), starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0)
    time, values = time[sample], values[sample]
    ends = np.flatnonzero(np.diff(line))
    kept = [ends, ends + 1, np.array([0, len(values) - 1])]
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(values)))  # of the slice
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == extreme.reduceat(values, first)[number])
        kept.append(hits[np.unique(number[hits], return_index=True)[1]])  # one in each slice
    points = np.unique(np.concatenate(kept))
    gaps = np.flatnonzero(np.diff(line[points])) + 1
    return np.insert(time[points], gaps, np.nan), np.insert(values[points], gaps, np.nan)


def band_points(
    time: Vector, lower: Vector, upper: Vector, *, n_bins: int, starts: Indices | None = None
) -> tuple[Vector, Vector, Vector]:
    """Return times, lower and upper edge of a band that looks the same, with NaN where it breaks.

    In each slice the band is the union of the samples' intervals.
    """
    finite = np.isfinite(time) & np.isfinite(lower) & np.isfinite(upper)
    sample, first, line = _slices(time, finite, starts, n_bins)
    if sample.size == 0:
        return np.empty(0), np.empty(0), np.empty(0)
    low, high = np.minimum.reduceat(lower[sample], first), np.maximum.reduceat(upper[sample], first)
    last = np.append(first[1:], len(sample)) - 1
    ends = first[:, None] if np.array_equal(first, last) else np.column_stack([first, last])  # of each slice
    n = ends.shape[1]
    gaps = n * (np.flatnonzero(np.diff(line[first])) + 1)
    edges = time[sample][ends.ravel()], np.repeat(low, n), np.repeat(high, n)
    return tuple(np.insert(edge, gaps, np.nan) for edge in edges)  # type: ignore[return-value]


def isolated(values: Vector) -> list[int]:
    """Return the indices of finite values without a finite neighbour, which a line alone does not show."""
    return [run.start for run in true_runs(np.isfinite(values)) if run.stop - run.start == 1]
