"""Reader of ArduPilot logs (DataFlash).

Format: https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html. A
message begins with two fixed bytes and a type; the formats of the types are messages too. Every
length is checked: where no message begins, reading continues at the next two fixed bytes. Messages: https://ardupilot.org/plane/docs/logmessages.html.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import HIGH_LIFT
from skdgp._flight.frames import euler_to_matrix, euler_to_quaternion
from skdgp._flight.servo_functions import TURNED, WEIGHTS, ServoFunction, ServoRange
from skdgp.io._log import (
    DOWN,
    EQUIVALENT,
    NOTHING,
    OPENING,
    QUATERNION,
    UP,
    Control,
    Log,
    Rule,
    Servo,
    States,
    Topic,
    Use,
    centi,
    damage,
    density_at,
    from_rpm,
    in_force,
    instance_name,
    last_before,
    numeric_fields,
    turned,
    whole,
)
from skdgp.io._tables import FlightReadError

# a message begins with a mark and a type
MARK = b"\xa3\x95"
HEAD = len(MARK) + 1
# type of the messages that define types
FMT = 0x80
# of unused pages of the memory chip
FILLING = b"\x00\xff"
TYPES = {
    "a": "(32,)<i2", "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "d": "<f8",
    "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4",
    "M": "u1", "q": "<i8", "Q": "<u8",
}  # fmt: skip
SCALE = {**dict.fromkeys("cCeE", 1e-2), "L": 1e-7}
# messages that describe the log, and are no topics
DEFINITIONS = {"FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG"}
# fields that number instances
INSTANCES = ("I", "Instance", "C", "chan")
# of a program by its parameter FRAME_CLASS (AP_Motors_Class.h, GCS_MAVLINK_Rover)
FRAMES = {
    ("ArduRover", 2): "boat", ("Rover", 2): "boat",
    **dict.fromkeys((("ArduCopter", 6), ("ArduCopter", 11), ("ArduCopter", 13)), "helicopter"),
}  # fmt: skip
VEHICLES = {
    "ArduPlane": "fixed wing", "ArduCopter": "multicopter", "ArduRover": "rover", "Rover": "rover",
    "ArduSub": "submarine", "Blimp": "airship", "AntennaTracker": "antenna tracker",
}  # fmt: skip


def _ground_course(values: Matrix) -> Matrix:
    """Return velocity north, east, down of ground speed, course [deg], velocity down."""
    speed, course, down = values.T
    course = np.deg2rad(course)
    return np.column_stack([speed * np.cos(course), speed * np.sin(course), down])


def _attitude(degrees: Matrix) -> Matrix:
    return euler_to_quaternion(*np.deg2rad(degrees).T)


STANDARD = "standard atmosphere at the measured pressure"
# the lane of the estimator, and the sensor, that the autopilot used (AP_NavEKF3, AP_Airspeed)
LANE_3 = (Use("XKF4", "PI"),)
LANE_2 = (Use("NKF4", "PI"),)
PRIMARY = (Use("ARSP", "Pri"), Use("ARSP", "Primary"), Use("", "ARSPD_PRIMARY"))
# a position in three dimensions
FIX = (("Status", 3, 6),)
# whether the autopilot uses an airspeed sensor (2: without throttle alone), and an IMU
AIRSPEED_USES = "ARSPD_USE ARSPD2_USE"
IMU_USES = "INS_USE INS_USE2 INS_USE3 INS4_USE INS5_USE"
# ratio of V^2 to the pressure difference, by the names of the topic
RATIOS = {"ARSP": "ARSPD_RATIO", "ARSP#1": "ARSPD2_RATIO", "ASP2": "ARSPD2_RATIO"}
# parameters of the position of each IMU (AP_InertialSensor)
IMU_POSITIONS = ("INS_POS1", "INS_POS2", "INS_POS3", "INS4_POS", "INS5_POS")
# further instances of sensors before the messages had a number
ALIASES = {
    "ARSP": "ASP2", "IMU": "IMU2 IMU3", "GPS": "GPS2 GPSB", "BARO": "BAR2 BAR3",
    "NKF1": "NKF6", "NKF2": "NKF7", "XKF1": "XKF6", "XKF2": "XKF7",
    "ESC": "ESC1 ESC2 ESC3 ESC4 ESC5 ESC6 ESC7 ESC8",
}  # fmt: skip


def _estimator(name: str, lane: tuple[Use, ...]) -> tuple[Rule, Rule, Rule]:
    """Return the rules for velocity, position and wind of an estimator."""
    return (
        Rule("v_north v_east v_down", f"{name}1", "VN VE VD", used=lane),
        Rule("north east down", f"{name}1", "PN PE PD", used=lane),
        Rule("wind_north wind_east", f"{name}2", "VWN VWE", used=lane),
    )


RULES = (
    Rule("p q r", "IMU", "GyrX GyrY GyrZ", valid="GH", uses=IMU_USES),
    Rule("ax ay az", "IMU", "AccX AccY AccZ", valid="AH", uses=IMU_USES),
    Rule(QUATERNION, "ATT", "Roll Pitch Yaw", _attitude),
    Rule(QUATERNION, "AHR2", "Roll Pitch Yaw", _attitude),
    Rule(
        EQUIVALENT,
        "ARSP",
        "Airspeed",
        valid="H Health U",
        used=PRIMARY,
        uses=AIRSPEED_USES,
    ),
    *_estimator("XKF", LANE_3),
    *_estimator("NKF", LANE_2),
    Rule("v_north v_east v_down", "GPS", "Spd GCrs VZ", _ground_course, within=FIX),
    Rule("altitude", "POS", "Alt"),
    Rule("altitude", "GPS", "Alt", within=FIX),
    Rule("density", "BARO", "Press", density_at, "H Health", STANDARD),
    Rule("throttle", "CTUN", "ThO", centi),
    Rule("throttle", "CTUN", "ThrOut", centi),
    Rule("throttle", "AETR", "Thr", centi),
    Rule("propeller_speed", "RPM", "RPM rpm1 rpm2", from_rpm, valid="H", engines=1),
    Rule("propeller_speed", "ESC", "RPM", from_rpm, engines=1),
)

# surfaces by the function of their servo
SURFACES: dict[int, str] = {
    ServoFunction.AILERON: "aileron",
    ServoFunction.ELEVATOR: "elevator",
    ServoFunction.RUDDER: "rudder",
    ServoFunction.ELEVON_LEFT: "elevon_left",
    ServoFunction.ELEVON_RIGHT: "elevon_right",
    ServoFunction.FLAP: "flap",
    ServoFunction.AUTOMATIC_FLAP: "flap",
    ServoFunction.AIRBRAKE: "spoiler",
}
NAMING = "the parameters SERVOn_FUNCTION"
# that are logged
MOST_SERVOS = 16
# of the left and the right engine of a twin, throttle +- half the rudder's part (ArduPlane/servos.cpp)
TWIN = (ServoFunction.THROTTLE_LEFT, ServoFunction.THROTTLE_RIGHT)
# motors 1 to 32 of a multicopter by SERVOn_FUNCTION (SRV_Channel.h); those of Q_TILT_MASK, and of tailsitters
# Q_TAILSIT_MOTMX, drive forward too
LIFT_MOTORS = (*range(33, 41), *range(82, 86), *range(160, 180))
# angles [rad] of the vehicle against the board: roll, pitch, heading
TRIM = ("AHRS_TRIM_X", "AHRS_TRIM_Y", "AHRS_TRIM_Z")
# mixed to one control each; elevons are surfaces of their own
MIXED = (
    ServoFunction.FLAPERON_LEFT,
    ServoFunction.FLAPERON_RIGHT,
    ServoFunction.VTAIL_LEFT,
    ServoFunction.VTAIL_RIGHT,
)
# functions of differential spoilers, which are not read
SPOILERS = {16, 17, 86, 87}
# numbers of the modes QSTABILIZE to QACRO and LOITER_ALT_QLAND, in which rotors lift a VTOL (ArduPlane/mode.h)
LIFTING_MODES = (*range(17, 24), 25)
# fraction of the range of pulses above which a motor runs; a guess
RUNNING = 0.05


def read_dataflash(path: Path) -> Log:
    """Return a DataFlash log; raise FlightReadError if it is none or holds no message with a time."""
    data = path.read_bytes()
    if not data.startswith(MARK):
        raise FlightReadError(
            "Got a file that does not begin as a DataFlash log does, but expected a "
            "binary log of ArduPilot: is it empty, in text, or of another kind? A log of PX4 is named .ulg, one of "
            "ArduPilot .bin."
        )
    messages, remarks = _scan(data)
    topics: dict[str, Topic] = {}
    for name in messages.keys() - DEFINITIONS:
        topics |= messages[name].topics()
    if not topics:
        raise FlightReadError(
            f"Got a DataFlash log of {len(data)} bytes in which no message has a TimeUS, "
            "but expected messages: was it cut off, or written before 2015?"
        )
    return _log(dict(sorted(topics.items())), messages, remarks)


class Messages:
    """Messages of one type: name, letters of the types of their columns, and their places in a file."""

    def __init__(self, data: bytes, name: str, codes: str, columns: list[str]):
        self.data = data
        self.name = name
        self.codes = dict(zip(columns, codes, strict=True))
        self.dtype = np.dtype([(column, TYPES[code]) for column, code in self.codes.items()])
        self.starts: list[int] = []

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns (n,) by name; integers with a scale as numbers, texts as bytes."""
        size = self.dtype.itemsize
        content = b"".join(self.data[k : k + size] for k in self.starts)
        records = np.frombuffer(content, self.dtype)
        columns = {}
        for column, code in self.codes.items():
            values = records[column]
            columns[column] = SCALE[code] * values if code in SCALE else values
        return columns

    def topics(self) -> dict[str, Topic]:
        """Return the topic of each instance by name, none without a time; texts are left out."""
        fields = numeric_fields(self.columns())
        if "TimeUS" not in fields:
            return {}
        time = fields["TimeUS"] * 1e-6
        topic = Topic(time, np.array(self.starts), fields).select(np.isfinite(time))
        # small whole numbers, to tell them from other fields of the name
        numbered = [name for name in INSTANCES if self.codes.get(name) in ("B", "M")]
        if not numbered:
            return {self.name: topic}
        numbers = topic.fields[numbered[0]]
        topics = {}
        for k in np.unique(numbers).tolist():
            topics[instance_name(self.name, k)] = topic.select(numbers == k)
        return topics


def _rows(messages: Mapping[str, Messages], name: str, *columns: str) -> list[tuple]:
    """Return some columns of the messages of a type, row by row; none without one of them."""
    if name not in messages:
        return []
    of_type = messages[name].columns()
    cells = [of_type.get(column, np.empty(0)).tolist() for column in columns]
    return list(zip(*cells, strict=False))


def _log(
    topics: dict[str, Topic], messages: Mapping[str, Messages], remarks: tuple[str, ...]
) -> Log:
    """Return the log of a file with these topics, and remarks on its damage."""
    changes = []
    for time, name, value in _rows(messages, "PARM", "TimeUS", "Name", "Value"):
        if isinstance(time, int) and isinstance(value, int | float):
            changes.append((1e-6 * time, _text(name), value))
    parameters = in_force(changes, topics)
    texts = [_text(message) for (message,) in _rows(messages, "MSG", "Message")]
    # the program tells its name and version in the first texts
    firmware = next((text for text in texts if text.split(" ")[0] in VEHICLES), "ArduPilot")
    program = firmware.split(" ")[0]
    frame = whole(parameters.get("FRAME_CLASS", 0.0))
    kind = FRAMES.get((program, frame), VEHICLES.get(program))
    topics, of_ratio = _with_last_ratio(topics, changes)
    log = Log(
        kind="ArduPilot DataFlash",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware=firmware,
        vehicle=vehicle_of(kind, parameters),
        remarks=(*remarks, *of_ratio),
        landed=(("STAT", "isFlying", 0.0, 0.0),),
        naming=NAMING,
        aliases=ALIASES,
    )
    return by_parameters(log, "RCOU.C{}", lifting_modes("MODE", "ModeNum"))


def _text(content: object) -> str:
    """Return the text of bytes, empty of a number."""
    return content.decode("utf-8", "replace").strip("\x00 ") if isinstance(content, bytes) else ""


def _with_last_ratio(
    topics: dict[str, Topic], changes: list[tuple[float, str, float]]
) -> tuple[dict[str, Topic], list[str]]:
    """Return the topics with airspeeds by the last ratio of their sensor, and remarks on those that changed.

    A ratio that was calibrated in flight is right for the time before, too: V^2 goes with it.
    """
    remarks = []
    for name, parameter in RATIOS.items():
        ratios = sorted(
            (t, value) for t, key, value in changes if key == parameter and 0 < value < np.inf
        )
        topic = topics.get(name, NOTHING)
        if not ratios or "Airspeed" not in topic:
            continue
        times, values = np.transpose(ratios)
        if np.ptp(values) > 0:
            at = values[last_before(times, topic.time)]
            scaled = topic["Airspeed"] * np.sqrt(values[-1] / at)
            topics = topics | {name: topic.with_fields(Airspeed=scaled)}
            remarks.append(
                f"{parameter} changed from {values[0]:.3g} to {values[-1]:.3g}: airspeeds before are "
                "scaled to the last"
            )
    return topics, remarks


def vehicle_of(vehicle: str | None, parameters: Mapping[str, float]) -> str | None:
    """Return the kind of vehicle, of a plane with motors that lift "VTOL"."""
    has_rotors = parameters.get("Q_ENABLE", 0.0) > 0
    return "VTOL" if vehicle == "fixed wing" and has_rotors else vehicle


def _in_vehicle_axes(rules: tuple[Rule, ...], parameters: Mapping[str, float]) -> tuple[Rule, ...]:
    """Return rules whose inertial sensors are turned by AHRS_TRIM, from axes of the board to those of the attitude.

    As by get_rotation_autopilot_body_to_vehicle_body of AP_AHRS.
    """
    trim = [parameters.get(name, 0.0) for name in TRIM]
    angles = " ".join(f"{angle:.3g}" for angle in trim)
    return turned(rules, euler_to_matrix(*trim), f"turned by AHRS_TRIM {angles} rad")


def lifting_modes(topic: str, field: str) -> States:
    """Return the field of the mode, and its numbers while rotors lift a VTOL."""
    return tuple((topic, field, float(mode), float(mode)) for mode in LIFTING_MODES)


def _lifting(servos: Mapping[int, Servo], parameters: Mapping[str, float]) -> States:
    """Return channels and their pulses while rotors lift, of motors that lift alone."""
    forward = whole(parameters.get("Q_TILT_MASK", 0.0)) | whole(
        parameters.get("Q_TAILSIT_MOTMX", 0.0)
    )
    low = parameters.get("Q_M_PWM_MIN", 1000.0) or 1000.0
    high = parameters.get("Q_M_PWM_MAX", 2000.0) or 2000.0
    motors = []
    for function, servo in servos.items():
        if function in LIFT_MOTORS and not forward >> LIFT_MOTORS.index(function) & 1:
            motors.append((servo.topic, servo.field, low + RUNNING * (high - low), np.inf))
    return tuple(motors)


def _scan(data: bytes) -> tuple[dict[str, Messages], tuple[str, ...]]:
    """Return the messages of a file by the name of their type, of several the first, and remarks on damage."""
    columns = ["Type", "Length", "Name", "Format", "Columns"]
    types = {FMT: Messages(data, "FMT", "BBnNZ", columns)}
    skipped = 0
    cut = False
    position = 0
    while position + HEAD <= len(data):
        start = position + HEAD
        kind = types.get(data[start - 1]) if data.startswith(MARK, position) else None
        end = start + kind.dtype.itemsize if kind else start
        if kind and end <= len(data):
            kind.starts.append(start)
            if kind is types[FMT]:
                _define(types, data[start:end])
            position = end
            continue
        following = data.find(MARK, position + 1)
        if following < 0:
            following = len(data)
        if kind and following == len(data):
            cut = True
        elif data[position:following].strip(FILLING):
            skipped += following - position
        position = following
    used = [kind for kind in types.values() if kind.starts]
    return {kind.name: kind for kind in reversed(used)}, damage(skipped, cut)


def _define(types: dict[int, Messages], message: bytes) -> None:
    """Add a type, unless its definition makes no sense: its messages are then skipped."""
    formats = types[FMT]
    (definition,) = np.frombuffer(message, formats.dtype)
    number, length, *texts = definition.tolist()
    with suppress(KeyError, ValueError, TypeError):
        name, codes, columns = (text.decode("ascii") for text in texts)
        new = Messages(formats.data, name, codes, columns.split(",") if columns else [])
        if re.fullmatch(r"\w+", name) and new.dtype.itemsize == length - HEAD:
            types.setdefault(number, new)


def by_parameters(log: Log, channel: str, modes: States, hover: States = ()) -> Log:
    """Return a log with what the parameters of ArduPilot say of its outputs and inertial sensors.

    Outputs n are named by ``channel``. Surfaces are by SERVOn_FUNCTION, single and mixed, commands are
    the engines of a twin. A VTOL lifts in ``hover``, and while a motor lifts, or without one in
    ``modes``.
    """
    name, _ = channel.split(".")
    parameters = log.parameters
    servos = _servos_of(log.topics.get(name, NOTHING), parameters, channel)
    controls: dict[str, Control] = {}
    for function in sorted(servos.keys() & SURFACES):
        controls[SURFACES[function]] = (servos[function],)
    for control, weights in WEIGHTS.items():
        mixed = {key: weight for key, weight in weights.items() if key in MIXED}
        if mixed and mixed.keys() <= servos.keys():
            controls[control] = tuple(servos[key].times(weight) for key, weight in mixed.items())
    commands = {}
    if servos.keys() >= {*TWIN}:
        left, right = (servos[function] for function in TWIN)
        commands["differential_throttle"] = (left, right.times(-1.0))
    lifts = _lifting(servos, parameters)
    remarks = [*log.remarks]
    if not SPOILERS.isdisjoint(servos):
        remarks.append("differential spoilers move and are not read")
    return replace(
        log,
        rules=_in_vehicle_axes(log.rules, parameters),
        remarks=tuple(remarks),
        outputs=(name,),
        controls=controls,
        commands=commands,
        lifting=(*hover, *(lifts or modes)) if log.vehicle == "VTOL" else (),
        sensor_positions=IMU_POSITIONS,
    )


def _servos_of(topic: Topic, parameters: Mapping[str, float], channel: str) -> dict[int, Servo]:
    """Return the first logged servo of each SERVOn_FUNCTION."""
    servos: dict[int, Servo] = {}
    for n in range(1, MOST_SERVOS + 1):
        name = channel.format(n)
        _, field = name.split(".")
        if field in topic:
            function = whole(parameters.get(f"SERVO{n}_FUNCTION", 0.0))
            servos.setdefault(function, _servo(parameters, n, name, function))
    return servos


def _servo(parameters: Mapping[str, float], n: int, channel: str, function: int) -> Servo:
    """Return the servo on output n, which moves the surface of its function, -1 to 1 from end to end."""
    low, middle, high, is_reversed = ServoRange.of(parameters, n)
    if SURFACES.get(function) in HIGH_LIFT or function in TWIN:
        return Servo(channel, (low, high), OPENING[::-1] if is_reversed else OPENING)
    throws = DOWN if (function in TURNED) != is_reversed else UP
    return Servo(channel, (low, middle, high), throws)
