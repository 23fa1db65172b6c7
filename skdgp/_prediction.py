"""What a fitted regressor answers: the posterior, in the units of the targets."""

from __future__ import annotations

from numbers import Integral

import numpy as np
from sklearn.metrics import r2_score
from sklearn.utils import check_array, check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from skdgp._targets import X_RANGE, check_magnitudes, check_memory

FEWER_SAMPLES = "Ask for fewer samples at a time, or for return_std=True, which needs no joint covariance."


class PredictionMixin:
    """Predictions from ``posterior_``, which knows normalised outputs: y = ``_center`` + ``_scale`` z."""

    def predict(self, X, return_std=False, return_cov=False, include_noise=False, include_input_noise=False):
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
            Whether X is as noisy as the regressors of the fit (``input_noise``), rather than exact: by the slopes J of
            the mean, J S J^T is added. A number: so many times the variance of the fit, as in rougher air.

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
            variance = variance + np.sum(self._reach(X, include_input_noise) ** 2, axis=2)
            return self._shaped(mean * self._scale + self._center), self._shaped(np.sqrt(variance) * self._scale)
        mean = self._shaped(mean * self._scale + self._center)
        if not return_cov:
            return mean
        check_memory(mean.size, "The joint covariance of", FEWER_SAMPLES)
        cov = self.posterior_.covariance(X)
        if include_noise:
            cov[np.diag_indices_from(cov)] += np.repeat(self.noise_variance_ / self._scale**2, len(X))
        reach = self._reach(X, include_input_noise)
        blocks = cov.reshape(len(self._scale), len(X), len(self._scale), len(X))
        np.einsum("iaja->aij", blocks)[:] += reach @ reach.swapaxes(1, 2)
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

    def _reach(self, X, times):
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
