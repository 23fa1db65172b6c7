"""Metrics of predictions and of their standard deviations.

Targets are (n,) or (n, P). A NaN target was not observed and is left out, output by output.
``multioutput`` is scikit-learn's: ``"raw_values"`` for one number per output, ``"uniform_average"``
for their mean. The metric of an output that is never observed is NaN, with
a warning. The metrics raise ValueError if shapes differ, a prediction is not finite, a standard
deviation is not positive, or a level is not inside (0, 1). The
scorers serve ``scoring=`` of ``cross_validate`` and ``GridSearchCV``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from sklearn import config_context
from sklearn.exceptions import UndefinedMetricWarning

from skdgp._compute.messages import warn
from skdgp._compute.sklearn_compat import accepts, safe_indexing, unwrap
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import ArrayLike, Mask, Matrix, Vector

__all__ = [
    "SCORERS", "interval_coverage", "median_relative_error", "negative_log_predictive_density",
    "normalized_rmse",
]  # fmt: skip

Score: TypeAlias = "float | Vector"


def median_relative_error(
    y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: str = "uniform_average"
) -> Score:
    """Return the median of ``|y_true - y_pred| / |y_true|``, a fraction (0.09 is 9 %), of (n,) or (n, P) targets.

    Hemakumara & Sukkarieh (ICRA 2011) report this figure. It ignores large errors: report
    :func:`normalized_rmse` beside it. A zero target has an infinite error, or none if met exactly.

    Examples
    --------
    >>> median_relative_error([1.0, 2.0, 4.0], [1.25, 2.0, 2.0])
    0.25
    """
    target, mean = check_scored(y_true, y_pred)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(target - mean) / np.abs(target)
    relative[target == mean] = 0.0
    return _aggregate(_by_output(np.nanmedian, relative), multioutput)


def normalized_rmse(
    y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: str = "uniform_average"
) -> Score:
    """Return the root mean squared error over the standard deviation of the targets, (n,) or (n, P).

    1 is no better than predicting their mean; NaN, with a warning, for a constant output.

    Examples
    --------
    >>> normalized_rmse([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])
    0.5
    """
    target, predicted = check_scored(y_true, y_pred)
    error = np.sqrt(_by_output(np.nanmean, (target - predicted) ** 2))
    spread = _by_output(np.nanstd, target)
    is_constant = spread == 0
    if is_constant.any():
        _warn_undefined(is_constant, "is constant", "its RMSE cannot be normalised")
        spread[is_constant] = np.nan
    return _aggregate(error / spread, multioutput)


def negative_log_predictive_density(
    y_true: ArrayLike,
    y_pred: ArrayLike,
    y_std: ArrayLike,
    *,
    multioutput: str = "uniform_average",
) -> Score:
    """Return the mean of ``log(2 pi s^2) / 2 + (y - m)^2 / 2 s^2`` (Rasmussen & Williams 2006, eq 2.34).

    For measured targets ``y_std`` must include measurement noise (``include_noise=True``).

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
    multioutput : str, default="uniform_average"

    Returns
    -------
    float or ndarray (P,)
        In nats per observation.

    Examples
    --------
    >>> round(negative_log_predictive_density([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]), 4)
    1.1689
    """
    target, mean, std = check_scored(y_true, y_pred, y_std)
    residual = (target - mean) / std
    density = 0.5 * np.log(2 * np.pi * std**2) + 0.5 * residual**2
    return _aggregate(_by_output(np.nanmean, density), multioutput)


def interval_coverage(
    y_true: ArrayLike, y_pred: ArrayLike, y_std: ArrayLike, *, level: float = 0.95,
    multioutput: str = "uniform_average",
) -> Score:  # fmt: skip
    """Return the fraction of targets inside the central ``level`` interval of a normal prediction.

    It is smaller than ``level`` where the standard deviations are too small.

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
    level : float, default=0.95
        Nominal probability of the interval.
    multioutput : str, default="uniform_average"

    Returns
    -------
    float or ndarray (P,)

    Examples
    --------
    >>> interval_coverage([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4)
    0.5
    """
    target, mean, std = check_scored(y_true, y_pred, y_std)
    is_inside = np.abs(target - mean) <= half_width(level) * std
    inside = np.where(np.isnan(target), np.nan, is_inside)
    return _aggregate(_by_output(np.nanmean, inside), multioutput)


def check_scored(y_true: ArrayLike, *predicted: ArrayLike) -> list[Matrix]:
    """Return targets, means and deviations as (n, P) floats; deviations are positive."""
    target = np.asarray(y_true, dtype=float)
    if target.ndim not in (1, 2) or not target.size:
        raise ValueError(
            f"Got y_true of shape {target.shape}, but expected (n,) or (n, P), not empty."
        )
    if np.isinf(target).any():
        raise ValueError(
            "Got infinite values in y_true, but expected finite ones or NaN (not observed)."
        )
    scored = [target.reshape(len(target), -1)]
    for name, prediction in zip(("y_pred", "y_std"), predicted, strict=False):
        values = np.asarray(prediction, dtype=float)
        _check_predicted(name, values, target)
        scored.append(values.reshape(len(target), -1))
    return scored


def _check_predicted(name: str, values: np.ndarray, target: np.ndarray) -> None:
    """Raise ValueError if predicted means or deviations do not fit the target, or are no numbers of their kind."""
    if values.size != target.size or len(values) != len(target):
        raise ValueError(
            f"Got {name} of shape {values.shape}, but expected {target.shape}, y_true's."
        )
    n_finite = np.isfinite(values).sum()
    if n_finite < values.size:
        raise ValueError(
            f"Got {values.size - n_finite} values of {name} that are not finite, but a "
            "prediction must be: look for NaN among the regressors."
        )
    if name == "y_std" and not (values > 0).all():
        raise ValueError(f"Got y_std down to {values.min():g}, but expected positive values.")


def _by_output(statistic: Callable, values: Matrix) -> Vector:
    """Return a statistic of the observed values of each output; NaN, with a warning, where there are none."""
    never: Mask = np.all(np.isnan(values), axis=0)
    if never.any():
        _warn_undefined(never, "is never observed", "it cannot be scored")
    result = np.full(len(never), np.nan)
    result[~never] = statistic(values[:, ~never], axis=0)
    return result


def _aggregate(values: Vector, multioutput: str) -> Score:
    if str(multioutput) not in ("raw_values", "uniform_average"):
        raise ValueError(
            f"Got multioutput={multioutput!r}, but expected 'raw_values' or 'uniform_average'."
        )
    if multioutput == "raw_values":
        return values
    scored = values[~np.isnan(values)]
    return float(scored.mean()) if scored.size else np.nan


def _warn_undefined(outputs: Mask, state: str, consequence: str) -> None:
    warn(
        f"Output {np.flatnonzero(outputs).tolist()} {state} in y_true, "
        f"so {consequence}: NaN, and left out of the mean.",
        UndefinedMetricWarning,
    )


@dataclass(frozen=True)
class _Scorer:
    """A scorer ``(estimator, X, y) -> float`` of a metric that may need predicted standard deviations.

    They include the noise where the estimator's ``predict`` takes ``include_noise``, as the targets
    are measurements. ``sign`` is -1 for errors, as scikit-learn maximises scores.
    """

    metric: Callable
    sign: int = -1
    needs_std: bool = True

    def __call__(self, estimator: Any, X: Any, y: Any) -> float:
        targets = np.asarray(y, dtype=float).reshape(len(y), -1)
        observed = np.isfinite(targets).any(axis=1)
        rows = np.flatnonzero(observed if observed.any() else ~observed)
        if not self.needs_std:
            predicted = (estimator.predict(X),)
        elif accepts(estimator, "return_std"):
            names = ("include_noise", "include_input_noise")
            noise = {name: True for name in names if accepts(estimator, name)}
            # These are options of the metric, not metadata that a pipeline would route.
            with config_context(enable_metadata_routing=False):
                predicted = unwrap(estimator).predict(X, return_std=True, **noise)
        else:
            raise TypeError(
                f"Got {type(estimator).__name__}, whose predict takes no return_std, but "
                "this metric needs predictive standard deviations: use "
                "DependentGPRegressor, also inside a Pipeline, or a metric of means."
            )
        of_rows = (np.asarray(part)[rows] for part in predicted)
        return self.sign * self.metric(safe_indexing(y, rows), *of_rows)


# Scorers by name, for ``scoring=SCORERS``. Greater is better, except that coverage should be near
# its level
SCORERS = {
    "neg_median_relative_error": _Scorer(median_relative_error, needs_std=False),
    "neg_normalized_rmse": _Scorer(normalized_rmse, needs_std=False),
    "log_predictive_density": _Scorer(negative_log_predictive_density),
    "interval_coverage": _Scorer(interval_coverage, sign=1),
}
