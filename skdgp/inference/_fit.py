"""From a kernel without values to a posterior: starting values, hyperparameters, the state of knowledge."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np
from sklearn.cluster import KMeans
from sklearn.utils import check_random_state

from skdgp._linalg import column_scale
from skdgp._parallel import sharing
from skdgp._threads import thread_map
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data, log_likelihood
from skdgp.inference._optimize import maximize
from skdgp.inference._shares import shares_of
from skdgp.inference._sparse import SparsePosterior

SINGLE, SINGLE_ITERATIONS = 800, 100  # values and iterations for each output alone
STRETCHES, TRY_ITERATIONS = (1.0, 0.3, 0.1), 40  # widths tried first, and how long
SUBSET = 2400  # values of the exact fit from which the sparse one starts
NOISE_BOUNDS = (1e-6, 1e2)  # of the variance of an output


class Fit(NamedTuple):
    """A posterior and how its hyperparameters were found."""

    posterior: ExactPosterior | SparsePosterior
    n_iter: int
    n_evaluations: int
    interrupted: bool
    rising: bool = False


def fit_exact(kernel, X, Y, *, optimizer, max_iter, random_state, spread=0.0) -> Fit:
    """Return the exact posterior at the best hyperparameters found from one starting point.

    Parameters
    ----------
    kernel : MultiOutputKernel
        What it leaves open is taken from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    optimizer : "fmin_l_bfgs_b", callable or None
        None keeps the starting values.
    max_iter : int
        Iterations on the joint likelihood.
    random_state : int, RandomState or None
    spread : float
        Standard deviation of what is added to the starting theta: for restarts.
    """
    random_state = check_random_state(random_state)
    P = Y.shape[1]
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise_bounds = np.multiply.outer(column_scale(Y) ** 2, NOISE_BOUNDS)
    noise = np.clip(0.2 * np.nanvar(kernel.unexplained(X, Y), axis=0), *noise_bounds.T)
    data = Data.from_table(X, Y)
    if optimizer is None:
        return Fit(ExactPosterior(kernel, noise, data), 0, 0, False)
    stop = Event()
    search = partial(maximize, optimizer=optimizer, stop=stop)
    singles, n_evaluations, n_iter = None, 0, 0
    if P > 1 and not open_kernel.is_given():
        singles, noise, n_evaluations = _single_outputs(open_kernel, noise, noise_bounds, X, Y, search, random_state)

    def climb(kernel, noise, max_iter, spread=0.0):
        theta = np.concatenate([kernel.theta, np.log(noise)])
        theta += spread * random_state.normal(size=theta.shape)
        best = search(_likelihood(kernel, data, P), theta, _bounds(kernel, noise_bounds), max_iter=max_iter)
        return kernel.clone_with_theta(best.theta[:-P]), np.exp(best.theta[-P:]), best

    # From few hyperparameters to many: filters alike over the outputs first. From there the way up is short, and it
    # ends at optima that predict better than those found from arbitrary widths.
    kernel = open_kernel.initialize(X, Y, random_state, singles)
    coarse = open_kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < kernel.n_dims:
        coarse, noise, best = climb(coarse, noise, -(-max_iter // 2), spread)
        n_evaluations, n_iter, spread = n_evaluations + best.n_evaluations, best.n_iter, 0.0
        kernel = open_kernel.initialize(X, Y, random_state, singles, coarse)
    kernel, noise, best = climb(kernel, noise, max_iter - n_iter, spread)
    n_evaluations, n_iter = n_evaluations + best.n_evaluations, n_iter + best.n_iter
    return Fit(ExactPosterior(kernel, noise, data), n_iter, n_evaluations, stop.is_set(), best.rising)


def fit_sparse(kernel, X, Y, *, n_inducing, optimizer, max_iter, random_state, spread=0.0) -> Fit:
    """Return the sparse posterior on all samples, started from an exact fit of some of them.

    Parameters are those of ``fit_exact``, and

    n_inducing : int
        Inducing inputs of each latent process; they start at the centres of k-means and are learned.
    """
    random_state = check_random_state(random_state)
    shares = shares_of(Data.from_table(X, Y))
    rows = _some_rows(Y, random_state)
    first = fit_exact(
        kernel, X[rows], Y[rows], optimizer=optimizer, max_iter=max_iter, random_state=random_state, spread=spread
    )
    kernel, noise = first.posterior.kernel, first.posterior.noise
    noise_bounds = np.multiply.outer(column_scale(Y) ** 2, NOISE_BOUNDS)
    features = kernel.features(_centres(X, n_inducing, random_state))
    if optimizer is None or first.interrupted:
        return first._replace(posterior=SparsePosterior(kernel, features, noise, shares))
    n, P = kernel.n_dims, Y.shape[1]

    def rebuilt(theta):
        new = kernel.clone_with_theta(theta[:n])
        return SparsePosterior(new, features.rebuild(new, theta[n + P :]), np.exp(theta[n : n + P]), shares)

    def bound(theta):
        posterior = rebuilt(theta)
        return posterior.log_marginal_likelihood, posterior.bound_gradient()

    theta = np.concatenate([kernel.theta, np.log(noise), features.theta])
    bounds = np.concatenate([_bounds(kernel, noise_bounds), features.bounds])
    with sharing(shares):
        best = maximize(bound, theta, bounds, optimizer=optimizer, max_iter=max_iter, stage="bound")
    n_evaluations = first.n_evaluations + best.n_evaluations
    return Fit(rebuilt(best.theta), best.n_iter, n_evaluations, best.interrupted, best.rising)


def _some_rows(Y, random_state):
    """Return rows with about SUBSET observed values, every output among them as often as its share allows."""
    seen = np.isfinite(Y)
    order = random_state.permutation(len(Y))
    quota = SUBSET // Y.shape[1]
    chosen = order[: max(2, SUBSET * len(Y) // seen.sum())]
    for output in seen.T:
        lacking = min(quota, output.sum()) - output[chosen].sum()
        rest = np.setdiff1d(order, chosen, assume_unique=True)
        chosen = np.concatenate([chosen, rest[output[rest]][: max(lacking, 0)]])
    return np.sort(chosen)


def _centres(X, n_inducing, random_state):
    """Return at most n_inducing centres of the samples, (k, d)."""
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    some = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    scale = np.where(X.std(axis=0) > 0, X.std(axis=0), 1.0)
    means = KMeans(n_inducing, n_init=1, random_state=random_state).fit(some / scale)
    return means.cluster_centers_ * scale


def _likelihood(kernel, data, n_outputs):
    """Return the log likelihood as a function of [theta, log noise]."""

    def evaluate(theta):
        noise = np.exp(theta[-n_outputs:])
        return log_likelihood(kernel.clone_with_theta(theta[:-n_outputs]), noise, data, eval_gradient=True)

    return evaluate


def _bounds(kernel, noise_bounds):
    return np.concatenate([kernel.bounds, np.log(noise_bounds)])


def _single_outputs(kernel, noise, noise_bounds, X, Y, search, random_state):
    """Return kernel and noise of a fit of each output alone, and what that cost.

    A single output has a P-th of the values: its fit costs a P^3-th of the joint one, and finds trend, widths and
    noise nearly where the joint fit ends.
    """
    states = [np.random.RandomState(seed) for seed in random_state.randint(2**31 - 1, size=Y.shape[1])]

    def fit_one(i):
        seen = np.flatnonzero(np.isfinite(Y[:, i]))
        rows = seen[np.sort(states[i].permutation(len(seen))[:SINGLE])]
        x, y = X[rows], Y[rows, i : i + 1]
        data = Data.from_table(x, y)

        def climb(single, theta, max_iter):
            bounds = _bounds(single, noise_bounds[i : i + 1])
            likelihood = _likelihood(single, data, 1)
            return single, search(likelihood, theta, bounds, max_iter=max_iter, stage=f"output {i + 1}")

        # From widths that are far too long, "all noise" is the nearest hill.
        starts = [kernel.single().initialize(x, y, states[i], stretch=stretch) for stretch in STRETCHES]
        tries = [climb(start, np.append(start.theta, np.log(noise[i])), TRY_ITERATIONS) for start in starts]
        single, best = max(tries, key=lambda end: end[1].value)
        single, end = climb(single, best.theta, SINGLE_ITERATIONS)
        n_evaluations = end.n_evaluations + sum(tried.n_evaluations for _, tried in tries)
        return single.clone_with_theta(end.theta[:-1]), np.exp(end.theta[-1]), n_evaluations

    singles, noises, n_evaluations = zip(*thread_map(fit_one, range(Y.shape[1]), search.keywords["stop"]), strict=True)
    return list(singles), np.array(noises), sum(n_evaluations)
