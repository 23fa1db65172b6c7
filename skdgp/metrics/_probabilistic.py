"""Metrics of stated uncertainty: proper scores and coverage."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp.metrics._arrays import aggregate, check_scored, output_names, reduce_observed

LEVELS = (*(k / 20 for k in range(1, 20)), 0.99)
"""Probabilities of the intervals that are counted where none are given."""


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
    >>> from skdgp.metrics import negative_log_predictive_density
    >>> round(negative_log_predictive_density([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]), 4)
    1.1689
    """
    y_true, y_pred, y_std = check_scored(y_true, y_pred, y_std)
    density = 0.5 * np.log(2 * np.pi * y_std**2) + 0.5 * ((y_true - y_pred) / y_std) ** 2
    return aggregate(reduce_observed(np.mean, density, y_true), multioutput)


def continuous_ranked_probability_score(y_true, y_pred, y_std, *, multioutput="uniform_average"):
    r"""Return the mean of the continuous ranked probability score of normal predictions.

    With z = (y - m) / s (Gneiting & Raftery 2007, equation 21, there with the opposite sign)

    .. math:: s \left[z (2 \Phi(z) - 1) + 2 \varphi(z) - 1 / \sqrt{\pi}\right].

    A proper score like :func:`negative_log_predictive_density`, but in units of the output and linear in a large error:
    one outlier does not decide it. Of a certain prediction it is the absolute error.

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    y_pred, y_std : array-like of the same shape
        Predicted mean and standard deviation, with measurement noise where the targets are measured.
    multioutput : {"raw_values", "uniform_average"} or array-like of shape (P,), default="uniform_average"
        How outputs are put together.

    Returns
    -------
    float or ndarray of shape (P,)
        In units of the output; NaN, with a warning, for an output that is never observed.

    Raises
    ------
    ValueError
        If the shapes differ, a prediction is not finite, or a standard deviation is not positive.

    Examples
    --------
    >>> from skdgp.metrics import continuous_ranked_probability_score
    >>> round(continuous_ranked_probability_score([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]), 4)
    0.4181
    """
    y_true, y_pred, y_std = check_scored(y_true, y_pred, y_std)
    z = (y_true - y_pred) / y_std
    score = y_std * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    return aggregate(reduce_observed(np.mean, score, y_true), multioutput)


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
    >>> from skdgp.metrics import interval_coverage
    >>> interval_coverage([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4)
    0.5
    """
    if not 0 < level < 1:
        raise ValueError(f"Got level={level!r}, but expected a probability inside (0, 1), such as 0.95.")
    y_true, y_pred, y_std = check_scored(y_true, y_pred, y_std)
    inside = np.abs(y_true - y_pred) <= norm.ppf(0.5 + level / 2) * y_std
    return aggregate(reduce_observed(np.mean, inside, y_true), multioutput)


def coverage_curve(y_true, y_pred, y_std, *, levels=LEVELS) -> pd.DataFrame:
    """Return how often intervals of several levels hold, output by output.

    Honest standard deviations give a curve near the diagonal; below it they are too small, above it too large.

    Parameters
    ----------
    y_true : array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    y_pred, y_std : array-like of the same shape
        Predicted mean and standard deviation. A prediction of deviation 0 covers the targets that it meets.
    levels : array-like of shape (L,), default 0.05 to 0.95 in steps of 0.05, and 0.99
        Probabilities of the central intervals.

    Returns
    -------
    DataFrame of shape (L, P)
        Share of targets inside: a row per level, rising, a column per output; NaN for an output never observed.

    Raises
    ------
    ValueError
        If the shapes differ, a prediction is not finite, a standard deviation is negative, or a level is not inside
        (0, 1).

    Examples
    --------
    >>> from skdgp.metrics import coverage_curve
    >>> coverage_curve([0.0, 1.9, 2.1, -3.0], [0.0] * 4, [1.0] * 4, levels=[0.5, 0.95])[0].tolist()
    [0.25, 0.5]
    """
    names = output_names(y_true)
    levels = check_levels(levels)
    y_true, y_pred, y_std = check_scored(y_true, y_pred, y_std, zero_std=True)
    shares = shares_inside(standardized(y_true, y_pred, y_std), levels)
    return pd.DataFrame(shares, index=pd.Index(levels, name="level"), columns=names or range(shares.shape[1]))


def standardized(y_true, y_pred, y_std) -> np.ndarray:
    """Return (y - m) / s, infinite for a certain prediction that is wrong, 0 for one that is right."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (y_true - y_pred) / y_std
    z[(y_true == y_pred) & (y_std == 0)] = 0.0
    return z


def check_levels(levels) -> np.ndarray:
    """Return probabilities inside (0, 1), rising."""
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    if levels.ndim != 1 or not ((levels > 0) & (levels < 1)).all():
        raise ValueError(f"Got levels {levels}, but expected probabilities between 0 and 1, such as 0.95.")
    return np.sort(levels)


def shares_inside(z, levels) -> np.ndarray:
    """Return the share of standardized errors (n, P) inside each central interval, (L, P); NaN ones do not count."""
    bounds = norm.ppf(0.5 + levels / 2)
    seen = [np.sort(np.abs(column[~np.isnan(column)])) for column in z.T]
    return np.column_stack(
        [np.searchsorted(z, bounds, side="right") / len(z) if len(z) else np.full(len(bounds), np.nan) for z in seen]
    )
