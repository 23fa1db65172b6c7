"""The dependent Gaussian process as a scikit-learn regressor: validate, scale, delegate."""

from __future__ import annotations

import warnings
from functools import partial
from numbers import Integral

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin, _fit_context, clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import r2_score
from sklearn.utils import check_array, check_random_state
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._parallel import check_n_jobs, fit_map
from skdgp._targets import check_enough, check_memory, check_targets, warn_of_indices, warn_of_samples
from skdgp.inference import fit_exact, fit_sparse, output_correlation
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel

EXACT_LIMIT = 6000
"""Observed values up to which inference="auto" is exact: about two seconds an evaluation on two cores."""

FEWER_VALUES = (
    "Use inference='sparse', or observe fewer: skdgp.model_selection.thin_targets(Y, 755) keeps 755 samples spread "
    "over the log."
)
FEWER_SAMPLES = "Ask for fewer samples at a time, or for return_std=True, which needs no joint covariance."


class DependentGPRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
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
        covariance_type=covariance_type)``. What the kernel leaves open is taken from the data.
    n_latent : int
        Latent processes shared by all outputs.
    private_latents : bool
        Whether each output also has a latent process of its own, which none of the others sees.
    covariance_type : {"spherical", "diag", "full", "tied"}
        Widths of the filters, see ``ConvolvedGaussian``.
    trend : {"linear", "constant", None}
        "constant" takes the mean of each output away (the paper's centring). "linear" adds a linear function
        of the regressors whose weights are integrated out, so that the model goes on sensibly where there were
        no data, with the uncertainty of the slopes. None: neither.
    inference : {"auto", "exact", "sparse"}
        "exact" conditions on every observed value. "sparse" starts from an exact fit of some samples and maximises
        a lower bound of the likelihood on all of them, in time linear in the samples and memory that does not
        grow. "auto" is "exact" up to 6000 observed values; ``inference_`` says what it chose.
    n_inducing : int
        Of sparse inference: inducing inputs of each latent process.
    optimizer : "fmin_l_bfgs_b", callable or None
        As in scikit-learn's ``GaussianProcessRegressor``; None keeps the starting values.
    n_restarts_optimizer : int
        Further starting points; the best end is kept. They run side by side with ``n_jobs``.
    max_iter : int
        Iterations of the optimiser on the full data.
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
    log_marginal_likelihood_value_ : float
        Of the normalised outputs; its lower bound where inference is sparse.
    inference_ : {"exact", "sparse"}
        What was done.
    posterior_ : ExactPosterior or SparsePosterior
        The state of knowledge about the normalised outputs.
    n_iter_, n_evaluations_ : int
        Iterations on the full data, at most ``max_iter``; evaluations of the likelihood in all.
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
        "n_latent": [Interval(Integral, 0, None, closed="left")],
        "private_latents": ["boolean"],
        "covariance_type": [StrOptions({"spherical", "diag", "full", "tied"})],
        "trend": [StrOptions({"linear", "constant"}), None],
        "inference": [StrOptions({"auto", "exact", "sparse"})],
        "n_inducing": [Interval(Integral, 1, None, closed="left")],
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
        trend="linear",
        inference="auto",
        n_inducing=100,
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
        self.trend = trend
        self.inference = inference
        self.n_inducing = n_inducing
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
            When X is not finite, an output was never observed, there are fewer than two samples, or the exact
            posterior would not fit the machine's memory.

        Warns
        -----
        UserWarning
            When an output is constant, or samples are repeated with the same targets.
        ConvergenceWarning
            When the search for hyperparameters was interrupted (the best ones so far are kept), or stopped at
            ``max_iter`` far from an optimum.
        """
        check_n_jobs(self.n_jobs)
        index = getattr(X, "index", None)
        X = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        warn_of_indices(index, y)
        Y, self.output_names_, self._single = check_targets(y, len(X), type(self).__name__)
        used = np.isfinite(Y).any(axis=1)
        X, Y = X[used], Y[used]
        check_enough(Y, self.output_names_)
        warn_of_samples(X, Y, self.output_names_)
        n_values = int(np.isfinite(Y).sum())
        self.inference_ = (
            self.inference if self.inference != "auto" else "exact" if n_values <= EXACT_LIMIT else "sparse"
        )
        if self.inference_ == "exact":
            check_memory(n_values, "Exact inference on", FEWER_VALUES)
        self._center = np.nanmean(Y, axis=0) if self.trend else np.zeros(Y.shape[1])
        scale = np.sqrt(np.nanmean((Y - self._center) ** 2, axis=0)) if self.normalize_y else np.ones(Y.shape[1])
        self._scale = np.where(scale > 1e-12 * np.nanmax(np.abs(Y), axis=0), scale, 1.0)
        best = self._search(X, (Y - self._center) / self._scale)
        if best.interrupted:
            warnings.warn(
                f"The fit was interrupted after {best.n_evaluations} evaluations of the likelihood; the best "
                "hyperparameters so far are kept. Fit again for more.",
                ConvergenceWarning,
                stacklevel=3,
            )
        elif best.rising:
            warnings.warn(
                f"The fit stopped at max_iter={self.max_iter} while the log likelihood was still rising fast: the "
                "hyperparameters are not good yet. Raise max_iter, or scale the regressors (StandardScaler).",
                ConvergenceWarning,
                stacklevel=3,
            )
        self.posterior_ = best.posterior
        self.kernel_ = best.posterior.kernel
        self.noise_variance_ = best.posterior.noise * self._scale**2
        self.log_marginal_likelihood_value_ = best.posterior.log_marginal_likelihood
        self.n_iter_, self.n_evaluations_ = best.n_iter, best.n_evaluations
        return self

    def _search(self, X, Z):
        """Return the best fit over the starting points."""
        kernel = self.kernel
        if kernel is None:
            kernel = ConvolvedGaussian(
                self.n_latent, private_latents=self.private_latents, covariance_type=self.covariance_type
            )
        kernel = clone(kernel)
        if self.trend == "linear":
            kernel = LinearTrend() + kernel
        search = fit_exact if self.inference_ == "exact" else partial(fit_sparse, n_inducing=self.n_inducing)
        search = partial(search, kernel, X, Z, optimizer=self.optimizer, max_iter=self.max_iter)
        seeds = check_random_state(self.random_state).randint(2**31 - 1, size=1 + self.n_restarts_optimizer)
        starts = [{"random_state": int(seed), "spread": float(k > 0)} for k, seed in enumerate(seeds)]
        fits = fit_map(search, starts, self.n_jobs)
        best = max(fits, key=lambda fit: fit.posterior.log_marginal_likelihood)
        return best._replace(interrupted=any(fit.interrupted for fit in fits))

    # -- prediction ------------------------------------------------------------------------------------

    def predict(self, X, return_std=False, return_cov=False, include_noise=False):
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
            return self._shaped(mean * self._scale + self._center), self._shaped(np.sqrt(variance) * self._scale)
        mean = self._shaped(mean * self._scale + self._center)
        if not return_cov:
            return mean
        check_memory(mean.size, "The joint covariance of", FEWER_SAMPLES)
        cov = self.posterior_.covariance(X)
        if include_noise:
            cov[np.diag_indices_from(cov)] += np.repeat(self.noise_variance_ / self._scale**2, len(X))
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
        values, vectors = np.linalg.eigh(cov)  # a posterior covariance may be singular
        white = check_random_state(random_state).standard_normal((len(values), n_samples))
        draws = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * white)
        draws = draws.reshape(mean.shape[1], len(X), n_samples).swapaxes(0, 1)
        return self._shaped((mean[..., None] + draws) * self._scale[:, None] + self._center[:, None])

    def log_marginal_likelihood(self, theta=None, eval_gradient=False):
        """Return the log marginal likelihood of the normalised outputs (equation 20).

        Parameters
        ----------
        theta : ndarray or None
            ``kernel_.theta`` followed by the logarithm of the noise variances of the normalised outputs. None:
            at the fitted values.
        eval_gradient : bool
            Also return the gradient with respect to theta.
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
            raise ValueError("The kernel has no stationary part: a linear trend alone couples no outputs.")
        found = output_correlation(kernel)
        found["output_names"] = list(self.output_names_)
        return found

    def score(self, X, y, sample_weight=None):
        """Return R^2, averaged over the outputs, of the targets that were observed.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        y : array, Series or DataFrame (n,) or (n, P)
            NaN where an output was not observed; an output without a target is left out.
        sample_weight : array (n,) or None
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

    def _check_regressors(self, X):
        check_is_fitted(self)
        return validate_data(self, X, dtype=np.float64, reset=False)

    def _shaped(self, values):
        """Return (n, P, ...) as it is, or (n, ...) where the targets were (n,)."""
        return values[:, 0] if self._single else values
