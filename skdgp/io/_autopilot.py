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

from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp._flight.channels import (
    CHANNELS,
    EARTH_VELOCITY,
    EULER,
    SENSOR_POSITION,
    SPECIFIC_FORCE,
)
from skdgp._flight.faults import POSSIBLE, RARE, attitude_jumps
from skdgp._flight.frames import (
    HIGHEST,
    LOWEST,
    STANDARD_GRAVITY,
    euler_to_matrix,
    quaternion_to_euler,
    standard_density,
    without_sign_changes,
)
from skdgp._flight.smoothing import differentiate
from skdgp._flight.tables import FlightTable, by_name
from skdgp.io._clock import clock_parts, resample, uniform_clock
from skdgp.io._dataflash import read_dataflash
from skdgp.io._instances import Origin, Source, choose, seconds
from skdgp.io._log import (
    DENSITY,
    EQUIVALENT,
    NOTHING,
    QUATERNION,
    Control,
    Log,
    Rule,
    States,
    full_throws,
    no_wings,
    read_servos,
    reversed_of,
    rows_in,
    scaled,
    with_throws,
)
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
# the clock of a table follows the first of these
LEADERS = ("p", "ax", "qw")


@dataclass(frozen=True)
class LogSettings:
    """Settings of the sources and the clock of a table, and of the search for flights in a log."""

    # a source slower than this [Hz] gives way to one further down that is not, or so many times as
    # fast (guess)
    least_rate: float = 5.0
    least_ratio: float = 1.5
    # of the clock, which follows the gyros [Hz]: rigid aircraft and surfaces move slower than 20 Hz
    highest_rate: float = 50.0
    # corner of the smoothing of accelerations by velocities, in parts of the sampling rate
    velocity_cutoff: float = 0.2
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
    # of each column
    origin: dict[str, Origin]
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
    turned = reversed_of(servos)
    entries = read_servos(servos) if turned is None else {}
    # damaged messages may hold any number
    with np.errstate(all="ignore"):
        controls = with_throws(entries, log) if turned is None else full_throws(log, turned)
        controls = {**log.commands, **controls}
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
    origin: dict[str, Origin] = {}
    remarks = [*log.remarks, *remarks]
    for part in parts:
        flights += part.flights
        origin |= part.origin
        remarks += part.remarks
    longest = max(parts, key=lambda part: len(part.table))
    return longest._replace(flights=flights, origin=origin, remarks=list(dict.fromkeys(remarks)))


def _part(
    log: Log, controls: Mapping[str, Control], speed: float, airborne: Any
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
    if len(jumps):
        remarks.append(f"the attitude jumps, so a new flight begins, at {seconds(jumps.tolist())}")
    cuts = np.unique([*jumps, *(cut for source in sources for cut in source.cuts)])
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


def _was_armed(log: Log, time: Vector) -> bool:
    """Return whether the autopilot was armed at some time, True where the log does not say."""
    is_told = any(field in log.topics.get(name, NOTHING) for name, field, _, _ in ARMED)
    return not is_told or bool(rows_in(ARMED, log.topics, time).any())


def find_sources(log: Log, controls: Mapping[str, Control]) -> tuple[list[Source], list[str]]:
    """Return the source of each group of columns, and remarks on sources that are of no use."""
    chosen: dict[tuple[str, ...], Source] = {}
    useless = []
    for rule in log.rules:
        source = choose(log, rule)
        if source is None:
            continue
        problem = _problem(source, rule)
        if problem:
            useless.append(problem)
        elif rule.columns not in chosen or _is_clearly_faster(source, chosen[rule.columns]):
            chosen[rule.columns] = source
    sources = [source for columns, source in chosen.items() if controls.keys().isdisjoint(columns)]
    useless += [source.remark for source in sources if source.remark]
    for name, control in controls.items():
        surface = _surface(log, name, control)
        if len(surface.time) > 1:
            sources.append(surface)
        else:
            useless.append(f"{surface.name} sends no pulse, so there is no {name}")
    return sources, useless


def _is_clearly_faster(source: Source, first: Source) -> bool:
    """Return whether a source is preferred to one further up that is slow."""
    least = min(SETTINGS.least_rate, SETTINGS.least_ratio * first.rate)
    return first.rate < SETTINGS.least_rate and source.rate >= least


def _problem(source: Source, rule: Rule) -> str:
    """Return why a source is of no use, or nothing."""
    if len(source.time) < 2:
        return source.remark or f"{source.name} has fewer than two values"
    limits = [POSSIBLE.get(name, (-np.inf, np.inf)) for name in rule.columns]
    low, high = np.transpose(limits)
    is_impossible = (source.values < low) | (source.values > high)
    impossible = is_impossible.any(axis=1).mean()
    # fewer are faults of a sensor
    if impossible > RARE:
        return f"{source.name} cannot be {rule.words}: {100 * impossible:.0f} % is impossible"
    return ""


def _surface(log: Log, name: str, control: Control) -> Source:
    """Return a control by the channels of its servos, which are fields of one topic.

    It is empty where a part of the log lacks the topic.
    """
    is_command = name in log.commands
    servos = [servo for _, servo in control]
    topic = log.topics.get(servos[0].topic, NOTHING)
    values = np.zeros(len(topic))
    for weight, servo in control if len(topic) else ():
        deflection = servo.deflection(topic[servo.field])
        if is_command:  # an engine that is switched off gets no number
            deflection = np.nan_to_num(deflection)
        values = values + weight * deflection
    named = log.controls.get(name, ())
    note = "by the servo file"
    if is_command:
        note = "as commanded"
    elif control in (named, scaled(named, -1.0)):
        note = "in parts of the full throw"
    channels = " ".join(servo.channel for servo in servos)
    valid = np.isfinite(values)
    return Source((name,), channels, topic.time[valid], values[valid][:, None], note)


def _check_channels(log: Log, controls: Mapping[str, Control]) -> None:
    """Raise FlightReadError if the log lacks the channel of a servo."""
    for name, control in controls.items():
        for _, servo in control:
            if servo.field in log.topics.get(servo.topic, NOTHING):
                continue
            logged = {}
            for output in {*log.outputs} & log.topics.keys():
                logged[output] = sorted(log.topics[output].fields.keys() - TIMES)
            raise FlightReadError(
                f"Got channel {servo.channel!r} for {name}, but the log has no such field: expected "
                f"one of {logged or [*log.outputs]}."
            )


def to_table(sources: list[Source], log: Log) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return all columns on one clock, in the order of the vocabulary, and where each is from."""
    columns, origin = _on_clock(sources)
    if "density" not in columns and "altitude" in columns:
        columns["density"] = standard_density(np.clip(columns["altitude"], LOWEST, HIGHEST))
        origin["density"] = Origin("altitude (standard atmosphere)", origin["altitude"].rate)
    if EQUIVALENT in columns:
        words, rate = origin.pop(EQUIVALENT)
        columns["airspeed"], note = _true_airspeed(columns.pop(EQUIVALENT), columns.get("density"))
        origin["airspeed"] = Origin(f"{words} ({note})", rate)
    table = pd.DataFrame(columns)
    table = table.where(np.isfinite(table))
    for source in sources:
        if source.columns == SPECIFIC_FORCE:
            table, origin = _with_stated_position(table, origin, source, log)
    if {*EARTH_VELOCITY, *EULER} <= columns.keys() and columns.keys().isdisjoint(SPECIFIC_FORCE):
        table, origin = with_specific_force(table, origin)
    table = table[[name for name in CHANNELS if name in table]]
    return table, {name: origin[name] for name in table if name in origin}


def _on_clock(
    sources: list[Source],
) -> tuple[dict[str, Vector], dict[str, Origin]]:
    """Return the columns of the sources on the clock of one of them, and where each is from."""
    leader = _leader(sources)
    rate = float(f"{min(SETTINGS.highest_rate, leader.rate):.3g}")
    clock = uniform_clock(leader.time, rate)
    columns: dict[str, Vector] = {"time": clock}
    origin: dict[str, Origin] = {}
    for source in sources:
        names = source.columns
        if names == QUATERNION:
            names = EULER
            values = _attitude(source, clock, rate)
        else:
            values = resample(source.time, source.values, clock, rate)
        columns |= by_name(names, values)
        origin |= dict.fromkeys(names, source.origin)
    return columns, origin


def _with_stated_position(
    table: pd.DataFrame, origin: dict[str, Origin], source: Source, log: Log
) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return the table with the position of its accelerometers, if the log states it, and an unknown tilt."""
    words, position = log.sensor_positions.get(source.instance, ("", ()))
    constants = dict(zip(SENSOR_POSITION, position, strict=False))
    origin = origin | dict.fromkeys(constants, Origin(words, np.nan))
    if log.sensor_tilt:
        constants["sensor_tilt"] = log.sensor_tilt
        origin["sensor_tilt"] = Origin("not stated by the log", np.nan)
    return table.assign(**constants), origin


def _true_airspeed(equivalent: Vector, density: Vector | None) -> tuple[Vector, str]:
    """Return the true airspeed of an equivalent one, and what it rests on."""
    if density is None:
        return equivalent, "equivalent, taken for true: density unknown"
    return equivalent * np.sqrt(DENSITY / density), "equivalent; true by density"


def _leader(sources: list[Source]) -> Source:
    """Return the source whose clock the table follows: gyros, accelerometers, attitude, or the fastest."""
    for leader in LEADERS:
        for source in sources:
            if leader in source.columns:
                return source
    return max(sources, key=lambda source: source.rate)


def _attitude(source: Source, clock: Vector, rate: float) -> Matrix:
    """Return phi, theta, psi of quaternions on a clock."""
    quaternions = resample(source.time, without_sign_changes(source.values), clock, rate)
    # a quaternion of zeros is none
    is_attitude = quaternions.any(axis=1, keepdims=True)
    return quaternion_to_euler(np.where(is_attitude, quaternions, np.nan))


def with_specific_force(
    table: pd.DataFrame, origin: dict[str, Origin]
) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return the table with the specific force that changes its velocity, f = R^T (v_dot - g).

    It is for logs without an accelerometer, and has the bandwidth of the velocity: little above
    a fifth of its rate.
    """
    rate = min(origin[name].rate for name in EARTH_VELOCITY)
    velocity = table[list(EARTH_VELOCITY)]
    try:
        cutoff = SETTINGS.velocity_cutoff * rate
        change = differentiate(velocity, table["time"], cutoff=cutoff)
    # the clock of the log is not sound, which coefficients refuse themselves
    except ValueError:
        return table, origin
    change[:, 2] -= STANDARD_GRAVITY
    attitude = euler_to_matrix(*table[list(EULER)].to_numpy().T)
    force = np.einsum("nji,nj->ni", attitude, change)
    # the sensors are at the body's origin
    added = by_name(SPECIFIC_FORCE, force) | dict.fromkeys(SENSOR_POSITION, 0.0)
    source = Origin("velocity and attitude, as no accelerometer is of use", rate)
    return table.assign(**added), origin | dict.fromkeys(added, source)


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
