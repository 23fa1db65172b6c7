"""From a kernel without values to a kernel that fits: starting values, a cheap start, the full likelihood."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._threads import thread_map
from skdgp.inference._exact import Data, log_likelihood
from skdgp.inference._optimize import maximize

SINGLE, SINGLE_ITERATIONS = 800, 100  # values and iterations for each output alone
NOISE_BOUNDS = (1e-6, 1e2)


class Fit(NamedTuple):
    """Fitted hyperparameters and how they were found."""

    kernel: object
    noise: np.ndarray
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool


def objective(kernel, data, n_outputs):
    """Return the log likelihood as a function of [theta, log noise]."""

    def evaluate(theta):
        noise = np.exp(theta[-n_outputs:])
        return log_likelihood(kernel.clone_with_theta(theta[:-n_outputs]), noise, data, eval_gradient=True)

    return evaluate


def fit_hyperparameters(kernel, X, Y, *, optimizer, max_iter, random_state, spread=0.0):
    """Return the fit from one starting point.

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
        Iterations on the full data.
    random_state : int, RandomState or None
    spread : float
        Standard deviation of what is added to the starting theta: for restarts.
    """
    random_state = check_random_state(random_state)
    P = Y.shape[1]
    kernel = kernel.initialize(X, Y, random_state)
    noise = _starting_noise(kernel, X, Y)
    data = Data.from_table(X, Y)
    if optimizer is None:
        return Fit(kernel, noise, log_likelihood(kernel, noise, data), 0, 1, False)
    stop = Event()
    search = partial(maximize, optimizer=optimizer, stop=stop)
    n_evaluations = 0
    if P > 1:
        kernel, noise, n_evaluations = _from_single_outputs(kernel, noise, X, Y, search, random_state)
    theta = np.concatenate([kernel.theta, np.log(noise)])
    theta += spread * random_state.normal(size=theta.shape)
    best = search(objective(kernel, data, P), theta, _bounds(kernel, P), max_iter=max_iter)
    return Fit(
        kernel.clone_with_theta(best.theta[:-P]),
        np.exp(best.theta[-P:]),
        best.value,
        best.n_iter,
        n_evaluations + best.n_evaluations,
        stop.is_set(),
    )


def _starting_noise(kernel, X, Y):
    return np.clip(0.2 * np.nanvar(kernel.unexplained(X, Y), axis=0), 10 * NOISE_BOUNDS[0], None)


def _bounds(kernel, n_outputs):
    return np.concatenate([kernel.bounds, np.tile(np.log(NOISE_BOUNDS), (n_outputs, 1))])


def _from_single_outputs(kernel, noise, X, Y, search, random_state):
    """Return kernel and noise started from a fit of each output alone, and what that cost.

    A single output has a P-th of the values: its fit costs a P^3-th of the joint one, and finds trend, widths and
    noise nearly where the joint fit ends.
    """
    states = [np.random.RandomState(seed) for seed in random_state.randint(2**31 - 1, size=Y.shape[1])]

    def fit_one(i):
        seen = np.flatnonzero(np.isfinite(Y[:, i]))
        rows = seen[np.sort(states[i].permutation(len(seen))[:SINGLE])]
        x, y = X[rows], Y[rows, i : i + 1]
        single = kernel.single().initialize(x, y, states[i])
        theta = np.append(single.theta, np.log(noise[i]))
        log_likelihood_i = objective(single, Data.from_table(x, y), 1)
        best = search(log_likelihood_i, theta, _bounds(single, 1), max_iter=SINGLE_ITERATIONS, stage=f"output {i + 1}")
        return single.clone_with_theta(best.theta[:-1]), np.exp(best.theta[-1]), best.n_evaluations

    singles, noises, n_evaluations = zip(*thread_map(fit_one, range(Y.shape[1]), search.keywords["stop"]), strict=True)
    return kernel.adopt(list(singles)), np.array(noises), sum(n_evaluations)
