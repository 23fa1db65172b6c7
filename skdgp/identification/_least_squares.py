"""Linear models by least squares of the rows that a model is learned from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression

from skdgp._compute.linalg import least_squares
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


class RegressionCalibration(NamedTuple):
    r"""Linear function that turns a function into the mean coefficients of logged rows.

    Regressors of a logged row are estimates. The mean of y, given an estimate x, is not the
    function f(x) (regression calibration: Carroll et al. 2006, chapter 4). With A and b by least
    squares of the residuals of the training rows, it is

    .. math:: \mathrm{E}[y \mid x] = f(x) + \rho \, (b + A^T x),

    where :math:`\rho` is the variance of the noise of the regressors over its value in the training
    flights, at most one: more noise than that was never compared.
    """

    intercept: Vector  # (P,)
    slopes: Matrix  # (d, P)

    @classmethod
    def of_residuals(cls, X: Matrix, residuals: Matrix) -> RegressionCalibration:
        """Return the calibration by the residuals (n, P) at X (n, d), NaN where unknown."""
        design = np.column_stack([np.ones(len(X)), X])
        coefficients = np.array([least_squares(design, residual) for residual in residuals.T])
        return cls(coefficients[:, 0], coefficients[:, 1:].T)

    def __call__(self, X: Matrix, noise_ratio: Vector) -> Matrix:
        """Return what is added to the function (n, P), at ratios (n,) of the variance of noise."""
        fraction = np.minimum(noise_ratio, 1.0)
        return fraction[:, None] * (self.intercept + X @ self.slopes)
