"""The log that a reader returns: topics with their clocks, parameters, information."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

PART = re.compile(r"(\w+)(?:\[(\d+)\])?")


@dataclass(frozen=True)
class Topic:
    """One message type over time, in the units of the log.

    Attributes
    ----------
    time : ndarray of shape (n,)
        Time stamps [s] in the order of the file, as they were written: perhaps wrong, perhaps out of order.
    order : ndarray of shape (n,)
        Where in the file each message stands (in bytes, say), which tells the order between topics.
    records : structured ndarray of shape (n,)
        The fields. Arrays and nested messages are read as ``q[0]``, ``esc[0].esc_rpm``.
    scale : dict
        Factors of fields that the format stores as scaled integers.
    """

    time: np.ndarray
    order: np.ndarray
    records: np.ndarray
    scale: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, time, **fields) -> Topic:
        """Return a topic of vectors (n,) or arrays (n, k), whose messages stand in the order of their times.

        >>> import numpy as np
        >>> topic = Topic.of([0.0, 0.1], gyro=np.zeros((2, 3)), count=[1, 2])
        >>> topic.channels()
        ['gyro[0]', 'gyro[1]', 'gyro[2]', 'count']
        """
        time = np.asarray(time, dtype=float)
        arrays = {name: np.asarray(values, dtype=float) for name, values in fields.items()}
        records = np.empty(len(time), [(name, float, values.shape[1:]) for name, values in arrays.items()])
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

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a field as floats, (n,)."""
        with np.errstate(all="ignore"):
            return self._walk(self.records, name).astype(float) * self.scale.get(name, 1.0)

    def _walk(self, values, name):
        for part in name.split("."):
            match = PART.fullmatch(part)
            if match is None:
                raise KeyError(name)
            values = values[match[1]]
            if match[2] is not None:
                values = values[:, int(match[2])]
        return values

    def columns(self, names) -> np.ndarray:
        """Return fields side by side, (n, k)."""
        return np.column_stack([self[name] for name in names])

    def taken(self, rows) -> Topic:
        """Return the messages of some rows."""
        return Topic(self.time[rows], self.order[rows], self.records[rows], self.scale)

    def channels(self) -> list[str]:
        """Return the names of all numeric fields, arrays and nested messages by element."""
        return [name for name in _leaves(self.records.dtype) if name in self]


@dataclass(frozen=True)
class Log:
    """A log as its format has it.

    Attributes
    ----------
    kind : str
        ``"PX4 ULog"`` or ``"ArduPilot DataFlash"``.
    topics : dict of str to Topic
        By name; further instances as ``name#1``, ``name#2``.
    parameters : dict of str to float
        What was set on the autopilot.
    firmware : str
        Name and version, as far as the log tells.
    vehicle : str or None
        ``"fixed wing"``, ``"VTOL"``, ``"multicopter"``, ...; None where the log does not tell.
    remarks : tuple of str
        What was wrong with the file: bytes that could not be read, where it was cut off.
    """

    kind: str
    topics: dict[str, Topic]
    parameters: dict[str, float]
    firmware: str
    vehicle: str | None
    remarks: tuple[str, ...] = ()

    def setting(self, name: str) -> int:
        """Return a parameter that is a whole number; 0 where it is not set."""
        return whole(self.parameters.get(name, 0.0))

    def find(self, name: str) -> str | None:
        """Return the name of the first instance of a topic that has messages, or None."""
        instances = [key for key in self.topics if key.split("#")[0] == name and len(self.topics[key]) > 1]
        return min(instances, key=lambda key: int(key.partition("#")[2] or 0), default=None)


def whole(value: float) -> int:
    """Return the nearest whole number, 0 of what is none."""
    return round(value) if np.isfinite(value) else 0


def instance_name(name: str, instance: int) -> str:
    """Return the name of an instance of a topic."""
    return f"{name}#{instance}" if instance else name


def _leaves(dtype):
    for name in dtype.names:
        inner, shape = dtype[name].base, dtype[name].shape
        elements = [name] if not shape else [f"{name}[{i}]" for i in range(shape[0])]
        if inner.names is None:
            yield from elements
        else:
            yield from (f"{element}.{leaf}" for element in elements for leaf in _leaves(inner))
