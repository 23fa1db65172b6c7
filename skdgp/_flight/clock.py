"""The clock of a log (``time`` and ``flight`` of each row): flights, contiguous segments, sampling rate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.typing import Indices, Mask, Vector

# A step of more usual steps than this starts a new segment: one lost sample is bridged
LONGEST_STEP = 2.5


@dataclass(frozen=True)
class Clock:
    """Time and flight of each row: time increases within each flight.

    Attributes
    ----------
    time : ndarray (n,)
        [s].
    flight : ndarray (n,) of int
        Number of each row's flight, from 0 on in their order.
    names : list
        Names of the flights.
    """

    time: Vector
    flight: Indices
    names: list

    @classmethod
    def of(cls, time: ArrayLike, flight: ArrayLike | None = None) -> Clock:
        """Return the clock of times (n,) [s] and names of flights (n,), by default one flight.

        Raises ValueError if time is not finite or does not increase within a flight, or a row names
        no flight.
        """
        time = np.asarray(time, dtype=float)
        if time.ndim != 1 or not np.isfinite(time).all():
            raise ValueError(
                f"Got time of shape {time.shape}, but expected (n,), every value finite [s]."
            )
        codes = np.zeros(len(time), int)
        names = ["flight"]
        if flight is not None:
            codes, names = flight_codes(flight)
        # rows of a flight may stand apart
        order = np.argsort(codes, kind="stable")
        is_same = np.diff(codes[order]) == 0
        is_later = np.diff(time[order]) > 0
        back = np.flatnonzero(is_same & ~is_later)
        if back.size:
            before, row = order[back[0] : back[0] + 2]
            raise ValueError(
                f"Got time {time[row]:.10g} s after {time[before]:.10g} s at row {row} "
                f"({len(back)} such rows), but expected time to increase strictly within a flight: "
                "sort by time, drop repeated rows, or name the flights apart in a column 'flight', "
                "as where a clock was restarted."
            )
        return cls(time, codes, names)

    def part(self, rows: Indices) -> Clock:
        """Return the clock of some rows, in their order, and of their flights."""
        present, flight = np.unique(self.flight[rows], return_inverse=True)
        names = [self.names[number] for number in present]
        return Clock(self.time[rows], flight, names)

    @property
    def rows(self) -> dict[str, Indices]:
        """Rows of each flight by its name, in the order of the flights."""
        return {name: np.flatnonzero(self.flight == k) for k, name in enumerate(self.names)}

    @cached_property
    def segments(self) -> list[slice]:
        """Rows of one flight without gaps, in order, every row once.

        A segment ends where the flight changes, and where time steps by more than 2.5 times the
        median step of the flight. Raises ValueError if time has no usual step, or rows of flights alternate.
        """
        step = np.diff(self.time)
        is_same = np.diff(self.flight) == 0
        # a tenth of returns to an earlier flight (guess): rows that alternate have no rate
        n_returns = np.sum(~is_same) + 1 - len(self.names)
        if n_returns > 0.1 * max(len(self.time), 10):
            raise ValueError(
                f"Got rows of {len(self.names)} flights that alternate, but expected those of each flight one after "
                "another: sort by flight, then by time."
            )
        steps = pd.Series(step).where(is_same)
        usual = steps.groupby(self.flight[1:]).transform("median").to_numpy()
        is_gap = is_same & (step > LONGEST_STEP * usual)
        is_uneven = is_same & ~is_gap & (np.abs(step - usual) > usual / 2)
        n_irregular = max(is_gap.sum(), is_uneven.sum())
        # a tenth of gaps, or of uneven steps (guess)
        if n_irregular > 0.1 * max(is_same.sum(), 10):
            raise ValueError(
                f"Got time steps from {step[is_same].min():.3g} s to {step[is_same].max():.3g} s, but expected a "
                "nearly constant rate with few gaps: resample the log to one uniform clock first. If rows are left "
                "out at random, as by a shuffled KFold: hold out whole flights."
            )
        starts = np.flatnonzero(~is_same | is_gap) + 1
        return slices(starts, len(self.time))

    @property
    def elapsed(self) -> Vector:
        """Time since the beginning of each row's segment [s], (n,)."""
        starts = np.concatenate(
            [np.full(n_rows(run), self.time[run.start]) for run in self.segments]
        )
        return self.time - starts

    @property
    def segments_by_flight(self) -> list[list[slice]]:
        """The segments of each flight."""
        runs: dict[int, list[slice]] = {}
        for segment in self.segments:
            number = int(self.flight[segment.start])
            runs.setdefault(number, []).append(segment)
        return list(runs.values())


def flight_codes(flight: ArrayLike) -> tuple[Indices, list]:
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
            "rows."
        )
    return codes, names.tolist()


def slices(starts: Iterable[int], n: int) -> list[slice]:
    """Return the parts of n rows that begin at the first row and at ``starts``; none of no rows."""
    if not n:
        return []
    edges = [0, *map(int, starts), n]
    return [slice(first, last) for first, last in pairwise(edges)]


def runs_between(time: Vector, gap: float) -> list[slice]:
    """Return the runs of increasing times between steps longer than a gap [s]."""
    return slices(np.flatnonzero(np.diff(time) > gap) + 1, len(time))


def n_rows(run: slice) -> int:
    """Return the number of rows of a run."""
    return int(run.stop - run.start)


def median_step(time: Vector, runs: list[slice]) -> float:
    """Return the median step within runs [s]."""
    steps = [np.diff(time[run]) for run in runs]
    return float(np.median(np.concatenate(steps)))


def true_runs(mask: Mask) -> list[slice]:
    """Return each run of True in a mask (n,)."""
    padded = np.concatenate([[0], np.asarray(mask).astype(int), [0]])
    edges = np.flatnonzero(np.diff(padded))
    pairs = edges.reshape(-1, 2).tolist()
    return [slice(first, last) for first, last in pairs]


def unrounded(time: Vector) -> tuple[Vector, float]:
    """Return the times of a run on a uniform clock if they are rounded from one, and the resolution, 0 if they are not.

    Rounded steps have two sizes, one resolution apart, and times less the clock have a range of one resolution. Fewer
    than 50 steps do not tell them from jitter, and a resolution of less than a twentieth of a step disturbs no rate.
    """
    steps = np.diff(time)
    if len(steps) < 50:
        return time, 0.0
    sizes = np.unique(np.round(steps, 6))
    resolution = float(np.ptp(sizes))
    between = (sizes > sizes[0] + 0.1 * resolution) & (sizes < sizes[-1] - 0.1 * resolution)
    if resolution < 0.05 * np.median(steps) or between.any():
        return time, 0.0
    line = _line(time)
    if np.ptp(time - line) > 1.2 * resolution:
        return time, 0.0
    return line, resolution


def _line(time: Vector) -> Vector:
    """Return the uniform clock nearest to increasing times (n,)."""
    index = np.arange(len(time))
    return np.polynomial.Polynomial.fit(index, time, 1)(index)


def uniform_grid(time: Vector) -> tuple[Vector, bool]:
    """Return the uniform grid of a run, and whether the samples lie off it (so must be resampled).

    Samples nearer than a fiftieth of a step are on it: clocks are rounded.
    """
    n = len(time)
    if n < 3:
        return time, False
    line = _line(time)
    step = np.ptp(line) / (n - 1)
    jitter = np.abs(time - line).max()
    if jitter <= 0.02 * step:
        return line, False
    n_steps = round(np.ptp(time) / np.median(np.diff(time)))
    return np.linspace(time[0], time[-1], max(n, 1 + n_steps)), True
