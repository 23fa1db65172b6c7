"""Sparse inference: the collapsed bound over inducing features, a sum over samples.

Titsias (2009) for features between domains (Alvarez et al. 2010). With the features' covariance Kuu, the
covariance Kfu of values and features, and the noise S, log N(y | 0, Kfu Kuu^-1 Kuf + S) less half the trace of
S^-1 (Kff - Kfu Kuu^-1 Kuf) is below the log marginal likelihood, and rises to it as features are added. Samples
enter through sums alone, so time is linear in them and memory does not grow.
"""

from __future__ import annotations

from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from skdgp._compute.linalg import (
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
    semidefinite_root,
    symmetric,
    triangular_solve,
    unexplained_variance,
)
from skdgp._compute.threads import thread_map, threads_for
from skdgp.inference._likelihood import Data
from skdgp.inference._optimize import maximize
from skdgp.inference._paths import Paths, sparse_paths
from skdgp.inference._sums import (
    ROWS,
    Sums,
    bound_gradient,
    data_of,
    own_factor,
    row_slices,
    shares_of,
    shares_read,
    summed,
    sums_of,
)


class SparsePosterior:
    """The posterior given the features, at fixed hyperparameters.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    shares : list of Share
        The observed values, see ``shares_of``; or of SampleShare, where the outputs are noisy together.

    Attributes
    ----------
    shares : list of SampleShare or None
        None where they were forgotten: ``sums`` is what is left of them.
    log_marginal_likelihood : float
        Its lower bound.
    """

    shares: Any
    sums: Sums
    statistics: Any  # list of Statistics, None where the noise is correlated

    def __init__(self, kernel, features, noise, shares: list):
        self.kernel, self.features, self.noise = kernel, features, np.asarray(noise, dtype=float)
        self.shares = shares
        self._begin()

    def __getstate__(self):
        state = {name: self.__dict__[name] for name in ("kernel", "features", "noise", "shares")}
        if self.shares is None:  # else the samples are smaller than their sums
            state["sums"] = self.sums.packed(self.features, self.kernel.n_outputs)
        return state

    def __setstate__(self, state):
        self.__dict__.update(state)
        self.shares = shares_read(self.shares)
        if self.shares is None:
            self.sums = self.sums.unpacked(self.features, self.kernel.n_outputs)
        self._begin()

    def _begin(self):
        with threads_for(self.features.size):
            self.Lu = jittered_cholesky(lambda: np.asfortranarray(self.features.Kuu()))
        if self.shares is not None:
            self.sums, self.statistics = self._sums_of(self.shares)
        self._condition()

    def _sums_of(self, shares):
        return sums_of(self.kernel, self.features, self.noise, self.Lu, shares)

    def _condition(self):
        """Whitened, u = Lu w: B = I + sum_i V_i V_i^T / noise_i, the mean of w is B^-1 b, and the bound follows."""
        b = self.sums.inner
        with threads_for(self.features.size):
            self.LB = jittered_cholesky(lambda: np.asfortranarray(self.B))
            self.white = cholesky_solve(self.LB, b)
            self.weights = triangular_solve(self.Lu, self.white, transposed=True)
        self.log_marginal_likelihood = -0.5 * (self.sums.rest + log_determinant(self.LB) - b @ self.white)

    @property
    def B(self) -> np.ndarray:
        """Precision of the whitened features, (K, K)."""
        B = self.sums.outer.copy()
        np.einsum("ii->i", B)[:] += 1.0
        return B

    @cached_property
    def B_inverse(self) -> np.ndarray:
        """Covariance of the whitened features, (K, K)."""
        with threads_for(self.features.size):
            return symmetric(cholesky_inverse(self.LB.copy(order="F")))

    def _with(self, shares, statistics, sums, noise=None) -> SparsePosterior:
        """Return the posterior of other samples or another noise, at the same features."""
        new = object.__new__(SparsePosterior)
        new.kernel, new.features, new.Lu = self.kernel, self.features, self.Lu
        new.noise = self.noise if noise is None else noise
        new.shares, new.statistics, new.sums = shares, statistics, sums
        new._condition()
        return new

    def with_noise(self, noise) -> SparsePosterior:
        """Return the posterior at another noise variance of each output, noisy apart; no sample is looked at again."""
        noise = np.asarray(noise, dtype=float)
        return self._with(self.shares, self.statistics, Sums.of(self.features, noise, self.statistics), noise)

    def noise_seen(self) -> np.ndarray:
        """Return the mean squared distance of the values from the function, uncertain as that is, (P,).

        Where it is the noise, the bound is stationary in the noise: the step of expectation maximisation. Of outputs
        that are noisy apart.
        """
        seen = np.empty(len(self.noise))
        for i, s in enumerate(self.statistics):
            c = self.features.columns(i)
            w = self.white[c]
            spread = np.einsum("ab,ab->", self.B_inverse[np.ix_(c, c)], s.outer) + s.missing
            seen[i] = (s.square - 2 * w @ s.inner + w @ s.outer @ w + spread) / max(s.n, 1)
        return seen

    def without_samples(self) -> SparsePosterior:
        """Return the same posterior, of the same predictions, that holds no samples: their sums alone."""
        return self._with(None, None, self.sums)

    def updated(self, data: Data) -> SparsePosterior:
        """Return the posterior that knows further values too: their sums are added."""
        sums, added = self._sums_of(shares_of(data))
        sums = self.sums.plus(sums)
        if self.shares is None:
            return self._with(None, None, sums)
        total = added and [summed(pair) for pair in zip(self.statistics, added, strict=True)]
        return self._with(shares_of(data_of(self.shares, len(data.X)).joined(data)), total, sums)

    def likelihood_at(self, kernel, noise, eval_gradient=False):
        """Return the bound for the same data and features at other hyperparameters, and its gradient on request."""
        if self.shares is None:
            raise ValueError(
                "A compact model holds no samples, so its likelihood is known at the fitted hyperparameters alone. Ask "
                "the model it was made from."
            )
        other = SparsePosterior(kernel, self.features.rebuild(kernel, self.features.theta), noise, self.shares)
        if not eval_gradient:
            return other.log_marginal_likelihood
        return other.log_marginal_likelihood, other.bound_gradient()[: kernel.n_dims + len(noise)]

    def bound_gradient(self):
        """Return the gradient of the bound by [kernel theta, log noise, features theta]."""
        return bound_gradient(self)

    @cached_property
    def readout(self) -> Readout:
        """What means need, made when they are first asked for."""
        return Readout(self.kernel, self.features, self.weights)

    @cached_property
    def roots(self) -> list[np.ndarray]:
        """What variances need besides."""
        with threads_for(self.features.size):
            return self.readout.roots(self.Lu, self.B_inverse)

    def predict(self, Xs, return_variance=False):
        """Return mean and, on request, variance of the latent functions at Xs (n, d): (n, P) each."""
        readout = self.readout
        answer = partial(readout.mean_and_variance, roots=self.roots) if return_variance else readout.mean
        if len(Xs) <= ROWS:
            return answer(Xs)
        parts = thread_map(lambda rows: answer(Xs[rows]), row_slices(len(Xs)))
        return tuple(map(np.concatenate, zip(*parts, strict=True))) if return_variance else np.concatenate(parts)

    def covariance(self, Xs) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        P, n = self.kernel.n_outputs, len(Xs)
        A = np.zeros((self.features.size, P * n), order="F")
        for i in range(P):
            A[self.features.columns(i), i * n : (i + 1) * n] = self.features.Kfu(i, Xs).T
        V = triangular_solve(self.Lu, A)
        return self.kernel(Xs) - V.T @ (V - self.B_inverse @ V)

    def paths(self, n_paths, random_state) -> Paths:
        """Return samples of the posterior that are functions of the regressors."""
        return sparse_paths(self, n_paths, random_state)

    def gradient(self, Xs, return_variance=False):
        """Return d mean / d x at Xs, (n, P, d), and on request the variance of the slopes."""
        parts = thread_map(partial(self._gradient, Xs, self.roots if return_variance else None), row_slices(len(Xs)))
        mean, variance = zip(*parts, strict=True)
        return (np.concatenate(mean), np.concatenate(variance)) if return_variance else np.concatenate(mean)

    def _gradient(self, Xs, roots, rows):
        """Return mean and, where roots are given, variance of the slopes at some rows, (n, P, d) each."""
        x, outputs = Xs[rows], range(self.kernel.n_outputs)
        D = [self.features.Kfu_derivative(i, x) for i in outputs]
        mean = np.stack([(D[i] @ self.weights[self.features.columns(i)]).T for i in outputs], axis=1)
        if roots is None:
            return mean, None
        learned = [
            explained_variance(D[i].reshape(-1, D[i].shape[-1]), roots[i]).reshape(-1, len(x)).T for i in outputs
        ]
        prior = np.stack([self.kernel.derivative_diag(i, x) for i in outputs], axis=1)
        return mean, unexplained_variance(prior, np.stack(learned, axis=1))


def maximize_features(start: SparsePosterior, scale, *, max_iter, stage) -> tuple:
    """Return the features that raise the bound most, found from those of ``start``, and how they were found.

    Steps are in units of ``scale`` (d,), the standard deviations of the regressors, to the nearest power of two: the
    search does not depend on the units of the regressors, and standardised ones keep their bits.
    """
    kernel, features = start.kernel, start.features
    unit = features.theta_scale(np.exp2(np.round(np.log2(scale))))

    def bound(theta):
        moved = SparsePosterior(kernel, features.rebuild(kernel, unit * theta), start.noise, start.shares)
        return moved.log_marginal_likelihood, unit * moved.bound_gradient()[-len(theta) :]

    best = maximize(bound, features.theta / unit, features.bounds / unit[:, None], max_iter=max_iter, stage=stage)
    return features.rebuild(kernel, unit * best.theta), best


class Readout:
    """Mean and variance of every output, from the features it feels.

    With whitened features V = Lu^-1 Kuf, the data took V^T (I - B^-1) V from the prior variance. With I - B^-1 = R R^T
    for the features of output i that is |Kfu Lu^-T R|^2, a product and a sum of squares.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    weights : ndarray (K,)
        Posterior mean of the features, coloured.
    """

    def __init__(self, kernel, features, weights):
        self.kernel, self.rows = kernel, features.rows()
        self.columns = [features.columns(i) for i in range(kernel.n_outputs)]
        edges = np.cumsum([0, *map(len, self.columns)])
        self.own = [slice(a, b) for a, b in pairwise(edges)]
        self.weights = np.zeros((edges[-1], kernel.n_outputs))
        for i, (own, columns) in enumerate(zip(self.own, self.columns, strict=True)):
            self.weights[own, i] = weights[columns]

    def roots(self, Lu, B_inverse) -> list[np.ndarray]:
        """Return Lu^-T R of the features of each output, (c, c)."""
        roots = []
        for columns in self.columns:
            learned = -B_inverse[np.ix_(columns, columns)]
            np.einsum("ii->i", learned)[:] += 1.0
            roots.append(triangular_solve(own_factor(Lu, columns), semidefinite_root(learned), transposed=True))
        return roots

    def mean(self, X) -> np.ndarray:
        """Return the mean at X (n, d), (n, P)."""
        return self.rows(X) @ self.weights

    def mean_and_variance(self, X, roots) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance at X (n, d), (n, P) each."""
        A = self.rows(X)
        variance = np.empty((len(X), len(self.own)))
        for i, (own, root) in enumerate(zip(self.own, roots, strict=True)):
            variance[:, i] = unexplained_variance(self.kernel.block_diag(i, X), explained_variance(A[:, own], root))
        return A @ self.weights, variance


def explained_variance(A, root):
    """Return what the data took from the variance of functions whose covariance with the features is A (n, c)."""
    half = A @ root
    return np.einsum("nc,nc->n", half, half)
