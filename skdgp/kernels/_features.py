"""Inducing variables of sparse inference: finitely many variables that represent the processes.

They are called features. Columns of X, which scikit-learn calls features, are called regressors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components
from sklearn.utils import check_random_state

from skdgp._compute.linalg import cluster_centres, pivoted_cholesky
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.kernels._pair import ExponentialRows
from skdgp.kernels._prior_paths import FeaturePaths, PathBundle, TrendPaths, Waves, draw_latents

# variance of white noise in the inducing variables, over their variance; the bound remains a bound
JITTER = 1e-6
CANDIDATES = 2400  # candidates of each latent in a ranking
CLUSTERED = 5000  # largest number of samples for k-means
NEGLIGIBLE = 1e-6  # residual variance at which a ranking stops, relative to the required accuracy


class Features(ABC):
    """K variables u that are jointly Gaussian with the outputs, with covariances Kuu (K, K) and Kfu.

    ``theta`` holds the inducing inputs, one after another. They change the quality of the
    approximation, not the model.
    """

    kernel: Any  # a MultiOutputKernel; its module imports this one
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
    def Kfu(self, i: int, X) -> Matrix:
        """Return cov(y_i(X), u) for the columns of i, (n, c_i)."""

    @abstractmethod
    def Kfu_derivative(self, i: int, X) -> Array:
        """Return dKfu / dX, (d, n, c_i)."""

    @abstractmethod
    def gradient_fu(self, i: int, X, W) -> Vector:
        """Return sum(W * dKfu_i) by [kernel theta, features theta]."""

    @abstractmethod
    def gradient_uu(self, W) -> Vector:
        """Return sum(W * dKuu) by [kernel theta, features theta]; W is symmetric."""

    @abstractmethod
    def rebuild(self, kernel, theta) -> Features:
        """Return the features of another kernel of the same shape, with other inducing inputs."""

    @abstractmethod
    def prior_paths(
        self, n_paths: int, n_frequencies: int, random_state
    ) -> tuple[PathBundle, Matrix]:
        """Return sample paths of the outputs and the values of u (n_paths, K), drawn jointly from the prior."""

    def rows(self) -> Callable[[Matrix], Matrix]:
        """Return a function X (n, d) -> Kfu of all outputs side by side, for few samples at a time."""
        return lambda X: np.hstack([self.Kfu(i, X) for i in range(self.n_outputs)])

    def paths(self, coefficients) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""
        return FeaturePaths(self, coefficients)

    @property
    def theta(self) -> Vector:
        """Inducing inputs, flat; none by default."""
        return np.empty(0)


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

    def gradient_fu(self, i, X, W):
        total, dZ = np.zeros(self.kernel.n_dims), np.zeros_like(self.Z)
        for j, w in zip(
            self._coupled[i], np.split(W, W.shape[1] // len(self.Z), axis=1), strict=True
        ):
            total += self.kernel.block_gradient(i, j, X, self.Z, w)
            dZ += np.einsum("dkn,nk->kd", self.kernel.block_derivative(j, i, self.Z, X), w)
        return np.concatenate([total, dZ.ravel()])

    def gradient_uu(self, W):
        W = W + JITTER * np.diag(np.diag(W))
        total, dZ = np.zeros(self.kernel.n_dims), np.zeros_like(self.Z)
        for i in range(self.kernel.n_outputs):
            for j in self._coupled[i]:
                w = W[self._slice(i), self._slice(j)]
                total += self.kernel.block_gradient(i, j, self.Z, self.Z, w)
                dZ += 2 * np.einsum(
                    "dkn,nk->kd", self.kernel.block_derivative(j, i, self.Z, self.Z), w
                )
        return np.concatenate([total, dZ.ravel()])

    def prior_paths(self, n_paths, n_frequencies, random_state):
        paths = self.kernel.prior_paths(n_paths, n_frequencies, random_state)
        u = paths.values(self.Z[None]).swapaxes(1, 2).reshape(n_paths, -1)
        u += np.sqrt(JITTER * self.kernel.diag(self.Z)) * random_state.standard_normal(u.shape)
        return paths, u

    @property
    def theta(self):
        return self.Z.ravel()

    def rebuild(self, kernel, theta):
        return PointFeatures(kernel, theta.reshape(self.Z.shape))


class LatentFeatures(Features):
    r"""Filtered latents of a convolved Gaussian, u_f(z) = (g_f * x_m)(z), with Gaussian filters g_f and unit variance.

    Such a variable is a further output of the same family (Alvarez et al. 2010). All covariances
    are those of a ConvolvedGaussian with one further output for every block f of variables. There
    are two kinds of filter g_f:

    - a window with length scales ``width`` (F, d): one block for all outputs of the latent;
    - the filter of output i, ``outputs[f] = i``: the block is the contribution of the latent to
      this output. One window cannot represent outputs of different widths well, while this filter
      loses no information about its output.

    Either ``width`` or ``outputs`` is None. Block f is of latent ``latents[f]``, at the inducing
    inputs ``Z[f]``.
    """

    def __init__(self, kernel, latents, Z, width=None, outputs=None):
        self.kernel, self.Z, self.width = kernel, list(Z), width
        self.latents = [int(m) for m in latents]
        self.outputs = None if outputs is None else [int(i) for i in outputs]
        self.joint = self._with_blocks()
        self._edges = np.cumsum([0, *map(len, self.Z)])
        self.size = int(self._edges[-1])
        feeds = kernel._value("feeds").astype(bool)
        self._blocks = [[f for f, m in enumerate(self.latents) if mask[m]] for mask in feeds.T]
        pairs = [(f, g) for f in range(len(self.latents)) for g in range(len(self.latents))]
        self._block_pairs = [(f, g) for f, g in pairs if self.latents[f] == self.latents[g]]

    def __getstate__(self):
        return {
            name: self.__dict__[name] for name in ("kernel", "latents", "Z", "width", "outputs")
        }

    def __setstate__(self, state):
        vars(self).update(vars(LatentFeatures(**state)))

    def _with_blocks(self):
        """Return the kernel with one further output of unit variance for each block."""
        kernel, arrays = self.kernel, {}
        for name in ("amplitude", "length_scale", "shift", "shear", "feeds"):
            value = kernel._value(name)
            if name in ("amplitude", "feeds"):
                extra = np.eye(len(value))[:, self.latents]
            elif self.outputs is not None:
                extra = value[self.latents, self.outputs]
            else:
                extra = (
                    self.width
                    if name == "length_scale"
                    else np.zeros((len(self.latents), value.shape[2]))
                )
            arrays[name] = np.concatenate(
                [value, np.broadcast_to(extra, (len(value), *extra.shape[-value.ndim + 1 :]))],
                axis=1,
            )
        return type(kernel)(
            covariance_type="full" if kernel.covariance_type == "full" else "diag", **arrays
        )

    def _slice(self, f):
        return slice(self._edges[f], self._edges[f + 1])

    def columns(self, i):
        return np.concatenate(
            [np.arange(0), *(np.arange(self.size)[self._slice(f)] for f in self._blocks[i])]
        )

    def Kuu(self):
        P, K = self.kernel.n_outputs, np.zeros((self.size, self.size))
        for f, g in self._block_pairs:
            K[self._slice(f), self._slice(g)] = self.joint.block(P + f, P + g, self.Z[f], self.Z[g])
        np.einsum("ii->i", K)[:] = 1.0 + JITTER
        return K

    def Kfu(self, i, X):
        blocks = [
            self.joint.block(i, self.kernel.n_outputs + f, X, self.Z[f]) for f in self._blocks[i]
        ]
        return np.hstack([np.empty((len(X), 0)), *blocks])

    def Kfu_derivative(self, i, X):
        P, (n, d) = self.kernel.n_outputs, np.shape(X)
        blocks = [self.joint.block_derivative(i, P + f, X, self.Z[f]) for f in self._blocks[i]]
        return np.concatenate([np.empty((d, n, 0)), *blocks], axis=2)

    def rows(self):
        P = self.kernel.n_outputs
        return ExponentialRows(
            self.joint, [[(P + f, self.Z[f]) for f in blocks] for blocks in self._blocks]
        )

    def gradient_fu(self, i, X, W):
        P, blocks = self.kernel.n_outputs, self._blocks[i]
        columns = [
            slice(*edges) for edges in pairwise(np.cumsum([0, *(len(self.Z[f]) for f in blocks)]))
        ]
        return self._collect(
            [
                (f, self.joint.entry_gradients(i, P + f, X, self.Z[f], W[:, own], inputs=True))
                for f, own in zip(blocks, columns, strict=True)
            ]
        )

    def gradient_uu(self, W):
        P, W = self.kernel.n_outputs, W - np.diag(np.diag(W))  # the diagonal of Kuu is constant
        parts = []
        for f, g in self._block_pairs:
            w = W[self._slice(f), self._slice(g)]
            entries, by_input = self.joint.entry_gradients(
                P + f, P + g, self.Z[f], self.Z[g], w, inputs=True
            )
            parts.append((g, (entries, 2 * by_input)))
        return self._collect(parts)

    def _collect(self, parts):
        """Return the gradient by [kernel theta, Z] from those by entries of ``joint`` and inputs of a block each."""
        P, names = self.kernel.n_outputs, ("amplitude", "length_scale", "shift", "shear")
        total, dZ = (
            {name: np.zeros_like(self.joint._value(name)) for name in names},
            [np.zeros_like(z) for z in self.Z],
        )
        for f, (entries, by_input) in parts:
            dZ[f] += by_input
            for name in names:
                total[name] += entries[name]
        for f, i in enumerate(self.outputs or ()):  # blocks have the filters of these outputs
            for name in names[1:]:
                total[name][self.latents[f], i] += total[name][self.latents[f], P + f]
        by_kernel = self.kernel.theta_gradient(
            {name: entries[:, :P] for name, entries in total.items()}
        )
        return np.concatenate([by_kernel, *(z.ravel() for z in dZ)])

    def prior_paths(self, n_paths, n_frequencies, random_state):
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

    @property
    def theta(self):
        return np.concatenate([z.ravel() for z in self.Z])

    def rebuild(self, kernel, theta):
        Z = np.split(theta.reshape(self.size, -1), self._edges[1:-1])
        return LatentFeatures(kernel, self.latents, Z, self.width, self.outputs)


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
        slope = self.kernel._value(
            "slope_scale"
        )  # (P, K); the columns of an output are [tau_0, tau_k (phi_k - c_k)]
        constant = np.column_stack(
            [self.kernel._value("intercept_scale"), -slope * self.kernel._value("center")]
        )
        slopes = np.zeros((slope.shape[1], *constant.shape))
        np.einsum("kik->ik", slopes[:, :, 1:])[:] = slope
        slopes, constant = slopes.reshape(len(slopes), -1), constant.ravel()
        return lambda X: self.kernel.columns(X) @ slopes + constant

    def Kfu_derivative(self, i, X):
        slopes = self.kernel.basis_slopes(i, X)
        return np.broadcast_to(slopes, (len(slopes), len(X), self.n_weights))

    def gradient_fu(self, i, X, W):
        return self.kernel.basis_gradient(i, X, W)

    def gradient_uu(self, W):
        return np.zeros(self.kernel.n_dims)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        u = random_state.standard_normal((n_paths, self.size))
        return self.paths(u), u

    def paths(self, coefficients):
        return TrendPaths(self.kernel, coefficients.reshape(len(coefficients), -1, self.n_weights))

    def rebuild(self, kernel, theta):
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

    def gradient_fu(self, i, X, W):
        n = len(self.first.columns(i))
        return self._ordered(
            self.first.gradient_fu(i, X, W[:, :n]), self.second.gradient_fu(i, X, W[:, n:])
        )

    def gradient_uu(self, W):
        n = self.first.size
        return self._ordered(self.first.gradient_uu(W[:n, :n]), self.second.gradient_uu(W[n:, n:]))

    def prior_paths(self, *args):
        (first, u), (second, v) = self.first.prior_paths(*args), self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])

    def _ordered(self, a, b):
        """Return [kernel theta, features theta] of both terms, kernels first."""
        na, nb = len(a) - len(self.first.theta), len(b) - len(self.second.theta)
        return np.concatenate([a[:na], b[:nb], a[na:], b[nb:]])

    @property
    def theta(self):
        return np.concatenate([self.first.theta, self.second.theta])

    def rebuild(self, kernel, theta):
        n = len(self.first.theta)
        return SumFeatures(
            self.first.rebuild(kernel.k1, theta[:n]), self.second.rebuild(kernel.k2, theta[n:])
        )


# -- placement of inducing variables
# -------------------------------------------------------------------


def rank_parts(kernel, X, scale, random_state) -> Callable[[int], LatentFeatures]:
    """Return a function n -> the best n inducing features.

    Candidates are the contributions of the latents to every output at every sample, weighted by
    amplitude over ``scale`` (P,), the required accuracy. A pivoted Cholesky factorisation of their
    covariance selects in each step the candidate with the largest unexplained variance (Burt et al.
    2020). The selection defines the number of variables of each latent and output. These are then
    placed at centres of k-means in the length scales of that output, which explain more variance
    than the pivots.
    """
    seed = check_random_state(random_state).randint(2**31 - 1)
    random_state = np.random.RandomState(seed)
    X, rankings = np.unique(X, axis=0), []
    for m, outputs in enumerate(map(np.flatnonzero, kernel._value("feeds"))):
        x = X[random_state.permutation(len(X))[: max(1, CANDIDATES // len(outputs))]]
        K = LatentFeatures(kernel, [m] * len(outputs), [x] * len(outputs), outputs=outputs).Kuu()
        weight = np.repeat(kernel._value("amplitude")[m, outputs] / scale[outputs], len(x))
        pivots, gain = pivoted_cholesky(
            np.asfortranarray(K * np.multiply.outer(weight, weight)), NEGLIGIBLE
        )
        gain[0] = np.inf  # every latent, and so every output, has at least one feature
        rankings.append((gain, outputs[pivots // len(x)]))
    order = np.sort(np.concatenate([gain for gain, _ in rankings]))[::-1]
    subset = X[np.sort(random_state.permutation(len(X))[:CLUSTERED])]

    def best(n):
        least = order[min(max(n, len(rankings)), len(order)) - 1]
        latents, outputs, Z = [], [], []
        for m, (gain, of_output) in enumerate(rankings):
            for i, size in zip(
                *np.unique(of_output[gain >= least], return_counts=True), strict=True
            ):
                latents.append(m)
                outputs.append(i)
                lengths = kernel._value("length_scale")[m, i]
                Z.append(
                    subset
                    if size >= len(subset)
                    else cluster_centres(subset, lengths, size, seed, max_iter=30)
                )
        return LatentFeatures(kernel, latents, Z, outputs=outputs)

    return best
