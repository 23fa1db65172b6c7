"""Scorers of fitted estimators, and scores by output and by flight."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from sklearn.exceptions import UndefinedMetricWarning

from skdgp._compute.predicting import accepts, predict_observed
from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import flight_rows
from skdgp.metrics._metrics import (
    continuous_ranked_probability_score,
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
    output_names,
)


def make_predictive_scorer(
    metric: Callable, *, greater_is_better: bool, needs_std: bool = False, **kwargs: Any
) -> Callable[..., float]:
    """Return a scorer ``(estimator, X, y) -> float`` of a metric that may need predicted standard deviations.

    Parameters
    ----------
    metric : callable
        ``metric(y_true, y_pred, **kwargs)``; with ``needs_std``, ``metric(y_true, y_pred, y_std, **kwargs)``.
    greater_is_better : bool
        False flips the sign, as scikit-learn maximises scores.
    needs_std : bool, default=False
        Whether to call ``predict(X, return_std=True)``, with ``include_noise=True`` where the estimator takes it, as
        the targets are measurements. Pipelines and fitted searches pass it on.
    **kwargs
        Passed to the metric.

    Returns
    -------
    callable
        For ``scoring=``; it can be pickled.

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
    """A metric, its sign, and whether it needs standard deviations."""

    def __init__(self, metric, sign, needs_std, kwargs):
        self.metric, self.sign, self.needs_std, self.kwargs = metric, sign, needs_std, kwargs

    def __call__(self, estimator, X, y):
        rows, *predicted = predict_observed(estimator, X, y, with_std=self.needs_std)
        return self.sign * self.metric(safe_indexing(y, rows), *predicted, **self.kwargs)

    def __repr__(self):
        return f"make_predictive_scorer({self.metric.__name__}, greater_is_better={self.sign > 0})"


POINT = (median_relative_error, normalized_rmse)
PROBABILISTIC = (negative_log_predictive_density, continuous_ranked_probability_score, interval_coverage)

SCORERS = {
    name: make_predictive_scorer(metric, greater_is_better=greater, needs_std=metric in PROBABILISTIC)
    for name, metric, greater in (
        ("neg_median_relative_error", median_relative_error, False),
        ("neg_normalized_rmse", normalized_rmse, False),
        ("log_predictive_density", negative_log_predictive_density, False),
        ("neg_continuous_ranked_probability_score", continuous_ranked_probability_score, False),
        ("interval_coverage", interval_coverage, True),
    )
}
"""Scorers by name, for ``scoring=SCORERS``. Greater is better, except that coverage should be near its level."""


def score_outputs(estimator: Any, X: Any, y: Any) -> dict[str, float]:
    """Return the metrics of each output, ``{"normalized_rmse_CX": ..., ...}``, for ``scoring=`` of ``cross_validate``.

    There are five metrics where the estimator predicts standard deviations, otherwise the two that need none. Errors
    are positive. Outputs are named by the columns of ``y``, or numbered.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> X, Y = np.arange(6.0)[:, None], np.arange(12.0).reshape(6, 2)
    >>> sorted(score_outputs(LinearRegression().fit(X, Y), X, Y))
    ['median_relative_error_0', 'median_relative_error_1', 'normalized_rmse_0', 'normalized_rmse_1']
    """
    rows, *predicted = predict_observed(estimator, X, y, with_std=accepts(estimator, "return_std"))
    scores = _scores(safe_indexing(y, rows), *predicted)
    return {f"{metric}_{name}": float(value) for metric, values in scores.items() for name, value in values.items()}


def score_flights(estimator: Any, table: pd.DataFrame, Y: Any, *, flight: str = "flight") -> pd.DataFrame:
    """Return the metrics of a fitted estimator by flight and output.

    Standard deviations include measurement noise where the estimator has it. Raises ValueError if the table lacks the
    column.

    Parameters
    ----------
    estimator : fitted estimator or Pipeline
    table : DataFrame (n, ...)
        Regressors, or the flights of an identification pipeline.
    Y : DataFrame, Series or array-like (n,) or (n, P)
        Measured targets.
    flight : str, default="flight"
        Column of ``table`` that names the flight.

    Returns
    -------
    DataFrame
        A row per flight and output. Columns: ``n_observed``, and the metrics of :func:`score_outputs`; NaN where an
        output is never observed in a flight.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from sklearn.linear_model import LinearRegression
    >>> table = pd.DataFrame({"flight": ["a"] * 5 + ["b"] * 5, "alpha": np.linspace(0.0, 0.9, 10)})
    >>> Y = pd.DataFrame({"CZ": -4.0 * table.alpha + 0.1 * (table.flight == "b")})
    >>> from sklearn.pipeline import make_pipeline
    >>> from skdgp.preprocessing import RegressorSelector
    >>> model = make_pipeline(RegressorSelector(["alpha"]), LinearRegression()).fit(table[:5], Y[:5])
    >>> score_flights(model, table, Y)["normalized_rmse"].round(2)
    flight  output
    a       CZ        0.00
    b       CZ        0.18
    Name: normalized_rmse, dtype: float64
    """
    check_columns(check_table(table), [flight], what="table of flights")
    values = np.asarray(Y, dtype=float).reshape(len(table), -1)
    Y = pd.DataFrame(values, columns=output_names(Y) or range(values.shape[1]))
    rows, *observed = predict_observed(estimator, table, Y, with_std=accepts(estimator, "return_std"))
    predicted = [np.ones(values.shape) for _ in observed]  # no row without a target is scored
    for full, part in zip(predicted, observed, strict=True):
        full[rows] = part.reshape(len(rows), -1)
    tables = {}
    for name, rows in flight_rows(table[flight]).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UndefinedMetricWarning)  # the NaN shows it
            scores = pd.DataFrame(_scores(Y.iloc[rows], *(part[rows] for part in predicted)))
        scores.insert(0, "n_observed", Y.iloc[rows].notna().sum())
        tables[name] = scores
    return pd.concat(tables, names=["flight", "output"])


def _scores(y, *predicted) -> dict[str, dict]:
    """Return every metric that the predictions allow, by output."""
    found: dict[str, Any] = {metric.__name__: metric(y, predicted[0], multioutput="raw_values") for metric in POINT}
    if len(predicted) > 1:
        found |= {metric.__name__: metric(y, *predicted, multioutput="raw_values") for metric in PROBABILISTIC}
    names = list(getattr(y, "columns", [])) or range(len(found[POINT[0].__name__]))
    return {metric: dict(zip(names, values, strict=True)) for metric, values in found.items()}
