"""Reader of telemetry logs of ground stations (tlog): MAVLink messages of PX4 or ArduPilot.

Each message stands after the time of its arrival, 8 bytes. pymavlink decodes it; see
https://mavlink.io/en/messages/ardupilotmega.html. Radio links deliver messages late and in bursts,
so the vehicle's own clock counts: a message without one was sent between its neighbours in the
file. Messages of other systems, such as the ground station, are left out.
"""

from __future__ import annotations

import struct
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import extra
from skdgp._flight.frames import STANDARD_GRAVITY, euler_to_quaternion
from skdgp.io._dataflash import controls_of
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
    mavlink = extra("pymavlink.dialects.v20.ardupilotmega", "logs")
    messages, skipped = _messages(path.read_bytes(), mavlink)
    systems = Counter(
        message.get_srcSystem() for message in messages if message.get_type() == "ATTITUDE"
    )
    if not systems:
        raise FlightReadError(
            "Got a file without a message ATTITUDE of MAVLink, but expected the telemetry of an "
            "aircraft: is it empty, or of another kind?"
        )
    system = systems.most_common(1)[0][0]
    by_name: dict[str, dict[int, Any]] = {}
    for place, message in enumerate(messages):
        if message.get_srcSystem() == system:
            number = getattr(message, NUMBERED.get(message.get_type(), ""), 0)
            name = instance_name(message.get_type(), int(number))
            by_name.setdefault(name, {})[place] = message
    beats = by_name.pop("HEARTBEAT", {}).values()
    px4 = any(beat.autopilot == PX4 for beat in beats)
    settings = by_name.pop("PARAM_VALUE", {}).values()
    parameters = {message.param_id: _parameter(message, px4) for message in settings}
    attitude = _clock(by_name["ATTITUDE"])
    topics = {name: _topic(by_name[name], attitude) for name in sorted(by_name)}
    return Log(
        kind="MAVLink telemetry",
        topics=topics,
        rules=RULES,
        parameters=parameters,
        firmware="PX4" if px4 else "ArduPilot",
        vehicle=next((MAV_TYPES[beat.type] for beat in beats if beat.type in MAV_TYPES), None),
        remarks=damage(skipped),
        landed=("EXTENDED_SYS_STATE", "landed_state", 1.0),
        outputs=(OUTPUTS,),
        controls=controls_of(topics.get(OUTPUTS, {}), parameters, OUTPUTS + ".servo{}_raw"),
    )


def _messages(data: bytes, mavlink: Any) -> tuple[list[Any], int]:
    """Return the messages to read, and the number of bytes that belong to none."""
    decoder = mavlink.MAVLink(None)
    messages: list[Any] = []
    position = skipped = 0
    while position + STAMP + min(OVERHEAD.values()) <= len(data):
        start = position + STAMP
        size = data[start + 1] + OVERHEAD.get(data[start], len(data))
        size += SIGNATURE * (data[start] == 0xFD and data[start + 2] & 1)
        frame = data[start : start + size]
        numbers = frame[5:6] if data[start] == 0xFE else frame[7:10]
        kind = mavlink.mavlink_map.get(int.from_bytes(numbers, "little"))
        try:
            if kind is None or kind.msgname in READ or len(frame) < size:
                messages.append(decoder.decode(bytearray(frame)))
            position = start + size
        except (mavlink.MAVError, struct.error, UnicodeDecodeError):
            position += 1
            skipped += 1
    return [message for message in messages if message.get_type() in READ], skipped


def _clock(messages: dict[int, Any]) -> pd.Series:
    """Return the vehicle's clock [s] by place in the file, NaN of messages without one."""

    def clock(message):
        times = (factor * getattr(message, name, np.nan) for name, factor in CLOCKS.items())
        return next((time for time in times if np.isfinite(time)), np.nan)

    return pd.Series({place: clock(message) for place, message in messages.items()})


def _topic(messages: dict[int, Any], attitude: pd.Series) -> Topic:
    """Return a topic; a message off the clock of the attitude was sent between its neighbours."""
    clock = _clock(messages)
    places = clock.index.to_numpy(float)
    by_place = np.interp(places, attitude.index, attitude)
    time = np.where(np.abs(clock - by_place) < LARGEST_DIFFERENCE, clock, by_place)
    fields = pd.DataFrame([message.to_dict() for message in messages.values()])
    return Topic(time, places, numeric_fields({str(name): fields[name] for name in fields}))


def _parameter(message: Any, px4: bool) -> float:
    """Return the value of a parameter; PX4 sends the bits of whole numbers."""
    form = "<i" if px4 and message.param_type == INT32 else "<f"
    return float(struct.unpack(form, struct.pack("<f", message.param_value))[0])
