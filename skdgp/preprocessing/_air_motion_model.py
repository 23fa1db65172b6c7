r"""One step of a small aircraft in gusty air, for all samples of a record at once, with its derivatives.

The velocity relative to the air and the rates, body axes, follow

.. math:: \dot v_a = f + \gamma - \omega \times v_a - R^T \dot w, \quad
          \dot\gamma = -\omega \times \gamma, \quad
          \dot\omega = I^{-1} (M - \omega \times I \omega),

with specific force f and moment M of coefficients that are linear in their derivatives, and gravity
:math:`\gamma` (Stevens, Lewis & Johnson 2016, section 1.7). A sensor at r from the centre of
gravity reads :math:`f + \dot\omega \times r + \omega \times (\omega \times r)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.frames import air_data, cross, cross_matrix
from skdgp.dynamics import Aircraft, aerodynamic_loads

STATE_TERMS = ("0", "alpha", "alpha2", "beta", "p", "q", "r")
"""Terms of a coefficient before those of the surfaces."""
DIFFERENCE = 1e-6  # of the numerical derivatives; velocities [m/s] move by V times as much
AIR, RATES, ERRORS = slice(0, 3), slice(3, 6), slice(6, 12)
"""Places of air velocity, rates and errors of the coefficients among the variables of derivatives.
"""


class Inputs(NamedTuple):
    """Known inputs of n samples."""

    surfaces: Matrix  # (n, k) deflections [rad]
    thrust: Matrix  # (n, 6) force [N] and moment [N m] of the engine
    density: Vector  # (n,) [kg/m^3]

    def part(self, rows: slice) -> Inputs:
        """Return the inputs of some samples."""
        return Inputs(*(values[rows] for values in self))

    def between(self, fraction: float) -> Inputs:
        """Return the inputs of each step, interpolated between its samples."""
        return Inputs(*((1 - fraction) * v[:-1] + fraction * v[1:] for v in self))


class AirMotionModel:
    """Equations of motion and sensors of an aircraft with coefficients linear in their derivatives.

    Parameters
    ----------
    aircraft : Aircraft
    derivatives : ndarray (6, k)
        Of CX ... Cn by `STATE_TERMS` and the surfaces.
    arm : ndarray (3,)
        Position of the inertial sensors relative to the centre of gravity [m].
    """

    def __init__(self, aircraft: Aircraft, derivatives: Matrix, arm: Vector) -> None:
        self.aircraft, self.derivatives, self.arm = aircraft, derivatives, arm
        self._half_lengths = 0.5 * np.array([aircraft.span, aircraft.chord, aircraft.span])

    def terms(self, air: Array, rates: Array, surfaces: Array) -> Array:
        """Return the values (..., k) of the terms of the coefficients."""
        airspeed, alpha, beta = air_data(air)
        X = np.empty((*alpha.shape, self.derivatives.shape[1]))
        X[..., 0], X[..., 1], X[..., 2], X[..., 3] = 1.0, alpha, alpha**2, beta
        X[..., 4:7] = rates * self._half_lengths / airspeed[..., None]
        X[..., 7:] = surfaces
        return X

    def accelerations(self, air: Array, rates: Array, errors: Array, inputs: Inputs) -> Array:
        """Return specific force and angular acceleration (..., 6); ``errors`` add to the coefficients."""
        C = self.terms(air, rates, inputs.surfaces) @ self.derivatives.T + errors
        airspeed = np.sqrt(np.einsum("...i,...i->...", air, air))
        force, moment = aerodynamic_loads(C, airspeed, inputs.density, self.aircraft)
        inertia, inverse = self.aircraft.inertia, self.aircraft.inertia_inverse
        moment = moment + inputs.thrust[:, 3:] - cross(rates, rates @ inertia)
        specific_force = (force + inputs.thrust[:, :3]) / self.aircraft.mass
        return np.concatenate([specific_force, moment @ inverse], axis=-1)

    def step(
        self, start: Array, gravity: Matrix, drift: Matrix, inputs: Inputs, step: Vector
    ) -> Array:
        """Return air velocity and rates (..., n - 1, 6) one ``step`` [s] after ``start`` (..., n - 1, 12).

        The method of Runge & Kutta. ``drift`` (n - 1, 3) is the acceleration of the air seen from
        the aircraft, ``gravity`` (n - 1, 3) that in body axes at the start.
        """
        state = np.concatenate(
            [start[..., :6], np.broadcast_to(gravity, (*start.shape[:-1], 3))], axis=-1
        )
        total, slope = np.zeros_like(state), np.zeros_like(state)
        for fraction, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
            now = state + fraction * step[:, None] * slope
            air, rates, down = now[..., AIR], now[..., RATES], now[..., 6:]
            loads = self.accelerations(air, rates, start[..., ERRORS], inputs.between(fraction))
            air_rate = loads[..., :3] + down - cross(rates, air) + drift
            slope = np.concatenate([air_rate, loads[..., 3:], -cross(rates, down)], axis=-1)
            total += weight * slope
        return (state + step[:, None] / 6 * total)[..., :6]

    def sensors(self, state: Array, inputs: Inputs) -> Array:
        """Return ax, ay, az, p, q, r, airspeed, alpha, beta (..., n, 9) at states (..., n, 12)."""
        air, rates = state[..., AIR], state[..., RATES]
        loads = self.accelerations(air, rates, state[..., ERRORS], inputs)
        force = loads[..., :3]
        if self.arm.any():
            turning = cross(loads[..., 3:], self.arm) + cross(rates, cross(rates, self.arm))
            force = force + turning
        return np.concatenate([force, rates, np.stack(air_data(air), axis=-1)], axis=-1)

    def arm_slopes(self, state: Matrix, inputs: Inputs) -> Array:
        """Return d specific force / d arm (n, 3, 3)."""
        turn = cross_matrix(state[:, RATES])
        spin = self.accelerations(state[:, AIR], state[:, RATES], state[:, ERRORS], inputs)[:, 3:]
        return cross_matrix(spin) + turn @ turn


def differentiated(function, state: Matrix) -> tuple[Matrix, Array]:
    """Return a function (..., n, 12) -> (..., n, k) at states (n, 12), and its derivatives (n, k, 12)."""
    airspeed = np.sqrt(np.mean(state[:, AIR] ** 2) * 3)
    moves = DIFFERENCE * np.array([airspeed] * 3 + [1.0] * 9)
    moved = state + np.concatenate([np.zeros((1, 12)), np.diag(moves)])[:, None]
    values = function(moved)
    slopes = (values[1:] - values[0]) / moves[:, None, None]
    return values[0], np.moveaxis(slopes, 0, -1)
