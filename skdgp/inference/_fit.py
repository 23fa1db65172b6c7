"""Fits: exact and sparse posteriors at the best hyperparameters, and the average of posteriors of parts of a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    check_memory,
    cluster_centres,
    column_scale,
    output_scale,
)
from skdgp._compute.messages import keeps_best
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Predictor, Seed, Vector
from skdgp.inference._average import AveragePosterior, held_out_weights, of_terms, parts_of
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import ExactPosterior, Posterior, SinglePosterior
from skdgp.inference._search import (
    NOISE_BOUNDS,
    NOISE_STEPS,
    UNKNOWN,
    Hyperparameters,
    KnownNoise,
    best_noise,
    search,
)
from skdgp.inference._sparse import SparsePosterior
from skdgp.kernels import MultiOutputKernel, inducing_features

MIN_WHITE_FRACTION = 0.01  # smallest part of an output's noise that is white measurement noise


class Fit(NamedTuple):
    """An ExactPosterior, SparsePosterior or AveragePosterior, its hyperparameters, and how well it explains its data.

    A sparse posterior uses a larger noise than ``learned`` where the errors of neighbouring samples
    are correlated.
    """

    posterior: Posterior
    learned: Hyperparameters

    def cut_short(self) -> Fit:
        """Return the same fit, interrupted."""
        return self._replace(learned=self.learned._replace(interrupted=True))


def fit_exact(
    kernel: MultiOutputKernel,
    X: Matrix,
    Y: Matrix,
    *,
    known: KnownNoise = UNKNOWN,
    data: Data | None = None,
    **options: Any,
) -> Fit:
    """Return the exact posterior at the best hyperparameters from one starting point.

    Parameters
    ----------
    kernel : MultiOutputKernel
        Missing values are estimated from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    known : KnownNoise
        What is known of the noise.
    data : Data or None
        Values of X and Y with the known noise, which fits of the same table share.
    **options
        Of the search: ``optimizer`` ("fmin_l_bfgs_b", or None, which keeps the starting values),
        ``max_iter`` on the joint likelihood, ``random_state``, and ``input_noise``, whether a
        standard deviation of the noise of each regressor is learned.

    Returns
    -------
    Fit
        The posterior, its hyperparameters and the history of the search.
    """
    learned = search(kernel, X, Y, exact=True, known=known, **options)
    data = learned.noisy(Data.from_table(X, Y, known.loading) if data is None else data)
    return Fit(ExactPosterior(learned.kernel, learned.noise, data), learned)


def as_exact(
    learned: Hyperparameters, X: Matrix, Y: Matrix, data: Data, known: KnownNoise = UNKNOWN
) -> Fit:
    """Return the exact posterior of these samples at a kernel that was learned, with its own noise.

    Parameters
    ----------
    learned : Hyperparameters
    X : ndarray (n, d)
    Y : ndarray (n, P)
    data : Data
        Of these samples.
    known : KnownNoise

    Returns
    -------
    Fit
    """
    kernel = learned.kernel
    learned = best_noise(learned, X, Y, data, known)
    noise = learned.noise
    posterior: SinglePosterior
    if kernel.n_processes:
        posterior = ExactPosterior(kernel, noise, data)
    else:  # the few weights of a trend are all that there is to know, so this is exact, and small
        posterior = SparsePosterior(kernel, inducing_features(kernel, X[:1]), noise, data)
    return Fit(posterior, learned)


def fit_sparse(
    kernel: MultiOutputKernel,
    X: Matrix,
    Y: Matrix,
    *,
    n_inducing: int,
    random_state: Seed,
    ordered: bool = False,
    known: KnownNoise = UNKNOWN,
    data: Data | None = None,
    **options: Any,
) -> Fit:
    """Return the sparse posterior of all samples, with hyperparameters learned from a subset.

    Parameters
    ----------
    kernel, X, Y
        As for ``fit_exact``.
    n_inducing : int
        Inducing inputs of each latent process: the centres of k-means.
    random_state : int, RandomState or None
    ordered : bool
        Whether the rows are in the order of a log, whose neighbours have correlated errors.
    known : KnownNoise
    data : Data or None
        As for ``fit_exact``.
    **options
        As for ``fit_exact``.

    Returns
    -------
    Fit
        The posterior, its hyperparameters and the history of the search.

    Raises
    ------
    ValueError
        When matrices of the size of all inducing variables do not fit into memory.
    """
    random_state = check_random_state(random_state)
    start = kernel.initialize(X, Y, np.random.RandomState(0))
    Z = inducing_centres(start, X, n_inducing, random_state)
    size = inducing_features(start, Z).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)
    learned = search(kernel, X, Y, random_state=random_state, known=known, **options)
    features = inducing_features(learned.kernel, Z)
    data = Data.from_table(X, Y, known.loading) if data is None else data
    return _sparse_fit(learned, features, data, X, Y, ordered, known)


def _sparse_fit(learned, features, data, X, Y, ordered, known, *, mean=None, loading=None) -> Fit:
    """Return the sparse fit with these features and, unless it is known, the noise that is best for them.

    Errors of neighbours in a log are correlated: a sample carries less information, so the
    posterior's noise is larger by the inflation (P,). With noisy regressors, part of each output's noise becomes
    noise of the regressors, whose errors are correlated, too. It propagates by the slopes of the
    function ``mean``, with the ``loading`` G at X; by default by those of the posterior.
    """
    posterior = SparsePosterior(learned.kernel, features, learned.noise, data)
    _, bounds = known.start(Y, output_scale(Y))
    inflation = np.ones(Y.shape[1])
    learns_noise = not known.is_fixed
    if learns_noise:
        posterior = _converge_noise(posterior, inflation, bounds)
    if ordered:
        residual = Y - posterior.predict(X)
        inflation = np.array([autocorrelation_time(e[np.isfinite(e)]) for e in residual.T])
    if ordered and learns_noise:
        posterior = _converge_noise(posterior, inflation, bounds)
    elif ordered:
        posterior = _inflated(posterior, inflation, X, Y, known.loading)
    noise = posterior.noise / inflation
    if learned.input_std is not None:
        if mean is None:
            mean = posterior.mean_function
            loading = posterior.gradient(X) * learned.input_std
        propagated = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
        white = np.maximum(noise - propagated, MIN_WHITE_FRACTION * noise)
        noise = np.where(known.is_learned, np.maximum(white, bounds[:, 0]), noise)
        data = data.with_slopes(mean, np.sqrt(inflation)[:, None] * learned.input_std)
        posterior = SparsePosterior(posterior.kernel, posterior.features, noise * inflation, data)
    return Fit(posterior, learned._replace(noise=noise))


def _inflated(posterior, inflation, X, Y, loading):
    """Return the posterior with its noise and the noise of samples, (n, P, r) or None, times ``inflation``."""
    noise = posterior.noise * inflation
    if loading is None:
        return posterior.with_noise(noise)
    data = Data.from_table(X, Y, loading * np.sqrt(inflation)[:, None])
    return SparsePosterior(posterior.kernel, posterior.features, noise, data)


def residual_drift(posterior: Posterior, X: Matrix, Y: Matrix, clock: Matrix) -> Matrix:
    """Return white noise and drift estimated from the residuals of a posterior.

    Parameters
    ----------
    posterior : ExactPosterior or SparsePosterior
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    clock : ndarray (n, 2)
        Time and flight number of each sample.

    Returns
    -------
    ndarray (3, P)
        The variances sigma^2 and tau^2 and the memory T of each output, see
        ``fit_drift_to_integrals``.
    """
    residual, least = Y - posterior.predict(X), NOISE_BOUNDS[0] * output_scale(Y) ** 2
    drift = np.stack([least, least, np.ones(len(least))])
    for i, e in enumerate(residual.T):
        observed = np.isfinite(e)
        if observed.sum() > 2:
            drift[:, i] = fit_drift_to_integrals(e[observed], clock[observed], least[i])
    return drift


def _converge_noise(posterior, inflation, bounds):
    """Return the posterior at the noise within ``bounds`` that maximises the likelihood bound, times ``inflation``."""
    for _ in range(NOISE_STEPS):
        noise = np.clip(posterior.noise_seen(), *bounds.T)
        change = np.abs(np.log(noise * inflation / posterior.noise)).max()
        posterior = posterior.with_noise(noise * inflation)
        if change < 0.01:
            break
    return posterior


def inducing_centres(
    kernel: MultiOutputKernel, X: Matrix, n_inducing: int, random_state: Any
) -> Matrix:
    """Return at most n_inducing centres of the samples, (k, d), or one for a kernel whose variables need no inputs."""
    if inducing_features(kernel, X[:1]).size == inducing_features(kernel, X[:2]).size:
        return X[:1]
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    subset = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    return cluster_centres(subset, column_scale(X), n_inducing, random_state)


# -- the average
# ------------------------------------------------------------------------------------------------------


def average(
    fit: Fit, X: Matrix, Y: Matrix, random_state: Any = None, known: KnownNoise = UNKNOWN
) -> Fit:
    """Return the fit of the average of the parts of a kernel, with its noise, at the hyperparameters of a fit.

    After Ctrl-C it is the fit of the whole kernel, interrupted, where ``listening`` keeps the best
    so far.

    Parameters
    ----------
    fit : Fit
        Of the whole kernel to all rows.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    random_state : RandomState or None
        Of the rows that are held out together. None: blocks of a log.
    known : KnownNoise

    Returns
    -------
    Fit
        With an AveragePosterior; the given fit if its kernel has one member.
    """
    parts = parts_of(fit.posterior.kernel)
    if len(parts) == 1:
        return fit
    try:
        std = fit.learned.input_std
        loading = known.loading if std is None else fit.posterior.gradient(X) * std
        ordered = random_state is None
        fits = [fit, *(_of_part(fit, X, Y, loading, ordered, part, known) for part in parts[1:])]
        if any(component.learned.interrupted for component in fits):
            return fit.cut_short()
        members = [component.posterior.members[0] for component in fits]
        noises = [component.learned.noise for component in fits]
        weights = held_out_weights(members, noises, X, Y, loading, random_state)
    except KeyboardInterrupt:
        if not keeps_best():
            raise
        return fit.cut_short()
    noise = np.sum(weights * noises, axis=0)
    return Fit(AveragePosterior(members, weights), fit.learned._replace(noise=noise))


def mean_of(fits: Sequence[Fit]) -> Fit:
    """Return the fit of the mean of averages, each of one search; with the likelihood of the first.

    Searches explain the log equally well but predict other flights differently, so their mean
    predicts better than each (Breiman 1996).
    """
    if len(fits) == 1:
        return fits[0]
    posteriors = [fit.posterior for fit in fits]
    learned = [fit.learned for fit in fits]
    posterior = AveragePosterior(
        [member for component in posteriors for member in component.members],
        np.concatenate([component.mixture for component in posteriors]) / len(fits),
    )
    stds = [part.input_std for part in learned if part.input_std is not None]
    common = learned[0]._replace(
        noise=np.mean([part.noise for part in learned], axis=0),
        input_std=np.sqrt(np.mean(np.square(stds), axis=0)) if stds else None,
        converged=all(part.converged for part in learned),
    )
    return Fit(posterior, common)


def _of_part(whole, X, Y, loading, ordered, part, known) -> Fit:
    """Return the fit of some terms of the kernel of a fit, at its hyperparameters but for the white noise.

    Noise of the regressors propagates by ``loading`` of the whole.
    """
    learned = whole.learned._replace(kernel=of_terms(whole.posterior.kernel, part))
    if isinstance(whole.posterior, SparsePosterior):
        features = of_terms(whole.posterior.features, part)
        data = whole.posterior.data._replace(sample_noise=None)
        if known.loading is not None:
            data = Data.from_table(X, Y, known.loading)
        mean = whole.posterior.mean_function
        return _sparse_fit(
            learned, features, data, X, Y, ordered, known, mean=mean, loading=loading
        )
    return as_exact(learned, X, Y, whole.posterior.data, known)


# -- the drift that residuals show
# ------------------------------------------------------------------------------------

LONGEST_HORIZON = 10.0  # longest time over which residuals are integrated [s]
N_HORIZONS = 12
MODEL_ERROR = 0.3  # relative, of the variances of integrals
LONGEST_GAP = 4.0  # a longer interval, over the median one, ends a record
LARGEST_LAG = 10.0  # errors of samples that are farther apart in time have independent noise [s]
CANDIDATES = 40  # nearest samples that are looked at
NEIGHBOURS = 8  # largest number of neighbours far in time
MISFIT_ROWS = 15000  # largest number of samples
PARTS = 16  # parts of the log whose means show the standard error of the whole


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
