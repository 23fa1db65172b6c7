"""The identification job: read, fit, try, write."""

from __future__ import annotations

import time
import warnings

import pandas as pd

from skdgp._cli._console import Console
from skdgp._cli._evaluation import Evaluation, Loads, evaluate
from skdgp._cli._folder import OutputFolder
from skdgp._cli._outputs import Outcome, writers
from skdgp._cli._source import Source, complete_rows
from skdgp._cli._summary import summary
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
    loads = Loads(None if options.thrust == "none" else options.thrust, list(options.external_forces))
    train = {name: complete_rows(table, options.regressors) for name, table in source.train.items()}
    test = {name: complete_rows(table, options.regressors) for name, table in source.test.items()}
    table = pd.concat(train.values(), ignore_index=True)
    console.stage("coefficients")
    Y = aerodynamic_coefficients(table, source.aircraft, **loads.keywords())
    pipeline = _pipeline(source, options, table)
    targets = thin_targets(Y, _n_samples(options, len(Y)))
    seconds = _fit(pipeline, table, targets, console)
    console.stage("calibration")
    widened = calibrate_noise(pipeline, table, Y.mask(targets.notna()))
    evaluations = [_try(pipeline, source, name, test[name], loads, options, console) for name in test]
    outcome = Outcome(
        source=source,
        options=options,
        command=command,
        pipeline=pipeline,
        loads=loads,
        train=train,
        n_samples=int(targets.notna().any(axis=1).sum()),
        n_available=int(Y.notna().any(axis=1).sum()),
        n_values=int(targets.notna().sum().sum()),
        seconds=seconds,
        widened=widened,
        interrupted=console.interrupts > 0,
        evaluations=evaluations,
        messages=console.messages,
    )
    console.stage("writing")
    folder.write(writers(outcome))
    console.close()
    print(summary(outcome, folder.path))


def _pipeline(source, options, table):
    regressor = DependentGPRegressor(
        trend=None if options.trend == "none" else options.trend,
        inference=options.inference,
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
    return make_identification_pipeline(
        source.aircraft, regressors=options.regressors, regressor=regressor, mixer=_mixer(table)
    )


def _mixer(table):
    """Return what mixes the surfaces: nothing, on an aircraft without elevons that lacks elevator or aileron."""
    surfaces = {"elevon_left", "elevon_right"} & set(table.columns)
    return None if surfaces or {"elevator", "aileron"} <= set(table.columns) else "passthrough"


def _n_samples(options, n_rows):
    if options.samples is None:
        return n_rows if options.inference == "sparse" else SAMPLES
    return n_rows if options.samples == "all" else options.samples


def _fit(pipeline, table, targets, console) -> float:
    """Fit, and return the seconds that it took."""
    console.stage("fit")
    began = time.monotonic()
    with listening(console.progress), console.keeping_the_best():
        pipeline.fit(table, targets)
    return time.monotonic() - began


def _try(pipeline, source, name, table, loads, options, console) -> Evaluation:
    console.stage(f"trying the model on {name}")
    return evaluate(pipeline, source.aircraft, name, table, loads=loads, horizons=options.horizons)
