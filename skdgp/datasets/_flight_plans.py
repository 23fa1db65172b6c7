"""Plans of the example flights: paths, altitudes, speeds, wind, manoeuvres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._excitation.multisines import multisine
from skdgp._excitation.signals import Steps, doublet, three_two_one_one
from skdgp._excitation.wavetrain import Wavetrain


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    orbits: tuple[tuple[float, float, float, float], ...]
    """(from time [s], centre north, centre east, radius [m]); a negative radius turns left."""
    altitudes: tuple[tuple[float, float], ...]
    """(from time [s], altitude [m])."""
    airspeeds: tuple[tuple[float, float], ...]
    """(from time [s], airspeed [m/s])."""
    wind: tuple[float, float, float]
    """Mean velocity of the air, NED [m/s]."""
    wind_at_6m: float
    """Wind near the ground [m/s], which sets the turbulence."""
    manoeuvres: Wavetrain
    """Additions to elevator, aileron, rudder [rad] and throttle."""


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    starts, values = np.array(steps)[:, 0], np.array(steps)[:, 1:]
    return values[np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)]


def interrupted(amplitude: float) -> Steps:
    """Return the 3-2-1-1 of 0.4 s as these flights have it, with a row at trim before the third pulse."""
    return Steps([1.2, 0.8, 0.025, 0.375, 0.4], [amplitude, -amplitude, 0.0, amplitude, -amplitude])


LATERAL_EVEN, LATERAL_ODD = range(12, 60, 2), range(13, 60, 2)
FIRST, SECOND, THIRD = (range(k, 60, 3) for k in (10, 11, 12))
LATERAL = Wavetrain(
    {
        "aileron": {
            6: multisine(30, LATERAL_EVEN, rms=0.055),
            40: doublet(0.5, 0.14),
            66: multisine(30, LATERAL_ODD, rms=0.07),
            104: interrupted(0.13),
            140: multisine(30, LATERAL_EVEN, rms=0.05),
            172: doublet(0.7, -0.11),
        },
        "rudder": {
            6: multisine(30, LATERAL_ODD, rms=0.12),
            44: doublet(0.9, 0.18),
            66: multisine(30, LATERAL_EVEN, rms=0.15),
            98: three_two_one_one(0.7, -0.16),
            110: doublet(0.7, -0.23),
            140: multisine(30, LATERAL_ODD, rms=0.09),
        },
    }
)
LATLON = Wavetrain(
    {
        "elevator": {
            6: multisine(30, FIRST, rms=0.04),
            40: three_two_one_one(0.5, 0.05),
            47: doublet(0.9, -0.075),
            70: multisine(30, SECOND, rms=0.045),
            104: three_two_one_one(0.6, -0.055),
            110: doublet(0.6, 0.09),
            144: multisine(30, THIRD, rms=0.04),
        },
        "aileron": {
            6: multisine(30, SECOND, rms=0.04),
            51: doublet(0.5, 0.13),
            70: multisine(30, THIRD, rms=0.05),
            114: interrupted(0.085),
            144: multisine(30, FIRST, rms=0.04),
        },
        "rudder": {
            6: multisine(30, THIRD, rms=0.07),
            54: doublet(0.8, -0.16),
            70: multisine(30, FIRST, rms=0.08),
            118: doublet(0.6, 0.18),
            144: multisine(30, SECOND, rms=0.07),
        },
        "throttle": {
            20: doublet(5, 0.2),
            84: doublet(6, 0.25),
            108: Steps([4], [-0.3]),
            144: multisine(30, range(1, 12, 2), rms=0.12),
        },
    }
)
TWO_ALTITUDES = Wavetrain(
    {
        "elevator": {
            14: doublet(0.7, -0.06),
            24: multisine(24, range(8, 42, 3), rms=0.035),
            96: three_two_one_one(0.5, 0.05),
            140: multisine(30, range(10, 54, 4), rms=0.035),
        },
        "aileron": {
            18: doublet(0.6, 0.11),
            24: multisine(24, range(9, 42, 3), rms=0.05),
            101: three_two_one_one(0.45, -0.10),
            140: multisine(30, range(11, 54, 4), rms=0.04),
        },
        "rudder": {
            21: doublet(0.8, 0.16),
            24: multisine(24, range(10, 42, 3), rms=0.09),
            106: three_two_one_one(0.6, 0.13),
            140: multisine(30, range(12, 54, 4), rms=0.09),
        },
        "throttle": {44: Steps([5], [-0.15]), 150: doublet(7, 0.15)},
    }
)

FLIGHT_PLANS = (
    FlightPlan(
        name="lateral",
        orbits=((-99, 0, 0, 230), (50, 0, 480, -230), (118, 0, 0, 190)),
        altitudes=((-99, 220),),
        airspeeds=((-99, 35),),
        wind=(-2.0, 3.0, 0.0),
        wind_at_6m=3.5,
        manoeuvres=LATERAL,
    ),
    FlightPlan(
        name="latlon",
        orbits=((-99, 0, 0, -260), (62, -520, 60, 240), (124, -80, 300, -210)),
        altitudes=((-99, 220), (76, 228), (114, 220)),
        airspeeds=((-99, 36), (38, 31), (66, 38), (120, 34)),
        wind=(3.0, -1.5, 0.0),
        wind_at_6m=3.5,
        manoeuvres=LATLON,
    ),
    FlightPlan(
        name="two_altitudes",
        orbits=((-99, 0, 0, 250), (56, 420, -350, -240), (116, -80, -500, 200)),
        altitudes=((-99, 200), (72, 275)),
        airspeeds=((-99, 37), (50, 32.5), (110, 35)),
        wind=(-3.5, -3.0, 0.0),
        wind_at_6m=5.5,
        manoeuvres=TWO_ALTITUDES,
    ),
)
