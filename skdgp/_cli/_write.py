"""Commands that write for others: the plan of the next flight, and exports of a model."""

from __future__ import annotations

import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._fly import read_model, read_model_to_fly
from skdgp._cli._output import Run
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
from skdgp.dynamics import trim
from skdgp.export import FORMATS, export_model, load_portable

RATE = 50.0  # of the rows of tables, and of the script [Hz]


def plan(run: Run) -> None:
    """Choose the manoeuvres of the next flight: those that lower the errors of a goal most in the given time.

    Doublets, 3-2-1-1s and multisines are simulated from a trim of the model. Each that is chosen is
    flown by aircraft drawn from its posterior, in gusts as in its training flights, and is
    made smaller or left out if it leaves the limits too often. These are the range of the training
    flights, with --growth, unless given. The controls are open loop during a
    manoeuvre; return to the trim in the pause after it. Ctrl-C ends the search with the best
    manoeuvre checked so far, if any.

    Writes into DIR, all or none, and removes a script there that an earlier plan wrote:
      plan.csv       time [s] and deviations from trim of the axes [rad, throttle 0 to 1], at 50 Hz
      plan.lua       a script for ArduPilot; with --full, the deflections at the ends of the servos' ranges
      card.html      a flight card to print: trim, entry, inputs, expected responses, abort limits, promised errors
      expected.csv   the flight that the model expects, manoeuvre by manoeuvre
      plan.json      trim, manoeuvres, risks, standard deviations before and promised; validate --plan compares them
                     with a model learned from this flight too

    For example:
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron rudder -o next
      skdgp plan results/model.joblib --airspeed 30 --seconds 120 --axes elevator --goal Cm_q -o pitch
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes rudder --full rudder=0.4 -o yaw
    """
    options, console = run.options, run.console
    axes = list(dict.fromkeys(options.axes))
    full = dict(options.full)
    if full:
        surface_mixes([axis for axis in axes if axis != "throttle"], full)  # the search takes long
    ranges = {
        name: getattr(options, option[2:].replace("-", "_"))
        for name, option in Envelope.command_options.items()
    }
    envelope = Envelope(
        **ranges,
        growth=float(options.growth),
        risk=options.risk,
        margin=options.margin,
        n_paths=options.paths,
        gusts=opt.none_of(options.gusts),
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
            random_state=options.seed,
        )
    numbers = {"model": options.model, "seconds": planned.seconds, **planned.to_dict()}
    files = run.write(_writers(options, planned), "plan.json", numbers, r"plan\.lua")
    run.print(_text(planned, options, files), numbers)


def _writers(options, planned: Plan) -> dict[str, Writer]:
    files: dict[str, Writer] = {"plan.csv": csv_writer(planned.train.table(RATE))}
    full = dict(options.full)
    if full:
        try:
            files["plan.lua"] = text_writer(ardupilot_script(planned.train, RATE, full))
        except ValueError as error:  # the plan is kept
            warn(f"No script for ArduPilot: {error}", stacklevel=2)
    return files | {
        "card.html": partial(write_flight_card, plan=planned, full=full),
        "expected.csv": csv_writer(planned.flight),
    }


def _text(planned: Plan, options, files: list) -> str:
    """Return manoeuvres and standard deviations as tables."""
    columns = ["start", "name", "scale", "risk"]
    lines = [_table(planned.manoeuvres[columns]), "", _table(planned.errors), ""]
    if planned.abort_limits.empty:
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
    jsbsim    aircraft/NAME/NAME.xml: an aircraft whose coefficients are the sums of their effects
    casadi    aero.casadi: mean, deviation and Jacobian as a Function, for optimisation; needs CasADi
    onnx      aero.onnx: mean and deviation as a graph, for inference runtimes; needs ONNX

    MODEL is the model.joblib that identify wrote, or a model.npz. With --max-kb the model gets
    fewer basis functions; the loss is printed in standard deviations of the posterior. All files
    are written into DIR, or none.

    For example:
      skdgp export results/model.joblib --to portable -o portable
      skdgp export results/model.joblib --to c --max-kb 256 -o flight_code
    """
    options = run.options
    run.console.stage("reading")
    if Path(options.model).suffix != ".npz":
        model = read_model(options)
    elif options.aircraft is not None:
        raise ValueError(
            "Got --aircraft with a portable model, but expected model.joblib: a portable model "
            "has its own."
        )
    else:
        model = load_portable(options.model)
    run.console.stage(f"exporting to {options.to}")
    with tempfile.TemporaryDirectory() as temporary:
        facts = export_model(temporary, model, options.to, max_kb=options.max_kb)
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
    plan: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--airspeed": opt.SHARED["--airspeed"] | {"nargs": None, "help": "of the trim [m/s]"},
            "--seed": opt.SHARED["--seed"],
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
            "--risk": {
                "metavar": "P",
                "type": opt.number("a number between 0 and 1", lambda value: 0 < value < 1),
                "default": 0.05,
                "help": "largest probability that a manoeuvre leaves the limits (default: 0.05)",
            },
            "--margin": {
                "metavar": "X",
                "type": opt.number("a number, 0 or more", lambda value: value >= 0),
                "default": 0.15,
                "help": "fraction by which responses may exceed the model's (default: 0.15)",
            },
            "--gusts": opt.SHARED["--gusts"]
            | {"help": "of the check: as in the training flights, or none (default: auto)"},
            "--paths": opt.SHARED["--paths"]
            | {
                "type": opt.at_least(2),
                "default": 200,
                "help": "aircraft drawn for each check (default: 200)",
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
            "model": opt.SHARED["model"]
            | {
                "help": f"the model.joblib that identify wrote ({opt.TRUST}), or a portable model.npz"
            },
            "--aircraft": opt.SHARED["--aircraft"],
            "--output": opt.SHARED["--output"] | {"required": True},
            "--to": {"choices": list(FORMATS), "required": True, "help": "the format"},
            "--max-kb": {
                "metavar": "KB",
                "type": opt.positive("kB"),
                "help": "largest size of the code, or of the portable form (default: whole model)",
            },
        },
    },
}
