"""The linear trend: weights with a Gaussian prior, which are integrated out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.linear_model import BayesianRidge

from skdgp._compute.linalg import column_scale, constant_columns
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.kernels._base import (
    FreeParameter,
    FrozenBounds,
    MultiOutputKernel,
    as_shape,
    complete_bounds,
    frozen,
    given_bounds,
    hyperparameter,
    rescaled_values,
)

# Bounds on ``slope_scale``, in standard deviations of the output for one of the regressor (trials)
SLOPE_BOUNDS = 0.05, 1e2
# Lower bound of few rows n: FEW_ROWS / n, at most LARGEST_BOUND. A smaller prior scale makes slopes
# that are not significant too certain there (benchmark ``coverage``).
FEW_ROWS, LARGEST_BOUND = 6.0, 0.3

OUTPUT_AXES = {"intercept_scale": -1, "slope_scale": -2}  # axis of the outputs of each parameter


class LinearTrend(MultiOutputKernel):
    r"""Covariance of one linear function for each output, with a Gaussian prior on its weights.

    .. math:: K_{ij}(s, s') = \delta_{ij} \left( \tau_{i0}^2
              + \sum_k \tau_{ik}^2 (s_k - c_k)(s'_k - c_k) \right)

    which is equation 2.41 of Rasmussen & Williams (2006) with a diagonal prior on the weights. The
    weights are integrated out, so mean, variance and likelihood include the uncertainty of the
    trend.

    Parameters
    ----------
    intercept_scale : array (P,) or None
        Prior standard deviation of the intercept, in the unit of the output. None: from the data.
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

    hyperparameter_intercept_scale = hyperparameter("intercept_scale")
    hyperparameter_slope_scale = hyperparameter("slope_scale")

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        factor = np.asarray(factor, dtype=float)
        values = {
            name: rescaled_values(name, getattr(self, name), factor, axis)
            for name, axis in OUTPUT_AXES.items()
        }
        bounds = given_bounds(self, OUTPUT_AXES)
        for name in OUTPUT_AXES.keys() & bounds.keys():
            axis = OUTPUT_AXES[name] - 1  # the last axis of bounds is the pair
            bounds[name] = rescaled_values(f"bounds of {name}", bounds[name], factor, axis)
        return clone(self).set_params(**values, parameter_bounds=bounds or None)

    def bounds_from_data(self, name: str) -> bool:
        return name not in given_bounds(self, OUTPUT_AXES)

    def value(self, name: str) -> Array:
        return self._cached("arrays", self._arrays)[name]

    def _arrays(self):
        if not self.has_values():
            raise ValueError(
                f"{type(self).__name__} has no values yet: give intercept_scale and slope_scale, "
                f"or let "
                "DependentGPRegressor.fit estimate them from the data."
            )
        slope = np.atleast_2d(np.array(self.slope_scale, dtype=float))
        intercept = as_shape("intercept_scale", np.ravel(self.intercept_scale), (len(slope),))
        center = np.zeros(1) if self.center is None else np.array(self.center, dtype=float)
        arrays = {"slope_scale": slope, "intercept_scale": intercept, "center": center}
        return {name: frozen(array) for name, array in arrays.items()}

    def has_values(self) -> bool:
        return self.intercept_scale is not None and self.slope_scale is not None

    def initialize(
        self,
        X: Matrix,
        Y: Matrix,
        random_state: Seed,
        singles: Sequence | None = None,
        coarse: MultiOutputKernel | None = None,
        width_factor: float = 1.0,
    ) -> MultiOutputKernel:
        P, d = Y.shape[1], X.shape[1]
        unit = column_scale(Y)[:, None] / column_scale(X)
        intercept, slope = column_scale(Y), unit
        if singles:
            intercept = np.concatenate([s.value("intercept_scale") for s in singles])
            slope = np.concatenate([s.value("slope_scale") for s in singles])
        if coarse:
            intercept, slope = coarse.value("intercept_scale"), coarse.value("slope_scale")
        n = np.isfinite(Y).sum(axis=0).max()
        least = max(SLOPE_BOUNDS[0], min(FEW_ROWS / n, LARGEST_BOUND))
        slope = np.maximum(slope, least * unit)
        given = self.get_params()
        start = {
            "intercept_scale": intercept,
            "slope_scale": slope,
            "center": np.mean(X, axis=0),
        }
        bounds: dict[str, Any] = {
            "intercept_scale": np.multiply.outer(column_scale(Y), [1e-3, 1e2]),
            "slope_scale": np.multiply.outer(unit, (least, SLOPE_BOUNDS[1])),
        }
        if d > len(X):  # too few rows for a scale of each slope: one for all, by ridge regression
            start["slope_scale"] = ridge_scale(X, Y)[:, None] / column_scale(X)
            bounds["slope_scale"] = "fixed"
        params = {name: start[name] if given[name] is None else given[name] for name in start}
        for name, shape in (("intercept_scale", (P,)), ("slope_scale", (P, d)), ("center", (d,))):
            params[name] = frozen(as_shape(name, params[name], shape))
        params["parameter_bounds"] = FrozenBounds(complete_bounds(self.parameter_bounds, bounds))
        return clone(self).set_params(**params)

    def basis(self, i: int, X: Matrix) -> Matrix:
        """Return the basis (n, d + 1) that maps the standardised weights of output i to its trend at X."""
        columns = (X - self.value("center")) * self.value("slope_scale")[i]
        return np.column_stack([np.full(len(X), self.value("intercept_scale")[i]), columns])

    def basis_slopes(self, i: int) -> Array:
        """Return dbasis / dX, (d, 1, d + 1), which is constant."""
        return np.pad(np.diag(self.value("slope_scale")[i]), [(0, 0), (1, 0)])[:, None]

    def term_regressors(self) -> list[tuple[int, ...]]:
        return [(), *((k,) for k in range(self.n_features))]

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        kept = np.array([(k,) == regressors for k in range(self.n_features)])
        intercept, slope = self.value("intercept_scale"), self.value("slope_scale")
        return clone(self).set_params(
            intercept_scale=intercept * (regressors == ()), slope_scale=slope * kept
        )

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        slopes = ((X - X.mean(axis=0)) / column_scale(X))[:, ~constant_columns(X)]
        basis = np.column_stack([np.ones(len(X)), slopes])
        residual = np.array(Y, dtype=float)
        for y in residual.T:
            rows = np.isfinite(y)
            if rows.sum() > 2 * basis.shape[1]:
                y[rows] -= basis[rows] @ np.linalg.lstsq(basis[rows], y[rows], rcond=None)[0]
        return residual

    def couples(self, i: int, j: int) -> bool:
        return i == j

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        if i != j:
            return np.zeros((len(Xi), len(Xj)))
        return self.basis(i, Xi) @ self.basis(i, Xj).T

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return (self.basis(i, Xi) ** 2).sum(axis=1)

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        if i != j:
            return np.zeros(self.n_dims)
        entries = np.zeros((self.n_outputs, 1 + self.n_features))  # by the logarithms of the scales
        entries[i] = 2 * np.einsum("ak,ak->k", self.basis(i, Xi), W @ self.basis(i, Xj))
        return self.theta_gradient(
            {"intercept_scale": entries[:, 0], "slope_scale": entries[:, 1:]}
        )

    def free_parameters(self) -> list[FreeParameter]:
        return self._cached("free", self._free_parameters)

    def _free_parameters(self):
        bounds = complete_bounds(
            self.parameter_bounds, {"intercept_scale": (1e-5, 1e5), "slope_scale": (1e-5, 1e5)}
        )
        values = {name: self.value(name) for name in bounds}
        return [
            FreeParameter(name, np.arange(v.size).reshape(v.shape), True, bounds[name])
            for name, v in values.items()
        ]

    def single_output(self) -> MultiOutputKernel:
        return LinearTrend()


def ridge_scale(X: Matrix, Y: Matrix) -> Vector:
    """Return the standard deviation of the slopes (P,) by which Bayesian ridge regression has most evidence.

    The slopes are of the regressors over their standard deviations. X (n, d), Y (n, P) with NaN.
    """
    inputs = (X - X.mean(axis=0)) / column_scale(X)
    rows = np.isfinite(Y)
    fits = [
        BayesianRidge().fit(inputs[known], y[known]) for y, known in zip(Y.T, rows.T, strict=True)
    ]
    return np.array([1.0 / np.sqrt(fit.lambda_) for fit in fits])
