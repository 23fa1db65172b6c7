"""The exact likelihood and its gradient by one Cholesky factorisation, with the noise of its covariance.

The N x N matrix is output-major. A kernel computes one tile of one pair of outputs at a time.

The noise of two values of the outputs i and j has the covariance S = sigma_i^2 delta_ij + sum_k s_k g_k g_k'
if they are of the same sample, zero otherwise: white noise of each output, and errors k of the sample, which
its values feel by the loadings g_k. Those of regressors are the slopes of the posterior mean
(McHutchon & Rasmussen 2011), as in factor analysis.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, combinations_with_replacement
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

#: Largest side of the tiles of the covariance matrix, in values of one output: what fits the cache
SIDE = 256
LEAST_INFORMATION = (
    1e-3  # about a hyperparameter that the values determine [nats for its unit squared]
)


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
        loadings = self.function.slopes(X[None])[0] * self.std
        return [loadings[samples.searchsorted(rows), i] for i, rows in enumerate(self.sample)]


def sample_table(X: Sequence[Matrix], sample: Sequence[Indices]) -> tuple[Indices, Matrix]:
    """Return the samples that any output has, (n,), in order, and their inputs (n, d)."""
    samples, first = np.unique(np.concatenate(sample), return_index=True)
    return samples, np.concatenate(X)[first]


class _Noise:
    """The noise covariance S of the stacked values, diag(``white``) + sum_k r_k r_k' for values of one sample.

    ``noise`` is [sigma^2 (P)] or, with learned variances s (n_sources) of the errors of samples, [sigma^2, s];
    they are one otherwise. S is linear in them, so its terms are its derivatives by their logarithms.
    """

    def __init__(self, noise: Vector, data: Data) -> None:
        P = len(data.y)
        self.n_learned = len(noise)
        self.of_output = np.repeat(np.eye(P), [len(y) for y in data.y], axis=0)
        self.white = self.of_output @ noise[:P]
        G = np.vstack(data.loadings())
        self.R = G * np.sqrt(noise[P:]) if len(noise) > P else G
        self.sample = np.concatenate([np.asarray(rows, dtype=int) for rows in data.sample])
        self.row, self.column = _pairs_of_samples(data)

    def add(self, upper: Matrix) -> None:
        """Add S to the upper triangle of a matrix (N, N)."""
        np.einsum("aa->a", upper)[:] += self.white
        of_sources = self.R[self.row] * self.R[self.column]
        upper[self.row, self.column] += of_sources.sum(axis=1)

    def products(self, alpha: Vector) -> Matrix:
        """Return the products of each learned term with a vector (N,), a column each."""
        by_white = self.of_output * (self.white * alpha)[:, None]
        felt = np.zeros((self.sample.max() + 1, self.R.shape[1]))
        np.add.at(felt, self.sample, self.R * alpha[:, None])
        return np.hstack([by_white, self.R * felt[self.sample]])[:, : self.n_learned]

    def half_sums(self, W: Matrix) -> Vector:
        """Return sum(W * term) / 2 of each learned term; only the upper triangle of W is read."""
        by_white = 0.5 * (np.diag(W) * self.white) @ self.of_output
        weights = W[self.row, self.column] * np.where(self.row == self.column, 0.5, 1.0)
        of_sources = self.R[self.row] * self.R[self.column]
        return np.concatenate([by_white, weights @ of_sources])[: self.n_learned]


def _pairs_of_samples(data):
    """Return the places (2, pairs) among the stacked values of two values of a sample, the first one first."""
    pairs = []
    places = consecutive(data.y)
    for i, j in combinations_with_replacement(range(len(places)), 2):
        _, a, b = np.intersect1d(data.sample[i], data.sample[j], True, return_indices=True)
        pairs.append([places[i].start + a, places[j].start + b])
    return np.concatenate(pairs, axis=1)


def draw_noise(noise: Vector, data: Data, n_draws: int, random_state: Any) -> Matrix:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) holds the white noise variances."""
    std = np.repeat(np.sqrt(noise), [len(y) for y in data.y])
    draws = std * random_state.standard_normal((n_draws, data.n_values))
    sample = np.concatenate(data.sample)
    for g in np.vstack(data.loadings()).T:
        errors = random_state.standard_normal((sample.max() + 1, n_draws)).T
        draws += g * errors[:, sample]
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


def _pairs(kernel, data, side):
    """Return the pairs of tiles on and above the diagonal that the kernel couples."""
    tiles = []
    for i, stacked in enumerate(consecutive(data.y)):
        for start in range(0, len(data.y[i]), side):
            end = min(start + side, len(data.y[i]))
            place = slice(stacked.start + start, stacked.start + end)
            tiles.append(Tile(i, slice(start, end), place))
    pairs = combinations_with_replacement(tiles, 2)
    return [(a, b) for a, b in pairs if kernel.couples(a.output, b.output)]


def covariance(
    kernel: MultiOutputKernel, noise: Vector, data: Data, side: int = SIDE
) -> np.ndarray:
    """Return Kff + noise, (N, N) in Fortran order; only its lower triangle is filled.

    ``noise`` is as for ``_Noise``.
    """
    pairs = _pairs(kernel, data, side)
    S = _Noise(noise, data)
    return _assembled(pairs, lambda k: kernel.block(*_inputs(data, *pairs[k])), S)


def _assembled(pairs, block, S):
    """Return Kff + S from ``block`` (k) of each pair of tiles on and above the diagonal."""

    def fill(k):
        a, b = pairs[k]
        upper[a.stacked, b.stacked] = block(k)

    # In C order: its transpose is the lower triangle in Fortran order.
    N = len(S.sample)
    upper = np.zeros((N, N))
    thread_map(fill, range(len(pairs)))
    S.add(upper)
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
    side: int = SIDE,
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
    side : int
        Of the tiles.

    Returns
    -------
    float or Likelihood
        The latter with ``eval_gradient``.
    """
    with threads_for(data.n_values):
        y = np.concatenate(data.y)
        if not eval_gradient:
            return _value(jittered_cholesky(lambda: covariance(kernel, noise, data, side)), y)
        pairs = _pairs(kernel, data, side)
        evaluated = kernel.evaluate([_inputs(data, a, b) for a, b in pairs])

        def block(k):
            return evaluated[k].covariance()

        S = _Noise(noise, data)
        L = jittered_cholesky(lambda: _assembled(pairs, block, S))
        value = _value(L, y)
        alpha = cholesky_solve(L, y)
        n_dims = kernel.n_dims
        products = np.zeros((len(y), n_dims + len(noise)), order="F")
        _add_products(products[:, :n_dims], pairs, evaluated, alpha)
        products[:, n_dims:] = S.products(alpha)
        half = triangular_solve(L, products)
        minus_W = _minus_W(L, alpha)
        slopes = _slopes(pairs, evaluated, minus_W, n_dims)
        by_theta = np.sum(list(slopes.values()), axis=0)
        gradient = -np.concatenate([by_theta, S.half_sums(minus_W)])
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
