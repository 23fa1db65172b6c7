"""Residuals of a model on flights that are held out."""

from __future__ import annotations

import warnings
from numbers import Integral

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.model_selection import GroupKFold

from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._flight.clock import flight_codes
from skdgp.metrics._scorers import predict_observed
from skdgp.model_selection import BlockSplit
from skdgp.model_selection._blocks import held_out

N_SPLITS = 5
GAP = 2.0
"""Seconds between training and held-out rows, where blocks of one flight stand for flights."""
FEWEST_ROWS = 6


def flights_of(X, groups) -> pd.DataFrame:
    """Return the flight of each row, numbered, and its time where X has one."""
    n, columns = len(X), getattr(X, "columns", ())
    ids = groups if groups is not None else X["flight"] if "flight" in columns else np.zeros(n)
    codes, _ = flight_codes(ids)
    if len(codes) != n:
        raise ValueError(f"Got {len(codes)} flight identifiers for {n} rows, but expected one for each row.")
    table = pd.DataFrame({"flight": codes})
    return table.assign(time=X["time"].to_numpy(dtype=float)) if "time" in columns else table


def splits_of(flights: pd.DataFrame, cv) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs of rows to learn from and rows held out; of a fitted model the second alone count."""
    groups, rows = flights["flight"], np.arange(len(flights))
    if not (cv is None or isinstance(cv, Integral | str)):
        return held_out(cv, flights, groups)
    if groups.nunique() < 2:
        return _blocks_of_one(flights, cv)
    if cv == "prefit":
        return [(rows[:0], rows)]
    return held_out(GroupKFold(min(N_SPLITS, groups.nunique()) if cv is None else cv), flights, groups)


def _blocks_of_one(flights, cv):
    n = len(flights)
    if n < FEWEST_ROWS:
        raise ValueError(
            f"Got n_samples={n} of one flight, but expected at least {FEWEST_ROWS}, to hold some out: give more rows, "
            "or several flights (column flight, or groups)."
        )
    n_blocks = cv if isinstance(cv, Integral) else min(N_SPLITS, n // 3)
    warnings.warn(
        f"Got one flight, so {n_blocks} blocks of it stand for flights: what is calibrated holds for further blocks of "
        "this flight, not for other flights. Give several (column flight, or groups).",
        UserWarning,
        stacklevel=5,
    )
    if "time" in flights:
        return list(BlockSplit(n_blocks, gap=0.0 if cv == "prefit" else GAP).split(flights))
    return list(BlockSplit(n_blocks, gap=0.0).split(flights.assign(time=np.arange(n, dtype=float))))


def fit_and_score(estimator, X, y, Y, train, test) -> np.ndarray:
    """Return the scores of held-out rows, by a model that did not learn from them."""
    fitted = clone(estimator).fit(safe_indexing(X, train), safe_indexing(y, train))
    return conformity_scores(fitted, safe_indexing(X, test), Y[test])


def conformity_scores(estimator, X, Y) -> np.ndarray:
    """Return ``|y - mean| / std``, (n, P); NaN where not observed."""
    rows, mean, std = predict_observed(estimator, X, Y, with_std=True)
    scores = np.full(Y.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        scores[rows] = np.abs(Y[rows] - mean.reshape(len(rows), -1)) / std.reshape(len(rows), -1)
    return scores
