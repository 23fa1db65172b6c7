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
    time: Vector
    values: Matrix
    valid: Mask
    # 0 to 1: flags, or a confidence
    preferred: Vector
    # 0 where resets are not logged
    counter: Vector
    # which of the valid ones the autopilot used
    used: Mask

    def health(self, duration: float) -> tuple[float, bool, float]:
        """Order of instances in a log of some duration [s]: valid readings, that move, the autopilot's flag."""
        share = float(self.valid.mean()) * np.ptp(self.time) / duration
        moves = self.valid.any() and np.ptp(self.values[self.valid]) > 0
        return round(share, 2), bool(moves), float(self.preferred.mean())


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
    readings = [_readings(log, instance, rule, use) for instance in instances]
    return _source_of(rule, readings, use)


def _source_of(rule: Rule, readings: list[Readings], use: Use | None) -> Source:
    """Return the source by the instances that were used, or if that is not known by the healthiest."""
    duration = np.ptp([reading.time[[0, -1]] for reading in readings])
    best = max(readings, key=lambda reading: reading.health(duration))
    chosen = [reading._replace(valid=reading.used) for reading in readings if reading.used.any()]
    time, values, counter = _merged(chosen or [best])
    names = [reading.instance.name for reading in chosen or [best]]
    note = _joined(", ", rule.note, _note(readings, use if chosen else None))
    is_first = names == [readings[0].instance.name]
    name = _words(rule, names)
    remarks = ["" if is_first else f"{rule.words} of {name} ({note})", _unmeasured(rule, best)]
    if rule.columns == QUATERNION:
        values = without_sign_changes(values)
    cuts = reset_times(time, values, counter)
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
        remark=_joined("; ", *remarks),
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


def _joined(separator: str, *texts: str) -> str:
    """Return the texts that are not empty, joined."""
    return separator.join(filter(None, texts))


def _words(rule: Rule, names: list[str]) -> str:
    """Return the name of a source: its instances and fields."""
    return f"{' and '.join(names[:3])}.{' '.join(rule.fields)}"


def _mean_engine(log: Log, rule: Rule) -> Source | None:
    """Return the root mean square of the engines that drive, fields of the instances; None if of several none runs.

    Thrusts go with the square of the speeds. It is at the times of the first of these, and left out where one
    of them tells no speed, before its first message or after its last. It is empty, with a remark, where no
    engine tells a speed.
    """
    engines = {}
    flags: set[str] = set()
    for instance in log.instances(rule.topic):
        valid = is_valid(instance.topic, rule)
        flags |= {*rule.valid} & {*instance.topic.fields}
        for field in rule.fields:
            if field in instance.topic:
                is_speed = valid & np.isfinite(instance.topic[field])
                valid_messages = instance.topic.select(is_speed)
                speed = rule.convert(valid_messages[field])
                engines[f"{instance.name}.{field}"] = (valid_messages.time, speed)
    with_speed = {name: (time, speed) for name, (time, speed) in engines.items() if len(time)}
    if engines and not with_speed:
        name = " and ".join([*engines][:3])
        remark = ""
        if flags:
            remark = (
                f"{rule.words} of {name}: 100 % of the messages are no measurement and are left out "
                f"({' '.join(sorted(flags))})"
            )
        return Source(rule.columns, name, np.empty(0), np.empty((0, 1)), remark=remark)
    speeds_of_flight = {name: speed[~log.lifts(time)] for name, (time, speed) in with_speed.items()}
    # the only one stands in a glide
    names = tuple(engines) if len(engines) == 1 else fastest(speeds_of_flight)
    if not names:
        return None
    time, _ = engines[names[0]]
    speeds = [np.interp(time, *engines[name], left=np.nan, right=np.nan) for name in names]
    mean = np.sqrt(np.mean(np.square(speeds), axis=0))
    is_finite = np.isfinite(mean)
    note = f"root mean square of {len(names)} engines" if len(names) > 1 else ""
    return Source(
        rule.columns, " and ".join(names[:3]), time[is_finite], mean[is_finite, None], note
    )


def _readings(log: Log, instance: Instance, rule: Rule, use: Use | None) -> Readings:
    topic = instance.topic
    n = len(topic)
    values = rule.convert(topic.columns(rule.fields))
    is_used = _is_used(log, rule, instance)
    valid = np.isfinite(values).all(axis=1) & is_valid(topic, rule) & is_used
    used = np.zeros(n, dtype=bool)
    if use is not None:
        used = valid & (_numbers(log, use, topic.time) == instance.number + use.first)
        if use.is_measurement:
            valid = used
    preferred = np.zeros(n)
    for field in rule.preferred:
        if field in topic:
            preferred = np.maximum(preferred, np.clip(np.nan_to_num(topic[field]), 0.0, 1.0))
    counter = np.zeros(n)
    for field in rule.resets:
        if field in topic:
            counter = counter + topic[field]
    return Readings(instance, topic.time, values, valid, preferred, counter, used)


def _is_used(log: Log, rule: Rule, instance: Instance) -> bool:
    """Return whether the autopilot uses an instance, by its parameter if it has one."""
    use = 1
    if instance.number < len(rule.uses):
        use = whole(log.parameters.get(rule.uses[instance.number], 1.0))
    return use == 1 or (use > 1 and any(flag in instance.topic for flag in rule.preferred))


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


def _note(readings: list[Readings], use: Use | None) -> str:
    """Return how the source was chosen, nothing where there is no choice."""
    if len(readings) < 2:
        return ""
    words = "the healthiest" if use is None else f"used by the autopilot: {use.words}"
    return f"of {len(readings)}, {words}"


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
