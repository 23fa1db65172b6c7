"""The result of `identify`: its numbers, its summary in words, its report and its files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import Pipeline

from skdgp._compute.files import (
    Writer,
    json_text,
    plain,
    software_versions,
    text_writer,
    write_together,
)
from skdgp._compute.messages import notify
from skdgp._compute.typing import Matrix
from skdgp._flight.channels import (
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    LATERAL,
    LONGITUDINAL,
    THRUST_FORCES,
    TRUTH_SUFFIX,
)
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, replay
from skdgp.identification._flights import Flights, regressor_columns, usable_flights
from skdgp.identification._model_file import save_model
from skdgp.identification._pipeline import flight_regressors
from skdgp.identification._verdict import flight_mechanics, judge
from skdgp.plotting import EffectsDisplay
from skdgp.preprocessing import FlightPathReconstruction, LagCorrector
from skdgp.report import (
    Evaluation,
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


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline, aircraft : Pipeline, Aircraft
        Fitted, a raw flight table in, six coefficients out; and its aircraft.
    settings, fit : dict
        Options, given or chosen; samples, likelihood, noise and time of the fit.
    train : dict of str to DataFrame
        Usable rows of the training flights; empty for a model that existed before.
    evaluations : list of Evaluation
        Predictions and replay of each test flight.
    messages, held_out : list of str, str or None
        Warnings, and the part held out because no test flight was named.
    supplements : sequence
        Further parts such as `skdgp.design.PlanCheck`: ``name`` and ``to_dict()`` for the metrics,
        ``summary()``, a list of lines, and ``section()``, HTML for the report.
    assumed : list of str
        Assumptions where flights and aircraft do not say, and measurements to make; empty without
        assumptions.
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
        """Trim, derivatives and modes at the median flight condition, and how long a simulation follows flights."""
        flights = list(self.train.values()), [flight.table for flight in self.evaluations]
        return flight_mechanics(self.pipeline, self.aircraft, *flights, self.settings, self.fit)

    @cached_property
    def verdict(self) -> Verdict:
        """Training data, and uses that the model is good enough for."""
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
                    flight.name: {
                        **_extent(flight.table),
                        "samples_with_std": len(flight.rows),
                        **_score_metrics(flight.scores),
                    }
                    for flight in self.evaluations
                },
                "test_together": _score_metrics(scores(self.evaluations)),
                "verdict": self.verdict.to_dict(),
                "flight_mechanics": self.mechanics.to_dict(),
                **{part.name: part.to_dict() for part in self.supplements},
                **({"assumed": self.assumed} if self.assumed else {}),
                "messages": self.messages,
            }
        )

    def summary(self) -> str:
        """Return the text of the command line: scores of all test flights together, and a line or table of each."""
        fit, tested, verdict = self.fit, self.evaluations, self.verdict
        done = "interrupted" if fit["interrupted"] else "fitted"
        record = (
            f"{done} in {fit['seconds']:.1f} s on {fit['samples']} of {fit['samples_available']} "
            f"samples, "
            if "seconds" in fit
            else ""
        )
        likelihood = f"log likelihood {fit['log_marginal_likelihood']:.1f}"
        lines = [f"{self.aircraft.name}: {record}{likelihood}"]
        if not fit["converged"]:
            lines.append(f"not converged after {fit['iterations']} iterations: raise max_iter")
        together = f"{len(tested)} test flights together"
        names = [*COEFFICIENTS, "longitudinal", "lateral", "all"]
        lines += [
            "",
            f"flight {tested[0].name}" if len(tested) == 1 else together,
            _score_text(scores(tested), names),
            "",
        ]
        for flight in tested if len(tested) > 1 else ():
            lines += [f"flight {flight.name}", _score_text(flight.scores, ["all"]), ""]
        if fit["reconstruction"]:
            lines.append(f"flight paths {fit['reconstruction']}")
        warnings = enumerate(verdict.warnings[:N_WARNINGS], start=1)
        lines += [
            *(line for part in self.supplements for line in part.summary()),
            "",
            f"error {verdict.error:.3f} of the spread, {100 * verdict.coverage:.1f} % in 95 % bands",
            *filter(None, [verdict.compared()]),
            *(f"{use.purpose + ':':<22}{use.fit}, {use.reason}" for use in verdict.uses),
            *(f"warning {k}: {warning}" for k, warning in warnings),
        ]
        lines += ["", "assumed, as nothing was told:"] if self.assumed else []
        for assumption in self.assumed:
            lines += wrap(assumption, 110, initial_indent="  - ", subsequent_indent="    ")
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
            facts = {"options": self.settings, "fit": self.fit, "flights": list(self.train)}
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
            units=getattr(self.pipeline, "control_units_", {}),
            command=self.command,
        )

    def _facts(self) -> dict[str, str]:
        """Return the facts of the fit as text; empty where a fact does not apply."""
        fit, aircraft, settings = self.fit, self.aircraft, self.settings
        regressor = self.pipeline[-1]
        tested = {flight.name: flight.table for flight in self.evaluations}
        sources = thrust_sources(settings["thrust"], [*self.train.values(), *tested.values()])
        lags = {name: row["applied"] for name, row in fit["lags"].items()}
        late = [f"{name} {lag:.3g} s" for name, lag in lags.items() if lag]
        has_record = "seconds" in fit
        return {
            "Aircraft": f"{aircraft.name}, {aircraft.mass:g} kg, wing area "
            f"{aircraft.wing_area:.4g} m², span {aircraft.span:.4g} m, chord {aircraft.chord:.4g} m",
            "Learned from": _durations(self.train),
            "Tested on": _durations(tested),
            "Regressors": ", ".join(fit["regressors"]),
            "Structure": f"{regressor.structure}, trend {regressor.trend or 'none'}",
            "Inference": fit["inference"],
            "Log likelihood": f"{fit['log_marginal_likelihood']:,.1f}",
            "Iterations": f"{fit['iterations']}"
            + " (not converged: raise max_iter)" * (not fit["converged"]),
            "Samples": f"{fit['samples']:,} of {fit['samples_available']:,}" if has_record else "",
            "Time of the fit": f"{fit['seconds']:.1f} s" if has_record else "",
            "Thrust": " or ".join(THRUSTS[name] for name in sources),
            "Flight paths": fit["reconstruction"] or "",
            "Lags": ", ".join(late) or "none to correct",
            "Other loads": ", ".join(settings["external_forces"]),
            "Fit": "interrupted; this is the best model until then" * fit["interrupted"],
            "Versions": ", ".join(f"{name} {n}" for name, n in software_versions().items()),
        }


def air_of(pipeline: Pipeline) -> str:
    """Return gusts and steady wind of the training flights, as reconstruction found them; empty where it did not."""
    step = pipeline["flightpathreconstruction"]
    if not getattr(step, "used_", False):
        return ""
    if step.air_motion_ is not None:
        return step.air_motion_.summary
    parts = [f"gusts {step.gust_std_:.2g} m/s rms"]
    winds = step.calibration_.pivot_table("estimate", "flight", "constant", sort=False)
    for name, row in winds.iterrows():
        north, east = row[["wind_north", "wind_east"]]
        way = np.rad2deg(np.arctan2(-east, -north)) % 360
        parts.append(f"steady wind of {name} {np.hypot(north, east):.2g} m/s from {way:.0f} deg")
    return ", ".join(parts[:4])


def _durations(flights: Mapping[str, pd.DataFrame]) -> str:
    """Return flights with their durations and rates."""
    extents = {name: _extent(table) for name, table in flights.items()}
    return ", ".join(
        f"{name} ({extent['duration']:.4g} s at {extent['sample_rate']:.3g} Hz)"
        for name, extent in extents.items()
    )


def _extent(table) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    rate = 1 / np.median(np.diff(time)) if len(time) > 1 else np.nan
    return {"samples": len(table), "duration": float(np.ptp(time)), "sample_rate": float(rate)}


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
    measured, truth = tables["measured"].loc[names], tables.get("truth", pd.DataFrame())
    columns = {
        "rel. error [%]": 100 * measured["median_relative_error"],
        "NRMSE": measured["normalized_rmse"],
        "in 95 % band [%]": 100 * measured["interval_coverage"],
    }
    if len(truth):
        columns["rel. error of truth [%]"] = 100 * truth["median_relative_error"]
        columns["NRMSE of truth"] = truth["normalized_rmse"]
    form = {name: ("{:.3f}" if "NRMSE" in name else "{:.1f}").format for name in columns}
    return pd.DataFrame(columns, index=names).to_string(formatters=form)


# -- records of the fit, and evaluation
# -------------------------------------------------------------------------------------

STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
# rows of a flight at which standard deviations are computed; they cost N^2 each, means only N
STD_ROWS = 3000


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor, path = pipeline[-1], pipeline["flightpathreconstruction"]
    used = getattr(path, "used_", False)
    how = "reconstructed from all sensors" if used else "not reconstructed, only smoothed"
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    input_std = np.sqrt(np.diag(regressor.input_covariance_)) * pipeline["standardscaler"].scale_
    return {
        "inference": regressor.inference_,
        "weights": {name: _by_coefficient(values) for name, values in regressor.weights_.items()},
        "regressors": names,
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter_),
        "converged": bool(regressor.converged_),
        "interrupted": bool(regressor.interrupted_),
        "noise_std": _by_coefficient(regressor.noise_variance_**0.5),
        "input_noise_std": dict(zip(names, map(float, input_std), strict=True)),
        "paths_reconstructed": used,
        "paths_not_converged": [
            str(name)
            for name, converged in getattr(path, "converged_", {}).items()
            if not converged
        ],
        "gusts_unknown": getattr(path, "doubt_", ""),
        "reconstruction": f"{how}: {path.reason_}"
        if isinstance(path, FlightPathReconstruction)
        else None,
        "lags": lags_of(pipeline),
    }


def lags_of(pipeline: Pipeline) -> dict[str, dict[str, Any]]:
    """Return the lags of channels by group, as of `LagCorrector`; empty without this step."""
    step = pipeline.named_steps.get("lagcorrector")
    if not isinstance(step, LagCorrector):
        return {}
    table = step.lags_.astype(object).where(step.lags_.notna(), None)
    return {str(group): dict(row) for group, row in table.iterrows()}


def lags_message(found: dict[str, dict[str, Any]]) -> str:
    """Return the lags that were found in the flights of the fit and corrected, in one line; empty without any."""
    lags = {name: row["applied"] for name, row in found.items() if row["remark"] == "removed"}
    parts = [
        f"{name} {abs(lag):.3f} s {'late' if lag > 0 else 'early'}" for name, lag in lags.items()
    ]
    early = (
        " Surfaces that are early are commands of slower servos."
        if lags.get("surfaces", 0) < 0
        else ""
    )
    return f"Lags against the inertial unit, corrected: {', '.join(parts)}.{early}" if parts else ""


def thrust_sources(thrust: str | None, tables: Iterable[Any]) -> list[str]:
    """Return where the thrust of flights is from: "columns", "propeller" or "none"."""
    if thrust is None:
        return ["none"]
    return sorted(
        {"columns" if {*THRUST_FORCES} & set(table.columns) else "propeller" for table in tables}
    )


def _by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))


def evaluate(
    name: str,
    table: pd.DataFrame,
    pipeline: Pipeline,
    aircraft: Aircraft,
    settings: dict,
    fit: dict,
) -> Evaluation:
    """Predict a flight and replay it, with the settings and facts of `identify`."""
    notify(f"evaluating {name}")
    loads = {key: settings[key] for key in ("thrust", "external_forces")}
    measured = aerodynamic_coefficients(table, aircraft, **loads).to_numpy()
    regressors, noise_ratio = flight_regressors(pipeline, table)
    regressor = pipeline[-1]
    mean = regressor.predict(regressors)
    step = -(-len(table) // STD_ROWS)
    rows = np.arange(step // 2, len(table), step)
    std = regressor.predict(
        regressors[rows], return_std=True, include_input_noise=noise_ratio[rows]
    )[1]
    std = np.column_stack([np.interp(np.arange(len(table)), rows, column) for column in std.T])
    replayed = None
    if {*EULER, *EARTH_VELOCITY} <= set(table.columns):  # from which the integration starts
        replayed = replay(table, aircraft, mean, horizon=min(settings["horizons"]), **loads)
    names, baseline = [coefficient + TRUTH_SUFFIX for coefficient in COEFFICIENTS], None
    if linear := fit.get("least_squares"):
        weights = np.array([list(linear[name].values()) for name in COEFFICIENTS])
        baseline = weights[:, 0] + named(pipeline, regressors).to_numpy() @ weights[:, 1:].T
    return Evaluation(
        name=name,
        time=table["time"].to_numpy(float),
        table=table,
        measured=measured,
        mean=mean,
        std=std,
        measured_std=np.sqrt(std**2 + regressor.noise_variance_),
        rows=rows,
        regressors=regressors,
        truth=table[names].to_numpy(float) if set(names) <= set(table) else None,
        baseline=baseline,
        replay=replayed,
    )


def fit_least_squares(
    pipeline: Pipeline, regressors: Matrix, Y: pd.DataFrame
) -> dict[str, dict[str, float]]:
    """Return intercept and slopes of each coefficient (n, 6) by least squares, where it is observed.

    ``regressors`` (n, d) are inputs of the last step; the slopes are in the units before the scaler
    of the pipeline.
    """
    table = named(pipeline, regressors)
    fitted = {}
    for coefficient, y in zip(COEFFICIENTS, np.asarray(Y, dtype=float).T, strict=True):
        observed = np.isfinite(y)
        linear = LinearRegression().fit(table[observed], y[observed])
        slopes = dict(zip(map(str, table), map(float, linear.coef_), strict=True))
        fitted[coefficient] = {"intercept": float(linear.intercept_), **slopes}
    return fitted


def named(pipeline: Pipeline, regressors: Matrix) -> pd.DataFrame:
    """Return the regressors (n, d) of the last step by name, in their units before the scaler."""
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    return pd.DataFrame(pipeline["standardscaler"].inverse_transform(regressors), columns=names)


def group_means(table: pd.DataFrame) -> pd.DataFrame:
    """Return the means of the scores over the longitudinal, the lateral and all coefficients."""
    groups = {"longitudinal": LONGITUDINAL, "lateral": LATERAL, "all": COEFFICIENTS}
    return pd.DataFrame(
        {group: table.loc[list(members)].mean() for group, members in groups.items()}
    ).T


def usable_flights_of_model(pipeline: Pipeline, flights: Flights) -> Flights:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Raises ValueError if the pipeline is not of `identify`, or a flight lacks a column that its
    training flights had.
    """
    check_identified(pipeline)
    regressors = pipeline["regressorselector"].regressors
    columns = regressor_columns([pd.DataFrame(columns=pipeline[0].feature_names_in_)], regressors)
    return usable_flights(flights, regressors, columns)


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    steps = getattr(pipeline, "named_steps", {})
    if not set(steps) >= STEPS or not isinstance(pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got a model of {list(steps) or type(pipeline).__name__}, but expected what "
            f"make_identification_pipeline "
            "makes, with a DependentGPRegressor: learn it with identify."
        )
