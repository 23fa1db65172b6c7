"""DependentGPRegressor: its kernel, its fit and its predictions."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, clone
from sklearn.gaussian_process.kernels import Kernel
from sklearn.metrics import r2_score
from sklearn.utils import check_array, check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._compute.linalg import check_memory, covariance_root
from skdgp._compute.sklearn_compat import Interval, StrOptions, fit_context
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp._regressor import _checks
from skdgp._regressor._impute import imputed
from skdgp.inference import (
    Data,
    ExactPosterior,
    Fit,
    FunctionErrors,
    KnownNoise,
    KnownSlopes,
    Paths,
    Posterior,
    PosteriorWithErrors,
    as_exact,
    average,
    fit_exact,
    fit_sparse,
    function_errors,
    mean_errors,
    mean_of,
    misfit_variance,
    n_searched,
    narrowing,
    residual_drift,
    stratified,
)
from skdgp.kernels import (
    ConvolvedGaussian,
    LinearTrend,
    MultiOutputKernel,
    as_multi_output,
    has_prior_paths,
)

LARGEST_MISFIT = 0.99  # over misfit and noise
FIT_REMEDY = (
    "Use inference='sparse' (--inference sparse) or fewer values: "
    "skdgp.model_selection.thin_targets(Y, 755) "
    "(--samples 755) keeps 755 samples spread over the log."
)
PREDICT_REMEDY = "Use fewer samples at a time, or return_std=True, which needs no joint covariance."
# Searches of a time series, each from other rows (docs/results.md, pairs of flights)
SEARCHES = 2
# Fewest and most shared latents where their number is not given; more take more time
N_LATENT = 2, 4
LOG_ITERATIONS = 60  # of a log
# Most iterations, of at most so many values; of more values, as many as take the same time
ITERATIONS, ITERATED_VALUES = 150, 1500
# Most observed values, and values of a log, of which inference="auto" is exact
EXACT_LIMIT, LOG_LIMIT = 6000, 1000
# Largest prior variance that inducing variables leave unexplained, over the noise variance
MOST_NEGLECTED = 0.3
ADDITIVE_SAMPLES = (
    5000  # of a log: largest number for which an average has main effects, see docs/theory.md
)


class DependentGPRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    r"""Gaussian-process regression of several dependent outputs.

    Output i is the sum of a trend, of latent white-noise processes x_m with a Gaussian filter h_mi
    each, and of measurement noise:

    .. math:: y_i(s) = t_i(s) + \sum_m (h_{mi} * x_m)(s) + w_i(s), \quad w_i \sim N(0, \sigma_i^2).

    Filters, trend and noise are learned jointly by maximising the marginal likelihood (Boyle &
    Frean 2005; Hemakumara & Sukkarieh 2011, equations 14 to 20). Outputs that share a latent
    process are correlated, so the samples of one output improve the prediction of another output
    that is noisy or observed less often.

    Cost of exact inference: with N observed values (samples times outputs), one evaluation of the
    likelihood takes O(N^3) time and O(N^2) memory. A predicted mean takes O(N), a standard
    deviation O(N^2). To learn from a part of a long log, set the other targets to NaN
    (``skdgp.model_selection.thin_targets``).

    A log, below, are rows in the order of recording, whose ``time`` ``fit`` gets.

    Parameters
    ----------
    kernel : MultiOutputKernel, scikit-learn kernel or None
        Covariance of the processes, with values and bounds in the units of the outputs. Missing
        values are estimated from the data. None: ``ConvolvedGaussian(n_latent)``, for a log with
        ``parameter_bounds={"length_scale": "spacing"}``. A kernel of scikit-learn is wrapped in
        ``Coregionalized``.
    n_latent : int or None
        Number of latent processes that all outputs share; each output also has a private one. Not
        together with ``kernel``, which has its own. None: two, or without ``time`` and with missing
        targets half as many as outputs, two to four.
    structure : {"average", "joint", "additive", "trend"}
        "joint": a trend and the dependent processes. "additive": also a process of each regressor
        alone for each output (main effects). "trend": the trend alone, with its weights integrated
        out. "average": the mixture of posteriors of all terms ("additive" for up to 5000 samples of
        a log, else "joint"), of the trend and main effects, and of the trend, at the same
        hyperparameters. Weights for each output (``weights_``) come from blocks of rows that are
        held out in turn (docs/theory.md). A model without a linear trend, or whose hyperparameters are
        not learned, has one member. With more regressors than rows "average" is "trend".
    trend : {"linear", "constant"} or None
        "constant" subtracts the mean of each output, as in the paper. "linear" adds a linear
        function of the regressors with weights that are integrated out, unless ``kernel`` contains
        a ``LinearTrend``; it extrapolates linearly, with the uncertainty of the slopes. None: no
        trend and no centring.

    inference : {"auto", "exact", "sparse"}
        "exact" computes the posterior from every observed value. "sparse" computes it from all
        values through inducing variables, in linear time and constant memory; it estimates the
        correlation of neighbouring errors, so rows must be in order. Both learn hyperparameters
        from at most 1800 values. "auto" is "exact" up to 6000 observed values, 1000 of a log. Of
        more without ``time`` it is "sparse" where the inducing inputs leave less than 0.3 of the
        noise variance unexplained (Burt, Rasmussen & van der Wilk 2020), else "exact" on 6000 of
        the values. The result is in ``inference_``.
    n_inducing : int
        Inducing inputs of each latent process in sparse inference.
    input_noise : {"auto", "learned"}, array (d,) or None
        Noise of the regressors, independent between samples and regressors: "learned" is one
        standard deviation for each regressor. With their covariance S and the slopes J of the mean
        it adds J S J^T to the noise covariance of the outputs (McHutchon & Rasmussen 2011). None:
        exact regressors. An array has known standard deviations. "auto" is "learned" for a log, and
        else None; without an ``optimizer`` nothing is learned.
    noise_variance : float, array (P,), array (n, P) or None
        Variance of the measurement noise, in squared units of the outputs. None: learned. A number
        for each output is known and keeps its value, or is the starting value if there are bounds.
        One for each value of y, in the shape of y, is known, as scikit-learn's ``alpha``; noise of
        the regressors is not learned beside it.
    noise_variance_bounds : pair of float, array (P, 2) or None
        Bounds of a learned noise variance, in squared units of the outputs. None: 1e-6 to 100 times
        the variance of the output, or fixed where a ``noise_variance`` is given.
    optimizer : "fmin_l_bfgs_b" or None
        None keeps the values of the kernel, and estimates noise that is not given. The posterior
        uses all values.
    max_iter : int or None
        Largest number of iterations of a joint search, half with widths that outputs share.
        The preceding fits of single outputs use at most twice as many each. None: 60 for a log,
        else 150, and down to 86 where the search learns from more than 1500 values, at most 1800.
    random_state : int, RandomState or None
        Seed of the starting values.

    Attributes
    ----------
    kernel_ : MultiOutputKernel
        Fitted covariance of the outputs, in their units. A fit with ``kernel=model.kernel_`` and
        ``structure="joint"`` continues there; with ``noise_variance=model.noise_variance_ +
        model.misfit_variance_``, ``input_noise=np.sqrt(np.diag(model.input_covariance_))`` after a
        fit with ``time``, and ``optimizer=None`` it is the same joint model.
    noise_variance_ : ndarray (P,)
        Variance of the measurement noise, without misfit, in squared units of the outputs; the mean
        over the samples where it was given for each.
    drift_variance_, drift_memory_ : ndarray (P,)
        Variance tau^2 of the drift, and its memory T [s], estimated from the residuals; zero
        without ``time``. The drift holds the effect of errors of the regressors, too. Simulated
        flights have one each.
    misfit_variance_ : ndarray (P,)
        Variance of the error of the function where flights come back to the same regressors, in
        squared units of the outputs: part of the function's band. Zero without ``time``. See
        :func:`skdgp.inference.misfit_variance`.
    input_covariance_ : ndarray (d, d)
        Covariance of the regressors' noise; zero for exact regressors.
    log_marginal_likelihood_value_ : float
        Log marginal likelihood of the normalised outputs. For sparse inference its lower bound,
        with noise that is inflated by the correlation of neighbouring errors.
    inference_ : {"exact", "sparse"}
        Inference that was used.
    posterior_ : Posterior
        Posterior of the normalised outputs with errors of the function: predictions, samples,
        paths and slopes all come from it.
    weights_ : dict of str to ndarray (P,)
        Weight of each kind of member of the average for each output: "joint", with all terms,
        "additive", with main effects, and "trend".
    n_iter_, max_iter_ : int
        Iterations of the joint search, without the fits of single outputs, and their largest
        number. ``n_iter_`` is at least 1, also of a search that starts at its optimum, and of
        ``optimizer=None``.
    interrupted_ : bool
        Whether the search was interrupted inside ``listening(..., keep_best=True)``.
    converged_ : bool
        Whether the search stopped because the likelihood no longer rose, or would rise by less than
        0.05 nats for each value in ``max_iter_`` further iterations. If not, ``fit`` warns.
    center_, scale_ : ndarray (P,)
        The normalised outputs are (y - ``center_``) / ``scale_``.
    output_names_ : list of str
        Column names of Y, or y0, y1, ...
    n_features_in_ : int
    feature_names_in_ : ndarray of str
        Column names of X, if it has any.

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
        "kernel": [Kernel, None],
        "n_latent": [Interval(Integral, 0, None, closed="left"), None],
        "structure": [StrOptions({"average", "joint", "additive", "trend"})],
        "trend": [StrOptions({"linear", "constant"}), None],
        "inference": [StrOptions({"auto", "exact", "sparse"})],
        "n_inducing": [Interval(Integral, 1, None, closed="left")],
        "input_noise": [StrOptions({"auto", "learned"}), "array-like", None],
        "noise_variance": [Interval(Real, 0, None, closed="neither"), "array-like", None],
        "noise_variance_bounds": ["array-like", None],
        "optimizer": [StrOptions({"fmin_l_bfgs_b"}), None],
        "max_iter": [Interval(Integral, 1, None, closed="left"), None],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        kernel: Kernel | None = None,
        *,
        n_latent: int | None = None,
        structure: str = "average",
        trend: str | None = "linear",
        inference: str = "auto",
        n_inducing: int = 100,
        input_noise: Any = "auto",
        noise_variance: Any = None,
        noise_variance_bounds: Any = None,
        optimizer: Any = "fmin_l_bfgs_b",
        max_iter: int | None = None,
        random_state: Seed = None,
    ) -> None:
        self.kernel = kernel
        self.n_latent = n_latent
        self.structure = structure
        self.trend = trend
        self.inference = inference
        self.n_inducing = n_inducing
        self.input_noise = input_noise
        self.noise_variance = noise_variance
        self.noise_variance_bounds = noise_variance_bounds
        self.optimizer = optimizer
        self.max_iter = max_iter
        self.random_state = random_state

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = True
        return tags

    # -- fitting
    # ---------------------------------------------------------------------------------------

    @fit_context(prefer_skip_nested_validation=False)
    def fit(
        self,
        X: Matrix,
        y: Any,
        time: Any = None,
        flight: Any = None,
        slopes: KnownSlopes | None = None,
    ) -> DependentGPRegressor:
        """Learn the hyperparameters and compute the posterior.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, finite.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.
        time : array (n,) or None
            Time of each sample [s], of rows in the order of the log. None: rows in any order, with
            independent errors. Use it if errors of neighbouring samples are correlated, as in a
            flight: without it bands are too narrow.

            With it, noise of the regressors is learned (``input_noise``), and blocks of the average
            are contiguous (``structure``); without it they are random. The residuals show
            the misfit, and the drift of each output, a part of its noise with the covariance
            ``tau^2 exp(-|t - t'| / T)`` within a flight.

            In a pipeline, pass it as ``pipeline.fit(X, y, dependentgpregressor__time=time)`` or by
            metadata routing; ``skdgp.identification.FlightPipeline`` does it itself.
        flight : array (n,) or None
            Label of the flight of each sample. Drifts of different flights are independent. None:
            one flight.

            These are the ``groups`` of a cross-validation. With metadata routing
            ``set_fit_request(flight="groups")`` passes one array to both. ``fit`` has no parameter
            of that name, so groups of a splitter need no request.
        slopes : KnownSlopes or None
            Slopes by the regressors that another source knows better than these samples. A linear
            function is added to the targets, so that their slopes by least squares are these; with
            the errors of the source.

        Returns
        -------
        DependentGPRegressor
            The fitted estimator.

        Raises
        ------
        ValueError
            If X is not finite, an output has fewer than two observed values, there are fewer than
            two samples, values are too large or too small for double precision, or the posterior
            does not fit into memory.
        KeyboardInterrupt
            After Ctrl-C; the estimator is as before. ``skdgp.listening(..., keep_best=True)`` keeps
            the best model so far instead.

        Warns
        -----
        UserWarning
            If an output or a regressor is constant, or samples with equal targets are repeated.
        FewRowsWarning
            If there are fewer than 10 independent rows for each regressor: bands are too narrow
            then.
        ConvergenceWarning
            If the search for hyperparameters stopped at ``max_iter_`` before it converged, or was
            interrupted and the best ones so far are kept.
        """
        before = dict(vars(self))
        try:
            X, Y, clock, noise = self._checked(X, y, time, flight)
            self._learn(X, Y, clock, slopes, noise)
        except BaseException:  # a refused fit changes nothing
            self.__dict__ = before
            raise
        return self

    def _checked(self, X, y, time, flight):
        """Return the samples with a target, X (n, d), Y (n, P), their clock (n, 2) or None, and their known noise."""
        index = getattr(X, "index", None)
        _checks.check_unmasked(X)
        X = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        _checks.warn_of_indices(index, y)
        Y, self.output_names_, self._single = _checks.check_targets(y, len(X), type(self).__name__)
        clock = _checks.check_clock(time, flight, len(X))
        noise = _checks.check_noise(
            self.noise_variance, self.noise_variance_bounds, Y, self._single
        )
        input_std = _checks.check_input_noise(self.input_noise, X.shape[1])
        learns_input_noise = isinstance(self.input_noise, str) and self.input_noise == "learned"
        if noise.loading is not None and (learns_input_noise or input_std is not None):
            raise ValueError(
                f"Got input_noise={self.input_noise!r} and a noise_variance for each value, but "
                "expected one of them: with known noise use input_noise=None."
            )
        if learns_input_noise and self.optimizer is None:
            raise ValueError(
                "Got input_noise='learned' with optimizer=None, which learns nothing: give the "
                "standard deviation of each regressor, such as "
                "input_noise=np.sqrt(np.diag(model.input_covariance_))."
            )
        noise = noise._replace(input_std=input_std)
        used = np.isfinite(Y).any(axis=1)
        X, Y, clock = X[used], Y[used], None if clock is None else clock[used]
        noise = noise.of_rows(used)
        _checks.check_observed(Y, self.output_names_)
        _checks.check_magnitudes(X, self._regressor_names(), "regressors", *_checks.X_RANGE)
        _checks.check_magnitudes(Y, self.output_names_, "targets", *_checks.Y_RANGE)
        _checks.warn_of_samples(X, Y, self._regressor_names(), self.output_names_)
        return X, Y, clock, noise

    def _learn(self, X, Y, clock, slopes, noise):
        """Set the fitted attributes."""
        log = clock is not None
        n_values = int(np.isfinite(Y).sum())
        inference = self.inference
        if inference == "auto":
            inference = "exact" if n_values <= (LOG_LIMIT if log else EXACT_LIMIT) else "sparse"
        if inference == "exact":  # the covariance, and the factors of the components
            searches = n_searches(self, log)
            n_matrices = 1 + 2 * searches if searches > 1 else 2
            check_memory(n_values, "Exact inference on", FIT_REMEDY, n_matrices)
        centred = self.trend is not None
        Z, self.center_, self.scale_ = _checks.standardize(Y, centred, noise.weights)
        self._slopes = None
        if slopes is not None:
            self._slopes = slopes.scaled(1 / self.scale_[:, None])
            Z = self._slopes.corrected(X, Z)
        self.max_iter_ = most_iterations(self.max_iter, Z, log)
        kernel = _make_kernel(self, X, Z, log).rescaled(1 / self.scale_)
        known = noise.in_units(self.scale_)
        fit = fit_structure(self, kernel, X, Z, log, inference, known)
        posterior, learned = fit.posterior, fit.learned
        self.inference_ = "exact" if isinstance(posterior.members[0], ExactPosterior) else "sparse"
        self.weights_ = weights_of(posterior)
        _checks.warn_of_search(learned, self.max_iter_, X, self._regressor_names())
        self.kernel_ = posterior.kernel.rescaled(self.scale_)
        if self.kernel is not None and self.optimizer is not None:
            _checks.warn_of_bounds(as_multi_output(self.kernel), self.kernel_)
        if not learned.interrupted:
            errors = Z - likeliest_mean(posterior, X)
            _checks.warn_of_few_rows(errors, X.shape[1], list(self.weights_))
        misfit, variance, memory = np.zeros((3, len(self.scale_)))
        if log:
            _, variance, memory = residual_drift(posterior, X, Z, clock)
            misfit = misfit_variance(posterior, X, Z, clock)
        # The search took the misfit for noise, of which at least a lower bound is left.
        least = (1.0 - LARGEST_MISFIT) * learned.noise
        if known.bounds is not None:
            least = np.maximum(least, known.bounds[:, 0])
        most = np.maximum(learned.noise - least, 0.0)
        misfit = np.where(known.is_learned, np.minimum(misfit, most), misfit)
        white = np.where(known.is_learned, learned.noise - misfit, learned.noise)
        if known.loading is not None:
            white = white + np.mean(np.einsum("npp->np", known.loading) ** 2, axis=0)
        if log:
            of_function = function_errors(posterior, misfit, learned.input_std, clock[:, 1])
        else:
            of_function = mean_errors(posterior)
        if not centred:
            of_function = of_function.without_means(len(self.scale_))
        if self._slopes is not None:
            of_function = self._slopes.replaced(of_function)
        if log or centred or self._slopes is not None:
            posterior = PosteriorWithErrors(posterior, of_function)
        self.posterior_ = posterior
        self.misfit_variance_ = misfit * self.scale_**2
        self.noise_variance_ = white * self.scale_**2
        self.drift_variance_ = variance * self.scale_**2
        self.drift_memory_ = memory
        self._input_std = learned.input_std
        std = np.zeros(X.shape[1]) if learned.input_std is None else learned.input_std
        self.input_covariance_ = np.diag(std**2)
        self.log_marginal_likelihood_value_ = posterior.log_marginal_likelihood
        self.n_iter_ = max(1, learned.n_iter)
        self.converged_ = learned.converged
        self.interrupted_ = learned.interrupted

    # -- predictions: y = center_ + scale_ z for the normalised outputs z
    # ------------------------------------

    def predict(
        self,
        X: Matrix,
        return_std: bool = False,
        return_cov: bool = False,
        include_noise: bool = False,
        include_input_noise: Any = True,
    ) -> Any:
        """Predict the outputs (equations 17 and 18).

        Parameters
        ----------
        X : array or DataFrame (n, d)
        return_std : bool
            Also return the standard deviation of each output, in the shape of the mean.
        return_cov : bool
            Also return the joint covariance of all outputs at all samples, (P n, P n),
            output-major. Its diagonal holds the squares of ``return_std``.
        include_noise : bool
            Return the uncertainty of a new measurement instead of the function's.
        include_input_noise : bool, float or array (n,)
            True: X has the noise covariance S of the fit (``input_noise``), and J S J^T is added
            with the slopes J of the mean. A number multiplies S, for example for rougher air.
            False: X is exact.

        Returns
        -------
        mean : ndarray (n, P), or (n,) for one-dimensional targets
        std or cov : ndarray
            With ``return_std`` or ``return_cov``.

        Raises
        ------
        ValueError
            If X is not finite, or both ``return_std`` and ``return_cov`` are True.
        """
        if return_std and return_cov:
            raise ValueError(
                "Got return_std=True and return_cov=True, but at most one of them can be returned."
            )
        X = self._check_regressors(X)
        if not (return_std or return_cov):
            return self._in_output_units(self.posterior_.predict(X))
        if return_std:
            mean, variance = self.posterior_.predict(X, return_variance=True)
            variance = variance + np.sum(self._loading(X, include_input_noise) ** 2, axis=2)
            if include_noise:
                variance = variance + self.noise_variance_ / self.scale_**2
            return self._in_output_units(mean), self._squeeze(np.sqrt(variance) * self.scale_)
        mean = self._in_output_units(self.posterior_.predict(X))
        check_memory(mean.size, "The joint covariance of", PREDICT_REMEDY)
        cov = self.posterior_.covariance(X)
        loading = self._loading(X, include_input_noise)
        blocks = cov.reshape(len(self.scale_), len(X), len(self.scale_), len(X))
        np.einsum("iaja->aij", blocks)[:] += loading @ loading.swapaxes(1, 2)
        if include_noise:
            noise = self.noise_variance_ / self.scale_**2
            cov[np.diag_indices_from(cov)] += np.repeat(noise, len(X))
        scale = np.repeat(self.scale_, len(X))
        return mean, cov * np.multiply.outer(scale, scale)

    def impute(self, X: Matrix, Y: Any, return_std: bool = False) -> Any:
        r"""Replace missing targets, from the regressors and the other outputs of the same row.

        ``predict`` gives the function of the regressors. A measurement whose row has other outputs
        is better known than that, since outputs share what changes from row to row. Given these,
        output p is

        .. math:: y_p = c + f(x) + \sum_q (a_q \bar y_q + b_q (y_q - \bar y_q)) + g(y_{-p}) + w

        with a rough process f (Matern 1/2), the outputs :math:`y_q` that are known in most rows
        without p, their means :math:`\bar y_q` over rows with near regressors, normal weights a and b of
        one scale, a smooth process g and white noise w; all but the scales, lengths and noise are
        integrated out. Weights of means and deviations differ, since outputs that drift together
        need not move together. Three bandwidths of the means, 0.02, 0.05 and 0.1 standard
        deviations of the regressors, are averaged. A positive output is replaced by its logarithm
        where this is closer to a normal distribution.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors of all rows to learn from and to complete: rows of the fit, and new rows.
        Y : array or DataFrame (n, P)
            Targets; NaN where an output was not observed.
        return_std : bool
            Also return standard deviations of the replaced measurements, zero where observed.

        Returns
        -------
        Y : ndarray (n, P)
            Of an output with logarithms, replaced values are medians. Rows without any of the other
            outputs have the mean of ``predict``, and its standard deviation with noise.
        std : ndarray (n, P)
            With ``return_std``.

        Raises
        ------
        ValueError
            If X is not finite, or Y does not have a row for each of X and the outputs of the fit.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> rng = np.random.default_rng(0)
        >>> x, Y = np.arange(40.0)[:, None], np.repeat(rng.normal(size=(40, 1)), 2, axis=1)
        >>> truth, Y[10:20, 1] = Y[10:20, 1].copy(), np.nan
        >>> filled = DependentGPRegressor(max_iter=5, random_state=0).fit(x, Y).impute(x, Y)
        >>> bool(np.allclose(filled[10:20, 1], truth, atol=0.01))
        True
        """
        X = self._check_regressors(X)
        mean, std = self.predict(X, return_std=True, include_noise=True)
        mean, std = mean.reshape(len(X), -1), std.reshape(len(X), -1)
        value, deviation = imputed(X, self._check_targets(Y, mean.shape), mean, std)
        if not return_std:
            return self._squeeze(value)
        return self._squeeze(value), self._squeeze(deviation)

    def predict_gradient(self, X: Matrix) -> Array:
        """Return the slopes of the mean at X (n, d), d mean / d regressor.

        They are (n, P, d), or (n, d) for one-dimensional targets. Their spread is that of the slopes
        of `sample_paths`.
        """
        X = self._check_regressors(X)
        return self._squeeze(self.posterior_.gradient(X) * self.scale_[:, None])

    def function_errors(self) -> FunctionErrors | None:
        """Return the errors of the function that the posterior alone does not hold, part of every prediction.

        In units of the outputs. See :func:`skdgp.inference.function_errors`; without ``time``
        :func:`skdgp.inference.mean_errors`, or None for outputs that were not centred.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x, time = np.random.default_rng(0).normal(size=(200, 1)), np.arange(200.0)
        >>> y = 2.0 * x + np.sin(time)[:, None]
        >>> model = DependentGPRegressor(structure="trend").fit(x, y, time=time)
        >>> model.function_errors().variance(x[:5]).shape
        (5, 1)
        """
        check_is_fitted(self)
        if not isinstance(self.posterior_, PosteriorWithErrors):
            return None
        d = self.n_features_in_
        return self.posterior_.errors.in_units(np.zeros(d), np.ones(d), self.scale_)

    def narrowing(self, added: Matrix) -> Matrix:
        """Return the factor (P, d) by which rows that are flown next narrow deviations of slopes, as of least squares.

        ``added`` (k, d) are their regressors.
        """
        return narrowing(self.posterior_, self._check_regressors(added))

    def sample_y(
        self,
        X: Matrix,
        n_samples: int = 1,
        random_state: Seed = 0,
        include_noise: bool = False,
        include_input_noise: Any = True,
    ) -> Array:
        """Return samples of the joint distribution of all outputs at X (n, d).

        Their mean and covariance are those of ``predict(X, return_cov=True)`` with the same
        switches. They are (n, P, n_samples), or (n, n_samples) for one-dimensional targets. A
        kernel without sample paths has them from the joint covariance, in O(P^3 n^3) time.
        """
        X = self._check_regressors(X)
        _check_number("samples", n_samples)
        if not has_prior_paths(self.kernel_):
            switches = {"include_noise": include_noise, "include_input_noise": include_input_noise}
            mean, cov = self.predict(X, return_cov=True, **switches)
            normal = check_random_state(random_state).standard_normal((len(cov), n_samples))
            deviations = (covariance_root(cov) @ normal).reshape(-1, len(mean), n_samples)
            return mean[..., None] + self._squeeze(deviations.swapaxes(0, 1))
        values = self.sample_paths(n_samples, random_state)(X).reshape(n_samples, len(X), -1)
        # other numbers than in the paths
        seed = check_random_state(random_state).randint(2**31 - 1, size=9)
        rng = np.random.default_rng(seed)
        loading = self._loading(X, include_input_noise)
        errors = rng.standard_normal((n_samples, len(X), loading.shape[2]))
        values = values + np.einsum("npd,snd->snp", loading, errors) * self.scale_
        if include_noise:
            values = values + rng.standard_normal(values.shape) * np.sqrt(self.noise_variance_)
        return self._squeeze(np.moveaxis(values, 0, -1))

    def sample_paths(self, n_paths: int = 1, random_state: Seed = 0) -> Any:
        """Return sample paths of the posterior: samples that are functions of the regressors, without noise.

        A path can be evaluated and differentiated at any points, repeatedly, as a simulation needs
        it. A path is a random function of the prior, a
        sum of waves, plus a correction by the data (Matheron's rule: Wilson et al. 2020,
        "Efficiently sampling functions from Gaussian process posteriors"). Mean and covariance
        over many paths equal ``predict(X, return_cov=True, include_input_noise=False)``, errors of
        the function included. Equal seeds give equal functions.

        ``paths(X)`` are the values at the same points X (n, d), (n_paths, n, P), or (n_paths, n) for
        one-dimensional targets, ``paths.each(X)`` of each path at its own points X (n_paths, n, d),
        and ``paths.gradient(X)`` slopes at either, (n_paths, n, P, d). Raises ValueError if
        ``n_paths`` is not a positive integer.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x = np.linspace(0.0, 6.0, 40)[:, None]
        >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
        >>> paths = model.sample_paths(50)
        >>> paths(x).shape, paths.gradient(x).shape
        ((50, 40), (50, 40, 1))
        """
        check_is_fitted(self)
        _check_number("paths", n_paths)
        return Paths(
            self.posterior_.paths(n_paths, random_state),
            n_paths,
            self.n_features_in_,
            self.center_,
            self.scale_,
            self._single,
            getattr(self, "feature_names_in_", None),
        )

    def score(self, X: Matrix, y: Any) -> float:
        """Return the coefficient of determination R^2 of the observed targets, averaged over the outputs.

        It is 1 for a perfect prediction, 0 for predicting the mean. Targets y (n,) or (n, P) at X
        (n, d) are NaN where an output was not observed; outputs without targets are ignored.
        """
        mean = self.predict(X).reshape(len(X), -1)
        Y = self._check_targets(y, mean.shape)
        scores = [
            r2_score(y_true[rows], y_pred[rows])
            for y_true, y_pred, rows in zip(Y.T, mean.T, np.isfinite(Y.T), strict=True)
            if rows.any()
        ]
        return float(np.mean(scores)) if scores else float("nan")

    def _loading(self, X, factor):
        """Return J R times the root of ``factor``, (n, P, d), with S = R^2; (n, P, 0) for exact regressors."""
        factor = np.asarray(factor, dtype=float)
        if factor.shape not in ((), (len(X),)) or not (factor >= 0).all():
            raise ValueError(
                f"Got include_input_noise of shape {factor.shape}, but expected a bool, or "
                f"factors of the variance "
                f"from 0 on: one number, or one for each of the {len(X)} rows."
            )
        if self._input_std is None or not factor.any():
            return np.zeros((len(X), len(self.scale_), 0))
        return np.sqrt(factor.reshape(-1, 1, 1)) * (self.posterior_.gradient(X) * self._input_std)

    def _check_regressors(self, X):
        if self._is_valid(X):
            return X
        check_is_fitted(self)
        _checks.check_unmasked(X)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        _checks.check_magnitudes(X, self._regressor_names(), "regressors", 0.0, _checks.X_RANGE[1])
        return X

    def _check_targets(self, y, shape):
        """Return targets in a table of this shape; NaN where an output was not observed."""
        Y = check_array(
            y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y"
        )
        if Y.reshape(len(Y), -1).shape != shape:
            raise ValueError(
                f"Got y of shape {Y.shape}, but expected {shape}: a row for each of X, all outputs."
            )
        return Y.reshape(shape)

    def _regressor_names(self) -> list[str]:
        """Return the names of the regressors, or x0, x1, ... if they have none."""
        return list(
            getattr(self, "feature_names_in_", [f"x{k}" for k in range(self.n_features_in_)])
        )

    def _is_valid(self, X):
        """Return whether X needs no conversion by ``validate_data``, which dominates the time of a single row."""
        return (
            type(X) is np.ndarray
            and X.dtype == np.float64
            and X.ndim == 2
            and len(X) > 0
            and X.shape[1] == getattr(self, "n_features_in_", None)
            and hasattr(self, "posterior_")
            and not hasattr(self, "feature_names_in_")
            and float(np.abs(X).max()) <= _checks.X_RANGE[1]
        )

    def _in_output_units(self, mean):
        """Return the mean (n, P) of the normalised outputs in the units of the outputs."""
        return self._squeeze(mean * self.scale_ + self.center_)

    def _squeeze(self, values):
        """Return values (n, P, ...), without the axis of outputs for one-dimensional targets."""
        return values[:, 0] if self._single else values


# -- the kernel and its fit
# --------------------------------------------------------------------------------------


def fit_structure(
    model: BaseEstimator,
    kernel: MultiOutputKernel,
    X: Matrix,
    Z: Matrix,
    log: bool,
    inference: str,
    known: KnownNoise,
) -> Fit:
    """Return the fit to X (n, d) and centred and scaled targets Z (n, P), rows of a ``log`` in its order or others.

    ``kernel`` has all terms, and ``known`` is the noise, of the scaled targets. Parameters of the
    model, a DependentGPRegressor, are read; it is not changed.
    """
    random_state = check_random_state(model.random_state)
    fits: list[Fit] = []
    data = Data.from_table(X, Z, known.loading)  # one copy for all
    while len(fits) < n_searches(model, log):
        fits.append(_searched(model, kernel, X, Z, data, log, inference, known, random_state))
        if fits[-1].learned.interrupted:
            return fits[0].cut_short()
    return mean_of(fits)


def n_searches(model: BaseEstimator, log: bool) -> int:
    """Return the number of searches whose averages a fit is the mean of."""
    return SEARCHES if log and model.structure == "average" and model.optimizer is not None else 1


def _searched(model, kernel, X, Z, data, log, inference, known, random_state):
    """Return the fit of one search."""
    kind = model.input_noise if isinstance(model.input_noise, str) else None
    has_input_noise = kind == "learned" or (log and kind == "auto") or known.input_std is not None
    options = {
        "known": known,
        "optimizer": model.optimizer,
        "max_iter": most_iterations(model.max_iter, Z, log),
        "input_noise": has_input_noise and known.loading is None,
        "random_state": random_state.randint(2**31 - 1),
    }
    if inference == "exact":
        fit = fit_exact(kernel, X, Z, data=data, **options)
    else:
        options |= {"n_inducing": model.n_inducing, "ordered": log}
        fit = fit_sparse(kernel, X, Z, data=data, **options)
        neglected = 0.0  # prior variance over the noise, of the worst output
        if not (log or fit.learned.interrupted or fit.learned.input_std is not None):
            sparse: Any = fit.posterior
            neglected = float(np.max(sparse.unexplained_variance / sparse.noise))
        n_exact = EXACT_LIMIT if model.inference == "auto" else None
        if neglected > MOST_NEGLECTED:
            _checks.warn_of_approximation(neglected, model.n_inducing, n_exact)
        if neglected > MOST_NEGLECTED and n_exact is not None:
            n = EXACT_LIMIT * len(X) // np.isfinite(Z).sum()
            rows = stratified(np.arange(len(X)), n, random_state)
            X, Z, known = X[rows], Z[rows], known.of_rows(rows)
            data = fit.learned.noisy(Data.from_table(X, Z, known.loading))
            fit = as_exact(fit.learned, X, Z, data, known)
    if model.structure != "average" or model.optimizer is None or fit.learned.interrupted:
        return fit
    return average(fit, X, Z, None if log else random_state, known)


def most_iterations(max_iter: int | None, Y: Matrix, log: bool) -> int:
    """Return the largest number of iterations of the search for hyperparameters, which learns from N values.

    Where it is not given, 60 of a log, else 150, or :math:`150 (1500 / N)^3`, as N^3 is the time of
    an iteration.
    """
    if max_iter is not None or log:
        return LOG_ITERATIONS if max_iter is None else max_iter
    return int(ITERATIONS * min(ITERATED_VALUES / n_searched(Y), 1.0) ** 3)


def weights_of(posterior: Posterior) -> dict[str, Vector]:
    """Return the weight (P,) of each kind of member of a posterior, by its name."""
    weights: dict = {}
    for member, weight in zip(posterior.members, posterior.mixture, strict=True):
        weights[_name(member.kernel)] = weights.get(_name(member.kernel), 0.0) + weight
    return weights


def likeliest_mean(posterior: Posterior, X: Matrix) -> Matrix:
    """Return the mean at X (n, d) of the member with the largest weight, for each output, (n, P).

    Its errors are noise, where an average still has a part of the errors of the other members.
    """
    means = np.array([member.predict(X) for member in posterior.members])
    return np.take_along_axis(means, posterior.mixture.argmax(axis=0)[None, None], axis=0)[0]


def _name(kernel):
    terms = [term for term in kernel.summands() if not isinstance(term, LinearTrend)]
    several = any(len(term.term_regressors()[0]) > 1 or kernel.n_features == 1 for term in terms)
    return "joint" if several else "additive" if terms else "trend"


def _check_number(what, number):
    """Raise a ValueError unless this is a positive integer."""
    if not isinstance(number, Integral) or isinstance(number, bool) or number < 1:
        raise ValueError(f"Got n_{what}={number!r}, but expected a number of {what} from 1 on.")


def _make_kernel(model, X, Z, log):
    """Return the kernel of all terms, in the units of the outputs.

    Raises ValueError if the structure needs another kernel or trend, or if ``n_latent`` is given
    beside a kernel.
    """
    if model.structure == "trend" and (model.kernel is not None or model.trend != "linear"):
        raise ValueError(
            f"Got structure='trend' with kernel={model.kernel!r} and trend={model.trend!r}, but "
            "expected kernel=None and trend='linear', or structure='joint' for a given kernel."
        )
    if model.structure == "additive" and model.kernel is not None:
        raise ValueError(
            f"Got structure='additive' with kernel={model.kernel!r}, but expected kernel=None. Use "
            "structure='joint', and add ConvolvedGaussian(0, regressors=[k]) to the kernel."
        )
    if model.n_latent is not None and model.kernel is not None:
        raise ValueError(
            f"Got n_latent={model.n_latent} with kernel={model.kernel!r}, but expected one of them: "
            f"leave out n_latent, and give it to the kernel, such as "
            f"ConvolvedGaussian({model.n_latent})."
        )
    n, d = X.shape
    # one centre for all searches and components
    trend = LinearTrend(center=X.mean(axis=0)) if model.trend == "linear" else None
    if model.kernel is not None:
        given = as_multi_output(clone(model.kernel))
        complete = trend is None or any(term.n_processes == 0 for term in given.summands())
        return given if complete else trend + given
    averaged = model.structure == "average" and trend is not None
    if model.structure == "trend" or (averaged and d > n):  # a process would have no weight
        return trend
    bounds = {"length_scale": "spacing"} if log else None
    n_latent = model.n_latent
    if n_latent is None:  # more where they can fill what is missing
        n_latent = (
            N_LATENT[0] if log or np.isfinite(Z).all() else int(np.clip(Z.shape[1] // 2, *N_LATENT))
        )
    kernel: MultiOutputKernel = ConvolvedGaussian(n_latent, parameter_bounds=bounds)
    if model.structure == "additive" or (log and averaged and d > 1 and n <= ADDITIVE_SAMPLES):
        for k in range(d):
            kernel = ConvolvedGaussian(0, regressors=[k], parameter_bounds=bounds) + kernel
    return kernel if trend is None else trend + kernel
