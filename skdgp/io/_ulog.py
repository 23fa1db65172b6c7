"""Reader of PX4 logs (ULog) by pyulog.

Topics: https://docs.px4.io/main/en/msg_docs. Bytes of a damaged file that pyulog skips are
counted, and definitions that ask for far more fields than a message can hold are refused.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.typing import Vector
from skdgp._flight.channels import ELEVONS
from skdgp.io._log import (
    DOWN,
    QUATERNION,
    UP,
    Control,
    Log,
    Rule,
    Servo,
    Topic,
    damage,
    from_rpm,
    instance_name,
    numeric_fields,
    whole,
)
from skdgp.io._tables import FlightReadError

HEADER = b"ULog\x01\x12\x35"
SPARE_READS = 1000  # beyond one for each byte: a sound file has two for each message
HEAD_SIZE = 3  # bytes before each message
LATEST = 1_000_000  # microseconds from sampling to publishing, at most
MOST_FIELDS = 2**16  # of one message, whose length has 16 bits
MOST_FIELDS_IN_ALL = 2**18  # of all topics of a log, at most one for each byte; a VTOL's has 4,000
SHORT_MESSAGES = (  # classes of pyulog that may raise struct.error, which ends its reading
    *("_MessageInfo", "_MessageParameterDefault", "MessageLogging", "MessageLoggingTagged"),
    "MessageDropout",
)
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

FIXED_MIXERS = ("actuator_controls_1", "actuator_controls_0")  # 1: the wings of a VTOL
OUTPUTS = ("actuator_servos", "actuator_outputs", "actuator_outputs#1", *FIXED_MIXERS)
# By CA_SV_CSn_TYPE: a left aileron, and so on. More of the output turns their trailing edges up,
# against our signs.
SURFACES = {1: "aileron", 3: "elevator", 4: "rudder", 5: "elevon_left", 6: "elevon_right"}
# Ailerons, elevator, rudder, elevons, V-tail; custom, A-tail, a single servo of both ailerons. No
# flaps, airbrakes, wheels, spoilers (ActuatorEffectivenessControlSurfaces.hpp).
MIXED_TYPES = (*range(1, 9), *range(12, 16))
# Torques CA_SV_CSn_TRQ_ that allocate a control, and its sign in a flight table at a positive
# torque
TORQUES = {"aileron": ("R", 1.0), "elevator": ("P", -1.0), "rudder": ("Y", -1.0)}
# Fields of actuator_controls, and full throws: more elevator and rudder turn against our sign
CONTROLS = {"aileron": (0, UP), "elevator": (1, DOWN), "rudder": (2, DOWN)}


def read_ulog(path: Path) -> Log:
    """Return a ULog; raise FlightReadError if it is none, of a later format, or holds no message.

    Raises ImportError without pyulog.
    """
    pyulog = extra("pyulog", "logs")
    data = path.read_bytes()
    if not data.startswith(HEADER):
        raise FlightReadError(
            "Got a file that does not begin as a ULog does, but expected a log of PX4: is it "
            "empty, or of another kind?"
        )
    file = _Bytes(data)
    try:
        with redirect_stdout(io.StringIO()):  # where pyulog tells of damage
            log, order, lost = _parsed(file)
            version = log.get_version_info_str() or "development"
    except (pyulog.ULogException, EOFError, TypeError) as error:
        raise FlightReadError(f"Got a ULog that cannot be read: {error}.") from error
    topics = {}
    for data_set in log.data_list:
        fields = numeric_fields(data_set.data)
        time = _sampled(data_set.name, fields) * 1e-6
        name = instance_name(data_set.name, data_set.multi_id)
        topics[name] = Topic(time, order[data_set.msg_id], fields)
    if not topics:
        raise FlightReadError(
            f"Got a ULog of {len(data)} bytes without any data, but expected messages: was it cut "
            f"off?"
        )
    remarks = damage(len(data) - file.end, file.cut, lost)
    if log.file_corruption and not remarks:
        remarks = ("parts of the file could not be read and were skipped",)
    settings = log.initial_parameters | {name: value for _, name, value in log.changed_parameters}
    parameters = {key: float(x) for key, x in settings.items() if type(x) in (int, float)}
    return Log(
        kind="PX4 ULog",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware=f"{log.msg_info_dict.get('sys_name', 'PX4')} {version}",
        vehicle=_vehicle(topics, parameters),
        remarks=remarks,
        landed=("vehicle_land_detected", "landed", 1.0),
        outputs=OUTPUTS,
        controls=_controls(topics, parameters),
    )


class _Bytes(io.BytesIO):
    """A file that keeps where reading ended, and whether a read got less than it asked for."""

    cut, end, reads = False, 0, 0

    def read(self, size: int | None = -1) -> bytes:
        """Return the next bytes; raise EOFError if pyulog reads the same place without an end."""
        self.reads += 1
        if self.reads > self.getbuffer().nbytes + SPARE_READS:
            raise EOFError("most of it is damaged")
        content = super().read(size)
        expected = size or 0
        self.cut = len(content) < expected and (bool(content) or expected != HEAD_SIZE)
        self.end = self.tell()
        return content


def _parsed(file: _Bytes) -> tuple[Any, dict[int, Vector], int]:
    """Return pyulog's log, the order of the messages in the file by topic, and how many it lost."""
    from pyulog import ULog

    places: dict[int, list[int]] = {}
    counts: dict[str, int] = {}
    n_lost = n_fields = 0
    most = min(MOST_FIELDS_IN_ALL, file.getbuffer().nbytes)

    class Reader(ULog):
        class _MessageAddLogged(ULog._MessageAddLogged):
            def __init__(self, data, header, formats):
                nonlocal n_fields
                if len(data) < 4:
                    raise ValueError("no topic is named")
                n_fields += _n_fields(bytes(data[3:]).decode("latin-1"), formats, counts)
                if n_fields > most:
                    raise ValueError("the topics have too many fields")
                super().__init__(data, header, formats)
                if "timestamp" not in self.dtype.names or self.dtype["timestamp"] != "<u8":
                    raise ValueError(f"{self.message_name} has no time")
                places[self.msg_id] = []

        class _MessageData(ULog._MessageData):
            def initialize(self, data, header, subscriptions, log):
                nonlocal n_lost
                lost = len(data) < 2 or super().initialize(data, header, subscriptions, log)
                n_lost += lost
                if not lost:
                    places[int.from_bytes(data[:2], "little")].append(file.end)
                return lost

    for name in SHORT_MESSAGES:
        setattr(Reader, name, _forgiving(getattr(ULog, name)))
    log = Reader(file)
    return log, {number: np.array(ends, float) for number, ends in places.items()}, n_lost


def _forgiving(message: type) -> type:
    """Return a class of pyulog's messages whose instance, if too short, does not end the reading."""

    class Message(message):
        def __init__(self, *args, **options):
            try:
                super().__init__(*args, **options)
            except struct.error as error:
                raise ValueError("a message is too short") from error

    return Message


def _n_fields(name: str, formats: Mapping[str, Any], counts: dict[str, int]) -> int:
    """Return how many fields a message has; raise ValueError if it holds itself, or too many."""
    if name not in counts:
        counts[name] = MOST_FIELDS + 1  # of a message that holds itself
        counts[name] = sum(
            max(n, 1) * (_n_fields(kind, formats, counts) if kind in formats else 1)
            for kind, n, _ in formats[name].fields
        )
    if counts[name] > MOST_FIELDS:
        raise ValueError(f"{name} has more fields than a message can hold")
    return counts[name]


def _sampled(name: str, fields: Mapping[str, Vector]) -> Vector:
    """Return when something was sampled, or if that is not logged or an output, published [us]."""
    published = fields["timestamp"]
    if "timestamp_sample" not in fields or name.startswith("actuator"):
        return published
    sampled = fields["timestamp_sample"]
    believed = (sampled > 0) & (sampled <= published) & (published - sampled < LATEST)
    return np.where(believed, sampled, published)


def _vehicle(topics, parameters) -> str | None:
    """Return the kind of vehicle by its status, or by a parameter of ground stations."""
    status = topics.get("vehicle_status", {})
    if "is_vtol" in status and status["is_vtol"].any():
        return "VTOL"
    kinds = [
        names.get(whole(np.median(status[field])))
        for field, names in (("vehicle_type", VEHICLE_TYPES), ("system_type", MAV_TYPES))
        if field in status
    ]
    return next(filter(None, [*kinds, MAV_TYPES.get(whole(parameters.get("MAV_TYPE", 0.0)))]), None)


def _controls(topics, parameters) -> dict[str, Control]:
    """Return the servos of control allocation, else of a plane mixed by fixed rules.

    The torques of control allocation mix any number of surfaces in any way; elevons are then mixed.
    """
    types = {
        n: whole(parameters.get(f"CA_SV_CS{n}_TYPE", 0.0))
        for n in range(8)
        if f"control[{n}]" in topics.get("actuator_servos", ())
    }
    mixed: dict[str, Control] = {}
    for control, (axis, sign) in TORQUES.items():
        torques = {
            n: parameters.get(f"CA_SV_CS{n}_TRQ_{axis}", 0.0) * (kind in MIXED_TYPES)
            for n, kind in types.items()
        }
        total = sum(map(abs, torques.values()))
        if 0 < total < np.inf:
            mixed[control] = tuple(
                (sign * torque / total, Servo(f"actuator_servos.control[{n}]", UP, UP))
                for n, torque in torques.items()
                if torque
            )
    single = {
        SURFACES[types[n]]: ((1.0, Servo(f"actuator_servos.control[{n}]", UP, DOWN)),)
        for n in sorted(types, reverse=True)  # the first output of a type counts
        if types[n] in SURFACES
    }
    fixed = {
        key: ((1.0, Servo(f"{name}.control[{n}]", UP, throws)),)
        for name in [name for name in FIXED_MIXERS if "control[2]" in topics.get(name, ())][:1]
        for key, (n, throws) in CONTROLS.items()
    }
    unmixed = {k: v for k, v in (single or fixed).items() if not (mixed and k in ELEVONS)}
    return unmixed | mixed
