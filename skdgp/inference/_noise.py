"""Noise covariance: white noise and drift of each output, and noise propagated from the regressors to all outputs.

To first order an error e ~ N(0, S) of the regressors changes all outputs of sample a by J_a e, with the slopes J_a of
the posterior mean. The noise of the sample then has the covariance diag(sigma^2) + J_a S J_a^T (McHutchon & Rasmussen
2011). With G = J R and S = R diag(s) R^T this is diag(sigma^2) + G_a diag(s) G_a^T. G is called ``loading``, as in
factor analysis.

Errors of neighbouring samples of a flight are correlated: gusts, lags and unmodelled motion last longer than a sample
interval. The drift of an output is an Ornstein-Uhlenbeck process with the covariance tau^2 exp(-|t - t'| / T) within a
flight, and zero between flights (Rasmussen & Williams 2006, equation 4.20 with nu = 1/2).
"""

from __future__ import annotations

from itertools import combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded
from scipy.optimize import minimize

from skdgp._compute.linalg import eigen_root
from skdgp._compute.typing import Matrix, Vector

SMALLEST_STEP = 1e-6  # smallest sample interval, over the memory of the drift: for two samples of the same time
LONGEST_HORIZON = 10.0  # longest time over which residuals are integrated [s]
N_HORIZONS = 12
MODEL_ERROR = 0.3  # relative, of the variances of integrals
LONGEST_GAP = 4.0  # a longer interval, over the median one, ends a record


class SampleNoise(NamedTuple):
    """For each output: the sample index of each value, (n_i,), and its loading G (n_i, r) on the regressors' noise."""

    sample: list[np.ndarray]
    loading: list[np.ndarray]

    @classmethod
    def from_table(cls, observed, loading) -> SampleNoise:
        """Return the entries of ``loading`` (n, P, r) for the observed values, a mask (n, P)."""
        return cls(
            [np.flatnonzero(rows) for rows in observed.T], [loading[rows, i] for i, rows in enumerate(observed.T)]
        )

    def joined(self, other: SampleNoise) -> SampleNoise:
        """Return these values followed by the other values, which belong to other samples."""
        first = 1 + max((s.max() for s in self.sample if len(s)), default=-1)
        sample = [np.concatenate([a, b + first]) for a, b in zip(self.sample, other.sample, strict=True)]
        return SampleNoise(sample, [np.concatenate(pair) for pair in zip(self.loading, other.loading, strict=True)])

    def pairs(self):
        """Yield (i, j, rows, columns, G_i, G_j) for each pair of outputs i <= j.

        ``rows`` and ``columns`` are the indices among the stacked values of two values of the same sample, on or above
        the diagonal.
        """
        start = np.cumsum([0, *map(len, self.sample)])
        for i, j in combinations_with_replacement(range(len(self.sample)), 2):
            _, a, b = np.intersect1d(self.sample[i], self.sample[j], assume_unique=True, return_indices=True)
            yield i, j, start[i] + a, start[j] + b, self.loading[i][a], self.loading[j][b]


class Drift(NamedTuple):
    """The clock of each output's values, time and flight number (n_i, 2), and the drifts' tau^2 and T, (P,) each.

    While tau^2 and T are learned they are None here and part of the noise vector.
    """

    clock: list[np.ndarray]
    variance: np.ndarray | None = None
    memory: np.ndarray | None = None

    def covariance(self, i, variance, memory):
        """Return the covariance of the drift of output i and the time lags |t - t'|, (n_i, n_i) each."""
        time, flight = self.clock[i].T
        lag = np.abs(np.subtract.outer(time, time))
        return variance * np.exp(-lag / memory) * np.equal.outer(flight, flight), lag


class NoiseParts(NamedTuple):
    """The parts of the noise vector; ``free_drift`` and ``free_scale`` tell which optional parts it contains."""

    white: np.ndarray
    variance: Any  # ndarray (P,), None where noise does not drift
    memory: Any
    scale: Any  # ndarray (r,), or 1 where it is not learned
    free_drift: bool
    free_scale: bool

    @classmethod
    def split(cls, noise, data) -> NoiseParts:
        """Return the parts of [sigma^2 (P), tau^2 (P), T (P), s (r)], of which only sigma^2 is always present."""
        P, drift = len(data.y), data.drift
        white, rest = noise[:P], noise[P:]
        variance, memory = (None, None) if drift is None else (drift.variance, drift.memory)
        free_drift = drift is not None and variance is None
        if free_drift:
            variance, memory, rest = rest[:P], rest[P : 2 * P], rest[2 * P :]
        return cls(white, variance, memory, rest if len(rest) else 1.0, free_drift, len(rest) > 0)


def add_noise(K, noise, data) -> None:
    """Add the covariance of ``noise``, see ``NoiseParts``, to the upper triangle of that of the values, (N, N)."""
    parts = NoiseParts.split(noise, data)
    np.einsum("ii->i", K)[:] += np.repeat(parts.white, [len(y) for y in data.y])
    for i, rows in _drift_slices(parts, data):
        covariance = data.drift.covariance(i, parts.variance[i], parts.memory[i])[0]
        upper = ~np.tri(len(covariance), k=-1, dtype=bool)  # below, K holds no numbers
        np.add(K[rows, rows], covariance, out=K[rows, rows], where=upper)
    if data.sample_noise is not None:
        for _, _, rows, columns, first, second in data.sample_noise.pairs():
            K[rows, columns] += np.einsum("nr,nr->n", first * parts.scale, second)


def draw_noise(noise, data, n_draws, random_state) -> np.ndarray:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) holds the white noise variances."""
    parts = NoiseParts.split(noise, data)
    std = np.repeat(np.sqrt(parts.white), [len(y) for y in data.y])
    draws = std * random_state.standard_normal((n_draws, len(std)))
    for i, rows in _drift_slices(parts, data):
        covariance = data.drift.covariance(i, parts.variance[i], parts.memory[i])[0]
        draws[:, rows] += random_state.standard_normal((n_draws, len(covariance))) @ eigen_root(covariance).T
    if data.sample_noise is not None:
        n_samples = 1 + max(s.max() for s in data.sample_noise.sample if len(s))
        error = random_state.standard_normal((n_draws, n_samples, data.sample_noise.loading[0].shape[1]))
        propagated = [np.einsum("snr,nr->sn", error[:, s], G) for s, G in zip(*data.sample_noise, strict=True)]
        draws += np.hstack(propagated)
    return draws


def noise_gradient(W, noise, data) -> np.ndarray:
    """Return 1/2 sum(W * dK / d log noise), in the shape of ``noise``; only the upper triangle of W is read."""
    P, parts = len(data.y), NoiseParts.split(noise, data)
    outputs = np.repeat(np.arange(P), [len(y) for y in data.y])  # an output without values contributes zero
    gradient = [0.5 * parts.white * np.bincount(outputs, np.einsum("ii->i", W), minlength=P)]
    if parts.free_drift:
        by_variance, by_memory = np.zeros(P), np.zeros(P)
        for i, rows in _drift_slices(parts, data):
            covariance, lag = data.drift.covariance(i, parts.variance[i], parts.memory[i])
            weighted = np.triu(W[rows, rows]) * covariance
            by_variance[i] = weighted.sum() - 0.5 * np.trace(weighted)
            by_memory[i] = np.sum(weighted * lag) / parts.memory[i]
        gradient += [by_variance, by_memory]
    if parts.free_scale:
        by_scale = np.zeros(len(parts.scale))
        for i, j, rows, columns, first, second in data.sample_noise.pairs():
            by_scale += (0.5 if i == j else 1.0) * np.einsum("n,nr,nr->r", W[rows, columns], first, second)
        gradient.append(parts.scale * by_scale)
    return np.concatenate(gradient)


def _drift_slices(parts, data):
    """Yield the outputs whose noise has a drift, and their slices of the stacked values."""
    if parts.variance is not None:
        for i, (a, b) in enumerate(pairwise(np.cumsum([0, *map(len, data.y)]))):
            if b > a:
                yield i, slice(a, b)


# -- drift of all samples of a log: its inverse covariance is tridiagonal ----------------------------------------


def drift_precision(clock, variance, memory):
    """Return the tridiagonal inverse covariance of drifts of variance and memory (p,), and log |covariance| (p,).

    The diagonal is (n, p), the upper diagonal (n - 1, p), zero between flights. The clock (n, 2) holds time and flight
    of samples in the order of the log.
    """
    time, flight = clock.T
    step = np.maximum(np.abs(np.diff(time))[:, None] / memory, SMALLEST_STEP)
    rho = np.exp(-step) * (flight[1:] == flight[:-1])[:, None]
    innovation = -np.expm1(-2 * step) * (rho > 0) + (rho == 0)  # variance 1 - rho^2 of the innovation of each sample
    diagonal = np.ones((len(time), len(variance)))
    diagonal[1:] = 1.0 / innovation
    diagonal[:-1] += rho**2 / innovation
    log_determinant = np.log(innovation).sum(axis=0) + len(time) * np.log(variance)
    return diagonal / variance, -rho / innovation / variance, log_determinant


def fit_drift(residual, clock, least):
    """Return the maximum likelihood estimates of sigma^2, tau^2 and T of white noise plus drift.

    The residuals (n,) and the clock (n, 2), time and flight, are in the order of the log; no variance is smaller than
    ``least``.
    """
    step = np.median(np.abs(np.diff(clock[:, 0]))[np.diff(clock[:, 1]) == 0]) if len(clock) > 1 else 1.0
    longest = max(np.ptp(clock[clock[:, 1] == flight, 0]) for flight in np.unique(clock[:, 1]))
    power = max(float(np.mean(residual**2)), 10 * least)
    bounds = np.log([(least, 10 * power), (least, 10 * power), (step, max(longest, 2 * step))])

    def loss(theta):
        white, variance, memory = np.exp(theta)
        diagonal, off_diagonal, log_determinant = drift_precision(clock, np.array([variance]), np.array([memory]))
        band = np.zeros((2, len(residual)))
        band[0], band[1, :-1] = diagonal[:, 0] + 1.0 / white, off_diagonal[:, 0]
        factor = cholesky_banded(band, lower=True)
        solved = solveh_banded(band, residual / white, lower=True)
        determinant = 2 * np.log(factor[0]).sum() + log_determinant[0] + len(residual) * np.log(white)
        return 0.5 * (determinant + (residual @ residual - residual @ solved) / white)

    starts = [np.log([0.5 * power, 0.5 * power, memory]) for memory in (4 * step, 40 * step)]
    optima = [minimize(loss, np.clip(s, *bounds.T), method="L-BFGS-B", bounds=[*bounds]) for s in starts]
    return np.exp(min(optima, key=lambda optimum: optimum.fun).x)


def fit_drift_to_integrals(residual: Vector, clock: Matrix, least: float) -> tuple[float, float, float]:
    r"""Return sigma^2, tau^2 and T of white noise plus drift, fitted to the integrals of the residuals (n,) over time.

    A simulated flight integrates the errors of the coefficients, so the estimate is judged by integrals. Over a time h,
    the integral of white noise with the sample interval d and of a drift has the variance

    .. math:: \sigma^2 d h + 2 \tau^2 T^2 (h / T - 1 + e^{-h / T}).

    tau^2 and T minimise the squared differences of its logarithm from that of the residuals, over horizons h from two
    sample intervals to 10 s or the longest record; sigma^2 + tau^2 is the mean square of the residuals. With n = the
    time flown over h, a logarithm has the weight 1 / (0.3^2 + 2 / n): the variance of n squares, and an error of the
    model. Residuals are not exactly white noise plus a drift: maximum likelihood would fit the differences of
    neighbouring samples best, and integrals over seconds worse.

    The constant of the function takes up the mean of the residuals, so the mean square of n independent integrals is
    multiplied by n / (n - 1). The clock (n, 2) holds time and flight; no variance is smaller than ``least``.
    """
    order = np.lexsort(clock.T)
    residual, (time, flight) = residual[order], clock[order].T
    same, steps = flight[1:] == flight[:-1], np.diff(time)
    moving = steps[same & (steps > 0)]
    step = float(np.median(moving)) if len(moving) else 1.0
    records = np.split(np.arange(len(time)), 1 + np.flatnonzero(~same | (steps > LONGEST_GAP * step)))
    longest = max(np.ptp(time[rows]) for rows in records)
    horizons = np.geomspace(2 * step, max(min(longest, LONGEST_HORIZON), 2 * step), N_HORIZONS)
    flown = sum(np.ptp(time[rows]) for rows in records)
    power = max(float(np.mean(residual**2)), 10 * least)
    found = _mean_squared_integrals(residual, time, records, horizons)
    known = (found > 0) & (horizons < flown)
    if not known.any():  # nothing shows a drift
        return power, least, step
    horizons = horizons[known]
    found = np.log(found[known] / (1 - horizons / flown))
    weight = 1 / (MODEL_ERROR**2 + 2 * horizons / flown)

    def loss(theta):
        variance, memory = np.exp(theta)
        ratio = horizons / memory
        drift = 2 * variance * memory**2 * (ratio + np.expm1(-ratio))
        return weight @ (np.log(drift + (power - variance) * step * horizons) - found) ** 2

    bounds = np.log([(least, power), (step, max(longest, 2 * step))])
    starts = [(np.log(0.5 * power), start) for start in np.linspace(bounds[1, 0], bounds[1, 1], 5)[:-1]]
    optima = [minimize(loss, start, method="L-BFGS-B", bounds=[*bounds]) for start in starts]
    variance, memory = np.exp(min(optima, key=lambda optimum: optimum.fun).x)
    return max(power - variance, least), variance, memory


def _mean_squared_integrals(residual, time, records, horizons):
    """Return the mean square of the integrals of the residuals over each horizon, within records; NaN without one."""
    total, count = np.zeros((2, len(horizons)))
    for rows in records:
        elapsed = time[rows] - time[rows[0]]
        integral = np.concatenate([[0.0], np.cumsum(residual[rows[:-1]] * np.diff(elapsed))])
        for k, horizon in enumerate(horizons):
            inside = elapsed + horizon <= elapsed[-1] * (1 + 1e-9)
            change = np.interp(elapsed[inside] + horizon, elapsed, integral) - integral[inside]
            total[k], count[k] = total[k] + change @ change, count[k] + len(change)
    return np.divide(total, count, out=np.full(len(horizons), np.nan), where=count > 0)
