r"""First-order uncertainty of a trajectory: errors of the model propagated along the flight of its mean.

The model's errors at the points that are passed, e(t), are jointly Gaussian with the posterior covariance, and an
error of the state obeys x' = A x + G e with the slopes of the motion. Between knots e is linear, e = sum_j hat_j e_j,
so x(t) = Z(t) z with z white of unit variance, L L^T the covariance of all e_j, and Z' = A Z + G hat L.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skdgp._compute.linalg import semidefinite_root
from skdgp._flight.channels import EULER
from skdgp._flight.frames import euler_per_rotation, quaternion_to_euler, quaternion_to_matrix
from skdgp.dynamics._control.jacobian import Jacobian, jacobian
from skdgp.dynamics._equations.motion import Air, Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, VELOCITY
from skdgp.dynamics._simulation.fly import Record
from skdgp.dynamics._simulation.starts import BODY, EARTH, checked_std

__all__ = ["linear_std"]

MOST_KNOTS = 250
"""A knot for each step, on longer flights so many: errors that forget themselves from knot to knot count too much."""
NAMES = ("north", "east", "down", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r")
SEEN = ("v_north", "v_east", "v_down", "airspeed", "alpha", "beta")


def linear_std(record: Record, motion: Motion, initial_std: Mapping[str, float] | None) -> dict[str, np.ndarray]:
    """Return the standard deviations of what is seen along trajectories () or (n_starts,), by name, (n_times, ...).

    Raises
    ------
    ValueError
        If the model gives no covariance of its errors, or a name of ``initial_std`` is unknown.
    """
    start = checked_std(initial_std)
    shape = record.ended.shape
    found = {f"{name}_std": np.full((len(record.time), *shape), np.nan) for name in (*NAMES, *SEEN)}
    for place in np.ndindex(shape):
        n = int(record.end[place])  # as long as it flew
        if n > 1:
            spread = _along(_Path(record, motion, place, n), motion, start)
            for name, std in zip(found, spread.T, strict=True):
                found[name][(slice(n), *place)] = std
    return found


class _Path:
    """One trajectory at its knots."""

    def __init__(self, record: Record, motion: Motion, place, n: int):
        dt = record.time[1]
        every = max(1, -(-n // MOST_KNOTS))
        self.knots = np.unique(np.append(np.arange(0, n, every), n - 1))
        self.dt, self.n = dt, n
        at = (self.knots, *place)
        wind = None if record.wind is None else record.wind[at]
        controls = {name: values[at] for name, values in record.controls.items()}
        self.states, self.regressors = record.states[(slice(n), *place)], record.regressors[at]
        self.slopes: Jacobian = jacobian(motion, record.states[at], controls, air=None if wind is None else Air(wind))

    def between(self, values) -> np.ndarray:
        """Return values at the knots, (k, ...), at every step, linear between them."""
        steps = np.arange(self.n)
        left = np.clip(np.searchsorted(self.knots, steps, side="right") - 1, 0, len(self.knots) - 2)
        share = (steps - self.knots[left]) / (self.knots[left + 1] - self.knots[left])
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        return (1.0 - share) * values[left] + share * values[left + 1]


def _along(path: _Path, motion: Motion, start: Mapping[str, float]) -> np.ndarray:
    """Return the standard deviations (n, 18) of `NAMES` and `SEEN`."""
    k = len(path.knots)
    root = semidefinite_root(motion.aerodynamics.covariance(path.regressors))  # (6 k, r), output by output
    errors = path.between(np.moveaxis(root.reshape(6, k, -1), 1, 0))  # (n, 6, r)
    A, G = path.between(path.slopes.state), path.between(path.slopes.coefficients)
    push = np.concatenate([0.5 * path.dt * G @ errors, np.zeros((path.n, 12, len(start)))], axis=-1)
    middle = 0.5 * path.dt * (A[:-1] + A[1:])
    transition = np.eye(12) + middle @ (
        np.eye(12) + middle @ (np.eye(12) / 2 + middle @ (np.eye(12) / 6 + middle / 24))
    )
    angles = quaternion_to_euler(path.states[:, ATTITUDE])
    per_rotation = euler_per_rotation(angles[:, 0], angles[:, 1])
    Z = np.zeros(push.shape[1:])
    Z[:, Z.shape[1] - len(start) :] = _start_errors(start, path.states[0], per_rotation[0])
    seen = _readouts(path, per_rotation)
    std = np.empty((path.n, len(NAMES) + len(SEEN)))
    for step in range(path.n):
        if step:
            Z = transition[step - 1] @ (Z + push[step - 1]) + push[step]
        std[step] = np.linalg.norm(seen[step] @ Z, axis=1)
    return std


def _start_errors(start: Mapping[str, float], state, per_rotation) -> np.ndarray:
    """Return the errors of the state (12, k) that one deviation of each name is, as `perturbed` draws them."""
    velocity, turns = state[VELOCITY], np.linalg.inv(per_rotation)
    Z = np.zeros((12, len(start)))
    for k, (name, size) in enumerate(start.items()):
        if name in EARTH:
            Z[3:6, k] = size * quaternion_to_matrix(state[ATTITUDE])[EARTH.index(name)]
        elif name in EULER:
            Z[6:9, k] = size * turns[:, EULER.index(name)]
            if not any(body in start for body in BODY):  # the velocity over the ground is what was measured
                Z[3:6, k] = np.cross(velocity, Z[6:9, k])
        else:
            Z[NAMES.index(name), k] = size
    return Z


def _readouts(path: _Path, per_rotation) -> np.ndarray:
    """Return d (`NAMES`, `SEEN`) / d error, (n, 18, 12)."""
    H = np.zeros((path.n, len(NAMES) + len(SEEN), 12))
    H[:, :12] = np.eye(12)
    H[:, 6:9, 6:9] = per_rotation
    rotation, velocity = quaternion_to_matrix(path.states[:, ATTITUDE]), path.states[:, VELOCITY]
    H[:, 12:15, 3:6] = rotation
    H[:, 12:15, 6:9] = -rotation @ np.cross(velocity[:, None, :], np.eye(3)).swapaxes(-1, -2)
    H[:, 15:18] = path.between(path.slopes.outputs_state[:, :3])
    return H
