"""Fits: the search for hyperparameters, in stages, and the posterior at the best ones.

``_learn_hyperparameters`` is the search of both kinds of inference. It learns from the rows that ``_rows`` chooses.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import check_memory, cluster_centres, column_scale, output_scale
from skdgp._compute.parallel import sharing
from skdgp._compute.threads import threads_for
from skdgp._compute.typing import Matrix, Seed
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data
from skdgp.inference._noise import autocorrelation_time, fit_drift, fit_drift_to_integrals
from skdgp.inference._objective import Objective, theta_bounds
from skdgp.inference._optimize import maximize
from skdgp.inference._rows import HELD_OUT_ROWS, held_out_rows, some_rows, stratified
from skdgp.inference._singles import fit_singles
from skdgp.inference._sparse import SparsePosterior, maximize_features
from skdgp.inference._sums import shares_of

FEATURE_ITERATIONS = 4  # iterations that move and scale the inducing variables on the bound
NOISE_STEPS = 10  # largest number of steps, or of iterations, that change the noise alone
NOISE_BOUNDS = (1e-6, 1e2)  # noise variance over the variance of the output
INPUT_BOUNDS = (1e-7, 0.3)  # noise variance over the variance of the regressor
MIN_WHITE_FRACTION = 0.01  # smallest part of an output's noise that is white measurement noise
IRRELEVANT_RISE = 0.05  # expected rise of the likelihood for each value [nats] up to which a search has converged
MEMORY_STEPS = 4  # starting memory of a drift, in sample intervals


class Fit(NamedTuple):
    """A posterior with its hyperparameters and the history of the search.

    ``noise`` (P,) is the variance of one measurement, drift included. A sparse posterior uses a larger noise where the
    errors of neighbouring samples are correlated. ``root`` (d, r) is R of the regressors' noise covariance R R^T, None
    for exact regressors. ``drift`` holds the variances and memories (P,) of the drift, or None. ``value`` is the log
    likelihood, or its bound, plus the log prior of the kernel: it compares fits of the same data.
    """

    posterior: ExactPosterior | SparsePosterior
    noise: np.ndarray
    root: np.ndarray | None
    drift: tuple[np.ndarray, np.ndarray] | None
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool = False
    remaining: float = 0.0
    converged: bool = True

    def found(self, interrupted: bool) -> Hyperparameters:
        """Return the hyperparameters of an exact fit, for use with other samples."""
        history = self.n_iter, self.n_evaluations, interrupted, self.remaining, self.converged
        white_noise = self.noise if self.drift is None else self.noise - self.drift[0]
        return Hyperparameters(self.posterior.kernel, white_noise, self.root, self.drift, *history)


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search; ``noise`` excludes ``drift``."""

    kernel: object
    noise: np.ndarray
    root: np.ndarray | None = None
    drift: tuple[np.ndarray, np.ndarray] | None = None
    n_iter: int = 0
    n_evaluations: int = 0
    interrupted: bool = False
    remaining: float = 0.0
    converged: bool = True

    def fit(self, posterior: Any, value: Any = None, more: Any = None) -> Fit:
        """Return the posterior with the history of the search; ``more`` is a later Optimum, or None."""
        value = posterior.log_marginal_likelihood if value is None else value
        n_evaluations = self.n_evaluations + (more.n_evaluations if more else 0)
        interrupted = self.interrupted or bool(more and more.interrupted)
        value += posterior.kernel.log_prior()
        history = self.n_iter, n_evaluations, interrupted, self.remaining, self.converged
        noise = self.noise if self.drift is None else self.noise + self.drift[0]
        return Fit(posterior, noise, self.root, self.drift, value, *history)

    def data(self, X: Matrix, Y: Matrix, clock: Matrix | None, passes: int = 2) -> Data:
        """Return the observed values with their noise model: noisy regressors and drift.

        The first pass takes slopes of a fit to exact regressors, the second of one to noisy regressors.
        """
        drift = self.drift or (None, None)
        data = Data.from_table(X, Y, None, clock, drift)
        if self.root is None:
            return data
        for _ in range(passes):
            loading = input_noise_loading(ExactPosterior(self.kernel, self.noise, data), X, self.root)
            data = Data.from_table(X, Y, loading, clock, drift)
        return data


def fit_exact(
    kernel: Any,
    X: Matrix,
    Y: Matrix,
    *,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: Any = None,
    spread: float = 0.0,
    found: Any = None,
    clock: Matrix | None = None,
    early_stopping: bool = False,
) -> Fit:
    """Return the exact posterior at the best hyperparameters from one starting point.

    Parameters
    ----------
    kernel : MultiOutputKernel
        Missing values are estimated from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    optimizer : "fmin_l_bfgs_b", callable or None
        None keeps the starting values.
    max_iter : int
        Iterations on the joint likelihood.
    random_state : int, RandomState or None
    input_noise : ndarray (d, r), "learned" or None
        R of the covariance R R^T of the regressors' noise. "learned": one variance for each regressor is learned.
    spread : float
        Standard deviation of the random perturbation of the starting theta, for restarts.
    found : Hyperparameters or None
        Hyperparameters to use without a search.
    clock : ndarray (n, 2) or None
        Time and flight number of each sample. None: white noise. Otherwise the noise has a drift, see ``Drift``.
    early_stopping : bool
        Whether hyperparameters are learned only until the error of held-out blocks no longer falls.

    Returns
    -------
    Fit
        The posterior, its hyperparameters and the history of the search.
    """
    learned = found
    if learned is None:
        random_state = check_random_state(random_state)
        rows, held = held_out_rows(Y, random_state) if early_stopping else (slice(None), None)
        options = optimizer, max_iter, random_state, input_noise, spread, held
        learned = _learn_hyperparameters(kernel.prepared(X), X, Y, clock, rows, *options, exact=True)
    return learned.fit(ExactPosterior(learned.kernel, learned.noise, learned.data(X, Y, clock)))


def fit_sparse(
    kernel: Any,
    X: Matrix,
    Y: Matrix,
    *,
    n_inducing: int,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: Any = None,
    spread: float = 0.0,
    found: Any = None,
    clock: Matrix | None = None,
    early_stopping: bool = False,
    centres: Matrix | None = None,
) -> Fit:
    """Return the sparse posterior of all samples, with hyperparameters learned from a subset.

    Parameters
    ----------
    kernel, X, Y
        As for ``fit_exact``.
    n_inducing : int
        Inducing inputs of each latent process. They start at the centres of k-means and are then optimised.
    optimizer, max_iter, random_state, input_noise, spread, found, clock, early_stopping
        As for ``fit_exact``. With ``early_stopping`` the inducing inputs stay where they start.
    centres : ndarray (k, d) or None
        Where the inducing inputs start. None: ``inducing_centres`` of X.

    Returns
    -------
    Fit
        The posterior, its hyperparameters and the history of the search.

    Raises
    ------
    ValueError
        When matrices of the size of all inducing variables do not fit into memory.
    """
    random_state, kernel = check_random_state(random_state), kernel.prepared(X)
    start = kernel.initialize(X, Y, np.random.RandomState(0))
    Z = inducing_centres(start, X, n_inducing, random_state) if centres is None else centres
    size = start.features(Z).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)
    learned = found
    if learned is None:
        rows, held = held_out_rows(Y, random_state) if early_stopping else (some_rows(Y, random_state), None)
        options = optimizer, max_iter, random_state, input_noise, spread, held
        learned = _learn_hyperparameters(kernel, X, Y, clock, rows, *options)
    kernel, features = learned.kernel, learned.kernel.features(Z)
    shares = shares_of(Data.from_table(X, Y))
    with sharing(shares):
        total = learned.noise if learned.drift is None else learned.noise + learned.drift[0]
        posterior = SparsePosterior(kernel, features, total, shares)
        if optimizer is None:
            return _final_fit(learned, posterior, X, Y, clock, 1.0)
        least = NOISE_BOUNDS[0] * output_scale(Y) ** 2
        posterior = _converge_noise(posterior, 1.0, least)
        value = posterior.log_marginal_likelihood
        residual = Y - posterior.predict(X)
        inflation = np.array([autocorrelation_time(e[np.isfinite(e)]) for e in residual.T])
        # Errors of neighbours are correlated: a sample carries less information, so its noise variance is inflated.
        posterior = _converge_noise(posterior, inflation, least)
        noise = posterior.noise
        hyperparameters = learned._replace(noise=noise / inflation)
        if clock is not None:
            white, variance, memory = residual_drift(posterior, X, Y, clock, fit_drift)
            scale = hyperparameters.noise / (white + variance)  # the residuals neglect the uncertainty of the function
            hyperparameters = hyperparameters._replace(noise=white * scale, drift=(variance * scale, memory))
    if hyperparameters.interrupted or early_stopping:
        return _final_fit(hyperparameters, posterior, X, Y, clock, inflation, value)
    features, best = _learn_features(features, kernel, noise, X, Y, int(inflation.min()))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, noise, shares)
    return _final_fit(hyperparameters, posterior, X, Y, clock, inflation, value, best)


def _final_fit(hyperparameters, posterior, X, Y, clock, inflation, value=None, more=None) -> Fit:
    """Return the fit; with noisy regressors, part of each output's noise becomes noise of the regressors.

    ``inflation`` (P,) multiplies variances of noise that has no drift. Errors of the regressors are correlated in time,
    too, but have no drift of their own: their part is always inflated.
    """
    if hyperparameters.root is None and hyperparameters.drift is None:
        return hyperparameters.fit(posterior, value, more)
    noise, drift, loading = hyperparameters.noise, hyperparameters.drift, None
    if hyperparameters.root is not None:
        loading = input_noise_loading(posterior, X, hyperparameters.root)
        propagated = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
        loading = loading * np.sqrt(inflation * np.ones(len(noise)))[:, None]
        noise = np.maximum(noise - propagated, MIN_WHITE_FRACTION * noise)
        if drift is not None:
            rest = propagated - (hyperparameters.noise - noise)
            drift = np.maximum(drift[0] - rest, MIN_WHITE_FRACTION * drift[0]), drift[1]
    shares = shares_of(Data.from_table(X, Y, loading, None if drift is None else clock, drift or (None, None)))
    with sharing(shares):
        effective_noise = noise * inflation if drift is None else noise
        posterior = SparsePosterior(posterior.kernel, posterior.features, effective_noise, shares)
    return hyperparameters._replace(noise=noise, drift=drift).fit(posterior, value, more)


def residual_drift(
    posterior: Any, X: Matrix, Y: Matrix, clock: Matrix, fit: Callable = fit_drift_to_integrals
) -> Matrix:
    """Return white noise and drift estimated from the residuals of a posterior.

    Parameters
    ----------
    posterior : ExactPosterior or SparsePosterior
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    clock : ndarray (n, 2)
        Time and flight number of each sample.
    fit : callable
        Estimates sigma^2, tau^2 and T of one output from its residuals, the clock and the smallest variance.

    Returns
    -------
    ndarray (3, P)
        The variances sigma^2 and tau^2 and the memory T of each output, see ``Drift``.
    """
    residual, least = Y - posterior.predict(X), NOISE_BOUNDS[0] * output_scale(Y) ** 2
    found = np.stack([least, least, np.ones(len(least))])
    for i, e in enumerate(residual.T):
        observed = np.isfinite(e)
        if observed.sum() > 2:
            found[:, i] = fit(e[observed], clock[observed], least[i])
    return found


def _learn_features(features, kernel, noise, X, Y, step):
    """Return the best features and their Optimum, from every ``step``-th sample: neighbours are redundant."""
    if len(features.theta) == 0:
        return features, None
    shares = shares_of(Data.from_table(X[::step], Y[::step]))
    with sharing(shares):
        start = SparsePosterior(kernel, features, noise / step, shares)
        return maximize_features(start, column_scale(X), max_iter=FEATURE_ITERATIONS, stage="bound")


def _converge_noise(posterior, inflation, least):
    """Return the posterior at the noise that maximises the bound, times ``inflation``."""
    for _ in range(NOISE_STEPS):
        noise = np.maximum(posterior.noise_seen(), least)
        change = np.abs(np.log(noise * inflation / posterior.noise)).max()
        posterior = posterior.with_noise(noise * inflation)
        if change < 0.01:
            break
    return posterior


def _initial_noise(residual, scale, clock):
    """Return the starting noise and its bounds: variances (P,), with a drift also its variances and memories."""
    bounds = np.multiply.outer(scale**2, NOISE_BOUNDS)
    noise = np.clip(0.2 * np.nanvar(residual, axis=0), *bounds.T)
    if clock is None:
        return noise, bounds
    time, flight = clock.T
    steps = np.abs(np.diff(time))[np.diff(flight) == 0]
    step = float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 1.0
    longest = max(float(np.ptp(time[flight == number])) for number in np.unique(flight))
    memory = np.full(len(noise), MEMORY_STEPS * step)
    span = np.tile([step, max(longest, 2 * MEMORY_STEPS * step)], (len(noise), 1))
    return np.concatenate([0.5 * noise, 0.5 * noise, memory]), np.concatenate([bounds, bounds, span])


def _learn_hyperparameters(
    kernel, X, Y, clock, rows, optimizer, max_iter, random_state, input_noise, spread, held=None, exact=False
) -> Hyperparameters:
    """Return hyperparameters, learned from each output separately and then from ``rows`` of all outputs jointly.

    The joint search stops when the error at the rows ``held`` no longer falls. This error says nothing about the noise,
    and without ``exact`` the search neglects what errors of regressors have in common between outputs, so noise is
    learned again at the end.
    """
    P, held_out = Y.shape[1], None
    if held is not None:
        some = stratified(held, HELD_OUT_ROWS, random_state)
        held_out, Y = Data.from_table(X[some], Y[some]), np.array(Y)
        Y[held] = np.nan
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise, noise_bounds = _initial_noise(kernel.residual(X, Y), output_scale(Y), clock)
    stop = Event()
    singles, n_evaluations, n_iter = None, 0, 0
    if optimizer is not None and P > 1 and not open_kernel.has_values():
        singles, noise, n_evaluations = fit_singles(
            open_kernel, noise, noise_bounds, X, Y, clock, optimizer, max_iter, random_state, stop
        )
    scale, X, Y, clock = column_scale(X), X[rows], Y[rows], None if clock is None else clock[rows]
    data = Data.from_table(X, Y, None, clock)
    n_values = data.n_values

    def hyperparameters(kernel, noise, root):
        drift = None if clock is None else (noise[P : 2 * P], noise[2 * P : 3 * P])
        return Hyperparameters(kernel, noise[:P], root, drift)

    if optimizer is None:
        return hyperparameters(kernel, noise, None if isinstance(input_noise, str) else input_noise)

    def with_slopes(kernel, noise, root, rows=slice(None)):
        data = hyperparameters(kernel, noise, root).data(X[rows], Y[rows], None if clock is None else clock[rows], 1)
        # The drift is learned with the other hyperparameters, so the data must not fix it.
        return data._replace(drift=data.drift and data.drift._replace(variance=None, memory=None))

    def optimize(name, kernel, noise, bounds, max_iter, data, spread=0.0, noise_alone=False):
        theta = np.concatenate([kernel.theta, np.log(noise)])
        theta += spread * random_state.normal(size=theta.shape)
        objective = Objective(kernel, data, len(noise), held_out, common=exact or noise_alone)
        bounds = theta_bounds(kernel, bounds)
        if noise_alone:
            bounds[: kernel.n_dims] = kernel.theta[:, None]
        with threads_for(data.n_values):
            best = maximize(
                objective,
                theta,
                bounds,
                optimizer=optimizer,
                max_iter=max_iter,
                name=name,
                stop=stop,
                held_out_error=None if held_out is None or noise_alone else objective.held_out_error,
            )
        theta, noise = np.split(best.theta, [-len(noise)])
        return kernel.clone_with_theta(theta), np.exp(noise), best

    # First few hyperparameters (widths shared by all outputs), then all of them. This start needs few iterations and
    # ends at optima that predict better than those reached from arbitrary widths. With noisy regressors, the slopes of
    # the coarse model propagate their noise to the outputs.
    kernel = open_kernel.initialize(X, Y, random_state, singles)
    coarse = open_kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < kernel.n_dims or input_noise is not None:
        coarse, noise, best = optimize("coarse", coarse, noise, noise_bounds, -(-max_iter // 2), data, spread)
        n_evaluations, n_iter, spread = n_evaluations + best.n_evaluations, best.n_iter, 0.0
        kernel = open_kernel.initialize(X, Y, random_state, singles, coarse)
    root, bounds = input_noise, noise_bounds
    if input_noise is not None:
        root = np.diag(scale) if isinstance(input_noise, str) else input_noise
        data = with_slopes(coarse, noise, root)
    if isinstance(input_noise, str):
        noise, input_bounds = _initial_input_noise(noise, P, data, len(scale))
        bounds = np.concatenate([noise_bounds, input_bounds])
    kernel, noise, best = optimize("fit", kernel, noise, bounds, max_iter - n_iter, data, spread)
    search_left_noise = held_out is not None if exact else isinstance(input_noise, str)
    if search_left_noise and not (callable(optimizer) or stop.is_set()):
        if not exact:  # the white noise will be that of all samples
            data = with_slopes(kernel, noise, root, slice(None, None, 2))
        _, noise, last = optimize("noise", kernel, noise, bounds, NOISE_STEPS, data, noise_alone=True)
        n_evaluations += last.n_evaluations
    if isinstance(input_noise, str):
        root = root * np.sqrt(noise[len(noise_bounds) :])
    return hyperparameters(kernel, noise, root)._replace(
        n_iter=n_iter + best.n_iter,
        n_evaluations=n_evaluations + best.n_evaluations,
        interrupted=stop.is_set(),
        remaining=best.remaining,
        converged=bool(best.converged or best.remaining <= IRRELEVANT_RISE * n_values),
    )


def input_noise_loading(posterior: Any, X: Matrix, root: Matrix) -> np.ndarray:
    """Return G = J R, (n, P, r): the slopes J of the mean times the root R of the regressors' noise covariance."""
    return posterior.gradient(X) @ root


def _initial_input_noise(noise, P, data, d):
    """Return the noise vector with starting factors s (d,) of the regressors' noise variances, and bounds of s.

    At the start, half of each output's noise comes from the regressors, with equal factors s.
    """
    propagated = [np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.sample_noise.loading]
    part = 0.5 * float(np.nanmedian(noise[:P] / np.maximum(propagated, 1e-12)))
    least, most = INPUT_BOUNDS
    start = np.full(d, np.clip(part, 10 * least, most / 10))
    return np.concatenate([0.5 * noise[:P], noise[P:], start]), np.tile(INPUT_BOUNDS, (d, 1))


def inducing_centres(kernel: Any, X: Matrix, n_inducing: int, random_state: Any) -> Matrix:
    """Return at most n_inducing centres of the samples, (k, d), or one for a kernel whose variables need no inputs."""
    if kernel.features(X[:1]).size == kernel.features(X[:2]).size:
        return X[:1]
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    subset = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    return cluster_centres(subset, column_scale(X), n_inducing, random_state)
