"""Second stage of an identification: the model that the flights determine, and the record of its fit.

Equations of "the paper" are those of Hemakumara & Sukkarieh (2011).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import notify, report
from skdgp._flight.channels import (
    ALL_SURFACES,
    ELEVONS,
    HIGH_LIFT,
    MIXED,
)
from skdgp._flight.findings import Code, Finding
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.estimation import without_airspeed_error
from skdgp.identification._flights import tables_of
from skdgp.identification._pipeline import (
    FlightPipeline,
    make_identification_pipeline,
)
from skdgp.identification._prepare import PreparedFlights
from skdgp.identification._record import FitRecord, TrainingRecord, fit_record, flown_seconds
from skdgp.io import FULL_THROW
from skdgp.preprocessing import FlightPathReconstruction

#: Units of the controls of a log without their scale
FULL_THROWS = dict.fromkeys((*ALL_SURFACES, *HIGH_LIFT), FULL_THROW)


@dataclass(frozen=True, kw_only=True)
class LearnedModel:
    """A fitted model of an aircraft.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
    fit : FitRecord
    options : dict
        Options of the identification, given or chosen, and ``horizons`` of the evaluation.
    """

    pipeline: FlightPipeline
    aircraft: Aircraft
    fit: FitRecord
    options: dict[str, Any]


def checked_regressor(regressor: DependentGPRegressor | None) -> DependentGPRegressor:
    """Return the regressor, by default one of seed 0; raise TypeError if it is of another kind."""
    if regressor is None:
        return DependentGPRegressor(random_state=0)
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__} as the regressor, but expected a "
            "DependentGPRegressor: fit other regressors with make_identification_pipeline."
        )
    return regressor


def learn(
    prepared: PreparedFlights,
    *,
    regressors: str | Sequence[str],
    regressor: DependentGPRegressor,
    steps: Mapping[str, Any],
    samples: int | str | None,
    horizons: Sequence[float],
) -> LearnedModel:
    """Return the model of the training flights; parameters: see `identify`."""
    notify("coefficients")  # inverse dynamics, paper eqs 3 to 8
    train = tables_of(prepared.train)
    pipeline = _pipeline_for(prepared, regressors, regressor, steps, samples)
    scale = prepared.flights.airspeed_scale
    table = without_airspeed_error(prepared.flights.table, scale.removable())
    flights = replace(prepared.flights, table=table)
    Y = aerodynamic_coefficients(flights, prepared.aircraft, **prepared.loads)
    targets = pipeline.thinned(prepared.flights, Y)

    notify("transforming")  # regressors (paper eq 22 is the set "paper"), then the fit, eq 20
    began = time.monotonic()
    pipeline.fit(prepared.flights, targets)
    seconds = round(time.monotonic() - began, 3)
    training = TrainingRecord(
        samples=_n_observed(targets),
        samples_available=_n_observed(Y),
        seconds=seconds,
        least_squares=pipeline.least_squares_,
        flights={name: len(part) for name, part in train.items()},
        conditions={str(k): float(v) for k, v in table.median(numeric_only=True).items()},
        flown=flown_seconds(train.values()),
    )
    fit = fit_record(pipeline, training)
    if fit.lags_corrected:
        finding = Finding(
            Code.LAGS_CORRECTED,
            numbers={"lags": fit.lags_corrected, "commands": fit.surfaces_are_commands},
        )
        report(finding)
    return LearnedModel(
        pipeline=pipeline,
        aircraft=prepared.aircraft,
        fit=fit,
        options=_options(prepared, pipeline, training.samples, horizons),
    )


def _n_observed(coefficients: pd.DataFrame) -> int:
    """Return the number of rows with any coefficient."""
    return int(coefficients.notna().any(axis=1).sum())


def _pipeline_for(
    prepared: PreparedFlights,
    regressors: str | Sequence[str],
    regressor: DependentGPRegressor,
    steps: Mapping[str, Any],
    samples: int | str | None,
) -> FlightPipeline:
    """Return the pipeline that learns the coefficients of the flights."""
    columns = {*prepared.flights.table}
    options = dict(steps)
    if not ({*MIXED} <= columns or {*ELEVONS} & columns):
        options.setdefault("mixer", "passthrough")
    return make_identification_pipeline(
        prepared.aircraft,
        regressors=regressors,
        regressor=regressor,
        samples=samples,
        control_units=FULL_THROWS if prepared.has_full_throws else None,
        **prepared.loads,
        **options,
    )


def _options(
    prepared: PreparedFlights, pipeline: Pipeline, samples: int, horizons: Sequence[float]
) -> dict[str, Any]:
    """Return the options of an identification, given or chosen."""
    reconstructs = isinstance(pipeline["flightpathreconstruction"], FlightPathReconstruction)
    chosen = {
        **pipeline[-1].get_params(deep=False),
        **prepared.loads,
        "samples": samples,
        "regressors": pipeline["regressorselector"].regressors,
        "reconstruction": "auto" if reconstructs else "none",
        "lags": pipeline["lagcorrector"].lags,
        "horizons": list(horizons),
    }
    if prepared.has_full_throws:
        chosen["servos"] = prepared.servos
    return chosen
