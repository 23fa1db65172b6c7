r"""The model of a small aircraft in gusty air: its parameters, with priors, and one step of all samples at once.

The velocity relative to the air and the rates, body axes, follow

.. math:: \dot v_a = f + \gamma - \omega \times v_a - R^T \dot w, \quad
          \dot\gamma = -\omega \times \gamma, \quad
          \dot\omega = I^{-1} (M - \omega \times I \omega),

with specific force f and moment M of coefficients that are linear in their derivatives, and gravity
:math:`\gamma` (Stevens, Lewis & Johnson 2016, section 1.7). A sensor at r from the centre of
gravity reads :math:`f + \dot\omega \times r + \omega \times (\omega \times r)`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import air_data, cross, cross_matrix
from skdgp.dynamics import Aircraft, aerodynamic_loads

STATE_TERMS = ("0", "alpha", "alpha2", "beta", "p", "q", "r")
"""Terms of a coefficient before those of the surfaces."""
DIFFERENCE = 1e-6  # of the numerical derivatives; velocities [m/s] move by V times as much
AIR, RATES, ERRORS = slice(0, 3), slice(3, 6), slice(6, 12)
"""Places of air velocity, rates and errors of the coefficients among the variables of derivatives.
"""

Prior = Mapping[str, tuple[float, float]]
"""Mean and standard deviation; of noises the median, and the standard deviation of the logarithm."""

TERMS: dict[str, tuple[str, ...]] = {
    "CX": ("0", "alpha", "alpha2"),
    "CY": ("0", "beta", "p", "r", "rudder"),
    "CZ": ("0", "alpha", "q", "elevator"),
    "Cl": ("0", "beta", "p", "r", "aileron", "rudder"),
    "Cm": ("0", "alpha", "q", "elevator"),
    "Cn": ("0", "beta", "p", "r", "aileron", "rudder"),
}
"""Terms of each coefficient; those of surfaces that a flight lacks are left out."""
DERIVATIVES: Prior = {
    "CX_alpha": (0.2, 1.0), "CX_alpha2": (0.0, 5.0), "CY_beta": (-0.5, 0.5), "CY_p": (0.0, 0.5),
    "CY_r": (0.1, 0.5), "CZ_alpha": (-4.5, 1.5), "CZ_q": (-5.0, 10.0), "CZ_elevator": (-0.2, 0.5),
    "Cl_beta": (-0.05, 0.1), "Cl_p": (-0.4, 0.3), "Cl_r": (0.1, 0.2), "Cm_alpha": (-0.5, 0.7),
    "Cm_q": (-8.0, 10.0), "Cn_beta": (0.06, 0.1), "Cn_p": (-0.03, 0.2), "Cn_r": (-0.1, 0.2),
}  # fmt: skip
"""Of small aircraft (Beard & McLain 2012, appendix E; Paw 2009), with wide standard deviations [1/rad]."""
OTHER_DERIVATIVE = (0.0, 1.0)
SHARED: Prior = {
    "servo_lag": (0.03, 0.05),  # [s]
    "thrust_scale": (0.0, 0.1),
    "airspeed_scale": (0.0, 0.03),
    "arm_x": (0.0, 0.03),  # inertial sensors from the centre of gravity [m]
    "arm_y": (0.0, 0.01),
    "arm_z": (0.0, 0.03),
    "alpha_bias": (0.0, 0.02),  # of vanes [rad]
    "beta_bias": (0.0, 0.02),
}
OWN: Prior = {
    "wind_north": (0.0, 30.0),  # steady [m/s]
    "wind_east": (0.0, 30.0),
    "wind_down": (0.0, 0.1),
    "p_bias": (0.0, 0.003),  # left over by the path [rad/s]
    "q_bias": (0.0, 0.003),
    "r_bias": (0.0, 0.003),
}
"""Constants of a flight."""
SENSOR_CONSTANTS = ("thrust_scale", "airspeed_scale", "wind_down", "p_bias", "q_bias", "r_bias")
"""Constants whose priors hold for any flight, with a mean of zero."""
SHARED_NOISES: Prior = {
    "time_h": (1.5, 0.8),  # correlation of gusts, horizontal and vertical [s]
    "time_v": (1.5, 0.8),
    "fast_h": (0.1, 0.5),  # intensity of the faster part of gusts, over that of the slower one
    "fast_v": (0.1, 0.5),
    "faster_h": (0.2, 0.5),  # its correlation time, over that of the slower one
    "faster_v": (0.2, 0.5),
    "drive_p": (0.02, 1.0),  # random angular acceleration [rad/s^2/sqrt(Hz)]
    "drive_q": (0.02, 1.0),
    "drive_r": (0.02, 1.0),
    "surface": (0.05, 1.0),  # error of a surface's position, in its change within a step
    "ax": (0.1, 0.3),  # sensors, with what the model leaves out; medians follow the log
    "ay": (0.1, 0.3),
    "az": (0.1, 0.3),
    "gyro": (0.005, 0.3),
    "airspeed": (0.3, 1.0),
    "vane": (0.01, 1.0),
}
OWN_NOISES: Prior = {
    "gust_north": (0.5, 1.5),  # [m/s]
    "gust_east": (0.5, 1.5),
    "gust_down": (0.5, 1.5),
    "path_y": (0.1, 1.0),  # air velocity that errors of attitude and ground path make, body axes
    "path_z": (0.1, 0.6),
}


class Parameters(NamedTuple):
    """Parameters of some flights: those that all share, and those of each."""

    names: list[str]
    mean: Vector
    std: Vector
    places: Indices  # (n_flights, k) of the k parameters of each flight
    local_names: list[str]

    @classmethod
    def of(cls, shared: Prior, own: Prior, n_flights: int) -> Parameters:
        """Return the parameters of ``n_flights`` flights."""
        owned = {f"{name} {f}": prior for f in range(n_flights) for name, prior in own.items()}
        mean, std = np.array(list((dict(shared) | owned).values())).T
        first = np.arange(len(shared))
        places = [
            np.append(first, len(shared) + f * len(own) + np.arange(len(own)))
            for f in range(n_flights)
        ]
        return cls([*shared, *owned], mean.copy(), std.copy(), np.array(places), [*shared, *own])

    def values(self, x: Array, flight: int) -> dict[str, Array]:
        """Return the values (...) of the parameters of one flight, from all (..., p)."""
        local = np.moveaxis(x[..., self.places[flight]], -1, 0)
        return dict(zip(self.local_names, local, strict=True))


def derivatives_of(terms: Mapping[str, Sequence[str]], surfaces: Sequence[str]) -> Prior:
    """Return the priors of the derivatives of all terms but those of surfaces that are not there."""
    missing = {"elevator", "aileron", "rudder"} - set(surfaces)
    names = [f"{C}_{term}" for C in COEFFICIENTS for term in terms[C] if term not in missing]
    return {name: DERIVATIVES.get(name, OTHER_DERIVATIVE) for name in names}


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

    def terms(self, air: Array, rates: Array, surfaces: Array) -> Array:
        """Return the values (..., k) of the terms of the coefficients."""
        airspeed, alpha, beta = air_data(air)
        X = np.empty((*alpha.shape, self.derivatives.shape[1]))
        X[..., 0], X[..., 1], X[..., 2], X[..., 3] = 1.0, alpha, alpha**2, beta
        X[..., 4:7] = rates * (0.5 * self.aircraft.moment_lengths) / airspeed[..., None]
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
        turning = cross(loads[..., 3:], self.arm) + cross(rates, cross(rates, self.arm))
        force = loads[..., :3] + turning
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
