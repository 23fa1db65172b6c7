"""Inducing variables of sparse inference, drawn jointly with sample paths.

Inducing variables are called features. Columns of X, which scikit-learn calls features, are called
regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce, singledispatch
from operator import add
from typing import Any, cast

import numpy as np
from scipy.linalg import block_diag

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._gaussian_filters import GaussianBasis
from skdgp.kernels._paths import Basis, BasisPaths, LinearPaths, PathBundle, contract
from skdgp.kernels._prior_paths import draw_waves, prior_paths
from skdgp.kernels._trend import LinearTrend


class FeaturePaths(BasisPaths):
    """Covariances with inducing variables, Kfu, times coefficients (S, K)."""

    def __init__(self, features: Features, coefficients: Matrix) -> None:
        self.features = features
        self.coefficients = coefficients
        basis, variables = features.basis()
        weights = [np.ascontiguousarray(coefficients[:, places]) for places in variables]
        super().__init__(basis, weights, consecutive(variables))

    def __reduce__(self):
        # Pickle the coefficients only: they are smaller than the weights of all columns.
        return FeaturePaths, (self.features, self.coefficients)


@dataclass(frozen=True)
class FeatureSettings:
    """How inducing variables are rounded."""

    #: Variance of white noise in the inducing variables, over their variance; the bound remains a bound
    jitter: float = 1e-6


SETTINGS = FeatureSettings()


class Features(ABC):
    """K variables u that are jointly Gaussian with the outputs, with covariances Kuu (K, K) and Kfu.

    Their inducing inputs change the quality of the approximation, not the model.
    """

    kernel: MultiOutputKernel
    size: int

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
    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        """Return sample paths of the outputs and the values of u (n_paths, K), drawn jointly from the prior."""

    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        """Return dKfu / dX, (d, n, c_i), for slopes of paths, unless the class has paths of its own."""
        raise NotImplementedError

    def basis(self) -> tuple[Basis, list[Indices]]:
        """Return the functions of the regressors that Kfu is made of, and the variable of each, for each output.

        Functions of the first output come first, then of the second, and so on. Functions of one
        variable and output add up to its column of Kfu.
        """
        n_outputs = self.kernel.n_outputs
        return FeatureBasis(self, n_outputs), [self.columns(i) for i in range(n_outputs)]

    def paths(self, coefficients: Matrix) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""
        return FeaturePaths(self, coefficients)


class FeatureBasis:
    """The columns of Kfu of all outputs, as their features compute them."""

    def __init__(self, features: Features, n_outputs: int) -> None:
        self.features = features
        self.outputs = range(n_outputs)

    def __call__(self, X: Matrix) -> Matrix:
        return np.hstack([self.features.Kfu(i, X) for i in self.outputs])

    def slopes(self, X: Array, weights: list[Matrix], columns: list[slice]) -> Array:
        points = X.reshape(-1, X.shape[-1])
        slopes = []
        for i, w in zip(self.outputs, weights, strict=True):
            D = self.features.Kfu_derivative(i, points)
            of_output = contract(D.reshape(len(D), *X.shape[:2], D.shape[-1]), w)
            slopes.append(np.moveaxis(of_output, 0, -1))
        return np.stack(slopes, axis=2)

    def averaged(self, spread: Vector) -> None:
        return None


class ValueFeatures(Features):
    """The values of output ``outputs[f]`` of the kernel ``joint`` at the inputs ``Z[f]`` (k, d), for each block f.

    The outputs of the kernel come first in ``joint``. Output i covaries with the blocks to
    which ``joint`` couples it, ``blocks[i]``. By default ``joint`` is the kernel, whose outputs may
    all be coupled.
    """

    settings = SETTINGS

    def __init__(
        self,
        kernel: MultiOutputKernel,
        Z: Sequence[Matrix],
        joint: MultiOutputKernel | None = None,
    ) -> None:
        first = 0 if joint is None else kernel.n_outputs
        self.kernel = kernel
        self.joint = joint or kernel
        self.Z = [np.asarray(z, dtype=float) for z in Z]
        self.outputs = range(first, first + len(self.Z))
        self.size = sum(map(len, self.Z))
        self._variables = [np.arange(place.start, place.stop) for place in consecutive(self.Z)]
        self.blocks = [list(range(len(self.Z)))] * kernel.n_outputs

    def columns(self, i: int) -> Indices:
        return np.concatenate([np.arange(0), *(self._variables[f] for f in self.blocks[i])])

    def Kuu(self) -> Matrix:
        K = np.zeros((self.size, self.size))
        blocks = list(zip(self.outputs, self.Z, self._variables, strict=True))
        for f, z, rows in blocks:
            for g, x, columns in blocks:
                if self.joint.couples(f, g):
                    K[np.ix_(rows, columns)] = self.joint.block(f, g, z, x)
        np.einsum("ii->i", K)[:] *= 1.0 + self.settings.jitter
        return K

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        blocks = [self.joint.block(i, self.outputs[f], X, self.Z[f]) for f in self.blocks[i]]
        return np.hstack([np.empty((len(X), 0)), *blocks])

    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        """Return dKfu / dX, (d, n, c_i)."""
        slopes = [np.empty((*np.shape(X)[::-1], 0))]
        for f in self.blocks[i]:
            slopes.append(self.joint.block_derivative(i, self.outputs[f], X, self.Z[f]))
        return np.concatenate(slopes, axis=2)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        paths = prior_paths(self.joint, n_paths, n_frequencies, random_state)
        return paths, self._values_of(paths, random_state)

    def _values_of(self, paths: PathBundle, random_state: Any) -> Matrix:
        """Return the variables (S, K) of paths of ``joint``, with a little white noise."""
        blocks = list(zip(self.outputs, self.Z, strict=True))
        # blocks with the same inputs share the values of all outputs there
        # single precision is exact enough beside this noise
        rounded = paths.rounded()
        values: dict[int, Array] = {}
        for z in self.Z:
            if id(z) not in values:
                values[id(z)] = rounded.values(z[None])
        u = np.hstack([values[id(z)][..., f] for f, z in blocks])
        variance = np.concatenate([self.joint.block_diag(f, z) for f, z in blocks])
        return u + np.sqrt(self.settings.jitter * variance) * random_state.standard_normal(u.shape)

    def basis(self) -> tuple[Basis, list[Indices]]:
        if not isinstance(self.joint, ConvolvedGaussian):
            return super().basis()
        bases, variables = [], []
        for i, blocks in enumerate(self.blocks):
            bases.append(self._basis_of(i))
            places = [np.arange(0)]
            for f in blocks:
                n_latents = len(self.joint.filters.latents(i, self.outputs[f]))
                places.append(np.tile(self._variables[f], n_latents))
            variables.append(np.concatenate(places))
        return GaussianBasis.joined(self.kernel.n_features, bases), variables

    def _basis_of(self, i):
        """Return the functions of output i of a convolved Gaussian."""
        joint = cast(ConvolvedGaussian, self.joint)
        filters = joint.filters
        parts = [filters.pair(i, self.outputs[f]).basis(self.Z[f]) for f in self.blocks[i]]
        return GaussianBasis.joined(self.kernel.n_features, parts)


class LatentFeatures(ValueFeatures):
    r"""Filtered latents of a convolved Gaussian, u_f(z) = (g_f * x_m)(z), with Gaussian filters g_f and unit variance.

    Such a variable is a further output of the same family (Alvarez et al. 2010). A
    ConvolvedGaussian gives all covariances, with one further output for every block f of
    variables, whose
    filter g_f is a window with length scales ``width`` (M, d). Block m is of latent m, at the
    inducing inputs ``Z[m]``.
    """

    def __init__(self, kernel: ConvolvedGaussian, Z: Sequence[Matrix], width: Matrix) -> None:
        filters = kernel.filters
        windows = np.eye(len(width))
        further = {"amplitude": windows, "feeds": windows, "length_scale": width}
        arrays: dict[str, Any] = {}
        for name, value in filters._asdict().items():
            added = np.zeros((len(width), len(width), *value.shape[2:]))
            added[:] = further.get(name, 0.0)
            arrays[name] = np.concatenate([value, added], axis=1)
        super().__init__(kernel, Z, ConvolvedGaussian(**arrays))
        self.width = width
        self.blocks = [np.flatnonzero(fed).tolist() for fed in filters.feeds.T]

    def __reduce__(self):
        return LatentFeatures, (self.kernel, self.Z, self.width)  # without the bases

    @cached_property
    def _bases(self) -> list[GaussianBasis]:
        """The functions of each output, one for each variable, as a variable has a single latent."""
        return [self._basis_of(i) for i in range(self.kernel.n_outputs)]

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        return self._bases[i](X)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        waves = draw_waves(self.joint, n_paths, n_frequencies, random_state)
        return waves.of_outputs(self.kernel.n_outputs), self._values_of(waves, random_state)


class TrendFeatures(Features):
    """The standardised weights of a trend; they represent it exactly."""

    def __init__(self, kernel):
        self.kernel = kernel
        self.n_weights = 1 + kernel.n_features  # of each output
        self.size = kernel.n_outputs * self.n_weights

    def columns(self, i):
        return np.arange(i * self.n_weights, (i + 1) * self.n_weights)

    def Kuu(self):
        return np.eye(self.size)

    def Kfu(self, i, X):
        return self.kernel.basis(i, X)

    def paths(self, coefficients):
        """Return the trends with standardised weights (S, K)."""
        values = self.kernel.values()
        n_outputs, d = values["slope_scale"].shape
        scales = np.column_stack([values["intercept_scale"], values["slope_scale"]])
        weights = coefficients.reshape(-1, n_outputs, 1 + d) * scales
        centre = np.broadcast_to(values["center"], (d,))
        return LinearPaths(weights.swapaxes(1, 2).copy(), centre)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        u = random_state.standard_normal((n_paths, self.size))
        return self.paths(u), u


class SumFeatures(Features):
    """The features of both terms of a sum."""

    def __init__(self, first: Features, second: Features):
        self.first = first
        self.second = second
        self.kernel = first.kernel + second.kernel
        self.size = first.size + second.size

    def summands(self):
        return [*self.first.summands(), *self.second.summands()]

    def columns(self, i):
        return np.concatenate([self.first.columns(i), self.first.size + self.second.columns(i)])

    def Kuu(self):
        return block_diag(self.first.Kuu(), self.second.Kuu())

    def Kfu(self, i, X):
        return np.hstack([self.first.Kfu(i, X), self.second.Kfu(i, X)])

    def prior_paths(self, *args):
        first, u = self.first.prior_paths(*args)
        second, v = self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])


# -- features of a kernel
# -----------------------------------------------------------------------------------------------


@singledispatch
def inducing_features(kernel: MultiOutputKernel, Z: Matrix) -> Features:
    """Return inducing features for sparse inference at Z (k, d).

    By default they are the values of the outputs at Z. ``inducing_features.register`` adds a class
    of kernels with others.
    """
    return ValueFeatures(kernel, [Z] * kernel.n_outputs)


@inducing_features.register
def _(kernel: ConvolvedGaussian, Z):
    filters = kernel.filters
    # windows of the mean width of the filters, by the variance that they explain
    weight = np.maximum(filters.amplitude**2, 1e-12) * filters.feeds
    weight /= weight.sum(axis=1, keepdims=True)
    width = np.exp(np.einsum("mp,mpk->mk", weight, np.log(filters.length_scale)))
    return LatentFeatures(kernel, [Z] * len(width), width)


@inducing_features.register
def _(kernel: LinearTrend, Z):
    return TrendFeatures(kernel)


@inducing_features.register
def _(kernel: Sum, Z):
    return SumFeatures(inducing_features(kernel.k1, Z), inducing_features(kernel.k2, Z))


def covariance_paths(
    kernel: MultiOutputKernel, X: Sequence[Matrix], coefficients: Matrix
) -> PathBundle:
    """Return the functions cov(y, y(X)) c, with inputs X (n_j, d) for each output and coefficients c (S, N)."""
    paths: list[PathBundle] = []
    for term in kernel.summands():
        if isinstance(term, LinearTrend):
            weights = []
            for i, (x, places) in enumerate(zip(X, consecutive(X), strict=True)):
                weights.append(coefficients[:, places] @ term.basis(i, x))
            paths.append(TrendFeatures(term).paths(np.hstack(weights)))
        else:
            paths.append(ValueFeatures(term, X).paths(coefficients))
    return reduce(add, paths)


@prior_paths.register
def _(kernel: LinearTrend, n_paths, n_frequencies, random_state):
    return TrendFeatures(kernel).prior_paths(n_paths, n_frequencies, random_state)[0]
