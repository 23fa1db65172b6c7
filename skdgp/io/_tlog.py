"""Reader of telemetry logs of ground stations (tlog): MAVLink messages of PX4 or ArduPilot.

Each message stands after the time of its arrival, 8 bytes. pymavlink decodes it; see
https://mavlink.io/en/messages/ardupilotmega.html. Radio links deliver messages late and in bursts,
so the vehicle's own clock counts: a message without one was sent between its neighbours in the
file. Messages of other systems, such as the ground station, are left out.
"""

from __future__ import annotations

import struct
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.frames import euler_to_quaternion
from skdgp.io._dataflash import mixing_of, servos_of
from skdgp.io._log import (
    EQUIVALENT,
    QUATERNION,
    Log,
    Rule,
    Topic,
    damage,
    density_at,
    from_rpm,
    instance_name,
    numeric_fields,
)
from skdgp.io._tables import FlightReadError
from skdgp.io._ulog import MAV_TYPES

STAMP, SIGNATURE = 8, 13  # bytes of the arrival, of a signature
OVERHEAD = {0xFE: 8, 0xFD: 12}  # bytes of a message beside its payload, by its first byte
PX4 = 12  # MAV_AUTOPILOT
INT32 = 6  # MAV_PARAM_TYPE of whole numbers, which PX4 sends as the bits of a float
CLOCKS = {"time_boot_ms": 1e-3, "time_usec": 1e-6}
# seconds from the clock of ATTITUDE beyond which the place in the file counts, as where there is none
LARGEST_DIFFERENCE = 60.0
NUMBERED = {"SERVO_OUTPUT_RAW": "port", "RAW_IMU": "id", "HIGHRES_IMU": "id"}
OUTPUTS = "SERVO_OUTPUT_RAW"


def _wind_from(values):
    """Return the wind north, east of the direction [deg] that it comes from, and its speed."""
    direction, speed = np.deg2rad(values[:, 0]), values[:, 1]
    return np.column_stack([-speed * np.cos(direction), -speed * np.sin(direction)])


def _axes(name):
    return tuple(f"{axis}{name}" for axis in "xyz")


_milli, _centi, _milli_g = (
    partial(np.multiply, factor) for factor in (1e-3, 0.01, 1e-3 * STANDARD_GRAVITY)
)
RULES = (
    Rule(("p", "q", "r"), "HIGHRES_IMU", _axes("gyro")),
    Rule(("p", "q", "r"), "RAW_IMU", _axes("gyro"), _milli),
    Rule(("p", "q", "r"), "SCALED_IMU", _axes("gyro"), _milli),
    Rule(("p", "q", "r"), "ATTITUDE", ("rollspeed", "pitchspeed", "yawspeed")),
    Rule(("ax", "ay", "az"), "HIGHRES_IMU", _axes("acc")),
    Rule(("ax", "ay", "az"), "RAW_IMU", _axes("acc"), _milli_g),
    Rule(("ax", "ay", "az"), "SCALED_IMU", _axes("acc"), _milli_g),
    Rule(
        QUATERNION,
        "ATTITUDE",
        ("roll", "pitch", "yaw"),
        lambda angles: euler_to_quaternion(*angles.T),
    ),
    Rule(
        (EQUIVALENT,),
        "VFR_HUD",
        ("airspeed",),
        valid=("airspeed",),
        note="of a sensor, or estimated on board",
    ),
    Rule(("v_north", "v_east", "v_down"), "LOCAL_POSITION_NED", ("vx", "vy", "vz")),
    Rule(("v_north", "v_east", "v_down"), "GLOBAL_POSITION_INT", ("vx", "vy", "vz"), _centi),
    Rule(("north", "east", "down"), "LOCAL_POSITION_NED", ("x", "y", "z")),
    Rule(("altitude",), "GLOBAL_POSITION_INT", ("alt",), _milli),
    Rule(
        ("density",),
        "SCALED_PRESSURE",
        ("press_abs",),
        lambda hectopascals: density_at(100 * hectopascals),
    ),
    Rule(("wind_north", "wind_east"), "WIND", ("direction", "speed"), _wind_from),
    Rule(("wind_north", "wind_east"), "WIND_COV", ("wind_x", "wind_y")),
    Rule(("throttle",), "VFR_HUD", ("throttle",), _centi),
    Rule(("propeller_speed",), "RPM", ("rpm1",), from_rpm),
    Rule(("propeller_speed",), "ESC_TELEMETRY_1_TO_4", ("rpm[0]",), from_rpm),
)
READ = {rule.topic for rule in RULES} | {OUTPUTS, "EXTENDED_SYS_STATE", "HEARTBEAT", "PARAM_VALUE"}


def read_tlog(path: Path) -> Log:
    """Return a telemetry log; raise FlightReadError if it is none, ImportError without pymavlink."""
    try:
        from pymavlink.dialects.v20 import ardupilotmega as mavlink
    except ImportError as error:
        raise ImportError(
            "Reading a tlog needs pymavlink, which is not installed: pip install "
            "'skdgp[logs]', or take the log of "
            "the autopilot itself."
        ) from error
    messages, skipped = _messages(path.read_bytes(), mavlink)
    systems = Counter(each.get_srcSystem() for each in messages if each.get_type() == "ATTITUDE")
    if not systems:
        raise FlightReadError(
            "Got a file without a message ATTITUDE of MAVLink, but expected the telemetry of an "
            "aircraft: is it empty, "
            "or of another kind?"
        )
    system = systems.most_common(1)[0][0]
    by_name: dict[str, dict[int, Any]] = {}
    for place, each in enumerate(messages):
        if each.get_srcSystem() == system:
            number = getattr(each, NUMBERED.get(each.get_type(), ""), 0)
            name = instance_name(each.get_type(), int(number))
            by_name.setdefault(name, {})[place] = each
    beats = list(by_name.pop("HEARTBEAT", {}).values())
    px4 = any(each.autopilot == PX4 for each in beats)
    parameters = dict(_parameter(each, px4) for each in by_name.pop("PARAM_VALUE", {}).values())
    attitude = _clocks(by_name["ATTITUDE"])
    topics = {name: _topic(by_name[name], attitude) for name in sorted(by_name)}
    vehicle = next((MAV_TYPES[each.type] for each in beats if each.type in MAV_TYPES), None)
    speeds = [
        parameters[name]
        for name in ("AIRSPEED_MIN", "ARSPD_FBW_MIN", "FW_AIRSPD_MIN")
        if name in parameters
    ]
    return Log(
        kind="MAVLink telemetry",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware="PX4" if px4 else "ArduPilot",
        vehicle=vehicle,
        remarks=damage(skipped),
        slowest_airspeed=next(iter(speeds), np.nan),
        landed=("EXTENDED_SYS_STATE", "landed_state", 1.0),
        outputs=(OUTPUTS,),
        servos=servos_of(topics.get(OUTPUTS, {}), parameters, OUTPUTS + ".servo{}_raw"),
        mixing=mixing_of(topics.get(OUTPUTS, {}), parameters, OUTPUTS + ".servo{}_raw"),
    )


def _topic(messages: dict[int, Any], attitude: pd.Series) -> Topic:
    """Return a topic; a message whose clock is not the one of the attitude was sent between its neighbours."""
    clock = _clocks(messages)
    places = clock.index.to_numpy(float)
    by_place = np.interp(places, attitude.index, attitude)
    time = np.where(np.abs(clock - by_place) < LARGEST_DIFFERENCE, clock, by_place)
    fields = pd.DataFrame([each.to_dict() for each in messages.values()])
    return Topic(time, places, numeric_fields({str(name): fields[name] for name in fields}))


def _messages(data: bytes, mavlink: Any) -> tuple[list[Any], int]:
    """Return the messages that are of use, and how many bytes are none."""
    decoder, known = mavlink.MAVLink(None), mavlink.mavlink_map
    messages: list[Any] = []
    position = skipped = 0
    while position + STAMP + min(OVERHEAD.values()) <= len(data):
        start = position + STAMP
        size = data[start + 1] + OVERHEAD.get(data[start], len(data))
        if data[start] == 0xFD and data[start + 2] & 1:
            size += SIGNATURE
        message = None
        if start + size <= len(data):
            number = (
                data[start + 5]
                if data[start] == 0xFE
                else int.from_bytes(data[start + 7 : start + 10], "little")
            )
            if number in known and known[number].msgname not in READ:
                position = start + size
                continue
            with suppress(mavlink.MAVError, struct.error, UnicodeDecodeError):
                message = decoder.decode(bytearray(data[start : start + size]))
        if message is None:
            position, skipped = position + 1, skipped + 1
            continue
        position = start + size
        if message.get_type() in READ:  # not a message that this version of pymavlink does not know
            messages.append(message)
    return messages, skipped


def _parameter(message: Any, px4: bool) -> tuple[str, float]:
    bits = struct.pack("<f", message.param_value)
    is_whole = px4 and message.param_type == INT32
    return message.param_id, float(
        struct.unpack("<i", bits)[0] if is_whole else message.param_value
    )


def _clocks(messages: dict[int, Any]) -> pd.Series:
    """Return the clock of the vehicle [s] by place in the file, NaN of messages without one."""
    return pd.Series(
        {
            place: next(
                (
                    factor * getattr(each, name)
                    for name, factor in CLOCKS.items()
                    if hasattr(each, name)
                ),
                np.nan,
            )
            for place, each in messages.items()
        }
    )
