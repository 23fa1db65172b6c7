"""Choice among the instances of a sensor: the one that the autopilot used at each time, else a healthy one."""

from __future__ import annotations

from itertools import compress
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Indices, Mask, Matrix, Vector
from skdgp._flight.clock import CLOCK
from skdgp._flight.frames import without_sign_changes
from skdgp.io._clock import usual_step
from skdgp.io._log import (
    LEAST_SPEED,
    QUATERNION,
    Instance,
    Log,
    Rule,
    Topic,
    Use,
    engines_note,
    last_before,
)
from skdgp.io._resets import reset_times, seconds

# weights of the choice: a valid sample counts before the autopilot's choice, this before a flag
VALID_WEIGHT = 4
USED_WEIGHT = 2
# columns whose instances are engines, and allocators, in place of redundant sensors
ENGINES = ("propeller_speed",)
COMMANDS = ("throttle",)
# beyond any counter of resets, of which instances have one each
COUNTERS = 1e6
# of a choice where the log says that no instance was used
NONE = -1


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
    remark: str = ""
    # times [s] of resets
    cuts: tuple[float, ...] = ()
    # number of the instance, the most used one of several
    instance: int = 0

    @property
    def rate(self) -> float:
        """The usual rate [Hz] of two samples or more."""
        return 1.0 / usual_step(np.diff(self.time))

    @property
    def origin(self) -> Origin:
        """The description with its note, and the rate."""
        words = f"{self.name} ({self.note})" if self.note else self.name
        return Origin(words, self.rate)


class Readings(NamedTuple):
    """The readings of one instance, which of them are valid, and the resets of an estimator."""

    instance: Instance
    time: Vector
    values: Matrix
    valid: Mask
    # 0 to 1: flags, or a confidence
    preferred: Vector
    # 0 where resets are not logged
    counter: Vector

    @property
    def health(self) -> tuple[bool, float, bool, float]:
        """Order of instances: valid readings, the autopilot's flag, readings that move."""
        share = float(self.valid.mean())
        moves = self.valid.any() and np.ptp(self.values[self.valid]) > 0
        return share > 0, round(share, 2), bool(moves), float(self.preferred.mean())

    @property
    def step(self) -> float:
        """The usual step [s], infinite of a single reading."""
        return usual_step(np.diff(self.time)) if len(self.time) > 1 else np.inf


def is_valid(topic: Topic, rule: Rule) -> Mask:
    """Return which messages the log calls valid measurements, by the fields that it has."""
    valid = np.ones(len(topic), bool)
    for field in rule.valid:
        if field in topic:
            valid &= topic[field] > 0
    for field, low, high in rule.within:
        if field in topic:
            valid &= (topic[field] >= low) & (topic[field] <= high)
    return valid


def validity_fields(log: Log, rule: Rule) -> list[str]:
    """Return the fields that say whether a source is a measurement, with their values where these are limited."""
    texts = []
    for instance in log.instances(rule.topic):
        texts += [field for field in rule.valid if field in instance.topic]
        for field, _, _ in rule.within:
            if field in instance.topic:
                values = np.unique(instance.topic[field]).astype(int).tolist()
                texts.append(f"{field} {values}")
    return list(dict.fromkeys(texts))


def choose(log: Log, rule: Rule) -> Source | None:
    """Return the source of a rule's columns, or None if the log has none of its fields."""
    readings = []
    for instance in log.instances(rule.topic):
        if all(field in instance.topic for field in rule.fields):
            readings.append(_readings(instance, rule))
    if not readings:
        return None
    if rule.columns == ENGINES and len(readings) > 1:
        return _mean_engine(log, rule, readings)
    if rule.columns == COMMANDS:
        readings = readings[:1]
    readings.sort(key=lambda reading: reading.health, reverse=True)
    return _source_of(log, rule, readings)


def _source_of(log: Log, rule: Rule, readings: list[Readings]) -> Source:
    """Return the source by the chosen readings of instances, best first."""
    times = np.unique(np.concatenate([reading.time for reading in readings]))
    used, use = _used(log, rule, readings, times)
    chosen = _chosen(readings, used, times, any(reading.is_measurement for reading in rule.used))
    names = _names(readings, chosen)
    note = _joined(", ", rule.note, _note(readings, use))
    first = min(reading.instance for reading in readings).name
    remarks = ["" if names == [first] else f"{rule.words} of {_words(rule, names)} ({note})"]
    remarks.append(_unmeasured(log, rule, readings))
    time, values, counter = _merged(readings, chosen, times)
    if rule.columns == QUATERNION:
        values = without_sign_changes(values)
    cuts = reset_times(time, values, counter) if rule.resets or rule.is_estimate else []
    if cuts:
        remarks.append(
            f"{rule.words}: resets of the estimator, so a new flight begins, at {seconds(cuts)}"
        )
    most = int(np.argmax(np.bincount(chosen[chosen != NONE], minlength=1)))
    return Source(
        columns=rule.columns,
        name=_words(rule, names),
        time=time,
        values=values,
        note=note,
        remark=_joined("; ", *remarks),
        cuts=tuple(cuts),
        instance=readings[most].instance.number,
    )


def _joined(separator: str, *texts: str) -> str:
    """Return the texts that are not empty, joined."""
    return separator.join(filter(None, texts))


def _merged(
    readings: list[Readings], chosen: Indices, times: Vector
) -> tuple[Vector, Matrix, Vector]:
    """Return times, values and counters of resets of the chosen valid readings, in order of time."""
    parts = []
    for place, reading in enumerate(readings):
        rows = reading.valid & (chosen[last_before(times, reading.time)] == place)
        counter = reading.counter[rows] + COUNTERS * place
        parts.append((reading.time[rows], reading.values[rows], counter))
    time, values, counter = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(time, kind="stable")
    return time[order], values[order], counter[order]


def _words(rule: Rule, names: list[str]) -> str:
    """Return the name of a source: its instances and fields."""
    return f"{' and '.join(names[:3])}.{_field_words(rule.fields)}"


def _field_words(fields: tuple[str, ...]) -> str:
    """Return the names of fields, of an array q[0..3]."""
    first, last = fields[0], fields[-1]
    if len(fields) > 1 and first.endswith("[0]") and last.endswith("]"):
        return f"{first[:-1]}..{last.split('[')[1]}"
    return " ".join(fields)


def _mean_engine(log: Log, rule: Rule, readings: list[Readings]) -> Source:
    """Return the root mean square of the engines that drive: thrusts go with the square of the speed."""
    readings = [reading for reading in readings if reading.valid.any()] or readings[:1]
    speeds = np.array([_speed_in_flight(log, reading) for reading in readings])
    runs = speeds > LEAST_SPEED * speeds.max()
    running = list(compress(readings, runs)) or readings[:1]
    time = running[0].time[running[0].valid]
    squares = []
    for reading in running:
        speed = reading.values[reading.valid, 0]
        squares.append(np.interp(time, reading.time[reading.valid], speed) ** 2)
    mean = np.sqrt(np.sum(squares, axis=0) / len(running))
    note = engines_note(len(running))
    return Source(
        columns=rule.columns,
        name=_words(rule, [reading.instance.name for reading in running]),
        time=time,
        values=mean[:, None],
        note=_joined(", ", rule.note, note),
    )


def _speed_in_flight(log: Log, engine: Readings) -> float:
    """Return the mean speed of an engine while no rotor lifts the aircraft [rad/s]."""
    drives = engine.valid & ~log.lifts(engine.time)
    return float(np.mean(np.abs(engine.values[drives]))) if drives.any() else 0.0


def _readings(instance: Instance, rule: Rule) -> Readings:
    topic = instance.topic
    n = len(topic)
    values = rule.convert(topic.columns(rule.fields))
    valid = np.isfinite(values).all(axis=1) & is_valid(topic, rule)
    preferred = np.zeros(n)
    for field in rule.preferred:
        if field in topic:
            preferred = np.maximum(preferred, np.clip(np.nan_to_num(topic[field]), 0.0, 1.0))
    counter = topic[rule.resets] if rule.resets in topic else np.zeros(n)
    return Readings(instance, topic.time, values, valid, preferred, counter)


def _used(
    log: Log, rule: Rule, readings: list[Readings], times: Vector
) -> tuple[Indices | None, str]:
    """Return the place among the readings that the autopilot used at each time, None if it does not say."""
    for use in rule.used:
        numbers = _numbers(log, use, times)
        if numbers is None:
            continue
        places = np.full(len(times), NONE)
        for place, reading in enumerate(readings):
            number: float = reading.instance.number + use.first
            if reading.instance.number in use.instances:
                number = use.instances.index(reading.instance.number)
            elif use.instances:
                number = NONE
            if use.match in reading.instance.topic:
                number = float(reading.instance.topic[use.match][0])
            places[numbers == number] = place
        if use.is_measurement or (places != NONE).any():
            return places, use.words
    return None, ""


def _numbers(log: Log, use: Use, times: Vector) -> Vector | None:
    """Return the number of the instance that was used at each time, None if the log does not say."""
    if not use.topic:
        value = log.parameters.get(use.field)
        return None if value is None else np.full(len(times), value)
    for instance in log.instances(use.topic, least=1):
        if use.field in instance.topic:
            return instance.topic[use.field][last_before(instance.topic.time, times)]
    return None


def _chosen(
    readings: list[Readings], used: Indices | None, times: Vector, is_measurement: bool
) -> Indices:
    """Return the place among the readings, best first, of the chosen one at each time."""
    scores = np.zeros((len(readings), len(times)))
    for place, reading in enumerate(readings):
        last = last_before(reading.time, times)
        age = times - reading.time[last]
        is_fresh = np.abs(age) <= CLOCK.gap * reading.step
        scores[place] = VALID_WEIGHT * (reading.valid[last] & is_fresh) + (
            reading.preferred[last] > 0
        )
        if used is not None:
            scores[place] += USED_WEIGHT * (used == place)
    chosen = scores.argmax(axis=0)
    if is_measurement and used is not None:
        chosen[used == NONE] = NONE
    return chosen


def _names(readings: list[Readings], chosen: Indices) -> list[str]:
    """Return the names of the chosen instances, in the order of their first choice."""
    present, first = np.unique(chosen, return_index=True)
    order = np.argsort(first)
    places = [place for place in present[order] if place != NONE] or [0]
    return [readings[place].instance.name for place in places]


def _note(readings: list[Readings], use: str) -> str:
    """Return how the source was chosen, nothing where there is no choice."""
    if len(readings) < 2:
        return ""
    return f"of {len(readings)}, " + (f"used by the autopilot: {use}" if use else "the healthiest")


def _unmeasured(log: Log, rule: Rule, readings: list[Readings]) -> str:
    """Return a remark on messages of a source that the log does not call measurements."""
    valid = np.concatenate([reading.valid for reading in readings])
    if not rule.within or valid.all():
        return ""
    name = readings[0].instance.name
    fields = " ".join(validity_fields(log, rule))
    return f"{name} is left out where it is no measurement, {100 * (1 - valid.mean()):.0f} % of it ({fields})"
