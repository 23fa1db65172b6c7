"""Samples of the posterior that are functions: Matheron's rule.

Samples of the prior become the posterior's by what they lack where something is known: with f and u drawn together,
f + Kfu Kuu^-1 (u_post - u) has mean and covariance of the posterior everywhere (Wilson et al. 2020, "Efficiently
sampling functions from Gaussian process posteriors").
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np
from sklearn.utils import check_random_state

from skdgp._linalg import triangular_solve
from skdgp._threads import threads_for
from skdgp.inference._noise import draw_noise
from skdgp.inference._shares import row_slices

FREQUENCIES = 64  # waves of each latent process, of every path
CHUNK_BYTES = 2**25  # working memory of an evaluation


class Path:
    """One sample of the posterior: a function of the regressors, X (n, d) -> (n, P), or (n,) where y was.

    ``gradient(X)`` is its slope, (n, P, d), or (n, d).
    """

    def __init__(self, alone: Paths):
        self._alone = alone

    def __call__(self, X) -> np.ndarray:
        return self._alone(X)[0]

    def gradient(self, X) -> np.ndarray:
        """Return d value / d regressor, (n, P, d), or (n, d) where y was (n,)."""
        return self._alone.gradient(X)[0]


class Paths(Sequence):
    """Samples of the posterior that are functions: a sequence of ``Path``, evaluated together.

    ``paths[k]`` is a function (n, d) -> (n, P), ``paths[a:b]`` some of them, ``paths(X)`` all at the same points,
    ``paths.each(X)`` each at its own, ``paths.gradient(X)`` their slopes. They can be pickled; the same points have the
    same values, in whatever order and company they are asked for.

    Parameters
    ----------
    prior : PriorPaths
    update : Update
        What is added to the prior paths, which makes them the posterior's.
    n_features : int
    center, scale : ndarray (P,)
        Values are center + scale * (prior + update).
    single : bool
        Whether the axis of outputs is left out.
    """

    def __init__(self, prior, update, n_features, center=0.0, scale=1.0, single=False):
        self.prior, self.update, self.n_features = prior, update, n_features
        self.center, self.scale, self.single = center, scale, single

    def in_units(self, center, scale, single) -> Paths:
        """Return the same paths in units of outputs that are ``center`` + ``scale`` times these."""
        return Paths(self.prior, self.update, self.n_features, center, scale, single)

    def __len__(self):
        return self.update.n_paths

    def __getitem__(self, index):
        if isinstance(index, slice):
            return self._take(index)
        k = range(len(self))[index]
        return Path(self._take(slice(k, k + 1)))

    def _take(self, some):
        return Paths(
            self.prior.take(some), self.update.take(some), self.n_features, self.center, self.scale, self.single
        )

    def __call__(self, X) -> np.ndarray:
        """Return the values of all paths at X (n, d), (n_paths, n, P), or (n_paths, n) where y was (n,)."""
        return self._shaped(self._values(self._checked(X, 2)[None]))

    def each(self, X) -> np.ndarray:
        """Return the values of each path at its own points X (n_paths, n, d), (n_paths, n, P)."""
        return self._shaped(self._values(self._checked(X, 3)))

    def gradient(self, X) -> np.ndarray:
        """Return the slopes of all paths at X (n, d), or of each at its own X (n_paths, n, d): (n_paths, n, P, d)."""
        X = self._checked(X, 3 if np.ndim(X) == 3 else 2)
        return self._shaped(self._slopes(X if X.ndim == 3 else X[None]))

    def _values(self, X):
        values = _in_chunks(lambda x: self.prior.each(x) + self.update.each(x), X, self._per_row(X))
        values *= self.scale
        values += self.center
        return values

    def _slopes(self, X):
        per_row = self.n_features * self._per_row(X)
        slopes = _in_chunks(lambda x: self.prior.gradient(x) + self.update.gradient(x), X, per_row)
        return slopes * np.reshape(self.scale, (-1, 1))

    def _per_row(self, X):
        return len(self) * self.prior.width + len(X) * self.update.width

    def _checked(self, X, ndim):
        X = np.asarray(X, dtype=float)
        expected = (len(self), -1, self.n_features)[3 - ndim :]
        if X.ndim != ndim or X.shape[-1] != self.n_features or (ndim == 3 and len(X) != len(self)):
            shape = str(expected).replace("-1", "n")
            raise ValueError(f"Got X of shape {X.shape}, but expected {shape}: a column for each regressor of the fit.")
        return X

    def _shaped(self, values):
        return values[:, :, 0] if self.single else values


class Update(ABC):
    """What makes prior paths those of the posterior: covariances with what is known, times coefficients."""

    n_paths: int
    width: int

    @abstractmethod
    def each(self, X) -> np.ndarray:
        """Return what is added to the values at X (S, n, d), or (1, n, d) the same for all, (S, n, P)."""

    @abstractmethod
    def gradient(self, X) -> np.ndarray:
        """Return what is added to the slopes, (S, n, P, d)."""

    @abstractmethod
    def take(self, some: slice) -> Update:
        """Return that of some of the paths."""


class FeatureUpdate(Update):
    """Kfu times coefficients (S, K) of the inducing variables."""

    def __init__(self, features, n_outputs, coefficients):
        self.features, self.coefficients = features, coefficients
        self.n_paths = len(coefficients)
        self._rows, columns = features.rows(), [features.columns(i) for i in range(n_outputs)]
        self._own = [slice(a, b) for a, b in pairwise(np.cumsum([0, *map(len, columns)]))]
        self._weights = [np.ascontiguousarray(coefficients[:, c]) for c in columns]
        self.width = sum(map(len, columns))

    def take(self, some):
        return FeatureUpdate(self.features, len(self._own), self.coefficients[some])

    def each(self, X):
        A = self._rows(X.reshape(-1, X.shape[-1])).reshape(*X.shape[:2], -1)
        return _paths_first([_weighted(A[..., own], c) for own, c in zip(self._own, self._weights, strict=True)])

    def gradient(self, X):
        D = (self.features.Kfu_derivative(i, X.reshape(-1, X.shape[-1])) for i in range(len(self._own)))
        slopes = [_weighted(d.reshape(len(d), *X.shape[:2], -1), c) for d, c in zip(D, self._weights, strict=True)]
        return _paths_first(np.swapaxes(slopes, 0, 1))


class DataUpdate(Update):
    """Kff times coefficients of the observed values: one array (S, n_j) for each output j, observed at X_j (n_j, d)."""

    def __init__(self, kernel, X, coefficients):
        self.kernel, self.X, self.coefficients = kernel, X, coefficients
        self.n_paths = len(coefficients[0])
        self.width = sum(map(len, X))

    def take(self, some):
        return DataUpdate(self.kernel, self.X, [c[some] for c in self.coefficients])

    def each(self, X):
        return self._summed(self.kernel.block, X, ())

    def gradient(self, X):
        return self._summed(self.kernel.block_derivative, X, X.shape[-1:])

    def _summed(self, block, X, slopes):
        """Return the sum of a block's products with the coefficients, (S, n, P) or, of slopes, (S, n, P, d)."""
        P, points = self.kernel.n_outputs, X.reshape(-1, X.shape[-1])
        values = np.zeros((*slopes, P, self.n_paths, X.shape[1]))
        for i, j in product(range(P), repeat=2):
            if self.kernel.couples(i, j):
                for some in row_slices(len(self.X[j])):
                    A = block(i, j, points, self.X[j][some]).reshape(*slopes, *X.shape[:2], -1)
                    values[..., i, :, :] += _weighted(A, self.coefficients[j][:, some])
        return _paths_first(values)


def _in_chunks(function, X, per_row):
    """Return a function of X (S, n, d), which keeps ``per_row`` doubles for each n, along its second axis."""
    step = max(1, CHUNK_BYTES // (8 * per_row))
    if X.shape[1] <= step:
        return function(X)
    return np.concatenate([function(X[:, a : a + step]) for a in range(0, X.shape[1], step)], axis=1)


def _weighted(A, c):
    """Return the products of A (..., S, n, C), or (..., 1, n, C), with c (S, C): (..., S, n)."""
    alike = A.shape[-3] == 1
    return c @ A[..., 0, :, :].swapaxes(-2, -1) if alike else (A @ c[..., None])[..., 0]


def _paths_first(values):
    """Return (P, S, n) as (S, n, P), and (d, P, S, n) as (S, n, P, d)."""
    return np.transpose(values).swapaxes(0, 1)


def sparse_paths(posterior, n_paths, random_state) -> Paths:
    """Return paths of a SparsePosterior: u_post = Lu w, w ~ N(white, B^-1), takes the place of u."""
    random_state = check_random_state(random_state)
    prior, u = posterior.features.prior_paths(n_paths, FREQUENCIES, random_state)
    with threads_for(posterior.features.size):
        white = random_state.standard_normal(u.shape).T
        gap = posterior.white[:, None] + triangular_solve(posterior.LB, np.asfortranarray(white), transposed=True)
        gap -= triangular_solve(posterior.Lu, np.array(u.T, order="F"))
        coefficients = triangular_solve(posterior.Lu, np.asfortranarray(gap), transposed=True).T
    kernel = posterior.kernel
    return Paths(prior, FeatureUpdate(posterior.features, kernel.n_outputs, coefficients), kernel.n_features)


def exact_paths(posterior, n_paths, random_state) -> Paths:
    """Return paths of an ExactPosterior: coefficients are K^-1 (y - f - noise), K that of the noisy values."""
    random_state = check_random_state(random_state)
    kernel, data = posterior.kernel, posterior.data
    prior = kernel.prior_paths(n_paths, FREQUENCIES, random_state)
    points, row = np.unique(np.concatenate(data.X), axis=0, return_inverse=True)
    f = _in_chunks(prior.each, points[None], n_paths * prior.width)
    rows = np.split(row.ravel(), np.cumsum([len(x) for x in data.X])[:-1])
    gap = [y - f[:, own, i] for i, (y, own) in enumerate(zip(data.y, rows, strict=True))]
    gap = np.hstack(gap) - draw_noise(posterior.noise, data, n_paths, random_state)
    coefficients = posterior.solve(gap.T).T
    edges = np.cumsum([0, *map(len, data.X)])
    each = [np.ascontiguousarray(coefficients[:, a:b]) for a, b in pairwise(edges)]
    return Paths(prior, DataUpdate(kernel, data.X, each), kernel.n_features)
