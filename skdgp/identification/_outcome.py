"""The outcome of an identification: model, settings, facts of the fit, evaluations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft
from skdgp.identification._evaluation import Evaluation, Loads


@dataclass(frozen=True)
class Outcome:
    """A model and how it did on flights.

    ``settings`` and ``fit`` say how it came about, as far as that is known; ``train`` are the flights learned from,
    none of a model that was there before.
    """

    title: str
    command: str
    aircraft: Aircraft
    pipeline: Pipeline
    loads: Loads
    settings: dict
    fit: dict
    train: dict[str, pd.DataFrame]
    evaluations: list[Evaluation]
    messages: list[str]
    held_out: str | None = None

    @property
    def regressor(self):
        """The last step of the pipeline."""
        return self.pipeline[-1]


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor = pipeline[-1]
    return {
        "inference": regressor.inference_,
        "regressors": list(pipeline["regressorselector"].regressors_),
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter),
        "evaluations": int(regressor.n_evaluations_),
        "noise_std": by_coefficient(regressor.noise_variance_**0.5),
        "input_noise_std": _input_noise(pipeline),
        "paths_reconstructed": lacking(pipeline) == [],
    }


def _input_noise(pipeline) -> dict[str, float]:
    """Return how noisy the regressors were found to be, standard deviations in their own units."""
    std = np.sqrt(np.diag(pipeline[-1].input_covariance_)) * pipeline["standardscaler"].scale_
    names = pipeline["regressorselector"].regressors_
    return {str(name): float(value) for name, value in zip(names, std, strict=True)}


def lacking(pipeline: Pipeline) -> list[str] | None:
    """Return which channels kept the paths of the flights from being reconstructed; None where that was not asked."""
    step = pipeline["flightpathreconstruction"]
    return None if isinstance(step, str) else step.missing_


def thrusts(loads: Loads, tables) -> list[str]:
    """Return what told the thrust of flights: "columns", "propeller" or "none"; of all but "auto" what was said."""
    chosen = loads.thrust or "none"
    if chosen != "auto":
        return [chosen]
    columns = {"thrust_x", "thrust_y", "thrust_z"}
    return sorted({"columns" if columns & set(table.columns) else "propeller" for table in tables})


def by_coefficient(values) -> dict[str, float]:
    """Return six values by the names of the coefficients."""
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))
