"""What an estimator is asked for: the kernel of all terms, and its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sklearn.base import clone

from skdgp._compute.linalg import column_scale, constant_columns
from skdgp._compute.typing import Matrix, Vector
from skdgp._regressor import _checks
from skdgp.inference import (
    BlockSettings,
    Data,
    Fit,
    KnownNoise,
    Posterior,
    SearchOptions,
    SearchSettings,
    average,
    blocks_of_rows,
    check_inducing,
    fit_exact,
    fit_sparse,
    mixture_of,
    search,
    structure_weights,
    widened,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel, as_multi_output


@dataclass(frozen=True)
class RegressorSettings:
    """Choices of the estimator where a parameter is not given."""

    #: Fewest and most shared latents; more take more time
    n_latent: tuple[int, int] = (2, 4)
    #: Bounds of the widths of a time series, in standard deviations of the regressors, and most samples
    #: that the lower one follows from
    width_bounds: tuple[float, float] = (0.05, 1e3)
    samples_of_widths: int = 400
    #: Most observed values for which inference="auto" is exact
    exact_values: int = 6000
    #: The same of a time series
    exact_time_series_values: int = 1000
    #: Largest prior variance that inducing variables leave unexplained, over the noise variance,
    #: of little more values than exact inference takes: errors are within 1 % of exact ones
    least_neglected: float = 0.003
    #: The same where it is possible on a small part of the values; it grows with their number squared
    most_neglected: float = 0.3
    #: Numbers of inducing inputs that inference="auto" tries before that, over ``n_inducing``
    times_inducing: tuple[int, ...] = (1, 2, 4)
    #: Of the search
    search: SearchSettings = field(default_factory=SearchSettings)


class Recipe:
    """How the kernel of an estimator is made and fitted.

    Parameters
    ----------
    estimator : DependentGPRegressor
        Its parameters and settings.
    time_series : bool
        Whether the rows are in the order of recording, with errors that last.
    """

    def __init__(self, estimator: Any, time_series: bool) -> None:
        self.given = estimator
        self.settings: RegressorSettings = estimator.settings
        self.time_series = time_series

    # -- the kernel

    def check(self) -> None:
        """Raise a ValueError if parameters contradict each other."""
        given = self.given
        if given.structure == "trend" and (given.kernel is not None or given.trend != "linear"):
            raise ValueError(
                f"Got structure='trend' with kernel={given.kernel!r} and trend={given.trend!r}, but expected "
                "kernel=None and trend='linear', or structure='joint' for a given kernel."
            )
        if given.n_latent is not None and given.kernel is not None:
            raise ValueError(
                f"Got n_latent={given.n_latent} with kernel={given.kernel!r}, but expected one of them: leave out "
                f"n_latent, and give it to the kernel, such as ConvolvedGaussian({given.n_latent})."
            )

    def make_kernels(self, X: Matrix, Z: Matrix) -> list[MultiOutputKernel]:
        """Return the kernels of all terms to be compared, in the units of the outputs."""
        self.check()
        given = self.given
        n, d = X.shape
        # one centre for all searches and components
        trend = LinearTrend(center=X.mean(axis=0)) if given.trend == "linear" else None
        if given.kernel is not None:
            n_fixed = Z.shape[1] if given.optimizer is None else None
            multi_output = as_multi_output(clone(given.kernel), n_fixed)
            if given.optimizer is not None:
                _checks.check_start(multi_output, X, Z)
            has_trend = any(term.n_processes == 0 for term in multi_output.summands())
            return [multi_output if trend is None or has_trend else trend + multi_output]
        averaged = given.structure == "average" and trend is not None
        if trend is not None and (given.structure == "trend" or (averaged and d > n)):
            return [trend]  # with fewer rows than regressors a process would have no weight
        kernels = self._processes(X, Z)
        return [kernel if trend is None else trend + kernel for kernel in kernels]

    def _processes(self, X, Z):
        """Return the processes of each structure that is compared.

        Outputs that share processes beside one of each alone, with the same length scales for all outputs,
        the shared ones and those of each alone without the others, and all of them with all length scales.
        The first is climbed to its end, often beyond what the next two promise. Of a time series it is
        the only one.
        """
        n_latent = self._number_of_latents(Z)
        if self.time_series:
            bounds = {"length_scale": self._width_bounds(X, Z)}
            return [ConvolvedGaussian(n_latent, covariance_type="tied", parameter_bounds=bounds)]
        independent = ConvolvedGaussian(0)
        kernel = ConvolvedGaussian(n_latent)
        if not self._averages or n_latent == 0:
            return [kernel]
        if Z.shape[1] == 1:
            return [kernel, independent]
        shared = ConvolvedGaussian(n_latent, private_latents=False, covariance_type="tied")
        tied = ConvolvedGaussian(n_latent, covariance_type="tied")
        return [tied, shared, independent, kernel]

    def _width_bounds(self, X, Z):
        """Return the bounds (d, 2) of the widths of a time series, in the units of the regressors.

        n samples of an output in d regressors that vary are 3.5 n^(-1/d) standard deviations apart: a
        process of less than n^(-1/d) is noise to them.
        """
        n = min(np.isfinite(Z).sum(axis=0).max(), self.settings.samples_of_widths)
        d = max(1, int(np.sum(~constant_columns(X))))
        least, most = self.settings.width_bounds
        return np.multiply.outer(column_scale(X), (max(least, n ** (-1.0 / d)), most))

    def _number_of_latents(self, Z):
        """Return the number of shared latents, more where they can fill missing targets."""
        if self.given.n_latent is not None:
            return self.given.n_latent
        fewest, most = self.settings.n_latent
        if self.time_series or np.isfinite(Z).all():
            return fewest
        return int(np.clip(Z.shape[1] // 2, fewest, most))

    # -- the fit

    @property
    def _averages(self):
        return self.given.structure == "average" and self.given.optimizer is not None

    def inference_of(self, n_values: int) -> str:
        """Return "exact" or "sparse", for so many observed values."""
        if self.given.inference != "auto":
            return self.given.inference
        settings = self.settings
        most = settings.exact_time_series_values if self.time_series else settings.exact_values
        return "exact" if n_values <= most else "sparse"

    def learns_input_noise(self, known: KnownNoise) -> bool:
        """Return whether the fit has noise of the regressors."""
        if known.added is not None:
            return False
        if known.input_std is not None:
            return True
        if not isinstance(self.given.input_noise, str):
            return False
        return self.given.input_noise == "learned" or self.time_series

    def fit(
        self, kernels: Sequence[MultiOutputKernel], X: Matrix, Z: Matrix, known: KnownNoise
    ) -> Fit:
        """Return the fit to X (n, d) and centred and scaled targets Z (n, P).

        ``kernels`` have all terms, and ``known`` is the noise, of the scaled targets.
        """
        settings = self.settings
        data = Data.from_table(X, Z, known.added)  # one copy for all
        request = SearchOptions(
            optimizer=self.given.optimizer,
            max_iter=self.given.max_iter,
            random_state=self.given.random_state,
            input_noise=self.learns_input_noise(known),
            n_restarts=self.given.n_restarts_optimizer,
            shifts=len(kernels) > 1,
            time_series=self.time_series,
            settings=settings.search,
        )
        if self.inference_of(data.n_values) == "sparse":
            start = kernels[-1].initialize(X, Z, np.random.RandomState(0))
            check_inducing(start, X, self.given.n_inducing)
        found = search(kernels, X, Z, request, known=known)
        if known.added is None and found[0].added is not None:  # of outliers
            known = known._replace(added=found[0].added)
            data = Data.from_table(X, Z, known.added)
        weights = structure_weights([learned.score() for learned in found])
        likeliest = np.argsort(-weights, kind="stable")[: np.count_nonzero(weights)]
        is_widened = self._is_widened(kernels[0], known, data.n_values)
        fits = []
        for k in likeliest:
            rows, fit = self._fit_of(found[k], X, Z, data, known)
            if self._averages:
                some = known.of_rows(rows)
                fit = average(fit, X[rows], Z[rows], self.time_series, some)
            if is_widened:
                fit = widened(fit)
            fits.append(fit)
        return mixture_of(fits, weights[likeliest].tolist())

    def _is_widened(self, kernel, known, n_values):
        """Return whether all variances are learned, from independent values by exact inference."""
        is_given = self.given.kernel is not None or self.given.optimizer is None
        if is_given or known.bounds is not None or self.time_series:
            return False
        return kernel.n_processes > 0 and self.inference_of(n_values) == "exact"

    def _fit_of(self, learned, X, Z, data, known):
        """Return the rows that are learned from, and the fit to them: some where a sparse fit neglects much."""
        every = slice(None)
        n_exact = self.settings.exact_values
        if self.inference_of(data.n_values) == "exact":
            return every, fit_exact(learned, data, self.time_series, known)
        fit, n_inducing = self._sparse_fit(learned, data, known)
        posterior: Any = fit.posterior.members[0]
        is_auto = self.given.inference == "auto"
        if self._is_good(posterior, learned):
            return every, fit
        neglected = posterior.neglected_variance
        _checks.warn_of_approximation(neglected, n_inducing, n_exact if is_auto else None)
        if not is_auto:
            return every, fit
        (rows,) = blocks_of_rows(X, Z, BlockSettings(values=n_exact))
        some = known.of_rows(rows)
        few = Data.from_table(X[rows], Z[rows], some.added)
        return rows, fit_exact(learned, few, self.time_series, some)

    def _sparse_fit(self, learned, data, known):
        """Return the fit with the fewest inducing inputs of those tried that neglect little, and their number."""
        settings = self.settings
        for times in settings.times_inducing if self.given.inference == "auto" else (1,):
            n_inducing = times * self.given.n_inducing
            fit = fit_sparse(
                learned, data, n_inducing=n_inducing, ordered=self.time_series, known=known
            )
            posterior: Any = fit.posterior.members[0]
            # with more, exact inference takes less time
            if self._is_good(posterior, learned) or 2 * posterior.size > settings.exact_values:
                break
        return fit, n_inducing

    def _is_good(self, posterior, learned):
        """Return whether a sparse posterior neglects little, or, as of a time series, this does not decide."""
        if self.time_series or learned.input_std is not None:
            return True
        settings = self.settings
        most = settings.most_neglected
        if self.given.inference == "auto":
            n_values = posterior.data.n_values
            most = min(most, settings.least_neglected * (n_values / settings.exact_values) ** 2)
        return posterior.neglected_variance <= most


def weights_of(posterior: Posterior) -> dict[str, Vector]:
    """Return the weight (P,) of each kind of component of a posterior, by its name."""
    weights: dict[str, Vector] = {}
    for member, weight in zip(posterior.members, posterior.mixture, strict=True):
        name = "joint" if member.kernel.n_processes else "trend"
        weights[name] = weights.get(name, 0.0) + weight
    return weights


def likeliest_mean(posterior: Posterior, X: Matrix) -> Matrix:
    """Return the mean (n, P) at X (n, d) of each output's component with the largest weight.

    Its errors are noise, where an average still has a part of the errors of the other components.
    """
    means = np.array([member.predict(X) for member in posterior.members])
    likeliest = posterior.mixture.argmax(axis=0)
    return np.take_along_axis(means, likeliest[None, None], axis=0)[0]
