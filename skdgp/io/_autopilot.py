"""Conversion of autopilot logs to flight tables: sources of columns by rules, and flights."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Mask, Vector
from skdgp._flight.faults import attitude_jumps
from skdgp._flight.tables import FlightTable
from skdgp.io._clock import clock_parts
from skdgp.io._dataflash import read_dataflash
from skdgp.io._log import NOTHING, Control, Log, States, controls_of, no_wings, rows_in
from skdgp.io._sources import find_sources, to_table
from skdgp.io._tables import FlightReadError
from skdgp.io._tlog import read_tlog
from skdgp.io._ulog import read_ulog

# Readers of logs by suffix; another format is one more entry
AUTOPILOTS: dict[str, Callable[[Path], Log]] = {
    ".ulg": read_ulog,
    ".ulog": read_ulog,
    ".bin": read_dataflash,
    ".log": read_dataflash,
    ".tlog": read_tlog,
}
# parameters [m/s]
SLOWEST_AIRSPEED = ("AIRSPEED_MIN", "ARSPD_FBW_MIN", "FW_AIRSPD_MIN")
# fields that are times
TIMES = {"timestamp", "timestamp_sample", "TimeUS"}
# while motors may run
ARMED: States = (
    ("actuator_armed", "armed", 1, 1),
    ("vehicle_status", "arming_state", 2, 2),
    ("STAT", "Armed", 1, 1),
    ("HEARTBEAT", "base_mode", 128, 255),
)


@dataclass(frozen=True)
class LogSettings:
    """Settings of the search for flights in a log."""

    # airborne above this fraction of the slowest airspeed that is set, or above this speed [m/s]
    airborne_fraction: float = 0.7
    airborne_speed: float = 8.0
    # height above the ground of the take-off [m] below which wheels may carry the aircraft; a guess
    clear_height: float = 0.5
    # rows this near to a reset of an estimator [s] are left out: filters smear the jump; a guess
    reset_margin: float = 0.25
    # slower for less than this is still flight [s]
    longest_dip: float = 2.0
    # faster for less than this is none [s]
    shortest: float = 5.0
    # channels begin and end within this of each other [s]
    longest_edge: float = 1.0


SETTINGS = LogSettings()


class FlightLog(NamedTuple):
    """A log, or a part of it between two restarts of its clock, resampled to one clock."""

    # with the topics of the longest part
    log: Log
    # of the longest part
    table: pd.DataFrame
    flights: list[pd.DataFrame]
    # description and rate [Hz] of the source of each column
    origin: dict[str, tuple[str, float]]
    remarks: list[str]
    # why it holds no flight
    reasons: str


def is_log(path: object) -> bool:
    """Return whether this is the path of a log of an autopilot."""
    if not isinstance(path, str | os.PathLike):
        return False
    return Path(path).suffix.lower() in AUTOPILOTS


def read_log(path: Path) -> Log:
    """Return a log of an autopilot as it is."""
    # damaged messages may hold any number
    with np.errstate(all="ignore"):
        return AUTOPILOTS[path.suffix.lower()](path)


def on_one_clock(log: Log, *, servos: Any = None, airborne: Any = True) -> FlightLog:
    """Return a log on one clock; raise FlightReadError if an option makes no sense or the log has no column."""
    speed = _least_speed(log, airborne)
    # damaged messages may hold any number
    with np.errstate(all="ignore"):
        controls = controls_of(servos, log)
        _check_channels(log, controls)
        topics_of_parts, remarks = clock_parts(log.topics)
        parts = []
        for topics in topics_of_parts:
            part = _part(replace(log, topics=topics), controls, speed, airborne)
            if part is not None:
                parts.append(part)
    if not parts:
        raise FlightReadError(
            "Got no message of a flight, but expected rates, accelerations, attitude, airspeed: "
            "log these topics."
        )
    flights = []
    origin: dict[str, tuple[str, float]] = {}
    remarks = [*log.remarks, *remarks]
    for part in parts:
        flights += part.flights
        origin |= part.origin
        remarks += part.remarks
    longest = max(parts, key=lambda part: len(part.table))
    return longest._replace(flights=flights, origin=origin, remarks=list(dict.fromkeys(remarks)))


def _part(
    log: Log, controls: Mapping[str, tuple[str, Control]], speed: float, airborne: Any
) -> FlightLog | None:
    """Return a part of a log on one clock, None if it has no source of a column."""
    sources, useless = find_sources(log, controls)
    if not sources:
        return None
    table, origin = to_table(sources, log)
    time = table["time"].to_numpy()
    speeds = _speed(table, log)
    landed = log.lands(time)
    lifted = log.lifts(time)
    remarks = []
    jumps = attitude_jumps(FlightTable.of(table))
    cuts = np.unique(np.concatenate([jumps, *(source.cuts for source in sources)]))
    if len(cuts):
        remarks.append(
            "a jump of the attitude, a reset of the estimator, or another instance, so a new flight begins, "
            f"at {_seconds(cuts)}"
        )
    if airborne is False:
        flights = _cut(table, cuts)
    else:
        if lifted.any():
            remarks.append(
                f"{100 * lifted.mean():.0f} % of the rows are left out of flights: rotors lift the "
                "VTOL, or it is in transition"
            )
        # a speed that is given counts whatever the autopilot reports
        on_ground = landed & (airborne is True)
        segments = _segments(table, (speeds > speed) & ~on_ground & ~lifted, on_ground)
        flights = [_trimmed(piece) for rows in segments for piece in _cut(table.iloc[rows], cuts)]
        if flights and not _was_armed(log, time):
            remarks.append(
                "the autopilot was never armed, but the speed is a flight's: if something else moved the "
                "surfaces, their columns and the throttle are not what flew"
            )
    reasons = _no_flight_because(table, speeds, speed, landed, lifted)
    return FlightLog(log, table, flights, origin, remarks + useless, reasons)


def _seconds(times: Vector) -> str:
    """Return the first times as text."""
    more = f" and {len(times) - 5} more" if len(times) > 5 else ""
    return ", ".join(f"{time:.1f} s" for time in times[:5]) + more


def _was_armed(log: Log, time: Vector) -> bool:
    """Return whether the autopilot was armed at some time, True where the log does not say."""
    is_told = any(field in log.topics.get(name, NOTHING) for name, field, _, _ in ARMED)
    return not is_told or bool(rows_in(ARMED, log.topics, time).any())


def _check_channels(log: Log, controls: Mapping[str, tuple[str, Control]]) -> None:
    """Raise FlightReadError if the log lacks the channel of a servo."""
    for name, (_, control) in controls.items():
        for servo in control:
            if servo.field in log.topics.get(servo.topic, NOTHING):
                continue
            logged = {}
            for output in {*log.outputs} & log.topics.keys():
                logged[output] = sorted(log.topics[output].fields.keys() - TIMES)
            raise FlightReadError(
                f"Got channel {servo.channel!r} for {name}, but the log has no such field: expected "
                f"one of {logged or [*log.outputs]}."
            )


# -- flights in a log


def flight_table(flown: FlightLog, name: str) -> pd.DataFrame:
    """Return the flights of a log one after another: name, name#2, ...; raise FlightReadError if there is none."""
    flights: list[pd.DataFrame] = []
    for piece in flown.flights:
        if len(piece):
            flight = f"{name}#{len(flights) + 1}" if flights else name
            flights.append(piece.assign(flight=flight))
    if not flown.log.has_wings:
        raise FlightReadError(no_wings(flown.log))
    if not flights:
        raise FlightReadError(
            f"Got a log of {flown.log.firmware} in which no flight was found "
            f"({flown.reasons}), but expected a fixed wing in the air: airborne=False "
            "(--airborne all) reads all of it, a speed [m/s] in its place all above it."
        )
    return pd.concat(flights, ignore_index=True)


def _cut(table: pd.DataFrame, cuts: Vector) -> list[pd.DataFrame]:
    """Return the pieces of a table between resets, whose neighbouring rows are left out."""
    time = table["time"].to_numpy()
    pieces = []
    edges = [-np.inf, *cuts.tolist(), np.inf]
    for begin, end in pairwise(edges):
        rows = (time >= begin + SETTINGS.reset_margin) & (time < end - SETTINGS.reset_margin)
        if rows.any():
            pieces.append(table[rows])
    return pieces


def _least_speed(log: Log, airborne: Any) -> float:
    """Return the airspeed [m/s] above which an aircraft flies: as given, or by the autopilot's parameters."""
    if not isinstance(airborne, bool):
        if isinstance(airborne, Real) and float(airborne) > 0:
            return float(airborne)
        raise FlightReadError(
            f"Got airborne={airborne!r}, but expected True, False, or an airspeed in m/s."
        )
    for name in SLOWEST_AIRSPEED:
        speed = log.parameters.get(name, np.nan)
        if 0 < speed < 200:
            return SETTINGS.airborne_fraction * speed
    return SETTINGS.airborne_speed


def _segments(table: pd.DataFrame, is_flight: Mask, on_ground: Mask) -> list[slice]:
    """Return the rows of each flight, of rows (n,) that are fast and not reported as landed.

    What rolls on its wheels after it was reported as landed does not fly yet.
    """
    time = table["time"].to_numpy()
    rows = np.flatnonzero(is_flight)
    pauses = np.flatnonzero(np.diff(time[rows]) >= SETTINGS.longest_dip) + 1
    segments = []
    for part in np.split(rows, pauses):
        if len(part):
            first = _lift_off(table, on_ground, part[0], part[-1])
            if time[part[-1]] - time[first] >= SETTINGS.shortest:
                segments.append(slice(first, int(part[-1]) + 1))
    return segments


def _lift_off(table: pd.DataFrame, on_ground: Mask, first: int, last: int) -> int:
    """Return the first row of a flight that is clear of the ground on which it was reported as landed before."""
    before = np.flatnonzero(on_ground[:first])
    if not len(before) or "down" not in table:
        return int(first)
    down = table["down"].to_numpy()
    height = down[before[-1]] - down[first : last + 1]
    # the first row where it is never clear: the height is not to be believed
    return int(first + (height > SETTINGS.clear_height).argmax())


def _trimmed(flight: pd.DataFrame) -> pd.DataFrame:
    """Return a flight without rows at its ends, at most a second, where slow channels have no value."""
    time = flight["time"]
    channels = flight.dropna(axis=1, how="all")
    begins = channels.apply(lambda column: time[column.first_valid_index()])
    ends = channels.apply(lambda column: time[column.last_valid_index()])
    begin = begins[begins <= begins.min() + SETTINGS.longest_edge].max()
    end = ends[ends >= ends.max() - SETTINGS.longest_edge].min()
    return flight[time.between(begin, end)]


def _no_flight_because(
    table: pd.DataFrame, speeds: Vector, least: float, landed: Mask, lifted: Mask
) -> str:
    """Return what rows with these speeds (n,) hold, where a flight is faster than ``least`` [m/s]."""
    facts = "neither a valid airspeed nor a ground speed"
    if np.isfinite(speeds).any():
        channel = "airspeed" if "airspeed" in table else "no valid airspeed, ground speed"
        facts = f"{channel} up to {np.nanmax(speeds):.3g} m/s, where a flight stays above {least:.3g} m/s"
    if landed.any():
        facts += f", reports to be landed in {100 * landed.mean():.0f} % of the rows"
    if lifted.any():
        facts += f", is lifted by rotors in {100 * lifted.mean():.0f} % of the rows"
    return facts


def _speed(table: pd.DataFrame, log: Log) -> Vector:
    """Return the airspeed (n,), where there is none of a vehicle with wings the speed over ground, else NaN.

    A sensor with one value throughout measures nothing, where a speed over ground is logged.
    """
    airspeed = np.full(len(table), np.nan)
    if "airspeed" in table:
        airspeed = table["airspeed"].to_numpy()
    if not {"v_north", "v_east"} <= {*table} or not log.has_wings:
        return airspeed
    ground_speed = np.hypot(table["v_north"].to_numpy(), table["v_east"].to_numpy())
    is_dead = np.nanmax(airspeed, initial=-np.inf) == np.nanmin(airspeed, initial=np.inf)
    return np.where(np.isnan(airspeed) | is_dead, ground_speed, airspeed)
