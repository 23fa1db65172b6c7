"""The clock of a log (``time`` and ``flight`` of each row): flights, contiguous segments, sampling rate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

# a step longer than this many median steps starts a new segment (one lost sample is bridged)
GAP = 2.5
# samples nearer than this fraction of a step to a uniform grid count as on it (rounded clocks)
JITTER = 0.02
MULTIPLE = 0.1  # tolerance of multiples of the shortest step, as a fraction


def flight_segments(time: ArrayLike, flight: ArrayLike | None = None) -> list[slice]:
    """Return the segments of a log: rows of one flight without gaps, in order, every row once.

    A segment ends where ``flight`` (n,), identifiers, changes, and where ``time`` (n,) [s] steps by
    more than 2.5 times the median step of the flight. Raises ValueError if time is not finite, does
    not increase within a flight, or has no usual step; or a row names no flight.
    """
    return _split(*check_clock(time, flight))


def flight_codes(flight: ArrayLike) -> tuple[np.ndarray, list]:
    """Return the number of each row's flight, (n,), from 0 on in their order, and the flights' names.

    Raises ValueError if a row names no flight: its cell is empty, None, NaN or blank.
    """
    codes, names = pd.factorize(np.asarray(flight, dtype=object))
    blank = [code for code, name in enumerate(names) if not str(name).strip()]
    missing = np.flatnonzero((codes < 0) | np.isin(codes, blank))
    if missing.size:
        raise ValueError(
            f"Got {missing.size} of {len(codes)} rows without a flight (the first is row "
            f"{missing[0]}), but expected each to name its own: fill in these cells, or drop these "
            f"rows."
        )
    return codes, names.tolist()


def flight_rows(flight: ArrayLike) -> dict[str, np.ndarray]:
    """Return the rows of each flight by its name, in the order of the flights."""
    codes, names = flight_codes(flight)
    parts = np.split(np.argsort(codes, kind="stable"), np.cumsum(np.bincount(codes))[:-1])
    return dict(zip(names, parts, strict=False))  # of no rows at all there is one empty part


def check_clock(time: ArrayLike, flight: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
    """Return time (n,) as float and integer flight codes (n,); ValueError if time does not increase within a flight."""
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or not np.isfinite(time).all():
        raise ValueError(
            f"Got time of shape {time.shape}, but expected (n,), every value finite [s]."
        )
    codes = np.zeros(len(time), int) if flight is None else flight_codes(flight)[0]
    order = np.argsort(codes, kind="stable")  # rows of a flight may stand apart
    back = np.flatnonzero((np.diff(codes[order]) == 0) & ~(time[order[1:]] > time[order[:-1]]))
    if back.size:
        before, row = order[back[0] : back[0] + 2]
        raise ValueError(
            f"Got time {time[row]:.10g} s after {time[before]:.10g} s at row {row} ({len(back)} "
            f"such rows), but expected time to increase strictly within a flight: sort by time, "
            f"drop repeated rows, or name the flights apart in a column 'flight', as where a clock "
            f"was restarted."
        )
    return time, codes


def runs_by_flight(time: np.ndarray, codes: np.ndarray) -> list[list[slice]]:
    """Group the segments by flight."""
    runs: dict[int, list[slice]] = {}
    for segment in _split(time, codes):
        runs.setdefault(int(codes[segment.start]), []).append(segment)
    return list(runs.values())


def true_runs(mask: np.ndarray) -> list[slice]:
    """Return each run of True in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask).astype(int), [0]])))
    return [slice(a, b) for a, b in edges.reshape(-1, 2).tolist()]


def uniform_grid(time: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the uniform grid of a run, and whether the samples lie off it (so must be resampled)."""
    n = len(time)
    if n < 3:
        return time, False
    index = np.arange(n)
    line = np.polynomial.Polynomial.fit(index, time, 1)(index)
    step = (line[-1] - line[0]) / (n - 1)
    if np.abs(time - line).max() <= JITTER * step:
        return line, False
    size = max(n, 1 + round((time[-1] - time[0]) / np.median(np.diff(time))))
    return np.linspace(time[0], time[-1], size), True


def _split(time: np.ndarray, codes: np.ndarray) -> list[slice]:
    """Return the segments of a checked clock; raise ValueError if it has no usual step."""
    if not len(time):
        return []
    step = np.diff(time)
    same = np.diff(codes) == 0
    usual = pd.Series(step[same]).groupby(codes[1:][same]).median()
    usual_here = usual.reindex(codes[1:]).to_numpy()
    gap = same & (step > GAP * usual_here)
    starts = ~same | gap
    uneven = ~starts & (np.abs(step - usual_here) > 0.5 * usual_here)
    if max(gap.sum(), uneven.sum()) > 0.1 * max(same.sum(), 10):
        steps = step[same] / step[same].min()
        drawn = np.mean(np.abs(steps - np.rint(steps)) < MULTIPLE) > 0.99
        remedy = "resample the log to one uniform clock first"
        if drawn:
            remedy = (
                "rows seem to be left out at random, as by a shuffled KFold: hold out whole flights"
            )
        raise ValueError(
            f"Got time steps from {step[same].min():.3g} s to {step[same].max():.3g} s (median "
            f"{np.median(step[same]):.3g} s), but expected a nearly constant rate with few gaps: "
            f"{remedy}."
        )
    edges = [0, *(np.flatnonzero(starts) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in pairwise(edges)]
