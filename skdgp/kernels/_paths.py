"""Functions of the regressors, many at once: linear ones, waves and other bases; their sums and means."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Protocol, cast

import numpy as np
from scipy.special import ndtri
from scipy.stats.qmc import Sobol

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.kernels._gaussian_filters import GaussianBasis

CHUNK_BYTES = 2**25  # working memory of an evaluation


class PathBundle(ABC):
    """S functions of the regressors with P values, evaluated together.

    Inputs are (S, n, d), with different points for each function, or (1, n, d), with the same
    points for all.
    """

    @abstractmethod
    def each(self, X: Array) -> np.ndarray:
        """Return the values of all outputs, (S, n, P)."""

    @abstractmethod
    def gradient(self, X: Array) -> np.ndarray:
        """Return the slopes of all outputs, (S, n, P, d)."""

    @abstractmethod
    def doubles(self, same_points: bool) -> int:
        """Return the working memory for one point of each function, in doubles."""

    def rounded(self) -> PathBundle:
        """Return the functions as simulations evaluate them, with errors 1e-6 of the prior.

        Waves are of single precision, and the Gaussian functions of all terms one basis.
        """
        return self

    @abstractmethod
    def times(self, factor: Array) -> PathBundle:
        """Return the functions with outputs multiplied by factors (P,), or by those of each function (S, P)."""

    def averaged(self, spread: Vector) -> PathBundle:
        """Return the expected functions at x + e, where e is normal with standard deviations ``spread`` (d,).

        By default they are means over fixed draws of e.
        """
        return MeanPaths(self, spread * normal_nodes(len(spread)))

    def averaged_slopes(self, X: Array, spread: Vector) -> np.ndarray:
        """Return the slope by each regressor, expected over a normal perturbation of it alone, (S, n, P, d).

        It is that of the best linear approximation over this perturbation (Stein's lemma), and the
        slope of the expected function.
        """
        slopes = []
        for k, alone in enumerate(np.diag(spread)):
            slopes.append(self.averaged(alone).slopes(X)[..., k])
        return np.stack(slopes, axis=-1)

    def summands(self) -> Sequence[PathBundle]:
        """Return the functions that these are sums of."""
        return [self]

    def __add__(self, other: PathBundle) -> PathBundle:
        return summed([*self.summands(), *other.summands()])

    def values(self, X: Array) -> np.ndarray:
        """Return the values at many points, in chunks."""
        return _in_chunks(self.each, X, self.doubles(len(X) == 1))

    def slopes(self, X: Array) -> np.ndarray:
        """Return the slopes at many points, in chunks."""
        return _in_chunks(self.gradient, X, X.shape[-1] * self.doubles(len(X) == 1))


def _in_chunks(function, X, doubles):
    """Return a function of X (S, n, d), evaluated in chunks of n; each point needs ``doubles`` of working memory."""
    step = max(1, CHUNK_BYTES // max(1, 8 * doubles))
    if X.shape[1] <= step:
        return function(X)
    chunks = [function(X[:, a : a + step]) for a in range(0, X.shape[1], step)]
    return np.concatenate(chunks, axis=1)


def normal_nodes(d: int, log2_size: int = 6) -> Matrix:
    """Return points (n, d) with their mirror images, which fill the standard normal distribution evenly."""
    uniform = Sobol(d, seed=0).random_base2(log2_size)
    nodes = ndtri(np.clip(uniform, 1e-6, 1.0 - 1e-6))
    return np.concatenate([nodes, -nodes])


class MeanPaths(PathBundle):
    """Means of paths over points moved by ``moves`` (m, d)."""

    def __init__(self, paths: PathBundle, moves: Matrix):
        self.paths = paths
        self.moves = moves

    def doubles(self, same_points):
        return self.paths.doubles(same_points)

    def each(self, X):
        return self._mean(self.paths.each, X)

    def gradient(self, X):
        return self._mean(self.paths.gradient, X)

    def times(self, factor):
        return MeanPaths(self.paths.times(factor), self.moves)

    def _mean(self, function, X):
        total = function(X + self.moves[0])
        for move in self.moves[1:]:
            total += function(X + move)
        return total / len(self.moves)


class SumPaths(PathBundle):
    """Sums of the paths of independent processes."""

    def __init__(self, parts: Sequence[PathBundle]):
        self.parts = parts

    def summands(self):
        return self.parts

    def rounded(self):
        return SumPaths(_with_one_basis([part.rounded() for part in self.parts]))

    def times(self, factor):
        return SumPaths([part.times(factor) for part in self.parts])

    def averaged(self, spread):
        return SumPaths([part.averaged(spread) for part in self.parts])

    def doubles(self, same_points):
        return max(part.doubles(same_points) for part in self.parts)

    def each(self, X):
        return self._sum(X, [part.each for part in self.parts])

    def gradient(self, X):
        return self._sum(X, [part.gradient for part in self.parts])

    def _sum(self, X, functions):
        first, *others = functions
        total = first(X)
        for function in others:
            total += function(X)
        return total


class LinearPaths(PathBundle):
    """Linear functions of x - ``centre`` with the weights (S, d + 1, P), the constant first."""

    def __init__(self, weights: Array, centre: Vector) -> None:
        self.weights = weights
        self.centre = centre

    def averaged(self, spread):
        return self

    def doubles(self, same_points):
        return len(self.weights) * sum(self.weights.shape[1:])

    def times(self, factor):
        return LinearPaths(self.weights * factor[..., None, :], self.centre)

    def about(self, centre: Vector) -> LinearPaths:
        """Return the same functions with another centre."""
        weights = self.weights.copy()
        weights[:, 0] += np.tensordot(centre - self.centre, self.weights[:, 1:], axes=(0, 1))
        return LinearPaths(weights, centre)

    def each(self, X):
        return (X - self.centre) @ self.weights[:, 1:] + self.weights[:, :1]

    def gradient(self, X):
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


class Basis(Protocol):
    """Functions of the regressors that add up to paths."""

    def __call__(self, X: Matrix) -> Matrix:
        """Return all functions at X (n, d), (n, C)."""

    def slopes(self, X: Array, weights: list[Matrix], columns: list[slice]) -> Array:
        """Return the slopes at X (S or 1, n, d) of sums of some functions for each output, (S, n, P, d).

        ``weights`` (S, c) belong to the functions in the columns of each output.
        """

    def averaged(self, spread: Vector) -> Basis | None:
        """Return the expected functions over a perturbation as of `PathBundle.averaged`, None without a formula."""


class BasisPaths(PathBundle):
    """Functions of a basis times weights (S, c) of each output, for the functions in its columns."""

    def __init__(self, basis: Basis, weights: list[Matrix], columns: list[slice]) -> None:
        self.basis = basis
        self.columns = columns
        self._all_weights = np.concatenate(weights, axis=1)
        self._starts = [places.start for places in columns]
        # `reduceat` has no sums of no functions
        self._is_dense = all(places.stop > places.start for places in columns)

    @property
    def weights(self) -> list[Matrix]:
        """The weights (S, c) of each output."""
        return [self._all_weights[:, columns] for columns in self.columns]

    def times(self, factor):
        factors = np.moveaxis(factor, -1, 0)[..., None]
        weights = [w * f for w, f in zip(self.weights, factors, strict=True)]
        return BasisPaths(self.basis, weights, self.columns)

    def averaged(self, spread):
        basis = self.basis.averaged(spread)
        if basis is None:
            return super().averaged(spread)
        return BasisPaths(basis, self.weights, self.columns)

    def doubles(self, same_points):
        return (1 if same_points else len(self.weights[0])) * self.columns[-1].stop

    def each(self, X):
        A = self.basis(X.reshape(-1, X.shape[-1]))
        A = A.reshape(*X.shape[:2], A.shape[-1])
        if self._is_dense and A.shape[:2] == (len(self._all_weights), 1):
            # a step of a simulation
            A *= self._all_weights[:, None]
            return np.add.reduceat(A, self._starts, axis=-1)
        outputs = zip(self.columns, self.weights, strict=True)
        return np.stack([contract(A[..., columns], c) for columns, c in outputs], axis=-1)

    def gradient(self, X):
        return self.basis.slopes(X, self.weights, self.columns)


def _with_one_basis(parts: Sequence[PathBundle]) -> list[PathBundle]:
    """Return the parts of a sum, where those of Gaussian functions are one bundle."""
    based: list[BasisPaths] = []
    others: list[PathBundle] = []
    for part in parts:
        if isinstance(part, BasisPaths) and isinstance(part.basis, GaussianBasis):
            based.append(part)
        else:
            others.append(part)
    if based:
        others.append(_joined_bases(based))
    return others


def _joined_bases(parts: Sequence[BasisPaths]) -> BasisPaths:
    """Return the sum of functions of Gaussian bases, which have no gains, with those of each output side by side."""
    bases: list[GaussianBasis] = []
    weights: list[Matrix] = []
    for i in range(len(parts[0].columns)):
        of_output = []
        for part in parts:
            basis = cast(GaussianBasis, part.basis).part(part.columns[i])
            of_output.append(part.weights[i] * basis.gain)
            bases.append(GaussianBasis(np.ones(len(basis.gain)), basis.precision, basis.centres))
        weights.append(np.concatenate(of_output, axis=1))
    joined = GaussianBasis.joined(bases[0].centres.shape[1], bases)
    return BasisPaths(joined, weights, consecutive([w.T for w in weights]))


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

    def rounded(self):
        return Waves(
            self.omega.astype(np.float32),
            self.phase.astype(np.float32),
            self.weights.astype(np.float32),
        )

    def averaged(self, spread):
        # the characteristic function of the normal distribution
        damping = np.exp(-0.5 * spread**2 @ self.omega**2).astype(self.omega.dtype)
        return Waves(self.omega, self.phase, self.weights * damping[:, None])

    def doubles(self, same_points):
        return len(self.omega) * self.omega.shape[2]

    def _arguments(self, X):
        """Return the arguments of the waves, (S, n, C)."""
        x = X.astype(self.omega.dtype) @ self.omega
        x += self.phase
        return x

    def each(self, X):
        wave = _cosine(self._arguments(X))
        return (self.weights @ wave.swapaxes(1, 2)).swapaxes(1, 2).astype(float)

    def gradient(self, X):
        wave = _negative_sine(self._arguments(X))
        of_outputs = wave[:, :, None] * self.weights[:, None]
        return (of_outputs @ self.omega.swapaxes(1, 2)[:, None]).astype(float)

    def of_outputs(self, n_outputs: int) -> Waves:
        """Return the paths of the first outputs."""
        return Waves(self.omega, self.phase, self.weights[:, :n_outputs])


def _cosine(x: Array) -> Array:
    """Return cos(x) in the memory of x.

    NumPy's sine and cosine are vectorised in single precision. In double precision its tangent is
    ten times as fast: cos(x) = 2 / (1 + tan(x / 2)^2) - 1.
    """
    if x.dtype == np.float32:
        return np.cos(x, out=x)
    x *= 0.5
    tangent = np.tan(x, out=x)
    tangent *= tangent
    tangent += 1.0
    cosine = np.divide(2.0, tangent, out=tangent)
    cosine -= 1.0
    return cosine


def _negative_sine(x: Array) -> Array:
    """Return -sin(x) in the memory of x, as `_cosine`."""
    if x.dtype == np.float32:
        return np.negative(np.sin(x, out=x), out=x)
    x *= 0.5
    tangent = np.tan(x, out=x)
    return -2.0 * tangent / (1.0 + tangent * tangent)
