"""The result of `identify`: its numbers, its summary in words, its report and its files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
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
from skdgp._compute.messages import notify
from skdgp._compute.wording import reason_of, text_of
from skdgp._flight.channels import COEFFICIENTS, LATERAL, LONGITUDINAL
from skdgp.dynamics import Aircraft
from skdgp.identification._learn import thrust_sources
from skdgp.identification._mechanics import flight_mechanics
from skdgp.identification._model_file import save_model
from skdgp.identification._pipeline import reconstruction_of
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

FORMAT = 1  # of the metrics
THRUSTS = {
    "columns": "from the thrust columns of the flights",
    "propeller": "from the propeller's bench table",
    "none": "none subtracted: an engine's is part of the coefficients",
}
N_WARNINGS = 3  # of the summary
MOST_AIR = 4  # gusts and steady winds that are shown


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
        Fitted, a raw flight table in, six coefficients out; and its aircraft.
    settings : dict
        Options, given or chosen.
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
        Further parts such as `skdgp.design.PlanCheck`: ``name`` and ``to_dict()`` for the metrics,
        ``summary()``, a list of lines, and ``section()``, HTML for the report.
    title, command, created : str
        Heading of the report, the command line, date and time.
    """

    pipeline: Pipeline
    aircraft: Aircraft
    settings: dict
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
        """Trim, derivatives and modes at the median flight condition, and how long a simulation follows flights."""
        training = self.fit.training
        return flight_mechanics(
            self.pipeline,
            self.aircraft,
            list(self.train.values()),
            [flight.table for flight in self.evaluations],
            self.settings,
            None if training is None else training.least_squares,
        )

    @cached_property
    def verdict(self) -> Verdict:
        """Training data, and uses that the model is good enough for."""
        return judge(self.train.values(), self.evaluations, self.fit, self.mechanics, self.findings)

    @cached_property
    def metrics(self) -> dict:
        """Every number of the report as plain JSON values, None where it is not finite: what metrics.json holds."""
        tests = {}
        for flight in self.evaluations:
            extent = _extent(flight.table) | {"samples_with_std": len(flight.rows)}
            tests[flight.name] = extent | _score_metrics(flight.scores)
        metrics = {
            "format": FORMAT,
            "created": self.created,
            "command": self.command,
            "versions": software_versions(),
            "aircraft": self.aircraft.to_dict(),
            "options": self.settings,
            "held_out": self.held_out,
            "fit": self.fit.to_dict(),
            "train": {name: _extent(table) for name, table in self.train.items()},
            "test": tests,
            "test_together": _score_metrics(scores(self.evaluations)),
            "verdict": self.verdict.to_dict(),
            "flight_mechanics": self.mechanics.to_dict(),
            **{part.name: part.to_dict() for part in self.supplements},
            "messages": self.messages,
            "findings": [finding.to_dict() for finding in self.findings],
        }
        if self.assumptions:
            metrics["assumed"] = self.assumed
        return plain(metrics)

    def summary(self) -> str:
        """Return the text of the command line: scores of all test flights together, and a line or table of each."""
        fit = self.fit
        tested = self.evaluations
        verdict = self.verdict
        lines = [self._fit_text()]
        if not fit.converged:
            lines.append(f"not converged after {fit.iterations} iterations: raise max_iter")
        together = f"{len(tested)} test flights together"
        names = [*COEFFICIENTS, "longitudinal", "lateral", "all"]
        lines += [
            "",
            f"flight {tested[0].name}" if len(tested) == 1 else together,
            _score_text(scores(tested), names),
            "",
        ]
        if len(tested) > 1:
            for flight in tested:
                lines += [f"flight {flight.name}", _score_text(flight.scores, ["all"]), ""]
        if fit.reconstruction is not None:
            lines.append(f"flight paths {text_of(fit.reconstruction)}")
        for part in self.supplements:
            lines += part.summary()
        lines += [
            "",
            f"error {verdict.error:.3f} of the spread, {100 * verdict.coverage:.1f} % in 95 % bands",
        ]
        if verdict.least_squares_error is not None:
            lines.append(verdict.compared())
        for use in verdict.uses:
            lines.append(f"{use.purpose + ':':<22}{use.fit}, {use.reason}")
        for number, warning in enumerate(verdict.warnings[:N_WARNINGS], start=1):
            lines.append(f"warning {number}: {warning}")
        if self.assumptions:
            lines += ["", "assumed, as nothing was told:"]
        for assumption in self.assumed:
            lines += wrap(assumption, 110, initial_indent="  - ", subsequent_indent="    ")
        return "\n".join(lines)

    def _fit_text(self) -> str:
        """Return one line on the fit: duration, samples and likelihood."""
        likelihood = f"log likelihood {self.fit.log_marginal_likelihood:.1f}"
        training = self.fit.training
        if training is None:
            return f"{self.aircraft.name}: {likelihood}"
        state = "interrupted" if self.fit.interrupted else "fitted"
        return (
            f"{self.aircraft.name}: {state} in {training.seconds:.1f} s on {training.samples} of "
            f"{training.samples_available} samples, {likelihood}"
        )

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
            facts = {
                "options": self.settings,
                "fit": self.fit.to_dict(),
                "flights": list(self.train),
            }
            writers["model.joblib"] = lambda path: save_model(
                path, self.pipeline, self.aircraft, **facts
            )
        write_together(path, writers)
        return path

    def _report_content(self) -> ReportContent:
        return ReportContent(
            title=self.title,
            subtitle=self.aircraft.name,
            train=self.train,
            test=self.evaluations,
            facts=self._facts(),
            verdict=self.verdict,
            mechanics=self.mechanics,
            effects=EffectsDisplay.from_model(self.pipeline[-2:], ax=False),
            air=air_of(self.pipeline),
            sections=[part.section() for part in self.supplements],
            assumed=self.assumed,
            units=self.pipeline.control_units_,
            command=self.command,
        )

    def _facts(self) -> dict[str, str]:
        """Return the facts of the fit as text; empty where a fact does not apply."""
        fit = self.fit
        aircraft = self.aircraft
        settings = self.settings
        regressor = self.pipeline[-1]
        tested = {flight.name: flight.table for flight in self.evaluations}
        sources = thrust_sources(settings["thrust"], [*self.train.values(), *tested.values()])
        lags = {name: lag["applied"] for name, lag in fit.lags.items()}
        late = [f"{name} {lag:.3g} s" for name, lag in lags.items() if lag]
        iterations = str(fit.iterations)
        if not fit.converged:
            iterations += " (not converged: raise max_iter)"
        facts = {
            "Aircraft": f"{aircraft.name}, {aircraft.mass:g} kg, wing area "
            f"{aircraft.wing_area:.4g} m², span {aircraft.span:.4g} m, chord {aircraft.chord:.4g} m",
            "Learned from": _durations(self.train),
            "Tested on": _durations(tested),
            "Regressors": ", ".join(fit.regressors),
            "Structure": f"{regressor.structure}, trend {regressor.trend or 'none'}",
            "Inference": fit.inference,
            "Log likelihood": f"{fit.log_marginal_likelihood:,.1f}",
            "Iterations": iterations,
            "Samples": "",
            "Time of the fit": "",
            "Thrust": " or ".join(THRUSTS[name] for name in sources),
            "Flight paths": text_of(fit.reconstruction) if fit.reconstruction else "",
            "Lags": ", ".join(late) or "none to correct",
            "Other loads": ", ".join(settings["external_forces"]),
            "Fit": "interrupted; this is the best model until then" if fit.interrupted else "",
            "Versions": ", ".join(f"{name} {n}" for name, n in software_versions().items()),
        }
        if fit.training is not None:
            training = fit.training
            facts["Samples"] = f"{training.samples:,} of {training.samples_available:,}"
            facts["Time of the fit"] = f"{training.seconds:.1f} s"
        return facts


def air_of(pipeline: Pipeline) -> str:
    """Return gusts and steady wind of the training flights, as reconstruction found them; empty where it did not."""
    step = reconstruction_of(pipeline)
    if step is None:
        return ""
    if step.air_motion_ is not None:
        return step.air_motion_.summary
    parts = [f"gusts {step.gust_std_:.2g} m/s rms"]
    winds = step.calibration_.pivot_table("estimate", "flight", "constant", sort=False)
    for name, row in winds.iterrows():
        north, east = row[["wind_north", "wind_east"]]
        way = np.rad2deg(np.arctan2(-east, -north)) % 360
        parts.append(f"steady wind of {name} {np.hypot(north, east):.2g} m/s from {way:.0f} deg")
    return ", ".join(parts[:MOST_AIR])


def _durations(flights: Mapping[str, pd.DataFrame]) -> str:
    """Return flights with their durations and rates."""
    parts = []
    for name, table in flights.items():
        extent = _extent(table)
        parts.append(f"{name} ({extent['duration']:.4g} s at {extent['sample_rate']:.3g} Hz)")
    return ", ".join(parts)


def _extent(table: pd.DataFrame) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    step = np.median(np.diff(time)) if len(time) > 1 else np.nan
    return {
        "samples": len(table),
        "duration": float(np.ptp(time)),
        "sample_rate": float(1 / step),
    }


def _score_metrics(tables: Mapping[str, pd.DataFrame]) -> dict:
    return {
        "coefficients": {against: table.to_dict("index") for against, table in tables.items()},
        "means": {
            against: group_means(table).to_dict("index") for against, table in tables.items()
        },
    }


def _score_text(of: Mapping[str, pd.DataFrame], names: list[str]) -> str:
    """Return errors and coverage against measured; against truth, which holds gusts that no band knows, errors only."""
    tables = {key: pd.concat([x, group_means(x)]) for key, x in of.items()}
    measured = tables["measured"].loc[names]
    columns = {
        "rel. error [%]": 100 * measured["median_relative_error"],
        "NRMSE": measured["normalized_rmse"],
        "in 95 % band [%]": 100 * measured["interval_coverage"],
    }
    if "truth" in tables:
        truth = tables["truth"]
        columns["rel. error of truth [%]"] = 100 * truth["median_relative_error"]
        columns["NRMSE of truth"] = truth["normalized_rmse"]
    form = {name: ("{:.3f}" if "NRMSE" in name else "{:.1f}").format for name in columns}
    return pd.DataFrame(columns, index=names).to_string(formatters=form)


def group_means(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame(
        {group: table.loc[list(members)].mean() for group, members in groups.items()}
    ).T
