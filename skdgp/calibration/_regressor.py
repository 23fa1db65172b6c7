"""CalibratedRegressor: standard deviations that hold on flights it did not learn from."""

from __future__ import annotations

import warnings
from numbers import Integral, Real

import numpy as np
from scipy.stats import norm
from sklearn.base import BaseEstimator, MetaEstimatorMixin, RegressorMixin, _fit_context, clone
from sklearn.utils import check_array, get_tags
from sklearn.utils._param_validation import HasMethods, Interval, StrOptions
from sklearn.utils.metaestimators import available_if
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.tables import column_names
from skdgp._regressor import check_targets
from skdgp.calibration._conformal import ROUNDING, unit_weights, units_needed, units_of, weighted_quantile
from skdgp.calibration._held_out import conformity_scores, fit_and_score, flights_of, splits_of
from skdgp.calibration._paths import ScaledPaths
from skdgp.metrics._scorers import predict_with_noise, unwrap


def _knows(name: str):
    """Return what says whether the estimator has a method, before the fit as after it."""
    return lambda self: hasattr(unwrap(getattr(self, "estimator_", self.estimator)), name)


class CalibratedRegressor(MetaEstimatorMixin, RegressorMixin, BaseEstimator):
    r"""Scale a regressor's standard deviations, output by output, to what flights held out show.

    Each held-out sample has a score :math:`|y - m| / s`, with m and s the mean and the standard deviation, measurement
    noise included, of a model that did not learn from its flight. The band at some level is
    :math:`m \pm q s`. Samples of one flight resemble each other, so flights are counted, not samples: with K flights,
    :math:`n_k` scores in the k-th, q is the least number with

    .. math:: \sum_k \frac{1}{(K + 1) \, n_k} \, \#\{i : score_{ki} \le q\} \ge level

    (hierarchical conformal prediction: Lee, Barber & Willett 2023; Dunn, Wasserman & Ramdas 2023). If the next flight
    and the K others could have been flown in any order, its samples lie in their band, on average over such flights,
    with a share of at least ``level``: whatever the model, whatever the distribution of the errors, however the samples
    of a flight depend on each other. The share of one flight may be smaller.

    The flight to come takes one part of K + 1, so **K flights guarantee no level above K / (K + 1)**: two 0.67, four
    0.8, nineteen 0.95. For a level above that, a warning says so, and q is the quantile of the scores seen, each flight
    weighing the same: right as K grows (Dunn et al., section 3), without a guarantee for few.

    With ``cv="prefit"``, flights that the model has never seen, the guarantee is exact. In cross-validation each score
    comes from a model that lacked that flight, the predictions from one that learned from all: as a rule, and not by
    a theorem, bands are then rather too wide.

    Parameters
    ----------
    estimator : regressor or Pipeline
        Whose ``predict`` takes ``return_std``.
    method : {"conformal", "variance"}, default="conformal"
        "variance" scales so that scores squared are one on average, each flight weighing the same, and trusts in the
        normal distribution for the rest: steadier where flights are few; no guarantee.
    level : float, default=0.95
        Probability at which the normal band of ``predict``'s standard deviation is the conformal one.
    cv : None, int, splitter, iterable or "prefit", default=None
        What is held out. None or int: whole flights, in 5 or so many shares (``GroupKFold``). One flight alone is cut
        into so many blocks, 2 s apart (``BlockSplit``), with a warning: then the guarantee is for further blocks of
        that flight, not for other flights. "prefit": the estimator is fitted, and ``fit`` gets flights it has not seen.
    n_jobs : int or None, default=None
        Fits of the cross-validation side by side, as in joblib.

    Attributes
    ----------
    estimator_ : estimator
        Fitted on all flights; with ``cv="prefit"`` the given one.
    std_scale_ : ndarray (P,)
        What standard deviations are multiplied with: above 1, they were too small.
    guaranteed_ : ndarray (P,) of bool
        Whether ``level`` is guaranteed.
    max_level_ : ndarray (P,)
        K / (K + 1): the level up to which there is a guarantee.
    unit_ : {"flight", "block"}
        What the guarantee is for. Blocks, if a splitter cuts flights.
    n_units_ : ndarray (P,) of int
        K: flights, or blocks, in which the output was observed.
    calibration_scores_ : ndarray (m, P)
        Scores of the samples held out; NaN where an output was not observed.
    calibration_units_ : ndarray (m,) of int
        The flight, or block, of each.
    output_names_ : list of str
        Column names of Y, or y0, y1, ...
    n_features_in_ : int
    feature_names_in_ : ndarray of str
        Where the estimator has them.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import BayesianRidge
    >>> from skdgp.calibration import CalibratedRegressor
    >>> rng = np.random.default_rng(0)
    >>> flight = np.repeat(np.arange(20), 50)
    >>> X = rng.normal(size=(1000, 1))
    >>> y = X[:, 0] + 0.1 * rng.normal(size=1000) + 0.3 * rng.normal(size=20)[flight]  # each flight is off by a bit
    >>> model = CalibratedRegressor(BayesianRidge(), level=0.9).fit(X, y, groups=flight)
    >>> mean, std = model.predict(X, return_std=True)
    >>> lower, upper = model.predict_interval(X)
    >>> bool(np.mean((lower <= y) & (y <= upper)) >= 0.9), bool(model.guaranteed_[0]), model.unit_
    (True, True, 'flight')
    """

    acts_on_outputs = True  # see skdgp.dynamics.as_aerodynamics
    _parameter_constraints: dict = {
        "estimator": [HasMethods(["fit", "predict"])],
        "method": [StrOptions({"conformal", "variance"})],
        "level": [Interval(Real, 0, 1, closed="neither")],
        "cv": ["cv_object", StrOptions({"prefit"})],
        "n_jobs": [Integral, None],
    }

    def __init__(self, estimator, *, method="conformal", level=0.95, cv=None, n_jobs=None):
        self.estimator = estimator
        self.method = method
        self.level = level
        self.cv = cv
        self.n_jobs = n_jobs

    def __sklearn_tags__(self):
        tags, own = super().__sklearn_tags__(), get_tags(self.estimator)
        tags.input_tags, tags.target_tags, tags.regressor_tags = own.input_tags, own.target_tags, own.regressor_tags
        return tags

    @_fit_context(prefer_skip_nested_validation=False)
    def fit(self, X, y, groups=None):
        """Hold flights out, score them, and fit on all of them.

        Parameters
        ----------
        X : array or DataFrame (n, d)
            Regressors, or the flights of an identification pipeline. Flights are told apart by its column ``flight``,
            blocks by its column ``time`` [s]; without it rows are taken to be in order, and no gap is left.
        y : array, Series or DataFrame (n,) or (n, P)
            Targets; NaN where an output was not observed.
        groups : array-like (n,), optional
            What is exchangeable, in place of the column ``flight``: the day, if flights of one day resemble each other.

        Returns
        -------
        CalibratedRegressor
            The fitted estimator itself.

        Raises
        ------
        TypeError
            When the estimator predicts no standard deviation.
        ValueError
            When there are too few rows, or an output is observed in nothing that is held out.

        Warns
        -----
        UserWarning
            When there is one flight alone, or there are too few to guarantee ``level``.
        """
        X = _checked(X)
        Y, self.output_names_, single = check_targets(y, len(X), type(self).__name__)
        y = y if column_names(y) else Y[:, 0] if single else Y
        self._single = single
        flights = flights_of(X, groups)
        splits = splits_of(flights, self.cv)
        if isinstance(self.cv, str):
            check_is_fitted(self.estimator)
            self.estimator_ = self.estimator
            everywhere = conformity_scores(self.estimator, X, Y)
            scores = [everywhere[test] for _, test in splits]
        else:
            fits = (delayed(fit_and_score)(self.estimator, X, y, Y, *rows) for rows in splits)
            scores = Parallel(n_jobs=self.n_jobs)(fits)
            self.estimator_ = clone(self.estimator).fit(X, y)
        self.unit_, units = units_of([test for _, test in splits], flights["flight"].to_numpy())
        self._calibrate(np.concatenate(scores), units)
        return self

    def _calibrate(self, scores, units):
        """Keep the scores, say what they guarantee, scale."""
        observed = ~np.isnan(scores).all(axis=1)
        self.calibration_scores_ = scores[observed]
        self.calibration_units_ = units = np.unique(units[observed], return_inverse=True)[1]
        self.n_units_ = np.array([len(np.unique(units[~np.isnan(column)])) for column in self.calibration_scores_.T])
        never = [name for name, n in zip(self.output_names_, self.n_units_, strict=True) if not n]
        if never:
            raise ValueError(
                f"Got no value of the outputs {never} in what is held out, but expected some to calibrate on: leave "
                "these outputs out, or observe them in more flights."
            )
        self.max_level_ = self.n_units_ / (self.n_units_ + 1)
        self.guaranteed_ = (self.max_level_ >= self.level - ROUNDING) & (self.method == "conformal")
        self.std_scale_ = self._half_widths(self.level) / norm.ppf(0.5 + self.level / 2)
        if self.method == "conformal" and not self.guaranteed_.all():
            self._warn_of_few()

    def _half_widths(self, level) -> np.ndarray:
        """Return by output how many standard deviations the band reaches to each side, (P,)."""
        totals = np.where(self.guaranteed_, self.max_level_, 1.0)  # the rest of 1 is the flight to come
        return np.array([self._half_width(k, total, level) for k, total in enumerate(totals)])

    def _half_width(self, k, total, level) -> float:
        seen = ~np.isnan(self.calibration_scores_[:, k])
        scores, weights = self.calibration_scores_[seen, k], unit_weights(self.calibration_units_[seen])
        if self.method == "variance":
            return norm.ppf(0.5 + level / 2) * np.sqrt(weights @ scores**2)
        return weighted_quantile(scores, total * weights, level)

    def predict(self, X, return_std=False, include_noise=True, return_cov=False):
        """Predict with the fitted estimator, standard deviations scaled.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        return_std : bool
            Also return the standard deviation, such that mean -/+ z std, z of the normal distribution, is the
            calibrated band of probability ``level``.
        include_noise : bool
            Whether that is of a new measurement, which is what was calibrated. Without, the deviation of the function
            is scaled alike, where the estimator tells the two apart.
        return_cov : bool
            Also return the joint covariance of the function, scaled alike, without noise, where the estimator has one.

        Returns
        -------
        mean : ndarray (n, P), or (n,) where y was
        std : ndarray
            On request.
        cov : ndarray (P n, P n)
            On request.

        Raises
        ------
        ValueError
            If both a deviation and a covariance are asked for.
        """
        check_is_fitted(self)
        if return_cov:
            if return_std:
                raise ValueError("Got return_std and return_cov, but expected one of them.")
            mean, covariance = unwrap(self.estimator_).predict(_checked(X), return_cov=True)
            scale = np.repeat(self.std_scale_, len(mean))
            return mean, covariance * scale[:, None] * scale
        if not return_std:
            return self.estimator_.predict(_checked(X))
        if include_noise:
            mean, std = predict_with_noise(self.estimator_, _checked(X))
        else:
            mean, std = unwrap(self.estimator_).predict(_checked(X), return_std=True)
        return mean, std * (self.std_scale_ if std.ndim > 1 else self.std_scale_[0])

    @available_if(_knows("predict_gradient"))
    def predict_gradient(self, X, return_std=False):
        """Return the slopes of the mean, (n, P, d) or (n, d), and on request their deviations, scaled.

        Parameters
        ----------
        X : array (n, d)
        return_std : bool

        Returns
        -------
        gradient, std : ndarray
        """
        check_is_fitted(self)
        found = unwrap(self.estimator_).predict_gradient(X, return_std=return_std)
        return (found[0], found[1] * np.asarray(self._scale)[..., None]) if return_std else found

    @available_if(_knows("sample_paths"))
    def sample_paths(self, n_paths=1, random_state=0):
        """Draw functions from the posterior, their distance from the mean scaled: what `predict` says, to be flown.

        A path f of a posterior with mean m becomes m + s (f - m), s the output's ``std_scale_``. Mean and covariance
        over paths are those of ``predict(..., include_noise=False)``.

        Parameters
        ----------
        n_paths : int
        random_state : int, RandomState or None

        Returns
        -------
        sequence of callables
            As of :meth:`skdgp.DependentGPRegressor.sample_paths`.
        """
        check_is_fitted(self)
        regressor = unwrap(self.estimator_)
        return ScaledPaths(regressor.sample_paths(n_paths, random_state), regressor, self._scale)

    @property
    def _scale(self):
        """What deviations are multiplied with: (P,), or a number where y was (n,)."""
        return self.std_scale_[0] if self._single else self.std_scale_

    def predict_interval(self, X, level=None):
        """Predict bands that hold new measurements.

        Parameters
        ----------
        X : array or DataFrame (n, d)
        level : float, optional
            By default the estimator's own.

        Returns
        -------
        lower, upper : ndarray (n, P), or (n,) where y was
            Infinite, with a warning, at a level that is not guaranteed of outputs whose ``level`` is.

        Raises
        ------
        ValueError
            If ``level`` is not inside (0, 1).
        """
        check_is_fitted(self)
        level = self.level if level is None else level
        if not isinstance(level, Real) or not 0 < level < 1:
            raise ValueError(f"Got level={level!r}, but expected a probability inside (0, 1), such as 0.95.")
        widths = self._half_widths(level)
        if np.isinf(widths).any():
            warnings.warn(
                f"Got level={level:g}, but {self.n_units_.min()} {self.unit_}s guarantee no more than "
                f"{self.max_level_.min():.3g}, so bands are infinite: calibrate on {units_needed(level)} of them, "
                "or lower the level.",
                UserWarning,
                stacklevel=2,
            )
        mean, std = predict_with_noise(self.estimator_, _checked(X))
        reach = std * (widths if std.ndim > 1 else widths[0])
        return mean - reach, mean + reach

    def score(self, X, y, sample_weight=None):
        """Return the score of the fitted estimator: its means are unchanged."""
        check_is_fitted(self)
        weight = {} if sample_weight is None else {"sample_weight": sample_weight}
        return self.estimator_.score(_checked(X), y, **weight)

    @property
    def n_features_in_(self):
        """Number of features, of the fitted estimator."""
        return self.estimator_.n_features_in_

    @property
    def feature_names_in_(self):
        """Names of the features, of the fitted estimator."""
        return self.estimator_.feature_names_in_

    def _warn_of_few(self):
        few = ~self.guaranteed_
        names = [name for name, lacks in zip(self.output_names_, few, strict=True) if lacks]
        n, top = self.n_units_[few].min(), self.max_level_[few].min()
        warnings.warn(
            f"Got level={self.level:g}, but {n} {self.unit_}s guarantee no more than {top:.3g}: the bands of {names} "
            f"are what held as often on these {self.unit_}s, without a guarantee for the next. Calibrate on "
            f"{units_needed(self.level)} {self.unit_}s at least, or ask for level={np.floor(100 * top) / 100:g}.",
            UserWarning,
            stacklevel=5,
        )


def _checked(X):
    """Return a table as it is, anything else as numbers."""
    return X if hasattr(X, "columns") else check_array(X, ensure_all_finite=False)
