"""Conversion of autopilot logs to flight tables: sources of columns by rules, and flights."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Mask, Vector
from skdgp._flight.clock import runs_between
from skdgp._flight.faults import attitude_jumps
from skdgp._flight.tables import FlightTable
from skdgp.io._clock import with_sound_times
from skdgp.io._dataflash import read_dataflash
from skdgp.io._log import NOTHING, Log, States, controls_of, no_wings, rows_in
from skdgp.io._sources import Source, find_sources, to_table
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
# while motors may run
ARMED: States = (
    ("actuator_armed", "armed", 1, 1),
    ("vehicle_status", "arming_state", 2, 2),
    ("STAT", "Armed", 1, 1),
    ("HEARTBEAT", "base_mode", 128, 255),
)


# airborne above this fraction of the slowest airspeed that is set, or above this speed [m/s]
AIRBORNE_FRACTION = 0.7
AIRBORNE_SPEED = 8.0
# height above the ground of the take-off [m] below which wheels may carry the aircraft; a guess
CLEAR_HEIGHT = 0.5
# rows this near to a reset of an estimator [s] are left out: filters smear the jump; a guess
RESET_MARGIN = 0.25
# slower for no more than this is still flight [s]
LONGEST_DIP = 2.0
# faster for less than this is none [s]
SHORTEST_FLIGHT = 5.0
# channels begin and end within this of each other [s]
LONGEST_EDGE = 1.0


class FlightLog(NamedTuple):
    """A log, resampled to one clock."""

    log: Log
    table: pd.DataFrame
    flights: list[pd.DataFrame]
    # description and rate [Hz] of the source of each column
    origin: dict[str, tuple[str, float]]
    remarks: list[str]
    # why it holds no flight
    reasons: str


def is_log(path: str | os.PathLike[str]) -> bool:
    """Return whether this is the path of a log of an autopilot."""
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
        topics, wrong_times = with_sound_times(log.topics)
        log = replace(log, topics=topics)
        sources, useless = find_sources(log, controls)
        if not sources:
            raise FlightReadError(
                "Got no message of a flight, but expected rates, accelerations, attitude, airspeed: "
                "log these topics."
            )
        return _flown(log, sources, speed, airborne, [*log.remarks, *wrong_times, *useless])


def _flown(
    log: Log, sources: list[Source], speed: float, airborne: Any, remarks: list[str]
) -> FlightLog:
    """Return a log on one clock, with its flights and further remarks."""
    table, origin = to_table(sources, log)
    time = table["time"].to_numpy()
    speeds = _speed(table, log)
    landed = log.lands(time)
    lifted = log.lifts(time)
    jumps = attitude_jumps(FlightTable.of(table))
    cuts = np.unique(np.concatenate([jumps, *(source.cuts for source in sources)]))
    if len(cuts):
        times = ", ".join(f"{cut:.1f}" for cut in cuts)
        remarks.append(
            "a jump of the attitude or a reset of the estimator, so a new flight begins, at "
            f"{times} s"
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
        pieces = [piece for rows in segments for piece in _cut(table.iloc[rows], cuts)]
        flights = [_trimmed(piece) for piece in pieces if len(piece)]
        if flights and not _was_armed(log, time):
            remarks.append(
                "the autopilot was never armed, but the speed is a flight's: if something else moved the "
                "surfaces, their columns and the throttle are not what flew"
            )
    reasons = _no_flight_because(table, speeds, speed, landed, lifted)
    return FlightLog(log, table, flights, origin, remarks, reasons)


def _was_armed(log: Log, time: Vector) -> bool:
    """Return whether the autopilot was armed at some time, True where the log does not say."""
    is_told = any(field in log.topics.get(name, NOTHING) for name, field, _, _ in ARMED)
    return not is_told or bool(rows_in(ARMED, log.topics, time).any())


# -- flights in a log


def flight_table(flown: FlightLog, name: str) -> pd.DataFrame:
    """Return the flights of a log one after another: name, name#2, ...; raise FlightReadError if there is none."""
    if not flown.log.has_wings:
        raise FlightReadError(no_wings(flown.log))
    flights = [piece for piece in flown.flights if len(piece)]
    if not flights:
        raise FlightReadError(
            f"Got a log of {flown.log.firmware} in which no flight was found "
            f"({flown.reasons}), but expected a fixed wing in the air: airborne=False "
            "(--airborne all) reads all of it, a speed [m/s] in its place all above it."
        )
    names = [name, *(f"{name}#{n}" for n in range(2, len(flights) + 1))]
    named = [flight.assign(flight=each) for each, flight in zip(names, flights, strict=True)]
    return pd.concat(named, ignore_index=True)


def _cut(table: pd.DataFrame, cuts: Vector) -> list[pd.DataFrame]:
    """Return the pieces of a table between resets, whose neighbouring rows are left out."""
    begins = [-np.inf, *(cuts + RESET_MARGIN)]
    ends = [*(cuts - RESET_MARGIN), np.inf]
    time = table["time"]
    return [
        table[time.between(*edges, inclusive="left")] for edges in zip(begins, ends, strict=True)
    ]


def _least_speed(log: Log, airborne: Any) -> float:
    """Return the airspeed [m/s] above which an aircraft flies: as given, or by the autopilot's parameters."""
    if isinstance(airborne, bool):
        stated = [log.parameters.get(name, np.nan) for name in SLOWEST_AIRSPEED]
        sound = [AIRBORNE_FRACTION * speed for speed in stated if 0 < speed < 200]
        return [*sound, AIRBORNE_SPEED][0]
    if isinstance(airborne, Real) and float(airborne) > 0:
        return float(airborne)
    raise FlightReadError(
        f"Got airborne={airborne!r}, but expected True, False, or an airspeed in m/s."
    )


def _segments(table: pd.DataFrame, is_flight: Mask, on_ground: Mask) -> list[slice]:
    """Return the rows of each flight, of rows (n,) that are fast and not reported as landed.

    What rolls on its wheels after it was reported as landed does not fly yet.
    """
    time = table["time"].to_numpy()
    rows = np.flatnonzero(is_flight)
    segments = []
    for run in runs_between(time[rows], LONGEST_DIP):
        last = rows[run][-1]
        first = _lift_off(table, on_ground, rows[run][0], last)
        if time[last] - time[first] >= SHORTEST_FLIGHT:
            segments.append(slice(first, last + 1))
    return segments


def _lift_off(table: pd.DataFrame, on_ground: Mask, first: int, last: int) -> int:
    """Return the first row of a flight that is clear of the ground on which it was reported as landed before."""
    before = np.flatnonzero(on_ground[:first])
    if not len(before) or "down" not in table:
        return first
    down = table["down"].to_numpy()
    height = down[before[-1]] - down[first : last + 1]
    # the first row where it is never clear: the height is not to be believed
    return first + int((height > CLEAR_HEIGHT).argmax())


def _trimmed(flight: pd.DataFrame) -> pd.DataFrame:
    """Return a flight without rows at its ends, at most a second, where slow channels have no value."""
    time = flight["time"]
    logged = flight.dropna(axis=1, how="all").notna()
    begins = time[logged.idxmax()]
    ends = time[logged[::-1].idxmax()]
    begin = begins[begins <= begins.min() + LONGEST_EDGE].max()
    end = ends[ends >= ends.max() - LONGEST_EDGE].min()
    return flight[time.between(begin, end)]


def _no_flight_because(
    table: pd.DataFrame, speeds: Vector, least: float, landed: Mask, lifted: Mask
) -> str:
    """Return what rows with these speeds (n,) hold, where a flight is faster than ``least`` [m/s]."""
    facts = "neither a valid airspeed nor a ground speed"
    if np.isfinite(speeds).any():
        channel = "airspeed" if "airspeed" in table else "no valid airspeed, ground speed"
        facts = f"{channel} up to {np.nanmax(speeds):.3g} m/s, where a flight stays above {least:.3g} m/s"
    for state, rows in (("reports to be on the ground", landed), ("is lifted by rotors", lifted)):
        if rows.any():
            facts += f", {state} in {100 * rows.mean():.0f} % of the rows"
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
    ground_speed = np.hypot(*table[["v_north", "v_east"]].to_numpy().T)
    is_dead = pd.Series(airspeed).nunique() < 2
    return np.where(np.isnan(airspeed) | is_dead, ground_speed, airspeed)
