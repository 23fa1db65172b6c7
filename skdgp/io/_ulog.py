"""Reader of PX4 logs (ULog) by pyulog.

Topics: https://docs.px4.io/main/en/msg_docs. A damaged file is read as far as pyulog reads it.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import extra
from skdgp._compute.typing import Vector
from skdgp._flight.frames import euler_to_matrix
from skdgp.io._log import (
    DOWN,
    NOTHING,
    OPENING,
    QUATERNION,
    UP,
    Control,
    Log,
    Rule,
    Servo,
    Topic,
    Use,
    from_rpm,
    in_force,
    instance_name,
    milli,
    numeric_fields,
    scaled,
    turned,
    whole,
)
from skdgp.io._tables import FlightReadError

HEADER = b"ULog\x01\x12\x35"
# spread of the delays from sampling to publishing [us], and delay that is told; guesses
LATEST = 1_000_000
TAILSITTERS = (19, 20, 23)
MAV_TYPES = {
    1: "fixed wing",
    10: "rover",
    11: "boat",
    12: "submarine",
    **dict.fromkeys((2, 3, 4, 13, 14, 15), "multicopter"),
    **dict.fromkeys(range(19, 26), "VTOL"),
    **dict.fromkeys(TAILSITTERS, "tailsitter"),
}
# kinds of vehicles by fields of vehicle_status, the first that tells one
KINDS = (
    ("is_vtol_tailsitter", {1: "tailsitter"}),
    ("is_vtol", {1: "VTOL"}),
    ("vehicle_type", {1: "multicopter", 2: "fixed wing", 3: "rover", 4: "airship"}),
    ("system_type", MAV_TYPES),
)


ATTITUDE = "q[0] q[1] q[2] q[3]"
# a position in three dimensions (SensorGps.msg)
FIX = (("fix_type", 3, 8),)
# -1 and 0 are no sensor: disabled, ground speed less wind; 4 is synthetic (AirspeedValidated.msg)
MEASURED = (("airspeed_source", 1, 3), ("selected_airspeed_index", 1, 3))
PITOT = tuple(
    Use("airspeed_validated", field, first=1, is_measurement=True) for field, _, _ in MEASURED
)


def _gps(topic: str) -> tuple[Rule, ...]:
    """Return the rules of a GPS; versions before 1.14 have the altitude in millimetres."""
    velocity = "vel_n_m_s vel_e_m_s vel_d_m_s"
    return (
        Rule("v_north v_east v_down", topic, velocity, valid="vel_ned_valid", within=FIX),
        Rule("altitude", topic, "altitude_msl_m", within=FIX),
        Rule("altitude", topic, "alt", milli, within=FIX),
    )


def _wind(topic: str) -> Rule:
    return Rule("wind_north wind_east", topic, "windspeed_north windspeed_east")


MOST_ENGINES = 12
MOTOR_FIELDS = [f"control[{k}]" for k in range(MOST_ENGINES)]
ESC_FIELDS = [f"esc[{k}].esc_rpm" for k in range(MOST_ENGINES)]
# an engine that is switched off has no number
MOTORS = Rule("throttle", "actuator_motors", " ".join(MOTOR_FIELDS), np.nan_to_num, engines=1)
RULES = (
    # other sources are one number for several engines, also where one is switched off
    MOTORS._replace(engines=2),
    Rule("p q r", "vehicle_angular_velocity", "xyz[0] xyz[1] xyz[2]"),
    Rule("p q r", "sensor_combined", "gyro_rad[0] gyro_rad[1] gyro_rad[2]"),
    Rule("p q r", "vehicle_attitude", "rollspeed pitchspeed yawspeed"),
    Rule("p q r", "sensor_gyro", "x y z"),
    Rule("ax ay az", "vehicle_acceleration", "xyz[0] xyz[1] xyz[2]"),
    Rule(
        "ax ay az",
        "sensor_combined",
        "accelerometer_m_s2[0] accelerometer_m_s2[1] accelerometer_m_s2[2]",
    ),
    Rule("ax ay az", "sensor_accel", "x y z"),
    Rule(QUATERNION, "vehicle_attitude", ATTITUDE, resets="quat_reset_counter"),
    Rule(
        "airspeed",
        "airspeed_validated",
        "true_airspeed_m_s",
        valid="airspeed_sensor_measurement_valid",
        within=MEASURED,
    ),
    Rule("airspeed", "airspeed", "true_airspeed_m_s", used=PITOT),
    Rule("alpha", "airflow_aoa", "aoa_rad"),
    Rule("beta", "airflow_slip", "slip_rad"),
    Rule(
        "v_north v_east v_down",
        "vehicle_local_position",
        "vx vy vz",
        valid="v_xy_valid v_z_valid",
        resets="vxy_reset_counter vz_reset_counter",
    ),
    Rule("v_north v_east v_down", "vehicle_global_position", "vel_n vel_e vel_d"),
    Rule("north east down", "vehicle_local_position", "x y z", valid="xy_valid z_valid"),
    Rule("altitude", "vehicle_global_position", "alt"),
    Rule("altitude", "vehicle_air_data", "baro_alt_meter", note="of the barometer"),
    *_gps("vehicle_gps_position"),
    *_gps("sensor_gps"),
    Rule("density", "vehicle_air_data", "rho"),
    _wind("wind"),
    _wind("wind_estimate"),
    Rule("throttle", "actuator_controls_1", "control[3]", note="of a VTOL in forward flight"),
    Rule("throttle", "actuator_controls_0", "control[3]"),
    Rule("throttle", "vehicle_thrust_setpoint", "xyz[0]"),
    MOTORS,
    Rule("propeller_speed", "esc_status", " ".join(ESC_FIELDS), from_rpm, engines=1),
    Rule("propeller_speed", "rpm", "rpm_estimate", from_rpm, engines=1),
    Rule("propeller_speed", "rpm", "indicated_frequency_rpm", from_rpm, engines=1),
)

# topics of single sensors, in axes of the board; others are in body axes
OF_BOARD = ("sensor_gyro", "sensor_accel")
BY_BOARD = "turned by SENS_BOARD_ROT, _X_OFF, _Y_OFF, _Z_OFF"
# roll, pitch, heading [deg] by SENS_BOARD_ROT (lib/conversion/rotation.h)
BOARD_ROTATIONS = (
    *((0, 0, yaw) for yaw in range(0, 360, 45)),
    *((180, 0, yaw) for yaw in (0, 45, 90, 135)),
    (0, 180, 0),
    *((180, 0, yaw) for yaw in (225, 270, 315)),
    *((90, 0, yaw) for yaw in (0, 45, 90, 135)),
    *((270, 0, yaw) for yaw in (0, 45, 90, 135)),
    (0, 90, 0),
    (0, 270, 0),
)
# VEHICLE_VTOL_STATE 1 to 3 are transitions and rotary wing; before, two flags (VtolVehicleStatus.msg)
LIFTING = (
    ("vtol_vehicle_status", "vehicle_vtol_state", 1, 3),
    ("vtol_vehicle_status", "vtol_in_rw_mode", 1, 1),
    ("vtol_vehicle_status", "vtol_in_trans_mode", 1, 1),
    ("vehicle_status", "in_transition_mode", 1, 1),
    ("vehicle_status", "vehicle_type", 1, 1),
)
# VT_TYPE of tailsitters, whose body axes are those of hover, and of tiltrotors, whose thrust is along -z
TAILSITTER = 0
TILTROTOR = 1
TILTED = Rule("throttle", "vehicle_thrust_setpoint", "xyz[2]", np.negative)
TILTROTOR_RULES = (RULES[0], TILTED, *RULES[1:])

FIXED_MIXERS = ("actuator_controls_1", "actuator_controls_0")  # 1: the wings of a VTOL
OUTPUTS = ("actuator_servos", "actuator_outputs", "actuator_outputs#1", *FIXED_MIXERS)
NAMING = "the parameters CA_SV_CSn_TRQ_R, _P, _Y, or the controls before a fixed mixer (actuator_controls_0)"
MOST_SURFACES = 8  # of control allocation
MOST_IMUS = 4
# Parameters of the position of the IMUs, the same for all (ekf2_params)
IMU_POSITIONS = ("EKF2_IMU_POS",) * MOST_IMUS
SURFACE_PARAMETERS = ("TYPE", "FLAP", "TRQ_R", "TRQ_P", "TRQ_Y")
# CA_SV_CSn_TYPE of surfaces that turn the aircraft:
# ailerons, elevator, rudder, elevons, V-tail; custom, A-tail, a single servo of both ailerons. No
# flaps, airbrakes, wheels, spoilers (ActuatorEffectivenessControlSurfaces.hpp).
MIXED_TYPES = (*range(1, 9), *range(12, 16))
# Left and right flaps
FLAPS = (9, 10)
# Torques CA_SV_CSn_TRQ_ that allocate a control, and its sign in a flight table at a positive
# torque
TORQUES = {"aileron": ("TRQ_R", 1.0), "elevator": ("TRQ_P", -1.0), "rudder": ("TRQ_Y", -1.0)}
# Surfaces by the fields of actuator_controls, and their throws: more elevator and rudder turn against our sign; flaps,
# spoilers and airbrakes open from zero (ActuatorControls.msg)
CONTROLS = {
    "control[0]": ("aileron", UP, UP),
    "control[1]": ("elevator", UP, DOWN),
    "control[2]": ("rudder", UP, DOWN),
    "control[4]": ("flap", OPENING, OPENING),
    "control[6]": ("spoiler", OPENING, OPENING),
    "control[5]": ("spoiler", OPENING, OPENING),
}


def read_ulog(path: Path) -> Log:
    """Return a ULog as far as pyulog reads it.

    Raises FlightReadError if it is none, of a later format, or holds no message, ImportError
    without pyulog.
    """
    log = _parsed(path.read_bytes())
    topics = {}
    remarks = ["parts of the file could not be read and were skipped"] * log.file_corruption
    for data_set in log.data_list:
        if "timestamp" in data_set.data:
            name = instance_name(data_set.name, data_set.multi_id)
            fields = numeric_fields(data_set.data)
            delay = _delay(data_set.name, fields)
            late = np.median(delay)
            if late > LATEST:
                remarks.append(
                    f"{name} is published {1e-6 * late:.1f} s after it was sampled, which counts"
                )
            # PX4's clock is not set back: wrong times are known among those of all topics
            time = 1e-6 * (fields["timestamp"] - delay)
            # which would be in place at the beginning
            time[1:][time[1:] == 0] = np.nan
            topics[name] = Topic(time, time, fields)
    if not topics:
        raise FlightReadError("Got a ULog without any data, but expected messages: was it cut off?")
    parameters = _parameters(log, topics)
    vehicle = _vehicle(topics, parameters)
    is_vtol = vehicle == "VTOL"
    lifting = LIFTING if is_vtol else ()
    tilts = is_vtol and parameters.get("VT_TYPE") == TILTROTOR
    surfaces = _surfaces(topics, parameters)
    return Log(
        kind="PX4 ULog",
        topics=topics,
        rules=_in_body_axes(TILTROTOR_RULES if tilts else RULES, parameters),
        parameters=parameters,
        firmware=f"{log.msg_info_dict.get('sys_name', 'PX4')} {log.get_version_info_str() or 'development'}",
        vehicle=vehicle,
        remarks=tuple(remarks),
        landed=(("vehicle_land_detected", "landed", 1.0, 1.0),),
        outputs=OUTPUTS,
        naming=NAMING,
        # before a fixed mixer, if the outputs of no surface are known
        controls=(_mixed_controls(surfaces) or _fixed_controls(topics)) | _flaps(surfaces),
        lifting=lifting,
        commands={} if is_vtol else _commands(topics, parameters),
        sensor_positions=IMU_POSITIONS,
    )


def _parsed(data: bytes) -> Any:
    """Return the log of pyulog; raise FlightReadError if it reads none."""
    pyulog = extra("pyulog", "logs")
    if not data.startswith(HEADER):
        raise FlightReadError(
            "Got a file that does not begin as a ULog does, but expected a log of PX4: is it empty, "
            "or of another kind? A log of PX4 is named .ulg, one of ArduPilot .bin."
        )
    try:
        # where pyulog tells of damage
        with redirect_stdout(io.StringIO()):
            log = pyulog.ULog(io.BytesIO(data))
            log.get_version_info_str()
    except (pyulog.ULogException, RecursionError, LookupError, TypeError, ValueError) as error:
        raise FlightReadError(f"Got a ULog that cannot be read: {error}.") from error
    return log


def _in_body_axes(rules: tuple[Rule, ...], parameters: Mapping[str, float]) -> tuple[Rule, ...]:
    """Return rules whose sensors in axes of the board are turned to body axes, as PX4 does (GetBoardRotationMatrix)."""
    place = whole(parameters.get("SENS_BOARD_ROT", 0.0))
    offsets = [parameters.get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"]
    if not 0 <= place < len(BOARD_ROTATIONS):
        return tuple(rule for rule in rules if rule.topic not in OF_BOARD)
    board = euler_to_matrix(*np.deg2rad(BOARD_ROTATIONS[place]))
    rotation = euler_to_matrix(*np.deg2rad(offsets)) @ board
    return turned(rules, rotation, BY_BOARD, OF_BOARD)


def _delay(name: str, fields: Mapping[str, Vector]) -> Vector:
    """Return how long after it was sampled each message was published [us], (n,).

    Zero where that is not logged or no time near the others' delay, and of outputs, which count from when they are
    sent.
    """
    published = fields["timestamp"].astype(float)
    sampled = fields.get("timestamp_sample", published).astype(float)
    delay = published - sampled
    is_told = (sampled > 0) & (delay >= 0)
    if name.startswith("actuator") or not is_told.any():
        return np.zeros(len(published))
    usual = np.median(delay[is_told])
    is_steady = np.abs(delay - usual) < LATEST
    if not is_steady[is_told].mean() > 0.5:
        return np.zeros(len(published))
    return np.where(is_told & is_steady, delay, 0.0)


def _parameters(log: Any, topics: Mapping[str, Topic]) -> dict[str, float]:
    """Return the parameters that are numbers."""
    changes = [(-np.inf, name, value) for name, value in log.initial_parameters.items()]
    for time, name, value in log.changed_parameters:
        changes.append((1e-6 * time, name, value))
    numbers = [change for change in changes if isinstance(change[2], int | float)]
    return in_force(numbers, topics)


def _vehicle(topics: Mapping[str, Topic], parameters: Mapping[str, float]) -> str | None:
    """Return the kind of vehicle by its status, or by a parameter of ground stations."""
    status = topics.get("vehicle_status", NOTHING)
    told = [names.get(whole(np.median(status[field]))) for field, names in KINDS if field in status]
    told.append(MAV_TYPES.get(whole(parameters.get("MAV_TYPE", 0.0))))
    vehicle = next(filter(None, told), None)
    is_tailsitter = vehicle == "VTOL" and parameters.get("VT_TYPE") == TAILSITTER
    return "tailsitter" if is_tailsitter else vehicle


def _surfaces(topics: Mapping[str, Topic], parameters: Mapping[str, float]) -> pd.DataFrame:
    """Return the surfaces of control allocation whose outputs are logged: their parameters CA_SV_CSn_, zero if absent.

    A row for each, by the number n of its output.
    """
    outputs = topics.get("actuator_servos", NOTHING)
    count = whole(parameters.get("CA_SV_CS_COUNT", MOST_SURFACES))
    logged = [n for n in range(min(count, MOST_SURFACES)) if f"control[{n}]" in outputs]
    surfaces = pd.DataFrame(index=logged, columns=SURFACE_PARAMETERS, dtype=float)
    for name in surfaces:
        surfaces[name] = [parameters.get(f"CA_SV_CS{n}_{name}", 0.0) for n in logged]
    return surfaces


def _servo(number: Any, inputs: tuple[float, ...], throws: tuple[float, ...]) -> Servo:
    """Return the servo of a surface with deflections at some values of its output."""
    return Servo(f"actuator_servos.control[{number}]", inputs, throws)


def _mixed_controls(surfaces: pd.DataFrame) -> dict[str, Control]:
    """Return the controls that several surfaces share, weighted by their torques about axes, with a sign."""
    controls: dict[str, Control] = {}
    mixed = surfaces[surfaces["TYPE"].isin(MIXED_TYPES)]
    for control, (axis, sign) in TORQUES.items():
        torques = sign * mixed[axis][mixed[axis] != 0.0]
        total = torques.abs().sum()
        if 0 < total < np.inf:
            weights = (torques / total).items()
            controls[control] = tuple(_servo(n, UP, UP).times(weight) for n, weight in weights)
    return controls


def _flaps(surfaces: pd.DataFrame) -> dict[str, Control]:
    """Return the mean f of the flaps, 0 to 1, whose outputs are (2 f - 1) CA_SV_CSn_FLAP.

    See ActuatorEffectivenessControlSurfaces.cpp; versions without the parameter have none.
    """
    scales = surfaces["FLAP"][surfaces["TYPE"].isin(FLAPS) & (surfaces["FLAP"] != 0.0)]
    servos = []
    for number, scale in scales.items():
        throws = OPENING if scale > 0 else OPENING[::-1]
        servos.append(_servo(number, (-abs(scale), abs(scale)), throws))
    return {"flap": scaled(tuple(servos), 1 / len(servos))} if servos else {}


def _fixed_controls(topics: Mapping[str, Topic]) -> dict[str, Control]:
    """Return the controls before a fixed mixer; what opens must move."""
    controls: dict[str, Control] = {}
    for name in FIXED_MIXERS:
        topic = topics.get(name, NOTHING)
        for field, (control, inputs, throws) in CONTROLS.items() if "control[2]" in topic else ():
            if inputs == UP or (field in topic and np.ptp(topic[field]) > 0):
                controls[control] = (Servo(f"{name}.{field}", inputs, throws),)
        if controls:
            break
    return controls


def _commands(topics: Mapping[str, Topic], parameters: Mapping[str, float]) -> dict[str, Control]:
    """Return the mean throttle of the left less that of the right engines of a fixed wing, by CA_ROTORn_PY."""
    outputs = topics.get("actuator_motors", NOTHING)
    sides: dict[bool, list[Servo]] = {True: [], False: []}
    for n, channel in enumerate(MOTOR_FIELDS):
        place = parameters.get(f"CA_ROTOR{n}_PY", 0.0)
        if place and channel in outputs and np.isfinite(outputs[channel]).any():
            sides[place < 0].append(Servo(f"actuator_motors.{channel}", OPENING, OPENING))
    left, right = sides.values()
    if not (left and right):
        return {}
    more_left = scaled(tuple(left), 1 / len(left))
    return {"differential_throttle": more_left + scaled(tuple(right), -1 / len(right))}
