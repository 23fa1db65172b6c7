r"""The average of posteriors of parts of one kernel, weighted by their predictions of held-out blocks.

The mixture of posteriors with fewer and fewer terms, at the hyperparameters that one search found,
has the weights

.. math:: w_i = \arg\max_w \sum_n \log \sum_k w_k\, e^{-c_k / n} p_k(y_{in} \mid \text{other blocks})

for each output i: stacking (Yao, Vehtari, Simpson & Gelman 2018), where c is zero for the trend and
two nats for each regressor for a process, whose hyperparameters the same rows have determined.
The weights have a Dirichlet prior (``stacked``), and those below 5 % are set to zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import softmax
from sklearn.utils import check_random_state

from skdgp._compute.linalg import constant_columns
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.inference._blocks import leaves
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import Posterior, SinglePosterior
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
    #: Rows that the prior of the weights is worth, for each component (benchmark `bands`)
    prior_rows: float = 3.0
    #: Steps of expectation maximisation for the weights
    n_steps: int = 200


SETTINGS = AverageSettings()


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


class AveragePosterior(Posterior):
    """A mixture of posteriors, its components, with weights for each output (``mixture_moments``).

    Each posterior of all terms is followed by the posteriors of its parts, with the same
    hyperparameters. Another posterior of all terms is of another structure.

    Outputs have the same component as far as their weights agree: one number from 0 to 1 for all
    outputs picks it by the cumulated weights.

    Parameters
    ----------
    members : list of ExactPosterior or SparsePosterior
        Components, of the same samples. The first has all terms, and gives the average its
        hyperparameters and likelihood.
    mixture : ndarray (K, P)
        Weights of the components for each output; columns add up to one.
    """

    def __init__(self, members: list, mixture: Matrix) -> None:
        self.members = members
        self.mixture = np.asarray(mixture, dtype=float)
        self.data = members[0].data
        self.kernel = members[0].kernel
        self.noise = members[0].noise
        self.log_marginal_likelihood = members[0].log_marginal_likelihood

    @cached_property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path, whose Gaussian functions are one basis."""
        first, *others = [
            member.mean_function.times(weights)
            for member, weights in zip(self.members, self.mixture, strict=True)
        ]
        return sum(others, first).rounded()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "mean_function"}

    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        predictions = [member.predict(Xs, return_variance) for member in self.members]
        combined = mixture_moments if return_variance else mixture_mean
        return combined(self.mixture, predictions)

    def gradient(self, Xs: Matrix, spread: Vector | None = None) -> Array:
        """Return d mean / d x at Xs, (n, P, d), or expected over each regressor alone with ``spread`` (d,)."""
        slopes = [member.gradient(Xs, spread) for member in self.members]
        return mixture_mean(self.mixture, slopes)

    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint covariance of the mixture at Xs, (P n, P n), output-major."""
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
        return joint

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
        first, *others = [
            component.paths(n_paths, int(seed))
            for component, seed in zip(self.members, seeds, strict=True)
        ]
        return first.mixed(others, member)


def held_out_weights(
    members: Sequence[SinglePosterior],
    noises: Sequence[Vector],
    X: Matrix,
    Y: Matrix,
    loading: Array | None,
    ordered: bool = False,
) -> Matrix:
    """Return the weights (K, P) of posteriors with these noises (P,) from their predictions of held-out blocks.

    Blocks of rows that are ``ordered`` in time are contiguous, others are spread everywhere.
    """
    step = max(-(-len(X) // SETTINGS.rows), -(-members[0].size // SETTINGS.values))
    n = len(X[::step])
    n_blocks = min(SETTINGS.n_blocks, n)
    block = np.arange(n) * n_blocks // n if ordered else leaves(X[::step], 1) % n_blocks
    predictions = []
    for member, noise in zip(members, noises, strict=True):
        predictions.append(held_out(member, noise, X, Y, step, loading, block))
    means, variances = np.array(predictions).swapaxes(0, 1)
    cost = SETTINGS.nats * np.sum(~constant_columns(X))
    weights = np.empty((len(members), Y.shape[1]))
    for i, y in enumerate(Y[::step].T):
        error = y - means[..., i]
        is_complete = np.isfinite(error).all(axis=0)
        error = error[:, is_complete]
        variance = variances[..., i][:, is_complete]
        scores = -0.5 * (np.log(2 * np.pi * variance) + error**2 / variance)
        scores[:-1] -= cost / max(scores.shape[1], 1)
        weights[:, i] = stacked(scores)
    weights[weights < SETTINGS.least_weight] = 0.0
    return weights / weights.sum(axis=0)


def stacked(scores: Matrix, settings: AverageSettings = SETTINGS) -> Vector:
    """Return the weights (K,) of components with log densities (K, n); without rows the last has all.

    Weights that few rows decide vary by chance. A Dirichlet prior is worth K ``prior_rows`` rows,
    shared in proportion to :math:`e^{-z_k}`: the score of component k is :math:`z_k` standard
    errors below that of the best one. Like pseudo-BMA+ (the same paper) it takes the uncertainty of
    the scores into account.
    """
    K, n = scores.shape
    if n == 0:
        return np.eye(K)[-1]
    shortfall = scores[scores.sum(axis=1).argmax()] - scores
    error = np.maximum(np.sqrt(n) * shortfall.std(axis=1), 1.0)
    prior = K * settings.prior_rows * softmax(-shortfall.sum(axis=1) / error)
    weights = np.full(K, 1.0 / K)
    for _ in range(settings.n_steps):  # expectation maximisation
        with np.errstate(divide="ignore"):
            component = softmax(scores + np.log(weights)[:, None], axis=0)
        rows = component.sum(axis=1) + prior
        weights = rows / rows.sum()
    return weights


def held_out(
    posterior: SinglePosterior,
    noise: Vector,
    X: Matrix,
    Y: Matrix,
    step: int = 1,
    loading: Array | None = None,
    block: Indices | None = None,
) -> tuple[Matrix, Matrix]:
    """Return mean and variance of the values of every ``step``-th row, predicted from the other blocks, (n, P) each.

    Hyperparameters are the posterior's; ``loading`` is the effect of the noise of the regressors
    at X, if they have any, ``block`` (n,) the number of each row's block, by default contiguous ones.
    Where outputs are observed together, whole rows are left out. A value that is missing while
    others are there is learned from these, so where an output has gaps, blocks are left out of one
    output at a time.
    """
    inflation = np.maximum(posterior.noise / noise / step, 1.0)
    X = X[::step]
    Y = Y[::step]
    inflated = None
    if loading is not None:
        loading = loading[::step]
        inflated = loading * np.sqrt(inflation)[:, None]
    if block is None:
        block = np.arange(len(Y)) * min(SETTINGS.n_blocks, len(Y)) // len(Y)
    mean = np.full(Y.shape, np.nan)
    variance = np.full(Y.shape, np.nan)
    folds = list(_folds(Y, block))
    data = Data.from_table(X, Y, inflated)
    parts = []
    for left_out in folds:
        kept = Data.from_table(X, np.where(left_out, np.nan, Y), inflated)
        parts.append((kept, Data.from_table(X, np.where(left_out, Y, np.nan), inflated)))
    posteriors = posterior.folds(noise * inflation, data, parts)
    for left_out, remaining in zip(folds, posteriors, strict=True):
        inside = np.flatnonzero(left_out.any(axis=1))
        means, variances = remaining.predict(X[inside], return_variance=True)
        mean[left_out] = means[left_out[inside]]
        variance[left_out] = variances[left_out[inside]]
    variance += noise
    if loading is not None:
        variance += np.einsum("npr,npr->np", loading, loading)
    return mean, variance


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


def training_inputs(posterior: Posterior) -> Matrix:
    """Return the distinct inputs of the observed values of a posterior, (n, d)."""
    return np.unique(np.concatenate(posterior.data.X), axis=0)
