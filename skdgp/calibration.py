"""Calibration of standard deviations and intervals by held-out flights.

A model predicts standard deviations; held-out flights show its errors. Scaling the first by the
second gives intervals with a guaranteed coverage. The guarantee needs no normal distribution and no
correct model, only that the next flight is of the same kind as the flights of the calibration.
"""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, MetaEstimatorMixin, RegressorMixin, clone
from sklearn.model_selection import GroupKFold
from sklearn.utils import check_array, get_tags
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import column_names
from skdgp._compute.messages import warn
from skdgp._compute.predicting import predict_observed, predict_with_noise, unwrap
from skdgp._compute.sklearn_compat import (
    HasMethods,
    Interval,
    StrOptions,
    fit_context,
    safe_indexing,
)
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.clock import flight_codes
from skdgp._regressor import check_targets
from skdgp.model_selection import BlockSplit

__all__ = ["CalibratedRegressor"]

N_SPLITS = 5
MIN_ROWS = 6  # of a single flight, which is cut into two blocks of three rows
ROUNDING = 1e-9  # levels nearer than this are equal


class CalibratedRegressor(MetaEstimatorMixin, RegressorMixin, BaseEstimator):
    r"""Scale the standard deviations of a regressor, output by output, by the errors on held-out flights.

    Each held-out sample has a score :math:`|y - m| / s`: m and s are the mean and the standard
    deviation, measurement noise included, of a model that did not learn from its flight. The
    interval of a level is :math:`m \pm q s`. Samples of one flight are dependent, so flights have
    equal weight: with K flights and :math:`n_k` scores in flight k, q is the least number with

    .. math:: \sum_k \frac{1}{(K + 1) \, n_k} \, \#\{i : score_{ki} \le q\} \ge level

    (hierarchical conformal prediction: Lee, Barber & Willett 2023; Dunn, Wasserman & Ramdas 2023).
    If the next flight and the K others are exchangeable, the expected share of its samples inside
    the interval is at least ``level``, for every model, distribution of errors and dependence
    within a flight. The share of one flight may be smaller. The guarantee is exact with
    ``cv="prefit"``; in cross-validation, where predictions come from a model of all flights,
    intervals are mostly too wide, though no theorem says so.

    **K flights guarantee no level above K / (K + 1)**: two 0.67, four 0.8, nineteen 0.95. Above it
    ``fit`` warns, and q is the quantile of the observed scores with equal weight per flight:
    consistent as K grows (Dunn et al., section 3), without a guarantee for small K.

    Only bands of predictions are scaled: a simulation flies the mean. Paths, slopes and covariances
    are of ``estimator_``.

    Parameters
    ----------
    estimator : regressor or Pipeline
        Its ``predict`` takes ``return_std``.
    level : float, default=0.95
        Level at which the normal interval of the scaled standard deviation is the conformal one.
    cv : None, int, splitter or "prefit", default=None
        None or int: hold out whole flights, in 5 or ``cv`` folds (``GroupKFold``). A single flight
        is cut into as many blocks, 2 s apart (``BlockSplit``), with a warning: the guarantee is
        then for further blocks of that flight. "prefit": the estimator is fitted, and ``fit`` gets
        flights that it did not learn from.
    n_jobs : int or None, default=None
        Fits of the cross-validation that run in parallel, as in joblib.

    Attributes
    ----------
    estimator_ : estimator
        Fitted on all flights; with ``cv="prefit"`` the given one.
    std_scale_ : ndarray (P,)
        Factors of the standard deviations: above 1, they were too small.
    guaranteed_, max_level_ : ndarray (P,) of bool, ndarray (P,)
        Whether ``level`` is guaranteed; K / (K + 1), the highest guaranteed level.
    unit_, n_units_ : {"flight", "block"}, ndarray (P,) of int
        Unit of the guarantee: "block" if a splitter cuts flights; and K, the number of units that
        observed each output.
    calibration_scores_, calibration_units_ : ndarray (m, P), ndarray (m,) of int
        Scores of the held-out samples, NaN where an output was not observed, and their units.
    output_names_, n_features_in_, feature_names_in_
        Column names of Y, or y0, y1, ...; the others are the estimator's.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import BayesianRidge
    >>> from skdgp.calibration import CalibratedRegressor
    >>> rng = np.random.default_rng(0)
    >>> flight = np.repeat(np.arange(20), 50)
    >>> X = rng.normal(size=(1000, 1))
    >>> y = X[:, 0] + 0.1 * rng.normal(size=1000) + 0.3 * rng.normal(size=20)[flight]  # an offset per flight
    >>> model = CalibratedRegressor(BayesianRidge(), level=0.9).fit(X, y, groups=flight)
    >>> mean, std = model.predict(X, return_std=True)
    >>> lower, upper = model.predict_interval(X)
    >>> bool(np.mean((lower <= y) & (y <= upper)) >= 0.9), bool(model.guaranteed_[0]), model.unit_
    (True, True, 'flight')
    """

    acts_on_outputs = True  # see skdgp.dynamics.as_aerodynamics
    _parameter_constraints: dict = {
        "estimator": [HasMethods(["fit", "predict"])],
        "level": [Interval(Real, 0, 1, closed="neither")],
        "cv": [
            Interval(Integral, 2, None, closed="left"),
            HasMethods(["split", "get_n_splits"]),
            StrOptions({"prefit"}),
            None,
        ],
        "n_jobs": [Integral, None],
    }

    def __init__(
        self,
        estimator: Any,
        *,
        level: float = 0.95,
        cv: Any = None,
        n_jobs: int | None = None,
    ) -> None:
        self.estimator = estimator
        self.level = level
        self.cv = cv
        self.n_jobs = n_jobs

    def __sklearn_tags__(self):
        tags, inner = super().__sklearn_tags__(), get_tags(self.estimator)
        for name in ("input_tags", "target_tags", "regressor_tags"):
            setattr(tags, name, getattr(inner, name))
        return tags

    @fit_context(prefer_skip_nested_validation=False)
    def fit(self, X: Any, y: Any, groups: Any = None, **fit_params: Any) -> Self:
        """Score held-out flights, then fit on all flights.

        X (n, d) are regressors, or the flights of an identification pipeline. Its column ``flight``
        names flights; a single flight is cut into blocks by its column ``time`` [s], or by rows
        without a gap. Targets y (n,) or (n, P) are NaN where an output was not observed. ``groups``
        (n,) are exchangeable units in place of the column ``flight``, such as the day. Parameters
        of the estimator's ``fit``, such as ``time``, have a value for each row.

        Raises TypeError if the estimator predicts no standard deviation, ValueError if there are
        too few rows or an output has no held-out observation. Warns if there is one flight, or too
        few to guarantee ``level``.
        """
        X = _check_X(X)
        Y, self.output_names_, is_single = check_targets(y, len(X), type(self).__name__)
        y = y if column_names(y) else Y[:, 0] if is_single else Y
        flights = _flight_table(X, groups)
        splits = _splits_of(flights, self.cv)
        if isinstance(self.cv, str):
            check_is_fitted(self.estimator)
            self.estimator_ = self.estimator
            all_scores = _scores(self.estimator, X, Y)
            scores = [all_scores[test] for _, test in splits]
        else:
            fits = (
                delayed(_fit_and_score)(self.estimator, X, y, Y, *rows, fit_params)
                for rows in splits
            )
            scores = Parallel(n_jobs=self.n_jobs)(fits)
            self.estimator_ = clone(self.estimator).fit(X, y, **fit_params)
        self.unit_, units = _units_of([test for _, test in splits], flights["flight"].to_numpy())
        self._calibrate(np.concatenate(scores), units)
        return self

    def _calibrate(self, scores, units):
        """Set the scores, the guaranteed levels and the scale factors."""
        observed = ~np.isnan(scores).all(axis=1)
        self.calibration_scores_ = scores[observed]
        self.calibration_units_ = units = np.unique(units[observed], return_inverse=True)[1]
        self.n_units_ = np.array(
            [len(np.unique(units[~np.isnan(column)])) for column in self.calibration_scores_.T]
        )
        never = [name for name, n in zip(self.output_names_, self.n_units_, strict=True) if not n]
        if never:
            raise ValueError(
                f"Got no value of the outputs {never} in held-out flights, but expected some to "
                f"calibrate on: leave "
                "these outputs out, or observe them in more flights."
            )
        self.max_level_ = self.n_units_ / (self.n_units_ + 1)
        self.guaranteed_ = self.max_level_ >= self.level - ROUNDING
        self.std_scale_ = self._half_widths() / half_width(self.level)
        if not self.guaranteed_.all():
            few = ~self.guaranteed_
            names = [name for name, lacks in zip(self.output_names_, few, strict=True) if lacks]
            n, top = self.n_units_[few].min(), self.max_level_[few].min()
            warn(
                f"Got level={self.level:g}, but {n} {self.unit_}s guarantee no more than "
                f"{top:.3g}: the intervals of "
                f"{names} held as often on these {self.unit_}s, without a guarantee for the next. "
                f"Calibrate on "
                f"{units_needed(self.level)} {self.unit_}s or more, or set "
                f"level={np.floor(100 * top) / 100:g}.",
                stacklevel=4,
            )

    def _half_widths(self) -> np.ndarray:
        """Return half the width of the interval of the level in standard deviations, (P,)."""
        widths = []
        for k, column in enumerate(self.calibration_scores_.T):
            rows = ~np.isnan(column)
            scores, weights = column[rows], unit_weights(self.calibration_units_[rows])
            # the next flight weighs 1 / (K + 1)
            total = self.max_level_[k] if self.guaranteed_[k] else 1.0
            widths.append(weighted_quantile(scores, total * weights, self.level))
        return np.array(widths)

    def predict(self, X: Any, return_std: bool = False, include_noise: bool = True) -> Any:
        """Return the mean at X (n, d), and on request its scaled standard deviation; (n, P) or (n,).

        With ``return_std``, mean -/+ z std, z of the normal distribution, is the calibrated
        interval of probability ``level``: of a new measurement, as calibrated, or, without
        ``include_noise``, of the function, scaled alike.
        """
        check_is_fitted(self)
        X, inside = _check_X(X), unwrap(self.estimator_)
        if not return_std:
            return self.estimator_.predict(X)
        mean, std = (
            predict_with_noise(inside, X) if include_noise else inside.predict(X, return_std=True)
        )
        return mean, std * (self.std_scale_ if std.ndim > 1 else self.std_scale_[0])

    def predict_interval(self, X: Any) -> tuple[Array, Array]:
        """Return lower and upper ends of intervals of ``level`` of new measurements at X (n, d), shaped as the mean."""
        mean, std = self.predict(X, return_std=True)
        half = half_width(self.level) * std
        return mean - half, mean + half

    def score(self, X: Any, y: Any, sample_weight: Any = None) -> float:
        """Return the score of the fitted estimator, whose means are unchanged."""
        check_is_fitted(self)
        weight = {} if sample_weight is None else {"sample_weight": sample_weight}
        return self.estimator_.score(_check_X(X), y, **weight)

    @property
    def n_features_in_(self) -> int:
        """Number of features, of the fitted estimator."""
        return self.estimator_.n_features_in_

    @property
    def feature_names_in_(self) -> np.ndarray:
        """Names of the features, of the fitted estimator."""
        return self.estimator_.feature_names_in_


def _check_X(X: Any) -> Any:
    """Return a table as it is, any other input as an array of numbers."""
    return X if hasattr(X, "columns") else check_array(X, ensure_all_finite=False)


def _flight_table(X: Any, groups: Any) -> pd.DataFrame:
    """Return the number of each row's flight, and its time where X has one."""
    n, columns = len(X), getattr(X, "columns", ())
    ids = groups if groups is not None else X["flight"] if "flight" in columns else np.zeros(n)
    codes, _ = flight_codes(ids)
    if len(codes) != n:
        raise ValueError(
            f"Got {len(codes)} flight identifiers for {n} rows, but expected one for each row."
        )
    table = pd.DataFrame({"flight": codes})
    return table.assign(time=X["time"].to_numpy(dtype=float)) if "time" in columns else table


def _splits_of(flights: pd.DataFrame, cv: Any) -> list[tuple[Indices, Indices]]:
    """Return the training and held-out rows of each split; a fitted model uses the held-out rows only."""
    groups, rows = flights["flight"], np.arange(len(flights))
    if cv is None or isinstance(cv, Integral | str):
        if groups.nunique() < 2:
            return _blocks_of_one_flight(flights, cv)
        if cv == "prefit":
            return [(rows[:0], rows)]
        cv = GroupKFold(min(N_SPLITS, groups.nunique()) if cv is None else cv)
    return list(cv.split(flights, groups=groups))


def _blocks_of_one_flight(flights: pd.DataFrame, cv: Any) -> list[tuple[Indices, Indices]]:
    n = len(flights)
    if n < MIN_ROWS:
        raise ValueError(
            f"Got n_samples={n} of one flight, but expected at least {MIN_ROWS}, to hold some "
            f"out: give more rows, "
            "or several flights (column flight, or groups)."
        )
    n_blocks = cv if isinstance(cv, Integral) else min(N_SPLITS, n // 3)
    warn(
        f"Got one flight, so {n_blocks} of its blocks replace flights: the calibration holds for "
        f"further blocks of this "
        "flight, not for other flights. Give several (column flight, or groups).",
        stacklevel=5,
    )
    gap = (
        2.0 if "time" in flights and cv != "prefit" else 0.0
    )  # seconds between training and held-out rows
    flights = flights if "time" in flights else flights.assign(time=np.arange(n, dtype=float))
    return list(BlockSplit(int(n_blocks), gap=gap).split(flights))


def _fit_and_score(
    estimator: Any, X: Any, y: Any, Y: Matrix, train: Indices, test: Indices, fit_params: dict
) -> Matrix:
    """Return the scores of held-out rows, by a model that did not learn from them."""
    params = {name: safe_indexing(values, train) for name, values in fit_params.items()}
    fitted = clone(estimator).fit(safe_indexing(X, train), safe_indexing(y, train), **params)
    return _scores(fitted, safe_indexing(X, test), Y[test])


def _scores(estimator: Any, X: Any, Y: Matrix) -> Matrix:
    """Return ``|y - mean| / std``, (n, P); NaN where not observed."""
    rows, mean, std = predict_observed(estimator, X, Y, with_std=True)
    scores = np.full(Y.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        scores[rows] = np.abs(Y[rows] - mean.reshape(len(rows), -1)) / std.reshape(len(rows), -1)
    return scores


def _units_of(tests: list[Indices], flights: Indices) -> tuple[str, Indices]:
    """Return the exchangeable unit, flight or, if a split cuts one, block; and the unit of each held-out row.

    ``tests`` holds the held-out rows of each split, ``flights`` the flight of every row, from 0 on.
    """
    sizes = np.bincount(flights)
    counts = np.array([np.bincount(flights[test], minlength=len(sizes)) for test in tests])
    is_whole = len(sizes) > 1 and ((counts == 0) | (counts == sizes)).all()
    units = [flights[test] + (0 if is_whole else k * len(sizes)) for k, test in enumerate(tests)]
    return "flight" if is_whole else "block", np.concatenate(units)


def unit_weights(units: Indices) -> Vector:
    """Return weights of samples that sum to one, with equal sums for all units."""
    counts = np.bincount(units)
    return 1.0 / (counts[units] * np.count_nonzero(counts))


def weighted_quantile(scores: Vector, weights: Vector, level: float) -> float:
    """Return the least score whose cumulative weight is ``level``."""
    order = np.argsort(scores)
    return float(scores[order][np.searchsorted(np.cumsum(weights[order]), level - ROUNDING)])


def units_needed(level: float) -> int:
    """Return K, the least number of units with K / (K + 1) >= level."""
    return int(np.ceil(level / (1 - level) - ROUNDING))
