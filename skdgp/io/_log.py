"""Data that a log reader returns: topics with their clocks, rules from fields to columns, parameters."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, ArrayLike, Indices, Mask, Matrix, Vector
from skdgp._flight.atmosphere import SEA_LEVEL_DENSITY as DENSITY
from skdgp._flight.atmosphere import SEA_LEVEL_PRESSURE as PRESSURE

PART = re.compile(r"(\w+)(?:\[(\d+)\])?")
QUATERNION = (
    "qw",
    "qx",
    "qy",
    "qz",
)  # columns of a rule for attitude: body to north-east-down, of any length
EQUIVALENT = (
    "equivalent_airspeed"  # column of a rule for equivalent airspeed; the table gets the true one
)


@dataclass(frozen=True)
class Topic:
    """One message type over time, in the units of the log.

    Attributes
    ----------
    time : ndarray (n,)
        Time stamps [s] in the order of the file, as written: they may be wrong or out of order.
    order : ndarray (n,)
        Place of each message in the file, such as its first byte, by which topics are ordered.
    records : structured ndarray (n,)
        The fields. Elements of arrays and nested messages are ``q[0]``, ``esc[0].esc_rpm``.
    scale : dict
        Factors of fields that the format stores as scaled integers.
    """

    time: Vector
    order: Vector
    records: np.ndarray
    scale: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, time: ArrayLike, **fields: ArrayLike) -> Topic:
        """Return a topic of vectors (n,) or arrays (n, k) at increasing times [s].

        >>> import numpy as np
        >>> topic = Topic.of([0.0, 0.1], gyro=np.zeros((2, 3)), count=[1, 2])
        >>> topic.channels()
        ['gyro[0]', 'gyro[1]', 'gyro[2]', 'count']
        """
        time = np.asarray(time, dtype=float)
        arrays = {name: np.asarray(values, dtype=float) for name, values in fields.items()}
        records = np.empty(
            len(time), [(name, float, values.shape[1:]) for name, values in arrays.items()]
        )
        for name, values in arrays.items():
            records[name] = values
        return cls(time, time, records)

    def __len__(self) -> int:
        return len(self.time)

    def __contains__(self, name: str) -> bool:
        try:
            values = self._walk(self.records[:0], name)
        except (KeyError, IndexError, ValueError):
            return False
        return values.ndim == 1 and values.dtype.kind in "iufb"

    def __getitem__(self, name: str) -> Vector:
        """Return a field as floats, (n,)."""
        with np.errstate(all="ignore"):
            return self._walk(self.records, name).astype(float) * self.scale.get(name, 1.0)

    def _walk(self, values, name):
        if name in (values.dtype.names or ()):  # columns of a table, such as "q[0]"
            return values[name]
        for part in name.split("."):
            match = PART.fullmatch(part)
            if match is None:
                raise KeyError(name)
            values = values[match[1]]
            if match[2] is not None:
                values = values[:, int(match[2])]
        return values

    def columns(self, names: tuple[str, ...]) -> Matrix:
        """Return fields side by side, (n, k)."""
        return np.column_stack([self[name] for name in names])

    def select(self, rows: Indices | Mask) -> Topic:
        """Return the messages of some rows."""
        return Topic(self.time[rows], self.order[rows], self.records[rows], self.scale)

    def channels(self) -> list[str]:
        """Return the names of all numeric fields, arrays and nested messages by element."""
        return [name for name in _leaves(self.records.dtype) if name in self]


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


class ServoChannel(NamedTuple):
    """Channel that moves a surface, its values at both ends and at trim, and whether its sign is reversed."""

    channel: str
    low: float
    trim: float
    high: float
    turned: bool = False


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
    slowest_airspeed : float
        Slowest airspeed set on the autopilot [m/s]; NaN where none is.
    landed : tuple of (str, str, float) or None
        Topic, field, and its value while the autopilot is on the ground.
    outputs : tuple of str
        Topics that hold what was sent to servos.
    servos, mixing : dict
        By surface, what the parameters say of its servo; by control, weights of the outputs, each
        from -1 to 1, that make it together, such as those of a V-tail.
    """

    kind: str
    topics: dict[str, Topic]
    rules: tuple[Rule, ...] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    vehicle: str | None = None
    remarks: tuple[str, ...] = ()
    slowest_airspeed: float = np.nan
    landed: tuple[str, str, float] | None = None
    outputs: tuple[str, ...] = ()
    servos: Mapping[str, ServoChannel] = field(default_factory=dict)
    mixing: Mapping[str, tuple[tuple[float, ServoChannel], ...]] = field(default_factory=dict)

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
    """Return the nearest whole number, 0 of what is none."""
    return round(value) if np.isfinite(value) else 0


def gathered(data: bytes, starts: list[int], dtype: np.dtype) -> np.ndarray:
    """Return the messages of one type that start at these bytes, (n,)."""
    return np.frombuffer(
        b"".join([data[start : start + dtype.itemsize] for start in starts]), dtype
    )


def damage(skipped: int, cut: bool = False, lost: int = 0) -> tuple[str, ...]:
    """Return remarks on bytes that could not be read, messages of no topic, and a file that ends within a message."""
    remarks = {
        f"{skipped} bytes could not be read and were skipped": skipped,
        f"{lost} messages belong to no topic that the log defines": lost,
        "the file ends within a message: it was cut off": cut,
    }
    return tuple(words for words, found in remarks.items() if found)


def instance_name(name: str, instance: int) -> str:
    """Return the name of an instance of a topic."""
    return f"{name}#{instance}" if instance else name


def _leaves(dtype: np.dtype) -> Iterator[str]:
    for name in dtype.names or ():
        inner, shape = dtype[name].base, dtype[name].shape
        elements = [name] if not shape else [f"{name}[{i}]" for i in range(shape[0])]
        if inner.names is None:
            yield from elements
        else:
            yield from (f"{element}.{leaf}" for element in elements for leaf in _leaves(inner))
