"""Processes as finitely many variables: sample paths of kernels, and the inducing variables of sparse inference.

Sample paths are functions of the regressors with random coefficients. Inducing variables are called
features. Columns of X, which scikit-learn calls features, are called regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property, reduce, singledispatch
from operator import add
from typing import Any, Protocol, cast

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp, ndtri
from scipy.stats.qmc import Sobol

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Seed, Vector
from skdgp.kernels._base import MultiOutputKernel, Rescaled, Sum
from skdgp.kernels._convolved import ConvolvedGaussian, Filters
from skdgp.kernels._gaussian_filters import GaussianBasis
from skdgp.kernels._trend import LinearTrend

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

    def take(self, index: slice | np.ndarray) -> PathBundle:
        """Return some of the functions; a mixture takes the ones that it needs."""
        raise NotImplementedError

    @abstractmethod
    def doubles(self, same_points: bool) -> int:
        """Return the working memory for one point of each function, in doubles."""

    def rounded(self) -> PathBundle:
        """Return the functions as simulations evaluate them, with errors 1e-6 of the prior.

        Waves are of single precision, and the Gaussian functions of all terms one basis.
        """
        return self

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

    def mixed(self, others: list[PathBundle], member: np.ndarray) -> PathBundle:
        """Return S functions with outputs of this bundle, where ``member`` (S, P) is 0, or of another.

        Linear parts of all bundles become one.
        """
        parts: list[PathBundle] = []
        bundles: list[PathBundle] = []
        # numbers among the bundles that are not linear, -1 for none
        number = np.full(member.shape, -1)
        for k, bundle in enumerate([self, *others]):
            is_member = member == k
            curved = [part for part in bundle.summands() if not isinstance(part, LinearPaths)]
            for part in bundle.summands():
                if isinstance(part, LinearPaths):
                    parts.append(LinearPaths(part.weights * is_member[:, None], part.centre))
            if curved and is_member.any():
                number[is_member] = len(bundles)
                bundles.append(summed(curved).take(is_member.any(axis=1)))
        if bundles:
            parts.append(MixedPaths(bundles, number))
        return summed(parts)

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

    def take(self, index):
        return MeanPaths(self.paths.take(index), self.moves)

    def averaged(self, spread):
        return MeanPaths(self.paths.averaged(spread), self.moves)

    def doubles(self, same_points):
        return self.paths.doubles(same_points)

    def each(self, X):
        return self._mean(self.paths.each, X)

    def gradient(self, X):
        return self._mean(self.paths.gradient, X)

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

    def take(self, index):
        return SumPaths([part.take(index) for part in self.parts])

    def rounded(self):
        return SumPaths(_with_one_basis([part.rounded() for part in self.parts]))

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

    def take(self, index):
        return LinearPaths(self.weights[index], self.centre)

    def averaged(self, spread):
        return self

    def doubles(self, same_points):
        return len(self.weights) * sum(self.weights.shape[1:])

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
    """Return the sums of functions: linear ones first, as one bundle, then waves along single regressors."""
    linear = [part for part in parts if isinstance(part, LinearPaths)]
    single = [part for part in parts if isinstance(part, SingleWaves)]
    others = [part for part in parts if not isinstance(part, LinearPaths | SingleWaves)]
    if single:
        others.insert(0, SingleWaves.joined(single))
    if linear:
        centre = linear[0].centre
        weights = [part.about(centre).weights for part in linear]
        others.insert(0, LinearPaths(np.sum(weights, axis=0), centre))
    return others[0] if len(others) == 1 else SumPaths(others)


class RescaledPaths(PathBundle):
    """Paths whose outputs are multiplied by factors (P,)."""

    def __init__(self, paths: PathBundle, factor: Vector):
        self.paths = paths
        self.factor = factor

    def take(self, index):
        return RescaledPaths(self.paths.take(index), self.factor)

    def rounded(self):
        return RescaledPaths(self.paths.rounded(), self.factor)

    def averaged(self, spread):
        return RescaledPaths(self.paths.averaged(spread), self.factor)

    def doubles(self, same_points):
        return self.paths.doubles(same_points)

    def each(self, X):
        return self.paths.each(X) * self.factor

    def gradient(self, X):
        return self.paths.gradient(X) * self.factor[:, None]


class MixedPaths(PathBundle):
    """Functions that take each output from one of several bundles, or are zero.

    ``member`` (S, P) is the number of the bundle that each output of each function is taken from, -1 for zero. A
    bundle holds the functions that need it, in their order, whose numbers are ``rows``.
    """

    def __init__(self, bundles: list[PathBundle], member: np.ndarray):
        self.bundles = bundles
        self.member = member
        self.rows = [np.flatnonzero((member == k).any(axis=1)) for k in range(len(bundles))]

    def rounded(self):
        return MixedPaths([bundle.rounded() for bundle in self.bundles], self.member)

    def averaged(self, spread):
        return MixedPaths([bundle.averaged(spread) for bundle in self.bundles], self.member)

    def doubles(self, same_points):
        needed = zip(self.bundles, self.rows, strict=True)
        return max(bundle.doubles(same_points) for bundle, rows in needed if len(rows))

    def each(self, X):
        values = np.zeros((len(self.member), X.shape[1], self.member.shape[1]))
        return self._fill(values, X, [bundle.each for bundle in self.bundles])

    def gradient(self, X):
        slopes = np.zeros((len(self.member), X.shape[1], *self.member.shape[1:], X.shape[-1]))
        return self._fill(slopes, X, [bundle.gradient for bundle in self.bundles])

    def _fill(self, values, X, functions):
        """Add the outputs of all functions, each from the bundle that it is taken from."""
        for k, (evaluate, rows) in enumerate(zip(functions, self.rows, strict=True)):
            if len(rows):
                of_bundle = evaluate(X if len(X) == 1 else X[rows])
                is_taken = (self.member[rows] == k)[:, None]
                is_taken = is_taken.reshape(is_taken.shape + (1,) * (values.ndim - 3))
                values[rows] += np.where(is_taken, of_bundle, 0.0)
        return values


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
        self.weights = weights
        self.columns = columns

    def take(self, index):
        return BasisPaths(self.basis, [w[index] for w in self.weights], self.columns)

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
    if len(based) > 1:
        others.append(_joined_bases(based))
        return others
    return list(parts)


def _joined_bases(parts: Sequence[BasisPaths]) -> BasisPaths:
    """Return the sum of functions of several Gaussian bases, with the functions of each output side by side."""
    bases: list[GaussianBasis] = []
    weights: list[Matrix] = []
    for i in range(len(parts[0].columns)):
        for part in parts:
            basis = cast(GaussianBasis, part.basis)
            bases.append(basis.part(part.columns[i]))
        weights.append(np.concatenate([part.weights[i] for part in parts], axis=1))
    joined = GaussianBasis.joined(bases[0].centres.shape[1], bases)
    return BasisPaths(joined, weights, consecutive([w.T for w in weights]))


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

    def take(self, index):
        return FeaturePaths(self.features, self.coefficients[index])


def contract(A: Array, c: Matrix) -> Array:
    """Return the sums over the last axis of A (..., S, n, C), or (..., 1, n, C), times c (S, C): (..., S, n)."""
    if A.shape[-3] == 1:
        return c @ A[..., 0, :, :].swapaxes(-2, -1)
    return (A @ c[..., None])[..., 0]


# -- samples of the prior: sums of waves with random frequencies
# --------------------------------------------


class Waves(PathBundle):
    """Sums of waves: each cosine is computed once for all outputs of its latent.

    ``omega`` is (S, k, C), ``phase`` (S, 1, C), ``weights`` (S, P, C). Waves run along the k
    regressors with the numbers ``along``.
    """

    def __init__(self, omega: Any, phase: Any, weights: Any, along: Indices) -> None:
        self.omega = omega
        self.phase = phase
        self.weights = weights
        self.along = along
        self._half_omega = 0.5 * omega
        self._half_phase = 0.5 * phase
        self._sum = weights.sum(axis=2)[:, None]

    def take(self, index):
        return Waves(self.omega[index], self.phase[index], self.weights[index], self.along)

    def rounded(self):
        omega = self.omega.astype(np.float32)
        phase = self.phase.astype(np.float32)
        return Waves(omega, phase, self.weights.astype(np.float32), self.along)

    def averaged(self, spread):
        # the characteristic function of the normal distribution
        damping = np.exp(-0.5 * spread[self.along] ** 2 @ self.omega**2).astype(self.omega.dtype)
        return Waves(self.omega, self.phase, self.weights * damping[:, None], self.along)

    def doubles(self, same_points):
        return len(self.omega) * self.omega.shape[2]

    def _tangents(self, X):
        """Return tan(x / 2) of the arguments x of the waves, (S, n, C)."""
        half = X[..., self.along].astype(self.omega.dtype) @ self._half_omega
        half += self._half_phase
        return np.tan(half, out=half)

    def each(self, X):
        wave = _raised_cosine(self._tangents(X))
        values = (self.weights @ wave.swapaxes(1, 2)).swapaxes(1, 2)
        return (values - self._sum).astype(float)

    def gradient(self, X):
        wave = _negative_sine(self._tangents(X))
        of_outputs = wave[:, :, None] * self.weights[:, None]
        slopes = np.zeros((*of_outputs.shape[:3], X.shape[-1]))
        slopes[..., self.along] = of_outputs @ self.omega.swapaxes(1, 2)[:, None]
        return slopes

    def of_outputs(self, feeds: Mask, latent: Indices) -> PathBundle:
        """Return the paths of the first P outputs, which latents feed, (M, P), of waves of these latents (C,).

        Waves along a single regressor that each feed a single output need less memory.
        """
        weights = self.weights[:, : feeds.shape[1]]
        fed = feeds[latent]
        n_waves = fed.sum(axis=0)
        is_private = fed.sum(axis=1).max() == 1 and n_waves.min() == n_waves.max()
        if len(self.along) > 1 or not is_private:
            return Waves(self.omega, self.phase, weights, self.along)
        places = np.stack([np.flatnonzero(of_output) for of_output in fed.T])
        outputs = np.arange(len(places))[:, None]
        return SingleWaves(
            self.omega[:, 0, places],
            self.phase[:, 0, places],
            weights[:, outputs, places],
            np.repeat(self.along, places.shape[1]),
        )


class SingleWaves(PathBundle):
    """Sums of waves along single regressors, W for each output.

    ``omega``, ``phase`` and ``weights`` are (S, P, W), ``along`` (W,) the numbers of the regressors.
    """

    def __init__(self, omega: Any, phase: Any, weights: Any, along: Indices) -> None:
        self.omega = omega
        self.phase = phase
        self.weights = weights
        self.along = along
        self._half_omega = 0.5 * omega
        self._half_phase = 0.5 * phase
        self._sum = weights.sum(axis=2)[:, None]

    @classmethod
    def joined(cls, parts: Sequence[SingleWaves]) -> SingleWaves:
        """Return the sums of functions."""
        return cls(
            np.concatenate([part.omega for part in parts], axis=2),
            np.concatenate([part.phase for part in parts], axis=2),
            np.concatenate([part.weights for part in parts], axis=2),
            np.concatenate([part.along for part in parts]),
        )

    def take(self, index):
        return SingleWaves(self.omega[index], self.phase[index], self.weights[index], self.along)

    def rounded(self):
        omega = self.omega.astype(np.float32)
        phase = self.phase.astype(np.float32)
        return SingleWaves(omega, phase, self.weights.astype(np.float32), self.along)

    def averaged(self, spread):
        # the characteristic function of the normal distribution
        damping = np.exp(-0.5 * (spread[self.along] * self.omega) ** 2).astype(self.omega.dtype)
        return SingleWaves(self.omega, self.phase, self.weights * damping, self.along)

    def doubles(self, same_points):
        return self.omega.size

    def _tangents(self, X):
        """Return tan(x / 2) of the arguments x of the waves, (S, n, P, W)."""
        x = X.astype(self.omega.dtype)[..., None, self.along]
        half = x * self._half_omega[:, None]
        half += self._half_phase[:, None]
        return np.tan(half, out=half)

    def each(self, X):
        wave = _raised_cosine(self._tangents(X))
        values = np.einsum("snpw,spw->snp", wave, self.weights)
        return (values - self._sum).astype(float)

    def gradient(self, X):
        slopes = _negative_sine(self._tangents(X))
        slopes *= (self.weights * self.omega)[:, None]
        is_along = np.equal.outer(self.along, np.arange(X.shape[-1]))
        return (slopes @ is_along.astype(slopes.dtype)).astype(float)


def _raised_cosine(tangent: Array) -> Array:
    """Return cos(x) + 1 = 2 / (1 + tan(x / 2)^2) in the memory of tan(x / 2).

    NumPy's tangent is vectorised in both precisions, and of double precision ten times as fast as
    its sine and cosine.
    """
    tangent *= tangent
    tangent += 1.0
    return np.divide(2.0, tangent, out=tangent)


def _negative_sine(tangent: Array) -> Array:
    """Return -sin(x) of tan(x / 2)."""
    return -2.0 * tangent / (1.0 + tangent * tangent)


def draw_waves(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> tuple[Waves, Indices]:
    r"""Return sample paths of a ConvolvedGaussian and the latent of each wave, (C,).

    There are F waves for each of S paths of every latent, A_i = 2 L_i^-2.

    The spectral density of h_i * x is the Gaussian N_i = N(0, L_i^-2), so samples are

    .. math:: w_i \sum_k \sqrt{\frac{N_i(\omega_k)}{F q(\omega_k)}}
              \big(g_k \cos \omega_k^T (s - \mu_i) + g'_k \sin \omega_k^T (s - \mu_i)\big),
              \quad g_k, g'_k \sim N(0, 1).

    These are the random features of Rahimi & Recht (2007) for several outputs at once. q is the
    mixture of the N_i of all c outputs of the latent. Frequencies are stratified over its
    components, so the weights are bounded (the balance heuristic of Veach & Guibas 1995). Every
    path has new frequencies, so paths have the moments of the prior for any number of
    frequencies, at least c. Those of functions of a single regressor are stratified in size too,
    so a quarter of them makes paths as Gaussian.
    """
    along = np.flatnonzero(~kernel.without_effect(kernel.n_features))
    if len(along) == 1:
        n_frequencies = n_frequencies // 4
    filters = kernel.filters.of_regressors(along)
    unit = np.eye(filters.feeds.shape[1])
    S = n_paths
    F = max(n_frequencies, int(filters.feeds.sum(axis=1).max()))
    omegas, phases, weights, latents = [], [], [], []
    for m, feeds in enumerate(filters.feeds):
        i = np.flatnonzero(feeds)
        amplitude = filters.amplitude[m, i]
        shift = filters.shift[m, i]
        lengths = filters.length_scale[m, i]
        component = np.arange(F) % len(i)
        omega = _frequencies(S, component, lengths, random_state)
        log_density = np.log(lengths).sum(axis=1) - 0.5 * omega**2 @ (lengths**2).T
        counts = np.bincount(component)
        log_mixture = logsumexp(log_density, axis=2, b=counts, keepdims=True)  # log(F q)
        gain = amplitude * np.exp(0.5 * (log_density - log_mixture))
        # the length of (g, g'); the phase is its direction
        gain *= random_state.rayleigh(size=(S, F, 1))
        # the phase of the first output, and differences of the others
        turn = omega @ shift.T
        phase = random_state.uniform(0.0, 2 * np.pi, (S, F)) - turn[..., 0]
        turn -= turn[..., :1].copy()
        omegas.append(omega)
        phases.append(phase)
        weights.append((gain * np.cos(turn)) @ unit[i])
        latents += [m] * F
        if turn.any():  # cos(a - turn) = cos(a) cos(turn) + sin(a) sin(turn)
            omegas.append(omega)
            phases.append(phase - 0.5 * np.pi)
            weights.append((gain * np.sin(turn)) @ unit[i])
            latents += [m] * F
    omega = np.concatenate(omegas, axis=1).swapaxes(1, 2).copy()
    phase = np.concatenate(phases, axis=1)[:, None]
    drawn = np.concatenate(weights, axis=1).swapaxes(1, 2).copy()
    return Waves(omega, phase, drawn, along), np.array(latents)


def draw_waves_of_one_width(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> Waves:
    """Return sample paths of independent outputs whose filters have one width, with the frequencies of `draw_waves`.

    Outputs share F frequencies, and each has cosines and sines of its own normal weights. So each is
    distributed as with frequencies of its own, no two correlate, and P outputs need 2 F waves, not P F.
    """
    along = np.flatnonzero(~kernel.without_effect(kernel.n_features))
    filters = kernel.filters.of_regressors(along)
    amplitude = np.sum(filters.amplitude, axis=0, where=filters.feeds)
    width = filters.length_scale[filters.feeds][0]
    shape = (n_paths, n_frequencies)
    omega = random_state.standard_normal((*shape, len(along))) / width
    phase = random_state.uniform(0.0, 2 * np.pi, shape)
    normal = random_state.standard_normal((n_paths, len(amplitude), 2 * n_frequencies))
    return Waves(
        np.concatenate([omega, omega], axis=1).swapaxes(1, 2).copy(),
        np.concatenate([phase, phase - 0.5 * np.pi], axis=1)[:, None],
        amplitude[:, None] / np.sqrt(n_frequencies) * normal,
        along,
    )


def _has_one_width(filters: Filters) -> bool:
    """Return whether each latent feeds one output, each output is fed by one, and all widths are equal."""
    feeds = filters.feeds
    is_private = (feeds.sum(axis=0) == 1).all() and (feeds.sum(axis=1) == 1).all()
    widths = filters.length_scale[feeds]
    return bool(is_private and (widths == widths[0]).all())


def _frequencies(n_paths: int, component: Indices, lengths: Matrix, random_state: Any) -> Array:
    """Return frequencies (n_paths, F, k) of the ``component`` (F,) of filters with these lengths (c, k)."""
    if lengths.shape[1] == 1:
        normal = _stratified_normal(n_paths, component, random_state)
    else:
        normal = random_state.standard_normal((n_paths, len(component), lengths.shape[1]))
    return normal / lengths[component]


def _stratified_normal(n_paths: int, component: Indices, random_state: Any) -> Array:
    """Return absolute values of normal numbers, (n_paths, F, 1), stratified over each ``component`` (F,)."""
    place = np.empty(len(component))
    size = np.empty(len(component))
    for c in np.unique(component):
        of_component = component == c
        size[of_component] = of_component.sum()
        place[of_component] = np.arange(of_component.sum())
    above = size - place - random_state.uniform(size=(n_paths, len(component)))
    return -ndtri(0.5 * above / size)[..., None]


# -- paths of a kernel
# ---------------------------------------------------------------------------------------------------


@singledispatch
def prior_paths(
    kernel: MultiOutputKernel, n_paths: int, n_frequencies: int, random_state: Seed
) -> PathBundle:
    """Return sample paths of the prior.

    ``prior_paths.register`` adds a class of kernels. Raises NotImplementedError for others.

    Parameters
    ----------
    kernel : MultiOutputKernel
    n_paths : int
    n_frequencies : int
        Number of waves for each latent process.
    random_state : RandomState

    Returns
    -------
    PathBundle
    """
    raise NotImplementedError(
        f"Got a {type(kernel).__name__}, but expected a kernel with sample paths. "
        "Use sample_y, or register paths of this class with skdgp.kernels.prior_paths."
    )


def has_prior_paths(kernel: MultiOutputKernel) -> bool:
    """Return whether sample paths are registered for the class of every term of a kernel."""
    missing = prior_paths.dispatch(object)
    for term in kernel.summands():
        original = term.kernel if isinstance(term, Rescaled) else term
        if prior_paths.dispatch(type(original)) is missing:
            return False
    return True


@prior_paths.register
def _(kernel: ConvolvedGaussian, n_paths, n_frequencies, random_state):
    filters = kernel.filters
    if _has_one_width(filters) and len(kernel.term_regressors()[0]) > 1:
        return draw_waves_of_one_width(kernel, n_paths, n_frequencies, random_state)
    waves, latent = draw_waves(kernel, n_paths, n_frequencies, random_state)
    return waves.of_outputs(filters.feeds, latent)


@prior_paths.register
def _(kernel: Rescaled, n_paths, n_frequencies, random_state):
    paths = prior_paths(kernel.kernel, n_paths, n_frequencies, random_state)
    return RescaledPaths(paths, np.asarray(kernel.factor))


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)


# Variance of white noise in the inducing variables, over their variance; the bound remains a bound
JITTER = 1e-6
# Inducing inputs of a term of a single regressor
ADDITIVE_POINTS = 8


class Features(ABC):
    """K variables u that are jointly Gaussian with the outputs, with covariances Kuu (K, K) and Kfu.

    Their inducing inputs change the quality of the approximation, not the model.
    """

    kernel: MultiOutputKernel
    size: int
    #: Arguments of the constructor behind the kernel
    arguments: tuple = ()

    def rebuild(self, kernel: MultiOutputKernel) -> Features:
        """Return the features of another kernel of the same shape, with the same inducing inputs."""
        return type(self)(kernel, *self.arguments)  # type: ignore[call-arg]

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
    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        """Return dKfu / dX, (d, n, c_i)."""

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

    def __init__(
        self,
        kernel: MultiOutputKernel,
        Z: Sequence[Matrix],
        joint: MultiOutputKernel | None = None,
    ) -> None:
        first = 0 if joint is None else kernel.n_outputs
        self.kernel = kernel
        self.joint = joint or kernel
        self.arguments = (Z,)
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
        np.einsum("ii->i", K)[:] *= 1.0 + JITTER
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
        """Return the variables (S, K) of paths of ``joint``, with white noise of variance JITTER."""
        blocks = list(zip(self.outputs, self.Z, strict=True))
        # blocks with the same inputs share the values of all outputs there
        # single precision is exact enough beside the noise of variance JITTER
        rounded = paths.rounded()
        values = {id(z): rounded.values(z[None]) for z in {id(z): z for z in self.Z}.values()}
        u = np.hstack([values[id(z)][..., f] for f, z in blocks])
        variance = np.concatenate([self.joint.block_diag(f, z) for f, z in blocks])
        return u + np.sqrt(JITTER * variance) * random_state.standard_normal(u.shape)

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
        super().__init__(kernel, Z, ConvolvedGaussian(regressors=kernel.regressors, **arrays))
        self.arguments = Z, width
        self.blocks = [np.flatnonzero(fed).tolist() for fed in filters.feeds.T]

    def __reduce__(self):
        return LatentFeatures, (self.kernel, *self.arguments)  # without the bases

    @cached_property
    def _bases(self) -> list[GaussianBasis]:
        """The functions of each output, one for each variable, as a variable has a single latent."""
        return [self._basis_of(i) for i in range(self.kernel.n_outputs)]

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        return self._bases[i](X)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        waves, latent = draw_waves(self.joint, n_paths, n_frequencies, random_state)
        u = self._values_of(waves, random_state)
        return waves.of_outputs(self.kernel.filters.feeds, latent), u


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

    def Kfu_derivative(self, i, X):
        slopes = self.kernel.basis_slopes(i)
        return np.broadcast_to(slopes, (len(slopes), len(X), self.n_weights))

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

    def rebuild(self, kernel):
        return SumFeatures(self.first.rebuild(kernel.k1), self.second.rebuild(kernel.k2))

    def summands(self):
        return [*self.first.summands(), *self.second.summands()]

    def columns(self, i):
        return np.concatenate([self.first.columns(i), self.first.size + self.second.columns(i)])

    def Kuu(self):
        return block_diag(self.first.Kuu(), self.second.Kuu())

    def Kfu(self, i, X):
        return np.hstack([self.first.Kfu(i, X), self.second.Kfu(i, X)])

    def Kfu_derivative(self, i, X):
        first = self.first.Kfu_derivative(i, X)
        return np.concatenate([first, self.second.Kfu_derivative(i, X)], axis=-1)

    def prior_paths(self, *args):
        first, u = self.first.prior_paths(*args)
        second, v = self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])


class RescaledFeatures(Features):
    """The features of a kernel whose outputs are multiplied by factors."""

    def __init__(self, kernel: Rescaled, features: Features):
        self.kernel = kernel
        self.features = features
        self.size = features.size

    def rebuild(self, kernel):
        return RescaledFeatures(kernel, self.features.rebuild(kernel.kernel))

    def columns(self, i):
        return self.features.columns(i)

    def Kuu(self):
        return self.features.Kuu()

    def Kfu(self, i, X):
        return self.kernel.factor[i] * self.features.Kfu(i, X)

    def Kfu_derivative(self, i, X):
        return self.kernel.factor[i] * self.features.Kfu_derivative(i, X)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        paths, u = self.features.prior_paths(n_paths, n_frequencies, random_state)
        return RescaledPaths(paths, np.asarray(self.kernel.factor)), u


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
    Z = _thinned(Z, kernel.without_effect(Z.shape[1]))
    return LatentFeatures(kernel, [Z] * len(width), width)


@inducing_features.register
def _(kernel: LinearTrend, Z):
    return TrendFeatures(kernel)


@inducing_features.register
def _(kernel: Rescaled, Z):
    return RescaledFeatures(kernel, inducing_features(kernel.kernel, Z))


@inducing_features.register
def _(kernel: Sum, Z):
    return SumFeatures(inducing_features(kernel.k1, Z), inducing_features(kernel.k2, Z))


def _thinned(Z, without_effect):
    """Return inducing inputs for functions of a single regressor: fewer than the given ones."""
    used = np.flatnonzero(~without_effect)
    if len(used) > 1 or len(Z) <= ADDITIVE_POINTS or len(without_effect) == 1:
        return Z
    chosen = np.tile(Z.mean(axis=0), (ADDITIVE_POINTS, 1))
    column = Z[:, used[0]]
    chosen[:, used[0]] = np.linspace(column.min(), column.max(), ADDITIVE_POINTS)
    return chosen


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
