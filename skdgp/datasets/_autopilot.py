"""A simple autopilot for the example flights: holds altitude and airspeed, flies orbits, adds manoeuvres."""

from __future__ import annotations

import numpy as np

from skdgp.dynamics import quaternion_to_euler
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY

__all__ = ["COMMANDS", "Autopilot"]

COMMANDS = ("elevator", "aileron", "rudder", "throttle")
BANK_LIMIT = 0.70
CAPTURE_DISTANCE = 170.0
"""Distance [m] from the orbit at which the wanted course still cuts it at 45 degrees."""


class Autopilot:
    """Proportional-integral loops around attitude, altitude and airspeed for several aircraft at once.

    Parameters
    ----------
    trim : array-like of shape (4,)
        Elevator, aileron, rudder [rad] and throttle of straight level flight.
    alpha_trim : float
        Angle of attack of straight level flight [rad].
    step : float
        Time between calls [s].
    n_flights : int
    """

    def __init__(self, trim, alpha_trim: float, step: float, n_flights: int):
        self.trim, self.alpha_trim, self.step = np.asarray(trim, float), alpha_trim, step
        self.climb_integral = np.zeros(n_flights)
        self.speed_integral = np.zeros(n_flights)
        self.roll_integral = np.zeros(n_flights)

    def command(self, state, loads, orbit, altitude, wanted_airspeed) -> np.ndarray:
        """Return `COMMANDS` (n_flights, 4) at ``state`` (n_flights, 13) and its `Loads`.

        ``orbit`` (n_flights, 3) holds the centre's north, east and the radius [m], negative to turn left.
        """
        derivative, airspeed, beta = loads.derivative, loads.airspeed, loads.beta
        phi, theta, _ = np.moveaxis(quaternion_to_euler(state[:, 6:10]), -1, 0)
        p, q, r = state[:, 10:13].T
        bank = self._bank(state, derivative, orbit)
        climb = np.clip(0.35 * (altitude + state[:, 2]), -3.0, 4.0)
        elevator = self._elevator(climb + derivative[:, 2], climb / airspeed, phi, theta, q, airspeed)
        aileron = self._aileron(bank - phi, p)
        rudder = 0.22 * (r - STANDARD_GRAVITY * np.sin(phi) * np.cos(theta) / airspeed) - 0.10 * beta
        throttle = self._throttle(wanted_airspeed - airspeed, climb)
        return self.trim + np.stack((elevator, aileron, rudder, throttle), axis=-1)

    def _bank(self, state, derivative, orbit):
        """Return the bank that follows the vector field around the orbit (Beard & McLain 2012, section 10.2)."""
        north, east, radius = state[:, 0] - orbit[:, 0], state[:, 1] - orbit[:, 1], np.abs(orbit[:, 2])
        turn = np.sign(orbit[:, 2])
        off = (np.hypot(north, east) - radius) / CAPTURE_DISTANCE
        course = np.arctan2(derivative[:, 1], derivative[:, 0])
        error = np.arctan2(east, north) + turn * (0.5 * np.pi + np.arctan(off)) - course
        error = (error + np.pi) % (2.0 * np.pi) - np.pi
        ground_speed2 = derivative[:, 0] ** 2 + derivative[:, 1] ** 2
        ahead = turn * np.arctan(ground_speed2 / (STANDARD_GRAVITY * radius)) * np.exp(-0.5 * off**2)
        return np.clip(ahead + 1.2 * error, -BANK_LIMIT, BANK_LIMIT)

    def _elevator(self, climb_error, path, phi, theta, q, airspeed):
        """Return the addition to the elevator: > 0 pitches down."""
        self.climb_integral = np.clip(self.climb_integral + 0.010 * climb_error * self.step, -0.10, 0.10)
        level = np.cos(phi)
        wanted = self.alpha_trim / level + path + 0.012 * climb_error + self.climb_integral
        turning = STANDARD_GRAVITY * np.sin(phi) ** 2 / (level * airspeed)
        return -0.30 * (wanted - theta) + 0.12 * (q - turning) - 0.03 * (1.0 / level - 1.0)

    def _aileron(self, bank_error, p):
        self.roll_integral = np.clip(self.roll_integral + 0.01 * bank_error * self.step, -0.05, 0.05)
        return np.clip(0.085 * bank_error - 0.022 * p + self.roll_integral, -0.12, 0.12)

    def _throttle(self, speed_error, climb):
        self.speed_integral = np.clip(self.speed_integral + 0.02 * speed_error * self.step, -0.3, 0.3)
        return 0.08 * speed_error + 0.06 * climb + self.speed_integral
