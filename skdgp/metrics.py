"""How far predictions are off, and whether their uncertainty tells the truth.

Targets (n,) or (n, P); a NaN target was not observed and is left out, output by output. ``multioutput`` is
scikit-learn's: ``"raw_values"`` one number per output, ``"uniform_average"`` their mean, or an array of
weights. The scorers serve ``scoring=`` of ``cross_validate`` and ``GridSearchCV``.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable

import numpy as np
from scipy.stats import norm
from sklearn.base import BaseEstimator
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.pipeline import Pipeline

__all__ = [
    "SCORERS",
    "interval_coverage",
    "make_predictive_scorer",
    "median_relative_error",
    "negative_log_predictive_density",
    "normalized_rmse",
    "score_outputs",
]


def median_relative_error(y_true, y_pred, *, multioutput="uniform_average"):
    """Return the median of ``|y_true - y_pred| / |y_true|``, a fraction (0.09 is 9 %).

    The figure of Hemakumara & Sukkarieh (ICRA 2011). It hides the tails: report :func:`normalized_rmse`
    beside it.

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed. A zero target makes an infinite error, or none if met exactly.
    y_pred : array-like of the same shape
        Predictions.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (P,), default="uniform_average"
        How outputs are put together.

    Returns
    -------
    float or ndarray of shape (P,)
        NaN, with a warning, for an output that is never observed.

    Raises
    ------
    ValueError
        If the shapes differ or a prediction is not finite.

    Examples
    --------
    >>> median_relative_error([1.0, 2.0, 4.0], [1.25, 2.0, 2.0])
    0.25
    """
    y_true, y_pred = _check_targets(y_true, y_pred)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(y_true - y_pred) / np.abs(y_true)
    relative[y_true == y_pred] = 0.0
    return _aggregate(_reduce(np.median, relative, y_true), multioutput)


def normalized_rmse(y_true, y_pred, *, multioutput="uniform_average"):
    """Return the root mean squared error over the standard deviation of the targets.

    1 is no better than predicting their mean.

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    y_pred : array-like of the same shape
        Predictions.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (P,), default="uniform_average"
        How outputs are put together.

    Returns
    -------
    float or ndarray of shape (P,)
        NaN, with a warning, for an output that is constant or never observed.

    Raises
    ------
    ValueError
        If the shapes differ or a prediction is not finite.

    Examples
    --------
    >>> normalized_rmse([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])
    0.5
    """
    y_true, y_pred = _check_targets(y_true, y_pred)
    error = np.sqrt(_reduce(np.mean, (y_true - y_pred) ** 2, y_true))
    mean = np.nansum(y_true, axis=0) / np.maximum((~np.isnan(y_true)).sum(axis=0), 1)
    spread = np.sqrt(_reduce(np.mean, (y_true - mean) ** 2, y_true))
    if (spread == 0).any():
        _undefined(spread == 0, "is constant", "its RMSE cannot be normalised")
        spread[spread == 0] = np.nan
    return _aggregate(error / spread, multioutput)


def negative_log_predictive_density(y_true, y_pred, y_std, *, multioutput="uniform_average"):
    """Return the mean of ``log(2 pi s^2) / 2 + (y - m)^2 / 2 s^2`` (Rasmussen & Williams 2006, eq 2.34).

    Small when predictions are close and say so. For measured targets ``y_std`` must include measurement noise
    (``include_noise=True``).

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    y_pred, y_std : array-like of the same shape
        Predicted mean and standard deviation.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (P,), default="uniform_average"
        How outputs are put together.

    Returns
    -------
    float or ndarray of shape (P,)
        In nats per observation; NaN, with a warning, for an output that is never observed.

    Raises
    ------
    ValueError
        If the shapes differ, a prediction is not finite, or a standard deviation is not positive.

    Examples
    --------
    >>> round(negative_log_predictive_density([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]), 4)
    1.1689
    """
    y_true, y_pred, y_std = _check_targets(y_true, y_pred, y_std)
    density = 0.5 * np.log(2 * np.pi * y_std**2) + 0.5 * ((y_true - y_pred) / y_std) ** 2
    return _aggregate(_reduce(np.mean, density, y_true), multioutput)


def interval_coverage(y_true, y_pred, y_std, *, level=0.95, multioutput="uniform_average"):
    """Return the fraction of targets inside the central ``level`` interval of a normal prediction.

    Near ``level`` when the standard deviations are honest; smaller when they are too confident.

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    y_pred, y_std : array-like of the same shape
        Predicted mean and standard deviation.
    level : float, default=0.95
        Probability that the interval should hold.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (P,), default="uniform_average"
        How outputs are put together.

    Returns
    -------
    float or ndarray of shape (P,)
        NaN, with a warning, for an output that is never observed.

    Raises
    ------
    ValueError
        If the shapes differ, a prediction is not finite, a standard deviation is not positive, or ``level``
        is not inside (0, 1).

    Examples
    --------
    >>> interval_coverage([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4)
    0.5
    """
    if not 0 < level < 1:
        raise ValueError(f"Got level={level!r}, but expected a probability inside (0, 1), such as 0.95.")
    y_true, y_pred, y_std = _check_targets(y_true, y_pred, y_std)
    inside = np.abs(y_true - y_pred) <= norm.ppf(0.5 + level / 2) * y_std
    return _aggregate(_reduce(np.mean, inside, y_true), multioutput)


def make_predictive_scorer(metric: Callable, *, greater_is_better: bool, needs_std: bool = False, **kwargs):
    """Make a scorer ``(estimator, X, y) -> float`` from a metric that may need predictive deviations.

    Parameters
    ----------
    metric : callable
        ``metric(y_true, y_pred, **kwargs)`` or, with ``needs_std``, ``metric(y_true, y_pred, y_std,
        **kwargs)``.
    greater_is_better : bool
        False flips the sign, as scikit-learn maximises scores.
    needs_std : bool, default=False
        Ask the estimator, through pipelines and fitted searches, for ``predict(X, return_std=True)``; with
        ``include_noise=True`` where it takes that, since the targets are measurements.
    **kwargs
        Passed to the metric.

    Returns
    -------
    callable
        Picklable; use it as ``scoring=``.

    Examples
    --------
    >>> from sklearn.gaussian_process import GaussianProcessRegressor
    >>> from sklearn.model_selection import cross_val_score
    >>> import numpy as np
    >>> X, y = np.linspace(0, 3, 30)[:, None], np.sin(np.linspace(0, 3, 30))
    >>> half = make_predictive_scorer(interval_coverage, greater_is_better=True, needs_std=True, level=0.5)
    >>> scores = cross_val_score(GaussianProcessRegressor(alpha=1e-6), X, y, scoring=half, cv=3)
    >>> scores.shape
    (3,)
    """
    return _PredictiveScorer(metric, 1 if greater_is_better else -1, needs_std, kwargs)


class _PredictiveScorer:
    """A metric with a sign and what it asks of ``predict``."""

    def __init__(self, metric, sign, needs_std, kwargs):
        self.metric, self.sign, self.needs_std, self.kwargs = metric, sign, needs_std, kwargs

    def __call__(self, estimator, X, y):
        predicted = _predict_with_std(estimator, X) if self.needs_std else (estimator.predict(X),)
        return self.sign * self.metric(y, *predicted, **self.kwargs)

    def __repr__(self):
        return f"make_predictive_scorer({self.metric.__name__}, greater_is_better={self.sign > 0})"


SCORERS = {
    "neg_median_relative_error": make_predictive_scorer(median_relative_error, greater_is_better=False),
    "neg_normalized_rmse": make_predictive_scorer(normalized_rmse, greater_is_better=False),
    "log_predictive_density": make_predictive_scorer(
        negative_log_predictive_density, greater_is_better=False, needs_std=True
    ),
    "interval_coverage": make_predictive_scorer(interval_coverage, greater_is_better=True, needs_std=True),
}
"""Scorers by name, for ``scoring=SCORERS``; greater is better, but coverage is to be read, not maximised."""


def score_outputs(estimator, X, y) -> dict[str, float]:
    """Score every output apart, ``{"normalized_rmse_CX": ..., ...}``: a ``scoring=`` of ``cross_validate``.

    All four metrics where the estimator predicts standard deviations, else the two that need none; signs are
    those of the metrics (errors are positive). Outputs are named by the columns of ``y``, or numbered.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> X, Y = np.arange(6.0)[:, None], np.arange(12.0).reshape(6, 2)
    >>> sorted(score_outputs(LinearRegression().fit(X, Y), X, Y))
    ['median_relative_error_0', 'median_relative_error_1', 'normalized_rmse_0', 'normalized_rmse_1']
    """
    takes_std = _accepts(estimator, "return_std")
    mean, *std = _predict_with_std(estimator, X) if takes_std else (estimator.predict(X),)
    scores = {}
    for metric in (median_relative_error, normalized_rmse):
        scores |= _named(metric, y, metric(y, mean, multioutput="raw_values"))
    for metric in (negative_log_predictive_density, interval_coverage) if takes_std else ():
        scores |= _named(metric, y, metric(y, mean, *std, multioutput="raw_values"))
    return scores


def _named(metric, y, values):
    names = list(getattr(y, "columns", range(len(values))))
    return {f"{metric.__name__}_{name}": float(value) for name, value in zip(names, values, strict=True)}


def _predict_with_std(estimator, X):
    """Return mean and std, with measurement noise where the estimator can add it."""
    if not _accepts(estimator, "return_std"):
        raise TypeError(
            f"Got {type(estimator).__name__}, whose predict takes no return_std, but this metric needs "
            "predictive "
            "standard deviations: use DependentGPRegressor (also inside a Pipeline), or a metric of means."
        )
    noise = {"include_noise": True} if _accepts(estimator, "include_noise") else {}
    fitted = _unwrap(estimator)
    return fitted.predict(X, return_std=True, **noise)


def _unwrap(estimator) -> BaseEstimator:
    """Return the fitted estimator behind a search, whose own predict takes no keywords."""
    while (best := getattr(estimator, "best_estimator_", None)) is not None:
        estimator = best
    return estimator


def _accepts(estimator, keyword) -> bool:
    """Whether the last step's predict takes the keyword."""
    estimator = _unwrap(estimator)
    while isinstance(estimator, Pipeline):
        estimator = _unwrap(estimator.steps[-1][1])
    parameters = inspect.signature(estimator.predict).parameters.values()
    return any(p.name == keyword or p.kind is p.VAR_KEYWORD for p in parameters)


def _check_targets(y_true, *predicted):
    """Return everything as (n, P) floats; predictions finite, standard deviations positive."""
    y_true = np.asarray(y_true, dtype=float)
    predicted = [np.asarray(values, dtype=float) for values in predicted]
    for name, values in zip(("y_pred", "y_std"), predicted, strict=False):
        if values.size != y_true.size or len(values) != len(y_true):
            raise ValueError(f"Got {name} of shape {values.shape}, but expected {y_true.shape}, y_true's.")
        if not np.isfinite(values).all():
            raise ValueError(
                f"Got {int((~np.isfinite(values)).sum())} values of {name} that are not finite, but a "
                "prediction must "
                "be: look for NaN among the regressors."
            )
    if y_true.ndim not in (1, 2) or not y_true.size:
        raise ValueError(f"Got y_true of shape {y_true.shape}, but expected (n,) or (n, P), not empty.")
    if np.isinf(y_true).any():
        raise ValueError("Got infinite values in y_true, but expected finite ones or NaN (not observed).")
    if len(predicted) == 2 and (predicted[1] <= 0).any():
        raise ValueError(f"Got y_std down to {predicted[1].min():g}, but expected positive values.")
    return [values.reshape(len(y_true), -1) for values in (y_true, *predicted)]


def _reduce(statistic, values, y_true):
    """Apply a statistic to the observed values of each output; NaN, with a warning, where there are none."""
    seen = ~np.isnan(y_true)
    if not seen.any(axis=0).all():
        _undefined(~seen.any(axis=0), "is never observed", "it cannot be scored")
    columns = [column[mask] for column, mask in zip(values.T, seen.T, strict=True)]
    return np.array([statistic(column) if column.size else np.nan for column in columns])


def _aggregate(values, multioutput):
    values = np.asarray(values, dtype=float)
    if isinstance(multioutput, str) and multioutput == "raw_values":
        return values
    if isinstance(multioutput, str):
        if multioutput != "uniform_average":
            raise ValueError(
                f"Got multioutput={multioutput!r}, but expected 'raw_values', 'uniform_average' or weights."
            )
        multioutput = np.ones(len(values))
    known = ~np.isnan(values)
    return float(np.average(values[known], weights=np.asarray(multioutput)[known])) if known.any() else np.nan


def _undefined(which, state, consequence):
    warnings.warn(
        f"Output {np.flatnonzero(which).tolist()} {state} in y_true, so {consequence}: NaN, and left out of the mean.",
        UndefinedMetricWarning,
        stacklevel=4,
    )
