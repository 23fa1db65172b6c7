"""The search for hyperparameters: one climb for each kernel of a list.

1. Rows that the search learns from, in blocks whose likelihoods add up (``_blocks.py``).
2. Each output alone, from the likeliest of several widths (``_Search.outputs_alone``).
3. Each kernel of the list, from the fits of the outputs or from the end of a simpler kernel that it
   contains (``_Search.end_of``).
4. The same with noise of the regressors, which the slopes of stage 3 propagate (``_with_input_noise``).

Each stage is a call of ``climb`` (``_objective.py``), which maximises one likelihood from one starting
point until it is stationary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, keep_freed_memory, output_scale
from skdgp._compute.messages import Progress
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix, Seed, Vector
from skdgp.inference._blocks import BlockSettings, blocks_of_rows
from skdgp.inference._likelihood import Data
from skdgp.inference._noise import SETTINGS as SETTINGS_OF_NOISE
from skdgp.inference._noise import UNKNOWN, KnownNoise, initial_input_noise
from skdgp.inference._objective import Objective, climb
from skdgp.inference._outliers import SETTINGS as SETTINGS_OF_OUTLIERS
from skdgp.inference._outliers import contaminated_variances, gross_outliers
from skdgp.inference._posterior import ExactPosterior
from skdgp.inference._shifts import found_shifts, price_of_shifts
from skdgp.inference._starts import SETTINGS as SETTINGS_OF_STARTS
from skdgp.inference._starts import (
    from_simpler,
    narrowed,
    redrawn,
    single_output,
    starting_kernel,
)
from skdgp.inference._structures import (
    contains,
    excess_of,
    has_shared_latents,
    least_score,
    price_of,
    with_shifts,
)
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class SearchSettings:
    """Starting points of a search, and the values that it learns from."""

    blocks: BlockSettings = field(default_factory=BlockSettings)
    #: Starting widths and noise of an output alone, over their estimates: factors of about two down
    #: to a function of many periods
    widths: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.05, 0.025, 0.012, 0.006)
    noises: tuple[float, ...] = (1.0, 0.1)
    #: Iterations with exact regressors, whose slopes are a start for noisy ones
    exact_iterations: int = 30


SETTINGS = SearchSettings()


@dataclass(frozen=True)
class SearchOptions:
    """What a search is asked for.

    Parameters
    ----------
    optimizer : "fmin_l_bfgs_b" or None
        None keeps the starting values, and estimates noise that is not known.
    max_iter : int
        Of each climb.
    random_state : int, RandomState or None
        Of the starts of restarts.
    input_noise : bool
        Whether a standard deviation of the noise of each regressor is learned.
    n_restarts : int
        Climbs of each kernel from random starts, of which the likeliest counts.
    shifts : bool
        Whether kernels with shifts are searched too, where separate fits of the outputs show them.
    time_series : bool
        Whether the rows are a time series.
    settings : SearchSettings
    """

    optimizer: str | None
    max_iter: int
    random_state: Seed
    input_noise: bool = False
    n_restarts: int = 0
    shifts: bool = False
    time_series: bool = False
    settings: SearchSettings = SETTINGS


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search that found them.

    ``noise`` (P,) is white. ``input_std`` (d,) are the standard deviations of the regressors'
    noise, None for exact regressors, ``added`` (n, P), or None, are the noise variances of the values
    beside the white noise, known or of outliers. ``log_likelihood`` is of the values
    of the search, ``price`` the price of the hyperparameters that they determine, and of shifts,
    ``excess`` the ratio of errors of other values to those of the search (Hurvich & Tsai 1989).
    """

    kernel: MultiOutputKernel
    noise: Vector
    input_std: Vector | None = None
    added: Matrix | None = None
    n_iter: int = 0
    converged: bool = True
    log_likelihood: float = -np.inf
    price: float = 0.0
    excess: float = 1.0

    def score(self) -> float:
        """Return the logarithm of the weight among structures (Akaike 1974)."""
        return self.log_likelihood - self.price

    def noisy(self, data: Data) -> Data:
        """Return observed values of exact regressors with their noise, by slopes of the fit to exact ones."""
        if self.input_std is None:
            return data
        mean = ExactPosterior(self.kernel, self.noise, data).mean_function
        return data.with_slopes(mean, self.input_std)


def search(
    kernels: Sequence[MultiOutputKernel],
    X: Matrix,
    Y: Matrix,
    options: SearchOptions,
    *,
    known: KnownNoise = UNKNOWN,
) -> list[Hyperparameters]:
    """Return hyperparameters of each kernel of a list, and of one with shifts.

    With ``options.shifts`` the likeliest of those with shared latents follows
    with shifts, where separate fits correlate more with shifts. Without an optimizer the first kernel
    keeps its values, and noise that is not known is estimated for it.

    Parameters
    ----------
    kernels : sequence of MultiOutputKernel
        Missing values are estimated from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    options : SearchOptions
    known : KnownNoise

    Returns
    -------
    list of Hyperparameters
        Of the kernels, then of the one with shifts.
    """
    keep_freed_memory()
    rows = blocks_of_rows(X, Y, options.settings.blocks, options.time_series)
    if options.optimizer is None:
        start = starting_kernel(kernels[0], X, Y)
        learned = Hyperparameters(start, np.ones(Y.shape[1]), known.input_std, known.added)
        return [with_best_noise(learned, X, Y, rows, known)]
    problem = _Search(X, Y, rows, known, options)
    alone = problem.outputs_alone(kernels[0])
    ends: list[Hyperparameters] = []
    for kernel in kernels:
        ends.append(problem.end_of(kernel, alone, ends))
    if options.shifts and alone is not None and len(alone.kernels) > 1:
        found = found_shifts(alone.kernels, alone.noise, X, Y)
        if found is not None:
            shift, aligned = found
            shared = [k for k, kernel in enumerate(kernels) if has_shared_latents(kernel)]
            likeliest = kernels[max(shared, key=lambda k: ends[k].score())]
            moved = with_shifts(likeliest, shift, X)
            ends.append(problem.end_of(moved, alone, ends, aligned, price_of_shifts(shift)))
    return [end._replace(added=problem.known.added) for end in ends]


class _OutputsAlone(NamedTuple):
    """Separate fits of each output, and their noise (P,)."""

    kernels: list[MultiOutputKernel]
    noise: Vector


class _Search:
    """Climbs of kernels for the same rows, with known noise."""

    def __init__(
        self,
        X: Matrix,
        Y: Matrix,
        rows: Sequence[Indices],
        known: KnownNoise,
        options: SearchOptions,
    ) -> None:
        self.X = X
        self.Y = Y
        self.rows = rows
        self.known = known
        self.has_normal_noise = (
            options.time_series or known.added is not None or not np.all(known.is_learned)
        )
        self.options = options
        self.random_state = check_random_state(options.random_state)
        self.scale = column_scale(X)
        self.blocks = _blocks_of(X, Y, rows, known)
        self.n_values = sum(block.n_values for block in self.blocks)

    def _noise(self, kernel):
        """Return the starting noise (P,) and its bounds (P, 2) of a kernel with values."""
        residual = kernel.residual(self.X, self.Y)
        return self.known.start(residual, output_scale(self.Y), self.X)

    # -- each output alone

    @one_blas_thread()  # two threads gain nothing on small matrices
    def outputs_alone(self, kernel: MultiOutputKernel) -> _OutputsAlone | None:
        """Return fits of one process to each output (stage 2); None for a kernel that gives its values."""
        single = single_output(kernel)
        if single is None or kernel.has_values():
            return None
        fits = []
        added = np.zeros(self.Y.shape)
        for i in range(self.Y.shape[1]):
            fit, added[:, i] = self._with_outliers(single, i)
            fits.append(fit)
        if added.any():
            self.known = self.known._replace(added=added)
            self.blocks = _blocks_of(self.X, self.Y, self.rows, self.known)
        noise = np.concatenate([fit.noise for fit in fits])
        return _OutputsAlone([fit.kernel for fit in fits], noise)

    def _with_outliers(self, single, i):
        """Return the fit of output i, and the noise variance of outliers beside white noise, (n,).

        Fits and the variances of their errors alternate. Errors of a
        time series last, and its gusts are no outliers.
        """
        settings = SETTINGS_OF_OUTLIERS
        observed = np.isfinite(self.Y[:, i])
        X, y = self.X[observed], self.Y[observed, i]
        added = np.zeros(len(self.Y))
        if self.known.added is not None:
            added = self.known.added[:, i].copy()
        if not self.has_normal_noise:
            added[observed] = gross_outliers(X, y)
        fit, data = self._alone(single, i, added)
        for _ in range(0 if self.has_normal_noise else settings.fits):
            function = ExactPosterior(fit.kernel, fit.noise, data)
            mean, variance = function.predict(X, return_variance=True)
            variances = contaminated_variances((y - mean[:, 0]) ** 2 + variance[:, 0])
            before = fit.noise + added[observed]
            after = np.full(len(y), fit.noise[0]) if variances is None else variances
            added[observed] = after - after.min()
            if np.abs(np.log(after / before)).max() < settings.tolerance:
                break
            fit, data = self._alone(single, i, added, (fit.kernel, np.array([after.min()])))
        return fit, added

    def _alone(self, single, i, added, start=None):
        """Return the fit of output i and its values, with noise variances ``added`` (n,) beside white noise.

        It starts from a kernel and noise, or the likeliest of several widths and noises: from widths that
        are much too long, the nearest optimum explains everything as noise; a function that turns often
        has an optimum that is narrow.
        """
        settings = self.options.settings
        column = slice(i, i + 1)
        rows = self._observed(i)
        beside = added[rows, None] if added.any() else None
        data = Data.from_table(self.X[rows], self.Y[rows, column], beside)
        kernel = starting_kernel(single, self.X[rows], self.Y[rows, column])
        residual = kernel.residual(self.X, self.Y[:, column])
        scale = output_scale(self.Y[:, column])
        noise, bounds = self.known.of_output(i).start(residual, scale, self.X)
        if start is None:
            starts = []
            for width, factor in product(settings.widths, settings.noises):
                starts.append((narrowed(single, kernel, width), np.clip(factor * noise, *bounds.T)))
            start = max(starts, key=partial(_likelihood, [data]))
        stage = Progress(f"output {i + 1}", i, self.Y.shape[1])
        max_iter = self.options.max_iter
        kernel, noise = start
        fit = climb(kernel, noise, bounds, [data], max_iter, stage=stage)
        return fit, data

    def _observed(self, i):
        """Return rows with values of output i: of as many blocks as have at most the values of one."""
        rows = [of_block[np.isfinite(self.Y[of_block, i])] for of_block in self.rows]
        n_values = np.cumsum([len(of_block) for of_block in rows])
        most = self.options.settings.blocks.series_values
        n_blocks = max(1, int(np.sum(n_values <= most)))
        return np.sort(np.concatenate(rows[:n_blocks]))

    # -- one kernel

    def end_of(
        self,
        kernel: MultiOutputKernel,
        alone: _OutputsAlone | None,
        ends: Sequence[Hyperparameters],
        aligned: Matrix | None = None,
        price: float = 0.0,
    ) -> Hyperparameters:
        """Return the hyperparameters of a kernel where its climbs end, the likeliest of all starts (stages 3 and 4).

        Amplitudes start from the outputs, or from those that are ``aligned`` (n, P). The kernel pays
        ``price`` beside its hyperparameters. A climb that falls behind the ``ends`` of other kernels
        is given up.
        """
        Y = self.Y if aligned is None else aligned
        singles = None if alone is None else alone.kernels
        is_sum = singles is not None and len(singles) == 1 and has_shared_latents(kernel)
        ratios = SETTINGS_OF_STARTS.apart if is_sum else (1.0,)
        of_ratios = [starting_kernel(kernel, self.X, Y, singles, ratio) for ratio in ratios]
        start = of_ratios[0]
        noise, bounds = self._noise(start)
        noise = noise if alone is None else alone.noise
        n_iter = self.options.max_iter
        if self.options.input_noise:
            n_iter = min(n_iter, self.options.settings.exact_iterations)
        starts = [(of_ratio, noise) for of_ratio in of_ratios]
        for end in ends if aligned is None else ():
            if contains(kernel, end.kernel):
                starts.append((from_simpler(start, end.kernel), end.noise))
        if not ends:
            starts = [_by_one_block(*pair, bounds, self.blocks, n_iter) for pair in starts]
        starts.sort(key=partial(_likelihood, self.blocks), reverse=True)
        score = least_score([end.score() for end in ends])
        found: list[Hyperparameters] = []

        def least(point):
            of_others = score + self._price(point.n_determined) + price
            return max([of_others, *(end.log_likelihood for end in found)])

        climb_from = partial(
            self._climb, bounds=bounds, blocks=self.blocks, max_iter=n_iter, least=least
        )
        for of_start in starts:
            is_hopeless = found and found[0].score() - price < score
            if not is_hopeless:
                found.append(climb_from(*of_start))
        for _ in range(self.options.n_restarts):
            found.append(climb_from(*redrawn(start, bounds, self.random_state)))
        best = max(found, key=lambda end: end.log_likelihood)
        if self.options.input_noise:
            best = self._with_input_noise(best, bounds)
        return best._replace(price=best.price + price)

    def _price(self, n_determined):
        return price_of(n_determined, self.n_values)

    def _climb(self, kernel, noise, bounds, blocks, max_iter, **options) -> Hyperparameters:
        point = climb(kernel, noise, bounds, blocks, max_iter, **options)
        return Hyperparameters(
            point.kernel,
            point.noise,
            n_iter=point.end.n_iter,
            converged=point.end.converged,
            log_likelihood=point.end.value,
            price=self._price(point.end.n_determined),
            excess=excess_of(point.end.n_determined, self.n_values),
        )

    def _with_input_noise(self, exact: Hyperparameters, bounds: Matrix) -> Hyperparameters:
        """Return hyperparameters with the noise of the regressors (stage 4).

        Slopes of the kernel of stage 3, which had exact regressors, propagate this noise. Stage 3 goes
        on if the data show none, as it does not raise the likelihood of exact regressors.
        """
        unit = exact._replace(input_std=self.scale)
        blocks = [unit.noisy(block).with_loadings() for block in self.blocks]
        noise, input_bounds = initial_input_noise(exact.noise, blocks, self.scale, self.known)
        max_iter = self.options.max_iter
        all_bounds = np.concatenate([bounds, input_bounds])
        start, noise = _by_one_block(exact.kernel, noise, all_bounds, blocks, max_iter)
        noisy = self._climb(start, noise, all_bounds, blocks, max_iter)
        is_known = self.known.input_std is not None
        if noisy.log_likelihood < exact.log_likelihood and not is_known:
            if exact.converged:
                return exact
            end = self._climb(exact.kernel, exact.noise, bounds, self.blocks, max_iter)
            return end._replace(n_iter=exact.n_iter + end.n_iter)
        P = self.Y.shape[1]
        input_std = self.known.input_std if is_known else self.scale * np.sqrt(noisy.noise[P:])
        n_iter = exact.n_iter + noisy.n_iter
        return noisy._replace(noise=noisy.noise[:P], input_std=input_std, n_iter=n_iter)


def _by_one_block(
    kernel: MultiOutputKernel, noise: Vector, bounds: Matrix, blocks: Sequence[Data], max_iter: int
) -> tuple[MultiOutputKernel, Vector]:
    """Return where a climb by the first of several blocks ends, to save time."""
    if len(blocks) == 1:
        return kernel, noise
    point = climb(kernel, noise, bounds, blocks[:1], max_iter)
    return point.kernel, point.noise


def _likelihood(blocks, start):
    """Return the likelihood of a kernel and noise to start from."""
    kernel, noise = start
    objective = Objective(kernel, blocks, len(noise))
    return objective.value(np.concatenate([kernel.theta, np.log(noise)]))


def _blocks_of(X, Y, rows, known):
    """Return the values of the rows of each block of X (n, d) and Y (n, P), with their known noise."""
    return [Data.from_table(X[of], Y[of], known.of_rows(of).added) for of in rows]


def with_best_noise(
    learned: Hyperparameters,
    X: Matrix,
    Y: Matrix,
    rows: Sequence[Indices],
    known: KnownNoise,
    max_iter: int = 100,
) -> Hyperparameters:
    """Return the hyperparameters with the noise (P,) that is best for their kernel.

    It is learned from blocks of rows of X (n, d) and Y (n, P).
    """
    noise, bounds = known.start(learned.kernel.residual(X, Y), output_scale(Y), X)
    if not learned.kernel.n_processes:  # all of the residual is noise
        noise = np.clip(noise / SETTINGS_OF_NOISE.start, *bounds.T)
    learned = learned._replace(noise=noise)
    if known.is_fixed:
        return learned
    blocks = [learned.noisy(block) for block in _blocks_of(X, Y, rows, known)]
    point = climb(
        learned.kernel, noise, bounds, blocks, max_iter, noise_alone=True, stage="members"
    )
    return learned._replace(noise=point.noise)
