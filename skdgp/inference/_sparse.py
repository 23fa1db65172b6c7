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

from functools import cached_property, partial
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

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
from skdgp.inference._posterior import FREQUENCIES, SinglePosterior
from skdgp.kernels import Features, MultiOutputKernel, PathBundle

ROWS = 512  # samples in one step: their covariances fit the cache
SHARES = 8  # largest number of shares of each output with independent noise
SAMPLE_SHARES = 16  # largest number of shares of samples with noise correlated between outputs
DIAGONAL_ROWS = 64  # rows of a block whose diagonal alone is needed


class SparsePosterior(SinglePosterior):
    """The sparse posterior at fixed hyperparameters and features.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data

    Attributes
    ----------
    log_marginal_likelihood : float
        Lower bound on the log marginal likelihood.
    """

    statistics: dict[tuple[int, ...], Statistics]

    def __init__(
        self, kernel: MultiOutputKernel, features: Features, noise: Vector, data: Data
    ) -> None:
        self.kernel = kernel
        self.features = features
        self.noise = np.asarray(noise, dtype=float)
        self.data = data
        with threads_for(self.size):
            self.Lu = jittered_cholesky(lambda: np.asfortranarray(self.features.Kuu()))
        # Of independent noise at the unit, so that another noise needs no sample.
        unit = np.ones_like(self.noise) if self.data.sample_noise is None else self.noise
        self.statistics = compute_statistics(
            self.kernel, self.features, unit, self.Lu, shares_of(self.data)
        )
        self._condition(self.noise / unit)

    def __reduce__(self):
        # A saved model holds the samples, and computes the sums again.
        return SparsePosterior, (self.kernel, self.features, self.noise, self.data)

    @property
    def size(self) -> int:
        """Number of features K."""
        return self.features.size

    def _condition(self, factor):
        """Compute the posterior of w in u = Lu w: precision B = I + sum_i V_i V_i^T / noise_i and mean B^-1 b.

        The noise of the statistics of one output is multiplied by its ``factor`` (P,).
        """
        self.B, b, constant = np.eye(self.size), np.zeros(self.size), 0.0
        for outputs, s in self.statistics.items():
            times = factor[outputs[0]]
            columns = self.features.columns(outputs[0]) if len(outputs) == 1 else np.arange(len(b))
            self.B[np.ix_(columns, columns)] += s.outer / times
            b[columns] += s.inner / times
            # log |2 pi noise| + y Pi y + tr(Pi (var(y) - V^T V)), which completes the bound
            constant += s.log_determinant + s.n * np.log(times) + (s.square + s.unexplained) / times
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

    def with_noise(self, noise: Vector) -> SparsePosterior:
        """Return the posterior with other variances of independent noise, from the same sums over samples."""
        new = object.__new__(SparsePosterior)
        kept = ("kernel", "features", "Lu", "data", "statistics")
        vars(new).update({name: getattr(self, name) for name in kept})
        new.noise = np.asarray(noise, dtype=float)
        new._condition(new.noise)
        return new

    def noise_seen(self) -> np.ndarray:
        """Return the expected mean squared residual of each output, (P,), for independent noise.

        This is the noise update of expectation maximisation: at its fixed point the bound is
        stationary in the noise.
        """
        residual = np.zeros(len(self.noise))
        for (i,), s in self.statistics.items():
            c = self.features.columns(i)
            w = self.white[c]
            spread = np.einsum("ab,ab->", self.B_inverse[np.ix_(c, c)], s.outer) + s.unexplained
            residual[i] = (s.square - 2 * w @ s.inner + w @ s.outer @ w + spread) / s.n
        return residual

    @property
    def unexplained_variance(self) -> Vector:
        """Mean prior variance that the features do not explain, (P,), of values with independent noise.

        Far below the noise variance, the posterior is nearly the exact one (Burt, Rasmussen & van
        der Wilk 2020).
        """
        variance = np.zeros(len(self.noise))
        for (i,), s in self.statistics.items():
            variance[i] = s.unexplained / s.n
        return variance

    def of(self, data: Data, noise: Vector) -> SparsePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters and features."""
        return SparsePosterior(self.kernel, self.features, noise, data)

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
                factor = sub_factor(self.Lu, columns)
                roots.append(
                    triangular_solve(factor, semidefinite_root(reduction), transposed=True)
                )
        return roots

    def _factors(self, kernel: MultiOutputKernel) -> dict[str, Any]:
        return {"features": self.features.rebuild(kernel), "roots": self.roots}

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
            prior, u = self.features.prior_paths(n_paths, FREQUENCIES, rng)
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


def shares_of(data: Data) -> list[SampleShare]:
    """Return the observed values in shares that do not depend on the number of threads: sums have the same bits."""
    if data.sample_noise is not None:
        tables = [(tuple(range(len(data.y))), *_sample_table(data))]
    else:
        tables = [
            ((i,), X, y[:, None], np.zeros((len(y), 1, 0)))
            for i, (X, y) in enumerate(zip(data.X, data.y, strict=True))
            if len(y)
        ]
    shares = []
    for outputs, *table in tables:
        n_shares = min(SHARES if len(outputs) == 1 else SAMPLE_SHARES, -(-len(table[0]) // ROWS))
        parts = zip(*(np.array_split(part, n_shares) for part in table), strict=True)
        shares += [SampleShare(outputs, *part) for part in parts]
    return shares


def _sample_table(data):
    """Return X, Y and loading of the samples."""
    sample, loadings = data.sample_noise.sample, data.sample_noise.loading
    samples, X = sample_table(data.X, sample)
    n, P = len(samples), len(data.y)
    Y, loading = np.full((n, P), np.nan), np.zeros((n, P, loadings[0].shape[1]))
    for i in range(P):
        rows = np.searchsorted(samples, sample[i])
        Y[rows, i] = data.y[i]
        loading[rows, i] = loadings[i]
    return X, Y, loading


# -- sums for conditioning
# --------------------------------------------------------------------------------------------


class Statistics(NamedTuple):
    """Sums over n samples of some outputs, with V = Lu^-1 Kuf and the inverse noise Pi.

    V Pi V^T (c, c), V Pi y (c,), y Pi y, tr(Pi var(y)) and log |2 pi noise|.
    """

    outer: np.ndarray
    inner: np.ndarray
    square: float
    variance: float
    log_determinant: float
    n: int

    @property
    def unexplained(self) -> float:
        """Prior variance that the features do not explain."""
        return self.variance - float(np.trace(self.outer))


def compute_statistics(kernel, features, noise, Lu, shares) -> dict[tuple[int, ...], Statistics]:
    """Return the sums over all values by their outputs: each alone, or all if their noise is correlated."""
    sums = thread_map(partial(_share_sums, kernel, features, noise, Lu), shares)
    statistics = {}
    for outputs in dict.fromkeys(share.outputs for share in shares):
        parts = [part for part, share in zip(sums, shares, strict=True) if share.outputs == outputs]
        statistics[outputs] = Statistics(*(sum(terms) for terms in zip(*parts, strict=True)))
    return statistics


def _share_sums(kernel, features, noise, Lu, share):
    """Return the statistics of a share; one output uses only its own features."""
    outputs = range(len(share.outputs))
    columns = [features.columns(i) for i in share.outputs]
    factors = [sub_factor(Lu, c) for c in columns]
    places: dict = {(i, j): np.ix_(columns[i], columns[j]) for i in outputs for j in outputs}
    size = features.size
    if len(outputs) == 1:  # slices instead of index arrays: nothing is copied
        size, columns, places = len(columns[0]), [slice(None)], {(0, 0): slice(None)}
    pairs = list(combinations_with_replacement(outputs, 2))
    blocks = {(i, j): np.zeros((factors[i].shape[0], factors[j].shape[0])) for i, j in pairs}
    inner = np.zeros(size)
    square = variance = log_determinant = 0.0
    noise = noise[list(share.outputs)]
    for rows in gen_batches(len(share.X), ROWS):
        X, Y = share.X[rows], np.nan_to_num(share.Y[rows])
        precision, log_determinants = precisions(share.Y[rows], share.loading[rows], noise)
        weighted = np.einsum("nij,nj->ni", precision, Y)
        V = [triangular_solve(factors[i], features.Kfu(share.outputs[i], X).T) for i in outputs]
        for i, j in pairs:
            if i == j:
                weight = precision[:, i, i]
                half = V[i] if (weight == 1.0).all() else V[i] * np.sqrt(weight)
                blocks[i, i] += half @ half.T
            else:
                blocks[i, j] += (V[i] * precision[:, i, j]) @ V[j].T
            if kernel.couples(share.outputs[i], share.outputs[j]):
                prior = _variance(kernel, share.outputs[i], share.outputs[j], X)
                variance += (1 if i == j else 2) * precision[:, i, j] @ prior
        for i in outputs:
            inner[columns[i]] += V[i] @ weighted[:, i]
        square += np.sum(Y * weighted)
        log_determinant += log_determinants.sum()
    outer = np.zeros((size, size))
    for i, j in pairs:
        outer[places[i, j]] += blocks[i, j]
        if i != j:
            outer[places[j, i]] += blocks[i, j].T
    return Statistics(outer, inner, square, variance, log_determinant, len(share.X))


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


def _variance(kernel, i, j, X):
    """Return cov(y_i(x), y_j(x)) at each row x of X, (n,)."""
    if i == j:
        return kernel.block_diag(i, X)
    return np.concatenate(
        [
            np.diag(kernel.block(i, j, X[rows], X[rows]))
            for rows in gen_batches(len(X), DIAGONAL_ROWS)
        ]
    )
