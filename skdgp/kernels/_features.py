"""Inducing variables of sparse inference: finitely many variables that represent the processes.

They are called features. Columns of X, which scikit-learn calls features, are called regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from skdgp._compute.linalg import cluster_centres, column_scale
from skdgp._compute.typing import Array, Indices, Matrix
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._gaussian_filters import CovarianceColumns
from skdgp.kernels._prior_paths import (
    FeaturePaths,
    PathBundle,
    TrendPaths,
    Waves,
    draw_latents,
    prior_paths,
)
from skdgp.kernels._trend import LinearTrend

# variance of white noise in the inducing variables, over their variance; the bound remains a bound
JITTER = 1e-6
ADDITIVE_POINTS = 8  # inducing inputs for each regressor of a term of few regressors


class Features(ABC):
    """K variables u that are jointly Gaussian with the outputs, with covariances Kuu (K, K) and Kfu.

    Their inducing inputs change the quality of the approximation, not the model.
    """

    kernel: MultiOutputKernel
    size: int

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.kernel.n_outputs

    def summands(self) -> list[Features]:
        """Return the features that are joined in these, which are not sums themselves."""
        return [self]

    def __add__(self, other: Features) -> SumFeatures:
        return SumFeatures(self, other)

    @abstractmethod
    def columns(self, i: int) -> Indices:
        """Return the indices of the variables that covary with output i, (c_i,): whole blocks of Kuu."""

    @abstractmethod
    def Kuu(self) -> Matrix:
        """Return cov(u, u), (K, K)."""

    @abstractmethod
    def Kfu(self, i: int, X: Matrix) -> Matrix:
        """Return cov(y_i(X), u) for the columns of i, (n, c_i)."""

    @abstractmethod
    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        """Return dKfu / dX, (d, n, c_i)."""

    @abstractmethod
    def rebuild(self, kernel: MultiOutputKernel) -> Features:
        """Return the features of another kernel of the same shape, with the same inducing inputs."""

    @abstractmethod
    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        """Return sample paths of the outputs and the values of u (n_paths, K), drawn jointly from the prior."""

    def rows(self) -> Callable[[Matrix], Matrix]:
        """Return a function X (n, d) -> Kfu of all outputs side by side, for few samples at a time."""
        return lambda X: np.hstack([self.Kfu(i, X) for i in range(self.n_outputs)])

    def paths(self, coefficients: Matrix) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""
        return FeaturePaths(self, coefficients)


class PointFeatures(Features):
    """The values of all outputs at inducing inputs Z (k, d), for any kernel.

    An output covaries with the values of all outputs to which the kernel couples it, directly or
    through others.
    """

    def __init__(self, kernel, Z):
        self.kernel, self.Z = kernel, np.asarray(Z, dtype=float)
        outputs, self.size = range(kernel.n_outputs), kernel.n_outputs * len(self.Z)
        couples = np.array([[kernel.couples(i, j) for j in outputs] for i in outputs])
        _, groups = connected_components(couples, directed=False)
        self._coupled = [np.flatnonzero(groups == group) for group in groups]

    def _slice(self, j):
        return slice(j * len(self.Z), (j + 1) * len(self.Z))

    def columns(self, i):
        return np.concatenate([np.arange(self.size)[self._slice(j)] for j in self._coupled[i]])

    def Kuu(self):
        K = self.kernel(self.Z)
        np.einsum("ii->i", K)[:] *= 1.0 + JITTER
        return K

    def Kfu(self, i, X):
        return np.hstack([self.kernel.block(i, j, X, self.Z) for j in self._coupled[i]])

    def Kfu_derivative(self, i, X):
        return np.concatenate(
            [self.kernel.block_derivative(i, j, X, self.Z) for j in self._coupled[i]], axis=2
        )

    def prior_paths(self, n_paths, n_frequencies, random_state):
        paths = prior_paths(self.kernel, n_paths, n_frequencies, random_state)
        u = paths.values(self.Z[None]).swapaxes(1, 2).reshape(n_paths, -1)
        u += np.sqrt(JITTER * self.kernel.diag(self.Z)) * random_state.standard_normal(u.shape)
        return paths, u

    def rebuild(self, kernel):
        return PointFeatures(kernel, self.Z)


class LatentFeatures(Features):
    r"""Filtered latents of a convolved Gaussian, u_f(z) = (g_f * x_m)(z), with Gaussian filters g_f and unit variance.

    Such a variable is a further output of the same family (Alvarez et al. 2010). All covariances
    are those of a ConvolvedGaussian with one further output for every block f of variables, whose
    filter g_f is a window with length scales ``width`` (F, d). Block f is of latent
    ``latents[f]``, at the inducing inputs ``Z[f]``.
    """

    def __init__(
        self, kernel: ConvolvedGaussian, latents: Iterable[int], Z: Sequence[Matrix], width: Matrix
    ) -> None:
        self.kernel = kernel
        self.Z = list(Z)
        self.width = width
        self.latents = [int(m) for m in latents]
        self.joint = self._with_blocks()
        self._edges = np.cumsum([0, *map(len, self.Z)])
        self.size = int(self._edges[-1])
        feeds = kernel.value("feeds").astype(bool)
        self.blocks = [[f for f, m in enumerate(self.latents) if mask[m]] for mask in feeds.T]
        pairs = [(f, g) for f in range(len(self.latents)) for g in range(len(self.latents))]
        self._block_pairs = [(f, g) for f, g in pairs if self.latents[f] == self.latents[g]]

    def __getstate__(self):
        return {name: self.__dict__[name] for name in ("kernel", "latents", "Z", "width")}

    def __setstate__(self, state):
        vars(self).update(vars(LatentFeatures(**state)))

    def _with_blocks(self):
        """Return the kernel with one further output of unit variance for each block."""
        kernel, arrays = self.kernel, {}
        for name in ("amplitude", "length_scale", "shift", "shear", "feeds"):
            value = kernel.value(name)
            if name in ("amplitude", "feeds"):
                extra = np.eye(len(value))[:, self.latents]
            elif name == "length_scale":
                extra = self.width
            else:
                extra = np.zeros((len(self.latents), value.shape[2]))
            arrays[name] = np.concatenate(
                [value, np.broadcast_to(extra, (len(value), *extra.shape[-value.ndim + 1 :]))],
                axis=1,
            )
        return type(kernel)(
            covariance_type="full" if kernel.covariance_type == "full" else "diag", **arrays
        )

    def _slice(self, f):
        return slice(self._edges[f], self._edges[f + 1])

    def columns(self, i: int) -> Indices:
        return np.concatenate(
            [np.arange(0), *(np.arange(self.size)[self._slice(f)] for f in self.blocks[i])]
        )

    def Kuu(self) -> Matrix:
        P, K = self.kernel.n_outputs, np.zeros((self.size, self.size))
        for f, g in self._block_pairs:
            K[self._slice(f), self._slice(g)] = self.joint.block(P + f, P + g, self.Z[f], self.Z[g])
        np.einsum("ii->i", K)[:] = 1.0 + JITTER
        return K

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        blocks = [
            self.joint.block(i, self.kernel.n_outputs + f, X, self.Z[f]) for f in self.blocks[i]
        ]
        return np.hstack([np.empty((len(X), 0)), *blocks])

    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        P, (n, d) = self.kernel.n_outputs, np.shape(X)
        blocks = [self.joint.block_derivative(i, P + f, X, self.Z[f]) for f in self.blocks[i]]
        return np.concatenate([np.empty((d, n, 0)), *blocks], axis=2)

    def rows(self) -> Callable[[Matrix], Matrix]:
        P = self.kernel.n_outputs
        pairs = [
            (self.joint.pair(i, P + f), self.Z[f])
            for i, blocks in enumerate(self.blocks)
            for f in blocks
        ]
        return CovarianceColumns(self.kernel.n_features, pairs)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        P, latents = (
            self.kernel.n_outputs,
            draw_latents(self.joint, n_paths, n_frequencies, random_state),
        )
        parts = [
            Waves.combine(latents, [P + f]).values(z[None])[..., 0] for f, z in enumerate(self.Z)
        ]
        u = np.concatenate(parts, axis=1)
        u += np.sqrt(JITTER) * random_state.standard_normal(u.shape)
        return Waves.combine(latents, range(P)), u

    def rebuild(self, kernel: MultiOutputKernel) -> Features:
        return LatentFeatures(kernel, self.latents, self.Z, self.width)


class TrendFeatures(Features):
    """The standardised weights of a trend; they represent it exactly."""

    def __init__(self, kernel):
        self.kernel = kernel
        self.n_weights = kernel.n_weights
        self.size = kernel.n_outputs * self.n_weights

    def columns(self, i):
        return np.arange(i * self.n_weights, (i + 1) * self.n_weights)

    def Kuu(self):
        return np.eye(self.size)

    def Kfu(self, i, X):
        return self.kernel.basis(i, X)

    def rows(self):
        slope = self.kernel.value(
            "slope_scale"
        )  # (P, d); the columns of an output are [tau_0, tau_k (s_k - c_k)]
        constant = np.column_stack(
            [self.kernel.value("intercept_scale"), -slope * self.kernel.value("center")]
        )
        slopes = np.zeros((slope.shape[1], *constant.shape))
        np.einsum("kik->ik", slopes[:, :, 1:])[:] = slope
        slopes, constant = slopes.reshape(len(slopes), -1), constant.ravel()
        return lambda X: X @ slopes + constant

    def Kfu_derivative(self, i, X):
        slopes = self.kernel.basis_slopes(i)
        return np.broadcast_to(slopes, (len(slopes), len(X), self.n_weights))

    def prior_paths(self, n_paths, n_frequencies, random_state):
        u = random_state.standard_normal((n_paths, self.size))
        return self.paths(u), u

    def paths(self, coefficients):
        return TrendPaths(self.kernel, coefficients.reshape(len(coefficients), -1, self.n_weights))

    def rebuild(self, kernel):
        return TrendFeatures(kernel)


class SumFeatures(Features):
    """The features of both terms of a sum."""

    def __init__(self, first: Features, second: Features):
        self.first, self.second = first, second
        self.size = first.size + second.size

    @property
    def n_outputs(self):
        return self.first.n_outputs

    def summands(self):
        return [*self.first.summands(), *self.second.summands()]

    def columns(self, i):
        return np.concatenate([self.first.columns(i), self.first.size + self.second.columns(i)])

    def Kuu(self):
        K = np.zeros((self.size, self.size))
        n = self.first.size
        K[:n, :n], K[n:, n:] = self.first.Kuu(), self.second.Kuu()
        return K

    def Kfu(self, i, X):
        return np.hstack([self.first.Kfu(i, X), self.second.Kfu(i, X)])

    def rows(self):
        first, second = self.first.rows(), self.second.rows()
        sizes = [
            [len(term.columns(i)) for term in (self.first, self.second)]
            for i in range(self.n_outputs)
        ]
        place = np.repeat(
            [0, 1] * len(sizes), np.ravel(sizes)
        )  # for each output its columns of both terms
        order = np.argsort(np.argsort(place, kind="stable"))
        return lambda X: np.take(np.hstack([first(X), second(X)]), order, axis=1)

    def Kfu_derivative(self, i, X):
        return np.concatenate(
            [self.first.Kfu_derivative(i, X), self.second.Kfu_derivative(i, X)], axis=2
        )

    def prior_paths(self, *args):
        (first, u), (second, v) = self.first.prior_paths(*args), self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])

    def rebuild(self, kernel):
        return SumFeatures(self.first.rebuild(kernel.k1), self.second.rebuild(kernel.k2))


# -- features of a kernel
# -----------------------------------------------------------------------------------------------


@singledispatch
def inducing_features(kernel: MultiOutputKernel, Z: Matrix) -> Features:
    """Return inducing features for sparse inference at Z (k, d).

    By default they are the values of the outputs at Z. ``inducing_features.register`` adds a class
    of kernels with others.
    """
    return PointFeatures(kernel, Z)


@inducing_features.register
def _(kernel: ConvolvedGaussian, Z):
    w = kernel.value("amplitude")
    A = kernel.A
    lengths = np.sqrt(2.0 / (np.einsum("mpkk->mpk", A) if A.ndim == 4 else A))
    weight = np.maximum(w**2, 1e-12) * kernel.value("feeds")
    weight /= weight.sum(axis=1, keepdims=True)
    width = np.exp(np.einsum("mp,mpk->mk", weight, np.log(lengths)))
    Z = _thinned(Z, kernel.without_effect(Z.shape[1]))
    return LatentFeatures(kernel, range(len(w)), [Z] * len(w), width)


@inducing_features.register
def _(kernel: LinearTrend, Z):
    return TrendFeatures(kernel)


@inducing_features.register
def _(kernel: Sum, Z):
    return SumFeatures(inducing_features(kernel.k1, Z), inducing_features(kernel.k2, Z))


def _thinned(Z, without_effect):
    """Return inducing inputs for functions of few regressors: fewer than the given ones."""
    used = ~without_effect
    n = ADDITIVE_POINTS * int(used.sum())
    if used.all() or n >= len(Z):
        return Z
    chosen = np.tile(Z.mean(axis=0), (n, 1))
    if used.sum() == 1:
        chosen[:, used] = np.linspace(Z[:, used].min(axis=0), Z[:, used].max(axis=0), n)
    else:
        chosen[:, used] = cluster_centres(Z[:, used], column_scale(Z)[used], n, 0)
    return chosen
