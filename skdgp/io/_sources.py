"""Sources of the columns of a flight table: topics by rules, instances of a sensor, servos; on one clock.

Of several instances the one counts that the autopilot used longest, while it did, else the healthiest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Mask, Matrix, Vector
from skdgp._flight.channels import CHANNELS, EARTH_VELOCITY, EULER, SENSOR_POSITION, SPECIFIC_FORCE
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
from skdgp.io._clock import resample, uniform_clock
from skdgp.io._log import (
    COMMANDED,
    DENSITY,
    EQUIVALENT,
    NOTHING,
    QUATERNION,
    Control,
    Instance,
    Log,
    Rule,
    Topic,
    Use,
    last_before,
    whole,
)
from skdgp.io._tables import FlightReadError

# a source slower than this [Hz] gives way to one further down that is not, or so many times as fast (guess)
LEAST_RATE = 5.0
LEAST_RATIO = 1.5
# of the clock, which follows the gyros [Hz]: rigid aircraft and surfaces move slower than 20 Hz
HIGHEST_RATE = 50.0
# mean speed of an engine that runs, over that of the fastest; a guess
LEAST_SPEED = 0.1
# corner of the smoothing of accelerations by velocities, in parts of the sampling rate
VELOCITY_CUTOFF = 0.2
# a reset of an estimator is a step beyond so many times what 95 % of the steps are; a guess
JUMP = 4.0
# columns whose instances are allocators in place of redundant sensors
COMMANDS = "throttle"
# the clock of a table follows the first of these
LEADERS = ("p", "ax", "qw")
# a source that ends so much and a step behind it [s] has late time stamps, as a log ends for all: in three logs 0.02 s
# at most
LATEST_END = 0.5


# field that says whether ArduPilot uses a sensor whose parameter says that it may (2)
IN_USE = "U"
# field of PX4's airspeed, from 0 to 1 by errors and age of the readings
CONFIDENCE = "confidence"
NONE = np.empty(0)


class Source(NamedTuple):
    """The source of columns, and its valid samples."""

    columns: tuple[str, ...]
    # topics, fields, and how they were chosen
    words: str
    time: Vector
    values: Matrix
    remark: str = ""
    # times [s] of resets
    cuts: Vector = NONE
    # number of the instance
    instance: int = 0

    @property
    def rate(self) -> float:
        """The usual rate [Hz] of two samples or more."""
        return float(1.0 / np.median(np.diff(self.time)))


class Candidate(NamedTuple):
    """The messages of one instance of a topic, in the columns of a rule."""

    instance: Instance
    values: Matrix
    valid: Mask
    # which of the valid ones the autopilot used
    used: Mask

    @property
    def rows(self) -> Mask:
        """The messages that count, (n,)."""
        return self.used if self.used.any() else self.valid

    def merit(self, duration: float) -> tuple[int, float, bool, float]:
        """Return the order of instances in a log of some duration [s].

        By messages that were used, the part of the log with valid ones, whether they move, and the mean of a flag or a
        confidence.
        """
        topic = self.instance.topic
        part = self.valid.mean() * np.ptp(topic.time) / duration
        moves = self.valid.any() and np.ptp(self.values[self.valid]) > 0
        told = [topic[field] for field in (IN_USE, CONFIDENCE) if field in topic]
        preference = np.clip(np.nan_to_num(told), 0.0, 1.0).sum() / len(topic)
        return int(self.used.sum()), round(part, 2), bool(moves), float(preference)


# -- topics by rules


def choose(log: Log, rule: Rule) -> Source | None:
    """Return the source of a rule's columns, or None if the log has none of its fields."""
    instances = log.instances(rule.topic)
    if rule.engines:
        return _engines(log, rule, instances)
    instances = [
        instance for instance in instances if {*rule.fields.split()} <= {*instance.topic.fields}
    ]
    if rule.columns == COMMANDS:
        instances = instances[:1]
    if not instances:
        return None
    use = _use(log, rule, instances)
    return _source_of(rule, [_candidate(log, instance, rule, use) for instance in instances], use)


def _source_of(rule: Rule, candidates: list[Candidate], use: Use | None) -> Source:
    """Return the source by the best of the instances."""
    duration = np.ptp([candidate.instance.topic.time[[0, -1]] for candidate in candidates])
    best = max(candidates, key=lambda candidate: candidate.merit(duration))
    number, name, topic = best.instance
    values = best.values[best.rows]
    if rule.columns == QUATERNION:
        values = without_sign_changes(values)
    notes = [rule.note] if rule.note else []
    if len(candidates) > 1:
        by = f"used by the autopilot: {use.words}" if use and best.used.any() else "the healthiest"
        notes.append(f"of {len(candidates)}, {by}")
    words = f"{name}.{rule.fields}"
    if notes:
        words += f" ({', '.join(notes)})"
    first = f"{rule.words} of {words}" if best is not candidates[0] else ""
    remark = "; ".join(filter(None, [first, *_left_out(rule, best, use)]))
    topic = topic.select(best.rows)
    cuts = _resets(rule, topic, values)
    return Source(tuple(rule.columns.split()), words, topic.time, values, remark, cuts, number)


def _resets(rule: Rule, topic: Topic, values: Matrix) -> Vector:
    """Return the times at which a counter of resets changes and the values (n, k) jump."""
    sizes = np.linalg.norm(np.diff(values, axis=0), axis=1)
    counters = [topic[field] for field in rule.resets.split() if field in topic]
    if not counters or not len(sizes):
        return NONE
    is_reset = np.diff(np.sum(counters, axis=0)) != 0
    is_jump = sizes > JUMP * np.quantile(sizes, 0.95)
    return topic.time[1:][is_jump & is_reset]


def _engines(log: Log, rule: Rule, instances: list[Instance]) -> Source | None:
    """Return the mean of the engines that drive, fields of the instances; None if too few are logged.

    It is at the times of the first of these, and left out where one of them tells nothing, before its
    first message or after its last. Of speeds it is the root of the mean square, and empty where none
    of several engines runs, or no speed is valid. A motor that only spins down after hover and transition is slower
    on average than `LEAST_SPEED` times the fastest.
    """
    engines = _engine_values(rule, instances)
    if not engines:
        return None
    table = pd.DataFrame(engines)
    names = [*table]
    if len(names) > 1:  # the only one stands in a glide
        means = table[~log.lifts(table.index.to_numpy())].abs().mean()
        names = [name for name in names if means[name] > LEAST_SPEED * means.max()]
    are_commands = rule.columns == COMMANDS
    if are_commands and len(names) < rule.engines:
        return None
    if table[names].empty:
        remark = f"{rule.topic}: no engine has valid speeds above zero"
        return Source((rule.columns,), rule.topic, NONE, NONE[:, None], remark)
    power = 1 if are_commands else 2
    known = table[names].interpolate("index", limit_area="inside").pow(power)
    mean = known.mean(axis=1, skipna=False).pow(1 / power)
    mean = mean[engines[names[0]].index].dropna()
    words = " and ".join(names[:3])
    if len(names) > 1:
        words += f" ({'mean' if are_commands else 'root mean square'} of {len(names)} engines)"
    return Source((rule.columns,), words, mean.index.to_numpy(), mean.to_numpy()[:, None])


def _engine_values(rule: Rule, instances: list[Instance]) -> dict[str, pd.Series]:
    """Return the valid speeds or commands of each engine by its times [s]."""
    engines = {}
    for _, name, topic in instances:
        for field in rule.fields.split():
            if field in topic:
                values = pd.Series(rule.convert(topic[field]), topic.time)
                rows = is_valid(topic, rule) & np.isfinite(values)
                engines[f"{name}.{field}"] = values[rows]
    return engines


def is_valid(topic: Topic, rule: Rule) -> Mask:
    """Return which messages the log calls valid measurements, by the fields that it has."""
    valid = np.ones(len(topic), bool)
    for field in rule.valid.split():
        if field in topic:
            valid &= topic[field] > 0
    for field, low, high in rule.within:
        if field in topic:
            valid &= (topic[field] >= low) & (topic[field] <= high)
    return valid


def _candidate(log: Log, instance: Instance, rule: Rule, use: Use | None) -> Candidate:
    number, _, topic = instance
    values = rule.convert(topic.columns(rule.fields.split()))
    valid = np.isfinite(values).all(axis=1) & is_valid(topic, rule)
    valid &= _is_used(log, rule, instance)
    used = np.zeros(len(topic), dtype=bool)
    if use is not None:
        used = valid & (_numbers(log, use, topic.time) == number + use.first)
        if use.is_measurement:
            valid = used
    return Candidate(instance, values, valid, used)


def _is_used(log: Log, rule: Rule, instance: Instance) -> bool:
    """Return whether the autopilot uses an instance, by its parameter if it has one."""
    parameter = dict(enumerate(rule.uses.split())).get(instance.number, "")
    use = whole(log.parameters.get(parameter, 1.0))
    return use == 1 or (use > 1 and IN_USE in instance.topic)


def _use(log: Log, rule: Rule, instances: list[Instance]) -> Use | None:
    """Return where the log says which of the instances the autopilot used, None if it does not."""
    for use in rule.used:
        numbers = _numbers(log, use, instances[0].topic.time)
        is_told = np.isin(numbers, [instance.number + use.first for instance in instances]).any()
        if is_told or (use.is_measurement and len(numbers)):
            return use
    return None


def _numbers(log: Log, use: Use, times: Vector) -> Vector:
    """Return the number of the instance that was used at each time, none if the log does not say."""
    if use.field in log.parameters and not use.topic:
        return np.full(len(times), log.parameters[use.field])
    for instance in log.instances(use.topic, least=1):
        if use.field in instance.topic:
            return instance.topic[use.field][last_before(instance.topic.time, times)]
    return NONE


def _left_out(rule: Rule, candidate: Candidate, use: Use | None) -> list[str]:
    """Return remarks on messages of a source that the autopilot did not use, or that the log calls no measurements."""
    number, name, topic = candidate.instance
    remarks = []
    missing = 1 - candidate.valid.mean()
    if missing == 1 or (missing and rule.within):
        fields = [
            field for field in rule.valid.split() if field in topic and topic[field].min() <= 0
        ]
        fields += rule.uses.split()[number : number + 1]
        for field, _, _ in rule.within:
            if field in topic:
                fields.append(f"{field} {np.unique(topic[field]).astype(int).tolist()}")
        why = " ".join(fields) or "no number"
        remarks.append(
            f"{100 * missing:.0f} % of the messages are left out, as the log calls them no measurement ({why})"
        )
    unused = (candidate.valid & ~candidate.rows).mean()
    if use and unused:
        remarks.append(
            f"{100 * unused:.0f} % of the messages are left out, as the autopilot used another ({use.words})"
        )
    return [f"{rule.words} of {name}: {remark}" for remark in remarks]


# -- all sources of a log


def find_sources(
    log: Log, controls: Mapping[str, tuple[str, Control]]
) -> tuple[list[Source], list[str]]:
    """Return the source of each group of columns, and remarks on these and on sources that are of no use.

    ``controls`` are notes on servos, and servos.
    """
    chosen: dict[str, Source] = {}
    remarks = []
    for rule in log.rules:
        source = choose(log, rule)
        if source is None:
            continue
        problem = _problem(source, rule)
        if problem:
            remarks.append(problem)
        elif rule.columns not in chosen or _is_clearly_faster(source, chosen[rule.columns]):
            chosen[rule.columns] = source
    sources = [source for columns, source in chosen.items() if columns not in controls]
    remarks += [source.remark for source in sources if source.remark]
    for name, (note, control) in controls.items():
        surface = _surface(log, name, note, control)
        if len(surface.time) > 1:
            sources.append(surface)
        else:
            remarks.append(surface.remark)
    return sources, remarks + _late(sources)


def _late(sources: list[Source]) -> list[str]:
    """Return a remark on the sources that end behind the one whose clock the table follows."""
    if not sources:
        return []
    leader = _leader(sources)
    latest = LATEST_END + 1.0 / leader.rate
    behind = {}
    for source in sources:
        seconds = source.time[-1] - leader.time[-1]
        if seconds > latest:
            behind[source.words] = f"{seconds:.1f} s"
    if not behind:
        return []
    late = ", ".join(f"{words} by {seconds}" for words, seconds in behind.items())
    return [
        f"{leader.words} ends first: either it was lost, or time stamps of others are late ({late})"
    ]


def _is_clearly_faster(source: Source, first: Source) -> bool:
    """Return whether a source is preferred to one further up that is slow."""
    return first.rate < LEAST_RATE and source.rate >= min(LEAST_RATE, LEAST_RATIO * first.rate)


def _problem(source: Source, rule: Rule) -> str:
    """Return why a source is of no use, or nothing."""
    if len(source.time) < 2:
        return source.remark or f"{source.words} has fewer than two values"
    limits = [POSSIBLE.get(name, (-np.inf, np.inf)) for name in rule.columns.split()]
    low, high = np.transpose(limits)
    is_impossible = (source.values < low) | (source.values > high)
    impossible = is_impossible.any(axis=1).mean()
    # fewer are faults of a sensor
    if impossible > RARE:
        return f"{source.words} cannot be {rule.words}: {100 * impossible:.0f} % is impossible"
    return ""


def _surface(log: Log, name: str, note: str, control: Control) -> Source:
    """Return a control by the channels of its servos, which are fields of one topic.

    Raises FlightReadError if the log lacks one.
    """
    topic = log.topics.get(control[0].topic, NOTHING)
    values = np.zeros(len(topic))
    for servo in control:
        if servo.field not in topic:
            expected = sorted(topic.fields) or [*log.outputs]
            raise FlightReadError(
                f"Got channel {servo.channel!r} for {name}, but the log has no such field: expected "
                f"one of {expected}."
            )
        deflection = servo.deflection(topic[servo.field])
        # an engine that is switched off gets no number
        values = values + (np.nan_to_num(deflection) if note == COMMANDED else deflection)
    channels = " ".join(servo.channel for servo in control)
    remark = f"{channels} sends no pulse, so there is no {name}"
    valid = np.isfinite(values)
    return Source((name,), f"{channels} ({note})", topic.time[valid], values[valid, None], remark)


# -- columns on one clock


def to_table(sources: list[Source], log: Log) -> tuple[pd.DataFrame, dict[str, tuple[str, float]]]:
    """Return all columns on one clock, in the order of the vocabulary, and words and rates [Hz] of their sources."""
    leader = _leader(sources)
    rate = float(f"{min(HIGHEST_RATE, leader.rate):.3g}")
    clock = uniform_clock(leader.time, rate)
    table = pd.DataFrame({"time": clock})
    origin: dict[str, tuple[str, float]] = {}
    for source in sources:
        columns = [*source.columns]
        values = resample(source.time, source.values, clock, rate)
        if columns == QUATERNION.split():
            columns = [*EULER]
            # a quaternion of zeros is none
            is_attitude = values.any(axis=1, keepdims=True)
            values = quaternion_to_euler(np.where(is_attitude, values, np.nan))
        table[columns] = values
        origin |= dict.fromkeys(columns, (source.words, source.rate))
        if source.columns == SPECIFIC_FORCE:
            _add_stated(table, origin, log, source.instance)
    if "density" not in table and "altitude" in table:
        table["density"] = standard_density(table["altitude"].clip(LOWEST, HIGHEST).to_numpy())
        origin["density"] = "altitude (standard atmosphere)", origin["altitude"][1]
    if EQUIVALENT in table:
        words, of_sensor = origin.pop(EQUIVALENT)
        note = "equivalent, taken for true: density unknown"
        table["airspeed"] = table[EQUIVALENT]
        if "density" in table:
            note = "equivalent; true by density"
            table["airspeed"] *= np.sqrt(DENSITY / table["density"])
        origin["airspeed"] = f"{words} ({note})", of_sensor
    if {*EARTH_VELOCITY, *EULER} <= {*table} and {*SPECIFIC_FORCE}.isdisjoint(table):
        _add_specific_force(table, origin)
    table = table[[name for name in CHANNELS if name in table]]
    return table.where(np.isfinite(table)), {name: origin[name] for name in table if name in origin}


def _leader(sources: list[Source]) -> Source:
    """Return the source whose clock the table follows: gyros, accelerometers, attitude, or the fastest."""
    for leader in LEADERS:
        for source in sources:
            if leader in source.columns:
                return source
    return max(sources, key=lambda source: source.rate)


def _add_stated(
    table: pd.DataFrame, origin: dict[str, tuple[str, float]], log: Log, instance: int
) -> None:
    """Add the position of the accelerometers, if the parameters state it, and an unknown tilt.

    Zeros, the default of autopilots, state nothing, and so do two of three.
    """
    for name in log.sensor_positions[instance : instance + 1]:
        place = [log.parameters.get(f"{name}_{axis}", np.nan) for axis in "XYZ"]
        if np.isfinite(place).all() and any(place):
            table[[*SENSOR_POSITION]] = place
            origin |= dict.fromkeys(SENSOR_POSITION, (f"{name}_X _Y _Z", np.nan))
    if log.sensor_tilt:
        table["sensor_tilt"] = log.sensor_tilt
        origin["sensor_tilt"] = "not stated by the log", np.nan


def _add_specific_force(table: pd.DataFrame, origin: dict[str, tuple[str, float]]) -> None:
    """Add the specific force that changes the velocity, f = R^T (v_dot - g), at the body's origin.

    It is for logs without an accelerometer, and has the bandwidth of the velocity: little above
    a fifth of its rate.
    """
    rate = min(origin[name][1] for name in EARTH_VELOCITY)
    velocity = table[[*EARTH_VELOCITY]].to_numpy()
    try:
        change = differentiate(velocity, table["time"].to_numpy(), cutoff=VELOCITY_CUTOFF * rate)
    # the clock of the log is not sound, which coefficients refuse themselves
    except ValueError:
        return
    attitude = euler_to_matrix(*table[[*EULER]].to_numpy().T)
    force = np.einsum("nji,nj->ni", attitude, change - [0.0, 0.0, STANDARD_GRAVITY])
    table[[*SPECIFIC_FORCE]] = force
    table[[*SENSOR_POSITION]] = 0.0
    words = "velocity and attitude, as no accelerometer is of use"
    origin |= dict.fromkeys((*SPECIFIC_FORCE, *SENSOR_POSITION), (words, rate))
