"""The search for hyperparameters, in stages.

1. Each output alone (``outputs_alone``).
2. All outputs, with widths that they share (``_shared_widths``).
3. All hyperparameters (``_all_hyperparameters``, ``_with_input_noise``).
4. The noise alone, if stage 3 neglected correlations between outputs (``_noise_alone``).

Stages 2 to 4, ``from_one_start``, learn from ``some_rows``. Of several structures a short trial
leaves the promising ones (``_StructureTrial``). Each stage is a call of ``climb`` (``_objective.py``),
which maximises one likelihood from one starting point. Stage 3 of rows that are no time series learns
from batches, whose likelihoods add up, and goes on where a test finds ``missed_effects``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, keep_freed_memory, output_scale
from skdgp._compute.messages import Progress
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix, Seed, Vector
from skdgp.inference._likelihood import (
    Data,
    held_out_error,
    log_likelihood,
)
from skdgp.inference._missed import missed_effects
from skdgp.inference._noise import UNKNOWN, KnownNoise, initial_input_noise
from skdgp.inference._objective import Objective, Point, climb
from skdgp.inference._optimizer import OptimizerSettings
from skdgp.inference._posterior import ExactPosterior
from skdgp.inference._shifts import found_shifts, price_of_shifts
from skdgp.inference._starts import (
    coarse,
    from_coarse,
    from_simpler,
    narrowed,
    single_output,
    starting_kernel,
    with_effects,
)
from skdgp.inference._structures import (
    contains,
    has_shared_latents,
    n_mattering,
    with_shifts,
)
from skdgp.kernels import MultiOutputKernel

#: Spacing of the points of a search, over the width of the bounds
GRID = 2.0**-14


@dataclass(frozen=True)
class SearchSettings:
    """How many values and iterations a search takes, and from where it starts."""

    #: Fewest and most values that the joint search of a time series learns from; its time grows with
    #: their third power
    values: tuple[int, int] = (1000, 1800)
    #: Values of a batch of other rows, fewest and most batches, and observed values for each; the time
    #: grows with the number of batches
    batch_values: int = 1000
    batches: tuple[int, int] = (2, 3)
    values_for_batch: int = 2000
    #: Most values that shared widths are learned from
    coarse_values: int = 900
    #: Most values, and iterations, of a trial of several structures
    structure_values: int = 600
    structure_iterations: int = 25
    #: Largest price of hyperparameters, over the number of values
    most_price: float = 0.5
    #: Distance from the best score up to which a structure is searched again on all values [nats],
    #: and that of the richest structure, which more values favour
    trial_margins: tuple[float, float] = (10.0, 100.0)
    #: Values of each output of a time series, between these
    output_values: int = 300
    #: Most values of an output alone
    single_values: int = 400
    #: Most iterations for an output alone
    single_iterations: int = 40
    #: Most values of each short trial for an output alone
    trial_values: int = 150
    #: Most iterations of each trial
    trial_iterations: int = 20
    #: Starting widths of the trials, over the estimates of ``initialize``
    width_factors: tuple[float, ...] = (1.0, 0.3, 0.1)
    #: Widths whose likelihood is compared with the best trial
    narrow_factors: tuple[float, ...] = (0.1, 0.05, 0.025, 0.012, 0.006)
    #: Noise at these widths, over its starting value
    noise_factors: tuple[float, ...] = (1.0, 0.1)
    #: Most steps, or iterations, that change the noise alone
    noise_steps: int = 10
    #: Expected rise of the likelihood for each value up to which a search has converged [nats]
    irrelevant_rise: float = 0.05
    #: Expected fall of the error of held-out values, over itself, up to which a search has converged,
    #: and expected rise of the likelihood for each value beyond which it has not (guess) [nats]
    irrelevant_fall: float = 0.02
    relevant_rise: float = 0.2
    #: Blocks of a time series that are held out in turn: errors are correlated over a tenth of it
    n_blocks: int = 8
    #: Of each maximisation
    optimizer: OptimizerSettings = field(default_factory=lambda: OptimizerSettings(grid=GRID))


SETTINGS = SearchSettings()
#: The same for a time series. Its errors are correlated, and its likelihood still rises where errors of
#: other flights no longer fall: a search by information has larger ones (eight fits of three aircraft:
#: 0.141 and 0.148)
TIME_SERIES = SearchSettings(
    structure_iterations=50,
    trial_iterations=40,
    single_iterations=100,
    optimizer=OptimizerSettings(grid=GRID, by_information=False),
)


@dataclass(frozen=True)
class SearchOptions:
    """What a search is asked for.

    Parameters
    ----------
    optimizer : "fmin_l_bfgs_b" or None
        None keeps the starting values, and estimates noise that is not known.
    max_iter : int
        Of the joint search.
    random_state : int, RandomState or None
    input_noise : bool
        Whether a standard deviation of the noise of each regressor is learned.
    n_restarts : int
        Joint searches from other random starts, of which the likeliest counts.
    shifts : bool
        Whether kernels with shifts are searched too, where separate fits of the outputs show them.
    time_series : bool
        Whether the rows are a time series, so that convergence is judged by held-out blocks.
    further : int
        How often the last stage goes on with as many iterations, as long as it has not converged,
        and, if the rows are no time series, with effects that it missed.
    settings : SearchSettings
    """

    optimizer: str | None
    max_iter: int
    random_state: Seed
    input_noise: bool = False
    n_restarts: int = 0
    shifts: bool = False
    time_series: bool = False
    further: int = 0
    settings: SearchSettings = SETTINGS


class Hyperparameters(NamedTuple):
    """Hyperparameters and the history of the search that found them.

    ``noise`` (P,) is white. ``input_std`` (d,) are the standard deviations of the regressors'
    noise, None for exact regressors. ``remaining`` is the expected rise of the likelihood by
    further iterations. ``is_unbiased``: variances are multiplied by ``unbiased_factor``.
    ``log_likelihood`` is of the values of the search, a sum over ``n_batches``. ``price`` is one for
    each hyperparameter that matters, and the price of shifts.
    """

    kernel: MultiOutputKernel
    noise: Vector
    input_std: Vector | None = None
    n_iter: int = 0
    interrupted: bool = False
    remaining: float = 0.0
    converged: bool = True
    is_unbiased: bool = False
    log_likelihood: float = -np.inf
    n_batches: int = 1
    price: float = 0.0

    def score(self, ratio: float = 1.0) -> float:
        """Return the logarithm of the weight among structures, for a likelihood of ``ratio`` times as many values.

        Of batches it is the mean, as they may show the same function.
        """
        return ratio * self.log_likelihood / self.n_batches - self.price

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


def search(
    kernels: Sequence[MultiOutputKernel],
    X: Matrix,
    Y: Matrix,
    options: SearchOptions,
    *,
    exact: bool = False,
    known: KnownNoise = UNKNOWN,
) -> list[Hyperparameters]:
    """Return hyperparameters of each kernel, learned from each output separately and then from some rows of all.

    The kernels have the same terms for one output, whose separate fits they share; simple ones are
    first. With ``options.shifts`` the same kernels with shifts follow, where separate fits correlate
    more with shifts, as long as these raise the score.

    Without ``exact`` the search neglects the correlation of outputs by errors of the regressors, so
    noise is learned again at the end. Without an optimizer the first kernel keeps its values, and
    noise that is not known is estimated for it.

    Parameters
    ----------
    kernels : sequence of MultiOutputKernel
        Missing values are estimated from the data.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    options : SearchOptions
    exact : bool
        Whether the likelihood has the correlation of outputs by errors of the regressors.
    known : KnownNoise

    Returns
    -------
    list of Hyperparameters
        Of the kernels, then of those with shifts.
    """
    keep_freed_memory()
    random_state = check_random_state(options.random_state)
    settings = options.settings
    rows = some_rows(Y, random_state, settings, options.time_series)
    kernel = kernels[0]
    start = starting_kernel(kernel, X, Y, random_state)
    noise, bounds = known.start(start.residual(X, Y), output_scale(Y))
    if options.optimizer is None:
        hyperparameters = Hyperparameters(start, noise, known.input_std)
        data = Data.from_table(X, Y, known.loading)
        if exact:
            data = hyperparameters.noisy(data)
        return [best_noise(hyperparameters, X, Y, data, known, settings)]

    stop = Event()
    all_rows = _JointSearch(
        X, Y, known, None, noise, bounds, stop, options, exact, column_scale(X), random_state
    )
    joint = all_rows.of_rows(rows)
    single_kernel = single_output(kernel)
    shift = None
    if single_kernel is not None and not kernel.has_values():
        fits = all_rows.outputs_alone(single_kernel)
        single_kernels = [fit.kernel for fit in fits]
        noise = np.concatenate([fit.noise for fit in fits])
        joint = joint._replace(single_kernels=single_kernels, noise=noise)
        if options.shifts and len(single_kernels) > 1:
            shift = found_shifts(single_kernels, noise, X, Y)

    if len(kernels) == 1:
        return [joint.from_all_starts(kernel)]
    ends = _StructureTrial(joint, kernels).ends(shift)
    if stop.is_set():  # even where it ended the search of another structure
        ends = [end._replace(interrupted=True) for end in ends]
    return ends


class _Structure(NamedTuple):
    """A kernel without values that a search compares with others."""

    kernel: MultiOutputKernel
    is_richest: bool = False  #: Of those without shifts
    shift_price: float = 0.0  #: What its likelihood pays for the choice of its shifts [nats]


class _StructureTrial:
    """The search of several structures: a trial on few values, then the promising ones on all.

    The likelihood of all values is taken as proportional to the likelihood of few.
    """

    def __init__(self, joint: _JointSearch, kernels: Sequence[MultiOutputKernel]) -> None:
        self.joint = joint
        self.trial = joint.trial()
        self.structures = [_Structure(kernel, kernel is kernels[-1]) for kernel in kernels]
        # where the trials ended
        self.trial_ends: list[Hyperparameters] = []

    def ends(self, shift: Matrix | None) -> list[Hyperparameters]:
        """Return hyperparameters of the structures that the trial leaves, and of those with shifts (P, d)."""
        for structure in self.structures:
            self.trial_ends.append(self.trial.from_simpler_ends(structure, self.trial_ends))
        if shift is not None:
            self._try_shifts(shift)
        joint = self.joint
        is_whole_search = self.trial is joint
        if is_whole_search or joint.stop.is_set():
            return self.trial_ends
        has_all_values = self.trial.n_values == joint.n_values
        ends: list[Hyperparameters] = []
        for k in self._promising():
            structure = self.structures[k]
            if has_all_values:
                end = joint.from_trial_end(structure, self.trial_ends[k])
            else:
                end = joint.from_simpler_ends(structure, ends)
            ends.append(end)
        return ends

    def _try_shifts(self, shift: Matrix) -> None:
        """Add the structures with shifts (P, d), as long as these raise the score."""
        for structure, without in [*zip(self.structures, self.trial_ends, strict=True)]:
            if not has_shared_latents(structure.kernel):
                continue
            kernel = with_shifts(structure.kernel, shift, self.trial.X)
            shifted = _Structure(kernel, shift_price=price_of_shifts(shift))
            end = self.trial.from_simpler_ends(shifted)
            self.structures.append(shifted)
            self.trial_ends.append(end)
            if end.score() < without.score():
                break

    def _promising(self) -> Indices:
        """Return the places of the structures whose score is near the best."""
        n_values = self.joint.n_values
        ratio = n_values / self.joint.n_batches(n_values) / self.trial.n_values
        scores = np.array([end.score(ratio) for end in self.trial_ends])
        margin, of_richest = self.joint.options.settings.trial_margins
        is_richest = [structure.is_richest for structure in self.structures]
        margins = np.where(is_richest, of_richest, margin)
        return np.flatnonzero(scores > scores.max() - margins)


class _JointSearch(NamedTuple):
    """Stages 1 to 4 on some rows, from kernels of the outputs alone and their noise, within bounds of the noise."""

    X: Matrix
    Y: Matrix
    known: KnownNoise
    single_kernels: list[MultiOutputKernel] | None
    noise: Vector
    bounds: Matrix
    stop: Event
    options: SearchOptions
    exact: bool
    scale: Vector
    random_state: Any

    @property
    def n_values(self) -> int:
        """Number of observed values."""
        return int(np.isfinite(self.Y).sum())

    def n_batches(self, n_values: int) -> int:
        """Return the number of batches of so many values whose likelihoods add up, one of a time series."""
        if self.options.time_series:
            return 1
        return max(1, round(n_values / self.options.settings.batch_values))

    def of_rows(self, rows: Any) -> _JointSearch:
        """Return the search on some rows."""
        return self._replace(X=self.X[rows], Y=self.Y[rows], known=self.known.of_rows(rows))

    @one_blas_thread()  # two threads gain nothing on small matrices
    def outputs_alone(self, kernel: MultiOutputKernel) -> list[Point]:
        """Return fits of a kernel to each output alone (stage 1).

        A single output has 1/P of the values, so an evaluation costs 1/P^3 of a joint one.
        """
        settings = self.options.settings
        loading = self.known.loading
        fits = []
        n_outputs = self.Y.shape[1]
        for i, seed in enumerate(self.random_state.randint(2**31 - 1, size=n_outputs)):
            observed = np.flatnonzero(np.isfinite(self.Y[:, i]))
            rows = stratified(observed, settings.single_values, np.random.RandomState(seed))
            column = slice(i, i + 1)
            of_output = None if loading is None else loading[rows, column]
            problem = SingleOutput(
                kernel,
                Data.from_table(self.X[rows], self.Y[rows, column], of_output),
                self.noise[column],
                self.bounds[column],
                Progress(f"output {i + 1}", i, n_outputs),
                self.stop,
                settings,
            )
            fits.append(problem.fit(self.options.max_iter, seed))
        return fits

    def trial(self) -> _JointSearch:
        """Return a short search, on few values where there are more.

        Itself where all values are few, and `from_trial_end` could not go on from its end.
        """
        settings = self.options.settings
        step = -(-self.n_values // settings.structure_values)
        if step == 1 and (self.options.input_noise or self.options.n_restarts):
            return self
        rows = np.arange(0, len(self.X), step)
        max_iter = min(self.options.max_iter, settings.structure_iterations)
        return self.of_rows(rows)._replace(options=replace(self.options, max_iter=max_iter))

    def from_simpler_ends(
        self, structure: _Structure, simpler_ends: Sequence[Hyperparameters] = ()
    ) -> Hyperparameters:
        """Return the hyperparameters of a structure, with its price, from all starts.

        These are its own, and the ends of simpler structures that it contains and that are not much
        worse. The best score counts.
        """
        kernel = structure.kernel
        best = self._priced(structure, self.from_all_starts(kernel))
        _, margin = self.options.settings.trial_margins
        for simpler in simpler_ends:
            is_promising = simpler.score() > best.score() - margin
            if contains(kernel, simpler.kernel) and is_promising and not self.stop.is_set():
                other = self._priced(structure, self.from_one_start(kernel, simpler))
                if other.score() > best.score():
                    best = other
        return best._replace(interrupted=self.stop.is_set())

    def from_trial_end(self, structure: _Structure, trial: Hyperparameters) -> Hyperparameters:
        """Return the hyperparameters of a structure, from where a trial on the same values ended, with its price."""
        n_left = self.options.max_iter - trial.n_iter
        if n_left < 1:
            return trial
        data = Data.from_table(self.X, self.Y, self.known.loading)
        learned = self._until_converged(trial.kernel, trial.noise, self.bounds, data, n_left)
        learned = learned._replace(n_iter=trial.n_iter + learned.n_iter)
        return self._priced(structure, learned)

    def _priced(self, structure: _Structure, learned: Hyperparameters) -> Hyperparameters:
        """Return hyperparameters with the price of their structure."""
        price = min(
            n_mattering(learned.kernel, self.X), self.options.settings.most_price * self.n_values
        )
        return learned._replace(price=price + structure.shift_price)

    def from_all_starts(self, kernel: MultiOutputKernel) -> Hyperparameters:
        """Return the hyperparameters of a kernel with the largest likelihood, from its own start and random ones."""
        best = self.from_one_start(kernel)
        for _ in range(self.options.n_restarts):
            if self.stop.is_set():
                break
            other = self.from_one_start(self._redrawn(kernel))
            if other.log_likelihood > best.log_likelihood:
                best = other
        return best._replace(interrupted=self.stop.is_set())

    def _redrawn(self, kernel):
        """Return a kernel with values drawn inside its bounds; missing values are drawn by each start."""
        if not kernel.has_values():
            return kernel
        start = self._start(kernel)
        return start.clone_with_theta(self.random_state.uniform(*start.bounds.T))

    def from_one_start(
        self, kernel: MultiOutputKernel, simpler: Hyperparameters | None = None
    ) -> Hyperparameters:
        """Return the hyperparameters of a kernel from its own start, or a simpler kernel's end (stages 2 to 4)."""
        options = self.options
        data = Data.from_table(self.X, self.Y, self.known.loading)
        start = self._start(kernel)
        shared = self._start(coarse(kernel))
        # few values show shared widths, unless slopes of stage 2 propagate noise of the regressors
        # (example flights, four seeds: errors 7 % larger)
        step = 1 if options.input_noise else -(-data.n_values // options.settings.coarse_values)
        if shared.n_dims == start.n_dims and step == 1 and not options.input_noise:
            return self._all_hyperparameters(kernel, start, self.noise, data, 0)
        stage_2 = self._shared_widths(shared, data.every(step), simpler)
        shared, noise, end = stage_2
        start = from_coarse(kernel, start, shared)
        if options.input_noise:
            noisy = self._with_input_noise(start, data, stage_2)
            if noisy is not None:
                return noisy
        return self._all_hyperparameters(kernel, start, noise, data, end.n_iter)

    def _shared_widths(
        self, start: MultiOutputKernel, data: Data, simpler: Hyperparameters | None
    ) -> Point:
        """Return where stage 2 ends, from a kernel whose outputs share widths, or from a simpler kernel's end.

        From shared widths, stage 3 needs few iterations, and ends at optima that predict better than
        those reached from arbitrary widths.
        """
        max_iter = self.options.max_iter
        half = min(-(-max_iter // 2), max_iter - 1)  # stage 3 has at least one
        noise = self.noise
        if simpler is not None:
            start = from_simpler(start, simpler.kernel)
            noise = simpler.noise
        return self._climb(start, noise, self.bounds, data, half)

    def _all_hyperparameters(
        self,
        kernel: MultiOutputKernel,
        start: MultiOutputKernel,
        noise: Vector,
        data: Data,
        n_iter: int,
    ) -> Hyperparameters:
        """Return all hyperparameters of a ``kernel`` from a start (stage 3), for exact regressors."""
        n_left = self.options.max_iter - n_iter
        learned = self._until_converged(start, noise, self.bounds, data, n_left)
        if not self.options.time_series:
            learned = self._with_missed_effects(kernel, learned, data, n_left)
        return learned._replace(n_iter=n_iter + learned.n_iter)

    def _with_missed_effects(self, kernel, learned, data, n_iter) -> Hyperparameters:
        """Return hyperparameters with effects of single regressors that this search missed."""
        batches = data.batches(self.n_batches(data.n_values))
        for _ in range(self.options.further):
            if self.stop.is_set():
                break
            effects = missed_effects(learned.kernel, learned.noise, batches, self.X)
            start = with_effects(kernel, learned.kernel, effects, self.X)
            if np.array_equal(start.theta, learned.kernel.theta):
                break
            other = self._until_converged(start, learned.noise, self.bounds, data, n_iter)
            rise = other.log_likelihood - learned.log_likelihood
            if rise <= n_mattering(other.kernel, self.X) - n_mattering(learned.kernel, self.X):
                break
            learned = other._replace(n_iter=learned.n_iter + other.n_iter)
        return learned

    def _with_input_noise(
        self, start: MultiOutputKernel, data: Data, stage_2: Point
    ) -> Hyperparameters | None:
        """Return all hyperparameters with the noise of the regressors (stages 3 and 4).

        Slopes of the kernel of stage 2, which had exact regressors, propagate this noise. None: the
        data show none, as it does not raise the likelihood of exact regressors.
        """
        shared, noise, exact_end = stage_2
        data = Hyperparameters(shared, noise, self.scale).noisy(data, 1).with_loadings()
        noise, input_bounds = initial_input_noise(noise, data, self.scale, self.known)
        bounds = np.concatenate([self.bounds, input_bounds])
        n_left = self.options.max_iter - exact_end.n_iter
        learned = self._until_converged(start, noise, bounds, data, n_left)
        noise = learned.noise
        is_known = self.known.input_std is not None
        gains = learned.log_likelihood >= exact_end.value
        if not gains and not is_known and not self.stop.is_set():
            return None
        if not self.exact and not self.stop.is_set():
            noise = self._noise_alone(learned.kernel, noise, bounds)
        P = self.Y.shape[1]
        if is_known:
            input_std = self.known.input_std
        else:
            input_std = self.scale * np.sqrt(noise[P:])
        return learned._replace(
            noise=noise[:P],
            input_std=input_std,
            n_iter=exact_end.n_iter + learned.n_iter,
            interrupted=self.stop.is_set(),
        )

    def _until_converged(self, start, noise, bounds, data, n_iter) -> Hyperparameters:
        """Return the hyperparameters after so many iterations, or further ones as long as they gain something."""
        point = self._climb(start, noise, bounds, data, n_iter)
        n_done = point.end.n_iter
        converged = self._gains_nothing(point, data, n_iter)
        for _ in range(self.options.further):
            if converged or self.stop.is_set():
                break
            before = point
            point = self._climb(before.kernel, before.noise, bounds, data, n_iter)
            n_done += point.end.n_iter
            converged = self._gains_nothing(point, data, n_iter, before)
        return Hyperparameters(
            point.kernel,
            point.noise,
            n_iter=n_done,
            interrupted=self.stop.is_set(),
            remaining=point.end.remaining,
            converged=converged,
            log_likelihood=point.end.value,
            n_batches=self.n_batches(data.n_values),
        )

    def _gains_nothing(
        self, point: Point, data: Data, n_iter: int, before: Point | None = None
    ) -> bool:
        """Return whether as many iterations again are expected to improve likelihood or errors by nothing relevant.

        The likelihood may rise for long by widths that hardly change predictions, or worsen them. So
        the error of held-out values counts, that may not fall more than in as many iterations
        ``before``, or is extrapolated from the last evaluations.
        """
        kernel, noise, end = point
        settings = self.options.settings
        if end.converged:
            return True
        rise = end.remaining / data.n_values
        if rise <= settings.irrelevant_rise:
            return True
        if end.earlier is None or self.stop.is_set() or rise > settings.relevant_rise:
            return False
        if end.n_since < settings.optimizer.recent - 1:  # too few evaluations to extrapolate
            return False
        n_blocks = settings.n_blocks if self.options.time_series else None
        data = data.batches(self.n_batches(data.n_values))[0]
        latest = held_out_error(kernel, noise, data, n_blocks)
        if before is not None:
            fall = held_out_error(before.kernel, before.noise, data, n_blocks) - latest
        else:
            earlier = Objective(kernel, data, len(noise)).at(end.earlier)
            fall = (held_out_error(*earlier, data, n_blocks) - latest) * n_iter / end.n_since
        return fall <= settings.irrelevant_fall * latest

    def _noise_alone(self, kernel, noise, bounds):
        """Return the noise vector learned from every other row (stage 4).

        White noise is learned again from all samples.
        """
        settings = self.options.settings
        data = Data.from_table(self.X[::2], self.Y[::2])
        data = Hyperparameters(kernel, noise[: self.Y.shape[1]], self.scale).noisy(data, 1)
        point = climb(
            kernel,
            noise,
            bounds,
            data,
            settings.noise_steps,
            self.stop,
            optimizer=settings.optimizer,
            noise_alone=True,
        )
        return point.noise

    def _start(self, kernel):
        return starting_kernel(kernel, self.X, self.Y, self.random_state, self.single_kernels)

    def _climb(self, start, noise, bounds, data, max_iter) -> Point:
        """Return the best kernel and noise found from a start."""
        return climb(
            start,
            noise,
            bounds,
            data,
            max_iter,
            self.stop,
            optimizer=self.options.settings.optimizer,
            common=self.exact,
            n_batches=self.n_batches(data.n_values),
        )


def best_noise(
    learned: Hyperparameters,
    X: Matrix,
    Y: Matrix,
    data: Data,
    known: KnownNoise = UNKNOWN,
    settings: SearchSettings = SETTINGS,
) -> Hyperparameters:
    """Return the hyperparameters with the noise (P,) that is best for their kernel.

    It is learned from at most 1800 of the values of X and Y. After Ctrl-C it is the best so far,
    and the result is interrupted.
    """
    noise, bounds = known.start(learned.kernel.residual(X, Y), output_scale(Y))
    if known.is_fixed:
        return learned._replace(noise=noise)
    chosen = data.every(-(-data.n_values // settings.values[1]))
    stop = Event()
    end = climb(
        learned.kernel,
        noise,
        bounds,
        chosen,
        settings.noise_steps,
        stop,
        optimizer=settings.optimizer,
        noise_alone=True,
        stage="members",
    )
    return learned._replace(noise=end.noise, interrupted=learned.interrupted or stop.is_set())


# -- the rows that a search learns from


def stratified(rows: Any, n: int, random_state: Any) -> Any:
    """Return a stratified sample of at most n rows: a random one of each of n equal parts, as neighbours are redundant.

    A row that two parts share may be drawn for both. It counts once: values that are there twice
    look free of noise.
    """
    if n >= len(rows):
        return rows
    edges = np.linspace(0, len(rows), n + 1)
    places = edges[:-1] + np.diff(edges) * random_state.uniform(size=n)
    return rows[np.unique(places.astype(int))]


def some_rows(
    Y: Matrix, random_state: Any, settings: SearchSettings = SETTINGS, time_series: bool = False
) -> Any:
    """Return rows that a search learns from: each output has about half of an equal share of the values, more, or all.

    A row that is added for one output brings values of all, so outputs with gaps do not get a whole
    share.
    """
    observed = np.isfinite(Y)
    P = Y.shape[1]
    n_batches = np.clip(round(observed.sum() / settings.values_for_batch), *settings.batches)
    n_values = int(n_batches) * settings.batch_values
    if time_series:
        n_values = int(np.clip(P * settings.output_values, *settings.values))
    share = -(-n_values // P)
    n_rows = max(2, P * share * len(Y) // observed.sum())
    rows = stratified(np.arange(len(Y)), n_rows, random_state)
    for output in observed.T:
        n_wanted = min(-(-share // 2), output.sum())
        n_missing = n_wanted - output[rows].sum()
        unused = np.setdiff1d(np.flatnonzero(output), rows, assume_unique=True)
        rows = np.concatenate([rows, stratified(unused, max(n_missing, 0), random_state)])
    return np.sort(rows)


# -- each output alone


class SingleOutput(NamedTuple):
    """The search for one output: its observed values, and where noise starts."""

    kernel: MultiOutputKernel
    data: Data
    noise: Vector
    noise_bounds: Matrix
    stage: str
    stop: Event
    settings: SearchSettings

    def fit(self, max_iter: int, seed: int) -> Point:
        """Return the end of the search, after at most twice ``max_iter`` iterations.

        From widths that are much too long, the nearest optimum explains everything as noise. Short
        trials from several widths avoid it. A function that turns often, such as a sine of many
        periods, has an optimum so narrow that the trials miss it. So the best trial is compared
        with narrow starts by the likelihood of all values.
        """
        settings = self.settings
        (x,), (y,) = self.data.X, self.data.y
        start = starting_kernel(self.kernel, x, y[:, None], np.random.RandomState(seed))
        few_values = self.data.every(max(1, len(y) // settings.trial_values))
        few = min(settings.trial_iterations, max_iter)
        trials = []
        tried = set()
        for factor in settings.width_factors:
            trial = narrowed(self.kernel, start, factor)
            if trial.theta.tobytes() not in tried:  # a trend has no widths
                tried.add(trial.theta.tobytes())
                trials.append(self._climb(trial, self.noise, few_values, few))
        best = max(trials, key=lambda trial: trial.end.value)
        starts = [(best.kernel, best.noise)]
        for width, factor in product(settings.narrow_factors, settings.noise_factors):
            starts.append((narrowed(self.kernel, start, width), factor * self.noise))
        likeliest = max(starts, key=self._likelihood)
        return self._climb(*likeliest, self.data, min(settings.single_iterations, 2 * max_iter))

    def _likelihood(self, start):
        kernel, noise = start
        try:
            return log_likelihood(kernel, noise, self.data)
        except np.linalg.LinAlgError:
            return -np.inf

    def _climb(self, kernel, noise, data, max_iter):
        optimizer = self.settings.optimizer
        n_processes = max(1, kernel.n_processes)
        optimizer = replace(optimizer, tolerance=n_processes * optimizer.tolerance)
        return climb(
            kernel,
            noise,
            self.noise_bounds,
            data,
            max_iter,
            self.stop,
            optimizer=optimizer,
            stage=self.stage,
        )
