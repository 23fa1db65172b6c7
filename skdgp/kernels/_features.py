"""Processes as finitely many variables: sample paths of kernels, and the inducing variables of sparse inference.

Sample paths are functions of the regressors with random coefficients. Inducing variables are called
features. Columns of X, which scikit-learn calls features, are called regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import reduce, singledispatch
from itertools import pairwise
from operator import add
from typing import Any, cast

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.kernels._base import MultiOutputKernel, Rescaled, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._gaussian_filters import CovarianceColumns
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
        """Return some of the functions, of which a mixture takes those that it needs."""
        raise NotImplementedError

    @abstractmethod
    def doubles(self, same_points: bool) -> int:
        """Return the working memory for one point of each function, in doubles."""

    def __add__(self, other: PathBundle) -> SumPaths:
        return SumPaths(self, other)

    def mixed(self, others: list[PathBundle], member: np.ndarray) -> MixedPaths:
        """Return S functions with outputs of this bundle, where ``member`` (S, P) is 0, or of another."""
        taken = [bundle.take((member == k).any(axis=1)) for k, bundle in enumerate([self, *others])]
        return MixedPaths(taken, member)

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
    return np.concatenate(
        [function(X[:, a : a + step]) for a in range(0, X.shape[1], step)], axis=1
    )


class SumPaths(PathBundle):
    """Sums of the paths of independent processes."""

    def __init__(self, first: PathBundle, second: PathBundle):
        self.first, self.second = first, second

    def take(self, index):
        return SumPaths(self.first.take(index), self.second.take(index))

    def doubles(self, same_points):
        return max(self.first.doubles(same_points), self.second.doubles(same_points))

    def each(self, X):
        values = self.first.each(X)
        values += self.second.each(X)
        return values

    def gradient(self, X):
        return self.first.gradient(X) + self.second.gradient(X)


class RescaledPaths(PathBundle):
    """Paths whose outputs are multiplied by factors (P,)."""

    def __init__(self, paths: PathBundle, factor: Vector):
        self.paths, self.factor = paths, factor

    def take(self, index):
        return RescaledPaths(self.paths.take(index), self.factor)

    def doubles(self, same_points):
        return self.paths.doubles(same_points)

    def each(self, X):
        return self.paths.each(X) * self.factor

    def gradient(self, X):
        return self.paths.gradient(X) * self.factor[:, None]


class MixedPaths(PathBundle):
    """Functions that take each output from one of several bundles.

    ``member`` (S, P) is the number of the bundle that each output of each function is taken from. A
    bundle holds the functions that need it, in their order, whose numbers are ``rows``.
    """

    def __init__(self, bundles: list[PathBundle], member: np.ndarray):
        self.bundles, self.member = bundles, member
        self.rows = [np.flatnonzero((member == k).any(axis=1)) for k in range(len(bundles))]

    def doubles(self, same_points):
        return max(
            b.doubles(same_points)
            for b, rows in zip(self.bundles, self.rows, strict=True)
            if len(rows)
        )

    def each(self, X):
        return self._assembled(X, (), "each")

    def gradient(self, X):
        return self._assembled(X, X.shape[-1:], "gradient")

    def _assembled(self, X, slopes, name):
        values = np.empty((len(self.member), X.shape[1], self.member.shape[1], *slopes))
        for k, (bundle, rows) in enumerate(zip(self.bundles, self.rows, strict=True)):
            if len(rows):
                found = getattr(bundle, name)(X if len(X) == 1 else X[rows])
                function, output = np.nonzero(self.member[rows] == k)
                values[rows[function], :, output] = found[function, :, output]
        return values


class FeaturePaths(PathBundle):
    """Covariances with inducing variables, Kfu, times coefficients (S, K)."""

    def __init__(self, features, coefficients):
        self.features, self.coefficients = features, coefficients
        self._rows, variables = features.rows()
        self._columns = consecutive(variables)
        self._weights = [np.ascontiguousarray(coefficients[:, own]) for own in variables]

    def __reduce__(self):
        # Pickle the coefficients only: they are smaller than the weights of all columns.
        return FeaturePaths, (self.features, self.coefficients)

    def take(self, index):
        return FeaturePaths(self.features, self.coefficients[index])

    def doubles(self, same_points):
        return (1 if same_points else len(self.coefficients)) * self._columns[-1].stop

    def each(self, X):
        A = _unflatten_points(self._rows(X.reshape(-1, X.shape[-1])), X)
        pairs = zip(self._columns, self._weights, strict=True)
        return np.stack([contract(A[..., columns], c) for columns, c in pairs], axis=-1)

    def gradient(self, X):
        if isinstance(self._rows, CovarianceColumns):
            A = _unflatten_points(self._rows(X.reshape(-1, X.shape[-1])), X)
            pairs = zip(self._columns, self._weights, strict=True)
            sums = [self._rows.slopes(X, A[..., own] * c[:, None], own) for own, c in pairs]
            return np.stack(sums, axis=2)
        slopes = []
        for i in range(len(self._columns)):
            D = _unflatten_points(self.features.Kfu_derivative(i, X.reshape(-1, X.shape[-1])), X)
            c = self.coefficients[:, self.features.columns(i)]
            slopes.append(np.moveaxis(contract(D, c), 0, -1))
        return np.stack(slopes, axis=2)


def _unflatten_points(A, X):
    """Return A (..., S n, C), computed from the rows of X, in the shape (..., S, n, C)."""
    return A.reshape(*A.shape[:-2], *X.shape[:2], A.shape[-1])


def contract(A, c):
    """Return the sums over the last axis of A (..., S, n, C), or (..., 1, n, C), times c (S, C): (..., S, n)."""
    return c @ A[..., 0, :, :].swapaxes(-2, -1) if A.shape[-3] == 1 else (A @ c[..., None])[..., 0]


# -- samples of the prior: sums of waves with random frequencies
# --------------------------------------------


class Waves(PathBundle):
    """Sums of waves: each cosine is computed once for all outputs of its latent.

    ``omega`` is (S, d, C), ``phase`` (S, 1, C), ``weights`` (S, C, P).
    """

    def __init__(self, omega, phase, weights):
        self.omega, self.phase, self.weights = omega, phase, weights
        self._half = 0.5 * omega, 0.5 * phase
        self._sum = weights.sum(axis=1, keepdims=True)

    def take(self, index):
        return Waves(self.omega[index], self.phase[index], self.weights[index])

    def doubles(self, same_points):
        return len(self.omega) * self.omega.shape[2]

    def each(self, X):
        omega, phase = self._half
        square = X @ omega
        square += phase
        np.tan(square, out=square)  # vectorised in NumPy, and ten times as fast as its cosine
        square *= square
        square += 1.0
        wave = np.divide(2.0, square, out=square)  # cos(2 x) + 1 = 2 / (1 + tan(x)^2)
        return wave @ self.weights - self._sum

    def gradient(self, X):
        wave = -np.sin(X @ self.omega + self.phase)
        turned = self.omega.swapaxes(1, 2)[:, None]
        return (wave[:, :, None] * self.weights.swapaxes(1, 2)[:, None]) @ turned


def draw_waves(kernel, n_paths, n_frequencies, random_state) -> Waves:
    r"""Return sample paths of a ConvolvedGaussian: F waves for each of S paths of every latent, A_i = 2 L_i^-2.

    The spectral density of h_i * x is the Gaussian N_i = N(0, L_i^-2), so samples are

    .. math:: w_i \sum_k \sqrt{\frac{N_i(\omega_k)}{F q(\omega_k)}}
              \big(g_k \cos \omega_k^T (s - \mu_i) + g'_k \sin \omega_k^T (s - \mu_i)\big),
              \quad g_k, g'_k \sim N(0, 1).

    These are the random features of Rahimi & Recht (2007) for several outputs at once. q is the
    mixture of the N_i of all c outputs of the latent. Frequencies are stratified over its
    components, so the weights are bounded (the balance heuristic of Veach & Guibas 1995). Every
    path has new frequencies, so paths have the moments of the prior for any number of
    frequencies, at least c.
    """
    feeds, waves = kernel.value("feeds"), []
    S, F = n_paths, max(n_frequencies, int(feeds.sum(axis=1).max()))
    for m, i in enumerate(map(np.flatnonzero, feeds)):
        amplitude, shift, lengths = (
            kernel.value(name)[m, i] for name in ("amplitude", "shift", "length_scale")
        )
        c, d = shift.shape
        component = np.arange(F) % c
        omega = random_state.standard_normal((S, F, d)) / lengths[component]
        log_density = np.log(lengths).sum(axis=1) - 0.5 * omega**2 @ (lengths**2).T
        log_mixture = logsumexp(
            log_density, axis=2, b=np.bincount(component), keepdims=True
        )  # log(F q)
        gain = amplitude * np.exp(0.5 * (log_density - log_mixture))
        gain *= random_state.rayleigh(
            size=(S, F, 1)
        )  # the length of (g, g'); the phase is its direction
        turn = omega @ shift.T
        # the phase of the first output, and differences of the others
        phase = random_state.uniform(0.0, 2 * np.pi, (S, F)) - turn[..., 0]
        turn -= turn[..., :1].copy()
        unit = np.eye(len(feeds.T))[i]
        waves.append((omega, phase, (gain * np.cos(turn)) @ unit))
        if turn.any():  # cos(a - turn) = cos(a) cos(turn) + sin(a) sin(turn)
            waves.append((omega, phase - 0.5 * np.pi, (gain * np.sin(turn)) @ unit))
    omega, phase, weights = (np.concatenate(part, 1) for part in zip(*waves, strict=True))
    return Waves(omega.swapaxes(1, 2).copy(), phase[:, None], weights)


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
        f"Got a {type(kernel).__name__}, but expected a kernel with sample paths. Use sample_y, or "
        "register paths of this class with skdgp.kernels.prior_paths."
    )


def has_prior_paths(kernel: MultiOutputKernel) -> bool:
    """Return whether sample paths are registered for the class of every term of a kernel."""
    missing = prior_paths.dispatch(object)
    for term in kernel.summands():
        original = term.kernel if isinstance(term, Rescaled) else term
        if prior_paths.dispatch(type(original)) is missing:
            return False
    return True


prior_paths.register(ConvolvedGaussian, draw_waves)


@prior_paths.register
def _(kernel: Rescaled, n_paths, n_frequencies, random_state):
    paths = prior_paths(kernel.kernel, n_paths, n_frequencies, random_state)
    return RescaledPaths(paths, np.asarray(kernel.factor))


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)


# variance of white noise in the inducing variables, over their variance; the bound remains a bound
JITTER = 1e-6
ADDITIVE_POINTS = 8  # inducing inputs of a term of a single regressor


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

    def rows(self) -> tuple[Callable[[Matrix], Matrix], list[Indices]]:
        """Return a function X (n, d) -> A (n, C) for few samples at a time, and the variable of each column.

        A holds the columns of the first output, then of the second; ``variables[i]`` has the
        variable of each column of output i. Columns of one variable and output add up to Kfu.
        """
        outputs = range(self.kernel.n_outputs)
        return (
            lambda X: np.hstack([self.Kfu(i, X) for i in outputs]),
            [self.columns(i) for i in outputs],
        )

    def paths(self, coefficients: Matrix) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""
        return FeaturePaths(self, coefficients)


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
        joint = joint or kernel
        outputs = range(first, joint.n_outputs)
        self.kernel, self.joint, self.outputs, self.arguments = kernel, joint, outputs, (Z,)
        self.Z = [np.asarray(z, dtype=float) for z in Z]
        edges = np.cumsum([0, *map(len, self.Z)])
        self.size = int(edges[-1])
        self._variables = [np.arange(*ends) for ends in pairwise(edges)]
        self.blocks = [list(range(len(self.Z)))] * kernel.n_outputs

    def columns(self, i: int) -> Indices:
        return np.concatenate([np.arange(0), *(self._variables[f] for f in self.blocks[i])])

    def Kuu(self) -> Matrix:
        K, blocks = np.zeros((self.size, self.size)), list(zip(self.outputs, self.Z, strict=True))
        for (f, z), rows in zip(blocks, self._variables, strict=True):
            for (g, x), columns in zip(blocks, self._variables, strict=True):
                if self.joint.couples(f, g):
                    K[np.ix_(rows, columns)] = self.joint.block(f, g, z, x)
        np.einsum("ii->i", K)[:] *= 1.0 + JITTER
        return K

    def Kfu(self, i: int, X: Matrix) -> Matrix:
        blocks = [self.joint.block(i, self.outputs[f], X, self.Z[f]) for f in self.blocks[i]]
        return np.hstack([np.empty((len(X), 0)), *blocks])

    def Kfu_derivative(self, i: int, X: Matrix) -> Array:
        """Return dKfu / dX, (d, n, c_i)."""
        blocks = [
            self.joint.block_derivative(i, self.outputs[f], X, self.Z[f]) for f in self.blocks[i]
        ]
        return np.concatenate([np.empty((*np.shape(X)[::-1], 0)), *blocks], axis=2)

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        paths = prior_paths(self.joint, n_paths, n_frequencies, random_state)
        values = {key: paths.values(z[None]) for key, z in {id(z): z for z in self.Z}.items()}
        u = np.hstack([values[id(z)][..., f] for f, z in zip(self.outputs, self.Z, strict=True)])
        variance = [self.joint.block_diag(f, z) for f, z in zip(self.outputs, self.Z, strict=True)]
        u += np.sqrt(JITTER * np.concatenate(variance)) * random_state.standard_normal(u.shape)
        return paths, u

    def rows(self) -> tuple[Callable[[Matrix], Matrix], list[Indices]]:
        if not isinstance(self.joint, ConvolvedGaussian):
            return super().rows()
        pairs, variables = [], []
        for i, blocks in enumerate(self.blocks):
            of_output = [self.joint.pair(i, self.outputs[f]) for f in blocks]
            pairs += [(pair, self.Z[f]) for pair, f in zip(of_output, blocks, strict=True)]
            tiles = zip(blocks, of_output, strict=True)
            tiled = [np.tile(self._variables[f], len(pair.gain)) for f, pair in tiles]
            variables.append(np.concatenate([np.arange(0), *tiled]))
        columns = CovarianceColumns(self.kernel.n_features, pairs)
        return super().rows() if columns.far else (columns, variables)


class LatentFeatures(ValueFeatures):
    r"""Filtered latents of a convolved Gaussian, u_f(z) = (g_f * x_m)(z), with Gaussian filters g_f and unit variance.

    Such a variable is a further output of the same family (Alvarez et al. 2010). A
    ConvolvedGaussian gives all covariances, with one further output for every block f of
    variables, whose
    filter g_f is a window with length scales ``width`` (M, d). Block m is of latent m, at the
    inducing inputs ``Z[m]``.
    """

    def __init__(self, kernel: ConvolvedGaussian, Z: Sequence[Matrix], width: Matrix) -> None:
        unit = np.eye(len(width))
        further = {"amplitude": unit, "feeds": unit, "length_scale": width}
        arrays: dict[str, Any] = {}
        for name in ("amplitude", "length_scale", "shift", "feeds"):
            value = kernel.value(name)
            shape = len(value), len(value), *value.shape[2:]
            added = np.broadcast_to(further.get(name, 0.0), shape)
            arrays[name] = np.concatenate([value, added], axis=1)
        super().__init__(kernel, Z, ConvolvedGaussian(**arrays))
        self.arguments = Z, width
        self.blocks = [np.flatnonzero(fed).tolist() for fed in kernel.value("feeds").T]

    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state: Any
    ) -> tuple[PathBundle, Matrix]:
        paths, u = super().prior_paths(n_paths, n_frequencies, random_state)
        waves = cast(Waves, paths)
        return Waves(waves.omega, waves.phase, waves.weights[..., : self.kernel.n_outputs]), u


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

    def rows(self):
        outputs = range(self.kernel.n_outputs)
        slopes = np.hstack([self.kernel.basis_slopes(i)[:, 0] for i in outputs])
        constant = np.hstack([self.Kfu(i, np.zeros((1, len(slopes)))) for i in outputs])
        return lambda X: X @ slopes + constant, [self.columns(i) for i in outputs]

    def Kfu_derivative(self, i, X):
        slopes = self.kernel.basis_slopes(i)
        return np.broadcast_to(slopes, (len(slopes), len(X), self.n_weights))

    def prior_paths(self, n_paths, n_frequencies, random_state):
        u = random_state.standard_normal((n_paths, self.size))
        return self.paths(u), u


class SumFeatures(Features):
    """The features of both terms of a sum."""

    def __init__(self, first: Features, second: Features):
        self.first, self.second = first, second
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

    def prior_paths(self, *args):
        (first, u), (second, v) = self.first.prior_paths(*args), self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])


class RescaledFeatures(Features):
    """The features of a kernel whose outputs are multiplied by factors."""

    def __init__(self, kernel: Rescaled, features: Features):
        self.kernel, self.features = kernel, features
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
        features: Any = self.features
        return self.kernel.factor[i] * features.Kfu_derivative(i, X)

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
    w = kernel.value("amplitude")
    weight = np.maximum(w**2, 1e-12) * kernel.value("feeds")
    weight /= weight.sum(axis=1, keepdims=True)
    width = np.exp(np.einsum("mp,mpk->mk", weight, np.log(kernel.value("length_scale"))))
    Z = _thinned(Z, kernel.without_effect(Z.shape[1]))
    return LatentFeatures(kernel, [Z] * len(w), width)


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
    by_output = np.split(coefficients, np.cumsum([len(x) for x in X])[:-1], axis=1)

    def of_term(term):
        if not isinstance(term, LinearTrend):
            return ValueFeatures(term, X).paths(coefficients)
        weights = [c @ term.basis(i, x) for i, (x, c) in enumerate(zip(X, by_output, strict=True))]
        return TrendFeatures(term).paths(np.hstack(weights))

    return reduce(add, map(of_term, kernel.summands()))


@prior_paths.register
def _(kernel: LinearTrend, n_paths, n_frequencies, random_state):
    return TrendFeatures(kernel).prior_paths(n_paths, n_frequencies, random_state)[0]
