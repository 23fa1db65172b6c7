"""Compaction: replace the samples of a posterior by inducing variables, and measure the change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Seed, Vector
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._search import maximize
from skdgp.inference._sparse import SparsePosterior

MAX_POINTS = 1000  # largest number of training inputs at which the change is measured
PERTURBATION = 0.5  # of the same number of further points, in standard deviations of the regressors
FIRST_SIZE, SIZE_GROWTH, SIZE_TOLERANCE = (
    50,
    1.6,
    1.1,
)  # search for the smallest number of variables


class Compaction(NamedTuple):
    """The change of predictions by compaction.

    It is measured for every output at up to 1000 training inputs and as many points around them,
    which are randomly perturbed by half a standard deviation of each regressor. The change of the
    mean is in standard deviations of the original posterior at the same point. The change of the
    standard deviation is the ratio new over original.

    A bound for all inputs follows from the divergence KL(new || original) of the two processes. For
    an exact original it is the log marginal likelihood minus the collapsed bound (Matthews et al.
    2016). No marginal divergence exceeds it (Burt et al. 2019): if the mean changes by c original
    standard deviations and the standard deviation by the ratio r, then (r^2 - 1 - log r^2 + c^2) /
    2 <= KL.

    Attributes
    ----------
    n_inducing : int
        Number of inducing variables of each search, the weights of a trend included.
    n_checked : int
        Number of points at which the change was measured.
    mean_rms, mean_max : ndarray (P,)
        Root mean square and largest change of the mean, in the original's standard deviations.
    std_rms : ndarray (P,)
        Root mean square of the relative change of the standard deviation.
    std_min, std_max : ndarray (P,)
        Smallest and largest ratio of standard deviations, new over original.
    divergence : float
        KL(new || original) in nats; NaN if the original is not exact.
    mean_bound : float
        Bound on the change of the mean at any input, in the original's standard deviations; NaN if
        divergence is NaN.
    std_bounds : tuple (low, high)
        Bounds on the ratio of standard deviations at any input.
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
        """Largest root mean square change of mean or standard deviation over the outputs."""
        return float(max(self.mean_rms.max(), self.std_rms.max()))


def compact(
    posterior: Any,
    n_inducing: int,
    tolerance: float | None,
    max_iter: int,
    random_state: Seed,
    allow: Callable,
) -> tuple[SparsePosterior, Compaction]:
    """Return a posterior with at most ``n_inducing`` inducing variables and no samples, and the change.

    Parameters
    ----------
    posterior : AveragePosterior, ExactPosterior or SparsePosterior
    n_inducing : int
        Largest number of variables, besides the weights of a trend. A sparse posterior with no more
        variables keeps them.
    tolerance : float or None
        Use the fewest variables for which ``Compaction.change`` stays below.
    max_iter : int
        Final iterations that move the variables to raise the bound.
    random_state : int, RandomState or None
    allow : callable
        Called with the number of variables before matrices of that size are allocated; raises if
        they are too large.

    Returns
    -------
    SparsePosterior, Compaction
    """
    data = posterior.samples()
    if data is None:
        raise ValueError(
            "A compact model holds no samples to be compacted again. Compact the model it was "
            "made from."
        )
    random_state = check_random_state(random_state)
    X = np.unique(np.concatenate(data.X), axis=0)
    check = _Check(posterior, X, random_state)
    best = [
        whole.kernel.feature_ranking(X, check.scale, random_state) for whole in posterior.wholes
    ]
    sizes = [
        whole.features.size for whole in posterior.wholes if isinstance(whole, SparsePosterior)
    ]

    def compact_to(n):
        if sizes and n >= max(sizes):
            return posterior, check.compare(posterior)
        features = [ranking(n) for ranking in best]
        allow(features[0].size)
        new = posterior.sparse(*features)
        return new, check.compare(new)

    new, change = (
        compact_to(n_inducing) if tolerance is None else _fewest(compact_to, n_inducing, tolerance)
    )
    if max_iter > 0 and new is not posterior and len(new.wholes[0].features.theta):
        improved = posterior.sparse(
            *(moved_features(whole, column_scale(X), max_iter) for whole in new.wholes)
        )
        improved_change = check.compare(improved)
        if tolerance is None or improved_change.change <= max(tolerance, change.change):
            new, change = improved, improved_change
    return new.without_samples(), change


def _fewest(compact_to, most, tolerance):
    """Return the result with the fewest variables that keeps the tolerance, or that with the most variables."""
    too_few, n = 0, min(FIRST_SIZE, most)
    best = compact_to(n)
    while best[1].change > tolerance and n < most:
        size, too_few, n = best[1].n_inducing, n, min(int(SIZE_GROWTH * n), most)
        best = compact_to(n)
        if best[1].n_inducing == size:  # there are no more variables
            return best
    if best[1].change > tolerance:
        return best
    while n > SIZE_TOLERANCE * too_few + 1 and n - too_few > 1:
        middle = (n + too_few) // 2
        trial = compact_to(middle)
        if trial[1].change > tolerance:
            too_few = middle
        else:
            n, best = middle, trial
    return best


class _Check:
    """The points at which the change is measured, with the predictions of the original."""

    def __init__(self, posterior, X, random_state):
        self.posterior = posterior
        inputs = X[random_state.permutation(len(X))[:MAX_POINTS]]
        around = inputs + PERTURBATION * X.std(axis=0) * random_state.standard_normal(inputs.shape)
        self.points = np.concatenate([inputs, around])
        self.mean, variance = posterior.predict(self.points, return_variance=True)
        P = self.mean.shape[1]
        prior = np.stack([posterior.kernel.block_diag(i, self.points) for i in range(P)], axis=1)
        self.least = 1e-6 * np.sqrt(prior)  # a smaller standard deviation is rounding error
        self.std = np.maximum(np.sqrt(variance), self.least)
        self.scale = np.sqrt(
            (self.std[: len(inputs)] ** 2).mean(axis=0)
        )  # of each output at the training inputs

    def compare(self, new) -> Compaction:
        """Return the change of predictions from the original to the new posterior."""
        mean, variance = new.predict(self.points, return_variance=True)
        shift = np.abs(mean - self.mean) / self.std
        ratio = np.maximum(np.sqrt(variance), self.least) / self.std
        divergence = np.nan
        if isinstance(self.posterior, ExactPosterior):
            divergence = max(
                float(self.posterior.log_marginal_likelihood - new.log_marginal_likelihood), 0.0
            )
        return Compaction(
            n_inducing=new.wholes[0].features.size,
            n_checked=len(self.points),
            mean_rms=np.sqrt((shift**2).mean(axis=0)),
            mean_max=shift.max(axis=0),
            std_rms=np.sqrt(((ratio - 1) ** 2).mean(axis=0)),
            std_min=ratio.min(axis=0),
            std_max=ratio.max(axis=0),
            divergence=divergence,
            mean_bound=float(np.sqrt(2 * divergence)),
            std_bounds=_ratio_bounds(divergence),
        )


def _ratio_bounds(divergence):
    """Return the two ratios r with (r^2 - 1 - log r^2) / 2 = divergence, below and above one."""
    if not divergence > 0:
        return (1.0, 1.0) if divergence == 0 else (np.nan, np.nan)

    def excess(log_square):
        return np.expm1(log_square) - log_square - 2 * divergence

    low = brentq(excess, -1.0 - 2 * divergence, 0.0)
    high = brentq(excess, 0.0, np.log1p(4 * divergence + 2 * np.sqrt(divergence)) + 1e-9)
    return float(np.exp(low / 2)), float(np.exp(high / 2))


def moved_features(start: SparsePosterior, scale: Vector, max_iter: int) -> Any:
    """Return the features with the inducing inputs that maximise the bound, from those of ``start``.

    Steps are in units of ``scale`` (d,), the standard deviations of the regressors, rounded to
    powers of two. The search then does not depend on the units of the regressors, and the scaling
    causes no rounding.
    """
    kernel, features = start.kernel, start.features
    unit = np.tile(np.exp2(np.round(np.log2(scale))), len(features.theta) // len(scale))
    bounds = np.tile([-np.inf, np.inf], (len(unit), 1))

    def bound(theta):
        posterior = SparsePosterior(
            kernel, features.rebuild(kernel, unit * theta), start.noise, start.shares
        )
        return posterior.log_marginal_likelihood, unit * posterior.bound_gradient()[-len(theta) :]

    best = maximize(bound, features.theta / unit, bounds, max_iter=max_iter, stage="compact")
    return features.rebuild(kernel, unit * best.theta)
