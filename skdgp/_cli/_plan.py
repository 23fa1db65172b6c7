"""The command ``plan``: manoeuvres for the next flight."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, table_writer
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import Writer, text_writer
from skdgp._compute.messages import warn
from skdgp._compute.progress import listening
from skdgp._excitation import AXES
from skdgp.design import (
    Envelope,
    Limits,
    Plan,
    ardupilot_script,
    surface_mixes,
    write_flight_card,
)
from skdgp.design import plan as plan_flight
from skdgp.dynamics import trim

RATE = 50.0  # of the rows of tables, and of the script [Hz]


def plan(run: Run) -> None:
    """Choose the manoeuvres of the next flight: those that lower the errors of a goal most in the given time.

    Doublets, 3-2-1-1s and multisines are simulated from trims of the model. Each that is chosen is
    flown by aircraft drawn from its posterior, in gusts as those of its training flights, and is
    made smaller or left out if it leaves the limits too often. These are the range of the training
    flights, with --growth, but for those that are given. The controls are open loop during a
    manoeuvre; return to the trim in the pause after it. Ctrl-C ends the search with the best of
    what has been checked, if anything has.

    Writes into DIR, all or none, and removes tables and scripts there that an earlier plan wrote
    and this one does not:
      plan.csv       time [s] and deviations from trim of the axes [rad, throttle 0 to 1], at 50 Hz; plan_1.csv,
                     plan_2.csv ... of several airspeeds
      plan.lua       a script for ArduPilot; with --full, the deflections at the ends of the servos' ranges
      card.html      a flight card to print: trim, entry, inputs, expected responses, abort limits, what it promises
      expected.csv   the flight that the model expects, manoeuvre by manoeuvre
      plan.json      trims, manoeuvres, risks, standard deviations before and promised; validate --plan compares them
                     with those of a model learned from this flight too

    For example:
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron rudder -o next
      skdgp plan results/model.joblib --airspeed 30 40 --seconds 120 --axes elevator --goal Cm_q -o pitch
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes rudder --full rudder=0.4 -o yaw
    """
    options = run.options
    console = run.console
    axes = list(dict.fromkeys(options.axes))
    full = dict(options.full)
    limits = _limits(options)
    if full:
        surface_mixes([axis for axis in axes if axis != "throttle"], full)  # the search takes long
    asked: dict[str, Any] = {
        name: getattr(options, option[2:].replace("-", "_"))
        for name, option in Envelope.command_options.items()
    }
    asked |= {"growth": float(options.growth), "risk": options.risk, "margin": options.margin}
    envelope = Envelope(**asked, n_paths=options.paths, gusts=opt.none_of(options.gusts))
    console.stage("reading")
    model, thrust = read_model_to_fly(options)
    altitude = options.altitude
    if altitude is None:  # the highest that was flown
        altitude = envelope.altitudes(model.pipeline)[1]
    climb = None if thrust is None else 0.0
    trims = trim(
        model.pipeline,
        model.aircraft,
        sorted(set(options.airspeed)),
        altitude=altitude,
        climb=climb,
        thrust=thrust,
    )
    with listening(console.progress), console.counting_interrupts():
        planned = plan_flight(
            model.pipeline,
            model.aircraft,
            trims,
            seconds=options.seconds,
            axes=axes,
            goal=options.goal,
            limits=limits,
            envelope=envelope,
            thrust=thrust,
            random_state=options.seed,
        )
    numbers = {"model": options.model, "seconds": planned.seconds, **planned.to_dict()}
    earlier = r"plan(_\d+)?\.(csv|lua)"
    files = run.write_record("plan.json", numbers, _writers(options, planned), earlier)
    run.print(_text(planned, options, files), numbers)


def _limits(options: argparse.Namespace) -> dict[str, Limits]:
    amplitudes = dict(options.limits)
    rates = dict(options.rates)
    if lacking := sorted({*rates} - {*amplitudes}):
        raise ValueError(
            f"Got --rates of {', '.join(lacking)} without --limits, but expected both: add "
            f"--limits."
        )
    return {axis: Limits(size, rates.get(axis, np.inf)) for axis, size in amplitudes.items()}


def _writers(options: argparse.Namespace, planned: Plan) -> dict[str, Writer]:
    files: dict[str, Writer] = {}
    full = dict(options.full)
    for number, train in enumerate(planned.trains, start=1):
        name = "plan" if len(planned.trains) == 1 else f"plan_{number}"
        files[f"{name}.csv"] = table_writer(train.table(RATE), ".csv")
        if full:
            try:
                files[f"{name}.lua"] = text_writer(ardupilot_script(train, RATE, full))
            except ValueError as error:  # the plan is kept
                warn(f"No script for ArduPilot: {error}", stacklevel=2)
    return files | {
        "card.html": partial(write_flight_card, plan=planned, full=full),
        "expected.csv": table_writer(planned.flight, ".csv"),
    }


def _text(planned: Plan, options: argparse.Namespace, files: list) -> str:
    """Return trims, manoeuvres, limits and standard deviations as tables."""
    lines = []
    for number, point in enumerate(planned.trims):
        controls = ", ".join(f"{name} {value:.4g}" for name, value in point.controls.items())
        lines.append(f"train {number}: {point.airspeed:g} m/s, {controls}")
    flown = {point.airspeed for point in planned.trims}
    lines += [f"{speed:g} m/s: nothing planned there" for speed in {*options.airspeed} - flown]
    columns = ["train", "start", "name", "scale", "risk"]
    lines += ["", planned.manoeuvres[columns].to_string(index=False, float_format="{:.3g}".format)]
    if not np.isnan(planned.risk):
        lines.append(f"risk of the flight, of any of these: {planned.risk:.1%}")
    limits = planned.abort_limits
    if limits.empty:
        lines += ["", "no limits, not even a floor: set them by --growth, --max-bank, --floor ..."]
    else:
        expected = planned.expected(range(len(planned.manoeuvres)))
        until = (
            f"up to {planned.response:g} s after the inputs; the risk counts {planned.reaction:g} s"
        )
        lines += ["", f"limits, and what is expected {until}, SI units"]
        lines.append(_table(limits.join(expected, rsuffix=" expected")))
    lines += ["", "standard deviations", _table(planned.errors)]
    if not options.full:
        lines += ["", "no script for ArduPilot: --full gives the full deflections that it needs"]
    return "\n".join([*lines, "", *map(str, files)])


def _table(table: pd.DataFrame) -> str:
    return table.to_string(float_format="{:.3g}".format)


COMMANDS: opt.Commands = {
    plan: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--airspeed": opt.SHARED["--airspeed"],
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
            | {"help": "largest deviations from trim [rad] (default: what was flown)"},
            "--rates": opt.AXIS_VALUES
            | {"help": "largest rates of change [rad/s] of axes with --limits (default: none)"},
            "--max-bank": {"metavar": "RAD", "type": opt.positive("rad"), "help": "to either side"},
            "--floor": {
                "metavar": "M",
                "type": opt.number(),
                "help": "lowest altitude [m] (default: the lowest that was flown)",
            },
            "--growth": {
                "metavar": "X",
                "type": opt.number(
                    "a number, 0 or more, or inf", lambda value: value >= 0, words=("inf",)
                ),
                "default": 0.2,
                "help": (
                    "part of its range by which a quantity may leave what was flown; inf: no "
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
}
