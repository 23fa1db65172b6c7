"""The identification job: read, fit, try, write."""

from __future__ import annotations

import time
import warnings
from importlib.util import find_spec

import pandas as pd

from skdgp._cli._console import Console
from skdgp._cli._evaluation import Loads, evaluate
from skdgp._cli._folder import OutputFolder
from skdgp._cli._outputs import Outcome, writers
from skdgp._cli._rows import check_known, check_same_columns, checked, complete_rows, warn_of_short
from skdgp._cli._source import Source
from skdgp._cli._summary import summary
from skdgp._faults import TOLD, FlightDataWarning
from skdgp._progress import listening
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import calibrate_noise, make_identification_pipeline
from skdgp.model_selection import thin_targets

SAMPLES = 755


def run(source: Source, options, folder: OutputFolder, console: Console, *, command: str) -> None:
    """Fit the model, try it on the test flights, write the outputs and print a summary."""
    if source.held_out:
        warnings.warn(
            f"No test flight was named: {source.held_out}, is held out of the fit and tested on.",
            UserWarning,
            stacklevel=2,
        )
    if find_spec("matplotlib") is None:
        warnings.warn('No pictures in the report: they need pip install "skdgp[plot]".', UserWarning, stacklevel=2)
    loads = Loads(None if options.thrust == "none" else options.thrust, list(options.external_forces))
    train, test = checked(source.train), checked(source.test)
    warnings.filterwarnings("ignore", TOLD, FlightDataWarning)  # by each step that meets the same flights again
    train = {name: complete_rows(table, options.regressors) for name, table in train.items()}
    test = {name: complete_rows(table, options.regressors) for name, table in test.items()}
    check_same_columns(train, test, options.regressors)
    warn_of_short(train, options.regressors)
    learned = _learn(source.aircraft, train, loads, options, console)
    evaluations = []
    for name, table in test.items():
        console.stage(f"trying the model on {name}")
        evaluations.append(
            evaluate(learned["pipeline"], source.aircraft, name, table, loads=loads, horizons=options.horizons)
        )
    outcome = Outcome(
        source=source,
        options=options,
        command=command,
        loads=loads,
        train=train,
        evaluations=evaluations,
        interrupted=console.interrupts > 0,
        messages=console.messages,
        **learned,
    )
    console.stage("writing")
    folder.write(writers(outcome))
    console.close()
    print(summary(outcome, folder.path))


def _learn(aircraft, train, loads, options, console) -> dict:
    """Return the fitted and calibrated pipeline, and how it came about."""
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
    return {
        "pipeline": pipeline,
        "widened": calibrate_noise(pipeline, table, Y.mask(targets.notna())),
        "n_samples": int(targets.notna().any(axis=1).sum()),
        "n_available": int(Y.notna().any(axis=1).sum()),
        "n_values": int(targets.notna().sum().sum()),
        "seconds": seconds,
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
