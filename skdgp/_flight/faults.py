"""Detection and removal of faults in a flight log.

A sensor with noise hardly ever repeats a value. If a share p of all runs of equal values is longer
than the usual length, a run of k times this length has the probability p^(k-1). Each
channel has its own usual length, so a sensor that is slower than the table is not stuck. A coarsely quantised or
noise-free channel has long runs without a fault: it is stuck only if it jumps after the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import FindingWarning
from skdgp._flight.channels import (
    ALL_SURFACES,
    BODY_VELOCITY,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    VANES,
)
from skdgp._flight.checks import ANGLE_NOISE, FASTEST_RATE, LARGEST_ANGLE, WRAPPED
from skdgp._flight.clock import GAP, flight_codes, true_runs

# of one sensor
SIBLINGS = (VANES, RATES, SPECIFIC_FORCE, EULER, EARTH_VELOCITY, BODY_VELOCITY, POSITION)
# noise and motion never let them stand still
SENSORS = ("airspeed", *(name for names in SIBLINGS for name in names))
# Outside of these nothing can have been measured
POSSIBLE = {
    "airspeed": (-10.0, 1000.0),
    **{
        name: (-LARGEST_ANGLE[name] - ANGLE_NOISE, LARGEST_ANGLE[name] + ANGLE_NOISE)
        for name in ("alpha", "beta", "theta")
    },
    **dict.fromkeys(RATES, (-FASTEST_RATE, FASTEST_RATE)),
    **dict.fromkeys(SPECIFIC_FORCE, (-1000.0, 1000.0)),
    **dict.fromkeys(("phi", "psi"), (-1000.0, 1000.0)),
    **dict.fromkeys((*EARTH_VELOCITY, *BODY_VELOCITY), (-1500.0, 1500.0)),
    **dict.fromkeys(POSITION, (-1e7, 1e7)),
    "density": (1e-3, 3.0),
    "altitude": (-1000.0, 1e5),
    "throttle": (-0.1, 1.5),
    "propeller_speed": (-1e4, 1e4),
    **dict.fromkeys(ALL_SURFACES, (-np.pi / 2, np.pi / 2)),
}
# impossible values more frequent than this fraction are of another unit: checks of units name it
RARE = 0.05


@dataclass(frozen=True)
class FaultSettings:
    """Constants of the search for faults; without another source they are guesses."""

    # Impossible values more frequent than this fraction are no fault.
    rare: float = RARE
    # Times [s] beyond this count from 1970, not from the start of a log.
    epoch: float = 1e8
    # Least number of samples to estimate the usual length of runs.
    enough: int = 50
    # Expected number of such runs in a flight below which chance is ruled out.
    improbable: float = 1e-4
    # Shorter holds [s] are no fault.
    least_hold: float = 0.3
    # Repeated values, at least, to estimate the resolution of a channel.
    fewest_held: int = 6
    # Fraction of such values that are multiples of the resolution.
    most_on_step: float = 0.9
    # Tolerance of such multiples, as a fraction of the resolution.
    off_step: float = 0.1
    # A spike stands out from its neighbours by so many times what all but 0.5 % of samples do.
    spike: float = 8.0
    # Most samples of a spike.
    widest_spike: int = 3
    # Steps that change by less than this fraction of themselves show no noise (with noise: 1.7).
    smooth: float = 0.5
    # A sample is missing where the next comes later than so many usual spacings.
    missing: float = 1.5


SETTINGS = FaultSettings()
NOT_MEASURED = (Code.STUCK, Code.IMPOSSIBLE, Code.SPIKE)


class FlightDataWarning(FindingWarning):
    """A log has faults."""


@dataclass(frozen=True)
class Fault:
    """A fault of one channel, and its rows by position in the table."""

    finding: Finding
    rows: np.ndarray

    @property
    def is_measured(self) -> bool:
        """Whether the values in these rows were measured."""
        return self.finding.code not in NOT_MEASURED


class _Rows(NamedTuple):
    """Rows of a flight with a fault of one channel, and the numbers that describe it."""

    channel: str
    code: Code
    rows: np.ndarray
    numbers: dict[str, Any]


def find_faults(
    table: pd.DataFrame, ignore: Iterable[str] = (), settings: FaultSettings = SETTINGS
) -> list[Fault]:
    """Return the faults of each flight in a table whose time increases within each; some columns are ignored."""
    time = table["time"].to_numpy(float)
    codes, names = flight_codes(
        table["flight"] if "flight" in table else np.full(len(table), "flight")
    )
    ignored = {*ignore}
    channels = {}
    for name in POSSIBLE:
        if name in table and name not in ignored and is_numeric_dtype(table[name]):
            channels[name] = table[name].to_numpy(float, na_value=np.nan)
    # texts count times from the first row of a clock that counts from 1970
    origin = float(time[0]) if len(time) and abs(time[0]) > settings.epoch else 0.0
    faults = []
    edges = np.flatnonzero(np.r_[True, np.diff(codes) != 0, True])
    for first, last in pairwise(edges):
        flight = names[codes[first]]
        flight_time = time[first:last]
        part = {name: values[first:last].copy() for name, values in channels.items()}
        for fault in _faults_of_flight(flight_time, part, settings):
            begin, end = flight_time[fault.rows[[0, -1]]].tolist()
            place = {"start": begin, "end": end, "samples": len(fault.rows), "origin": origin}
            finding = Finding(fault.code, flight, fault.channel, place | fault.numbers)
            faults.append(Fault(finding, first + fault.rows))
    return faults


def without_faults(table: pd.DataFrame, faults: Iterable[Fault]) -> pd.DataFrame:
    """Return the table with NaN for values that were not measured."""
    table = table.copy(deep=False)
    for fault in faults:
        if not fault.is_measured:
            channel = fault.finding.channel
            values = table[channel].to_numpy(float, na_value=np.nan).copy()
            values[fault.rows] = np.nan
            table[channel] = values
    return table


def _faults_of_flight(
    time: np.ndarray, channels: dict[str, np.ndarray], settings: FaultSettings
) -> Iterator[_Rows]:
    """Yield each fault; faulty values in the channels become NaN."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    rows = np.flatnonzero(np.diff(time) > GAP * step)
    if rows.size:
        numbers = {"times": len(rows), "longest": float(np.diff(time).max())}
        yield _Rows("time", Code.GAP, rows, numbers)
    for name, values in channels.items():
        yield from _missing(name, values, step, settings)
        values[~np.isfinite(values)] = np.nan
        yield from _impossible(name, values, settings)
        if name in SENSORS:
            for rows in stuck_rows(values, step, settings):
                yield _Rows(name, Code.STUCK, rows, {"value": float(values[rows[0]])})
                values[rows] = np.nan
            rows = spike_rows(values, angle=name in WRAPPED, settings=settings)
            if rows.size:
                yield _Rows(name, Code.SPIKE, rows, {"times": _n_runs(rows)})
    yield from _dead(channels, len(time), settings)


def _missing(
    name: str, values: np.ndarray, step: float, settings: FaultSettings
) -> Iterator[_Rows]:
    """Yield the gaps, together, of a channel that usually has values there."""
    sampled = np.flatnonzero(np.isfinite(values))
    if not sampled.size:
        yield _Rows(name, Code.MISSING, np.arange(len(values)), {})
        return
    ends = np.r_[-1, sampled, len(values)]
    spacing = np.diff(ends)
    wide = spacing > settings.missing * usual_spacing(values)
    if wide.any():
        lengths = spacing[wide] - 1
        gaps = zip(ends[:-1][wide] + 1, lengths, strict=True)
        rows = np.concatenate([np.arange(first, first + n) for first, n in gaps])
        numbers = {"times": _n_runs(rows), "longest": float(lengths.max() * step)}
        yield _Rows(name, Code.MISSING, rows, numbers)


def _impossible(name: str, values: np.ndarray, settings: FaultSettings) -> Iterator[_Rows]:
    low, high = POSSIBLE[name]
    rows = np.flatnonzero((values < low) | (values > high))
    if 0 < rows.size <= settings.rare * np.isfinite(values).sum():
        numbers = {"value": float(values[rows[0]])}
        values[rows] = np.nan
        yield _Rows(name, Code.IMPOSSIBLE, rows, numbers)


def _dead(channels: dict[str, np.ndarray], n: int, settings: FaultSettings) -> Iterator[_Rows]:
    """Yield sensors that have one value throughout while others of their kind move."""
    spread = {}
    for name, values in channels.items():
        sampled = values[np.isfinite(values)]
        if len(sampled) >= settings.enough:
            spread[name] = np.ptp(sampled)
    for names in SIBLINGS:
        moving = [name for name in names if spread.get(name, 0) > 0]
        for name in names:
            if moving and spread.get(name) == 0:
                yield _Rows(name, Code.CONSTANT, np.arange(n), {"moving": moving})


def _n_runs(rows: np.ndarray) -> int:
    """Return the number of runs of consecutive rows."""
    return 1 + int(np.sum(np.diff(rows) > 1))


def stuck_rows(
    values: np.ndarray, step: float, settings: FaultSettings = SETTINGS
) -> list[np.ndarray]:
    """Return the rows of each run where a sensor repeats its last value, improbably often."""
    rows = np.flatnonzero(np.isfinite(values))
    readings = values[rows]
    if len(rows) < settings.enough or np.ptp(readings) == 0:
        return []
    start = np.flatnonzero(np.r_[True, np.diff(readings) != 0])
    length = np.diff(np.r_[start, len(readings)])
    usual = np.median(length)
    k = np.floor(length / usual)
    share = (1 + np.sum(length >= 1.5 * usual)) / (1 + len(length))
    chance = len(length) * share ** (k - 1)  # expected number of runs at least so long
    stuck = (chance < settings.improbable) & (length * step >= settings.least_hold)

    # a channel that turns back repeats its value, and leaves it by one quantum
    leap = np.abs(np.diff(readings[start], append=np.nan))
    steps = leap[:-1]
    held = readings[start[length > 1]]
    quantum = max(np.quantile(steps, 0.01), _resolution(held, settings))
    stuck &= ~(leap <= 3 * quantum)

    # a channel without noise has long runs: it is stuck only if it jumps after the run
    bend = np.inf
    if len(steps) > 1:
        bend = np.median(np.abs(np.diff(readings[start], 2))) / np.median(steps)
    largest_usual = np.quantile(steps, 0.99)
    if bend < settings.smooth or np.median(steps) <= settings.missing * quantum:
        stuck &= leap > largest_usual

    # a value that is held again and again, and left by usual steps, is one of a coarse resolution
    levels, counts = np.unique(readings[start[stuck]], return_counts=True)
    again = np.isin(readings[start], levels[counts > 1])
    stuck &= ~(again & (leap <= largest_usual))
    runs = zip(start[stuck], length[stuck], strict=True)
    return [rows[first + 1 : first + n] for first, n in runs]


def _resolution(held: np.ndarray, settings: FaultSettings) -> float:
    """Return the common step of held values, from any origin; 0 if there is none."""
    levels = np.unique(held)
    if len(levels) < settings.fewest_held:
        return 0.0
    step = np.diff(levels).min()
    multiples = (levels - levels[len(levels) // 2]) / step
    on_step = np.abs(multiples - np.rint(multiples)) < settings.off_step
    return float(step) if on_step.mean() > settings.most_on_step else 0.0


def spike_rows(
    values: np.ndarray, *, angle: bool, settings: FaultSettings = SETTINGS
) -> np.ndarray:
    """Return the rows of a few samples that leap from their neighbours and back."""
    none = np.empty(0, int)
    sampled = np.flatnonzero(np.isfinite(values))
    if len(sampled) < settings.enough:
        return none
    start = np.flatnonzero(np.r_[True, np.diff(values[sampled]) != 0])
    fresh = values[sampled[start]]
    readings = np.unwrap(fresh) if angle else fresh
    if len(readings) < settings.enough:
        return none
    padded = np.pad(readings, 2, mode="reflect")
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    out = np.abs(readings - around)
    edges = np.r_[start, len(sampled)]
    spikes = [none]
    for run in true_runs(out > settings.spike * np.quantile(out, 0.995)):
        before = readings[max(run.start - 1, 0)]
        after = readings[min(run.stop, len(readings) - 1)]
        returns = abs(after - before) < out[run].max() / 2
        if run.stop - run.start <= settings.widest_spike and returns:
            spikes.append(sampled[edges[run.start] : edges[run.stop]])
    return np.concatenate(spikes)


def usual_spacing(values: np.ndarray) -> float:
    """Return the 90 % quantile of the rows between a sample and the next."""
    sampled = np.flatnonzero(np.isfinite(values))
    return float(np.quantile(np.diff(sampled), 0.9)) if sampled.size > 1 else 1.0
