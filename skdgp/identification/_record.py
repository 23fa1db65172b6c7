"""The record of a fit: its numbers and findings."""

from __future__ import annotations

from sklearn.utils import Bunch

from skdgp._compute.typing import Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.identification._pipeline import FlightPipeline, regressor_names, step_of
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector


def fit_record(pipeline: FlightPipeline) -> Bunch:
    """Return what a fitted pipeline shows of its fit.

    =============================== =======================================================================
    ``summary``                     duration, samples and likelihood, and whether the search converged
    ``inference``                   "exact" or "sparse"
    ``weights``                     weight of each component of an average, by coefficient
    ``regressors``                  names of the regressors of the last step
    ``log_marginal_likelihood``     at the end of the search
    ``iterations``                  of the search
    ``converged``, ``interrupted``  whether the search converged, or was ended by Ctrl-C
    ``noise_std``                   standard deviations of the noise of coefficients
    ``doubts``                      findings that exclude the judgement "yes" of any use of the model: gusts
                                    that are not known, and paths that did not converge
    ``reconstruction``              whether flight paths are reconstructed, and why; None without this step
    ``lags``                        table of `skdgp.preprocessing.LagCorrector`; None without this step
    ``lags_corrected``              lags [s] by group that the flights show, and that are removed
    ``samples``                     rows learned from
    ``samples_available``           rows with a coefficient
    ``seconds``, ``flown``          duration of the fit, and of the training flights without gaps [s]
    ``flights``                     rows of each training flight
    ``conditions``                  medians of the columns of the training flights
    ``least_squares``               by coefficient intercept and slopes of the linear model of the same rows
    =============================== =======================================================================
    """
    regressor = pipeline[-1]
    step = step_of(pipeline, FlightPathReconstruction)
    corrector = step_of(pipeline, LagCorrector)
    corrected = {}
    if corrector is not None:
        applied = corrector.lags_.dropna(subset="std")["applied"]
        corrected = applied[applied != 0].to_dict()
    state = "interrupted" if regressor.interrupted_ else "fitted"
    samples = f"{pipeline.n_learned_} of {pipeline.n_observed_} samples"
    likelihood = regressor.log_marginal_likelihood_value_
    summary = f"{state} in {pipeline.fit_time_:.1f} s on {samples}, log likelihood {likelihood:.1f}"
    if not regressor.converged_:
        summary += f"; not converged after {regressor.n_iter_} iterations: raise max_iter"
    return Bunch(
        summary=summary,
        inference=regressor.inference_,
        weights={name: _by_coefficient(values) for name, values in regressor.weights_.items()},
        regressors=regressor_names(pipeline),
        log_marginal_likelihood=likelihood,
        iterations=regressor.n_iter_,
        converged=regressor.converged_,
        interrupted=regressor.interrupted_,
        noise_std=_by_coefficient(regressor.noise_variance_**0.5),
        doubts=[] if step is None else step.doubts_,
        reconstruction=None if step is None else step.finding_,
        lags=None if corrector is None else corrector.lags_,
        lags_corrected=corrected,
        samples=pipeline.n_learned_,
        samples_available=pipeline.n_observed_,
        seconds=pipeline.fit_time_,
        flown=pipeline.seconds_,
        flights=pipeline.flights_,
        conditions=pipeline.conditions_,
        least_squares=pipeline.least_squares_.to_dict(),
    )


def _by_coefficient(values: Vector) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, values, strict=True))
