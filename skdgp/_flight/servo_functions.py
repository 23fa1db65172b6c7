"""Servos of ArduPilot: what an output moves, by the number of SERVOn_FUNCTION (SRV_Channel.h), and how it is mixed."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

# pulses [us] at the ends and at trim of a servo that has no parameters SERVOn_MIN, _TRIM and _MAX
USUAL_PULSES = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0}


# pulses shorter than this [us] move no servo: an output that is switched off
NO_PULSE = 500.0


class ServoRange(NamedTuple):
    """Pulses [us] of a servo at its ends and at trim."""

    low: float
    trim: float
    high: float
    is_reversed: bool

    @classmethod
    def of(cls, parameters: Mapping[str, float], n: int) -> ServoRange:
        """Return the range of the servo on output n by the parameters ``SERVOn_*``."""
        pulses = [parameters.get(f"SERVO{n}_{key}", usual) for key, usual in USUAL_PULSES.items()]
        low, trim, high = pulses
        return cls(low, trim, high, bool(parameters.get(f"SERVO{n}_REVERSED", 0.0)))


class ServoFunction(IntEnum):
    """Function of an output. Flaps are moved by the pilot alone or by the autopilot."""

    FLAP = 2
    AUTOMATIC_FLAP = 3
    AILERON = 4
    ELEVATOR = 19
    RUDDER = 21
    FLAPERON_LEFT = 24
    FLAPERON_RIGHT = 25
    THROTTLE = 70
    THROTTLE_LEFT = 73
    THROTTLE_RIGHT = 74
    ELEVON_LEFT = 77
    ELEVON_RIGHT = 78
    VTAIL_LEFT = 79
    VTAIL_RIGHT = 80
    AIRBRAKE = 110


# Functions whose command, up or right, turns a surface against the sign of a flight table
TURNED = (
    ServoFunction.ELEVATOR,
    ServoFunction.RUDDER,
    ServoFunction.ELEVON_LEFT,
    ServoFunction.ELEVON_RIGHT,
    ServoFunction.VTAIL_LEFT,
    ServoFunction.VTAIL_RIGHT,
)
# Weights of the outputs of servos in a control (ArduPlane/servos.cpp): left = pitch - roll, right = pitch + roll of
# elevons; left = pitch + yaw, right = pitch - yaw of V-tails; left = roll + flap, right = roll - flap of flaperons
WEIGHTS: dict[str, dict[int, float]] = {
    "aileron": {
        ServoFunction.AILERON: 1.0,
        ServoFunction.ELEVON_LEFT: -0.5,
        ServoFunction.ELEVON_RIGHT: 0.5,
        ServoFunction.FLAPERON_LEFT: 0.5,
        ServoFunction.FLAPERON_RIGHT: 0.5,
    },
    "elevator": {
        ServoFunction.ELEVATOR: 1.0,
        ServoFunction.ELEVON_LEFT: 0.5,
        ServoFunction.ELEVON_RIGHT: 0.5,
        ServoFunction.VTAIL_LEFT: 0.5,
        ServoFunction.VTAIL_RIGHT: 0.5,
    },
    "rudder": {
        ServoFunction.RUDDER: 1.0,
        ServoFunction.VTAIL_LEFT: 0.5,
        ServoFunction.VTAIL_RIGHT: -0.5,
    },
    "flap": {ServoFunction.FLAPERON_LEFT: 0.5, ServoFunction.FLAPERON_RIGHT: -0.5},
    "throttle": {ServoFunction.THROTTLE: 1.0},
}
