"""Central intervals of normal predictions, and how many errors they hold."""

from __future__ import annotations

from numbers import Real

import numpy as np
from scipy.stats import norm

from skdgp._compute.typing import ArrayLike, Matrix, Vector

LEVELS = (*(k / 20 for k in range(1, 20)), 0.99)
"""Probabilities of the intervals that ``coverage_curve`` counts by default."""


def standardized(y_true: Matrix, y_pred: Matrix, y_std: Matrix) -> Matrix:
    """Return (y - m) / s; where s = 0, zero for a prediction that is right and infinite for one that is wrong."""
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (y_true - y_pred) / y_std
    z[(y_true == y_pred) & (y_std == 0)] = 0.0
    return z


def check_level(level: float) -> float:
    """Return a probability strictly between 0 and 1."""
    if not isinstance(level, Real) or not 0 < float(level) < 1:
        raise ValueError(f"Got level={level!r}, but expected a probability inside (0, 1), such as 0.95.")
    return float(level)


def half_width(level: float) -> float:
    """Return half the width of the central interval of a probability inside (0, 1), in standard deviations."""
    return float(norm.ppf(0.5 + check_level(level) / 2))


def check_levels(levels: ArrayLike) -> Vector:
    """Return probabilities inside (0, 1), rising."""
    levels = np.atleast_1d(np.asarray(levels, dtype=float))
    if levels.ndim != 1 or not ((levels > 0) & (levels < 1)).all():
        raise ValueError(f"Got levels {levels}, but expected probabilities between 0 and 1, such as 0.95.")
    return np.sort(levels)


def shares_inside(z: Matrix, levels: Vector) -> Matrix:
    """Return the share of standardized errors (n, P) inside each central interval, (L, P); NaN ones do not count."""
    bounds = norm.ppf(0.5 + levels / 2)
    columns = [np.sort(np.abs(column[~np.isnan(column)])) for column in z.T]
    shares = [np.searchsorted(c, bounds, side="right") / len(c) if len(c) else np.nan * bounds for c in columns]
    return np.column_stack(shares)
