"""Functions of the regressors, many at once: linear ones, waves, Gaussian functions, covariances, and sums."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.kernels._base import MultiOutputKernel
from skdgp.kernels._gaussian_filters import GaussianBasis

CHUNK_BYTES = 2**25  # working memory of an evaluation
STEP = 2.0**-10  # of differences, for regressors of about unit size; adding it rounds little
NODES = np.linspace(-5.0, 5.0, 101)  # of a perturbation, in its standard deviations


class PathBundle(ABC):
    """S functions of the regressors with P values, evaluated together.

    Inputs are (S, n, d), with different points for each function, or (1, n, d), with the same
    points for all. ``weights`` are the numbers that make the functions.
    """

    weights: Array

    @abstractmethod
    def each(self, X: Array) -> np.ndarray:
        """Return the values of all outputs, (S, n, P)."""

    @abstractmethod
    def gradient(self, X: Array, spread: Vector | None = None) -> np.ndarray:
        """Return the slopes of all outputs, (S, n, P, d).

        With ``spread`` (d,) the slope by each regressor is expected over a normal perturbation of it
        alone with this standard deviation. It is the slope of the best linear approximation over
        this perturbation (Stein's lemma), and of the expected function.
        """

    @abstractmethod
    def times(self, factor: Array) -> PathBundle:
        """Return the functions with outputs multiplied by factors (P,), or by those of each function (S, P)."""

    def summands(self) -> Sequence[PathBundle]:
        """Return the functions that these are sums of."""
        return [self]

    def __add__(self, other: PathBundle) -> PathBundle:
        return summed([*self.summands(), *other.summands()])

    def values(self, X: Array) -> np.ndarray:
        """Return the values at many points, in chunks."""
        return self._in_chunks(self.each, X, 1)

    def slopes(self, X: Array, spread: Vector | None = None) -> np.ndarray:
        """Return the slopes at many points, in chunks."""
        return self._in_chunks(lambda part: self.gradient(part, spread), X, X.shape[-1])

    def _in_chunks(self, function, X, width):
        """Return a function of X (S, n, d), evaluated in chunks of n, with ``width`` times the weights in memory."""
        step = max(1, CHUNK_BYTES // max(1, 8 * width * self.weights.size))
        chunks = [function(X[:, a : a + step]) for a in range(0, max(1, X.shape[1]), step)]
        return np.concatenate(chunks, axis=1)


class SumPaths(PathBundle):
    """Sums of the paths of independent processes."""

    def __init__(self, parts: Sequence[PathBundle]):
        self.parts = parts

    def summands(self):
        return self.parts

    def times(self, factor):
        return SumPaths([part.times(factor) for part in self.parts])

    def each(self, X):
        return sum(part.each(X) for part in self.parts)

    def gradient(self, X, spread=None):
        return sum(part.gradient(X, spread) for part in self.parts)

    def values(self, X):
        return sum(part.values(X) for part in self.parts)

    def slopes(self, X, spread=None):
        return sum(part.slopes(X, spread) for part in self.parts)


class LinearPaths(PathBundle):
    """Linear functions of x - ``centre`` with the weights (S, d + 1, P), the constant first."""

    def __init__(self, weights: Array, centre: Vector) -> None:
        self.weights = weights
        self.centre = centre

    def times(self, factor):
        return LinearPaths(self.weights * factor[..., None, :], self.centre)

    def about(self, centre: Vector) -> LinearPaths:
        """Return the same functions with another centre."""
        weights = self.weights.copy()
        weights[:, 0] += np.tensordot(centre - self.centre, self.weights[:, 1:], axes=(0, 1))
        return LinearPaths(weights, centre)

    def each(self, X):
        return (X - self.centre) @ self.weights[:, 1:] + self.weights[:, :1]

    def gradient(self, X, spread=None):
        slopes = self.weights[:, 1:].swapaxes(1, 2)[:, None]
        return np.repeat(slopes, X.shape[1], axis=1)


def summed(parts: Sequence[PathBundle]) -> PathBundle:
    """Return the sums of functions: linear ones first, as one bundle."""
    linear = [part for part in parts if isinstance(part, LinearPaths)]
    others = [part for part in parts if not isinstance(part, LinearPaths)]
    if linear:
        centre = linear[0].centre
        weights = [part.about(centre).weights for part in linear]
        others.insert(0, LinearPaths(np.sum(weights, axis=0), centre))
    return others[0] if len(others) == 1 else SumPaths(others)


class GaussianPaths(PathBundle):
    """Gaussian functions times weights (S, C), for each output those in its ``columns``."""

    def __init__(self, basis: GaussianBasis, weights: Matrix, columns: list[slice]) -> None:
        self.basis = basis
        self.weights = weights
        self.columns = columns

    @property
    def _of_outputs(self):
        """The weights (S, c) of each output."""
        return [self.weights[:, places] for places in self.columns]

    def times(self, factor):
        sizes = [places.stop - places.start for places in self.columns]
        weights = self.weights * np.repeat(factor, sizes, axis=-1)
        return GaussianPaths(self.basis, weights, self.columns)

    def each(self, X):
        A = self.basis(X.reshape(-1, X.shape[-1]))
        A = A.reshape(*X.shape[:2], A.shape[-1])
        outputs = zip(self.columns, self._of_outputs, strict=True)
        return np.stack([contract(A[..., columns], c) for columns, c in outputs], axis=-1)

    def gradient(self, X, spread=None):
        if spread is None:
            return self.basis.slopes(X, self._of_outputs, self.columns)
        slopes = []
        for k, alone in enumerate(np.diag(spread)):
            wider, factor = self.basis.averaged(alone)
            of_outputs = [self.weights[:, places] * factor[places] for places in self.columns]
            slopes.append(wider.slopes(X, of_outputs, self.columns)[..., k])
        return np.stack(slopes, axis=-1)


class CovariancePaths(PathBundle):
    """Covariances of the first ``n_outputs`` outputs of a kernel with some values, times weights (S, N).

    ``sources`` are the output j and the inputs X (n_j, d) of each part of the N values. Slopes are
    differences of fourth order.
    """

    def __init__(
        self,
        kernel: MultiOutputKernel,
        n_outputs: int,
        sources: Sequence[tuple[int, Matrix]],
        weights: Matrix,
        factor: Any = 1.0,
    ) -> None:
        self.kernel = kernel
        self.n_outputs = n_outputs
        self.sources = sources
        self.weights = weights
        self.factor = factor
        all_inputs = [inputs for _, inputs in sources]
        # small steps at points far from zero would be rounded
        self._origin = np.concatenate(all_inputs).mean(axis=0) if kernel.is_stationary() else 0.0
        self._coupled = []
        for (j, inputs), columns in zip(sources, consecutive(all_inputs), strict=True):
            for i in range(n_outputs):
                if kernel.couples(i, j):
                    self._coupled.append((i, j, inputs - self._origin, columns))

    def times(self, factor):
        factor = self.factor * factor[..., None, :]
        return CovariancePaths(self.kernel, self.n_outputs, self.sources, self.weights, factor)

    def each(self, X):
        points = X.reshape(-1, X.shape[-1]) - self._origin
        values = np.zeros((len(self.weights), X.shape[1], self.n_outputs))
        for i, j, inputs, columns in self._coupled:
            A = self.kernel.block(i, j, points, inputs)
            A = A.reshape(*X.shape[:2], len(inputs))
            values[..., i] += contract(A, self.weights[:, columns])
        return values * self.factor

    def gradient(self, X, spread=None):
        slopes = []
        for k, unit in enumerate(np.eye(X.shape[-1])):
            if spread is None:
                slopes.append(_difference(self.each, X, STEP * unit))
            else:
                slopes.append(self._expected(X, STEP * unit, spread[k] * unit))
        return np.stack(slopes, axis=-1)

    def _expected(self, X, step, spread):
        """Return slopes expected over a normal perturbation, by the trapezoidal rule."""
        weights = np.exp(-0.5 * NODES**2)
        moved = [_difference(self.each, X + node * spread, step) for node in NODES]
        return np.tensordot(weights / weights.sum(), moved, axes=1)


def _difference(function: Callable, X: Array, step: Vector) -> Array:
    """Return the derivative of a function along a step, by central differences of fourth order."""
    near = function(X + step) - function(X - step)
    far = function(X + 2 * step) - function(X - 2 * step)
    return (8 * near - far) / (12 * STEP)


def contract(A: Array, c: Matrix) -> Array:
    """Return the sums over the last axis of A (..., S, n, C), or (..., 1, n, C), times c (S, C): (..., S, n)."""
    if A.shape[-3] == 1:
        return c @ A[..., 0, :, :].swapaxes(-2, -1)
    return (A @ c[..., None])[..., 0]


class Waves(PathBundle):
    """Sums of waves: each cosine is computed once for all outputs of its latent.

    Frequencies ``omega`` are (S, d, C), ``phase`` (S, 1, C), ``weights`` (S, P, C).
    """

    def __init__(self, omega: Any, phase: Any, weights: Any) -> None:
        self.omega = omega
        self.phase = phase
        self.weights = weights

    def times(self, factor):
        return Waves(self.omega, self.phase, self.weights * factor[..., None])

    def _arguments(self, X):
        """Return the arguments of the waves, (S, n, C)."""
        return X @ self.omega + self.phase

    def each(self, X):
        wave = np.cos(self._arguments(X))
        return (self.weights @ wave.swapaxes(1, 2)).swapaxes(1, 2)

    def gradient(self, X, spread=None):
        omega = self.omega
        if spread is not None:  # the characteristic function of the normal distribution
            omega = np.exp(-0.5 * (spread[:, None] * omega) ** 2) * omega
        wave = -np.sin(self._arguments(X))
        of_outputs = wave[:, :, None] * self.weights[:, None]
        return of_outputs @ omega.swapaxes(1, 2)[:, None]

    def of_outputs(self, n_outputs: int) -> Waves:
        """Return the paths of the first outputs."""
        return Waves(self.omega, self.phase, self.weights[:, :n_outputs])
