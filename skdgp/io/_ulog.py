"""Reader of PX4 logs (ULog).

The format is that of https://docs.px4.io/main/en/dev_log/ulog_file_format. A file
has a header, definitions and messages, little-endian, each after its length and type. Every length
is checked: invalid bytes are skipped, and reading continues at the next position with three valid
messages in a row. The topics are those of https://docs.px4.io/main/en/msg_docs.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skdgp._compute.files import read_json
from skdgp.io._log import (
    QUATERNION,
    Log,
    Rule,
    ServoChannel,
    Topic,
    damage,
    from_rpm,
    gathered,
    instance_name,
    whole,
)
from skdgp.io._tables import FlightReadError

HEADER, HEADER_SIZE = b"ULog\x01\x12\x35", 16
SYNC = bytes.fromhex("2f731320250cbb12")
KINDS = b"BFIMPQARDLCSO"
HEAD = struct.Struct("<HB")
NEXT = re.compile(rb"(?=..[" + KINDS + rb"])", re.DOTALL)
NAME, FORMAT = re.compile(rb"[\w/]{1,255}"), re.compile(rb"([\w/]{1,255}+):([\w\[\] ;]*+)")
KEY = re.compile(rb"(\w+)(?:\[(\d{1,5})\])? ([\w.\-/]+)")
FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")
TYPES = {
    **{f"{sign}int{8 * size}_t": f"<{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float": "<f4", "double": "<f8", "bool": "u1", "char": "u1",
}  # fmt: skip
LARGEST = 2**16  # a message cannot be longer [bytes]: its length is 16 bits
LONGEST_TEXT = 2000
LATEST = 1_000_000  # microseconds from sampling to publishing, at most
DEEPEST = 8  # levels of nested messages
# the last byte of a version from which it is an alpha, beta or release, not a state of development
RELEASED = 64
MAV_TYPES = {
    1: "fixed wing", 10: "rover", 11: "boat", 12: "submarine",
    **dict.fromkeys((2, 3, 4, 13, 14, 15), "multicopter"), **dict.fromkeys(range(19, 26), "VTOL"),
}  # fmt: skip
VEHICLE_TYPES = {1: "multicopter", 2: "fixed wing", 3: "rover", 4: "airship"}


def _xyz(name):
    return tuple(f"{name}[{i}]" for i in range(3))


RULES = (
    Rule(("p", "q", "r"), "vehicle_angular_velocity", _xyz("xyz")),
    Rule(("p", "q", "r"), "sensor_combined", _xyz("gyro_rad")),
    Rule(("p", "q", "r"), "vehicle_attitude", ("rollspeed", "pitchspeed", "yawspeed")),
    Rule(("p", "q", "r"), "sensor_gyro", ("x", "y", "z")),
    Rule(("ax", "ay", "az"), "vehicle_acceleration", _xyz("xyz")),
    Rule(("ax", "ay", "az"), "sensor_combined", _xyz("accelerometer_m_s2")),
    Rule(("ax", "ay", "az"), "sensor_accel", ("x", "y", "z")),
    Rule(QUATERNION, "vehicle_attitude", tuple(f"q[{i}]" for i in range(4))),
    Rule(
        ("airspeed",),
        "airspeed_validated",
        ("true_airspeed_m_s",),
        valid=("airspeed_sensor_measurement_valid",),
    ),
    Rule(("airspeed",), "airspeed", ("true_airspeed_m_s",)),
    Rule(("alpha",), "airflow_aoa", ("aoa_rad",)),
    Rule(("beta",), "airflow_slip", ("slip_rad",)),
    Rule(("v_north", "v_east"), "vehicle_local_position", ("vx", "vy"), valid=("v_xy_valid",)),
    Rule(("v_north", "v_east"), "vehicle_global_position", ("vel_n", "vel_e")),
    Rule(
        ("v_north", "v_east"),
        "vehicle_gps_position",
        ("vel_n_m_s", "vel_e_m_s"),
        valid=("vel_ned_valid",),
    ),
    Rule(("v_down",), "vehicle_local_position", ("vz",), valid=("v_z_valid",)),
    Rule(("v_down",), "vehicle_global_position", ("vel_d",)),
    Rule(("v_down",), "vehicle_gps_position", ("vel_d_m_s",), valid=("vel_ned_valid",)),
    Rule(("north", "east"), "vehicle_local_position", ("x", "y"), valid=("xy_valid",)),
    Rule(("down",), "vehicle_local_position", ("z",), valid=("z_valid",)),
    Rule(("altitude",), "vehicle_global_position", ("alt",)),
    Rule(("altitude",), "vehicle_air_data", ("baro_alt_meter",), note="of the barometer"),
    Rule(("altitude",), "vehicle_gps_position", ("altitude_msl_m",)),
    Rule(("altitude",), "vehicle_gps_position", ("alt",), lambda millimetres: 1e-3 * millimetres),
    Rule(("density",), "vehicle_air_data", ("rho",)),
    Rule(("wind_north", "wind_east"), "wind", ("windspeed_north", "windspeed_east")),
    Rule(("wind_north", "wind_east"), "wind_estimate", ("windspeed_north", "windspeed_east")),
    Rule(("throttle",), "actuator_controls_1", ("control[3]",), note="of a VTOL in forward flight"),
    Rule(("throttle",), "actuator_controls_0", ("control[3]",)),
    Rule(("throttle",), "vehicle_thrust_setpoint", ("xyz[0]",)),
    Rule(("throttle",), "actuator_motors", ("control[0]",)),
    Rule(("propeller_speed",), "rpm", ("rpm_estimate",), from_rpm),
    Rule(("propeller_speed",), "rpm", ("indicated_frequency_rpm",), from_rpm),
    Rule(("propeller_speed",), "esc_status", ("esc[0].esc_rpm",), from_rpm),
)

OUTPUTS = (
    "actuator_servos",
    "actuator_outputs",
    "actuator_outputs#1",
    "actuator_controls_0",
    "actuator_controls_1",
)
TOPICS = {*OUTPUTS, *(rule.topic for rule in RULES)}
SURFACES = {1: "aileron", 3: "elevator", 4: "rudder", 5: "elevon_left", 6: "elevon_right"}
"""By CA_SV_CSn_TYPE: a left aileron, and so on. More of the output turns their trailing edges up,
against our signs.
"""
MIXED_TYPES = (*range(1, 9), *range(12, 16))
"""Ailerons, elevator, rudder, elevons, V-tail; custom, A-tail, a single servo of both ailerons. No flaps, airbrakes,
wheels, spoilers (ActuatorEffectivenessControlSurfaces.hpp)."""
TORQUES = {"aileron": ("R", 1.0), "elevator": ("P", -1.0), "rudder": ("Y", -1.0)}
"""Torques CA_SV_CSn_TRQ_ by which the autopilot allocates a control, and the sign of ours at a
positive torque.
"""
CONTROLS = {"aileron": (0, False), "elevator": (1, True), "rudder": (2, True)}
"""Fields of actuator_controls, and whether more turns the surface against our sign."""


def read_ulog(path: Path) -> Log:
    """Return a ULog; raise FlightReadError if it is none, of a later incompatible format, or holds no message."""
    data = path.read_bytes()
    if not data.startswith(HEADER):
        raise FlightReadError(
            "Got a file that does not begin as a ULog does, but expected a log of PX4: is it "
            "empty, or of another kind?"
        )
    reader = _Reader(data)
    reader.read()
    topics = reader.topics()
    if not topics:
        raise FlightReadError(
            f"Got a ULog of {len(data)} bytes without any data, but expected messages: was it cut "
            f"off?"
        )
    return _log(
        "PX4 ULog",
        topics,
        reader.parameters,
        reader.information,
        damage(reader.skipped, reader.cut, reader.lost),
    )


def read_topic_tables(path: Path) -> Log:
    """Return a log of PX4 in a folder with a Parquet file for each topic, as Flight Review stores it.

    Further instances of a topic are topic_1.parquet, ... Parameters and firmware are in
    metadata.json; without it the servos of surfaces are not known. Raises FlightReadError if no
    file is a topic, ImportError without pyarrow.
    """
    try:
        from pyarrow.parquet import read_table
    except ImportError as error:
        raise ImportError(
            "Reading parquet needs pyarrow, which is not installed: pip install 'skdgp[parquet]'."
        ) from error
    metadata, topics = {}, {}
    if (path / "metadata.json").exists():
        try:
            metadata = read_json(path / "metadata.json")
        except ValueError as error:
            raise FlightReadError(f"Got metadata.json, but expected JSON: {error}") from error
    for file in sorted(path.glob("*.parquet")):
        try:
            table = read_table(file)
        except (OSError, ValueError, NotImplementedError) as error:  # ArrowInvalid is a ValueError
            raise FlightReadError(
                f"Got no whole Parquet file {file.name} ({error}): copy it again."
            ) from error
        records = table.to_pandas().select_dtypes(["number", "bool"]).to_records(index=False)
        if len(records) and "timestamp" in (records.dtype.names or ()):
            name, _, number = file.stem.rpartition("_")
            is_instance = (
                name and number.isdecimal() and file.stem not in TOPICS
            )  # some topics end in a number
            name = instance_name(name, int(number)) if is_instance else file.stem
            topics[name] = Topic(
                _sampled(name, records) * 1e-6, records["timestamp"].astype(float), records
            )
    if not topics:
        raise FlightReadError(
            "Got a folder, but expected Parquet files of the topics of PX4 in it, with a "
            "timestamp, such as "
            "vehicle_attitude.parquet."
        )
    numbers = {
        key: value
        for key, value in metadata.get("parameters", {}).items()
        if type(value) in (int, float)
    }
    return _log(
        "PX4 Parquet", topics, {key: float(value) for key, value in numbers.items()}, metadata, ()
    )


def _log(kind, topics, parameters, information, remarks) -> Log:
    return Log(
        kind=kind,
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware=_firmware(information),
        vehicle=_vehicle(topics, parameters),
        remarks=remarks,
        slowest_airspeed=parameters.get("FW_AIRSPD_MIN", np.nan),
        landed=("vehicle_land_detected", "landed", 1.0),
        outputs=OUTPUTS,
        servos=_servos(topics, parameters),
        mixing=_mixing(topics, parameters),
    )


class _Subscription(NamedTuple):
    """Layout of one topic, and the positions of its messages."""

    name: str
    instance: int
    dtype: np.dtype
    largest: int
    starts: list[int]


class _Reader:
    def __init__(self, data):
        self.data = data
        self.formats, self.dtypes, self.layouts = {}, {}, {}
        self.subscriptions, self.finished = {}, []
        self.parameters, self.information = {}, {}
        self.appended, self.skipped, self.lost, self.cut = [], 0, 0, False
        by_kind = {"B": self._flags, "F": self._format, "A": self._subscribe, "D": self._datum}
        by_kind |= {
            "I": self._information,
            "P": self._parameter,
            "S": lambda start, end: data[start:end] == SYNC,
        }
        by_kind |= dict.fromkeys(
            "MQ", lambda start, end: end - start > 1 and self._keyed(start + 1, end) is not None
        )
        by_kind |= dict.fromkeys("OR", lambda start, end: end - start == 2)
        by_kind |= dict.fromkeys("LC", lambda start, end: 9 <= end - start <= LONGEST_TEXT)
        self.handlers = {ord(kind): makes_sense for kind, makes_sense in by_kind.items()}

    def read(self):
        """Collect definitions and the places of all messages."""
        data, position = self.data, HEADER_SIZE
        while position + HEAD.size <= len(data):
            size, kind = HEAD.unpack_from(data, position)
            start, end = position + HEAD.size, position + HEAD.size + size
            if (
                self.appended and end > self.appended[0]
            ):  # a crash report was appended there, perhaps to half a message
                position = max(position, self.appended.pop(0))
            elif self._read_message(kind, start, end):
                position = end
            else:
                starts = (match.start() for match in NEXT.finditer(data, position + 1))
                following = next((start for start in starts if self._chain(start, 3)), len(data))
                complete = end <= len(data) or kind not in KINDS
                self.cut = self.cut or (following == len(data) and not complete)
                self.skipped += following - position if complete else 0
                position = following

    def _read_message(self, kind, start, end) -> bool:
        """Return whether there is a message: of a known kind that makes sense, or of a new kind between known ones."""
        if start == end or end > len(self.data):
            return False
        return self.handlers[kind](start, end) if kind in self.handlers else self._chain(end, 3)

    def _chain(self, position, n):
        """Whether n messages of known kinds follow each other, or fewer up to the end of the file."""
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

    # Each of these reads the bytes of one message from start to end, and returns whether they make
    # sense.

    def _flags(self, start, end):
        if start != HEADER_SIZE + HEAD.size or end - start < 40:
            return False
        incompatible = self.data[start + 8 : start + 16]
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise FlightReadError(
                f"Got a ULog with incompatible flags {incompatible.hex()}, but expected none but "
                f"'data appended': "
                "it is of a later format than this reader."
            )
        if incompatible[0] & 1:
            self.appended = sorted(
                o for o in struct.unpack_from("<3Q", self.data, start + 16) if o > end
            )
        return True

    def _format(self, start, end):
        match = FORMAT.fullmatch(self.data, start, end)
        if match is None:
            return False
        self.formats.setdefault(match[1].decode(), match[2].decode())
        return True

    def _subscribe(self, start, end):
        match = NAME.fullmatch(self.data, start + 3, end)
        if match is None:
            return False
        instance, number = struct.unpack_from("<BH", self.data, start)
        name = match[0].decode()
        if name not in self.layouts:
            self.layouts[name] = self._layout(name)
        if (layout := self.layouts[name]) is not None:
            if number in self.subscriptions and self.subscriptions[number].starts:
                self.finished.append(self.subscriptions[number])
            self.subscriptions[number] = _Subscription(name, instance, layout[0], layout[1], [])
        return True

    def _layout(self, name):
        """Return the layout of a topic as it is logged and its largest size; None if its definition makes no sense."""
        try:
            dtype = self._dtype(name)
        except (KeyError, ValueError, TypeError):  # a definition that is lost, or makes no sense
            return None
        names = list(dtype.names)
        while names and names[-1].startswith("_padding"):  # at the end it is not logged
            names.pop()
        timed = "timestamp" in names and dtype["timestamp"] == np.dtype("<u8")
        return (
            (np.dtype([(name, dtype[name]) for name in names]), dtype.itemsize) if timed else None
        )

    def _dtype(self, name, depth=0):
        """Return the layout of a message, made once; nested messages stay nested, so that no size can be abused."""
        if name not in self.dtypes:
            self.dtypes[name] = None  # until it is made: a message that holds itself is none
            self.dtypes[name] = self._new_dtype(name, depth)
        if self.dtypes[name] is None:
            raise ValueError(f"Got a definition of {name} that is no message.")
        return self.dtypes[name]

    def _new_dtype(self, name, depth):
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
        subscription = self.subscriptions.get(
            int.from_bytes(self.data[start : start + 2], "little")
        )
        if subscription is None:
            known = self._chain(end, 1)
            self.lost += known
            return known
        if not subscription.dtype.itemsize <= end - start - 2 <= subscription.largest:
            return False
        subscription.starts.append(start + 2)
        return True

    def _keyed(self, start, end):
        """Return type, key and value, or None where the length is not that of the type."""
        match = KEY.fullmatch(self.data, start + 1, min(start + 1 + self.data[start], end))
        if match is None:
            return None
        kind, length, key = (group and group.decode() for group in match.groups())
        value = self.data[match.end() : end]
        sound = kind in TYPES and len(value) == np.dtype(TYPES[kind]).itemsize * int(length or 1)
        return (kind, key, value) if sound else None

    def _information(self, start, end):
        keyed = self._keyed(start, end)
        if keyed is not None:
            kind, key, value = keyed
            scalar = "int" in kind and len(value) == np.dtype(TYPES[kind]).itemsize
            text = value.decode("utf-8", "replace").strip("\x00")
            self.information[key] = int(np.frombuffer(value, TYPES[kind])[0]) if scalar else text
        return keyed is not None

    def _parameter(self, start, end):
        keyed = self._keyed(start, end)
        if keyed is not None and len(keyed[2]) == np.dtype(TYPES[keyed[0]]).itemsize:
            self.parameters[keyed[1]] = float(np.frombuffer(keyed[2], TYPES[keyed[0]])[0])
        return keyed is not None

    def topics(self) -> dict[str, Topic]:
        """Return the topics by name; of two of one name the longer."""
        by_name: dict[str, Topic] = {}
        for each in [*self.subscriptions.values(), *self.finished]:
            name = instance_name(each.name, each.instance)
            if each.starts and len(each.starts) > len(by_name.get(name, ())):
                records = gathered(self.data, each.starts, each.dtype)
                by_name[name] = Topic(
                    _sampled(each.name, records) * 1e-6, np.array(each.starts), records
                )
        return dict(sorted(by_name.items()))


def _sampled(name, records):
    """Return when something was sampled, or if that is not logged or an output, published [us]."""
    published = records["timestamp"]
    if "timestamp_sample" not in records.dtype.names or name.startswith("actuator"):
        return published
    sampled = records["timestamp_sample"]
    believed = (sampled > 0) & (sampled <= published) & (published - sampled < LATEST)
    return np.where(believed, sampled, published)


def _firmware(information) -> str:
    name, release = information.get("sys_name") or "PX4", information.get("ver_sw_release")
    if release and release & 255 >= RELEASED:
        version = f" {release >> 24 & 255}.{release >> 16 & 255}.{release >> 8 & 255}"
    else:
        version = " development " + str(information.get("ver_sw") or "")[:8]
    board = information.get("ver_hw")
    return f"{name}{version.rstrip()}" + (f" on {board}" if board else "")


def _vehicle(topics, parameters) -> str | None:
    status = topics.get("vehicle_status", {})
    if "is_vtol" in status and status["is_vtol"].any():
        return "VTOL"
    for field, names in (("vehicle_type", VEHICLE_TYPES), ("system_type", MAV_TYPES)):
        if field in status and (found := names.get(whole(np.median(status[field])))):
            return found
    return MAV_TYPES.get(whole(parameters.get("MAV_TYPE", 0.0)))


def _surface_types(topics, parameters) -> dict[int, int]:
    """Return the type of each surface of control allocation whose output is logged, by its number."""
    outputs = topics.get("actuator_servos", ())
    return {
        n: whole(parameters.get(f"CA_SV_CS{n}_TYPE", 0.0))
        for n in range(8)
        if f"control[{n}]" in outputs
    }


def _servos(topics, parameters) -> dict[str, ServoChannel]:
    """Return the servos of control allocation, else those of a plane mixed by fixed rules."""
    channels: dict[str, ServoChannel] = {}
    for n, kind in _surface_types(topics, parameters).items():
        if kind in SURFACES:
            channels.setdefault(
                SURFACES[kind], ServoChannel(f"actuator_servos.control[{n}]", -1, 0, 1, True)
            )
    if channels:
        return channels
    name = (
        "actuator_controls_1" if "actuator_controls_1" in topics else "actuator_controls_0"
    )  # 1: a VTOL's wings
    if name not in topics or "control[2]" not in topics[name]:
        return {}
    return {
        key: ServoChannel(f"{name}.control[{n}]", -1, 0, 1, turned)
        for key, (n, turned) in CONTROLS.items()
    }


def _mixing(topics, parameters) -> dict[str, tuple[tuple[float, ServoChannel], ...]]:
    """Return the controls by the torques of control allocation: any number of surfaces, mixed in any way."""
    mixed = [n for n, kind in _surface_types(topics, parameters).items() if kind in MIXED_TYPES]
    found = {}
    for control, (axis, sign) in TORQUES.items():
        torques = {n: parameters.get(f"CA_SV_CS{n}_TRQ_{axis}", 0.0) for n in mixed}
        total = sum(map(abs, torques.values()))
        if 0 < total < np.inf:
            found[control] = tuple(
                (sign * torque / total, ServoChannel(f"actuator_servos.control[{n}]", -1, 0, 1))
                for n, torque in torques.items()
                if torque
            )
    return found
