"""The search for hyperparameters, in stages.

1. Each output alone (``_fit_output``).
2. All outputs, with widths that they share.
3. All hyperparameters.
4. The noise alone, if stage 3 neglected correlations between outputs.

Stages 2 to 4 learn from ``some_rows``. Each stage is a call of ``climb``, which maximises one
likelihood from one starting point by ``maximize``.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import LbfgsInvHessProduct, minimize
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, output_scale
from skdgp._compute.messages import keeps_best, notify
from skdgp._compute.parallel import one_blas_thread, threads_for
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, log_likelihood
from skdgp.inference._posterior import ExactPosterior
from skdgp.kernels import MultiOutputKernel

NOISE_STEPS = 10  # largest number of steps, or of iterations, that change the noise alone
NOISE_BOUNDS = (1e-6, 1e2)  # noise variance over the variance of the output
INPUT_BOUNDS = (1e-7, 0.3)  # noise variance over the variance of the regressor
# Expected rise of the likelihood for each value [nats] up to which a search has converged
IRRELEVANT_RISE = 0.05
# Rise of the likelihood, as a fraction for each process, below which an iteration is the last
TOLERANCE = 1e-5
RECENT = 10  # evaluations to extrapolate the rise of the likelihood
# Grid of the search over the width of the bounds, so that rounding does not choose the optimum
GRID = 2.0**-14
WIDEST = 16.0  # width of bounds that counts
GRADIENT = 1e-4  # [nats] below which a search has converged
STOPPED = 99  # status of SciPy's minimisers after StopIteration in the callback


class KnownNoise(NamedTuple):
    """What is known of the noise before the fit.

    ``variance`` (P,) are starting values within ``bounds`` (P, 2); equal bounds keep a value. None:
    both from the data. ``loading`` (n, P, P), or None, is a root of the noise covariance of each
    sample that is known beside. ``input_std`` (d,), or None, are known standard deviations of the
    noise of the regressors.
    """

    variance: Vector | None = None
    bounds: Matrix | None = None
    loading: Array | None = None
    input_std: Vector | None = None

    @classmethod
    def of_values(cls, variance: Matrix) -> KnownNoise:
        """Return the noise of known variances of all values, (n, P), as scikit-learn's ``alpha``.

        The smallest variance of each output is its white noise, the rest differs between samples.
        """
        white = variance.min(axis=0)
        root = np.sqrt(variance - white)
        loading = root[:, :, None] * np.eye(len(white))
        return cls(white, np.column_stack([white, white]), loading)

    @property
    def is_learned(self) -> Any:
        """Whether the variance of each output is learned, (P,), or one value for all."""
        return np.bool_(True) if self.bounds is None else self.bounds[:, 0] < self.bounds[:, 1]

    @property
    def is_fixed(self) -> bool:
        """Whether all variances keep their values."""
        return not np.any(self.is_learned)

    @property
    def weights(self) -> Matrix | None:
        """Inverse variances of the values, (n, P), where they differ between samples."""
        if self.loading is None or self.variance is None:
            return None
        return 1.0 / (self.variance + np.einsum("npp->np", self.loading) ** 2)

    def of_rows(self, rows: Any) -> KnownNoise:
        """Return the same of some samples."""
        return self._replace(loading=None if self.loading is None else self.loading[rows])

    def in_units(self, scale: Vector) -> KnownNoise:
        """Return the same of outputs over ``scale`` (P,)."""
        variance, bounds, loading, input_std = self
        return KnownNoise(
            None if variance is None else variance / scale**2,
            None if bounds is None else bounds / scale[:, None] ** 2,
            None if loading is None else loading / scale[:, None],
            input_std,
        )

    def of_output(self, i: int) -> KnownNoise:
        """Return the same of one output."""
        variance, bounds, loading, input_std = self
        own = slice(i, i + 1)
        return KnownNoise(
            None if variance is None else variance[own],
            None if bounds is None else bounds[own],
            None if loading is None else loading[:, own],
            input_std,
        )

    def start(self, residual: Matrix, scale: Vector) -> tuple[Vector, Matrix]:
        """Return the starting noise variances (P,) and their bounds (P, 2).

        Without known ones: a fifth of the variance of the ``residual`` (n, P), and bounds relative
        to the ``scale`` (P,) of the outputs.
        """
        bounds = np.multiply.outer(scale**2, NOISE_BOUNDS) if self.bounds is None else self.bounds
        if self.variance is None:
            return np.clip(0.2 * np.nanvar(residual, axis=0), *bounds.T), bounds
        return np.clip(self.variance, *bounds.T), bounds


UNKNOWN = KnownNoise()


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search that found them.

    ``noise`` (P,) is white. ``input_std`` (d,) are the standard deviations of the regressors'
    noise, None for exact regressors. ``remaining`` is the expected rise of the likelihood by
    further iterations.
    """

    kernel: MultiOutputKernel
    noise: Vector
    input_std: Vector | None = None
    n_iter: int = 0
    interrupted: bool = False
    remaining: float = 0.0
    converged: bool = True

    def noisy(self, data: Data, passes: int = 2) -> Data:
        """Return observed values of exact regressors with the noise of the regressors.

        The first pass takes slopes of a fit to exact regressors, the second of one to noisy
        regressors.
        """
        if self.input_std is None:
            return data
        for _ in range(passes):
            mean = ExactPosterior(self.kernel, self.noise, data).mean_function
            data = data.with_slopes(mean, self.input_std)
        return data


class Point(NamedTuple):
    """Kernel and noise where a run of the search ended, and how it ended.

    A noise vector is [sigma^2 (P)], with learned noise of the regressors [sigma^2, s (d)].
    """

    kernel: MultiOutputKernel
    noise: Vector
    end: Optimum


def climb(
    kernel: MultiOutputKernel,
    noise: Vector,
    noise_bounds: Matrix,
    data: Data,
    max_iter: int,
    stop: Event,
    *,
    tolerance: float = TOLERANCE,
    common: bool = True,
    noise_alone: bool = False,
    stage: str = "fit",
) -> Point:
    """Return the best kernel and noise found from these, which the kernel keeps if ``noise_alone``."""
    objective = Objective(kernel, data, len(noise), common)
    bounds = np.concatenate([kernel.bounds, np.log(noise_bounds)])
    if noise_alone:
        bounds[: kernel.n_dims] = kernel.theta[:, None]
    start = np.concatenate([kernel.theta, np.log(noise)])
    options: Any = {"max_iter": max_iter, "tolerance": tolerance, "stage": stage, "grid": GRID}
    with threads_for(data.n_values):
        end = maximize(objective, start, bounds, stop, **options)
    return Point(*objective.at(end.theta), end)


def search(
    kernel: MultiOutputKernel,
    X: Matrix,
    Y: Matrix,
    *,
    optimizer: Any,
    max_iter: int,
    random_state: Seed,
    input_noise: bool = False,
    exact: bool = False,
    known: KnownNoise = UNKNOWN,
) -> Hyperparameters:
    """Return hyperparameters, learned from each output separately and then from some rows of all outputs jointly.

    Without ``exact`` the search neglects the correlation of outputs by errors of the regressors, so
    noise is learned again at the end. The other arguments are as in ``fit_exact``. Without an
    ``optimizer`` the kernel keeps its values, and noise that is not known is estimated for it.
    """
    random_state = check_random_state(random_state)
    rows = some_rows(Y, random_state)
    start = kernel.initialize(X, Y, random_state)
    noise, noise_bounds = known.start(start.residual(X, Y), output_scale(Y))
    scale, P = column_scale(X), Y.shape[1]
    input_std: Vector | None = None
    if optimizer is None:
        data = Data.from_table(X, Y, known.loading)
        given = Hyperparameters(start, noise, known.input_std)
        data = given.noisy(data) if exact else data
        return best_noise(given, X, Y, data, known)
    stop, singles = Event(), None
    if not kernel.has_values() and kernel.single_output() is not None:  # stage 1
        singles, noise = _fit_outputs(
            kernel, noise, noise_bounds, X, Y, max_iter, random_state, stop, known
        )
    # Stage 2. From widths that outputs share, stage 3 needs few iterations, and ends at optima that
    # predict better than those reached from arbitrary widths. With noisy regressors, slopes of the
    # coarse model propagate their noise.
    X, Y, known = X[rows], Y[rows], known.of_rows(rows)
    data, n_iter = Data.from_table(X, Y, known.loading), 0
    start = kernel.initialize(X, Y, random_state, singles)
    coarse = kernel.coarse().initialize(X, Y, random_state, singles)
    if coarse.n_dims < start.n_dims or input_noise:
        half = min(-(-max_iter // 2), max_iter - 1)  # stage 3 has at least one
        coarse, noise, end = climb(coarse, noise, noise_bounds, data, half, stop, common=exact)
        n_iter = end.n_iter
        start = kernel.initialize(X, Y, random_state, singles, coarse)
    # Stage 3.
    bounds = noise_bounds
    if input_noise:
        data = Hyperparameters(coarse, noise, scale).noisy(data, 1).with_loadings()
        noise, input_bounds = _initial_input_noise(noise, data, scale, known)
        bounds = np.concatenate([noise_bounds, input_bounds])
    best, noise, end = climb(start, noise, bounds, data, max_iter - n_iter, stop, common=exact)
    if input_noise:
        if not (exact or stop.is_set()):
            # Stage 4; the white noise is learned again from all samples.
            half_data = Data.from_table(X[::2], Y[::2])
            half_data = Hyperparameters(best, noise[:P], scale).noisy(half_data, 1)
            noise = climb(best, noise, bounds, half_data, NOISE_STEPS, stop, noise_alone=True).noise
        input_std = scale * np.sqrt(noise[P:]) if known.input_std is None else known.input_std
    return Hyperparameters(
        best,
        noise[:P],
        input_std,
        n_iter=n_iter + end.n_iter,
        interrupted=stop.is_set(),
        remaining=end.remaining,
        converged=bool(end.converged or end.remaining <= IRRELEVANT_RISE * data.n_values),
    )


def best_noise(
    learned: Hyperparameters, X: Matrix, Y: Matrix, data: Data, known: KnownNoise = UNKNOWN
) -> Hyperparameters:
    """Return the hyperparameters with the noise (P,) that is best for their kernel.

    It is learned from at most 1800 of the values of X and Y. After Ctrl-C it is the best so far,
    and the result is interrupted.
    """
    noise, bounds = known.start(learned.kernel.residual(X, Y), output_scale(Y))
    if known.is_fixed:
        return learned._replace(noise=noise)
    some = data.every(-(-data.n_values // SEARCH_VALUES[1]))
    stop = Event()
    end = climb(
        learned.kernel, noise, bounds, some, NOISE_STEPS, stop, noise_alone=True, stage="members"
    )
    return learned._replace(noise=end.noise, interrupted=learned.interrupted or stop.is_set())


def _initial_input_noise(noise, data, scale, known):
    """Return the noise vector with factors s (d,) of the regressors' noise variances, and bounds of s.

    Known standard deviations, over the ``scale`` (d,) of the regressors, keep their values. At the
    start of others, half of each output's noise comes from the regressors, with equal factors s.
    """
    least, most = INPUT_BOUNDS
    if known.input_std is not None:
        fixed = np.maximum((known.input_std / scale) ** 2, least)
        return np.concatenate([noise, fixed]), np.column_stack([fixed, fixed])
    propagated = [
        np.mean(np.sum(G**2, axis=1)) if len(G) else np.nan for G in data.sample_noise.loading
    ]
    part = 0.5 * float(np.nanmedian(noise / np.maximum(propagated, 1e-12)))
    d = len(scale)
    start = np.full(d, np.clip(part, 10 * least, most / 10))
    return np.concatenate([0.5 * noise, start]), np.tile(INPUT_BOUNDS, (d, 1))


# -- the rows that a search learns from
# -------------------------------------------------------------------------------

SEARCH_VALUES = (1000, 1800)  # least and most values that a search learns from
OUTPUT_VALUES = 300  # values of each output, between these


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
        unused = np.setdiff1d(np.flatnonzero(output), rows, assume_unique=True)
        rows = np.concatenate([rows, stratified(unused, max(n_missing, 0), random_state)])
    return np.sort(rows)


# -- each output alone
# ------------------------------------------------------------------------------------------------

SINGLE_VALUES, SINGLE_ITERATIONS = 400, 100  # largest numbers for each output
WIDTH_FACTORS = (1.0, 0.3, 0.1)  # starting widths of the short trials, over ``initialize``'s
NARROW_FACTORS = (0.1, 0.05, 0.025, 0.012, 0.006)  # widths whose likelihood is compared with theirs
NOISE_FACTORS = (1.0, 0.1)  # of the noise at these widths
TRIAL_VALUES, TRIAL_ITERATIONS = 150, 40  # largest numbers for each trial


@one_blas_thread()  # two threads gain nothing on small matrices
def _fit_outputs(kernel, noise, noise_bounds, X, Y, max_iter, random_state, stop, known):
    """Return kernels and noise (P,) of separate fits of each output.

    A single output has 1/P of the values, so an evaluation costs 1/P^3 of a joint one.
    """
    fits = []
    for i, seed in enumerate(random_state.randint(2**31 - 1, size=Y.shape[1])):
        rows = stratified(
            np.flatnonzero(np.isfinite(Y[:, i])), SINGLE_VALUES, np.random.RandomState(seed)
        )
        own = slice(i, i + 1)
        fits.append(
            _fit_output(
                kernel,
                noise[own],
                noise_bounds[own],
                X[rows],
                Y[rows, own],
                max_iter=max_iter,
                seed=seed,
                stage=f"output {i + 1}",
                stop=stop,
                loading=known.of_output(i).of_rows(rows).loading,
            )
        )
    return [fit.kernel for fit in fits], np.concatenate([fit.noise for fit in fits])


def _fit_output(kernel, noise, noise_bounds, x, y, max_iter, seed, stage, stop, loading=None):
    """Return the Point of the fit to one output, y (n, 1), in at most twice ``max_iter`` iterations.

    From widths that are much too long, the nearest optimum explains everything as noise. Short
    trials from several widths avoid it. A function that turns often, such as a sine of many
    periods, has an optimum so narrow that the trials miss it: the best trial is compared with
    narrow starts by the likelihood of all values.
    """

    def start(width_factor):
        random_state = np.random.RandomState(seed)
        return kernel.single_output().initialize(x, y, random_state, width_factor=width_factor)

    def run(kernel, noise, step, max_iter):
        some = None if loading is None else loading[::step]
        data = Data.from_table(x[::step], y[::step], some)
        options = {"tolerance": TOLERANCE * max(1, kernel.n_processes), "stage": stage}
        return climb(kernel, noise, noise_bounds, data, max_iter, stop, **options)

    widths = {single.theta.tobytes(): single for single in map(start, WIDTH_FACTORS)}
    step, few = max(1, len(x) // TRIAL_VALUES), min(TRIAL_ITERATIONS, max_iter)
    trials = [run(single, noise, step, few) for single in widths.values()]
    best = max(trials, key=lambda trial: trial.end.value)
    starts = [(best.kernel, best.noise)]
    starts += [
        (start(width), factor * noise) for width, factor in product(NARROW_FACTORS, NOISE_FACTORS)
    ]
    data = Data.from_table(x, y, loading)

    def likelihood(start):
        kernel, noise = start
        try:
            return log_likelihood(kernel, noise, data)
        except np.linalg.LinAlgError:
            return -np.inf

    return run(*max(starts, key=likelihood), 1, min(SINGLE_ITERATIONS, 2 * max_iter))


# -- the optimiser
class Objective:
    """The function [theta, log noise] -> log likelihood, and its gradient.

    ``n_noise`` is the length of the noise vector. Where nothing couples outputs, this is the sum of
    their likelihoods: P^2 times faster.
    With ``common`` false it neglects the correlation of outputs by errors of the regressors: widths
    and amplitudes hardly change, but the variances of the regressors' noise must then be learned
    again.
    """

    def __init__(
        self, kernel: MultiOutputKernel, data: Data, n_noise: int, common: bool = True
    ) -> None:
        self.kernel = kernel
        self.n_noise = n_noise
        coupled = any(kernel.couples(i, j) for i, j in combinations(range(kernel.n_outputs), 2))
        coupled |= common and data.sample_noise is not None
        self.parts = [data.with_loadings()] if coupled else data.by_output()

    def at(self, theta: Vector) -> tuple[MultiOutputKernel, Vector]:
        """Return the kernel and the noise of [theta, log noise]."""
        theta, log_noise = np.split(theta, [-self.n_noise])
        return self.kernel.clone_with_theta(theta), np.exp(log_noise)

    def __call__(self, theta: Vector) -> tuple[float, Vector]:
        kernel, noise = self.at(theta)
        value, gradient = 0.0, np.zeros(len(theta))
        for part in self.parts:
            of_part, slope = log_likelihood(kernel, noise, part, eval_gradient=True)
            value += of_part
            gradient += slope
        return value, gradient


class Optimum(NamedTuple):
    """The result of a maximisation."""

    theta: np.ndarray
    value: float
    n_iter: int
    remaining: float  # expected rise of the likelihood in as many iterations again [nats]
    converged: bool  # stopped because the likelihood no longer rose


class _Loss:
    """The negative log likelihood for a minimiser; it keeps the best point and reports progress."""

    def __init__(self, objective, theta, stage, stop):
        self.objective, self.stage, self.stop = objective, stage, stop
        self.theta = np.array(theta)
        self.value = -np.inf
        self.latest = -np.inf
        self.best_values: list[float] = []  # after each evaluation

    def __call__(self, theta):
        if self.stop.is_set():
            raise KeyboardInterrupt
        try:
            value, gradient = self.objective(theta)
        except np.linalg.LinAlgError:
            value, gradient = -np.inf, np.zeros_like(theta)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            # A large finite value, so that the line search turns back.
            value = -1e6 - 2 * abs(self.value if np.isfinite(self.value) else 0.0)
            gradient = np.zeros_like(theta)
        elif value > self.value:
            self.theta, self.value = np.array(theta), value
        self.latest = value
        self.best_values.append(self.value)
        notify(self.stage, len(self.best_values), self.value)
        return -value, -gradient

    def rise_per_evaluation(self) -> float:
        """Return the mean rise of the best value in the last evaluations, infinite if there is only one."""
        last = [value for value in self.best_values[-RECENT:] if np.isfinite(value)]
        return (last[-1] - last[0]) / (len(last) - 1) if len(last) > 1 else np.inf


def maximize(
    objective: Callable,
    theta: Vector,
    bounds: Matrix,
    stop: Event,
    *,
    max_iter: int = 100,
    tolerance: float = TOLERANCE,
    stage: str = "fit",
    grid: float = 0.0,
) -> Optimum:
    """Return the best point of a search that starts at ``theta``.

    Parameters
    ----------
    objective : callable
        theta (n,) -> value and gradient (n,).
    theta : ndarray (n,)
        Starting point.
    bounds : ndarray (n, 2)
    stop : threading.Event
        Stops the search before the next evaluation when it is set. Ctrl-C sets it inside
        ``listening(..., keep_best=True)``.
    max_iter : int
        Zero: the starting point is evaluated.
    tolerance : float
        Stop when one iteration raises the likelihood by less than this fraction.
    stage : str
        Name of the stage for progress listeners.
    grid : float
        Spacing of the points that are evaluated, from the lower bounds on, over the width of the
        bounds, see ``GRID``. Zero: any points.

    Returns
    -------
    Optimum
        If ``stop`` is set the best point so far; the caller warns.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C, unless the best so far is kept.
    """
    step = grid * np.minimum(np.ptp(bounds, axis=1), WIDEST)
    step[step == 0.0] = 1.0

    def rounded(theta):
        nearest = bounds[:, 0] + step * np.round((theta - bounds[:, 0]) / step) if grid else theta
        return np.clip(nearest, *bounds.T)

    loss = _Loss(objective, rounded(theta), stage, stop)
    n_iter, remaining, converged = 0, np.inf, False
    try:
        n_iter, remaining, converged = _minimized(
            loss, rounded(theta), bounds, rounded, max_iter, tolerance
        )
    except KeyboardInterrupt:
        if not keeps_best():
            raise
        stop.set()
    return Optimum(loss.theta, loss.value, n_iter, remaining, converged)


def _minimized(loss, theta, bounds, rounded, max_iter, tolerance):
    """Return the number of iterations of L-BFGS-B, the expected rise by as many again, and whether it converged."""
    first = loss(theta)
    if max_iter == 0:  # of which SciPy makes one
        return 0, np.inf, False
    before = loss.latest
    unit = float(np.linalg.norm(first[1])) or 1.0  # so that the first step has length one

    def scaled_loss(other):
        other = rounded(other)
        value, gradient = first if np.array_equal(other, theta) else loss(other)
        return value / unit, gradient / unit

    def end_of_iteration(theta):
        nonlocal before
        rise, before = loss.latest - before, loss.latest
        if rise <= tolerance * max(1.0, abs(before), abs(before - rise)):
            raise StopIteration

    end = minimize(
        scaled_loss,
        theta,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        callback=end_of_iteration,
        options={
            "maxiter": max_iter,
            "maxfun": 2 * max_iter + 10,
            "maxcor": 20,
            "ftol": 0.0,
            "gtol": GRADIENT / unit,
        },
    )
    if end.success or end.status == STOPPED:
        return end.nit, 0.0, True
    again = max(max_iter, 1) * loss.rise_per_evaluation()
    return end.nit, min(_newton_rise(end, unit, bounds), again), False


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
