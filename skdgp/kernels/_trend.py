"""Trends: functions that are linear in weights with a Gaussian prior.

The weights are integrated out.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import joblib
import numpy as np
from sklearn.base import clone

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.kernels._base import FreeParameter, MultiOutputKernel, as_shape, or_default

BASIS_STEP = 1e-3  # step of numerical derivatives, in standard deviations of the regressor
SLOPE_BOUNDS = 0.05, 1e2
"""Bounds on ``slope_scale``, over the standard deviation of the output for one of the column.

With few rows the likelihood takes a weight for zero that is not, and bands become narrow. Of 60
rows in 40 regressors that all matter, 88 % of new values are inside 95 % bands from a least scale
of 0.001, 92 % from 0.05, at an error of 0.27 and 0.15 standard deviations. Where five matter, the
error of the trend is 0.07 and 0.11, and 85 % and 94 % are inside (0.03: 0.09 and 93 %, but 90 %
where all matter).
"""


def check_transformer(transformer: Any) -> None:
    """Raise a TypeError unless the object is an instance of a scikit-learn transformer."""
    methods = all(
        callable(getattr(transformer, name, None)) for name in ("fit", "transform", "get_params")
    )
    if isinstance(transformer, type) or not methods:
        raise TypeError(
            f"Got {transformer!r} for a trend, but expected an instance of a scikit-learn "
            f"transformer, such as "
            "PolynomialFeatures(2) or make_pipeline(StandardScaler(), SplineTransformer())."
        )


class FittedBasis:
    """A fitted transformer with K columns; clones of a kernel share it, since hyperparameters do not change it.

    It is a clone that is fitted to X (n, d). ``step`` (d,) is that of numerical slopes in each
    regressor.
    """

    def __init__(self, transformer: Any, X: Matrix) -> None:
        check_transformer(transformer)
        self.transformer = clone(transformer).fit(X)
        self.step = BASIS_STEP * column_scale(X)
        self.n_columns = as_columns(self.transformer.transform(X), len(X), self.transformer).shape[
            1
        ]

    def __sklearn_clone__(self):
        return self

    def __eq__(self, other):
        return isinstance(other, FittedBasis) and joblib.hash(self) == joblib.hash(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self):
        return repr(self.transformer)

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return len(self.step)

    def columns(self, X: Matrix) -> np.ndarray:
        """Return phi(X), (n, K)."""
        if len(X) == 0:
            return np.empty((0, self.n_columns))
        return as_columns(self.transformer.transform(X), len(X), self.transformer)

    def slopes(self, X: Matrix) -> np.ndarray:
        """Return d phi / dX, (d, n, K), by central differences, which are exact for polynomials up to degree four."""
        X = np.asarray(X, dtype=float)
        unit = np.diag(self.step)[:, None, :]
        points = np.stack([X + times * unit for times in (-2, -1, 1, 2)])  # (4, d, n, d)
        phi = self.columns(points.reshape(-1, X.shape[1])).reshape(
            *points.shape[:3], self.n_columns
        )
        return np.tensordot([1.0, -8.0, 8.0, -1.0], phi, axes=1) / (12 * self.step[:, None, None])


def as_columns(phi, n: int, transformer: Any) -> np.ndarray:
    """Return the output of a transformer as a finite (n, K) array."""
    phi = np.asarray(phi.toarray() if hasattr(phi, "toarray") else phi, dtype=float)
    if phi.ndim != 2 or len(phi) != n or phi.shape[1] == 0 or not np.isfinite(phi).all():
        raise ValueError(
            f"Got columns of shape {phi.shape} from {transformer!r} for {n} samples, but expected "
            f"finite ones, "
            f"({n}, K) with K > 0: choose a transformer whose columns are functions of the "
            f"regressors."
        )
    return phi


class Trend(MultiOutputKernel):
    """Base class of trends, with the covariance tau_i0^2 + sum_k tau_ik^2 (phi_k(s) - c_k)(phi_k(s') - c_k).

    A subclass defines phi by ``columns`` and ``column_slopes``. The parameters of all trends are
    ``intercept_scale`` (P,), ``slope_scale`` (P, K), ``center`` (K,) and bounds of the first two.
    """

    def __init__(
        self,
        intercept_scale: Any = None,
        slope_scale: Any = None,
        center: Any = None,
        *,
        intercept_scale_bounds: Any = None,
        slope_scale_bounds: Any = None,
    ) -> None:
        self.intercept_scale = intercept_scale
        self.slope_scale = slope_scale
        self.center = center
        self.intercept_scale_bounds = intercept_scale_bounds
        self.slope_scale_bounds = slope_scale_bounds

    @abstractmethod
    def columns(self, X: Matrix) -> np.ndarray:
        """Return phi(X), (n, K)."""

    @abstractmethod
    def column_slopes(self, X: Matrix) -> np.ndarray:
        """Return d phi / dX, (d, n, K), or (d, 1, K) if it is constant."""

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.value("slope_scale").shape[0]

    @property
    def n_processes(self) -> int:
        return 0

    @property
    def n_weights(self) -> int:
        """Number of weights of each output, K + 1."""
        return self.value("slope_scale").shape[1] + 1

    def value(self, name: str) -> Array:
        return self._cached("arrays", self._arrays)[name]

    def _arrays(self):
        if not self.has_values():
            raise ValueError(
                f"{type(self).__name__} has no values yet: give intercept_scale and slope_scale, "
                f"or let "
                "DependentGPRegressor.fit estimate them from the data."
            )
        slope = np.atleast_2d(np.asarray(self.slope_scale, dtype=float))
        intercept = as_shape("intercept_scale", np.ravel(self.intercept_scale), (len(slope),))
        center = np.zeros(1) if self.center is None else np.asarray(self.center, dtype=float)
        return {"slope_scale": slope, "intercept_scale": intercept, "center": center}

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
        ready = self.prepared(X)
        phi = ready.columns(X)
        P, K = Y.shape[1], phi.shape[1]
        # With many columns each weight starts smaller, so that the total variance is that of a
        # linear trend.
        unit = min(1.0, np.sqrt(X.shape[1] / K)) * column_scale(Y)[:, None] / column_scale(phi)
        intercept, slope = column_scale(Y), unit
        if singles:
            intercept = np.concatenate([s.value("intercept_scale") for s in singles])
            slope = np.concatenate([s.value("slope_scale") for s in singles])
        if coarse:
            intercept, slope = coarse.value("intercept_scale"), coarse.value("slope_scale")
        given = self.get_params()
        start = {
            "intercept_scale": intercept,
            "slope_scale": slope,
            "center": phi.mean(axis=0),
            "intercept_scale_bounds": np.multiply.outer(column_scale(Y), [1e-3, 1e2]),
            "slope_scale_bounds": np.multiply.outer(unit, SLOPE_BOUNDS),
        }
        params = {name: start[name] if given[name] is None else given[name] for name in start}
        for name, shape in (("intercept_scale", (P,)), ("slope_scale", (P, K)), ("center", (K,))):
            params[name] = as_shape(name, params[name], shape)
        return clone(ready).set_params(**params)

    def basis(self, i: int, X: Matrix) -> Matrix:
        """Return the basis (n, K + 1) that maps the standardised weights of output i to its trend at X."""
        columns = (self.columns(X) - self.value("center")) * self.value("slope_scale")[i]
        return np.column_stack([np.full(len(X), self.value("intercept_scale")[i]), columns])

    def basis_slopes(self, i: int, X: Matrix) -> Array:
        """Return dbasis / dX, (d, n, K + 1), or (d, 1, K + 1) if it is constant."""
        return np.pad(
            self.column_slopes(X) * self.value("slope_scale")[i], [(0, 0), (0, 0), (1, 0)]
        )

    def column_regressors(self) -> list[tuple[int, ...]]:
        """Return the regressors that each column of phi depends on; the default is all of them."""
        return [tuple(range(self.n_features))] * (self.n_weights - 1)

    def term_regressors(self) -> list[tuple[int, ...]]:
        return list(dict.fromkeys([(), *self.column_regressors()]))

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        kept = np.array([columns == regressors for columns in self.column_regressors()])
        intercept, slope = self.value("intercept_scale"), self.value("slope_scale")
        return clone(self).set_params(
            intercept_scale=intercept * (regressors == ()), slope_scale=slope * kept
        )

    def _by_weight(self, i, slopes):
        """Return d/dtheta from derivatives (K + 1,) by the logarithms of the scales of output i."""
        entries = np.zeros((self.n_outputs, self.n_weights))
        entries[i] = slopes
        return self.theta_gradient(
            {"intercept_scale": entries[:, 0], "slope_scale": entries[:, 1:]}
        )

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        phi = self.columns(X)
        basis = np.column_stack([np.ones(len(X)), (phi - phi.mean(axis=0)) / column_scale(phi)])
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

    def block_derivative(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Array:
        shape = (np.shape(Xi)[1], len(Xi), len(Xj))
        if i != j:
            return np.zeros(shape)
        return np.broadcast_to(self.basis_slopes(i, Xi) @ self.basis(i, Xj).T, shape)

    def derivative_times(self, i: int, j: int, Xi: Matrix, Xj: Matrix, w: Vector) -> Matrix:
        if i != j:
            return np.zeros(np.shape(Xi))
        return np.broadcast_to((self.basis_slopes(i, Xi) @ (w @ self.basis(i, Xj))).T, np.shape(Xi))

    def derivative_diag(self, i: int, Xi: Matrix) -> Matrix:
        return np.broadcast_to((self.basis_slopes(i, Xi) ** 2).sum(axis=2).T, np.shape(Xi))

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        if i != j:
            return np.zeros(self.n_dims)
        return self._by_weight(
            i, 2 * np.einsum("ak,ak->k", self.basis(i, Xi), W @ self.basis(i, Xj))
        )

    def free_parameters(self) -> list[FreeParameter]:
        return self._cached("free", self._free_parameters)

    def _free_parameters(self):
        bounds = {
            "intercept_scale": self.intercept_scale_bounds,
            "slope_scale": self.slope_scale_bounds,
        }
        index = {
            name: np.arange(self.value(name).size).reshape(self.value(name).shape)
            for name in bounds
        }
        return [
            FreeParameter(name, index[name], True, or_default(bounds[name], (1e-5, 1e5)))
            for name in bounds
        ]


class LinearTrend(Trend):
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
        from the data.
    center : array (d,) or None
        Point of the intercept. None: the mean of the data, or the origin without data.
    intercept_scale_bounds, slope_scale_bounds : pair of float, array (..., 2), "fixed" or None
        Bounds; None: from the data.

    Examples
    --------
    >>> from skdgp.kernels import LinearTrend
    >>> LinearTrend(intercept_scale=[1.0], slope_scale=[[2.0]], center=[0.0])([[0.0], [1.0]])
    array([[1., 1.],
           [1., 5.]])
    """

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self.n_weights - 1

    def columns(self, X: Matrix) -> Matrix:
        return np.asarray(X, dtype=float)

    def column_slopes(self, X: Matrix) -> Array:
        return np.eye(self.n_features)[:, None, :]

    def column_regressors(self) -> list[tuple[int, ...]]:
        return [(k,) for k in range(self.n_features)]

    def single_output(self) -> MultiOutputKernel:
        return LinearTrend()


class BasisTrend(Trend):
    r"""Covariance of one function for each output that is linear in the columns of a scikit-learn transformer.

    .. math:: K_{ij}(s, s') = \delta_{ij} \left( \tau_{i0}^2
              + \sum_k \tau_{ik}^2 (\varphi_k(s) - c_k)(\varphi_k(s') - c_k) \right)

    The trend of output i is :math:`w_{i0} + \sum_k w_{ik} (\varphi_k(s) - c_k)` with weights
    :math:`w_{ik} \sim N(0, \tau_{ik}^2)`, which are integrated out (Rasmussen & Williams 2006,
    equations 2.37 to 2.42). ``LinearTrend`` is the case :math:`\varphi(s) = s`. Slopes are central
    differences of fourth order.

    Parameters
    ----------
    transformer : scikit-learn transformer
        phi: ``PolynomialFeatures(2)``, ``SplineTransformer()`` or a pipeline. ``initialize`` fits a
        clone of it to X, an array without column names. A constant column has no effect, since the
        intercept is a separate term.
    intercept_scale, slope_scale, center, intercept_scale_bounds, slope_scale_bounds
        As of :class:`LinearTrend`, of the K columns in place of the regressors; the total variance
        from the data is that of a linear trend.

    Raises
    ------
    TypeError
        By ``initialize``, if ``transformer`` is not a transformer.
    ValueError
        If its columns are not finite, or their number of rows is not the number of samples.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.preprocessing import PolynomialFeatures
    >>> from skdgp.kernels import BasisTrend
    >>> square = BasisTrend(PolynomialFeatures(2, include_bias=False), [0.0], [[0.0, 1.0]], [0.0, 0.0])
    >>> X = np.array([[1.0], [2.0]])
    >>> square.initialize(X, X, 0)(X)
    array([[ 1.,  4.],
           [ 4., 16.]])
    """

    def __init__(
        self,
        transformer: Any,
        intercept_scale: Any = None,
        slope_scale: Any = None,
        center: Any = None,
        *,
        intercept_scale_bounds: Any = None,
        slope_scale_bounds: Any = None,
    ) -> None:
        bounds = {
            "intercept_scale_bounds": intercept_scale_bounds,
            "slope_scale_bounds": slope_scale_bounds,
        }
        super().__init__(intercept_scale, slope_scale, center, **bounds)
        self.transformer = transformer

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self._basis().n_features

    def _basis(self) -> FittedBasis:
        if isinstance(self.transformer, FittedBasis):
            return self.transformer
        check_transformer(self.transformer)
        raise ValueError(
            f"The transformer of {self!r} is not fitted yet: call initialize(X, Y, random_state), "
            f"or let "
            "DependentGPRegressor.fit do it."
        )

    def columns(self, X: Matrix) -> Matrix:
        return self._basis().columns(X)

    def column_slopes(self, X: Matrix) -> Array:
        return self._basis().slopes(X)

    def prepared(self, X: Matrix) -> MultiOutputKernel:
        if isinstance(self.transformer, FittedBasis):
            return self
        return clone(self).set_params(transformer=FittedBasis(self.transformer, X))

    def single_output(self) -> MultiOutputKernel:
        return BasisTrend(self.transformer)
