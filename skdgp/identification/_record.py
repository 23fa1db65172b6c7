"""The record of a fit: its numbers and findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from skdgp._compute.typing import Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.findings import Finding
from skdgp.identification._pipeline import FlightPipeline, regressor_names, step_of
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector


@dataclass(frozen=True, kw_only=True)
class FitRecord:
    """What a fitted pipeline shows of its fit.

    Parameters
    ----------
    inference : str
        "exact" or "sparse".
    weights : mapping of str to mapping of str to float
        Weight of each component of an average, by coefficient.
    regressors : sequence of str
        Regressors of the last step.
    log_marginal_likelihood : float
        At the end of the search.
    iterations : int
        Of the search.
    converged, interrupted : bool
        Whether the search converged, or was ended by Ctrl-C.
    noise_std : mapping of str to float
        Standard deviations of the noise of coefficients.
    doubts : sequence of Finding
        Findings that exclude the judgement "yes" of any use of the model: gusts of flights without
        vanes that are not known, and paths that did not converge.
    reconstruction : Finding, optional
        Whether flight paths are reconstructed, and why; None without this step.
    lags : DataFrame, optional
        As of `skdgp.preprocessing.LagCorrector`; None without this step.
    samples, samples_available : int
        Rows learned from, and rows with a coefficient.
    seconds, flown : float
        Duration of the fit, and of the training flights without gaps [s].
    flights : mapping of str to int
        Rows of each training flight.
    conditions : mapping of str to float
        Medians of the columns of the training flights, where derivatives are judged.
    least_squares : mapping of str to mapping of str to float
        By coefficient ``intercept`` and slopes of the linear model of the same rows.
    """

    inference: str
    weights: Mapping[str, Mapping[str, float]]
    regressors: Sequence[str]
    log_marginal_likelihood: float
    iterations: int
    converged: bool
    interrupted: bool
    noise_std: Mapping[str, float]
    doubts: Sequence[Finding]
    reconstruction: Finding | None
    lags: pd.DataFrame | None
    samples: int
    samples_available: int
    seconds: float
    flown: float
    flights: Mapping[str, int]
    conditions: Mapping[str, float]
    least_squares: Mapping[str, Mapping[str, float]]

    @property
    def summary(self) -> str:
        """Duration, samples and likelihood of the fit, and whether it converged."""
        state = "interrupted" if self.interrupted else "fitted"
        samples = f"{self.samples} of {self.samples_available} samples"
        likelihood = f"log likelihood {self.log_marginal_likelihood:.1f}"
        text = f"{state} in {self.seconds:.1f} s on {samples}, {likelihood}"
        if not self.converged:
            text += f"; not converged after {self.iterations} iterations: raise max_iter"
        return text

    @property
    def lags_corrected(self) -> dict[str, float]:
        """Lags [s] by group that the flights show, and that are removed."""
        if self.lags is None:
            return {}
        is_shown = self.lags["std"].notna() & (self.lags["applied"] != 0)
        return self.lags["applied"][is_shown].to_dict()

    @property
    def surfaces_are_commands(self) -> bool:
        """Whether lags show that logged surfaces are commands of slower servos."""
        return "servos" in self.lags_corrected or self.lags_corrected.get("surfaces", 0) < 0


def fit_record(pipeline: FlightPipeline) -> FitRecord:
    """Return what a fitted pipeline shows of its fit."""
    regressor = pipeline[-1]
    step = step_of(pipeline, FlightPathReconstruction)
    corrector = step_of(pipeline, LagCorrector)
    return FitRecord(
        inference=regressor.inference_,
        weights={name: _by_coefficient(values) for name, values in regressor.weights_.items()},
        regressors=regressor_names(pipeline),
        log_marginal_likelihood=float(regressor.log_marginal_likelihood_value_),
        iterations=int(regressor.n_iter_),
        converged=bool(regressor.converged_),
        interrupted=bool(regressor.interrupted_),
        noise_std=_by_coefficient(regressor.noise_variance_**0.5),
        doubts=[] if step is None else step.doubts_,
        reconstruction=None if step is None else step.finding_,
        lags=None if corrector is None else corrector.lags_,
        samples=pipeline.n_learned_,
        samples_available=pipeline.n_observed_,
        seconds=pipeline.fit_time_,
        flown=float(pipeline.seconds_ or 0.0),
        flights=pipeline.flights_,
        conditions=pipeline.conditions_,
        least_squares=pipeline.least_squares_.to_dict(),
    )


def _by_coefficient(values: Vector) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, np.asarray(values, float).tolist(), strict=True))
