"""Learning curves over the length of the training flights, found by fits and expected before them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.metrics import check_scoring
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.utils.parallel import Parallel, delayed

from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._compute.typing import ArrayLike, Indices
from skdgp._flight.checks import check_columns, check_table
from skdgp.inference import Data, ExactPosterior, input_noise_loading
from skdgp.metrics import score_outputs
from skdgp.model_selection._blocks import list_splits, rows_by_flight
from skdgp.model_selection._informative import regressor_and_inputs
from skdgp.model_selection._thin import evenly, thin_targets


def flight_learning_curve(
    estimator: Any,
    table: pd.DataFrame,
    Y: Any,
    *,
    seconds: ArrayLike,
    test_table: pd.DataFrame | None = None,
    test_Y: Any = None,
    cv: Any = None,
    n_samples: int | None = None,
    scoring: Any = score_outputs,
    n_jobs: int | None = None,
) -> pd.DataFrame:
    """Return the scores of models that learned from the first seconds of each training flight.

    Where the curve is flat, longer flights of this kind do not improve the model: fly other manoeuvres. Raises
    ValueError if ``seconds`` are not positive or longer than every training flight, or there is nothing to test on:
    neither test flights with targets, nor ``cv``, nor several flights.

    Parameters
    ----------
    estimator : estimator or Pipeline
        It is cloned and fitted for every point of the curve.
    table : DataFrame (n, ...)
        Training flights, with ``time`` [s], and ``flight`` where there are several.
    Y : DataFrame, Series or array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    seconds : array-like of shape (S,)
        Seconds of each training flight, counted over its recorded rows. A shorter flight is used whole; at least one
        must be as long.
    test_table, test_Y : DataFrame and targets, optional
        Test flights and their targets.
    cv : splitter or iterable, optional
        Splits of ``table``, where there are no test flights. Default: hold out each flight in turn.
    n_samples : int, optional
        Rows to learn from in every training part (:func:`thin_targets`), so that parts differ in what was flown and
        not in the number of samples. Default: all observed rows.
    scoring : callable, str, list or dict, default=score_outputs
        As in ``cross_validate``.
    n_jobs : int, optional
        Points of the curve that are computed in parallel, as in joblib.

    Returns
    -------
    DataFrame
        A row per point and split: ``seconds``, ``split``, ``n_samples`` (rows to learn from), and a column per score.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn.pipeline import make_pipeline
    >>> from skdgp.preprocessing import RegressorSelector
    >>> t = np.tile(np.arange(0.0, 60.0, 0.1), 2)
    >>> table = pd.DataFrame({"time": t, "flight": np.repeat(["a", "b"], 600), "alpha": 0.1 * np.sin(t**2 / 60)})
    >>> Y = pd.DataFrame({"CZ": -4.0 * table.alpha + 30 * table.alpha**3})
    >>> model = make_pipeline(RegressorSelector(["alpha"]), LinearRegression())
    >>> curve = flight_learning_curve(model, table, Y, seconds=[5, 50])
    >>> curve[["seconds", "split", "n_samples"]].values.tolist()
    [[5.0, 0.0, 50.0], [5.0, 1.0, 50.0], [50.0, 0.0, 500.0], [50.0, 1.0, 500.0]]
    >>> curve.groupby("seconds")["normalized_rmse_CZ"].mean().is_monotonic_decreasing
    True
    """
    check_columns(check_table(table), ["time"])
    if test_table is not None and (test_Y is None or cv is not None):
        raise ValueError("Got a test_table, but expected its test_Y as well, and no cv: give both, or cv alone.")
    if test_table is not None:
        splits = [(np.arange(len(table)), (test_table, test_Y))]
    else:
        splits = [(train, (table.iloc[test], safe_indexing(Y, test))) for train, test in _splits(cv, table)]
    points = [(float(second), k) for second in np.atleast_1d(seconds) for k in range(len(splits))]
    parts = [_first_rows(second, table, splits[k][0]) for second, k in points]
    scorer = check_scoring(estimator, scoring=scoring)
    scores = Parallel(n_jobs=n_jobs)(
        delayed(_fit_and_score)(estimator, table.iloc[rows], safe_indexing(Y, rows), *splits[k][1], n_samples, scorer)
        for (_, k), rows in zip(points, parts, strict=True)
    )
    return pd.concat([pd.DataFrame(points, columns=["seconds", "split"]), pd.DataFrame(scores)], axis=1)


def expected_learning_curve(
    model: Any,
    table: pd.DataFrame,
    *,
    seconds: ArrayLike,
    n_samples: int = 300,
    n_points: int = 200,
    include_noise: bool = False,
) -> pd.DataFrame:
    r"""Return how far off a model expects to be once it has learned the first seconds of each flight.

    No target is needed and nothing is fitted: at given hyperparameters the posterior variance depends on the
    regressors alone. So the curve is known before a long log is learned, and of a simulated flight before it is flown.
    With the posterior variance :math:`v_i` of output i after these seconds,

    .. math:: \mathrm{NRMSE}_i = \sqrt{\mathrm{mean}(v_i)} / \mathrm{std}(m_i)

    over points spread evenly over the whole log, where :math:`m` is the mean of the model as it is. The samples that
    the model has learned from before do not count. Where the curve with noise is flat, more of the same flight does not
    improve predictions of measurements: fly other manoeuvres. Raises ValueError if ``seconds`` are not positive or
    longer than every flight, or too short for a row; NotFittedError if the model is not fitted.

    Parameters
    ----------
    model : DependentGPRegressor or Pipeline that ends with it
        Fitted, on a part of the log or on another flight.
    table : DataFrame (n, ...)
        The log, as the pipeline takes it, with ``time`` [s], and ``flight`` where there are several.
    seconds : array-like of shape (S,)
        Seconds of each flight, counted over its recorded rows, as of `flight_learning_curve`.
    n_samples : int, default=300
        Rows to learn from in the whole log, spread evenly; of its first seconds those among them.
    n_points : int, default=200
        Points at which the model is judged.
    include_noise : bool, default=False
        Whether to predict new measurements instead of the coefficients themselves.

    Returns
    -------
    DataFrame
        A row per point of the curve: ``seconds``, ``n_samples``, ``normalized_rmse_NAME`` of each output, and
        ``above``, by which part their mean exceeds that of the whole log.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.model_selection import expected_learning_curve
    >>> log = pd.DataFrame({"time": np.arange(0, 100, 0.1)})
    >>> log["alpha"] = 0.1 * np.sin(log["time"]) * (1 + (log["time"] > 50))  # a wider range from 50 s on
    >>> y = np.sin(20 * log["alpha"]) + 0.1 * np.random.default_rng(0).standard_normal(1000)
    >>> model = DependentGPRegressor(n_latent=1, random_state=0).fit(log[["alpha"]][::20], y[::20])
    >>> curve = expected_learning_curve(model, log, seconds=[25, 50, 75, 100], include_noise=True)
    >>> curve["above"].round(1).tolist()  # only the first part of each half teaches
    [1.5, 1.4, 0.0, 0.0]
    """
    check_columns(check_table(table), ["time"])
    regressor, X = regressor_and_inputs(model, table)
    usable = np.flatnonzero(np.isfinite(X).all(axis=1))
    points, spread = (usable[evenly(len(usable), size)] for size in (n_points, n_samples))
    posterior, root = regressor.posterior_, regressor._root

    def loading(rows):  # of noisy regressors
        return None if root is None else input_noise_loading(posterior, X[rows], root)

    noise = 0.0
    if include_noise:
        noise = posterior.noise + (0.0 if root is None else (loading(points) ** 2).sum(axis=2))
    size = posterior.predict(X[points]).std(axis=0)
    found = []
    for second in [*np.atleast_1d(np.asarray(seconds, dtype=float)), np.inf]:
        rows = spread if np.isinf(second) else np.intersect1d(spread, _first_rows(second, table, np.arange(len(table))))
        if not len(rows):
            raise ValueError(f"Got {second:g} s, without any of {n_samples} rows: ask for more, or raise n_samples.")
        data = Data.from_table(X[rows], np.zeros((len(rows), len(size))), loading(rows))
        learned = ExactPosterior(regressor.kernel_, posterior.noise, data)
        variance = learned.predict(X[points], return_variance=True)[1] + noise
        found.append([second, len(rows), *(np.sqrt(variance.mean(axis=0)) / size)])
    names = [f"normalized_rmse_{name}" for name in regressor.output_names_]
    curve = pd.DataFrame(found, columns=["seconds", "n_samples", *names])
    mean = curve[names].mean(axis=1)
    return curve.assign(above=mean / mean.iloc[-1] - 1).iloc[:-1]


def _fit_and_score(estimator, table, Y, test_table, test_Y, n_samples, scorer) -> dict:
    Y = Y if n_samples is None else thin_targets(Y, n_samples)
    scores = scorer(clone(estimator).fit(table, Y), test_table, test_Y)
    observed = np.isfinite(np.asarray(Y, dtype=float).reshape(len(Y), -1)).any(axis=1)
    return {"n_samples": int(observed.sum()), **(scores if isinstance(scores, dict) else {"score": scores})}


def _first_rows(second: float, table: pd.DataFrame, train: Indices) -> Indices:
    """Return the training rows of the first seconds of each flight."""
    if not second > 0:
        raise ValueError(f"Got {second:g} s, but expected a positive number of seconds to learn from.")
    time = table["time"].to_numpy(float)[train]
    kept, longest = [], 0.0
    for rows in rows_by_flight(table.iloc[train]).values():
        step = float(np.median(np.diff(time[rows]))) if len(rows) > 1 else 0.0
        longest = max(longest, step * len(rows))
        kept.append(rows[np.arange(len(rows)) * step < second * (1 - 1e-9)])
    if second > longest * (1 + 1e-6):
        raise ValueError(f"Got {second:g} s, but the longest training flight has {longest:g} s: ask for fewer seconds.")
    return train[np.sort(np.concatenate(kept))]


def _splits(cv: Any, table: pd.DataFrame) -> list[tuple[Indices, Indices]]:
    """Return training and test rows; by default each flight in turn is held out."""
    flights = rows_by_flight(table)
    if cv is None and len(flights) < 2:
        raise ValueError(
            "Got one flight, but expected several to hold out in turn: give test_table and test_Y, or cv=BlockSplit()."
        )
    groups = np.empty(len(table), dtype=int)
    for code, rows in enumerate(flights.values()):
        groups[rows] = code
    return list_splits(LeaveOneGroupOut() if cv is None else cv, table, groups)
