"""The search for hyperparameters, in stages.

1. Each output alone (``_singles``).
2. All outputs, with widths that they share.
3. All hyperparameters, until the likelihood or the error of held-out blocks gets no better; in exact inference of many
   values, the last iterations are of all of them.
4. The noise alone, if stage 3 ended by held-out blocks or neglected correlations between outputs.

Stages learn from rows that ``_rows`` chooses.
"""

from __future__ import annotations

from threading import Event
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import column_scale, output_scale
from skdgp._compute.threads import threads_for
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data
from skdgp.inference._objective import Objective, theta_bounds
from skdgp.inference._optimize import GRID, Optimum, maximize
from skdgp.inference._rows import HELD_OUT_ROWS, SEARCH_VALUES, some_rows, stratified
from skdgp.inference._singles import fit_singles

REFINED = 4  # exact inference of many values learns from some of them first, and in the last fourth from all
NOISE_STEPS = 10  # largest number of steps, or of iterations, that change the noise alone
NOISE_BOUNDS = (1e-6, 1e2)  # noise variance over the variance of the output
INPUT_BOUNDS = (1e-7, 0.3)  # noise variance over the variance of the regressor
IRRELEVANT_RISE = 0.05  # expected rise of the likelihood for each value [nats] up to which a search has converged


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search that found them.

    ``noise`` (P,) is white. ``root`` (d, r) is R of the regressors' noise covariance R R^T, None for exact regressors.
    ``remaining`` is the expected rise of the likelihood by further iterations.
    """

    kernel: Any
    noise: Vector
    root: Matrix | None = None
    n_iter: int = 0
    n_evaluations: int = 0
    interrupted: bool = False
    remaining: float = 0.0
    converged: bool = True

    def data(self, X: Matrix, Y: Matrix, passes: int = 2) -> Data:
        """Return the observed values with the noise of the regressors.

        The first pass takes slopes of a fit to exact regressors, the second of one to noisy regressors.
        """
        data = Data.from_table(X, Y)
        if self.root is None:
            return data
        for _ in range(passes):
            loading = input_noise_loading(ExactPosterior(self.kernel, self.noise, data), X, self.root)
            data = Data.from_table(X, Y, loading)
        return data


def input_noise_loading(posterior: Any, X: Matrix, root: Matrix) -> np.ndarray:
    """Return G = J R, (n, P, r): the slopes J of the mean times the root R of the regressors' noise covariance."""
    return posterior.gradient(X) @ root


class _Stages:
    """What the stages of a search of P outputs have in common.

    A noise vector is [sigma^2 (P)], with learned noise of the regressors [sigma^2, s (d)]. ``common``: whether the
    likelihood includes the correlation of the outputs that errors of the regressors cause.
    """

    def __init__(self, P, held_out, optimizer, common, stop):
        self.P, self.held_out = P, held_out
        self.optimizer, self.common, self.stop = optimizer, common, stop
        self.n_evaluations = 0

    def hyperparameters(self, kernel, noise, root) -> Hyperparameters:
        return Hyperparameters(kernel, noise[: self.P], root)

    def run(self, data, kernel, noise, bounds, max_iter) -> tuple[Any, Vector, Optimum]:
        """Return kernel and noise at the end of a stage, and its Optimum."""
        objective = Objective(kernel, data, len(noise), self.held_out, self.common)
        error = None if self.held_out is None else objective.held_out_error
        return self._maximize(objective, noise, theta_bounds(kernel, bounds), max_iter, error)

    def run_noise(self, data, kernel, noise, bounds, stage="fit") -> Vector:
        """Return the noise that is best for this kernel."""
        objective, bounds = Objective(kernel, data, len(noise)), theta_bounds(kernel, bounds)
        bounds[: kernel.n_dims] = kernel.theta[:, None]
        return self._maximize(objective, noise, bounds, NOISE_STEPS, stage=stage)[1]

    def _maximize(self, objective, noise, bounds, max_iter, error=None, stage="fit"):
        theta = np.concatenate([objective.kernel.theta, np.log(noise)])
        options = {"optimizer": self.optimizer, "max_iter": max_iter, "stop": self.stop, "grid": GRID, "stage": stage}
        with threads_for(objective.data.n_values):
            best = maximize(objective, theta, bounds, **options, held_out_error=error)
        self.n_evaluations += best.n_evaluations
        theta, noise = np.split(best.theta, [-len(noise)])
        return objective.kernel.clone_with_theta(theta), np.exp(noise), best


def search(
    kernel: Any,
    X: Matrix,
    Y: Matrix,
    rows: Any,
    *,
    optimizer: Any,
    max_iter: int,
    random_state: Any,
    input_noise: Any,
    held: Any = None,
    exact: bool = False,
) -> Hyperparameters:
    """Return hyperparameters, learned from each output separately and then from ``rows`` of all outputs jointly.

    The joint search stops when the error at the rows ``held`` no longer falls. This error says nothing about the noise,
    and without ``exact`` the search neglects the correlation of outputs by errors of the regressors, so noise is
    learned again at the end. The other arguments are those of ``fit_exact``.
    """
    P, held_out, whole = Y.shape[1], None, (X, Y)
    if held is not None:
        some = stratified(held, HELD_OUT_ROWS, random_state)
        held_out, Y = Data.from_table(X[some], Y[some]), np.array(Y)
        Y[held] = np.nan
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise, noise_bounds = _initial_noise(kernel.residual(X, Y), output_scale(Y))
    stop, singles, n_singles = Event(), None, 0
    if optimizer is not None and P > 1 and not open_kernel.has_values():
        singles, noise, n_singles = fit_singles(
            open_kernel, noise, noise_bounds, X, Y, optimizer, max_iter, random_state, stop
        )
    scale, X, Y = column_scale(X), X[rows], Y[rows]
    stages = _Stages(P, held_out, optimizer, exact, stop)
    learned_root = isinstance(input_noise, str)
    root = np.diag(scale) if learned_root else input_noise
    if optimizer is None:
        return stages.hyperparameters(kernel, noise, None if learned_root else root)
    data, bounds, n_iter = Data.from_table(X, Y), noise_bounds, 0
    # First few hyperparameters (widths shared by all outputs), then all of them. This start needs few iterations and
    # ends at optima that predict better than those reached from arbitrary widths. With noisy regressors, the slopes of
    # the coarse model propagate their noise to the outputs.
    kernel = open_kernel.initialize(X, Y, random_state, singles)
    coarse = open_kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < kernel.n_dims or root is not None:
        coarse, noise, best = stages.run(data, coarse, noise, bounds, -(-max_iter // 2))
        n_iter = best.n_iter
        kernel = open_kernel.initialize(X, Y, random_state, singles, coarse)
    if root is not None:
        data = stages.hyperparameters(coarse, noise, root).data(X, Y, 1)
    if learned_root:
        noise, input_bounds = _initial_input_noise(noise, data, len(scale))
        bounds = np.concatenate([noise_bounds, input_bounds])
    most, refined = max_iter - n_iter, exact and held_out is None and len(X) < len(whole[0])
    kernel, noise, best = stages.run(data, kernel, noise, bounds, most - refined * (most // REFINED))
    if refined and not stop.is_set():
        n_iter += best.n_iter
        data = stages.hyperparameters(kernel, noise, root).data(*whole, 1)
        kernel, noise, best = stages.run(data, kernel, noise, bounds, most // REFINED)
    n_values = data.n_values
    noise_is_left = held_out is not None if exact else learned_root
    if noise_is_left and not (callable(optimizer) or stop.is_set()):
        # That of all blocks; in sparse inference the white noise is learned again from all samples.
        some = some_rows(whole[1], random_state)
        noise_X, noise_Y = (whole[0][some], whole[1][some]) if exact else (X[::2], Y[::2])
        data = stages.hyperparameters(kernel, noise, root).data(noise_X, noise_Y, 1)
        noise = stages.run_noise(data, kernel, noise, bounds)
    if learned_root:
        root = root * np.sqrt(noise[len(noise_bounds) :])
    return stages.hyperparameters(kernel, noise, root)._replace(
        n_iter=n_iter + best.n_iter,
        n_evaluations=n_singles + stages.n_evaluations,
        interrupted=stop.is_set(),
        remaining=best.remaining,
        converged=bool(best.converged or best.remaining <= IRRELEVANT_RISE * n_values),
    )


def noise_alone(kernel: Any, X: Matrix, Y: Matrix, data: Data) -> tuple[Vector, int]:
    """Return the noise (P,) that is best for a kernel, and the number of evaluations of the likelihood it took.

    It is learned from at most 1800 of the values of X and Y. Raises KeyboardInterrupt after Ctrl-C.
    """
    step, stop = -(-data.n_values // SEARCH_VALUES[1]), Event()
    noise, bounds = _initial_noise(kernel.residual(X, Y), output_scale(Y))
    stages = _Stages(Y.shape[1], None, "fmin_l_bfgs_b", True, stop)
    found = stages.run_noise(data.every(step), kernel, noise, bounds, "members")
    if stop.is_set():
        raise KeyboardInterrupt
    return found, stages.n_evaluations


def _initial_noise(residual, scale):
    """Return the starting noise variances (P,) and their bounds."""
    bounds = np.multiply.outer(scale**2, NOISE_BOUNDS)
    return np.clip(0.2 * np.nanvar(residual, axis=0), *bounds.T), bounds


def _initial_input_noise(noise, data, d):
    """Return the noise vector with starting factors s (d,) of the regressors' noise variances, and bounds of s.

    At the start, half of each output's noise comes from the regressors, with equal factors s.
    """
    propagated = [np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.sample_noise.loading]
    part = 0.5 * float(np.nanmedian(noise / np.maximum(propagated, 1e-12)))
    least, most = INPUT_BOUNDS
    start = np.full(d, np.clip(part, 10 * least, most / 10))
    return np.concatenate([0.5 * noise, start]), np.tile(INPUT_BOUNDS, (d, 1))
