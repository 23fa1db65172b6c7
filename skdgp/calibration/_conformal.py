"""Conformal calibration by flight: scores of held-out flights, and their quantiles with equal weight per flight."""

from __future__ import annotations

import warnings
from numbers import Integral
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.model_selection import GroupKFold

from skdgp._compute.predicting import predict_observed
from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.clock import flight_codes
from skdgp.model_selection import BlockSplit

N_SPLITS = 5
MIN_ROWS = 6  # of a single flight, which is cut into two blocks of three rows
ROUNDING = 1e-9  # levels nearer than this are equal


def flight_table(X: Any, groups: Any) -> pd.DataFrame:
    """Return the number of each row's flight, and its time where X has one."""
    n, columns = len(X), getattr(X, "columns", ())
    ids = groups if groups is not None else X["flight"] if "flight" in columns else np.zeros(n)
    codes, _ = flight_codes(ids)
    if len(codes) != n:
        raise ValueError(f"Got {len(codes)} flight identifiers for {n} rows, but expected one for each row.")
    table = pd.DataFrame({"flight": codes})
    return table.assign(time=X["time"].to_numpy(dtype=float)) if "time" in columns else table


def splits_of(flights: pd.DataFrame, cv: Any) -> list[tuple[Indices, Indices]]:
    """Return the training and held-out rows of each split; a fitted model uses the held-out rows only."""
    groups, rows = flights["flight"], np.arange(len(flights))
    if cv is None or isinstance(cv, Integral | str):
        if groups.nunique() < 2:
            return _blocks_of_one_flight(flights, cv)
        if cv == "prefit":
            return [(rows[:0], rows)]
        cv = GroupKFold(min(N_SPLITS, groups.nunique()) if cv is None else cv)
    if not hasattr(cv, "split"):
        return list(cv)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The groups parameter is ignored")
        return list(cv.split(flights, groups=groups))


def _blocks_of_one_flight(flights: pd.DataFrame, cv: Any) -> list[tuple[Indices, Indices]]:
    n = len(flights)
    if n < MIN_ROWS:
        raise ValueError(
            f"Got n_samples={n} of one flight, but expected at least {MIN_ROWS}, to hold some out: give more rows, "
            "or several flights (column flight, or groups)."
        )
    n_blocks = cv if isinstance(cv, Integral) else min(N_SPLITS, n // 3)
    warnings.warn(
        f"Got one flight, so {n_blocks} blocks of it replace flights: the calibration holds for further blocks of this "
        "flight, not for other flights. Give several (column flight, or groups).",
        stacklevel=5,
    )
    gap = 2.0 if "time" in flights and cv != "prefit" else 0.0  # seconds between training and held-out rows
    flights = flights if "time" in flights else flights.assign(time=np.arange(n, dtype=float))
    return list(BlockSplit(int(n_blocks), gap=gap).split(flights))


def fit_and_score(estimator: Any, X: Any, y: Any, Y: Matrix, train: Indices, test: Indices, fit_params: dict) -> Matrix:
    """Return the scores of held-out rows, by a model that did not learn from them."""
    params = {name: safe_indexing(values, train) for name, values in fit_params.items()}
    fitted = clone(estimator).fit(safe_indexing(X, train), safe_indexing(y, train), **params)
    return conformity_scores(fitted, safe_indexing(X, test), Y[test])


def conformity_scores(estimator: Any, X: Any, Y: Matrix) -> Matrix:
    """Return ``|y - mean| / std``, (n, P); NaN where not observed."""
    rows, mean, std = predict_observed(estimator, X, Y, with_std=True)
    scores = np.full(Y.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        scores[rows] = np.abs(Y[rows] - mean.reshape(len(rows), -1)) / std.reshape(len(rows), -1)
    return scores


def units_of(tests: list[Indices], flights: Indices) -> tuple[str, Indices]:
    """Return the exchangeable unit, the flight or, if a split cuts one, the block, and that of each held-out row.

    ``tests`` holds the held-out rows of each split, ``flights`` the flight of every row, from 0 on.
    """
    sizes = np.bincount(flights)
    counts = np.array([np.bincount(flights[test], minlength=len(sizes)) for test in tests])
    whole = len(sizes) > 1 and ((counts == 0) | (counts == sizes)).all()
    units = [flights[test] + (0 if whole else k * len(sizes)) for k, test in enumerate(tests)]
    return "flight" if whole else "block", np.concatenate(units)


def unit_weights(units: Indices) -> Vector:
    """Return weights of samples that sum to one, with equal sums for all units."""
    counts = np.bincount(units)
    return 1.0 / (counts[units] * np.count_nonzero(counts))


def weighted_quantile(scores: Vector, weights: Vector, level: float) -> float:
    """Return the least score for which scores up to it have a weight of ``level``; infinite if there is none."""
    order = np.argsort(scores)
    index = np.searchsorted(np.cumsum(weights[order]), level - ROUNDING)
    return float(scores[order][index]) if index < len(scores) else np.inf


def units_needed(level: float) -> int:
    """Return K, the least number of units with K / (K + 1) >= level."""
    return int(np.ceil(level / (1 - level) - ROUNDING))
