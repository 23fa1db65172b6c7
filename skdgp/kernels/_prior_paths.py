"""Sample paths of the prior: functions of the regressors with random coefficients."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import singledispatch

import numpy as np
from scipy.special import logsumexp

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Seed
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._gaussian_filters import CovarianceColumns

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
    def take(self, index: slice | np.ndarray) -> PathBundle:
        """Return some of the functions."""

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


class MixedPaths(PathBundle):
    """Functions that take each output from one of several bundles.

    ``member`` (S, P) is the number of the bundle that each output of each function is taken from. A
    bundle holds the functions that need it, in their order, whose numbers are ``rows``.
    """

    def __init__(self, bundles: list[PathBundle], member: np.ndarray):
        self.bundles, self.member = bundles, member
        self.rows = [np.flatnonzero((member == k).any(axis=1)) for k in range(len(bundles))]

    def take(self, index):
        wanted = np.arange(len(self.member))[index]
        held = [wanted[np.isin(wanted, own)] for own in self.rows]
        bundles = [
            bundle.take(np.searchsorted(own, new))
            for bundle, own, new in zip(self.bundles, self.rows, held, strict=True)
        ]
        return MixedPaths(bundles, self.member[index])

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
        weights = self.weights.swapaxes(1, 2)
        return (wave[:, :, None] * weights[:, None]) @ turned


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
        f"Got a {type(kernel).__name__}, but expected a kernel with sample paths: register them "
        "with skdgp.kernels.prior_paths, or use sample_y, which draws values at given points."
    )


prior_paths.register(ConvolvedGaussian, draw_waves)


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)
