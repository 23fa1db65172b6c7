"""Metrics of predictions and of their standard deviations.

Targets are (n,) or (n, P). A NaN target was not observed and is left out, output by output.
``multioutput`` is scikit-learn's: ``"raw_values"`` for one number per output, ``"uniform_average"``
for their mean, or an array of weights. The metric of an output that is never observed is NaN, with
a warning. The metrics raise ValueError if shapes differ, a prediction is not finite, a standard
deviation is not positive, or a level is not inside (0, 1). The
scorers serve ``scoring=`` of ``cross_validate`` and ``GridSearchCV``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from scipy.stats import norm
from sklearn.exceptions import UndefinedMetricWarning

from skdgp._compute.messages import warn, without_warnings
from skdgp._compute.predicting import accepts, predict_observed
from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import ArrayLike, Mask, Matrix, Vector
from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import flight_rows

__all__ = [
    "SCORERS", "continuous_ranked_probability_score", "interval_coverage", "median_relative_error",
    "negative_log_predictive_density", "normalized_rmse", "score_flights", "score_outputs",
]  # fmt: skip

Average: TypeAlias = "str | ArrayLike"
Score: TypeAlias = "float | Vector"


def median_relative_error(
    y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: Average = "uniform_average"
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
    return _aggregate(_by_output(np.median, relative, target), multioutput)


def normalized_rmse(
    y_true: ArrayLike, y_pred: ArrayLike, *, multioutput: Average = "uniform_average"
) -> Score:
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
    y_true: ArrayLike,
    y_pred: ArrayLike,
    y_std: ArrayLike,
    *,
    multioutput: Average = "uniform_average",
) -> Score:
    """Return the mean of ``log(2 pi s^2) / 2 + (y - m)^2 / 2 s^2`` (Rasmussen & Williams 2006, eq 2.34).

    For measured targets ``y_std`` must include measurement noise (``include_noise=True``).

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
    y_true: ArrayLike,
    y_pred: ArrayLike,
    y_std: ArrayLike,
    *,
    multioutput: Average = "uniform_average",
) -> Score:
    r"""Return the mean of the continuous ranked probability score of normal predictions.

    With z = (y - m) / s (Gneiting & Raftery 2007, equation 21, there with the opposite sign)

    .. math:: s \left[z (2 \Phi(z) - 1) + 2 \varphi(z) - 1 / \sqrt{\pi}\right].

    It is a proper score, in units of the output and linear in a large error, so one outlier does
    not dominate it.

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
    y_true: ArrayLike, y_pred: ArrayLike, y_std: ArrayLike, *, level: float = 0.95,
    multioutput: Average = "uniform_average",
) -> Score:  # fmt: skip
    """Return the fraction of targets inside the central ``level`` interval of a normal prediction.

    It is smaller than ``level`` where the standard deviations are too small.

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
    inside = np.abs(target - mean) <= half_width(level) * std
    return _aggregate(_by_output(np.mean, inside, target), multioutput)


def output_names(y: object) -> list:
    """Return the outputs' names of a DataFrame, or of a Series that has one; else an empty list."""
    name = getattr(y, "name", None)
    return list(getattr(y, "columns", [] if name is None or name == "" else [name]))


def check_scored(y_true: ArrayLike, *predicted: ArrayLike) -> list[Matrix]:
    """Return targets, means and deviations as (n, P) floats; deviations are positive."""
    target = np.asarray(y_true, dtype=float)
    predictions = [np.asarray(values, dtype=float) for values in predicted]
    for name, values in zip(("y_pred", "y_std"), predictions, strict=False):
        if values.size != target.size or len(values) != len(target):
            raise ValueError(
                f"Got {name} of shape {values.shape}, but expected {target.shape}, y_true's."
            )
        if not np.isfinite(values).all():
            raise ValueError(
                f"Got {int((~np.isfinite(values)).sum())} values of {name} that are not finite, "
                f"but a prediction must "
                "be: look for NaN among the regressors."
            )
    if target.ndim not in (1, 2) or not target.size:
        raise ValueError(
            f"Got y_true of shape {target.shape}, but expected (n,) or (n, P), not empty."
        )
    if np.isinf(target).any():
        raise ValueError(
            "Got infinite values in y_true, but expected finite ones or NaN (not observed)."
        )
    if len(predictions) == 2 and not (predictions[1] > 0).all():
        raise ValueError(
            f"Got y_std down to {predictions[1].min():g}, but expected positive values."
        )
    return [values.reshape(len(target), -1) for values in (target, *predictions)]


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
            raise ValueError(
                f"Got {multioutput=}, but expected 'raw_values', 'uniform_average' or weights."
            )
        multioutput = np.ones(len(values))
    scored = ~np.isnan(values)
    return (
        float(np.average(values[scored], weights=np.asarray(multioutput)[scored]))
        if scored.any()
        else np.nan
    )


def _warn_undefined(outputs: Mask, state: str, consequence: str) -> None:
    warn(
        f"Output {np.flatnonzero(outputs).tolist()} {state} in y_true, so {consequence}: NaN, and "
        f"left out of the "
        "mean.",
        UndefinedMetricWarning,
        stacklevel=4,
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
        rows, *predicted = predict_observed(estimator, X, y, with_std=self.needs_std)
        return self.sign * self.metric(safe_indexing(y, rows), *predicted)


POINT = (median_relative_error, normalized_rmse)
PROBABILISTIC = (
    negative_log_predictive_density,
    continuous_ranked_probability_score,
    interval_coverage,
)
SCORERS = {
    "neg_median_relative_error": _Scorer(median_relative_error, needs_std=False),
    "neg_normalized_rmse": _Scorer(normalized_rmse, needs_std=False),
    "log_predictive_density": _Scorer(negative_log_predictive_density),
    "neg_continuous_ranked_probability_score": _Scorer(continuous_ranked_probability_score),
    "interval_coverage": _Scorer(interval_coverage, sign=1),
}
"""Scorers by name, for ``scoring=SCORERS``. Greater is better, except that coverage should be near
its level.
"""


def score_outputs(estimator: Any, X: Any, y: Any) -> dict[str, float]:
    """Return the metrics of each output, ``{"normalized_rmse_CX": ..., ...}``, for ``scoring=`` of ``cross_validate``.

    There are five metrics where the estimator predicts standard deviations, otherwise the two that
    need none. Outputs are named by the columns of ``y``, or numbered.

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
    return {
        f"{metric}_{name}": float(value)
        for metric, values in scores.items()
        for name, value in values.items()
    }


def score_flights(estimator: Any, table: pd.DataFrame, Y: Any) -> pd.DataFrame:
    """Return the metrics of a fitted estimator or pipeline by flight and output.

    The table (n, ...), regressors or the flights of an identification pipeline, names flights in
    its column ``flight``; Y (n,) or (n, P) are measured targets. The result has a row per flight
    and output, with ``n_observed`` and the metrics of :func:`score_outputs`; NaN where an output is
    never observed in a flight. Standard deviations include measurement noise where the estimator
    has it. Raises ValueError if the table lacks the column.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn.pipeline import make_pipeline
    >>> table = pd.DataFrame({"flight": ["a"] * 5 + ["b"] * 5, "alpha": np.linspace(0.0, 0.9, 10)})
    >>> Y = pd.DataFrame({"CZ": -4.0 * table.alpha + 0.1 * (table.flight == "b")})
    >>> from skdgp.preprocessing import RegressorSelector
    >>> model = make_pipeline(RegressorSelector(["alpha"]), LinearRegression()).fit(table[:5], Y[:5])
    >>> score_flights(model, table, Y)["normalized_rmse"].round(2)
    flight  output
    a       CZ        0.00
    b       CZ        0.18
    Name: normalized_rmse, dtype: float64
    """
    check_columns(check_table(table), ["flight"], what="table of flights")
    values = np.asarray(Y, dtype=float).reshape(len(table), -1)
    Y = pd.DataFrame(values, columns=output_names(Y) or range(values.shape[1]))
    rows, *observed = predict_observed(
        estimator, table, Y, with_std=accepts(estimator, "return_std")
    )
    predicted = [np.ones(values.shape) for _ in observed]  # no row without a target is scored
    for full, part in zip(predicted, observed, strict=True):
        full[rows] = part.reshape(len(rows), -1)
    tables = {}
    for name, rows in flight_rows(table["flight"]).items():
        with without_warnings(UndefinedMetricWarning):  # the NaN shows it
            scores = pd.DataFrame(_scores(Y.iloc[rows], *(part[rows] for part in predicted)))
        scores.insert(0, "n_observed", Y.iloc[rows].notna().sum())
        tables[name] = scores
    return pd.concat(tables, names=["flight", "output"])


def _scores(y, *predicted) -> dict[str, dict]:
    """Return every metric that the predictions allow, by output."""
    scores: dict[str, Any] = {
        metric.__name__: metric(y, predicted[0], multioutput="raw_values") for metric in POINT
    }
    if len(predicted) > 1:
        scores |= {
            metric.__name__: metric(y, *predicted, multioutput="raw_values")
            for metric in PROBABILISTIC
        }
    names = list(getattr(y, "columns", [])) or range(len(scores[POINT[0].__name__]))
    return {metric: dict(zip(names, values, strict=True)) for metric, values in scores.items()}
