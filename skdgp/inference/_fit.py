"""Fits: exact and sparse posteriors at the best hyperparameters, and the average of posteriors of parts of a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import check_memory, cluster_centres, column_scale, output_scale
from skdgp._compute.messages import keeps_best
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._average import AveragePosterior, held_out_weights, of_terms, parts_of
from skdgp.inference._blocks import blocks_of_rows
from skdgp.inference._likelihood import Data
from skdgp.inference._noise import UNKNOWN, KnownNoise
from skdgp.inference._posterior import ExactPosterior, Posterior, SinglePosterior
from skdgp.inference._search import Hyperparameters, with_best_noise
from skdgp.inference._sparse import SparsePosterior
from skdgp.kernels import Features, MultiOutputKernel, PathBundle, inducing_features


@dataclass(frozen=True)
class SparseSettings:
    """How sparse posteriors find their noise and their inducing inputs."""

    #: Smallest part of an output's noise that is white measurement noise, of noisy regressors
    white_fraction: float = 0.01
    #: Most steps of expectation maximisation for the noise
    noise_steps: int = 10
    #: Relative change of the noise below which a step is the last
    tolerance: float = 0.01
    #: Samples for each inducing input, from which k-means finds the centres
    samples_of_centre: int = 50


SETTINGS = SparseSettings()


class Fit(NamedTuple):
    """An ExactPosterior, SparsePosterior or AveragePosterior, and its hyperparameters.

    A posterior uses a larger noise than ``learned`` where the errors of neighbouring samples are
    correlated.
    """

    posterior: Posterior
    learned: Hyperparameters

    def cut_short(self) -> Fit:
        """Return the same fit, interrupted."""
        return self._replace(learned=self.learned._replace(interrupted=True))


def fit_exact(learned: Hyperparameters, data: Data, ordered: bool = False) -> Fit:
    """Return the exact posterior of observed values at hyperparameters that a search has found.

    ``data`` are with exact regressors, and known noise; noise of the regressors that was learned is
    added. Both are larger in the posterior of a time series (``ordered``), whose neighbours have
    correlated errors.
    """
    data = learned.noisy(data)
    posterior = _exact_posterior(learned.kernel, learned.noise, data)
    if ordered:
        times = []
        for i, (x, y) in enumerate(zip(data.X, data.y, strict=True)):
            times.append(autocorrelation_time(y - posterior.predict(x)[:, i]))
        inflation = np.array(times)
        data = data.inflated(inflation)
        posterior = _exact_posterior(learned.kernel, learned.noise * inflation, data)
    return Fit(posterior, learned)


def _exact_posterior(kernel: MultiOutputKernel, noise: Vector, data: Data) -> SinglePosterior:
    """Return the exact posterior.

    The few weights of a trend are all that there is to know of it, so it has the sparse form, which
    is then exact, and small.
    """
    if kernel.n_processes:
        return ExactPosterior(kernel, noise, data)
    return SparsePosterior(kernel, inducing_features(kernel, data.X[0][:1]), noise, data)


def fit_sparse(
    learned: Hyperparameters,
    X: Matrix,
    Y: Matrix,
    *,
    n_inducing: int,
    random_state: Seed,
    ordered: bool = False,
    known: KnownNoise = UNKNOWN,
    data: Data | None = None,
) -> Fit:
    """Return the sparse posterior of all samples at hyperparameters that a search has found.

    Parameters
    ----------
    learned : Hyperparameters
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    n_inducing : int
        Inducing inputs of each latent process: the centres of k-means.
    random_state : int, RandomState or None
    ordered : bool
        Whether the rows are a time series, whose neighbours have correlated errors.
    known : KnownNoise
    data : Data or None
        Values of X and Y with the known noise, which fits of the same table share.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        When matrices of the size of all inducing variables do not fit into memory.
    """
    check_inducing(learned.kernel, X, Y, n_inducing)
    centres = inducing_centres(learned.kernel, X, n_inducing, check_random_state(random_state))
    features = inducing_features(learned.kernel, centres)
    data = Data.from_table(X, Y, known.loading) if data is None else data
    return SparseFit(features, data, X, Y, ordered, known).at(learned)


@dataclass(frozen=True)
class SparseFit:
    """Data and features of sparse fits at given hyperparameters.

    Parameters
    ----------
    features : Features
    data : Data
        Of the table, with known noise.
    X : ndarray (n, d)
    Y : ndarray (n, P)
    ordered : bool
        Whether the rows are a time series. Errors of neighbours are then correlated: a sample
        carries less information, so the posterior's noise is larger by the inflation (P,).
    known : KnownNoise
    settings : SparseSettings
    """

    features: Features
    data: Data
    X: Matrix
    Y: Matrix
    ordered: bool
    known: KnownNoise
    settings: SparseSettings = SETTINGS

    def at(
        self,
        learned: Hyperparameters,
        mean: PathBundle | None = None,
        loading: Array | None = None,
    ) -> Fit:
        """Return the fit with the noise that is best for it, unless it is known.

        With noisy regressors, part of each output's noise becomes noise of the regressors, whose
        errors are correlated, too. It propagates by the slopes of the function ``mean``, with the
        ``loading`` G at X; by default by the posterior's slopes.
        """
        posterior = SparsePosterior(learned.kernel, self.features, learned.noise, self.data)
        inflation = np.ones(self.Y.shape[1])
        # with noise that differs between values the search has learned the white noise
        is_known = self.known.is_fixed or self.known.loading is not None
        if not is_known:
            posterior = self._with_best_noise(posterior, inflation)
        if self.ordered:
            residual = self.Y - posterior.predict(self.X)
            times = [autocorrelation_time(e[np.isfinite(e)]) for e in residual.T]
            inflation = np.array(times)
            if is_known:
                posterior = self._inflated(posterior, inflation)
            else:
                posterior = self._with_best_noise(posterior, inflation)
        noise = posterior.noise / inflation
        if learned.input_std is None:
            return Fit(posterior, learned._replace(noise=noise))

        if mean is None:
            mean = posterior.mean_function
            loading = posterior.gradient(self.X) * learned.input_std
        white = self._white(noise, loading)
        std = np.sqrt(inflation)[:, None] * learned.input_std
        data = self.data.with_slopes(mean, std)
        posterior = SparsePosterior(posterior.kernel, self.features, white * inflation, data)
        return Fit(posterior, learned._replace(noise=white))

    @property
    def _bounds(self):
        """Bounds of the noise, (P, 2)."""
        return self.known.start(self.Y, output_scale(self.Y), self.X)[1]

    def _white(self, noise, loading):
        """Return the noise of the outputs without the noise that regressors propagate."""
        propagated = np.mean(np.einsum("npr,npr->np", loading, loading), axis=0)
        white = np.maximum(noise - propagated, self.settings.white_fraction * noise)
        return np.where(self.known.is_learned, np.maximum(white, self._bounds[:, 0]), noise)

    def _with_best_noise(self, posterior, inflation):
        """Return the posterior at the noise that maximises the likelihood bound, times ``inflation``."""
        bounds = self._bounds
        for _ in range(self.settings.noise_steps):
            noise = np.clip(posterior.noise_seen(), *bounds.T) * inflation
            change = np.abs(np.log(noise / posterior.noise)).max()
            posterior = posterior.with_noise(noise)
            if change < self.settings.tolerance:
                break
        return posterior

    def _inflated(self, posterior, inflation):
        """Return the posterior with its noise, and the known noise of samples, times ``inflation``."""
        noise = posterior.noise * inflation
        if self.known.loading is None:
            return posterior.with_noise(noise)
        return SparsePosterior(
            posterior.kernel, self.features, noise, self.data.inflated(inflation)
        )


def check_inducing(kernel: MultiOutputKernel, X: Matrix, Y: Matrix, n_inducing: int) -> None:
    """Raise ValueError if matrices of the size of all inducing variables of a kernel without values do not fit."""
    start = kernel.initialize(X, Y, np.random.RandomState(0))
    size = inducing_features(start, X[:n_inducing]).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)


def inducing_centres(
    kernel: MultiOutputKernel,
    X: Matrix,
    n_inducing: int,
    random_state: Any,
) -> Matrix:
    """Return at most n_inducing centres of the samples, (k, d), or one for a kernel whose variables need no inputs."""
    if inducing_features(kernel, X[:1]).size == inducing_features(kernel, X[:2]).size:
        return X[:1]
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    most = SETTINGS.samples_of_centre * n_inducing
    subset = X[random_state.permutation(len(X))[:most]]
    return cluster_centres(subset, column_scale(X), n_inducing, random_state)


# -- the average
# ------------------------------------------------------------------------------------------------------


def average(
    fit: Fit, X: Matrix, Y: Matrix, ordered: bool = False, known: KnownNoise = UNKNOWN
) -> Fit:
    """Return the average of the parts of a kernel, with its noise, at the hyperparameters of a fit.

    After Ctrl-C it is the fit of the whole kernel, interrupted, where ``listening`` keeps the best
    so far.

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
        With an AveragePosterior; the given fit if its kernel has one member.
    """
    parts = parts_of(fit.posterior.kernel)
    if len(parts) == 1:
        return fit
    try:
        return _average(fit, X, Y, ordered, known, parts)
    except KeyboardInterrupt:
        if not keeps_best():
            raise
        return fit.cut_short()


def _average(fit, X, Y, ordered, known, parts):
    std = fit.learned.input_std
    loading = known.loading if std is None else fit.posterior.gradient(X) * std
    fits = [fit]
    for part in parts[1:]:
        fits.append(_of_part(fit, X, Y, loading, ordered, part, known))
    if any(component.learned.interrupted for component in fits):
        return fit.cut_short()
    members = [component.posterior.members[0] for component in fits]
    noises = [component.learned.noise for component in fits]
    weights = held_out_weights(members, noises, X, Y, loading, ordered)
    noise = np.sum(weights * noises, axis=0)
    return Fit(AveragePosterior(members, weights), fit.learned._replace(noise=noise))


def mixture_of(fits: Sequence[Fit], weights: Sequence[float]) -> Fit:
    """Return the fit of the mixture of posteriors with weights that add up to one; with the likelihood of the first.

    Structures may explain the data equally well but predict other data differently, so their mean
    predicts better than each (Breiman 1996).
    """
    if len(fits) == 1:
        return fits[0]
    members: list[SinglePosterior] = []
    mixture = []
    for fit, weight in zip(fits, weights, strict=True):
        members += fit.posterior.members
        mixture.append(weight * fit.posterior.mixture)
    learned = [fit.learned for fit in fits]
    input_std = None
    if any(part.input_std is not None for part in learned):
        stds = [0.0 if part.input_std is None else part.input_std for part in learned]
        variances = np.broadcast_arrays(*map(np.square, stds))
        input_std = np.sqrt(np.average(variances, axis=0, weights=weights))
    common = learned[0]._replace(
        noise=np.average([part.noise for part in learned], axis=0, weights=weights),
        input_std=input_std,
        n_iter=max(part.n_iter for part in learned),
        converged=all(part.converged for part in learned),
    )
    return Fit(AveragePosterior(members, np.concatenate(mixture)), common)


def _of_part(whole, X, Y, loading, ordered, part, known) -> Fit:
    """Return the fit of some terms of the kernel of a fit, at its hyperparameters but for the white noise.

    Noise of the regressors propagates by ``loading`` of the whole.
    """
    learned = whole.learned._replace(kernel=of_terms(whole.posterior.kernel, part))
    data = Data.from_table(X, Y, loading)
    is_exact = isinstance(whole.posterior, ExactPosterior)
    if is_exact or known.loading is not None:
        blocks = blocks_of_rows(X, Y, time_series=ordered)
        learned = with_best_noise(learned, data, blocks, X, Y, known)
    if is_exact:
        posterior = fit_exact(learned._replace(input_std=None), data, ordered).posterior
        return Fit(posterior, learned)
    features = of_terms(whole.posterior.features, part)
    data = Data.from_table(X, Y, known.loading)
    fit = SparseFit(features, data, X, Y, ordered, known)
    return fit.at(learned, whole.posterior.mean_function, loading)
