"""The exact likelihood and its gradient by one Cholesky factorisation, with the noise of its covariance.

The N x N matrix is output-major. A kernel computes one tile of one pair of outputs at a time.

The noise has the covariance S = sum_k s_k N_k by its sources k, sparse matrices: white noise of each
output, with the variance s_k and ones on the diagonal, and sources that all values of a sample feel,
N_k = G_k G_k^T. G (N, n samples) holds the loadings of the values on the error of their sample. Those
of regressors are the slopes of the posterior mean (McHutchon & Rasmussen 2011), as in factor analysis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
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
LEAST_INFORMATION = (
    1e-3  # about a hyperparameter that the values determine [nats for its unit squared]
)
SLOPE_ROWS = 512  # samples in one step of the slopes: their covariances fit the cache


class SlopeNoise(NamedTuple):
    """Loadings of values on errors of their regressors, by the slopes of a function f.

    Those of output i are d f_i / d x times ``std`` (d,) or (P, d). They are computed where they are
    needed, from the few weights of the function: kept, they would hold P times as many numbers as X.
    ``sample`` and ``X`` belong to the values.
    """

    sample: Sequence[np.ndarray]
    X: Sequence[np.ndarray]
    function: PathBundle
    std: np.ndarray

    def loadings(self) -> list[np.ndarray]:
        """Return the loadings of the values of each output on each regressor, (n_i, d)."""
        samples, X = sample_table(self.X, self.sample)
        batches = [X[start : start + SLOPE_ROWS] for start in range(0, len(X), SLOPE_ROWS)]
        with threads_for(len(X)):
            slopes = thread_map(lambda batch: self.function.slopes(batch[None])[0], batches)
        loadings = np.concatenate(slopes) * self.std
        of_outputs = []
        for i, sample in enumerate(self.sample):
            everywhere = len(sample) == len(samples)
            rows = slice(None) if everywhere else samples.searchsorted(sample)
            of_outputs.append(loadings[rows, i])
        return of_outputs


def sample_table(X: Sequence[Matrix], sample: Sequence[Indices]) -> tuple[Indices, Matrix]:
    """Return the samples that any output has, (n,), in order, and their inputs (n, d)."""
    samples, first = np.unique(np.concatenate(sample), return_index=True)
    for inputs, places in zip(X, sample, strict=True):
        if len(places) == len(samples):
            return samples, inputs
    return samples, np.concatenate(X)[first]


def noise_terms(noise: Vector, data: Data) -> list[Any]:
    """Return the noise covariance of the stacked values by each source, sparse matrices (N, N).

    ``noise`` is [sigma^2 (P)] or, with learned variances s (r) of the errors of samples, [sigma^2, s];
    they are one otherwise. As the covariance is linear in them, terms are derivatives by their logarithms.
    """
    P = len(data.y)
    terms = []
    for variance, rows in zip(noise, consecutive(data.y), strict=False):
        diagonal = np.zeros(data.n_values)
        diagonal[rows] = variance
        terms.append(sparse.diags_array(diagonal))
    roots = noise_roots(data)
    factors = noise[P:] if len(noise) > P else np.ones(len(roots))
    return terms + [s * (G @ G.T) for s, G in zip(factors, roots, strict=True)]


def noise_roots(data: Data) -> list[Any]:
    """Return the loadings of the stacked values on the error of their sample, by source, sparse (N, n samples)."""
    values = np.arange(data.n_values)
    samples = np.concatenate([np.asarray(rows, dtype=int) for rows in data.sample])
    loadings = np.vstack(data.loadings())
    return [sparse.csr_array((column, (values, samples))) for column in loadings.T]


def draw_noise(noise: Vector, data: Data, n_draws: int, random_state: Any) -> Matrix:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) holds the white noise variances."""
    std = np.repeat(np.sqrt(noise), [len(y) for y in data.y])
    draws = std * random_state.standard_normal((n_draws, data.n_values))
    for G in noise_roots(data):
        draws += (G @ random_state.standard_normal((G.shape[1], n_draws))).T
    return draws


class Data(NamedTuple):
    """Observed values: inputs (n_i, d) and targets (n_i,) of each output, and their noise model.

    ``noise`` are the loadings (n_i, r) of their noise beside the white noise on independent errors of
    their samples. ``sample`` (n_i,) is the row of each value in the table.
    """

    X: list[np.ndarray]
    y: list[np.ndarray]
    noise: list[np.ndarray] | SlopeNoise | None = None
    sample: Sequence[np.ndarray] = ()

    @classmethod
    def from_table(cls, X: Matrix, Y: Matrix, added: Matrix | None = None) -> Data:
        """Return the observed values of X (n, d) and Y (n, P), with NaN where an output was not observed.

        ``added`` (n, P) are the variances of their noise beside the white noise.
        """
        inputs, values, samples, loadings = [], [], [], []
        outputs = np.eye(Y.shape[1])  # sources of one output each
        for i, rows in enumerate(np.isfinite(Y).T):
            inputs.append(X if rows.all() else X[rows])
            values.append(Y[rows, i])
            samples.append(np.flatnonzero(rows))
            if added is not None:
                loadings.append(np.sqrt(added[rows]) * outputs[i])
        return cls(inputs, values, loadings or None, samples)

    def loadings(self) -> list[np.ndarray]:
        """Return the loadings of the noise beside the white noise, (n_i, r)."""
        if self.noise is None:
            return [np.zeros((len(y), 0)) for y in self.y]
        return self.noise.loadings() if isinstance(self.noise, SlopeNoise) else self.noise

    def with_slopes(self, function: PathBundle, std: Array) -> Data:
        """Return the values of a table with the noise of regressors that the slopes of a function propagate.

        ``std`` (d,) or (P, d) are the standard deviations of the regressors' noise.
        """
        return self._replace(noise=SlopeNoise(self.sample, self.X, function, std))

    def with_loadings(self) -> Data:
        """Return the values with the loadings of their noise in memory, for repeated evaluations."""
        return self._replace(noise=self.loadings())

    def inflated(self, factor: Vector) -> Data:
        """Return the values with the variances of the noise beside the white noise times ``factor`` (P,)."""
        loadings = [root * G for root, G in zip(np.sqrt(factor), self.loadings(), strict=True)]
        return self._replace(noise=loadings)

    def of_outputs(self, outputs: Sequence[int]) -> Data:
        """Return the values of some outputs; the others have none."""
        rows = [slice(None) if i in outputs else slice(0) for i in range(len(self.y))]

        def chosen(parts):
            return [part[places] for part, places in zip(parts, rows, strict=True)]

        return Data(chosen(self.X), chosen(self.y), chosen(self.loadings()), chosen(self.sample))

    @property
    def n_values(self) -> int:
        """Number of observed values N."""
        return sum(len(y) for y in self.y)


def coupled_outputs(kernel: MultiOutputKernel, data: Data) -> list[list[int]]:
    """Return the groups of outputs that have values and depend on each other by the kernel, or by noise in common."""
    outputs = [i for i, y in enumerate(data.y) if len(y)]
    felt = [np.any(loadings, axis=0) for loadings in data.loadings()]
    depends = np.eye(len(data.y), dtype=bool)
    for i, j in combinations(outputs, 2):
        depends[i, j] = kernel.couples(i, j) or np.any(felt[i] & felt[j])
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

    ``noise`` is as for ``noise_terms``.
    """
    pairs = _pairs(kernel, data, tiles.side, tiles.diagonal)
    terms = noise_terms(noise, data)
    return _assembled(pairs, lambda k: kernel.block(*_inputs(data, *pairs[k])), terms)


def _assembled(pairs, block, noise):
    """Return Kff + noise from ``block`` (k) of each pair of tiles on and above the diagonal, and terms of the noise."""

    def fill(k):
        a, b = pairs[k]
        upper[a.stacked, b.stacked] = block(k)

    # In C order: its transpose is the lower triangle in Fortran order.
    upper = np.zeros(noise[0].shape)
    thread_map(fill, range(len(pairs)))
    total = sparse.coo_array(sparse.triu(sum(noise)))
    upper[total.row, total.col] += total.data
    return upper.T


class Likelihood(NamedTuple):
    """The log marginal likelihood at some hyperparameters z = [theta, log noise]."""

    value: float
    gradient: Vector
    #: Average information (n, n) and the kernel's curvature, see `log_likelihood`
    information: Matrix

    @property
    def n_determined(self) -> int:
        """Number of hyperparameters whose change by one unit changes the likelihood."""
        return int(np.sum(np.diag(self.information) > LEAST_INFORMATION))


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

        terms = noise_terms(noise, data)
        L = jittered_cholesky(lambda: _assembled(pairs, block, terms))
        value = _value(L, y)
        alpha = cholesky_solve(L, y)
        n_dims = kernel.n_dims
        products = np.zeros((len(y), n_dims + len(noise)), order="F")
        _add_products(products[:, :n_dims], pairs, evaluated, alpha)
        for k, term in enumerate(terms[: len(noise)]):
            products[:, n_dims + k] = term @ alpha
        half = triangular_solve(L, products)
        minus_W = _minus_W(L, alpha)
        slopes = _slopes(pairs, evaluated, minus_W, n_dims)
        by_theta = np.sum(list(slopes.values()), axis=0)
        by_noise = [_half_sum(minus_W, term) for term in terms[: len(noise)]]
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


def _half_sum(W, term):
    """Return sum(W * term) / 2 of a symmetric sparse matrix; only the upper triangle of W is read."""
    off = sparse.coo_array(sparse.triu(term, k=1))
    return 0.5 * np.diag(W) @ term.diagonal() + W[off.row, off.col] @ off.data


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
