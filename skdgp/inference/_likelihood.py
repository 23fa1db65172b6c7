"""The exact likelihood and its gradient by one Cholesky factorisation, with the noise of its covariance.

Only this file knows the layout of the N x N matrix. A kernel computes one tile of one pair of
outputs at a time.

Noise is white noise of each output, and noise propagated from the regressors to all outputs. The
noise of sample a has the covariance diag(sigma^2) + J_a S J_a^T, with the slopes J_a of the
posterior mean and the covariance S of errors of the regressors (McHutchon & Rasmussen 2011). With G
= J R and S = R diag(s) R^T this is diag(sigma^2) + G_a diag(s) G_a^T. G is called ``loading``, as
in factor analysis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.blas import dsymv, dsyr

from skdgp._compute.linalg import (
    RowPairs,
    cholesky_inverse,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._compute.parallel import thread_map, threads_for
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.kernels import MultiOutputKernel, PathBundle

TILE = (
    768  # largest side of a tile, in values of one output; kernels cut it further to fit the cache
)
PAIRED = 1000  # largest number of rows whose pairs are all kept
SLOPE_ROWS = 512  # samples in one step of the slopes: their covariances fit the cache
HALF = 384  # largest side of a tile on the diagonal, where both triangles are computed


class SampleNoise(NamedTuple):
    """For each output: the sample index of each value, (n_i,), and its loading G (n_i, r) on the regressors' noise."""

    sample: Sequence[np.ndarray]
    loading: Sequence[np.ndarray]


class SlopeNoise(NamedTuple):
    """A `SampleNoise` by the slopes of a function f.

    The loading of output i is d f_i / d x times ``std`` (d,) or (P, d). It is computed where it is
    needed, from the few weights of the function: kept, it would hold P times as many numbers as X.
    ``sample`` and ``X`` are those of the values.
    """

    sample: Sequence[np.ndarray]
    X: Sequence[np.ndarray]
    function: PathBundle
    std: np.ndarray

    @property
    def loading(self) -> list[np.ndarray]:
        """Loadings of the values of each output, (n_i, r)."""
        samples, X = sample_table(self.X, self.sample)
        batches = [X[start : start + SLOPE_ROWS] for start in range(0, len(X), SLOPE_ROWS)]
        with threads_for(len(X)):
            slopes = thread_map(lambda batch: self.function.slopes(batch[None])[0], batches)
        loading = np.concatenate(slopes) * self.std
        return [
            loading[:, i]
            if len(sample) == len(samples)
            else loading[samples.searchsorted(sample), i]
            for i, sample in enumerate(self.sample)
        ]


def sample_table(X: Sequence[Matrix], sample: Sequence[Indices]) -> tuple[Indices, Matrix]:
    """Return the samples that any output has, (n,), in order, and their inputs (n, d)."""
    samples, first = np.unique(np.concatenate(sample), return_index=True)
    for inputs, own in zip(X, sample, strict=True):
        if len(own) == len(samples):
            return samples, inputs
    return samples, np.concatenate(X)[first]


def noise_pairs(noise: SampleNoise | SlopeNoise) -> Iterator[tuple]:
    """Yield (i, j, rows, columns, G_i, G_j) for each pair of outputs i <= j.

    ``rows`` and ``columns`` are the indices among the stacked values of two values of the same
    sample, on or above the diagonal.
    """
    sample, loading = noise.sample, noise.loading
    start = np.cumsum([0, *map(len, sample)])
    for i, j in combinations_with_replacement(range(len(sample)), 2):
        _, a, b = np.intersect1d(sample[i], sample[j], assume_unique=True, return_indices=True)
        yield i, j, start[i] + a, start[j] + b, loading[i][a], loading[j][b]


def _white_and_scale(noise, data):
    """Return sigma^2 (P,) and the factors s (r,) of a noise vector [sigma^2, s]; s is 1 where it is not learned."""
    P = len(data.y)
    return noise[:P], noise[P:] if len(noise) > P else 1.0


def add_noise(K, noise, data) -> None:
    """Add the covariance of ``noise``, [sigma^2 (P)] or [sigma^2, s (r)], to the upper triangle of K (N, N)."""
    white, scale = _white_and_scale(noise, data)
    np.einsum("ii->i", K)[:] += np.repeat(white, [len(y) for y in data.y])
    if data.sample_noise is not None:
        for _, _, rows, columns, first, second in noise_pairs(data.sample_noise):
            K[rows, columns] += np.einsum("nr,nr->n", first * scale, second)


def draw_noise(noise, data, n_draws, random_state) -> np.ndarray:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) holds the white noise variances."""
    std = np.repeat(np.sqrt(noise), [len(y) for y in data.y])
    draws = std * random_state.standard_normal((n_draws, len(std)))
    if data.sample_noise is not None:
        sample, loading = data.sample_noise.sample, data.sample_noise.loading
        n_samples = 1 + max(s.max() for s in sample if len(s))
        error = random_state.standard_normal((n_draws, n_samples, loading[0].shape[1]))
        propagated = [
            np.einsum("snr,nr->sn", error[:, s], G) for s, G in zip(sample, loading, strict=True)
        ]
        draws += np.hstack(propagated)
    return draws


def noise_gradient(W, noise, data) -> np.ndarray:
    """Return 1/2 sum(W * dK / d log noise), in the shape of ``noise``; only the upper triangle of W is read."""
    P, (white, scale) = len(data.y), _white_and_scale(noise, data)
    outputs = np.repeat(
        np.arange(P), [len(y) for y in data.y]
    )  # an output without values contributes zero
    by_white = 0.5 * white * np.bincount(outputs, np.einsum("ii->i", W), minlength=P)
    if len(noise) == P:
        return by_white
    by_scale = np.zeros(len(noise) - P)
    for i, j, rows, columns, first, second in noise_pairs(data.sample_noise):
        by_scale += (0.5 if i == j else 1.0) * np.einsum(
            "n,nr,nr->r", W[rows, columns], first, second
        )
    return np.concatenate([by_white, scale * by_scale])


class Data(NamedTuple):
    """Observed values: inputs (n_i, d) and targets (n_i,) of each output, and their noise model.

    Outputs that are observed in the same rows share the array of their inputs, which is the table's
    where these are all. ``pairs`` are the pairs of rows of the only output with values, for
    repeated evaluations of few rows. ``sample`` (n_i,) is the row of each value in the table.
    """

    X: list[np.ndarray]
    y: list[np.ndarray]
    sample_noise: SampleNoise | SlopeNoise | None = None
    pairs: RowPairs | None = None
    sample: Sequence[np.ndarray] = ()

    @classmethod
    def from_table(
        cls,
        X: Matrix,
        Y: Matrix,
        loading: Array | None = None,
    ) -> Data:
        """Return the observed values of X (n, d) and Y (n, P), with NaN where an output was not observed.

        ``loading`` (n, P, r) describes noisy regressors, see ``SampleNoise``.
        """
        observed = np.isfinite(Y)
        inputs: dict[bytes, Matrix] = {}
        samples: dict[bytes, np.ndarray] = {}
        for rows in observed.T:
            if rows.tobytes() not in inputs:
                inputs[rows.tobytes()] = X if rows.all() else X[rows]
                samples[rows.tobytes()] = np.flatnonzero(rows)
        values = cls(
            [inputs[rows.tobytes()] for rows in observed.T],
            [y[rows] for y, rows in zip(Y.T, observed.T, strict=True)],
            sample=[samples[rows.tobytes()] for rows in observed.T],
        )
        if loading is None:
            return values
        loadings = [loading[rows, i] for i, rows in enumerate(observed.T)]
        return values._replace(sample_noise=SampleNoise(values.sample, loadings))

    def with_slopes(self, function: PathBundle, std: Array) -> Data:
        """Return the values of a table with the noise of regressors that the slopes of a function propagate.

        ``std`` (d,) or (P, d) are the standard deviations of the regressors' noise.
        """
        return self._replace(sample_noise=SlopeNoise(self.sample, self.X, function, std))

    def with_loadings(self) -> Data:
        """Return the values with the loadings of their noise in memory, for repeated evaluations."""
        noise = self.sample_noise
        if noise is None:
            return self
        return self._replace(sample_noise=SampleNoise(noise.sample, noise.loading))

    def every(self, step: int) -> Data:
        """Return every ``step``-th value of each output."""
        X, y, noise = [x[::step] for x in self.X], [y[::step] for y in self.y], self.sample_noise
        if noise is None:
            return Data(X, y)
        sample = [part[::step] for part in noise.sample]
        return Data(X, y, SampleNoise(sample, [part[::step] for part in noise.loading]))

    def by_output(self) -> list[Data]:
        """Return the values of each output that has any alone, for evaluations one after another.

        What noise of regressors has in common between outputs is lost. Outputs of the same rows
        share their pairs.
        """

        def only(i, parts):
            return [part if k == i else part[:0] for k, part in enumerate(parts)]

        pairs: dict = {X.tobytes(): RowPairs(X) for X in self.X if 0 < len(X) <= PAIRED}
        noise = self.with_loadings().sample_noise
        return [
            Data(
                only(i, self.X),
                only(i, self.y),
                noise and SampleNoise(only(i, noise.sample), only(i, noise.loading)),
                pairs=pairs.get(X.tobytes()),
            )
            for i, X in enumerate(self.X)
            if len(X)
        ]

    @property
    def n_values(self) -> int:
        """Number of observed values N."""
        return sum(len(y) for y in self.y)


class Tile(NamedTuple):
    """A slice of the values of one output."""

    output: int
    rows: slice  # among the values of the output
    stacked: slice  # among the stacked values of all outputs


def _cut(tile, side):
    row, place = tile.rows.start, tile.stacked.start
    size = tile.rows.stop - row
    edges = np.linspace(0, size, -(-size // side) + 1).astype(int)
    return [
        Tile(tile.output, slice(row + a, row + b), slice(place + a, place + b))
        for a, b in pairwise(edges)
    ]


def _pairs(kernel, sizes):
    """Return the pairs of tiles on and above the diagonal that the kernel couples."""
    ends = np.cumsum([0, *sizes])
    outputs = [Tile(i, slice(0, n), slice(ends[i], ends[i] + n)) for i, n in enumerate(sizes)]
    tiles = [tile for output in outputs for tile in _cut(output, TILE)]
    pairs = list(combinations(tiles, 2))
    for tile in tiles:
        pairs += combinations_with_replacement(_cut(tile, HALF), 2)
    return [(a, b) for a, b in pairs if kernel.couples(a.output, b.output)]


def covariance(
    kernel: MultiOutputKernel,
    noise: Vector,
    data: Data,
    at_pairs: Vector | None = None,
) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is as for ``add_noise``. ``at_pairs`` (n_pairs,) is the covariance of ``data.pairs``,
    where it is known.
    """
    X = data.X
    sizes = [len(x) for x in X]
    # In C order: its transpose is the lower triangle in Fortran order.
    upper = np.zeros((sum(sizes), sum(sizes)))

    def fill(pair):
        a, b = pair
        upper[a.stacked, b.stacked] = kernel.block(
            a.output, b.output, X[a.output][a.rows], X[b.output][b.rows]
        )

    if at_pairs is not None and data.pairs is not None:
        upper.ravel()[data.pairs.place] = at_pairs
    else:
        thread_map(fill, _pairs(kernel, sizes))
    add_noise(upper, noise, data)
    return upper.T


def log_likelihood(
    kernel: MultiOutputKernel,
    noise: Vector,
    data: Data,
    eval_gradient: bool = False,
) -> Any:
    """Return the log marginal likelihood (equation 20) and its gradient by [theta, log noise].

    With W = alpha alpha^T - K^-1 the gradient is 1/2 sum(W * dK/dtheta), computed tile by tile.

    Parameters
    ----------
    kernel : MultiOutputKernel
        With values.
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data
        Observed values of each output.
    eval_gradient : bool
        Whether to return the gradient too.

    Returns
    -------
    value : float
        The log marginal likelihood.
    gradient : ndarray (n_theta + P,)
        Only with ``eval_gradient``.
    """
    with threads_for(data.n_values):
        y = np.concatenate(data.y)
        at_pairs = by_pairs = None
        if data.pairs is not None:
            only = next(i for i, values in enumerate(data.y) if len(values))
            at_pairs, by_pairs = kernel.at_pairs(only, data.pairs)
        L = jittered_cholesky(lambda: covariance(kernel, noise, data, at_pairs))
        white = triangular_solve(L, y)  # y^T K^-1 y = white^T white
        # Equation 20.
        value = -0.5 * (white @ white + log_determinant(L) + len(y) * np.log(2 * np.pi))
        if not eval_gradient:
            return value
        return value, _gradient(kernel, noise, data, y, L, by_pairs)


def _gradient(kernel, noise, data, y, L, by_pairs):
    inverse = cholesky_inverse(L)
    # -W: only one triangle is computed and read, the upper one in C order.
    alpha = dsymv(1.0, inverse, y, lower=1)
    minus_W = dsyr(-1.0, alpha, a=inverse, lower=1, overwrite_a=1).T

    def contract(pair):
        a, b = pair
        W = minus_W[a.stacked, b.stacked]
        if a is b:
            W = np.triu(W)
            np.einsum("ii->i", W)[:] *= 0.5
        # The tile and its mirror image: twice one half.
        return kernel.block_gradient(
            a.output, b.output, data.X[a.output][a.rows], data.X[b.output][b.rows], W
        )

    if by_pairs is not None:
        w = minus_W.ravel()[data.pairs.place]
        w[data.pairs.own] *= 0.5
        d_theta = -by_pairs(w)
    else:
        d_theta = -np.sum(thread_map(contract, _pairs(kernel, [len(x) for x in data.X])), axis=0)
    return np.concatenate([d_theta, -noise_gradient(minus_W, noise, data)])
