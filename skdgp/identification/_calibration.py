"""Mean coefficients of logged rows, whose regressors are estimates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import least_squares
from skdgp._compute.typing import Matrix, Vector


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
    def of_residuals(
        cls, X: Matrix, residuals: Matrix, without_effect: Matrix | None = None
    ) -> RegressionCalibration:
        """Return the calibration by the residuals (n, P) at X (n, d), NaN where unknown.

        Regressors ``without_effect`` (P, d) get no slope.
        """
        P, d = residuals.shape[1], X.shape[1]
        design = np.column_stack([np.ones(len(X)), X])
        used = np.ones((P, 1 + d), dtype=bool)
        if without_effect is not None:
            used[:, 1:] = np.logical_not(without_effect)
        coefficients = np.zeros((P, 1 + d))
        for residual, columns, weights in zip(residuals.T, used, coefficients, strict=True):
            weights[columns] = least_squares(design[:, columns], residual)
        return cls(coefficients[:, 0], coefficients[:, 1:].T)

    def __call__(self, X: Matrix, noise_ratio: Vector) -> Matrix:
        """Return what is added to the function (n, P), at ratios (n,) of the variance of noise."""
        fraction = np.minimum(noise_ratio, 1.0)
        return fraction[:, None] * (self.intercept + X @ self.slopes)
