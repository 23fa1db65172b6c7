"""A linear trend in every output, its weights integrated out."""

from __future__ import annotations

import numpy as np

from skdgp._linalg import column_scale
from skdgp.kernels._base import Free, MultiOutputKernel, as_shape, or_default
from skdgp.kernels._features import TrendFeatures


class LinearTrend(MultiOutputKernel):
    r"""Covariance of one linear function per output whose weights have a Gaussian prior.

    .. math:: K_{ij}(s, s') = \delta_{ij} \Big( \tau_{i0}^2
              + \sum_k \tau_{ik}^2 (s_k - c_k)(s'_k - c_k) \Big)

    which is equation 2.41 of Rasmussen & Williams (2006) with a diagonal prior on the weights: mean, variance
    and likelihood then carry the uncertainty of the trend, and nothing is fitted beforehand.

    Parameters
    ----------
    intercept_scale : array (P,) or None
        Prior standard deviation of the intercept, in the unit of the output. None: from the data.
    slope_scale : array (P, d) or None
        Prior standard deviation of the slopes, unit of the output per unit of the regressor. None: from the
        data.
    center : array (d,) or None
        Where the intercept is. None: the mean of the data it is initialized with, else the origin.
    intercept_scale_bounds, slope_scale_bounds : pair of float, array (..., 2), "fixed" or None
        Bounds; None: from the data.

    Examples
    --------
    >>> from skdgp.kernels import LinearTrend
    >>> LinearTrend(intercept_scale=[1.0], slope_scale=[[2.0]], center=[0.0])([[0.0], [1.0]])
    array([[1., 1.],
           [1., 5.]])
    """

    def __init__(
        self,
        intercept_scale=None,
        slope_scale=None,
        center=None,
        *,
        intercept_scale_bounds=None,
        slope_scale_bounds=None,
    ):
        self.intercept_scale = intercept_scale
        self.slope_scale = slope_scale
        self.center = center
        self.intercept_scale_bounds = intercept_scale_bounds
        self.slope_scale_bounds = slope_scale_bounds

    @property
    def n_outputs(self):
        """Number of outputs P."""
        return self._value("slope_scale").shape[0]

    @property
    def n_features(self):
        """Number of regressors d."""
        return self._value("slope_scale").shape[1]

    def _value(self, name):
        if name == "center":
            return np.zeros(1) if self.center is None else np.asarray(self.center, dtype=float)
        if not self.is_given():
            raise ValueError(
                "LinearTrend has no values yet: give intercept_scale and slope_scale, or let DependentGPRegressor.fit "
                "take them from the data."
            )
        slope = np.atleast_2d(np.asarray(self.slope_scale, dtype=float))
        return slope if name == "slope_scale" else as_shape(name, np.ravel(self.intercept_scale), (len(slope),))

    def is_given(self):
        return self.intercept_scale is not None and self.slope_scale is not None

    def initialize(self, X, Y, random_state, singles=None, coarse=None, stretch=1.0):
        P, d = Y.shape[1], X.shape[1]
        unit = column_scale(Y)[:, None] / column_scale(X)
        intercept, slope = column_scale(Y), unit
        if singles:
            intercept = np.concatenate([s._value("intercept_scale") for s in singles])
            slope = np.concatenate([s._value("slope_scale") for s in singles])
        if coarse:
            intercept, slope = coarse._value("intercept_scale"), coarse._value("slope_scale")
        given = self.get_params()
        start = {
            "intercept_scale": intercept,
            "slope_scale": slope,
            "center": X.mean(axis=0),
            "intercept_scale_bounds": np.multiply.outer(column_scale(Y), [1e-3, 1e2]),
            "slope_scale_bounds": np.multiply.outer(unit, [1e-3, 1e2]),
        }
        params = {name: start[name] if given[name] is None else given[name] for name in start}
        for name, shape in (("intercept_scale", (P,)), ("slope_scale", (P, d)), ("center", (d,))):
            params[name] = as_shape(name, params[name], shape)
        return LinearTrend(**params)

    def basis(self, i, X):
        """Return (n, d + 1): output i's standardised weights -> its trend at X."""
        return np.column_stack([np.full(len(X), self._scales(i)[0]), self._weighted(i, X)])

    def basis_derivative(self, i, X):
        """Return dbasis / dX, (d, n, d + 1)."""
        n, d = np.shape(X)
        slopes = np.column_stack([np.zeros(d), np.diag(self._scales(i)[1])])
        return np.broadcast_to(slopes[:, None, :], (d, n, d + 1))

    def basis_gradient(self, i, X, W):
        """Return sum(W * dbasis / dtheta), (n_theta,)."""
        by_column = (W * self.basis(i, X)).sum(axis=0)
        return self._by_entry(i, by_column[0], by_column[1:])

    def diag_gradient(self, i, Xi, w):
        return self._by_entry(i, 2 * w.sum() * self._scales(i)[0] ** 2, 2 * w @ self._weighted(i, Xi) ** 2)

    def features(self, Z):
        return TrendFeatures(self)

    def feature_ranking(self, X, scale, random_state):
        return lambda n: TrendFeatures(self)

    def _by_entry(self, i, by_intercept, by_slope):
        intercept, slope = np.zeros(self.n_outputs), np.zeros((self.n_outputs, self.n_features))
        intercept[i], slope[i] = by_intercept, by_slope
        return self.pull_back({"intercept_scale": intercept, "slope_scale": slope})

    def peaks(self, i, j, d):
        return np.zeros((0, d))

    def coarse(self):
        return self

    def single(self):
        return LinearTrend()

    def stationary_part(self):
        return None

    def unexplained(self, X, Y):
        basis = np.column_stack([np.ones(len(X)), X])
        residual = np.array(Y, dtype=float)
        for y in residual.T:
            seen = np.isfinite(y)
            if seen.sum() > 2 * basis.shape[1]:
                y[seen] -= basis[seen] @ np.linalg.lstsq(basis[seen], y[seen], rcond=None)[0]
        return residual

    def _scales(self, i):
        return self._value("intercept_scale")[i], self._value("slope_scale")[i]

    def _weighted(self, i, X):
        return (np.asarray(X, dtype=float) - self._value("center")) * self._scales(i)[1]

    def couples(self, i, j):
        return i == j

    def block(self, i, j, Xi, Xj):
        if i != j:
            return np.zeros((len(Xi), len(Xj)))
        return self._weighted(i, Xi) @ self._weighted(i, Xj).T + self._scales(i)[0] ** 2

    def block_diag(self, i, Xi):
        return (self._weighted(i, Xi) ** 2).sum(axis=1) + self._scales(i)[0] ** 2

    def block_derivative(self, i, j, Xi, Xj):
        d = np.shape(Xi)[1]
        if i != j:
            return np.zeros((d, len(Xi), len(Xj)))
        slopes = (self._weighted(i, Xj) * self._scales(i)[1]).T
        return np.broadcast_to(slopes[:, None, :], (d, len(Xi), len(Xj)))

    def derivative_diag(self, i, Xi):
        return np.broadcast_to(self._scales(i)[1] ** 2, np.shape(Xi))

    def block_gradient(self, i, j, Xi, Xj, W):
        if i != j:
            return np.zeros(self.n_dims)
        by_slope = np.einsum("ak,ak->k", self._weighted(i, Xi), W @ self._weighted(i, Xj))
        return self._by_entry(i, 2 * W.sum() * self._scales(i)[0] ** 2, 2 * by_slope)

    def _free(self):
        P, d = self.n_outputs, self.n_features
        intercept, slope = np.arange(P), np.arange(P * d).reshape(P, d)
        return [
            Free("intercept_scale", intercept, True, or_default(self.intercept_scale_bounds, (1e-5, 1e5))),
            Free("slope_scale", slope, True, or_default(self.slope_scale_bounds, (1e-5, 1e5))),
        ]
