"""Resampling to one clock: faster channels are low-passed, slower ones interpolated, gaps stay NaN."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from skdgp._flight.clock import GAP

ORDER = 4
PASSED = 0.4
"""Corner of the low-pass in parts of the new rate: gain 1/2 there."""
NEARLY = 1.2
"""A channel that is faster than the new rate by less than this is not low-passed."""
PAUSE = (5.0, 50.0)
"""Where the log stands still for longer than this [s] and [usual steps], the clock has no rows."""
SPARSE = 20.0
"""Rows of the clock per sample of the channel that it follows; a clock with more is none."""


def sampling_rate(time: np.ndarray) -> float:
    """Return the usual rate [Hz] of increasing times, NaN of less than two."""
    return float(1.0 / np.median(np.diff(time))) if len(time) > 1 else np.nan


def uniform_clock(time: np.ndarray, rate: float) -> np.ndarray:
    """Return the multiples of 1 / rate [s] that lie within the runs of a channel.

    Raises
    ------
    ValueError
        If there would be far more of them than samples.
    """
    step = np.diff(time)
    edges = np.flatnonzero(step > max(PAUSE[0], PAUSE[1] * np.median(step))) + 1
    starts, ends = time[np.r_[0, edges]], time[np.r_[edges, len(time)] - 1]
    first, last = np.ceil(starts * rate - 1e-6), np.floor(ends * rate + 1e-6)
    counts = np.maximum(last - first + 1, 0).astype(int)
    if counts.sum() > SPARSE * len(time) * max(1.0, rate / sampling_rate(time)):
        raise ValueError(
            f"Got {len(time)} samples over {(ends - starts).sum():.6g} s, but expected a clock without so many gaps."
        )
    return np.concatenate([a + np.arange(n) for a, n in zip(first, counts, strict=True)]) / rate


def resample(time: np.ndarray, values: np.ndarray, clock: np.ndarray, rate: float) -> np.ndarray:
    """Return channels at the times of another clock.

    Each run of samples without a gap (2.5 usual steps) is taken by itself. If it is faster than the new rate it passes
    a Butterworth low-pass forwards and backwards, which has no delay (Gustafsson 1996, Determining the initial states
    in forward-backward filtering); then it is interpolated linearly.

    Parameters
    ----------
    time : ndarray of shape (n,)
        Increasing [s].
    values : ndarray of shape (n, k)
        Rows that are not finite count as not sampled.
    clock : ndarray of shape (m,)
        Increasing [s].
    rate : float
        Of the clock [Hz].

    Returns
    -------
    ndarray of shape (m, k)
        NaN in gaps, before the first and after the last sample.
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
    """Return a run without what the new rate cannot carry."""
    n, own = len(time), (len(time) - 1) / (time[-1] - time[0])
    if own < NEARLY * rate:
        return values
    even = np.linspace(time[0], time[-1], n)
    sections = butter(ORDER, PASSED * rate, fs=own, output="sos")
    reach = min(n - 1, round(4 * own / rate) + 27)
    columns = [np.interp(even, time, column) for column in values.T]
    passed = sosfiltfilt(sections, np.column_stack(columns), axis=0, padlen=reach)
    return np.column_stack([np.interp(time, even, column) for column in passed.T])
