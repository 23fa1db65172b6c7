"""Plans of the example flights: paths, altitudes, speeds, wind, excitation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skdgp.datasets._manoeuvres import doublet, multisine, pulse, three_two_one_one

__all__ = ["FLIGHT_PLANS", "FlightPlan"]


@dataclass(frozen=True)
class FlightPlan:
    """One flight: where to go, in which air, and what to add to the controls."""

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
    excitation: Callable[[np.ndarray], tuple]
    """Time (n,) to additions to elevator, aileron, rudder [rad] and throttle, (n,) each."""


def scheduled(steps, time: np.ndarray) -> np.ndarray:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    starts, values = np.array(steps)[:, 0], np.array(steps)[:, 1:]
    return values[np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)]


def _lateral(time):
    even, odd = np.arange(12, 60, 2), np.arange(13, 60, 2)
    aileron = (
        multisine(time, 6, 36, even, 0.055)
        + doublet(time, 40, 0.5, 0.14)
        + multisine(time, 66, 96, odd, 0.07)
        + three_two_one_one(time, 104, 0.4, 0.13)
        + multisine(time, 140, 170, even, 0.05)
        + doublet(time, 172, 0.7, -0.11)
    )
    rudder = (
        multisine(time, 6, 36, odd, 0.12)
        + doublet(time, 44, 0.9, 0.18)
        + multisine(time, 66, 96, even, 0.15)
        + three_two_one_one(time, 98, 0.7, -0.16)
        + doublet(time, 110, 0.7, -0.23)
        + multisine(time, 140, 170, odd, 0.09)
    )
    return np.zeros_like(time), aileron, rudder, np.zeros_like(time)


def _latlon(time):
    first, second, third = (np.arange(k, 60, 3) for k in (10, 11, 12))
    elevator = (
        multisine(time, 6, 36, first, 0.04)
        + three_two_one_one(time, 40, 0.5, 0.05)
        + doublet(time, 47, 0.9, -0.075)
        + multisine(time, 70, 100, second, 0.045)
        + three_two_one_one(time, 104, 0.6, -0.055)
        + doublet(time, 110, 0.6, 0.09)
        + multisine(time, 144, 174, third, 0.04)
    )
    aileron = (
        multisine(time, 6, 36, second, 0.04)
        + doublet(time, 51, 0.5, 0.13)
        + multisine(time, 70, 100, third, 0.05)
        + three_two_one_one(time, 114, 0.4, 0.085)
        + multisine(time, 144, 174, first, 0.04)
    )
    rudder = (
        multisine(time, 6, 36, third, 0.07)
        + doublet(time, 54, 0.8, -0.16)
        + multisine(time, 70, 100, first, 0.08)
        + doublet(time, 118, 0.6, 0.18)
        + multisine(time, 144, 174, second, 0.07)
    )
    throttle = (
        pulse(time, 20, 5, 0.2)
        + pulse(time, 25, 5, -0.2)
        + doublet(time, 84, 6, 0.25)
        + pulse(time, 108, 4, -0.3)
        + multisine(time, 144, 174, np.arange(1, 12, 2), 0.12)
    )
    return elevator, aileron, rudder, throttle


def _two_altitudes(time):
    elevator = (
        doublet(time, 14, 0.7, -0.06)
        + multisine(time, 24, 48, np.arange(8, 42, 3), 0.035)
        + three_two_one_one(time, 96, 0.5, 0.05)
        + multisine(time, 140, 170, np.arange(10, 54, 4), 0.035)
    )
    aileron = (
        doublet(time, 18, 0.6, 0.11)
        + multisine(time, 24, 48, np.arange(9, 42, 3), 0.05)
        + three_two_one_one(time, 101, 0.45, -0.10)
        + multisine(time, 140, 170, np.arange(11, 54, 4), 0.04)
    )
    rudder = (
        doublet(time, 21, 0.8, 0.16)
        + multisine(time, 24, 48, np.arange(10, 42, 3), 0.09)
        + three_two_one_one(time, 106, 0.6, 0.13)
        + multisine(time, 140, 170, np.arange(12, 54, 4), 0.09)
    )
    throttle = pulse(time, 44, 5, -0.15) + doublet(time, 150, 7, 0.15)
    return elevator, aileron, rudder, throttle


FLIGHT_PLANS = (
    FlightPlan(
        name="lateral",
        orbits=((-99, 0, 0, 230), (50, 0, 480, -230), (118, 0, 0, 190)),
        altitudes=((-99, 220),),
        airspeeds=((-99, 35),),
        wind=(-2.0, 3.0, 0.0),
        wind_at_6m=3.5,
        excitation=_lateral,
    ),
    FlightPlan(
        name="latlon",
        orbits=((-99, 0, 0, -260), (62, -520, 60, 240), (124, -80, 300, -210)),
        altitudes=((-99, 220), (76, 228), (114, 220)),
        airspeeds=((-99, 36), (38, 31), (66, 38), (120, 34)),
        wind=(3.0, -1.5, 0.0),
        wind_at_6m=3.5,
        excitation=_latlon,
    ),
    FlightPlan(
        name="two_altitudes",
        orbits=((-99, 0, 0, 250), (56, 420, -350, -240), (116, -80, -500, 200)),
        altitudes=((-99, 200), (72, 275)),
        airspeeds=((-99, 37), (50, 32.5), (110, 35)),
        wind=(-3.5, -3.0, 0.0),
        wind_at_6m=5.5,
        excitation=_two_altitudes,
    ),
)
