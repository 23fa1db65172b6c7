"""DependentGPRegressor, and the validation of its data and targets."""

from __future__ import annotations

import warnings
from functools import partial
from numbers import Integral, Real

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import r2_score
from sklearn.utils import check_array, check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._compute.checkpoint import fit_record, run_recorded
from skdgp._compute.linalg import check_memory, column_scale, constant_columns, eigen_root
from skdgp._compute.parallel import check_n_jobs, fit_map
from skdgp._compute.progress import CallbackSupportMixin, FitTask
from skdgp._compute.sklearn_compat import HasMethods, Interval, StrOptions, fit_context
from skdgp._compute.tables import column_names
from skdgp.inference import (
    Data,
    choose_kernel,
    compact,
    fit_exact,
    fit_sparse,
    held_out_errors,
    input_noise_loading,
    output_correlation,
)
from skdgp.kernels import BasisTrend, ConvolvedGaussian, LinearTrend, MultiOutputKernel

EXACT_LIMIT = 6000
"""Observed values up to which inference="auto" is exact: about two seconds an evaluation on two cores."""

AUTO_LATENT = 2  # shared, that structure="auto" compares with the trend where n_latent="auto"
MOST_LATENT = 3  # shared, that n_latent="auto" tries
MOST_NOISE = 10  # standard deviation of a regressor's noise, over that of the regressor
X_RANGE = (1e-60, 1e60)  # magnitudes of regressors: their fourth powers are numbers
MUCH = 0.5  # change of a prediction by compacting, in standard deviations, that is warned of unasked
Y_RANGE = (1e-100, 1e100)  # magnitudes of targets: their squares are numbers
FEWER_VALUES = (
    "Use inference='sparse', or observe fewer: skdgp.model_selection.thin_targets(Y, 755) keeps 755 samples spread "
    "over the log."
)
FEWER_LATER = (
    "Compact the model first (model.compact(), which goes on learning in memory that does not grow), or fit with "
    "inference='sparse'."
)
FEWER_SAMPLES = "Ask for fewer samples at a time, or for return_std=True, which needs no joint covariance."


class DependentGPRegressor(CallbackSupportMixin, MultiOutputMixin, RegressorMixin, BaseEstimator):
    r"""Gaussian-process regression of several outputs with the dependencies between them.

    Output i is a trend, plus a sum of white-noise processes that the outputs share, each through a Gaussian
    filter of the output's own, plus measurement noise:

    .. math:: y_i(s) = t_i(s) + \sum_m (h_{mi} * x_m)(s) + w_i(s), \quad w_i \sim N(0, \sigma_i^2).

    Filters, trend and noise are learned together by maximising the marginal likelihood (Boyle & Frean 2005;
    Hemakumara & Sukkarieh 2011, equations 14 to 20). What one output's samples say of a shared latent process
    is known to all: an output that is noisy, or observed less often, borrows from the others.

    Cost: N is the number of observed values (samples times outputs). One evaluation of the likelihood is of
    order N^3 in time and N^2 in memory; a prediction is N for a mean and N^2 for a standard deviation. To learn
    from a long log, set the targets of the other samples to NaN (``skdgp.model_selection.thin_targets``).

    Parameters
    ----------
    kernel : MultiOutputKernel or None
        Covariance of the processes. None: ``ConvolvedGaussian(n_latent, private_latents=private_latents,
        covariance_type=covariance_type, length_scale_prior=length_scale_prior)``. What is open is taken from the data.
    n_latent : int or "auto"
        Latent processes shared by all outputs. "auto": one more, up to 3, as long as the evidence for it
        exceeds what its hyperparameters would fit by chance (the Bayesian information criterion).
    private_latents : bool
        Whether each output also has a latent process of its own, which none of the others sees.
    covariance_type : {"spherical", "diag", "full", "tied"}
        Widths of the filters, see ``ConvolvedGaussian``.
    length_scale_prior : None, "auto", pair or array (d, 2)
        Prior median of the widths and spread of their logarithms, see ``ConvolvedGaussian``. None: no prior.
    structure : {"joint", "trend", "auto"}
        "joint": a trend and the dependent processes. "trend": the trend alone, its weights integrated out. "auto": the
        trend alone where it predicts blocks of rows better that are held out in turn, by the mean over the outputs of
        squared errors; rows in the order of the log. ``structure_`` says what was chosen, ``structure_errors_`` why.
    trend : {"linear", "constant"}, transformer or None
        "constant" takes the mean of each output away (the paper's centring). "linear" adds a linear function of the
        regressors whose weights are integrated out: the model goes on sensibly where there were no data, with the
        uncertainty of the slopes. A transformer, such as ``PolynomialFeatures(2)``: linear in its columns
        (``BasisTrend``). None: neither.
    inference : {"auto", "exact", "sparse"}
        "exact" conditions on every observed value. "sparse" learns hyperparameters from some of them and conditions a
        summary on all, in time linear in the samples and memory that does not grow; rows in the order of the log tell
        it how far neighbours repeat each other. "auto" is "exact" up to 6000 observed values; ``inference_`` says what
        it chose.
    n_inducing : int
        Of sparse inference: inducing inputs of each latent process.
    input_noise : None, "learned", float, array (d,) or (d, d)
        How noisy the regressors are, each sample by itself: standard deviations, or a covariance, in the units of X;
        or a standard deviation for each is learned. By the slopes J of the mean it adds J S J^T to the noise of the
        outputs, together (McHutchon & Rasmussen 2011). None: the regressors are exact.
    optimizer : "fmin_l_bfgs_b", callable or None
        As in scikit-learn's ``GaussianProcessRegressor``; None keeps the starting values.
    n_restarts_optimizer : int
        Further starting points; the best end is kept. They run side by side with ``n_jobs``.
    max_iter : int
        Iterations of the optimiser on the full data; on each output alone, before, at most twice as many.
    normalize_y : bool
        Whether each output is divided by its standard deviation inside. The kernel and the noise in ``kernel_``
        are then in these units.
    n_jobs : int or None
        Processes for the restarts, as in joblib. None: as the active ``joblib.parallel_config`` says, else one.
    random_state : int, RandomState or None
        Seed of the starting values.

    Attributes
    ----------
    kernel_ : MultiOutputKernel
        The fitted covariance, in units of normalised outputs.
    noise_variance_ : ndarray (P,)
        Variance of the measurement noise, in squared units of the outputs, drift included.
    drift_variance_, drift_memory_ : ndarray (P,)
        Variance tau^2 of the noise that drifts, and its memory T in the unit of ``time``; zero without ``time``.
    input_covariance_ : ndarray (d, d)
        Covariance of the regressors' noise, where there is any.
    log_marginal_likelihood_value_ : float
        Of the normalised outputs; where inference is sparse its lower bound, neighbours that repeat each other as one.
    inference_ : {"exact", "sparse", "compact"}
        What was done.
    compaction_ : Compaction
        Of a model made by ``compact``: what that changed.
    posterior_ : ExactPosterior or SparsePosterior
        The state of knowledge about the normalised outputs.
    n_latent_ : int or None
        Latent processes that are shared; None where a kernel was given.
    n_latent_scores_ : dict
        Of ``n_latent="auto"``: the criterion for each number that was tried, in nats; the largest is taken.
    structure_ : {"joint", "trend"}
        What the model is made of.
    structure_errors_ : dict
        Of ``structure="auto"``: for "trend" and "joint" the mean squared error of each output in blocks held out, over
        its variance, (P,).
    n_iter_, n_evaluations_ : int
        Iterations of the joint search, at most ``max_iter``; evaluations of the likelihood in all.
    converged_ : bool
        Whether the search ended because the likelihood hardly rose any more.
    output_names_ : list of str
        Column names of Y, or y0, y1, ...
    n_features_in_ : int
    feature_names_in_ : ndarray of str
        Where X had column names.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor
    >>> x = np.linspace(0.0, 6.0, 40)[:, None]
    >>> Y = np.column_stack([np.sin(x[:, 0]), np.cos(x[:, 0])])
    >>> Y[20:, 1] = np.nan                       # the second output is observed on half the samples only
    >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, Y)
    >>> mean, std = model.predict(x, return_std=True)
    >>> mean.shape, std.shape
    ((40, 2), (40, 2))
    """

    _parameter_constraints = {
        "kernel": [MultiOutputKernel, None],
        "n_latent": [Interval(Integral, 0, None, closed="left"), StrOptions({"auto"})],
        "private_latents": ["boolean"],
        "covariance_type": [StrOptions({"spherical", "diag", "full", "tied"})],
        "length_scale_prior": [StrOptions({"auto"}), "array-like", None],
        "structure": [StrOptions({"joint", "trend", "auto"})],
        "trend": [StrOptions({"linear", "constant"}), HasMethods(["fit", "transform"]), None],
        "inference": [StrOptions({"auto", "exact", "sparse"})],
        "n_inducing": [Interval(Integral, 1, None, closed="left")],
        "input_noise": [StrOptions({"learned"}), Interval(Real, 0, None, closed="neither"), "array-like", None],
        "optimizer": [StrOptions({"fmin_l_bfgs_b"}), callable, None],
        "n_restarts_optimizer": [Interval(Integral, 0, None, closed="left")],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "normalize_y": ["boolean"],
        "n_jobs": [Integral, None],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        kernel=None,
        *,
        n_latent=2,
        private_latents=True,
        covariance_type="diag",
        length_scale_prior=None,
        structure="joint",
        trend="linear",
        inference="auto",
        n_inducing=100,
        input_noise=None,
        optimizer="fmin_l_bfgs_b",
        n_restarts_optimizer=0,
        max_iter=60,
        normalize_y=True,
        n_jobs=None,
        random_state=None,
    ):
        self.kernel = kernel
        self.n_latent = n_latent
        self.private_latents = private_latents
        self.covariance_type = covariance_type
        self.length_scale_prior = length_scale_prior
        self.structure = structure
        self.trend = trend
        self.inference = inference
        self.n_inducing = n_inducing
        self.input_noise = input_noise
        self.optimizer = optimizer
        self.n_restarts_optimizer = n_restarts_optimizer
        self.max_iter = max_iter
        self.normalize_y = normalize_y
        self.n_jobs = n_jobs
        self.random_state = random_state

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = True
        return tags

    # -- fitting ---------------------------------------------------------------------------------------

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y, time=None, flight=None):
        """Learn the hyperparameters and the posterior.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, finite.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.
        time : array (n,) or None
            When each sample was measured, in any unit. Neighbours in time then err alike as far as the data show it:
            each output's noise has a part that drifts, with the covariance tau^2 exp(-|t - t'| / T) within a flight.
            Without it samples that repeat each other's error count as independent evidence, and bands are too narrow.
            Scikit-learn passes it through pipelines as ``pipeline.fit(X, y, dependentgpregressor__time=time)``, or by
            metadata routing. None: noise is white.
        flight : array (n,) or None
            Which flight, or record, each sample is of; None: all are of one.

        Returns
        -------
        DependentGPRegressor
            The fitted estimator itself.

        Raises
        ------
        ValueError
            When X is not finite, an output was never observed, there are fewer than two samples, magnitudes are beyond
            what double precision can square, ``n_jobs`` makes no sense, or the posterior would not fit the machine's
            memory.

        Warns
        -----
        UserWarning
            When an output or a regressor is constant, samples are repeated with the same targets, or there are more
            inducing inputs than samples.
        ConvergenceWarning
            When the search for hyperparameters was interrupted (the best ones so far are kept), or stopped at
            ``max_iter`` far from an optimum.
        """
        check_n_jobs(self.n_jobs)
        task, index = FitTask(self, X, y), getattr(X, "index", None)
        X = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        warn_of_indices(index, y)
        Y, self.output_names_, self._single = check_targets(y, len(X), type(self).__name__)
        clock = check_clock(time, flight, len(X))
        used = np.isfinite(Y).any(axis=1)
        X, Y, clock = X[used], Y[used], None if clock is None else clock[used]
        check_enough(Y, self.output_names_)
        check_magnitudes(X, self._regressor_names(), "regressors", *X_RANGE)
        check_magnitudes(Y, self.output_names_, "targets", *Y_RANGE)
        warn_of_constant_regressors(X, self._regressor_names())
        warn_of_samples(X, Y, self.output_names_)
        n_values = int(np.isfinite(Y).sum())
        self.inference_ = (
            self.inference if self.inference != "auto" else "exact" if n_values <= EXACT_LIMIT else "sparse"
        )
        if self.inference_ == "exact":
            check_memory(n_values, "Exact inference on", FEWER_VALUES)
        else:
            warn_of_inducing(self.n_inducing, len(X))
        Z, self._center, self._scale = standardized(Y, self.trend is not None, self.normalize_y)
        best = task.run(self._search, X, Z, clock)
        warn_of_search(best, self.max_iter)
        self.__dict__.pop("compaction_", None)  # of what was known before
        self.posterior_ = best.posterior
        self.kernel_ = best.posterior.kernel
        self.noise_variance_ = best.noise * self._scale**2
        variance, memory = np.zeros((2, len(self._scale))) if best.drift is None else best.drift
        self.drift_variance_, self.drift_memory_ = variance * self._scale**2, memory
        self._n_flights = 0 if clock is None else int(clock[:, 1].max()) + 1
        self._root = best.root
        self.input_covariance_ = np.zeros((X.shape[1],) * 2) if best.root is None else best.root @ best.root.T
        self.log_marginal_likelihood_value_ = best.posterior.log_marginal_likelihood
        self.n_iter_, self.n_evaluations_, self.converged_ = best.n_iter, best.n_evaluations, best.converged
        task.end()
        return self

    def _search(self, X, Z, clock):
        """Return the best fit over the starting points."""
        search = fit_exact if self.inference_ == "exact" else partial(fit_sparse, n_inducing=self.n_inducing)
        root = input_root(self.input_noise, X, self._regressor_names())
        options = {"optimizer": self.optimizer, "max_iter": self.max_iter, "input_noise": root, "clock": clock}
        seeds = check_random_state(self.random_state).randint(2**31 - 1, size=1 + self.n_restarts_optimizer)
        facts = X if clock is None else np.column_stack([X, clock])
        record = fit_record(facts, Z, seeds, self.get_params(deep=False))
        seeds = seeds if record is None else record.seeds
        kernel, found = self._choose(X, Z, options | {"random_state": int(seeds[0]), "record": record})
        names = [f"start-{k}" for k in range(len(seeds) if found is None else 1)]
        starts = [{"part": name, "random_state": int(seeds[k]), "spread": float(k > 0)} for k, name in enumerate(names)]
        start = partial(run_recorded, record, function=partial(search, kernel, X, Z, found=found, **options))
        fits = fit_map(start, starts, self.n_jobs)
        best = max(fits, key=lambda fit: fit.value)
        return best._replace(interrupted=any(fit.interrupted for fit in fits))

    def _choose(self, X, Z, options):
        """Return the prior, its number of shared latents from the data where that was asked; what Ctrl-C left of it."""
        self.n_latent_, self.n_latent_scores_ = self.n_latent if self.kernel is None else None, {}
        self.structure_, found = self._choose_structure(X, Z, options)
        if self.structure_ == "trend":
            self.n_latent_ = 0
            return self._trend(), found
        if found is not None:
            self.n_latent_ = AUTO_LATENT if self.n_latent_ == "auto" else self.n_latent_
            return self._prior(self.n_latent_), found
        if self.n_latent_ == "auto":
            fewest = int(not self.private_latents)
            numbers = range(fewest, (MOST_LATENT if Z.shape[1] > 1 else fewest) + 1)
            choice = choose_kernel([self._prior(number) for number in numbers], X, Z, **options)
            self.n_latent_, found = numbers[choice.index], choice.found
            self.n_latent_scores_ = dict(zip(numbers, choice.scores, strict=False))
        return self._prior(self.n_latent_), found

    def _choose_structure(self, X, Z, options):
        """Return "trend" where that was asked for, or predicts blocks better that were held out, else "joint".

        And the hyperparameters that Ctrl-C left, if it came meanwhile.
        """
        self.structure_errors_ = {}
        no_choice = self.kernel is not None or self.trend in ("constant", None)
        if self.structure == "trend" and no_choice:
            raise ValueError(
                f"Got structure='trend' with kernel={self.kernel!r} and trend={self.trend!r}, but expected no kernel, "
                "and a trend such as 'linear', of which the whole model is made."
            )
        if self.structure == "joint" or no_choice:
            return "joint", None
        if self.structure == "auto":
            n_latent = AUTO_LATENT if self.n_latent == "auto" else self.n_latent
            for name, kernel in (("trend", self._trend()), ("joint", self._prior(n_latent))):
                errors, found = held_out_errors(name, kernel, X, Z, **options)
                if errors is None:
                    return ("joint" if found is None else name), found
                self.structure_errors_[name] = errors
            if np.nanmean(self.structure_errors_["joint"]) <= np.nanmean(self.structure_errors_["trend"]):
                return "joint", None
        return "trend", None

    def _prior(self, n_latent):
        options = {
            "private_latents": self.private_latents,
            "covariance_type": self.covariance_type,
            "length_scale_prior": self.length_scale_prior,
        }
        trend = None if self.trend in ("constant", None) else self._trend()
        kernel = ConvolvedGaussian(n_latent, **options) if self.kernel is None else clone(self.kernel)
        return kernel if trend is None else trend + kernel

    def _trend(self):
        return LinearTrend() if self.trend == "linear" else BasisTrend(self.trend)

    # -- after the fit ---------------------------------------------------------------------------------

    @fit_context(prefer_skip_nested_validation=False)
    def partial_fit(self, X, y, time=None, flight=None):
        """Learn from further samples, at the hyperparameters found by ``fit``.

        Kernel, noise, and the centre and scale that normalise the outputs stay as they are; the posterior becomes that
        of all samples so far. An exact posterior appends rows to its factor: of order N^2 for each new value. A sparse
        or compact one adds to its sums: of order 1, in a compact model without keeping the sample. Not fitted yet, the
        first call is ``fit``.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, finite.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.
        time, flight : array (n,) or None
            As for ``fit``. The samples are of other flights than those before; without time each errs by itself.

        Returns
        -------
        DependentGPRegressor
            The estimator itself.

        Raises
        ------
        ValueError
            When columns of X or y are not those of the fit, X is not finite, or the exact posterior of all samples
            would not fit the machine's memory.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x = np.linspace(0.0, 6.0, 40)[:, None]
        >>> model = DependentGPRegressor(n_latent=1, random_state=0).partial_fit(x[:30], np.sin(x[:30, 0]))
        >>> _, before = model.predict(x[-1:], return_std=True)
        >>> _, after = model.partial_fit(x[30:], np.sin(x[30:, 0])).predict(x[-1:], return_std=True)
        >>> bool(after[0] < before[0])
        True
        """
        if not hasattr(self, "posterior_"):
            return self.fit(X, y, time, flight)
        index = getattr(X, "index", None)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        warn_of_indices(index, y)
        Y, names, _ = check_targets(y, len(X), type(self).__name__)
        check_same_targets(names, self.output_names_)
        check_magnitudes(X, self._regressor_names(), "regressors", 0.0, X_RANGE[1])
        check_magnitudes(Y, self.output_names_, "targets", 0.0, Y_RANGE[1])
        loading = None if self._root is None else input_noise_loading(self.posterior_, X, self._root)
        clock, drift = self._later_clock(time, flight, len(X))
        data = Data.from_table(X, (Y - self._center) / self._scale, loading, clock, drift)
        if self.inference_ == "exact":
            check_memory(self.posterior_.data.n_values + data.n_values, "Exact inference on", FEWER_LATER)
        if data.n_values:
            self.posterior_ = self.posterior_.updated(data)
            self.log_marginal_likelihood_value_ = self.posterior_.log_marginal_likelihood
        return self

    def _later_clock(self, time, flight, n):
        """Return time and flight of further samples, and the drift of the fit; no clock where noise is white."""
        if not getattr(self, "_n_flights", 0):
            return None, (None, None)
        clock = check_clock(time, flight, n)
        if clock is None:  # each a flight of its own
            clock = np.column_stack([np.zeros(n), np.arange(n)])
        clock[:, 1] += self._n_flights
        self._n_flights = int(clock[:, 1].max()) + 1
        return clock, (self.drift_variance_ / self._scale**2, self.drift_memory_)

    def compact(self, n_inducing=1500, *, tolerance=None, max_iter=10, random_state=0):
        """Return a small and fast model of nearly the same predictions, that holds no samples.

        The samples become inducing variables, at the same hyperparameters: what each latent contributes to each output,
        as many of each, and placed, as explains the outputs best. A row costs microseconds; memory and file do not
        grow; ``partial_fit`` still learns. What that changed is in ``compaction_``, measured and bounded.

        Parameters
        ----------
        n_inducing : int
            Inducing variables at most, beside the weights of a trend; where the samples give fewer, all. A sparse
            model that has no more keeps its own.
        tolerance : float or None
            Take as few as change, for every output, mean and standard deviation by at most this fraction of the
            original standard deviation, root mean square over the training inputs and points around them.
        max_iter : int
            Iterations in which the places are improved at the end, on the bound of the likelihood; Ctrl-C stops them.
        random_state : int, RandomState or None
            Of the places, and of the points where the change is measured.

        Returns
        -------
        DependentGPRegressor
            Another one, fitted, with ``inference_ = "compact"``.

        Raises
        ------
        ValueError
            When the numbers make no sense, matrices of that size do not fit the machine, or the model is compact
            already.

        Warns
        -----
        UserWarning
            When ``n_inducing`` variables do not keep the tolerance; without one, when they change predictions by more
            than half a standard deviation.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x = np.linspace(0.0, 6.0, 80)[:, None]
        >>> y = np.sin(x) + np.random.default_rng(0).normal(0.0, 0.1, x.shape)
        >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, y)
        >>> small = model.compact(tolerance=0.01)
        >>> small.compaction_.change < 0.01, small.compaction_.n_inducing < 80
        (True, True)
        """
        check_is_fitted(self)
        check_compaction(n_inducing, tolerance, max_iter)
        posterior, compaction = compact(self.posterior_, n_inducing, tolerance, max_iter, random_state, _allow_compact)
        warn_of_compaction(tolerance, compaction.change, compaction.n_inducing)
        small = clone(self)
        vars(small).update({name: value for name, value in vars(self).items() if name not in self.get_params(False)})
        small.posterior_, small.compaction_, small.inference_ = posterior, compaction, "compact"
        small.log_marginal_likelihood_value_ = posterior.log_marginal_likelihood
        return small

    def output_correlation(self):
        """Say which outputs are coupled, how strongly, and with what shift.

        Returns
        -------
        Bunch
            ``correlation`` (P, P): the largest correlation, in size, between output i at s + shift and output j
            at s, over all shifts, of the dependent processes without trend and noise; ``shift`` (P, P, d): where
            it is, in the units of the regressors; ``output_names``. What the prior allows counts, so with
            ``trend="constant"`` very wide latents, standing in for a trend, weigh heavily.
        """
        check_is_fitted(self)
        kernel = self.kernel_.stationary_part()
        if kernel is None:
            raise ValueError("The kernel has no stationary part: a trend alone couples no outputs.")
        found = output_correlation(kernel)
        found["output_names"] = list(self.output_names_)
        return found

    # -- predictions: y = _center + _scale z, of the posterior of normalised outputs z ----------------------

    def predict(self, X, return_std=False, return_cov=False, include_noise=False, include_input_noise=True):
        """Predict the outputs (equations 17 and 18).

        Parameters
        ----------
        X : array or DataFrame (n, d)
        return_std : bool
            Also return the standard deviation of each output, shaped like the mean.
        return_cov : bool
            Also return the joint covariance of all outputs at all samples, (P n, P n), output-major.
        include_noise : bool
            Whether these are of a new measurement rather than of the underlying function.
        include_input_noise : bool, float or array (n,)
            Whether X is as noisy as the regressors of the fit (``input_noise``), which is the default, rather than
            exact: by the slopes J of the mean, J S J^T is added. A number: so many times the variance of the fit, as in
            rougher air.

        Returns
        -------
        mean : ndarray (n, P), or (n,) where y was
        std or cov : ndarray
            On request.

        Raises
        ------
        ValueError
            When X is not finite, or both std and cov are asked for.
        """
        if return_std and return_cov:
            raise ValueError("Got return_std=True and return_cov=True, but at most one of them can be returned.")
        X = self._check_regressors(X)
        mean = self.posterior_.predict(X, return_variance=return_std)
        if return_std:
            mean, variance = mean
            if include_noise:
                variance = variance + self.noise_variance_ / self._scale**2
            variance = variance + np.sum(self._loading(X, include_input_noise) ** 2, axis=2)
            return self._shaped(mean * self._scale + self._center), self._shaped(np.sqrt(variance) * self._scale)
        mean = self._shaped(mean * self._scale + self._center)
        if not return_cov:
            return mean
        check_memory(mean.size, "The joint covariance of", FEWER_SAMPLES)
        cov = self.posterior_.covariance(X)
        if include_noise:
            cov[np.diag_indices_from(cov)] += np.repeat(self.noise_variance_ / self._scale**2, len(X))
        loading = self._loading(X, include_input_noise)
        blocks = cov.reshape(len(self._scale), len(X), len(self._scale), len(X))
        np.einsum("iaja->aij", blocks)[:] += loading @ loading.swapaxes(1, 2)
        scale = np.repeat(self._scale, len(X))
        return mean, cov * np.multiply.outer(scale, scale)

    def predict_gradient(self, X, return_std=False):
        """Return the slopes of the mean, d mean / d regressor, and on request their standard deviation.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        return_std : bool

        Returns
        -------
        gradient : ndarray (n, P, d), or (n, d) where y was (n,)
        std : ndarray, the same shape
            On request.
        """
        X = self._check_regressors(X)
        found = self.posterior_.gradient(X, return_variance=return_std)
        if not return_std:
            return self._shaped(found * self._scale[:, None])
        mean, variance = found
        return self._shaped(mean * self._scale[:, None]), self._shaped(np.sqrt(variance) * self._scale[:, None])

    def sample_y(self, X, n_samples=1, random_state=0):
        """Draw from the joint posterior of all outputs at X.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        n_samples : int
        random_state : int, RandomState or None

        Returns
        -------
        ndarray (n, P, n_samples), or (n, n_samples) where y was (n,)
        """
        X = self._check_regressors(X)
        mean = self.posterior_.predict(X)
        check_memory(mean.size, "The joint covariance of", FEWER_SAMPLES)
        cov = self.posterior_.covariance(X)
        white = check_random_state(random_state).standard_normal((len(cov), n_samples))
        draws = eigen_root(cov) @ white  # a posterior covariance may be singular
        draws = draws.reshape(mean.shape[1], len(X), n_samples).swapaxes(0, 1)
        return self._shaped((mean[..., None] + draws) * self._scale[:, None] + self._center[:, None])

    def sample_paths(self, n_paths=1, random_state=0):
        """Draw samples of the posterior that are functions.

        Where ``sample_y`` draws values at points known beforehand, a path can be evaluated wherever a simulation comes
        to, again and again, and differentiated: samples of the prior are sums of random waves, which what was learned
        corrects (Matheron's rule: Wilson et al. 2020, "Efficiently sampling functions from Gaussian process
        posteriors"). Mean and covariance over many paths are those of ``predict``.

        Parameters
        ----------
        n_paths : int
        random_state : int, RandomState or None
            The same seed, the same functions.

        Returns
        -------
        Paths
            A sequence of functions: ``paths[k](X)`` is (n, P) for X (n, d), or (n,) where y was. ``paths(X)``, all of
            them at the same points, (n_paths, n, P); ``paths.each(X)``, each at its own, X (n_paths, n, d);
            ``paths.gradient(X)``, slopes at either, (n_paths, n, P, d). Measurement noise is not in them.

        Raises
        ------
        ValueError
            When ``n_paths`` is no positive number.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x = np.linspace(0.0, 6.0, 40)[:, None]
        >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
        >>> paths = model.sample_paths(50)
        >>> paths(x).shape, paths[0](x).shape, paths.gradient(x).shape
        ((50, 40), (40,), (50, 40, 1))
        """
        check_is_fitted(self)
        if not isinstance(n_paths, Integral) or isinstance(n_paths, bool) or n_paths < 1:
            raise ValueError(f"Got n_paths={n_paths!r}, but expected a number of paths from 1 on.")
        names = getattr(self, "feature_names_in_", None)
        return self.posterior_.paths(n_paths, random_state).in_units(self._center, self._scale, self._single, names)

    def score(self, X, y, sample_weight=None):
        """Return R^2, averaged over the outputs, of the targets that were observed.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        y : array, Series or DataFrame (n,) or (n, P)
            NaN where an output was not observed; an output without a target is left out.
        sample_weight : array (n,) or None

        Returns
        -------
        float
            1 is perfect, 0 no better than the mean.
        """
        mean = self.predict(X).reshape(len(X), -1)
        Y = check_array(y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y")
        if Y.reshape(len(Y), -1).shape != mean.shape:
            raise ValueError(f"Got y of shape {Y.shape}, but expected {mean.shape}: a row for each of X, all outputs.")
        scores = []
        for y_true, y_pred in zip(Y.reshape(mean.shape).T, mean.T, strict=True):
            seen = np.isfinite(y_true)
            if seen.any():
                weight = None if sample_weight is None else np.asarray(sample_weight)[seen]
                scores.append(r2_score(y_true[seen], y_pred[seen], sample_weight=weight))
        return float(np.mean(scores)) if scores else float("nan")

    # -- what was learned ------------------------------------------------------------------------------

    def log_marginal_likelihood(self, theta=None, eval_gradient=False):
        """Return the log marginal likelihood of the normalised outputs (equation 20).

        Parameters
        ----------
        theta : ndarray or None
            ``kernel_.theta`` followed by the logarithm of the noise variances of the normalised outputs. None:
            at the fitted values. What noisy regressors carry stays as it was fitted.
        eval_gradient : bool
            Also return the gradient with respect to theta.

        Returns
        -------
        value : float
            In nats.
        gradient : ndarray (n_theta,)
            Only with ``eval_gradient``.
        """
        check_is_fitted(self)
        P = len(self._scale)
        if theta is None:
            if not eval_gradient:
                return self.log_marginal_likelihood_value_
            theta = self.theta_
        theta = np.asarray(theta, dtype=float)
        expected = (self.kernel_.n_dims + P,)
        if theta.shape != expected:
            raise ValueError(
                f"Got theta of shape {theta.shape}, but expected {expected}: the kernel's {expected[0] - P} "
                f"hyperparameters and the logarithms of {P} noise variances, as in theta_."
            )
        kernel = self.kernel_.clone_with_theta(theta[:-P])
        return self.posterior_.likelihood_at(kernel, np.exp(theta[-P:]), eval_gradient)

    @property
    def theta_(self):
        """Fitted hyperparameters, as ``log_marginal_likelihood`` takes them."""
        check_is_fitted(self, "kernel_")
        return np.concatenate([self.kernel_.theta, np.log(self.posterior_.noise)])

    def _loading(self, X, times):
        """Return J R of noisy regressors, (n, P, r); of exact ones r is zero."""
        times = np.asarray(times, dtype=float)
        if times.shape not in ((), (len(X),)) or not (times >= 0).all():
            raise ValueError(
                f"Got include_input_noise of shape {times.shape}, but expected a bool, or how many times the variance "
                f"of the fit: a number, or one for each of the {len(X)} rows, from 0 on."
            )
        if self._root is None or not times.any():
            return np.zeros((len(X), len(self._scale), 0))
        return np.sqrt(times.reshape(-1, 1, 1)) * (self.posterior_.gradient(X) @ self._root)

    def _check_regressors(self, X):
        if self._is_plain(X):
            return X
        check_is_fitted(self)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        check_magnitudes(X, self._regressor_names(), "regressors", 0.0, X_RANGE[1])
        return X

    def _regressor_names(self) -> list[str]:
        """Return the names of the regressors, or x0, x1, ... where they have none."""
        return list(getattr(self, "feature_names_in_", [f"x{k}" for k in range(self.n_features_in_)]))

    def _is_plain(self, X):
        """Return whether X is what ``validate_data`` would return as it is: for a row that is most of the time."""
        return (
            type(X) is np.ndarray
            and X.dtype == np.float64
            and X.ndim == 2
            and len(X) > 0
            and X.shape[1] == getattr(self, "n_features_in_", None)
            and hasattr(self, "posterior_")
            and not hasattr(self, "feature_names_in_")
            and float(np.abs(X).max()) <= X_RANGE[1]
        )

    def _shaped(self, values):
        """Return (n, P, ...) as it is, or (n, ...) where the targets were (n,)."""
        return values[:, 0] if self._single else values


# -- checks at the door ----------------------------------------------------------------------


def check_targets(y, n_samples: int, estimator: str) -> tuple[np.ndarray, list[str], bool]:
    """Return the targets as (n, P) with NaN where not observed, their names, and whether they were (n,)."""
    if y is None:
        raise ValueError(f"This {estimator} estimator requires y to be passed, but the target y is None.")
    names = column_names(y)
    Y = check_array(y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y")
    if Y.ndim > 2:
        raise ValueError(f"Got y of shape {Y.shape}, but expected (n,) or (n, P).")
    if len(Y) != n_samples:
        raise ValueError(
            f"Found input variables with inconsistent numbers of samples: {[n_samples, len(Y)]}. y needs a row for "
            "each of X; NaN where an output was not observed."
        )
    table = Y.reshape(len(Y), -1)
    return table, names or unnamed(table.shape[1]), Y.ndim == 1


def standardized(Y: np.ndarray, centered: bool, scaled: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return targets with mean 0 and mean square 1 where asked, and the center and scale of each output, (P,).

    The center of a constant output is its value, its scale the size of that: it is 0 or 1 everywhere, without rounding.
    """
    constant, size = constant_columns(Y), np.nanmax(np.abs(Y), axis=0)
    Y = np.where(constant & np.isfinite(Y), Y[np.isfinite(Y).argmax(axis=0), range(Y.shape[1])], Y)
    center = np.where(constant, np.nanmax(Y, axis=0), np.nanmean(Y, axis=0)) if centered else np.zeros(Y.shape[1])
    scale = np.sqrt(np.nanmean((Y - center) ** 2, axis=0)) if scaled else np.ones(Y.shape[1])
    scale = np.where(constant & scaled, np.where(size > 0, size, 1.0), scale)
    return (Y - center) / scale, center, scale


def check_clock(time, flight, n_samples: int) -> np.ndarray | None:
    """Return time and a number for each flight, (n, 2), or None where no time is given."""
    if time is None:
        if flight is not None:
            raise ValueError("Got flight without time, but expected both: how long errors last is told by time.")
        return None
    time = check_array(time, dtype=np.float64, ensure_2d=False, input_name="time")
    codes = np.zeros(n_samples) if flight is None else pd.factorize(np.asarray(flight))[0].astype(float)
    for name, values in (("time", time), ("flight", codes)):
        if values.shape != (n_samples,):
            raise ValueError(f"Got {name} of shape {values.shape}, but expected ({n_samples},): one for each row of X.")
    if (codes < 0).any():
        raise ValueError(f"Got {int((codes < 0).sum())} rows without a flight: name the flight of every row.")
    return np.column_stack([time, codes])


def check_magnitudes(Z: np.ndarray, names: list[str], what: str, least: float, most: float) -> None:
    """Refuse columns whose powers overflow or vanish in double precision; Z (n, k) with NaN where not observed."""
    size = np.nanmax(np.abs(Z), axis=0, initial=0.0)
    extreme = (size > most) | ((size < least) & (size > 0))
    if extreme.any():
        found = {name: f"{s:.1g}" for name, s, out in zip(names, size, extreme, strict=True) if out}
        raise ValueError(
            f"Got {what} of magnitudes {found}, but expected between {least:g} and {most:g}: powers of others "
            "vanish or overflow. Use another unit, or scale them (StandardScaler)."
        )


def warn_of_constant_regressors(X: np.ndarray, names: list[str]) -> None:
    """Warn of regressors (n, d) that have the same value in all samples."""
    constant = [name for name, same in zip(names, constant_columns(X), strict=True) if same]
    if constant:
        _warn(
            f"The regressors {constant} are constant over the samples: their effect cannot be learned, and predictions "
            "at other values of them mean little. Leave them out, or add samples in which they vary."
        )


def check_enough(Y: np.ndarray, names: list[str]) -> None:
    """Refuse outputs that no two samples tell of."""
    counts = np.isfinite(Y).sum(axis=0)
    few = {name: int(n) for name, n in zip(names, counts, strict=True) if n < 2}
    if few:
        raise ValueError(
            f"Got outputs observed at fewer than two samples: {few} (NaN is not observed). Leave these columns out, or "
            "give at least two of their values, better many."
        )


def check_same_targets(names: list[str], expected: list[str]) -> None:
    """Refuse further targets that are not of the outputs that were fitted."""
    if len(names) != len(expected):
        raise ValueError(
            f"Got y with {len(names)} outputs, but expected the {len(expected)} that were fitted: {expected}. Set the "
            "targets of an output that was not observed to NaN."
        )
    if names != expected and unnamed(len(names)) not in (names, expected):
        raise ValueError(f"Got y with the columns {names}, but expected those of the fit, in their order: {expected}.")


def warn_of_inducing(n_inducing: int, n_samples: int) -> None:
    """Warn of more inducing inputs than samples."""
    if n_inducing > n_samples:
        warnings.warn(
            f"Got n_inducing={n_inducing} for {n_samples} samples: each sample becomes an inducing input, which costs "
            "more than it saves. Lower n_inducing, or use inference='exact'.",
            UserWarning,
            stacklevel=4,
        )


def check_compaction(n_inducing, tolerance, max_iter) -> None:
    """Refuse numbers that make no sense."""
    if not isinstance(n_inducing, Integral) or isinstance(n_inducing, bool) or n_inducing < 1:
        raise ValueError(f"Got n_inducing={n_inducing!r}, but expected a number of inducing variables from 1 on.")
    if not isinstance(max_iter, Integral) or isinstance(max_iter, bool) or max_iter < 0:
        raise ValueError(f"Got max_iter={max_iter!r}, but expected a number of iterations, or 0 for none.")
    if tolerance is None:
        return
    if not isinstance(tolerance, Real) or isinstance(tolerance, bool) or not 0 < float(tolerance) < np.inf:
        raise ValueError(
            f"Got tolerance={tolerance!r}, but expected a positive fraction of the standard deviation, such as 0.1, or "
            "None."
        )


def warn_of_compaction(tolerance: float | None, change: float, n_inducing: int) -> None:
    """Warn that compacting changed predictions by more than the tolerance, or, where none was asked for, by much."""
    if change <= (MUCH if tolerance is None else tolerance):
        return
    asked = "" if tolerance is None else f", which is more than the tolerance {tolerance:g}"
    warnings.warn(
        f"Compacting to {n_inducing} inducing variables changes mean or deviation of an output by {change:.2g} of its "
        f"standard deviation (root mean square){asked}. Raise n_inducing, or see compaction_ for which output it is.",
        UserWarning,
        stacklevel=3,
    )


def input_root(input_noise, X: np.ndarray, names: list[str]):
    """Return R (d, r) of the covariance R R^T of the regressors' noise, or what asks for none or for learning."""
    if input_noise is None or isinstance(input_noise, str):
        return input_noise
    root = _root_of(input_noise, X.shape[1])
    noise = np.sqrt(np.einsum("dr,dr->d", root, root))
    drowned = (noise > MOST_NOISE * column_scale(X)) & ~constant_columns(X)
    if drowned.any():
        found = {name: f"{s:.2g}" for name, s, out in zip(names, X.std(axis=0), drowned, strict=True) if out}
        raise ValueError(
            f"Got input_noise that is more than {MOST_NOISE} times what the regressors vary by (standard deviations: "
            f"{found}), but expected the noise that is part of this. Give it in the units of X, one for each column."
        )
    return root


def _root_of(input_noise, d):
    given = np.asarray(input_noise, dtype=float)
    expected = f"expected a standard deviation, {d} of them, or a covariance ({d}, {d}), in the units of X."
    if given.shape not in ((), (d,), (d, d)) or not np.isfinite(given).all():
        raise ValueError(f"Got input_noise of shape {given.shape}, but {expected}")
    if given.ndim < 2:
        if (given < 0).any():
            raise ValueError(f"Got input_noise down to {given.min():g}, but {expected}")
        return np.diag(np.broadcast_to(given, d))
    values = np.linalg.eigvalsh(given)
    if not np.allclose(given, given.T) or values.min() < -1e-9 * abs(values).max():
        raise ValueError(f"Got input_noise that is no covariance (not symmetric, or not positive), but {expected}")
    return eigen_root(given)


def unnamed(n: int) -> list[str]:
    """Return the names of outputs that came without."""
    return [f"y{i}" for i in range(n)]


def warn_of_indices(index, y) -> None:
    """Warn when the rows of two tables are named differently."""
    if isinstance(index, pd.Index) and isinstance(y, (pd.DataFrame, pd.Series)) and not index.equals(y.index):
        _warn(
            "The indices of X and y differ; rows are matched by position. If rows of one were dropped or sorted, do "
            "the same to the other (y.loc[X.index])."
        )


def warn_of_samples(X: np.ndarray, Y: np.ndarray, names: list[str]) -> None:
    """Warn of outputs that are constant and of samples that stand twice."""
    constant = [name for name, same in zip(names, constant_columns(Y), strict=True) if same]
    if constant:
        _warn(
            f"The outputs {constant} are constant over the samples: nothing can be learned of how they depend on the "
            "regressors, and their stated uncertainty means little. Leave them out, or check the log."
        )
    repeated = int(pd.DataFrame(np.column_stack([X, Y])).duplicated().sum())
    if repeated:
        _warn(
            f"{repeated} of {len(X)} samples repeat another one, regressors and targets alike. Each counts as new "
            "evidence, so the uncertainty comes out too small: drop repeated rows (was a log read twice?)."
        )


def warn_of_search(best, max_iter: int) -> None:
    """Warn of a search for hyperparameters that was interrupted, or stopped far from an optimum."""
    if best.interrupted:
        _warn(
            f"The fit was interrupted after {best.n_evaluations} evaluations of the likelihood; the best "
            "hyperparameters so far are kept. Fit again for more.",
            ConvergenceWarning,
        )
    elif best.rising:
        _warn(
            f"The fit stopped at max_iter={max_iter} while the log likelihood was still rising fast: the "
            "hyperparameters are not good yet. Raise max_iter, or scale the regressors (StandardScaler).",
            ConvergenceWarning,
        )


def _warn(message, category=UserWarning):
    # From here through the check, fit and scikit-learn's wrapper of it, to who called fit.
    warnings.warn(message, category, stacklevel=5)


def _allow_compact(size):
    check_memory(size, "A compact model of", "Ask for fewer n_inducing.", n_matrices=8)
