"""Noise covariance: white noise of each output, and noise propagated from the regressors to all outputs.

The noise of sample a has the covariance diag(sigma^2) + J_a S J_a^T, with the slopes J_a of the
posterior mean and the covariance S of errors of the regressors (McHutchon & Rasmussen 2011). With G
= J R and S = R diag(s) R^T this is diag(sigma^2) + G_a diag(s) G_a^T. G is called ``loading``, as
in factor analysis.

Residuals of a fit also show the drift, an Ornstein-Uhlenbeck process with the covariance tau^2
exp(-|t - t'| / T) within a flight (Rasmussen & Williams 2006, equation 4.20 with nu = 1/2), and the
misfit.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Matrix, Predictor, Vector

LONGEST_HORIZON = 10.0  # longest time over which residuals are integrated [s]
N_HORIZONS = 12
MODEL_ERROR = 0.3  # relative, of the variances of integrals
LONGEST_GAP = 4.0  # a longer interval, over the median one, ends a record
LARGEST_LAG = 10.0  # errors of samples that are farther apart in time have independent noise [s]
CANDIDATES, NEIGHBOURS = (
    40,
    8,
)  # nearest samples that are looked at, and largest number of neighbours far in time
MISFIT_ROWS = 15000  # largest number of samples
PARTS = 16  # parts of the log whose means show the standard error of the whole


class SampleNoise(NamedTuple):
    """For each output: the sample index of each value, (n_i,), and its loading G (n_i, r) on the regressors' noise."""

    sample: list[np.ndarray]
    loading: list[np.ndarray]

    @classmethod
    def from_table(cls, observed, loading) -> SampleNoise:
        """Return the entries of ``loading`` (n, P, r) for the observed values, a mask (n, P)."""
        return cls(
            [np.flatnonzero(rows) for rows in observed.T],
            [loading[rows, i] for i, rows in enumerate(observed.T)],
        )

    def pairs(self):
        """Yield (i, j, rows, columns, G_i, G_j) for each pair of outputs i <= j.

        ``rows`` and ``columns`` are the indices among the stacked values of two values of the same
        sample, on or above the diagonal.
        """
        start = np.cumsum([0, *map(len, self.sample)])
        for i, j in combinations_with_replacement(range(len(self.sample)), 2):
            _, a, b = np.intersect1d(
                self.sample[i], self.sample[j], assume_unique=True, return_indices=True
            )
            yield i, j, start[i] + a, start[j] + b, self.loading[i][a], self.loading[j][b]


def _white_and_scale(noise, data):
    """Return sigma^2 (P,) and the factors s (r,) of a noise vector [sigma^2, s]; s is 1 where it is not learned."""
    P = len(data.y)
    return noise[:P], noise[P:] if len(noise) > P else 1.0


def add_noise(K, noise, data) -> None:
    """Add the covariance of ``noise``, [sigma^2 (P)] or [sigma^2, s (r)], to the upper triangle of K (N, N)."""
    white, scale = _white_and_scale(noise, data)
    np.einsum("ii->i", K)[:] += np.repeat(white, [len(y) for y in data.y])
    if data.sample_noise is not None:
        for _, _, rows, columns, first, second in data.sample_noise.pairs():
            K[rows, columns] += np.einsum("nr,nr->n", first * scale, second)


def draw_noise(noise, data, n_draws, random_state) -> np.ndarray:
    """Return draws of the noise of the stacked values, (n_draws, N); ``noise`` (P,) holds the white noise variances."""
    std = np.repeat(np.sqrt(noise), [len(y) for y in data.y])
    draws = std * random_state.standard_normal((n_draws, len(std)))
    if data.sample_noise is not None:
        n_samples = 1 + max(s.max() for s in data.sample_noise.sample if len(s))
        error = random_state.standard_normal(
            (n_draws, n_samples, data.sample_noise.loading[0].shape[1])
        )
        propagated = [
            np.einsum("snr,nr->sn", error[:, s], G) for s, G in zip(*data.sample_noise, strict=True)
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
    for i, j, rows, columns, first, second in data.sample_noise.pairs():
        by_scale += (0.5 if i == j else 1.0) * np.einsum(
            "n,nr,nr->r", W[rows, columns], first, second
        )
    return np.concatenate([by_white, scale * by_scale])


# -- the drift that residuals show
# ------------------------------------------------------------------------------------


def fit_drift_to_integrals(
    residual: Vector, clock: Matrix, least: float
) -> tuple[float, float, float]:
    r"""Return sigma^2, tau^2 and T of white noise plus drift, fitted to the integrals of the residuals (n,) over time.

    A simulated flight integrates the errors of the coefficients, so the estimate is judged by
    integrals. Over a time h, the integral of white noise with the sample interval d and of a drift
    has the variance

    .. math:: \sigma^2 d h + 2 \tau^2 T^2 (h / T - 1 + e^{-h / T}).

    tau^2 and T minimise the squared differences between its logarithm and the logarithm of the
    residuals' variance, over
    horizons h from two sample intervals to 10 s or the longest record; sigma^2 + tau^2 is the mean
    square of the residuals. With n = the time flown over h, a logarithm has the weight 1 / (0.3^2 +
    2 / n): the variance of n squares, and an error of the model. Residuals are not exactly white
    noise plus a drift: maximum likelihood would fit the differences of neighbouring samples best,
    and integrals over seconds worse.

    The constant of the function takes up the mean of the residuals, so the mean square of n
    independent integrals is multiplied by n / (n - 1). The clock (n, 2) holds time and flight; no
    variance is smaller than ``least``.
    """
    order = np.lexsort(clock.T)
    residual, (time, flight) = residual[order], clock[order].T
    same, steps = flight[1:] == flight[:-1], np.diff(time)
    moving = steps[same & (steps > 0)]
    step = float(np.median(moving)) if len(moving) else 1.0
    records = np.split(
        np.arange(len(time)), 1 + np.flatnonzero(~same | (steps > LONGEST_GAP * step))
    )
    longest = max(np.ptp(time[rows]) for rows in records)
    horizons = np.geomspace(2 * step, max(min(longest, LONGEST_HORIZON), 2 * step), N_HORIZONS)
    flown = sum(np.ptp(time[rows]) for rows in records)
    power = max(float(np.mean(residual**2)), 10 * least)
    integrals = _mean_squared_integrals(residual, time, records, horizons)
    known = (integrals > 0) & (horizons < flown)
    if not known.any():  # nothing shows a drift
        return power, least, step
    horizons = horizons[known]
    integrals = np.log(integrals[known] / (1 - horizons / flown))
    weight = 1 / (MODEL_ERROR**2 + 2 * horizons / flown)

    def loss(theta):
        variance, memory = np.exp(theta)
        ratio = horizons / memory
        drift = 2 * variance * memory**2 * (ratio + np.expm1(-ratio))
        return weight @ (np.log(drift + (power - variance) * step * horizons) - integrals) ** 2

    bounds = np.log([(least, power), (step, max(longest, 2 * step))])
    starts = [
        (np.log(0.5 * power), start) for start in np.linspace(bounds[1, 0], bounds[1, 1], 5)[:-1]
    ]
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


# -- the misfit that residuals show
# -----------------------------------------------------------------------------------


def misfit_variance(posterior: Predictor, X: Matrix, Y: Matrix, clock: Matrix) -> Vector:
    r"""Return the variance of the misfit of each output, (P,), at the samples that a posterior has learned from.

    Residuals e of two samples with near regressors share the error of the function, but no noise if
    they are from different flights or 10 s apart. So their products have the mean square of this
    error as their mean. With the mean m of n products and its standard error s, the least that they
    show is

    .. math:: v_i = \max(0, m_i - s_i), \quad
              m_i = \frac{1}{n} \sum_a e_{ia} \frac{1}{|N_a|} \sum_{b \in N_a} e_{ib}.

    :math:`N_a` are at most 8 of the 40 samples nearest to a, by regressors over their standard
    deviations; a sample without such neighbours does not count. s is the scatter over 16 parts of
    the log; it is multiplied by :math:`\sqrt 2`, since two parts share the products of their
    samples. For the right model the mean product is the negative posterior covariance, so v is zero
    but by chance. It is positive where the function has kinks or jumps that the kernel's widths
    smooth away. Errors that change their sign within the distance of neighbours do not show.

    Parameters
    ----------
    posterior : ExactPosterior, SparsePosterior or regressor
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    clock : ndarray (n, 2)
        Time [s] and flight number of each sample.

    Returns
    -------
    ndarray (P,)
        In squared units of Y.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from skdgp.inference import misfit_variance
    >>> rng = np.random.default_rng(0)
    >>> x, time = rng.uniform(-1, 1, (4000, 1)), np.arange(4000.0)
    >>> y = np.abs(x) + rng.normal(0, 0.5, x.shape)
    >>> line = LinearRegression().fit(x, y)
    >>> misfit = misfit_variance(line, x, y, np.column_stack([time, 0 * time]))
    >>> float(np.sqrt(misfit[0]).round(1)), float(np.std(np.abs(x) - line.predict(x)).round(1))
    (0.3, 0.3)
    """
    rows = np.flatnonzero(np.isfinite(Y).any(axis=1))
    rows = rows[:: -(-len(rows) // MISFIT_ROWS)]
    X, residual, (time, flight) = X[rows], Y[rows] - posterior.predict(X[rows]), clock[rows].T
    scaled = X / column_scale(X)
    near: Any = KDTree(scaled).query(scaled, k=min(CANDIDATES, len(X)))[1]
    apart = (np.abs(time[near] - time[:, None]) > LARGEST_LAG) | (flight[near] != flight[:, None])
    sample, place = np.nonzero(apart & (np.cumsum(apart, axis=1) <= NEIGHBOURS))
    neighbours = csr_array(
        (np.ones(len(sample)), (sample, near[sample, place])), shape=(len(X), len(X))
    )
    observed = np.isfinite(residual)
    error = np.where(observed, residual, 0.0)
    total, count = neighbours @ error, neighbours @ observed.astype(float)
    variance = np.zeros(Y.shape[1])
    for i in range(Y.shape[1]):
        some = observed[:, i] & (count[:, i] > 0)
        if some.sum() >= PARTS:
            products = error[some, i] * total[some, i] / count[some, i]
            parts = [part.mean() for part in np.array_split(products, PARTS)]
            variance[i] = max(0.0, products.mean() - np.sqrt(2 / PARTS) * np.std(parts, ddof=1))
    return variance
