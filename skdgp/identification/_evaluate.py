"""Predictions of test flights, and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.messages import notify
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    COEFFICIENTS,
    TRUTH_SUFFIX,
)
from skdgp._flight.smoothing import band_limited, without_vibration
from skdgp._flight.tables import FlightTable, interpolated
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._log_errors import by_least_squares
from skdgp.identification._pipeline import (
    FlightPipeline,
    band_of,
    flight_regressors,
    named_regressors,
    reconstruction_of,
)
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)

CONTROL_DERIVATIVES = ("Cm_elevator", "Cl_aileron", "Cn_rudder")
MOST_STD_ROWS = 3000  # rows of a flight at which standard deviations are computed
# scores by the names of their columns in summary and report
SHOWN = {
    "median_relative_error": "rel. error",
    "normalized_rmse": "NRMSE",
    "interval_coverage": "in 95 % band",
}


class Thresholds(NamedTuple):
    """What counts as good enough (docs/judging.md, with the sources)."""

    # Largest error over the spread of the coefficients: Theil's coefficient is then 0.27, and 0.25
    # to 0.3 count as good agreement (Jategaonkar 2006, chapter 11).
    error: float = 0.5
    coverage: float = 0.90  # smallest share of measured values in a 95 % band (guess)
    # Smallest share of measured values in a 95 % band of each coefficient for a controller: bands of
    # derivatives are of the same model (guess)
    held: float = 0.80
    widest: float = 0.99  # larger share, which marks bands as too wide (guess)
    # Largest half-width of a 95 % band over its value: a gain margin of 6 dB (MIL-F-9490D) bears
    # half the gain.
    band: float = 0.5
    seconds: float = 1.0  # shortest simulation that is of use [s] (guess)
    # Least seconds and rows for each regressor to learn from: below, the uses are unknown (guesses)
    flown: float = 30.0
    rows: float = 10.0
    tie: float = 0.02  # errors that differ by less than this share are equal (guess)


THRESHOLDS = Thresholds()


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Predictions for one flight.

    Parameters
    ----------
    name : str
        What to call it.
    table : DataFrame
        The flight table, for the inputs and the path.
    states : DataFrame
        The same with states and wind of the reconstructed path, where the flight was reconstructed.
    measured, mean, std : (n, 6)
        Measured CX CY CZ Cl Cm Cn, smoothed by the flight's own spectra, or in the band of the fit where
        that one vibrated; NaN = not observed; estimated ones, and their deviations without noise.
    prediction_std : (n, 6)
        Standard deviations of such measurements, which have the same errors of the log.
    regressors : (n, d)
        Inputs of the last step of the pipeline.
    baseline : (n, 6)
        Coefficients that least squares on the same rows predict.
    truth : (n, 6), optional
        Noise-free coefficients of a simulation.
    """

    name: str
    table: pd.DataFrame
    states: pd.DataFrame
    measured: Matrix
    mean: Matrix
    std: Matrix
    prediction_std: Matrix
    regressors: Matrix
    baseline: Matrix
    truth: Matrix | None = None


def scores(flights: Sequence[Evaluation]) -> dict[str, pd.DataFrame]:
    """Return coefficients by metrics, over all rows of the flights, against "measured" and "truth" if all know it."""
    measured = [flight.measured for flight in flights]
    bands = [flight.prediction_std for flight in flights]
    against = {"measured": _scores(flights, measured, bands)}
    if all(flight.truth is not None for flight in flights):
        true: list[Any] = [flight.truth for flight in flights]
        against["truth"] = _scores(flights, true, [flight.std for flight in flights])
    return against


def _scores(
    flights: Sequence[Evaluation], expected: Sequence[Matrix], stds: Sequence[Matrix]
) -> pd.DataFrame:
    """Return coefficients by metrics: errors against expected values, and how bands hold these."""
    true = np.concatenate(expected)
    mean = np.concatenate([flight.mean for flight in flights])
    linear = np.concatenate([flight.baseline for flight in flights])
    bands = true, mean, np.concatenate(stds)
    each: dict[str, Any] = {"multioutput": "raw_values"}
    columns = {
        "median_relative_error": median_relative_error(true, mean, **each),
        "normalized_rmse": normalized_rmse(true, mean, **each),
        "least_squares_normalized_rmse": normalized_rmse(true, linear, **each),
        "negative_log_predictive_density": negative_log_predictive_density(*bands, **each),
        "interval_coverage": interval_coverage(*bands, **each),
    }
    return pd.DataFrame(columns, [*COEFFICIENTS])


def score_table(flights: Sequence[Evaluation]) -> pd.DataFrame:
    """Return the scores of flights as they are shown, and their means.

    The truth of a simulation contains gusts that no band knows: of it there are errors only.
    """
    against = scores(flights)
    table = against["measured"][[*SHOWN]].rename(columns=SHOWN)
    if "truth" in against:
        of_truth = against["truth"].rename(columns=SHOWN).add_suffix(" of truth")
        table = table.join(of_truth[["rel. error of truth", "NRMSE of truth"]])
    table.loc["mean"] = table.mean()
    return table


def evaluate(
    name: str,
    flight: FlightTable,
    pipeline: FlightPipeline,
    aircraft: Aircraft,
) -> Evaluation:
    """Predict a checked flight."""
    notify(f"evaluating {name}")
    thrust = pipeline.thrust
    X, ratio, corrected, path = flight_regressors(pipeline, flight)
    checked = replace(flight, table=corrected)
    states = corrected
    if reconstruction_of(pipeline) is not None:  # beside the logged inputs
        states = corrected.assign(**path.drop(columns=[*ALL_SURFACES], errors="ignore"))
    band = band_of(pipeline)
    measured = aerodynamic_coefficients(
        checked, aircraft, cutoff=without_vibration(band), thrust=thrust
    )
    mean = pipeline.predict_rows(X, ratio)
    std = _std(pipeline[-1], X, ratio)
    variance = std**2
    if pipeline.log_errors_ is not None:  # which the measured coefficients have, too
        variance = np.maximum(variance - pipeline.log_errors_.variance(X), 0.0)
    return Evaluation(
        name=name,
        table=corrected,
        states=states,
        measured=measured.to_numpy(),
        mean=mean,
        std=std,
        prediction_std=np.sqrt(variance + pipeline[-1].noise_variance_),
        regressors=X,
        truth=_truth(corrected, band),
        baseline=by_least_squares(named_regressors(pipeline, X), pipeline.least_squares_),
    )


def _std(regressor: DependentGPRegressor, X: Matrix, noise_ratio: Vector) -> Matrix:
    """Return standard deviations (n, 6), of many rows computed at some and interpolated between these.

    They cost N^2 each, means only N.
    """
    every = np.arange(len(X), dtype=float)
    step = int(np.ceil(len(X) / MOST_STD_ROWS))
    rows = np.arange(step // 2, len(X), step)
    _, std = regressor.predict(X[rows], return_std=True, include_input_noise=noise_ratio[rows])
    return interpolated(every, every[rows], std)


def _truth(table: pd.DataFrame, band: float) -> Matrix | None:
    """Return the noise-free coefficients of a simulation in the band of the fit, where the table has them."""
    names = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS]
    if not {*names} <= {*table}:
        return None
    return band_limited(table[names].to_numpy(float), table, band)
