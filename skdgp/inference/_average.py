r"""The average of posteriors of parts of one kernel, weighted by what they predict of held-out blocks.

A kernel is a sum of terms: a trend, a process of each regressor alone, processes of all regressors. Which of them a log
can tell apart from its noise is uncertain, and the likelihood, which takes residuals as independent, does not say. So
the posterior is the mixture of those with fewer and fewer terms, at the hyperparameters that one search found,

.. math:: p(f_i) = \sum_k w_{ik}\, p_k(f_i), \quad
          w_i = \arg\max_w \frac{n}{\tau} \, \overline{\log \sum_k w_k\, p_k(y_i \mid \text{other blocks})}
          + c \sum_k \pi_k \log w_k,

the stacking of predictive distributions (Yao, Vehtari, Simpson & Gelman 2018) for each output i. n rows whose errors,
those of the best member, are correlated over tau rows are worth n / tau. c rows of an opinion :math:`\pi` keep weights
from following chance. It is equal weights, but the trend alone as far as n / tau falls short of ten rows for each
regressor, times :math:`e^{-n \Delta_k / 10 \tau}` for a member whose mean log score is less than the best by
:math:`\Delta_k`. Hyperparameters have seen the held-out blocks, too, and fit few rows: with r < 10 rows for each
regressor their evidence counts :math:`(r / 10)^4` times.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial, reduce
from typing import Any

import numpy as np
from scipy.special import logsumexp, softmax

from skdgp._compute.correlation import autocorrelation_time
from skdgp._compute.linalg import covariance_root
from skdgp._compute.parallel import fit_map
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._fit import Fit, loading_of, with_noise_for
from skdgp.inference._likelihood import Data
from skdgp.inference._mixture import moments
from skdgp.inference._posterior_paths import Paths, mixed_paths
from skdgp.inference._sparse import SparsePosterior

PRIOR_ROWS = 3.0
"""c. An output of ten values, which has another for a guide, needs few.

Real flights, each aircraft left out in turn, prefer 10 rows by half a percent (tests/benchmarks/pairs.py)."""
TEMPER = 10.0  # nats of evidence over the log of the opinion; 30 and no evidence are as good on these flights
LEAST_ROWS = 10  # rows for each regressor below which evidence is discounted, and the trend is believed first
BLOCKS, FOLDS = 40, 4  # blocks of the log, which are held out in turn, a fourth of them at a time
MOST_ROWS = 4000  # largest number of rows that weights are learned from
COMPLETE = 0.95  # share of its values that an output has where whole rows are held out
STEPS = 200  # of expectation maximisation for the weights


def parts_of(kernel: Any) -> list[tuple[int, ...]]:
    """Return which terms of a kernel each member of its average has, by their numbers: all terms first, the trend last.

    Between them stands the sum without the processes of several regressors. A kernel without a trend has one member.
    """
    terms = kernel.summands()
    trend = [k for k, term in enumerate(terms) if term.n_processes == 0]
    single = [k for k, term in enumerate(terms) if k not in trend and len(term.term_regressors()[0]) == 1]
    members = [tuple(range(len(terms)))]
    if trend:
        members += [tuple(sorted(trend + single)), tuple(trend)]
    return list(dict.fromkeys(members))


def of_terms(whole: Any, numbers: Sequence[int]) -> Any:
    """Return the sum of some terms of a kernel, or of features."""
    terms = whole.summands()
    if len(numbers) == len(terms):
        return whole
    return reduce(lambda rest, k: terms[k] + rest, numbers[-2::-1], terms[numbers[-1]])


class AveragePosterior:
    """The mixture of posteriors, the members, with weights for each output (``moments``).

    Behind a posterior of all terms stand those of its parts, which have the same hyperparameters. Another posterior of
    all terms is that of another search.

    Outputs have the same member as far as their weights agree: a number from 0 to 1, the same for all, picks it by the
    cumulated weights.

    Parameters
    ----------
    members : list of ExactPosterior or SparsePosterior
        Of the same samples. The first has all terms; hyperparameters and likelihood of the average are its own.
    parts : list of tuple of int
        The terms of the first member's kernel that each member has.
    mixture : ndarray (K, P)
        Weights of each member, for each output; columns add up to one.
    """

    measured: Any = None  # X (n, d), Y (n, P) where it has learned from other samples

    def __init__(self, members: list, parts: list, mixture: Matrix) -> None:
        self.members, self.parts, self.mixture = members, parts, np.asarray(mixture, dtype=float)

    @property
    def wholes(self) -> list[Any]:
        """The members with all terms, one of each search."""
        return [member for member, part in zip(self.members, self.parts, strict=True) if part == self.parts[0]]

    @property
    def kernel(self) -> Any:
        """The kernel of the first member."""
        return self.members[0].kernel

    @property
    def noise(self) -> Vector:
        """The noise variances of the first member, (P,)."""
        return self.members[0].noise

    @property
    def log_marginal_likelihood(self) -> float:
        """The log likelihood of the first member."""
        return self.members[0].log_marginal_likelihood

    def likelihood_at(self, kernel: Any, noise: Vector, eval_gradient: bool = False) -> Any:
        """Return the log likelihood of the first member at other hyperparameters."""
        return self.members[0].likelihood_at(kernel, noise, eval_gradient)

    def samples(self) -> Data | None:
        """Return the values that the members have learned from; None in a compact model."""
        return self.members[0].samples()

    def map(self, function: Any) -> AveragePosterior:
        """Return the average of other posteriors, ``function`` of each member."""
        new = AveragePosterior([function(member) for member in self.members], self.parts, self.mixture)
        new.measured = self.measured
        return new

    def updated(self, data: Data) -> AveragePosterior:
        """Return the average with further values; weights stay."""
        return self.map(lambda member: member.updated(data))

    def without_samples(self) -> AveragePosterior:
        """Return the same average without samples."""
        return self.map(lambda member: member.without_samples())

    def scaled_noise(self, factor: Vector) -> AveragePosterior:
        """Return the average with the noise of each output times a factor (P,)."""
        return self.map(lambda member: member.scaled_noise(factor))

    def sparse(self, *features: Any) -> AveragePosterior:
        """Return the sparse average of the same samples, with these features of the kernels of ``wholes``."""
        search = np.cumsum([part == self.parts[0] for part in self.parts]) - 1
        members = [
            member.sparse(of_terms(features[s], part))
            for member, part, s in zip(self.members, self.parts, search, strict=True)
        ]
        return AveragePosterior(members, self.parts, self.mixture)

    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        return moments(self.mixture, [m.predict(Xs, return_variance) for m in self.members], return_variance)

    def gradient(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return d mean / d x at Xs, (n, P, d), and with ``return_variance`` the variance of the slopes."""
        return moments(self.mixture, [m.gradient(Xs, return_variance) for m in self.members], return_variance)

    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint covariance of the mixture at Xs, (P n, P n), output-major."""
        means = np.array([member.predict(Xs) for member in self.members])
        off = means - moments(self.mixture, means)
        shared = self._shared()
        n, P = off.shape[1:]
        joint = np.einsum("klij,kai,lbj->iajb", shared, off, off).reshape(P * n, P * n)
        for k, member in enumerate(self.members):
            joint += member.covariance(Xs) * np.kron(shared[k, k], np.ones((n, n)))
        return joint

    def _shared(self):
        """Return the probability that output i has member k and output j member l, (K, K, P, P)."""
        ends = np.cumsum(self.mixture, axis=0)
        starts = ends - self.mixture
        first = np.maximum(starts[:, None, :, None], starts[None, :, None, :])
        last = np.minimum(ends[:, None, :, None], ends[None, :, None, :])
        return np.maximum(last - first, 0.0)

    def paths(self, n_paths: int, random_state: Seed) -> Paths:
        """Return samples of the mixture that are functions of the regressors: each output of a path has one member."""
        return mixed_paths(self.members, self.mixture, n_paths, random_state)


def average(fit: Fit, X: Matrix, Y: Matrix, n_jobs: int | None = None) -> Fit:
    """Return the fit of the average of the parts of a kernel, with its noise, at the hyperparameters of a fit.

    After Ctrl-C it is the fit of the whole kernel, interrupted.

    Parameters
    ----------
    fit : Fit
        Of the whole kernel to all rows.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    n_jobs : int or None
        Parts that are fitted side by side, as in joblib.

    Returns
    -------
    Fit
        With an AveragePosterior; the given fit if its kernel has one member.
    """
    parts = parts_of(fit.posterior.kernel)
    if len(parts) == 1:
        return fit
    try:
        loading = loading_of(fit, X)
        of_part = partial(_of_part, fit, X=X, Y=Y, loading=loading)
        fits = [fit, *fit_map(of_part, [{"part": part} for part in parts[1:]], n_jobs)]
        weights = None if any(each.interrupted for each in fits) else _weights(fits, X, Y, loading)
    except KeyboardInterrupt:
        weights = None
    if weights is None:
        return fit.marked(interrupted=True)
    posterior = AveragePosterior([each.posterior for each in fits], parts, weights)
    noise = np.sum(weights * [each.learned.noise for each in fits], axis=0)
    n_evaluations = sum(each.learned.n_evaluations for each in fits)
    return fit._replace(posterior=posterior, learned=fit.learned._replace(noise=noise, n_evaluations=n_evaluations))


def joined(fits: list[Fit]) -> Fit:
    """Return the fit of the mean of averages, each of one search; the likelihood is that of the first.

    Searches hold out other blocks and start at other values. What they find explains the log equally well, but predicts
    other flights differently, so their mean predicts better than each (Breiman 1996).
    """
    if len(fits) == 1:
        return fits[0]
    posteriors, learned = [fit.posterior for fit in fits], [fit.learned for fit in fits]
    posterior = AveragePosterior(
        [member for each in posteriors for member in each.members],
        [part for each in posteriors for part in each.parts],
        np.concatenate([each.mixture for each in posteriors]) / len(fits),
    )
    roots = [each.root for each in learned if each.root is not None]
    found = learned[0]._replace(
        noise=np.mean([each.noise for each in learned], axis=0),
        root=covariance_root(np.mean([root @ root.T for root in roots], axis=0)) if roots else None,
        n_evaluations=sum(each.n_evaluations for each in learned),
        interrupted=any(each.interrupted for each in learned),
        converged=all(each.converged for each in learned),
    )
    return Fit(posterior, found, fits[0].value)


def _of_part(fit, X, Y, loading, part) -> Fit:
    """Return the fit of some terms of its kernel, with the noise that is best for them."""
    kernel, features = of_terms(fit.posterior.kernel, part), None
    if isinstance(fit.posterior, SparsePosterior):
        features = of_terms(fit.posterior.features, part)
    return with_noise_for(kernel, features, fit, X, Y, loading)


def _weights(fits, X, Y, loading) -> Matrix:
    """Return the weights (K, P) of fits from what they predict of held-out blocks."""
    rows = np.arange(0, len(X), -(-len(X) // MOST_ROWS))
    found = [held_out(fit, X, Y, rows, loading) for fit in fits]
    K, P = len(fits), Y.shape[1]
    weights = np.empty((K, P))
    for i in range(P):
        y = Y[rows, i]
        error = np.array([y - mean[:, i] for mean, _ in found])
        variance = np.array([v[:, i] for _, v in found])
        known = np.isfinite(error).all(axis=0)
        scores = -0.5 * (np.log(2 * np.pi * variance[:, known]) + error[:, known] ** 2 / variance[:, known])
        weights[:, i] = stacked(scores, *_evidence(scores, error[:, known], X.shape[1]))
    return weights


def _evidence(scores, error, n_regressors):
    """Return how many rows the scores (K, rows) are worth, and the opinion of the weights (K,)."""
    K, n = scores.shape
    if n == 0:
        return 0.0, np.eye(K)[-1]
    mean = scores.mean(axis=1)
    seen = min(1.0, n / (LEAST_ROWS * n_regressors)) ** 4
    worth = seen * n / max(autocorrelation_time(error[mean.argmax()]), 1.0)
    trust = min(1.0, worth / (LEAST_ROWS * n_regressors))
    opinion = np.full(K, trust / K)
    opinion[-1] += 1.0 - trust
    opinion *= np.exp(worth * (mean - mean.max()) / TEMPER)
    return worth, opinion / opinion.sum()


def stacked(scores: Matrix, n: float, opinion: Vector, prior_rows: float = PRIOR_ROWS) -> Vector:
    """Return the weights (K,) of members with the log densities ``scores`` (K, rows), worth n independent ones."""
    with np.errstate(divide="ignore"):
        log_weights = np.log(opinion)
        for _ in range(STEPS if scores.shape[1] else 0):
            share = softmax(scores + log_weights[:, None], axis=0).mean(axis=1)
            log_weights = np.log((n * share + prior_rows * opinion) / (n + prior_rows))
    return np.exp(log_weights - logsumexp(log_weights))


def held_out(fit: Fit, X: Matrix, Y: Matrix, rows: Any, loading: Any = None) -> tuple[Matrix, Matrix]:
    """Return mean and variance of the values of some rows, predicted from the other blocks, (len(rows), P) each.

    Hyperparameters are those of the fit; ``loading`` is what noise of the regressors adds at X, if they have any. Where
    outputs are observed together, whole rows are left out. A value that is missing while others are there is learned
    from these, so where an output has gaps, blocks are left out of one output at a time.
    """
    posterior, noise = fit.posterior, fit.learned.noise
    loading = None if loading is None else loading[rows]
    X, Y, step = X[rows], Y[rows], len(X) // len(rows)
    inflation = np.maximum(posterior.noise / noise / step, 1.0)
    mean, variance = np.full((2, *Y.shape), np.nan)
    for left_out in _folds(Y):
        rest = np.where(left_out, np.nan, Y)
        data = Data.from_table(X, rest, None if loading is None else loading * np.sqrt(inflation)[:, None])
        inside = np.flatnonzero(left_out.any(axis=1))
        found = posterior.of(data, noise * inflation).predict(X[inside], return_variance=True)
        for values, all_values in zip(found, (mean, variance), strict=True):
            all_values[left_out] = values[left_out[inside]]
    variance += noise
    if loading is not None:
        variance += np.einsum("npr,npr->np", loading, loading)
    return mean, variance


def _folds(Y):
    """Yield masks of the values that are held out together, (n, P)."""
    n, P = Y.shape
    block = np.arange(n) * min(BLOCKS, n) // n
    observed = np.isfinite(Y)
    gaps = P > 1 and (observed.mean(axis=0) < COMPLETE * observed.any(axis=1).mean()).any()
    turn = block[:, None] + (np.arange(P) if gaps else np.zeros(P, dtype=int))
    for fold in range(FOLDS):
        yield (turn % FOLDS == fold) & observed
