"""Records of a fit, and evaluation of a fitted pipeline on flights: predictions, scores, replay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import warn
from skdgp._compute.progress import notify
from skdgp._compute.typing import Indices, Matrix
from skdgp._flight.channels import (
    BODY_VELOCITY,
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    HORIZONTAL,
    LATERAL,
    LONGITUDINAL,
    RATES,
    THRUST_FORCES,
    TRUTH_SUFFIX,
)
from skdgp._flight.checks import unwrapped
from skdgp._flight.clock import flight_segments
from skdgp._flight.smoothing import noise_level
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, replay, replay_errors
from skdgp.identification._flights import Flights, regressor_columns, usable_flights
from skdgp.identification._pipeline import flight_regressors, regressor_and_scale
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector
from skdgp.report import FlightResult

STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
# rows of a flight at which standard deviations are computed; they cost N^2 each, means only N
STD_ROWS = 3000
STATES = (*HORIZONTAL, *EARTH_VELOCITY, *EULER, *RATES)


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor = regressor_and_scale(pipeline)[0]
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
        "evaluations": int(regressor.n_evaluations_),
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
    regressor = regressor_and_scale(pipeline)[0]
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
    if thrust != "auto":
        return [thrust or "none"]
    return sorted(
        {"columns" if {*THRUST_FORCES} & set(table.columns) else "propeller" for table in tables}
    )


def _by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))


@dataclass(frozen=True, kw_only=True)
class Evaluation(FlightResult):
    """Predictions for one flight and their replay: a `skdgp.report.FlightResult`, and how it was computed.

    Attributes
    ----------
    rows : ndarray of int
        Where standard deviations were computed; between them they are interpolated.
    states : dict of str to DataFrame
        Errors of the replay, as of ``skdgp.dynamics.replay_errors``, against "measured" and, where
        it is known, "truth".
    regressors : ndarray (n, d)
        Inputs of the last step of the pipeline.
    """

    rows: Indices
    states: dict[str, pd.DataFrame]
    regressors: Matrix


def evaluate_flights(
    flights: Flights, pipeline: Pipeline, aircraft: Aircraft, settings: dict, fit: dict
) -> list[Evaluation]:
    """Predict flights and replay them, with the settings and facts of `identify`."""
    return [
        _evaluate(name, table, pipeline, aircraft, settings, fit.get("least_squares"))
        for name, table in flights.items()
    ]


def _evaluate(name, table, pipeline, aircraft, settings, least_squares) -> Evaluation:
    notify(f"evaluating {name}")
    loads = {key: settings[key] for key in ("thrust", "external_forces")}
    measured = aerodynamic_coefficients(table, aircraft, **loads).to_numpy()
    regressors, noise_ratio = flight_regressors(pipeline, table)
    regressor, scale = regressor_and_scale(pipeline)
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    std = regressor.predict(
        regressors[rows], return_std=True, include_input_noise=noise_ratio[rows]
    )[1]
    std = np.column_stack([np.interp(np.arange(len(table)), rows, column) for column in std.T])
    measured_std = scale * np.sqrt(std**2 + regressor.noise_variance_)
    replayed = _replay(name, table, aircraft, mean, settings["horizons"], loads)
    states: dict[str, pd.DataFrame] = {}
    if replayed is not None:
        states["measured"] = replay_errors(replayed, table)
        if "v_east" + TRUTH_SUFFIX in table:
            states["truth"] = replay_errors(replayed, table, suffix=TRUTH_SUFFIX)
    names, baseline = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS], None
    if least_squares is not None:
        weights = np.array([list(least_squares[name].values()) for name in COEFFICIENTS])
        baseline = weights[:, 0] + named(pipeline, regressors).to_numpy() @ weights[:, 1:].T
    evaluation = Evaluation(
        name=name,
        time=table["time"].to_numpy(float),
        measured=measured,
        mean=mean,
        std=scale * std,
        measured_std=measured_std,
        truth=table[names].to_numpy(float) if set(names) <= set(table) else None,
        table=table,
        replay=replayed,
        rows=rows,
        states=states,
        regressors=regressors,
        baseline=baseline,
    )
    metrics: dict[str, Any] = {
        against: table.to_dict("list") for against, table in scores([evaluation]).items()
    }
    return replace(evaluation, metrics=metrics)


def fit_least_squares(
    pipeline: Pipeline, regressors: Matrix, Y: pd.DataFrame
) -> dict[str, dict[str, dict[str, float]]]:
    """Return "least_squares": intercept and slopes of each coefficient (n, 6), and "least_squares_std": their errors.

    ``regressors`` (n, d) are inputs of the last step; the slopes are in the units before the scaler
    of the pipeline. Standard deviations hold where errors are correlated within a block of
    consecutive rows (Liang & Zeger 1986).
    """
    table = named(pipeline, regressors)
    names, values = [str(name) for name in table], table.to_numpy()
    slopes, std = {}, {}
    for coefficient, y in zip(COEFFICIENTS, np.asarray(Y, dtype=float).T, strict=True):
        observed = np.isfinite(y)
        X, y = values[observed], y[observed]
        linear = LinearRegression().fit(X, y)
        residuals, z = y - linear.predict(X), X - X.mean(axis=0)
        blocks = np.array_split(
            np.arange(len(y)), np.clip(len(y) // 10, 2, 60)
        )  # as many as of `slope_errors`
        scores = np.array([z[rows].T @ residuals[rows] for rows in blocks]) @ np.linalg.pinv(
            z.T @ z
        )
        errors = np.sqrt(len(blocks) / (len(blocks) - 1) * (scores**2).sum(axis=0))
        fitted = {"intercept": linear.intercept_, **dict(zip(names, linear.coef_, strict=True))}
        slopes[coefficient] = {name: float(value) for name, value in fitted.items()}
        std[coefficient] = dict(zip(names, map(float, errors), strict=True))
    return {"least_squares": slopes, "least_squares_std": std}


def named(pipeline: Pipeline, regressors: Matrix) -> pd.DataFrame:
    """Return the regressors (n, d) of the last step by name, in their units before the scaler."""
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    return pd.DataFrame(pipeline["standardscaler"].inverse_transform(regressors), columns=names)


def scores(evaluations: Sequence[Evaluation]) -> dict[str, pd.DataFrame]:
    """Return coefficients by metrics, over all rows of the flights, against "measured" and "truth" if all know it."""
    pairs = {"measured": ("measured", "measured_std"), "truth": ("truth", "std")}
    if any(evaluation.truth is None for evaluation in evaluations):
        del pairs["truth"]
    return {against: _scores(evaluations, *names) for against, names in pairs.items()}


def group_means(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame(
        {group: table.loc[list(members)].mean() for group, members in groups.items()}
    ).T


def _scores(evaluations, reference, std) -> pd.DataFrame:
    """Return metrics of means over all rows, and of bands over those where standard deviations were computed."""

    def all_rows(name):
        return np.concatenate([getattr(flight, name) for flight in evaluations])

    means = all_rows(reference), all_rows("mean")
    bands = [
        np.concatenate([getattr(flight, name)[flight.rows] for flight in evaluations])
        for name in (reference, "mean", std)
    ]
    columns = {
        metric.__name__: metric(*means, multioutput="raw_values")
        for metric in (median_relative_error, normalized_rmse)
    }
    if all(flight.baseline is not None for flight in evaluations):
        linear = normalized_rmse(means[0], all_rows("baseline"), multioutput="raw_values")
        columns["least_squares_normalized_rmse"] = linear
    for metric in (negative_log_predictive_density, interval_coverage):
        columns[metric.__name__] = metric(*bands, multioutput="raw_values")
    return pd.DataFrame(columns, index=list(COEFFICIENTS))


def _replay(name, table, aircraft, mean, horizons, loads) -> pd.DataFrame | None:
    velocity = BODY_VELOCITY if set(BODY_VELOCITY) <= set(table.columns) else EARTH_VELOCITY
    lacking = [column for column in [*EULER, *velocity] if column not in table]
    if lacking:
        warn(
            f"Flight {name!r} is not replayed: it lacks {lacking}, from which the integration "
            f"would start.",
            stacklevel=4,
        )
        return None
    warn_of_long_horizons(horizons, name, table)
    return replay(table, aircraft, mean, horizon=horizons, **loads)


def warn_of_long_horizons(horizons: Sequence[float], name: str, table: pd.DataFrame) -> None:
    """Warn of horizons that the flight is too short for."""
    time = table["time"].to_numpy(float)
    longest = max(time[run][-1] - time[run][0] for run in flight_segments(time))
    long = [horizon for horizon in horizons if horizon > longest]
    if long:
        warn(
            f"Flight {name!r} lasts {longest:.3g} s without a gap, so the replay never reaches "
            f"horizons of "
            f"{' '.join(f'{horizon:g}' for horizon in long)} s: it runs to the end of each "
            f"gap-free segment.",
            stacklevel=5,
        )


def sensor_noise(table: pd.DataFrame, states: Sequence[str] = STATES) -> dict[str, float]:
    """Return the white noise of the measured states, by name: how uncertain a restart from them is.

    Where the spectrum of a short flight does not show it, second differences do: white
    noise has 1 + 4 + 1 = 6 times its variance in them; with motion in them the noise is rather over- than
    understated.
    """
    names = [name for name in states if name in table]
    values, time = unwrapped(table, names), table["time"].to_numpy(float)
    noise = noise_level(values, time).measured
    squares = (
        np.concatenate([np.diff(values[run], 2, axis=0) for run in flight_segments(time)]) ** 2
    )
    sampled = np.isfinite(squares)
    bound = np.sqrt(
        np.where(sampled, squares, 0.0).sum(axis=0) / np.maximum(sampled.sum(axis=0), 1) / 6.0
    )
    return dict(zip(names, np.where(np.isfinite(noise), noise, bound).tolist(), strict=True))


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
    if not set(steps) >= STEPS or not isinstance(
        regressor_and_scale(pipeline)[0], DependentGPRegressor
    ):
        raise ValueError(
            f"Got a model of {list(steps) or type(pipeline).__name__}, but expected what "
            f"make_identification_pipeline "
            "makes, with a DependentGPRegressor: learn it with identify."
        )
