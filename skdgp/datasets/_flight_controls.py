"""Controls of the example flights: autopilot, manoeuvres, actuator lags."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp.datasets._brumby import PROPELLER
from skdgp.datasets._flight_plans import FlightPlan, scheduled

ALPHA = 0.085
COMMANDS = ("elevator", "aileron", "rudder", "throttle")
TRIM = (-0.04, -0.007, 0.0, 0.63)
"""Of the commands in straight level flight [rad]."""
BANK_LIMIT, ELEVON_LIMIT, RUDDER_LIMIT = 0.70, 0.42, 0.35
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])
"""Of the lags of both elevons, rudder and propeller [s]."""
CAPTURE_DISTANCE = 170.0
"""Distance [m] from the orbit at which the wanted course still cuts it at 45 degrees."""


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
            "throttle": self.throttle,
            "elevator": 0.5 * (left + right),
            "aileron": 0.5 * (left - right),
            "rudder": rudder,
            "elevon_left": left,
            "elevon_right": right,
            "propeller_speed": propeller_speed,
        }


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
