"""The linear trend: weights with a Gaussian prior, which are integrated out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from sklearn.linear_model import BayesianRidge

from skdgp._compute.linalg import column_scale, constant_columns, least_squares
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.kernels._base import (
    EstimatedKernel,
    EvaluatedBlock,
    FreeParameter,
    InputPair,
    MultiOutputKernel,
    add_at,
    as_shape,
)


@dataclass(frozen=True)
class TrendSettings:
    """Bounds of the prior standard deviations of slopes that are estimated from data.

    Slopes are in standard deviations of the output for one of the regressor.
    """

    #: Bounds of slopes by many regressors (trials)
    slope_bounds: tuple[float, float] = (0.05, 1e2)
    #: The lower bound of slopes is this number over n for few rows n: a smaller one makes slopes
    #: that are not significant too certain (benchmark ``bands``)
    few_rows: float = 6.0
    #: Largest lower bound of few rows
    largest_bound: float = 0.3
    #: The lower bound by d regressors is d to this power: only of many do most not matter, and a
    #: slope that is nearly certain to be zero makes bands beyond the data too narrow
    few_regressors: float = -2.0

    def least_slope(self, n_rows: int, n_regressors: int) -> float:
        """Return the lower bound of slopes by so many regressors that are learned from so many rows."""
        of_few_rows = min(self.few_rows / n_rows, self.largest_bound)
        of_few_regressors = float(max(1, n_regressors)) ** self.few_regressors
        return max(self.slope_bounds[0], of_few_rows, of_few_regressors)


SETTINGS = TrendSettings()


class LinearTrend(EstimatedKernel):
    r"""Covariance of one linear function for each output, with a Gaussian prior on its weights.

    .. math:: K_{ij}(s, s') = \delta_{ij} \left( \tau_{i0}^2
              + \sum_k \tau_{ik}^2 (s_k - c_k)(s'_k - c_k) \right)

    which is equation 2.41 of Rasmussen & Williams (2006) with a diagonal prior on the weights. The
    weights are integrated out, so mean, variance and likelihood include the uncertainty of the
    trend.

    Parameters
    ----------
    intercept_scale : array (P,) or None
        Prior standard deviation of the intercept, in the unit of the output. None: the output's
        standard deviation, which keeps its value.
    slope_scale : array (P, d) or None
        Prior standard deviation of the slopes, unit of the output per unit of the regressor. None:
        from the data; with more regressors than rows one for all slopes of an output, in standard
        deviations of the regressors, which keeps its value.
    center : array (d,) or None
        Point of the intercept. None: the mean of the data, or the origin without data.
    parameter_bounds : mapping or None
        Bounds by the names ``"intercept_scale"`` and ``"slope_scale"``: a pair, an array (..., 2),
        or "fixed". Others: from the data.

    Examples
    --------
    >>> from skdgp.kernels import LinearTrend
    >>> LinearTrend(intercept_scale=[1.0], slope_scale=[[2.0]], center=[0.0])([[0.0], [1.0]])
    array([[1., 1.],
           [1., 5.]])
    """

    needed = ("intercept_scale", "slope_scale")
    default_bounds = {"intercept_scale": (1e-5, 1e5), "slope_scale": (1e-5, 1e5)}
    output_axes = {"intercept_scale": -1, "slope_scale": -2}

    def __init__(
        self,
        intercept_scale: Any = None,
        slope_scale: Any = None,
        center: Any = None,
        *,
        parameter_bounds: Mapping[str, Any] | None = None,
    ) -> None:
        self.intercept_scale = intercept_scale
        self.slope_scale = slope_scale
        self.center = center
        self.parameter_bounds = parameter_bounds

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.value("slope_scale").shape[0]

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self.value("slope_scale").shape[1]

    @property
    def n_processes(self) -> int:
        return 0

    def values(self) -> dict[str, Array]:
        self._check_values()
        slope = np.atleast_2d(np.array(self.slope_scale, dtype=float))
        intercept = as_shape("intercept_scale", np.ravel(self.intercept_scale), (len(slope),))
        center = np.zeros(1) if self.center is None else np.array(self.center, dtype=float)
        return {"slope_scale": slope, "intercept_scale": intercept, "center": center}

    def initialize(self, X: Matrix, Y: Matrix, random_state: Seed) -> MultiOutputKernel:
        y_scale = column_scale(Y)
        x_scale = column_scale(X)
        unit = y_scale[:, None] / x_scale
        n_rows = np.isfinite(Y).sum(axis=0).max()
        least = SETTINGS.least_slope(n_rows, int(np.sum(~constant_columns(X))))
        slope = unit
        bounds: Any = np.multiply.outer(unit, (least, SETTINGS.slope_bounds[1]))
        if len(x_scale) > len(X):  # too few rows for a scale of each slope: one for all
            slope = ridge_scale(X, Y)[:, None] / x_scale
            bounds = "fixed"
        values = {"intercept_scale": y_scale, "slope_scale": slope, "center": X.mean(axis=0)}
        # learned from centred outputs the intercept's scale would vanish
        return self._completed(values, {"intercept_scale": "fixed", "slope_scale": bounds})

    def basis(self, i: int, X: Matrix) -> Matrix:
        """Return the basis (n, d + 1) that maps the standardised weights of output i to its trend at X."""
        return _basis(self.values(), i, X)

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        slopes = ((X - X.mean(axis=0)) / column_scale(X))[:, ~constant_columns(X)]
        basis = np.column_stack([np.ones(len(X)), slopes])
        residual = np.array(Y, dtype=float)
        for y in residual.T:
            rows = np.isfinite(y)
            if rows.sum() > 2 * basis.shape[1]:
                y[rows] -= basis[rows] @ least_squares(basis, y)
        return residual

    def couples(self, i: int, j: int) -> bool:
        return i == j

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        if i != j:
            return np.zeros((len(Xi), len(Xj)))
        return self.basis(i, Xi) @ self.basis(i, Xj).T

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return (self.basis(i, Xi) ** 2).sum(axis=1)

    def evaluate(self, pairs: Sequence[InputPair]) -> Sequence[EvaluatedBlock]:
        values = self.values()
        of_parameters = self.theta_places()
        places = np.column_stack(list(of_parameters.values()))
        evaluated = []
        for i, j, Xi, Xj in pairs:
            first, second = _basis(values, i, Xi), _basis(values, j, Xj)
            evaluated.append(_EvaluatedTrend(first * (i == j), second, places[i]))
        return evaluated

    def free_parameters(self) -> list[FreeParameter]:
        values = self.values()
        parameters = []
        for name, bounds in self.bounds_by_name().items():
            index = np.arange(values[name].size).reshape(values[name].shape)
            parameters.append(FreeParameter(name, index, True, bounds))
        return parameters


class _EvaluatedTrend(NamedTuple):
    """`EvaluatedBlock` of a `LinearTrend`; the derivative by log tau_k is 2 phi_k phi_k^T of basis function k."""

    first: Matrix
    second: Matrix
    places: Indices

    def covariance(self) -> Matrix:
        return self.first @ self.second.T

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        by_log = 2 * np.einsum("ak,ak->k", self.first, W @ self.second)
        add_at(total[None], self.places, by_log[None])

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        first, second = self[1::-1] if transposed else self[:2]
        add_at(total, self.places, 2 * first * (second.T @ beta))


def _basis(values, i, X):
    """Return the basis of output i at X, from the values of the parameters."""
    constant = np.full(len(X), values["intercept_scale"][i])
    linear = (X - values["center"]) * values["slope_scale"][i]
    return np.column_stack([constant, linear])


def ridge_scale(X: Matrix, Y: Matrix) -> Vector:
    """Return the standard deviation of the slopes (P,) at the largest evidence of ridge regression.

    The slopes are of the regressors over their standard deviations. X (n, d), Y (n, P) with NaN.
    """
    inputs = X / column_scale(X)
    scales = []
    for y in Y.T:
        rows = np.isfinite(y)
        fit = BayesianRidge().fit(inputs[rows], y[rows])
        scales.append(1.0 / np.sqrt(fit.lambda_))
    return np.array(scales)
