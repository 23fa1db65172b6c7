"""The exact likelihood and its gradient by one Cholesky factorisation, block by block.

Only this file knows how the N x N matrix is laid out; kernels only ever see one tile of one pair of outputs.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skdgp._linalg import (
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
)
from skdgp._threads import thread_map, threads_for

TILE = 384  # a tile of doubles and its temporaries stay in the second-level cache


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


class Tile(NamedTuple):
    output: int
    own: slice  # within the output
    all: slice  # within the stacked values


def tiles_of(sizes):
    """Cut outputs of the given sizes into tiles."""
    tiles, start = [], 0
    for i, size in enumerate(sizes):
        n_pieces = -(-size // TILE)
        edges = np.linspace(0, size, n_pieces + 1).astype(int)
        for a, b in pairwise(edges):
            tiles.append(Tile(i, slice(a, b), slice(start + a, start + b)))
        start += size
    return tiles


def _pairs(tiles):
    """Return the pairs of tiles on and above the diagonal."""
    return [(a, b) for k, a in enumerate(tiles) for b in tiles[k:]]


def covariance(kernel, noise, X) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is the noise variance of each output, (P,).
    """
    tiles = tiles_of([len(x) for x in X])
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
    tiles = tiles_of([len(x) for x in data.X])

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
