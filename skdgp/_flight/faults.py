"""Detection and removal of faults in a flight log, and of rows on the ground.

A sensor with noise hardly ever repeats a value. If a share p of all runs of equal values is longer
than the usual length, a run of k times this length has the probability p^(k-1). Each
channel has its own usual length, so a sensor that is slower than the table is not stuck. A coarsely quantised or
noise-free channel has long runs without a fault: it is stuck only if it jumps after the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view

from skdgp._compute.messages import FindingWarning, report
from skdgp._compute.typing import Indices, Mask, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    BODY_VELOCITY,
    CHANNELS,
    EARTH_VELOCITY,
    EULER,
    HIGH_LIFT,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    VANES,
    WRAPPED,
)
from skdgp._flight.clock import LONGEST_STEP, n_rows, true_runs
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import wrapped
from skdgp._flight.holds import CONTROL_GROUPS, SENSOR_GROUPS, between_samples, find_holds
from skdgp._flight.tables import FlightTable, unwrapped, wrap_near
from skdgp._flight.units import ANGLE_NOISE, MOST_THROTTLE

# of one sensor
SIBLINGS = (VANES, RATES, SPECIFIC_FORCE, EULER, EARTH_VELOCITY, BODY_VELOCITY, POSITION)
# noise and motion never let them stand still
SENSORS = {"airspeed"}.union(*SIBLINGS)
# whose range has an end, which flights reach: an airspeed, and a bank angle, stay where they are held
LIMITED = {*VANES, *RATES, *SPECIFIC_FORCE}
# channels that move only if those of a group do
WITNESSES = {
    ("airspeed",): (*SPECIFIC_FORCE, *EARTH_VELOCITY),
    ("elevator",): ("aileron", "q"),
    RATES: EULER,
    EULER: RATES,
}


def _within(size: float, *names: str) -> dict[str, tuple[float, float]]:
    """Return limits of channels, the same on both sides of zero."""
    return dict.fromkeys(names, (-size, size))


# Outside of these nothing can have been measured
POSSIBLE = {
    "airspeed": (-10.0, 1000.0),
    **_within(np.pi + ANGLE_NOISE, "alpha"),
    **_within(np.pi / 2 + ANGLE_NOISE, "beta", "theta"),
    **_within(50.0, *RATES),  # eight turns a second
    **_within(1000.0, *SPECIFIC_FORCE, *WRAPPED),
    **_within(1500.0, *EARTH_VELOCITY, *BODY_VELOCITY),
    **_within(1e7, *POSITION),
    "density": (1e-3, 3.0),
    "altitude": (-1000.0, 1e5),
    "throttle": (-0.1, MOST_THROTTLE),
    "differential_throttle": (-MOST_THROTTLE, MOST_THROTTLE),
    "propeller_speed": (-1e4, 1e4),
    **_within(np.pi / 2, *ALL_SURFACES, *HIGH_LIFT),
}


# Constants of the search without another source are guesses.
# Impossible values more frequent than this fraction are of another unit, which other checks name
RARE = 0.05
# Longest gap that is interpolated [s]
LONGEST_BRIDGE = 0.25
BRIDGED = [name for name in CHANNELS if name not in ("time", "flight")]
# Rows a second that show the fast modes
SLOWEST = 8.0
# Least number of samples to estimate the usual length of runs, and of leaps
ENOUGH = 50
NOT_MEASURED = (Code.STUCK, Code.IMPOSSIBLE, Code.SPIKE, Code.CLIPPED)


class FlightDataWarning(FindingWarning):
    """A log has faults."""


class Fault(NamedTuple):
    """A fault of one channel, its rows by position in the table, and the numbers that describe it."""

    channel: str
    code: Code
    rows: Indices
    numbers: dict[str, Any]
    flight: Any = None

    @property
    def is_measured(self) -> bool:
        """Whether the values in these rows were measured."""
        return self.code not in NOT_MEASURED

    @property
    def finding(self) -> Finding:
        """The finding of the fault."""
        return Finding(self.code, self.flight, self.channel, **self.numbers)


def find_faults(flights: FlightTable, ignore: Iterable[str] = ()) -> list[Fault]:
    """Return the faults of each flight; some columns are ignored."""
    ignored = {*ignore}
    names = [name for name in POSSIBLE if name not in ignored]
    faults = []
    for flight, rows in flights.clock.rows.items():
        part = flights.part(rows)
        for fault in _faults_of_flight(part, names):
            times = part.time[fault.rows]
            place = {"start": float(times[0]), "end": float(times[-1]), "samples": len(fault.rows)}
            numbers = place | fault.numbers
            faults.append(fault._replace(rows=rows[fault.rows], numbers=numbers, flight=flight))
    return faults


def without_faults(table: pd.DataFrame, faults: Iterable[Fault]) -> pd.DataFrame:
    """Return the table with NaN for values that were not measured."""
    table = table.copy(deep=False)
    for fault in faults:
        if not fault.is_measured:
            values = table[fault.channel].to_numpy(float, na_value=np.nan).copy()
            values[fault.rows] = np.nan
            table[fault.channel] = values
    return table


def clean(flights: FlightTable, ignore: Sequence[str] = ()) -> FlightTable:
    """Return flights without faults and with short gaps interpolated, and what was found."""
    faults = find_faults(flights, ignore)
    # gaps in time are no error
    faulty = [fault.finding for fault in faults if fault.code is not Code.GAP]
    measured = replace(flights, table=without_faults(flights.table, faults))
    new = _bridged(measured, ignore)
    controls = find_holds(measured, CONTROL_GROUPS)
    holds = [*controls, *find_holds(measured, SENSOR_GROUPS)]
    findings = []
    if faulty:
        findings.append(Finding(Code.FAULTS_BRIDGED, faults=faulty, longest_bridge=LONGEST_BRIDGE))
    if holds:
        rates = {", ".join(hold.names): hold.rate for hold in holds}
        findings.append(Finding(Code.SLOW_CHANNELS, rates=rates))
    table = measured.table.assign(**new | between_samples(measured, controls))
    return replace(flights, table=table, findings=tuple(findings))


def _bridged(flights: FlightTable, ignore: Sequence[str]) -> dict[str, Vector]:
    """Return the channels that have missing values, with short gaps interpolated."""
    new = {}
    for name, values in flights.numeric_channels(BRIDGED).items():
        if name in ignore or np.isfinite(values).all():
            continue
        filled = unwrapped(flights.table, [name])[:, 0]
        filled[~np.isfinite(filled)] = np.nan
        for segment in flights.segments:
            filled[segment] = _interpolated(flights.time[segment], filled[segment])
        new[name] = filled
    angles = flights.table[[name for name in WRAPPED if name in new]]
    wrap_near(new, angles.replace([np.inf, -np.inf], np.nan).ffill().bfill())
    return new


def _interpolated(time: Vector, values: Vector) -> Vector:
    """Return values with short gaps interpolated, if nearly every row has a sample."""
    observed = np.isfinite(values)
    if observed.sum() < 2 or usual_spacing(values) > 1:
        return values
    sampled = pd.Series(np.where(observed, time, np.nan))
    gap = sampled.bfill() - sampled.ffill()  # NaN before the first sample and after the last
    filled = np.interp(time, time[observed], values[observed])
    return np.where(gap <= LONGEST_BRIDGE + 1e-9, filled, values)


def _faults_of_flight(flight: FlightTable, names: list[str]) -> Iterator[Fault]:
    """Yield each fault of a flight: gaps in time, then channel by channel, then dead sensors."""
    steps = np.diff(flight.time)
    step = float(np.median(steps)) if len(steps) else 1.0
    gaps = np.flatnonzero(steps > LONGEST_STEP * step)
    if gaps.size:
        numbers = {"times": len(gaps), "longest": float(steps.max())}
        yield Fault("time", Code.GAP, gaps, numbers)
    channels = flight.numeric_channels(names)
    for name, values in channels.items():
        yield from _faults_of_channel(name, values, step)
    yield from _dead(channels)
    yield from _jumps(channels, steps)


def _jumps(channels: dict[str, Vector], steps: Vector) -> Iterator[Fault]:
    """Yield the steps in which an angle of the attitude changes by far more than the gyros turn.

    More jumps than ten are of a channel in another unit, which other checks name.
    """
    if not {*RATES} <= channels.keys():
        return
    rates = np.max([np.abs(channels[name]) for name in RATES], axis=0)
    turned = np.fmax(rates[1:], rates[:-1]) * steps
    for name in [name for name in EULER if name in channels]:
        change = np.abs(wrapped(np.diff(channels[name])))
        # near the vertical roll and heading change by more than the rates
        is_jump = change > 0.15 + 1.5 * turned
        if "theta" in channels:
            is_jump &= np.abs(channels["theta"][1:]) < 1.2
        rows = 1 + np.flatnonzero(is_jump & (steps < 0.11))
        if 0 < rows.size <= 10:
            yield Fault(name, Code.JUMP, rows, {"size": float(change[rows - 1].max())})


def attitude_jumps(flights: FlightTable) -> Vector:
    """Return the times [s] at which the attitude jumps, as by another estimator."""
    channels = flights.numeric_channels((*RATES, *EULER))
    rows: set[int] = set()
    for jump in _jumps(channels, np.diff(flights.time)):
        rows.update(jump.rows)
    return flights.time[sorted(rows)]


def _faults_of_channel(name: str, values: Vector, step: float) -> Iterator[Fault]:
    """Yield the faults of a channel, in whose place its values become NaN: each is found without those before."""
    values[~np.isfinite(values)] = np.nan
    is_missing = np.isnan(values)
    # as many rows are missing between samples of a sensor that is slower than the table
    usual = 1.5 * usual_spacing(values) - 1
    gaps = [gap for gap in true_runs(is_missing) if n_rows(gap) > usual]
    if is_missing.all():
        yield Fault(name, Code.NEVER_MEASURED, np.arange(len(values)), {})
    elif gaps:
        numbers = {"times": len(gaps), "longest": max(map(n_rows, gaps)) * step}
        yield Fault(name, Code.MISSING, np.r_[tuple(gaps)], numbers)
    low, high = POSSIBLE[name]
    rows = np.flatnonzero((values < low) | (values > high))
    if 0 < rows.size <= RARE * np.sum(~is_missing):
        yield Fault(name, Code.IMPOSSIBLE, rows, {"value": float(values[rows[0]])})
        values[rows] = np.nan
    if name not in SENSORS:
        return
    marks = mark_rows(values)
    values[marks] = np.nan
    rows = np.union1d(marks, spike_rows(values, angle=name in WRAPPED))
    values[rows] = np.nan
    if rows.size:
        n_runs = 1 + int(np.sum(np.diff(rows) > 1))
        yield Fault(name, Code.SPIKE, rows, {"times": n_runs})
    for rows in clipped_rows(values) if name in LIMITED else ():
        yield Fault(name, Code.CLIPPED, rows, {"value": float(values[rows[0]])})
        values[rows] = np.nan
    for rows in stuck_rows(values, step):
        yield Fault(name, Code.STUCK, rows, {"value": float(values[rows[0]])})
        values[rows] = np.nan


def dead_channels(flights: FlightTable) -> list[str]:
    """Return the sensors that have one value in all flights while others of their kind move."""
    return [dead.channel for dead in _dead(flights.numeric_channels(POSSIBLE))]


def _dead(channels: dict[str, Vector]) -> Iterator[Fault]:
    """Yield sensors that have one value throughout while others of their kind move, else their witnesses."""
    ranges = {}
    for name, values in channels.items():
        sampled = values[np.isfinite(values)]
        if len(sampled) >= ENOUGH:
            ranges[name] = np.ptp(sampled)
    for names in (("airspeed",), ("elevator",), *SIBLINGS):
        for witnesses in (names, WITNESSES.get(names, ())):
            moving = [name for name in witnesses if ranges.get(name, 0) > 0]
            if moving:
                break
        for name in names:
            if moving and ranges.get(name) == 0:
                yield Fault(name, Code.CONSTANT, np.arange(len(channels[name])), {"moving": moving})


class _Runs(NamedTuple):
    """Runs of equal readings of a sensor."""

    rows: Indices  # rows with a reading
    start: Indices  # first reading of each run, among these rows
    length: Indices
    value: Vector

    @classmethod
    def of(cls, values: Vector) -> _Runs:
        """Return the runs of a channel, NaN where it has no reading."""
        rows = np.flatnonzero(np.isfinite(values))
        readings = values[rows]
        start = np.flatnonzero(np.diff(readings, prepend=np.nan) != 0)
        length = np.diff(start, append=len(rows))
        return cls(rows, start, length, readings[start])

    def readings_of(self, is_chosen: Mask) -> Indices:
        """Return the rows of the readings in some of the runs."""
        return self.rows[np.repeat(is_chosen, self.length)]


def stuck_rows(values: Vector, step: float) -> list[Indices]:
    """Return the rows of each run of 0.3 s or more where a sensor repeats its last value, improbably often."""
    runs = _Runs.of(values)
    if len(runs.rows) < ENOUGH or np.ptp(runs.value) == 0:
        return []
    is_stuck = _is_improbable(runs.length) & (runs.length * step >= 0.3)

    # a channel that turns back repeats its value, and leaves it by one quantum
    leap = np.abs(np.diff(runs.value))
    usual_step = np.median(leap)
    largest_usual = np.quantile(leap, 0.99)
    quantum = max(np.quantile(leap, 0.01), _resolution(runs.value[runs.length > 1]))
    is_stuck[:-1] &= leap > 3 * quantum

    # a channel without noise has long runs: it is stuck only if it jumps after the run, or the last run, of 2 s,
    # is far longer than all others. With noise steps change by 1.7 times themselves.
    is_jump = leap > largest_usual
    is_coarse = usual_step <= 1.5 * quantum
    bends = np.abs(np.diff(runs.value, 2))
    if is_coarse or (bends.size and np.median(bends) < 0.5 * usual_step):
        is_stuck[:-1] &= is_jump
        longest_other = runs.length[:-1].max()
        is_stuck[-1] &= runs.length[-1] >= max(2.0 / step, 5 * longest_other)

    # a value that is held again and again, and left by usual steps, is one of a coarse resolution
    levels, counts = np.unique(runs.value[is_stuck], return_counts=True)
    is_stuck[:-1] &= is_jump | ~np.isin(runs.value[:-1], levels[counts > 1])

    stuck = []
    for first, length in zip(runs.start[is_stuck], runs.length[is_stuck], strict=True):
        stuck.append(runs.rows[first + 1 : first + length])
    return stuck


def _is_improbable(length: Indices) -> Mask:
    """Return which of the runs are longer than chance makes one of them in 10,000 flights.

    Where a fraction p of n runs is longer than usual, chance makes n p^(k - 1) of them k times as long.
    """
    usual = np.median(length)
    p = (1 + np.sum(length >= 1.5 * usual)) / (1 + len(length))
    k = np.floor(length / usual)
    return len(length) * p ** (k - 1) < 1e-4


def _resolution(held: Vector) -> float:
    """Return the step that nine in ten of the steps of held values are multiples of; 0 if there is none."""
    levels = np.unique(held)
    if len(levels) < 6:
        return 0.0
    steps = np.diff(levels)
    step = steps.min()
    # of single precision, whose error would add up over many steps
    multiples = steps / step
    is_on_step = np.abs(multiples - np.rint(multiples)) < 0.1
    return float(step) if is_on_step.mean() > 0.9 else 0.0


def mark_rows(values: Vector) -> Indices:
    """Return the rows of one value that stands for missing samples, such as zero.

    A sensor leaps to it and back at least five times, which changes what it reads less than a third as much, and
    repeats no other value a fifth as often. The edges of a dead band are no farther from it than the leaps.
    """
    runs = _Runs.of(values)
    nothing = np.empty(0, int)
    counts = pd.Series(runs.value).value_counts()
    if len(runs.rows) < ENOUGH or len(counts) < 2:
        return nothing
    first, second = counts.iloc[:2]
    if first < max(5, 5 * second):
        return nothing
    mark = counts.index[0]
    is_mark = runs.value == mark
    inner = 1 + np.flatnonzero(is_mark[1:-1])
    before = runs.value[inner - 1]
    after = runs.value[inner + 1]
    usual = np.median(np.abs(after - before))
    others = runs.value[~is_mark]
    if others.min() < mark < others.max():
        usual = max(usual, np.abs(others - mark).min())
    leap = np.median(np.abs(mark - (before + after) / 2))
    return runs.readings_of(is_mark) if leap > 3 * usual else nothing


def clipped_rows(values: Vector) -> list[Indices]:
    """Return the rows of the least and of the largest value, if a sensor reads them far more often than all others.

    Of a coarse resolution the ends are the rarest values; zero stands for rest.
    """
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < ENOUGH:
        return []
    least = max(ENOUGH, 5 * counts[1:-1].max())
    ends = [levels[end] for end in (0, -1) if counts[end] >= least and levels[end] != 0]
    clipped = [np.flatnonzero(values == end) for end in ends]
    return [rows for rows in clipped if (np.diff(rows) > 1).any()]


def spike_rows(values: Vector, *, angle: bool) -> Indices:
    """Return the rows of one to three samples that leap from their neighbours and back.

    The leap is eight times what all but 0.5 % of samples do.
    """
    runs = _Runs.of(values)
    n = len(runs.value)
    is_spike = np.zeros(n, dtype=bool)
    if n < ENOUGH:
        return runs.readings_of(is_spike)
    readings = np.unwrap(runs.value) if angle else runs.value
    windows = sliding_window_view(np.pad(readings, 2, mode="reflect"), 5)
    neighbours = np.delete(windows, 2, axis=1)
    out = np.abs(readings - np.median(neighbours, axis=1))
    for run in true_runs(out > 8 * np.quantile(out, 0.995)):
        change = readings[min(run.stop, n - 1)] - readings[max(run.start - 1, 0)]
        returns = abs(change) < out[run].max() / 2
        is_spike[run] = returns and n_rows(run) <= 3
    return runs.readings_of(is_spike)


def usual_spacing(values: Vector) -> float:
    """Return the 90 % quantile of the rows between a sample and the next."""
    sampled = np.flatnonzero(np.isfinite(values))
    if sampled.size < 2:
        return 1.0
    return float(np.quantile(np.diff(sampled), 0.9))


def slow_log(flights: FlightTable) -> list[Finding]:
    """Return the finding of the slowest flight if its rows are too few to show the fast modes, else none."""
    times = [flight.time for flight in flights.flights.values() if len(flight.time) > 1]
    step = float(max((np.median(np.diff(time)) for time in times), default=0.0))
    return [Finding(Code.SLOW_LOG, rate=1 / step)] if step > 1 / SLOWEST else []


def on_ground(flights: FlightTable) -> Mask:
    """Return which rows (n,) stand or roll on the ground, none without an airspeed."""
    airspeed = flights.column("airspeed")
    ground = np.zeros(len(airspeed), dtype=bool)
    for rows in flights.clock.rows.values():
        speed = airspeed[rows]
        measured = speed[np.isfinite(speed)]
        if not measured.size:
            continue
        fast = float(np.quantile(measured, 0.95))
        time = flights.time[rows]
        # below a quarter of it no wing carries: the lift coefficient would be 16 times as large. From there the
        # aircraft rolls up to the half
        for run in true_runs(speed < 0.5 * fast):
            standing = true_runs(speed[run] < 0.25 * fast)
            seconds = [np.ptp(time[run][part]) for part in standing]
            ground[rows[run]] = max(seconds, default=0.0) >= 2.0
    return ground


def without_ground(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the rows of flights that fly; warn of the others, by the name of the table."""
    ground = on_ground(FlightTable.of(table))
    if not ground.any():
        return table
    report(Finding(Code.ON_GROUND, flight=name, percent=100 * ground.mean()))
    flown = table[~ground].reset_index(drop=True)
    flown.attrs = table.attrs
    return flown
