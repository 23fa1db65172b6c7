"""The workflow from flights to an evaluated model, and its result."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch

from skdgp._compute.files import json_text, plain, text_writer, write_together
from skdgp._compute.progress import notify
from skdgp._compute.typing import Matrix, Seed
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp._regressor import DependentGPRegressor
from skdgp.calibration import CalibratedRegressor
from skdgp.design import FlownPlan, Plan, coefficient_noise, posterior_information
from skdgp.design._flown import compare_with_plan, read_plan
from skdgp.dynamics import Aircraft, aerodynamic_coefficients, as_aerodynamics
from skdgp.identification import _flights, _model_file
from skdgp.identification._evaluation import Evaluation, evaluate_flight, fit_least_squares, group_means, scores
from skdgp.identification._flights import Flights
from skdgp.identification._pipeline import (
    check_aircraft,
    clock_of,
    default_regressor,
    flight_noise,
    flown_turbulence,
    make_identification_pipeline,
    regressor_and_scale,
)
from skdgp.model_selection import thin_targets
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay
from skdgp.plotting._style import display_unit
from skdgp.preprocessing import FlightPathReconstruction
from skdgp.report import FlightRecord, ModelSummary, ReportContent, render_report, write_report

FORMAT = 1  # of the metrics
EXACT_SAMPLES = 755  # rows that exact inference learns from in a minute
STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
WIDTHS = {
    "spherical": "one width for all regressors",
    "diag": "one width for each regressor",
    "full": "a full matrix of widths",
    "tied": "one width for each regressor, common to all outputs",
}
STRUCTURES = {
    "joint": "the trend and processes",
    "additive": "the trend, main effects and processes",
    "trend": "the trend alone",
}
THRUSTS = {
    "columns": "from the thrust columns of the flights",
    "propeller": "from the propeller's bench table",
    "none": "none subtracted: that of an engine is part of the coefficients",
}
KERNELS = {
    "joint": "convolved Gaussian, {widths}",
    "additive": "functions of one regressor each, and convolved Gaussian, {widths}",
    "trend": "none: the trend alone",
}
MARGIN, WIDTH = 16, 11  # characters of the summary's first column, and of the others


def identify(
    flights: Any,
    aircraft: Aircraft | str | os.PathLike,
    *,
    test: Any = None,
    regressors: str | Sequence[str] = "quasi-steady",
    reconstruction: Any = "auto",
    lags: str | dict | None = None,
    thrust: str | None = "auto",
    external_forces: Sequence[str] = (),
    samples: int | str | None = None,
    regressor: DependentGPRegressor | None = None,
    calibrate: bool = False,
    symmetric: bool = False,
    gusty: bool = False,
    horizons: Sequence[float] = (2.0, 10.0),
    random_state: Seed = 0,
    n_jobs: int | None = None,
    servos: Any = None,
    airborne: bool | float = True,
) -> Identification:
    """Learn a model of the six coefficients from flights, and judge it on others.

    Measured coefficients follow from inverse dynamics. A pipeline (`make_identification_pipeline`) learns them from
    the training flights. The model then predicts the test flights, and its predictions are scored and replayed.

    Listeners of `skdgp.listening` are called at each stage too, with ``(stage, 0, nan)``: "reading", "coefficients",
    "transforming", "evaluating NAME". In a block of `skdgp.checkpointing` a killed fit resumes. Ctrl-C
    during the fit keeps the best model so far.

    Parameters
    ----------
    flights : DataFrame, path, dict of name to table, or list of tables and paths
        Training flights at their full rate. A column ``flight`` separates several flights in one table.
    aircraft : Aircraft or path
        A path ends in .json or .toml.
    test : as flights, optional
        Test flights. By default the last training flight is held out, or the last quarter of a single one.
    regressors, reconstruction, lags
        As of :func:`make_identification_pipeline`.
    thrust, external_forces
        As of :func:`skdgp.dynamics.aerodynamic_coefficients`. ``thrust=None`` needs the throttle or the speed of the
        propeller among the regressors, best with the airspeed, unless the aircraft glides.
    samples : int, "all" or None
        Rows to learn from, spread over the flights. None: all, or 755 by exact inference.
    regressor : DependentGPRegressor, optional
        By default :func:`default_regressor`.
    calibrate : bool
        Whether :class:`skdgp.calibration.CalibratedRegressor` scales standard deviations to what training flights
        show that are held out in turn. It takes one more fit for each of up to 5 groups of flights.
    symmetric, gusty
        As of :func:`make_identification_pipeline`, not with ``calibrate``.
    horizons : sequence of float
        Seconds from restart to restart of the replay.
    random_state, n_jobs
        Of the default regressor; not used with a given one.
    servos, airborne
        As of :func:`skdgp.io.read_flight`, for paths of logs of autopilots.

    Returns
    -------
    Identification
        The model, its scores and how it came about.

    Raises
    ------
    ValueError
        If a flight lacks columns or usable rows, a name occurs twice, the thrust is not known, or there is a single
        training flight to calibrate on.
    TypeError
        If ``regressor`` is not a DependentGPRegressor.
    OSError
        If a file cannot be read.

    Examples
    --------
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.datasets import load_example_flights
    >>> from skdgp.identification import identify
    >>> example = load_example_flights()
    >>> result = identify(
    ...     example.train[example.train["time"] < 20],
    ...     example.aircraft,
    ...     test=example.test[example.test["time"] < 10],
    ...     samples=60,
    ...     regressor=DependentGPRegressor(n_latent=1, max_iter=30, random_state=0),
    ...     horizons=[2.0],
    ... )
    >>> result.fit["samples"], sorted(result.metrics["test"])
    (60, ['two_altitudes'])
    >>> mean, std = result.pipeline.predict(example.test[:400], return_std=True)
    >>> mean.shape
    (400, 6)
    """
    if regressor is None:
        regressor = default_regressor(gusty=gusty, random_state=random_state, n_jobs=n_jobs)
    if not isinstance(regressor, DependentGPRegressor):
        raise TypeError(
            f"Got {type(regressor).__name__} as the regressor, but expected a DependentGPRegressor: fit other "
            "regressors with make_identification_pipeline."
        )
    loads: dict[str, Any] = {"thrust": thrust, "external_forces": list(external_forces)}
    with recorded_warnings() as messages:
        _announce("reading")
        aircraft = read_aircraft(aircraft)
        reading = {"needed": _flights.MEASURED, "servos": servos, "airborne": airborne}
        train = _flights.named_flights(flights, **reading)
        test = {} if test is None else _flights.named_flights(test, default="test flight", **reading)
        train, test, held_out = _flights.train_and_test(train, test)
        if calibrate:
            _check_calibration(train, symmetric, gusty)
        columns = _flights.regressor_columns(train.values(), regressors)
        train, test = (_flights.usable_flights(part, regressors, columns) for part in (train, test))
        _flights.warn_of_short_flights(train, regressors)
        if thrust is None:
            _flights.warn_of_engine(train, regressors)
        # The steps of the pipeline meet the same faults again.
        warnings.filterwarnings("ignore", WARNING_START, FlightDataWarning)

        _announce("coefficients")
        table = pd.concat(train.values(), ignore_index=True)
        Y = aerodynamic_coefficients(table, aircraft, **loads)
        _flights.check_known(Y, table)
        targets = thin_targets(Y, _n_samples(samples, regressor, len(Y)))

        _announce("transforming")
        pipeline = make_identification_pipeline(
            aircraft,
            regressors=regressors,
            reconstruction=reconstruction,
            lags=lags,
            mixer=_mixer(table),
            regressor=CalibratedRegressor(clone(regressor)) if calibrate else regressor,
            symmetric=symmetric,
            gusty=gusty,
        )
        began = time.monotonic()
        X = _fit(pipeline, table, targets)
        pipeline.noise_ = flight_noise(pipeline, table, aircraft, regressors=X, **loads)
        seconds = time.monotonic() - began

        fit = {
            "samples": int(targets.notna().any(axis=1).sum()),
            "samples_available": int(Y.notna().any(axis=1).sum()),
            "values": int(targets.notna().sum().sum()),
            "thrust": _thrust_sources(thrust, train.values()),
            **fit_facts(pipeline),
            "least_squares": fit_least_squares(pipeline, X, targets),
            "seconds": round(seconds, 3),
            "interrupted": any(message.startswith("The fit was interrupted") for message in messages),
            "flights": {name: len(part) for name, part in train.items()},
        }
        settings = {"samples": fit["samples"], **loads, **_settings(pipeline, reconstruction, horizons)}
        evaluations = _evaluated(test, pipeline, aircraft, settings, fit)
    return Identification(
        title=f"{aircraft.name}: aerodynamic coefficients",
        aircraft=aircraft,
        pipeline=pipeline,
        settings=settings,
        fit=fit,
        train=train,
        evaluations=evaluations,
        messages=messages,
        held_out=held_out,
    )


def validate(
    model: Bunch,
    flights: Any,
    *,
    aircraft: Aircraft | str | os.PathLike | None = None,
    plan: Plan | str | os.PathLike[str] | None = None,
    horizons: Sequence[float] = (2.0, 10.0),
    servos: Any = None,
    airborne: bool | float = True,
    **loads: Any,
) -> Identification:
    """Judge a model that exists on flights.

    Raises ValueError if the model is not of ``identify``, a flight lacks a column of the model, or the plan is of
    another aircraft, of other regressors, or was not flown.

    Parameters
    ----------
    model : Bunch
        As of :func:`load_model`.
    flights : as of :func:`identify`
        The flights to predict and replay.
    aircraft : Aircraft or path, optional
        In place of the model's, such as with another mass.
    plan : Plan or path, optional
        What was to be flown, or the plan.json of ``python -m skdgp plan``: what it expected is compared with what was
        found (`Identification.plan`). Give the model that the plan was made with, or one learned from its flights and
        these: its standard deviations stand beside those of the plan.
    horizons : sequence of float
        Seconds from restart to restart of the replay.
    servos, airborne
        As of :func:`skdgp.io.read_flight`, for paths of logs of autopilots.
    **loads
        ``thrust`` and ``external_forces``, where they differ from those of the model's fit.

    Returns
    -------
    Identification
        Without training flights.
    """
    settings = {"thrust": "auto", "external_forces": []} | model.get("options", {}) | loads
    settings["horizons"] = list(horizons)
    with recorded_warnings() as messages:
        _announce("reading")
        named = _flights.named_flights(flights, servos=servos, airborne=airborne)
        flights = usable_flights_of_model(model.pipeline, named)
        for name in flights.keys() & set(model.get("flights", [])):
            _warn(f"The model learned from a flight {name!r}: if it is this one, its errors say nothing about others.")
        aircraft = read_aircraft(model.aircraft if aircraft is None else aircraft)
        flown = None if plan is None else _flown_plan(plan, model.pipeline, aircraft, flights)
        fit = fit_facts(model.pipeline) | model.get("fit", {})
        evaluations = _evaluated(flights, model.pipeline, aircraft, settings, fit)
    return Identification(
        title=f"{aircraft.name}: a model on other flights",
        aircraft=aircraft,
        pipeline=model.pipeline,
        settings=settings,
        fit=fit,
        train={},
        evaluations=evaluations,
        messages=messages,
        plan=flown,
    )


def _flown_plan(plan: Any, pipeline: Pipeline, aircraft: Aircraft, flights: Flights) -> FlownPlan:
    """Return what a plan expected beside what was found in flights."""
    record = read_plan(plan)
    tables = [one.assign(**pipeline[: list(pipeline.named_steps).index("regressorselector")].transform(one))
              for one in flights.values()]  # fmt: skip
    names = list(as_aerodynamics(pipeline).regressors)
    at = [record["at"].get(name, np.nan) for name in names]
    information = posterior_information(pipeline, at, record["known"]["coefficients"])
    return compare_with_plan(record, pd.concat(tables), aircraft, coefficient_noise(pipeline), information)


def usable_flights_of_model(pipeline: Pipeline, flights: Flights) -> Flights:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Raises ValueError if the pipeline is not of `identify`, or a flight lacks a column that its training flights had.
    """
    check_identified(pipeline)
    regressors = pipeline["regressorselector"].regressors
    columns = _flights.regressor_columns([pd.DataFrame(columns=pipeline[0].feature_names_in_)], regressors)
    flights = _flights.usable_flights(flights, regressors, columns)
    warnings.filterwarnings("ignore", WARNING_START, FlightDataWarning)
    return flights


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    steps = getattr(pipeline, "named_steps", {})
    if not set(steps) >= STEPS or not isinstance(regressor_and_scale(pipeline)[0], DependentGPRegressor):
        raise ValueError(
            f"Got a model of {list(steps) or type(pipeline).__name__}, but expected what make_identification_pipeline "
            "makes, with a DependentGPRegressor: learn it with identify."
        )


def read_aircraft(aircraft: Aircraft | str | os.PathLike) -> Aircraft:
    """Return the aircraft, read from a file where a path is given."""
    if not isinstance(aircraft, str | os.PathLike):
        return check_aircraft(aircraft)
    path = Path(aircraft)
    if not path.exists():
        raise FileNotFoundError(f"Got {path} as the aircraft, but there is no such file.")
    readers = {".json": Aircraft.from_json, ".toml": Aircraft.from_toml}
    if path.suffix.lower() not in readers:
        raise ValueError(f"Got {path} as the aircraft, but expected a file that ends in .json or .toml.")
    return readers[path.suffix.lower()](path)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of `identify`: a model of an aircraft, its evaluation on test flights, and the record of the fit.

    Attributes
    ----------
    pipeline : Pipeline
        Fitted: a raw flight table in, six coefficients out.
    aircraft : Aircraft
    settings, fit : dict
        What was asked for or chosen; samples, likelihood, noise and time of the fit.
    train : dict of str to DataFrame
        Usable rows of the training flights; empty for a model that existed before.
    evaluations : list of Evaluation
        Predictions and replay of each test flight.
    messages : list of str
        Warnings that arose.
    held_out : str or None
        What was held out because no test flight was named.
    plan : FlownPlan or None
        What a plan expected beside what was found.
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
    plan: FlownPlan | None = None
    title: str = ""
    command: str | None = None
    created: str = field(default_factory=lambda: datetime.now().astimezone().isoformat(timespec="seconds"))

    @cached_property
    def metrics(self) -> dict:
        """Every number of the report as plain JSON values, None where it is not finite: what metrics.json holds."""
        return plain(
            {
                "format": FORMAT,
                "created": self.created,
                "command": self.command,
                "versions": _model_file.software_versions(),
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
                        "states": {against: table.to_dict("records") for against, table in one.states.items()},
                    }
                    for one in self.evaluations
                },
                "test_together": _score_metrics(self.evaluations),
                **({} if self.plan is None else {"plan": self.plan.to_dict()}),
                "messages": self.messages,
            }
        )

    def summary(self) -> str:
        """Return what the command line prints: scores of all test flights together, and a line or table of each."""
        fit, tested = self.fit, self.evaluations
        first = f"{self.aircraft.name}: "
        if "seconds" in fit:
            first += f"{'interrupted' if fit['interrupted'] else 'fitted'} in {fit['seconds']:.1f} s on "
            first += f"{fit['samples']} of {fit['samples_available']} samples, "
        lines = [f"{first}log likelihood {fit['log_marginal_likelihood']:.1f}"]
        if not fit.get("converged", True):
            lines.append(f"not converged after {fit['iterations']} iterations: raise max_iter")
        lines.append("")
        if len(tested) == 1:
            lines += [f"flight {tested[0].name}", *_score_table(tested), "", *_state_lines(tested[0])]
        else:
            lines += [f"{len(tested)} test flights together", *_score_table(tested), ""]
            for one in tested:
                lines += [f"flight {one.name}", _mean_row([one], "all"), *_state_lines(one)]
        paths = _reconstruction(self.pipeline)
        facts = [f"flight paths {paths}"] if paths else []
        facts += [] if self.plan is None else _plan_lines(self.plan)
        return "\n".join([*lines, "", *facts, *_comparison(tested)]).rstrip()

    def evaluate(self, flight: Any) -> Evaluation:
        """Predict and replay another flight, a table or a path."""
        with warnings.catch_warnings():
            flights = usable_flights_of_model(self.pipeline, _flights.named_flights(flight))
            if len(flights) != 1:
                raise ValueError(f"Got {len(flights)} flights, but expected one: evaluate each by itself.")
            return _evaluated(flights, self.pipeline, self.aircraft, self.settings, self.fit)[0]

    def report(self, path: str | os.PathLike) -> Path:
        """Write the report, one HTML file, and return its path."""
        return write_report(path, self._report_content())

    def save(self, path: str | os.PathLike) -> Path:
        """Write model.joblib, metrics.json and report.html into a folder, all or none, and return the path.

        A path that ends in .joblib is that of the model alone.
        """
        path = Path(path)
        if path.suffix == ".joblib":
            return _model_file.save_model(path, self.pipeline, self.aircraft, **self._model_facts())
        path.mkdir(parents=True, exist_ok=True)
        write_together(path, self.writers())
        return path

    def writers(self) -> dict[str, Callable[[Path], object]]:
        """Return by file name what writes report, metrics and, of a model that was learned here, the model."""
        _announce("report")
        if find_spec("matplotlib") is None:
            _warn('No pictures in the report: they need pip install "skdgp[plot]".')
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
        regressor, fit = regressor_and_scale(self.pipeline)[0], self.fit
        aircraft, coupled = self.aircraft, fit["structure"] != "trend"
        return ReportContent(
            title=self.title,
            train=[FlightRecord(name=name, table=table) for name, table in self.train.items()],
            test=self.evaluations,
            model=ModelSummary(
                n_samples=fit.get("samples"),
                n_available=fit.get("samples_available"),
                regressors=fit["regressors"],
                n_latent=regressor.n_latent_,
                n_private=len(COEFFICIENTS) if regressor.private_latents and coupled else 0,
                kernel=KERNELS[fit["structure"]].format(widths=WIDTHS[regressor.covariance_type]),
                trend=regressor.trend or "none",
                inference=regressor.inference_ + " (chosen by auto)" * (regressor.inference == "auto"),
                log_marginal_likelihood=fit["log_marginal_likelihood"],
                n_iter=fit["iterations"],
                max_iter=regressor.max_iter,
                converged=fit.get("converged", True),
                fit_seconds=fit.get("seconds"),
                noise_std=regressor.noise_variance_**0.5,
                correlation=regressor.output_correlation() if coupled else None,
                versions=_model_file.software_versions(),
                extra=self._remarks(),
            ),
            aircraft={
                "Aircraft": aircraft.name,
                "Mass": f"{aircraft.mass:g} kg",
                "Wing area, span, chord": f"{aircraft.wing_area:.4g} m², {aircraft.span:.4g} m, {aircraft.chord:.4g} m",
            },
            envelope=self._envelope(),
            effects=self._effects(),
            plan=self.plan,
            messages=self.messages,
            command=self.command,
        )

    def _envelope(self) -> EnvelopeDisplay | None:
        """Return where the data are and what the model knows around them; None of a single regressor."""
        names, scaler = self.pipeline["regressorselector"].regressors_, self.pipeline["standardscaler"]
        if len(names) < 2 or not self.train:
            return None
        tested = [scaler.inverse_transform(one.regressors) for one in self.evaluations]
        path = pd.DataFrame(np.concatenate(tested), columns=names) if tested else None
        return EnvelopeDisplay.compute(self.pipeline[-2:], self._training_regressors(), flight=path, n_grid=12)

    def _effects(self) -> EffectsDisplay | None:
        """Return the effect of each regressor; None of a compact model without its training flights."""
        compact = regressor_and_scale(self.pipeline)[0].inference_ == "compact"
        if compact and not self.train:
            return None
        return EffectsDisplay.compute(self.pipeline[-2:], self._training_regressors() if compact else None)

    def _training_regressors(self) -> pd.DataFrame:
        return pd.concat([self.pipeline[:-2].transform(table) for table in self.train.values()])

    def _remarks(self) -> dict[str, str]:
        fit, tables = self.fit, [*self.train.values(), *(one.table for one in self.evaluations)]
        sources = _thrust_sources(self.settings["thrust"], tables)
        remarks = {"Thrust": " or ".join(THRUSTS[name] for name in sources)}
        paths = _reconstruction(self.pipeline)
        if paths:
            remarks["Flight paths"] = paths
        lags = {name: row["applied"] for name, row in fit.get("lags", {}).items() if row["applied"]}
        if "lags" in fit:
            remarks["Lags"] = ", ".join(f"{name} {lag:.3g} s" for name, lag in lags.items()) or "none to correct"
        errors = {name: float(np.nanmean(values)) for name, values in fit.get("structure_errors", {}).items()}
        if errors:
            words = " and ".join(f"{error:.3g} of {STRUCTURES[name]}" for name, error in errors.items())
            remarks["Structure"] = (
                f"{STRUCTURES[fit['structure']]}. Mean squared error of quarters of the training flights, predicted "
                f"from the rest, over the variance: {words}"
            )
        noisy = {name: value for name, value in fit["input_noise_std"].items() if value > 0}
        if noisy:
            remarks["Noise of the regressors"] = ", ".join(f"{name} {value:.2g}" for name, value in noisy.items())
        if self.settings["external_forces"]:
            remarks["Other loads"] = ", ".join(self.settings["external_forces"])
        comparison = _comparison(self.evaluations)
        if comparison:
            remarks["Least squares"] = "; ".join(comparison)
        if len(self.evaluations) > 1:
            means = group_means(scores(self.evaluations)["measured"])
            remarks["All test flights"] = "; ".join(
                f"{group} NRMSE {row.normalized_rmse:.3f}, {100 * row.median_relative_error:.1f} % median relative "
                f"error, {100 * row.interval_coverage:.1f} % in the 95 % band"
                for group, row in means.iterrows()
            )
        if "std_scale" in fit:
            factors = ", ".join(f"{name} {factor:.2f}" for name, factor in fit["std_scale"].items())
            remarks["Calibration"] = f"standard deviations scaled to flights held out in turn: {factors} times"
        step = max(-(-len(one.time) // len(one.rows)) for one in self.evaluations)
        if step > 1:
            remarks["Bands"] = f"computed at one row in {step}, interpolated between"
        if any(one.truth is not None for one in self.evaluations):
            remarks["Truth"] = "contains gusts that no sensor felt: coverage and NLPD against it are in metrics.json"
        if fit.get("interrupted"):
            remarks["Fit"] = "interrupted; this is the best model until then"
        return remarks


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """Show warnings as usual, and yield the list of their messages, each once."""
    messages: list[str] = []
    with warnings.catch_warnings():
        show = warnings.showwarning

        def record(message, category, filename, lineno, file=None, line=None):
            text = " ".join(str(message).split())
            if text not in messages:
                messages.append(text)
            show(message, category, filename, lineno, file, line)

        warnings.showwarning = record
        yield messages


def _announce(stage):
    notify(stage, 0, np.nan)


def _warn(message):
    warnings.warn(message, stacklevel=3)


def _check_calibration(train, symmetric, gusty) -> None:
    if len(train) < 2:
        raise ValueError(
            f"Got one training flight ({next(iter(train))!r}) to calibrate on, but expected at least two, to hold "
            "each out in turn: give more flights, or do not calibrate."
        )
    if symmetric or gusty:
        raise ValueError(
            f"Got calibrate with symmetric={symmetric}, gusty={gusty}, but expected one or the other: calibration "
            "is by measured coefficients of flights held out, in the same air."
        )


def _fit(pipeline, table, targets) -> Matrix:
    """Fit a pipeline as its ``fit`` does, and return the regressors (n, d), which are not computed twice."""
    if pipeline.symmetric or pipeline.gusty:
        return pipeline.fit(table, targets)[:-1].transform(table)
    groups = {"groups": table["flight"]} if isinstance(pipeline[-1], CalibratedRegressor) else {}
    X = pipeline[:-1].fit_transform(table, targets)
    pipeline[-1].fit(X, targets, **groups, **clock_of(pipeline[-1], table))
    pipeline.turbulence_ = flown_turbulence(pipeline, table)
    return X


def _n_samples(samples, regressor, n_rows) -> int:
    if samples is None:
        return EXACT_SAMPLES if regressor.inference == "exact" else n_rows
    return n_rows if samples == "all" else samples


def _mixer(table) -> str | None:
    """Return "passthrough" for an aircraft without elevons that lacks elevator or aileron."""
    has_elevons = {"elevon_left", "elevon_right"} & set(table.columns)
    return None if has_elevons or {"elevator", "aileron"} <= set(table.columns) else "passthrough"


def _evaluated(flights, pipeline, aircraft, settings, fit) -> list[Evaluation]:
    loads, linear = {name: settings[name] for name in ("thrust", "external_forces")}, fit.get("least_squares")
    evaluations = []
    for name, table in flights.items():
        _announce(f"evaluating {name}")
        evaluations.append(evaluate_flight(pipeline, aircraft, name, table, settings["horizons"], loads, linear))
    return evaluations


def fit_facts(pipeline: Pipeline) -> dict:
    """Return what a fitted pipeline knows of its fit."""
    regressor, _ = regressor_and_scale(pipeline)
    names = [str(name) for name in pipeline["regressorselector"].regressors_]
    input_std = np.sqrt(np.diag(regressor.input_covariance_)) * pipeline["standardscaler"].scale_
    facts = {
        "inference": regressor.inference_,
        "structure": regressor.structure_,
        "regressors": names,
        "log_marginal_likelihood": float(regressor.log_marginal_likelihood_value_),
        "iterations": int(regressor.n_iter_),
        "limit_reached": bool(regressor.n_iter_ >= regressor.max_iter),
        "converged": bool(getattr(regressor, "converged_", True)),  # models of version 0.1 do not say
        "evaluations": int(regressor.n_evaluations_),
        "noise_std": _by_coefficient(regressor.noise_variance_**0.5),
        "input_noise_std": dict(zip(names, map(float, input_std), strict=True)),
        "paths_reconstructed": getattr(pipeline["flightpathreconstruction"], "used_", False),
        "reconstruction": _reconstruction(pipeline),
    }
    if regressor.structure_errors_:
        facts["structure_errors"] = {
            name: [float(value) for value in errors] for name, errors in regressor.structure_errors_.items()
        }
    if isinstance(pipeline[-1], CalibratedRegressor):
        facts["std_scale"] = _by_coefficient(pipeline[-1].std_scale_)
        facts["guaranteed_level"] = _by_coefficient(pipeline[-1].max_level_)
    if "lagcorrector" in pipeline.named_steps:
        facts["lags"] = pipeline["lagcorrector"].lags_.to_dict("index")
    return facts


def _settings(pipeline, reconstruction, horizons) -> dict:
    """Return what a pipeline was made with, by the names of the command line's options."""
    regressor, _ = regressor_and_scale(pipeline)
    settings = {
        "inference": regressor.inference,
        "structure": regressor.structure,
        "regressors": pipeline["regressorselector"].regressors,
        "reconstruction": "none" if reconstruction in (None, "passthrough") else reconstruction,
        "input_noise": "none" if regressor.input_noise is None else regressor.input_noise,
        "trend": "none" if regressor.trend is None else regressor.trend,
        "seed": regressor.random_state,
        "restarts": regressor.n_restarts_optimizer,
        "horizons": list(horizons),
        "inducing": regressor.n_inducing,
        "latents": regressor.n_latent_,
        "max_iter": regressor.max_iter,
    }
    if isinstance(pipeline[-1], CalibratedRegressor):
        settings["calibrate"] = True
    if "lagcorrector" in pipeline.named_steps:
        settings["lags"] = pipeline["lagcorrector"].lags
    return settings | {name: True for name in ("symmetric", "gusty") if getattr(pipeline, name)}


def _reconstruction(pipeline) -> str | None:
    """Return whether flight paths are reconstructed, and why; None where it was not asked for."""
    step = pipeline["flightpathreconstruction"]
    if not isinstance(step, FlightPathReconstruction):
        return None
    return f"{'reconstructed from all sensors' if step.used_ else 'not reconstructed, only smoothed'}: {step.reason_}"


def _thrust_sources(thrust, tables) -> list[str]:
    """Return where the thrust of flights is from: "columns", "propeller" or "none"."""
    if thrust != "auto":
        return [thrust or "none"]
    columns = {"thrust_x", "thrust_y", "thrust_z"}
    return sorted({"columns" if columns & set(table.columns) else "propeller" for table in tables})


def _by_coefficient(values) -> dict[str, float]:
    return dict(zip(COEFFICIENTS, map(float, values), strict=True))


def _extent(table) -> dict[str, float]:
    """Return how many samples a flight has, how long it is [s] and how often it was sampled [Hz]."""
    time = table["time"].to_numpy(float)
    rate = 1 / np.median(np.diff(time)) if len(time) > 1 else np.nan
    return {"samples": len(table), "duration": float(np.ptp(time)), "sample_rate": float(rate)}


def _score_metrics(evaluations) -> dict:
    tables = scores(evaluations)
    return {
        "coefficients": {against: table.to_dict("index") for against, table in tables.items()},
        "means": {against: group_means(table).to_dict("index") for against, table in tables.items()},
    }


def _comparison(evaluations) -> list[str]:
    """Return what least squares on the same rows reaches, and where it is better."""
    lines = []
    for against, table in scores(evaluations).items():
        if "least_squares_normalized_rmse" in table:
            linear, model = table["least_squares_normalized_rmse"], table["normalized_rmse"]
            line = f"least squares on the same rows: NRMSE {linear.mean():.3f} against {against}"
            line += f", the model {model.mean():.3f}"
            better = [name for name in table.index if linear[name] < model[name]]
            lines.append(f"{line}; least squares is better in {', '.join(better)}" if better else line)
    return lines


def _plan_lines(plan: FlownPlan) -> list[str]:
    """Return how much of a plan was flown, and what it taught."""
    n_missed, left = sum(plan.missed.values()), (plan.manoeuvres["left"] != "").sum()
    words = ", ".join(f"{name} {value:.0%}" for name, value in plan.remaining.items())
    return [
        f"plan: {len(plan.manoeuvres)} manoeuvres flown, {n_missed} not; {left} left a limit",
        f"errors of {len(plan.errors)} derivatives, of those before: {words}",
    ]


def _score_table(evaluations) -> list[str]:
    tables = scores(evaluations)
    above = [f"{'against measured':>{3 * WIDTH}}", f"{'against truth':>{2 * WIDTH}}"][: len(tables)]
    lines = [" " * MARGIN + "".join(above)]
    for words in (("median", "NRMSE", "in 95 %"), ("rel. error", "", "band")):
        cells = [f"{word:>{WIDTH}}" for word in (*words, *words[:2] * (len(tables) - 1))]
        lines.append(" " * MARGIN + "".join(cells).rstrip())
    lines += [_row(name, [table.loc[name] for table in tables.values()]) for name in COEFFICIENTS]
    return [*lines, "", *(_mean_row(evaluations, group) for group in ("longitudinal", "lateral", "all"))]


def _mean_row(evaluations, group) -> str:
    return _row(group, [group_means(table).loc[group] for table in scores(evaluations).values()])


def _row(name, rows) -> str:
    """Return errors and coverage against measured; against truth, which holds gusts that no band knows, errors only."""
    measured, *truth = rows
    cells = [_percent(measured.median_relative_error), f"{measured.normalized_rmse:.3f}"]
    cells.append(_percent(measured.interval_coverage))
    for row in truth:
        cells += [_percent(row.median_relative_error), f"{row.normalized_rmse:.3f}"]
    return f"  {name:<{MARGIN - 2}}" + "".join(f"{cell:>{WIDTH}}" for cell in cells)


def _percent(fraction) -> str:
    return f"{100 * fraction:.1f} %" if np.isfinite(fraction) else "-"


def _state_lines(evaluation: Evaluation) -> list[str]:
    if not evaluation.states:
        return []
    lines = []
    for horizon, part in evaluation.states["measured"].groupby("horizon"):
        median = part.set_index("state")["median"]
        cells = []
        for state in (name for name in ("v_east", "p", "r") if name in median):
            factor, unit = display_unit(state)
            cells.append(f"{state} {factor * median[state]:.3g} {unit}")
        lines.append(f"  replayed over {horizon:g} s, median error: {', '.join(cells)}")
    return lines
