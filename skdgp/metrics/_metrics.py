"""Metrics of predicted means and standard deviations."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pandas as pd
from scipy.stats import norm
from sklearn.exceptions import UndefinedMetricWarning

from skdgp._compute.intervals import LEVELS, check_level, check_levels, shares_inside, standardized
from skdgp._compute.typing import ArrayLike, Mask, Matrix, Vector

Average: TypeAlias = "str | ArrayLike"
Score: TypeAlias = "float | Vector"


def median_relative_error(y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: Average = "uniform_average") -> Score:
    """Return the median of ``|y_true - y_pred| / |y_true|``, a fraction (0.09 is 9 %), of (n,) or (n, P) targets.

    Hemakumara & Sukkarieh (ICRA 2011) report this figure. It ignores large errors: report :func:`normalized_rmse`
    beside it. A zero target has an infinite error, or none if met exactly.

    Examples
    --------
    >>> median_relative_error([1.0, 2.0, 4.0], [1.25, 2.0, 2.0])
    0.25
    """
    target, mean = check_scored(y_true, y_pred)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(target - mean) / np.abs(target)
    relative[target == mean] = 0.0
    return _aggregate(_by_output(np.median, relative, target), multioutput)


def normalized_rmse(y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: Average = "uniform_average") -> Score:
    """Return the root mean squared error over the standard deviation of the targets, (n,) or (n, P).

    1 is no better than predicting their mean; NaN, with a warning, for a constant output.

    Examples
    --------
    >>> normalized_rmse([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])
    0.5
    """
    target, predicted = check_scored(y_true, y_pred)
    error = np.sqrt(_by_output(np.mean, (target - predicted) ** 2, target))
    mean = np.nansum(target, axis=0) / np.maximum((~np.isnan(target)).sum(axis=0), 1)
    spread = np.sqrt(_by_output(np.mean, (target - mean) ** 2, target))
    if (spread == 0).any():
        _warn_undefined(spread == 0, "is constant", "its RMSE cannot be normalised")
        spread[spread == 0] = np.nan
    return _aggregate(error / spread, multioutput)


def negative_log_predictive_density(
    y_true: ArrayLike, y_pred: ArrayLike, y_std: ArrayLike, *, multioutput: Average = "uniform_average"
) -> Score:
    """Return the mean of ``log(2 pi s^2) / 2 + (y - m)^2 / 2 s^2`` (Rasmussen & Williams 2006, eq 2.34).

    It is small when predictions are close and their standard deviations are small. For measured targets ``y_std`` must
    include measurement noise (``include_noise=True``).

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
    multioutput : str or array-like (P,), default="uniform_average"

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
    density = 0.5 * np.log(2 * np.pi * std**2) + 0.5 * ((target - mean) / std) ** 2
    return _aggregate(_by_output(np.mean, density, target), multioutput)


def continuous_ranked_probability_score(
    y_true: ArrayLike, y_pred: ArrayLike, y_std: ArrayLike, *, multioutput: Average = "uniform_average"
) -> Score:
    r"""Return the mean of the continuous ranked probability score of normal predictions.

    With z = (y - m) / s (Gneiting & Raftery 2007, equation 21, there with the opposite sign)

    .. math:: s \left[z (2 \Phi(z) - 1) + 2 \varphi(z) - 1 / \sqrt{\pi}\right].

    Like :func:`negative_log_predictive_density` it is a proper score, but in units of the output and linear in a large
    error, so one outlier does not dominate it. For s = 0 it is the absolute error.

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
    multioutput : str or array-like (P,), default="uniform_average"

    Returns
    -------
    float or ndarray (P,)
        In units of the output.

    Examples
    --------
    >>> round(continuous_ranked_probability_score([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]), 4)
    0.4181
    """
    target, mean, std = check_scored(y_true, y_pred, y_std)
    z = (target - mean) / std
    score = std * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    return _aggregate(_by_output(np.mean, score, target), multioutput)


def interval_coverage(
    y_true: ArrayLike,
    y_pred: ArrayLike,
    y_std: ArrayLike,
    *,
    level: float = 0.95,
    multioutput: Average = "uniform_average",
) -> Score:
    """Return the fraction of targets inside the central ``level`` interval of a normal prediction.

    It is near ``level`` where the standard deviations are right, and smaller where they are too small.

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
    level : float, default=0.95
        Nominal probability of the interval.
    multioutput : str or array-like (P,), default="uniform_average"

    Returns
    -------
    float or ndarray (P,)

    Examples
    --------
    >>> interval_coverage([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4)
    0.5
    """
    target, mean, std = check_scored(y_true, y_pred, y_std)
    inside = np.abs(target - mean) <= norm.ppf(0.5 + check_level(level) / 2) * std
    return _aggregate(_by_output(np.mean, inside, target), multioutput)


def coverage_curve(
    y_true: ArrayLike, y_pred: ArrayLike, y_std: ArrayLike, *, levels: ArrayLike = LEVELS
) -> pd.DataFrame:
    """Return the fraction of targets inside central intervals of several levels, by output.

    Right standard deviations give a curve near the diagonal. Below it they are too small, above it too large.

    Parameters
    ----------
    y_true, y_pred, y_std : array-like (n,) or (n, P)
        An interval of deviation 0 holds the targets that equal its mean.
    levels : array-like (L,), default 0.05 to 0.95 in steps of 0.05, and 0.99
        Nominal probabilities of the intervals.

    Returns
    -------
    DataFrame (L, P)
        A row per level, rising, a column per output; NaN for an output never observed.

    Examples
    --------
    >>> coverage_curve([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4, levels=[0.5, 0.95])[0].tolist()
    [0.25, 0.5]
    """
    levels = check_levels(levels)
    shares = shares_inside(standardized(*check_scored(y_true, y_pred, y_std, zero_std=True)), levels)
    names = output_names(y_true) or range(shares.shape[1])
    return pd.DataFrame(shares, index=pd.Index(levels, name="level"), columns=names)


def output_names(y: object) -> list:
    """Return the outputs' names of a DataFrame, or of a Series that has one; else an empty list."""
    name = getattr(y, "name", None)
    return list(getattr(y, "columns", [] if name is None or name == "" else [name]))


def check_scored(y_true: ArrayLike, *predicted: ArrayLike, zero_std: bool = False) -> list[Matrix]:
    """Return targets, means and deviations as (n, P) floats; deviations are positive, or 0 with ``zero_std``."""
    target = np.asarray(y_true, dtype=float)
    found = [np.asarray(values, dtype=float) for values in predicted]
    for name, values in zip(("y_pred", "y_std"), found, strict=False):
        if values.size != target.size or len(values) != len(target):
            raise ValueError(f"Got {name} of shape {values.shape}, but expected {target.shape}, y_true's.")
        if not np.isfinite(values).all():
            raise ValueError(
                f"Got {int((~np.isfinite(values)).sum())} values of {name} that are not finite, but a prediction must "
                "be: look for NaN among the regressors."
            )
    if target.ndim not in (1, 2) or not target.size:
        raise ValueError(f"Got y_true of shape {target.shape}, but expected (n,) or (n, P), not empty.")
    if np.isinf(target).any():
        raise ValueError("Got infinite values in y_true, but expected finite ones or NaN (not observed).")
    if len(found) == 2 and not ((found[1] > 0) | (zero_std & (found[1] == 0))).all():
        raise ValueError(f"Got y_std down to {found[1].min():g}, but expected positive values.")
    return [values.reshape(len(target), -1) for values in (target, *found)]


def _by_output(statistic: Callable, values: np.ndarray, y_true: Matrix) -> Vector:
    """Return a statistic of the observed values of each output; NaN, with a warning, where there are none."""
    observed = ~np.isnan(y_true)
    if (never := np.all(~observed, axis=0)).any():
        _warn_undefined(never, "is never observed", "it cannot be scored")
    columns = [column[rows] for column, rows in zip(values.T, observed.T, strict=True)]
    return np.array([statistic(column) if column.size else np.nan for column in columns])


def _aggregate(values: Vector, multioutput: Average) -> Score:
    if isinstance(multioutput, str):
        if multioutput == "raw_values":
            return values
        if multioutput != "uniform_average":
            raise ValueError(f"Got {multioutput=}, but expected 'raw_values', 'uniform_average' or weights.")
        multioutput = np.ones(len(values))
    known = ~np.isnan(values)
    return float(np.average(values[known], weights=np.asarray(multioutput)[known])) if known.any() else np.nan


def _warn_undefined(outputs: Mask, state: str, consequence: str) -> None:
    warnings.warn(
        f"Output {np.flatnonzero(outputs).tolist()} {state} in y_true, so {consequence}: NaN, and left out of the "
        "mean.",
        UndefinedMetricWarning,
        stacklevel=4,
    )
