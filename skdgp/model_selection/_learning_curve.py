"""Learning curves over the seconds flown."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.metrics import check_scoring
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.utils.parallel import Parallel, delayed

from skdgp._compute.sklearn_compat import safe_indexing
from skdgp._flight.checks import check_columns, check_table
from skdgp.metrics import score_outputs
from skdgp.model_selection._blocks import held_out, rows_by_flight
from skdgp.model_selection._thin import thin_targets


def flight_learning_curve(
    estimator,
    table: pd.DataFrame,
    Y,
    *,
    seconds,
    test_table: pd.DataFrame | None = None,
    test_Y=None,
    cv=None,
    n_samples: int | None = None,
    scoring=score_outputs,
    n_jobs: int | None = None,
) -> pd.DataFrame:
    """Score a model that learned from the first so many seconds of each training flight.

    Where the curve has become flat, flying longer like this teaches nothing more: fly something else.

    Parameters
    ----------
    estimator : estimator or Pipeline
        It is cloned and fitted for every point of the curve.
    table : DataFrame (n, ...)
        Training flights, with ``time`` [s], and ``flight`` where there are several.
    Y : DataFrame, Series or array-like of shape (n,) or (n, P)
        Targets; NaN is not observed.
    seconds : array-like of shape (S,)
        Seconds of each training flight, counted over its recorded rows. A shorter flight is used whole; one must be as
        long.
    test_table, test_Y : DataFrame and targets, optional
        Flights to be judged on, with their targets.
    cv : splitter or iterable, optional
        Without test flights: what is held out of ``table``. Default: each flight in turn.
    n_samples : int, optional
        Rows to learn from in every training part, spread evenly (:func:`thin_targets`): then the parts differ in what
        was flown, not in how many samples there are. Default: the targets as they are.
    scoring : callable, str, list or dict, default=score_outputs
        As in ``cross_validate``.
    n_jobs : int, optional
        Points of the curve side by side, as in joblib.

    Returns
    -------
    DataFrame
        A row per point and split: ``seconds``, ``split``, ``n_samples`` (rows learned from), and a column per score.

    Raises
    ------
    ValueError
        If ``seconds`` are not positive or longer than every training flight, or it is not clear what to judge on: test
        flights and their targets, or ``cv``, or several flights.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from sklearn.compose import make_column_transformer
    >>> from sklearn.linear_model import LinearRegression
    >>> from sklearn.pipeline import make_pipeline
    >>> from skdgp.model_selection import flight_learning_curve
    >>> t = np.tile(np.arange(0.0, 60.0, 0.1), 2)
    >>> table = pd.DataFrame({"time": t, "flight": np.repeat(["a", "b"], 600), "alpha": 0.1 * np.sin(t**2 / 60)})
    >>> Y = pd.DataFrame({"CZ": -4.0 * table.alpha + 30 * table.alpha**3})
    >>> model = make_pipeline(make_column_transformer(("passthrough", ["alpha"])), LinearRegression())
    >>> curve = flight_learning_curve(model, table, Y, seconds=[5, 50])
    >>> curve[["seconds", "split", "n_samples"]].values.tolist()
    [[5.0, 0.0, 50.0], [5.0, 1.0, 50.0], [50.0, 0.0, 500.0], [50.0, 1.0, 500.0]]
    >>> curve.groupby("seconds")["normalized_rmse_CZ"].mean().is_monotonic_decreasing
    True
    """
    check_columns(check_table(table), ["time"])
    if test_table is not None and (test_Y is None or cv is not None):
        raise ValueError("Got a test_table, but expected its test_Y as well, and no cv: what else is held out?")
    everything = np.arange(len(table))
    splits = [(everything, None)] if test_table is not None else _held_out(cv, table)
    points = [(float(second), k) for second in np.atleast_1d(seconds) for k in range(len(splits))]
    parts = [_first(second, table, splits[k][0]) for second, k in points]
    judges = [
        (test_table, test_Y) if test_table is not None else (table.iloc[test], safe_indexing(Y, test))
        for _, test in splits
    ]
    scorer = check_scoring(estimator, scoring=scoring)
    scores = Parallel(n_jobs=n_jobs)(
        delayed(_fit_and_score)(estimator, table.iloc[rows], safe_indexing(Y, rows), *judges[k], n_samples, scorer)
        for (_, k), rows in zip(points, parts, strict=True)
    )
    return pd.concat([pd.DataFrame(points, columns=["seconds", "split"]), pd.DataFrame(scores)], axis=1)


def _fit_and_score(estimator, table, Y, test_table, test_Y, n_samples, scorer) -> dict:
    Y = Y if n_samples is None else thin_targets(Y, n_samples)
    scores = scorer(clone(estimator).fit(table, Y), test_table, test_Y)
    observed = np.isfinite(np.asarray(Y, dtype=float).reshape(len(Y), -1)).any(axis=1)
    return {"n_samples": int(observed.sum()), **(scores if isinstance(scores, dict) else {"score": scores})}


def _first(second: float, table: pd.DataFrame, train: np.ndarray) -> np.ndarray:
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
        raise ValueError(
            f"Got {second:g} s, but the longest training flight has {longest:g} s: beyond it the curve would be flat "
            "for want of data. Ask for fewer seconds."
        )
    return train[np.sort(np.concatenate(kept))]


def _held_out(cv, table: pd.DataFrame) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return pairs of training and test rows, of each flight in turn by default."""
    flights = rows_by_flight(table)
    if cv is None and len(flights) < 2:
        raise ValueError(
            "Got one flight, but expected several, of which each is held out in turn: give test_table and test_Y, or "
            "cv=BlockSplit()."
        )
    groups = np.empty(len(table), dtype=int)
    for code, rows in enumerate(flights.values()):
        groups[rows] = code
    return held_out(LeaveOneGroupOut() if cv is None else cv, table, groups)
