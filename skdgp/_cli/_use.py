"""Commands that use a model: predict, derivatives, plan, export."""

from __future__ import annotations

import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._cli import _shared as opt
from skdgp._cli._shared import Run
from skdgp._compute.files import Writer, csv_writer, text_writer
from skdgp._compute.messages import listening, warn
from skdgp._excitation import AXES
from skdgp.design import (
    Envelope,
    Plan,
    ardupilot_script,
    surface_mixes,
    write_flight_card,
)
from skdgp.design import plan as plan_flight
from skdgp.dynamics import (
    Aircraft,
    Trim,
    linearize,
    stability_derivatives,
    trim,
)
from skdgp.export import FORMATS, export_model
from skdgp.identification import (
    check_identified,
    load_model,
    named_flights,
    usable_flights_of_model,
)
from skdgp.report import FlightMechanics

# Intensity [m/s] above which derivatives by rates lose notably: two thirds of light turbulence of
# MIL-F-8785C
NOTABLE_GUSTS = 0.5


def read_model(options) -> Bunch:
    """Return the model that the options name, with its own aircraft or theirs; raise ValueError if it is of no use.

    Warns of surfaces that are not in radians.
    """
    model = load_model(options.model)
    check_identified(model.pipeline)
    if model.pipeline.control_units_:
        warn(
            "Surfaces of this model are in parts of their full throw, -1 to 1, wherever radians "
            "are expected of them: in controls, limits, plans and exports.",
            stacklevel=2,
        )
    if vars(options).get("aircraft") is not None:  # predict has no such option
        model.aircraft = Aircraft.from_file(options.aircraft)
    return model


def read_model_to_fly(options) -> tuple[Bunch, str | None]:
    """Return the model and its thrust in motion, "auto" or None; warn of loads and gusts of its flights."""
    model = read_model(options)
    learned = model.get("options", {})
    if learned.get("external_forces"):
        warn(
            f"Motion is computed without the external forces {learned['external_forces']} of the "
            "flights that the model was learned from.",
            stacklevel=2,
        )
    turbulence = model.pipeline.turbulence_
    if turbulence is not None and max(turbulence.intensity) > NOTABLE_GUSTS:
        warn(
            f"The model was learned in gusts of {max(turbulence.intensity):.1f} m/s, so its "
            f"derivatives by rates are too small: learn from flights in calmer air.",
            stacklevel=2,
        )
    return model, learned.get("thrust", "auto")


def predict(run: Run) -> None:
    """Write what a model predicts for flights: flight, time, CX CY CZ Cl Cm Cn, standard deviations CX_std ... Cn_std.

    These are wider in rougher air. Rows whose regressors were not sampled are left out, with a
    warning.

    For example:
      skdgp predict results/model.joblib wednesday.csv -o coefficients.csv
      skdgp predict results/model.joblib a.csv b.csv -o coefficients.csv --include-noise
    """
    options = run.options
    output = Path(options.output)
    if output.resolve() in (Path(flight).resolve() for flight in options.flight):
        raise FileExistsError(
            f"Got {options.output} as the output, but it is one of the flights: name another."
        )
    run.console.stage("reading")
    model = read_model(options)
    flights = usable_flights_of_model(
        model.pipeline, named_flights(options.flight, **opt.reading(options, model))
    )
    run.console.stage("predicting")
    parts = [
        _predictions(model.pipeline, flight, options.include_noise) for flight in flights.values()
    ]
    run.write({output.name: csv_writer(pd.concat(parts, ignore_index=True))})
    rows = {name: len(flight) for name, flight in flights.items()}
    numbers = {
        "model": options.model,
        "output": options.output,
        "flights": rows,
        "include_noise": options.include_noise,
    }
    lines = [f"{count} rows of flight {name}" for name, count in rows.items()]
    run.print("\n".join([*lines, "", f"table    {options.output}"]), numbers)


def _predictions(pipeline, flight: pd.DataFrame, include_noise: bool) -> pd.DataFrame:
    """Return the coefficients of a flight and their standard deviations, ``CX`` and ``CX_std``, beside its time."""
    names = pipeline[-1].output_names_
    columns = [*names, *(f"{name}_std" for name in names)]
    moments = pipeline.predict(flight, return_std=True, include_noise=include_noise)
    table = pd.DataFrame(np.hstack(moments), columns=columns)
    return flight[["flight", "time"]].reset_index(drop=True).join(table)


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation, whose parts are in derivatives.csv. With -o writes derivatives.csv,
    modes.csv and derivatives.json into DIR, all or none.

    For example:
      skdgp derivatives results/model.joblib --airspeed 35
      skdgp derivatives results/model.joblib --airspeed 30 35 40 -o sweep
    """
    options = run.options
    run.console.stage("reading")
    model, thrust = read_model_to_fly(options)
    run.console.stage("trimming")
    climb = None if thrust is None else 0.0  # without thrust it follows
    conditions: dict[str, Any] = {"altitude": options.altitude, "climb": climb, "thrust": thrust}
    airspeeds = sorted(set(options.airspeed))
    trims: Any = trim(model.pipeline, model.aircraft, airspeeds, **conditions)
    _warn_beyond(trims)
    run.console.stage("derivatives")
    spread = {"n_paths": options.paths, "random_state": options.seed, "thrust": thrust}
    table: Any = stability_derivatives(model.pipeline, model.aircraft, trims, **spread)
    run.console.stage("modes")
    modes = [
        linearize(model.pipeline, model.aircraft, steady, **spread).modes() for steady in trims
    ]
    points = [
        FlightMechanics(trim=point, derivatives=table.loc[k], modes=modes[k])
        for k, point in enumerate(trims)
    ]
    numbers = {"model": options.model, "points": [point.to_dict() for point in points]}
    blocks = [_derivatives_text(trims[k], table.loc[k], modes[k]) for k in range(len(trims))]
    if run.folder is not None:
        named = pd.concat(modes, keys=airspeeds, names=["airspeed", "mode"])
        files = {
            "derivatives.csv": csv_writer(table.reset_index(names=["point", "derivative"])),
            "modes.csv": csv_writer(named.drop(columns="eigenvalue").reset_index()),
        }
        written = run.write(files, "derivatives.json", numbers)
        blocks.append("wrote " + ", ".join(map(str, written)))
    run.print("\n\n".join(blocks), numbers)


def _warn_beyond(trims: list[Trim]) -> None:
    """Warn of trims whose regressors are outside the range of the training data."""
    beyond = []
    for point in trims:
        for name, (value, low, high) in point.beyond.items():
            limits = f"{low:.3g} to {high:.3g}"
            beyond.append(f"{point.airspeed:g} m/s: {name} {value:.3g} ({limits})")
    if beyond:
        warn(f"Trims are beyond the training data: {', '.join(beyond)}.", stacklevel=3)


def _derivatives_text(point: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> str:
    """Return trim, derivatives with their standard deviations, and modes."""
    controls = ", ".join(f"{name} {value:.4g}" for name, value in point.controls.items())
    cells = table["value"].map("{:z.4f}".format)
    if "std" in table:
        cells += table["std"].map(" +- {:.2g}".format)
    named = table.assign(cell=cells, regressor=table["regressor"].replace("", "at trim"))
    coefficients, regressors = named["coefficient"].unique(), named["regressor"].unique()
    wide = named.pivot(index="regressor", columns="coefficient", values="cell")
    wide = wide.loc[regressors, coefficients].rename_axis(index=None, columns=None)
    return "\n".join(
        [
            f"{point.airspeed:g} m/s: alpha {np.rad2deg(point.alpha):.3g} deg, {controls}",
            "values, +- one standard deviation" if "std" in table else "values",
            "",
            wide.to_string(),
            "",
            "modes, in rad/s and s",
            modes.drop(columns="eigenvalue").to_string(float_format="{:.3g}".format),
        ]
    )


RATE = 50.0  # of the rows of tables, and of the script [Hz]


def plan(run: Run) -> None:
    """Choose the manoeuvres of the next flight: those that lower the errors of a goal most in the given time.

    Doublets, 3-2-1-1s and multisines are simulated from a trim of the model in calm air. Each is made
    smaller or left out if its response, with --margin, leaves the limits. These are the range of the
    training flights, with --growth, unless given. The controls are open loop during a manoeuvre;
    return to the trim in the pause after it.

    Writes into DIR, all or none, and removes a script there that an earlier plan wrote:
      plan.csv       time [s] and deviations from trim of the axes [rad, throttle 0 to 1], at 50 Hz
      plan.lua       a script for ArduPilot; with --full, the deflections at the ends of the servos' ranges
      card.html      a flight card to print: trim, entry, inputs, expected responses, abort limits, promised errors
      expected.csv   the flight that the model expects, manoeuvre by manoeuvre
      plan.json      trim, manoeuvres, standard deviations before and promised; validate --plan compares them with a
                     model learned from this flight too

    For example:
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron rudder -o next
      skdgp plan results/model.joblib --airspeed 30 --seconds 120 --axes elevator --goal Cm_q -o pitch
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes rudder --full rudder=0.4 -o yaw
    """
    options = run.options
    console = run.console
    axes = list(dict.fromkeys(options.axes))
    full = dict(options.full)
    if full:
        surface_mixes([axis for axis in axes if axis != "throttle"], full)  # the search takes long
    arguments = vars(options)
    ranges = {
        name: arguments[option.removeprefix("--").replace("-", "_")]
        for name, option in Envelope.command_options.items()
    }
    envelope = Envelope(
        **ranges,
        growth=float(options.growth),
        margin=options.margin,
    )
    console.stage("reading")
    model, thrust = read_model_to_fly(options)
    highest = envelope.altitudes(model.pipeline)[1]  # of the training flights
    point: Any = trim(
        model.pipeline,
        model.aircraft,
        options.airspeed,
        altitude=highest if options.altitude is None else options.altitude,
        climb=None if thrust is None else 0.0,
        thrust=thrust,
    )
    with listening(console.progress):
        planned = plan_flight(
            model.pipeline,
            model.aircraft,
            point,
            seconds=options.seconds,
            axes=axes,
            goal=options.goal,
            limits=dict(options.limits),
            envelope=envelope,
            thrust=thrust,
        )
    numbers = {"model": options.model, "seconds": planned.seconds, **planned.to_dict()}
    writers: dict[str, Writer] = {"plan.csv": csv_writer(planned.train.table(RATE))}
    if full:
        try:
            writers["plan.lua"] = text_writer(ardupilot_script(planned.train, RATE, full))
        except ValueError as error:  # the plan is kept
            warn(f"No script for ArduPilot: {error}", stacklevel=2)
    writers["card.html"] = partial(write_flight_card, plan=planned, full=full)
    writers["expected.csv"] = csv_writer(planned.flight)
    files = run.write(writers, "plan.json", numbers, r"plan\.lua")
    run.print(_text(planned, options, files), numbers)


def _text(planned: Plan, options, files: list) -> str:
    """Return manoeuvres and standard deviations as tables."""
    columns = ["start", "name", "scale"]
    lines = [_table(planned.manoeuvres[columns]), "", _table(planned.errors), ""]
    if np.isinf(planned.abort_limits).all(axis=None):
        lines.append("no limits, not even a floor: set them by --growth, --max-bank, --floor ...")
    if not options.full:
        lines.append("no script for ArduPilot: --full gives the full deflections that it needs")
    return "\n".join([*lines, *map(str, files)])


def _table(table: pd.DataFrame) -> str:
    return table.to_string(float_format="{:.3g}".format)


def export(run: Run) -> None:
    """Write a model in a form that other programs read, without Python or without pickle.

    portable  model.npz: arrays and JSON, no code; skdgp.export.load_portable and examples/read_portable.py read it
    c         aero.h, aero.c: mean, deviation, slopes and limits in C99; "make test" compares them with the model
    jsbsim    aircraft/NAME/NAME.xml: an aircraft that flies the mean; --full gives its full deflections
    casadi    aero.casadi: mean, deviation and Jacobian as a Function, aero_mean.casadi: the mean alone; needs CasADi

    With --max-kb the model gets fewer basis functions; the loss is printed in standard deviations
    of the posterior. All files are written into DIR, or none.

    For example:
      skdgp export results/model.joblib --to portable -o portable
      skdgp export results/model.joblib --to c --max-kb 256 -o flight_code
      skdgp export results/model.joblib --to jsbsim --full elevator=0.42 aileron=0.42 rudder=0.35 -o jsbsim
    """
    options = run.options
    run.console.stage("reading")
    model = read_model(options)
    run.console.stage(f"exporting to {options.to}")
    with tempfile.TemporaryDirectory() as temporary:
        facts = export_model(
            temporary, model, options.to, max_kb=options.max_kb, full=dict(options.full)
        )
        files = {str(Path(path).relative_to(temporary)): Path(path) for path in facts["files"]}
        sizes = {name: path.stat().st_size for name, path in files.items()}
        run.write({name: partial(shutil.copyfile, path) for name, path in files.items()})
    numbers = {"model": options.model, "to": options.to, **facts, "files": sizes}
    run.print(_export_text(options.output, numbers), numbers)


def _export_text(folder, numbers) -> str:
    lines = [
        f"{size / 1024:>9.1f} kB  {Path(folder, name)}" for name, size in numbers["files"].items()
    ]
    if loss := numbers.get("loss"):
        lines += ["", "loss, root mean square, in posterior deviations"]
        lines.append(_table(pd.DataFrame.from_dict(loss, orient="index")))
    return "\n".join(lines)


COMMANDS: opt.Commands = {
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
                "help": "the table, .csv",
            },
        },
    },
    derivatives: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--airspeed": opt.SHARED["--airspeed"],
            "--seed": opt.SHARED["--seed"],
            "--output": opt.SHARED["--output"],
            "--altitude": {
                "metavar": "M",
                "type": opt.number(),
                "default": 0.0,
                "help": "of the trims [m] (default: 0)",
            },
            "--paths": opt.SHARED["--paths"]
            | {
                "default": 200,
                "help": (
                    "functions of the posterior for the standard deviations; 0: none (default: 200)"
                ),
            },
        },
    },
    plan: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--airspeed": opt.SHARED["--airspeed"] | {"nargs": None, "help": "of the trim [m/s]"},
            "--output": opt.SHARED["--output"] | {"required": True},
            "--seconds": {
                "metavar": "S",
                "type": opt.positive("seconds"),
                "required": True,
                "help": "of all flights together",
            },
            "--axes": {"choices": AXES, "nargs": "+", "required": True, "help": "controls to move"},
            "--goal": {
                "metavar": "NAME",
                "nargs": "+",
                "help": ("derivatives such as Cm_q Cn_rudder (default: all)"),
            },
            "--altitude": {
                "metavar": "M",
                "type": opt.number(),
                "help": "[m] (default: the highest that was flown)",
            },
            "--full": opt.AXIS_VALUES
            | {"help": "deflections [rad] at the ends of the servos' ranges, for the script"},
        },
        "limits": {
            "--limits": opt.AXIS_VALUES
            | {"help": "largest deviations from trim [rad] (default: as flown)"},
            "--max-bank": {"metavar": "RAD", "type": opt.positive("rad"), "help": "to either side"},
            "--floor": {
                "metavar": "M",
                "type": opt.number(),
                "help": "lowest altitude [m] (default: the lowest that was flown)",
            },
            "--growth": {
                "metavar": "X",
                "type": opt.number(
                    "a number, 0 or more, or inf", lambda value: value >= 0, keywords=("inf",)
                ),
                "default": 0.2,
                "help": (
                    "part of its range by which a quantity may leave its range in training; inf: no "
                    "limit (default: 0.2)"
                ),
            },
            "--margin": {
                "metavar": "X",
                "type": opt.number("a number, 0 or more", lambda value: value >= 0),
                "default": 0.3,
                "help": "fraction by which responses may exceed the model's (default: 0.3)",
            },
            "--alpha": {
                "metavar": ("LOW", "HIGH"),
                "type": opt.number(),
                "nargs": 2,
                "help": "[rad]",
            },
            "--beta": {
                "metavar": ("LOW", "HIGH"),
                "type": opt.number(),
                "nargs": 2,
                "help": "[rad]",
            },
            "--load-factor": {
                "metavar": ("LOW", "HIGH"),
                "type": opt.number(),
                "nargs": 2,
                "help": "of -az / g",
            },
            "--speeds": {
                "metavar": ("LOW", "HIGH"),
                "type": opt.number(),
                "nargs": 2,
                "help": "[m/s]",
            },
        },
    },
    export: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--output": opt.SHARED["--output"] | {"required": True},
            "--to": {"choices": list(FORMATS), "required": True, "help": "the format"},
            "--max-kb": {
                "metavar": "KB",
                "type": opt.positive("kB"),
                "help": "largest size of the code, or of the portable form (default: whole model)",
            },
            "--full": opt.AXIS_VALUES
            | {
                "help": (
                    "of jsbsim: deflections [rad] at a command of 1 (default: of the aircraft "
                    "file, else the largest that were flown)"
                )
            },
        },
    },
}
