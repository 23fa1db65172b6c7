"""Third stage of an identification: predictions and replays of test flights."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import notify
from skdgp._compute.typing import Indices, Matrix
from skdgp._flight.channels import COEFFICIENTS, EARTH_VELOCITY, EULER, TRUTH_SUFFIX
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import aerodynamic_coefficients, replay
from skdgp.identification._flights import Flights
from skdgp.identification._learn import LearnedModel, named_regressors
from skdgp.identification._pipeline import FlightPipeline, flight_regressors
from skdgp.identification._prepare import Tables, regressor_columns, usable_flights
from skdgp.report import Evaluation

# steps that an evaluation reads
STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
# rows of a flight at which standard deviations are computed; they cost N^2 each, means only N
STD_ROWS = 3000


def evaluate(name: str, table: pd.DataFrame, model: LearnedModel) -> Evaluation:
    """Predict a flight and replay it."""
    notify(f"evaluating {name}")
    loads = {key: model.settings[key] for key in ("thrust", "external_forces")}
    measured = aerodynamic_coefficients(table, model.aircraft, **loads).to_numpy()
    regressors, noise_ratio = flight_regressors(model.pipeline, table)
    regressor = model.pipeline[-1]
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    std = _interpolated_std(regressor, regressors, noise_ratio, rows)
    replayed = None
    if {*EULER, *EARTH_VELOCITY} <= {*table.columns}:  # from which the integration starts
        horizon = min(model.settings["horizons"])
        replayed = replay(table, model.aircraft, mean, horizon=horizon, **loads)
    return Evaluation(
        name=name,
        time=table["time"].to_numpy(float),
        table=table,
        measured=measured,
        mean=mean,
        std=std,
        measured_std=np.sqrt(std**2 + regressor.noise_variance_),
        rows=rows,
        regressors=regressors,
        truth=_truth(table),
        baseline=_baseline(model, regressors),
        replay=replayed,
    )


def _interpolated_std(
    regressor: DependentGPRegressor, regressors: Matrix, noise_ratio: np.ndarray, rows: Indices
) -> Matrix:
    """Return standard deviations (n, 6), computed at some rows and interpolated between these."""
    std = regressor.predict(
        regressors[rows], return_std=True, include_input_noise=noise_ratio[rows]
    )[1]
    every = np.arange(len(regressors))
    return np.column_stack([np.interp(every, rows, column) for column in std.T])


def _truth(table: pd.DataFrame) -> Matrix | None:
    """Return the noise-free coefficients of a simulation, where the table has them."""
    names = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS]
    return table[names].to_numpy(float) if {*names} <= {*table} else None


def _baseline(model: LearnedModel, regressors: Matrix) -> Matrix | None:
    """Return the coefficients (n, 6) by least squares on the rows of the fit, where it is known."""
    if model.fit.training is None:
        return None
    linear = model.fit.training.least_squares
    weights = np.array([list(linear[name].values()) for name in COEFFICIENTS])
    X = named_regressors(model.pipeline, regressors).to_numpy()
    return weights[:, 0] + X @ weights[:, 1:].T


def usable_flights_of_model(pipeline: Pipeline, flights: Flights) -> Tables:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Raises ValueError if the pipeline is not of `identify`, or a flight lacks a column that its
    training flights had.
    """
    check_identified(pipeline)
    regressors = pipeline["regressorselector"].regressors
    learned = pd.DataFrame(columns=pipeline[0].feature_names_in_)
    return usable_flights(flights, regressors, regressor_columns([learned], regressors))


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    names = list(pipeline.named_steps) if isinstance(pipeline, FlightPipeline) else []
    if not {*names} >= STEPS or not isinstance(pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got a model of {names or type(pipeline).__name__}, but expected what "
            "make_identification_pipeline makes, with a DependentGPRegressor: learn it with "
            "identify."
        )
