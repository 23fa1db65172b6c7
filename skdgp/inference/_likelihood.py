"""The exact likelihood and its gradient by one Cholesky factorisation, block by block.

Only this file knows how the N x N matrix is laid out; kernels only ever see one tile of one pair of outputs.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement, pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dsymv, dsyr

from skdgp._compute.linalg import (
    cholesky_inverse,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._compute.threads import thread_map, threads_for
from skdgp.inference._noise import Drift, SampleNoise, add_noise, noise_gradient

TILE = 768  # values of an output a side: the kernel cuts further, for the cache
HALF = 384  # a side on the diagonal, where every tile computes its mirror image too


class Data(NamedTuple):
    """Observed values: inputs (n_i, d) and targets (n_i,) of each output, and what is known of their noise."""

    X: list[np.ndarray]
    y: list[np.ndarray]
    sample_noise: SampleNoise | None = None
    drift: Drift | None = None

    @classmethod
    def from_table(cls, X, Y, loading=None, clock=None, drift=(None, None)):
        """Return the observed values of X (n, d), Y (n, P) with NaN where an output was not observed.

        ``loading`` (n, P, r), where regressors are noisy: see ``SampleNoise``. ``clock`` (n, 2), time and flight, where
        noise drifts, and ``drift``, its variances and memories (P,), unless they are to be learned: see ``Drift``.
        """
        seen = np.isfinite(Y)
        return cls(
            [X[s] for s in seen.T],
            [y[s] for y, s in zip(Y.T, seen.T, strict=True)],
            None if loading is None else SampleNoise.from_table(seen, loading),
            None if clock is None else Drift([clock[s] for s in seen.T], *drift),
        )

    def joined(self, other: Data) -> Data:
        """Return these values, then the other's, output by output."""
        X = [np.concatenate(pair) for pair in zip(self.X, other.X, strict=True)]
        y = [np.concatenate(pair) for pair in zip(self.y, other.y, strict=True)]
        sample_noise, drift = self.sample_noise, self.drift
        if sample_noise is not None and other.sample_noise is not None:
            sample_noise = sample_noise.joined(other.sample_noise)
        if drift is not None and other.drift is not None:
            drift = drift._replace(clock=[np.concatenate(c) for c in zip(drift.clock, other.drift.clock, strict=True)])
        return Data(X, y, sample_noise, drift)

    @property
    def n_values(self) -> int:
        """Number of observed values N."""
        return sum(len(y) for y in self.y)


class Tile(NamedTuple):
    """A run of the values of one output."""

    output: int
    own: slice  # within the output
    all: slice  # within the stacked values


def tiles_of(sizes, side=None):
    """Cut outputs of the given sizes into tiles."""
    tiles, start = [], 0
    for i, size in enumerate(sizes):
        tiles += _cut(Tile(i, slice(0, size), slice(start, start + size)), side or TILE)
        start += size
    return tiles


def _cut(tile, side):
    size, own, everywhere = tile.own.stop - tile.own.start, tile.own.start, tile.all.start
    edges = np.linspace(0, size, -(-size // side) + 1).astype(int)
    return [
        Tile(tile.output, slice(own + a, own + b), slice(everywhere + a, everywhere + b)) for a, b in pairwise(edges)
    ]


def _pairs(kernel, sizes):
    """Return the pairs of tiles, on and above the diagonal, that the kernel couples."""
    tiles = tiles_of(sizes)
    pairs = list(combinations(tiles, 2))
    for tile in tiles:
        pairs += combinations_with_replacement(_cut(tile, HALF), 2)
    return [(a, b) for a, b in pairs if kernel.couples(a.output, b.output)]


def covariance(kernel, noise, data: Data, workspace=None) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is that of ``add_noise``; ``workspace`` (N, N) in C order is written to, where given.
    """
    X = data.X
    sizes = [len(x) for x in X]
    pairs = _pairs(kernel, sizes)
    # In C order: its transpose is the lower triangle in Fortran order.
    upper = np.empty((sum(sizes), sum(sizes))) if workspace is None else workspace
    if not all_coupled(kernel):
        upper.fill(0.0)

    def fill(pair):
        a, b = pair
        upper[a.all, b.all] = kernel.block(a.output, b.output, X[a.output][a.own], X[b.output][b.own])

    thread_map(fill, pairs)
    add_noise(upper, noise, data)
    return upper.T


def all_coupled(kernel) -> bool:
    """Return whether the kernel couples every pair of outputs."""
    return all(kernel.couples(i, j) for i, j in combinations(range(kernel.n_outputs), 2))


def log_likelihood(kernel, noise, data: Data, eval_gradient=False, workspace=None):
    """Return the log marginal likelihood (equation 20) and its gradient with respect to [theta, log noise].

    With W = alpha alpha^T - K^-1 the gradient is 1/2 sum(W * dK/dtheta), contracted tile by tile.

    Parameters
    ----------
    kernel : MultiOutputKernel
        With values.
    noise : ndarray (P,)
        Variance of each output's noise.
    data : Data
        Observed values of each output.
    eval_gradient : bool
        Whether to return the gradient, too.
    workspace : ndarray (N, N), C order, or None
        All the memory that is needed: covariance, factor and inverse in turn. Who evaluates often saves the time to ask
        for it.

    Returns
    -------
    value : float
        The log marginal likelihood.
    gradient : ndarray (n_theta + P,)
        Only with ``eval_gradient``.
    """
    with threads_for(data.n_values):
        y = np.concatenate(data.y)
        L = jittered_cholesky(lambda: covariance(kernel, noise, data, workspace))
        white = triangular_solve(L, y)
        value = -0.5 * (white @ white + log_determinant(L) + len(y) * np.log(2 * np.pi))
        return (value, _gradient(kernel, noise, data, y, L)) if eval_gradient else value


def _gradient(kernel, noise, data, y, L):
    inverse = cholesky_inverse(L)
    alpha = dsymv(1.0, inverse, y, lower=1)
    # -W, of which only one triangle is computed, and read; in C order its upper one.
    minus_W = dsyr(-1.0, alpha, a=inverse, lower=1, overwrite_a=1).T

    def contract(pair):
        a, b = pair
        W = minus_W[a.all, b.all]
        if a is b:
            W = np.triu(W)
            np.einsum("ii->i", W)[:] *= 0.5
        # The tile stands for its mirror image too: twice one half.
        return kernel.block_gradient(a.output, b.output, data.X[a.output][a.own], data.X[b.output][b.own], W)

    sizes = [len(x) for x in data.X]
    d_theta = -np.sum(thread_map(contract, _pairs(kernel, sizes)), axis=0)
    return np.concatenate([d_theta, -noise_gradient(minus_W, noise, data)])
