"""Least squares of the rows that a model is learned from, with which it is compared."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS


def fit_least_squares(table: pd.DataFrame, Y: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Return intercept and slopes of each coefficient (n, 6) by regressors (n, d), where it is observed."""
    fitted: dict[str, dict[str, float]] = {}
    for coefficient, y in zip(COEFFICIENTS, np.asarray(Y, dtype=float).T, strict=True):
        is_observed = np.isfinite(y)
        linear = LinearRegression().fit(table[is_observed], y[is_observed])
        slopes = dict(zip(map(str, table), linear.coef_.tolist(), strict=True))
        fitted[coefficient] = {"intercept": float(linear.intercept_), **slopes}
    return fitted


def linear_terms(fitted: Mapping[str, Mapping[str, float]]) -> tuple[Vector, Matrix]:
    """Return intercepts (6,) and slopes (d, 6) of `fit_least_squares`."""
    table = pd.DataFrame(fitted)[list(COEFFICIENTS)]
    return table.loc["intercept"].to_numpy(), table.drop("intercept").to_numpy()
