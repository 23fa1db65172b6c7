"""Conversion of autopilot logs to flight tables: sources of columns by rules, one clock, flights.

Single time stamps may be wrong; the median of neighbouring messages in the file hardly ever is.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from numbers import Real
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import butter, sosfiltfilt

from skdgp._compute.messages import without_warnings
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import CHANNELS, EARTH_VELOCITY, EULER, SPECIFIC_FORCE
from skdgp._flight.clock import GAP
from skdgp._flight.faults import POSSIBLE, RARE
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
from skdgp.io._dataflash import read_dataflash
from skdgp.io._log import (
    DENSITY,
    EQUIVALENT,
    QUATERNION,
    Control,
    Log,
    Rule,
    Topic,
    full_throws,
    read_servos,
    reversed_of,
    with_throws,
)
from skdgp.io._tables import FlightReadError
from skdgp.io._tlog import read_tlog
from skdgp.io._ulog import read_ulog

BLOCK_SIZE = 25  # messages of a block, whose median time is compared with the next block's
# a clock that goes back by more than this was restarted [s]; messages out of order are less late
RESTART_STEP = 5.0
STAMP_MARGIN = 5.0  # distance of valid stamps from the medians of a part [s]
LARGEST_STEP = 60.0  # longest step between medians that widens this margin [s]
FILTER_ORDER = 4
CUTOFF = 0.4  # corner of the low-pass in parts of the new rate: gain 1/2 there
LEAST_RATIO = 1.2  # least ratio of rates of a channel that is low-passed
LONGEST_PAUSE = (5.0, 50.0)  # in longer pauses, [s] and [usual steps], the clock has no rows
MOST_GAPS = 0.05  # larger fractions of gaps are the pauses between bursts; a guess
# Readers of logs by suffix; another format is one more entry
AUTOPILOTS: dict[str, Callable[[Path], Log]] = {
    ".ulg": read_ulog, ".ulog": read_ulog, ".bin": read_dataflash, ".tlog": read_tlog,
}  # fmt: skip
# corner of the smoothing of accelerations by velocities, in parts of the sampling rate
RATE_CUTOFF = 0.2
SLOWEST_AIRSPEED = ("AIRSPEED_MIN", "ARSPD_FBW_MIN", "FW_AIRSPD_MIN")  # parameters [m/s]
# airborne above this fraction of the slowest airspeed that is set, or above this speed [m/s]
AIRBORNE_FRACTION = 0.7
AIRBORNE_SPEED = 8.0
# height above the ground of the take-off [m] below which wheels may carry the aircraft; a guess
CLEAR = 0.5
LONGEST_DIP = 2.0  # slower for less than this is still flight [s]
SHORTEST_FLIGHT = 5.0  # faster for less than this is none [s]
LONGEST_EDGE = 1.0  # channels begin and end within this of each other [s]
NOT_FLYING_ON_WINGS = ("multicopter", "rover", "boat", "submarine", "antenna tracker")
LEAST_RATE = 5.0  # a source slower than this [Hz] gives way to a faster one further down
# of the clock, which follows the gyros [Hz]: rigid aircraft and surfaces move slower than 20 Hz
HIGHEST_RATE = 50.0


class Origin(NamedTuple):
    """The description of the source of a column, and its sampling rate [Hz]."""

    words: str
    rate: float


class Source(NamedTuple):
    """The source of columns, and its valid samples."""

    columns: tuple[str, ...]
    name: str
    time: Vector
    values: Matrix
    note: str = ""

    @property
    def rate(self) -> float:
        """The usual rate [Hz], NaN of less than two samples."""
        return 1.0 / usual_step(np.diff(self.time)) if len(self.time) > 1 else np.nan


class Part(NamedTuple):
    """Part of a log between two restarts of its clock."""

    topics: dict[str, Topic]
    table: pd.DataFrame
    segments: list[slice]


class FlightLog(NamedTuple):
    """A log resampled to one clock: its parts, the origin of each column, and remarks."""

    log: Log
    parts: list[Part]
    origin: dict[str, Origin]
    speed: float
    remarks: list[str]


def is_log(path: object) -> bool:
    """Return whether this is the path of a log of an autopilot."""
    return isinstance(path, str | os.PathLike) and Path(path).suffix.lower() in AUTOPILOTS


def read_log(path: Path) -> Log:
    """Return a log of an autopilot as it is."""
    return AUTOPILOTS[path.suffix.lower()](path)


def on_one_clock(path: Path, *, servos=None, airborne=True) -> FlightLog:
    """Return a log on one clock; raise FlightReadError if an option makes no sense or the log has no column."""
    is_speed = isinstance(airborne, Real) and float(airborne) > 0
    if not (isinstance(airborne, bool) or is_speed):
        raise FlightReadError(
            f"Got airborne={airborne!r}, but expected True, False, or an airspeed in m/s."
        )
    turned = reversed_of(servos)
    entries = read_servos(servos) if turned is None else {}
    with np.errstate(all="ignore"):  # damaged messages may hold any number
        log = read_log(path)
        servos = with_throws(entries, log) if turned is None else full_throws(log, turned)
        topics, remarks = clock_parts(log.topics)
        speed = _airborne_speed(log) if isinstance(airborne, bool) else float(airborne)
        parts: list[Part] = []
        origin: dict[str, Origin] = {}
        useless: list[str] = []
        logged = [(part, *find_sources(log, part, servos)) for part in topics]
        for part, sources, unused in [entry for entry in logged if entry[1]] or logged[:1]:
            useless += unused
            clock, chosen = follow(sources)
            table, origins = to_table(sources, clock, chosen)
            if {*EARTH_VELOCITY, *EULER} <= {*table} and not {*SPECIFIC_FORCE} & {*table}:
                table, origins = with_specific_force(table, origins)
            origin |= origins
            parts.append(Part(part, table, find_segments(table, log, part, speed)))
    remarks = [*log.remarks, *remarks, *dict.fromkeys(useless)]
    return FlightLog(log, parts, origin, speed, remarks)


def _airborne_speed(log: Log) -> float:
    """Return the airspeed [m/s] above which an aircraft flies, by the autopilot's parameters."""
    speeds = [log.parameters.get(name, np.nan) for name in SLOWEST_AIRSPEED]
    set_speeds = (AIRBORNE_FRACTION * speed for speed in speeds if 0 < speed < 200)
    return next(set_speeds, AIRBORNE_SPEED)


def flight_table(flown: FlightLog, name: str, *, airborne) -> pd.DataFrame:
    """Return the flights of a log one after another: name, name#2, ...; raise FlightReadError if there is none."""
    if flown.log.vehicle in NOT_FLYING_ON_WINGS:
        pieces = []
    elif airborne is False:
        pieces = [part.table for part in flown.parts if len(part.table)]
    else:
        pieces = [trimmed(part.table.iloc[rows]) for part in flown.parts for rows in part.segments]
    if not pieces:
        raise FlightReadError(
            f"Got a log of {flown.log.firmware} in which no flight was found "
            f"({no_flight_because(flown)}), but expected a fixed wing in the air: airborne=False "
            f"(--airborne all) reads all of it, airborne=6.0 (--airborne 6) all above 6 m/s."
        )
    names = [name, *(f"{name}#{k + 2}" for k in range(len(pieces) - 1))]
    return pd.concat(
        [piece.assign(flight=n) for piece, n in zip(pieces, names, strict=True)], ignore_index=True
    )


def with_specific_force(
    table: pd.DataFrame, origin: dict[str, Origin]
) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return the table with the specific force that changes its velocity, f = R^T (v_dot - g).

    It is for logs without an accelerometer, and has the bandwidth of the velocity: little above
    a fifth of its rate.
    """
    rate = min(origin[name].rate for name in EARTH_VELOCITY)
    try:
        with without_warnings():  # rows that stand alone have no rate of change
            change = differentiate(
                table[list(EARTH_VELOCITY)], table["time"], cutoff=RATE_CUTOFF * rate
            )
    except (
        ValueError
    ):  # the clock of the log is not sound, which coefficients refuse in their own words
        return table, origin
    change[:, 2] -= STANDARD_GRAVITY
    attitude = euler_to_matrix(*table[list(EULER)].to_numpy().T)
    force = np.einsum("nji,nj->ni", attitude, change)
    source = Origin("velocity and attitude, as no accelerometer is of use", rate)
    table = table.assign(**dict(zip(SPECIFIC_FORCE, force.T, strict=True)))
    return table[[name for name in CHANNELS if name in table]], origin | dict.fromkeys(
        SPECIFIC_FORCE, source
    )


def find_segments(
    table: pd.DataFrame, log: Log, topics: dict[str, Topic], speed: float
) -> list[slice]:
    """Return the rows of each flight: airspeed above a speed, and not reported as landed.

    Without an airspeed the speed over ground is used, unless the vehicle has no wings. What rolls
    on its wheels after it was reported as landed does not fly yet.
    """
    fast = _speed(table, log) > speed
    landed = _landed(table["time"].to_numpy(), log, topics)
    if landed is not None:
        fast &= ~landed
    time, rows = table["time"].to_numpy(), np.flatnonzero(fast)
    parts = np.split(rows, np.flatnonzero(np.diff(time[rows]) >= LONGEST_DIP) + 1)
    ends = [
        (_lift_off(table, landed, int(part[0]), int(part[-1])), int(part[-1]))
        for part in parts
        if len(part)
    ]
    return [slice(a, b + 1) for a, b in ends if time[b] - time[a] >= SHORTEST_FLIGHT]


def _lift_off(table, landed, first: int, last: int) -> int:
    """Return the first row of a flight that is clear of the ground on which it was reported as landed before."""
    before = (
        np.flatnonzero(landed[:first]) if landed is not None and "down" in table else np.empty(0)
    )
    if not len(before):
        return first
    height = table["down"].to_numpy()[before[-1]] - table["down"].to_numpy()[first : last + 1]
    return first + int(
        (height > CLEAR).argmax()
    )  # 0 where it is never: the height is not to be believed


def trimmed(flight: pd.DataFrame) -> pd.DataFrame:
    """Return a flight without rows at its ends, at most a second, where slow channels have no value."""
    time, sampled = flight["time"].to_numpy(), flight.notna().to_numpy()
    sampled = sampled[:, sampled.any(axis=0)]
    begins, ends = time[sampled.argmax(axis=0)], time[len(time) - 1 - sampled[::-1].argmax(axis=0)]
    begin = begins[begins <= time[0] + LONGEST_EDGE].max()
    end = ends[ends >= time[-1] - LONGEST_EDGE].min()
    return flight[(time >= begin) & (time <= end)]


def no_flight_because(flown: FlightLog) -> str:
    """Return why a log holds no flight."""
    if flown.log.vehicle in NOT_FLYING_ON_WINGS:
        return (
            f"a {flown.log.vehicle}: not for this program; if it has wings, correct the vehicle "
            f"type on the autopilot"
        )
    table = max((part.table for part in flown.parts), key=len)
    highest = np.nanmax(_speed(table, flown.log), initial=-np.inf)
    measured = "airspeed" in table
    slow = (
        f"{'airspeed' if measured else 'ground speed'} never stays above {flown.speed:.3g} m/s in "
        f"the air (highest {highest:.3g} m/s)"
    )
    reasons = {"there is no valid airspeed": not measured, slow: np.isfinite(highest)}
    return ", ".join(reason for reason, applies in reasons.items() if applies)


def _speed(table, log):
    if "airspeed" in table:
        return table["airspeed"].to_numpy()
    if not {"v_north", "v_east"} <= {*table} or log.vehicle in NOT_FLYING_ON_WINGS:
        return np.full(len(table), np.nan)
    return np.hypot(table["v_north"].to_numpy(), table["v_east"].to_numpy())


def _landed(time, log, topics):
    """Return whether the autopilot reported to be landed, (n,), or None where it does not say."""
    name, field, value = log.landed or ("", "", 0.0)
    if field not in topics.get(name, ()):
        return None
    last = np.searchsorted(topics[name].time, time, side="right") - 1
    return (topics[name][field] == value)[np.maximum(last, 0)]


def find_sources(
    log: Log, topics: dict[str, Topic], servos: Mapping[str, Control]
) -> tuple[list[Source], list[str]]:
    """Return the source of each group of columns, and remarks on sources that are of no use."""
    part = replace(log, topics=topics)
    candidates: dict[tuple[str, ...], list[Source]] = {}
    useless: list[str] = []
    for rule in log.rules:
        source = _source(part, rule)
        if source is None:
            continue
        low, high = np.transpose([POSSIBLE.get(name, (-np.inf, np.inf)) for name in rule.columns])
        wrong = ((source.values < low) | (source.values > high)).any(axis=1)
        if len(source.time) < 2:
            useless.append(f"{source.name} is never valid ({' '.join(rule.valid) or 'no number'})")
        elif wrong.mean() > RARE:  # fewer are faults of a sensor
            columns = ", ".join(rule.columns)
            share = f"{100 * wrong.mean():.0f} % is impossible"
            useless.append(f"{source.name} cannot be {columns}: {share}")
        else:
            candidates.setdefault(rule.columns, []).append(source)
    surfaces = [_surface(part, name, parts) for name, parts in servos.items()]
    useless += [
        f"{surface.name} sends no pulse, so there is no {surface.columns[0]}"
        for surface in surfaces
        if len(surface.time) < 2
    ]
    chosen = [
        next((source for source in sources if source.rate >= LEAST_RATE), sources[0])
        for columns, sources in candidates.items()
        if not servos.keys() & set(columns)
    ]
    return chosen + [surface for surface in surfaces if len(surface.time) > 1], useless


def follow(sources: list[Source]) -> tuple[Vector, float]:
    """Return the clock of the table and its rate [Hz], by the gyros or the next best source."""
    by_column = {name: source for source in sources for name in source.columns}
    leader = next((by_column[name] for name in ("p", "ax", "qw") if name in by_column), None)
    leader = leader or max(sources, key=lambda source: source.rate, default=None)
    if leader is None:
        raise FlightReadError(
            "Got no message of a flight, but expected rates, accelerations, attitude, airspeed: "
            "log these topics."
        )
    rate = float(f"{min(HIGHEST_RATE, leader.rate):.3g}")
    return uniform_clock(leader.time, rate), rate


def to_table(
    sources: list[Source], clock: Vector, rate: float
) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return all columns on one clock, in the order of the vocabulary, and where each is from."""
    columns: dict[str, Vector] = {"time": clock}
    origin: dict[str, Origin] = {}
    for source in sources:
        names, turns = source.columns, source.columns == QUATERNION
        values = without_sign_changes(source.values) if turns else source.values
        values = resample(source.time, values, clock, rate)
        if turns:
            is_attitude = values.any(axis=1, keepdims=True)  # a quaternion of zeros is none
            names = EULER
            values = quaternion_to_euler(np.where(is_attitude, values, np.nan))
        for name, column in zip(names, values.T, strict=True):
            columns[name] = column
            origin[name] = Origin(
                source.name + (f" ({source.note})" if source.note else ""), source.rate
            )
    if "density" not in columns and "altitude" in columns:
        columns["density"] = standard_density(np.clip(columns["altitude"], LOWEST, HIGHEST))
        origin["density"] = Origin("altitude (standard atmosphere)", origin["altitude"].rate)
    if EQUIVALENT in columns:
        density = columns.get("density", DENSITY)
        columns["airspeed"] = columns.pop(EQUIVALENT) * np.sqrt(DENSITY / density)
        note = (
            "equivalent; true by density"
            if "density" in columns
            else "equivalent, taken for true: density unknown"
        )
        pitot, its_rate = origin.pop(EQUIVALENT)
        origin["airspeed"] = Origin(f"{pitot} ({note})", its_rate)
    table = pd.DataFrame({name: columns[name] for name in CHANNELS if name in columns})
    table = table.where(np.isfinite(table))
    return table, {name: origin[name] for name in table.columns if name in origin}


def _source(log, rule: Rule) -> Source | None:
    name = log.find(rule.topic)
    topic = log.topics.get(name)
    if topic is None or not all(field in topic for field in rule.fields):
        return None
    values = rule.convert(topic.columns(rule.fields))
    valid = np.isfinite(values).all(axis=1)
    for field in rule.valid:
        valid &= topic[field] > 0 if field in topic else True
    first, last = rule.fields[0], rule.fields[-1]
    is_array = first != last and first.endswith("[0]")
    described = (
        f"{first[:-1]}..{last.split('[')[1]}" if is_array else " ".join(rule.fields)
    )  # q[0..3], GyrX GyrY GyrZ
    return Source(rule.columns, f"{name}.{described}", topic.time[valid], values[valid], rule.note)


def _surface(log, name, parts: Control) -> Source:
    values = np.sum(
        [w * part.deflection(_channel(log, name, part.channel)) for w, part in parts], axis=0
    )
    valid = np.isfinite(values)
    largest = sum(abs(weight) * max(np.abs(part.angles)) for weight, part in parts)
    note = "in parts of the full throw" if np.isclose(largest, 1.0) else "by the servo file"
    channels = [part.channel for _, part in parts]
    time = log.topics[channels[0].partition(".")[0]].time  # parts are fields of one topic
    return Source((name,), " ".join(channels), time[valid], values[valid][:, None], note)


def _channel(log, name, channel: str) -> Vector:
    """Return the values of a channel; raise FlightReadError if the log has none such."""
    topic, _, field = channel.partition(".")
    if field not in log.topics.get(topic, ()):
        fields = [
            f"{key}.{name}"
            for key in log.topics
            if key in log.outputs
            for name in log.topics[key].fields
            if name not in ("timestamp", "timestamp_sample", "TimeUS")
        ]
        raise FlightReadError(
            f"Got channel {channel!r} for {name}, but the log has no such field: expected one of "
            f"{fields[:24]}."
        )
    return log.topics[topic][field]


def clock_parts(topics: dict[str, Topic]) -> tuple[list[dict[str, Topic]], list[str]]:
    """Return the topics, split where the clock was set back, their times strictly increasing; and remarks."""
    order = np.concatenate([topic.order for topic in topics.values()])
    rows = np.argsort(order, kind="stable")
    order = order[rows]
    time = np.concatenate([topic.time for topic in topics.values()])[rows]
    edges = [0, *_restarts(time), len(time)]
    parts = []
    wrong = dict.fromkeys(topics, 0)
    disordered = 0
    for first, last in pairwise(edges):
        steady = _steady(time[first:last])
        margin = STAMP_MARGIN + min(np.abs(np.diff(steady)).max(initial=0.0), LARGEST_STEP)
        low, high = steady.min() - margin, steady.max() + margin
        part = {}
        for name, topic in topics.items():
            logged = topic.select((topic.order >= order[first]) & (topic.order <= order[last - 1]))
            stamped = logged.select((logged.time >= low) & (logged.time <= high))
            part[name] = stamped.select(np.unique(stamped.time, return_index=True)[1])
            wrong[name] += len(logged) - len(stamped)
            disordered += int((np.diff(stamped.time) < 0).sum())
        parts.append({name: topic for name, topic in part.items() if len(topic)})
    steps = [f"from {time[edge - 1]:.1f} s to {time[edge]:.1f} s" for edge in edges[1:-1][:4]]
    name, most = max(wrong.items(), key=itemgetter(1))
    remarks = {
        f"the clock was set back {len(parts) - 1} times ({', '.join(steps)}): each time a new "
        f"flight begins": len(parts) > 1,
        f"{sum(wrong.values())} of {len(time)} messages have a time that cannot be ({most} of "
        f"{name})": most,
        f"{disordered} messages stand out of order in time, and were sorted": disordered,
    }
    return parts, [remark for remark, applies in remarks.items() if applies]


def _steady(time):
    """Return the median time of each block of messages, (m,), and of these the median of five neighbours."""
    size = min(BLOCK_SIZE, len(time))
    centres = np.median(time[: len(time) // size * size].reshape(-1, size), axis=1)
    # Not scipy.ndimage.median_filter: of one value, versions 1.15.0 to .2 overwrite memory, and
    # 1.15.3 returns 0.
    return np.median(sliding_window_view(np.pad(centres, 2, mode="edge"), 5), axis=1)


def _restarts(time) -> list[int]:
    """Return the first messages of clocks that were set back."""
    steady = _steady(time)
    restarts = []
    for block in np.flatnonzero(np.diff(steady) < -RESTART_STEP).tolist():
        window = slice(max(block - 3, 0) * BLOCK_SIZE, (block + 5) * BLOCK_SIZE)
        later = np.where(time[window] > (steady[block] + steady[block + 1]) / 2, 1, -1)
        restarts.append(window.start + int(np.argmax(np.cumsum(later))) + 1)
    return sorted(set(restarts) - {len(time)})


def usual_step(step: Vector) -> float:
    """Return the usual step of a clock: the median, or the mean where messages come in bursts.

    In bursts, steps longer than gaps are frequent and make up most of the time.
    """
    median = float(np.median(step))
    gap = step > GAP * median
    bursts = gap.mean() > MOST_GAPS and step[gap].sum() > 0.5 * step.sum()
    return float(np.mean(step)) if bursts else median


def uniform_clock(time: Vector, rate: float) -> Vector:
    """Return the multiples of 1 / rate [s] within the runs of a channel."""
    step = np.diff(time)
    edges = np.flatnonzero(step > max(LONGEST_PAUSE[0], LONGEST_PAUSE[1] * np.median(step))) + 1
    starts, ends = time[np.r_[0, edges]], time[np.r_[edges, len(time)] - 1]
    first, last = np.ceil(starts * rate - 1e-6), np.floor(ends * rate + 1e-6)
    counts = np.maximum(last - first + 1, 0).astype(int)
    return np.concatenate([a + np.arange(n) for a, n in zip(first, counts, strict=True)]) / rate


def resample(time: Vector, values: Matrix, clock: Vector, rate: float) -> Matrix:
    """Return channels (n, k), sampled at increasing times (n,) [s], on another clock (m,) of ``rate`` [Hz], (m, k).

    Rows that are not finite count as not sampled; gaps, and rows before the first and after the
    last sample, are NaN. Each run of samples without a gap (2.5 usual steps) is taken by itself. If
    it is faster than the new rate it passes a Butterworth low-pass forwards and backwards, which
    has no delay (Gustafsson 1996, Determining the initial states in forward-backward filtering);
    then it is interpolated linearly.
    """
    result = np.full((len(clock), values.shape[1]), np.nan)
    sampled = np.isfinite(values).all(axis=1)
    time, values = time[sampled], values[sampled]
    if len(time) < 2:
        return result
    step = np.diff(time)
    edges = np.r_[0, np.flatnonzero(step > GAP * usual_step(step)) + 1, len(time)]
    tolerance = 1e-6 / rate
    begins = np.searchsorted(clock, time[edges[:-1]] - tolerance)
    ends = np.searchsorted(clock, time[edges[1:] - 1] + tolerance, side="right")
    for a, b, begin, end in zip(edges[:-1], edges[1:], begins, ends, strict=True):
        if b - a > 1 and end > begin:
            run = _low_passed(time[a:b], values[a:b], rate)
            for j in range(values.shape[1]):
                result[begin:end, j] = np.interp(clock[begin:end], time[a:b], run[:, j])
    return result


def _low_passed(time, values, rate):
    """Return a run without the frequencies that the new rate cannot carry."""
    n, old_rate = len(time), (len(time) - 1) / (time[-1] - time[0])
    if old_rate < LEAST_RATIO * rate:
        return values
    even = np.linspace(time[0], time[-1], n)
    sections = butter(FILTER_ORDER, CUTOFF * rate, fs=old_rate, output="sos")
    padding = min(n - 1, round(4 * old_rate / rate) + 27)
    columns = [np.interp(even, time, column) for column in values.T]
    passed = sosfiltfilt(sections, np.column_stack(columns), axis=0, padlen=padding)
    return np.column_stack([np.interp(time, even, column) for column in passed.T])
