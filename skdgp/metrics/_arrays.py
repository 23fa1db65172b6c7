"""Validation of the arguments of metrics, and the shape of what they return."""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.exceptions import UndefinedMetricWarning


def check_scored(y_true, *predicted, zero_std=False):
    """Return everything as (n, P) floats; predictions finite, standard deviations positive, or 0 with ``zero_std``."""
    y_true = np.asarray(y_true, dtype=float)
    predicted = [np.asarray(values, dtype=float) for values in predicted]
    for name, values in zip(("y_pred", "y_std"), predicted, strict=False):
        if values.size != y_true.size or len(values) != len(y_true):
            raise ValueError(f"Got {name} of shape {values.shape}, but expected {y_true.shape}, y_true's.")
        if not np.isfinite(values).all():
            raise ValueError(
                f"Got {int((~np.isfinite(values)).sum())} values of {name} that are not finite, but a prediction must "
                "be: look for NaN among the regressors."
            )
    if y_true.ndim not in (1, 2) or not y_true.size:
        raise ValueError(f"Got y_true of shape {y_true.shape}, but expected (n,) or (n, P), not empty.")
    if np.isinf(y_true).any():
        raise ValueError("Got infinite values in y_true, but expected finite ones or NaN (not observed).")
    if len(predicted) == 2 and not ((predicted[1] > 0) | (zero_std & (predicted[1] == 0))).all():
        raise ValueError(f"Got y_std down to {predicted[1].min():g}, but expected positive values.")
    return [values.reshape(len(y_true), -1) for values in (y_true, *predicted)]


def reduce_observed(statistic, values, y_true):
    """Apply a statistic to the observed values of each output; NaN, with a warning, where there are none."""
    seen = ~np.isnan(y_true)
    if not seen.any(axis=0).all():
        warn_undefined(~seen.any(axis=0), "is never observed", "it cannot be scored")
    columns = [column[mask] for column, mask in zip(values.T, seen.T, strict=True)]
    return np.array([statistic(column) if column.size else np.nan for column in columns])


def aggregate(values, multioutput):
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


def warn_undefined(which, state, consequence):
    warnings.warn(
        f"Output {np.flatnonzero(which).tolist()} {state} in y_true, so {consequence}: NaN, and left out of the mean.",
        UndefinedMetricWarning,
        stacklevel=4,
    )


def output_names(y) -> list:
    """Return the outputs' names of a DataFrame, or of a Series that has one; else an empty list."""
    name = getattr(y, "name", None)
    return list(getattr(y, "columns", [] if name is None or name == "" else [name]))
