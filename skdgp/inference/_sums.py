"""Sums over samples for sparse inference: for conditioning and for the gradient of the bound.

A share is a sequence of samples, a chunk of the data. It holds one output if the outputs have independent noise, and
all outputs if noisy regressors correlate their noise. Functions that sum over a share are module-level functions with
explicit arguments, so that a thread, a process or another machine can run them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import triangular_solve
from skdgp._compute.parallel import share_map
from skdgp.inference._likelihood import Data

ROWS = 512  # samples in one step: their covariances fit the cache
SHARES = 8  # largest number of shares of each output with independent noise
SAMPLE_SHARES = 16  # largest number of shares of samples with noise correlated between outputs
DIAGONAL_ROWS = 32  # rows of a block of which only the diagonal is needed


class SampleShare(NamedTuple):
    """A sequence of samples of some outputs.

    ``X`` (n, d), ``Y`` (n, p) with NaN where not observed, and the ``loading`` G (n, p, r) of the noise covariance
    diag(sigma^2) + G G^T.
    """

    outputs: tuple[int, ...]
    X: np.ndarray
    Y: np.ndarray
    loading: np.ndarray


def _one_output(i, X, y):
    return SampleShare((i,), X, y[:, None], np.zeros((len(y), 1, 0)))


def shares_of(data: Data) -> list[SampleShare]:
    """Return the observed values in shares that do not depend on the number of threads: sums have the same bits."""
    if data.sample_noise is None:
        return [
            _one_output(i, *part)
            for i, values in enumerate(zip(data.X, data.y, strict=True))
            if len(values[1])
            for part in zip(*(np.array_split(a, min(SHARES, -(-len(a) // ROWS))) for a in values), strict=True)
        ]
    table = _sample_table(data)
    parts = zip(*(np.array_split(a, min(SAMPLE_SHARES, -(-len(a) // ROWS))) for a in table), strict=True)
    return [SampleShare(tuple(range(len(data.y))), *part) for part in parts]


def _sample_table(data):
    """Return X, Y and loading of the samples."""
    samples, first = np.unique(np.concatenate(data.sample_noise.sample), return_index=True)
    n, P = len(samples), len(data.y)
    Y, loading = np.full((n, P), np.nan), np.zeros((n, P, data.sample_noise.loading[0].shape[1]))
    for i, (y, sample, G) in enumerate(zip(data.y, *data.sample_noise, strict=True)):
        rows = np.searchsorted(samples, sample)
        Y[rows, i], loading[rows, i] = y, G
    return np.concatenate(data.X)[first], Y, loading


def data_from_shares(shares, n_outputs) -> Data:
    """Return the observed values of all shares."""
    if _independent(shares):
        empty = _one_output(-1, shares[0].X[:0], np.empty(0))
        by_output = [[empty, *(share for share in shares if share.outputs == (i,))] for i in range(n_outputs)]
        X = [np.concatenate([share.X for share in parts]) for parts in by_output]
        return Data(X, [np.concatenate([share.Y[:, 0] for share in parts]) for parts in by_output])
    table = [np.concatenate([share[k] for share in shares]) for k in (1, 2, 3)]
    return Data.from_table(table[0], table[1], table[2])


def _independent(shares) -> bool:
    """Return whether the noise of all values is independent."""
    return all(share.loading.shape[2] == 0 for share in shares)


# -- sums for conditioning --------------------------------------------------------------------------------------


class Sums(NamedTuple):
    """The sums V Pi V^T (K, K), V Pi y (K,) and ``rest`` over all values, with V = Lu^-1 Kuf and inverse noise Pi.

    ``rest`` is log |2 pi noise| + y Pi y + tr(Pi (var(y) - V^T V)), which completes the bound.
    """

    outer: np.ndarray
    inner: np.ndarray
    rest: float

    @classmethod
    def combine(cls, features, noise, statistics) -> Sums:
        """Return the sums over outputs with independent noise."""
        outer, inner, rest = np.zeros((features.size, features.size)), np.zeros(features.size), 0.0
        for i, s in enumerate(statistics):
            columns = features.columns(i)
            outer[np.ix_(columns, columns)] += s.outer / noise[i]
            inner[columns] += s.inner / noise[i]
            rest += s.n * np.log(2 * np.pi * noise[i]) + (s.square + s.unexplained) / noise[i]
        return cls(outer, inner, rest)

    def plus(self, other: Sums) -> Sums:
        """Return the sums over these and the other values."""
        return Sums(self.outer + other.outer, self.inner + other.inner, self.rest + other.rest)

    def packed(self, features, n_outputs) -> Sums:
        """Return the sums with only the lower-triangular entries of ``outer`` that can differ from zero."""
        return self._replace(outer=self.outer[_nonzero(features, n_outputs)])

    def unpacked(self, features, n_outputs) -> Sums:
        """Return the sums with the full matrix ``outer``; the inverse of ``packed``."""
        lower = np.zeros((features.size, features.size))
        lower[_nonzero(features, n_outputs)] = self.outer
        return self._replace(outer=lower + np.tril(lower, -1).T)


def _nonzero(features, n_outputs):
    """Return the mask of pairs of features that covary with a common output, in the lower triangle."""
    pairs = np.zeros((features.size, features.size), dtype=bool)
    for i in range(n_outputs):
        columns = features.columns(i)
        pairs[np.ix_(columns, columns)] = True
    return np.tril(pairs)


class Statistics(NamedTuple):
    """Sums over the n samples of one output at unit noise: V V^T (c, c), V y (c,), y y and var(y_i)."""

    outer: np.ndarray
    inner: np.ndarray
    square: float
    variance: float
    n: int

    @property
    def unexplained(self) -> float:
        """Prior variance that the features do not explain."""
        return self.variance - float(np.trace(self.outer))


def total_statistics(parts) -> Statistics:
    """Return the sums over the samples of all parts."""
    return Statistics(*(sum(part) for part in zip(*parts, strict=True)))


def compute_sums(kernel, features, noise, Lu, shares) -> tuple[Sums, list[Statistics] | None]:
    """Return the sums over all values, and their parts by output if the noise is independent, else None."""
    if shares and not _independent(shares):
        outer, inner, rest = np.zeros((features.size, features.size)), np.zeros(features.size), 0.0
        for share, part in zip(shares, share_map(_share_sums, (kernel, features, noise, Lu), shares), strict=True):
            columns = features.columns(share.outputs[0]) if len(share.outputs) == 1 else np.arange(features.size)
            outer[np.ix_(columns, columns)] += part[0]
            inner[columns] += part[1]
            rest += part[4] + part[2] + part[3] - np.trace(part[0])
        return Sums(outer, inner, rest), None
    parts = share_map(_share_sums, (kernel, features, np.ones(kernel.n_outputs), Lu), shares)
    statistics = []
    for i in range(kernel.n_outputs):
        c = len(features.columns(i))
        by_share = [Statistics(np.zeros((c, c)), np.zeros(c), 0.0, 0.0, 0)]
        for share, part in zip(shares, parts, strict=True):
            if share.outputs == (i,):
                by_share.append(Statistics(part[0], part[1], part[2], part[3], len(share.X)))
        statistics.append(total_statistics(by_share))
    return Sums.combine(features, noise, statistics), statistics


def _share_sums(kernel, features, noise, Lu, share):
    """Return V Pi V^T, V Pi y, y Pi y, tr(Pi var(y)) and log |2 pi noise|; one output uses only its own features."""
    outputs = range(len(share.outputs))
    columns = [features.columns(i) for i in share.outputs]
    factors = [sub_factor(Lu, c) for c in columns]
    places: dict = {(i, j): np.ix_(columns[i], columns[j]) for i in outputs for j in outputs}
    size = features.size
    if len(outputs) == 1:  # slices instead of index arrays: nothing is copied
        size, columns, places = len(columns[0]), [slice(None)], {(0, 0): slice(None)}
    outer, inner, square, variance, log_determinant = np.zeros((size, size)), np.zeros(size), 0.0, 0.0, 0.0
    for X, Y, precision, log_determinants in _blocks(share, noise):
        Y = np.nan_to_num(Y)
        weighted = np.einsum("nij,nj->ni", precision, Y)
        V = [triangular_solve(factors[i], features.Kfu(share.outputs[i], X).T) for i in outputs]
        for i, j in _pairs(share):
            if i == j:
                weight = precision[:, i, i]
                half = V[i] if (weight == 1.0).all() else V[i] * np.sqrt(weight)
                outer[places[i, i]] += half @ half.T
            else:
                block = (V[i] * precision[:, i, j]) @ V[j].T
                outer[places[i, j]] += block
                outer[places[j, i]] += block.T
            prior = _variance(kernel, share.outputs[i], share.outputs[j], X)
            variance += (1 if i == j else 2) * precision[:, i, j] @ prior
        for i in outputs:
            inner[columns[i]] += V[i] @ weighted[:, i]
        square += np.sum(Y * weighted)
        log_determinant += log_determinants.sum()
    return outer, inner, square, variance, log_determinant


# -- the gradient of the bound -----------------------------------------------------------------------------------


def bound_gradient(posterior) -> np.ndarray:
    """Return the gradient of the bound by [kernel theta, log noise, features theta]."""
    a, kernel, features = posterior.weights, posterior.kernel, posterior.features
    Lu, identity = posterior.Lu, np.eye(features.size)
    reduction = _unwhitened(Lu, identity - posterior.B_inverse)  # Kuu^-1 - (Kuu + sum Kuf Pi Kfu)^-1
    Wuu = 0.5 * (_unwhitened(Lu, 2 * identity - posterior.B_inverse - posterior.B) - np.outer(a, a))
    parts = share_map(_share_slope, (kernel, features, posterior.noise, a, reduction), posterior.shares)
    total, diagonal, d_noise = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
    total += features.gradient_uu(Wuu)
    n = kernel.n_dims
    return np.concatenate([total[:n] + diagonal, d_noise, total[n:]])


def _unwhitened(Lu, M):
    """Return Lu^-T M Lu^-1 for a symmetric M (K, K)."""
    half = triangular_solve(Lu, np.asfortranarray(M), transposed=True)
    return triangular_solve(Lu, np.asfortranarray(half.T), transposed=True)


def _share_slope(kernel, features, noise, weights, reduction, share):
    """Return the sums of the gradient: by [kernel, features], by the kernel through prior variances, by log noise.

    ``weights`` (K,) are Kuu^-1 times the posterior mean of the features; ``reduction`` (K, K) as in ``bound_gradient``.
    """
    outputs = range(len(share.outputs))
    columns = [features.columns(i) for i in share.outputs]
    reductions = {(i, j): reduction[np.ix_(columns[j], columns[i])] for i in outputs for j in outputs}
    total, diagonal, d_noise = 0.0, np.zeros(kernel.n_dims), np.zeros(len(noise))
    for X, Y, precision, _ in _blocks(share, noise):
        A = [features.Kfu(i, X) for i in share.outputs]
        residual = np.nan_to_num(Y) - np.column_stack([A[i] @ weights[columns[i]] for i in outputs])
        weighted = np.einsum("nij,nj->ni", precision, residual)
        projected = {(i, j): A[j] @ reductions[i, j] for i in outputs for j in outputs}
        covariance = np.empty_like(precision)  # posterior covariance of the outputs at each sample
        for i, j in _pairs(share):
            first, second = share.outputs[i], share.outputs[j]
            value = _variance(kernel, first, second, X) - np.einsum("nc,nc->n", A[i], projected[i, j])
            covariance[:, i, j] = covariance[:, j, i] = value
            w = -0.5 * precision[:, i, j]
            if i == j:
                diagonal += kernel.diag_gradient(first, X, w)
            elif kernel.couples(first, second):
                for rows in _diagonal_slices(len(X)):
                    diagonal += kernel.block_gradient(first, second, X[rows], X[rows], np.diag(2 * w[rows]))
        for i in outputs:
            W = np.multiply.outer(weighted[:, i], weights[columns[i]])
            for j in outputs:
                W += precision[:, i, j, None] * projected[i, j]
            total = total + features.gradient_fu(share.outputs[i], X, W)
        spread = np.einsum("nij,njk,nki->ni", precision, covariance, precision)
        by_noise = np.sum(weighted**2 + spread - np.einsum("nii->ni", precision), axis=0)
        d_noise[list(share.outputs)] += 0.5 * noise[list(share.outputs)] * by_noise
    return total, diagonal, d_noise


# -- common to both -------------------------------------------------------------------------------------------


def row_slices(n):
    """Return slices of at most ROWS of n rows."""
    return [slice(a, min(a + ROWS, n)) for a in range(0, n, ROWS)]


def sub_factor(Lu, columns):
    """Return the Cholesky factor of some features: Kuu is block diagonal, and ``columns`` are whole blocks."""
    return np.asfortranarray(Lu[np.ix_(columns, columns)])


def _blocks(share, noise):
    """Yield X, Y, inverse noise covariances (n, p, p) and log |2 pi noise| (n,) for successive rows of a share."""
    noise = noise[list(share.outputs)]
    for rows in row_slices(len(share.X)):
        X, Y, loading = share.X[rows], share.Y[rows], share.loading[rows]
        yield X, Y, *precisions(Y, loading, noise)


def precisions(Y, loading, noise):
    """Return the inverse noise covariances of the observed outputs, (n, p, p), zero elsewhere, and log |2 pi noise|."""
    observed = np.isfinite(Y)
    if loading.shape[2] == 0:
        precision = np.where(observed, 1.0 / noise, 0.0)[:, :, None] * np.eye(len(noise))
        return precision, observed @ np.log(2 * np.pi * noise)
    loading = np.where(observed[..., None], loading, 0.0)
    covariance = loading @ loading.swapaxes(1, 2)
    np.einsum("nii->ni", covariance)[:] += np.where(observed, noise, 1.0)
    _, log_determinants = np.linalg.slogdet(covariance)
    precision = np.linalg.inv(covariance)
    np.einsum("nii->ni", precision)[:] *= observed
    return precision, log_determinants + observed.sum(axis=1) * np.log(2 * np.pi)


def _pairs(share):
    p = len(share.outputs)
    return [(i, j) for i in range(p) for j in range(i, p)]


def _variance(kernel, i, j, X):
    """Return cov(y_i(x), y_j(x)) at each row x of X, (n,)."""
    if i == j:
        return kernel.block_diag(i, X)
    if not kernel.couples(i, j):
        return np.zeros(len(X))
    return np.concatenate([np.diag(kernel.block(i, j, X[rows], X[rows])) for rows in _diagonal_slices(len(X))])


def _diagonal_slices(n):
    return [slice(a, a + DIAGONAL_ROWS) for a in range(0, n, DIAGONAL_ROWS)]
