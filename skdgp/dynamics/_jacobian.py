r"""Derivatives of the motion at states, and errors of slopes that the posterior of a model does not contain.

Most flights do not tell alpha_dot from q and beta_dot from r (Klein & Morelli 2006, section 5.1). A
model without them gives their effect to the regressors that they follow from. With
:math:`\dot\alpha = S x` of the motion that the loads of the model cause without gravity, a slope by
x holds :math:`C_{\dot\alpha} S`. A tail in the downwash gives :math:`C_{\dot\alpha} = C_q\,
d\epsilon/d\alpha` (Etkin & Reid 1996, section 5.5). The downwash is not known here, so
:math:`C_{\dot\alpha}` is zero with a standard deviation of `SHARES` of :math:`C_q`, and of
:math:`C_r` for beta_dot. The square of :math:`C_q` is the model's, plus the square of its
deviation by method: where gusts make it vanish, :math:`C_{\dot\alpha}` need not vanish.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import BODY_VELOCITY, EULER, POSITION, RATE_LENGTHS
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import (
    air_data_slopes,
    air_velocity,
    cross,
    euler_per_rotation,
    euler_to_quaternion,
    quaternion_to_euler,
)
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, RATES

# Rates of change, and the rates whose slopes theirs are shares of
LAGS = {"alpha_dot": "q", "beta_dot": "r"}
SHARES = np.array([0.4, 0.2])
STATES = (*POSITION, *BODY_VELOCITY, *EULER, *RATE_NAMES)  # States of a linear model
ANGLES_OF_STATE = slice(6, 9)  # Places of phi, theta, psi in `STATES`
OUTPUTS = ("airspeed", "alpha", "beta", "ax", "ay", "az")
ANGLES = slice(1, 3)  # Places of alpha and beta in `OUTPUTS`
# Of differences of the mechanics [m, rad or rad/s]; velocities and controls step by a fraction of
# themselves
POSITION_STEP, ANGLE_STEP, FRACTION = 1.0, 1e-3, 1e-3
# Of the central difference of fourth order
WEIGHTS = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}


def jacobian(
    motion: Motion,
    state: Array,
    controls: Mapping,
    inputs: Sequence[str] = (),
    lag: Lag | None = None,
) -> tuple[Array, Array, Instant]:
    r"""Return d state_dot (..., 12, 12 + k), d outputs (..., 6, 12 + k) by `STATES` and inputs, and the instant.

    The states are (..., 13), as of `Motion.at`, the inputs k of the controls. The
    motion is mechanics :math:`\dot x = F(x, u, C)` around a model :math:`C = c(X)` of
    regressors :math:`X = G(x, u, C)`, which depend on C where they follow from the loads
    (alpha_dot, ax, ...). So

    .. math:: dC = (I - c_X G_C)^{-1} c_X (G_x dx + G_u du), \quad d\dot x = F_x dx + F_u du + F_C dC

    with the slopes of the model :math:`c_X`, and differences of F and G, exact to some 1e-10.
    ``controls`` are as of :meth:`Motion.at`. Where the aerodynamics are paths, these are the
    first axis of ``state``. A ``lag`` adds coefficients by alpha_dot and beta_dot, to first order.
    """
    state = np.asarray(state, dtype=float)
    instant = motion.at(state, controls)
    F, G, H = _mechanics(motion, state, controls, tuple(inputs), instant)
    slopes = motion.aerodynamics.gradient(instant.regressors)
    n = len(STATES) + len(inputs)
    change: np.ndarray = slopes @ G[..., :n]
    gain: np.ndarray = np.eye(6)
    if motion.is_implicit:
        gain = np.linalg.inv(np.eye(6) - slopes @ G[..., n:])
        change = gain @ change
    if lag is not None:
        rate = F[..., :n] + F[..., n:] @ change
        by_angles = lag.missing * (H[..., ANGLES, : len(STATES)] @ rate)
        change = change + gain @ lag.slopes @ (by_angles - lag.relation @ G[..., :n])
    rate = F[..., :n] + F[..., n:] @ change
    return rate, H[..., :n] + H[..., n:] @ change, instant


def check_settled(instant: Instant) -> None:
    """Raise ValueError if the fixed point of the implicit regressors was not found."""
    if not np.all(instant.settled):
        raise ValueError(
            "The coefficients depend so strongly on the accelerations they cause that the motion "
            "is not determined: "
            "learn a model without accelerations, as RegressorSelector() does."
        )


def _mechanics(
    motion: Motion, state: Array, controls: Mapping, inputs: tuple[str, ...], instant: Instant
) -> tuple[Array, Array, Array]:
    """Return d (state_dot, regressors, outputs) / d (state, inputs, coefficients), the coefficients being given."""
    frozen: Any = copy.copy(motion)
    shape = state.shape[:-1]
    n = len(STATES)
    k = len(inputs)
    x = np.concatenate(
        [state[..., :6], quaternion_to_euler(state[..., ATTITUDE]), state[..., RATES]], axis=-1
    )
    u = {name: np.broadcast_to(np.asarray(v, dtype=float), shape) for name, v in controls.items()}
    steps = np.full((*shape, n + k + 6), FRACTION)
    steps[..., :3] = POSITION_STEP
    steps[..., 3:6] = FRACTION * instant.airspeed[..., None]
    steps[..., 6:n] = ANGLE_STEP
    for j, name in enumerate(inputs):
        steps[..., n + j] = FRACTION * (1.0 + np.abs(u[name]))
    slopes = np.zeros(())
    for move, weight in WEIGHTS.items():
        moves = move * steps[..., None] * np.eye(n + k + 6)
        C = instant.coefficients[..., None, :] + moves[..., n + k :]
        frozen.aerodynamics = lambda X, C=C: C
        moved = {name: np.repeat(v[..., None], n + k + 6, axis=-1) for name, v in u.items()}
        for j, name in enumerate(inputs):
            moved[name] = moved[name] + moves[..., n + j]
        now = frozen.at(_state(x[..., None, :] + moves[..., :n]), moved)
        slopes = slopes + weight * _responses(now, x[..., None, :] + moves[..., :n], motion)
    slopes = np.swapaxes(slopes / steps[..., None], -1, -2)
    d = len(motion.regressors)
    return slopes[..., :n, :], slopes[..., n : n + d, :], slopes[..., n + d :, :]


def _state(x: Array) -> Array:
    """Return states (..., 13) of states with Euler angles (..., 12)."""
    attitude = euler_to_quaternion(*np.moveaxis(x[..., ANGLES_OF_STATE], -1, 0))
    return np.concatenate([x[..., :6], attitude, x[..., 9:]], axis=-1)


def _responses(instant: Instant, x: Array, motion: Motion) -> Array:
    """Return the rates of change of `STATES`, the regressors, and `OUTPUTS`."""
    euler_rate = euler_per_rotation(x[..., 6], x[..., 7]) @ x[..., 9:, None]
    air = np.stack([instant.airspeed, instant.alpha, instant.beta], axis=-1)
    rate = instant.derivative
    parts = [rate[..., :6], euler_rate[..., 0], rate[..., RATES], instant.regressors, air]
    return np.concatenate([*parts, instant.force / motion.aircraft.mass], axis=-1)


class Lag(NamedTuple):
    """What alpha_dot and beta_dot may change of C: slopes @ (missing * rates - relation @ regressors)."""

    slopes: Array  # One standard deviation of the slopes of C by them [s/rad], (..., 6, 2)
    # S, their slopes by the regressors, less their slopes as regressors themselves, (..., 2, d)
    relation: Array
    missing: Array  # Whether they are no regressors, (2, 1)

    @property
    def errors(self) -> Array:
        """Errors of the slopes of C, (..., 6, d, 2)."""
        return -np.einsum("...ij,...jk->...ikj", self.slopes, self.relation)


def lag_of(motion: Motion, now: Instant, slopes: Array, scatter: ArrayLike = 0.0) -> Lag:
    """Return what alpha_dot and beta_dot may change at a flight, by the slopes (..., 6, d) of the model.

    ``scatter`` is the standard deviation of these slopes by method.
    """
    velocity = air_velocity(now.airspeed, now.alpha, now.beta)
    pressure = (
        0.5 * now.density * now.airspeed**2 * motion.aircraft.wing_area / motion.aircraft.mass
    )
    acceleration = np.asarray(pressure)[..., None, None] * slopes[..., :3, :]
    by_rate = np.zeros((*slopes.shape[:-1], 2))
    as_regressors = np.zeros((*slopes.shape[:-2], 2, slopes.shape[-1]))
    size = np.copysign(np.hypot(slopes, scatter), slopes)
    for k, name in enumerate(motion.regressors):
        if name not in RATE_LENGTHS:
            continue
        unit = np.broadcast_to(
            1.0 / motion.factor(k, now.airspeed), np.shape(now.airspeed)
        )  # of the regressor [rad/s]
        if name in LAGS:
            as_regressors[..., list(LAGS).index(name), k] = unit
            continue
        acceleration[..., k] -= (
            cross(np.eye(3)["pqr".index(name)] * np.ones_like(velocity), velocity) * unit[..., None]
        )
        if name in LAGS.values():
            by_rate[..., list(LAGS.values()).index(name)] = size[..., k] / unit[..., None]
    missing = np.array([[name not in motion.regressors] for name in LAGS])
    return Lag(
        SHARES * by_rate,
        air_data_slopes(velocity)[..., 1:, :] @ acceleration - as_regressors,
        missing,
    )


def draw_errors(errors: Any, lag: Lag, n_paths: int, random_state: Seed) -> tuple[Array, Lag]:
    """Return draws of the errors of slopes at one flight, (n_paths, 6, d), and of the lag, with paths first."""
    seed = check_random_state(random_state).randint(
        2**31 - 1, size=4
    )  # other numbers than for the paths
    rng = np.random.default_rng(seed)
    lag_drawn = lag._replace(slopes=lag.slopes * rng.standard_normal((n_paths, 1, 2)))
    drawn = np.zeros((n_paths, *lag.errors.shape[:-1]))
    for part in () if errors is None else (errors.random[0], errors.method[0]):
        drawn += np.moveaxis(part @ rng.standard_normal((part.shape[-1], n_paths)), -1, 0)
    return drawn, lag_drawn
