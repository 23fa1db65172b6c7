"""Third stage of an identification: predictions and replays of test flights."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import notify
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, EARTH_VELOCITY, EULER, TRUTH_SUFFIX
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, replay
from skdgp.identification._flights import Flights
from skdgp.identification._learn import LearnedModel
from skdgp.identification._least_squares import linear_terms, named_regressors
from skdgp.identification._pipeline import FlightPipeline, band_limited, flight_regressors
from skdgp.identification._prepare import Tables, regressor_columns, usable_flights
from skdgp.report import Evaluation

# steps that an evaluation reads
STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}


def evaluate(name: str, table: pd.DataFrame, model: LearnedModel) -> Evaluation:
    """Predict a flight and replay it."""
    notify(f"evaluating {name}")
    loads = {key: model.options[key] for key in ("thrust", "external_forces")}
    pipeline = model.pipeline
    regressors, noise_ratio = flight_regressors(pipeline, table)
    table = pipeline.corrected(table)
    measured = aerodynamic_coefficients(table, model.aircraft, cutoff=pipeline.own_cutoff, **loads)
    # with the noise of the fit, which the bands contain
    noisy = aerodynamic_coefficients(
        table, model.aircraft, cutoff=pipeline.coefficient_filter_, **loads
    )
    regressor = pipeline[-1]
    mean = pipeline.mean_of_rows(regressors, noise_ratio)
    rows = std_rows(len(table))
    std = _interpolated_std(regressor, regressors, noise_ratio, rows)
    replayed = None
    if {*EULER, *EARTH_VELOCITY} <= {*table.columns}:  # from which the integration starts
        horizon = min(model.options["horizons"])
        replayed = replay(table, model.aircraft, mean, horizon=horizon, **loads)
    return Evaluation(
        name=name,
        time=table["time"].to_numpy(float),
        table=table,
        measured=measured.to_numpy(),
        measured_as_in_fit=noisy.to_numpy(),
        mean=mean,
        std=std,
        measured_std=np.sqrt(std**2 + regressor.noise_variance_),
        rows=rows,
        regressors=regressors,
        truth=_truth(table, pipeline.band_),
        baseline=_baseline(model, regressors),
        replay=replayed,
    )


def std_rows(n: int, most: int = 3000) -> Indices:
    """Return the rows of n at which standard deviations are computed; they cost N^2 each, means only N."""
    step = int(np.ceil(n / most))
    return np.arange(step // 2, n, step)


def _interpolated_std(
    regressor: DependentGPRegressor, regressors: Matrix, noise_ratio: Vector, rows: Indices
) -> Matrix:
    """Return standard deviations (n, 6), computed at some rows and interpolated between these."""
    ratio = noise_ratio[rows]
    _, std = regressor.predict(regressors[rows], return_std=True, include_input_noise=ratio)
    every = np.arange(len(regressors))
    return np.column_stack([np.interp(every, rows, column) for column in std.T])


def _truth(table: pd.DataFrame, band: float) -> Matrix | None:
    """Return the noise-free coefficients of a simulation in the band of the fit, where the table has them."""
    names = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS]
    if not {*names} <= {*table}:
        return None
    return band_limited(table[names].to_numpy(float), table, band)


def _baseline(model: LearnedModel, regressors: Matrix) -> Matrix | None:
    """Return the coefficients (n, 6) by least squares on the rows of the fit, where it is known."""
    if model.fit.training is None:
        return None
    intercepts, slopes = linear_terms(model.fit.training.least_squares)
    return intercepts + named_regressors(model.pipeline, regressors).to_numpy() @ slopes


def usable_flights_of_model(
    pipeline: Pipeline, flights: Flights, aircraft: Aircraft | None = None
) -> Tables:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Flights that do not state the position of their inertial sensors get the aircraft's. Raises
    ValueError if the pipeline is not of `identify`, or a flight lacks a column that its training
    flights had.
    """
    check_identified(pipeline)
    regressors = pipeline["regressorselector"].regressors
    of_fit = pd.DataFrame(columns=pipeline[0].feature_names_in_)
    columns = regressor_columns([of_fit], regressors)
    return usable_flights(flights, aircraft, regressors, columns)


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    names = list(pipeline.named_steps) if isinstance(pipeline, FlightPipeline) else []
    if not {*names} >= STEPS or not isinstance(pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got a model of {names or type(pipeline).__name__}, but expected what "
            "make_identification_pipeline makes, with a DependentGPRegressor: learn it with "
            "identify."
        )
