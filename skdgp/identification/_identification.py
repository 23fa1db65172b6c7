"""The result of `identify`: its numbers, its summary in words, its report and its files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.files import json_text, plain, software_versions, text_writer, write_together
from skdgp._compute.messages import recorded_warnings, warn
from skdgp._compute.progress import notify
from skdgp._display.style import display_unit
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp.dynamics import Aircraft
from skdgp.identification import _evaluation, _model_file
from skdgp.identification._evaluation import Evaluation, group_means, reconstruction_of, scores
from skdgp.identification._flights import named_flights
from skdgp.identification._pipeline import regressor_and_scale
from skdgp.identification._verdict import flight_mechanics, judge
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay
from skdgp.report import (
    FlightMechanics,
    ReportContent,
    Verdict,
    render_report,
    write_report,
)

FORMAT = 1  # of the metrics
WIDTHS = {
    "spherical": "one width for all regressors",
    "diag": "one width for each regressor",
    "full": "a full matrix of widths",
    "tied": "one width for each regressor, common to all outputs",
}
MEMBERS = {"joint": "all terms", "additive": "trend and main effects", "trend": "trend alone"}
THRUSTS = {
    "columns": "from the thrust columns of the flights",
    "propeller": "from the propeller's bench table",
    "none": "none subtracted: that of an engine is part of the coefficients",
}
N_WARNINGS = 3  # of the summary
MOST_NAMED = 3  # flights whose durations are given
MARGIN, WIDTH = 16, 11  # characters of the summary's first column, and of the others


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
        Fitted: a raw flight table in, six coefficients out; and of what.
    settings, fit : dict
        What was asked for or chosen; samples, likelihood, noise and time of the fit.
    train : dict of str to DataFrame
        Usable rows of the training flights; empty for a model that existed before.
    evaluations : list of Evaluation
        Predictions and replay of each test flight.
    messages, held_out : list of str, str or None
        Warnings that arose, and what was held out because no test flight was named.
    supplements : sequence
        Further parts such as `skdgp.design.FlownPlan`: ``name`` and ``to_dict()`` for the metrics,
        ``summary()``, a list of lines, and ``section()``, HTML for the report.
    assumed : list of str
        What was assumed where flights and aircraft do not say, and what to measure; empty where all
        was told.
    title, command, created : str
        Heading of the report, the command line, date and time.
    """

    pipeline: Pipeline
    aircraft: Aircraft
    settings: dict
    fit: dict
    train: dict[str, pd.DataFrame]
    evaluations: list[Evaluation]
    messages: list[str]
    held_out: str | None = None
    supplements: Sequence[Any] = ()
    assumed: list[str] = field(default_factory=list)
    title: str = ""
    command: str | None = None
    created: str = field(
        default_factory=lambda: datetime.now().astimezone().isoformat(timespec="seconds")
    )

    @cached_property
    def mechanics(self) -> FlightMechanics:
        """Trim, derivatives and modes in the middle of what was flown, and how long a simulation follows flights."""
        train, test = (
            list(self.train.values()),
            [one.table for one in self.evaluations if one.table is not None],
        )
        return flight_mechanics(self.pipeline, self.aircraft, train, test, self.settings, self.fit)

    @cached_property
    def verdict(self) -> Verdict:
        """What was learned, and what it is good enough for."""
        return judge(self.train.values(), self.evaluations, self.fit, self.mechanics, self.messages)

    @cached_property
    def metrics(self) -> dict:
        """Every number of the report as plain JSON values, None where it is not finite: what metrics.json holds."""
        return plain(
            {
                "format": FORMAT,
                "created": self.created,
                "command": self.command,
                "versions": software_versions(),
                "aircraft": self.aircraft.to_dict(),
                "options": self.settings,
                "held_out": self.held_out,
                "fit": self.fit,
                "train": {name: _extent(table) for name, table in self.train.items()},
                "test": {
                    one.name: {
                        **_extent(one.table),
                        "samples_with_std": len(one.rows),
                        **_score_metrics([one]),
                        "states": {
                            against: table.to_dict("records")
                            for against, table in one.states.items()
                        },
                    }
                    for one in self.evaluations
                },
                "test_together": _score_metrics(self.evaluations),
                "verdict": self.verdict.to_dict(),
                "flight_mechanics": self.mechanics.to_dict(),
                **{each.name: each.to_dict() for each in self.supplements},
                **({"assumed": self.assumed} if self.assumed else {}),
                "messages": self.messages,
            }
        )

    def summary(self) -> str:
        """Return what the command line prints: scores of all test flights together, and a line or table of each."""
        fit, tested, verdict = self.fit, self.evaluations, self.verdict
        first = f"{self.aircraft.name}: "
        if "seconds" in fit:
            first += (
                f"{'interrupted' if fit['interrupted'] else 'fitted'} in {fit['seconds']:.1f} s on "
            )
            first += f"{fit['samples']} of {fit['samples_available']} samples, "
        lines = [f"{first}log likelihood {fit['log_marginal_likelihood']:.1f}"]
        if not fit.get("converged", True):
            lines.append(f"not converged after {fit['iterations']} iterations: raise max_iter")
        if len(tested) == 1:
            lines += [
                "",
                f"flight {tested[0].name}",
                *_score_table(tested),
                "",
                *_state_lines(tested[0]),
            ]
        else:
            lines += ["", f"{len(tested)} test flights together", *_score_table(tested), ""]
            for one in tested:
                lines += [f"flight {one.name}", _mean_row([one], "all"), *_state_lines(one)]
        lines += [
            "",
            *(f"flight paths {paths}" for paths in [reconstruction_of(self.pipeline)] if paths),
        ]
        lines += [line for each in self.supplements for line in each.summary()]
        lines += [
            "",
            f"error {verdict.error:.3f} of the spread, {_percent(verdict.coverage)} in 95 % bands",
        ]
        lines += [words] if (words := verdict.compared()) else []
        lines += [f"{use.purpose + ':':<22}{use.fit}, {use.reason}" for use in verdict.uses]
        lines += [
            f"warning {k}: {warning}"
            for k, warning in enumerate(verdict.warnings[:N_WARNINGS], start=1)
        ]
        lines += ["", "assumed, as nothing was told:"] if self.assumed else []
        for each in self.assumed:
            lines += wrap(each, 110, initial_indent="  - ", subsequent_indent="    ")
        return "\n".join(lines)

    def evaluate(self, flight: Any) -> Evaluation:
        """Predict and replay another flight, a table or a path."""
        with recorded_warnings() as messages:
            flights = _evaluation.usable_flights_of_model(self.pipeline, named_flights(flight))
            messages.ignore(FlightDataWarning, WARNING_START)  # the steps meet them again
            if len(flights) != 1:
                raise ValueError(
                    f"Got {len(flights)} flights, but expected one: evaluate each by itself."
                )
            return _evaluation.evaluate_flights(
                flights, self.pipeline, self.aircraft, self.settings, self.fit
            )[0]

    def report(self, path: str | os.PathLike) -> Path:
        """Write the report, one HTML file, and return its path."""
        return write_report(path, self._report_content())

    def save(self, path: str | os.PathLike) -> Path:
        """Write model.joblib, metrics.json and report.html into a folder, all or none; of a path .joblib the model."""
        path = Path(path)
        if path.suffix == ".joblib":
            return _model_file.save_model(path, self.pipeline, self.aircraft, **self._model_facts())
        path.mkdir(parents=True, exist_ok=True)
        write_together(path, self.writers())
        return path

    def writers(self) -> dict[str, Callable[[Path], object]]:
        """Return by file name what writes report, metrics and, of a model that was learned here, the model."""
        notify("report")
        if find_spec("matplotlib") is None:
            warn('No pictures in the report: they need pip install "skdgp[plot]".', stacklevel=2)
        found = {
            "report.html": text_writer(render_report(self._report_content())),
            "metrics.json": text_writer(json_text(self.metrics)),
        }
        if self.train:
            model = _model_file.model_bunch(self.pipeline, self.aircraft, **self._model_facts())
            found["model.joblib"] = lambda path: _model_file.dump_model(path, model)
        return found

    def _model_facts(self) -> dict:
        return {"options": self.settings, "fit": self.fit, "flights": list(self.train)}

    def _report_content(self) -> ReportContent:
        return ReportContent(
            title=self.title,
            subtitle=self.aircraft.name,
            train=self.train,
            test=self.evaluations,
            facts=self._facts(),
            verdict=self.verdict,
            mechanics=self.mechanics,
            envelope=self._envelope(),
            effects=self._effects(),
            air=air_of(self.pipeline),
            sections=[each.section() for each in self.supplements],
            assumed=self.assumed,
            units=getattr(self.pipeline, "control_units_", {}),
            messages=self.messages,
            command=self.command,
        )

    def _envelope(self) -> EnvelopeDisplay | None:
        """Return where the data are and what the model knows around them; None of a single regressor."""
        if len(self.fit["regressors"]) < 2 or not self.train:
            return None
        tested = [_evaluation.named(self.pipeline, one.regressors) for one in self.evaluations]
        path = pd.concat(tested) if tested else None
        return EnvelopeDisplay.compute(
            self.pipeline[-2:], self._training_regressors(), flight=path, n_grid=12
        )

    def _effects(self) -> EffectsDisplay:
        """Return the effect of each regressor."""
        return EffectsDisplay.compute(self.pipeline[-2:])

    def _training_regressors(self) -> pd.DataFrame:
        return pd.concat([self.pipeline[:-2].transform(table) for table in self.train.values()])

    def _facts(self) -> dict[str, str]:
        """Return what was done, ready to read."""
        fit = self.fit
        aircraft = self.aircraft
        regressor = regressor_and_scale(self.pipeline)[0]
        shared = sum(getattr(term, "n_latent", 0) for term in regressor.kernel_.summands())
        coupled = "joint" in fit["weights"]
        end = " (limit reached)" * (fit["iterations"] == regressor.max_iter_)
        if not fit.get("converged", True):
            end = " (not converged: raise max_iter)"
        facts = {
            "Aircraft": f"{aircraft.name}, {aircraft.mass:g} kg, wing area "
            f"{aircraft.wing_area:.4g} m², span {aircraft.span:.4g} m, chord {aircraft.chord:.4g} m",
            "Learned from": _durations(self.train),
            "Tested on": _durations({one.name: one.table for one in self.evaluations}),
            "Regressors": ", ".join(fit["regressors"]),
            "Latent processes": f"{shared} shared, {len(COEFFICIENTS)} private" if coupled else "",
            "Kernel": f"convolved Gaussian, {WIDTHS[regressor.covariance_type]}" if coupled else "",
            "Trend": regressor.trend or "none",
            "Inference": regressor.inference_
            + " (chosen by auto)" * (regressor.inference == "auto"),
            "Log likelihood": f"{fit['log_marginal_likelihood']:,.1f}",
            "Iterations": f"{fit['iterations']}{end}",
        }
        if "seconds" in fit:
            facts["Samples"] = f"{fit['samples']:,} of {fit['samples_available']:,}"
            facts["Time of the fit"] = f"{fit['seconds']:.1f} s"
        versions = ", ".join(f"{name} {number}" for name, number in software_versions().items())
        return facts | self._remarks() | {"Versions": versions}

    def _remarks(self) -> dict[str, str]:
        fit = self.fit
        tables = [*self.train.values(), *(one.table for one in self.evaluations)]
        sources = _evaluation.thrust_sources(self.settings["thrust"], tables)
        remarks = {"Thrust": " or ".join(THRUSTS[name] for name in sources)}
        if paths := reconstruction_of(self.pipeline):
            remarks["Flight paths"] = paths
        if "lags" in fit:
            lags = [
                f"{name} {row['applied']:.3g} s"
                for name, row in fit["lags"].items()
                if row["applied"]
            ]
            remarks["Lags"] = ", ".join(lags) or "none to correct"
        if len(fit["weights"]) > 1:
            shares = {
                name: np.mean(list(by_output.values()))
                for name, by_output in fit["weights"].items()
            }
            words = ", ".join(f"{share:.0%} {MEMBERS[name]}" for name, share in shares.items())
            remarks["Average"] = (
                f"{words}; weights by blocks of the training flights, predicted from the others"
            )
        if noisy := [
            f"{name} {value:.2g}" for name, value in fit["input_noise_std"].items() if value > 0
        ]:
            remarks["Noise of the regressors"] = ", ".join(noisy)
        if self.settings["external_forces"]:
            remarks["Other loads"] = ", ".join(self.settings["external_forces"])
        step = max(-(-len(one.time) // len(one.rows)) for one in self.evaluations)
        if step > 1:
            remarks["Bands"] = f"computed at one row in {step}, interpolated between"
        if any(one.truth is not None for one in self.evaluations):
            remarks["Truth"] = (
                "contains gusts that no sensor felt: coverage and NLPD against it are in "
                "metrics.json"
            )
        if fit.get("interrupted"):
            remarks["Fit"] = "interrupted; this is the best model until then"
        return remarks


def air_of(pipeline: Pipeline) -> str:
    """Return gusts and steady wind of the training flights, as reconstruction found them; empty where it did not."""
    step = pipeline["flightpathreconstruction"]
    if not getattr(step, "tells_gusts_", False):
        return ""
    if step.air_motion_ is not None:
        return step.air_motion_.summary
    parts = [f"gusts {step.gust_std_:.2g} m/s rms"]
    winds = step.calibration_.pivot_table("estimate", "flight", "constant", sort=False)
    for name, row in winds.iterrows() if {"wind_north", "wind_east"} <= {*winds} else ():
        north, east = row[["wind_north", "wind_east"]]
        way = np.rad2deg(np.arctan2(-east, -north)) % 360
        parts.append(f"steady wind of {name} {np.hypot(north, east):.2g} m/s from {way:.0f} deg")
    return ", ".join(parts[:4])


def _durations(flights: Mapping[str, Any]) -> str:
    """Return flights with their durations and rates; of many their number."""
    extents = {name: _extent(table) for name, table in flights.items()}
    if len(extents) > MOST_NAMED:
        seconds = sum(each["duration"] for each in extents.values())
        return f"{len(extents)} flights, {seconds:.4g} s together: {', '.join(extents)}"
    return ", ".join(
        f"{name} ({each['duration']:.4g} s at {each['sample_rate']:.3g} Hz)"
        for name, each in extents.items()
    )


def _extent(table) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    rate = 1 / np.median(np.diff(time)) if len(time) > 1 else np.nan
    return {"samples": len(table), "duration": float(np.ptp(time)), "sample_rate": float(rate)}


def _score_metrics(evaluations) -> dict:
    tables = scores(evaluations)
    return {
        "coefficients": {against: table.to_dict("index") for against, table in tables.items()},
        "means": {
            against: group_means(table).to_dict("index") for against, table in tables.items()
        },
    }


def _score_table(evaluations) -> list[str]:
    tables = scores(evaluations)
    above = [f"{'against measured':>{3 * WIDTH}}", f"{'against truth':>{2 * WIDTH}}"][: len(tables)]
    lines = [" " * MARGIN + "".join(above)]
    for words in (("median", "NRMSE", "in 95 %"), ("rel. error", "", "band")):
        cells = [f"{word:>{WIDTH}}" for word in (*words, *words[:2] * (len(tables) - 1))]
        lines.append(" " * MARGIN + "".join(cells).rstrip())
    lines += [_row(name, [table.loc[name] for table in tables.values()]) for name in COEFFICIENTS]
    return [
        *lines,
        "",
        *(_mean_row(evaluations, group) for group in ("longitudinal", "lateral", "all")),
    ]


def _mean_row(evaluations, group) -> str:
    return _row(group, [group_means(table).loc[group] for table in scores(evaluations).values()])


def _row(name, rows) -> str:
    """Return errors and coverage against measured; against truth, which holds gusts that no band knows, errors only."""
    cells = [
        cell
        for row in rows
        for cell in (_percent(row.median_relative_error), f"{row.normalized_rmse:.3f}")
    ]
    cells.insert(2, _percent(rows[0].interval_coverage))
    return f"  {name:<{MARGIN - 2}}" + "".join(f"{cell:>{WIDTH}}" for cell in cells)


def _percent(fraction) -> str:
    return f"{100 * fraction:.1f} %" if np.isfinite(fraction) else "-"


def _state_lines(evaluation: Evaluation) -> list[str]:
    lines = []
    for horizon, part in (
        evaluation.states["measured"].groupby("horizon") if evaluation.states else ()
    ):
        median = part.set_index("state")["median"]
        units = {state: display_unit(state) for state in ("v_east", "p", "r") if state in median}
        cells = [
            f"{state} {factor * median[state]:.3g} {unit}"
            for state, (factor, unit) in units.items()
        ]
        lines.append(f"  replayed over {horizon:g} s, median error: {', '.join(cells)}")
    return lines
