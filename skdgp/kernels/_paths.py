"""Functions of the regressors with random coefficients, of which posterior samples are sums."""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import pairwise, product

import numpy as np

from skdgp.kernels._rows import ExponentialRows

CHUNK_BYTES = 2**25  # working memory of an evaluation
TILE = 512  # values whose covariances with points are made at a time


class PathBundle(ABC):
    """S functions of the regressors with P values, evaluated together.

    Inputs are (S, n, d), the points of each, or (1, n, d), the same points for all.
    """

    @abstractmethod
    def each(self, X) -> np.ndarray:
        """Return the values of all outputs, (S, n, P)."""

    @abstractmethod
    def gradient(self, X) -> np.ndarray:
        """Return their slopes, (S, n, P, d)."""

    @abstractmethod
    def take(self, some: slice) -> PathBundle:
        """Return some of the functions."""

    @abstractmethod
    def doubles(self, alike: bool) -> int:
        """Return how many doubles values at one point take meanwhile, or at one of each, unless they are ``alike``."""

    def __add__(self, other) -> SumPaths:
        return SumPaths(self, other)

    def values(self, X) -> np.ndarray:
        """Return ``each`` of many points, some at a time."""
        return _in_chunks(self.each, X, self.doubles(len(X) == 1))

    def slopes(self, X) -> np.ndarray:
        """Return ``gradient`` of many points, some at a time."""
        return _in_chunks(self.gradient, X, X.shape[-1] * self.doubles(len(X) == 1))


def _in_chunks(function, X, doubles):
    """Return a function of X (S, n, d) along its second axis, of which each n takes so many doubles meanwhile."""
    step = max(1, CHUNK_BYTES // max(1, 8 * doubles))
    if X.shape[1] <= step:
        return function(X)
    return np.concatenate([function(X[:, a : a + step]) for a in range(0, X.shape[1], step)], axis=1)


class SumPaths(PathBundle):
    """Sums of the paths of independent processes."""

    def __init__(self, first: PathBundle, second: PathBundle):
        self.first, self.second = first, second

    def take(self, some):
        return SumPaths(self.first.take(some), self.second.take(some))

    def doubles(self, alike):
        return max(self.first.doubles(alike), self.second.doubles(alike))

    def each(self, X):
        values = self.first.each(X)
        values += self.second.each(X)
        return values

    def gradient(self, X):
        return self.first.gradient(X) + self.second.gradient(X)


class TrendPaths(PathBundle):
    """Trends with weights: tau_i0 u_i0 + sum_k tau_ik u_ik (phi_k(s) - c_k).

    Parameters
    ----------
    kernel : Trend
    weights : ndarray (S, P, K + 1)
        Standardised, u.
    """

    def __init__(self, kernel, weights):
        self.kernel, self.weights = kernel, weights
        self._center = kernel._value("center")
        self._intercept = weights[:, None, :, 0] * kernel._value("intercept_scale")
        self._slope = (weights[:, :, 1:] * kernel._value("slope_scale")).swapaxes(1, 2).copy()

    def take(self, some):
        return TrendPaths(self.kernel, self.weights[some])

    def doubles(self, alike):
        return self.weights[:1].size if alike else self.weights.size

    def each(self, X):
        columns = self.kernel.columns(_rows_of(X)) - self._center
        values = _over_points(columns, X) @ self._slope
        values += self._intercept
        return values

    def gradient(self, X):
        slopes = self.kernel.column_slopes(_rows_of(X))  # (d, S n, K), or the same everywhere
        slopes = np.broadcast_to(slopes, (len(slopes), X.shape[0] * X.shape[1], slopes.shape[2]))
        return np.moveaxis(_over_points(slopes, X) @ self._slope, 0, -1)


class FeaturePaths(PathBundle):
    """Covariances with inducing variables, Kfu, times coefficients (S, K)."""

    def __init__(self, features, n_outputs, coefficients):
        self.features, self.coefficients = features, coefficients
        self._rows, columns = features.rows(), [features.columns(i) for i in range(n_outputs)]
        self._own = [slice(a, b) for a, b in pairwise(np.cumsum([0, *map(len, columns)]))]
        self._weights = [np.ascontiguousarray(coefficients[:, c]) for c in columns]

    def take(self, some):
        return FeaturePaths(self.features, len(self._own), self.coefficients[some])

    def doubles(self, alike):
        return (1 if alike else len(self.coefficients)) * self._own[-1].stop

    def each(self, X):
        A = _over_points(self._rows(_rows_of(X)), X)
        values = [contract(A[..., own], c) for own, c in zip(self._own, self._weights, strict=True)]
        return np.stack(values, axis=-1)

    def gradient(self, X):
        slopes = []
        for i, c in enumerate(self._weights):
            D = _over_points(self.features.Kfu_derivative(i, _rows_of(X)), X)
            slopes.append(np.moveaxis(contract(D, c), 0, -1))
        return np.stack(slopes, axis=2)


class KernelPaths(PathBundle):
    """Covariances with values of the outputs, times coefficients: sum_j cov(y, y_j(X_j)) c_j.

    ``X`` is a list of one (n_j, d) array for each output, ``coefficients`` of (S, n_j).
    """

    def __init__(self, kernel, X, coefficients):
        self.kernel, self.X, self.coefficients = kernel, X, coefficients

    def take(self, some):
        return KernelPaths(self.kernel, self.X, [c[some] for c in self.coefficients])

    def doubles(self, alike):
        return (1 if alike else len(self.coefficients[0])) * TILE

    def each(self, X):
        return self._summed(self.kernel.block, X, ())

    def gradient(self, X):
        return self._summed(self.kernel.block_derivative, X, X.shape[-1:])

    def _summed(self, block, X, slopes):
        P, points = self.kernel.n_outputs, _rows_of(X)
        values = np.zeros((*slopes, P, len(self.coefficients[0]), X.shape[1]))
        for i, j in product(range(P), repeat=2):
            if self.kernel.couples(i, j):
                for a in range(0, len(self.X[j]), TILE):
                    some = slice(a, a + TILE)
                    A = _over_points(block(i, j, points, self.X[j][some]), X)
                    values[..., i, :, :] += contract(A, self.coefficients[j][:, some])
        return values.T.swapaxes(0, 1)


class ValuePaths(PathBundle):
    """The same as ``KernelPaths``, of a convolved Gaussian: for few points one product and one exponential."""

    def __init__(self, kernel, X, coefficients):
        self.general = KernelPaths(kernel, X, coefficients)
        outputs = range(kernel.n_outputs)
        felt = [[j for j in outputs if kernel.couples(i, j)] for i in outputs]
        self._rows = ExponentialRows(kernel, [[(j, X[j]) for j in own] for i, own in enumerate(felt)])
        self._own = [slice(a, b) for a, b in pairwise(np.cumsum([0, *self._rows.sizes]))]
        nothing = np.empty((len(coefficients[0]), 0))
        self._weights = [
            np.hstack([nothing, *(np.tile(coefficients[j], len(kernel._pair(i, j)[1])) for j in own)])
            for i, own in enumerate(felt)
        ]

    def __reduce__(self):
        # The weights of all latents are made again from the coefficients, which are a fraction of them.
        return ValuePaths, (self.general.kernel, self.general.X, self.general.coefficients)

    def take(self, some):
        general = self.general
        return ValuePaths(general.kernel, general.X, [c[some] for c in general.coefficients])

    def doubles(self, alike):
        return (1 if alike else len(self._weights[0])) * self._own[-1].stop

    def each(self, X):
        A = _over_points(self._rows(_rows_of(X)), X)
        values = [contract(A[..., own], c) for own, c in zip(self._own, self._weights, strict=True)]
        return np.stack(values, axis=-1)

    def gradient(self, X):
        return self.general.gradient(X)


def _rows_of(X):
    """Return the points of X (S, n, d) one after another, (S n, d)."""
    return X.reshape(-1, X.shape[-1])


def _over_points(A, X):
    """Return what was made of the rows of X, (..., S n, C), as (..., S, n, C)."""
    return A.reshape(*A.shape[:-2], *X.shape[:2], A.shape[-1])


def contract(A, c):
    """Return the sums over the last axis of A (..., S, n, C), or (..., 1, n, C), times c (S, C): (..., S, n)."""
    return c @ A[..., 0, :, :].swapaxes(-2, -1) if A.shape[-3] == 1 else (A @ c[..., None])[..., 0]
