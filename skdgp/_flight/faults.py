"""Faults of a flight log: found, named, and removed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._flight.checks import FASTEST, LARGEST_ANGLE, SLACK
from skdgp._flight.clock import GAP, flight_codes
from skdgp._flight.fault_detectors import ENOUGH, holds, lost, spikes, stops

SIBLINGS = (
    *(("alpha", "beta"), ("p", "q", "r"), ("ax", "ay", "az"), ("phi", "theta", "psi")),
    *(("v_north", "v_east", "v_down"), ("u", "v", "w"), ("north", "east", "down")),
)
SENSORS = ("airspeed", *(name for names in SIBLINGS for name in names))
"""Channels that noise and motion never let stand still."""
SURFACES = ("elevator", "aileron", "rudder", "elevon_left", "elevon_right")
ANGLES = ("phi", "psi")
"""Angles that go round."""
POSSIBLE = {
    "airspeed": (-10.0, 1000.0),
    **{name: (-LARGEST_ANGLE[name] - SLACK, LARGEST_ANGLE[name] + SLACK) for name in ("alpha", "beta", "theta")},
    **dict.fromkeys(("p", "q", "r"), (-FASTEST, FASTEST)),
    **dict.fromkeys(("ax", "ay", "az"), (-1000.0, 1000.0)),
    **dict.fromkeys(("phi", "psi"), (-1000.0, 1000.0)),
    **dict.fromkeys(("v_north", "v_east", "v_down", "u", "v", "w"), (-1500.0, 1500.0)),
    **dict.fromkeys(("north", "east", "down"), (-1e7, 1e7)),
    "density": (1e-3, 3.0),
    "altitude": (-1000.0, 1e5),
    "throttle": (-0.1, 1.5),
    "propeller_speed": (-1e4, 1e4),
    **dict.fromkeys(SURFACES, (-np.pi / 2, np.pi / 2)),
}
"""Outside of these nothing can have been measured."""
RARE = 0.05
"""Impossible values more frequent than this are of another unit: checks at the door name it."""
LONG = 1.0
"""Seconds from which lost samples are told place by place."""
SHOWN = 8
"""Findings told one by one in a warning."""

TOLD = "Faults in the log"
"""How that warning begins."""
NOT_MEASURED = ("stuck", "impossible", "spike")
REMEDY = {
    "restart": "a flight of its own",
    "gap": "nothing is filtered across it",
    "missing": "leave out these rows where the gap is too long to interpolate",
    "stuck": "not measured; if it was, name the column in ignore",
    "impossible": "not measured; write missing values as empty cells",
    "spike": "not measured",
    "constant": "a dead sensor, or none: drop the column unless the flight was simulated so",
    "saturated": "kept; what it does beyond is not known",
}


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
    words: str

    @property
    def message(self) -> str:
        """What is wrong, and what follows from it."""
        where = f"{self.start:.6g} to {self.end:.6g} s, {len(self.rows)} samples"
        return f"{self.channel} {self.words} ({where}): {REMEDY[self.kind]}"


def find_faults(table: pd.DataFrame, ignore: Iterable[str] = ()) -> list[Finding]:
    """Return the faults of each flight in a table whose time increases within each; none of the columns to ignore."""
    left = [name for name in POSSIBLE if name not in set(ignore)]
    codes, names = flight_codes(table["flight"] if "flight" in table else np.full(len(table), "flight"))
    time = table["time"].to_numpy(float)
    channels = {name: table[name].to_numpy(float, na_value=np.nan) for name in left if _is_numeric(table, name)}
    found = []
    edges = np.flatnonzero(np.r_[True, np.diff(codes) != 0, True])
    for first, last in pairwise(edges):
        here = time[first:last]
        part = {name: values[first:last].copy() for name, values in channels.items()}
        for channel, kind, rows, words in _of_flight(here, part):
            ends = float(here[rows[0]]), float(here[rows[-1]])
            found.append(Finding(names[codes[first]], channel, kind, *ends, first + rows, words))
    return found


def without_faults(table: pd.DataFrame, findings: Iterable[Finding]) -> pd.DataFrame:
    """Return the table with NaN for what was not measured."""
    new: dict[str, np.ndarray] = {}
    for each in findings:
        if each.kind in NOT_MEASURED:
            if each.channel not in new:
                new[each.channel] = table[each.channel].to_numpy(float, na_value=np.nan).copy()
            new[each.channel][each.rows] = np.nan
    return table.assign(**new) if new else table


def told(findings: list[Finding], done: str) -> str:
    """Return one message of many findings, each flight named once."""
    by_flight = groupby(findings[:SHOWN], key=lambda each: str(each.flight))
    said = [f"flight {flight}: {'; '.join(each.message for each in group)}" for flight, group in by_flight]
    more = f"; and {len(findings) - SHOWN} more, see skdgp.preprocessing.inspect_flight" * (len(findings) > SHOWN)
    return f"{TOLD}: {'; '.join(said)}{more}. {done}"


def _of_flight(time, channels) -> Iterator[tuple[str, str, np.ndarray, str]]:
    """Yield channel, kind, rows and words of each fault; what was not measured is taken out of the channels."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    yield from _gaps(time, step)
    for name, values in channels.items():
        yield from _missing(name, values, step)
        values[~np.isfinite(values)] = np.nan
        yield from _impossible(name, values)
        if name in SENSORS:
            for rows in holds(values, step):
                yield name, "stuck", rows, f"is stuck at {values[rows[0]]:.4g}"
                values[rows] = np.nan
            rows = spikes(values, angle=name in ANGLES)
            if rows.size:
                yield name, "spike", rows, f"leaps from its neighbours and back {_times(rows)}"
        elif name in SURFACES:
            for rows in stops(values, step):
                words = f"stands at its extreme value {values[rows[0]]:.4g} {_times(rows)}, as at a stop"
                yield name, "saturated", rows, words
    yield from _dead(channels, len(time))


def _gaps(time, step):
    rows = np.flatnonzero(np.diff(time) > GAP * step)
    if rows.size:
        longest = float(np.diff(time).max())
        yield "time", "gap", rows, f"jumps forward {_times(2 * rows)}, by {longest:.3g} s at most"


def _missing(name, values, step):
    stretches = lost(values)
    if len(stretches) == 1 and len(stretches[0]) == len(values):
        yield name, "missing", stretches[0], "has no value"
        return
    for rows in stretches:
        if len(rows) * step >= LONG:
            yield name, "missing", rows, f"has no value for {len(rows) * step:.3g} s"
    short = [rows for rows in stretches if len(rows) * step < LONG]
    if short:
        rows = np.concatenate(short)
        yield name, "missing", rows, f"has no value {_times(rows)}, for {max(map(len, short)) * step:.2g} s at most"


def _impossible(name, values):
    low, high = POSSIBLE[name]
    rows = np.flatnonzero((values < low) | (values > high))
    if 0 < rows.size <= RARE * np.isfinite(values).sum():
        words = f"has impossible values, such as {values[rows[0]]:.4g}"
        values[rows] = np.nan
        yield name, "impossible", rows, words


def _dead(channels, n):
    """Yield sensors that have one value throughout while others of their kind move."""
    spread = {name: np.ptp(values[np.isfinite(values)]) for name, values in channels.items() if _enough(values)}
    for names in SIBLINGS:
        moving = [name for name in names if spread.get(name, 0) > 0]
        for name in names:
            if moving and spread.get(name) == 0:
                yield (
                    name,
                    "constant",
                    np.arange(n),
                    f"never changes, while {' and '.join(moving)} {'moves' if len(moving) == 1 else 'move'}",
                )


def _enough(values):
    return np.isfinite(values).sum() >= ENOUGH


def _times(rows) -> str:
    n = 1 + int(np.sum(np.diff(rows) > 1))
    return "once" if n == 1 else f"{n} times"


def _is_numeric(table, name):
    return name in table and pd.api.types.is_numeric_dtype(table[name])
