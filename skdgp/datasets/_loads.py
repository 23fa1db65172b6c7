"""Air data, loads and motion of the example aircraft at an instant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients
from skdgp.dynamics import air_data, ned_to_body, rigid_body_derivative, standard_density
from skdgp.dynamics._simulation.gusts import Gusts

__all__ = ["Loads", "loads"]

UNIT_FORCE, ARM = BRUMBY.thrust_line.loads(1.0)
"""Force and moment of one newton of thrust."""


class Loads(NamedTuple):
    """What acts on the aircraft and what follows from it; arrays (..., k)."""

    airspeed: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    coefficients: np.ndarray
    thrust_force: np.ndarray
    thrust_moment: np.ndarray
    force: np.ndarray
    """Aerodynamic and propulsive, body axes [N]."""
    derivative: np.ndarray
    """Of the rigid body's state."""
    slopes: tuple[np.ndarray, np.ndarray]
    """alpha_dot, beta_dot [rad/s]."""


def loads(state, controls, wind, gust: Gusts, slopes) -> Loads:
    """Return the loads at ``state`` (..., 13) in a steady ``wind`` NED (..., 3) and a ``gust``.

    ``controls`` (..., 4) are left and right elevon, rudder [rad] and propeller speed [rad/s]. The coefficients
    depend on alpha_dot and beta_dot, which depend on the coefficients, if weakly: ``slopes`` is a guess of both
    and the slopes returned err 70 times less, so calls with the last answer converge.
    """
    steady = ned_to_body(state[..., 6:10], wind)
    velocity = state[..., 3:6] - steady - gust.velocity
    airspeed, alpha, beta = air_data(velocity)
    rates = state[..., 10:13] - gust.rates
    coefficients = brumby_coefficients(_regressors(airspeed, alpha, beta, rates, slopes, controls))

    density = standard_density(-state[..., 2])
    pressure = (0.5 * BRUMBY.wing_area * density * airspeed**2)[..., None]
    thrust = BRUMBY.propeller.thrust(controls[..., 3], airspeed, density)[..., None]
    torque = BRUMBY.propeller.torque(controls[..., 3], airspeed, density)[..., None]
    thrust_force, thrust_moment = thrust * UNIT_FORCE, thrust * ARM + torque * UNIT_FORCE
    force = pressure * coefficients[..., :3] + thrust_force
    moment = pressure * coefficients[..., 3:] * BRUMBY.moment_lengths + thrust_moment
    derivative = rigid_body_derivative(state, force, moment, BRUMBY)
    # The steady wind is constant over the earth, so in body axes it turns against the aircraft.
    acceleration = derivative[..., 3:6] + _cross(state[..., 10:13], steady) - gust.acceleration
    return Loads(
        airspeed, alpha, beta, coefficients, thrust_force, thrust_moment, force, derivative,
        _air_slopes(velocity, acceleration),
    )  # fmt: skip


def _regressors(airspeed, alpha, beta, rates, slopes, controls) -> np.ndarray:
    half_time = 0.5 / airspeed
    regressors = np.empty((*airspeed.shape, len(REGRESSORS)))
    regressors[..., 0], regressors[..., 1] = alpha, beta
    regressors[..., 2:5] = rates * BRUMBY.moment_lengths * half_time[..., None]
    regressors[..., 5] = slopes[0] * BRUMBY.chord * half_time
    regressors[..., 6] = slopes[1] * BRUMBY.span * half_time
    regressors[..., 7] = 0.5 * (controls[..., 0] + controls[..., 1])
    regressors[..., 8] = 0.5 * (controls[..., 0] - controls[..., 1])
    regressors[..., 9] = controls[..., 2]
    return regressors


def _air_slopes(velocity, acceleration) -> tuple[np.ndarray, np.ndarray]:
    """Return alpha_dot and beta_dot of alpha = atan2(w, u), beta = atan2(v, sqrt(u^2 + w^2))."""
    u, v, w = velocity[..., 0], velocity[..., 1], velocity[..., 2]
    u_dot, v_dot, w_dot = acceleration[..., 0], acceleration[..., 1], acceleration[..., 2]
    plane2 = u * u + w * w
    plane = np.sqrt(plane2)
    plane_dot = (u * u_dot + w * w_dot) / plane
    return (u * w_dot - w * u_dot) / plane2, (plane * v_dot - v * plane_dot) / (plane2 + v * v)


def _cross(a, b) -> np.ndarray:
    """Return a x b; numpy.cross takes five times as long on three numbers."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
