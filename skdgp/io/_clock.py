"""Clocks of logs: messages without wrong time stamps, and channels brought to one clock.

Single time stamps may be wrong; the median of neighbouring messages in the file hardly ever is.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd

from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp._flight.clock import LONGEST_STEP, runs_between, slices
from skdgp._flight.smoothing import low_pass
from skdgp._flight.tables import interpolated
from skdgp.io._log import Topic

# messages, of which the median is hardly ever a wrong time
NEIGHBOURS = 25
# a clock that goes back by more than this was restarted [s]; messages out of order are less late
RESTART_STEP = 15.0
# between two runs of a clock [s]
RESTART_PAUSE = 60.0
# distance of valid times from the medians, beside the usual one [s]
MARGIN = 5.0
# corner of the low-pass in parts of the new rate: gain 1/2 there; and its order
CUTOFF = 0.4
FILTER_ORDER = 4
# least ratio of rates of a channel that is low-passed
LEAST_RATIO = 1.2
# in pauses longer than both, [s] and [usual steps], the clock has no rows
PAUSE_SECONDS = 5.0
PAUSE_STEPS = 50.0


def with_sound_times(topics: dict[str, Topic]) -> tuple[dict[str, Topic], list[str]]:
    """Return the topics without wrong times, their times strictly increasing, and remarks.

    A clock that was set back goes on behind a pause.
    """
    order = np.concatenate([topic.order for topic in topics.values()])
    time = np.concatenate([topic.time for topic in topics.values()])
    rows = np.argsort(order, kind="stable")
    rows = rows[_is_near_others(time[rows])]
    stamps, shifts = _behind_pauses(time[rows])
    continued = np.full(len(time), np.nan)
    continued[rows] = stamps
    ends = np.cumsum([len(topic) for topic in topics.values()])
    sound = {}
    n_wrong: Counter[str] = Counter()
    falls = {}
    for (name, topic), times in zip(topics.items(), np.split(continued, ends[:-1]), strict=True):
        valid = np.flatnonzero(np.isfinite(times))
        n_wrong[name] = len(topic) - len(valid)
        falls[name] = -np.diff(times[valid]).min(initial=0.0)
        if len(valid):
            # in order of time, each time once
            increasing, first = np.unique(times[valid], return_index=True)
            sound[name] = replace(topic.select(valid[first]), time=increasing)
    return sound, _remarks(shifts, falls, n_wrong, len(time))


def _remarks(
    shifts: list[float], falls: dict[str, float], n_wrong: Counter[str], n_messages: int
) -> list[str]:
    """Return remarks on a clock that was set back, on topics in which it goes back, and on wrong times."""
    remarks = []
    if shifts:
        later = ", ".join(f"{shift:.1f} s" for shift in shifts)
        remarks.append(
            f"the clock was set back, as by a restart: what follows has times {later} later than in the log"
        )
    name = max(falls, key=lambda name: falls[name])
    if falls[name] > MARGIN:
        remarks.append(
            f"the clock goes back by {falls[name]:.1f} s in {name}: what follows is mixed with what was before"
        )
    if n_wrong.total():
        name, most = n_wrong.most_common(1)[0]
        wrong = f"{n_wrong.total()} of {n_messages} messages have a time that cannot be"
        remarks.append(f"{wrong} ({most} of {name})")
    return remarks


def _behind_pauses(stamps: Vector) -> tuple[Vector, list[float]]:
    """Return times that go on behind a pause where the clock was set back, and how much later they are then [s]."""
    restarts = np.flatnonzero(np.diff(stamps) < -RESTART_STEP) + 1
    continued = stamps.copy()
    shifts = []
    end = 0.0
    for run in slices(restarts, len(stamps)):
        if run.start:
            shifts.append(end - stamps[run].min() + RESTART_PAUSE)
            continued[run] += shifts[-1]
        end = continued[run].max()
    return continued, shifts


def _is_near_others(time: Vector) -> Mask:
    """Return which times, in the order of the file, are near the median of those before, or of those behind."""
    # odd, so that a median is one of the times, and at most half of a short log
    n = min(NEIGHBOURS, 2 * ((len(time) - 1) // 4) + 1)
    before = _running_median(time, n)
    behind = _running_median(time[::-1], n)[::-1]
    margin = MARGIN + np.nanmedian(np.abs(behind - before))
    return (np.abs(time - before) <= margin) | (np.abs(time - behind) <= margin)


def _running_median(time: Vector, n: int) -> Vector:
    """Return the median of n times up to each one, of at least half as many at the beginning, else NaN."""
    return pd.Series(time).rolling(n, min_periods=n // 2 + 1).median().to_numpy()


def uniform_clock(time: Vector, rate: float) -> Vector:
    """Return the multiples of 1 / rate [s] within the runs of a channel."""
    step = np.diff(time)
    pause = max(PAUSE_SECONDS, PAUSE_STEPS * np.median(step))
    ticks = []
    for run in runs_between(time, pause):
        first = np.ceil(time[run][0] * rate - 1e-6)
        last = np.floor(time[run][-1] * rate + 1e-6)
        ticks.append(np.arange(first, last + 1))
    return np.concatenate(ticks) / rate


def resample(time: Vector, values: Matrix, clock: Vector, rate: float) -> Matrix:
    """Return finite channels (n, k) at increasing times (n,) [s] on another clock (m,) of ``rate`` [Hz], (m, k).

    Gaps, and rows before the first and after the last sample, are NaN. Each run of samples without
    a gap (2.5 usual steps) is taken by itself. If it is faster than the new rate it passes a
    Butterworth low-pass forwards and backwards, which has no delay (Gustafsson 1996, Determining
    the initial states in forward-backward filtering); then it is interpolated linearly.
    """
    result = np.full((len(clock), values.shape[1]), np.nan)
    gap = LONGEST_STEP * np.median(np.diff(time))
    tolerance = 1e-6 / rate
    for run in runs_between(time, gap):
        run_time = time[run]
        begin = np.searchsorted(clock, run_time[0] - tolerance)
        end = np.searchsorted(clock, run_time[-1] + tolerance, side="right")
        if len(run_time) > 1 and end > begin:
            passed = _low_passed(run_time, values[run], rate)
            result[begin:end] = interpolated(clock[begin:end], run_time, passed)
    return result


def _low_passed(time: Vector, values: Matrix, rate: float) -> Matrix:
    """Return a run without the frequencies that the new rate cannot carry."""
    n = len(time)
    old_rate = (n - 1) / (time[-1] - time[0])
    if old_rate < LEAST_RATIO * rate:
        return values
    even = np.linspace(time[0], time[-1], n)
    evenly = interpolated(even, time, values)
    passed = low_pass(evenly, old_rate, CUTOFF * rate, order=FILTER_ORDER)
    return interpolated(time, even, passed)
