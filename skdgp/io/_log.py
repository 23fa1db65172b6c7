"""Data that a log reader returns: topics with their clocks, rules from fields to columns, parameters, servos."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.interpolate import make_interp_spline

from skdgp._compute.files import read_toml
from skdgp._compute.typing import Array, ArrayLike, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, EULER, HIGH_LIFT
from skdgp._flight.frames import SEA_LEVEL_DENSITY as DENSITY
from skdgp._flight.frames import SEA_LEVEL_PRESSURE as PRESSURE
from skdgp._flight.servo_functions import NO_PULSE
from skdgp.io._tables import FlightReadError

# of a rule for attitude: body to north-east-down, any length
QUATERNION = "qw qx qy qz"
# of rules for inertial sensors
INERTIAL = ("p q r", "ax ay az")
# of a rule for equivalent airspeed; the table gets the true one
EQUIVALENT = "equivalent_airspeed"
NOT_FLYING_ON_WINGS = (
    "multicopter", "helicopter", "rover", "boat", "submarine", "airship", "antenna tracker", "tailsitter",
)  # fmt: skip


@dataclass(frozen=True)
class Topic:
    """One message type over time, in the units of the log.

    Attributes
    ----------
    time : ndarray (n,)
        Time stamps [s] in the order of the file, as written: they may be wrong or out of order.
    order : ndarray (n,)
        Place of each message in the file, the order of all topics together; of PX4 the time.
    fields : dict of str to ndarray (n,)
        Numbers by name. Elements of arrays and nested messages are ``q[0]``, ``esc[0].esc_rpm``.
    """

    time: Vector
    order: Vector
    fields: dict[str, np.ndarray]

    @classmethod
    def of(cls, time: ArrayLike, **fields: ArrayLike) -> Topic:
        """Return a topic of vectors (n,) or arrays (n, k) at increasing times [s].

        >>> import numpy as np
        >>> topic = Topic.of([0.0, 0.1], gyro=np.zeros((2, 3)), count=[1, 2])
        >>> list(topic.fields)
        ['gyro[0]', 'gyro[1]', 'gyro[2]', 'count']
        """
        time = np.asarray(time, dtype=float)
        return cls(time, time, numeric_fields(fields))

    def __len__(self) -> int:
        return len(self.time)

    def __contains__(self, name: str) -> bool:
        return name in self.fields

    def __getitem__(self, name: str) -> Vector:
        """Return a field as floats, (n,)."""
        return self.fields[name].astype(float)

    def columns(self, names: Iterable[str]) -> Matrix:
        """Return fields side by side, (n, k)."""
        return np.column_stack([self[name] for name in names])

    def with_fields(self, **fields: np.ndarray) -> Topic:
        """Return the messages with further fields."""
        return Topic(self.time, self.order, self.fields | fields)

    def select(self, rows: Indices | Mask) -> Topic:
        """Return the messages of some rows."""
        fields = {name: values[rows] for name, values in self.fields.items()}
        return Topic(self.time[rows], self.order[rows], fields)


def numeric_fields(fields: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    """Return the fields that hold numbers; arrays (n, k) element by element."""
    numeric = {}
    for name, values in fields.items():
        values = np.asarray(values)
        if values.dtype.kind not in "iufb":
            continue
        if values.ndim == 1:
            numeric[name] = values
        else:
            for i, column in enumerate(values.T):
                numeric[f"{name}[{i}]"] = column
    return numeric


# in place of a topic that is not logged
NOTHING = Topic(np.empty(0), np.empty(0), {})


class Use(NamedTuple):
    """Where a log says which instance of a sensor the autopilot used."""

    #: Topic of the field, empty for a parameter
    topic: str
    field: str
    #: Number in the field of the instance 0
    first: int = 0
    #: Whether a number of no instance means that nothing was measured
    is_measurement: bool = False

    @property
    def words(self) -> str:
        """Name of the field or parameter."""
        return f"{self.topic}.{self.field}" if self.topic else self.field


def last_before(time: Vector, at: Vector) -> Indices:
    """Return the last of increasing times at or before each time, the first where there is none."""
    return np.maximum(np.searchsorted(time, at, side="right") - 1, 0)


class Instance(NamedTuple):
    """One instance of a topic."""

    number: int
    name: str
    topic: Topic


class Rule(NamedTuple):
    """A rule: the fields of a topic that give columns of the flight table.

    Of several rules for the same columns the first one is used whose topic is logged, valid, and
    not slower than 5 Hz.

    Attributes
    ----------
    columns : str
        Columns of the flight table, or qw qx qy qz of the attitude, body to north-east-down, or
        equivalent_airspeed, of which the table gets the true one. Several names, here and below, have
        blanks between them.
    topic : str
        Name of the topic, without the number of an instance.
    fields : str
        Fields of the topic.
    convert : callable
        Maps fields (n, k) to columns (n, m) in SI units; default: as they are.
    valid : str
        Fields that, where the log has them, are positive where the others are valid.
    note : str
        Remark on the source, shown with it.
    within : tuple of (str, float, float)
        Fields that, where the log has them, are within these limits where the others are valid.
    used : tuple of Use
        Where the log says which instance the autopilot used; the first that is logged counts.
    resets : str
        Counters of an estimator's resets.
    engines : int
        Least number of engines that run, of fields which are engines; ``convert`` takes one. The column is the
        root mean square of speeds, with which thrust goes, and the mean of commands.
    uses : str
        Parameters by which the autopilot uses an instance, by its number: always (1), or under
        conditions (2), which the flag ``U`` then tells.
    """

    columns: str
    topic: str
    fields: str
    convert: Callable[[Matrix], Matrix] = np.asarray
    valid: str = ""
    note: str = ""
    within: tuple[tuple[str, float, float], ...] = ()
    used: tuple[Use, ...] = ()
    resets: str = ""
    uses: str = ""
    engines: int = 0

    @property
    def words(self) -> str:
        """Names of the columns of the flight table."""
        if self.columns == QUATERNION:
            return " ".join(EULER)
        return self.columns.replace(EQUIVALENT, "airspeed")


class Servo(NamedTuple):
    """The channel that moves a surface, and the angles of the surface at some values of the channel."""

    #: Topic and field, ``RCOU.C2`` or ``actuator_outputs#1.output[0]``
    channel: str
    #: Values of the channel, increasing
    inputs: tuple[float, ...]
    #: Angles there [rad], or parts of the full throw; straight lines between them and beyond
    angles: tuple[float, ...]

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.channel.split(".", 1)[0]

    @property
    def field(self) -> str:
        """Name of the field of the topic."""
        return self.channel.removeprefix(f"{self.topic}.")

    def deflection(self, values: Vector) -> Vector:
        """Return angles of values of the channel; NaN where no pulse was sent."""
        if self.inputs[0] >= NO_PULSE:
            values = np.where(values < NO_PULSE, np.nan, values)
        return make_interp_spline(self.inputs, self.angles, k=1)(values)

    def times(self, factor: float) -> Servo:
        """Return the servo with angles times a factor."""
        return self._replace(angles=tuple(factor * angle for angle in self.angles))


# full throws of a servo, and of one that is turned
UP = (-1.0, 0.0, 1.0)
DOWN = UP[::-1]
# of one that moves to one side alone
OPENING = (0.0, 1.0)
# Topic, field and its limits while a vehicle is in some state
States: TypeAlias = tuple[tuple[str, str, float, float], ...]
# Servos of one topic, whose weighted deflections add up to a control, as of a V-tail
Control: TypeAlias = tuple[Servo, ...]


@dataclass(frozen=True)
class Log:
    """A log of an autopilot.

    Attributes
    ----------
    kind : str
        The format: ``"PX4 ULog"``, ``"ArduPilot DataFlash"``.
    topics : dict of str to Topic
        By name; further instances as ``name#1``, ``name#2``.
    rules : tuple of Rule
        Columns that the format knows, preferred sources first.
    parameters : dict of str to float
        Settings of the autopilot.
    firmware, vehicle : str
        Name and version; ``"fixed wing"``, ``"VTOL"``, ``"multicopter"``, ..., or None where the
        log does not say.
    remarks : tuple of str
        Damage of the file: bytes that could not be read, where it was cut off.
    landed : tuple of (str, str, float, float)
        Topic, field and its limits while the autopilot is on the ground; none where it does not say.
    outputs : tuple of str
        Topics with the outputs to servos.
    naming : str
        What names the surfaces that the outputs move.
    controls : dict of str to Control
        Servos of each surface by the parameters, -1 to 1 from end to end and 0 at trim. Angles of several that make
        a control together, as of a V-tail, add up.
    aliases : dict of str to str
        Names of topics that are further instances of another, as ``ASP2`` of ``ARSP``.
    lifting : tuple of (str, str, float, float)
        Topic, field and its limits while rotors carry a VTOL, or in transition; none of other vehicles.
    commands : dict of str to Control
        Outputs that need no angles: the throttle of the left less the right engine.
    sensor_positions : tuple of str
        Parameters _X, _Y, _Z of the position of each instance of the inertial sensors, forward, right, down of the
        origin of the body axes, the centre of gravity [m].
    sensor_tilt : float
        Standard deviation of their roll and pitch against the attitude [rad]; zero where it is known.
    """

    kind: str
    topics: dict[str, Topic]
    rules: tuple[Rule, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    vehicle: str | None = None
    remarks: tuple[str, ...] = ()
    landed: States = ()
    outputs: tuple[str, ...] = ()
    naming: str = ""
    controls: Mapping[str, Control] = field(default_factory=dict)
    aliases: Mapping[str, str] = field(default_factory=dict)
    lifting: States = ()
    commands: Mapping[str, Control] = field(default_factory=dict)
    sensor_positions: tuple[str, ...] = ()
    sensor_tilt: float = 0.0

    @property
    def has_wings(self) -> bool:
        """Whether the vehicle may fly on wings: only other kinds are excluded."""
        return self.vehicle not in NOT_FLYING_ON_WINGS

    def instances(self, name: str, least: int = 2) -> list[Instance]:
        """Return the instances of a topic that have so many messages, by number."""
        further = self.aliases.get(name, "").split()
        instances = []
        for key, topic in self.topics.items():
            base, _, number = key.partition("#")
            if len(topic) >= least and base == name:
                instances.append(Instance(int(number or 0), key, topic))
            elif len(topic) >= least and key in further:
                instances.append(Instance(1 + further.index(key), key, topic))
        return sorted(instances)

    def lifts(self, time: Vector) -> Mask:
        """Return whether rotors lift a VTOL or it is in transition, (n,); False of other vehicles."""
        return rows_in(self.lifting, self.topics, time)

    def lands(self, time: Vector) -> Mask:
        """Return whether the autopilot reports to be on the ground, (n,)."""
        return rows_in(self.landed, self.topics, time)


def rows_in(states: States, topics: Mapping[str, Topic], time: Vector) -> Mask:
    """Return where a field of one of the states is within its limits, (n,)."""
    rows = np.zeros(len(time), dtype=bool)
    for name, field_name, low, high in states:
        topic = topics.get(name, NOTHING)
        if field_name in topic:
            values = topic[field_name][last_before(topic.time, time)]
            rows |= (values >= low) & (values <= high)
    return rows


def turned(
    rules: Iterable[Rule], rotation: Matrix, note: str, topics: Collection[str] = ()
) -> tuple[Rule, ...]:
    """Return rules whose inertial sensors are turned by a rotation (3, 3), from axes of the board to body axes.

    Those of all ``topics`` if none is given.
    """
    if np.allclose(rotation, np.eye(3), atol=1e-9):
        return tuple(rules)
    converted = []
    for rule in rules:
        is_of_board = not topics or rule.topic in topics
        if rule.columns in INERTIAL and is_of_board:
            convert = partial(_turned, rule.convert, rotation)
            rule = rule._replace(convert=convert, note=rule.note or note)
        converted.append(rule)
    return tuple(converted)


def _turned(convert: Callable[[Matrix], Matrix], rotation: Matrix, fields: Matrix) -> Matrix:
    """Return converted fields (n, 3) in other axes."""
    return convert(fields) @ rotation.T


def scaling(factor: float) -> Callable[[Array], Array]:
    """Return the conversion of a rule that multiplies fields by a factor."""
    return partial(np.multiply, factor)


from_rpm = scaling(np.pi / 30)  # revolutions per minute to rad/s


milli = scaling(1e-3)
centi = scaling(0.01)


def density_at(pressure: Array) -> Array:
    """Return the density [kg/m^3] at a pressure [Pa] of the standard atmosphere below 11 km (ISO 2533)."""
    return DENSITY * np.maximum(pressure / PRESSURE, 0.0) ** (1 - 1 / 5.25588)


def whole(value: float) -> int:
    """Return the nearest whole number, 0 for NaN and infinity."""
    return round(value) if np.isfinite(value) else 0


def damage(skipped: int = 0, cut: bool = False) -> tuple[str, ...]:
    """Return remarks on skipped bytes, and on a file that ends within a message."""
    remarks = []
    if skipped:
        remarks.append(f"{skipped} bytes could not be read and were skipped")
    if cut:
        remarks.append("the file ends within a message: it was cut off")
    return tuple(remarks)


def instance_name(name: str, instance: int) -> str:
    """Return the name of an instance of a topic."""
    return f"{name}#{instance}" if instance else name


def in_force(
    changes: Iterable[tuple[float, str, float]], topics: Mapping[str, Topic]
) -> dict[str, float]:
    """Return the value of each parameter in the middle of a log, of (time [s], name, value) in order; NaN are none.

    One that is set later alone has its first value.
    """
    # single time stamps may be wrong
    middle = np.nanmedian(np.concatenate([topic.time for topic in topics.values()]))
    parameters: dict[str, float] = {}
    for time, name, value in changes:
        if np.isfinite(value) and (time <= middle or name not in parameters):
            parameters[name] = float(value)
    return parameters


# -- servo files (TOML): pulse widths to surface angles; mixing by the parameters of the autopilot

COMMANDED = "as commanded"
IN_THROWS = "in parts of the full throw"
BY_FILE = "by the servo file"
MOVED = (*ALL_SURFACES, *HIGH_LIFT, "throttle")
# What stands for a servo file where none is at hand: surfaces in parts of their full throw, -1 to
# 1; with ", reversed rudder" after it, some of the other sign than the autopilot's parameters say
FULL_THROW = "full throw"
REVERSED = ", reversed "
THROW = re.compile(r"(-?\d+\.?\d*|-?\.\d+) ?(deg|rad)")


def read_servos(
    servos: str | Path | Mapping[str, Any] | None,
) -> dict[str, Servo | float]:
    r"""Return a calibration, one entry for each surface, from a TOML file or a mapping.

    ``[elevator]`` has ``channel`` and ``points``, a list of pairs (value of the channel, angle in
    rad), with straight lines between them and beyond. Or in one line the angle at full throw [rad],
    ``elevator = "25 deg"``, of the servos that the autopilot's parameters name.

    Raises FlightReadError if the file is no TOML, or a surface or number makes no sense.

    Examples
    --------
    >>> read_servos({"rudder": {"channel": "RCOU.C4", "points": [[1100, -0.3], [1900, 0.3]]}})
    {'rudder': Servo(channel='RCOU.C4', inputs=(1100.0, 1900.0), angles=(-0.3, 0.3))}
    """
    if servos is None:
        return {}
    if isinstance(servos, (str, Path)):
        try:
            servos = read_toml(servos)
        except ValueError as error:
            message = f"Got {servos} as the servo file, but expected TOML: {error}"
            raise FlightReadError(message) from error
    return {name: _servo(name, entry) for name, entry in servos.items()}


def reversed_of(servos: Any) -> tuple[str, ...] | None:
    """Return the surfaces of other sign that servos in parts of the full throw have; None of a servo file.

    Raises FlightReadError if one is no surface.

    Examples
    --------
    >>> reversed_of("full throw, reversed rudder aileron"), reversed_of("full throw"), reversed_of("servo.toml")
    (('rudder', 'aileron'), (), None)
    """
    if not isinstance(servos, str):
        return None
    words, *reversed_names = servos.split(REVERSED, 1)
    if words != FULL_THROW:
        return None
    names = " ".join(reversed_names).split()
    strange = {*names} - {*ALL_SURFACES}
    if strange:
        raise FlightReadError(
            f"Got {sorted(strange)} as reversed, but expected some of {list(ALL_SURFACES)}."
        )
    return tuple(names)


def full_throws(log: Log, turned: Collection[str] = ()) -> dict[str, Control]:
    """Return the servos that the parameters of an autopilot name, -1 to 1 from end to end and 0 at trim.

    Surfaces in ``turned`` have the other sign. Where the parameters say how controls are mixed,
    these are elevator, aileron and rudder of any tail and wing. Raises FlightReadError if there are
    none.
    """
    if not log.controls:
        raise FlightReadError(lacking_servos(log))
    for name, control in log.controls.items():
        for servo in control:
            if not _increases(servo.inputs):
                raise FlightReadError(
                    f"Got min, trim, max of {name} on {servo.channel} {servo.inputs}, but expected them in "
                    "this order: write the servo file by hand."
                )
    of_turned = {name: scaled(log.controls[name], -1.0) for name in turned if name in log.controls}
    return {**log.controls, **of_turned}


def no_wings(log: Log) -> str:
    """Return the message that a vehicle does not fly on wings."""
    return (
        f"Got a log of a {log.vehicle}, but expected a fixed wing: if it has wings, correct the vehicle "
        "type on the autopilot."
    )


def lacking_servos(log: Log) -> str:
    """Return the message that nothing in a log tells which outputs move surfaces."""
    if not log.has_wings:
        return no_wings(log)
    has_outputs = any(name in log.topics for name in log.outputs)
    outputs = "" if has_outputs else f"some of {[*log.outputs]} and "
    return (
        f"Got a log without parameters that name the surfaces of its outputs, but expected {outputs}{log.naming}: "
        "log them, or write the servo file by hand."
    )


def _increases(inputs: ArrayLike) -> bool:
    """Return whether each value is more than the one before it."""
    return bool((np.diff(inputs) > 0).all())


def controls_of(servos: Any, log: Log) -> dict[str, tuple[str, Control]]:
    """Return a note on each control and its servos: commands, and those of a servo file or by the parameters.

    Raises FlightReadError if the parameters lack a servo of which the file has a throw.
    """
    controls = {name: (COMMANDED, control) for name, control in log.commands.items()}
    turned = reversed_of(servos)
    if turned is not None:
        throws = full_throws(log, turned)
        return controls | {name: (IN_THROWS, control) for name, control in throws.items()}
    entries = read_servos(servos)
    has_throws = any(isinstance(entry, float) for entry in entries.values())
    named = full_throws(log) if has_throws else {}
    for name, entry in entries.items():
        control = (entry,) if isinstance(entry, Servo) else scaled(named.get(name, ()), entry)
        if not control:
            raise FlightReadError(
                f"Got the full throw of {name!r}, but expected surfaces that the parameters of "
                f"the log name, {sorted(named)}: give the channel of the others."
            )
        controls[name] = BY_FILE, control
    return controls


def scaled(control: Control, factor: float) -> Control:
    """Return a control with angles times a factor."""
    return tuple(servo.times(factor) for servo in control)


def _servo(name: str, entry: Any) -> Servo | float:
    """Return the entry of a surface: its servo, or the angle at full throw [rad]."""
    if name not in MOVED:
        raise FlightReadError(f"Got {name!r} in the servo file, but expected one of {list(MOVED)}.")
    if isinstance(entry, str):
        return _throw(name, entry)
    try:
        channel = entry["channel"]
        inputs, angles = np.array(sorted(entry["points"]), dtype=float).T
        is_sound = (
            {*entry} == {"channel", "points"}
            and isinstance(channel, str)
            and len(inputs) > 1
            and _increases(inputs)
            and np.abs(angles).max() <= np.pi / 2
        )
    except (KeyError, TypeError, ValueError, OverflowError):
        is_sound = False
    if not is_sound:
        raise FlightReadError(
            f"Got {name} = {entry}, but expected a channel and points alone. These are two or more "
            "pairs of numbers, values of the channel, each once, and angles in radians, at most pi/2: "
            'channel = "RCOU.C2", points = [[1100, -0.35], [1900, 0.35]].'
        )
    return Servo(channel, tuple(inputs.tolist()), tuple(angles.tolist()))


def _throw(name: str, text: str) -> float:
    """Return the angle at full throw [rad], of a text such as "25 deg"; "-25 deg" turns the sign of the parameters."""
    match = THROW.fullmatch(text.strip())
    number, unit = match.groups() if match else (0, "rad")
    angle = float(number) * (np.pi / 180 if unit == "deg" else 1.0)
    if not 0 < abs(angle) <= np.pi / 2:
        raise FlightReadError(
            f'Got {name} = {text!r}, but expected the angle at full throw, up to 90 degrees, as in {name} = "25 deg", '
            'or "-25 deg" for the other sign than the parameters say.'
        )
    return angle
