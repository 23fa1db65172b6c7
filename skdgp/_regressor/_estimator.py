"""DependentGPRegressor: its kernel, its fit and its predictions."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral, Real
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.gaussian_process.kernels import Kernel
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._compute.linalg import check_memory, covariance_root
from skdgp._compute.messages import report
from skdgp._compute.sklearn_compat import Interval, StrOptions, fit_context
from skdgp._compute.statistics import r2_of_observed
from skdgp._compute.typing import Array, Matrix, Seed
from skdgp._regressor import _checks
from skdgp._regressor._recipe import Recipe, RegressorSettings, likeliest_mean, weights_of
from skdgp.inference import (
    ExactPosterior,
    FunctionErrors,
    KnownSlopes,
    Paths,
    check_spread,
    errors_by_input_noise,
    order_of_rows,
    residual_drift,
)
from skdgp.kernels import as_multi_output

FIT_REMEDY = (
    "Use inference='sparse' or fewer values: "
    "skdgp.model_selection.thin_targets(Y, 755) (--samples 755) keeps 755 samples spread over the flight."
)
PREDICT_REMEDY = "Use fewer samples at a time, or return_std=True, which needs no joint covariance."


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
    deviation O(N^2). To learn from a part of a long time series, set the other targets to NaN
    (``skdgp.model_selection.thin_targets``).

    "Time series" below means rows that are fitted with ``time``; ``fit`` brings them in the order of
    flight and time.

    Parameters
    ----------
    kernel : MultiOutputKernel, scikit-learn kernel or None
        Covariance of the processes, with values and bounds in the units of the outputs. Missing
        values are estimated from the data. None: for a time series ``ConvolvedGaussian(n_latent,
        covariance_type="tied")`` with length scales of at least n^(-1/d) standard deviations, for n
        samples, at most 400, in d regressors (docs/theory.md, smallest widths). For other
        data and ``structure="average"``, independent outputs, length scales that the outputs share,
        without and with private latents, and ``ConvolvedGaussian(n_latent)`` are compared, the
        likeliest also with shifts where separate fits of the outputs show them; their mixture has
        Akaike weights (docs/theory.md, structures). A kernel of scikit-learn is wrapped in
        ``Coregionalized``; with ``optimizer=None`` it is the covariance of each output, as it stands.
    n_latent : int or None
        Number of latent processes that all outputs share; each output also has a private one. Not
        together with ``kernel``, which has its own. None: two, or without ``time`` and with missing
        targets half as many as outputs, two to four.
    structure : {"average", "joint", "trend"}
        "joint": a trend and the dependent processes. "trend": the trend alone, with its weights
        integrated out. "average": the mixture of both posteriors, at the same hyperparameters.
        Weights for each output (``weights_``) come from blocks of rows that are held out in turn
        (docs/theory.md). A model without a linear trend, or whose hyperparameters are not learned,
        has one member. With more regressors than rows "average" is "trend".
    trend : {"linear", "constant"} or None
        "constant" subtracts the mean of each output, as in the paper. "linear" adds a linear
        function of the regressors with weights that are integrated out, unless ``kernel`` contains
        a ``LinearTrend``; it extrapolates linearly, with the uncertainty of the slopes. None: no
        trend and no centring.

    inference : {"auto", "exact", "sparse"}
        "exact" computes the posterior from every observed value. "sparse" computes it from all
        values through inducing variables, in linear time and constant memory; it estimates the
        correlation of neighbouring errors of a time series. Both learn hyperparameters from at most
        1500 values, of a time series from three blocks of 1000, whose likelihoods add up. "auto" is
        "exact" up to 1000 observed values of a time series, and "sparse" for more. Without ``time``
        it is "exact" up to 6000. Of N > 6000 it is "sparse" where up to four times as many inducing
        inputs leave at most 0.003 (N / 6000)^2, or 0.3, of the noise variance unexplained (Burt,
        Rasmussen & van der Wilk 2020), else "exact" on 6000 of the values. The result is in
        ``inference_``.
    n_inducing : int
        Inducing inputs of each latent process in sparse inference; "auto" may take more.
    input_noise : {"auto", "learned"}, array (d,) or None
        Noise of the regressors, independent between samples and regressors: "learned" is one
        standard deviation for each regressor. With their covariance S and the slopes J of the mean
        it adds J S J^T to the noise covariance of the outputs (McHutchon & Rasmussen 2011). None:
        exact regressors. An array has known standard deviations. "auto" is "learned" for a time series,
        and else None; without an ``optimizer`` nothing is learned.
    noise_variance : float, array (P,), array (n, P) or None
        Variance of the measurement noise, in squared units of the outputs. None: learned. A number
        for each output is known and keeps its value, or is the starting value if there are bounds.
        One for each value of y, in the shape of y, is known, as scikit-learn's ``alpha``; noise of
        the regressors is not learned beside it.
    noise_variance_bounds : pair of float, array (P, 2) or None
        Bounds of a learned noise variance, in squared units of the outputs. None: 1e-6 to 100 times
        the variance of the output, or fixed where a ``noise_variance`` is given.
    optimizer : "fmin_l_bfgs_b" or None
        The name is scikit-learn's; the search is that of docs/theory.md, hyperparameters. None keeps the
        values of the kernel, and estimates noise that is not given. The posterior uses all values.
    n_restarts_optimizer : int
        Searches of each kernel from random starts within its bounds, of which the likeliest counts.
        Each takes as long as the first. As in scikit-learn they change nothing without an
        ``optimizer``.
    max_iter : int
        Largest number of steps from each starting point, each with one evaluation.
    random_state : int, RandomState or None
        Seed of restarts.

    Attributes
    ----------
    kernel_ : MultiOutputKernel
        Fitted covariance of the outputs, in their units. A fit with ``kernel=model.kernel_`` and
        ``structure="joint"`` continues there; with ``noise_variance=model.noise_variance_``,
        ``input_noise=np.sqrt(np.diag(model.input_covariance_))`` after a fit with ``time``, and
        ``optimizer=None`` it is the same joint model, if no value was an outlier (with noise of the
        regressors up to about a hundredth of the band).
    noise_variance_ : ndarray (P,)
        Variance of the measurement noise, in squared units of the outputs; the mean over the
        samples where it was given for each, or where some are outliers.
    drift_variance_, drift_memory_ : ndarray (P,)
        Variance tau^2 of the drift, and its correlation time T [s], estimated from the residuals;
        zero without ``time``. The drift holds the effect of errors of the regressors, too.
        Simulated flights have one each.
    input_covariance_ : ndarray (d, d)
        Covariance of the regressors' noise; zero for exact regressors. Of a regressor that no
        output depends on nothing is learned, and its noise stays where the search began.
    log_marginal_likelihood_value_ : float
        Log marginal likelihood of the normalised outputs. For sparse inference its lower bound,
        with noise that is inflated by the correlation of neighbouring errors.
    inference_ : {"exact", "sparse"}
        Inference that was used.
    posterior_ : Posterior
        Posterior of the normalised outputs with errors of the function: predictions, samples,
        paths and slopes all come from it.
    weights_ : dict of str to ndarray (P,)
        Weight of each kind of component of the average for each output: "joint", with all terms,
        and "trend".
    n_iter_ : int
        Steps of the joint search, without the fits of single outputs. At least 1, also of a search
        that starts at its optimum, and of ``optimizer=None``.
    converged_ : bool
        Whether the search ended at a stationary point of the likelihood of all values that it learned
        from, with slopes of at most 0.001 nats for a standard error of each hyperparameter, or at
        bounds. If not, ``fit`` warns.
    slopes_ : KnownSlopes or None
        Those of ``fit``, (P, d), in units of the outputs over those of the regressors.
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
        "structure": [StrOptions({"average", "joint", "trend"})],
        "trend": [StrOptions({"linear", "constant"}), None],
        "inference": [StrOptions({"auto", "exact", "sparse"})],
        "n_inducing": [Interval(Integral, 1, None, closed="left")],
        "input_noise": [StrOptions({"auto", "learned"}), "array-like", None],
        "noise_variance": [Interval(Real, 0, None, closed="neither"), "array-like", None],
        "noise_variance_bounds": ["array-like", None],
        "optimizer": [StrOptions({"fmin_l_bfgs_b"}), None],
        "n_restarts_optimizer": [Interval(Integral, 0, None, closed="left")],
        "max_iter": [Interval(Integral, 1, None, closed="left")],
        "random_state": ["random_state"],
    }

    #: Choices where a parameter is not given
    settings = RegressorSettings()

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
        n_restarts_optimizer: int = 0,
        max_iter: int = 300,
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
        self.n_restarts_optimizer = n_restarts_optimizer
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
        slopes: KnownSlopes | Callable[..., KnownSlopes | None] | None = None,
        errors: FunctionErrors | None = None,
    ) -> DependentGPRegressor:
        """Learn the hyperparameters and compute the posterior.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, finite.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.
        time : array (n,) or None
            Time of each sample [s], of rows in any order. None: independent errors. Use it if errors
            of neighbouring samples are correlated, as in a flight: without it bands are too narrow.

            With it, noise of the regressors is learned (``input_noise``), and blocks of the average
            are contiguous (``structure``); without it they are random. The residuals show the drift
            of each output, a part of its noise with the covariance ``tau^2 exp(-|t - t'| / T)``
            within a flight.

            In a pipeline, pass it as ``pipeline.fit(X, y, dependentgpregressor__time=time)`` or by
            metadata routing; ``skdgp.identification.FlightPipeline`` does it itself.
        flight : array (n,) or None
            Label of the flight of each sample. Drifts of different flights are independent. None:
            one flight.

            These are the ``groups`` of a cross-validation. With metadata routing
            ``set_fit_request(flight="groups")`` passes one array to both. ``fit`` has no parameter
            of that name, so groups of a splitter need no request.
        slopes : KnownSlopes, callable or None
            Slopes by the regressors that another source knows better than these samples. A linear
            function is added to the mean, so that its slopes over the samples are these, with the
            errors of the source. A callable is given the function that is learned without them,
            ``predict(X)``, (n, P), and returns slopes or None.
        errors : FunctionErrors or None
            Errors of the function that these samples do not show, in units of X and y. They add to
            its covariance.

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
            After Ctrl-C; the estimator is as before.

        Warns
        -----
        UserWarning
            If an output or a regressor is constant, or samples with equal targets are repeated.
        FewRowsWarning
            If there are fewer than 10 independent rows for each regressor: bands may be too narrow
            then.
        ConvergenceWarning
            If the search for hyperparameters stopped at ``max_iter`` before it converged.
        """
        before = dict(vars(self))
        try:
            X, Y, clock, noise, rows = self._checked(X, y, time, flight)
            self._learn(X, Y, clock, slopes, errors, noise, rows)
        except BaseException:  # a refused fit changes nothing
            self.__dict__ = before
            raise
        return self

    def _checked(self, X, y, time, flight):
        """Return the samples with a target, X (n, d), Y (n, P), their clock (n, 2) or None, known noise, and rows."""
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
        if noise.added is not None and (learns_input_noise or input_std is not None):
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
        used = np.flatnonzero(np.isfinite(Y).any(axis=1))
        _checks.check_observed(Y, self.output_names_)
        _checks.check_magnitudes(X[used], self._regressor_names(), "regressors", *_checks.X_RANGE)
        _checks.check_magnitudes(Y[used], self.output_names_, "targets", *_checks.Y_RANGE)
        if clock is None:
            used = used[order_of_rows(X[used], Y[used])]
        else:  # errors of neighbours in time are correlated
            used = used[np.lexsort(clock[used].T)]
        X = X[used]
        Y = Y[used]
        clock = None if clock is None else clock[used]
        noise = noise._replace(input_std=input_std).of_rows(used)
        _checks.warn_of_samples(X, Y, self._regressor_names(), self.output_names_)
        return X, Y, clock, noise, used

    def _learn(self, X, Y, clock, slopes, errors, noise, rows):
        """Set the fitted attributes."""
        recipe = Recipe(self, time_series=clock is not None)
        _check_memory(recipe, int(np.isfinite(Y).sum()))
        Z, self.center_, self.scale_ = _checks.standardize(Y, self.trend is not None, noise.weights)
        known_noise = noise.in_units(self.scale_)
        kernels = [kernel.rescaled(1 / self.scale_) for kernel in recipe.make_kernels(X, Z)]
        fit = recipe.fit(kernels, X, Z, known_noise)
        self._set_hyperparameters(fit)
        recorded = np.argsort(rows) if clock is None else np.arange(len(rows))
        self._warn_of_fit(fit, X[recorded], Z[recorded], known_noise, rows)
        self._set_noise(fit, X, Z, clock)
        if callable(slopes):
            slopes = slopes(lambda X: self.center_ + self.scale_ * fit.posterior.predict(X))
        self.slopes_ = slopes
        if slopes is not None:
            slopes = slopes.scaled(1 / self.scale_[:, None])
        std = fit.learned.input_std if recipe.time_series else None
        self.posterior_ = fit.posterior
        if recipe.time_series or slopes is not None or errors is not None:
            self.posterior_ = fit.posterior.with_errors(
                self._errors_of(fit.posterior, X, std, slopes, errors)
            )

    def _set_hyperparameters(self, fit):
        """Set the attributes that the search has found."""
        posterior, learned = fit
        self.inference_ = "exact" if isinstance(posterior.members[0], ExactPosterior) else "sparse"
        self.weights_ = weights_of(posterior)
        self.kernel_ = posterior.kernel.rescaled(self.scale_)
        self._input_std = learned.input_std
        std = np.zeros(self.n_features_in_) if learned.input_std is None else learned.input_std
        self.input_covariance_ = np.diag(std**2)
        self.log_marginal_likelihood_value_ = posterior.log_marginal_likelihood
        self.n_iter_ = max(1, learned.n_iter)
        self.converged_ = learned.converged

    def _warn_of_fit(self, fit, X, Z, known, rows):
        """Warn of a search that did not converge, of values at their bounds, of outliers, and of few rows.

        X (n, d) and Z (n, P) are in recording order, ``rows`` (n,) those of the fit.
        """
        ended = _checks.search_ended(self)
        if ended is not None:
            report(ended, _checks.SearchWarning)
        if self.kernel is not None and self.optimizer is not None:
            _checks.warn_of_bounds(as_multi_output(self.kernel), self.kernel_)
            _checks.warn_of_noise(self.kernel_, X, self.output_names_, self.scale_)
        added = fit.learned.added
        if added is not None and known.added is None:
            _checks.warn_of_outliers(added, fit.learned.noise, self.output_names_, rows)
        errors = Z - likeliest_mean(fit.posterior, X)
        _checks.warn_of_few_rows(errors, X.shape[1], list(self.weights_))

    def _set_noise(self, fit, X, Z, clock):
        """Set noise and drift of the outputs."""
        white = fit.learned.noise
        if fit.learned.added is not None:
            # a new measurement is an outlier as often as those of the fit
            white = white + np.mean(fit.learned.added, axis=0)
        variance, memory = np.zeros((2, len(white)))
        if clock is not None:
            variance, memory = residual_drift(fit.posterior, X, Z, clock)
        self.noise_variance_ = white * self.scale_**2
        self.drift_variance_ = variance * self.scale_**2
        self.drift_memory_ = memory

    def _errors_of(self, posterior, X, std, slopes, further):
        """Return the errors of the function: by noise of the regressors, of known slopes, and further ones."""
        function = posterior.mean_function
        if slopes is not None:
            known = slopes.function_errors(X, posterior.predict(X))
            function = function + known.mean_path()
        errors = errors_by_input_noise(posterior.data.X, function, std)
        if slopes is not None:
            errors = slopes.left_of(errors).joined(known)
        if further is not None:
            unscaled = np.zeros(self.n_features_in_), np.ones(self.n_features_in_)
            errors = errors.joined(further.in_units(*unscaled, 1 / self.scale_))
        return errors

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
        if return_std:
            return self._mean_and_std(X, include_noise, include_input_noise)
        mean = self._in_output_units(self.posterior_.predict(X))
        if return_cov:
            check_memory(mean.size, "The joint covariance of", PREDICT_REMEDY)
            return mean, self._covariance(X, include_noise, include_input_noise)
        return mean

    def _mean_and_std(self, X, include_noise, include_input_noise):
        mean, variance = self.posterior_.predict(X, return_variance=True)
        variance = variance + np.sum(self._loading(X, include_input_noise) ** 2, axis=2)
        if include_noise:
            variance = variance + self.noise_variance_ / self.scale_**2
        return self._in_output_units(mean), self._squeeze(np.sqrt(variance) * self.scale_)

    def _covariance(self, X, include_noise, include_input_noise):
        """Return the joint covariance at X, (P n, P n), output-major."""
        n, P = len(X), len(self.scale_)
        cov = self.posterior_.covariance(X)
        loading = self._loading(X, include_input_noise)
        blocks = cov.reshape(P, n, P, n)
        np.einsum("iaja->aij", blocks)[:] += loading @ loading.swapaxes(1, 2)
        scale = np.repeat(self.scale_, n)
        cov *= np.multiply.outer(scale, scale)
        _, std = self._mean_and_std(X, include_noise, include_input_noise)
        np.fill_diagonal(cov, std.T.ravel() ** 2)
        return cov

    def predict_gradient(self, X: Matrix, spread: Any = None) -> Array:
        r"""Return the slopes of the mean at X (n, d), d mean / d regressor.

        They are (n, P, d), or (n, d) for one-dimensional targets. The slopes of `sample_paths` show
        their spread. With standard deviations ``spread`` (d,) of the regressors they are

        .. math:: E[\partial f / \partial x_k], \quad x_k \sim N(X_k, s_k^2),

        the slopes of the best linear approximation over a perturbation of each regressor alone
        (statistical linearisation: Gelb 1974, section 6.2). Raises ValueError unless they are d finite numbers
        from 0 on.

        Examples
        --------
        >>> import numpy as np
        >>> from skdgp import DependentGPRegressor
        >>> x = np.linspace(-2.0, 2.0, 60)[:, None]
        >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.tanh(3 * x[:, 0]))
        >>> local, averaged = model.predict_gradient([[0.0]]), model.predict_gradient([[0.0]], [0.5])
        >>> bool(averaged[0, 0] < 0.7 * local[0, 0])
        True
        """
        X = self._check_regressors(X)
        if spread is not None:
            spread = check_spread(spread, X.shape[1])
        return self._squeeze(self.posterior_.gradient(X, spread) * self.scale_[:, None])

    def function_errors(self) -> FunctionErrors | None:
        """Return the errors of the function that the posterior alone does not hold, part of every prediction.

        In units of the outputs. See docs/theory.md; None without ``time``, known slopes and further
        ``errors``.

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
        errors = self.posterior_.errors
        if errors is None:
            return None
        d = self.n_features_in_
        return errors.in_units(np.zeros(d), np.ones(d), self.scale_)

    def sample_y(
        self,
        X: Matrix,
        n_samples: int = 1,
        random_state: Seed = 0,
        include_noise: bool = False,
        include_input_noise: Any = True,
    ) -> Array:
        """Return normal samples with the mean and covariance of all outputs at X (n, d).

        These are as from ``predict(X, return_cov=True)`` with the same switches, and take as long:
        O(P^3 n^3). Samples are (n, P, n_samples), or (n, n_samples) for one-dimensional targets.
        `sample_paths` takes less time at many points.
        """
        _check_number("samples", n_samples)
        switches = {"include_noise": include_noise, "include_input_noise": include_input_noise}
        mean, cov = self.predict(X, return_cov=True, **switches)
        normal = check_random_state(random_state).standard_normal((len(cov), n_samples))
        deviations = (covariance_root(cov) @ normal).reshape(-1, len(mean), n_samples)
        return mean[..., None] + self._squeeze(deviations.swapaxes(0, 1))

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
        return self._paths(self.posterior_.paths(n_paths, random_state), n_paths)

    def mean_path(self) -> Paths:
        """Return the mean as a single path, see `sample_paths`: a simulation evaluates it at one point at a time."""
        check_is_fitted(self)
        return self._paths(self.posterior_.mean_function, 1)

    def _paths(self, bundle, n_paths):
        """Return functions of the posterior in units of the outputs."""
        return Paths(
            bundle,
            n_paths,
            self.n_features_in_,
            self.center_,
            self.scale_,
            self._single,
            getattr(self, "feature_names_in_", None),
        )

    def score(self, X: Matrix, y: Any, sample_weight: Any = None) -> float:
        """Return the coefficient of determination R^2 of the observed targets, averaged over the outputs.

        It is 1 for a perfect prediction, 0 for predicting the mean. Targets y (n,) or (n, P) at X
        (n, d) are NaN where an output was not observed; outputs without targets are ignored.
        ``sample_weight`` (n,) are weights of the rows, by default equal ones.
        """
        mean = self.predict(X).reshape(len(X), -1)
        Y, *_ = _checks.check_targets(y, len(mean), type(self).__name__)
        if Y.shape != mean.shape:
            raise ValueError(
                f"Got y of {Y.shape[1]} outputs, but expected {mean.shape[1]}: all outputs."
            )
        return r2_of_observed(Y, mean, sample_weight)

    def _loading(self, X, factor):
        """Return J R times the root of ``factor``, (n, P, d), with S = R^2; (n, P, 0) for exact regressors."""
        factor = np.asarray(factor, dtype=float)
        if factor.shape not in ((), (len(X),)) or not (factor >= 0).all():
            raise ValueError(
                f"Got include_input_noise of shape {factor.shape}, but expected a bool, or factors of the variance "
                f"from 0 on: one number, or one for each of the {len(X)} rows."
            )
        if self._input_std is None or not factor.any():
            return np.zeros((len(X), len(self.scale_), 0))
        return np.sqrt(factor.reshape(-1, 1, 1)) * (self.posterior_.gradient(X) * self._input_std)

    def _check_regressors(self, X):
        check_is_fitted(self)
        _checks.check_unmasked(X)
        X = validate_data(self, X, dtype=np.float64, reset=False)
        _checks.check_magnitudes(X, self._regressor_names(), "regressors", 0.0, _checks.X_RANGE[1])
        return X

    def _regressor_names(self) -> list[str]:
        """Return the names of the regressors, or x0, x1, ... if they have none."""
        return list(
            getattr(self, "feature_names_in_", [f"x{k}" for k in range(self.n_features_in_)])
        )

    def _in_output_units(self, mean):
        """Return the mean (n, P) of the normalised outputs in the units of the outputs."""
        return self._squeeze(mean * self.scale_ + self.center_)

    def _squeeze(self, values):
        """Return values (n, P, ...), without the axis of outputs for one-dimensional targets."""
        return values[:, 0] if self._single else values


def _check_number(what, number):
    """Raise a ValueError unless this is a positive integer."""
    if not isinstance(number, Integral) or isinstance(number, bool) or number < 1:
        raise ValueError(f"Got n_{what}={number!r}, but expected a number of {what} from 1 on.")


def _check_memory(recipe, n_values):
    """Raise a ValueError if the covariance, and the factors of the components, do not fit into memory."""
    if recipe.inference_of(n_values) == "exact":
        # the covariance, and a factor for each component of the average of a time series
        is_average = recipe.time_series and recipe.given.structure == "average"
        n_matrices = 4 if is_average else 2
        check_memory(n_values, "Exact inference on", FIT_REMEDY, n_matrices)
