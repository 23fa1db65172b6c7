"""Reader of ArduPilot logs (DataFlash).

The format is that of https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html. A
message begins with two fixed bytes and a type; the formats of the types are messages too. Every
length is checked: where no message begins, reading continues at the next two fixed bytes. The
messages are those of https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from skdgp._flight.frames import euler_to_quaternion
from skdgp.io._log import (
    EQUIVALENT,
    QUATERNION,
    Log,
    Rule,
    ServoChannel,
    Topic,
    damage,
    density_at,
    from_rpm,
    instance_name,
    numeric_fields,
    whole,
)
from skdgp.io._tables import FlightReadError

MARK, HEAD = b"\xa3\x95", 3
FMT, FMT_LENGTH = 0x80, 89
TYPES = {
    "a": ("<i2", (32,)), "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "d": "<f8",
    "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
    "M": "u1", "q": "<i8", "Q": "<u8",
}  # fmt: skip
SCALE = {**dict.fromkeys("cCeE", 1e-2), "L": 1e-7}
DEFINITIONS = (
    "FMT",
    "FMTU",
    "UNIT",
    "MULT",
    "PARM",
    "MSG",
)  # messages that describe the log, and are no topics
INSTANCES = (
    "I",
    "Instance",
    "C",
)  # fields that number instances, in logs that do not say which field does
VEHICLES = {
    "ArduPlane": "fixed wing", "ArduCopter": "multicopter", "ArduRover": "rover", "Rover": "rover",
    "ArduSub": "submarine", "Blimp": "airship", "AntennaTracker": "antenna tracker",
}  # fmt: skip


def _ground_course(values):
    """Return velocity north, east, down of ground speed, course [deg], velocity down."""
    speed, course, down = values[:, 0], np.deg2rad(values[:, 1]), values[:, 2]
    return np.column_stack([speed * np.cos(course), speed * np.sin(course), down])


def _attitude(degrees):
    return euler_to_quaternion(*np.deg2rad(degrees).T)


_percent = partial(np.multiply, 0.01)
MODELLED = "estimated on board, not measured by a vane"
RULES = (
    Rule(("p", "q", "r"), "IMU", ("GyrX", "GyrY", "GyrZ")),
    Rule(("ax", "ay", "az"), "IMU", ("AccX", "AccY", "AccZ")),
    Rule(QUATERNION, "ATT", ("Roll", "Pitch", "Yaw"), _attitude),
    Rule(QUATERNION, "AHR2", ("Roll", "Pitch", "Yaw"), _attitude),
    Rule((EQUIVALENT,), "ARSP", ("Airspeed",), valid=("H", "Health")),
    Rule(("alpha",), "AOA", ("AOA",), np.deg2rad, note=MODELLED),
    Rule(("beta",), "AOA", ("SSA",), np.deg2rad, note=MODELLED),
    Rule(("v_north", "v_east", "v_down"), "XKF1", ("VN", "VE", "VD")),
    Rule(("v_north", "v_east", "v_down"), "NKF1", ("VN", "VE", "VD")),
    Rule(("v_north", "v_east", "v_down"), "GPS", ("Spd", "GCrs", "VZ"), _ground_course),
    Rule(("north", "east", "down"), "XKF1", ("PN", "PE", "PD")),
    Rule(("north", "east", "down"), "NKF1", ("PN", "PE", "PD")),
    Rule(("altitude",), "POS", ("Alt",)),
    Rule(("altitude",), "GPS", ("Alt",)),
    Rule(
        ("density",),
        "BARO",
        ("Press",),
        density_at,
        note="standard atmosphere at the measured pressure",
    ),
    Rule(("wind_north", "wind_east"), "XKF2", ("VWN", "VWE")),
    Rule(("wind_north", "wind_east"), "NKF2", ("VWN", "VWE")),
    Rule(("throttle",), "CTUN", ("ThO",), _percent),
    Rule(("throttle",), "CTUN", ("ThrOut",), _percent),
    Rule(("throttle",), "AETR", ("Thr",), _percent),
    Rule(("propeller_speed",), "RPM", ("rpm1",), from_rpm),
    Rule(("propeller_speed",), "RPM", ("RPM",), from_rpm),
    Rule(("propeller_speed",), "ESC", ("RPM",), from_rpm),
)

SERVOS = {
    4: ("aileron", False), 19: ("elevator", True), 21: ("rudder", True),
    77: ("elevon_left", True), 78: ("elevon_right", True),
}  # fmt: skip
"""By SERVOn_FUNCTION, and whether more of the command turns the surface against our sign."""
MOST_SERVOS = 16
MIXES = {
    "elevator": {79: -0.5, 80: -0.5},
    "rudder": {79: -0.5, 80: 0.5},
    "aileron": {24: 0.5, 25: 0.5},
}
"""Weights by SERVOn_FUNCTION: of a V-tail left = elevator + rudder, right = elevator - rudder of commands that go up
and right; of flaperons left = aileron + flap, right = aileron - flap (ArduPlane/servos.cpp)."""
LEFT_FLAPERON = (
    24  # later versions turn its sign: whether it moves with the right one the outputs show
)
Outputs: TypeAlias = Topic | Mapping[str, Any]
Mixing: TypeAlias = dict[str, tuple[tuple[float, ServoChannel], ...]]


def read_dataflash(path: Path) -> Log:
    """Return a DataFlash log; raise FlightReadError if it is none or holds no message with a time."""
    data = path.read_bytes()
    if not data.startswith(MARK):
        raise FlightReadError(
            "Got a file that does not begin as a DataFlash log does, but expected a binary log of "
            "ArduPilot: is it "
            "empty, or of another kind?"
        )
    reader = _Reader(data)
    reader.read()
    topics = reader.topics()
    if not topics:
        raise FlightReadError(
            f"Got a DataFlash log of {len(data)} bytes in which no message has a TimeUS, but "
            f"expected messages: was it "
            "cut off, or written before 2015?"
        )
    messages, parameters = reader.texts("MSG", "Message"), reader.parameters()
    firmware = next((text for text in messages if text.split(" ")[0] in VEHICLES), "ArduPilot")
    vehicle = VEHICLES.get(firmware.split(" ")[0])
    if vehicle == "fixed wing" and parameters.get("Q_ENABLE", 0) > 0:
        vehicle = "VTOL"
    speeds = [parameters.get(name, np.nan) for name in ("AIRSPEED_MIN", "ARSPD_FBW_MIN")]
    return Log(
        kind="ArduPilot DataFlash",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware=firmware,
        vehicle=vehicle,
        remarks=damage(reader.skipped, reader.cut),
        slowest_airspeed=next((speed for speed in speeds if 0 < speed < 200), np.nan),
        landed=("STAT", "isFlying", 0.0),
        outputs=("RCOU",),
        servos=servos_of(topics.get("RCOU", {}), parameters),
        mixing=mixing_of(topics.get("RCOU", {}), parameters),
    )


class _Format:
    """Layout of one type of message, and the positions of its messages."""

    def __init__(self, name, length, codes, columns):
        self.name, self.length = name, length
        layout = [(column, TYPES[code]) for column, code in zip(columns, codes, strict=True)]
        self.dtype = np.dtype(
            [(name, *((kind,) if isinstance(kind, str) else kind)) for name, kind in layout]
        )
        self.names = self.dtype.names or ()
        if self.dtype.itemsize != length - HEAD:
            raise ValueError(
                f"Got {name} of {length} bytes, whose fields take {self.dtype.itemsize}."
            )
        self.scale = {
            column: SCALE[code]
            for column, code in zip(columns, codes, strict=True)
            if code in SCALE
        }
        small = [column for column in columns if self.dtype[column] == np.uint8]
        self.instance = next((column for column in small if column in INSTANCES), None)
        self.starts = []


class _Reader:
    def __init__(self, data):
        self.data = data
        self.formats = {
            FMT: _Format(
                "FMT", FMT_LENGTH, "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"]
            )
        }
        self.skipped, self.cut = 0, False

    def read(self):
        """Collect definitions and the places of all messages."""
        data, formats, position, n = self.data, self.formats, 0, len(self.data)
        while position + HEAD <= n:
            of = formats.get(data[position + 2]) if data.startswith(MARK, position) else None
            if of is not None and position + of.length <= n:
                of.starts.append(position + HEAD)
                if data[position + 2] == FMT:
                    self._define(position + HEAD)
                position += of.length
                continue
            following = data.find(MARK, position + 1)
            following = n if following < 0 else following
            if of is not None and following == n:
                self.cut = True
            elif data[position:following].strip(
                b"\x00\xff"
            ):  # pages of the memory chip are filled up
                self.skipped += following - position
            position = following

    def _define(self, start):
        kind, length, name, codes, columns = np.frombuffer(
            self.data, self.formats[FMT].dtype, 1, start
        )[0].tolist()
        if kind in self.formats:
            return
        try:
            texts = [text.decode("ascii") for text in (name, codes, columns)]
            if re.fullmatch(r"\w+", texts[0]):
                self.formats[kind] = _Format(
                    texts[0], length, texts[1], texts[2].split(",") if texts[2] else []
                )
        except (
            KeyError,
            ValueError,
            TypeError,
        ):  # a definition that makes no sense; its messages are skipped
            return

    def records(self, name, *columns) -> np.ndarray | None:
        """Return the messages of a name, None where it has no such columns."""
        of = next((of for of in self.formats.values() if of.name == name), None)
        if of is None or not {*columns} <= {*of.names}:
            return None
        return self._messages(of)

    def _messages(self, of: _Format) -> np.ndarray:
        """Return the messages of one type, (n,)."""
        size = of.dtype.itemsize
        parts = [self.data[start : start + size] for start in of.starts]
        return np.frombuffer(b"".join(parts), of.dtype)

    def texts(self, name, column) -> list[str]:
        """Return a column of texts."""
        records = self.records(name, column)
        if records is None or records.dtype[column].kind != "S":
            return []
        return [text.decode("utf-8", "replace").strip("\x00 ") for text in records[column].tolist()]

    def parameters(self) -> dict[str, float]:
        """Return what was set on the autopilot."""
        records = self.records("PARM", "Value")
        values = [] if records is None else records["Value"].astype(float).tolist()
        return dict(zip(self.texts("PARM", "Name"), values, strict=False))

    def topics(self) -> dict[str, Topic]:
        """Return what has a time, by instance."""
        numbered = self._numbered()
        by_name: dict[str, Topic] = {}
        for kind, of in self.formats.items():
            timed = "TimeUS" in of.names and of.dtype["TimeUS"].kind in "iu"
            if of.name in DEFINITIONS or not of.starts or not timed:
                continue
            records = self._messages(of)
            fields = numeric_fields({name: records[name] for name in of.names})
            fields |= {name: factor * records[name] for name, factor in of.scale.items()}
            topic = Topic(records["TimeUS"] * 1e-6, np.array(of.starts), fields)
            instance = numbered.get(kind, of.instance)
            numbers = np.zeros(len(records), int) if instance is None else records[instance]
            for number in np.unique(numbers).tolist():
                by_name.setdefault(
                    instance_name(of.name, int(number)), topic.select(numbers == number)
                )
        return dict(sorted(by_name.items()))

    def _numbered(self) -> dict[int, str | None]:
        """Return by type the field that numbers instances, where the log says so: unit "#" of an FMTU message."""
        records, fields = self.records("FMTU", "FmtType", "UnitIds"), {}
        if records is None:
            return {}
        for kind, units in zip(
            records["FmtType"].tolist(), self.texts("FMTU", "UnitIds"), strict=True
        ):
            names = self.formats[kind].names if kind in self.formats else ()
            place = units.find("#")
            field = names[place] if 0 <= place < len(names) else None
            fields[kind] = field if field and self.formats[kind].dtype[field].kind in "iu" else None
        return fields


def servos_of(
    outputs: Outputs, parameters: Mapping[str, float], name: str = "RCOU.C{}"
) -> dict[str, ServoChannel]:
    """Return the servos of surfaces by SERVOn_FUNCTION, of those that are logged; ``name`` is the channel of one."""
    channels: dict[str, ServoChannel] = {}
    for function, n in _numbers(outputs, parameters, name):
        if function in SERVOS:
            surface, turned = SERVOS[function]
            channels.setdefault(surface, _channel(name.format(n), n, parameters, turned))
    return channels


def mixing_of(outputs: Outputs, parameters: Mapping[str, float], name: str = "RCOU.C{}") -> Mixing:
    """Return elevator and rudder of a V-tail, aileron of flaperons; none where one of their servos is missing."""
    by_function = dict(reversed(_numbers(outputs, parameters, name)))
    found: Mixing = {}
    for control, weights in MIXES.items():
        if set(weights) <= set(by_function):
            numbers = [by_function[each] for each in weights]
            channels = [_channel(name.format(n), n, parameters, False) for n in numbers]
            signs = [1.0, 1.0]
            if LEFT_FLAPERON in weights:
                moves = [
                    (-1.0) ** each.turned * np.diff(outputs[each.channel.partition(".")[2]])
                    for each in channels
                ]
                signs = [-1.0 if moves[0] @ moves[1] < 0 else 1.0, 1.0]
            found[control] = tuple(
                zip(np.multiply(signs, list(weights.values())).tolist(), channels, strict=True)
            )
    return found


def _numbers(outputs, parameters, name) -> list[tuple[int, int]]:
    """Return function and number of the servos that are logged."""
    field = name.partition(".")[2]
    numbers = [n for n in range(1, MOST_SERVOS + 1) if field.format(n) in outputs]
    return [(whole(parameters.get(f"SERVO{n}_FUNCTION", 0.0)), n) for n in numbers]


def _channel(channel, n, parameters, turned) -> ServoChannel:
    keys = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0, "REVERSED": 0.0}
    low, trim, high, back = (
        parameters.get(f"SERVO{n}_{key}", usual) for key, usual in keys.items()
    )
    return ServoChannel(channel, low, trim, high, turned != bool(back))
