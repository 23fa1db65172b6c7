"""The output files of ``identify``: model, metrics, report."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from skdgp._cli._report import report_of
from skdgp._cli._writers import Writer, json_writer, text_writer
from skdgp.identification._evaluation import Evaluation, grouped, scores
from skdgp.identification._model_file import dump_model, model_bunch, software_versions
from skdgp.identification._outcome import Outcome
from skdgp.report import render_report

FORMAT = 1


def writers(outcome: Outcome, metrics: dict) -> dict[str, Writer]:
    """Return what writes report and numbers, and of a model that was learned here the model."""
    files = {"report.html": text_writer(render_report(report_of(outcome))), "metrics.json": json_writer(metrics)}
    if not outcome.train:
        return files
    model = model_bunch(
        outcome.pipeline,
        outcome.aircraft,
        options=outcome.settings,
        fit=outcome.fit,
        flights=list(outcome.train),
    )
    return files | {"model.joblib": lambda path: dump_model(path, model)}


def metrics_of(outcome: Outcome) -> dict:
    """Return every number of the report, for other programs; docs/identification.md describes the keys."""
    return {
        "format": FORMAT,
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command": outcome.command,
        "versions": software_versions(),
        "aircraft": outcome.aircraft.to_dict(),
        "options": outcome.settings,
        "held_out": outcome.held_out,
        "fit": outcome.fit,
        "train": {name: _flown(table) for name, table in outcome.train.items()},
        "test": {evaluation.name: _flight_metrics(evaluation) for evaluation in outcome.evaluations},
        "test_together": _score_metrics(outcome.evaluations),
        "messages": outcome.messages,
    }


def _flown(table) -> dict[str, float]:
    """Return how long a flight is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    steps = np.diff(time)
    rate = 1 / np.median(steps) if steps.size else np.nan
    return {"samples": len(table), "duration": float(np.ptp(time)), "sample_rate": float(rate)}


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
