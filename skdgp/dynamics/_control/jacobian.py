"""First-order derivatives of the aircraft's motion by states, controls and coefficients."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from skdgp._flight.frames import cross_matrix, quaternion_rate
from skdgp.dynamics._equations.motion import Air, Instant, Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, RATES

__all__ = ["ERRORS", "OUTPUTS", "Jacobian", "check_settled", "jacobian"]

ERRORS = ("north", "east", "down", "u", "v", "w", "turn_x", "turn_y", "turn_z", "p", "q", "r")
"""What a small error of a state is made of: its attitude is off by a small rotation about body axes."""
OUTPUTS = ("airspeed", "alpha", "beta", "ax", "ay", "az")
TURN, SPIN = slice(6, 9), slice(9, 12)
POSITION_STEP, ANGLE_STEP, FRACTION = 1.0, 1e-3, 1e-3
"""Of differences of the mechanics [m, rad or rad/s]; velocities and controls step by a fraction of themselves."""
WEIGHTS = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
"""Of the central difference of fourth order."""


class Jacobian(NamedTuple):
    """Derivatives at states (...): the state's error is `ERRORS`, the coefficients' one is added to the model's."""

    state: np.ndarray
    """d error_dot / d error, (..., 12, 12)."""
    controls: np.ndarray
    """(..., 12, k)."""
    coefficients: np.ndarray
    """(..., 12, 6)."""
    outputs_state: np.ndarray
    """d outputs / d error, of `OUTPUTS`, (..., 6, 12)."""
    outputs_controls: np.ndarray
    """(..., 6, k)."""
    instant: Instant


def jacobian(
    motion: Motion,
    state,
    controls: Mapping,
    *,
    inputs: Sequence[str] = (),
    air: Air | None = None,
) -> Jacobian:
    r"""Return the derivatives of an aircraft's motion at states (..., 13).

    The motion is mechanics :math:`\dot x = F(x, u, C)` around a model :math:`C = c(X)` of regressors
    :math:`X = G(x, u, C)`, which depend on C where they follow from the loads (alpha_dot, ax, ...). So

    .. math:: dC = (I - c_X G_C)^{-1} (c_X (G_x dx + G_u du) + e), \quad d\dot x = F_x dx + F_u du + F_C dC

    with the model's own slopes :math:`c_X`, e an error of the model, and F, G differenced, which is exact to some
    1e-10 of their size and asks the model for nothing.

    Parameters
    ----------
    motion : Motion
        Where its aerodynamics are paths, they are the first axis of ``state``.
    state : ndarray of shape (..., 13)
    controls : mapping of str to float or ndarray of shape (...)
    inputs : sequence of str
        The k controls to differentiate by.
    air : Air, optional
        As for :meth:`Motion.at`.
    """
    state = np.asarray(state, dtype=float)
    instant = motion.at(state, controls, air)
    F, G, H = _mechanics(motion, state, controls, tuple(inputs), instant, air)
    slopes = motion.aerodynamics.gradient(instant.regressors)
    n = len(ERRORS) + len(inputs)
    change, gain = slopes @ G[..., :n], np.eye(6)
    if motion.is_implicit:
        gain = np.linalg.inv(np.eye(6) - slopes @ G[..., n:])
        change = gain @ change
    rate, output = F[..., :n] + F[..., n:] @ change, H[..., :n] + H[..., n:] @ change
    rate[..., TURN, TURN], rate[..., TURN, SPIN] = -cross_matrix(state[..., RATES]), np.eye(3)
    return Jacobian(rate[..., :12], rate[..., 12:], F[..., n:] @ gain, output[..., :12], output[..., 12:], instant)


def check_settled(instant: Instant) -> None:
    """Raise a ValueError if the regressors that follow from the loads were not found."""
    if not np.all(instant.settled):
        raise ValueError(
            "The model depends so strongly on what follows from its coefficients that its motion is not determined: "
            "learn one without accelerations, as RegressorSelector() does."
        )


def _mechanics(motion, state, controls, inputs, instant, air):
    """Return d (error_dot, regressors, outputs) / d (error, inputs, coefficients), the coefficients being given."""
    frozen = copy.copy(motion)
    if air is not None:
        air = Air(*(None if part is None else np.asarray(part, dtype=float)[..., None, :] for part in air))
    n_inputs, shape = len(inputs), state.shape[:-1]
    controls = {name: np.broadcast_to(np.asarray(value, dtype=float), shape) for name, value in controls.items()}
    steps = np.concatenate(
        [
            np.full((*shape, 3), POSITION_STEP),
            np.repeat(FRACTION * instant.airspeed[..., None], 3, axis=-1),
            np.full((*shape, 6), ANGLE_STEP),
            *(FRACTION * (1.0 + np.abs(controls[name]))[..., None] for name in inputs),
            np.full((*shape, 6), FRACTION),
        ],
        axis=-1,
    )
    slopes = 0.0
    for move, weight in WEIGHTS.items():
        moves = move * steps[..., None] * np.eye(steps.shape[-1])
        C = instant.coefficients[..., None, :] + moves[..., 12 + n_inputs :]
        frozen.aerodynamics = lambda X, C=C: C
        moved = {name: np.repeat(value[..., None], steps.shape[-1], axis=-1) for name, value in controls.items()}
        for k, name in enumerate(inputs):
            moved[name] = moved[name] + moves[..., 12 + k]
        slopes = slopes + weight * _followed(frozen.at(_shifted(state, moves[..., :12]), moved, air), motion)
    slopes = np.swapaxes(slopes / steps[..., None], -1, -2)
    d = len(motion.regressors)
    return slopes[..., :12, :], slopes[..., 12 : 12 + d, :], slopes[..., 12 + d :, :]


def _shifted(state, errors) -> np.ndarray:
    """Return the states (..., 13) with errors (..., m, 12), as (..., m, 13)."""
    shifted = np.repeat(state[..., None, :], errors.shape[-2], axis=-2)
    shifted[..., :6] += errors[..., :6]
    shifted[..., RATES] += errors[..., SPIN]
    shifted[..., ATTITUDE] += quaternion_rate(shifted[..., ATTITUDE], errors[..., TURN])
    return shifted


def _followed(instant: Instant, motion: Motion) -> np.ndarray:
    """Return error_dot but for the attitude, which `jacobian` knows exactly, then regressors and outputs."""
    derivative = instant.derivative
    seen = np.stack([instant.airspeed, instant.alpha, instant.beta], axis=-1)
    return np.concatenate(
        [
            derivative[..., :6],
            np.zeros((*derivative.shape[:-1], 3)),
            derivative[..., RATES],
            instant.regressors,
            seen,
            instant.force / motion.aircraft.mass,
        ],
        axis=-1,
    )
