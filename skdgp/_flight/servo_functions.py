"""Servos of ArduPilot: what an output moves, by the number of SERVOn_FUNCTION (SRV_Channel.h)."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

# pulses [us] at the ends and at trim of a servo that has no parameters SERVOn_MIN, _TRIM and _MAX
USUAL_PULSES = {"MIN": 1100.0, "TRIM": 1500.0, "MAX": 1900.0}


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
