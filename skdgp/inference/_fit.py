"""Fits: exact and sparse posteriors at the best hyperparameters."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.correlation import autocorrelation_time
from skdgp._compute.linalg import check_memory, cluster_centres, column_scale, output_scale
from skdgp._compute.parallel import sharing
from skdgp._compute.typing import Matrix, Seed
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data
from skdgp.inference._noise import fit_drift_to_integrals
from skdgp.inference._rows import held_out_rows, some_rows
from skdgp.inference._search import NOISE_BOUNDS, NOISE_STEPS, Hyperparameters, input_noise_loading, search
from skdgp.inference._sparse import SparsePosterior, maximize_features
from skdgp.inference._sums import shares_of

FEATURE_ITERATIONS = 4  # iterations that move and scale the inducing variables on the bound
MIN_WHITE_FRACTION = 0.01  # smallest part of an output's noise that is white measurement noise


class Fit(NamedTuple):
    """A posterior, the hyperparameters it has, and how well it explains its data.

    ``value`` is the log likelihood, or its bound, plus the log prior of the kernel: it compares fits of the same data.
    A sparse posterior uses a larger noise than ``learned`` where the errors of neighbouring samples are correlated.
    """

    posterior: ExactPosterior | SparsePosterior
    learned: Hyperparameters
    value: float

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the search."""
        return self.learned.interrupted

    def marked(self, interrupted: bool) -> Fit:
        """Return the same fit, interrupted or not."""
        return self._replace(learned=self.learned._replace(interrupted=interrupted))


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
        options = {"optimizer": optimizer, "max_iter": max_iter, "input_noise": input_noise, "spread": spread}
        options |= {"random_state": random_state, "held": held}
        learned = search(kernel.prepared(X), X, Y, rows, **options, exact=True)
    return _fit(ExactPosterior(learned.kernel, learned.noise, learned.data(X, Y)), learned)


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
    optimizer, max_iter, random_state, input_noise, spread, found, early_stopping
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
        options = {"optimizer": optimizer, "max_iter": max_iter, "input_noise": input_noise, "spread": spread}
        options |= {"random_state": random_state, "held": held}
        learned = search(kernel, X, Y, rows, **options)
    kernel, features = learned.kernel, learned.kernel.features(Z)
    shares = shares_of(Data.from_table(X, Y))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, learned.noise, shares)
        if optimizer is None:
            return _final_fit(learned, posterior, X, Y, 1.0)
        least = NOISE_BOUNDS[0] * output_scale(Y) ** 2
        posterior = _converge_noise(posterior, 1.0, least)
        value = posterior.log_marginal_likelihood
        residual = Y - posterior.predict(X)
        inflation = np.array([autocorrelation_time(e[np.isfinite(e)]) for e in residual.T])
        # Errors of neighbours are correlated: a sample carries less information, so its noise variance is inflated.
        posterior = _converge_noise(posterior, inflation, least)
        noise = posterior.noise
        hyperparameters = learned._replace(noise=noise / inflation)
    if hyperparameters.interrupted or early_stopping:
        return _final_fit(hyperparameters, posterior, X, Y, inflation, value)
    features, best = _learn_features(features, kernel, noise, X, Y, int(inflation.min()))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, noise, shares)
    return _final_fit(hyperparameters, posterior, X, Y, inflation, value, best)


def _fit(posterior, learned, value=None, more=None) -> Fit:
    """Return the fit; ``more`` is an Optimum of a later search, or None."""
    if more is not None:
        learned = learned._replace(
            n_evaluations=learned.n_evaluations + more.n_evaluations,
            interrupted=learned.interrupted or more.interrupted,
        )
    value = posterior.log_marginal_likelihood if value is None else value
    return Fit(posterior, learned, value + posterior.kernel.log_prior())


def _final_fit(hyperparameters, posterior, X, Y, inflation, value=None, more=None) -> Fit:
    """Return the fit; with noisy regressors, part of each output's noise becomes noise of the regressors.

    ``inflation`` (P,) multiplies the variances of both parts: errors of the regressors are correlated in time, too.
    """
    if hyperparameters.root is None:
        return _fit(posterior, hyperparameters, value, more)
    loading = input_noise_loading(posterior, X, hyperparameters.root)
    propagated = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
    noise = hyperparameters.noise
    loading = loading * np.sqrt(inflation * np.ones(len(noise)))[:, None]
    noise = np.maximum(noise - propagated, MIN_WHITE_FRACTION * noise)
    shares = shares_of(Data.from_table(X, Y, loading))
    with sharing(shares):
        posterior = SparsePosterior(posterior.kernel, posterior.features, noise * inflation, shares)
    return _fit(posterior, hyperparameters._replace(noise=noise), value, more)


def residual_drift(posterior: Any, X: Matrix, Y: Matrix, clock: Matrix) -> Matrix:
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
        The variances sigma^2 and tau^2 and the memory T of each output, see ``fit_drift_to_integrals``.
    """
    residual, least = Y - posterior.predict(X), NOISE_BOUNDS[0] * output_scale(Y) ** 2
    found = np.stack([least, least, np.ones(len(least))])
    for i, e in enumerate(residual.T):
        observed = np.isfinite(e)
        if observed.sum() > 2:
            found[:, i] = fit_drift_to_integrals(e[observed], clock[observed], least[i])
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


def inducing_centres(kernel: Any, X: Matrix, n_inducing: int, random_state: Any) -> Matrix:
    """Return at most n_inducing centres of the samples, (k, d), or one for a kernel whose variables need no inputs."""
    if kernel.features(X[:1]).size == kernel.features(X[:2]).size:
        return X[:1]
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    subset = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    return cluster_centres(subset, column_scale(X), n_inducing, random_state)
