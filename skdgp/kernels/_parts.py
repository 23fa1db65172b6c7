"""Inducing features of compact models: the outputs' parts of the latents, and where they are placed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import cluster_centres, pivoted_cholesky
from skdgp.kernels._features import JITTER, Features
from skdgp.kernels._paths import FeaturePaths
from skdgp.kernels._rows import ExponentialRows
from skdgp.kernels._waves import joint_paths

CANDIDATES = 2400  # of each latent
CLUSTERED = 5000  # samples that k-means looks at
NEGLIGIBLE = 1e-6  # residual variance, relative to the scale given, that ends a ranking


class PartFeatures(Features):
    """What a latent contributes to an output, u_mi(z) = (h_mi * x_m)(z) at unit variance.

    One window over a latent (``ConvolvedFeatures``) cannot serve outputs of different widths: what it smooths away is
    lost to the narrow ones, and what it resolves is needed off the data by the wide ones. An output's own part loses
    nothing to that output, and its covariances are again those of a ConvolvedGaussian, with a further output for
    every pair (m, i).

    Parameters
    ----------
    kernel : ConvolvedGaussian
    parts : list of (m, i)
        Latent and output.
    Z : list of ndarray (k, d)
        Where each part stands.
    """

    def __init__(self, kernel, parts, Z):
        self.kernel, self.parts, self.Z = kernel, [(int(m), int(i)) for m, i in parts], list(Z)
        self.joint, self._d = _with_parts(kernel, self.parts), kernel.n_features
        self._edges = np.cumsum([0, *map(len, self.Z)])
        self.size = int(self._edges[-1])
        feeds = kernel._value("feeds").astype(bool)
        self._felt = [[f for f, (m, _) in enumerate(self.parts) if fed[m]] for fed in feeds.T]
        self._related = [(f, g) for f, (m, _) in enumerate(self.parts) for g, (n, _) in enumerate(self.parts) if m == n]

    def _of(self, f):
        return slice(self._edges[f], self._edges[f + 1])

    def columns(self, i):
        return np.concatenate([np.arange(0), *(np.arange(self.size)[self._of(f)] for f in self._felt[i])])

    def Kuu(self):
        P, K = self.kernel.n_outputs, np.zeros((self.size, self.size))
        for f, g in self._related:
            K[self._of(f), self._of(g)] = self.joint.block(P + f, P + g, self.Z[f], self.Z[g])
        np.einsum("ii->i", K)[:] = 1.0 + JITTER
        return K

    def Kfu(self, i, X):
        blocks = [self.joint.block(i, self.kernel.n_outputs + f, X, self.Z[f]) for f in self._felt[i]]
        return np.hstack([np.empty((len(X), 0)), *blocks])

    def Kfu_derivative(self, i, X):
        P, (n, d) = self.kernel.n_outputs, np.shape(X)
        blocks = [self.joint.block_derivative(i, P + f, X, self.Z[f]) for f in self._felt[i]]
        return np.concatenate([np.empty((d, n, 0)), *blocks], axis=2)

    def rows(self):
        P = self.kernel.n_outputs
        return ExponentialRows(self.joint, [[(P + f, self.Z[f]) for f in felt] for felt in self._felt])

    def gradient_fu(self, i, X, W):
        P, start = self.kernel.n_outputs, 0
        total, dZ = self._zeros()
        for f in self._felt[i]:
            own = W[:, start : start + len(self.Z[f])]
            start += len(self.Z[f])
            entries, dZ[self._of(f)] = self.joint.entry_gradients(i, P + f, X, self.Z[f], own, inputs=True)
            _add(total, entries)
        return self._collect(total, dZ)

    def gradient_uu(self, W):
        P, (total, dZ) = self.kernel.n_outputs, self._zeros()
        for f, g in self._related:
            own = np.array(W[self._of(f), self._of(g)])
            if f == g:
                np.einsum("ii->i", own)[:] = 0.0  # the diagonal is one, whatever the parameters
            entries, slope = self.joint.entry_gradients(P + f, P + g, self.Z[f], self.Z[g], own, inputs=True)
            dZ[self._of(g)] += 2 * slope
            _add(total, entries)
        return self._collect(total, dZ)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        return joint_paths(self.joint, self.Z, JITTER, n_paths, n_frequencies, random_state)

    def paths(self, coefficients):
        return FeaturePaths(self, self.kernel.n_outputs, coefficients)

    def _zeros(self):
        names = ("amplitude", "length_scale", "shift", "shear")
        return {name: np.zeros_like(self.joint._value(name)) for name in names}, np.zeros((self.size, self._d))

    def _collect(self, total, dZ):
        """Return the gradient by [kernel theta, Z]: widths of a part are those of its output."""
        P = self.kernel.n_outputs
        own = {name: entry[:, :P].copy() for name, entry in total.items()}
        for f, (m, i) in enumerate(self.parts):
            for name in ("length_scale", "shift", "shear"):
                own[name][m, i] += total[name][m, P + f]
        return np.concatenate([self.kernel.pull_back(own), dZ.ravel()])

    @property
    def theta(self):
        return np.concatenate([np.empty(0), *(z.ravel() for z in self.Z)])

    @property
    def bounds(self):
        return np.tile([-np.inf, np.inf], (self.size * self._d, 1))

    def theta_scale(self, scale):
        return np.tile(scale, self.size)

    def rebuild(self, kernel, theta):
        stacked = theta.reshape(self.size, self._d)
        return PartFeatures(kernel, self.parts, [stacked[self._of(f)] for f in range(len(self.parts))])


def _add(total, entries):
    for name, entry in entries.items():
        total[name] += entry


def _with_parts(kernel, parts):
    """Return the kernel with one more output for each part: the part itself, at unit variance."""
    m, i = np.array(parts, dtype=int).reshape(-1, 2).T
    arrays = {}
    for name in ("amplitude", "length_scale", "shift", "shear", "feeds"):
        value = kernel._value(name)
        if name in ("amplitude", "feeds"):
            extra = np.eye(len(value))[:, m]
        else:
            extra = np.broadcast_to(value[m, i], (len(value), *value[m, i].shape))
        arrays[name] = np.concatenate([value, extra], axis=1)
    return type(kernel)(covariance_type="full" if kernel.covariance_type == "full" else "diag", **arrays)


class Ranking(NamedTuple):
    """Candidates of one latent, best first: what each takes away, its output, its place."""

    gain: np.ndarray
    output: np.ndarray
    Z: np.ndarray


def rank_parts(kernel, X, scale, random_state) -> Callable[[int], PartFeatures]:
    """Return a function n -> the features that n variables are best spent on.

    Candidates are the parts of every output at every sample, weighted by amplitude over ``scale`` (P,), how exactly an
    output is to be kept. A pivoted Cholesky factorisation of their covariance takes the one that is least
    explained by those before it (Burt et al. 2020); what it took says how many each part deserves. They are then placed
    at the centres of k-means, in the part's own length scales, which explains more than the pivots themselves do.
    """
    seed = check_random_state(random_state).randint(2**31 - 1)
    random_state = np.random.RandomState(seed)
    X = np.unique(X, axis=0)
    rankings = [_rank(kernel, m, X, scale, random_state) for m in range(len(kernel._value("feeds")))]
    for ranking in rankings:
        ranking.gain[0] = np.inf  # no latent is left out: no output is without features
    order = np.sort(np.concatenate([ranking.gain for ranking in rankings]))[::-1]
    some = X[np.sort(random_state.permutation(len(X))[:CLUSTERED])]

    def best(n):
        least = order[min(max(n, len(rankings)), len(order)) - 1]
        parts, Z = [], []
        for m, ranking in enumerate(rankings):
            outputs = ranking.output[ranking.gain >= least]
            for i in np.unique(outputs):
                parts.append((m, i))
                Z.append(_centres(some, kernel._value("length_scale")[m, i], np.sum(outputs == i), seed))
        return PartFeatures(kernel, parts, Z)

    return best


def _rank(kernel, m, X, scale, random_state):
    outputs = np.flatnonzero(kernel._value("feeds")[m])
    x = X[random_state.permutation(len(X))[: max(1, CANDIDATES // len(outputs))]]
    K = PartFeatures(kernel, [(m, i) for i in outputs], [x] * len(outputs)).Kuu()
    weight = np.repeat(kernel._value("amplitude")[m, outputs] / scale[outputs], len(x))
    pivots, gain = pivoted_cholesky(np.asfortranarray(K * np.multiply.outer(weight, weight)), NEGLIGIBLE)
    return Ranking(gain, outputs[pivots // len(x)], x[pivots % len(x)])


def _centres(X, length_scale, n, seed):
    """Return n centres of the samples in the metric of the length scales, or all samples where n is as many."""
    if n >= len(X):
        return X
    return cluster_centres(X, length_scale, n, seed, max_iter=30)
