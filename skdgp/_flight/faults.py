"""Detection and removal of faults in a flight log.

A sensor with noise hardly ever repeats a value. If a share p of all runs of equal values is longer
than the usual length, a run of k times this length has the probability p^(k-1). Each
channel has its own usual length, so a sensor that is slower than the table is not stuck. A coarsely quantised or
noise-free channel has long runs without a fault: it is stuck only if it jumps after the run.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

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
# impossible values more frequent than this are of another unit: the checks of units name it
RARE = 0.05
MOST_SHOWN = 8  # kinds of findings that a warning names
EPOCH = 1e8  # times [s] beyond this count from 1970, not from the start of a log
WARNING_START = "Faults in the log"  # first words of the warning, for filters
AIR_UNKNOWN = "Gusts are not known"  # first words of warnings that forbid a verdict of yes
ENOUGH = 50  # least number of samples to estimate the usual length of runs
IMPROBABLE = 1e-4  # expected number of such runs in a flight below which chance is ruled out
LEAST_HOLD = 0.3  # shorter holds [s] are no fault
FEWEST_HELD = 6  # repeated values, at least, to estimate the resolution of a channel
MOST_ON_STEP = 0.9  # fraction of such values that are multiples of the resolution
OFF_STEP = 0.1  # tolerance of such multiples, as a fraction of the resolution
# a spike stands out from its neighbours by so many times what all but 0.5 % of samples do
SPIKE = 8.0
WIDEST_SPIKE = 3
# steps that change by less than this share of themselves show no noise (with noise: 1.7)
SMOOTH = 0.5
MISSING = 1.5  # a sample is missing where the next comes later than so many usual spacings

NOT_MEASURED = ("stuck", "impossible", "spike")
REMEDY = {
    "gap": "nothing is filtered across it",
    "missing": "leave out these rows where the gap is too long to interpolate",
    "stuck": "not measured; if it was, name the column in ignore",
    "impossible": "not measured; write missing values as empty cells",
    "spike": "not measured",
    "constant": "a dead sensor, or none: drop the column unless the flight was simulated so",
}


Fault = tuple[str, str, np.ndarray, str]  # channel, kind, rows, description


class FlightDataWarning(UserWarning):
    """A log has faults."""


class Finding(NamedTuple):
    """One fault of one channel, and its rows by position in the table."""

    flight: object
    channel: str
    kind: str
    start: float
    end: float
    rows: np.ndarray
    description: str
    # Origin of the times in messages [s]: the first row where the clock counts from 1970
    origin: float = 0.0

    @property
    def message(self) -> str:
        """Description of the fault, its place and its consequence."""
        begin, end = self.start - self.origin, self.end - self.origin
        where = f"{begin:.6g} to {end:.6g} s, {len(self.rows)} samples"
        return f"{self.channel} {self.description} ({where}): {REMEDY[self.kind]}"


def find_faults(table: pd.DataFrame, ignore: Iterable[str] = ()) -> list[Finding]:
    """Return the faults of each flight in a table whose time increases within each; some columns are ignored."""
    ignored, time = set(ignore), table["time"].to_numpy(float)
    codes, names = flight_codes(
        table["flight"] if "flight" in table else np.full(len(table), "flight")
    )
    channels = {
        name: table[name].to_numpy(float, na_value=np.nan)
        for name in POSSIBLE
        if name in table and name not in ignored and pd.api.types.is_numeric_dtype(table[name])
    }
    findings = []
    origin = float(time[0]) if len(time) and abs(time[0]) > EPOCH else 0.0  # counts from 1970
    edges = np.flatnonzero(np.r_[True, np.diff(codes) != 0, True])
    for first, last in pairwise(edges):
        flight_time = time[first:last]
        part = {name: values[first:last].copy() for name, values in channels.items()}
        for channel, kind, rows, description in _faults_of_flight(flight_time, part):
            ends = map(float, flight_time[rows[[0, -1]]])
            found = (names[codes[first]], channel, kind, *ends, first + rows, description, origin)
            findings.append(Finding(*found))
    return findings


def without_faults(table: pd.DataFrame, findings: Iterable[Finding]) -> pd.DataFrame:
    """Return the table with NaN for values that were not measured."""
    table = table.copy(deep=False)
    for finding in findings:
        if finding.kind in NOT_MEASURED:
            values = table[finding.channel].to_numpy(float, na_value=np.nan).copy()
            values[finding.rows] = np.nan
            table[finding.channel] = values
    return table


def grouped_messages(findings: Iterable[Finding]) -> list[str]:
    """Return one line for all findings of one kind in one channel: their number and the longest."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.channel, finding.kind), []).append(finding)
    lines = []
    for group in groups.values():
        longest = max(group, key=lambda finding: len(finding.rows))
        times = f"{len(group)} times, the longest: " if len(group) > 1 else ""
        lines.append(f"flight {longest.flight}: {times}{longest.message}")
    return lines


def faults_message(findings: list[Finding], done: str) -> str:
    """Return one message of many findings that ends with their treatment, ``done``."""
    lines = grouped_messages(findings)
    n_hidden = len(lines) - MOST_SHOWN
    hidden = (
        f"; and {n_hidden} more, see skdgp.preprocessing.inspect_flight" if n_hidden > 0 else ""
    )
    return f"{WARNING_START}: {'; '.join(lines[:MOST_SHOWN])}{hidden}. {done}"


def _faults_of_flight(time: np.ndarray, channels: dict[str, np.ndarray]) -> Iterator[Fault]:
    """Yield channel, kind, rows and description of each fault; faulty values in the channels become NaN."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    rows = np.flatnonzero(np.diff(time) > GAP * step)
    if rows.size:
        longest = float(np.diff(time).max())
        yield "time", "gap", rows, f"jumps forward {_times(2 * rows)}, by {longest:.3g} s at most"
    for name, values in channels.items():
        yield from _missing(name, values, step)
        values[~np.isfinite(values)] = np.nan
        yield from _impossible(name, values)
        if name in SENSORS:
            for rows in stuck_rows(values, step):
                yield name, "stuck", rows, f"is stuck at {values[rows[0]]:.4g}"
                values[rows] = np.nan
            rows = spike_rows(values, angle=name in WRAPPED)
            if rows.size:
                yield name, "spike", rows, f"leaps from its neighbours and back {_times(rows)}"
    yield from _dead(channels, len(time))


def _missing(name: str, values: np.ndarray, step: float) -> Iterator[Fault]:
    """Yield the gaps, together, of a channel that usually has values there."""
    sampled = np.flatnonzero(np.isfinite(values))
    if not sampled.size:
        yield name, "missing", np.arange(len(values)), "has no value"
        return
    spacing = np.diff(np.r_[-1, sampled, len(values)])
    wide = np.flatnonzero(spacing > MISSING * usual_spacing(values))
    before = np.r_[-1, sampled][wide]
    gaps = [np.arange(first + 1, first + n) for first, n in zip(before, spacing[wide], strict=True)]
    if gaps:
        longest = max(map(len, gaps)) * step
        rows = np.concatenate(gaps)
        yield name, "missing", rows, f"has no value {_times(rows)}, for {longest:.2g} s at most"


def _impossible(name: str, values: np.ndarray) -> Iterator[Fault]:
    low, high = POSSIBLE[name]
    rows = np.flatnonzero((values < low) | (values > high))
    if 0 < rows.size <= RARE * np.isfinite(values).sum():
        text = f"has impossible values, such as {values[rows[0]]:.4g}"
        values[rows] = np.nan
        yield name, "impossible", rows, text


def _dead(channels: dict[str, np.ndarray], n: int) -> Iterator[Fault]:
    """Yield sensors that have one value throughout while others of their kind move."""
    sampled = {name: values[np.isfinite(values)] for name, values in channels.items()}
    spread = {name: np.ptp(values) for name, values in sampled.items() if len(values) >= ENOUGH}
    for names in SIBLINGS:
        moving = [name for name in names if spread.get(name, 0) > 0]
        for name in names:
            if moving and spread.get(name) == 0:
                move = "moves" if len(moving) == 1 else "move"
                yield (
                    name,
                    "constant",
                    np.arange(n),
                    f"never changes, while {' and '.join(moving)} {move}",
                )


def _times(rows: np.ndarray) -> str:
    n = 1 + int(np.sum(np.diff(rows) > 1))
    return "once" if n == 1 else f"{n} times"


def stuck_rows(values: np.ndarray, step: float) -> list[np.ndarray]:
    """Return the rows of each run where a sensor repeats its last value, improbably often."""
    rows = np.flatnonzero(np.isfinite(values))
    readings = values[rows]
    if len(rows) < ENOUGH or np.ptp(readings) == 0:
        return []
    start = np.flatnonzero(np.r_[True, np.diff(readings) != 0])
    length = np.diff(np.r_[start, len(readings)])
    k = np.floor(length / np.median(length))
    share = (1 + np.sum(length >= 1.5 * np.median(length))) / (1 + len(length))
    chance = len(length) * share ** (k - 1)  # expected number of runs at least so long
    leap = np.abs(np.diff(readings[start], append=np.nan))
    steps = leap[:-1]
    quantum = max(np.quantile(steps, 0.01), _resolution(readings[start[length > 1]]))
    bend = (
        np.median(np.abs(np.diff(readings[start], 2))) / np.median(steps)
        if len(steps) > 1
        else np.inf
    )
    stuck = (chance < IMPROBABLE) & (length * step >= LEAST_HOLD)
    stuck &= ~(
        leap <= 3 * quantum
    )  # a channel that turns back repeats its value, and leaves it by one quantum
    if bend < SMOOTH or np.median(steps) <= MISSING * quantum:
        stuck &= leap > np.quantile(steps, 0.99)
    levels, counts = np.unique(readings[start[stuck]], return_counts=True)
    # a value that is held again and again, and left by usual steps, is one of a coarse resolution
    again = np.isin(readings[start], levels[counts > 1])
    stuck &= ~(again & (leap <= np.quantile(steps, 0.99)))
    return [
        rows[first + 1 : first + n] for first, n in zip(start[stuck], length[stuck], strict=True)
    ]


def _resolution(held: np.ndarray) -> float:
    """Return the common step of held values, from any origin; 0 if there is none."""
    levels = np.unique(held)
    if len(levels) < FEWEST_HELD:
        return 0.0
    step = np.diff(levels).min()
    multiples = (levels - levels[len(levels) // 2]) / step
    on_step = np.abs(multiples - np.rint(multiples)) < OFF_STEP
    return float(step) if on_step.mean() > MOST_ON_STEP else 0.0


def spike_rows(values: np.ndarray, *, angle: bool) -> np.ndarray:
    """Return the rows of a few samples that leap from their neighbours and back."""
    sampled = np.flatnonzero(np.isfinite(values))
    if len(sampled) < ENOUGH:
        return np.empty(0, int)
    start = np.flatnonzero(np.r_[True, np.diff(values[sampled]) != 0])
    fresh = values[sampled[start]]
    readings = np.unwrap(fresh) if angle else fresh
    if len(readings) < ENOUGH:
        return np.empty(0, int)
    padded = np.pad(readings, 2, mode="reflect")
    around = np.median([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    out = np.abs(readings - around)
    far = out > SPIKE * np.quantile(out, 0.995)
    leaps = [
        np.arange(run.start, run.stop)
        for run in true_runs(far)
        if run.stop - run.start <= WIDEST_SPIKE
    ]
    ends = [(max(part[0] - 1, 0), min(part[-1] + 1, len(readings) - 1)) for part in leaps]
    back = [
        k
        for k, (a, b) in zip(leaps, ends, strict=True)
        if abs(readings[b] - readings[a]) < out[k].max() / 2
    ]
    edges = np.r_[start, len(sampled)]
    return np.concatenate(
        [sampled[edges[part[0]] : edges[part[-1] + 1]] for part in back] or [sampled[:0]]
    )


def usual_spacing(values: np.ndarray) -> float:
    """Return the 90 % quantile of the rows between a sample and the next."""
    sampled = np.flatnonzero(np.isfinite(values))
    return float(np.quantile(np.diff(sampled), 0.9)) if sampled.size > 1 else 1.0
