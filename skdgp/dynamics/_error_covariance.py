r"""First-order errors of a flight, and their covariance along it.

A small error x of the state (`ERRORS`) obeys x' = A x + B z along the flight, with z independent
errors of unit variance behind the coefficients. Over a step h, with c = exp(-h / correlation time)
and w white,

    x_1 = Phi (x_0 + h/2 B_0 z_0) + h/2 B_1 z_1,   Phi = exp(h (A_0 + A_1) / 2),   z_1 = c z_0 + sqrt(1 - c^2) w.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import BODY_VELOCITY, EARTH_VELOCITY, EULER, POSITION, RATES
from skdgp._flight.checks import check_names
from skdgp._flight.frames import (
    cross,
    cross_matrix,
    euler_per_rotation,
    quaternion_to_euler,
    quaternion_to_matrix,
)
from skdgp.dynamics._rigid_body import ATTITUDE, VELOCITY

ERRORS = (*POSITION, *BODY_VELOCITY, "turn_x", "turn_y", "turn_z", *RATES)
"""Errors of a state: that of its attitude is a small rotation about body axes."""
STATES = (*POSITION, *BODY_VELOCITY, *EULER, *RATES, *EARTH_VELOCITY)
"""Rows of `state_readouts`."""


def checked_std(std: Mapping[str, float] | None) -> dict[str, float]:
    """Return standard deviations of a start by name, of `STATES`; raise ValueError if one is negative or not finite."""
    std = dict(std or {})
    check_names(std, STATES, "names of initial_std")
    for name, size in std.items():
        if not (np.isfinite(size) and size >= 0):
            raise ValueError(
                f"Got initial_std of {name} {size!r}, but expected a finite number from 0 on."
            )
    return std


def start_errors(std: Mapping[str, float], states: Array) -> Array:
    """Return the error (..., 12, k) that one deviation of each of k names makes at states (..., 13).

    Errors of angles alone leave the velocity over the ground as it is, which is what was measured.
    """
    rotation, velocity = quaternion_to_matrix(states[..., ATTITUDE]), states[..., VELOCITY]
    turns = np.linalg.inv(_euler_slopes(states))
    errors = np.zeros((*states.shape[:-1], 12, len(std)))
    for k, (name, size) in enumerate(std.items()):
        if name in EARTH_VELOCITY:
            errors[..., 3:6, k] = size * rotation[..., EARTH_VELOCITY.index(name), :]
        elif name in EULER:
            errors[..., 6:9, k] = size * turns[..., EULER.index(name)]
            if not any(body in std for body in BODY_VELOCITY):
                errors[..., 3:6, k] = cross(velocity, errors[..., 6:9, k])
        else:
            errors[..., ERRORS.index(name), k] = size
    return errors


def state_readouts(states: Array) -> Array:
    """Return d `STATES` / d error at states (..., 13), (..., 15, 12)."""
    rotation = quaternion_to_matrix(states[..., ATTITUDE])
    readouts = np.zeros((*states.shape[:-1], len(STATES), 12))
    readouts[..., :12, :] = np.eye(12)
    readouts[..., 6:9, 6:9] = _euler_slopes(states)
    readouts[..., 12:, 3:6] = rotation
    readouts[..., 12:, 6:9] = -rotation @ cross_matrix(states[..., VELOCITY])
    return readouts


def error_covariances(
    samples: Iterable[tuple[Array, Array]],
    steps: Iterable[Array | float],
    start: Array,
    correlation_time: float = np.inf,
) -> Iterator[Array]:
    """Yield the covariance of the errors (..., 12, 12) at every sample.

    ``samples`` yields A (..., 12, 12) and B (..., 12, m) of each, ``steps`` the time from each to
    the next [s], a float or (..., 1, 1). ``start`` (..., 12, k) is a root of the first covariance,
    ``correlation_time`` that of z [s].
    """
    samples = iter(samples)
    A, B = next(samples)
    covariance, with_z = start @ np.swapaxes(start, -1, -2), np.zeros_like(B)
    yield covariance
    for (next_A, next_B), step in zip(samples, steps, strict=True):
        half = 0.5 * step
        M, one = half * (A + next_A), np.eye(12)
        transition = one + M @ (
            one + M @ (one / 2 + M @ (one / 6 + M / 24))
        )  # exp(M) of small M, to fourth order
        memory = np.exp(-step / correlation_time) if correlation_time > 0 else 0.0
        covariance, with_z = _pushed(covariance, with_z, half * B)
        covariance = transition @ covariance @ np.swapaxes(transition, -1, -2)
        covariance, with_z = _pushed(covariance, memory * (transition @ with_z), half * next_B)
        A, B = next_A, next_B
        yield covariance


def state_deviations(
    samples: Iterable[tuple[Array, Array]],
    steps: Iterable[Array | float],
    std: Mapping[str, float],
    states: Array,
    correlation_time: float = np.inf,
) -> Iterator[Array]:
    """Yield the standard deviations of `STATES` at every state (n_times, ..., 13).

    ``std`` are those of the start by name, the rest as of `error_covariances`.
    """
    covariances = error_covariances(samples, steps, start_errors(std, states[0]), correlation_time)
    for state, covariance in zip(states, covariances, strict=False):
        yield standard_deviations(covariance, state_readouts(state))


def standard_deviations(covariance: Array, readouts: Array) -> Array:
    """Return the deviations (..., n) of readouts (..., n, 12); a variance below zero is rounding."""
    return np.sqrt(np.maximum(np.einsum("...ij,...ij->...i", readouts @ covariance, readouts), 0.0))


def _pushed(covariance: Array, with_z: Array, push: Array) -> tuple[Array, Array]:
    """Return the covariance of x + push z, and that of it with z."""
    cross = with_z @ np.swapaxes(push, -1, -2)
    covariance = covariance + cross + np.swapaxes(cross, -1, -2) + push @ np.swapaxes(push, -1, -2)
    return covariance, with_z + push


def _euler_slopes(states: Array) -> Array:
    angles = quaternion_to_euler(states[..., ATTITUDE])
    return euler_per_rotation(angles[..., 0], angles[..., 1])
