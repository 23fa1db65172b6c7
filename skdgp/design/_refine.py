"""Steps of several axes at once that teach most: gradient ascent on the information of the linear response."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.design._information import whitened

STARTS, ITERATIONS = 3, 80
PENALTY = 30.0
"""Of the mean square by which a channel leaves its room, relative to it, against the gain."""


class Response(NamedTuple):
    """Linear response of an aircraft to a step of each axis that is held for a slot."""

    hold: Matrix
    """Regressors of trimmed flight, (n, d)."""
    pulses: Array
    """What a unit step of the first slot adds to them, (axes, n, d)."""
    channels: Array
    """What it adds to the channels of the envelope, over the room that they have, (axes, n, c)."""
    every: int
    """Rows of a slot."""

    def of_slots(self, values: Array, n_slots: int) -> Array:
        """Return the response to each slot of each axis, (n, columns, axes * n_slots): that to the first one, later."""
        found = np.zeros((*values.shape[1:], len(values), n_slots))
        for k in range(n_slots):
            late = k * self.every
            found[late:, :, :, k] = np.moveaxis(values[:, : values.shape[1] - late], 0, -1)
        return found.reshape(*found.shape[:2], -1)


def best_levels(
    response: Response,
    n_slots: int,
    amplitudes: Vector,
    gain: Callable[[Array], tuple[float, Array]],
    noise: pd.DataFrame,
    time: Vector,
    seed: int,
) -> Matrix:
    r"""Return the levels (axes, n_slots) of the largest gain that keep the envelope.

    The response is the sum of those to the single steps, so the whitened regressors of coefficient i are
    :math:`A_i(c) = A_{i0} + \sum_j c_j A_{ij}` and its information :math:`A_i^T A_i` has the slope
    :math:`2 A_i^T A_{ij}`. What leaves the room of the envelope is penalised by its square. L-BFGS-B keeps the
    amplitudes; it starts from random signs, the best of a few counts.

    Parameters
    ----------
    response : Response
    n_slots : int
    amplitudes : ndarray of shape (axes,)
        Largest deviation of each axis.
    gain : callable
        Information (P, 1 + d, 1 + d) to the gain and its slope by the information.
    noise : DataFrame
        As for `expected_information`.
    time : ndarray of shape (n,)
        Of the rows of the response [s].
    seed : int
        Of the starts.
    """
    drift, white, memory = (noise[name].to_numpy(float) for name in ("drift", "white", "memory"))

    def white_of(columns: Matrix) -> Array:
        return whitened(columns, time, white**2, drift**2, memory)

    n, d = response.hold.shape
    size = np.repeat(amplitudes, n_slots)
    slots = response.of_slots(response.pulses, n_slots) * size
    first = white_of(np.column_stack([np.ones(n), response.hold])).swapaxes(0, 1)  # (P, n, 1 + d)
    each = white_of(slots.reshape(n, -1)).reshape(n, len(white), d, -1).transpose(1, 0, 2, 3)
    moved = (response.of_slots(response.channels, n_slots) * size).reshape(-1, len(size))

    def loss(levels: Vector) -> tuple[float, Vector]:
        A = first.copy()
        A[:, :, 1:] += each @ levels
        value, slope = gain(A.swapaxes(1, 2) @ A)
        by_levels = 2.0 * np.tensordot((A @ slope)[:, :, 1:], each, axes=3)
        out = moved @ levels
        beyond = np.sign(out) * np.maximum(np.abs(out) - 1.0, 0.0)
        return (
            PENALTY * float(beyond @ beyond) / n - value,
            2.0 * PENALTY * (beyond @ moved) / n - by_levels,
        )

    rng = np.random.default_rng(seed)
    found = [
        minimize(loss, 0.7 * rng.choice([-1.0, 1.0], len(size)), jac=True, method="L-BFGS-B",
                 bounds=[(-1.0, 1.0)] * len(size), options={"maxiter": ITERATIONS})
        for _ in range(STARTS)
    ]  # fmt: skip
    best = min(found, key=lambda one: one.fun).x
    return (best * size).reshape(len(amplitudes), n_slots)


def gain_of(fisher: Array, goal: Sequence[tuple[int, int]]) -> tuple[float, Array]:
    """Return the mean of minus the logarithm of the standard errors of the goal, and its slope by the information."""
    scale = np.sqrt(np.einsum("pdd->pd", fisher))
    inverse = np.linalg.inv(fisher / scale[:, :, None] / scale[:, None]) / scale[:, :, None] / scale[:, None]
    value, slope = 0.0, np.zeros_like(fisher)
    for i, k in goal:
        value -= 0.5 * np.log(inverse[i, k, k]) / len(goal)
        slope[i] += 0.5 * np.outer(inverse[i, k], inverse[i, k]) / inverse[i, k, k] / len(goal)
    return float(value), slope
