"""The result of `identify`: its numbers, its summary in words, its report and its files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch

from skdgp._compute.files import (
    Writer,
    json_text,
    plain,
    software_versions,
    text_writer,
    write_together,
)
from skdgp._compute.findings import Severity, clauses_of
from skdgp._flight.findings import Finding
from skdgp.dynamics import Aircraft
from skdgp.identification._changed import Changes
from skdgp.identification._evaluate import Evaluation, score_table, scores
from skdgp.identification._mechanics import FlightMechanics, flight_mechanics
from skdgp.identification._model_file import save_model
from skdgp.identification._verdict import Verdict, judge

FORMAT = 5  # of the metrics
MOST_WARNINGS = 3  # in the summary


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
        Fitted, a raw flight table in, six coefficients out; and its aircraft.
    options : dict
        Options of `identify`, given or chosen, and the ``horizon``.
    fit : Bunch
        Likelihood, noise and findings of the fit; samples and time: ``fit.keys()``.
    train : dict of str to DataFrame
        Usable rows of the training flights; empty for a model that existed before.
    evaluations : list of Evaluation
        Predictions of each test flight.
    findings : tuple of Finding
        Warnings, and assumptions where flights and aircraft do not say.
    changes : Changes, optional
        Whether the aircraft has changed since the flights of a model that existed before.
    title, command, created : str
        Heading of the report, the command line, date and time.
    """

    pipeline: Pipeline
    aircraft: Aircraft
    options: dict
    fit: Bunch
    train: dict[str, pd.DataFrame]
    evaluations: list[Evaluation]
    findings: tuple[Finding, ...] = ()
    changes: Changes | None = None
    title: str = ""
    command: str | None = None
    created: str = field(
        default_factory=lambda: datetime.now().astimezone().isoformat(timespec="seconds")
    )

    @property
    def assumed(self) -> list[str]:
        """The assumptions as sentences; empty where everything was told."""
        assumed = [found for found in self.findings if found.severity is Severity.ASSUMPTION]
        return [finding.text for finding in assumed]

    @cached_property
    def mechanics(self) -> FlightMechanics:
        """Trim, derivatives and modes at the median flight condition, and how long a simulation follows flights.

        Computed when first asked for, as are the `verdict` and the `metrics`.
        """
        return flight_mechanics(
            self.pipeline,
            self.aircraft,
            self.fit.conditions,
            [flight.states for flight in self.evaluations],
            self.options,
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Scores, and uses that the model is good enough for."""
        slopes = self.mechanics.derivatives
        columns: list[Any] = (
            [] if slopes.empty else [slopes["value"].to_dict(), slopes["std"].to_dict()]
        )
        question = self.aircraft.question_of_sizes(*columns)
        findings = self.findings if question is None else (*self.findings, question)
        return judge(self.evaluations, self.fit, self.mechanics, findings)

    @cached_property
    def metrics(self) -> dict:
        """Every number of the report as plain JSON values, None where it is not finite: what metrics.json holds."""
        tests = {}
        for flight in self.evaluations:
            tests[flight.name] = _sampling_of(flight.table) | _score_metrics([flight])
        return plain(
            {
                "format": FORMAT,
                "created": self.created,
                "command": self.command,
                "versions": software_versions(),
                "aircraft": self.aircraft.to_dict(),
                "options": self.options,
                "fit": self.fit,
                "train": {name: _sampling_of(table) for name, table in self.train.items()},
                "test": tests,
                "test_together": _score_metrics(self.evaluations),
                "verdict": self.verdict,
                "flight_mechanics": self.mechanics,
                "findings": self.findings,
                "changed": self.changes,
            }
        )

    def summary(self) -> str:
        """Return the text of the command line: scores of all test flights together and of each, and the verdict."""
        table = score_table(self.evaluations)
        if len(self.evaluations) > 1:
            for flight in self.evaluations:
                table.loc[f"flight {flight.name}"] = score_table([flight]).loc["mean"]
        title = f"{len(self.evaluations)} test flight(s) together"
        lines = [f"{self.aircraft.name}: {self.fit.summary}", "", title]
        lines += [table.to_string(float_format="{:.3g}".format), ""]
        if self.fit.reconstruction is not None:
            lines.append(self.fit.reconstruction.clause)
        if self.changes is not None:
            lines += [finding.clause for finding in self.changes.findings]
        lines += ["", self.verdict.compared()]
        for use in self.verdict.uses:
            lines.append(f"{use.purpose + ':':<22}{use.judgement}, {use.reason}")
        lines += [f"warning: {warning}" for warning in self.verdict.warnings[:MOST_WARNINGS]]
        if self.assumed:
            lines += ["", "assumed, as nothing was told:"]
        for assumption in self.assumed:
            lines.append(fill(assumption, 110, initial_indent="  - ", subsequent_indent="    "))
        return "\n".join(lines)

    def save(self, path: str | os.PathLike, **further: Writer) -> Path:
        """Write metrics.json and, of a model that was learned here, model.joblib into a folder, all or none.

        ``further`` files have writers by name, see `skdgp.report.save_report`.
        """
        path = Path(path)
        writers = {**further, "metrics.json": text_writer(json_text(self.metrics))}
        if self.train:
            writers["model.joblib"] = partial(
                save_model,
                pipeline=self.pipeline,
                aircraft=self.aircraft,
                options=self.options,
                fit=plain(self.fit),
                uses={use.purpose: use.judgement for use in self.verdict.uses},
                flights=list(self.train),
            )
        write_together(path, writers)
        return path

    @property
    def facts(self) -> dict[str, str]:
        """What was done, as text."""
        paths = self.fit.reconstruction
        notes = [found for found in self.findings if found.severity is Severity.NOTE]
        return {
            "aircraft": repr(self.aircraft),
            "regressors": ", ".join(self.fit.regressors),
            "flight paths": "" if paths is None else paths.clause,
            "fit": self.fit.summary,
            "notes": clauses_of(notes),
            "options": _listed(self.options),
            "versions": _listed(software_versions()),
        }


def _listed(values: Mapping[str, Any]) -> str:
    """Return values with their names."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _sampling_of(table: pd.DataFrame) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    return {
        "samples": len(time),
        "duration": np.ptp(time),
        "sample_rate": 1 / np.median(np.diff(time)),
    }


def _score_metrics(flights: Sequence[Evaluation]) -> dict:
    """Return the scores of each coefficient, and their means."""
    tables = scores(flights)
    return {
        "coefficients": tables,
        "means": {against: table.mean().to_dict() for against, table in tables.items()},
    }
