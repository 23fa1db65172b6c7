"""Evaluation of a fitted model on one flight."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS, EULER, LATERAL, LONGITUDINAL, TRUTH_SUFFIX
from skdgp._flight.clock import flight_segments
from skdgp._flight.smoothing import noise_level
from skdgp.dynamics import aerodynamic_coefficients, replay, replay_errors
from skdgp.identification import flight_regressors
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)

STD_ROWS = 3000
"""Rows of a flight at which standard deviations are computed; they cost N^2 each, means only N."""
STATES = ("north", "east", "v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r")


@dataclass(frozen=True)
class Loads:
    """What is taken away from the forces on the aircraft before they are called aerodynamic."""

    thrust: str | None = "auto"
    external_forces: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, thrust: str | None, external_forces) -> Loads:
        """Return the loads as options say them."""
        return cls(None if thrust == "none" else thrust, list(external_forces))

    def keywords(self) -> dict:
        """Return the keywords of ``aerodynamic_coefficients`` and ``replay``."""
        return {"thrust": self.thrust, "external_forces": self.external_forces}


@dataclass(frozen=True)
class Evaluation:
    """Predictions of one flight, (n, 6) each, and how they replay.

    ``std`` is of the function at regressors as noisy as this flight's, ``measured_std`` of a new measurement: computed
    at ``rows``, interpolated between.
    ``states`` maps "measured" and, where it is known, "truth" to the errors of the replay. ``regressors`` (n, d) are
    what the last step of the pipeline was given.
    """

    name: str
    table: pd.DataFrame
    measured: np.ndarray
    truth: np.ndarray | None
    mean: np.ndarray
    std: np.ndarray
    measured_std: np.ndarray
    rows: np.ndarray
    replay: pd.DataFrame | None
    states: dict[str, pd.DataFrame]
    regressors: np.ndarray


def evaluate(pipeline, aircraft, name: str, table: pd.DataFrame, *, loads: Loads, horizons) -> Evaluation:
    """Predict a flight and replay it."""
    measured = aerodynamic_coefficients(table, aircraft, **loads.keywords()).to_numpy()
    (regressors, times), regressor = flight_regressors(pipeline, table), pipeline[-1]
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    std = regressor.predict(regressors[rows], return_std=True, include_input_noise=times[rows])[1]
    std = _between(len(table), rows, std)
    measured_std = np.sqrt(std**2 + regressor.noise_variance_)
    flown = _replay(name, table, aircraft, mean, measured_std, loads, horizons)
    states = _state_errors(flown, table)
    return Evaluation(name, table, measured, _truth(table), mean, std, measured_std, rows, flown, states, regressors)


def scores(evaluations: Sequence[Evaluation]) -> dict[str, pd.DataFrame]:
    """Return coefficients by metrics, over all rows of the flights, against "measured" and "truth" if all know it.

    What needs a standard deviation is taken over the rows where that was computed.
    """
    pairs = {"measured": ("measured", "measured_std"), "truth": ("truth", "std")}
    if any(evaluation.truth is None for evaluation in evaluations):
        del pairs["truth"]
    return {against: _scores(evaluations, *names) for against, names in pairs.items()}


def grouped(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame({group: table.loc[list(members)].mean() for group, members in groups.items()}).T


def _truth(table) -> np.ndarray | None:
    names = [name + TRUTH_SUFFIX for name in COEFFICIENTS]
    return table[names].to_numpy(float) if all(name in table for name in names) else None


def _between(n, rows, values) -> np.ndarray:
    return np.column_stack([np.interp(np.arange(n), rows, column) for column in values.T])


def _scores(evaluations, of, std) -> pd.DataFrame:
    def joined(name, some):
        parts = [getattr(one, name)[one.rows] if some else getattr(one, name) for one in evaluations]
        return np.concatenate(parts)

    columns = {}
    for metric in (median_relative_error, normalized_rmse):
        columns[metric.__name__] = metric(joined(of, False), joined("mean", False), multioutput="raw_values")
    for metric in (negative_log_predictive_density, interval_coverage):
        values = (joined(name, True) for name in (of, "mean", std))
        columns[metric.__name__] = metric(*values, multioutput="raw_values")
    return pd.DataFrame(columns, index=list(COEFFICIENTS))


def _replay(name, table, aircraft, mean, std, loads, horizons) -> pd.DataFrame | None:
    velocity = ["u", "v", "w"] if {"u", "v", "w"} <= set(table.columns) else ["v_north", "v_east", "v_down"]
    lacking = [column for column in [*EULER, *velocity] if column not in table]
    if lacking:
        warnings.warn(
            f"Flight {name!r} is not replayed: it lacks {lacking}, from which the integration would start.",
            UserWarning,
            stacklevel=3,
        )
        return None
    _warn_of_long(horizons, name, table)
    return replay(
        table, aircraft, mean, std=std, horizon=horizons, initial_std=_sensor_noise(table), **loads.keywords()
    )


def _warn_of_long(horizons, name, table):
    time = table["time"].to_numpy(float)
    lasts = max(time[run][-1] - time[run][0] for run in flight_segments(time))
    long = [horizon for horizon in horizons if horizon > lasts]
    if long:
        warnings.warn(
            f"Flight {name!r} lasts {lasts:.3g} s without a gap, so the replay never reaches --horizons "
            f"{' '.join(f'{horizon:g}' for horizon in long)}: it runs to the end of each stretch.",
            UserWarning,
            stacklevel=4,
        )


def _sensor_noise(table) -> dict[str, float]:
    """Return the white noise of the measured states: how uncertain a restart from them is.

    Where the spectrum of a short flight does not tell it, second differences do: those of white noise have
    1 + 4 + 1 = 6 times its variance. Motion adds to them, so the noise is rather over- than understated.
    """
    names = [name for name in STATES if name in table]
    values = table[names].to_numpy(float).copy()
    for j, name in enumerate(names):
        if name in EULER:
            known = np.isfinite(values[:, j])
            values[known, j] = np.unwrap(values[known, j])
    time = table["time"].to_numpy(float)
    found = noise_level(values, time).measured
    found = np.where(np.isfinite(found), found, _rough_noise(values, time))
    return {name: float(level) for name, level in zip(names, found, strict=True)}


def _rough_noise(values, time) -> np.ndarray:
    """Return the root mean square of second differences over sqrt(6), (k,); 0 of less than three rows in a run."""
    curls = [np.diff(values[run], 2, axis=0) for run in flight_segments(time)]
    squares = np.concatenate(curls) ** 2
    known = np.isfinite(squares)
    return np.sqrt(np.where(known, squares, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1) / 6.0)


def _state_errors(flown, table) -> dict[str, pd.DataFrame]:
    if flown is None:
        return {}
    errors = {"measured": replay_errors(flown, table)}
    if "v_east" + TRUTH_SUFFIX in table:
        errors["truth"] = replay_errors(flown, table, suffix=TRUTH_SUFFIX)
    return errors
