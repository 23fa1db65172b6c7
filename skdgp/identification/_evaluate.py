"""Third stage of an identification: predictions and replays of test flights."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._compute.messages import notify
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, EARTH_VELOCITY, EULER, TRUTH_SUFFIX
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import aerodynamic_coefficients, replay
from skdgp.identification._learn import LearnedModel
from skdgp.identification._least_squares import linear_terms, named_regressors
from skdgp.identification._pipeline import band_limited, cutoff_of, flight_regressors
from skdgp.report import Evaluation

MOST_STD_ROWS = 3000  # rows of a flight at which standard deviations are computed


def evaluate(name: str, table: pd.DataFrame, model: LearnedModel) -> Evaluation:
    """Predict a flight and replay it."""
    notify(f"evaluating {name}")
    loads = {key: model.options[key] for key in ("thrust", "external_forces")}
    pipeline = model.pipeline
    X, noise_ratio = flight_regressors(pipeline, table)
    corrected = pipeline.corrected(table)
    measured = aerodynamic_coefficients(
        corrected, model.aircraft, cutoff=cutoff_of(pipeline.band_), **loads
    )
    # with the noise of the fit, which the bands contain
    measured_as_in_fit = aerodynamic_coefficients(
        corrected, model.aircraft, cutoff=pipeline.coefficient_filter_, **loads
    )
    regressor = pipeline[-1]
    mean = pipeline.mean_of_rows(X, noise_ratio)
    rows = std_rows(len(corrected))
    std = _interpolated_std(regressor, X, noise_ratio, rows)
    replayed = None
    if {*EULER, *EARTH_VELOCITY} <= {*corrected.columns}:  # from which the integration starts
        horizon = min(model.options["horizons"])
        replayed = replay(corrected, model.aircraft, mean, horizon=horizon, **loads)
    return Evaluation(
        name=name,
        time=corrected["time"].to_numpy(float),
        table=corrected,
        measured=measured.to_numpy(),
        measured_as_in_fit=measured_as_in_fit.to_numpy(),
        mean=mean,
        std=std,
        prediction_std=np.sqrt(std**2 + regressor.noise_variance_),
        rows=rows,
        regressors=X,
        truth=_truth(corrected, pipeline.band_),
        baseline=_baseline(model, X),
        replay=replayed,
    )


def std_rows(n: int) -> Indices:
    """Return the rows of n at which standard deviations are computed; they cost N^2 each, means only N."""
    step = int(np.ceil(n / MOST_STD_ROWS))
    return np.arange(step // 2, n, step)


def _interpolated_std(
    regressor: DependentGPRegressor, X: Matrix, noise_ratio: Vector, rows: Indices
) -> Matrix:
    """Return standard deviations (n, 6), computed at some rows and interpolated between these."""
    ratio = noise_ratio[rows]
    _, std = regressor.predict(X[rows], return_std=True, include_input_noise=ratio)
    every = np.arange(len(X))
    return np.column_stack([np.interp(every, rows, column) for column in std.T])


def _truth(table: pd.DataFrame, band: float) -> Matrix | None:
    """Return the noise-free coefficients of a simulation in the band of the fit, where the table has them."""
    names = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS]
    if not {*names} <= {*table}:
        return None
    return band_limited(table[names].to_numpy(float), table, band)


def _baseline(model: LearnedModel, X: Matrix) -> Matrix | None:
    """Return the coefficients (n, 6) by least squares on the rows of the fit, where it is known."""
    if model.fit.training is None:
        return None
    intercepts, slopes = linear_terms(model.fit.training.least_squares)
    return intercepts + named_regressors(model.pipeline, X).to_numpy() @ slopes
