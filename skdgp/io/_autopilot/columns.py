"""Columns of a flight table, computed from topics by rules."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.atmosphere import HIGHEST, LOWEST, standard_density
from skdgp._flight.channels import CHANNELS, EULER
from skdgp._flight.faults import POSSIBLE, RARE
from skdgp._flight.frames import quaternion_to_euler, without_sign_changes
from skdgp.io._autopilot.clock import resample, sampling_rate, uniform_clock
from skdgp.io._autopilot.formats import DENSITY, EQUIVALENT, QUATERNION, Log, Rule, Topic
from skdgp.io._autopilot.servos import Mixture, Servo
from skdgp.io._tables import FlightReadError

LEAST_RATE = 5.0  # a source slower than this [Hz] gives way to a faster one further down
HIGHEST_RATE = 50.0
"""The clock follows the gyros, but not beyond this [Hz]: rigid aircraft and surfaces move slower than 20 Hz."""


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
        """The usual rate [Hz]."""
        return sampling_rate(self.time)


def find_sources(
    log: Log, topics: dict[str, Topic], servos: Mapping[str, Servo | Mixture]
) -> tuple[list[Source], list[str]]:
    """Return the source of each group of columns, and remarks on those that are of no use."""
    part = replace(log, topics=topics)
    candidates: dict[tuple[str, ...], list[Source]] = {}
    useless = []
    for rule in log.rules:
        source = _source(part, rule)
        if source is None:
            continue
        low, high = zip(*(POSSIBLE.get(name, (-np.inf, np.inf)) for name in rule.columns), strict=True)
        wrong = ((source.values < low) | (source.values > high)).any(axis=1)
        if len(source.time) < 2:
            useless.append(f"{source.name} is never valid ({' '.join(rule.valid) or 'no number'})")
        elif (share := wrong.mean()) > RARE:  # fewer are faults of a sensor
            useless.append(f"{source.name} cannot be {', '.join(rule.columns)}: {100 * share:.0f} % is impossible")
        else:
            candidates.setdefault(rule.columns, []).append(source)
    found = [
        next((source for source in sources if source.rate >= LEAST_RATE), sources[0])
        for columns, sources in candidates.items()
        if not servos.keys() & set(columns)
    ]
    surfaces = [_surface(part, name, servo) for name, servo in servos.items()]
    useless += [
        f"{each.name} sends no pulse, so there is no {each.columns[0]}" for each in surfaces if len(each.time) < 2
    ]
    return found + [each for each in surfaces if len(each.time) > 1], list(dict.fromkeys(useless))


def follow(sources: list[Source], rate: float | None) -> tuple[Vector, float]:
    """Return the clock of the table and its rate [Hz]: those of the gyros, or the next best source."""
    by_column = {name: source for source in sources for name in source.columns}
    leader = next((by_column[name] for name in ("p", "ax", "qw") if name in by_column), None)
    leader = leader or max(sources, key=lambda source: source.rate, default=None)
    if leader is None:
        raise FlightReadError(
            "Got no message of a flight, but expected rates, accelerations, attitude, airspeed: log these topics."
        )
    rate = rate or float(f"{min(HIGHEST_RATE, leader.rate):.3g}")
    try:
        clock = uniform_clock(leader.time, rate)
    except ValueError as error:
        raise FlightReadError(f"{leader.name}: {error} Is the clock of the log sound?") from error
    return clock, rate


def to_table(sources: list[Source], clock: Vector, rate: float) -> tuple[pd.DataFrame, dict[str, Origin]]:
    """Return all columns on one clock, in the order of the vocabulary, and where each is from."""
    columns: dict[str, Vector] = {"time": clock}
    origin: dict[str, Origin] = {}
    for source in sources:
        values = source.values
        if source.columns == QUATERNION:
            values = without_sign_changes(values)
        values = resample(source.time, values, clock, rate)
        names = source.columns
        if names == QUATERNION:
            known = values.any(axis=1, keepdims=True)  # a quaternion of zeros is no attitude
            names, values = EULER, quaternion_to_euler(np.where(known, values, np.nan))
        for name, column in zip(names, values.T, strict=True):
            columns[name] = column
            origin[name] = Origin(source.name + (f" ({source.note})" if source.note else ""), source.rate)
    _complete(columns, origin)
    table = pd.DataFrame({name: columns[name] for name in CHANNELS if name in columns})
    table = table.where(np.isfinite(table))
    return table, {name: origin[name] for name in table.columns if name in origin}


def _complete(columns, origin):
    """Add density and true airspeed where they were not logged."""
    if "density" not in columns and "altitude" in columns:
        columns["density"] = standard_density(np.clip(columns["altitude"], LOWEST, HIGHEST))
        origin["density"] = Origin("altitude (standard atmosphere)", origin["altitude"].rate)
    if EQUIVALENT in columns:
        equivalent, (words, rate) = columns.pop(EQUIVALENT), origin.pop(EQUIVALENT)
        known = "density" in columns
        columns["airspeed"] = equivalent * np.sqrt(DENSITY / columns["density"]) if known else equivalent
        note = "equivalent; true by density" if known else "equivalent, taken for true: density unknown"
        origin["airspeed"] = Origin(f"{words} ({note})", rate)


def _source(log, rule: Rule) -> Source | None:
    name = log.find(rule.topic)
    topic = log.topics.get(name)
    if topic is None or not all(field in topic for field in rule.fields):
        return None
    values = rule.convert(topic.columns(rule.fields))
    known = np.isfinite(values).all(axis=1)
    for field in rule.valid:
        known &= topic[field] > 0 if field in topic else True
    first, last = rule.fields[0], rule.fields[-1]
    is_array = first != last and first.endswith("[0]")
    words = f"{first[:-1]}..{last.split('[')[1]}" if is_array else " ".join(rule.fields)  # q[0..3], GyrX GyrY GyrZ
    return Source(rule.columns, f"{name}.{words}", topic.time[known], values[known], rule.note)


def _surface(log, name, servo: Servo | Mixture) -> Source:
    values = np.sum([w * each.deflection(_channel(log, name, each.channel)) for w, each in servo.parts], axis=0)
    known = np.isfinite(values)
    largest = sum(abs(weight) * max(np.abs(each.angles)) for weight, each in servo.parts)
    note = "in parts of the full throw" if np.isclose(largest, 1.0) else "by the servo file"
    channels = [each.channel for _, each in servo.parts]
    time = log.topics[channels[0].partition(".")[0]].time  # parts are fields of one topic
    return Source((name,), " ".join(channels), time[known], values[known][:, None], note)


def _channel(log, name, channel: str) -> Vector:
    """Return the values of a channel; raise FlightReadError if the log has none such."""
    topic_name, _, field = channel.partition(".")
    topic = log.topics.get(topic_name)
    if topic is None or field not in topic:
        fields = [f"{key}.{each}" for key in log.topics if key in log.outputs for each in log.topics[key].channels()]
        raise FlightReadError(
            f"Got channel {channel!r} for {name}, but the log has no such field: expected one of "
            f"{[each for each in fields if not each.endswith(('timestamp', 'timestamp_sample', 'TimeUS'))][:24]}."
        )
    return topic[field]
