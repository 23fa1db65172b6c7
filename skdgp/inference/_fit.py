"""Fits: starting values, hyperparameters, posterior."""

from __future__ import annotations

from threading import Event
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import check_memory, cluster_centres, column_scale, output_scale
from skdgp._compute.parallel import sharing
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data
from skdgp.inference._optimize import maximize
from skdgp.inference._repeats import autocorrelation_time
from skdgp.inference._samples import shares_of
from skdgp.inference._singles import bounds_of, fit_singles, likelihood_of, spread
from skdgp.inference._sparse import SparsePosterior, maximize_features

SUBSET = 2400  # values that sparse inference learns hyperparameters from jointly
FEATURE_ITERATIONS = 12  # on the bound: where the inducing inputs stand and how wide they look
SETTLING = 10  # steps, at most, to the noise that all values show
NOISE_BOUNDS = (1e-6, 1e2)  # of the variance of an output
INPUT_BOUNDS = (1e-7, 0.3)  # of the variance of a regressor
LEAST_OWN = 0.01  # of an output's noise is its own


class Fit(NamedTuple):
    """A posterior, and how its hyperparameters were found.

    ``noise`` (P,) is the variance of a measurement, which in a sparse posterior counts for less where neighbours repeat
    each other; ``root`` (d, r) is R of the regressors' noise, R R^T, where they are noisy; ``value`` is the likelihood,
    or its bound, and the kernel's prior with it: by it fits of the same data can be compared.
    """

    posterior: ExactPosterior | SparsePosterior
    noise: np.ndarray
    root: np.ndarray | None
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool = False
    rising: bool = False
    converged: bool = True

    def found(self, interrupted: bool) -> Found:
        """Return the hyperparameters of an exact fit, to be taken for other values."""
        story = self.n_iter, self.n_evaluations, interrupted, self.rising, self.converged
        return Found(self.posterior.kernel, self.noise, self.root, *story)


class Found(NamedTuple):
    """Hyperparameters, and how they were found."""

    kernel: object
    noise: np.ndarray
    root: np.ndarray | None = None
    n_iter: int = 0
    n_evaluations: int = 0
    interrupted: bool = False
    rising: bool = False
    converged: bool = True

    def fit(self, posterior, value=None, more=None) -> Fit:
        """Return the posterior with the story of how it was found; ``more`` is an Optimum that followed."""
        value = posterior.log_marginal_likelihood if value is None else value
        n_evaluations = self.n_evaluations + (more.n_evaluations if more else 0)
        interrupted = self.interrupted or bool(more and more.interrupted)
        value += posterior.kernel.log_prior()
        story = self.n_iter, n_evaluations, interrupted, self.rising, self.converged
        return Fit(posterior, self.noise, self.root, value, *story)


def fit_exact(kernel, X, Y, *, optimizer, max_iter, random_state, input_noise=None, spread=0.0, found=None) -> Fit:
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
    input_noise : ndarray (d, r), "learned" or None
        R of the covariance R R^T of the regressors' noise; or a variance for each regressor is learned.
    spread : float
        Standard deviation of what is added to the starting theta: for restarts.
    found : Found or None
        Hyperparameters to take as they are.

    Returns
    -------
    Fit
        The posterior, its hyperparameters, and how the search went.
    """
    if found is None:
        options = optimizer, max_iter, check_random_state(random_state), input_noise, spread
        found, data = _learn(kernel.prepared(X), X, Y, slice(None), *options)
    else:
        data = _carried(Data.from_table(X, Y), found, X, Y)
    return found.fit(ExactPosterior(found.kernel, found.noise, data))


def fit_sparse(
    kernel, X, Y, *, n_inducing, optimizer, max_iter, random_state, input_noise=None, spread=0.0, found=None
) -> Fit:
    """Return the sparse posterior on all samples, at hyperparameters learned from some of them.

    Parameters
    ----------
    kernel, X, Y
        As for ``fit_exact``.
    n_inducing : int
        Inducing inputs of each latent process; they start at the centres of k-means and are learned.
    optimizer, max_iter, random_state, input_noise, spread, found
        As for ``fit_exact``.

    Returns
    -------
    Fit
        The posterior, its hyperparameters, and how the search went.

    Raises
    ------
    ValueError
        When matrices of all inducing variables would not fit the machine's memory.
    """
    random_state, kernel = check_random_state(random_state), kernel.prepared(X)
    Z = _centres(X, n_inducing, random_state)
    size = kernel.initialize(X, Y, np.random.RandomState(0)).features(Z).size
    check_memory(size, "Sparse inference with", "Lower n_inducing.", n_matrices=8)
    if found is None:
        rows = some_rows(Y, random_state)
        found, _ = _learn(kernel, X, Y, rows, optimizer, max_iter, random_state, input_noise, spread)
    kernel, features = found.kernel, found.kernel.features(Z)
    shares = shares_of(Data.from_table(X, Y))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, found.noise, shares)
        if optimizer is None:
            return _reached(found, posterior, X, Y, 1.0)
        least = NOISE_BOUNDS[0] * output_scale(Y) ** 2
        posterior = _settled(posterior, 1.0, least)
        value, repeats = posterior.log_marginal_likelihood, _repeats(posterior, X, Y)
        # From here on so many neighbours in the log count as one: what each says is known with that much more noise.
        posterior = _settled(posterior, repeats, least)
        noise = posterior.noise
        found = found._replace(noise=noise / repeats)
    if found.interrupted:
        return _reached(found, posterior, X, Y, repeats, value)
    features, best = _learn_features(features, kernel, noise, X, Y, int(repeats.min()))
    with sharing(shares):
        posterior = SparsePosterior(kernel, features, noise, shares)
    return _reached(found, posterior, X, Y, repeats, value, best)


def _reached(found, posterior, X, Y, repeats, value=None, more=None) -> Fit:
    """Return the fit, where regressors are noisy with the noise that they carry, of what had seemed each output's own.

    ``repeats`` (P,) neighbours count as one, in this as in the rest of the noise.
    """
    if found.root is None:
        return found.fit(posterior, value, more)
    reach = reach_of(posterior, X, found.root)
    carried = np.mean(np.einsum("npr,npr->np", reach, reach), axis=0)
    noise = np.maximum(found.noise - carried, LEAST_OWN * found.noise)
    shares = shares_of(Data.from_table(X, Y, reach * np.sqrt(repeats * np.ones(len(noise)))[:, None]))
    with sharing(shares):
        posterior = SparsePosterior(posterior.kernel, posterior.features, noise * repeats, shares)
    return found._replace(noise=noise).fit(posterior, value, more)


def _learn_features(features, kernel, noise, X, Y, step):
    """Return the best features and the Optimum they are of: of neighbours that repeat each other one is enough."""
    shares = shares_of(Data.from_table(X[::step], Y[::step]))
    with sharing(shares):
        start = SparsePosterior(kernel, features, noise / step, shares)
        return maximize_features(start, column_scale(X), max_iter=FEATURE_ITERATIONS, stage="bound")


def _settled(posterior, repeats, least):
    """Return the posterior at the noise that all values together show, each counted as one in so many."""
    for _ in range(SETTLING):
        noise = np.maximum(posterior.noise_seen(), least)
        change = np.abs(np.log(noise * repeats / posterior.noise)).max()
        posterior = posterior.with_noise(noise * repeats)
        if change < 0.01:
            break
    return posterior


def _repeats(posterior, X, Y):
    """Return, for each output, how many neighbouring samples count as one."""
    residual = Y - posterior.predict(X)
    return np.array([autocorrelation_time(e[np.isfinite(e)]) for e in residual.T])


def _learn(kernel, X, Y, rows, optimizer, max_iter, random_state, input_noise, spread) -> tuple[Found, Data]:
    """Return hyperparameters: of each output alone, then of all jointly from the rows; and the values of these."""
    P = Y.shape[1]
    noise_bounds = np.multiply.outer(output_scale(Y) ** 2, NOISE_BOUNDS)
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise = np.clip(0.2 * np.nanvar(kernel.unexplained(X, Y), axis=0), *noise_bounds.T)
    stop = Event()
    singles, n_evaluations, n_iter = None, 0, 0
    if optimizer is not None and P > 1 and not open_kernel.is_given():
        found = fit_singles(open_kernel, noise, noise_bounds, X, Y, optimizer, max_iter, random_state, stop)
        singles, noise, n_evaluations = found
    everything, X, Y = (X, Y), X[rows], Y[rows]
    data = Data.from_table(X, Y)
    if optimizer is None:
        found = Found(kernel, noise, None if isinstance(input_noise, str) else input_noise)
        return found, _carried(data, found, X, Y)

    def climb(name, kernel, noise, bounds, max_iter, data, spread=0.0):
        theta = np.concatenate([kernel.theta, np.log(noise)])
        theta += spread * random_state.normal(size=theta.shape)
        best = maximize(
            likelihood_of(kernel, data, len(noise)),
            theta,
            bounds_of(kernel, bounds),
            optimizer=optimizer,
            max_iter=max_iter,
            name=name,
            stop=stop,
        )
        theta, noise = np.split(best.theta, [-len(noise)])
        return kernel.clone_with_theta(theta), np.exp(noise), best

    # From few hyperparameters to many: filters alike over the outputs first. From there the way up is short, and it
    # ends at optima that predict better than those found from arbitrary widths. Where regressors are noisy, the slopes
    # found on the way say what their noise carries.
    kernel = open_kernel.initialize(X, Y, random_state, singles)
    coarse = open_kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < kernel.n_dims or input_noise is not None:
        coarse, noise, best = climb("coarse", coarse, noise, noise_bounds, -(-max_iter // 2), data, spread)
        n_evaluations, n_iter, spread = n_evaluations + best.n_evaluations, best.n_iter, 0.0
        kernel = open_kernel.initialize(X, Y, random_state, singles, coarse)
    root, bounds = input_noise, noise_bounds
    if isinstance(input_noise, str):
        root, data, noise, more = _start_of_inputs(coarse, noise, data, X, Y, column_scale(everything[0]))
        bounds = np.concatenate([noise_bounds, more])
    elif input_noise is not None:
        data = _carried(data, Found(coarse, noise, root), X, Y)
    kernel, noise, best = climb("fit", kernel, noise, bounds, max_iter - n_iter, data, spread)
    if isinstance(input_noise, str):
        root = root * np.sqrt(noise[P:])
    found = Found(kernel, noise[:P], root, n_iter + best.n_iter, n_evaluations + best.n_evaluations)
    found = found._replace(interrupted=stop.is_set(), rising=best.rising, converged=best.converged)
    return found, _carried(data, found, X, Y)


def reach_of(posterior, X, root) -> np.ndarray:
    """Return where noisy regressors carry the outputs, G = J R, (n, P, r): slopes of the mean times R."""
    return posterior.gradient(X) @ root


def _carried(data, found, X, Y) -> Data:
    """Return the values with the noise that regressors carry, by the slopes of what was found."""
    if found.root is None:
        return data
    return Data.from_table(X, Y, reach_of(ExactPosterior(found.kernel, found.noise, data), X, found.root))


def _start_of_inputs(kernel, noise, data, X, Y, scale):
    """Return R of regressors with noise of variance s each, values that it reaches, noise and s, and bounds of s.

    At the start half of the noise comes from the regressors, each off by the same part of its spread.
    """
    root = np.diag(scale)
    data = _carried(data, Found(kernel, noise, root), X, Y)
    carried = [np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.scatter.reach]
    part = 0.5 * float(np.nanmedian(noise / np.maximum(carried, 1e-12)))
    least, most = INPUT_BOUNDS
    start = np.full(len(scale), np.clip(part, 10 * least, most / 10))
    return root, data, np.concatenate([0.5 * noise, start]), np.tile(INPUT_BOUNDS, (len(scale), 1))


def some_rows(Y, random_state):
    """Return rows with about SUBSET observed values, every output among them as often as its share allows."""
    seen = np.isfinite(Y)
    quota = SUBSET // Y.shape[1]
    chosen = spread(np.arange(len(Y)), max(2, SUBSET * len(Y) // seen.sum()), random_state)
    for output in seen.T:
        lacking = min(quota, output.sum()) - output[chosen].sum()
        rest = np.setdiff1d(np.flatnonzero(output), chosen, assume_unique=True)
        chosen = np.concatenate([chosen, spread(rest, max(lacking, 0), random_state)])
    return np.sort(chosen)


def _centres(X, n_inducing, random_state):
    """Return at most n_inducing centres of the samples, (k, d)."""
    distinct = np.unique(X, axis=0)
    if len(distinct) <= n_inducing:
        return distinct
    some = X[random_state.permutation(len(X))[: 50 * n_inducing]]
    return cluster_centres(some, column_scale(X), n_inducing, random_state)
