"""Exact inference: likelihood, gradient and posterior by one Cholesky factorisation, block by block.

Only this file knows how the N x N matrix is laid out; kernels only ever see one tile of one pair of outputs.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skdgp._linalg import (
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._threads import thread_map, threads_for

TILE = 384  # a tile of doubles and its temporaries stay in the second-level cache
CHUNK_BYTES = 2**27  # working memory of one chunk of predictions


class Data(NamedTuple):
    """Observed values: inputs (n_i, d) and targets (n_i,) of each output."""

    X: list[np.ndarray]
    y: list[np.ndarray]

    @classmethod
    def from_table(cls, X, Y):
        """Return the observed values of X (n, d), Y (n, P) with NaN where an output was not observed."""
        seen = np.isfinite(Y)
        return cls([X[s] for s in seen.T], [y[s] for y, s in zip(Y.T, seen.T, strict=True)])

    @property
    def n_values(self) -> int:
        """Number of observed values N."""
        return sum(len(y) for y in self.y)


class _Tile(NamedTuple):
    output: int
    own: slice  # within the output
    all: slice  # within the stacked values


def _tiles(sizes):
    """Cut outputs of the given sizes into tiles."""
    tiles, start = [], 0
    for i, size in enumerate(sizes):
        n_pieces = -(-size // TILE)
        edges = np.linspace(0, size, n_pieces + 1).astype(int)
        for a, b in pairwise(edges):
            tiles.append(_Tile(i, slice(a, b), slice(start + a, start + b)))
        start += size
    return tiles


def _pairs(tiles):
    """Return the pairs of tiles on and above the diagonal."""
    return [(a, b) for k, a in enumerate(tiles) for b in tiles[k:]]


def covariance(kernel, noise, X) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is the noise variance of each output, (P,).
    """
    tiles = _tiles([len(x) for x in X])
    N = sum(len(x) for x in X)
    upper = np.empty((N, N))  # in C order: its transpose is the lower triangle in Fortran order

    def fill(pair):
        a, b = pair
        upper[a.all, b.all] = kernel.block(a.output, b.output, X[a.output][a.own], X[b.output][b.own])

    thread_map(fill, _pairs(tiles))
    np.einsum("ii->i", upper)[:] += np.repeat(noise, [len(x) for x in X])
    return upper.T


def log_likelihood(kernel, noise, data: Data, eval_gradient=False):
    """Return the log marginal likelihood (equation 20) and its gradient with respect to [theta, log noise].

    With W = alpha alpha^T - K^-1 the gradient is 1/2 sum(W * dK/dtheta), contracted tile by tile. Memory: one
    N x N matrix, which is covariance, factor and inverse in turn.
    """
    with threads_for(data.n_values):
        y = np.concatenate(data.y)
        L = jittered_cholesky(lambda: covariance(kernel, noise, data.X))
        alpha = cholesky_solve(L, y)
        value = -0.5 * (y @ alpha + log_determinant(L) + len(y) * np.log(2 * np.pi))
        return (value, _gradient(kernel, noise, data, alpha, L)) if eval_gradient else value


def _gradient(kernel, noise, data, alpha, L):
    inverse = cholesky_inverse(L).T  # its upper triangle, in C order
    tiles = _tiles([len(x) for x in data.X])

    def contract(pair):
        a, b = pair
        W = np.multiply.outer(alpha[a.all], alpha[b.all])
        W -= inverse[a.all, b.all]
        if a is b:
            W = np.triu(W, 1)
            W += W.T
            np.einsum("ii->i", W)[:] = alpha[a.all] ** 2 - np.einsum("ii->i", inverse[a.all, a.all])
            W *= 0.5
        # Off the diagonal the tile stands for its mirror image too: twice one half.
        return kernel.block_gradient(a.output, b.output, data.X[a.output][a.own], data.X[b.output][b.own], W)

    d_theta = np.sum(thread_map(contract, _pairs(tiles)), axis=0)
    diagonal = alpha**2 - np.einsum("ii->i", inverse)
    ends = np.cumsum([0, *(len(x) for x in data.X)])
    d_noise = [0.5 * s * diagonal[a:b].sum() for s, (a, b) in zip(noise, pairwise(ends), strict=True)]
    return np.concatenate([d_theta, d_noise])


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
        tiles, rows = _tiles([len(x) for x in self.data.X]), _tiles([len(Xs)])
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
