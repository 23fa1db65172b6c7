r"""Small aircraft in gusty air: its equations of motion, and one step of all samples at once.

The velocity relative to the air and the rates, body axes, follow

.. math:: \dot v_a = f + \gamma - \omega \times v_a - R^T \dot w, \quad
          \dot\gamma = -\omega \times \gamma, \quad
          \dot\omega = I^{-1} (M - \omega \times I \omega),

with specific force f and moment M of coefficients that are linear in their derivatives, and gravity
:math:`\gamma` (Stevens, Lewis & Johnson 2016, section 1.7). A sensor at r from the centre of
gravity reads :math:`f + \dot\omega \times r + \omega \times (\omega \times r)`.

Variables of the derivatives are air velocity, rates, errors of the six coefficients, and the rate of
roll of the air, 13 numbers. Coefficients depend on the rate of roll relative to the air.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.frames import air_data, cross
from skdgp._flight.sensor_position import acceleration_by_rotation
from skdgp.dynamics import (
    Aircraft,
    aerodynamic_loads,
    dynamic_pressure,
    gyroscopic_moment,
    rk4_step,
)
from skdgp.estimation._air_parameters import STATE_TERMS

N_VARIABLES = 13
AIR_VELOCITY = slice(0, 3)
BODY_RATES = slice(3, 6)
COEFFICIENT_ERRORS = slice(6, 12)
AIR_ROLL = 12
MOTION = slice(0, 6)
"""Places among the variables: air velocity, rates, errors of the coefficients, rate of roll of the air; the first two
are the motion."""


class Inputs(NamedTuple):
    """Known inputs of n samples."""

    surfaces: Matrix  # (n, k) deflections [rad]
    thrust: Matrix  # (n, 6) force [N] and moment [N m] of the engine
    density: Vector  # (n,) [kg/m^3]

    def part(self, rows: slice) -> Inputs:
        """Return the inputs of some samples."""
        return Inputs(self.surfaces[rows], self.thrust[rows], self.density[rows])

    def between(self, fraction: float) -> Inputs:
        """Return the inputs of each step, interpolated between its samples."""

        def mean(values: Array) -> Array:
            return (1 - fraction) * values[:-1] + fraction * values[1:]

        return Inputs(mean(self.surfaces), mean(self.thrust), mean(self.density))


class Slipstream(NamedTuple):
    r"""The effect of k surfaces with thrust, over that at a mean thrust.

    By momentum theory the dynamic pressure behind a propeller of the disk A is :math:`\bar q + T / A`. With
    :math:`\tau = T / (\bar q S)` the effect of surfaces in the slipstream is

    .. math:: \frac{1 + s \tau}{1 + s \tau_0}, \quad s = S / A,

    for a tail that lies in it; s is smaller for one that lies partly in it, and zero before a pusher.
    """

    factor: float  # s
    mean: float  # tau_0, at which derivatives by these surfaces hold
    reached: Vector  # (k,) 1 for a surface that the slipstream may reach, else 0

    def effect(self, tau: Array) -> Array:
        """Return the effect (..., k) at the relative thrust tau (...)."""
        change = self.factor * (tau - self.mean) / (1.0 + self.factor * self.mean)
        return 1.0 + change[..., None] * self.reached


class AirMotionModel:
    """Equations of motion of an aircraft with coefficients linear in their derivatives.

    Parameters
    ----------
    aircraft : Aircraft
    derivatives : ndarray (6, k)
        Of CX ... Cn by `STATE_TERMS` and the surfaces.
    slipstream : Slipstream
        Of the propeller on surfaces of the tail.
    """

    def __init__(self, aircraft: Aircraft, derivatives: Matrix, slipstream: Slipstream) -> None:
        self.aircraft = aircraft
        self.derivatives = derivatives
        self.slipstream = slipstream

    @property
    def by_surfaces(self) -> Matrix:
        """Derivatives of the coefficients by the surfaces, (6, n_surfaces)."""
        return self.derivatives[:, len(STATE_TERMS) :]

    def terms(self, air: tuple[Array, Array, Array], rates: Array, inputs: Inputs) -> Array:
        """Return the values (..., k) of the terms of the coefficients.

        By airspeed, alpha and beta (...), and rates relative to the air (..., 3).
        """
        airspeed, alpha, beta = air
        half_lengths = 0.5 * self.aircraft.moment_lengths
        tau = self.relative_thrust(airspeed, inputs)
        # in the order of `STATE_TERMS`
        angles = np.stack([np.ones_like(alpha), alpha, alpha**2, beta], axis=-1)
        scaled_rates = rates * half_lengths / airspeed[..., None]
        surfaces = inputs.surfaces * self.slipstream.effect(tau)
        return np.concatenate([angles, scaled_rates, tau[..., None], surfaces], axis=-1)

    def accelerations(self, state: Array, inputs: Inputs) -> Array:
        """Return specific force and angular acceleration (..., 6) at variables (..., 13)."""
        rates = state[..., BODY_RATES]
        air = air_data(state[..., AIR_VELOCITY])
        terms = self.terms(air, relative_rates(state), inputs)
        coefficients = terms @ self.derivatives.T + state[..., COEFFICIENT_ERRORS]
        force, moment = aerodynamic_loads(coefficients, air[0], inputs.density, self.aircraft)
        specific_force = (force + inputs.thrust[:, :3]) / self.aircraft.mass
        moment = moment + inputs.thrust[:, 3:] - gyroscopic_moment(rates, self.aircraft)
        spin = moment @ self.aircraft.inertia_inverse
        return np.concatenate([specific_force, spin], axis=-1)

    def coefficients(
        self, specific_force: Matrix, rates: Matrix, spin: Matrix, airspeed: Vector, inputs: Inputs
    ) -> Matrix:
        """Return the coefficients (n, 6) at which `accelerations` are ``specific_force`` and ``spin``."""
        aircraft = self.aircraft
        force = aircraft.mass * specific_force - inputs.thrust[:, :3]
        moment = spin @ aircraft.inertia + gyroscopic_moment(rates, aircraft) - inputs.thrust[:, 3:]
        loads = np.concatenate([force, moment / aircraft.moment_lengths], axis=1)
        pressure = dynamic_pressure(airspeed, inputs.density)[:, None]
        return loads / (pressure * aircraft.wing_area)

    def step(
        self, start: Array, gravity: Matrix, drift: Matrix, inputs: Inputs, time_step: Vector
    ) -> Array:
        """Return air velocity and rates (..., n - 1, 6) one ``time_step`` [s] after ``start`` (..., n - 1, 13).

        The method of Runge & Kutta. ``drift`` (n - 1, 3) is the acceleration of the air seen from
        the aircraft, ``gravity`` (n - 1, 3) that in body axes at the start.
        """
        within = {fraction: inputs.between(fraction) for fraction in (0.0, 0.5, 1.0)}

        def change(fraction: float, state: Array) -> Array:
            """Return the change of variables and gravity (..., n - 1, 16) in a step at its rate of change."""
            rates = state[..., BODY_RATES]
            down = state[..., N_VARIABLES:]
            loads = self.accelerations(state[..., :N_VARIABLES], within[fraction])
            derivative = np.zeros_like(state)
            derivative[..., AIR_VELOCITY] = (
                loads[..., :3] + down - cross(rates, state[..., AIR_VELOCITY]) + drift
            )
            derivative[..., BODY_RATES] = loads[..., 3:]
            derivative[..., N_VARIABLES:] = -cross(rates, down)
            return time_step[:, None] * derivative

        gravity = np.broadcast_to(gravity, (*start.shape[:-1], 3))
        state = np.concatenate([start, gravity], axis=-1)
        return rk4_step(change, 0.0, state, 1.0)[..., :6]

    def relative_thrust(self, airspeed: Array, inputs: Inputs) -> Array:
        """Return thrust over dynamic pressure and wing area (..., n)."""
        pressure = dynamic_pressure(airspeed, inputs.density)
        return inputs.thrust[:, 0] / (pressure * self.aircraft.wing_area)


def relative_rates(state: Array) -> Array:
    """Return the rates relative to the air (..., 3) at variables (..., 13)."""
    rates = state[..., BODY_RATES].copy()
    rates[..., 0] -= state[..., AIR_ROLL]
    return rates


def sensors(loads: Array, state: Array, arm: Vector) -> Array:
    """Return ax, ay, az, p, q, r, airspeed, alpha, beta (..., 9) at accelerations (..., 6) and variables (..., 13).

    ``arm`` is the position of the inertial sensors relative to the centre of gravity [m].
    """
    rates = state[..., BODY_RATES]
    turning = acceleration_by_rotation(loads[..., 3:], rates, arm)
    air = np.stack(air_data(state[..., AIR_VELOCITY]), axis=-1)
    return np.concatenate([loads[..., :3] + turning, rates, air], axis=-1)


def differentiated(function: Callable[[Matrix], Matrix], state: Matrix, here: Matrix) -> Array:
    """Return the derivatives (n, k, 13) of a function (n, 13) -> (n, k) at states (n, 13), where it is ``here``."""
    moves = np.full(N_VARIABLES, 1e-6)
    # velocities move by the airspeed times as much
    moves[AIR_VELOCITY] *= np.sqrt(np.mean(state[:, AIR_VELOCITY] ** 2) * 3)
    slopes = []
    for place, move in enumerate(moves):
        moved = state.copy()
        moved[:, place] += move
        slopes.append((function(moved) - here) / move)
    return np.stack(slopes, axis=-1)
