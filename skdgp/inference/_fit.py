"""Fits: exact and sparse posteriors at the best hyperparameters, and the average of posteriors of parts of a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    check_memory,
    cluster_centres,
    column_scale,
    output_scale,
)
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Seed
from skdgp.inference._average import AveragePosterior, held_out_weights, of_terms, parts_of
from skdgp.inference._likelihood import Data
from skdgp.inference._noise import fit_drift_to_integrals
from skdgp.inference._posterior import ExactPosterior, Posterior, SinglePosterior
from skdgp.inference._search import (
    NOISE_BOUNDS,
    NOISE_STEPS,
    Hyperparameters,
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
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: bool = False,
) -> Fit:
    """Return the exact posterior at the best hyperparameters from one starting point.

    Parameters
    ----------
    kernel : MultiOutputKernel
        Missing values are estimated from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    optimizer : "fmin_l_bfgs_b" or None
        None keeps the starting values.
    max_iter : int
        Iterations on the joint likelihood.
    random_state : int, RandomState or None
    input_noise : bool
        Whether a standard deviation of the noise of each regressor is learned.

    Returns
    -------
    Fit
        The posterior, its hyperparameters and the history of the search.
    """
    random_state = check_random_state(random_state)
    options = {"optimizer": optimizer, "max_iter": max_iter, "input_noise": input_noise}
    learned = search(kernel, X, Y, random_state=random_state, exact=True, **options)
    return Fit(ExactPosterior(learned.kernel, learned.noise, learned.data(X, Y)), learned)


def as_exact(fit: Fit, X: Matrix, Y: Matrix) -> Fit:
    """Return the exact posterior of these samples at the kernel of a sparse fit, with its own noise."""
    data = fit.learned.data(X, Y)
    noise = best_noise(fit.learned.kernel, X, Y, data)
    posterior = ExactPosterior(fit.learned.kernel, noise, data)
    return Fit(posterior, fit.learned._replace(noise=noise))


def fit_sparse(
    kernel: MultiOutputKernel,
    X: Matrix,
    Y: Matrix,
    *,
    n_inducing: int,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: bool = False,
    ordered: bool = False,
) -> Fit:
    """Return the sparse posterior of all samples, with hyperparameters learned from a subset.

    Parameters
    ----------
    kernel, X, Y
        As for ``fit_exact``.
    n_inducing : int
        Inducing inputs of each latent process: the centres of k-means.
    optimizer, max_iter, random_state, input_noise
        As for ``fit_exact``.
    ordered : bool
        Whether the rows are in the order of a log, whose neighbours have correlated errors.

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
    options = {"optimizer": optimizer, "max_iter": max_iter, "input_noise": input_noise}
    learned = search(kernel, X, Y, random_state=random_state, **options)
    features = inducing_features(learned.kernel, Z)
    return _sparse_fit(learned, features, X, Y, ordered, converge=optimizer is not None)


def _sparse_fit(learned, features, X, Y, ordered, *, converge=True, loading=None) -> Fit:
    """Return the sparse fit with these features and, unless ``converge`` is false, the noise that is best for them.

    Errors of neighbours in a log are correlated: a sample carries less information, so the
    posterior's noise is larger by the inflation (P,). With noisy regressors, part of each output's noise becomes
    noise of the regressors, whose errors are correlated, too. ``loading`` is G of this noise, by
    default by the slopes of the posterior.
    """
    posterior = SparsePosterior(learned.kernel, features, learned.noise, Data.from_table(X, Y))
    inflation, least = np.ones(Y.shape[1]), NOISE_BOUNDS[0] * output_scale(Y) ** 2
    posterior = _converge_noise(posterior, inflation, least) if converge else posterior
    if converge and ordered:
        inflation = np.array(
            [autocorrelation_time(e[np.isfinite(e)]) for e in (Y - posterior.predict(X)).T]
        )
        posterior = _converge_noise(posterior, inflation, least)
    noise = posterior.noise / inflation
    if learned.input_std is not None:
        loading = posterior.gradient(X) * learned.input_std if loading is None else loading
        propagated = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
        noise = np.maximum(noise - propagated, MIN_WHITE_FRACTION * noise)
        data = Data.from_table(X, Y, loading * np.sqrt(inflation)[:, None])
        posterior = SparsePosterior(posterior.kernel, posterior.features, noise * inflation, data)
    return Fit(posterior, learned._replace(noise=noise))


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


def _converge_noise(posterior, inflation, least):
    """Return the posterior at the noise that maximises the bound, times ``inflation``."""
    for _ in range(NOISE_STEPS):
        noise = np.maximum(posterior.noise_seen(), least)
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


def average(fit: Fit, X: Matrix, Y: Matrix, random_state: Any = None) -> Fit:
    """Return the fit of the average of the parts of a kernel, with its noise, at the hyperparameters of a fit.

    After Ctrl-C it is the fit of the whole kernel, interrupted.

    Parameters
    ----------
    fit : Fit
        Of the whole kernel to all rows.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    random_state : RandomState or None
        Of the rows that are held out together. None: blocks of a log.

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
        loading = None if std is None else fit.posterior.gradient(X) * std
        ordered = random_state is None
        fits = [fit, *(_of_part(fit, X, Y, loading, ordered, part) for part in parts[1:])]
        members = [component.posterior.members[0] for component in fits]
        noises = [component.learned.noise for component in fits]
        weights = held_out_weights(members, noises, X, Y, loading, random_state)
    except KeyboardInterrupt:
        return fit.cut_short()
    posterior = AveragePosterior(members, weights)
    noise = np.sum(weights * noises, axis=0)
    return Fit(posterior, fit.learned._replace(noise=noise))


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


def _of_part(whole, X, Y, loading, ordered, part) -> Fit:
    """Return the fit of some terms of the kernel of a fit, at its hyperparameters but for the white noise.

    Noise of the regressors propagates by ``loading`` of the whole.
    """
    kernel = of_terms(whole.posterior.kernel, part)
    learned = whole.learned._replace(kernel=kernel)
    if isinstance(whole.posterior, SparsePosterior):
        features = of_terms(whole.posterior.features, part)
        return _sparse_fit(learned, features, X, Y, ordered, loading=loading)
    data = whole.posterior.data
    noise = best_noise(kernel, X, Y, data)
    posterior: SinglePosterior
    if kernel.n_processes:
        posterior = ExactPosterior(kernel, noise, data)
    else:  # the few weights of a trend are all that there is to know, so this is exact, and small
        posterior = SparsePosterior(kernel, inducing_features(kernel, X[:1]), noise, data)
    return Fit(posterior, learned._replace(noise=noise))
