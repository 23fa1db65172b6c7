"""The exact posterior: one Cholesky factorisation, then equations 17 and 18."""

from __future__ import annotations

from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    consecutive,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
    unexplained_variance,
)
from skdgp._compute.parallel import few_threads, n_threads, thread_map, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, covariance, log_likelihood, make_tiles
from skdgp.inference._noise import draw_noise
from skdgp.inference._paths import FREQUENCIES, Paths
from skdgp.inference._posterior import SinglePosterior
from skdgp.kernels import MultiOutputKernel, covariance_paths, prior_paths

CHUNK_BYTES = 2**27  # working memory of one chunk of predictions
FEW = 16  # up to this many points the mean is one matrix product instead of many tiles
ROWS = 256  # samples in one tile of a mean


class ExactPosterior(SinglePosterior):
    """The posterior at fixed hyperparameters (equations 17 and 18).

    Parameters
    ----------
    kernel : MultiOutputKernel
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data

    Attributes
    ----------
    log_marginal_likelihood : float
    """

    def __init__(self, kernel: MultiOutputKernel, noise: Vector, data: Data) -> None:
        self.kernel = kernel
        self.noise = np.asarray(noise, dtype=float)
        self.data = data
        square = self._white @ self._white
        self.log_marginal_likelihood = -0.5 * (
            square + log_determinant(self.L) + data.n_values * np.log(2 * np.pi)
        )

    @property
    def size(self) -> int:
        """Number of values N."""
        return self.data.n_values

    @cached_property
    def L(self) -> np.ndarray:
        """Cholesky factor of Kff + noise, (N, N), lower triangle. A loaded posterior computes it again.

        The result has the same bits for the same number of BLAS threads.
        """
        with threads_for(self.size):
            return jittered_cholesky(lambda: covariance(self.kernel, self.noise, self.data))

    @cached_property
    def _white(self):
        """L^-1 y."""
        with threads_for(self.size):
            return triangular_solve(self.L, np.concatenate(self.data.y))

    @cached_property
    def alpha(self) -> np.ndarray:
        """K^-1 y of the stacked values, (N,)."""
        with threads_for(self.size):
            return triangular_solve(self.L, self._white, transposed=True)

    def solve(self, B: Matrix) -> np.ndarray:
        """Return K^-1 B for rows of the stacked values, (N, m)."""
        with threads_for(self.size):
            half = triangular_solve(self.L, np.array(B, order="F"))
            return triangular_solve(self.L, half, transposed=True)

    def __getstate__(self):
        # A saved model holds the samples, not L: the file is about a hundred times smaller.
        not_saved = {"L", "_white", "_mean_function"}
        self.alpha  # noqa: B018 - computed now, so that a loaded model predicts means without L
        return {name: value for name, value in self.__dict__.items() if name not in not_saved}

    def samples(self) -> Data:
        """Return the values that the posterior has learned from."""
        return self.data

    def of(self, data: Data, noise: Vector) -> ExactPosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""
        return ExactPosterior(self.kernel, noise, data)

    def likelihood_at(
        self, kernel: MultiOutputKernel, noise: Vector, eval_gradient: bool = False
    ) -> Any:
        """Return the log likelihood of the same data at other hyperparameters, with ``eval_gradient`` its gradient."""
        return log_likelihood(kernel, noise, self.data, eval_gradient)

    def term(self, kernel: MultiOutputKernel) -> ExactPosterior:
        """Return the posterior of one term of the kernel, which is independent of the others a priori.

        With the covariance K_t of the term its mean is K_t(X*, X) K^-1 y, and its covariance
        K_t(X*, X*) - K_t(X*, X) K^-1 K_t(X, X*) (Duvenaud, Nickisch & Rasmussen 2011).
        ``predict``, ``covariance`` and ``gradient`` refer to the term, given by
        ``self.kernel.term(regressors)``.
        """
        new = object.__new__(ExactPosterior)
        vars(new).update(vars(self) | {"kernel": kernel, "L": self.L, "alpha": self.alpha})
        vars(new).pop("_mean_function", None)
        return new

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, N) and b (N,) such that the mean of output i at Xs is A b."""
        return self.cross(i, Xs), self.alpha

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, N), (n,)."""
        half = self._solve_lower(A)
        return np.einsum("ab,ab->b", half, half)

    # -- prediction
    # ------------------------------------------------------------------------------------

    def cross(self, i: int, Xs: Matrix) -> np.ndarray:
        """Return cov(y_i(Xs), all observed values), (n, N)."""
        return self._cross([i], Xs)

    def _cross(self, outputs, Xs):
        """Return cov(y_i(Xs), all observed values) for several outputs, stacked, (len(outputs) n, N)."""
        tiles, rows = (
            make_tiles([len(x) for x in self.data.X]),
            make_tiles([len(Xs)] * len(outputs)),
        )
        K = np.empty((len(outputs) * len(Xs), self.data.n_values))

        def fill(pair):
            a, b = pair
            i = outputs[a.output]
            K[a.stacked, b.stacked] = (
                self.kernel.block(i, b.output, Xs[a.rows], self.data.X[b.output][b.rows])
                if self.kernel.couples(i, b.output)
                else 0.0
            )

        thread_map(fill, [(a, b) for a in rows for b in tiles])
        return K

    def _solve_lower(self, K):
        """Return L^-1 K^T, (N, n), for covariances K (n, N) with the stacked values; K is overwritten."""
        return triangular_solve(self.L, K.T)

    def _chunks(self, n, per_row):
        """Return slices of n rows such that ``per_row`` doubles for each row fit the working memory."""
        step = max(1, int(CHUNK_BYTES / 8 / max(per_row, 1)))
        return [slice(a, min(a + step, n)) for a in range(0, max(n, 1), step)]

    @few_threads
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        if not return_variance:
            return self._mean_function.each(Xs[None])[0] if len(Xs) <= FEW else self._mean(Xs)
        P = self.kernel.n_outputs
        mean, variance = np.empty((2, len(Xs), P))
        for rows in self._chunks(len(Xs), P * self.data.n_values):
            K = self._cross(range(P), Xs[rows])
            mean[rows] = (K @ self.alpha).reshape(P, -1).T  # equation 17
            half = self._solve_lower(K).T
            explained = np.einsum("ab,ab->a", half, half).reshape(P, -1)
            prior = np.stack([self.kernel.block_diag(i, Xs[rows]) for i in range(P)])
            variance[rows] = unexplained_variance(prior, explained).T  # equation 18
        return mean, variance

    @cached_property
    def _mean_function(self):
        """The mean as a function that is fast for few points."""
        return covariance_paths(self.kernel, self.data.X, self.alpha[None])

    def _mean(self, Xs):
        """Return the mean; covariances are computed and used tile by tile, within the cache."""
        mean = np.zeros((len(Xs), self.kernel.n_outputs))
        tiles = make_tiles([len(x) for x in self.data.X])
        side = min(ROWS, -(-len(Xs) // n_threads()))

        def add(row):
            i = row.output
            for b in tiles:
                if self.kernel.couples(i, b.output):
                    block = self.kernel.block(
                        i, b.output, Xs[row.rows], self.data.X[b.output][b.rows]
                    )
                    mean[row.rows, i] += block @ self.alpha[b.stacked]

        thread_map(add, make_tiles([len(Xs)] * self.kernel.n_outputs, max(1, side)))
        return mean

    @few_threads
    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        half = self._solve_lower(self._cross(range(self.kernel.n_outputs), Xs))
        return self.kernel(Xs) - half.T @ half

    @few_threads
    def gradient(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return d mean / d x at Xs, (n, P, d), and with ``return_variance`` the variance of the slopes."""
        P, d = self.kernel.n_outputs, np.shape(Xs)[1]
        mean = np.zeros((len(Xs), P, d))
        parts = self.data.X, np.split(self.alpha, np.cumsum([len(y) for y in self.data.y])[:-1])
        for rows, i in product(self._chunks(len(Xs), d * self.data.n_values), range(P)):
            for j, (Xj, alpha) in enumerate(zip(*parts, strict=True)):
                if self.kernel.couples(i, j):
                    mean[rows, i] += self.kernel.derivative_times(i, j, Xs[rows], Xj, alpha)
        if not return_variance:
            return mean
        variance = np.empty((len(Xs), P, d))
        for rows, i in product(self._chunks(len(Xs), d * self.data.n_values), range(P)):
            blocks = [
                self.kernel.block_derivative(i, j, Xs[rows], Xj) for j, Xj in enumerate(self.data.X)
            ]
            half = self._solve_lower(np.concatenate(blocks, axis=2).reshape(-1, self.data.n_values))
            explained = np.einsum("ab,ab->b", half, half).reshape(d, -1).T
            variance[rows, i] = unexplained_variance(
                self.kernel.derivative_diag(i, Xs[rows]), explained
            )
        return mean, variance

    def paths(self, n_paths: int, random_state: Seed) -> Paths:
        """Return samples of the posterior, f + Kfy Kyy^-1 (y - f(X) - noise), that are functions of the regressors."""
        rng, data = check_random_state(random_state), self.data
        with threads_for(self.size):
            prior = prior_paths(self.kernel, n_paths, FREQUENCIES, rng)
            points, row = np.unique(np.concatenate(data.X), axis=0, return_inverse=True)
            f = prior.values(points[None])
            places = enumerate(consecutive(data.X))
            f = np.hstack([f[:, row.ravel()[place], i] for i, place in places])
            residual = np.concatenate(data.y) - f - draw_noise(self.noise, data, n_paths, rng)
            correction = covariance_paths(self.kernel, data.X, self.solve(residual.T).T)
            return Paths(prior + correction, n_paths, self.kernel.n_features)
