r"""The posterior of a fit: an average of parts of one kernel, weighted by their errors of held-out blocks.

The mixture of the posteriors of all terms and of the trend, at the hyperparameters that one search
found, has the mean :math:`w m_1 + (1 - w) m_2` of each output. Its weight is the one whose errors of
held-out blocks are smallest (stacked regressions: Breiman 1996), as far as the rows tell
(``stacked``), and weights below 5 % are set to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np
from scipy.special import softmax
from sklearn.utils import check_random_state

from skdgp._compute.linalg import constant_columns
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.inference._blocks import leaves
from skdgp.inference._errors import FunctionErrors
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import SinglePosterior
from skdgp.kernels import MultiOutputKernel, PathBundle


@dataclass(frozen=True)
class AverageSettings:
    """How the weights of an average are learned."""

    #: Cost of the hyperparameters of a process [nats for each regressor] (Akaike 1974: two widths)
    nats: float = 2.0
    #: Blocks of rows: errors are correlated over a tenth of a time series
    n_blocks: int = 8
    #: Parts of the blocks that are held out in turn
    n_folds: int = 4
    #: Most rows that weights are learned from, to save time
    rows: int = 4000
    #: Most values of an exact posterior that weights are learned from, to save time
    values: int = 4000
    #: Fraction of its values that an output has where whole rows are held out
    complete: float = 0.95
    #: Smaller weights are set to zero: such a component lies outside the 95 % band, yet widens it
    least_weight: float = 0.05


SETTINGS = AverageSettings()
WEIGHTS = np.linspace(0.0, 1.0, 1001)  # over which the density of a weight is summed
ROUNDING = 1e-12  # mean square that counts as zero, over the one of all errors


def mixture_mean(mixture: Matrix, means: Any) -> Array:
    r"""Return the mean (n, P, ...) of a mixture with weights (K, P) of components with ``means`` (K, n, P, ...)."""
    means = np.asarray(means)
    return np.sum(_broadcast(mixture, means) * means, axis=0)


def mixture_moments(mixture: Matrix, moments: Any) -> tuple[Matrix, Matrix]:
    r"""Return the mean and the variance of a mixture with weights (K, P), (n, P) each.

    ``moments`` are pairs of the means :math:`m_k` and the variances :math:`v_k` of the components:
    :math:`m = \sum_k w_k m_k` and :math:`v = \sum_k w_k (v_k + (m_k - m)^2)`.
    """
    means, variances = map(np.asarray, zip(*moments, strict=True))
    mean = mixture_mean(mixture, means)
    scatter = variances + (means - mean) ** 2
    return mean, np.sum(_broadcast(mixture, means) * scatter, axis=0)


def _broadcast(mixture: Matrix, means: Array) -> Array:
    """Return weights (K, P) in the shape of means (K, n, P, ...)."""
    return mixture.reshape(len(means), 1, -1, *(1,) * (means.ndim - 3))


def parts_of(kernel: MultiOutputKernel) -> list[tuple[int, ...]]:
    """Return the numbers of the terms in each component of a kernel's average: all terms, and the trend alone.

    A kernel without a trend, or without processes, has one component.
    """
    terms = kernel.summands()
    trend = tuple(k for k, term in enumerate(terms) if term.n_processes == 0)
    members = [tuple(range(len(terms)))]
    return list(dict.fromkeys([*members, trend] if trend else members))


def of_terms(whole: Any, numbers: Sequence[int]) -> Any:
    """Return the sum of some terms of a kernel, or of features."""
    terms = whole.summands()
    *others, last = numbers
    total = terms[last]
    for k in reversed(others):
        total = terms[k] + total
    return total


class Posterior:
    """The outputs, given their observed values: a mixture of Gaussian processes, and errors of their function.

    The weights are those of each output (``mixture_moments``). Each component of all terms is followed by
    the components of its parts, with the same hyperparameters. Another component of all terms is of
    another structure.

    Outputs have the same component as far as their weights agree: one number from 0 to 1 for all
    outputs picks it by the cumulated weights.

    Parameters
    ----------
    members : list of ExactPosterior or SparsePosterior
        Components, of the same samples. The first has all terms, and gives the mixture its
        hyperparameters and likelihood.
    mixture : ndarray (K, P)
        Weights of the components for each output; columns add up to one.
    errors : FunctionErrors or None
        Independent errors of the function that the components do not hold.
    """

    def __init__(
        self,
        members: Sequence[SinglePosterior],
        mixture: Matrix,
        errors: FunctionErrors | None = None,
    ) -> None:
        self.members = list(members)
        self.mixture = np.asarray(mixture, dtype=float)
        self.errors = errors

    @classmethod
    def of_one(cls, member: SinglePosterior) -> Posterior:
        """Return the posterior of one Gaussian process."""
        return cls([member], np.ones((1, member.kernel.n_outputs)))

    def with_errors(self, errors: FunctionErrors | None) -> Posterior:
        """Return the same components with other errors of their function."""
        return Posterior(self.members, self.mixture, errors)

    @property
    def kernel(self) -> MultiOutputKernel:
        """Kernel of all terms."""
        return self.members[0].kernel

    @property
    def noise(self) -> Vector:
        """Noise variance of each output, of all terms."""
        return self.members[0].noise

    @property
    def data(self) -> Data:
        """The observed values."""
        return self.members[0].data

    @property
    def inputs(self) -> Matrix:
        """The distinct inputs of the observed values, (n, d)."""
        return np.unique(np.concatenate(self.data.X), axis=0)

    @property
    def log_marginal_likelihood(self) -> float:
        """Log marginal likelihood of all terms, or a lower bound on it."""
        return self.members[0].log_marginal_likelihood

    @cached_property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""
        weighted = [
            member.mean_function.times(weights)
            for member, weights in zip(self.members, self.mixture, strict=True)
        ]
        if self.errors is not None:
            weighted.append(self.errors.mean_path())
        return reduce(add, weighted)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "mean_function"}

    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        predictions = [member.predict(Xs, return_variance) for member in self.members]
        added = 0.0 if self.errors is None else self.errors.mean_path().each(Xs)[0]
        if not return_variance:
            return mixture_mean(self.mixture, predictions) + added
        mean, variance = mixture_moments(self.mixture, predictions)
        if self.errors is not None:
            variance = variance + self.errors.variance(Xs)
        return mean + added, variance

    def gradient(self, Xs: Matrix, spread: Vector | None = None) -> Array:
        """Return d mean / d x at Xs, (n, P, d), or expected over each regressor alone with ``spread`` (d,)."""
        slopes = [member.gradient(Xs, spread) for member in self.members]
        added = 0.0 if self.errors is None else self.errors.mean_path().gradient(Xs[None])[0]
        return mixture_mean(self.mixture, slopes) + added

    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint covariance at Xs, (P n, P n), output-major."""
        means = np.array([member.predict(Xs) for member in self.members])
        off = means - mixture_mean(self.mixture, means)
        ends = np.cumsum(self.mixture, axis=0)
        starts = ends - self.mixture
        first = np.maximum(starts[:, None, :, None], starts[None, :, None, :])
        last = np.minimum(ends[:, None, :, None], ends[None, :, None, :])
        # probability that output i has component k and output j component l, (K, K, P, P)
        shared = np.maximum(last - first, 0.0)
        n, P = off.shape[1:]
        joint = np.einsum("klij,kai,lbj->iajb", shared, off, off).reshape(P * n, P * n)
        for k, member in enumerate(self.members):
            joint += member.covariance(Xs) * np.kron(shared[k, k], np.ones((n, n)))
        return joint if self.errors is None else joint + self.errors.covariance(Xs)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples, functions of the regressors, with one component for each output.

        The numbers that pick components are spread evenly, so that few paths have them in
        proportion to the weights.
        """
        rng = check_random_state(random_state)
        pick = rng.permutation(n_paths) + rng.uniform(size=n_paths)
        ends = n_paths * np.cumsum(self.mixture, axis=0)
        member = np.sum(pick[:, None, None] >= ends[:-1], axis=1)
        seeds = rng.randint(2**31 - 1, size=len(self.members))
        parts: list[PathBundle] = []
        for k, (component, seed) in enumerate(zip(self.members, seeds, strict=True)):
            if (member == k).any():
                parts.append(component.paths(n_paths, int(seed)).times(1.0 * (member == k)))
        if self.errors is not None:
            parts.append(self.errors.paths(n_paths, rng))
        return reduce(add, parts)


def held_out_weights(
    members: Sequence[SinglePosterior],
    noises: Sequence[Vector],
    X: Matrix,
    Y: Matrix,
    added: Matrix | None,
    ordered: bool = False,
) -> Matrix:
    """Return the weights (2, P) of two posteriors with these noises (P,) from their errors of held-out blocks.

    Blocks of rows that are ``ordered`` in time are contiguous, others are spread everywhere. Errors
    are over the root mean square of the posteriors' standard deviations.
    """
    step = max(-(-len(X) // SETTINGS.rows), -(-members[0].size // SETTINGS.values))
    n = len(X[::step])
    n_blocks = min(SETTINGS.n_blocks, n)
    block = np.arange(n) * n_blocks // n if ordered else leaves(X[::step], 1) % n_blocks
    predictions = []
    for member, noise in zip(members, noises, strict=True):
        predictions.append(held_out(member, noise, X, Y, step, added, block))
    means, variances = np.array(predictions).swapaxes(0, 1)
    errors = (Y[::step] - means) / np.sqrt(variances.mean(axis=0))
    cost = SETTINGS.nats * np.sum(~constant_columns(X))
    weights = np.empty((len(members), Y.shape[1]))
    for i in range(Y.shape[1]):
        is_complete = np.isfinite(errors[..., i]).all(axis=0)
        weights[:, i] = stacked(errors[:, is_complete, i], cost, ordered)
    weights[weights < SETTINGS.least_weight] = 0.0
    return weights / weights.sum(axis=0)


def stacked(errors: Matrix, cost: float, ordered: bool = False) -> Vector:
    r"""Return the weights (2,) of two components with the ``errors`` (2, n) of held-out values.

    The error of the mixture's mean is :math:`e_w = w e_1 + (1 - w) e_2`. The first component pays
    ``cost`` nats, and the weight is the mean of w from 0 to 1 with the density

    .. math:: p(w) \propto \exp\left(-\frac{1}{\tau} \left(\frac{\sum_n e_{wn}^2}{2 \sigma^2}
              + c\, w\right)\right),

    where :math:`\sigma^2` is the least mean square of :math:`e_w`, and :math:`\tau` its autocorrelation
    time where the rows are ``ordered`` in time, else 1. Rows that tell nothing give equal weights. Of
    components that are equal, and without rows, the second has all.
    """
    difference = errors[1] - errors[0]
    information = difference @ difference
    if information == 0.0:
        return np.array([0.0, 1.0])
    best = difference @ errors[1] / information
    residual = errors[1] - best * difference
    variance = np.mean(residual**2) + ROUNDING * np.mean(errors**2)
    tau = autocorrelation_time(residual) if ordered else 1.0
    squares = information * (WEIGHTS - best) ** 2  # beyond the least sum of squares
    weight = WEIGHTS @ softmax(-(squares / (2.0 * variance) + cost * WEIGHTS) / tau)
    return np.array([weight, 1.0 - weight])


def held_out(
    posterior: SinglePosterior,
    noise: Vector,
    X: Matrix,
    Y: Matrix,
    step: int = 1,
    added: Matrix | None = None,
    block: Indices | None = None,
) -> tuple[Matrix, Matrix]:
    """Return mean and variance of the values of every ``step``-th row, predicted from the other blocks, (n, P) each.

    Hyperparameters are the posterior's; ``added`` (n, P) are the variances of the noise of the values
    beside the white noise, if any, ``block`` (n,) the number of each row's block, by default contiguous ones.
    Where outputs are observed together, whole rows are left out. A value that is missing while
    others are there is learned from these, so where an output has gaps, blocks are left out of one
    output at a time.
    """
    inflation = np.maximum(posterior.noise / noise / step, 1.0)
    X = X[::step]
    Y = Y[::step]
    added = np.zeros(Y.shape) if added is None else added[::step]
    inflated = added * inflation
    if block is None:
        block = np.arange(len(Y)) * min(SETTINGS.n_blocks, len(Y)) // len(Y)
    mean = np.full(Y.shape, np.nan)
    variance = np.full(Y.shape, np.nan)
    for left_out in _folds(Y, block):
        kept = Data.from_table(X, np.where(left_out, np.nan, Y), inflated)
        remaining = posterior.of(kept, noise * inflation)
        inside = np.flatnonzero(left_out.any(axis=1))
        means, variances = remaining.predict(X[inside], return_variance=True)
        mean[left_out] = means[left_out[inside]]
        variance[left_out] = variances[left_out[inside]]
    return mean, variance + noise + added


def _folds(Y, block):
    """Yield masks of the values that are held out together, (n, P), from the ``block`` (n,) of each row."""
    P = Y.shape[1]
    observed = np.isfinite(Y)
    complete = SETTINGS.complete * observed.any(axis=1).mean()
    has_gaps = P > 1 and (observed.mean(axis=0) < complete).any()
    shift = np.arange(P) if has_gaps else np.zeros(P, dtype=int)
    turn = block[:, None] + shift
    for fold in range(SETTINGS.n_folds):
        yield (turn % SETTINGS.n_folds == fold) & observed
