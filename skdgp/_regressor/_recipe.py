"""Request to the estimator, as a value: the kernel of all terms, and its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from sklearn.base import clone
from sklearn.gaussian_process.kernels import Kernel
from sklearn.utils import check_random_state

from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp._regressor import _checks
from skdgp.inference import (
    TIME_SERIES,
    Data,
    Fit,
    KnownNoise,
    Posterior,
    SearchOptions,
    SearchSettings,
    as_exact,
    average,
    check_inducing,
    fit_exact,
    fit_sparse,
    mixture_of,
    search,
    stratified,
    structure_weights,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel, as_multi_output


@dataclass(frozen=True)
class RegressorSettings:
    """Choices of the estimator where a parameter is not given."""

    #: Fewest and most shared latents; more take more time
    n_latent: tuple[int, int] = (2, 4)
    #: Iterations for a time series
    time_series_iterations: int = 60
    #: How often a search goes on while the errors of held-out values fall, of a time series by half as
    #: many iterations: of a solar aircraft's flight they fell by 4 % in 30 further iterations, and by
    #: 1 % in 30 more; of other data also with effects that it missed
    further: int = 2
    #: Iterations for other data
    iterations: int = 75
    #: Most observed values for which inference="auto" is exact
    exact_values: int = 6000
    #: The same of a time series
    exact_time_series_values: int = 1000
    #: Observed values above which inference="auto" tries inducing variables: exact inference takes long
    sparse_values: int = 1500
    #: Largest prior variance that inducing variables leave unexplained, over the noise variance,
    #: where exact inference on all values is possible: errors are within 1 % of exact ones
    least_neglected: float = 0.003
    #: The same where it is possible on a small part of the values; it grows with their number squared
    most_neglected: float = 0.3
    #: Numbers of inducing inputs that inference="auto" tries before that, over ``n_inducing``
    times_inducing: tuple[int, ...] = (1, 2, 4)
    #: Least variance of the white noise, over the noise that the search found
    least_white: float = 0.01
    #: Of each search
    search: SearchSettings = field(default_factory=SearchSettings)
    #: The same of a time series
    time_series_search: SearchSettings = TIME_SERIES


@dataclass(frozen=True)
class Recipe:
    """How a kernel is made and fitted.

    ``time_series`` is whether the rows are in the order of recording, with errors that last. The
    other fields are parameters of DependentGPRegressor.
    """

    kernel: Kernel | None
    n_latent: int | None
    structure: str
    trend: str | None
    inference: str
    n_inducing: int
    input_noise: Any
    optimizer: str | None
    n_restarts_optimizer: int
    max_iter: int | None
    random_state: Seed
    time_series: bool
    settings: RegressorSettings = field(default_factory=RegressorSettings)

    # -- the kernel

    def check(self) -> None:
        """Raise a ValueError if parameters contradict each other."""
        if self.structure == "trend" and (self.kernel is not None or self.trend != "linear"):
            raise ValueError(
                f"Got structure='trend' with kernel={self.kernel!r} and trend={self.trend!r}, but expected "
                "kernel=None and trend='linear', or structure='joint' for a given kernel."
            )
        if self.structure == "additive" and self.kernel is not None:
            raise ValueError(
                f"Got structure='additive' with kernel={self.kernel!r}, but expected kernel=None. "
                "Use structure='joint', and add ConvolvedGaussian(0, regressors=[k]) to the kernel."
            )
        if self.n_latent is not None and self.kernel is not None:
            raise ValueError(
                f"Got n_latent={self.n_latent} with kernel={self.kernel!r}, but expected one of them: leave out "
                f"n_latent, and give it to the kernel, such as ConvolvedGaussian({self.n_latent})."
            )

    def make_kernels(self, X: Matrix, Z: Matrix) -> list[MultiOutputKernel]:
        """Return the kernels of all terms to be compared, in the units of the outputs."""
        self.check()
        n, d = X.shape
        # one centre for all searches and components
        trend = LinearTrend(center=X.mean(axis=0)) if self.trend == "linear" else None
        if self.kernel is not None:
            multi_output = as_multi_output(clone(self.kernel))
            has_trend = any(term.n_processes == 0 for term in multi_output.summands())
            return [multi_output if trend is None or has_trend else trend + multi_output]
        averaged = self.structure == "average" and trend is not None
        if trend is not None and (self.structure == "trend" or (averaged and d > n)):
            return [trend]  # with fewer rows than regressors a process would have no weight
        kernels = self._processes(X, Z, averaged)
        return [kernel if trend is None else trend + kernel for kernel in kernels]

    def _processes(self, X, Z, averaged):
        """Return the joint processes of each structure, with the processes of each regressor alone."""
        d = X.shape[1]
        n_latent = self._number_of_latents(Z)
        bounds = {"length_scale": "spacing"} if self.time_series else None
        kernel: MultiOutputKernel
        kernel = ConvolvedGaussian(n_latent, parameter_bounds=bounds)
        averages_effects = self.time_series and averaged and d > 1
        if self.structure == "additive" or averages_effects:
            for k in range(d):
                kernel = ConvolvedGaussian(0, regressors=[k], parameter_bounds=bounds) + kernel
        if self.time_series or not self._averages or n_latent == 0:
            return [kernel]
        independent = ConvolvedGaussian(0)
        if Z.shape[1] == 1:
            return [independent, kernel]
        tied = ConvolvedGaussian(n_latent, private_latents=False, covariance_type="tied")
        return [independent, tied, kernel]

    def _number_of_latents(self, Z):
        """Return the number of shared latents, more where they can fill missing targets."""
        if self.n_latent is not None:
            return self.n_latent
        fewest, most = self.settings.n_latent
        if self.time_series or np.isfinite(Z).all():
            return fewest
        return int(np.clip(Z.shape[1] // 2, fewest, most))

    # -- the fit

    @property
    def _averages(self):
        return self.structure == "average" and self.optimizer is not None

    def inference_of(self, n_values: int) -> str:
        """Return "exact" or "sparse", for so many observed values."""
        if self.inference != "auto":
            return self.inference
        settings = self.settings
        most = settings.exact_time_series_values if self.time_series else settings.exact_values
        return "exact" if n_values <= most else "sparse"

    @property
    def most_iterations(self) -> int:
        """The largest number of iterations of a joint search."""
        if self.max_iter is not None:
            return self.max_iter
        settings = self.settings
        return settings.time_series_iterations if self.time_series else settings.iterations

    def learns_input_noise(self, known: KnownNoise) -> bool:
        """Return whether the fit has noise of the regressors."""
        if known.loading is not None:
            return False
        if known.input_std is not None:
            return True
        if not isinstance(self.input_noise, str):
            return False
        return self.input_noise == "learned" or self.time_series

    def fit(
        self, kernels: Sequence[MultiOutputKernel], X: Matrix, Z: Matrix, known: KnownNoise
    ) -> Fit:
        """Return the fit to X (n, d) and centred and scaled targets Z (n, P).

        ``kernels`` have all terms, and ``known`` is the noise, of the scaled targets.
        """
        settings = self.settings
        random_state = check_random_state(self.random_state)
        data = Data.from_table(X, Z, known.loading)  # one copy for all
        seeds = random_state.randint(2**31 - 1, size=2)
        request = SearchOptions(
            optimizer=self.optimizer,
            max_iter=self.most_iterations,
            random_state=check_random_state(seeds[0]),
            input_noise=self.learns_input_noise(known),
            n_restarts=self.n_restarts_optimizer,
            shifts=len(kernels) > 1,
            time_series=self.time_series,
            further=settings.further if self.max_iter is None else 0,
            settings=settings.time_series_search if self.time_series else settings.search,
        )
        is_exact = self.inference_of(data.n_values) == "exact"
        if not is_exact:
            check_inducing(kernels[-1], X, Z, self.n_inducing)
        found = search(kernels, X, Z, request, exact=is_exact, known=known)
        weights = structure_weights([learned.score() for learned in found])
        likeliest = np.argsort(-weights, kind="stable")[: np.count_nonzero(weights)]
        fits = []
        for k in likeliest:
            rng = check_random_state(seeds[1])  # the same inducing inputs for all
            samples = _Samples(X, Z, data, known)
            if is_exact:
                fit = self._of_few(found[k], samples, rng)
            else:
                fit, samples = self._of_many(found[k], samples, rng)
            if self._averages and not fit.learned.interrupted:
                fit = self._average(fit, samples, random_state)
            fits.append(fit)
            if fit.learned.interrupted:
                return fits[0].cut_short()
        return mixture_of(fits, weights[likeliest].tolist())

    def _of_few(self, learned, samples, rng):
        """Return the fit of samples that exact inference can take all of."""
        is_large = samples.data.n_values > self.settings.sparse_values
        if is_large and self.inference == "auto" and self._can_neglect(learned):
            fit = self._sparse(learned, samples, self.n_inducing, rng)
            if fit.posterior.neglected_variance <= self.settings.least_neglected:
                return fit
        return fit_exact(
            learned.kernel,
            samples.X,
            samples.Z,
            known=samples.known,
            data=samples.data,
            learned=learned,
            optimizer=self.optimizer,
        )

    def _of_many(self, learned, samples, rng):
        """Return the sparse fit, or if it neglects much the exact fit of some samples, and the samples."""
        settings = self.settings
        is_auto = self.inference == "auto"
        most = settings.most_neglected
        if is_auto:
            grown = settings.least_neglected * (samples.data.n_values / settings.exact_values) ** 2
            most = min(grown, most)
        for times in settings.times_inducing if is_auto else (1,):
            n_inducing = times * self.n_inducing
            fit = self._sparse(learned, samples, n_inducing, rng)
            if not self._can_neglect(fit.learned):
                return fit, samples
            neglected = fit.posterior.neglected_variance
            if neglected <= most:
                return fit, samples
            if 2 * fit.posterior.size > settings.exact_values:
                break  # exact inference takes less time
        n_exact = settings.exact_values if is_auto else None
        _checks.warn_of_approximation(neglected, n_inducing, n_exact)
        if not is_auto:
            return fit, samples
        n_rows = settings.exact_values * len(samples.X) // samples.data.n_values
        rows = stratified(np.arange(len(samples.X)), n_rows, rng)
        few = samples.of_rows(rows)
        learned = fit.learned
        return as_exact(learned, few.X, few.Z, learned.noisy(few.data), few.known), few

    def _can_neglect(self, learned):
        """Return whether the variance that inducing variables neglect is known, and decides."""
        return not (self.time_series or learned.interrupted or learned.input_std is not None)

    def _sparse(self, learned, samples, n_inducing, rng):
        """Return the fit with so many inducing inputs."""
        return fit_sparse(
            learned.kernel,
            samples.X,
            samples.Z,
            n_inducing=n_inducing,
            ordered=self.time_series,
            known=samples.known,
            data=samples.data,
            learned=learned,
            random_state=rng,
        )

    def _average(self, fit, samples, random_state):
        """Return the average of the terms of the kernel of a fit."""
        order = None if self.time_series else random_state
        return average(fit, samples.X, samples.Z, order, samples.known)


class _Samples(NamedTuple):
    """Inputs (n, d), targets (n, P), their observed values, and the known noise."""

    X: Matrix
    Z: Matrix
    data: Data
    known: KnownNoise

    def of_rows(self, rows):
        """Return some samples."""
        X, Z, known = self.X[rows], self.Z[rows], self.known.of_rows(rows)
        return _Samples(X, Z, Data.from_table(X, Z, known.loading), known)


def weights_of(posterior: Posterior) -> dict[str, Vector]:
    """Return the weight (P,) of each kind of component of a posterior, by its name."""
    weights: dict[str, Vector] = {}
    for member, weight in zip(posterior.members, posterior.mixture, strict=True):
        name = _name(member.kernel)
        weights[name] = weights.get(name, 0.0) + weight
    return weights


def _name(kernel):
    """Return the structure of a component of an average."""
    terms = [term for term in kernel.summands() if not isinstance(term, LinearTrend)]
    if not terms:
        return "trend"
    if kernel.n_features == 1 or any(len(term.term_regressors()[0]) > 1 for term in terms):
        return "joint"
    return "additive"


def likeliest_mean(posterior: Posterior, X: Matrix) -> Matrix:
    """Return the mean (n, P) at X (n, d) of each output's component with the largest weight.

    Its errors are noise, where an average still has a part of the errors of the other components.
    """
    means = np.array([member.predict(X) for member in posterior.members])
    likeliest = posterior.mixture.argmax(axis=0)
    return np.take_along_axis(means, likeliest[None, None], axis=0)[0]
