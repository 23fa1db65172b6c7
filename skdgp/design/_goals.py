"""Goals of a plan besides derivatives: the function over what was flown, and a simulated flight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import expm

from skdgp._compute.typing import Array
from skdgp._flight.channels import COEFFICIENTS, HAT
from skdgp._flight.frames import euler_per_rotation
from skdgp.dynamics import Aerodynamics, Aircraft, Trim
from skdgp.dynamics._control.linearize import ANGLES, TURN, jacobian
from skdgp.dynamics._equations.motion import Motion

FUNCTION, FREE_FLIGHT = "function", "free-flight"
WHOLE = (FUNCTION, FREE_FLIGHT)
"""Goals that are errors of the whole model rather than of one derivative."""
HORIZON = 2.0
"""Duration of free flight [s]."""
ROWS = 500
"""Number of rows drawn from the flown range of the regressors."""


def _derivatives(model: Aerodynamics, coefficients: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Return numbers of coefficient and regressor by name, such as ``Cm_q``."""
    short = [name.removesuffix(HAT) for name in model.regressors]
    return {f"{one}_{name}": (i, k) for i, one in enumerate(coefficients) for k, name in enumerate(short)}


def check_goal(goal: Sequence[str] | None, model: Aerodynamics, coefficients: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a goal, by default all derivatives; raise ValueError if the model cannot tell of them."""
    known = _derivatives(model, coefficients)
    names = (goal,) if isinstance(goal, str) else tuple(known if goal is None else goal)
    lacking = [name for name in names if name not in {*known, *WHOLE}]
    if lacking or not names or isinstance(goal, str):
        raise ValueError(
            f"Got the goal {lacking or goal!r}, but the model has the coefficients {list(coefficients)} and the "
            f"regressors {list(model.regressors)}: give a list of {FUNCTION!r}, {FREE_FLIGHT!r} or derivatives such as "
            f"{next(iter(known))!r}, or learn a model with that regressor."
        )
    still = np.zeros(len(model.regressors), bool) if model.limits is None else np.ptp(model.limits, axis=0) == 0
    for name in goal or ():
        if name in known and still[known[name][1]]:
            raise ValueError(
                f"Got the goal {name!r}, but {model.regressors[known[name][1]]} did not move in the flights that the "
                "model was learned from, so it knows nothing of its effect: learn from a flight in which it moves, or "
                "ask for another goal."
            )
    return names


def goal_weights(
    names: Sequence[str],
    model: Aerodynamics,
    aircraft: Aircraft,
    trims: Sequence[Trim],
    coefficients: Sequence[str],
    thrust: Any,
) -> dict[str, Array]:
    r"""Return W (P, 1 + d, 1 + d) of each goal, whose error is the root of :math:`\sum_i \mathrm{tr}(W_i C_i)`.

    :math:`C_i` is the covariance of the constant and the slopes of coefficient i. Of a derivative W is one element.
    With the mean M of :math:`x x^T` over rows x = (1, regressors) of the flown envelope, :math:`\mathrm{tr}(M C_i)` is
    the mean variance of the coefficient. "function": its sum over coefficients, each in units of its spread over these
    rows, over P. "free-flight": the mean variance of alpha, beta, phi, theta [rad^2] after two seconds, by errors that
    stay as they are, through the linear model at the trims.
    """
    derivatives, found = _derivatives(model, coefficients), {}
    chosen = [COEFFICIENTS.index(one) for one in coefficients]
    for name in names:
        if name in derivatives:
            i, k = derivatives[name]
            found[name] = np.zeros((len(coefficients), *[1 + len(model.regressors)] * 2))
            found[name][i, 1 + k, 1 + k] = 1.0
            continue
        if model.limits is None:
            raise ValueError(
                f"Got the goal {name!r}, but the model does not say what was flown: give an Aerodynamics with limits."
            )
        low, high = model.limits
        rows = low + (high - low) * np.random.default_rng(0).uniform(size=(ROWS, len(low)))
        x = np.column_stack([np.ones(ROWS), rows])
        if name == FUNCTION:
            spread = model(rows)[:, chosen].var(axis=0)
            share = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0) / len(chosen)
        else:
            share = np.mean([_growth(model, aircraft, point, thrust)[chosen] for point in trims], axis=0)
        found[name] = share[:, None, None] * (x.T @ x) / ROWS
    return found


def _growth(model: Aerodynamics, aircraft: Aircraft, point: Trim, thrust: Any) -> Array:
    """Return the mean square of alpha, beta, phi, theta after `HORIZON` by a unit error of each coefficient, (6,)."""
    found = jacobian(Motion(model, aircraft, thrust=thrust), point.state, point.controls)
    system = np.zeros((18, 18))
    system[:12] = np.column_stack([found.state, found.coefficients])
    moved = expm(system * HORIZON)[:12, 12:]
    euler = euler_per_rotation(point.phi, point.theta) @ moved[TURN]
    angles = np.concatenate([found.outputs_state[ANGLES] @ moved, euler[:2]])
    return (angles**2).mean(axis=0)
