"""Goals of a plan besides derivatives: the function over what was flown, and a simulated flight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm

from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.frames import euler_per_rotation
from skdgp.design._information import Information
from skdgp.dynamics import Aerodynamics, Aircraft, Trim
from skdgp.dynamics._control.linearize import ANGLES, TURN, jacobian
from skdgp.dynamics._equations.motion import Motion

FUNCTION, FREE_FLIGHT = "function", "free-flight"
HORIZON = 2.0
"""Of free flight [s]."""
ROWS = 500
"""Drawn from the flown range of the regressors."""


def envelope_rows(model: Aerodynamics, goal: str) -> Matrix:
    """Return regressors (n, d), drawn evenly from the ranges that a model was learned from."""
    if model.limits is None:
        raise ValueError(
            f"Got the goal {goal!r}, but the model does not say what was flown: give an Aerodynamics with limits."
        )
    low, high = model.limits
    return low + (high - low) * np.random.default_rng(0).uniform(size=(ROWS, len(low)))


def goal_weights(
    goal: str, model: Aerodynamics, aircraft: Aircraft, trims: Sequence[Trim], coefficients: Sequence[str], thrust: Any
) -> Array:
    r"""Return W_i (P, 1 + d, 1 + d): the goal is the root of :math:`\sum_i \mathrm{tr}(W_i C_i)`.

    :math:`C_i` is the covariance of the constant and the slopes of coefficient i, and :math:`M` the mean of
    :math:`x x^T` of rows x = (1, regressors) of the flown envelope, so :math:`\mathrm{tr}(M C_i)` is the mean variance
    of the coefficient. "function": its sum over coefficients, each in units of its spread over these rows, over P.
    "free-flight": the mean variance of alpha, beta, phi, theta [rad^2] after two seconds, by errors that stay as they
    are, through the linear model at the trims.
    """
    rows = envelope_rows(model, goal)
    x = np.column_stack([np.ones(len(rows)), rows])
    chosen = [COEFFICIENTS.index(name) for name in coefficients]
    if goal == FUNCTION:
        spread = model(rows)[:, chosen].var(axis=0)
        share = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0) / len(chosen)
    else:
        share = np.mean([_growth(model, aircraft, point, thrust)[chosen] for point in trims], axis=0)
    return share[:, None, None] * (x.T @ x) / len(x)


def _growth(model: Aerodynamics, aircraft: Aircraft, point: Trim, thrust: Any) -> Array:
    """Return the mean square of alpha, beta, phi, theta after `HORIZON` by a unit error of each coefficient, (6,)."""
    found = jacobian(Motion(model, aircraft, thrust=thrust), point.state, point.controls)
    system = np.zeros((18, 18))
    system[:12] = np.column_stack([found.state, found.coefficients])
    moved = expm(system * HORIZON)[:12, 12:]
    euler = euler_per_rotation(point.phi, point.theta) @ moved[TURN]
    angles = np.concatenate([found.outputs_state[ANGLES] @ moved, euler[:2]])
    return (angles**2).mean(axis=0)


def weighted_error(information: Information, weights: Array) -> float:
    """Return the error of a goal, inf where the information does not determine it."""
    covariance = np.where(weights == 0, 0.0, information.whole_covariance)
    return float(np.sqrt(np.sum(weights * covariance)))
