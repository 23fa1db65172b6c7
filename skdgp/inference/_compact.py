"""Compaction: a posterior of few inducing variables without samples, and what that changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data
from skdgp.inference._sparse import SparsePosterior, maximize_features
from skdgp.inference._sums import data_of, shares_of

CHECKED = 1000  # training inputs, at most, and as many around them, where the change is measured
AROUND = 0.5  # standard deviations of the regressors that these are moved by
FIRST, GROWTH, CLOSE = 50, 1.6, 1.1  # of the search for the smallest number


class Compaction(NamedTuple):
    """What compacting changed.

    Measured at up to 1000 training inputs and as many points around them (moved by half a standard deviation of each
    regressor, at random), for every output: the change of the mean, in standard deviations of the original posterior
    there, and the new standard deviation over the original one.

    What holds everywhere, and for every output, follows from the divergence KL(new || original) of the two processes,
    which for an exact original is its log marginal likelihood less the collapsed bound (Matthews et al. 2016), and
    which no marginal exceeds (Burt et al. 2019): with Gaussians of mean change c original deviations and ratio r of
    deviations, (r^2 - 1 - log r^2 + c^2) / 2 <= KL.

    Attributes
    ----------
    n_inducing : int
        Variables that stand for the samples, the weights of a trend included.
    n_checked : int
        Points at which the change was measured.
    mean_rms, mean_max : ndarray (P,)
        Root mean square and largest change of the mean, in the original's standard deviations.
    std_rms : ndarray (P,)
        Root mean square of the relative change of the standard deviation.
    std_min, std_max : ndarray (P,)
        Smallest and largest ratio of standard deviations, new over original.
    divergence : float
        KL(new || original) in nats; NaN where the original was not exact.
    mean_bound : float
        No mean, anywhere, changed by more of the original's standard deviations. NaN where divergence is.
    std_bounds : tuple (low, high)
        No ratio of standard deviations, anywhere, is outside.
    """

    n_inducing: int
    n_checked: int
    mean_rms: np.ndarray
    mean_max: np.ndarray
    std_rms: np.ndarray
    std_min: np.ndarray
    std_max: np.ndarray
    divergence: float
    mean_bound: float
    std_bounds: tuple[float, float]

    @property
    def change(self) -> float:
        """The largest, over the outputs, of the root mean square changes of mean and standard deviation."""
        return float(max(self.mean_rms.max(), self.std_rms.max()))


def compact(posterior, n_inducing: int, tolerance: float | None, max_iter: int, random_state, allow):
    """Return a posterior of at most so many inducing variables, without samples, and what that changed.

    Parameters
    ----------
    posterior : ExactPosterior or SparsePosterior
    n_inducing : int
        Variables, beside the weights of a trend. A sparse posterior that has no more keeps its own.
    tolerance : float or None
        Take fewer variables, as long as ``Compaction.change`` stays below.
    max_iter : int
        Iterations in which their places are improved on the bound, at the end.
    random_state : int, RandomState or None
    allow : callable
        Called with the number of variables before matrices of that size are made; raises where they are too large.

    Returns
    -------
    SparsePosterior, Compaction
    """
    data = _values(posterior)
    random_state = check_random_state(random_state)
    X = np.unique(np.concatenate(data.X), axis=0)
    check = _Check(posterior, X, random_state)
    best = posterior.kernel.feature_ranking(X, check.scale(), random_state)
    shares = shares_of(data)

    def summary(n):
        if isinstance(posterior, SparsePosterior) and n >= posterior.features.size:
            return posterior, check.of(posterior)
        features = best(n)
        allow(features.size)
        new = SparsePosterior(posterior.kernel, features, posterior.noise, shares)
        return new, check.of(new)

    new, found = summary(n_inducing) if tolerance is None else _smallest(summary, n_inducing, tolerance)
    if max_iter > 0 and new is not posterior and len(new.features.theta):
        placed = new
        if data.drift is not None:  # where variables stand best, white noise of the same size tells as well
            white, noise = data._replace(drift=None), new.noise + data.drift.variance
            placed = SparsePosterior(new.kernel, new.features, noise, shares_of(white))
        features, _ = maximize_features(placed, column_scale(X), max_iter=max_iter, stage="compact")
        improved = SparsePosterior(new.kernel, features, new.noise, new.shares)
        after = check.of(improved)
        if tolerance is None or after.change <= max(tolerance, found.change):
            new, found = improved, after
    return new.without_samples(), found


def _smallest(summary, most, tolerance):
    """Return the summary of fewest variables that keeps the tolerance, or that of the most."""
    too_few, n = 0, min(FIRST, most)
    found = summary(n)
    while found[1].change > tolerance and n < most:
        size, too_few, n = found[1].n_inducing, n, min(int(GROWTH * n), most)
        found = summary(n)
        if found[1].n_inducing == size:  # there are no more
            return found
    if found[1].change > tolerance:
        return found
    while n > CLOSE * too_few + 1 and n - too_few > 1:
        middle = (n + too_few) // 2
        tried = summary(middle)
        if tried[1].change > tolerance:
            too_few = middle
        else:
            n, found = middle, tried
    return found


def _values(posterior) -> Data:
    """Return the observed values that a posterior holds."""
    if isinstance(posterior, ExactPosterior):
        return posterior.data
    if posterior.shares is None:
        raise ValueError("A compact model holds no samples to be compacted again. Compact the model it was made from.")
    return data_of(posterior.shares, posterior.kernel.n_outputs)


class _Check:
    """Where the change is measured, and what the original says there."""

    def __init__(self, posterior, X, random_state):
        self.posterior = posterior
        inputs = X[random_state.permutation(len(X))[:CHECKED]]
        around = inputs + AROUND * X.std(axis=0) * random_state.standard_normal(inputs.shape)
        self.inputs, self.points = inputs, np.concatenate([inputs, around])
        self.mean, variance = posterior.predict(self.points, return_variance=True)
        P = self.mean.shape[1]
        prior = np.stack([posterior.kernel.block_diag(i, self.points) for i in range(P)], axis=1)
        self.least = 1e-6 * np.sqrt(prior)  # a deviation below is rounding
        self.std = np.maximum(np.sqrt(variance), self.least)

    def scale(self):
        """Return how exactly each output is known at the training inputs, (P,)."""
        return np.sqrt((self.std[: len(self.inputs)] ** 2).mean(axis=0))

    def of(self, new) -> Compaction:
        """Return what changed."""
        mean, variance = new.predict(self.points, return_variance=True)
        moved = np.abs(mean - self.mean) / self.std
        ratio = np.maximum(np.sqrt(variance), self.least) / self.std
        divergence = np.nan
        if isinstance(self.posterior, ExactPosterior):
            divergence = max(float(self.posterior.log_marginal_likelihood - new.log_marginal_likelihood), 0.0)
        return Compaction(
            n_inducing=new.features.size,
            n_checked=len(self.points),
            mean_rms=np.sqrt((moved**2).mean(axis=0)),
            mean_max=moved.max(axis=0),
            std_rms=np.sqrt(((ratio - 1) ** 2).mean(axis=0)),
            std_min=ratio.min(axis=0),
            std_max=ratio.max(axis=0),
            divergence=divergence,
            mean_bound=float(np.sqrt(2 * divergence)),
            std_bounds=_ratio_bounds(divergence),
        )


def _ratio_bounds(divergence):
    """Return the ratios r of deviations with (r^2 - 1 - log r^2) / 2 = divergence, below and above one."""
    if not divergence > 0:
        return (1.0, 1.0) if divergence == 0 else (np.nan, np.nan)

    def excess(log_square):
        return np.expm1(log_square) - log_square - 2 * divergence

    low = brentq(excess, -1.0 - 2 * divergence, 0.0)
    high = brentq(excess, 0.0, np.log1p(4 * divergence + 2 * np.sqrt(divergence)) + 1e-9)
    return float(np.exp(low / 2)), float(np.exp(high / 2))
