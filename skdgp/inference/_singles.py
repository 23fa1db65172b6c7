"""Fits of each output alone, which give the starting point of the joint fit."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import NamedTuple

import numpy as np

from skdgp._compute.threads import thread_map
from skdgp.inference._likelihood import Data, log_likelihood
from skdgp.inference._optimize import maximize

VALUES, ITERATIONS = 800, 100  # of each output
STRETCHES, TRY_VALUES, TRY_ITERATIONS = (1.0, 0.3, 0.1), 250, 40  # widths tried before, on how many values, how long


class Singles(NamedTuple):
    """Kernel and noise of each output alone, and the evaluations that they took."""

    kernels: list
    noise: np.ndarray
    n_evaluations: int


class _Output:
    """The values of one output, and the ways up its likelihood."""

    def __init__(self, i, X, Y, noise, noise_bounds, seed, search):
        rows = spread(np.flatnonzero(np.isfinite(Y[:, i])), VALUES, np.random.RandomState(seed))
        self.x, self.y, self.seed = X[rows], Y[rows, i : i + 1], seed
        self.noise, self.noise_bounds = noise[i], noise_bounds[i : i + 1]
        self.search = partial(search, stage=f"output {i + 1}")

    def climb(self, kernel, theta, step, max_iter, name=None):
        """Return the kernel without values and the Optimum from theta on, of every step-th value."""
        data = Data.from_table(self.x[::step], self.y[::step])
        bounds = bounds_of(kernel, self.noise_bounds)
        return kernel, self.search(likelihood_of(kernel, data, 1), theta, bounds, max_iter=max_iter, name=name)

    def attempt(self, kernel, width_factor, max_iter):
        """Return where a few of the values lead from one width."""
        start = kernel.single_output().initialize(
            self.x, self.y, np.random.RandomState(self.seed), width_factor=width_factor
        )
        theta = np.append(start.theta, np.log(self.noise))
        name = f"{self.search.keywords['stage']} from {width_factor}"
        return self.climb(start, theta, max(1, len(self.x) // TRY_VALUES), min(TRY_ITERATIONS, max_iter), name)


def fit_singles(kernel, noise, noise_bounds, X, Y, optimizer, max_iter, random_state, stop: Event) -> Singles:
    """Return a fit of each output alone, in at most twice ``max_iter`` iterations each.

    A single output has a P-th of the values: its fit costs a P^3-th of the joint one. From widths that are far too
    long, "all noise" is the nearest hill: which hill it is, some of the values tell, from several widths.
    """
    search = partial(maximize, optimizer=optimizer, stop=stop)
    seeds = random_state.randint(2**31 - 1, size=Y.shape[1])
    outputs = [_Output(i, X, Y, noise, noise_bounds, seed, search) for i, seed in enumerate(seeds)]
    tasks = [(output, width_factor) for output in outputs for width_factor in STRETCHES]
    tries = thread_map(lambda task: task[0].attempt(kernel, task[1], max_iter), tasks, stop)
    n = len(STRETCHES)
    best = [max(tries[k : k + n], key=lambda end: end[1].value) for k in range(0, len(tries), n)]

    def refine(task):
        output, (single, optimum) = task
        return output.climb(single, optimum.theta, 1, min(ITERATIONS, 2 * max_iter))

    ends = thread_map(refine, zip(outputs, best, strict=True), stop)
    return Singles(
        [single.clone_with_theta(end.theta[:-1]) for single, end in ends],
        np.array([np.exp(end.theta[-1]) for _, end in ends]),
        sum(end.n_evaluations for _, end in (*tries, *ends)),
    )


def likelihood_of(kernel, data, n_outputs):
    """Return the log likelihood, and what the kernel's prior adds to it, as a function of [theta, log noise]."""
    workspace = np.empty((data.n_values, data.n_values))

    def evaluate(theta):
        kernel_there, noise = kernel.clone_with_theta(theta[:-n_outputs]), np.exp(theta[-n_outputs:])
        value, gradient = log_likelihood(kernel_there, noise, data, eval_gradient=True, workspace=workspace)
        prior, slope = kernel_there.log_prior(eval_gradient=True)
        gradient[: len(slope)] += slope
        return value + prior, gradient

    return evaluate


def bounds_of(kernel, noise_bounds):
    """Return the bounds of [theta, log noise]."""
    return np.concatenate([kernel.bounds, np.log(noise_bounds)])


def spread(rows, n, random_state):
    """Return n of the rows, spread over them: in a log neighbours say the same. One by chance of each n-th part."""
    if n >= len(rows):
        return rows
    edges = np.linspace(0, len(rows), n + 1)
    return rows[(edges[:-1] + np.diff(edges) * random_state.uniform(size=n)).astype(int)]
