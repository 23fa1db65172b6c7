"""The exact posterior: one Cholesky factor, then equations 17 and 18 for any samples."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from skdgp._linalg import cholesky_solve, jittered_cholesky, log_determinant, triangular_solve
from skdgp._threads import thread_map, threads_for
from skdgp.inference._likelihood import Data, covariance, log_likelihood, tiles_of

CHUNK_BYTES = 2**27  # working memory of one chunk of predictions


class ExactPosterior:
    """The posterior at fixed hyperparameters (equations 17 and 18).

    Parameters
    ----------
    kernel : MultiOutputKernel
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data
    """

    def __init__(self, kernel, noise, data: Data):
        self.kernel, self.noise, self.data = kernel, np.asarray(noise, dtype=float), data
        y = np.concatenate(data.y)
        self.alpha = cholesky_solve(self.L, y)
        self.log_marginal_likelihood = -0.5 * (y @ self.alpha + log_determinant(self.L) + len(y) * np.log(2 * np.pi))

    @cached_property
    def L(self):
        """Cholesky factor of Kff + noise, (N, N); factored again where it was left behind.

        To the same bits on the same number of BLAS threads.
        """
        with threads_for(self.data.n_values):
            return jittered_cholesky(lambda: covariance(self.kernel, self.noise, self.data.X))

    def __getstate__(self):
        # A saved model holds the samples, not the N x N factor: megabytes instead of hundreds of them.
        return {name: value for name, value in self.__dict__.items() if name != "L"}

    def likelihood_at(self, kernel, noise, eval_gradient=False):
        """Return the log likelihood of the same data at other hyperparameters, and its gradient on request."""
        return log_likelihood(kernel, noise, self.data, eval_gradient)

    def cross(self, i, Xs) -> np.ndarray:
        """Return cov(y_i(Xs), all observed values), (n, N)."""
        tiles, rows = tiles_of([len(x) for x in self.data.X]), tiles_of([len(Xs)])
        K = np.empty((len(Xs), len(self.alpha)))

        def fill(pair):
            a, b = pair
            K[a.own, b.all] = self.kernel.block(i, b.output, Xs[a.own], self.data.X[b.output][b.own])

        thread_map(fill, [(a, b) for a in rows for b in tiles])
        return K

    def _chunks(self, n, per_row):
        """Cut n rows so that ``per_row`` doubles for each fit the working memory."""
        step = max(1, int(CHUNK_BYTES / 8 / max(per_row, 1)))
        return [slice(a, min(a + step, n)) for a in range(0, n, step)]

    def predict(self, Xs, return_variance=False):
        """Return mean and, on request, variance of the latent functions at Xs (n, d): (n, P) each."""
        P = self.kernel.n_outputs
        mean = np.empty((len(Xs), P))
        variance = np.empty((len(Xs), P)) if return_variance else None
        for rows in self._chunks(len(Xs), len(self.alpha)):
            for i in range(P):
                K = self.cross(i, Xs[rows])
                mean[rows, i] = K @ self.alpha
                if return_variance:
                    half = triangular_solve(self.L, K.T)
                    variance[rows, i] = self.kernel.block_diag(i, Xs[rows]) - np.einsum("ab,ab->b", half, half)
        return (mean, np.maximum(variance, 0.0)) if return_variance else mean

    def covariance(self, Xs) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        half = triangular_solve(self.L, np.concatenate([self.cross(i, Xs) for i in range(self.kernel.n_outputs)]).T)
        return self.kernel(Xs) - half.T @ half

    def gradient(self, Xs, return_variance=False):
        """Return d mean / d x at Xs, (n, P, d), and on request the variance of the slopes."""
        P, d = self.kernel.n_outputs, np.shape(Xs)[1]
        mean = np.empty((len(Xs), P, d))
        variance = np.empty((len(Xs), P, d)) if return_variance else None
        for rows in self._chunks(len(Xs), d * len(self.alpha)):
            for i in range(P):
                x = Xs[rows]
                K = np.concatenate(
                    [self.kernel.block_derivative(i, j, x, Xj) for j, Xj in enumerate(self.data.X)], axis=2
                )
                mean[rows, i] = (K @ self.alpha).T
                if return_variance:
                    half = triangular_solve(self.L, K.reshape(-1, len(self.alpha)).T)
                    explained = np.einsum("ab,ab->b", half, half).reshape(d, -1).T
                    variance[rows, i] = np.maximum(self.kernel.derivative_diag(i, x) - explained, 0.0)
        return (mean, variance) if return_variance else mean
