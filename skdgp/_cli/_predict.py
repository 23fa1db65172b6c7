"""The commands ``predict`` and ``validate``: a saved model on flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._cli import _options as opt
from skdgp._cli._identify import finish
from skdgp._cli._output import Run, check_writable, table_writer
from skdgp._compute.messages import warn
from skdgp._compute.progress import listening
from skdgp.design import PlanCheck
from skdgp.dynamics import Aircraft
from skdgp.identification import (
    check_identified,
    load_model,
    named_flights,
    predict_flight,
    usable_flights_of_model,
)
from skdgp.identification import validate as judge

NOTABLE_GUSTS = 0.5
"""Intensity [m/s] from which derivatives by rates lose notably: two thirds of light turbulence of
MIL-F-8785C.
"""


def read_model(options) -> Bunch:
    """Return the model that the options name, with its own aircraft or theirs; raise ValueError if it is of no use.

    Warns of surfaces that are not in radians.
    """
    model = load_model(options.model)
    check_identified(model.pipeline)
    if getattr(model.pipeline, "control_units_", {}):
        warn(
            "Surfaces of this model are in parts of their full throw, -1 to 1, wherever radians "
            "are expected of them: "
            "in controls, limits, plans and exports.",
            stacklevel=2,
        )
    if getattr(options, "aircraft", None) is not None:
        model.aircraft = Aircraft.from_file(options.aircraft)
    return model


def read_model_to_fly(options) -> tuple[Bunch, str | None]:
    """Return the model and the thrust of a simulation, "auto" or None; warn of loads and gusts of its flights."""
    model = read_model(options)
    learned, pipeline = model.get("options", {}), model.pipeline
    if learned.get("external_forces"):
        warn(
            f"The simulation flies without the external forces {learned['external_forces']} of "
            f"the flights that the "
            "model was learned from.",
            stacklevel=2,
        )
    turbulence = getattr(pipeline, "turbulence_", None)
    gusts = 0.0 if turbulence is None else max(turbulence.intensity)
    if gusts > NOTABLE_GUSTS:
        warn(
            f"The model was learned in gusts of {gusts:.1f} m/s, so its derivatives by rates are "
            f"too small: learn from "
            "flights in calmer air to simulate or to linearise.",
            UserWarning,
            stacklevel=2,
        )
    return model, None if learned.get("thrust", "auto") in (None, "none") else "auto"


def predict(run: Run) -> None:
    """Write what a model predicts for flights: flight, time, CX CY CZ Cl Cm Cn, standard deviations CX_std ... Cn_std.

    These are wider in rougher air. Rows whose regressors were not sampled are left out, with a
    warning.

    For example:
      skdgp predict results/model.joblib wednesday.csv -o coefficients.csv
      skdgp predict results/model.joblib a.csv b.csv -o coefficients.parquet --include-noise
    """
    options, output = run.options, Path(run.options.output)
    check_writable(output.suffix)
    if output.resolve() in (Path(flight).resolve() for flight in options.flight):
        raise FileExistsError(
            f"Got {options.output} as the output, but it is one of the flights: name another."
        )
    run.console.stage("reading")
    model = read_model(options)
    flights = usable_flights_of_model(
        model.pipeline, named_flights(options.flight, **opt.reading(options, model))
    )
    tables = []
    for name, table in flights.items():
        run.console.stage(f"predicting {name}")
        tables.append(predictions(model.pipeline, table, include_noise=options.include_noise))
    whole = pd.concat(tables, ignore_index=True)
    run.write({output.name: table_writer(whole, output.suffix)})
    rows = {name: len(table) for name, table in flights.items()}
    coefficients = {
        name: {
            "lowest": whole[name].min(),
            "highest": whole[name].max(),
            "median_std": whole[f"{name}_std"].median(),
        }
        for name in whole
        if f"{name}_std" in whole
    }
    numbers = {"model": options.model, "output": options.output, "flights": rows}
    numbers |= {"include_noise": options.include_noise, "coefficients": coefficients}
    lines = [f"{count} rows of flight {name}" for name, count in rows.items()]
    lines += ["", f"{'':6}{'lowest':>12}{'highest':>12}{'std (median)':>15}"]
    for coefficient, row in coefficients.items():
        lines.append(
            f"{coefficient:6}{row['lowest']:>12.4g}{row['highest']:>12.4g}{row['median_std']:>15.2g}"
        )
    run.print("\n".join([*lines, "", f"table    {options.output}"]), numbers)


def predictions(pipeline, table: pd.DataFrame, *, include_noise: bool) -> pd.DataFrame:
    """Return the coefficients of a flight and their standard deviations, ``CX`` and ``CX_std``, beside its time."""
    names = pipeline[-1].output_names_
    columns = [*names, *(f"{name}_std" for name in names)]
    values = np.hstack(predict_flight(pipeline, table, include_noise=include_noise))
    return (
        table[["flight", "time"]].reset_index(drop=True).join(pd.DataFrame(values, columns=columns))
    )


def validate(run: Run) -> None:
    """Judge a model on flights that it has not seen, as identify does on its test flights.

    Its coefficients are compared with the measured ones and replayed: integrated from the measured
    state, restarted every --horizons seconds. Prints the scores, and with -o writes report.html
    and metrics.json into DIR, all or none. With --plan also the standard deviations of derivatives that the
    plan promised, beside those of this model, which learned from its flight.

    For example:
      skdgp validate results/model.joblib thursday.csv
      skdgp validate results/model.joblib thursday.csv friday.csv -o validation --horizons 5
      skdgp validate both/model.joblib thursday.csv --plan next/plan.json -o validation
      skdgp validate results/model.joblib thursday.csv --aircraft heavier.json --json
    """
    options = run.options
    names = ("thrust", "external_forces")
    known = {
        name: opt.none_of(value) for name in names if (value := getattr(options, name)) is not None
    }
    with listening(run.console.progress):
        model = read_model(options)
        result = judge(
            model, options.flight, horizons=options.horizons, reading=opt.reading(options), **known
        )
        if options.plan is not None:
            thrust = None if result.settings["thrust"] in (None, "none") else "auto"
            check = PlanCheck.from_file(
                options.plan, model.pipeline, result.aircraft, thrust=thrust
            )
            result = replace(result, supplements=[check])
        finish(run, replace(result, command=run.command_line))


COMMANDS: opt.Commands = {
    validate: {
        "": {
            "model": opt.SHARED["model"],
            "flight": opt.SHARED["flight"],
            "--aircraft": opt.SHARED["--aircraft"],
            **opt.LOG,
            "--horizons": opt.SHARED["--horizons"],
            "--output": opt.SHARED["--output"],
            "--plan": {
                "metavar": "FILE",
                "help": (
                    "plan.json of a flight that the model learned from: compares its promises with this model"
                ),
            },
            "--thrust": opt.SHARED["--thrust"],
            "--external-forces": opt.SHARED["--external-forces"],
        },
    },
    predict: {
        "": {
            "model": opt.SHARED["model"],
            "flight": opt.SHARED["flight"],
            **opt.LOG,
            "--include-noise": {
                "action": "store_true",
                "help": (
                    "standard deviations of new measurements, not of the coefficients themselves"
                ),
            },
            "--output": opt.SHARED["--output"]
            | {
                "metavar": "FILE",
                "type": opt.table_file,
                "required": True,
                "help": "the table: .csv or .parquet",
            },
        },
    },
}
