"""Regressors of simulated flights, and the information of rows about the slopes of a linear model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, LENGTHS, rate_factor
from skdgp._flight.checks import check_columns
from skdgp.dynamics import Aerodynamics, Aircraft


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
    columns = []
    for name in names:
        channel = name if name in flight else name.removesuffix(HAT)
        is_slope = channel in ("alpha_dot", "beta_dot") and channel not in flight
        source = channel.removesuffix("_dot") if is_slope else channel
        check_columns(flight, [source, "airspeed"])
        values = flight[source].to_numpy(float)
        if is_slope:
            values = np.gradient(values, flight["time"].to_numpy(float))
        if channel != name and channel in LENGTHS:
            length = getattr(aircraft, LENGTHS[channel])
            values = values * rate_factor(channel, length, flight["airspeed"].to_numpy(float))
        columns.append(values)
    return np.stack(columns, axis=-1)


def information(X: Matrix) -> Matrix:
    """Return the Fisher information (1 + d, 1 + d) of rows X (n, d) for noise of unit variance.

    It concerns a constant and the slopes of a coefficient that is linear in the regressors. The
    noise of a coefficient is a factor of all its variances, so the information serves all six.
    """
    rows = np.column_stack([np.ones(len(X)), X])
    return rows.T @ rows


def slope_variances(fisher: Matrix) -> Vector:
    """Return the variances (d,) of the slopes, of the information about a constant and d slopes."""
    scale = np.sqrt(np.diag(fisher))
    return np.diag(np.linalg.inv(fisher / np.outer(scale, scale)))[1:] / scale[1:] ** 2


def derivative_names(model: Aerodynamics) -> dict[str, int]:
    """Return the number of the regressor of each derivative of the model, such as ``Cm_q``."""
    short = [name.removesuffix(HAT) for name in model.regressors]
    return {
        f"{coefficient}_{name}": k for coefficient in COEFFICIENTS for k, name in enumerate(short)
    }


def check_goal(goal: Sequence[str] | None, model: Aerodynamics) -> tuple[str, ...]:
    """Return the names of a goal, by default all derivatives; raise ValueError if the model cannot tell of one."""
    derivatives = derivative_names(model)
    names = (goal,) if isinstance(goal, str) else tuple(derivatives if goal is None else goal)
    lacking = [name for name in names if name not in derivatives]
    if lacking or not names or isinstance(goal, str):
        raise ValueError(
            f"Got the goal {lacking or goal!r}, but the model has the regressors "
            f"{list(model.regressors)}: give a list of derivatives such as {next(iter(derivatives))!r}, "
            f"or learn a model with that regressor."
        )
    if model.limits is not None:
        still = np.ptp(model.limits, axis=0) == 0
        if unmoved := [name for name in goal or () if still[derivatives[name]]]:
            raise ValueError(
                f"Got the goal {unmoved}, but {model.regressors[derivatives[unmoved[0]]]} did not move "
                f"in the flights that the model was learned from: learn from a flight in which it "
                f"moves, or ask for another goal."
            )
    return names
