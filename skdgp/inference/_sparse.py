"""Sparse inference by the collapsed variational bound.

Features are inducing variables u (Alvarez et al. 2010), see ``skdgp.kernels._features``. With their
covariance Kuu, the covariance Kfu of values and features, and the noise S, the bound of Titsias
(2009) is

    log N(y | 0, Kfu Kuu^-1 Kuf + S) - 1/2 tr S^-1 (Kff - Kfu Kuu^-1 Kuf).

It does not exceed the log marginal likelihood, and approaches it as features are added. It needs
only sums over the samples, so time is linear in their number and memory is constant.

A share is a sequence of samples, a chunk of the data. It holds one output if the outputs have
independent noise, and all outputs if noisy regressors correlate their noise. Functions that sum
over a share are module-level functions with explicit arguments, so that a thread, a process or
another machine can run them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations_with_replacement
from operator import add
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state, gen_batches

from skdgp._compute.linalg import (
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
    semidefinite_root,
    symmetric,
    triangular_solve,
)
from skdgp._compute.parallel import few_threads, thread_map, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, sample_table
from skdgp.inference._posterior import SinglePosterior
from skdgp.kernels import Features, MultiOutputKernel, PathBundle


@dataclass(frozen=True)
class ShareSettings:
    """How sums over the samples are cut. Results do not depend on the number of threads."""

    #: Samples in one step: their covariances fit the cache
    rows: int = 512
    #: Most shares, of each output with independent noise
    shares: int = 16
    #: Rows of a block whose diagonal alone is needed
    diagonal_rows: int = 64


SHARES = ShareSettings()


class SparseSums(NamedTuple):
    """Cholesky factor of Kuu, and the sums over all values by their outputs."""

    Lu: Matrix
    statistics: dict[tuple[int, ...], Statistics]


class SparsePosterior(SinglePosterior):
    """The sparse posterior at fixed hyperparameters and features.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data
    sums : SparseSums or None
        Of these data and features, where they are known.
    share_settings : ShareSettings

    Attributes
    ----------
    log_marginal_likelihood : float
        Lower bound on the log marginal likelihood.
    """

    def __init__(
        self,
        kernel: MultiOutputKernel,
        features: Features,
        noise: Vector,
        data: Data,
        sums: SparseSums | None = None,
        share_settings: ShareSettings = SHARES,
    ) -> None:
        self.kernel = kernel
        self.features = features
        self.noise = np.asarray(noise, dtype=float)
        self.data = data
        self.share_settings = share_settings
        if sums is None:
            with threads_for(self.size):
                Lu = jittered_cholesky(lambda: np.asfortranarray(features.Kuu()))
            shares = shares_of(data, share_settings)
            statistics = compute_statistics(
                kernel, features, self.noise, Lu, shares, share_settings
            )
            sums = SparseSums(Lu, statistics)
        self.sums = sums
        self._condition()

    @property
    def Lu(self) -> Matrix:
        """Cholesky factor of Kuu, (K, K)."""
        return self.sums.Lu

    def __reduce__(self):
        # A saved model holds the samples, and computes the sums again.
        return SparsePosterior, (self.kernel, self.features, self.noise, self.data)

    @property
    def size(self) -> int:
        """Number of features K."""
        return self.features.size

    def _condition(self):
        """Compute the posterior of w in u = Lu w: precision B = I + sum_i V_i Pi_i V_i^T and mean B^-1 b."""
        self.B = np.eye(self.size)
        b = np.zeros(self.size)
        constant = 0.0
        for sums in self.sums.statistics.values():
            self.B[np.ix_(sums.columns, sums.columns)] += sums.outer
            b[sums.columns] += sums.inner
            # log |2 pi noise| + y Pi y + tr(Pi (var(y) - V^T V)), which completes the bound
            constant += sums.log_determinant + sums.square + sums.unexplained
        with threads_for(self.size):
            self.LB = jittered_cholesky(lambda: np.array(self.B, order="F"))
            self.white = cholesky_solve(self.LB, b)
            self.weights = triangular_solve(self.Lu, self.white, transposed=True)
        self.log_marginal_likelihood = -0.5 * float(
            constant + log_determinant(self.LB) - b @ self.white
        )

    @cached_property
    def B_inverse(self) -> np.ndarray:
        """Covariance of the whitened features, (K, K)."""
        with threads_for(self.size):
            return symmetric(cholesky_inverse(self.LB.copy(order="F")))

    @property
    def neglected_variance(self) -> float:
        """Mean prior variance that the features do not explain, over the noise variance.

        Of the worst output, or of all values where their noise is correlated or known for each.
        Far below one, the posterior is nearly the exact one (Burt, Rasmussen & van der Wilk 2020).
        """
        if self.data.sample_noise is not None:
            total = sum(sums.unexplained for sums in self.sums.statistics.values())
            return total / self.data.n_values
        return max(sums.unexplained / sums.n for sums in self.sums.statistics.values())

    def of(self, data: Data, noise: Vector) -> SparsePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters and features."""
        return SparsePosterior(self.kernel, self.features, noise, data)

    def folds(
        self, noise: Vector, data: Data, parts: Sequence[tuple[Data, Data]]
    ) -> Iterator[SinglePosterior]:
        is_correlated = data.sample_noise is not None
        if is_correlated and any(_have_common_samples(*part) for part in parts):
            yield from super().folds(noise, data, parts)
            return
        settings = self.share_settings
        of_parts = []
        for _, left_out in parts:
            shares = shares_of(left_out, settings)
            of_parts.append(
                compute_statistics(self.kernel, self.features, noise, self.Lu, shares, settings)
            )
        for k, (remaining, _) in enumerate(parts):
            sums = SparseSums(self.Lu, _total(of_parts[:k] + of_parts[k + 1 :]))
            yield SparsePosterior(self.kernel, self.features, noise, remaining, sums, settings)

    @cached_property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""
        return self.features.paths(self.weights[None])

    @cached_property
    def roots(self) -> list[np.ndarray]:
        """Lu^-T R of the features of each output, (c, c), with R R^T = I - B^-1.

        With V = Lu^-1 Kuf the data reduce the prior variance by V^T (I - B^-1) V, the square of Kfu
        Lu^-T R.
        """
        roots = []
        with threads_for(self.size):
            for i in range(self.kernel.n_outputs):
                columns = self.features.columns(i)
                reduction = np.eye(len(columns)) - self.B_inverse[np.ix_(columns, columns)]
                R = semidefinite_root(reduction)
                roots.append(triangular_solve(sub_factor(self.Lu, columns), R, transposed=True))
        return roots

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""
        return self.features.Kfu(i, Xs), self.weights[self.features.columns(i)]

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""
        half = A @ self.roots[i]
        return np.einsum("nc,nc->n", half, half)

    @few_threads
    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        P, n = self.kernel.n_outputs, len(Xs)
        A = np.zeros((self.features.size, P * n), order="F")
        for i in range(P):
            A[self.features.columns(i), i * n : (i + 1) * n] = self.features.Kfu(i, Xs).T
        V = triangular_solve(self.Lu, A)
        return self.kernel(Xs) - V.T @ (V - self.B_inverse @ V)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples of the posterior that are functions of the regressors; u_post = Lu w, w ~ N(white, B^-1)."""
        rng = check_random_state(random_state)
        with threads_for(self.size):
            prior, u = self.features.prior_paths(n_paths, self.settings.frequencies, rng)
            drawn = np.asfortranarray(rng.standard_normal(u.shape).T)
            w = self.white[:, None] + triangular_solve(self.LB, drawn, transposed=True)
            w -= triangular_solve(self.Lu, np.asfortranarray(u.T))
            coefficients = triangular_solve(self.Lu, np.asfortranarray(w), transposed=True).T
            return prior + self.features.paths(coefficients)


# -- shares of the samples
# --------------------------------------------------------------------------------------------


class SampleShare(NamedTuple):
    """A sequence of samples of some outputs.

    ``X`` (n, d), ``Y`` (n, p) with NaN where not observed, and the ``loading`` G (n, p, r) of the
    noise covariance diag(sigma^2) + G G^T.
    """

    outputs: tuple[int, ...]
    X: np.ndarray
    Y: np.ndarray
    loading: np.ndarray


def shares_of(data: Data, settings: ShareSettings) -> list[SampleShare]:
    """Return the observed values in shares that do not depend on the number of threads: sums have the same bits."""
    if data.sample_noise is not None:
        share = SampleShare(tuple(range(len(data.y))), *_sample_table(data))
        return _cut(share, settings)
    shares = []
    for i, (X, y) in enumerate(zip(data.X, data.y, strict=True)):
        if len(y):
            share = SampleShare((i,), X, y[:, None], np.zeros((len(y), 1, 0)))
            shares += _cut(share, settings)
    return shares


def _cut(whole, settings):
    """Return shares of about equal numbers of samples."""
    n_shares = min(settings.shares, -(-len(whole.X) // settings.rows))
    shares = []
    for rows in np.array_split(np.arange(len(whole.X)), n_shares):
        part = slice(rows[0], rows[-1] + 1)
        shares.append(SampleShare(whole.outputs, whole.X[part], whole.Y[part], whole.loading[part]))
    return shares


def _sample_table(data):
    """Return X, Y and loading of the samples."""
    sample = data.sample_noise.sample
    loadings = data.sample_noise.loading
    samples, X = sample_table(data.X, sample)
    n = len(samples)
    P = len(data.y)
    Y = np.full((n, P), np.nan)
    loading = np.zeros((n, P, loadings[0].shape[1]))
    for i in range(P):
        rows = np.searchsorted(samples, sample[i])
        Y[rows, i] = data.y[i]
        loading[rows, i] = loadings[i]
    return X, Y, loading


# -- sums for conditioning
# --------------------------------------------------------------------------------------------


class Statistics(NamedTuple):
    """Sums over n samples of some outputs, with V = Lu^-1 Kuf and the inverse noise Pi.

    V Pi V^T (c, c), V Pi y (c,), y Pi y, tr(Pi var(y)) and log |2 pi noise|, where ``columns`` (c,)
    are the features of the outputs.
    """

    columns: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    square: float
    variance: float
    log_determinant: float
    n: int

    def plus(self, other: Statistics) -> Statistics:
        """Return the sums over these and other samples of the same outputs."""
        return Statistics(self.columns, *map(add, self[1:], other[1:]))

    @property
    def unexplained(self) -> float:
        """Prior variance that the features do not explain."""
        return self.variance - float(np.trace(self.outer))


def compute_statistics(
    kernel, features, noise, Lu, shares, settings: ShareSettings
) -> dict[tuple[int, ...], Statistics]:
    """Return the sums over all values by their outputs: each alone, or all if their noise is correlated."""
    of_share = thread_map(partial(_share_sums, kernel, features, noise, Lu, settings), shares)
    return _total([{share.outputs: sums} for share, sums in zip(shares, of_share, strict=True)])


def _share_sums(kernel, features, noise, Lu, settings, share):
    """Return the sums over a share."""
    total = _Sums(kernel, features, Lu, share.outputs)
    noise = noise[list(share.outputs)]
    for rows in gen_batches(len(share.X), settings.rows):
        X = share.X[rows]
        Y = share.Y[rows]
        precision, log_determinants = precisions(Y, share.loading[rows], noise)
        total.add(X, np.nan_to_num(Y), precision, settings)
        total.log_determinant += log_determinants.sum()
    return total.statistics()


def _total(parts: Sequence[dict[tuple[int, ...], Statistics]]) -> dict[tuple[int, ...], Statistics]:
    """Return the sums over the samples of several parts, by their outputs."""
    total: dict[tuple[int, ...], Statistics] = {}
    for part in parts:
        for outputs, sums in part.items():
            total[outputs] = total[outputs].plus(sums) if outputs in total else sums
    return total


class _Sums:
    """Sums over samples of some outputs, in blocks of their features; the noise of several is correlated."""

    def __init__(self, kernel, features, Lu, outputs):
        self.kernel = kernel
        self.features = features
        self.outputs = outputs
        self.columns = [features.columns(i) for i in outputs]
        self.factors = [sub_factor(Lu, columns) for columns in self.columns]
        self.blocks: dict = {}
        for a, b in combinations_with_replacement(range(len(outputs)), 2):
            self.blocks[a, b] = np.zeros((len(self.columns[a]), len(self.columns[b])))
        self.inner = [np.zeros(len(columns)) for columns in self.columns]
        self.square = 0.0
        self.variance = 0.0
        self.log_determinant = 0.0
        self.n = 0

    def add(self, X, Y, precision, settings):
        """Add the sums over samples X (n, d) with targets Y (n, p), zero where missing, and the inverse noise."""
        self.n += len(X)
        weighted = np.einsum("nij,nj->ni", precision, Y)
        V = []
        for i, factor in zip(self.outputs, self.factors, strict=True):
            V.append(triangular_solve(factor, self.features.Kfu(i, X).T))
        for a, b in self.blocks:
            self._add_block(a, b, V, precision[:, a, b])
            self._add_variance(a, b, X, precision[:, a, b], settings)
        for a, v in enumerate(V):
            self.inner[a] += v @ weighted[:, a]
        self.square += np.sum(Y * weighted)

    def _add_block(self, a, b, V, weight):
        if a == b:
            half = V[a] if (weight == 1.0).all() else V[a] * np.sqrt(weight)
            self.blocks[a, a] += half @ half.T
        else:
            self.blocks[a, b] += (V[a] * weight) @ V[b].T

    def _add_variance(self, a, b, X, weight, settings):
        i, j = self.outputs[a], self.outputs[b]
        if self.kernel.couples(i, j):
            times = 1 if a == b else 2
            variance = _variance(self.kernel, i, j, X, settings.diagonal_rows)
            self.variance += times * weight @ variance

    def statistics(self):
        """Return the sums, in the order of the features of the outputs."""
        columns = np.unique(np.concatenate(self.columns))
        places = [np.searchsorted(columns, of_output) for of_output in self.columns]
        outer = np.zeros((len(columns), len(columns)))
        inner = np.zeros(len(columns))
        for (a, b), block in self.blocks.items():
            outer[np.ix_(places[a], places[b])] += block
            if a != b:
                outer[np.ix_(places[b], places[a])] += block.T
        for rows, part in zip(places, self.inner, strict=True):
            inner[rows] += part
        return Statistics(
            columns, outer, inner, self.square, self.variance, self.log_determinant, self.n
        )


def _have_common_samples(first, second):
    """Return whether some sample has values in both."""
    samples = np.concatenate(first.sample), np.concatenate(second.sample)
    return len(np.intersect1d(*samples)) > 0


def sub_factor(Lu, columns):
    """Return the Cholesky factor of some features: Kuu is block diagonal, and ``columns`` are whole blocks."""
    return np.asfortranarray(Lu[np.ix_(columns, columns)])


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


def _variance(kernel, i, j, X, n_rows):
    """Return cov(y_i(x), y_j(x)) at each row x of X, (n,)."""
    if i == j:
        return kernel.block_diag(i, X)
    total = np.zeros(len(X))
    for term in kernel.summands():
        if term.couples(i, j):
            total += _variance_of_term(term, i, j, X, n_rows)
    return total


def _variance_of_term(term, i, j, X, n_rows):
    """Return cov(y_i(x), y_j(x)) of one term at each row x of X, (n,) or, of a stationary term, (1,)."""
    if term.is_stationary():
        return term.block(i, j, X[:1], X[:1])[0]
    parts = []
    for rows in gen_batches(len(X), n_rows):
        parts.append(np.diag(term.block(i, j, X[rows], X[rows])))
    return np.concatenate(parts)
