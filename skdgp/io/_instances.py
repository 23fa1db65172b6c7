"""Choice among the instances of a sensor: those that the autopilot used at each time, else the healthiest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp._flight.frames import without_sign_changes
from skdgp.io._clock import usual_step
from skdgp.io._log import (
    QUATERNION,
    Instance,
    Log,
    Rule,
    Topic,
    Use,
    fastest,
    last_before,
    whole,
)

# columns whose instances are engines, and allocators, in place of redundant sensors
ENGINES = ("propeller_speed",)
COMMANDS = ("throttle",)

# between the counters of two instances
COUNTERS = 1e6
# a reset of an estimator is a step beyond so many times what 95 % of the steps are; a guess
JUMP = 4.0


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
    # number of the instance
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
    values: Matrix
    valid: Mask
    # which of the valid ones the autopilot used
    used: Mask
    # mean of a flag, or of a confidence from 0 to 1
    confidence: float
    # of resets, 0 where they are not logged
    counter: Vector

    @property
    def time(self) -> Vector:
        """Times of the messages [s]."""
        return self.instance.topic.time

    def health(self, duration: float) -> tuple[float, bool, float]:
        """Order of instances in a log of some duration [s]: valid readings, that move, the autopilot's flag."""
        share = float(self.valid.mean()) * np.ptp(self.time) / duration
        moves = self.valid.any() and np.ptp(self.values[self.valid]) > 0
        return round(share, 2), bool(moves), self.confidence


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


def choose(log: Log, rule: Rule) -> Source | None:
    """Return the source of a rule's columns, or None if the log has none of its fields."""
    if rule.columns == ENGINES:
        return _mean_engine(log, rule)
    instances = []
    for instance in log.instances(rule.topic):
        if all(field in instance.topic for field in rule.fields):
            instances.append(instance)
    if not instances:
        return None
    if rule.columns == COMMANDS:
        instances = instances[:1]
    use = _use(log, rule, instances)
    return _source_of(rule, [_readings(log, instance, rule, use) for instance in instances], use)


def _source_of(rule: Rule, readings: list[Readings], use: Use | None) -> Source:
    """Return the source by the instances that were used, or if that is not known by the healthiest."""
    duration = np.ptp([reading.time[[0, -1]] for reading in readings])
    best = max(readings, key=lambda reading: reading.health(duration))
    used = [reading._replace(valid=reading.used) for reading in readings if reading.used.any()]
    chosen = used or [best]
    time, values, counter = _merged(chosen)
    if rule.columns == QUATERNION:
        values = without_sign_changes(values)
    cuts = reset_times(time, values, counter)
    names = [reading.instance.name for reading in chosen]
    name = f"{' and '.join(names[:3])}.{' '.join(rule.fields)}"
    notes = [rule.note]
    if len(readings) > 1:
        by = f"used by the autopilot: {use.words}" if use and used else "the healthiest"
        notes.append(f"of {len(readings)}, {by}")
    note = ", ".join(filter(None, notes))
    remarks = [_unmeasured(rule, best)]
    if names != [readings[0].instance.name]:
        remarks.insert(0, f"{rule.words} of {name} ({note})")
    if cuts:
        remarks.append(
            f"{rule.words}: resets of the estimator, or another instance, so a new flight begins, at {seconds(cuts)}"
        )
    return Source(
        columns=rule.columns,
        name=name,
        time=time,
        values=values,
        note=note,
        remark="; ".join(filter(None, remarks)),
        cuts=tuple(cuts),
        instance=best.instance.number,
    )


def _merged(readings: list[Readings]) -> tuple[Vector, Matrix, Vector]:
    """Return times, values and counters of resets of the valid readings, in order of time."""
    parts = []
    for reading in readings:
        counter = reading.counter + COUNTERS * reading.instance.number
        parts.append([part[reading.valid] for part in (reading.time, reading.values, counter)])
    time, values, counter = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(time, kind="stable")
    return time[order], values[order], counter[order]


def reset_times(time: Vector, values: Matrix, counter: Vector) -> list[float]:
    """Return the times at which a counter (n,) changes and the values (n, k) jump."""
    sizes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    if not len(sizes):
        return []
    is_jump = sizes > JUMP * np.quantile(sizes, 0.95)
    return time[1:][is_jump & (np.diff(counter) != 0)].tolist()


def seconds(times: list[float]) -> str:
    """Return the first times as text."""
    more = f" and {len(times) - 5} more" if len(times) > 5 else ""
    return ", ".join(f"{time:.1f} s" for time in times[:5]) + more


def _mean_engine(log: Log, rule: Rule) -> Source | None:
    """Return the root mean square of the engines that drive, fields of the instances; None if none is logged.

    Thrusts go with the square of the speeds. It is at the times of the first of these, and left out where one
    of them tells no speed, before its first message or after its last. It is empty where none of several engines
    runs, or no speed is valid.
    """
    logged = []
    engines = {}
    for _, name, topic in log.instances(rule.topic):
        for field in rule.fields:
            if field in topic:
                logged.append(f"{name}.{field}")
                is_speed = is_valid(topic, rule) & np.isfinite(topic[field])
                if is_speed.any():
                    speed = rule.convert(topic[field][is_speed])
                    engines[logged[-1]] = (topic.time[is_speed], speed)
    if not logged:
        return None
    driving = {name: speed[~log.lifts(time)] for name, (time, speed) in engines.items()}
    # the only one stands in a glide
    names = tuple(engines) if len(logged) == 1 else fastest(driving)
    if not names:
        remark = f"{rule.topic}: no engine has valid speeds above zero"
        return Source(rule.columns, rule.topic, np.empty(0), np.empty((0, 1)), remark=remark)
    time, _ = engines[names[0]]
    speeds = [np.interp(time, *engines[name], left=np.nan, right=np.nan) for name in names]
    mean = np.sqrt(np.mean(np.square(speeds), axis=0))
    is_finite = np.isfinite(mean)
    note = f"root mean square of {len(names)} engines" if len(names) > 1 else ""
    return Source(
        rule.columns, " and ".join(names[:3]), time[is_finite], mean[is_finite, None], note
    )


def _readings(log: Log, instance: Instance, rule: Rule, use: Use | None) -> Readings:
    number, _, topic = instance
    values = rule.convert(topic.columns(rule.fields))
    valid = np.isfinite(values).all(axis=1) & is_valid(topic, rule)
    valid &= _is_used(log, rule, instance)
    used = np.zeros(len(topic), dtype=bool)
    if use is not None:
        used = valid & (_numbers(log, use, topic.time) == number + use.first)
        if use.is_measurement:
            valid = used
    confidence = 0.0
    if rule.preferred in topic:
        confidence = float(np.clip(np.nan_to_num(topic[rule.preferred]), 0.0, 1.0).mean())
    counter = np.zeros(len(topic))
    for field in rule.resets:
        if field in topic:
            counter += topic[field]
    return Readings(instance, values, valid, used, confidence, counter)


def _is_used(log: Log, rule: Rule, instance: Instance) -> bool:
    """Return whether the autopilot uses an instance, by its parameter if it has one."""
    use = 1
    if instance.number < len(rule.uses):
        use = whole(log.parameters.get(rule.uses[instance.number], 1.0))
    return use == 1 or (use > 1 and rule.preferred in instance.topic)


def _use(log: Log, rule: Rule, instances: list[Instance]) -> Use | None:
    """Return where the log says which of the instances the autopilot used, None if it does not."""
    for use in rule.used:
        numbers = _numbers(log, use, instances[0].topic.time)
        is_told = np.isin(numbers, [instance.number + use.first for instance in instances]).any()
        if len(numbers) and (use.is_measurement or is_told):
            return use
    return None


def _numbers(log: Log, use: Use, times: Vector) -> Vector:
    """Return the number of the instance that was used at each time, none if the log does not say."""
    if not use.topic:
        value = log.parameters.get(use.field)
        return np.empty(0) if value is None else np.full(len(times), value)
    for instance in log.instances(use.topic, least=1):
        if use.field in instance.topic:
            return instance.topic[use.field][last_before(instance.topic.time, times)]
    return np.empty(0)


def _unmeasured(rule: Rule, reading: Readings) -> str:
    """Return a remark on messages of a source that the log does not call measurements, with the fields that say so."""
    number, name, topic = reading.instance
    missing = 100 * (1 - reading.valid.mean())
    if missing == 0 or (missing < 100 and not rule.within):
        return ""
    fields = [field for field in rule.valid if field in topic]
    fields += rule.uses[number : number + 1]
    for field, _, _ in rule.within:
        if field in topic:
            fields.append(f"{field} {np.unique(topic[field]).astype(int).tolist()}")
    why = " ".join(fields) or "no number"
    return f"{rule.words} of {name}: {missing:.0f} % of the messages are no measurement and are left out ({why})"
