"""The result of `identify`: its numbers, its summary in words, its report and its files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.files import (
    Writer,
    json_text,
    plain,
    software_versions,
    text_writer,
    write_together,
)
from skdgp._compute.findings import Code, Finding, with_codes
from skdgp._compute.messages import can_draw, notify
from skdgp._compute.wording import reason_of, text_of
from skdgp.dynamics import Aircraft, as_aerodynamics
from skdgp.identification._mechanics import flight_mechanics
from skdgp.identification._model_file import save_model
from skdgp.identification._summary import (
    air_of,
    assumption_lines,
    facts_of_fit,
    fit_lines,
    group_means,
    sampling_of,
    score_lines,
    verdict_lines,
)
from skdgp.identification._verdict import judge
from skdgp.plotting import EffectsDisplay
from skdgp.report import (
    Evaluation,
    FitRecord,
    FlightMechanics,
    ReportContent,
    Verdict,
    render_report,
    scores,
)

FORMAT = 2  # of the metrics


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
        Fitted, a raw flight table in, six coefficients out; and its aircraft.
    options : dict
        Options of `identify`, given or chosen, and ``horizons``.
    fit : FitRecord
        Likelihood, noise and findings of the fit; samples and time in ``fit.training``.
    train : dict of str to DataFrame
        Usable rows of the training flights; empty for a model that existed before.
    evaluations : list of Evaluation
        Predictions and replay of each test flight.
    findings : tuple of Finding
        Warnings.
    assumptions : tuple of Finding
        Assumptions where flights and aircraft do not say; empty without assumptions.
    supplements : sequence
        Further parts such as the changes of the aircraft: ``name`` and ``to_dict()`` for the metrics,
        ``summary()``, a list of lines, and ``section()``, HTML for the report.
    title, command, created : str
        Heading of the report, the command line, date and time.
    """

    pipeline: Pipeline
    aircraft: Aircraft
    options: dict
    fit: FitRecord
    train: dict[str, pd.DataFrame]
    evaluations: list[Evaluation]
    findings: tuple[Finding, ...] = ()
    assumptions: tuple[Finding, ...] = ()
    supplements: Sequence[Any] = ()
    title: str = ""
    command: str | None = None
    created: str = field(
        default_factory=lambda: datetime.now().astimezone().isoformat(timespec="seconds")
    )

    @property
    def messages(self) -> list[str]:
        """The findings as sentences."""
        return [text_of(finding) for finding in self.findings]

    @property
    def assumed(self) -> list[str]:
        """The assumptions as sentences."""
        return [text_of(finding) for finding in self.assumptions]

    @property
    def held_out(self) -> str | None:
        """The part held out because no test flight was named; None if one was."""
        held_out = with_codes(self.findings, Code.HELD_OUT_FLIGHT, Code.HELD_OUT_QUARTER)
        return reason_of(held_out[0]) if held_out else None

    @cached_property
    def mechanics(self) -> FlightMechanics:
        """Trim, derivatives and modes at the median flight condition, and how long a simulation follows flights.

        Computed when first asked for, as are the `verdict` and the `metrics`.
        """
        return flight_mechanics(
            self.pipeline,
            self.aircraft,
            list(self.train.values()),
            [flight.table for flight in self.evaluations],
            self.options,
            self.fit.training,
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Training data, and uses that the model is good enough for."""
        # assumptions are told in their own list
        findings = [finding for finding in self.findings if finding not in self.assumptions]
        question = self.aircraft.question_of_sizes(derivatives=self.mechanics.derivatives)
        if question is not None:
            findings.append(question)
        return judge(self.train.values(), self.evaluations, self.fit, self.mechanics, findings)

    @cached_property
    def metrics(self) -> dict:
        """Every number of the report as plain JSON values, None where it is not finite: what metrics.json holds."""
        tests = {}
        for flight in self.evaluations:
            sampling = sampling_of(flight.table) | {"samples_with_std": len(flight.rows)}
            tests[flight.name] = sampling | _score_metrics(flight.scores)
        metrics = {
            "format": FORMAT,
            "created": self.created,
            "command": self.command,
            "versions": software_versions(),
            "aircraft": self.aircraft.to_dict(),
            "options": self.options,
            "held_out": self.held_out,
            "fit": self.fit.to_dict(),
            "train": {name: sampling_of(table) for name, table in self.train.items()},
            "test": tests,
            "test_together": _score_metrics(scores(self.evaluations)),
            "verdict": self.verdict.to_dict(),
            "flight_mechanics": self.mechanics.to_dict(),
        }
        for part in self.supplements:
            metrics[part.name] = part.to_dict()
        metrics["messages"] = self.messages
        metrics["findings"] = [finding.to_dict() for finding in self.findings]
        if self.assumptions:
            metrics["assumed"] = self.assumed
        return plain(metrics)

    def summary(self) -> str:
        """Return the text of the command line: scores of all test flights together, and a line or table of each."""
        lines = fit_lines(self.aircraft, self.fit)
        lines += ["", *score_lines(self.evaluations)]
        if self.fit.reconstruction is not None:
            lines.append(f"flight paths {text_of(self.fit.reconstruction)}")
        for part in self.supplements:
            lines += part.summary()
        lines += ["", *verdict_lines(self.verdict)]
        lines += assumption_lines(self.assumed)
        return "\n".join(lines)

    def save(self, path: str | os.PathLike) -> Path:
        """Write report and metrics and, of a model that was learned here, the model into a folder, all or none."""
        path = Path(path)
        path.mkdir(parents=True, exist_ok=True)
        notify("report")
        writers: dict[str, Writer] = {
            "report.html": text_writer(render_report(self._report_content())),
            "metrics.json": text_writer(json_text(self.metrics)),
        }
        if self.train:
            writers["model.joblib"] = partial(
                save_model,
                pipeline=self.pipeline,
                aircraft=self.aircraft,
                options=self.options,
                fit=self.fit.to_dict(),
                uses={use.purpose: use.judgement for use in self.verdict.uses},
                flights=list(self.train),
            )
        write_together(path, writers)
        return path

    def _effects(self) -> EffectsDisplay:
        """Return slices of the model through its trim, through the mean of the flights if it has none."""
        aerodynamics: Any = as_aerodynamics(self.pipeline)
        rows = pd.DataFrame(aerodynamics.learned.training_rows(), columns=aerodynamics.regressors)
        trim = self.mechanics.trim
        steady = {} if trim is None else {"alpha": trim.alpha, "beta": trim.beta, **trim.controls}
        at = {name: steady[name] for name in rows if name in steady}
        return EffectsDisplay.from_estimator(self.pipeline[-2:], rows, at, ax=False)

    def _report_content(self) -> ReportContent:
        tested = {flight.name: flight.table for flight in self.evaluations}
        return ReportContent(
            title=self.title,
            subtitle=self.aircraft.name,
            created=datetime.fromisoformat(self.created),
            train=self.train,
            test=self.evaluations,
            facts=facts_of_fit(
                self.aircraft, self.pipeline, self.fit, self.options, self.train, tested
            ),
            verdict=self.verdict,
            mechanics=self.mechanics,
            effects=self._effects() if can_draw() else None,
            air=air_of(self.pipeline),
            sections=[part.section() for part in self.supplements],
            assumed=self.assumed,
            units=self.pipeline.control_units_,
            command=self.command,
        )


def _score_metrics(tables: Mapping[str, pd.DataFrame]) -> dict:
    """Return the scores of each coefficient, and the means of groups."""
    coefficients = {}
    means = {}
    for against, table in tables.items():
        coefficients[against] = table.to_dict("index")
        means[against] = group_means(table).to_dict("index")
    return {"coefficients": coefficients, "means": means}
