"""Data that a log reader returns: topics with their clocks, rules from fields to columns, parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.interpolate import make_interp_spline

from skdgp._compute.typing import Array, ArrayLike, Indices, Mask, Matrix, Vector
from skdgp._flight.frames import SEA_LEVEL_DENSITY as DENSITY
from skdgp._flight.frames import SEA_LEVEL_PRESSURE as PRESSURE

QUATERNION = ("qw", "qx", "qy", "qz")  # of a rule for attitude: body to north-east-down, any length
EQUIVALENT = "equivalent_airspeed"  # of a rule for equivalent airspeed; the table gets the true one


NO_PULSE = 500.0  # pulses shorter than this [us] move no servo: an output that is switched off


@dataclass(frozen=True)
class Topic:
    """One message type over time, in the units of the log.

    Attributes
    ----------
    time : ndarray (n,)
        Time stamps [s] in the order of the file, as written: they may be wrong or out of order.
    order : ndarray (n,)
        Place of each message in the file, the order of all topics together.
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

    def columns(self, names: tuple[str, ...]) -> Matrix:
        """Return fields side by side, (n, k)."""
        return np.column_stack([self[name] for name in names])

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
        columns = {name: values}
        if values.ndim > 1:
            columns = {f"{name}[{i}]": column for i, column in enumerate(values.T)}
        numeric.update(columns)
    return numeric


class Rule(NamedTuple):
    """A rule: the fields of a topic that give columns of the flight table.

    Of several rules for the same columns the first one is used whose topic is logged, valid, and
    not slower than 5 Hz.

    Attributes
    ----------
    columns : tuple of str
        Columns of the flight table, or `QUATERNION`, or `EQUIVALENT`.
    topic : str
        Name of the topic, without the number of an instance.
    fields : tuple of str
        Fields of the topic.
    convert : callable
        Maps fields (n, len(fields)) to columns (n, len(columns)) in SI units; default: as they are.
    valid : tuple of str
        Fields that, where the log has them, are positive where the others are valid.
    note : str
        Remark on the source, shown with it.
    """

    columns: tuple[str, ...]
    topic: str
    fields: tuple[str, ...]
    convert: Callable[[Matrix], Matrix] = np.asarray
    valid: tuple[str, ...] = ()
    note: str = ""


class Servo(NamedTuple):
    """The channel that moves a surface, and the angles of the surface at some values of the channel."""

    channel: str  # topic and field, ``RCOU.C2`` or ``actuator_outputs#1.output[0]``
    inputs: tuple[float, ...]  # values of the channel, increasing
    #: Angles there [rad], or parts of the full throw; straight lines between them and beyond
    angles: tuple[float, ...]

    def deflection(self, values: Vector) -> Vector:
        """Return angles of values of the channel; NaN where no pulse was sent."""
        if self.inputs[0] >= NO_PULSE:
            values = np.where(values < NO_PULSE, np.nan, values)
        return make_interp_spline(self.inputs, self.angles, k=1)(values)


UP, DOWN = (-1.0, 0.0, 1.0), (1.0, 0.0, -1.0)  # full throws of a servo, and of one that is turned
# Weights of servos of one topic, whose deflections add up to a control, as of a V-tail
Control: TypeAlias = tuple[tuple[float, Servo], ...]


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
    landed : tuple of (str, str, float) or None
        Topic, field, and its value while the autopilot is on the ground.
    outputs : tuple of str
        Topics with the outputs to servos.
    controls : dict of str to Control
        Servos of each surface by the parameters, -1 to 1 from end to end and 0 at trim, with
        weights of those that make a control together, as of a V-tail.
    """

    kind: str
    topics: dict[str, Topic]
    rules: tuple[Rule, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    vehicle: str | None = None
    remarks: tuple[str, ...] = ()
    landed: tuple[str, str, float] | None = None
    outputs: tuple[str, ...] = ()
    controls: Mapping[str, Control] = field(default_factory=dict)

    def find(self, name: str) -> str | None:
        """Return the name of the first instance of a topic that has messages, or None."""
        instances = [
            key for key in self.topics if key.split("#")[0] == name and len(self.topics[key]) > 1
        ]
        return min(instances, key=lambda key: int(key.partition("#")[2] or 0), default=None)


def from_rpm(values: Array) -> Array:
    """Return rad/s of revolutions per minute."""
    return values * (np.pi / 30)


def density_at(pressure: Array) -> Array:
    """Return the density [kg/m^3] at a pressure [Pa] of the standard atmosphere below 11 km (ISO 2533)."""
    return DENSITY * np.maximum(pressure / PRESSURE, 0.0) ** (1 - 1 / 5.25588)


def whole(value: float) -> int:
    """Return the nearest whole number, 0 for NaN and infinity."""
    return round(value) if np.isfinite(value) else 0


def damage(skipped: int = 0, cut: bool = False, lost: int = 0) -> tuple[str, ...]:
    """Return remarks on skipped bytes, lost messages, and a file that ends within a message."""
    remarks = {
        f"{skipped} bytes could not be read and were skipped": skipped,
        f"{lost} messages do not fit the definition of their topic and were skipped": lost,
        "the file ends within a message: it was cut off": cut,
    }
    return tuple(remark for remark, applies in remarks.items() if applies)


def instance_name(name: str, instance: int) -> str:
    """Return the name of an instance of a topic."""
    return f"{name}#{instance}" if instance else name
