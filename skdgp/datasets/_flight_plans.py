"""Plans of the example flights: paths, altitudes, speeds, wind, manoeuvres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array


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
    excitation: Callable[[Array], tuple]
    """Time (n,) to additions to elevator, aileron, rudder [rad] and throttle, (n,) each."""


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    starts, values = np.array(steps)[:, 0], np.array(steps)[:, 1:]
    return values[np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)]


def pulse(time: ArrayLike, start: float, width: float, amplitude: float) -> Array:
    """Return ``amplitude`` during ``width`` seconds from ``start`` on, else 0."""
    since = np.asarray(time, dtype=float) - start
    return np.where((since >= 0) & (since < width), amplitude, 0.0)


def doublet(time: ArrayLike, start: float, width: float, amplitude: float) -> Array:
    """Return one pulse up and one down, each ``width`` seconds long."""
    return pulse(time, start, width, amplitude) - pulse(time, start + width, width, amplitude)


def three_two_one_one(time: ArrayLike, start: float, width: float, amplitude: float) -> Array:
    """Return the 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    (Jategaonkar, Flight Vehicle System Identification, 2nd edition, 2015, section 2.3.)
    """
    signal, sign = np.zeros(np.shape(time)), 1.0
    for units in (3, 2, 1, 1):
        signal = signal + pulse(time, start, units * width, sign * amplitude)
        start, sign = start + units * width, -sign
    return signal


def multisine(time: ArrayLike, start: float, stop: float, harmonics: ArrayLike, rms: float) -> Array:
    """Return a sum of sines of equal power with Schroeder phases between ``start`` and ``stop``, else 0.

    Harmonics k of the frequency 1 / (stop - start), phases -pi i (i - 1) / n for the i-th of n, which keep the peaks
    low. Disjoint harmonics on several controls make their inputs orthogonal (Morelli, AIAA 2003-5700).
    """
    harmonics = np.asarray(harmonics, dtype=float)
    order = np.arange(1, len(harmonics) + 1)
    since = (np.asarray(time, dtype=float) - start) / (stop - start)
    phases = -np.pi * order * (order - 1) / len(order)
    waves = np.sin(2.0 * np.pi * since[:, None] * harmonics + phases)
    return rms * np.sqrt(2.0 / len(order)) * waves.sum(axis=1) * ((since >= 0) & (since < 1))


def _lateral(time: Array) -> tuple[Array, ...]:
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


def _latlon(time: Array) -> tuple[Array, ...]:
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


def _two_altitudes(time: Array) -> tuple[Array, ...]:
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
