"""Metrics of point predictions."""

from __future__ import annotations

import numpy as np

from skdgp.metrics._arrays import aggregate, check_scored, reduce_observed, warn_undefined


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
    >>> from skdgp.metrics import median_relative_error
    >>> median_relative_error([1.0, 2.0, 4.0], [1.25, 2.0, 2.0])
    0.25
    """
    y_true, y_pred = check_scored(y_true, y_pred)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(y_true - y_pred) / np.abs(y_true)
    relative[y_true == y_pred] = 0.0
    return aggregate(reduce_observed(np.median, relative, y_true), multioutput)


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
    >>> from skdgp.metrics import normalized_rmse
    >>> normalized_rmse([1.0, -1.0, 1.0, -1.0], [0.5, -0.5, 0.5, -0.5])
    0.5
    """
    y_true, y_pred = check_scored(y_true, y_pred)
    error = np.sqrt(reduce_observed(np.mean, (y_true - y_pred) ** 2, y_true))
    mean = np.nansum(y_true, axis=0) / np.maximum((~np.isnan(y_true)).sum(axis=0), 1)
    spread = np.sqrt(reduce_observed(np.mean, (y_true - mean) ** 2, y_true))
    if (spread == 0).any():
        warn_undefined(spread == 0, "is constant", "its RMSE cannot be normalised")
        spread[spread == 0] = np.nan
    return aggregate(error / spread, multioutput)
