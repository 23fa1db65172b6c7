"""Sparse inference: the collapsed bound over inducing features, a sum over samples.

Titsias (2009) for features between domains (Alvarez et al. 2010). With the features' covariance Kuu, the
covariance Kfu of values and features, and the noise S, log N(y | 0, Kfu Kuu^-1 Kuf + S) less half the trace of
S^-1 (Kff - Kfu Kuu^-1 Kuf) is below the log marginal likelihood, and rises to it as features are added. Samples
enter through sums alone, so time is linear in them and memory does not grow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._linalg import cholesky_inverse, cholesky_solve, jittered_cholesky, log_determinant, triangular_solve
from skdgp._threads import n_threads, thread_map
from skdgp.inference._exact import Data

ROWS = 512  # samples at a time


class _Statistics(NamedTuple):
    """Sums over the samples of one output: Kuf Kfu (c, c), Kuf y (c,), y y, sum of var(y_i), number of values."""

    outer: np.ndarray
    inner: np.ndarray
    square: float
    variance: float
    n: int


def _shares(data):
    """Return (output, slices of rows): work of equal size, a few pieces for each thread."""
    shares = []
    for i, y in enumerate(data.y):
        slices = [slice(a, min(a + ROWS, len(y))) for a in range(0, len(y), ROWS)]
        n_shares = min(len(slices), 2 * n_threads())
        shares += [(i, slices[k::n_shares]) for k in range(n_shares)]
    return shares


def _accumulate(kernel, features, data) -> list[_Statistics]:
    """Return the sums for each output."""

    def over(share):
        i, slices = share
        size = len(features.columns(i))
        outer, inner = np.zeros((size, size)), np.zeros(size)
        square, variance, n = 0.0, 0.0, 0
        for rows in slices:
            X, y = data.X[i][rows], data.y[i][rows]
            A = features.Kfu(i, X)
            outer += A.T @ A
            inner += A.T @ y
            square, variance, n = square + y @ y, variance + kernel.block_diag(i, X).sum(), n + len(y)
        return i, _Statistics(outer, inner, square, variance, n)

    parts = thread_map(over, _shares(data))
    return [_Statistics(*map(sum, zip(*(s for k, s in parts if k == i), strict=True))) for i in range(len(data.y))]


class SparsePosterior:
    """The posterior given the features, at fixed hyperparameters.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data

    Attributes
    ----------
    log_marginal_likelihood : float
        Its lower bound.
    """

    def __init__(self, kernel, features, noise, data: Data):
        self.kernel, self.features, self.noise = kernel, features, np.asarray(noise, dtype=float)
        self.data = data
        self.statistics = _accumulate(kernel, features, data)
        self._solve()

    def __getstate__(self):
        kept = ("kernel", "features", "noise", "data", "statistics")
        return {name: self.__dict__[name] for name in kept}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._solve()

    def _solve(self):
        """From the statistics: B = Kuu + sum_i Kuf_i Kfu_i / noise_i, the weights B^-1 b, and the bound."""
        Kuu = self.features.Kuu()
        B, b = Kuu.copy(), np.zeros(self.features.size)
        for i, s in enumerate(self.statistics):
            columns = self.features.columns(i)
            B[np.ix_(columns, columns)] += s.outer / self.noise[i]
            b[columns] += s.inner / self.noise[i]
        self.Lu = jittered_cholesky(lambda: np.asfortranarray(Kuu))
        self.LB = jittered_cholesky(lambda: np.asfortranarray(B))
        self.weights = cholesky_solve(self.LB, b)
        self.Ku_inverse, self.B_inverse = (_symmetric(cholesky_inverse(L.copy(order="F"))) for L in (self.Lu, self.LB))
        n = np.array([s.n for s in self.statistics])
        square = np.array([s.square for s in self.statistics])
        value = n.sum() * np.log(2 * np.pi) + (n * np.log(self.noise)).sum() + (square / self.noise).sum()
        value += log_determinant(self.LB) - log_determinant(self.Lu) - b @ self.weights
        self.missing = np.array([s.variance - self._explained(i) for i, s in enumerate(self.statistics)])
        self.log_marginal_likelihood = -0.5 * (value + (self.missing / self.noise).sum())

    def likelihood_at(self, kernel, noise, eval_gradient=False):
        """Return the bound for the same data and features at other hyperparameters, and its gradient on request."""
        other = SparsePosterior(kernel, self.features.rebuild(kernel, self.features.theta), noise, self.data)
        if not eval_gradient:
            return other.log_marginal_likelihood
        return other.log_marginal_likelihood, other.bound_gradient()[: kernel.n_dims + len(noise)]

    def _explained(self, i):
        """Return tr(Kuu^-1 Kuf_i Kfu_i): the variance that the features can express."""
        columns = self.features.columns(i)
        return np.einsum("ab,ab->", self.Ku_inverse[np.ix_(columns, columns)], self.statistics[i].outer)

    def bound_gradient(self):
        """Return the gradient of the bound by [kernel theta, log noise, features theta]."""
        a, kernel, features, data = self.weights, self.kernel, self.features, self.data
        Lambda = np.zeros_like(self.B_inverse)
        d_noise = np.empty(len(self.noise))
        for i, s in enumerate(self.statistics):
            c = features.columns(i)
            Lambda[np.ix_(c, c)] += s.outer / self.noise[i]
            fit = np.einsum("ab,ab->", self.B_inverse[np.ix_(c, c)], s.outer) + a[c] @ s.outer @ a[c]
            d_noise[i] = 0.5 * ((fit + s.square - 2 * a[c] @ s.inner + self.missing[i]) / self.noise[i] - s.n)
        Wuu = 0.5 * (self.Ku_inverse - self.B_inverse - np.outer(a, a) - self.Ku_inverse @ Lambda @ self.Ku_inverse)

        def over(share):
            i, slices = share
            c = features.columns(i)
            gap = self.B_inverse[np.ix_(c, c)] - self.Ku_inverse[np.ix_(c, c)]
            total, diagonal = 0.0, 0.0
            for rows in slices:
                X, y = data.X[i][rows], data.y[i][rows]
                A = features.Kfu(i, X)
                W = np.multiply.outer((y - A @ a[c]) / self.noise[i], a[c])
                W -= A @ (gap / self.noise[i])
                total = total + features.gradient_fu(i, X, W)
                diagonal = diagonal + kernel.diag_gradient(i, X, np.full(len(X), -0.5 / self.noise[i]))
            return total, diagonal

        totals, diagonals = zip(*thread_map(over, _shares(data)), strict=True)
        total = features.gradient_uu(Wuu) + np.sum(totals, axis=0)
        n = kernel.n_dims
        return np.concatenate([total[:n] + np.sum(diagonals, axis=0), d_noise, total[n:]])

    def _rows(self, n):
        return [slice(a, min(a + ROWS, n)) for a in range(0, n, ROWS)]

    def predict(self, Xs, return_variance=False):
        """Return mean and, on request, variance of the latent functions at Xs (n, d): (n, P) each."""
        P = self.kernel.n_outputs
        mean = np.empty((len(Xs), P))
        variance = np.empty((len(Xs), P)) if return_variance else None

        def over(task):
            i, rows = task
            c = self.features.columns(i)
            A = self.features.Kfu(i, Xs[rows])
            mean[rows, i] = A @ self.weights[c]
            if return_variance:
                variance[rows, i] = self.kernel.block_diag(i, Xs[rows]) - np.einsum("ab,ab->a", A @ self._gap(i), A)

        thread_map(over, [(i, rows) for rows in self._rows(len(Xs)) for i in range(P)])
        return (mean, np.maximum(variance, 0.0)) if return_variance else mean

    def _gap(self, i):
        """Return Kuu^-1 - B^-1 of the columns of i: what the data took from the prior variance."""
        c = self.features.columns(i)
        return self.Ku_inverse[np.ix_(c, c)] - self.B_inverse[np.ix_(c, c)]

    def covariance(self, Xs) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        P, n = self.kernel.n_outputs, len(Xs)
        A = np.zeros((P * n, self.features.size), order="F")
        for i in range(P):
            A[i * n : (i + 1) * n, self.features.columns(i)] = self.features.Kfu(i, Xs)
        prior, posterior = (
            triangular_solve(self.Lu, A.T.copy(order="F")),
            triangular_solve(self.LB, A.T.copy(order="F")),
        )
        return self.kernel(Xs) - prior.T @ prior + posterior.T @ posterior

    def gradient(self, Xs, return_variance=False):
        """Return d mean / d x at Xs, (n, P, d), and on request the variance of the slopes."""
        P, d = self.kernel.n_outputs, np.shape(Xs)[1]
        mean = np.empty((len(Xs), P, d))
        variance = np.empty((len(Xs), P, d)) if return_variance else None
        for rows in self._rows(len(Xs)):
            for i in range(P):
                D = self.features.Kfu_derivative(i, Xs[rows])
                mean[rows, i] = (D @ self.weights[self.features.columns(i)]).T
                if return_variance:
                    explained = np.einsum("dna,ab,dnb->nd", D, self._gap(i), D, optimize=True)
                    variance[rows, i] = np.maximum(self.kernel.derivative_diag(i, Xs[rows]) - explained, 0.0)
        return (mean, variance) if return_variance else mean


def _symmetric(lower):
    """Return the full matrix of which the lower triangle is given."""
    full = np.tril(lower)
    return full + np.tril(full, -1).T
