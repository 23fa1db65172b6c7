"""What a fitted model says of one flight, and how right it is."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from skdgp._signal import noise_level
from skdgp._vocabulary import COEFFICIENTS, LATERAL, LONGITUDINAL, TRUTH_SUFFIX
from skdgp.dynamics import aerodynamic_coefficients, replay, replay_errors
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)

STD_ROWS = 3000
"""Rows of a flight at which standard deviations are computed; they cost N^2 each, means only N."""
STATES = ("north", "east", "v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r")
ANGLES = ("phi", "theta", "psi")


@dataclass(frozen=True)
class Loads:
    """What is taken away from the forces on the aircraft before they are called aerodynamic."""

    thrust: str | None = "auto"
    external_forces: list[str] = field(default_factory=list)

    def keywords(self) -> dict:
        """Return the keywords of ``aerodynamic_coefficients`` and ``replay``."""
        return {"thrust": self.thrust, "external_forces": self.external_forces}


@dataclass(frozen=True)
class Evaluation:
    """Predictions of one flight, (n, 6) each, and their scores.

    ``std`` is of the function, ``measured_std`` of a new measurement; both computed at every ``std_step``-th row
    and interpolated between. ``scores`` and ``states`` map "measured" and, where it is known, "truth" to tables.
    """

    name: str
    table: pd.DataFrame
    measured: np.ndarray
    truth: np.ndarray | None
    mean: np.ndarray
    std: np.ndarray
    measured_std: np.ndarray
    std_step: int
    scores: dict[str, pd.DataFrame]
    replay: pd.DataFrame | None
    states: dict[str, pd.DataFrame]


def evaluate(pipeline, aircraft, name: str, table: pd.DataFrame, *, loads: Loads, horizons) -> Evaluation:
    """Predict a flight, replay it, and score both."""
    measured = aerodynamic_coefficients(table, aircraft, **loads.keywords()).to_numpy()
    truth = _truth(table)
    regressors, regressor = pipeline[:-1].transform(table), pipeline[-1]
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    some = regressor.predict(regressors[rows], return_std=True)[1]
    std = _between(len(table), rows, some)
    noise = regressor.noise_variance_
    scores = {"measured": _scores(measured, mean, np.sqrt(some**2 + noise), rows)}
    if truth is not None:
        scores["truth"] = _scores(truth, mean, some, rows)
    measured_std = np.sqrt(std**2 + noise)
    flown = _replay(name, table, aircraft, mean, measured_std, loads, horizons)
    return Evaluation(
        name, table, measured, truth, mean, std, measured_std, step, scores, flown, _state_errors(flown, table)
    )


def grouped(scores: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame({group: scores.loc[list(members)].mean() for group, members in groups.items()}).T


def _truth(table) -> np.ndarray | None:
    names = [name + TRUTH_SUFFIX for name in COEFFICIENTS]
    return table[names].to_numpy(float) if all(name in table for name in names) else None


def _between(n, rows, values) -> np.ndarray:
    return np.column_stack([np.interp(np.arange(n), rows, column) for column in values.T])


def _scores(y, mean, std, rows) -> pd.DataFrame:
    """Return coefficients by metrics; those that need a standard deviation over the rows where it was computed."""
    if np.isnan(y[rows]).all(axis=0).any():
        warnings.warn("Some coefficients have no measured value to be scored against.", UserWarning, stacklevel=2)
    raw = {"multioutput": "raw_values"}
    columns = {metric.__name__: metric(y, mean, **raw) for metric in (median_relative_error, normalized_rmse)}
    for metric in (negative_log_predictive_density, interval_coverage):
        columns[metric.__name__] = metric(y[rows], mean[rows], std, **raw)
    return pd.DataFrame(columns, index=list(COEFFICIENTS))


def _replay(name, table, aircraft, mean, std, loads, horizons) -> pd.DataFrame | None:
    velocity = ["u", "v", "w"] if {"u", "v", "w"} <= set(table.columns) else ["v_north", "v_east", "v_down"]
    lacking = [column for column in [*ANGLES, *velocity] if column not in table]
    if lacking:
        warnings.warn(
            f"Flight {name!r} is not replayed: it lacks {lacking}, from which the integration would start.",
            UserWarning,
            stacklevel=3,
        )
        return None
    return replay(
        table, aircraft, mean, std=std, horizon=horizons, initial_std=_sensor_noise(table), **loads.keywords()
    )


def _sensor_noise(table) -> dict[str, float]:
    """Return the white noise of the measured states: how uncertain a restart from them is."""
    names = [name for name in STATES if name in table]
    values = table[names].to_numpy(float).copy()
    for j, name in enumerate(names):
        if name in ANGLES:
            known = np.isfinite(values[:, j])
            values[known, j] = np.unwrap(values[known, j])
    found = noise_level(values, table["time"].to_numpy(float)).measured
    return {name: float(level) for name, level in zip(names, np.nan_to_num(found), strict=True)}


def _state_errors(flown, table) -> dict[str, pd.DataFrame]:
    if flown is None:
        return {}
    errors = {"measured": replay_errors(flown, table)}
    if "v_east" + TRUTH_SUFFIX in table:
        errors["truth"] = replay_errors(flown, table, suffix=TRUTH_SUFFIX)
    return errors
