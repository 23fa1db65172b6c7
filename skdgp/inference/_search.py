"""The search for hyperparameters, in stages.

1. Each output alone (``_fit_singles``).
2. All outputs, with widths that they share.
3. All hyperparameters.
4. The noise alone, if stage 3 neglected correlations between outputs.

Stages learn from ``some_rows``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import LbfgsInvHessProduct, minimize

from skdgp._compute.linalg import column_scale, output_scale
from skdgp._compute.parallel import one_blas_thread, threads_for
from skdgp._compute.progress import notify
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._exact import ExactPosterior
from skdgp.inference._likelihood import Data, couplings, log_likelihood

NOISE_STEPS = 10  # largest number of steps, or of iterations, that change the noise alone
NOISE_BOUNDS = (1e-6, 1e2)  # noise variance over the variance of the output
INPUT_BOUNDS = (1e-7, 0.3)  # noise variance over the variance of the regressor
IRRELEVANT_RISE = (
    0.05  # expected rise of the likelihood for each value [nats] up to which a search has converged
)


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search that found them.

    ``noise`` (P,) is white. ``root`` (d, r) is R of the regressors' noise covariance R R^T, None
    for exact regressors. ``remaining`` is the expected rise of the likelihood by further
    iterations.
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

        The first pass takes slopes of a fit to exact regressors, the second of one to noisy
        regressors.
        """
        data = Data.from_table(X, Y)
        if self.root is None:
            return data
        for _ in range(passes):
            loading = input_noise_loading(
                ExactPosterior(self.kernel, self.noise, data), X, self.root
            )
            data = Data.from_table(X, Y, loading)
        return data


def input_noise_loading(posterior: Any, X: Matrix, root: Matrix) -> np.ndarray:
    """Return G = J R, (n, P, r): the slopes J of the mean times the root R of the regressors' noise covariance."""
    return posterior.gradient(X) @ root


class _Stages:
    """What the stages of a search of P outputs have in common.

    A noise vector is [sigma^2 (P)], with learned noise of the regressors [sigma^2, s (d)].
    ``common`` is that of `Objective`.
    """

    def __init__(self, P, optimizer, common, stop):
        self.P = P
        self.optimizer = optimizer
        self.common = common
        self.stop = stop
        self.n_evaluations = 0

    def hyperparameters(self, kernel, noise, root) -> Hyperparameters:
        return Hyperparameters(kernel, noise[: self.P], root)

    def run(self, data, kernel, noise, bounds, max_iter) -> tuple[Any, Vector, Optimum]:
        """Return kernel and noise at the end of a stage, and its Optimum."""
        objective = Objective(kernel, data, len(noise), self.common)
        return self._maximize(objective, noise, theta_bounds(kernel, bounds), max_iter)

    def run_noise(self, data, kernel, noise, bounds, stage="fit") -> Vector:
        """Return the noise that is best for this kernel."""
        objective, bounds = Objective(kernel, data, len(noise)), theta_bounds(kernel, bounds)
        bounds[: kernel.n_dims] = kernel.theta[:, None]
        return self._maximize(objective, noise, bounds, NOISE_STEPS, stage=stage)[1]

    def _maximize(self, objective, noise, bounds, max_iter, stage="fit"):
        theta = np.concatenate([objective.kernel.theta, np.log(noise)])
        options = {
            "optimizer": self.optimizer,
            "max_iter": max_iter,
            "stop": self.stop,
            "grid": GRID,
            "stage": stage,
        }
        with threads_for(objective.data.n_values):
            best = maximize(objective, theta, bounds, **options)
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
    exact: bool = False,
) -> Hyperparameters:
    """Return hyperparameters, learned from each output separately and then from ``rows`` of all outputs jointly.

    Without ``exact`` the search neglects the correlation of outputs by errors of the regressors, so
    noise is learned again at the end. The other arguments are those of ``fit_exact``.
    """
    open_kernel, kernel = kernel, kernel.initialize(X, Y, random_state)
    noise, noise_bounds = _initial_noise(kernel.residual(X, Y), output_scale(Y))
    stop, singles, n_singles = Event(), None, 0
    if optimizer is not None and not open_kernel.has_values():  # stage 1
        options = optimizer, max_iter, random_state, stop
        singles, noise, n_singles = _fit_singles(open_kernel, noise, noise_bounds, X, Y, *options)
    scale, X, Y = column_scale(X), X[rows], Y[rows]
    stages = _Stages(Y.shape[1], optimizer, exact, stop)
    learned_root = isinstance(input_noise, str)
    root = np.diag(scale) if learned_root else input_noise
    if optimizer is None:
        return stages.hyperparameters(kernel, noise, None if learned_root else root)
    data, bounds, n_iter = Data.from_table(X, Y), noise_bounds, 0
    # Stage 2. From widths that outputs share, stage 3 needs few iterations, and ends at optima that
    # predict better than those reached from arbitrary widths. With noisy regressors, slopes of the
    # coarse model propagate their noise.
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
    # Stage 3.
    kernel, noise, best = stages.run(data, kernel, noise, bounds, max_iter - n_iter)
    n_values = data.n_values
    if learned_root and not (exact or callable(optimizer) or stop.is_set()):
        # Stage 4; the white noise is learned again from all samples.
        data = stages.hyperparameters(kernel, noise, root).data(X[::2], Y[::2], 1)
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
    stages = _Stages(Y.shape[1], "fmin_l_bfgs_b", True, stop)
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
    propagated = [
        np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.sample_noise.loading
    ]
    part = 0.5 * float(np.nanmedian(noise / np.maximum(propagated, 1e-12)))
    least, most = INPUT_BOUNDS
    start = np.full(d, np.clip(part, 10 * least, most / 10))
    return np.concatenate([0.5 * noise, start]), np.tile(INPUT_BOUNDS, (d, 1))


# -- the rows that a search learns from
# -------------------------------------------------------------------------------

SEARCH_VALUES, OUTPUT_VALUES = (
    (1000, 1800),
    300,
)  # least and most values that a search learns from; of each output


def stratified(rows: Any, n: int, random_state: Any) -> Any:
    """Return a stratified sample of at most n rows: a random one of each of n equal parts, as neighbours are redundant.

    A row that two parts share may be drawn for both. It counts once: values that are there twice
    look free of noise.
    """
    if n >= len(rows):
        return rows
    edges = np.linspace(0, len(rows), n + 1)
    return rows[np.unique((edges[:-1] + np.diff(edges) * random_state.uniform(size=n)).astype(int))]


def n_searched(Y: Matrix) -> int:
    """Return the number of values that a search learns from."""
    return int(min(np.clip(Y.shape[1] * OUTPUT_VALUES, *SEARCH_VALUES), np.isfinite(Y).sum()))


def some_rows(Y: Matrix, random_state: Seed):
    """Return rows that a search learns from: each output has about half of an equal share of the values, more, or all.

    A row that is added for one output brings values of all, so outputs with gaps do not get a whole
    share.
    """
    observed, P = np.isfinite(Y), Y.shape[1]
    share = -(-int(np.clip(P * OUTPUT_VALUES, *SEARCH_VALUES)) // P)
    rows = stratified(np.arange(len(Y)), max(2, P * share * len(Y) // observed.sum()), random_state)
    for output in observed.T:
        n_missing = min(-(-share // 2), output.sum()) - output[rows].sum()
        rest = np.setdiff1d(np.flatnonzero(output), rows, assume_unique=True)
        rows = np.concatenate([rows, stratified(rest, max(n_missing, 0), random_state)])
    return np.sort(rows)


# -- each output alone
# ------------------------------------------------------------------------------------------------

SINGLE_VALUES, SINGLE_ITERATIONS = 400, 100  # largest numbers for each output
WIDTH_FACTORS = (1.0, 0.3, 0.1)  # starting widths of the short trials, over those of ``initialize``
NARROW_FACTORS = (0.1, 0.05, 0.025, 0.012, 0.006)  # widths whose likelihood is compared with theirs
NOISE_FACTORS = (1.0, 0.1)  # of the noise at these widths
TRIAL_VALUES, TRIAL_ITERATIONS = 150, 40  # largest numbers for each trial
# rise of the likelihood by one iteration, as a fraction for each process, below which it is the
# last
TOLERANCE = 1e-5


class _SingleFit:
    """The values of one output and the maximisation of its likelihood."""

    def __init__(self, i, X, Y, noise, noise_bounds, seed, search):
        rows = stratified(
            np.flatnonzero(np.isfinite(Y[:, i])), SINGLE_VALUES, np.random.RandomState(seed)
        )
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

    def likeliest_narrow(self, kernel, theta):
        """Return the likeliest of ``theta`` and starts of narrow widths, by all values of the output.

        A function that turns often, such as a sine of many periods, has an optimum so narrow that
        searches from wider starts end at one that explains everything as noise.
        """
        data = Data.from_table(self.x, self.y)
        starts = [theta]
        for width, noise in product(NARROW_FACTORS, NOISE_FACTORS):
            start = kernel.single_output().initialize(
                self.x, self.y, np.random.RandomState(self.seed), width_factor=width
            )
            starts.append(np.concatenate([start.theta, np.log(noise * self.noise)]))
        like = kernel.single_output().initialize(self.x, self.y, np.random.RandomState(self.seed))

        def value(theta):
            try:
                return log_likelihood(like.clone_with_theta(theta[:-1]), np.exp(theta[-1:]), data)
            except np.linalg.LinAlgError:
                return -np.inf

        return max(starts, key=value)


@one_blas_thread()  # and one after another: two threads gain nothing on small matrices
def _fit_singles(kernel, noise, noise_bounds, X, Y, optimizer, max_iter, random_state, stop):
    """Return kernels and noise (P,) of separate fits of each output, and the number of evaluations.

    Each has at most twice ``max_iter`` iterations.

    A single output has 1/P of the values, so an evaluation costs 1/P^3 of a joint one. From widths
    that are much too long, the nearest optimum explains everything as noise. Short trials from
    several widths avoid it.
    """
    tolerance = TOLERANCE * max(1, kernel.n_processes)
    search = partial(maximize, optimizer=optimizer, stop=stop, tolerance=tolerance, grid=GRID)
    seeds = random_state.randint(2**31 - 1, size=Y.shape[1])
    outputs = [
        _SingleFit(i, X, Y, noise, noise_bounds, seed, search) for i, seed in enumerate(seeds)
    ]
    trials = [output.try_widths(kernel, max_iter) for output in outputs]
    most = min(SINGLE_ITERATIONS, 2 * max_iter)
    refined = [
        output.optimize(single, output.likeliest_narrow(kernel, optimum.theta), 1, most)
        for output, (single, optimum, _) in zip(outputs, trials, strict=True)
    ]
    kernels = [single.clone_with_theta(optimum.theta[:-1]) for single, optimum in refined]
    noise = np.concatenate([np.exp(optimum.theta[-1:]) for _, optimum in refined])
    return (
        kernels,
        noise,
        sum(trial[2] for trial in trials) + sum(optimum.n_evaluations for _, optimum in refined),
    )


# -- what is maximised, and the optimiser
# -----------------------------------------------------------------------------

RECENT = 10  # evaluations from which the rise of the likelihood is extrapolated
GRID = 2.0**-14
"""Spacing of the hyperparameters that a search evaluates, over the width of their bounds.

Far from an optimum, each iteration of L-BFGS multiplies a difference between two searches by about
1.6. So data that differ by rounding alone, on another processor or of a mirrored flight, would lead
to different optima within 60 iterations. On the grid the difference is mostly gone before it grows:
regressors moved by 1e-12 move predictions of six tables by at most 0.02 deviations, of five by less
than 1e-7. A grid of 2^-12 stops some searches early: the error of electrodes (docs/results.md) is
then .49 instead of .26.
"""
WIDEST = 16.0  # width of bounds that counts
GRADIENT = 1e-4  # [nats] below which a search has converged
STOPPED = 99  # status of SciPy's minimisers after StopIteration in the callback


class Objective:
    """The function [theta, log noise] -> log likelihood, and its gradient.

    ``n_noise`` is the length of the noise vector. Where nothing couples outputs, this is the sum of
    their likelihoods: P^2 times faster.
    With ``common`` false it neglects the correlation of outputs by errors of the regressors: widths
    and amplitudes hardly change, but the variances of the regressors' noise must then be learned
    again.
    """

    def __init__(self, kernel: Any, data: Data, n_noise: int, common: bool = True) -> None:
        self.kernel = kernel
        self.data = data
        self.n_noise = n_noise
        coupled = any(couplings(kernel)) or (common and data.sample_noise is not None)
        self.parts = [data] if coupled else data.by_output()
        self.workspace = np.empty(max(part.n_values for part in self.parts) ** 2)

    def __call__(self, theta):
        candidate, noise = self._split(theta)
        value, gradient = 0.0, np.zeros(len(theta))
        for part in self.parts:
            n = part.n_values
            workspace = self.workspace[: n * n].reshape(n, n)
            of_part, slope = log_likelihood(candidate, noise, part, True, workspace)
            value += of_part
            gradient += slope
        return value, gradient

    def _split(self, theta):
        return self.kernel.clone_with_theta(theta[: -self.n_noise]), np.exp(theta[-self.n_noise :])


def theta_bounds(kernel: Any, noise_bounds):
    """Return the bounds of [theta, log noise]."""
    return np.concatenate([kernel.bounds, np.log(noise_bounds)])


class Optimum(NamedTuple):
    """The result of a maximisation."""

    theta: np.ndarray
    value: float
    n_iter: int
    n_evaluations: int
    interrupted: bool
    remaining: float  # expected rise of the likelihood in as many iterations again [nats]
    converged: bool  # stopped because the likelihood no longer rose


class _Watched:
    """The negative log likelihood for a minimiser; it keeps the best point and reports progress."""

    def __init__(self, log_likelihood, theta, stage, stop):
        self.log_likelihood, self.stage, self.stop = log_likelihood, stage, stop
        self.theta, self.value, self.latest, self.n_evaluations = (
            np.array(theta),
            -np.inf,
            -np.inf,
            0,
        )
        self.values: list[float] = []

    def __call__(self, theta, eval_gradient=True):
        if self.stop is not None and self.stop.is_set():
            raise KeyboardInterrupt
        try:
            value, gradient = self.log_likelihood(theta)
        except np.linalg.LinAlgError:
            value, gradient = -np.inf, np.zeros_like(theta)
        self.n_evaluations += 1
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            # A large finite value, so that the line search turns back.
            value, gradient = (
                -1e6 - 2 * abs(self.value if np.isfinite(self.value) else 0.0),
                np.zeros_like(theta),
            )
        elif value > self.value:
            self.theta, self.value = np.array(theta), value
        self.latest = value
        self.values.append(self.value)
        notify(self.stage, self.n_evaluations, self.value)
        return (-value, -gradient) if eval_gradient else -value

    def rise_per_evaluation(self) -> float:
        """Return the mean rise of the best value in the last evaluations, infinite if there is only one."""
        last = [value for value in self.values[-RECENT:] if np.isfinite(value)]
        return (last[-1] - last[0]) / (len(last) - 1) if len(last) > 1 else np.inf


def maximize(
    log_likelihood: Callable,
    theta: Vector,
    bounds: Any,
    *,
    optimizer: Any = "fmin_l_bfgs_b",
    max_iter: int = 100,
    tolerance: Any = 1e-5,
    stage: str = "fit",
    stop: Any = None,
    grid: float = 0.0,
) -> Optimum:
    """Return the best point of a search that starts at ``theta``.

    Parameters
    ----------
    log_likelihood : callable
        theta (n,) -> value and gradient (n,).
    theta : ndarray (n,)
        Starting point.
    bounds : ndarray (n, 2)
    optimizer : "fmin_l_bfgs_b" or callable
        A callable has scikit-learn's signature: (obj_func, initial_theta, bounds) -> theta,
        minimum.
    max_iter : int
    tolerance : float
        Stop when one iteration raises the likelihood by less than this fraction.
    stage : str
        Name of the stage for progress listeners.
    stop : threading.Event or None
        Stops the search before the next evaluation when it is set. Ctrl-C sets it.
    grid : float
        Spacing of the points that are evaluated, from the lower bounds on, over the width of the
        bounds, see ``GRID``. Zero: any points.

    Returns
    -------
    Optimum
        After Ctrl-C the best point so far, with ``interrupted``; the caller warns.
    """
    step = grid * np.minimum(np.ptp(bounds, axis=1), WIDEST)
    step[step == 0.0] = 1.0

    def rounded(theta):
        nearest = bounds[:, 0] + step * np.round((theta - bounds[:, 0]) / step) if grid else theta
        return np.clip(nearest, bounds[:, 0], bounds[:, 1])

    theta = rounded(theta)
    if stop is not None and stop.is_set():
        return Optimum(theta, -np.inf, 0, 0, True, np.inf, False)
    objective = _Watched(log_likelihood, theta, stage, stop)
    n_iter, interrupted, remaining, converged = 0, False, np.inf, False
    before = -np.inf

    def watch(theta):
        nonlocal before
        rise, before = objective.latest - before, objective.latest
        if rise <= tolerance * max(1.0, abs(before), abs(before - rise)):
            raise StopIteration

    try:
        if callable(optimizer):
            optimizer(objective, theta, bounds)
            remaining, converged = 0.0, True  # an optimiser of the user has its own stopping rule
        else:
            first = objective(theta)
            before = objective.latest
            unit = float(np.linalg.norm(first[1])) or 1.0  # so that the first step has length one

            def loss(other):
                other = rounded(other)
                value, gradient = first if np.array_equal(other, theta) else objective(other)
                return value / unit, gradient / unit

            options: Any = {
                "maxiter": max_iter,
                "maxfun": 2 * max_iter + 10,
                "maxcor": 20,
                "ftol": 0.0,
            }
            options["gtol"] = GRADIENT / unit
            end = minimize(
                loss,
                theta,
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options=options,
                callback=watch,
            )
            n_iter, converged = end.nit, bool(end.success) or end.status == STOPPED
            remaining = 0.0
            if not converged:
                remaining = min(
                    _newton_rise(end, unit, bounds),
                    max(max_iter, 1) * objective.rise_per_evaluation(),
                )
    except KeyboardInterrupt:
        interrupted = True
        if stop is not None:
            stop.set()
    return Optimum(
        objective.theta,
        objective.value,
        n_iter,
        objective.n_evaluations,
        interrupted,
        remaining,
        converged,
    )


def _newton_rise(end: Any, unit: float, bounds: Any) -> float:
    """Return g^T H^-1 g / 2 with the gradient g inside the bounds and the H of L-BFGS, half the Newton decrement.

    ``end`` is of a loss in units of ``unit`` nats. Where L-BFGS has seen no curvature, H is one
    nat.
    """
    downhill = -unit * end.jac
    blocked = ((end.x <= bounds[:, 0]) & (downhill < 0)) | (
        (end.x >= bounds[:, 1]) & (downhill > 0)
    )
    free = np.where(blocked, 0.0, downhill)
    return float(0.5 * free @ LbfgsInvHessProduct(end.hess_inv.sk, unit * end.hess_inv.yk)(free))
