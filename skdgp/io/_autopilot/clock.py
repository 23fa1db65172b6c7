"""Resampling of all topics to one clock: removes wrong time stamps, detects restarts, keeps gaps.

Single time stamps may be wrong; the median of neighbouring messages in the file hardly ever is.
"""

from __future__ import annotations

from itertools import pairwise
from operator import itemgetter

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import butter, sosfiltfilt

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.clock import GAP
from skdgp.io._autopilot.formats import Topic

BLOCK_SIZE = 25  # messages whose median time is compared with that of the next
RESTART_STEP = 5.0  # a clock that goes back by more than this was restarted [s]; messages out of order are less late
STAMP_MARGIN = 5.0  # distance of valid stamps from the medians of a part [s]
LARGEST_STEP = 60.0  # longest step between medians that widens this margin [s]
FILTER_ORDER = 4
CUTOFF = 0.4  # corner of the low-pass in parts of the new rate: gain 1/2 there
LEAST_RATIO = 1.2  # ratio of rates from which a channel is low-passed
LONGEST_PAUSE = (5.0, 50.0)  # in longer pauses, [s] and [usual steps], the clock has no rows
MOST_ROWS_PER_SAMPLE = 20.0  # of the clock, per sample of the channel that it follows
LEAST_GAP = 0.5  # seconds of a gap that is worth a remark


def clock_parts(topics: dict[str, Topic]) -> tuple[list[dict[str, Topic]], list[str]]:
    """Return the topics, split where the clock was set back, their times strictly increasing; and remarks."""
    order = np.concatenate([topic.order for topic in topics.values()])
    rows = np.argsort(order, kind="stable")
    order, time = order[rows], np.concatenate([topic.time for topic in topics.values()])[rows]
    edges = [0, *_restarts(time), len(time)]
    parts: list[dict[str, Topic]] = []
    remarks: list[str] = []
    dropped: dict[str, int] = {}
    disordered = 0
    for first, last in pairwise(edges):
        steady = _steady(time[first:last])
        margin = STAMP_MARGIN + min(np.abs(np.diff(steady)).max(initial=0.0), LARGEST_STEP)
        part = {}
        for name, topic in topics.items():
            inside = (topic.order >= order[first]) & (topic.order <= order[last - 1])
            valid = inside & (topic.time >= steady.min() - margin) & (topic.time <= steady.max() + margin)
            here = topic.select(valid)
            disordered += int((np.diff(here.time) < 0).sum())
            here = here.select(np.unique(here.time, return_index=True)[1])
            dropped[name] = dropped.get(name, 0) + int(inside.sum() - valid.sum())
            if len(here):
                part[name] = here
        parts.append(part)
    if len(parts) > 1:
        steps = ", ".join(f"from {time[edge - 1]:.1f} s to {time[edge]:.1f} s" for edge in edges[1:-1][:4])
        remarks.append(f"the clock was set back {len(parts) - 1} times ({steps}): what follows is a flight of its own")
    if n_dropped := sum(dropped.values()):
        most, name = max(zip(dropped.values(), dropped, strict=True), key=itemgetter(0))
        remarks.append(f"{n_dropped} of {len(time)} messages have a time that cannot be ({most} of {name})")
    if disordered:
        remarks.append(f"{disordered} messages stand out of order in time, and were sorted")
    return parts, remarks


def _steady(time):
    """Return the median time of each block of messages, (m,), and of these the median of five neighbours."""
    size = min(BLOCK_SIZE, len(time))
    centres = np.median(time[: len(time) // size * size].reshape(-1, size), axis=1)
    # Not scipy.ndimage.median_filter: of one value, versions 1.15.0 to .2 overwrite memory, and 1.15.3 returns 0.
    return np.median(sliding_window_view(np.pad(centres, 2, mode="edge"), 5), axis=1)


def _restarts(time) -> list[int]:
    """Return the messages with which a clock that was set back begins."""
    steady, found = _steady(time), []
    for block in np.flatnonzero(np.diff(steady) < -RESTART_STEP).tolist():
        window = slice(max(block - 3, 0) * BLOCK_SIZE, (block + 5) * BLOCK_SIZE)
        later = np.where(time[window] > (steady[block] + steady[block + 1]) / 2, 1, -1)
        found.append(window.start + int(np.argmax(np.cumsum(later))) + 1)
    return sorted(set(found) - {len(time)})


def sampling_rate(time: Vector) -> float:
    """Return the usual rate [Hz] of increasing times, NaN of less than two."""
    return float(1.0 / np.median(np.diff(time))) if len(time) > 1 else np.nan


def gaps(time: Vector) -> list[tuple[float, float]]:
    """Return beginnings and lengths [s] of the gaps between increasing times that are worth a remark."""
    step = np.diff(time)
    if not len(step):
        return []
    return [(float(time[i]), float(step[i])) for i in np.flatnonzero(step > max(LEAST_GAP, GAP * np.median(step)))]


def uniform_clock(time: Vector, rate: float) -> Vector:
    """Return the multiples of 1 / rate [s] within the runs of a channel; ValueError if far more than samples."""
    step = np.diff(time)
    edges = np.flatnonzero(step > max(LONGEST_PAUSE[0], LONGEST_PAUSE[1] * np.median(step))) + 1
    starts, ends = time[np.r_[0, edges]], time[np.r_[edges, len(time)] - 1]
    first, last = np.ceil(starts * rate - 1e-6), np.floor(ends * rate + 1e-6)
    counts = np.maximum(last - first + 1, 0).astype(int)
    if counts.sum() > MOST_ROWS_PER_SAMPLE * len(time) * max(1.0, rate / sampling_rate(time)):
        raise ValueError(
            f"Got {len(time)} samples over {(ends - starts).sum():.6g} s, but expected a clock without so many gaps."
        )
    return np.concatenate([a + np.arange(n) for a, n in zip(first, counts, strict=True)]) / rate


def resample(time: Vector, values: Matrix, clock: Vector, rate: float) -> Matrix:
    """Return channels (n, k), sampled at increasing times (n,) [s], on another clock (m,) of ``rate`` [Hz], (m, k).

    Rows that are not finite count as not sampled; gaps, and rows before the first and after the last sample, are NaN.
    Each run of samples without a gap (2.5 usual steps) is taken by itself. If it is faster than the new rate it passes
    a Butterworth low-pass forwards and backwards, which has no delay (Gustafsson 1996, Determining the initial states
    in forward-backward filtering); then it is interpolated linearly.
    """
    result = np.full((len(clock), values.shape[1]), np.nan)
    known = np.isfinite(values).all(axis=1)
    time, values = time[known], values[known]
    if len(time) < 2:
        return result
    step = np.diff(time)
    edges = np.r_[0, np.flatnonzero(step > GAP * np.median(step)) + 1, len(time)]
    tolerance = 1e-6 / rate
    begins = np.searchsorted(clock, time[edges[:-1]] - tolerance)
    ends = np.searchsorted(clock, time[edges[1:] - 1] + tolerance, side="right")
    for a, b, begin, end in zip(edges[:-1], edges[1:], begins, ends, strict=True):
        if b - a > 1 and end > begin:
            run = _low_passed(time[a:b], values[a:b], rate)
            for j in range(values.shape[1]):
                result[begin:end, j] = np.interp(clock[begin:end], time[a:b], run[:, j])
    return result


def _low_passed(time, values, rate):
    """Return a run without the frequencies that the new rate cannot carry."""
    n, old_rate = len(time), (len(time) - 1) / (time[-1] - time[0])
    if old_rate < LEAST_RATIO * rate:
        return values
    even = np.linspace(time[0], time[-1], n)
    sections = butter(FILTER_ORDER, CUTOFF * rate, fs=old_rate, output="sos")
    padding = min(n - 1, round(4 * old_rate / rate) + 27)
    columns = [np.interp(even, time, column) for column in values.T]
    passed = sosfiltfilt(sections, np.column_stack(columns), axis=0, padlen=padding)
    return np.column_stack([np.interp(time, even, column) for column in passed.T])
