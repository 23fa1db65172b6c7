"""PX4's ULog: a header, definitions of messages, then messages, little-endian, each behind its length and type.

The format is that of https://docs.px4.io/main/en/dev_log/ulog_file_format. No length in the file is trusted: what does
not fit is left out, and reading goes on at the next place where three messages in a row make sense.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from skdgp.io._errors import FlightReadError
from skdgp.io._topics import Log, Topic, instance_name, whole

HEADER, HEADER_SIZE = b"ULog\x01\x12\x35", 16
KINDS = b"BFIMPQARDLCSO"
HEAD = struct.Struct("<HB")
NEXT = re.compile(rb"(?=..[" + KINDS + rb"])", re.DOTALL)
FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
TYPES = {
    **{f"{sign}int{8 * size}_t": f"<{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float": "<f4", "double": "<f8", "bool": "u1", "char": "u1",
}  # fmt: skip
LARGEST = 2**16
"""A message cannot be longer [bytes]: its length is 16 bits."""
DEEPEST = 8
"""Levels of nested messages."""
RELEASED = 64
"""The last byte of a version from which it is an alpha, beta or release, not a state of development."""
MAV_TYPES = {
    1: "fixed wing", 10: "rover", 11: "boat", 12: "submarine",
    **dict.fromkeys((2, 3, 4, 13, 14, 15), "multicopter"), **dict.fromkeys(range(19, 26), "VTOL"),
}  # fmt: skip
VEHICLE_TYPES = {1: "multicopter", 2: "fixed wing", 3: "rover", 4: "airship"}


def read_ulog(path: Path) -> Log:
    """Read a ULog.

    Raises
    ------
    FlightReadError
        If it is no ULog, of a later incompatible format, or holds no message.
    """
    data = path.read_bytes()
    if not data.startswith(HEADER):
        raise FlightReadError(
            f"Got {path}, which does not begin as a ULog does, but expected a log of PX4: is it empty, or of "
            "another kind?"
        )
    reader = _Reader(data)
    reader.read()
    topics = reader.topics()
    if not topics:
        raise FlightReadError(
            f"Got {path}, a ULog of {len(data)} bytes without any data, but expected messages: was it cut off?"
        )
    return Log(
        kind="PX4 ULog",
        topics=topics,
        parameters=reader.parameters,
        firmware=_firmware(reader.information),
        vehicle=_vehicle(topics, reader.parameters),
        remarks=tuple(reader.remarks()),
    )


class _Subscription:
    """Where the messages of one topic stand."""

    def __init__(self, name, instance, dtype):
        self.name, self.instance = name, instance
        names = list(dtype.names)
        while names and names[-1].startswith("_padding"):  # at the end it is not logged
            names.pop()
        self.dtype = np.dtype([(name, dtype[name]) for name in names])
        self.largest = dtype.itemsize
        self.starts = []


class _Reader:
    def __init__(self, data):
        self.data = data
        self.formats, self.subscriptions, self.finished = {}, {}, []
        self.parameters, self.information = {}, {}
        self.appended, self.skipped, self.lost, self.cut = [], 0, 0, False
        self.take = {"B": self._flags, "F": self._format, "A": self._subscribe, "D": self._datum}
        self.take |= {"I": self._information, "P": self._parameter, "O": self._dropout}
        self.take = {ord(kind): take for kind, take in self.take.items()}

    def read(self):
        """Go through the file."""
        data, position = self.data, HEADER_SIZE
        while position + HEAD.size <= len(data):
            size, kind = HEAD.unpack_from(data, position)
            start, end = position + HEAD.size, position + HEAD.size + size
            if self.appended and end > self.appended[0]:  # a crash report was appended there, perhaps to half a message
                position = max(position, self.appended.pop(0))
            elif self._believable(position, size, kind) and self._taken(kind, start, end):
                position = end
            elif end > len(data) and kind in KINDS and size:
                found = self._next(position + 1)
                self.cut = self.cut or found == len(data)
                position = found
            else:
                found = self._next(position + 1)
                self.skipped += found - position
                position = found

    def _taken(self, kind, start, end):
        take = self.take.get(kind)
        return take is None or take(start, end) is not False

    def _believable(self, position, size, kind):
        """Whether a message stands here: of a known kind, or of a new one between known ones."""
        end = position + HEAD.size + size
        return size > 0 and end <= len(self.data) and (kind in KINDS or self._chain(end, 3))

    def _chain(self, position, n):
        for _ in range(n):
            if position == len(self.data):
                return True
            if position + HEAD.size > len(self.data):
                return False
            size, kind = HEAD.unpack_from(self.data, position)
            position += HEAD.size + size
            if kind not in KINDS or not size or position > len(self.data):
                return False
        return True

    def _next(self, position):
        found = (match.start() for match in NEXT.finditer(self.data, position))
        return next((start for start in found if self._chain(start, 3)), len(self.data))

    def _flags(self, start, end):
        if end - start < 40:
            return False
        incompatible = self.data[start + 8 : start + 16]
        if start == HEADER_SIZE + HEAD.size and (incompatible[0] & ~1 or any(incompatible[1:])):
            raise FlightReadError(
                f"Got a ULog with incompatible flags {incompatible.hex()}, but expected none but 'data appended': "
                "it is of a later format than this reader."
            )
        if incompatible[0] & 1:
            self.appended = sorted(o for o in struct.unpack_from("<3Q", self.data, start + 16) if o > end)
        return True

    def _format(self, start, end):
        name, _, fields = self.data[start:end].decode("utf-8", "replace").partition(":")
        self.formats.setdefault(name, fields)

    def _subscribe(self, start, end):
        if end - start < 4:
            return False
        instance, number = struct.unpack_from("<BH", self.data, start)
        name = self.data[start + 3 : end].decode("utf-8", "replace")
        try:
            subscription = _Subscription(name, instance, self._dtype(name))
        except (KeyError, ValueError, TypeError):  # a definition that makes no sense
            return name in self.formats
        if "timestamp" not in subscription.dtype.names or subscription.dtype["timestamp"] != np.dtype("<u8"):
            return True
        if number in self.subscriptions:
            self.finished.append(self.subscriptions[number])
        self.subscriptions[number] = subscription
        return True

    def _dtype(self, name, depth=0):
        """Return the layout of a message; nested ones and arrays stay nested, so that no size can be abused."""
        if depth > DEEPEST:
            raise ValueError(f"Got messages nested deeper than {DEEPEST}.")
        fields = [FIELD.fullmatch(text) for text in self.formats[name].split(";") if text]
        layout = []
        for kind, length, field in (match.groups() for match in fields if match is not None):
            inner = np.dtype(TYPES[kind]) if kind in TYPES else self._dtype(kind, depth + 1)
            layout.append((field, inner) if length is None else (field, inner, (int(length),)))
        dtype = np.dtype(layout)
        if len(layout) < len(fields) or not 0 < dtype.itemsize < LARGEST:
            raise ValueError(f"Got a definition of {name} that is no message.")
        return dtype

    def _datum(self, start, end):
        if end - start < 2:
            return False
        subscription = self.subscriptions.get(int.from_bytes(self.data[start : start + 2], "little"))
        if subscription is None:
            self.lost += 1
            return True
        if not subscription.dtype.itemsize <= end - start - 2 <= subscription.largest:
            return False
        subscription.starts.append(start + 2)
        return True

    def _keyed(self, start, end):
        """Return type, key and where the value stands."""
        middle = start + 1 + self.data[start]
        kind, _, key = self.data[start + 1 : middle].decode("utf-8", "replace").partition(" ")
        return kind, key, self.data[middle:end]

    def _information(self, start, end):
        kind, key, value = self._keyed(start, end)
        if kind.startswith("char["):
            self.information[key] = value.decode("utf-8", "replace")
        elif kind in TYPES and len(value) == np.dtype(TYPES[kind]).itemsize:
            self.information[key] = int(np.frombuffer(value, TYPES[kind])[0]) if "int" in kind else None

    def _parameter(self, start, end):
        kind, key, value = self._keyed(start, end)
        if kind in ("int32_t", "float") and len(value) == 4:
            self.parameters[key] = float(np.frombuffer(value, TYPES[kind])[0])

    def _dropout(self, start, end):
        return end - start == 2

    def topics(self) -> dict[str, Topic]:
        found = {}
        for each in [*self.subscriptions.values(), *self.finished]:
            name = instance_name(each.name, each.instance)
            if each.starts and len(each.starts) > len(found.get(name, ())):
                size = each.dtype.itemsize
                raw = b"".join([self.data[start : start + size] for start in each.starts])
                records = np.frombuffer(raw, each.dtype)
                found[name] = Topic(records["timestamp"] * 1e-6, np.array(each.starts), records)
        return dict(sorted(found.items()))

    def remarks(self):
        if self.skipped:
            yield f"{self.skipped} bytes could not be read and were skipped"
        if self.lost:
            yield f"{self.lost} messages belong to no topic that the log defines"
        if self.cut:
            yield "the file ends within a message: it was cut off"


def _firmware(information) -> str:
    name, release = information.get("sys_name") or "PX4", information.get("ver_sw_release")
    if release and release & 255 >= RELEASED:
        version = f" {release >> 24 & 255}.{release >> 16 & 255}.{release >> 8 & 255}"
    else:
        version = " development " + str(information.get("ver_sw") or "")[:8]
    board = information.get("ver_hw")
    return f"{name}{version.rstrip()}" + (f" on {board}" if board else "")


def _vehicle(topics, parameters) -> str | None:
    status = topics.get("vehicle_status")
    if status is not None:
        if "is_vtol" in status and status["is_vtol"].any():
            return "VTOL"
        for field, names in (("vehicle_type", VEHICLE_TYPES), ("system_type", MAV_TYPES)):
            if field in status:
                found = names.get(whole(np.median(status[field])))
                if found is not None:
                    return found
    return MAV_TYPES.get(whole(parameters.get("MAV_TYPE", 0.0)))
