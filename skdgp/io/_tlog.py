"""Reader of telemetry logs of ground stations (tlog): MAVLink messages of PX4 or ArduPilot.

Each message stands after the time of its arrival, 8 bytes. pymavlink decodes it; see
https://mavlink.io/en/messages/ardupilotmega.html. Radio links deliver messages late and in bursts,
so the vehicle's own clock counts: a message without one was sent between its neighbours in the
file. Messages of other systems, such as the ground station, are left out.
"""

from __future__ import annotations

import io
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.frames import STANDARD_GRAVITY, euler_to_quaternion
from skdgp.io._dataflash import (
    NAMING,
    TRIM,
    by_parameters,
    lifting_modes,
    vehicle_of,
)
from skdgp.io._log import (
    EQUIVALENT,
    NOTHING,
    QUATERNION,
    Log,
    Rule,
    Topic,
    centi,
    damage,
    density_at,
    from_rpm,
    instance_name,
    last_before,
    milli,
    numeric_fields,
    rows_in,
    scaling,
    whole,
)
from skdgp.io._tables import FlightReadError
from skdgp.io._ulog import MAV_TYPES, TAILSITTERS

# bytes of the time of arrival before each message
STAMP = 8
# MAV_AUTOPILOT
PX4 = 12
# bit of FLIGHT_OPTIONS by which the telemetry of ArduPlane has the pitch of the vehicle
KEEPS_PITCH_TRIM = 1 << 8
# standard deviation of an AHRS_TRIM that is not known [rad], of at most 0.17; a guess
TILT_STD = 0.03
UNKNOWN_TRIM = (
    "the parameters AHRS_TRIM_X and _Y are not in the telemetry: accelerometers that are turned against the "
    "attitude by 0.05 rad change CX by 0.05 CL (fetch the parameters while the ground station records)"
)
# MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE, and the fields that have its bit
PRESSURE_SENSOR = 16
SENSOR_SETS = ("onboard_control_sensors_present", "onboard_control_sensors_health")
# a field of VFR_HUD that says whether there was a healthy sensor of the airspeed
PITOT = "has_sensor"
# MAV_PARAM_TYPE of whole numbers, which PX4 sends as the bits of a float: they are left out
INT32 = 6
CLOCKS = {"time_boot_ms": 1e-3, "time_usec": 1e-6}
# seconds from the clock of ATTITUDE beyond which the place in the file counts, as where there is none
LARGEST_DIFFERENCE = 60.0
NUMBERED = {"SERVO_OUTPUT_RAW": "port", "RAW_IMU": "id", "HIGHRES_IMU": "id"}
OUTPUTS = "SERVO_OUTPUT_RAW"
PX4_NAMING = "the log on board (.ulg), as no message of PX4 names them"
# MAV_VTOL_STATE 1 to 3 are transitions and rotary wing
HOVER = ("EXTENDED_SYS_STATE", "vtol_state", 1.0, 3.0)


def _wind_from(values: Matrix) -> Matrix:
    """Return the wind north, east of the direction [deg] that it comes from, and its speed."""
    direction, speed = values.T
    direction = np.deg2rad(direction)
    return np.column_stack([-speed * np.cos(direction), -speed * np.sin(direction)])


def _attitude(angles: Matrix) -> Matrix:
    return euler_to_quaternion(*angles.T)


def _density(hectopascals: Matrix) -> Matrix:
    return density_at(100 * hectopascals)


GYROS = "xgyro ygyro zgyro"
ACCELEROMETERS = "xacc yacc zacc"
milli_g = scaling(1e-3 * STANDARD_GRAVITY)
ESC = "ESC_TELEMETRY_1_TO_4"
AIRSPEED = "of a sensor, or estimated on board"
RULES = (
    Rule("p q r", "HIGHRES_IMU", GYROS),
    Rule("p q r", "RAW_IMU", GYROS, milli),
    Rule("p q r", "SCALED_IMU", GYROS, milli),
    Rule("p q r", "ATTITUDE", "rollspeed pitchspeed yawspeed"),
    Rule("ax ay az", "HIGHRES_IMU", ACCELEROMETERS),
    Rule("ax ay az", "RAW_IMU", ACCELEROMETERS, milli_g),
    Rule("ax ay az", "SCALED_IMU", ACCELEROMETERS, milli_g),
    Rule(QUATERNION, "ATTITUDE", "roll pitch yaw", _attitude),
    # estimated on board where the autopilot does not use the sensor
    Rule(
        EQUIVALENT,
        "VFR_HUD",
        "airspeed",
        valid=f"airspeed {PITOT}",
        note=AIRSPEED,
        uses="ARSPD_USE",
    ),
    Rule("v_north v_east v_down", "LOCAL_POSITION_NED", "vx vy vz"),
    Rule("v_north v_east v_down", "GLOBAL_POSITION_INT", "vx vy vz", centi),
    Rule("north east down", "LOCAL_POSITION_NED", "x y z"),
    Rule("altitude", "GLOBAL_POSITION_INT", "alt", milli),
    Rule("density", "SCALED_PRESSURE", "press_abs", _density),
    Rule("wind_north wind_east", "WIND", "direction speed", _wind_from),
    Rule("wind_north wind_east", "WIND_COV", "wind_x wind_y"),
    Rule("throttle", "VFR_HUD", "throttle", centi),
    Rule("propeller_speed", "RPM", "rpm1 rpm2", from_rpm, engines=1),
    Rule("propeller_speed", ESC, "rpm[0] rpm[1] rpm[2] rpm[3]", from_rpm, engines=1),
)
# further instances of sensors, which have messages of their own
ALIASES = {
    "SCALED_IMU": "SCALED_IMU2 SCALED_IMU3",
    "SCALED_PRESSURE": "SCALED_PRESSURE2 SCALED_PRESSURE3",
}
READ = {rule.topic for rule in RULES}.union(" ".join(ALIASES.values()).split()) | {
    OUTPUTS,
    "EXTENDED_SYS_STATE",
    "HEARTBEAT",
    "PARAM_VALUE",
    "SYS_STATUS",
}


def read_tlog(path: Path) -> Log:
    """Return a telemetry log; raise FlightReadError if it is none, ImportError without pymavlink."""
    mavlink = extra("pymavlink.dialects.v20.ardupilotmega", "logs")
    messages, skipped = _messages(path.read_bytes(), mavlink)
    system, others = _system(messages)
    by_name = _by_name(messages, system)
    beats = by_name.get("HEARTBEAT", {}).values()
    is_px4 = any(beat.autopilot == PX4 for beat in beats)
    # only PX4's tailsitters log in axes of hover
    types = MAV_TYPES if is_px4 else MAV_TYPES | dict.fromkeys(TAILSITTERS, "VTOL")
    vehicles = [types[beat.type] for beat in beats if beat.type in types]
    parameters = {}
    for message in by_name.pop("PARAM_VALUE", {}).values():
        if not (is_px4 and message.param_type == INT32):
            parameters[message.param_id] = message.param_value
    topics = _topics(by_name)
    of_trim: tuple[str, ...] = ()
    if not is_px4:
        attitude = topics["ATTITUDE"]
        pitch = attitude["pitch"] + _pitch_trim(parameters)
        topics["ATTITUDE"] = attitude.with_fields(pitch=pitch)
        of_trim = () if TRIM[0] in parameters else (UNKNOWN_TRIM,)
    log = Log(
        kind="MAVLink telemetry",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware="PX4" if is_px4 else "ArduPilot",
        vehicle=_vehicle(topics, vehicles, parameters),
        remarks=(*damage(skipped), *others, *of_trim),
        landed=(("EXTENDED_SYS_STATE", "landed_state", 1.0, 1.0),),
        naming=PX4_NAMING if is_px4 else f"{NAMING} (fetch them while the ground station records)",
        aliases=ALIASES,
        sensor_tilt=TILT_STD if of_trim else 0.0,
    )
    modes = () if is_px4 else lifting_modes("HEARTBEAT", "custom_mode")
    return by_parameters(log, OUTPUTS + ".servo{}_raw", modes, (HOVER,))


def _system(messages: list[Any]) -> tuple[int, list[str]]:
    """Return the number of the vehicle with most attitudes, and a remark on others, if there are any.

    Raises FlightReadError if there is no attitude.
    """
    flown = Counter(each.get_srcSystem() for each in messages if each.get_type() == "ATTITUDE")
    if not flown:
        raise FlightReadError(
            "Got a file without a message ATTITUDE of MAVLink, but expected the "
            "telemetry of an aircraft: is it empty, or of another kind?"
        )
    system, _ = flown.most_common(1)[0]
    remark = f"of the vehicles {sorted(flown)} number {system} is read, with most attitudes"
    return system, [remark] if len(flown) > 1 else []


def _topics(by_name: Mapping[str, dict[int, Any]]) -> dict[str, Topic]:
    """Return the topics, with a field on whether a sensor measured the airspeed."""
    attitudes = by_name["ATTITUDE"]
    places = np.array([*attitudes], dtype=float)
    times = np.array([1e-3 * message.time_boot_ms for message in attitudes.values()])
    # the clock stands between the last attitude before a restart and the first behind it
    falls = np.flatnonzero(np.diff(times) < 0.0)
    last = places[falls + 1] - 0.5
    attitude = np.insert(places, falls + 1, last), np.insert(times, falls + 1, times[falls])
    topics = {name: _topic(by_name[name], attitude) for name in sorted(by_name)}
    if {"VFR_HUD", "SYS_STATUS"} <= topics.keys():
        topics["VFR_HUD"] = _with_pitot(topics["VFR_HUD"], topics["SYS_STATUS"])
    return topics


def _vehicle(
    topics: dict[str, Topic], vehicles: list[str], parameters: dict[str, float]
) -> str | None:
    """Return the kind of vehicle by heartbeats; of a plane with a state in hover or transition "VTOL"."""
    vehicle = vehicle_of(vehicles[0] if vehicles else None, parameters)
    states = topics.get(HOVER[0], NOTHING)
    hovers = rows_in((HOVER,), topics, states.time).any()
    return "VTOL" if vehicle == "fixed wing" and hovers else vehicle


def _pitch_trim(parameters: Mapping[str, float]) -> float:
    """Return the pitch trim [rad] that the telemetry of ArduPlane subtracts from theta (GCS_MAVLINK_Plane)."""
    if whole(parameters.get("FLIGHT_OPTIONS", 0.0)) & KEEPS_PITCH_TRIM:
        return 0.0
    degrees = parameters.get("PTCH_TRIM_DEG", 0.01 * parameters.get("TRIM_PITCH_CD", 0.0))
    return float(np.deg2rad(degrees))


def _with_pitot(hud: Topic, status: Topic) -> Topic:
    """Return the messages with a field that says whether a sensor measured the airspeed, else it is estimated."""
    rows = last_before(status.order, hud.order)
    present, healthy = (status.fields[name][rows].astype(int) for name in SENSOR_SETS)
    return hud.with_fields(**{PITOT: present & healthy & PRESSURE_SENSOR})


def _messages(data: bytes, mavlink: Any) -> tuple[list[Any], int]:
    """Return the messages to read, and the number of bytes that belong to none."""
    decoder = mavlink.MAVLink(None)
    decoder.robust_parsing = True
    file = io.BytesIO(data)
    file.seek(STAMP)
    messages = []
    skipped = 0
    while content := file.read(decoder.bytes_needed()):
        message = decoder.parse_char(content)
        if message is None:
            continue
        if message.get_type() == "BAD_DATA":
            skipped += len(message.data)
            continue
        file.seek(STAMP, io.SEEK_CUR)
        if message.get_type() in READ:
            messages.append(message)
    return messages, skipped


def _by_name(messages: list[Any], system: int) -> dict[str, dict[int, Any]]:
    """Return the messages of a system by the name of their topic, with its instance, and their place in the file."""
    by_name: defaultdict[str, dict[int, Any]] = defaultdict(dict)
    for place, message in enumerate(messages):
        if message.get_srcSystem() == system:
            kind = message.get_type()
            instance = message.to_dict().get(NUMBERED.get(kind), 0)
            by_name[instance_name(kind, int(instance))][place] = message
    return by_name


def _topic(messages: dict[int, Any], attitude: tuple[Vector, Vector]) -> Topic:
    """Return a topic; a message without a time near the attitude's, by places and times, was sent between these."""
    sent = [message.to_dict() for message in messages.values()]
    numbers = numeric_fields({name: [fields[name] for fields in sent] for name in sent[0]})
    places = np.array([*messages], dtype=float)
    time = np.interp(places, *attitude)
    for name, factor in CLOCKS.items():
        if name in numbers:
            clock = factor * numbers[name]
            time = np.where(np.abs(clock - time) < LARGEST_DIFFERENCE, clock, time)
    return Topic(time, places, numbers)
