"""Fits: exact and sparse posteriors at the best hyperparameters, and the average of posteriors of parts of a kernel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import norm, t

from skdgp._compute.linalg import check_memory, cluster_centres, column_scale
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._average import Posterior, held_out_weights, of_terms, parts_of
from skdgp.inference._blocks import blocks_of_rows
from skdgp.inference._likelihood import Data, sample_table
from skdgp.inference._noise import UNKNOWN, KnownNoise
from skdgp.inference._posterior import ExactPosterior, SinglePosterior
from skdgp.inference._search import Hyperparameters, with_best_noise
from skdgp.inference._sparse import SparsePosterior
from skdgp.kernels import Features, MultiOutputKernel, PathBundle, inducing_features

SAMPLES_OF_CENTRE = 50
"""Samples for each inducing input, from which k-means finds the centres."""
ROWS_SEEN = 1000
"""Samples whose variances and slopes show the noise, to save time."""


class Fit(NamedTuple):
    """A posterior and its hyperparameters.

    A posterior uses a larger noise than ``learned`` where the errors of neighbouring samples are
    correlated.
    """

    posterior: Posterior
    learned: Hyperparameters


def fit_exact(
    learned: Hyperparameters, data: Data, ordered: bool = False, known: KnownNoise = UNKNOWN
) -> Fit:
    """Return the exact posterior of observed values at hyperparameters that a search has found.

    Parameters
    ----------
    learned : Hyperparameters
    data : Data
        With exact regressors, and known noise; noise of the regressors that was learned is added.
    ordered : bool
        Whether the rows are a time series, whose neighbours have correlated errors: noise is larger then.
    known : KnownNoise

    Returns
    -------
    Fit
    """
    return _fit(learned, data, ordered, partial(_posterior, None), known)


def fit_sparse(
    learned: Hyperparameters,
    data: Data,
    *,
    n_inducing: int,
    ordered: bool = False,
    known: KnownNoise = UNKNOWN,
) -> Fit:
    """Return the sparse posterior of observed values at hyperparameters that a search has found.

    Parameters
    ----------
    learned : Hyperparameters
    data : Data
        With exact regressors, and known noise, as of `fit_exact`.
    n_inducing : int
        Inducing inputs of each latent process: the centres of k-means.
    ordered : bool
        Whether the rows are a time series, whose neighbours have correlated errors.
    known : KnownNoise

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        When matrices of the size of all inducing variables do not fit into memory.
    """
    _, X = sample_table(data.X, data.sample)
    check_inducing(learned.kernel, X, n_inducing)
    centres = inducing_centres(X, n_inducing)
    features = inducing_features(learned.kernel, centres)
    return _fit(learned, data, ordered, partial(_posterior, features), known)


def _posterior(
    features: Features | None, kernel: MultiOutputKernel, noise: Vector, data: Data
) -> SinglePosterior:
    """Return the posterior, exact without features.

    The few weights of a trend are all that there is to know of it, so it has the sparse form, which
    is then exact, and small.
    """
    if features is None and kernel.n_processes:
        return ExactPosterior(kernel, noise, data)
    if features is None:
        features = inducing_features(kernel, data.X[0][:1])
    return SparsePosterior(kernel, features, noise, data)


def _fit(
    learned: Hyperparameters,
    data: Data,
    ordered: bool,
    posterior_of: Callable[[MultiOutputKernel, Vector, Data], SinglePosterior],
    known: KnownNoise,
    function: PathBundle | None = None,
) -> Fit:
    """Return the fit, whose noise follows from posteriors before it.

    Regressors propagate their noise by the slopes of the posterior before, or of the ``function``
    where it is known. Of a time series the noise is at least what the residuals show, and where they
    are correlated a value carries less information: its noise is multiplied by their correlation time.
    """
    noise, std = learned.noise, learned.input_std
    inflation = np.ones(len(noise))
    noisy = data
    passes = int(ordered)
    if std is not None and function is not None:
        noisy = data.with_slopes(function, std)
    elif std is not None:
        passes = 2  # slopes of exact regressors, then of noisy ones
    posterior = posterior_of(learned.kernel, noise, noisy)
    for _ in range(passes):
        slopes_of = posterior.mean_function if function is None else function
        if ordered:
            residuals = _residuals(posterior, data)
            inflation = np.array([autocorrelation_time(e) for e in residuals])
            seen = _noise_seen(posterior, residuals, data, slopes_of, std)
            noise = known.within(np.maximum(learned.noise, seen))
        noisy = data.inflated(inflation)
        if std is not None:
            noisy = data.with_slopes(slopes_of, np.sqrt(inflation)[:, None] * std)
        posterior = posterior_of(learned.kernel, noise * inflation, noisy)
    return Fit(Posterior.of_one(posterior), learned._replace(noise=noise))


def _residuals(posterior: SinglePosterior, data: Data) -> list[Vector]:
    """Return the residuals of the values of each output."""
    samples, X = sample_table(data.X, data.sample)
    mean = posterior.predict(X)
    residuals = []
    for i, (rows, y) in enumerate(zip(data.sample, data.y, strict=True)):
        residuals.append(y - mean[samples.searchsorted(rows), i])
    return residuals


def _noise_seen(
    posterior: SinglePosterior,
    residuals: Sequence[Vector],
    data: Data,
    function: PathBundle,
    std: Vector | None,
) -> Vector:
    """Return the expected squared residual (P,) under the posterior, less the variance that regressors propagate.

    It is the noise of expectation maximisation. Noise of the regressors of standard deviations ``std``
    (d,) propagates by the slopes of the function.
    """
    seen = []
    for i, (X, e) in enumerate(zip(data.X, residuals, strict=True)):
        some = X[:: -(-len(X) // ROWS_SEEN)]
        _, variance = posterior.predict(some, return_variance=True)
        squares = np.mean(e**2) + np.mean(variance[:, i])
        if std is not None:
            slopes = function.slopes(some[None])[0, :, i]
            squares -= np.mean(np.sum((slopes * std) ** 2, axis=1))
        seen.append(squares)
    return np.array(seen)


def check_inducing(kernel: MultiOutputKernel, X: Matrix, n_inducing: int) -> None:
    """Raise ValueError if matrices of the size of all inducing variables of a kernel with values do not fit."""
    size = inducing_features(kernel, X[:n_inducing]).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)


def inducing_centres(X: Matrix, n_inducing: int) -> Matrix:
    """Return at most n_inducing centres of the samples, (k, d): they alone decide where k-means puts them."""
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    step = -(-len(X) // (SAMPLES_OF_CENTRE * n_inducing))
    return cluster_centres(X[::step], column_scale(X), n_inducing)


# -- the average
# ------------------------------------------------------------------------------------------------------


def average(
    fit: Fit, X: Matrix, Y: Matrix, ordered: bool = False, known: KnownNoise = UNKNOWN
) -> Fit:
    """Return the average of the parts of a kernel, with its noise, at the hyperparameters of a fit.

    Parameters
    ----------
    fit : Fit
        Of the whole kernel to all rows.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    ordered : bool
        Whether the rows are a time series.
    known : KnownNoise

    Returns
    -------
    Fit
        The given fit if its kernel has one member.
    """
    parts = parts_of(fit.posterior.kernel)
    if len(parts) == 1:
        return fit
    std = fit.learned.input_std
    added = known.added
    if std is not None:
        added = np.sum((fit.posterior.gradient(X) * std) ** 2, axis=2)
    fits = [fit]
    for part in parts[1:]:
        fits.append(_of_part(fit, X, Y, ordered, part, known, added))
    members = [component.posterior.members[0] for component in fits]
    noises = [component.learned.noise for component in fits]
    weights = held_out_weights(members, noises, X, Y, added, ordered)
    noise = np.sum(weights * noises, axis=0)
    return Fit(Posterior(members, weights), fit.learned._replace(noise=noise))


def widened(fit: Fit) -> Fit:
    r"""Return an exact fit whose bands hold of few values, too: variances are larger, the mean is the same.

    The variances of n values of an output and of their p hyperparameters, which maximise the likelihood,
    are too small. With their excess they are unbiased, as the variance of residuals of p weights, and
    the standard deviation is that of a normal distribution with the 95 % band of Student's t
    distribution with n - 1 degrees of freedom: of a process whose amplitude is integrated out.
    """
    n_values = np.array([len(y) for y in fit.posterior.data.y])
    root = t.ppf(0.975, n_values - 1) / norm.ppf(0.975) * np.sqrt(fit.learned.excess)
    members = []
    for member in fit.posterior.members:
        kernel = member.kernel.rescaled(root)
        data = member.data.inflated(root**2)
        members.append(_posterior(None, kernel, root**2 * member.noise, data))
    added = fit.learned.added
    learned = fit.learned._replace(
        noise=root**2 * fit.learned.noise, added=None if added is None else root**2 * added
    )
    return Fit(Posterior(members, fit.posterior.mixture), learned)


def mixture_of(fits: Sequence[Fit], weights: Sequence[float]) -> Fit:
    """Return the fit of the mixture of posteriors with weights that add up to one.

    Likelihood and noise of the regressors are those of the first. Structures may explain the data
    equally well but predict other data differently, so their mean predicts better than each (Breiman 1996).
    """
    if len(fits) == 1:
        return fits[0]
    members: list[SinglePosterior] = []
    mixture = []
    for fit, weight in zip(fits, weights, strict=True):
        members += fit.posterior.members
        mixture.append(weight * fit.posterior.mixture)
    learned = [fit.learned for fit in fits]
    common = learned[0]._replace(
        noise=np.average([part.noise for part in learned], axis=0, weights=weights),
        n_iter=max(part.n_iter for part in learned),
        converged=all(part.converged for part in learned),
    )
    return Fit(Posterior(members, np.concatenate(mixture)), common)


def _of_part(whole, X, Y, ordered, part, known, added) -> Fit:
    """Return the fit of some terms of the kernel of a fit, at its hyperparameters but for the white noise.

    Noise of the regressors propagates by the slopes of the whole, with the variances ``added`` at X.
    """
    learned = whole.learned._replace(kernel=of_terms(whole.posterior.kernel, part), input_std=None)
    rows = blocks_of_rows(X, Y, time_series=ordered)
    learned = with_best_noise(learned, X, Y, rows, known._replace(added=added))
    features = getattr(whole.posterior.members[0], "features", None)
    of_part = None if features is None else of_terms(features, part)
    data = Data.from_table(X, Y, known.added)
    learned = learned._replace(input_std=whole.learned.input_std)
    function = whole.posterior.mean_function
    return _fit(learned, data, ordered, partial(_posterior, of_part), known, function)
