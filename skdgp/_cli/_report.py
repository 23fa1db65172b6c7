"""The content of the report, from the outcome of a job."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS
from skdgp.identification._evaluation import Evaluation, grouped, scores
from skdgp.identification._model_file import software_versions
from skdgp.identification._outcome import Outcome, lacking, thrusts
from skdgp.plotting import EnvelopeDisplay
from skdgp.report import FlightRecord, FlightResult, ModelSummary, ReportContent

WIDTHS = {
    "spherical": "one width for all regressors",
    "diag": "one width for each regressor",
    "full": "a full matrix of widths",
    "tied": "one width for each regressor, common to all outputs",
}
ENVELOPE_POINTS = 12
"""Along each axis of the envelope's panels; what is computed there costs as much as a band."""
THRUSTS = {
    "columns": "from the thrust columns of the flights",
    "propeller": "from the propeller's bench table",
    "none": "none",
}


def report_of(outcome: Outcome) -> ReportContent:
    """Return what the report shows."""
    return ReportContent(
        title=outcome.title,
        train=[FlightRecord(name=name, table=table) for name, table in outcome.train.items()],
        test=[_result(evaluation) for evaluation in outcome.evaluations],
        model=_model_summary(outcome),
        aircraft=_aircraft_facts(outcome.aircraft),
        envelope=_envelope(outcome),
        messages=outcome.messages,
        command=outcome.command,
    )


def _envelope(outcome) -> EnvelopeDisplay | None:
    """Return where the data are and what the model knows around them; a single regressor makes none."""
    names, scaler = outcome.pipeline["regressorselector"].regressors_, outcome.pipeline["standardscaler"]
    if len(names) < 2 or not outcome.train:
        return None
    flown = pd.concat([outcome.pipeline[:-2].transform(table) for table in outcome.train.values()])
    tested = [scaler.inverse_transform(evaluation.regressors) for evaluation in outcome.evaluations]
    path = pd.DataFrame(np.concatenate(tested), columns=names) if tested else None
    return EnvelopeDisplay.compute(outcome.pipeline[-2:], flown, flight=path, n_grid=ENVELOPE_POINTS)


def _result(evaluation: Evaluation) -> FlightResult:
    return FlightResult(
        name=evaluation.name,
        time=evaluation.table["time"].to_numpy(float),
        measured=evaluation.measured,
        mean=evaluation.mean,
        std=evaluation.std,
        measured_std=evaluation.measured_std,
        truth=evaluation.truth,
        table=evaluation.table,
        replay=evaluation.replay,
        replay_errors=evaluation.states.get("measured"),
        metrics={against: table.to_dict("list") for against, table in scores([evaluation]).items()},
    )


def _model_summary(outcome) -> ModelSummary:
    regressor, fit = outcome.regressor, outcome.fit
    return ModelSummary(
        n_samples=fit.get("samples"),
        n_available=fit.get("samples_available"),
        regressors=fit["regressors"],
        n_latent=regressor.n_latent_,
        n_private=len(COEFFICIENTS) if regressor.private_latents else 0,
        kernel=f"convolved Gaussian, {WIDTHS[regressor.covariance_type]}",
        trend=regressor.trend or "none",
        inference=_inference(regressor),
        log_marginal_likelihood=fit["log_marginal_likelihood"],
        n_iter=fit["iterations"],
        max_iter=regressor.max_iter,
        fit_seconds=fit.get("seconds"),
        noise_std=regressor.noise_variance_**0.5,
        correlation=regressor.output_correlation(),
        versions=software_versions(),
        extra=_remarks(outcome),
    )


def _inference(regressor) -> str:
    words = regressor.inference_
    return f"{words} (chosen by auto)" if regressor.inference == "auto" else words


def _remarks(outcome) -> dict[str, str]:
    tables = [*outcome.train.values(), *(evaluation.table for evaluation in outcome.evaluations)]
    remarks = {"Thrust": " or ".join(THRUSTS[name] for name in thrusts(outcome.loads, tables))}
    missing = lacking(outcome.pipeline)
    if missing is not None:
        without = f"not reconstructed, the flights lack {', '.join(missing)}; smoothed channel by channel"
        remarks["Flight paths"] = without if missing else "reconstructed from all sensors"
    noisy = {name: value for name, value in outcome.fit["input_noise_std"].items() if value > 0}
    if noisy:
        remarks["Noise of the regressors"] = ", ".join(f"{name} {value:.2g}" for name, value in noisy.items())
    if outcome.loads.external_forces:
        remarks["Other loads"] = ", ".join(outcome.loads.external_forces)
    if len(outcome.evaluations) > 1:
        means = grouped(scores(outcome.evaluations)["measured"])
        remarks["All test flights"] = "; ".join(
            f"{group} NRMSE {row.normalized_rmse:.3f}, {100 * row.median_relative_error:.1f} % median relative error, "
            f"{100 * row.interval_coverage:.1f} % in the 95 % band"
            for group, row in means.iterrows()
        )
    grown = outcome.fit.get("noise_widened", {})
    widened = [f"{name} {value:.2f}" for name, value in grown.items() if value > 1.005]
    if widened:
        remarks["Noise"] = f"widened to what rows not learned from show: {', '.join(widened)} times"
    step = max(-(-len(evaluation.table) // len(evaluation.rows)) for evaluation in outcome.evaluations)
    if step > 1:
        remarks["Bands"] = f"computed at one row in {step}, interpolated between"
    if any(evaluation.truth is not None for evaluation in outcome.evaluations):
        remarks["Truth"] = "contains gusts that no sensor felt: coverage and NLPD against it are in metrics.json"
    if outcome.fit.get("interrupted"):
        remarks["Fit"] = "interrupted; the best so far was kept"
    return remarks


def _aircraft_facts(aircraft) -> dict[str, str]:
    return {
        "Aircraft": aircraft.name,
        "Mass": f"{aircraft.mass:g} kg",
        "Wing area, span, chord": f"{aircraft.wing_area:.4g} m², {aircraft.span:.4g} m, {aircraft.chord:.4g} m",
    }
