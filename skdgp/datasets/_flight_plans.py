"""Plans of the example flights, and the autopilot and the actuators that fly them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._excitation.multisines import multisine
from skdgp._excitation.signals import Steps, doublet, three_two_one_one
from skdgp._excitation.wavetrain import Wavetrain
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp.datasets._brumby import PROPELLER

ALPHA = 0.085
COMMANDS = ("elevator", "aileron", "rudder", "throttle")
TRIM = (-0.04, -0.007, 0.0, 0.63)  # of the commands in straight level flight [rad]
BANK_LIMIT, ELEVON_LIMIT, RUDDER_LIMIT = 0.70, 0.42, 0.35
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])  # of the lags of both elevons, rudder and propeller [s]
CAPTURE_DISTANCE = 170.0  # distance [m] from the orbit at which the wanted course still cuts it at 45 degrees


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    orbits: tuple[tuple[float, float, float, float], ...]
    """(from time [s], centre north, centre east, radius [m]); a negative radius turns left."""
    altitudes: tuple[tuple[float, float], ...]  # (from time [s], altitude [m])
    airspeeds: tuple[tuple[float, float], ...]  # (from time [s], airspeed [m/s])
    wind: tuple[float, float, float]  # mean velocity of the air, NED [m/s]
    wind_at_6m: float  # wind near the ground [m/s], which sets the turbulence
    manoeuvres: Wavetrain  # additions to elevator, aileron, rudder [rad] and throttle


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    starts, values = np.array(steps)[:, 0], np.array(steps)[:, 1:]
    return values[np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)]


def interrupted(amplitude: float) -> Steps:
    """Return the 3-2-1-1 of 0.4 s as these flights have it, with a row at trim before the third pulse."""
    return Steps([1.2, 0.8, 0.025, 0.375, 0.4], [amplitude, -amplitude, 0.0, amplitude, -amplitude])


EVEN, ODD = range(12, 60, 2), range(13, 60, 2)
FIRST, SECOND, THIRD = (range(k, 60, 3) for k in (10, 11, 12))
LATERAL = Wavetrain({
    "aileron": {
        6: multisine(30, EVEN, rms=0.055), 40: doublet(0.5, 0.14), 66: multisine(30, ODD, rms=0.07),
        104: interrupted(0.13), 140: multisine(30, EVEN, rms=0.05), 172: doublet(0.7, -0.11),
    },
    "rudder": {
        6: multisine(30, ODD, rms=0.12), 44: doublet(0.9, 0.18), 66: multisine(30, EVEN, rms=0.15),
        98: three_two_one_one(0.7, -0.16), 110: doublet(0.7, -0.23), 140: multisine(30, ODD, rms=0.09),
    },
})  # fmt: skip
LATLON = Wavetrain({
    "elevator": {
        6: multisine(30, FIRST, rms=0.04), 40: three_two_one_one(0.5, 0.05), 47: doublet(0.9, -0.075),
        70: multisine(30, SECOND, rms=0.045), 104: three_two_one_one(0.6, -0.055), 110: doublet(0.6, 0.09),
        144: multisine(30, THIRD, rms=0.04),
    },
    "aileron": {
        6: multisine(30, SECOND, rms=0.04), 51: doublet(0.5, 0.13), 70: multisine(30, THIRD, rms=0.05),
        114: interrupted(0.085), 144: multisine(30, FIRST, rms=0.04),
    },
    "rudder": {
        6: multisine(30, THIRD, rms=0.07), 54: doublet(0.8, -0.16), 70: multisine(30, FIRST, rms=0.08),
        118: doublet(0.6, 0.18), 144: multisine(30, SECOND, rms=0.07),
    },
    "throttle": {
        20: doublet(5, 0.2), 84: doublet(6, 0.25), 108: Steps([4], [-0.3]),
        144: multisine(30, range(1, 12, 2), rms=0.12),
    },
})  # fmt: skip
TWO_ALTITUDES = Wavetrain({
    "elevator": {
        14: doublet(0.7, -0.06), 24: multisine(24, range(8, 42, 3), rms=0.035), 96: three_two_one_one(0.5, 0.05),
        140: multisine(30, range(10, 54, 4), rms=0.035),
    },
    "aileron": {
        18: doublet(0.6, 0.11), 24: multisine(24, range(9, 42, 3), rms=0.05), 101: three_two_one_one(0.45, -0.10),
        140: multisine(30, range(11, 54, 4), rms=0.04),
    },
    "rudder": {
        21: doublet(0.8, 0.16), 24: multisine(24, range(10, 42, 3), rms=0.09), 106: three_two_one_one(0.6, 0.13),
        140: multisine(30, range(12, 54, 4), rms=0.09),
    },
    "throttle": {44: Steps([5], [-0.15]), 150: doublet(7, 0.15)},
})  # fmt: skip

FLIGHT_PLANS = (
    FlightPlan(
        name="lateral", orbits=((-99, 0, 0, 230), (50, 0, 480, -230), (118, 0, 0, 190)), altitudes=((-99, 220),),
        airspeeds=((-99, 35),), wind=(-2.0, 3.0, 0.0), wind_at_6m=3.5, manoeuvres=LATERAL,
    ),
    FlightPlan(
        name="latlon", orbits=((-99, 0, 0, -260), (62, -520, 60, 240), (124, -80, 300, -210)),
        altitudes=((-99, 220), (76, 228), (114, 220)), airspeeds=((-99, 36), (38, 31), (66, 38), (120, 34)),
        wind=(3.0, -1.5, 0.0), wind_at_6m=3.5, manoeuvres=LATLON,
    ),
    FlightPlan(
        name="two_altitudes", orbits=((-99, 0, 0, 250), (56, 420, -350, -240), (116, -80, -500, 200)),
        altitudes=((-99, 200), (72, 275)), airspeeds=((-99, 37), (50, 32.5), (110, 35)), wind=(-3.5, -3.0, 0.0),
        wind_at_6m=5.5, manoeuvres=TWO_ALTITUDES,
    ),
)  # fmt: skip


class FlightControls:
    """Controls of several flights as a function of step, stage and measured values, for `fly_record`.

    At the beginning of each step the commands of the autopilot and the manoeuvres are added to targets. The actuators
    approach the targets as exact first-order lags.
    """

    def __init__(self, plans: tuple[FlightPlan, ...], time: np.ndarray, step: float):
        self.orbit = np.stack([scheduled(plan.orbits, time) for plan in plans], axis=1)
        self.altitude = np.column_stack([scheduled(plan.altitudes, time) for plan in plans])
        self.airspeed = np.column_stack([scheduled(plan.airspeeds, time) for plan in plans])
        added = [[plan.manoeuvres(axis, time) for axis in COMMANDS] for plan in plans]
        self.manoeuvres = np.moveaxis(np.array(added), -1, 0)  # (n_times, n_flights, 4)
        self.autopilot, self.step, self.now = Autopilot(step, len(plans)), step, -1
        self.end, _ = _targets(np.tile(TRIM, (len(plans), 1)))

    def __call__(self, k: int, stage: int, observe: Callable[[], Mapping[str, Array]]) -> dict[str, Array]:
        """Return the controls (n_flights,) by name at a stage, two to a step."""
        if k != self.now:
            self.now, self.begin = k, self.end
            command = self.autopilot.command(observe(), self.orbit[k], self.altitude[k], self.airspeed[k])
            self.target, self.throttle = _targets(self.manoeuvres[k] + command)
        half_steps, positions = stage - 2 * k, self.begin
        if half_steps:
            lag = np.exp(-0.5 * half_steps * self.step / TIME_CONSTANTS)
            positions = self.target + lag * (self.begin - self.target)
        if half_steps == 2:
            self.end = positions
        left, right, rudder, propeller_speed = positions.T
        return {
            "throttle": self.throttle, "elevator": 0.5 * (left + right), "aileron": 0.5 * (left - right),
            "rudder": rudder, "elevon_left": left, "elevon_right": right, "propeller_speed": propeller_speed,
        }  # fmt: skip


def _targets(command: Array) -> tuple[Array, Array]:
    """Return where the actuators go (n, 4), elevons, rudder, propeller, and the throttle (n,), mixed and limited."""
    elevator, aileron, rudder, throttle = command.T
    throttle = np.clip(throttle, 0.0, 1.0)
    elevons = np.clip([elevator + aileron, elevator - aileron], -ELEVON_LIMIT, ELEVON_LIMIT)
    rudder = np.clip(rudder, -RUDDER_LIMIT, RUDDER_LIMIT)
    return np.stack([*elevons, rudder, PROPELLER.speed_at(throttle)], axis=-1), throttle


class Autopilot:
    """Proportional-integral loops for attitude, altitude and airspeed of several flights."""

    def __init__(self, step: float, n_flights: int):
        self.step = step
        self.climb_integral, self.speed_integral, self.roll_integral = np.zeros((3, n_flights))

    def command(self, seen: Mapping[str, Array], orbit: Array, altitude: Array, airspeed: Array) -> Array:
        """Return elevator, aileron, rudder and throttle (n_flights, 4) of what is ``seen``, channels by name.

        ``orbit`` (n_flights, 3) holds the centre's north, east and the radius [m], negative to turn left.
        """
        phi, theta, speed = seen["phi"], seen["theta"], seen["airspeed"]
        climb = np.clip(0.35 * (altitude - seen["altitude"]), -3.0, 4.0)
        elevator = self._elevator(climb + seen["v_down"], climb / speed, phi, theta, seen["q"], speed)
        bank_error = self._bank(seen, orbit) - phi
        self.roll_integral = np.clip(self.roll_integral + 0.01 * bank_error * self.step, -0.05, 0.05)
        aileron = np.clip(0.085 * bank_error - 0.022 * seen["p"] + self.roll_integral, -0.12, 0.12)
        turning = STANDARD_GRAVITY * np.sin(phi) * np.cos(theta) / speed
        rudder = 0.22 * (seen["r"] - turning) - 0.10 * seen["beta"]
        self.speed_integral = np.clip(self.speed_integral + 0.02 * (airspeed - speed) * self.step, -0.3, 0.3)
        throttle = 0.08 * (airspeed - speed) + 0.06 * climb + self.speed_integral
        return TRIM + np.stack((elevator, aileron, rudder, throttle), axis=-1)

    def _bank(self, seen: Mapping[str, Array], orbit: Array) -> Array:
        """Return the bank that follows the vector field around the orbit (Beard & McLain 2012, section 10.2)."""
        north, east, radius = seen["north"] - orbit[:, 0], seen["east"] - orbit[:, 1], np.abs(orbit[:, 2])
        turn = np.sign(orbit[:, 2])
        off = (np.hypot(north, east) - radius) / CAPTURE_DISTANCE
        course = np.arctan2(seen["v_east"], seen["v_north"])
        error = np.arctan2(east, north) + turn * (0.5 * np.pi + np.arctan(off)) - course
        error = (error + np.pi) % (2.0 * np.pi) - np.pi
        ground_speed2 = seen["v_north"] ** 2 + seen["v_east"] ** 2
        ahead = turn * np.arctan(ground_speed2 / (STANDARD_GRAVITY * radius)) * np.exp(-0.5 * off**2)
        return np.clip(ahead + 1.2 * error, -BANK_LIMIT, BANK_LIMIT)

    def _elevator(self, climb_error: Array, path: Array, phi: Array, theta: Array, q: Array, speed: Array) -> Array:
        """Return the addition to the elevator: > 0 pitches down."""
        self.climb_integral = np.clip(self.climb_integral + 0.010 * climb_error * self.step, -0.10, 0.10)
        level = np.cos(phi)
        wanted = ALPHA / level + path + 0.012 * climb_error + self.climb_integral
        turning = STANDARD_GRAVITY * np.sin(phi) ** 2 / (level * speed)
        return -0.30 * (wanted - theta) + 0.12 * (q - turning) - 0.03 * (1.0 / level - 1.0)
