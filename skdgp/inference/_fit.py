"""From a kernel without values to a kernel that fits: starting values, a cheap start, the full likelihood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp.inference._exact import Data, log_likelihood
from skdgp.inference._optimize import maximize

SUBSET = 1200  # values: an evaluation costs milliseconds, and the hyperparameters come close
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
    variance = np.nanvar(kernel.unexplained(X, Y), axis=0)
    noise = np.clip(0.2 * variance, 10 * NOISE_BOUNDS[0], None)
    theta = np.concatenate([kernel.theta, np.log(noise)])
    data = Data.from_table(X, Y)
    if optimizer is None:
        value = log_likelihood(kernel, noise, data)
        return Fit(kernel, noise, value, 0, 1, False)
    bounds = np.concatenate([kernel.bounds, np.tile(np.log(NOISE_BOUNDS), (P, 1))])
    theta = theta + spread * random_state.normal(size=theta.shape)
    n_evaluations = 0
    if data.n_values > 2 * SUBSET:
        rows = np.sort(random_state.permutation(len(X))[: max(2, SUBSET * len(X) // data.n_values)])
        part = Data.from_table(X[rows], Y[rows])
        start = maximize(
            objective(kernel, part, P), theta, bounds, optimizer=optimizer, max_iter=max_iter, stage="subset"
        )
        theta, n_evaluations = start.theta, start.n_evaluations
        if start.interrupted:
            max_iter = 0
    best = maximize(objective(kernel, data, P), theta, bounds, optimizer=optimizer, max_iter=max_iter, stage="fit")
    return Fit(
        kernel.clone_with_theta(best.theta[:-P]),
        np.exp(best.theta[-P:]),
        best.value,
        best.n_iter,
        n_evaluations + best.n_evaluations,
        best.interrupted,
    )
