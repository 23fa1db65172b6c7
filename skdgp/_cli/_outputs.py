"""The three files of a job: the model, the numbers, the report."""

from __future__ import annotations

import json
import math
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._cli._evaluation import Evaluation, Loads, grouped, scores
from skdgp._cli._source import Source
from skdgp._model_file import dump_model, model_bunch, software_versions
from skdgp._vocabulary import COEFFICIENTS
from skdgp.plotting import EnvelopeDisplay
from skdgp.report import FlightRecord, FlightResult, ModelSummary, ReportContent, render_report

FORMAT = 1
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


@dataclass(frozen=True)
class Outcome:
    """A fitted model, what it was fitted on and how it did."""

    source: Source
    options: Namespace
    command: str
    pipeline: Pipeline
    loads: Loads
    train: dict[str, pd.DataFrame]
    n_samples: int
    n_available: int
    n_values: int
    seconds: float
    widened: np.ndarray
    interrupted: bool
    evaluations: list[Evaluation]
    messages: list[str]

    @property
    def regressor(self):
        """The last step of the pipeline."""
        return self.pipeline[-1]


def writers(outcome: Outcome) -> dict[str, Callable[[Path], object]]:
    """Return what writes each file."""
    metrics = json.dumps(_plain(metrics_of(outcome)), indent=1, allow_nan=False) + "\n"
    page = render_report(report_of(outcome))
    model = model_bunch(
        outcome.pipeline,
        outcome.source.aircraft,
        options=_options(outcome),
        fit=_fit_facts(outcome),
        flights=list(outcome.train),
    )
    return {
        "report.html": lambda path: path.write_text(page, encoding="utf-8"),
        "metrics.json": lambda path: path.write_text(metrics, encoding="utf-8"),
        "model.joblib": lambda path: dump_model(path, model),
    }


def metrics_of(outcome: Outcome) -> dict:
    """Return every number of the report, for other programs; docs/identification.md describes the keys."""
    return {
        "format": FORMAT,
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": outcome.command,
        "versions": software_versions(),
        "aircraft": outcome.source.aircraft.to_dict(),
        "options": _options(outcome),
        "held_out": outcome.source.held_out,
        "fit": _fit_facts(outcome) | {"flights": {name: len(table) for name, table in outcome.train.items()}},
        "train": {name: _flown(table) for name, table in outcome.train.items()},
        "test": {evaluation.name: _flight_metrics(evaluation) for evaluation in outcome.evaluations},
        "test_together": _score_metrics(outcome.evaluations),
        "messages": outcome.messages,
    }


def report_of(outcome: Outcome) -> ReportContent:
    """Return what the report shows."""
    return ReportContent(
        title=outcome.source.title,
        train=[FlightRecord(name=name, table=table) for name, table in outcome.train.items()],
        test=[_result(evaluation) for evaluation in outcome.evaluations],
        model=_model_summary(outcome),
        aircraft=_aircraft_facts(outcome.source.aircraft),
        envelope=_envelope(outcome),
        messages=outcome.messages,
        command=outcome.command,
    )


def _options(outcome) -> dict:
    chosen = vars(outcome.options)
    names = ("inference", "regressors", "reconstruction", "input_noise", "trend", "seed", "restarts", "horizons")
    return {
        "samples": outcome.n_samples,
        "thrust": outcome.loads.thrust,
        "external_forces": outcome.loads.external_forces,
        **{name: chosen[name] for name in names},
        "inducing": outcome.regressor.n_inducing,
        "latents": outcome.regressor.n_latent_,
        "max_iter": outcome.regressor.max_iter,
    }


def _fit_facts(outcome) -> dict:
    regressor = outcome.regressor
    return {
        "samples": outcome.n_samples,
        "samples_available": outcome.n_available,
        "values": outcome.n_values,
        "thrust": _thrusts(outcome, outcome.train),
        "inference": regressor.inference_,
        "regressors": list(outcome.pipeline["regressorselector"].regressors_),
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter),
        "evaluations": int(regressor.n_evaluations_),
        "seconds": round(outcome.seconds, 3),
        "interrupted": outcome.interrupted,
        "noise_std": _by_coefficient(regressor.noise_variance_**0.5),
        "noise_widened": _by_coefficient(outcome.widened),
        "input_noise_std": _input_noise(outcome),
        "paths_reconstructed": _lacking(outcome) == [],
    }


def _input_noise(outcome) -> dict[str, float]:
    """Return how noisy the regressors were found to be, standard deviations in their own units."""
    std = np.sqrt(np.diag(outcome.regressor.input_covariance_)) * outcome.pipeline["standardscaler"].scale_
    names = outcome.pipeline["regressorselector"].regressors_
    return {str(name): float(value) for name, value in zip(names, std, strict=True)}


def _lacking(outcome) -> list[str] | None:
    """Return which channels kept the paths of the flights from being reconstructed; None where that was not asked."""
    step = outcome.pipeline["flightpathreconstruction"]
    return None if isinstance(step, str) else step.missing_


def _flown(table) -> dict[str, float]:
    """Return how long a flight is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    steps = np.diff(time)
    rate = 1 / np.median(steps) if steps.size else np.nan
    return {"samples": len(table), "duration": float(np.ptp(time)), "sample_rate": float(rate)}


def _thrusts(outcome, tables) -> list[str]:
    """Return what told the thrust of the flights: "columns", "propeller" or "none"; of all but "auto" what was said."""
    chosen = outcome.loads.thrust or "none"
    if chosen != "auto":
        return [chosen]
    columns = {"thrust_x", "thrust_y", "thrust_z"}
    return sorted({"columns" if columns & set(table.columns) else "propeller" for table in tables.values()})


def _by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))


def _flight_metrics(evaluation: Evaluation) -> dict:
    return {
        **_flown(evaluation.table),
        "samples_with_std": len(evaluation.rows),
        **_score_metrics([evaluation]),
        "states": {against: table.to_dict("records") for against, table in evaluation.states.items()},
    }


def _score_metrics(evaluations) -> dict:
    tables = scores(evaluations)
    return {
        "coefficients": {against: table.to_dict("index") for against, table in tables.items()},
        "means": {against: grouped(table).to_dict("index") for against, table in tables.items()},
    }


def _envelope(outcome) -> EnvelopeDisplay | None:
    """Return where the data are and what the model knows around them; a single regressor makes no picture."""
    names, scaler = outcome.pipeline["regressorselector"].regressors_, outcome.pipeline["standardscaler"]
    if len(names) < 2:
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
    regressor = outcome.regressor
    return ModelSummary(
        n_samples=outcome.n_samples,
        n_available=outcome.n_available,
        regressors=outcome.pipeline["regressorselector"].regressors_,
        n_latent=regressor.n_latent_,
        n_private=len(COEFFICIENTS) if regressor.private_latents else 0,
        kernel=f"convolved Gaussian, {WIDTHS[regressor.covariance_type]}",
        trend=regressor.trend or "none",
        inference=_inference(regressor),
        log_marginal_likelihood=regressor.log_marginal_likelihood_value_,
        n_iter=regressor.n_iter_,
        max_iter=regressor.max_iter,
        fit_seconds=outcome.seconds,
        noise_std=regressor.noise_variance_**0.5,
        correlation=regressor.output_correlation(),
        versions=software_versions(),
        extra=_remarks(outcome),
    )


def _inference(regressor) -> str:
    words = regressor.inference_
    return f"{words} (chosen by auto)" if regressor.inference == "auto" else words


def _remarks(outcome) -> dict[str, str]:
    tables = outcome.train | {evaluation.name: evaluation.table for evaluation in outcome.evaluations}
    remarks = {"Thrust": " or ".join(THRUSTS[name] for name in _thrusts(outcome, tables))}
    lacking = _lacking(outcome)
    if lacking is not None:
        without = f"not reconstructed, the flights lack {', '.join(lacking)}; smoothed channel by channel"
        remarks["Flight paths"] = without if lacking else "reconstructed from all sensors"
    noisy = {name: value for name, value in _input_noise(outcome).items() if value > 0}
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
    widened = [f"{name} {value:.2f}" for name, value in _by_coefficient(outcome.widened).items() if value > 1.005]
    if widened:
        remarks["Noise"] = f"widened to what rows not learned from show: {', '.join(widened)} times"
    step = max(-(-len(evaluation.table) // len(evaluation.rows)) for evaluation in outcome.evaluations)
    if step > 1:
        remarks["Bands"] = f"computed at one row in {step}, interpolated between"
    if any(evaluation.truth is not None for evaluation in outcome.evaluations):
        remarks["Truth"] = "contains gusts that no sensor felt: coverage and NLPD against it are in metrics.json"
    if outcome.interrupted:
        remarks["Fit"] = "interrupted; the best so far was kept"
    return remarks


def _aircraft_facts(aircraft) -> dict[str, str]:
    return {
        "Aircraft": aircraft.name,
        "Mass": f"{aircraft.mass:g} kg",
        "Wing area, span, chord": f"{aircraft.wing_area:.4g} m², {aircraft.span:.4g} m, {aircraft.chord:.4g} m",
    }


def _plain(value):
    """Return the value as JSON knows it: what is not a finite number is null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
