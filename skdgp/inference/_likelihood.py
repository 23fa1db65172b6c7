"""The exact likelihood and its gradient by one Cholesky factorisation, with the noise of its covariance.

The N x N matrix is output-major. A kernel computes one tile of one pair of outputs at a time.

Noise is white noise of each output, and noise propagated from the regressors to all outputs. The
noise of sample a has the covariance diag(sigma^2) + J_a S J_a^T, with the slopes J_a of the
posterior mean and the covariance S of errors of the regressors (McHutchon & Rasmussen 2011). With G
= J R and S = R diag(s) R^T this is diag(sigma^2) + G_a diag(s) G_a^T. G is called ``loading``, as
in factor analysis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.blas import dsyr
from scipy.sparse.csgraph import connected_components

from skdgp._compute.linalg import (
    cholesky_inverse,
    cholesky_solve,
    consecutive,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._compute.parallel import thread_map, threads_for
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.kernels import InputPair, MultiOutputKernel, PathBundle


@dataclass(frozen=True)
class TileSettings:
    """Largest sides of the tiles of the covariance matrix, in values of one output: what fits the cache."""

    #: Beside the diagonal
    side: int = 768
    #: On the diagonal, where both triangles are computed
    diagonal: int = 256


TILES = TileSettings()
SLOPE_ROWS = 512  # samples in one step of the slopes: their covariances fit the cache


class SampleNoise(NamedTuple):
    """For each output: the sample index of each value, (n_i,), and its loading G (n_i, r) on the regressors' noise."""

    sample: Sequence[np.ndarray]
    loading: Sequence[np.ndarray]


class SlopeNoise(NamedTuple):
    """A `SampleNoise` by the slopes of a function f.

    The loading of output i is d f_i / d x times ``std`` (d,) or (P, d). It is computed where it is
    needed, from the few weights of the function: kept, it would hold P times as many numbers as X.
    ``sample`` and ``X`` belong to the values.
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
        of_outputs = []
        for i, sample in enumerate(self.sample):
            everywhere = len(sample) == len(samples)
            rows = slice(None) if everywhere else samples.searchsorted(sample)
            of_outputs.append(loading[rows, i])
        return of_outputs


def sample_table(X: Sequence[Matrix], sample: Sequence[Indices]) -> tuple[Indices, Matrix]:
    """Return the samples that any output has, (n,), in order, and their inputs (n, d)."""
    samples, first = np.unique(np.concatenate(sample), return_index=True)
    for inputs, places in zip(X, sample, strict=True):
        if len(places) == len(samples):
            return samples, inputs
    return samples, np.concatenate(X)[first]


def noise_pairs(noise: SampleNoise | SlopeNoise) -> Iterator[tuple]:
    """Yield (i, j, rows, columns, G_i, G_j) for each pair of outputs i <= j.

    ``rows`` and ``columns`` are the indices among the stacked values of two values of the same
    sample, on or above the diagonal.
    """
    sample = noise.sample
    loading = noise.loading
    start = np.cumsum([0, *map(len, sample)])
    for i, j in combinations_with_replacement(range(len(sample)), 2):
        _, a, b = np.intersect1d(sample[i], sample[j], assume_unique=True, return_indices=True)
        yield i, j, start[i] + a, start[j] + b, loading[i][a], loading[j][b]


def _white_and_scale(noise, data):
    """Return sigma^2 (P,) and the factors s (r,) of a noise vector [sigma^2, s]; s is 1 where it is not learned."""
    P = len(data.y)
    scale = noise[P:] if len(noise) > P else 1.0
    return noise[:P], scale


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
        loading = data.sample_noise.loading
        n_samples = 1 + max(sample.max() for sample in data.sample_noise.sample if len(sample))
        error = random_state.standard_normal((n_draws, n_samples, loading[0].shape[1]))
        propagated = []
        for sample, G in zip(data.sample_noise.sample, loading, strict=True):
            propagated.append(np.einsum("snr,nr->sn", error[:, sample], G))
        draws += np.hstack(propagated)
    return draws


def noise_gradient(W, noise, data) -> np.ndarray:
    """Return 1/2 sum(W * dK / d log noise), in the shape of ``noise``; only the upper triangle of W is read."""
    P = len(data.y)
    white, scale = _white_and_scale(noise, data)
    # an output without values contributes zero
    outputs = np.repeat(np.arange(P), [len(y) for y in data.y])
    by_white = 0.5 * white * np.bincount(outputs, np.einsum("ii->i", W), minlength=P)
    if len(noise) == P:
        return by_white
    by_scale = np.zeros(len(noise) - P)
    for i, j, rows, columns, first, second in noise_pairs(data.sample_noise):
        times = 0.5 if i == j else 1.0
        by_scale += times * np.einsum("n,nr,nr->r", W[rows, columns], first, second)
    return np.concatenate([by_white, scale * by_scale])


class Data(NamedTuple):
    """Observed values: inputs (n_i, d) and targets (n_i,) of each output, and their noise model.

    Outputs that are observed in the same rows share the array of their inputs, which is the table's
    where these are all. ``sample`` (n_i,) is the row of each value in the table.
    """

    X: list[np.ndarray]
    y: list[np.ndarray]
    sample_noise: SampleNoise | SlopeNoise | None = None
    sample: Sequence[np.ndarray] = ()

    @classmethod
    def from_table(cls, X: Matrix, Y: Matrix, loading: Array | None = None) -> Data:
        """Return the observed values of X (n, d) and Y (n, P), with NaN where an output was not observed.

        ``loading`` (n, P, r) describes noisy regressors, see ``SampleNoise``.
        """
        inputs: dict[bytes, Matrix] = {}
        samples: dict[bytes, Indices] = {}
        keys = []
        observed = np.isfinite(Y).T
        for rows in observed:
            key = rows.tobytes()
            keys.append(key)
            if key not in inputs:
                inputs[key] = X if rows.all() else X[rows]
                samples[key] = np.flatnonzero(rows)
        sample = [samples[key] for key in keys]
        noise = None
        if loading is not None:
            noise = SampleNoise(sample, [loading[rows, i] for i, rows in enumerate(observed)])
        values = [y[rows] for y, rows in zip(Y.T, observed, strict=True)]
        return cls([inputs[key] for key in keys], values, noise, sample)

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

    def inflated(self, factor: Vector) -> Data:
        """Return the values with the noise of their samples, where there is any, times ``factor`` (P,)."""
        noise = self.sample_noise
        if noise is None:
            return self
        root = np.sqrt(factor)
        if isinstance(noise, SlopeNoise):
            return self._replace(sample_noise=noise._replace(std=root[:, None] * noise.std))
        loading = [r * G for r, G in zip(root, noise.loading, strict=True)]
        return self._replace(sample_noise=noise._replace(loading=loading))

    def of_outputs(self, outputs: Sequence[int]) -> Data:
        """Return the values of some outputs; the others have none."""
        if len(outputs) == len(self.y):
            return self
        rows = [slice(None) if i in outputs else slice(0) for i in range(len(self.y))]
        return self._of_rows(rows)

    def _of_rows(self, rows):
        """Return some values of each output."""

        def chosen(parts):
            return [part[places] for part, places in zip(parts, rows, strict=True)]

        noise = self.sample_noise
        if noise is not None:
            noise = SampleNoise(chosen(noise.sample), chosen(noise.loading))
        sample = chosen(self.sample) if self.sample else ()
        return Data(chosen(self.X), chosen(self.y), noise, sample)

    @property
    def n_values(self) -> int:
        """Number of observed values N."""
        return sum(len(y) for y in self.y)


def coupled_outputs(kernel: MultiOutputKernel, data: Data) -> list[list[int]]:
    """Return the groups of outputs that have values and depend on each other by the kernel, or by noise in common."""
    outputs = [i for i, y in enumerate(data.y) if len(y)]
    if data.sample_noise is not None:
        return [outputs]
    depends = np.eye(len(data.y), dtype=bool)
    for i, j in combinations(outputs, 2):
        depends[i, j] = kernel.couples(i, j)
    _, group = connected_components(depends, directed=False)
    members: dict[int, list[int]] = {}
    for i in outputs:
        members.setdefault(group[i], []).append(i)
    return list(members.values())


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


def _pairs(kernel, data, side, diagonal):
    """Return the pairs of tiles on and above the diagonal that the kernel couples."""
    tiles = []
    for i, stacked in enumerate(consecutive(data.y)):
        output = Tile(i, slice(0, len(data.y[i])), stacked)
        tiles += _cut(output, side)
    pairs = list(combinations(tiles, 2))
    for tile in tiles:
        pairs += combinations_with_replacement(_cut(tile, diagonal), 2)
    return [(a, b) for a, b in pairs if kernel.couples(a.output, b.output)]


def covariance(
    kernel: MultiOutputKernel, noise: Vector, data: Data, tiles: TileSettings = TILES
) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is as for ``add_noise``.
    """
    pairs = _pairs(kernel, data, tiles.side, tiles.diagonal)
    return _assembled(pairs, lambda k: kernel.block(*_inputs(data, *pairs[k])), noise, data)


def _assembled(pairs, block, noise, data):
    """Return Kff + noise from ``block`` (k) of each pair of tiles on and above the diagonal."""

    def fill(k):
        a, b = pairs[k]
        upper[a.stacked, b.stacked] = block(k)

    # In C order: its transpose is the lower triangle in Fortran order.
    upper = np.zeros((data.n_values, data.n_values))
    thread_map(fill, range(len(pairs)))
    add_noise(upper, noise, data)
    return upper.T


class Likelihood(NamedTuple):
    """The log marginal likelihood at some hyperparameters z = [theta, log noise]."""

    value: float
    gradient: Vector
    #: Average information (n, n) and the kernel's curvature, see `log_likelihood`
    information: Matrix


def log_likelihood(
    kernel: MultiOutputKernel,
    noise: Vector,
    data: Data,
    eval_gradient: bool = False,
    tiles: TileSettings = TILES,
) -> Any:
    r"""Return the log marginal likelihood (equation 20), or its `Likelihood` with derivatives by [theta, log noise].

    With :math:`\alpha = K^{-1} y` and :math:`W = \alpha \alpha^T - K^{-1}` the gradient is
    :math:`\frac{1}{2} \mathrm{tr}(W\, \partial K / \partial z_k)`, computed tile by tile. The average
    information

    .. math:: \mathcal{I}_{kl} = \frac{1}{2} \alpha^T \frac{\partial K}{\partial z_k} K^{-1}
              \frac{\partial K}{\partial z_l} \alpha

    is the mean of the observed and the expected information where K is linear in z (Gilmour,
    Thompson & Cullis 1995, "Average information REML"): the curvature of the likelihood, for the
    price of a product of the derivatives with one vector. Where first derivatives are zero it
    is zero, too: `MultiOutputKernel.add_curvature` adds second derivatives there.

    Parameters
    ----------
    kernel : MultiOutputKernel
        With values.
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data
        Observed values of each output.
    eval_gradient : bool
        Whether to return the derivatives too.
    tiles : TileSettings

    Returns
    -------
    float or Likelihood
        The latter with ``eval_gradient``.
    """
    with threads_for(data.n_values):
        y = np.concatenate(data.y)
        if not eval_gradient:
            return _value(jittered_cholesky(lambda: covariance(kernel, noise, data, tiles)), y)
        pairs = _pairs(kernel, data, tiles.side, tiles.diagonal)
        evaluated = kernel.evaluate([_inputs(data, a, b) for a, b in pairs])

        def block(k):
            return evaluated[k].covariance()

        L = jittered_cholesky(lambda: _assembled(pairs, block, noise, data))
        value = _value(L, y)
        alpha = cholesky_solve(L, y)
        n_dims = kernel.n_dims
        products = np.zeros((len(y), n_dims + len(noise)), order="F")
        _add_products(products[:, :n_dims], pairs, evaluated, alpha)
        _add_noise_products(products[:, n_dims:], noise, data, alpha)
        half = triangular_solve(L, products)
        minus_W = _minus_W(L, alpha)
        slopes = _slopes(pairs, evaluated, minus_W, n_dims)
        by_theta = np.sum(list(slopes.values()), axis=0)
        by_noise = noise_gradient(minus_W, noise, data)
        gradient = -np.concatenate([by_theta, by_noise])
        information = 0.5 * half.T @ half
        kernel.add_curvature(information[:n_dims, :n_dims], slopes)
        return Likelihood(value, gradient, information)


def _slopes(pairs, evaluated, W, n_dims):
    """Return sum(W * dK_ij / dtheta), (n_theta,), of each pair of outputs, from tiles on and above the diagonal."""

    def of_pair(k):
        slopes = np.zeros(n_dims)
        evaluated[k].add_gradient(slopes, _weights(W, *pairs[k]))
        return slopes

    of_outputs: dict[tuple[int, int], Vector] = {}
    for (a, b), slopes in zip(pairs, thread_map(of_pair, range(len(pairs))), strict=True):
        of_outputs.setdefault((a.output, b.output), np.zeros(n_dims))
        of_outputs[a.output, b.output] += slopes
    return of_outputs


def _add_products(products, pairs, evaluated, alpha):
    """Add dK / dtheta alpha, (N, n_theta), from tiles on and above the diagonal."""
    for (a, b), of_pair in zip(pairs, evaluated, strict=True):
        of_pair.add_products(products[a.stacked], alpha[b.stacked])
        if a is not b:
            of_pair.add_products(products[b.stacked], alpha[a.stacked], transposed=True)


def _add_noise_products(products, noise, data, alpha):
    """Add dK / d log noise alpha, (N, n_noise)."""
    white, scale = _white_and_scale(noise, data)
    for i, rows in enumerate(consecutive(data.y)):
        products[rows, i] += white[i] * alpha[rows]
    if len(noise) == len(white):
        return
    of_regressors = products[:, len(white) :]
    for i, j, rows, columns, first, second in noise_pairs(data.sample_noise):
        propagated = scale * first * second
        of_regressors[rows] += propagated * alpha[columns, None]
        if i != j:
            of_regressors[columns] += propagated * alpha[rows, None]


def _value(L, y):
    """Return equation 20."""
    white = triangular_solve(L, y)  # y^T K^-1 y = white^T white
    return -0.5 * (white @ white + log_determinant(L) + len(y) * np.log(2 * np.pi))


def _minus_W(L, alpha):
    """Return K^-1 - alpha alpha^T; only its upper triangle is computed, over L."""
    return dsyr(-1.0, alpha, a=cholesky_inverse(L), lower=1, overwrite_a=1).T


def _inputs(data, a, b):
    """Return the inputs of two tiles."""
    return InputPair(a.output, b.output, data.X[a.output][a.rows], data.X[b.output][b.rows])


def _weights(W, a, b):
    """Return the weights of the block of two tiles and its mirror image, from half of W (N, N)."""
    weights = W[a.stacked, b.stacked]
    if a is b:
        weights = np.triu(weights)
        np.einsum("ii->i", weights)[:] *= 0.5
    return weights
