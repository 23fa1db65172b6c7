"""Records of a fit, and evaluation of a fitted pipeline on flights: predictions, scores, replay."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import notify
from skdgp._compute.typing import Matrix
from skdgp._flight.channels import (
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    LATERAL,
    LONGITUDINAL,
    THRUST_FORCES,
    TRUTH_SUFFIX,
)
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, replay
from skdgp.identification._flights import Flights, regressor_columns, usable_flights
from skdgp.identification._pipeline import flight_regressors
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector
from skdgp.report import Evaluation

STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
# rows of a flight at which standard deviations are computed; they cost N^2 each, means only N
STD_ROWS = 3000


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor = pipeline[-1]
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    input_std = np.sqrt(np.diag(regressor.input_covariance_)) * pipeline["standardscaler"].scale_
    return {
        "inference": regressor.inference_,
        "weights": {name: _by_coefficient(values) for name, values in regressor.weights_.items()},
        "regressors": names,
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter_),
        "converged": bool(regressor.converged_),
        "interrupted": bool(regressor.interrupted_),
        "noise_std": _by_coefficient(regressor.noise_variance_**0.5),
        "input_noise_std": dict(zip(names, map(float, input_std), strict=True)),
        "paths_reconstructed": getattr(pipeline["flightpathreconstruction"], "used_", False),
        "paths_not_converged": [
            str(name)
            for name, converged in getattr(
                pipeline["flightpathreconstruction"], "converged_", {}
            ).items()
            if not converged
        ],
        "gusts_unknown": getattr(pipeline["flightpathreconstruction"], "doubt_", ""),
        "reconstruction": reconstruction_of(pipeline),
        "lags": lags_of(pipeline),
    }


def settings_of(pipeline, horizons) -> dict:
    """Return what a pipeline was made with, by the names of the command line's options."""
    regressor = pipeline[-1]
    reconstructs = isinstance(pipeline["flightpathreconstruction"], FlightPathReconstruction)
    return {
        "inference": regressor.inference,
        "structure": regressor.structure,
        "regressors": pipeline["regressorselector"].regressors,
        "reconstruction": "auto" if reconstructs else "none",
        "input_noise": "none" if regressor.input_noise is None else "learned",
        "trend": "none" if regressor.trend is None else regressor.trend,
        "seed": regressor.random_state,
        "horizons": list(horizons),
        "inducing": regressor.n_inducing,
        "latents": regressor.n_latent,
        "max_iter": regressor.max_iter,
        "lags": pipeline["lagcorrector"].lags,
    }


def lags_of(pipeline: Pipeline) -> dict[str, dict[str, Any]]:
    """Return the lags of channels by group, as of `LagCorrector`; empty without this step."""
    step = pipeline.named_steps.get("lagcorrector")
    if not isinstance(step, LagCorrector):
        return {}
    table = step.lags_.astype(object).where(step.lags_.notna(), None)
    return {str(group): dict(row) for group, row in table.iterrows()}


def lags_message(pipeline: Pipeline) -> str:
    """Return the lags that were found in the flights of the fit and corrected, in one line; empty without any."""
    lags = {
        name: row["applied"]
        for name, row in lags_of(pipeline).items()
        if row["remark"] == "removed"
    }
    parts = [
        f"{name} {abs(lag):.3f} s {'late' if lag > 0 else 'early'}" for name, lag in lags.items()
    ]
    early = (
        " Surfaces that are early are commands of slower servos."
        if lags.get("surfaces", 0) < 0
        else ""
    )
    return f"Lags against the inertial unit, corrected: {', '.join(parts)}.{early}" if parts else ""


def reconstruction_of(pipeline) -> str | None:
    """Return whether flight paths are reconstructed, and why; None where it was not asked for."""
    step = pipeline["flightpathreconstruction"]
    if not isinstance(step, FlightPathReconstruction):
        return None
    return f"{'reconstructed from all sensors' if step.used_ else 'not reconstructed, only smoothed'}: {step.reason_}"


def thrust_sources(thrust: str | None, tables: Iterable[Any]) -> list[str]:
    """Return where the thrust of flights is from: "columns", "propeller" or "none"."""
    if thrust is None:
        return ["none"]
    return sorted(
        {"columns" if {*THRUST_FORCES} & set(table.columns) else "propeller" for table in tables}
    )


def _by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))


def evaluate(
    name: str,
    table: pd.DataFrame,
    pipeline: Pipeline,
    aircraft: Aircraft,
    settings: dict,
    fit: dict,
) -> Evaluation:
    """Predict a flight and replay it, with the settings and facts of `identify`."""
    notify(f"evaluating {name}")
    loads = {key: settings[key] for key in ("thrust", "external_forces")}
    measured = aerodynamic_coefficients(table, aircraft, **loads).to_numpy()
    regressors, noise_ratio = flight_regressors(pipeline, table)
    regressor = pipeline[-1]
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    std = regressor.predict(
        regressors[rows], return_std=True, include_input_noise=noise_ratio[rows]
    )[1]
    std = np.column_stack([np.interp(np.arange(len(table)), rows, column) for column in std.T])
    replayed = None
    if {*EULER, *EARTH_VELOCITY} <= set(table.columns):  # from which the integration starts
        replayed = replay(table, aircraft, mean, horizon=min(settings["horizons"]), **loads)
    names, baseline = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS], None
    if linear := fit.get("least_squares"):
        weights = np.array([list(linear[name].values()) for name in COEFFICIENTS])
        baseline = weights[:, 0] + named(pipeline, regressors).to_numpy() @ weights[:, 1:].T
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
        truth=table[names].to_numpy(float) if set(names) <= set(table) else None,
        baseline=baseline,
        replay=replayed,
    )


def fit_least_squares(
    pipeline: Pipeline, regressors: Matrix, Y: pd.DataFrame
) -> dict[str, dict[str, float]]:
    """Return intercept and slopes of each coefficient (n, 6) by least squares, where it is observed.

    ``regressors`` (n, d) are inputs of the last step; the slopes are in the units before the scaler
    of the pipeline.
    """
    table = named(pipeline, regressors)
    fitted = {}
    for coefficient, y in zip(COEFFICIENTS, np.asarray(Y, dtype=float).T, strict=True):
        observed = np.isfinite(y)
        linear = LinearRegression().fit(table[observed], y[observed])
        slopes = dict(zip(map(str, table), map(float, linear.coef_), strict=True))
        fitted[coefficient] = {"intercept": float(linear.intercept_), **slopes}
    return fitted


def named(pipeline: Pipeline, regressors: Matrix) -> pd.DataFrame:
    """Return the regressors (n, d) of the last step by name, in their units before the scaler."""
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    return pd.DataFrame(pipeline["standardscaler"].inverse_transform(regressors), columns=names)


def group_means(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame(
        {group: table.loc[list(members)].mean() for group, members in groups.items()}
    ).T


def usable_flights_of_model(pipeline: Pipeline, flights: Flights) -> Flights:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Raises ValueError if the pipeline is not of `identify`, or a flight lacks a column that its
    training flights had.
    """
    check_identified(pipeline)
    regressors = pipeline["regressorselector"].regressors
    columns = regressor_columns([pd.DataFrame(columns=pipeline[0].feature_names_in_)], regressors)
    return usable_flights(flights, regressors, columns)


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    steps = getattr(pipeline, "named_steps", {})
    if not set(steps) >= STEPS or not isinstance(pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got a model of {list(steps) or type(pipeline).__name__}, but expected what "
            f"make_identification_pipeline "
            "makes, with a DependentGPRegressor: learn it with identify."
        )
