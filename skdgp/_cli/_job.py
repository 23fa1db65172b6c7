"""The commands ``identify`` and ``demo``: read, fit, evaluate, write."""

from __future__ import annotations

import time
import warnings
from importlib.util import find_spec

import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._cli._outputs import metrics_of, writers
from skdgp._cli._summary import summary
from skdgp._cli._task import Task
from skdgp._compute.checkpoint import checkpointing
from skdgp._compute.progress import listening
from skdgp._flight.faults import WARNING_START, FlightDataWarning
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import calibrate_noise, make_identification_pipeline
from skdgp.identification._evaluation import Evaluation, Loads, evaluate
from skdgp.identification._outcome import Outcome, by_coefficient, fit_facts, thrusts
from skdgp.identification._rows import check_known, check_same_columns, checked, complete_rows, warn_of_short
from skdgp.identification._source import Source, example_source, file_source
from skdgp.model_selection import thin_targets

CHECKPOINT = "checkpoint"  # in the folder of the outputs, while these are made
SAMPLES = 755


def identify(task: Task) -> None:
    """Learn a model from the flights that the options name."""
    options = task.options
    task.console.stage("reading")
    run(file_source(options), Loads.of(options.thrust, options.external_forces), task)


def demo(task: Task) -> None:
    """Learn a model from the example flights."""
    task.console.stage("flying the example flights")
    run(example_source(), Loads(), task)


def run(source: Source, loads: Loads, task: Task) -> None:
    """Fit the model, try it on the test flights, write the outputs and print a summary."""
    options = task.options
    if source.held_out:
        warnings.warn(
            f"No test flight was named: {source.held_out}, is held out of the fit and tested on.",
            UserWarning,
            stacklevel=2,
        )
    train, test = checked(source.train), checked(source.test)
    warnings.filterwarnings(
        "ignore", WARNING_START, FlightDataWarning
    )  # by each step that meets the same flights again
    train = {name: complete_rows(table, options.regressors) for name, table in train.items()}
    test = {name: complete_rows(table, options.regressors) for name, table in test.items()}
    check_same_columns(train, test, options.regressors)
    warn_of_short(train, options.regressors)
    with checkpointing(task.folder.path / CHECKPOINT):
        pipeline, fit = _learn(source.aircraft, train, loads, task)
        outcome = Outcome(
            title=source.title,
            command=task.command,
            aircraft=source.aircraft,
            pipeline=pipeline,
            loads=loads,
            settings=_settings(options, pipeline, loads, fit),
            fit=fit,
            train=train,
            evaluations=try_on(test, pipeline, source.aircraft, loads, task),
            messages=task.console.messages,
            held_out=source.held_out,
        )
        said = finish(outcome, task)
    task.say(*said)


def try_on(flights, pipeline, aircraft, loads: Loads, task: Task) -> list[Evaluation]:
    """Compare a model with flights, and fly it."""
    evaluations = []
    for name, table in flights.items():
        task.console.stage(f"trying the model on {name}")
        evaluations.append(evaluate(pipeline, aircraft, name, table, loads=loads, horizons=task.options.horizons))
    return evaluations


def finish(outcome: Outcome, task: Task) -> tuple[str, dict]:
    """Write the outputs, where a folder is named, and return what is to be printed, as text and as numbers."""
    if task.folder is not None:
        task.console.stage("report")
        if find_spec("matplotlib") is None:
            warnings.warn('No pictures in the report: they need pip install "skdgp[plot]".', UserWarning, stacklevel=2)
    metrics = metrics_of(outcome)
    files = {} if task.folder is None else task.write(writers(outcome, metrics))
    return summary(outcome, files), metrics


def _learn(aircraft, train, loads, task) -> tuple[Pipeline, dict]:
    """Return the fitted and calibrated pipeline, and how it came about."""
    options, console = task.options, task.console
    console.stage("coefficients")
    table = pd.concat(train.values(), ignore_index=True)
    Y = aerodynamic_coefficients(table, aircraft, **loads.keywords())
    check_known(Y, table)
    targets = thin_targets(Y, _n_samples(options, len(Y)))
    pipeline = make_identification_pipeline(
        aircraft,
        regressors=options.regressors,
        reconstruction="passthrough" if options.reconstruction == "none" else "auto",
        regressor=_regressor(options),
        mixer=_mixer(table),
    )
    seconds = _fit(pipeline, table, targets, console)
    console.stage("calibration")
    widened = calibrate_noise(pipeline, table, Y.mask(targets.notna()))
    fit = {
        "samples": int(targets.notna().any(axis=1).sum()),
        "samples_available": int(Y.notna().any(axis=1).sum()),
        "values": int(targets.notna().sum().sum()),
        "thrust": thrusts(loads, train.values()),
        **fit_facts(pipeline),
        "noise_widened": by_coefficient(widened),
        "seconds": round(seconds, 3),
        "interrupted": console.interrupts > 0,
        "flights": {name: len(part) for name, part in train.items()},
    }
    return pipeline, fit


def _settings(options, pipeline, loads, fit) -> dict:
    """Return what was asked for, and what was chosen where nothing was."""
    chosen, regressor = vars(options), pipeline[-1]
    names = ("inference", "regressors", "reconstruction", "input_noise", "trend", "seed", "restarts", "horizons")
    return {
        "samples": fit["samples"],
        "thrust": loads.thrust,
        "external_forces": loads.external_forces,
        **{name: chosen[name] for name in names},
        "inducing": regressor.n_inducing,
        "latents": regressor.n_latent_,
        "max_iter": regressor.max_iter,
    }


def _regressor(options) -> DependentGPRegressor:
    regressor = DependentGPRegressor(
        trend=None if options.trend == "none" else options.trend,
        inference=options.inference,
        input_noise=None if options.input_noise == "none" else options.input_noise,
        n_restarts_optimizer=options.restarts,
        n_jobs=options.n_jobs,
        random_state=options.seed,
    )
    for name, value in (
        ("n_latent", options.latents),
        ("max_iter", options.max_iter),
        ("n_inducing", options.inducing),
    ):
        if value is not None:
            regressor.set_params(**{name: value})
    return regressor


def _mixer(table):
    """Return what mixes the surfaces: nothing, on an aircraft without elevons that lacks elevator or aileron."""
    surfaces = {"elevon_left", "elevon_right"} & set(table.columns)
    return None if surfaces or {"elevator", "aileron"} <= set(table.columns) else "passthrough"


def _n_samples(options, n_rows):
    if options.samples is None:
        return SAMPLES if options.inference == "exact" else n_rows
    return n_rows if options.samples == "all" else options.samples


def _fit(pipeline, table, targets, console) -> float:
    """Fit, and return the seconds that it took."""
    console.stage("fit")
    began = time.monotonic()
    with listening(console.progress), console.keeping_the_best():
        pipeline.fit(table, targets)
    return time.monotonic() - began
