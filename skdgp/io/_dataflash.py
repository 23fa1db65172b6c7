"""Reader of ArduPilot logs (DataFlash).

Format: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html. A
message begins with two fixed bytes and a type; the formats of the types are messages too. Every
length is checked: where no message begins, reading continues at the next two fixed bytes. Messages: https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from skdgp._flight.frames import euler_to_quaternion
from skdgp.io._log import (
    DOWN,
    EQUIVALENT,
    QUATERNION,
    UP,
    Control,
    Log,
    Rule,
    Servo,
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
FMT = 0x80  # type of the messages that define types
FILLING = b"\x00\xff"  # of unused pages of the memory chip
TEXTS = ("Name", "Message", "UnitIds")
TYPES = {
    "a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "d": "<f8",
    "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
    "M": "u1", "q": "<i8", "Q": "<u8",
}  # fmt: skip
SCALE = {**dict.fromkeys("cCeE", 1e-2), "L": 1e-7}
# messages that describe the log, and are no topics
DEFINITIONS = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG")
# fields that number instances, in logs that do not say which field does
INSTANCES = ("I", "Instance", "C")
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

# By SERVOn_FUNCTION, and whether more of the command turns the surface against our sign
SERVOS = {
    4: ("aileron", False), 19: ("elevator", True), 21: ("rudder", True),
    77: ("elevon_left", True), 78: ("elevon_right", True),
}  # fmt: skip
MOST_SERVOS = 16
# Weights by SERVOn_FUNCTION: of a V-tail left = elevator + rudder, right = elevator - rudder of
# commands that go up and right (ArduPlane/servos.cpp)
MIXES = {
    "elevator": {79: -0.5, 80: -0.5},
    "rudder": {79: -0.5, 80: 0.5},
}


def read_dataflash(path: Path) -> Log:
    """Return a DataFlash log; raise FlightReadError if it is none or holds no message with a time."""
    data = path.read_bytes()
    if not data.startswith(MARK):
        raise FlightReadError(
            "Got a file that does not begin as a DataFlash log does, but expected a binary log of "
            "ArduPilot: is it empty, or of another kind?"
        )
    file = _File(data)
    topics = file.topics()
    if not topics:
        raise FlightReadError(
            f"Got a DataFlash log of {len(data)} bytes in which no message has a TimeUS, but "
            f"expected messages: was it cut off, or written before 2015?"
        )
    names, values = file.column("PARM", "Name"), file.column("PARM", "Value")
    parameters = {str(name): float(x) for name, x in zip(names, values, strict=False)}
    texts = map(str, file.column("MSG", "Message"))
    firmware = next((text for text in texts if text.split(" ")[0] in VEHICLES), "ArduPilot")
    vehicle = VEHICLES.get(firmware.split(" ")[0])
    if vehicle == "fixed wing" and parameters.get("Q_ENABLE", 0) > 0:
        vehicle = "VTOL"
    return Log(
        kind="ArduPilot DataFlash",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware=firmware,
        vehicle=vehicle,
        remarks=damage(file.skipped, file.cut),
        landed=("STAT", "isFlying", 0.0),
        outputs=("RCOU",),
        controls=controls_of(topics.get("RCOU", {}), parameters),
    )


class _Messages:
    """Messages of one type: name, layout, and places in the file."""

    def __init__(self, name: str, codes: str, columns: list[str]):
        self.name = name
        self.codes = dict(zip(columns, codes, strict=True))
        self.dtype = np.dtype([(column, TYPES[code]) for column, code in self.codes.items()])
        self.starts: list[int] = []

    def read(self, data: bytes) -> np.ndarray:
        """Return the messages as records, (n,)."""
        size = self.dtype.itemsize
        return np.frombuffer(b"".join(data[k : k + size] for k in self.starts), self.dtype)

    def is_whole_number(self, column: str) -> bool:
        """Return whether there is a column of integers of this name."""
        return column in self.codes and self.dtype[column].kind in "iu"


class _File:
    """Types of messages by number, with the places of all messages, and the damage."""

    def __init__(self, data: bytes):
        self.data = data
        columns = ["Type", "Length", "Name", "Format", "Columns"]
        self.types = {FMT: _Messages("FMT", "BBnNZ", columns)}
        self.skipped, self.cut = 0, False
        position, n = 0, len(data)
        while position + HEAD <= n:
            messages = (
                self.types.get(data[position + 2]) if data.startswith(MARK, position) else None
            )
            start = position + HEAD
            if messages is not None and (end := start + messages.dtype.itemsize) <= n:
                messages.starts.append(start)
                if messages is self.types[FMT]:
                    self._define(data[start:end])
                position = end
                continue
            following = data.find(MARK, position + 1) % (n + 1)  # -1, for none, becomes n
            if messages is not None and following == n:
                self.cut = True
            elif data[position:following].strip(FILLING):
                self.skipped += following - position
            position = following

    def _define(self, message: bytes) -> None:
        """Add a type, unless its definition makes no sense: its messages are then skipped."""
        number, length, *texts = np.frombuffer(message, self.types[FMT].dtype)[0].tolist()
        with suppress(KeyError, ValueError, TypeError):
            name, codes, columns = (text.decode("ascii") for text in texts)
            new = _Messages(name, codes, columns.split(",") if columns else [])
            if re.fullmatch(r"\w+", name) and new.dtype.itemsize == length - HEAD:
                self.types.setdefault(number, new)

    def column(self, name: str, column: str) -> list:
        """Return a column of the messages of a name, texts as str; empty where there is none such."""
        kinds = "S" if column in TEXTS else "iuf"
        kind = next(
            (
                kind
                for kind in self.types.values()
                if kind.name == name and column in kind.codes and kind.dtype[column].kind in kinds
            ),
            None,
        )
        values = [] if kind is None else kind.read(self.data)[column].tolist()
        return [
            value.decode("utf-8", "replace").strip("\x00 ") if kinds == "S" else value
            for value in values
        ]

    def topics(self) -> dict[str, Topic]:
        """Return the messages that have a time, by name and instance."""
        units = dict(
            zip(self.column("FMTU", "FmtType"), self.column("FMTU", "UnitIds"), strict=False)
        )
        topics: dict[str, Topic] = {}
        for number, kind in self.types.items():
            if kind.name in DEFINITIONS or not kind.starts or not kind.is_whole_number("TimeUS"):
                continue
            records = kind.read(self.data)
            fields = numeric_fields({name: records[name] for name in kind.codes}) | {
                name: SCALE[code] * records[name]
                for name, code in kind.codes.items()
                if code in SCALE
            }
            topic = Topic(records["TimeUS"] * 1e-6, np.array(kind.starts), fields)
            instance = _instance_field(kind, units.get(number))
            instances = np.zeros(len(records), int) if instance is None else records[instance]
            for k in np.unique(instances).tolist():
                topics.setdefault(instance_name(kind.name, k), topic.select(instances == k))
        return dict(sorted(topics.items()))


def _instance_field(kind: _Messages, units: str | None) -> str | None:
    """Return the field that numbers instances: by the log's unit "#", or in older logs by its name."""
    if units is None:
        return next(
            (name for name in kind.codes if name in INSTANCES and kind.codes[name] in "BM"), None
        )
    marked = [name for name, unit in zip(kind.codes, units, strict=False) if unit == "#"]
    return next(filter(kind.is_whole_number, marked), None)


def controls_of(
    outputs: Topic | Mapping, parameters: Mapping[str, float], name: str = "RCOU.C{}"
) -> dict[str, Control]:
    """Return surfaces by SERVOn_FUNCTION, and controls of a V-tail; ``name`` is the channel of output n."""
    field = name.partition(".")[2]
    first = {  # the first logged output of each function
        whole(parameters.get(f"SERVO{n}_FUNCTION", 0.0)): n
        for n in range(MOST_SERVOS, 0, -1)
        if field.format(n) in outputs
    }

    def servo(function: int, turned: bool = False) -> Servo:
        keys = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0, "REVERSED": 0.0}
        *ends, back = (
            parameters.get(f"SERVO{first[function]}_{key}", usual) for key, usual in keys.items()
        )
        return Servo(
            name.format(first[function]), tuple(ends), DOWN if turned != bool(back) else UP
        )

    mixed = {
        control: tuple((weight, servo(function)) for function, weight in weights.items())
        for control, weights in MIXES.items()
        if set(weights) <= set(first)
    }
    single = {
        SERVOS[function][0]: ((1.0, servo(function, SERVOS[function][1])),)
        for function in reversed(first)
        if function in SERVOS
    }
    return single | mixed
