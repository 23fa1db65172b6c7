"""Noise covariance: each output's own, correlated in time where asked, and what regressors carry into all outputs.

To first order a regressor that is off by e, e ~ N(0, S), moves the outputs of sample a by J_a e, with the slopes J_a of
the posterior mean: their noise has the covariance diag(sigma^2) + J_a S J_a^T (McHutchon & Rasmussen 2011), the same e
in every output. With G = J R, S = R diag(s) R^T, this is diag(sigma^2) + G_a diag(s) G_a^T.

Neighbouring samples of a flight err alike: gusts, lags and unmodelled motion last longer than a sample. Each output has
a drift, an Ornstein-Uhlenbeck process with the covariance tau^2 exp(-|t - t'| / T) within a flight, and none between
flights (Rasmussen & Williams 2006, equation 4.20 with nu = 1/2).
"""

from __future__ import annotations

from itertools import combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded
from scipy.optimize import minimize

from skdgp._compute.linalg import eigen_root

SMALLEST_STEP = 1e-6  # of a drift's memory: two samples of one time


class SampleNoise(NamedTuple):
    """Of each output: which sample each value is of, (n_i,), and where noisy regressors carry it, G (n_i, r)."""

    sample: list[np.ndarray]
    loading: list[np.ndarray]

    @classmethod
    def from_table(cls, seen, loading) -> SampleNoise:
        """Return what belongs to the observed values, ``seen`` (n, P), of ``loading`` (n, P, r)."""
        return cls([np.flatnonzero(s) for s in seen.T], [loading[s, i] for i, s in enumerate(seen.T)])

    def joined(self, other: SampleNoise) -> SampleNoise:
        """Return these values, then the other's, which are of other samples."""
        first = 1 + max((s.max() for s in self.sample if len(s)), default=-1)
        sample = [np.concatenate([a, b + first]) for a, b in zip(self.sample, other.sample, strict=True)]
        return SampleNoise(sample, [np.concatenate(pair) for pair in zip(self.loading, other.loading, strict=True)])

    def pairs(self):
        """Yield the places, rows and columns among the stacked values, of two values of one sample, and their loading.

        Rows are not below columns, and every pair of outputs comes once: (i, j, rows, columns, G_i, G_j).
        """
        start = np.cumsum([0, *map(len, self.sample)])
        for i, j in combinations_with_replacement(range(len(self.sample)), 2):
            _, a, b = np.intersect1d(self.sample[i], self.sample[j], assume_unique=True, return_indices=True)
            yield i, j, start[i] + a, start[j] + b, self.loading[i][a], self.loading[j][b]


Scatter = SampleNoise  # its name in model files of version 0.1


class Drift(NamedTuple):
    """Of each output: when each value was measured, time and flight (n_i, 2), and tau^2 and T, (P,) each.

    While the last two are learned they stand in the vector of noise, and are None here.
    """

    clock: list[np.ndarray]
    variance: np.ndarray | None = None
    memory: np.ndarray | None = None

    def covariance(self, i, variance, memory):
        """Return the covariance of the drift of output i and |t - t'|, (n_i, n_i) each."""
        time, flight = self.clock[i].T
        apart = np.abs(np.subtract.outer(time, time))
        return variance * np.exp(-apart / memory) * np.equal.outer(flight, flight), apart


class NoiseParts(NamedTuple):
    """The vector of noise, by what its entries are; what is given has ``free`` False."""

    own: np.ndarray
    variance: Any  # ndarray (P,), None where noise does not drift
    memory: Any
    scale: Any  # ndarray (r,), or 1 where it is not learned
    free_drift: bool
    free_scale: bool

    @classmethod
    def of(cls, noise, data) -> NoiseParts:
        """Return the parts of [sigma^2 (P), tau^2 (P), T (P), s (r)], of which only the first are always there."""
        P, drift = len(data.y), data.drift
        own, rest = noise[:P], noise[P:]
        variance, memory = (None, None) if drift is None else (drift.variance, drift.memory)
        free_drift = drift is not None and variance is None
        if free_drift:
            variance, memory, rest = rest[:P], rest[P : 2 * P], rest[2 * P :]
        return cls(own, variance, memory, rest if len(rest) else 1.0, free_drift, len(rest) > 0)


def add_noise(K, noise, data) -> None:
    """Add the noise to the upper triangle of a covariance matrix of the values, (N, N) in C order.

    Parameters
    ----------
    K : ndarray (N, N)
    noise : ndarray
        Variance of each output, and what else is learned, see ``NoiseParts``.
    data : Data
    """
    parts = NoiseParts.of(noise, data)
    np.einsum("ii->i", K)[:] += np.repeat(parts.own, [len(y) for y in data.y])
    for i, rows in _drifting(parts, data):
        K[rows, rows] += np.triu(data.drift.covariance(i, parts.variance[i], parts.memory[i])[0])
    if data.sample_noise is not None:
        for _, _, rows, columns, first, second in data.sample_noise.pairs():
            K[rows, columns] += np.einsum("nr,nr->n", first * parts.scale, second)


def draw_noise(noise, data, n_draws, random_state) -> np.ndarray:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) is the outputs' own."""
    parts = NoiseParts.of(noise, data)
    own = np.repeat(np.sqrt(parts.own), [len(y) for y in data.y])
    drawn = own * random_state.standard_normal((n_draws, len(own)))
    for i, rows in _drifting(parts, data):
        covariance = data.drift.covariance(i, parts.variance[i], parts.memory[i])[0]
        drawn[:, rows] += random_state.standard_normal((n_draws, len(covariance))) @ eigen_root(covariance).T
    if data.sample_noise is not None:
        n_samples = 1 + max(s.max() for s in data.sample_noise.sample if len(s))
        off = random_state.standard_normal((n_draws, n_samples, data.sample_noise.loading[0].shape[1]))
        carried = [np.einsum("snr,nr->sn", off[:, s], G) for s, G in zip(*data.sample_noise, strict=True)]
        drawn += np.hstack(carried)
    return drawn


def noise_gradient(W, noise, data) -> np.ndarray:
    """Return 1/2 sum(W * dK / d log noise), of the shape of ``noise``, of a W whose upper triangle is read."""
    P, parts = len(data.y), NoiseParts.of(noise, data)
    outputs = np.repeat(np.arange(P), [len(y) for y in data.y])  # an output without values has no share
    gradient = [0.5 * parts.own * np.bincount(outputs, np.einsum("ii->i", W), minlength=P)]
    if parts.free_drift:
        by_variance, by_memory = np.zeros(P), np.zeros(P)
        for i, rows in _drifting(parts, data):
            covariance, apart = data.drift.covariance(i, parts.variance[i], parts.memory[i])
            weighted = np.triu(W[rows, rows]) * covariance
            by_variance[i] = weighted.sum() - 0.5 * np.trace(weighted)
            by_memory[i] = np.sum(weighted * apart) / parts.memory[i]
        gradient += [by_variance, by_memory]
    if parts.free_scale:
        carried = np.zeros(len(parts.scale))
        for i, j, rows, columns, first, second in data.sample_noise.pairs():
            carried += (0.5 if i == j else 1.0) * np.einsum("n,nr,nr->r", W[rows, columns], first, second)
        gradient.append(parts.scale * carried)
    return np.concatenate(gradient)


def _drifting(parts, data):
    """Yield the outputs whose noise drifts, and their rows among the stacked values."""
    if parts.variance is not None:
        for i, (a, b) in enumerate(pairwise(np.cumsum([0, *map(len, data.y)]))):
            if b > a:
                yield i, slice(a, b)


# -- drift at full rate: its inverse covariance has three diagonals ---------------------------------------------


def drift_precision(clock, variance, memory):
    """Return the inverse covariance of drifts: its diagonal, its upper diagonal, and log |covariance|, by output.

    Parameters
    ----------
    clock : ndarray (n, 2)
        Time and flight of samples in the order of the log.
    variance, memory : ndarray (p,)

    Returns
    -------
    diagonal : ndarray (n, p)
    beside : ndarray (n - 1, p)
        Between a sample and the next; zero where another flight begins.
    log_determinant : ndarray (p,)
    """
    time, flight = clock.T
    step = np.maximum(np.abs(np.diff(time))[:, None] / memory, SMALLEST_STEP)
    rho = np.exp(-step) * (flight[1:] == flight[:-1])[:, None]
    left = -np.expm1(-2 * step) * (rho > 0) + (rho == 0)  # 1 - rho^2: what is new in a sample
    diagonal = np.ones((len(time), len(variance)))
    diagonal[1:] = 1.0 / left
    diagonal[:-1] += rho**2 / left
    return diagonal / variance, -rho / left / variance, np.log(left).sum(axis=0) + len(time) * np.log(variance)


def fit_drift(residual, clock, least):
    """Return sigma^2, tau^2 and T of a residual that is white noise and a drift, by maximum likelihood.

    Parameters
    ----------
    residual : ndarray (n,)
        In the order of the log.
    clock : ndarray (n, 2)
        Time and flight.
    least : float
        Smallest variance.
    """
    step = np.median(np.abs(np.diff(clock[:, 0]))[np.diff(clock[:, 1]) == 0]) if len(clock) > 1 else 1.0
    longest = max(np.ptp(clock[clock[:, 1] == flight, 0]) for flight in np.unique(clock[:, 1]))
    power = max(float(np.mean(residual**2)), 10 * least)
    bounds = np.log([(least, 10 * power), (least, 10 * power), (step, max(longest, 2 * step))])

    def loss(theta):
        white, variance, memory = np.exp(theta)
        diagonal, beside, log_determinant = drift_precision(clock, np.array([variance]), np.array([memory]))
        band = np.zeros((2, len(residual)))
        band[0], band[1, :-1] = diagonal[:, 0] + 1.0 / white, beside[:, 0]
        factor = cholesky_banded(band, lower=True)
        solved = solveh_banded(band, residual / white, lower=True)
        determinant = 2 * np.log(factor[0]).sum() + log_determinant[0] + len(residual) * np.log(white)
        return 0.5 * (determinant + (residual @ residual - residual @ solved) / white)

    starts = [np.log([0.5 * power, 0.5 * power, memory]) for memory in (4 * step, 40 * step)]
    ends = [minimize(loss, np.clip(s, *bounds.T), method="L-BFGS-B", bounds=[*bounds]) for s in starts]
    return np.exp(min(ends, key=lambda end: end.fun).x)
