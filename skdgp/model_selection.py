"""Training subsets of flights.

Hold out whole flights with scikit-learn's ``LeaveOneGroupOut`` or ``GroupKFold`` on the column
``flight``. Neighbouring samples of one flight are nearly equal, so a random split inside a flight
gives scores that are too good.
"""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import column_names
from skdgp._compute.typing import Array, Mask

__all__ = ["thin_targets"]


def thin_targets(Y: Any, n_samples: int) -> Any:
    """Return targets with ``n_samples`` evenly spread observed rows; the others are NaN, not observed.

    Smoothing and differentiation need the flight at its full rate, exact inference a few hundred
    samples. So the training subset is chosen in the targets: transformers get every row, the
    regressor learns from the observed ones.

    Rows that are NaN in every output do not count; where there are fewer than ``n_samples``, all
    stay. The result is a copy of ``Y``, (n,) or (n, P), as floats, of the same type, names and
    index. Raises ValueError if ``n_samples`` is not a positive integer.

    Examples
    --------
    >>> from skdgp.model_selection import thin_targets
    >>> thin_targets([1.0, 2.0, float("nan"), 4.0, 5.0], 2)
    array([nan,  2., nan, nan,  5.])
    """
    if not isinstance(n_samples, Integral) or isinstance(n_samples, bool) or n_samples < 1:
        raise ValueError(
            f"Got n_samples={n_samples!r}, but expected a positive number of rows to keep."
        )
    values = np.array(Y, dtype=float)
    if values.ndim not in (1, 2):
        raise ValueError(f"Got targets of shape {values.shape}, but expected (n,) or (n, P).")
    observed = np.flatnonzero(~np.isnan(np.atleast_2d(values.T)).all(axis=0))
    if n_samples < len(observed):  # the middles of equal parts stay
        middles = (np.arange(n_samples) + 0.5) * len(observed) / n_samples
        observed = observed[middles.astype(int)]
    is_chosen = np.zeros(len(values), dtype=bool)
    is_chosen[observed] = True
    return observed_at(Y, is_chosen)


def observed_at(Y: Any, rows: Mask) -> Any:
    """Return targets (n,) or (n, P) that are observed at some rows (n,); the others are NaN."""
    values = np.array(Y, dtype=float)
    values[~rows] = np.nan
    return _like(Y, values)


def _like(Y: Any, values: Array) -> Any:
    """Return values as the type of Y, with its names and index."""
    if isinstance(Y, pd.DataFrame):
        return pd.DataFrame(values, index=Y.index, columns=Y.columns)
    if isinstance(Y, pd.Series):
        return pd.Series(values, index=Y.index, name=Y.name)
    if not column_names(Y):
        return values
    if values.ndim == 1:  # a series or a table without an index, such as polars'
        return type(Y)(Y.name, values)
    return type(Y)(dict(zip(Y.columns, values.T, strict=True)))
