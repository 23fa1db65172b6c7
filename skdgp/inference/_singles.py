"""Fits of single outputs: the starting point of the joint search."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.threads import one_blas_thread
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._objective import Objective, theta_bounds
from skdgp.inference._optimize import GRID, maximize
from skdgp.inference._rows import stratified

SINGLE_VALUES, SINGLE_ITERATIONS = 400, 100  # largest numbers for each output
WIDTH_FACTORS = (1.0, 0.3, 0.1)  # starting widths of the short trials, over those of ``initialize``
TRIAL_VALUES, TRIAL_ITERATIONS = 150, 40  # largest numbers for each trial
TOLERANCE = 1e-5  # rise of the likelihood by one iteration, as a fraction for each process, below which it is the last


class Singles(NamedTuple):
    """Kernel and noise of a separate fit of each output, and the number of evaluations."""

    kernels: list
    noise: np.ndarray
    n_evaluations: int


class _SingleFit:
    """The values of one output and the maximisation of its likelihood."""

    def __init__(self, i, X, Y, noise, noise_bounds, seed, search):
        rows = stratified(np.flatnonzero(np.isfinite(Y[:, i])), SINGLE_VALUES, np.random.RandomState(seed))
        self.x, self.y, self.seed = X[rows], Y[rows, i : i + 1], seed
        self.noise, self.noise_bounds = noise[i : i + 1], noise_bounds[i : i + 1]
        self.search = partial(search, stage=f"output {i + 1}")

    def optimize(self, kernel, theta, step, max_iter):
        """Return the kernel and the Optimum reached from theta, with every ``step``-th value."""
        likelihood = Objective(kernel, Data.from_table(self.x[::step], self.y[::step]), 1)
        bounds = theta_bounds(kernel, self.noise_bounds)
        return kernel, self.search(likelihood, theta, bounds, max_iter=max_iter)

    def try_widths(self, kernel, max_iter):
        """Return the best kernel and Optimum of short searches from several widths, and their number of evaluations."""
        step, max_iter = max(1, len(self.x) // TRIAL_VALUES), min(TRIAL_ITERATIONS, max_iter)
        trials: dict = {}  # by their start: a trend has no widths
        for factor in WIDTH_FACTORS:
            start = kernel.single_output().initialize(
                self.x, self.y, np.random.RandomState(self.seed), width_factor=factor
            )
            theta = np.concatenate([start.theta, np.log(self.noise)])
            if theta.tobytes() not in trials:
                trials[theta.tobytes()] = self.optimize(start, theta, step, max_iter)
        n_evaluations = sum(optimum.n_evaluations for _, optimum in trials.values())
        return *max(trials.values(), key=lambda trial: trial[1].value), n_evaluations


@one_blas_thread()  # and one after another: two threads gain nothing on small matrices
def fit_singles(
    kernel: Any,
    noise: Vector,
    noise_bounds,
    X: Matrix,
    Y: Matrix,
    optimizer: Any,
    max_iter: int,
    random_state: Any,
    stop: Event,
) -> Singles:
    """Return a separate fit of each output, with at most twice ``max_iter`` iterations each.

    A single output has 1/P of the values, so an evaluation costs 1/P^3 of a joint one. From widths that are much too
    long, the nearest optimum explains everything as noise. Short trials from several widths avoid it.
    """
    tolerance = TOLERANCE * max(1, kernel.n_processes)
    search = partial(maximize, optimizer=optimizer, stop=stop, tolerance=tolerance, grid=GRID)
    seeds = random_state.randint(2**31 - 1, size=Y.shape[1])
    outputs = [_SingleFit(i, X, Y, noise, noise_bounds, seed, search) for i, seed in enumerate(seeds)]
    trials = [output.try_widths(kernel, max_iter) for output in outputs]
    most = min(SINGLE_ITERATIONS, 2 * max_iter)
    refined = [
        output.optimize(single, optimum.theta, 1, most)
        for output, (single, optimum, _) in zip(outputs, trials, strict=True)
    ]
    return Singles(
        [single.clone_with_theta(optimum.theta[:-1]) for single, optimum in refined],
        np.concatenate([np.exp(optimum.theta[-1:]) for _, optimum in refined]),
        sum(trial[2] for trial in trials) + sum(optimum.n_evaluations for _, optimum in refined),
    )
