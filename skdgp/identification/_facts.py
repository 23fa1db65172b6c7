"""What a pipeline was made with, and what it knows of its fit: the records that metrics, summary and report show."""

from __future__ import annotations

import numpy as np
from sklearn.pipeline import Pipeline

from skdgp._flight.channels import COEFFICIENTS, THRUST_FORCES
from skdgp.calibration import CalibratedRegressor
from skdgp.identification._pipeline import regressor_and_scale
from skdgp.preprocessing import FlightPathReconstruction


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor, _ = regressor_and_scale(pipeline)
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    input_std = np.sqrt(np.diag(regressor.input_covariance_)) * pipeline["standardscaler"].scale_
    facts = {
        "inference": regressor.inference_,
        "weights": {name: by_coefficient(values) for name, values in regressor.weights_.items()},
        "regressors": names,
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter_),
        "converged": bool(regressor.converged_),
        "interrupted": bool(regressor.interrupted_),
        "evaluations": int(regressor.n_evaluations_),
        "noise_std": by_coefficient(regressor.noise_variance_**0.5),
        "input_noise_std": dict(zip(names, map(float, input_std), strict=True)),
        "paths_reconstructed": getattr(pipeline["flightpathreconstruction"], "used_", False),
        "reconstruction": reconstruction_of(pipeline),
    }
    if isinstance(pipeline[-1], CalibratedRegressor):
        facts["std_scale"] = by_coefficient(pipeline[-1].std_scale_)
        facts["guaranteed_level"] = by_coefficient(pipeline[-1].max_level_)
    if "lagcorrector" in pipeline.named_steps:
        facts["lags"] = pipeline["lagcorrector"].lags_.to_dict("index")
    return facts


def settings_of(pipeline, reconstruction, horizons) -> dict:
    """Return what a pipeline was made with, by the names of the command line's options."""
    regressor, _ = regressor_and_scale(pipeline)
    settings = {
        "inference": regressor.inference,
        "structure": regressor.structure,
        "regressors": pipeline["regressorselector"].regressors,
        "reconstruction": "none" if reconstruction in (None, "passthrough") else reconstruction,
        "input_noise": "none" if regressor.input_noise is None else "learned",
        "trend": "none" if regressor.trend is None else regressor.trend,
        "seed": regressor.random_state,
        "horizons": list(horizons),
        "inducing": regressor.n_inducing,
        "latents": regressor.n_latent,
        "max_iter": regressor.max_iter,
    }
    if isinstance(pipeline[-1], CalibratedRegressor):
        settings["calibrate"] = True
    if "lagcorrector" in pipeline.named_steps:
        settings["lags"] = pipeline["lagcorrector"].lags
    return settings | ({"symmetric": True} if pipeline.symmetric else {})


def reconstruction_of(pipeline) -> str | None:
    """Return whether flight paths are reconstructed, and why; None where it was not asked for."""
    step = pipeline["flightpathreconstruction"]
    if not isinstance(step, FlightPathReconstruction):
        return None
    return f"{'reconstructed from all sensors' if step.used_ else 'not reconstructed, only smoothed'}: {step.reason_}"


def thrust_sources(thrust, tables) -> list[str]:
    """Return where the thrust of flights is from: "columns", "propeller" or "none"."""
    if thrust != "auto":
        return [thrust or "none"]
    return sorted({"columns" if {*THRUST_FORCES} & set(table.columns) else "propeller" for table in tables})


def by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))
