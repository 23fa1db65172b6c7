"""Lines and bands of long records, with few points.

A screen shows about a thousand columns. Of all samples in one column only the lowest and the highest are visible, so a
line of these looks the same.
"""

from __future__ import annotations

from typing import NamedTuple

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


class _Slices(NamedTuple):
    sample: Indices  # indices of the finite samples, in order
    first: Indices  # positions in ``sample`` where a new time slice begins
    line: Indices  # for each of ``sample``, the number of its unbroken line


def _slices(time: Vector, finite: Mask, starts: Indices | None, n_bins: int) -> _Slices:
    starts = segment_starts(time) if starts is None else starts
    sample = np.flatnonzero(finite)
    t = time[sample]
    width = (t.max() - t.min()) / n_bins if t.size else 0.0
    segment = np.cumsum(np.bincount(starts, minlength=len(time)))[sample]
    # A missing value breaks the line only if the hole is wide enough to be visible.
    broken = (np.diff(segment) != 0) | ((np.diff(sample) > 1) & (np.diff(t) > width))
    new_line = np.concatenate([[True], broken])[: len(sample)]
    if len(sample) <= 2 * n_bins or width == 0.0:
        new_slice = np.ones(len(sample), dtype=bool)
    else:
        column = np.floor((t - t.min()) / width)
        new_slice = new_line | np.concatenate([[True], np.diff(column) != 0])
    return _Slices(sample, np.flatnonzero(new_slice), np.cumsum(new_line))


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
    points = _extremes(values[sample], first, line)
    gaps = np.flatnonzero(np.diff(line[points])) + 1
    return np.insert(time[sample][points], gaps, np.nan), np.insert(values[sample][points], gaps, np.nan)


def _extremes(values: Vector, first: Indices, line: Indices) -> Indices:
    """Return the sorted positions of one lowest and one highest value per slice, and of the ends of lines."""
    number = np.repeat(np.arange(len(first)), np.diff(first, append=len(values)))
    ends = np.flatnonzero(np.diff(line))
    points = [ends, ends + 1, np.array([0, len(values) - 1])]
    for extreme in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == extreme.reduceat(values, first)[number])
        points.append(hits[np.unique(number[hits], return_index=True)[1]])
    return np.unique(np.concatenate(points))


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
    single = np.array_equal(first, last)
    t = time[sample][first] if single else time[sample][np.column_stack([first, last]).ravel()]
    repeat = 1 if single else 2
    gaps = (np.flatnonzero(np.diff(line[first])) + 1) * repeat
    low, high = (np.insert(np.repeat(edge, repeat), gaps, np.nan) for edge in (low, high))
    return np.insert(t, gaps, np.nan), low, high


def isolated(values: Vector) -> list[int]:
    """Return the indices of finite values without a finite neighbour, which a line alone does not show."""
    return [run.start for run in true_runs(np.isfinite(values)) if run.stop - run.start == 1]
