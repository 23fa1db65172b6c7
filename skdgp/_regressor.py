"""The dependent Gaussian process as a scikit-learn regressor: validate, scale, delegate."""

from __future__ import annotations

from functools import partial
from numbers import Integral, Real

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, _fit_context, clone
from sklearn.utils import check_random_state
from sklearn.utils._param_validation import HasMethods, Interval, StrOptions
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._callbacks import CallbackSupportMixin, FitTask
from skdgp._checkpoint import kept_in, record_of_fit
from skdgp._parallel import check_n_jobs, fit_map
from skdgp._prediction import PredictionMixin
from skdgp._targets import (
    FEWER_LATER,
    FEWER_VALUES,
    X_RANGE,
    Y_RANGE,
    check_compaction,
    check_enough,
    check_magnitudes,
    check_memory,
    check_same_targets,
    check_targets,
    input_root,
    standardized,
    warn_of_compaction,
    warn_of_constant_regressors,
    warn_of_indices,
    warn_of_inducing,
    warn_of_samples,
    warn_of_search,
)
from skdgp.inference import Data, choose_kernel, compact, fit_exact, fit_sparse, output_correlation, reach_of
from skdgp.kernels import BasisTrend, ConvolvedGaussian, LinearTrend, MultiOutputKernel

EXACT_LIMIT = 6000
"""Observed values up to which inference="auto" is exact: about two seconds an evaluation on two cores."""

MOST_LATENT = 3  # shared, that n_latent="auto" tries


class DependentGPRegressor(PredictionMixin, CallbackSupportMixin, MultiOutputMixin, RegressorMixin, BaseEstimator):
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
        Variance of the measurement noise, in squared units of the outputs.
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

    @_fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y):
        """Learn the hyperparameters and the posterior.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, finite.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.

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
        used = np.isfinite(Y).any(axis=1)
        X, Y = X[used], Y[used]
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
        best = task.heard(self._search, X, Z)
        warn_of_search(best, self.max_iter)
        vars(self).pop("compaction_", None)  # of what was known before
        self.posterior_ = best.posterior
        self.kernel_ = best.posterior.kernel
        self.noise_variance_ = best.noise * self._scale**2
        self._root = best.root
        self.input_covariance_ = np.zeros((X.shape[1],) * 2) if best.root is None else best.root @ best.root.T
        self.log_marginal_likelihood_value_ = best.posterior.log_marginal_likelihood
        self.n_iter_, self.n_evaluations_, self.converged_ = best.n_iter, best.n_evaluations, best.converged
        task.end()
        return self

    def _search(self, X, Z):
        """Return the best fit over the starting points."""
        search = fit_exact if self.inference_ == "exact" else partial(fit_sparse, n_inducing=self.n_inducing)
        root = input_root(self.input_noise, X, self._regressor_names())
        options = {"optimizer": self.optimizer, "max_iter": self.max_iter, "input_noise": root}
        seeds = check_random_state(self.random_state).randint(2**31 - 1, size=1 + self.n_restarts_optimizer)
        record = record_of_fit(X, Z, seeds, self.get_params(deep=False))
        seeds = seeds if record is None else record.seeds
        kernel, found = self._choose(X, Z, options | {"random_state": int(seeds[0]), "record": record})
        names = [f"start-{k}" for k in range(len(seeds) if found is None else 1)]
        starts = [{"part": name, "random_state": int(seeds[k]), "spread": float(k > 0)} for k, name in enumerate(names)]
        start = partial(kept_in, record, function=partial(search, kernel, X, Z, found=found, **options))
        fits = fit_map(start, starts, self.n_jobs)
        best = max(fits, key=lambda fit: fit.value)
        return best._replace(interrupted=any(fit.interrupted for fit in fits))

    def _choose(self, X, Z, options):
        """Return the prior, its number of shared latents from the data where that was asked; what Ctrl-C left of it."""
        self.n_latent_, self.n_latent_scores_ = self.n_latent if self.kernel is None else None, {}
        found = None
        if self.n_latent_ == "auto":
            fewest = int(not self.private_latents)
            numbers = range(fewest, (MOST_LATENT if Z.shape[1] > 1 else fewest) + 1)
            choice = choose_kernel([self._prior(number) for number in numbers], X, Z, **options)
            self.n_latent_, found = numbers[choice.index], choice.found
            self.n_latent_scores_ = dict(zip(numbers, choice.scores, strict=False))
        return self._prior(self.n_latent_), found

    def _prior(self, n_latent):
        options = {
            "private_latents": self.private_latents,
            "covariance_type": self.covariance_type,
            "length_scale_prior": self.length_scale_prior,
        }
        kernel = ConvolvedGaussian(n_latent, **options) if self.kernel is None else clone(self.kernel)
        if self.trend not in ("constant", None):
            kernel = (LinearTrend() if self.trend == "linear" else BasisTrend(self.trend)) + kernel
        return kernel

    # -- after the fit ---------------------------------------------------------------------------------

    @_fit_context(prefer_skip_nested_validation=False)
    def partial_fit(self, X, y):
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
            return self.fit(X, y)
        index = getattr(X, "index", None)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        warn_of_indices(index, y)
        Y, names, _ = check_targets(y, len(X), type(self).__name__)
        check_same_targets(names, self.output_names_)
        check_magnitudes(X, self._regressor_names(), "regressors", 0.0, X_RANGE[1])
        check_magnitudes(Y, self.output_names_, "targets", 0.0, Y_RANGE[1])
        reach = None if self._root is None else reach_of(self.posterior_, X, self._root)
        data = Data.from_table(X, (Y - self._center) / self._scale, reach)
        if self.inference_ == "exact":
            check_memory(self.posterior_.data.n_values + data.n_values, "Exact inference on", FEWER_LATER)
        if data.n_values:
            self.posterior_ = self.posterior_.updated(data)
            self.log_marginal_likelihood_value_ = self.posterior_.log_marginal_likelihood
        return self

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


def _allow_compact(size):
    check_memory(size, "A compact model of", "Ask for fewer n_inducing.", n_matrices=8)
