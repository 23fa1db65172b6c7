"""Sparse inference by the collapsed variational bound.

Features are inducing variables u (Alvarez et al. 2010), see ``skdgp.kernels._features``. With their covariance Kuu, the
covariance Kfu of values and features, and the noise S, the bound of Titsias (2009) is

    log N(y | 0, Kfu Kuu^-1 Kuf + S) - 1/2 tr S^-1 (Kff - Kfu Kuu^-1 Kuf).

It does not exceed the log marginal likelihood, and approaches it as features are added. It needs only sums over the
samples, so time is linear in their number and memory is constant.
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
from skdgp._compute.threads import few_threads, thread_map, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._mixture import Single
from skdgp.inference._optimize import maximize
from skdgp.inference._posterior_paths import Paths, sparse_paths
from skdgp.inference._sums import (
    ROWS,
    Sums,
    bound_gradient,
    compute_sums,
    data_from_shares,
    row_slices,
    shares_of,
    sub_factor,
    total_statistics,
)


class SparsePosterior(Single):
    """The sparse posterior at fixed hyperparameters and features.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    shares : list of SampleShare
        The observed values, see ``shares_of``.

    Attributes
    ----------
    shares : list of SampleShare or None
        None after ``without_samples``: only ``sums`` remain.
    log_marginal_likelihood : float
        Lower bound on the log marginal likelihood.
    """

    shares: Any
    sums: Sums
    statistics: Any  # list of Statistics, None if the noise is correlated

    def __init__(self, kernel: Any, features: Any, noise: Vector, shares: list) -> None:
        self.kernel, self.features, self.noise = kernel, features, np.asarray(noise, dtype=float)
        self.shares = shares
        self._begin()

    def __getstate__(self):
        state = {name: getattr(self, name) for name in ("kernel", "features", "noise", "shares", "measured")}
        if self.shares is None:  # otherwise the sums are computed again from the samples, which take less space
            state["sums"] = self.sums.packed(self.features, self.kernel.n_outputs)
        return state

    def __setstate__(self, state):
        self.__dict__.update(state)
        if self.shares is None:
            self.sums = self.sums.unpacked(self.features, self.kernel.n_outputs)
        self._begin()

    @property
    def size(self) -> int:
        """Number of features K."""
        return self.features.size

    def _begin(self):
        with threads_for(self.size):
            self.Lu = jittered_cholesky(lambda: np.asfortranarray(self.features.Kuu()))
        if self.shares is not None:
            self.sums, self.statistics = self._compute_sums(self.shares)
        self._condition()

    def _compute_sums(self, shares):
        return compute_sums(self.kernel, self.features, self.noise, self.Lu, shares)

    def _condition(self):
        """Compute the posterior of w in u = Lu w: precision B = I + sum_i V_i V_i^T / noise_i and mean B^-1 b."""
        b = self.sums.inner
        with threads_for(self.size):
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
        with threads_for(self.size):
            return symmetric(cholesky_inverse(self.LB.copy(order="F")))

    def _with(self, shares, statistics, sums, noise=None) -> SparsePosterior:
        """Return the posterior of other samples or with another noise, with the same features."""
        new = object.__new__(SparsePosterior)
        new.kernel, new.features, new.Lu, new.measured = self.kernel, self.features, self.Lu, self.measured
        new.noise = self.noise if noise is None else noise
        new.shares, new.statistics, new.sums = shares, statistics, sums
        new._condition()
        return new

    def with_noise(self, noise: Vector) -> SparsePosterior:
        """Return the posterior with other variances of independent noise, from the same sums over samples."""
        noise = np.asarray(noise, dtype=float)
        return self._with(self.shares, self.statistics, Sums.combine(self.features, noise, self.statistics), noise)

    def noise_seen(self) -> np.ndarray:
        """Return the expected mean squared residual of each output, (P,), for independent noise.

        This is the noise update of expectation maximisation: at its fixed point the bound is stationary in the noise.
        """
        residual = np.empty(len(self.noise))
        for i, s in enumerate(self.statistics):
            c = self.features.columns(i)
            w = self.white[c]
            spread = np.einsum("ab,ab->", self.B_inverse[np.ix_(c, c)], s.outer) + s.unexplained
            residual[i] = (s.square - 2 * w @ s.inner + w @ s.outer @ w + spread) / max(s.n, 1)
        return residual

    def samples(self) -> Data | None:
        """Return the values that the posterior has learned from; None without samples."""
        return None if self.shares is None else data_from_shares(self.shares, self.kernel.n_outputs)

    def of(self, data: Data, noise: Vector) -> SparsePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters and features."""
        return SparsePosterior(self.kernel, self.features, noise, shares_of(data))

    def scaled_noise(self, factor: Vector) -> SparsePosterior:
        """Return the posterior with the noise of each output times a factor (P,)."""
        return SparsePosterior(self.kernel, self.features, self.noise * factor, self.shares)

    def sparse(self, features: Any) -> SparsePosterior:
        """Return the posterior of the same samples with other features."""
        return SparsePosterior(self.kernel, features, self.noise, self.shares)

    def without_samples(self) -> SparsePosterior:
        """Return the same posterior without samples: it keeps only their sums and predicts the same."""
        posterior = self._with(None, None, self.sums)
        posterior.measured = None
        return posterior

    def updated(self, data: Data) -> SparsePosterior:
        """Return the posterior with further values: their sums are added."""
        sums, added = self._compute_sums(shares_of(data))
        sums = self.sums.plus(sums)
        if self.shares is None:
            return self._with(None, None, sums)
        total = added and [total_statistics(pair) for pair in zip(self.statistics, added, strict=True)]
        return self._with(shares_of(data_from_shares(self.shares, len(data.X)).joined(data)), total, sums)

    def likelihood_at(self, kernel: Any, noise: Vector, eval_gradient: bool = False) -> Any:
        """Return the bound of the same data at other hyperparameters, with ``eval_gradient`` also its gradient."""
        if self.shares is None:
            raise ValueError(
                "A compact model holds no samples, so its likelihood is known at the fitted hyperparameters alone. Use "
                "the model it was made from."
            )
        other = SparsePosterior(kernel, self.features.rebuild(kernel, self.features.theta), noise, self.shares)
        if not eval_gradient:
            return other.log_marginal_likelihood
        return other.log_marginal_likelihood, other.bound_gradient()[: kernel.n_dims + len(noise)]

    def bound_gradient(self) -> Vector:
        """Return the gradient of the bound by [kernel theta, log noise, features theta]."""
        return bound_gradient(self)

    @cached_property
    def readout(self) -> Readout:
        """The weights of means, computed at the first prediction."""
        return Readout(self.kernel, self.features, self.weights)

    @cached_property
    def roots(self) -> list[np.ndarray]:
        """The matrices of variances, computed at the first prediction of a standard deviation."""
        with threads_for(self.size):
            return self.readout.roots(self.Lu, self.B_inverse)

    @few_threads
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        readout = self.readout
        evaluate = partial(readout.mean_and_variance, roots=self.roots) if return_variance else readout.mean
        if len(Xs) <= ROWS:
            return evaluate(Xs)
        parts = thread_map(lambda rows: evaluate(Xs[rows]), row_slices(len(Xs)))
        return tuple(map(np.concatenate, zip(*parts, strict=True))) if return_variance else np.concatenate(parts)

    def term(self, kernel: Any) -> SparsePosterior:
        """Return the posterior of one term of the kernel, which is independent of the others a priori.

        The features are the same, so the posterior of the term is that of all with the covariance of the term and the
        features in place of Kfu. ``predict``, ``covariance`` and ``gradient`` are those of the term,
        which ``self.kernel.term(regressors)`` gives.
        """
        new, features = object.__new__(SparsePosterior), self.features.rebuild(kernel, self.features.theta)
        readout = Readout(kernel, features, self.weights)
        vars(new).update(vars(self) | {"kernel": kernel, "features": features, "readout": readout, "roots": self.roots})
        return new

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""
        return self.features.Kfu(i, Xs), self.weights[self.features.columns(i)]

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""
        return explained_variance(A, self.roots[i])

    @few_threads
    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        P, n = self.kernel.n_outputs, len(Xs)
        A = np.zeros((self.features.size, P * n), order="F")
        for i in range(P):
            A[self.features.columns(i), i * n : (i + 1) * n] = self.features.Kfu(i, Xs).T
        V = triangular_solve(self.Lu, A)
        return self.kernel(Xs) - V.T @ (V - self.B_inverse @ V)

    def paths(self, n_paths: int, random_state: Seed) -> Paths:
        """Return samples of the posterior that are functions of the regressors."""
        with threads_for(self.size):
            return sparse_paths(self, n_paths, random_state)

    @few_threads
    def gradient(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return d mean / d x at Xs, (n, P, d), and with ``return_variance`` the variance of the slopes."""
        parts = thread_map(partial(self._gradient, Xs, self.roots if return_variance else None), row_slices(len(Xs)))
        mean, variance = zip(*parts, strict=True)
        return (np.concatenate(mean), np.concatenate(variance)) if return_variance else np.concatenate(mean)

    def _gradient(self, Xs, roots, rows):
        """Return the mean and, unless ``roots`` is None, the variance of the slopes at some rows, (n, P, d) each."""
        x, outputs = Xs[rows], range(self.kernel.n_outputs)
        D = [self.features.Kfu_derivative(i, x) for i in outputs]
        mean = np.stack([(D[i] @ self.weights[self.features.columns(i)]).T for i in outputs], axis=1)
        if roots is None:
            return mean, None
        explained = [
            explained_variance(D[i].reshape(-1, D[i].shape[-1]), roots[i]).reshape(-1, len(x)).T for i in outputs
        ]
        prior = np.stack([self.kernel.derivative_diag(i, x) for i in outputs], axis=1)
        return mean, unexplained_variance(prior, np.stack(explained, axis=1))


def maximize_features(start: SparsePosterior, scale: Vector, *, max_iter: int, stage: str) -> tuple:
    """Return the features that maximise the bound, from those of ``start``, and the Optimum.

    Steps are in units of ``scale`` (d,), the standard deviations of the regressors, rounded to powers of two. The
    search then does not depend on the units of the regressors, and the scaling causes no rounding.
    """
    kernel, features = start.kernel, start.features
    unit = features.theta_scale(np.exp2(np.round(np.log2(scale))))

    def bound(theta):
        posterior = SparsePosterior(kernel, features.rebuild(kernel, unit * theta), start.noise, start.shares)
        return posterior.log_marginal_likelihood, unit * posterior.bound_gradient()[-len(theta) :]

    best = maximize(bound, features.theta / unit, features.bounds / unit[:, None], max_iter=max_iter, stage=stage)
    return features.rebuild(kernel, unit * best.theta), best


class Readout:
    """Mean and variance of every output from the features it covaries with.

    With V = Lu^-1 Kuf the data reduce the prior variance by V^T (I - B^-1) V. With I - B^-1 = R R^T for the features of
    output i this is |Kfu Lu^-T R|^2, one matrix product and a sum of squares. The weights (K,) are Kuu^-1 times the
    posterior mean of the features.
    """

    def __init__(self, kernel: Any, features: Any, weights) -> None:
        self.kernel, self.rows = kernel, features.rows()
        self.columns = [features.columns(i) for i in range(kernel.n_outputs)]
        edges = np.cumsum([0, *map(len, self.columns)])
        self.slices = [slice(a, b) for a, b in pairwise(edges)]
        self.weights = np.zeros((edges[-1], kernel.n_outputs))
        for i, (rows, columns) in enumerate(zip(self.slices, self.columns, strict=True)):
            self.weights[rows, i] = weights[columns]

    def roots(self, Lu, B_inverse) -> list[np.ndarray]:
        """Return Lu^-T R of the features of each output, (c, c)."""
        roots = []
        for columns in self.columns:
            reduction = -B_inverse[np.ix_(columns, columns)]
            np.einsum("ii->i", reduction)[:] += 1.0
            roots.append(triangular_solve(sub_factor(Lu, columns), semidefinite_root(reduction), transposed=True))
        return roots

    def mean(self, X: Matrix) -> np.ndarray:
        """Return the mean at X (n, d), (n, P)."""
        return self.rows(X) @ self.weights

    def mean_and_variance(self, X: Matrix, roots) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance at X (n, d), (n, P) each."""
        A = self.rows(X)
        variance = np.empty((len(X), len(self.slices)))
        for i, (columns, root) in enumerate(zip(self.slices, roots, strict=True)):
            explained = explained_variance(A[:, columns], root)
            variance[:, i] = unexplained_variance(self.kernel.block_diag(i, X), explained)
        return A @ self.weights, variance


def explained_variance(A, root: Matrix):
    """Return the variance explained by the data for functions with covariances A (n, c) with the features."""
    half = A @ root
    return np.einsum("nc,nc->n", half, half)
