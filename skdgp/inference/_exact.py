"""The exact posterior: one Cholesky factorisation, then equations 17 and 18."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.linalg.blas import dsyrk
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    jittered_cholesky,
    log_determinant,
    triangular_solve,
    unexplained_variance,
)
from skdgp._compute.parallel import few_threads, n_threads, thread_map, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._average import Single
from skdgp.inference._likelihood import Data, covariance, log_likelihood, make_tiles
from skdgp.inference._noise import draw_noise
from skdgp.inference._paths import FREQUENCIES, Paths
from skdgp.inference._sparse import SparsePosterior, shares_of

CHUNK_BYTES = 2**27  # working memory of one chunk of predictions
FEW = 16  # up to this many points the mean is one matrix product instead of many tiles
ROWS = 256  # samples in one tile of a mean
TAIL = 8  # appended rows are merged into the factor when they exceed 1 / TAIL of it


class ExactPosterior(Single):
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

    def __init__(self, kernel: Any, noise: Vector, data: Data) -> None:
        self.kernel, self.noise, self.data = kernel, np.asarray(noise, dtype=float), data
        self._rows = slice(None)
        self._solve()

    @property
    def size(self) -> int:
        """Number of values N."""
        return self.data.n_values

    def _solve(self):
        square, determinant = self._white @ self._white, self.factor.log_determinant()
        self.log_marginal_likelihood = -0.5 * (
            square + determinant + self.data.n_values * np.log(2 * np.pi)
        )

    @cached_property
    def factor(self) -> Factor:
        """Cholesky factor of Kff + noise, with rows in the order ``_rows``.

        A loaded posterior computes it again.

        The result has the same bits for the same number of BLAS threads, unless rows were appended
        before.
        """
        with threads_for(self.size):
            return Factor(jittered_cholesky(lambda: covariance(self.kernel, self.noise, self.data)))

    @cached_property
    def _white(self):
        """L^-1 y, in the order of the factor's rows."""
        with threads_for(self.size):
            return self.factor.solve_lower(np.concatenate(self.data.y)[self._rows])

    @cached_property
    def alpha(self) -> np.ndarray:
        """K^-1 y of the stacked values, (N,)."""
        alpha = np.empty(self.data.n_values)
        with threads_for(self.size):
            alpha[self._rows] = self.factor.solve_upper(self._white)
        return alpha

    def solve(self, B: Matrix) -> np.ndarray:
        """Return K^-1 B for rows of the stacked values, (N, m)."""
        solved = np.empty(B.shape)
        with threads_for(self.size):
            half = self.factor.solve_lower(np.array(B[self._rows], order="F"))
            solved[self._rows] = self.factor.solve_upper(half)
        return solved

    @property
    def L(self) -> np.ndarray:
        """Cholesky factor of Kff + noise, (N, N). Only its lower triangle is defined."""
        return self.factor.matrix()

    def __getstate__(self):
        # A saved model holds the samples, not the N x N factor: the file is about a hundred times
        # smaller.
        not_saved = {"factor", "_rows", "_white", "_mean_function"}
        self.alpha  # noqa: B018 - computed now, so that a loaded model predicts means without the factor
        return {name: value for name, value in self.__dict__.items() if name not in not_saved}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._rows = slice(None)

    def updated(self, data: Data) -> ExactPosterior:
        """Return the posterior with further values: rows are appended to the factor.

        Each new value costs O(N^2), while a new factorisation costs O(N^3).
        """
        if data.n_values == 0:
            return self
        new = object.__new__(ExactPosterior)
        new.kernel, new.noise, new.measured = self.kernel, self.noise, self.measured
        new.data = self.data.joined(data)
        new._rows = self._appended_rows([len(y) for y in data.y])
        with threads_for(self.size):
            half = self._solve_lower(
                np.concatenate([self.cross(i, x) for i, x in enumerate(data.X)])
            )
            new.factor, corner = self.factor.extended(
                half, covariance(self.kernel, self.noise, data)
            )
            last = triangular_solve(corner, np.concatenate(data.y) - half.T @ self._white)
            new._white = np.concatenate([self._white, last])
        new._solve()
        return new

    def _appended_rows(self, added):
        """Return the index among all stacked values of each row of the extended factor."""
        sizes = [len(y) for y in self.data.y]
        before = np.cumsum([0, *added[:-1]])
        old = np.arange(sum(sizes)) + np.repeat(before, sizes)
        new = np.arange(sum(added)) + np.repeat(np.cumsum(sizes), added)
        return np.concatenate([old[self._rows], new])

    def samples(self) -> Data:
        """Return the values that the posterior has learned from."""
        return self.data

    def of(self, data: Data, noise: Vector) -> ExactPosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""
        return ExactPosterior(self.kernel, noise, data)

    def scaled_noise(self, factor: Vector) -> ExactPosterior:
        """Return the posterior with the noise of each output times a factor (P,)."""
        return ExactPosterior(self.kernel, self.noise * factor, self.data)

    def sparse(self, features: Any) -> SparsePosterior:
        """Return the sparse posterior of the same values, with these features of the kernel."""
        return SparsePosterior(self.kernel, features, self.noise, shares_of(self.data))

    def likelihood_at(self, kernel: Any, noise: Vector, eval_gradient: bool = False) -> Any:
        """Return the log likelihood of the same data at other hyperparameters, with ``eval_gradient`` its gradient."""
        return log_likelihood(kernel, noise, self.data, eval_gradient)

    def term(self, kernel: Any) -> ExactPosterior:
        """Return the posterior of one term of the kernel, which is independent of the others a priori.

        With the covariance K_t of the term its mean is K_t(X*, X) K^-1 y, and its covariance
        K_t(X*, X*) - K_t(X*, X) K^-1 K_t(X, X*) (Duvenaud, Nickisch & Rasmussen 2011). ``predict``,
        ``covariance`` and ``gradient`` are those of the term, given by
        ``self.kernel.term(regressors)``.
        """
        new = object.__new__(ExactPosterior)
        vars(new).update(
            vars(self) | {"kernel": kernel, "factor": self.factor, "alpha": self.alpha}
        )
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
        return self.factor.solve_lower(
            (K if isinstance(self._rows, slice) else np.take(K, self._rows, axis=1)).T
        )

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
            mean[rows] = (K @ self.alpha).reshape(P, -1).T
            half = self._solve_lower(K).T
            explained = np.einsum("ab,ab->a", half, half).reshape(P, -1)
            prior = np.stack([self.kernel.block_diag(i, Xs[rows]) for i in range(P)])
            variance[rows] = unexplained_variance(prior, explained).T
        return mean, variance

    @cached_property
    def _mean_function(self):
        """The mean as a function that is fast for few points."""
        edges = np.cumsum([0, *map(len, self.data.X)])
        return self.kernel.paths(self.data.X, [self.alpha[None, a:b] for a, b in pairwise(edges)])

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
        edges = np.cumsum([0, *map(len, data.X)])
        with threads_for(self.size):
            prior = self.kernel.prior_paths(n_paths, FREQUENCIES, rng)
            points, row = np.unique(np.concatenate(data.X), axis=0, return_inverse=True)
            f = prior.values(points[None])
            f = np.hstack([f[:, row.ravel()[a:b], i] for i, (a, b) in enumerate(pairwise(edges))])
            residual = np.concatenate(data.y) - f - draw_noise(self.noise, data, n_paths, rng)
            coefficients = self.solve(residual.T).T
            by_output = [np.ascontiguousarray(coefficients[:, a:b]) for a, b in pairwise(edges)]
            return Paths(
                prior + self.kernel.paths(data.X, by_output), n_paths, self.kernel.n_features
            )


class Factor:
    """L of K = L L^T, (N, N): a large head (n, n), and a small tail of appended rows [below (m, n), tail (m, m)].

    All are in Fortran order; what stands above the diagonals is not read. Appending copies the tail
    only. When the tail is large, both are merged.
    """

    def __init__(self, head, below=None, tail=None) -> None:
        self.head, self.below, self.tail = head, below, tail

    @property
    def size(self) -> int:
        """Number of rows N."""
        return len(self.head) + (0 if self.tail is None else len(self.tail))

    def matrix(self) -> np.ndarray:
        """Return L, (N, N); entries above its diagonal are undefined."""
        return self.head if self.tail is None else _stacked(self.head, self.below, self.tail)

    def log_determinant(self) -> float:
        """Return log |K|."""
        return log_determinant(self.head) + (
            0.0 if self.tail is None else log_determinant(self.tail)
        )

    def solve_lower(self, B: Matrix):
        """Return L^-1 B; a matrix ``B`` in Fortran order may be overwritten."""
        if self.tail is None:
            return triangular_solve(self.head, B)
        n = len(self.head)
        first = triangular_solve(self.head, np.array(B[:n], order="F"))
        last = np.asfortranarray(B[n:] - self.below @ first)
        return np.concatenate([first, triangular_solve(self.tail, last)])

    def solve_upper(self, b):
        """Return L^-T b for a vector b."""
        if self.tail is None:
            return triangular_solve(self.head, b, transposed=True)
        n = len(self.head)
        last = triangular_solve(self.tail, b[n:], transposed=True)
        first = triangular_solve(self.head, b[:n] - self.below.T @ last, transposed=True)
        return np.concatenate([first, last])

    def extended(self, half, K) -> tuple[Factor, np.ndarray]:
        """Return the factor of the matrix with further rows and columns, and its last diagonal block, (m, m).

        ``half`` (N, m) is ``solve_lower`` of the covariance of the old rows with the new rows. The
        lower triangle of K (m, m), in Fortran order, is the covariance of the new rows; it is
        overwritten. Raises LinAlgError as ``jittered_cholesky``.
        """
        K = dsyrk(
            -1.0, half, beta=1.0, c=K, trans=1, lower=1, overwrite_c=1
        )  # what is above the diagonal may be NaN
        corner = jittered_cholesky(lambda: K.copy(order="F"))
        n = len(self.head)
        if self.tail is None:
            below, tail = half.T, corner
        else:
            below = np.concatenate([self.below, half[:n].T])
            tail = _stacked(self.tail, half[n:].T, corner)
        if TAIL * len(tail) > n:
            return Factor(_stacked(self.head, below, tail)), corner
        return Factor(self.head, np.asfortranarray(below), tail), corner


def _stacked(head, below, tail):
    """Return [[head, *], [below, tail]], in Fortran order."""
    n, m = len(head), len(tail)
    L = np.empty((n + m, n + m), order="F")
    L[:n, :n], L[n:, :n], L[n:, n:] = head, below, tail
    return L
