"""Calibration of standard deviations and intervals by held-out flights.

A model predicts standard deviations; held-out flights show its errors. Scaling the first by the
second gives intervals with a guaranteed coverage. The guarantee needs no normal distribution and no
correct model, only that the next flight is of the same kind as the flights of the calibration.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.stats import t as student
from sklearn.base import BaseEstimator, MetaEstimatorMixin, RegressorMixin, clone
from sklearn.model_selection import GroupKFold
from sklearn.utils import check_array, get_tags
from sklearn.utils.metaestimators import available_if
from sklearn.utils.parallel import Parallel, delayed
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import column_names
from skdgp._compute.predicting import accepts, predict_observed, predict_with_noise, unwrap
from skdgp._compute.sklearn_compat import (
    HasMethods,
    Interval,
    StrOptions,
    fit_context,
    safe_indexing,
)
from skdgp._compute.statistics import check_level, half_width
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp._flight.channels import EARTH_VELOCITY, EULER, RATES
from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_codes
from skdgp._flight.frames import wrapped
from skdgp._regressor import check_targets
from skdgp.dynamics import trajectory_bands
from skdgp.inference import Path, Paths
from skdgp.model_selection import BlockSplit

__all__ = ["CalibratedBands", "CalibratedRegressor"]

N_SPLITS = 5
MIN_ROWS = 6  # of a single flight, which is cut into two blocks of three rows
ROUNDING = 1e-9  # levels nearer than this are equal
GROUPS = {"velocity": EARTH_VELOCITY, "attitude": EULER, "rates": RATES}
ONE_SIGMA = 0.6827  # probability of a normal variable within one standard deviation of its mean


def _estimator_has(name: str) -> Callable[[Any], bool]:
    """Return a check of whether the estimator has a method, before and after ``fit``."""
    return lambda self: hasattr(unwrap(getattr(self, "estimator_", self.estimator)), name)


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

    Parameters
    ----------
    estimator : regressor or Pipeline
        Its ``predict`` takes ``return_std``.
    method : {"conformal", "variance"}, default="conformal"
        "variance" scales the mean squared score to one, with equal weight per flight, and assumes
        normal errors: it varies less with few flights, but has no guarantee.
    level : float, default=0.95
        Level at which the normal interval of the scaled standard deviation is the conformal one.
    cv : None, int, splitter, iterable or "prefit", default=None
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
        Unit of the guarantee: "block" if a splitter cuts flights; and K, the units in which each
        output was observed.
    calibration_scores_, calibration_units_ : ndarray (m, P), ndarray (m,) of int
        Scores of the held-out samples, NaN where an output was not observed, and their units.
    output_names_, n_features_in_, feature_names_in_
        Column names of Y, or y0, y1, ...; the others are those of the estimator.

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
        "method": [StrOptions({"conformal", "variance"})],
        "level": [Interval(Real, 0, 1, closed="neither")],
        "cv": ["cv_object", StrOptions({"prefit"})],
        "n_jobs": [Integral, None],
    }

    def __init__(
        self,
        estimator: Any,
        *,
        method: str = "conformal",
        level: float = 0.95,
        cv: Any = None,
        n_jobs: int | None = None,
    ) -> None:
        self.estimator = estimator
        self.method = method
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
        Y, self.output_names_, self._single = check_targets(y, len(X), type(self).__name__)
        y = y if column_names(y) else Y[:, 0] if self._single else Y
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
        self.guaranteed_ = (self.max_level_ >= self.level - ROUNDING) & (self.method == "conformal")
        self.std_scale_ = self._half_widths(self.level) / half_width(self.level)
        if self.method == "conformal" and not self.guaranteed_.all():
            few = ~self.guaranteed_
            names = [name for name, lacks in zip(self.output_names_, few, strict=True) if lacks]
            n, top = self.n_units_[few].min(), self.max_level_[few].min()
            warnings.warn(
                f"Got level={self.level:g}, but {n} {self.unit_}s guarantee no more than "
                f"{top:.3g}: the intervals of "
                f"{names} held as often on these {self.unit_}s, without a guarantee for the next. "
                f"Calibrate on "
                f"{units_needed(self.level)} {self.unit_}s or more, or set "
                f"level={np.floor(100 * top) / 100:g}.",
                stacklevel=4,
            )

    def _half_widths(self, level) -> np.ndarray:
        """Return half the width of the interval in standard deviations, (P,)."""
        widths = []
        for k, column in enumerate(self.calibration_scores_.T):
            rows = ~np.isnan(column)
            scores, weights = column[rows], unit_weights(self.calibration_units_[rows])
            if self.method == "variance":
                widths.append(half_width(level) * np.sqrt(weights @ scores**2))
            else:
                total = (
                    self.max_level_[k] if self.guaranteed_[k] else 1.0
                )  # the next flight weighs 1 / (K + 1)
                widths.append(weighted_quantile(scores, total * weights, level))
        return np.array(widths)

    def predict(
        self, X: Any, return_std: bool = False, include_noise: bool = True, return_cov: bool = False
    ) -> Any:
        """Return the mean at X (n, d), and on request its standard deviation or covariance, scaled; (n, P) or (n,).

        With ``return_std``, mean -/+ z std, z of the normal distribution, is the calibrated
        interval of probability ``level``: of a new measurement, as calibrated, or, without
        ``include_noise``, of the function, scaled alike. ``return_cov`` is the joint covariance (P
        n, P n) of the function at exact X, scaled alike. Raises ValueError if both are requested.
        """
        check_is_fitted(self)
        X, inside = _check_X(X), unwrap(self.estimator_)
        if return_cov:
            if return_std:
                raise ValueError("Got return_std and return_cov, but expected one of them.")
            exact = (
                {"include_input_noise": False}
                if accepts(self.estimator_, "include_input_noise")
                else {}
            )
            mean, covariance = inside.predict(X, return_cov=True, **exact)
            scale = np.repeat(self.std_scale_, len(mean))
            return mean, covariance * scale[:, None] * scale
        if not return_std:
            return self.estimator_.predict(X)
        mean, std = (
            predict_with_noise(inside, X) if include_noise else inside.predict(X, return_std=True)
        )
        return mean, std * (self.std_scale_ if std.ndim > 1 else self.std_scale_[0])

    @available_if(_estimator_has("predict_gradient"))
    def predict_gradient(self, X: Any, return_std: bool = False) -> Any:
        """Return the gradient of the mean at X (n, d), (n, P, d) or (n, d), and on request its scaled deviations."""
        check_is_fitted(self)
        found = unwrap(self.estimator_).predict_gradient(X, return_std=return_std)
        return (found[0], found[1] * np.asarray(self._scale)[..., None]) if return_std else found

    @available_if(_estimator_has("sample_paths"))
    def sample_paths(self, n_paths: int = 1, random_state: Seed = 0) -> ScaledPaths:
        """Draw functions from the posterior, as :meth:`skdgp.DependentGPRegressor.sample_paths`, scaled.

        A path f of a posterior with mean m becomes m + s (f - m), with s the output's
        ``std_scale_``.
        """
        check_is_fitted(self)
        regressor = unwrap(self.estimator_)
        return ScaledPaths(regressor.sample_paths(n_paths, random_state), regressor, self._scale)

    @property
    def drift_variance_(self) -> Array:
        """Variance of the estimator's drift in time, (P,), scaled; zero if it has none."""
        return self._of_estimator("drift_variance_") * self.std_scale_**2

    @property
    def drift_memory_(self) -> Array:
        """Memory of the estimator's drift, (P,)."""
        return self._of_estimator("drift_memory_")

    @property
    def misfit_variance_(self) -> Array:
        """Variance of the estimator's misfit, (P,), scaled; zero if it knows none."""
        return self._of_estimator("misfit_variance_") * self.std_scale_**2

    def _of_estimator(self, name) -> Array:
        return getattr(unwrap(self.estimator_), name, np.zeros(len(self.std_scale_)))

    @property
    def _scale(self):
        """Return the factors of the deviations: (P,), or a number for y of shape (n,)."""
        return self.std_scale_[0] if self._single else self.std_scale_

    def predict_interval(self, X: Any, level: float | None = None) -> tuple[Array, Array]:
        """Return lower and upper ends of calibrated intervals of new measurements at X (n, d), shaped as the mean.

        The default level is that of the constructor. Above the guaranteed level of outputs whose
        ``level`` is guaranteed, intervals are infinite, with a warning. Raises ValueError if
        ``level`` is not inside (0, 1).
        """
        check_is_fitted(self)
        level = check_level(self.level if level is None else level)
        widths = self._half_widths(level)
        if np.isinf(widths).any():
            warnings.warn(
                f"Got level={level:g}, but {self.n_units_.min()} {self.unit_}s guarantee no more "
                f"than "
                f"{self.max_level_.min():.3g}, so intervals are infinite: calibrate on "
                f"{units_needed(level)} of them, or lower the level.",
                stacklevel=2,
            )
        mean, std = predict_with_noise(self.estimator_, _check_X(X))
        half = std * (widths if std.ndim > 1 else widths[0])
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


class ScaledPaths(Sequence):
    """Paths f of a posterior with mean m, of a regressor, as m + scale (f - m): as `skdgp.inference.Paths`."""

    def __init__(self, paths: Paths, regressor: Any, scale: Any) -> None:
        self.paths, self.regressor, self.scale = paths, regressor, scale

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return ScaledPaths(self.paths[index], self.regressor, self.scale)
        k = range(len(self))[index]
        return Path(self[k : k + 1])

    def __call__(self, X: Any) -> Array:
        """Return the values of all paths at X (n, d): (n_paths, n, P), or (n_paths, n) for y of shape (n,)."""
        return self._scaled(X, self.paths(X), self.regressor.predict, self.scale)

    def each(self, X: Any) -> Array:
        """Return the values of each path at its own points, X (n_paths, n, d), in the shape of a call."""
        return self._scaled(X, self.paths.each(X), self.regressor.predict, self.scale)

    def gradient(self, X: Any) -> Array:
        """Return the gradients of all paths at X (n, d), or of each path at its own points, X (n_paths, n, d)."""
        scale = np.asarray(self.scale)[..., None]
        return self._scaled(X, self.paths.gradient(X), self.regressor.predict_gradient, scale)

    def _scaled(
        self, X: Any, values: Array, predict: Callable[[Array], Array], scale: Any
    ) -> Array:
        # A table of points for all paths has names, which predict expects.
        mean = (
            predict(X.reshape(-1, X.shape[-1])).reshape(values.shape)
            if np.ndim(X) == 3
            else predict(X)
        )
        return mean + scale * (values - mean)


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
    if not hasattr(cv, "split"):
        return list(cv)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="The groups parameter is ignored")
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
    warnings.warn(
        f"Got one flight, so {n_blocks} blocks of it replace flights: the calibration holds for "
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


@dataclass(frozen=True)
class CalibratedBands:
    r"""Bands that hold whole trajectories, from simulated ensembles and the flights that were recorded.

    A segment is a part of a recorded flight, simulated from its first row. Its score is, for each
    group of states, the largest error along it, over all its times and states,

    .. math:: \max_{t, i} |y_i(t) - m_i(t)| / s_i(t),

    with the median m of the ensemble and its deviation s: the distance from m to the 16 % or the 84
    % quantile, on the side of y. The band of a level is :math:`m \pm q s`, with q as in
    :class:`CalibratedRegressor`: with one segment of each of K flights the :math:`\lceil (K + 1) \,
    level \rceil`-th smallest score. If the next flight and the K others are exchangeable, the
    expected share of its segments whose states of the group stay in their bands from beginning to
    end is at least ``level``.

    **K flights guarantee no level above K / (K + 1).** Above it, with a warning, q is the largest
    score, or if larger Student's prediction bound of the logarithms x of the largest score of each
    flight, with their mean and standard deviation,

    .. math:: \log q = \bar{x} + t_{K - 1, level} \, s_x \sqrt{1 + 1 / K},

    which holds the level if these are normal, without a guarantee otherwise.

    Parameters
    ----------
    scores, units : DataFrame (n_segments, n_groups), ndarray (n_segments,) of int
        Score of each segment and group, and the exchangeable unit of each segment, from 0 on.
    unit : {"flight", "segment"}
        What the units are.
    groups, noise : mappings of str to sequence of str, and of str to float
        States of each group; standard deviations of the recorded states' errors.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.calibration import CalibratedBands
    >>> rng, time = np.random.default_rng(0), np.arange(5) / 10
    >>> def ensemble(n):
    ...     paths = [pd.DataFrame({"start": s, "path": p, "time": time, "q": time * rng.normal(), "ended": ""})
    ...              for s in range(n) for p in range(30)]
    ...     return pd.concat(paths, ignore_index=True)
    >>> recorded = [pd.DataFrame({"time": time, "flight": k, "q": 2 * time * rng.normal()}) for k in range(9)]
    >>> calibrated = CalibratedBands.from_flights(ensemble(9), recorded)
    >>> calibrated.max_level, 1 < calibrated.factors(0.9)["rates"] < 10
    (0.9, True)
    >>> list(calibrated.bands(ensemble(1), level=0.9))
    ['start', 'time', 'flying', 'q', 'q_low', 'q_high']
    """

    scores: pd.DataFrame
    units: np.ndarray
    unit: str
    groups: Mapping[str, Sequence[str]]
    noise: Mapping[str, float]

    @classmethod
    def from_flights(
        cls, ensemble: pd.DataFrame, recorded: Sequence[pd.DataFrame], *,
        groups: Mapping[str, Sequence[str]] | None = None, noise: Mapping[str, float] | None = None,
    ) -> CalibratedBands:  # fmt: skip
        """Return the bands that the errors of an ensemble on recorded segments ask for.

        Raises ValueError if there are fewer than two units, a segment is shorter than its
        trajectory or lacks a state, or an ensemble does not spread. Warns if segments of one flight
        are the units.

        Parameters
        ----------
        ensemble : DataFrame
            Of :func:`skdgp.dynamics.simulate` with ``n_paths``, from the first row of each segment,
            by a model that did not learn from these flights.
        recorded : list of DataFrame
            The segments in the order of the starts, with ``time`` [s] and the states. A column
            ``flight`` names their flights, which are the exchangeable units. Without it, or with
            one flight, segments are, only approximately: neighbours fly in the same air.
        groups : mapping of str to sequence of str, optional
            States of each group, which has bands of its own; by default velocity (v_north, v_east,
            v_down), attitude (phi, theta, psi) and rates (p, q, r), as far as they were recorded.
        noise : mapping of str to float, optional
            Standard deviations of the errors of recorded states, by name. They are part of s:
            without them the first rows, where an ensemble has not spread, decide. ``initial_std``
            of `simulate` is that of the starts.
        """
        names = {name for part in recorded for name in part}
        if groups is None:
            groups = {
                group: [name for name in states if name in names]
                for group, states in GROUPS.items()
            }
            groups = {group: states for group, states in groups.items() if states}
        bands = _one_sigma(ensemble, groups, noise := dict(noise or {}))
        if len(recorded) != len(bands):
            raise ValueError(
                f"Got {len(recorded)} recorded segments and {len(bands)} starts of the ensemble, "
                f"but expected one "
                "segment for each start."
            )
        scores = pd.DataFrame(
            [_group_scores(*pair, groups) for pair in zip(bands, recorded, strict=True)]
        )
        if len(recorded) < 2:
            raise ValueError(
                "Got one recorded segment, but expected at least two, of different flights."
            )
        codes, flights = flight_codes(
            [part["flight"].iloc[0] if "flight" in part else 0 for part in recorded]
        )
        if len(flights) > 1:
            return cls(scores, codes, "flight", groups, noise)
        warnings.warn(
            f"Got one flight, so its {len(recorded)} segments replace flights: the bands hold for "
            f"further segments "
            "of this flight, not for other flights. Give segments of several (column flight).",
            stacklevel=2,
        )
        return cls(scores, np.arange(len(recorded)), "segment", groups, noise)

    @property
    def n_units(self) -> int:
        """Number of exchangeable units, K."""
        return len(np.unique(self.units))

    @property
    def max_level(self) -> float:
        """Highest level with a guarantee, K / (K + 1)."""
        return self.n_units / (self.n_units + 1)

    def factors(self, level: float = 0.95) -> dict[str, float]:
        """Return q of each group; raise ValueError if the level is not inside (0, 1).

        Warns if there are too few flights to guarantee the level.
        """
        if check_level(level) <= self.max_level + ROUNDING:
            weights = self.max_level * unit_weights(self.units)
            return {
                str(name): weighted_quantile(s.to_numpy(), weights, level)
                for name, s in self.scores.items()
            }
        warnings.warn(
            f"Got level={level:g}, but {self.n_units} {self.unit}s guarantee no more than "
            f"{self.max_level:.3g}: the "
            f"bands assume that logarithms of their largest scores are normal. Calibrate on "
            f"{units_needed(level)} "
            f"{self.unit}s or more, or set level={np.floor(100 * self.max_level) / 100:g}.",
            stacklevel=2,
        )
        largest = np.log(self.scores.groupby(self.units).max())
        margin = (
            student.ppf(level, self.n_units - 1) * np.sqrt(1 + 1 / self.n_units) * largest.std()
        )
        bound = np.fmax(
            largest.max(), largest.mean() + margin
        )  # without a standard deviation one is infinite
        return {str(name): float(q) for name, q in np.exp(bound).items()}

    def bands(self, ensemble: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
        """Return the calibrated bands of other trajectories, in the form of :func:`skdgp.dynamics.trajectory_bands`.

        The ensemble of :func:`skdgp.dynamics.simulate` is as long as the segments or shorter. Where
        ``noise`` was given, bands are those of records. Errors and warnings are those of
        :meth:`factors`.
        """
        factors = self.factors(level)
        table = pd.concat(_one_sigma(ensemble, self.groups, self.noise), ignore_index=True)
        for group, states in self.groups.items():
            for name in states:
                for end in ("_low", "_high"):
                    table[name + end] = table[name] + factors[group] * (
                        table[name + end] - table[name]
                    )
        return table


def _one_sigma(ensemble: pd.DataFrame, groups: Mapping, noise: Mapping) -> list[pd.DataFrame]:
    """Return the median of the states and its distance from 16 and 84 % quantiles, noise included, of each start."""
    states = [name for names in groups.values() for name in names]
    check_columns(ensemble, states, what="ensemble")
    table = trajectory_bands(ensemble, ONE_SIGMA, states)
    for name in states:
        for end, sign in (("_low", -1), ("_high", 1)):
            table[name + end] = table[name] + sign * np.hypot(
                table[name + end] - table[name], noise.get(name, 0.0)
            )
    return [band.reset_index(drop=True) for _, band in table.groupby("start", sort=True)]


def _group_scores(band: pd.DataFrame, recorded: pd.DataFrame, groups: Mapping) -> dict[str, float]:
    """Return the largest error over deviation of each group, after the first row; infinite where no path flies."""
    check_columns(
        recorded,
        ["time", *(name for names in groups.values() for name in names)],
        what="recorded segment",
    )
    time = recorded["time"].to_numpy(float)
    at = band["time"].to_numpy(float) - band["time"].iloc[0] + time[0]
    if at[-1] > time[-1] + 1e-6:
        raise ValueError(
            f"Got a recorded segment of {np.ptp(time):g} s for a trajectory of {np.ptp(at):g} s, "
            f"but expected records "
            "to its end: simulate a shorter duration."
        )

    def score(name: str) -> float:
        values = recorded[name].to_numpy(float)
        observed = np.isfinite(values)
        if not observed.any():
            raise ValueError(
                f"Got a recorded segment without a value of {name}, but expected some."
            )
        values = np.unwrap(values[observed]) if name in EULER else values[observed]
        error = np.interp(at, time[observed], values) - band[name]
        error = wrapped(error) if name in EULER else error
        spread = np.where(
            error > 0, band[name + "_high"] - band[name], band[name] - band[name + "_low"]
        )[1:]
        if (spread == 0).any():
            raise ValueError(
                f"Got an ensemble in which {name} does not spread, but expected several paths: "
                f"simulate with n_paths."
            )
        return float(np.max(np.nan_to_num(np.abs(error[1:]) / spread, nan=np.inf)))

    return {group: max(map(score, names)) for group, names in groups.items()}
