"""Inducing variables of sparse inference, drawn jointly with sample paths.

Inducing variables are called features. Columns of X, which scikit-learn calls features, are called
regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property, singledispatch
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._gaussian_filters import GaussianBasis
from skdgp.kernels._paths import CovariancePaths, GaussianPaths, LinearPaths, PathBundle, summed
from skdgp.kernels._prior_paths import prior_paths
from skdgp.kernels._trend import LinearTrend

# Variance of white noise in the inducing variables, over their variance; the bound remains a bound
JITTER = 1e-6


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

    @abstractmethod
    def paths(self, coefficients: Matrix) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""


class ValueFeatures(Features):
    """The values at Z (k, d) of some outputs of the kernel ``joint``, block after block.

    The outputs of ``kernel`` come first in ``joint``, which is the kernel itself by default; the
    values are of all outputs then, or of the further ones. Output i covaries with ``blocks[i]``.
    """

    def __init__(
        self, kernel: MultiOutputKernel, Z: Matrix, joint: MultiOutputKernel | None = None
    ) -> None:
        first = 0 if joint is None else kernel.n_outputs
        self.kernel = kernel
        self.joint = joint or kernel
        self.Z = np.asarray(Z, dtype=float)
        self.outputs = range(first, self.joint.n_outputs)
        self.size = len(self.outputs) * len(self.Z)
        self.blocks = [list(range(len(self.outputs)))] * kernel.n_outputs

    def columns(self, i: int) -> Indices:
        return np.arange(self.size).reshape(len(self.outputs), -1)[self.blocks[i]].ravel()

    def Kuu(self) -> Matrix:
        n = len(self.Z)
        K = np.zeros((self.size, self.size))
        for a, f in enumerate(self.outputs):
            for b, g in enumerate(self.outputs):
                if self.joint.couples(f, g):
                    block = self.joint.block(f, g, self.Z, self.Z)
                    K[a * n : (a + 1) * n, b * n : (b + 1) * n] = block
        np.einsum("ii->i", K)[:] *= 1.0 + JITTER
        return K

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        blocks = [self.joint.block(i, self.outputs[f], X, self.Z) for f in self.blocks[i]]
        return np.hstack(blocks)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        paths = prior_paths(self.joint, n_paths, n_frequencies, random_state)
        values = paths.values(self.Z[None])[..., self.outputs.start :]
        u = values.swapaxes(1, 2).reshape(n_paths, self.size)
        variance = np.concatenate([self.joint.block_diag(f, self.Z) for f in self.outputs])
        return paths, u + np.sqrt(JITTER * variance) * random_state.standard_normal(u.shape)

    def paths(self, coefficients: Matrix) -> PathBundle:
        sources = [(f, self.Z) for f in self.outputs]
        return _paths_of_values(self.joint, self.kernel.n_outputs, sources, coefficients)


class LatentFeatures(ValueFeatures):
    r"""Filtered latents of a convolved Gaussian, u_f(z) = (g_f * x_m)(z), with Gaussian filters g_f and unit variance.

    Such a variable is a further output of the same family (Alvarez et al. 2010). A
    ConvolvedGaussian gives all covariances, with one further output for every latent m, whose
    filter g_m is a window with length scales ``width`` (M, d).
    """

    def __init__(self, kernel: ConvolvedGaussian, Z: Matrix, width: Matrix) -> None:
        filters = kernel.filters
        windows = np.eye(len(width))
        further = {"amplitude": windows, "feeds": windows, "length_scale": width}
        arrays: dict[str, Any] = {}
        for name, value in filters._asdict().items():
            added = np.zeros((len(width), len(width), *value.shape[2:]))
            if name in further:
                added[:] = further[name]
            arrays[name] = np.concatenate([value, added], axis=1)
        super().__init__(kernel, Z, ConvolvedGaussian(**arrays))
        self.width = width
        self.blocks = [np.flatnonzero(fed).tolist() for fed in filters.feeds.T]

    def __reduce__(self):
        return LatentFeatures, (self.kernel, self.Z, self.width)  # without the bases

    @cached_property
    def _bases(self) -> list[tuple[GaussianBasis, Vector]]:
        """The functions of each output and their gains, one for each variable, as it has a single latent."""
        filters = self.joint.filters
        bases = []
        for i, blocks in enumerate(self.blocks):
            pairs = [filters.pair(i, self.outputs[f]) for f in blocks]
            gain = np.concatenate([pair.gain for pair in pairs])
            basis = GaussianBasis.joined([pair.basis(self.Z) for pair in pairs])
            bases.append((basis, np.repeat(gain, len(self.Z))))
        return bases

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        basis, gain = self._bases[i]
        values = basis(X)
        values *= gain
        return values

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        waves: Any
        waves, u = super().prior_paths(n_paths, n_frequencies, random_state)
        return waves.of_outputs(self.kernel.n_outputs), u


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
    return ValueFeatures(kernel, Z)


@inducing_features.register
def _(kernel: ConvolvedGaussian, Z):
    filters = kernel.filters
    # windows of the mean width of the filters, by the variance that they explain
    weight = np.maximum(filters.amplitude**2, 1e-12) * filters.feeds
    weight /= weight.sum(axis=1, keepdims=True)
    width = np.exp(np.einsum("mp,mpk->mk", weight, np.log(filters.length_scale)))
    return LatentFeatures(kernel, Z, width)


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
            paths.append(_paths_of_values(term, len(X), list(enumerate(X)), coefficients))
    return summed(paths)


def _paths_of_values(kernel, n_outputs, sources, coefficients):
    """Return the `CovariancePaths` of a kernel; a convolved Gaussian has a formula."""
    if not isinstance(kernel, ConvolvedGaussian):
        return CovariancePaths(kernel, n_outputs, sources, coefficients)
    filters = kernel.filters
    parts = consecutive([inputs for _, inputs in sources])
    bases = []
    weights = []
    for i in range(n_outputs):
        of_output = []
        for (j, inputs), part in zip(sources, parts, strict=True):
            pair = filters.pair(i, j)
            bases.append(pair.basis(inputs))
            of_latents = pair.gain[:, None] * coefficients[:, None, part]
            of_output.append(of_latents.reshape(len(coefficients), -1))
        weights.append(np.concatenate(of_output, axis=1))
    columns = consecutive([w.T for w in weights])
    return GaussianPaths(GaussianBasis.joined(bases), np.concatenate(weights, axis=1), columns)


@prior_paths.register
def _(kernel: LinearTrend, n_paths, n_frequencies, random_state):
    return TrendFeatures(kernel).prior_paths(n_paths, n_frequencies, random_state)[0]
