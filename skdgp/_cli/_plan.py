"""The command ``plan``: manoeuvres for the next flight."""

from __future__ import annotations

import argparse
import warnings
from functools import partial

import numpy as np

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, table_writer
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import Writer, json_text, text_writer
from skdgp._compute.progress import listening
from skdgp._excitation import AXES
from skdgp.design import (
    Envelope,
    Limits,
    Pilot,
    Plan,
    ardupilot_script,
    surface_mixes,
    write_csv,
    write_flight_card,
)
from skdgp.design import plan as plan_flight
from skdgp.io import read_servos, servo_outputs

DETENTS = dict.fromkeys(AXES, float(np.deg2rad(1.0))) | {"throttle": 0.1}
"""Of a pilot's controls [rad, or 1 of the throttle]."""


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
      plan.csv       time [s] and deviations from trim of the axes [rad, throttle 0 to 1]; plan_1.csv, plan_2.csv ... of
                     several airspeeds
      plan_servos.csv  with --servos, what the channels of the servos send: trims and inputs together
      plan.lua       a script for ArduPilot; with --full, the deflections at the ends of the servos' ranges
      card.html      a flight card to print: trim, entry, inputs, expected responses, abort limits, what it teaches
      expected.csv   the flight that the model expects, manoeuvre by manoeuvre
      plan.json      trims, manoeuvres, risks, standard errors before and after; validate --plan compares them with
                     the flight
      config.toml    all options of this run

    For example:
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron rudder -o next
      skdgp plan results/model.joblib --airspeed 30 40 --seconds 120 --axes elevator --goal Cm_q -o pitch
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes rudder --full rudder=0.4 -o yaw
    """
    options, console = run.options, run.console
    axes, limits, full = (
        list(dict.fromkeys(options.axes)),
        _limits(options),
        opt.by_axis(options.full),
    )
    if options.servos:
        read_servos(options.servos)
    if full:
        surface_mixes([axis for axis in axes if axis != "throttle"], full)  # the search takes long
    detents = (
        None
        if options.pilot is None
        else {one: DETENTS[one] for one in axes} | opt.by_axis(options.pilot)
    )
    asked = {
        name: getattr(options, option[2:].replace("-", "_"))
        for name, option in Envelope.command_options.items()
    }
    chosen = {
        "growth": float(options.growth),
        "risk": options.risk,
        "margin": options.margin,
        "n_paths": options.paths,
    }
    console.stage("reading")
    model, thrust = read_model_to_fly(options)
    with listening(console.progress), console.counting_interrupts():
        planned = plan_flight(
            model.pipeline,
            model.aircraft,
            airspeeds=sorted(set(options.airspeed)),
            seconds=options.seconds,
            axes=axes,
            goal=options.goal,
            limits=limits,
            envelope=Envelope(**asked, **chosen, gusts=opt.none_of(options.gusts)),
            altitude=options.altitude,
            pilot=Pilot(options.pause or "auto", options.rate, detents),
            thrust=thrust,
            random_state=options.seed,
        )
    numbers = {"model": options.model, "seconds": planned.seconds, **planned.to_dict()}
    files = run.write(_writers(options, planned, numbers))
    run.print(_text(planned, options, files), numbers)


def _limits(options: argparse.Namespace) -> dict[str, Limits]:
    amplitudes = opt.by_axis(options.limits)
    more = {"rate": opt.by_axis(options.rates), "lag": opt.by_axis(options.servo_lags)}
    for option, values in zip(("--rates", "--servo-lags"), more.values(), strict=True):
        if lacking := sorted({*values} - {*amplitudes}):
            raise ValueError(
                f"Got {option} of {', '.join(lacking)} without --limits, but expected both: add "
                f"--limits."
            )
    return {
        axis: Limits(
            amplitude, **{name: values[axis] for name, values in more.items() if axis in values}
        )
        for axis, amplitude in amplitudes.items()
    }


def _writers(options: argparse.Namespace, planned: Plan, numbers: dict) -> dict[str, Writer]:
    files: dict[str, Writer] = {}
    rate, full = options.rate, opt.by_axis(options.full)
    for number, train in enumerate(planned.trains, start=1):
        name = "plan" if len(planned.trains) == 1 else f"plan_{number}"
        files[f"{name}.csv"] = partial(write_csv, train=train, rate=rate)
        if full:
            try:
                files[f"{name}.lua"] = text_writer(ardupilot_script(train, rate, full))
            except ValueError as error:  # the plan is kept
                warnings.warn(f"No script for ArduPilot: {error}", stacklevel=2)
        if options.servos:
            try:
                table = train.table(rate, trim=planned.trims[number - 1].controls)
                files[f"{name}_servos.csv"] = table_writer(
                    servo_outputs(table, options.servos), ".csv"
                )
            except ValueError as error:
                warnings.warn(f"No outputs of servos: {error}", stacklevel=2)
    return files | {
        "card.html": partial(write_flight_card, plan=planned, full=full),
        "expected.csv": table_writer(planned.flight, ".csv"),
        "plan.json": text_writer(json_text(numbers)),
    }


def _text(planned: Plan, options: argparse.Namespace, files: list) -> str:
    rows = planned.manoeuvres
    width = max(map(len, rows["name"])) + 2
    lines = [f"{'start':>7}  {'manoeuvre':<{width}}{'of limits':>10}{'risk':>8}{'errors':>9}"]
    for number, trim in enumerate(planned.trims):
        lines.append(
            f"{trim.airspeed:g} m/s: " + ", ".join(f"{k} {v:.4g}" for k, v in trim.controls.items())
        )
        for _, row in rows[rows["train"] == number].iterrows():
            risk = "-" if np.isnan(row["risk"]) else f"{row['risk']:.1%}"
            lines.append(
                f"{row['start']:>5.1f} s  "
                f"{row['name']:<{width}}{row['scale']:>10.0%}{risk:>8}{-row['gain']:>9.0%}"
            )
    flown = {trim.airspeed for trim in planned.trims}
    if not np.isnan(planned.risk):
        lines.append(
            f"{'':<7}  {'risk of the flight, of any of these':<{width + 10}}{planned.risk:>8.1%}"
        )
    lines += [
        f"{speed:g} m/s: nothing planned there" for speed in sorted({*options.airspeed} - flown)
    ]
    limits = planned.abort_limits.join(planned.expected(range(len(rows))), rsuffix="est")
    until = f"expected, up to {planned.response:g} s after the inputs; the risk counts {planned.reaction:g} s"
    lines += [
        "",
        f"{'limits, SI units':<18}{'low':>10}{'high':>10}{'lowest':>10}{'highest':>10} {until}",
    ]
    lines += [
        f"{name:<18}"
        + "".join(f"{row[end]:>10.3g}" for end in limits.columns.drop("source"))
        + f" {row['source']}"
        for name, row in limits.iterrows()
    ] or ["none, not even a floor: set them by --growth, --max-bank, --floor ..."]
    errors = planned.errors.rename(columns={"std": "std now"})
    lines += ["", f"{'standard error of':<18}" + "".join(f"{name:>10}" for name in errors)]
    lines += [
        f"{name:<18}" + "".join(f"{one:>10.2g}" for one in row) for name, row in errors.iterrows()
    ]
    if planned.merged:
        lines += [
            "before: std_unmerged of derivatives; std now: its std, with what alpha_dot and "
            "beta_dot may hold"
        ]
    if len(planned.confounded):
        pairs = planned.confounded.head(5).itertuples()
        shown = [
            f"{one.first} and {one.second} in {one.coefficient} ({one.correlation:.2f})"
            for one in pairs
        ]
        lines += ["", f"errors that are still correlated: {', '.join(shown)}"]
    if not options.full:
        lines += ["", "no script for ArduPilot: --full gives the full deflections that it needs"]
    return "\n".join([*lines, "", *map(str, files)])


PLAN = opt.Command(
    plan,
    {
        "": [
            *(opt.MODEL, opt.AIRCRAFT),
            opt.option(
                "--airspeed V", "of the trims [m/s]", opt.positive("m/s"), nargs="+", required=True
            ),
            opt.option(
                "--seconds S", "of all flights together", opt.positive("seconds"), required=True
            ),
            opt.option("--axes", "controls to move", choices=AXES, nargs="+", required=True),
            opt.option(
                "--goal NAME",
                "function (over what was flown), free-flight (2 s), derivatives such as Cm_q "
                "Cn_rudder (default: all)",
                str,
                nargs="+",
            ),
            opt.option("--altitude M", "[m] (default: the highest that was flown)", opt.number()),
            opt.option(
                "--pause S",
                "after each manoeuvre (default: by the airspeed)",
                opt.positive("seconds"),
            ),
            opt.option(
                "--rate HZ", "of the autopilot (default: 50)", opt.positive("Hz"), default=50.0
            ),
            opt.option(
                "--pilot AXIS=X",
                "only steps that a pilot can fly: half seconds, multiples of X [rad] (default: a "
                "degree, throttle 0.1)",
                opt.axis_value,
                nargs="*",
            ),
            opt.axis_values(
                "--full", "deflections [rad] at the ends of the servos' ranges, for the script"
            ),
            opt.option(
                "--servos FILE",
                "TOML, as of identify: also writes what the channels of these servos send",
            ),
            opt.SEED,
            opt.FOLDER,
        ],
        "limits": [
            opt.axis_values(
                "--limits", "largest deviations from trim [rad] (default: what was flown)"
            ),
            opt.axis_values(
                "--rates", "largest rates of change [rad/s] of axes with --limits (default: none)"
            ),
            opt.axis_values(
                "--servo-lags", "time constants [s] of servos of axes with --limits (default: none)"
            ),
            opt.option("--alpha LOW HIGH", "[rad]", opt.number(), nargs=2),
            opt.option("--beta LOW HIGH", "[rad]", opt.number(), nargs=2),
            opt.option("--load-factor LOW HIGH", "of -az / g", opt.number(), nargs=2),
            opt.option("--speeds LOW HIGH", "[m/s]", opt.number(), nargs=2),
            opt.option("--max-bank RAD", "to either side", opt.positive("rad")),
            opt.option(
                "--floor M",
                "lowest altitude [m] (default: the lowest that was flown)",
                opt.number(),
            ),
            opt.option(
                "--growth X",
                "part of its range by which a quantity may leave what was flown; inf: no limit "
                "(default: 0.2)",
                opt.number("a number, 0 or more, or inf", lambda value: value >= 0, words=("inf",)),
                default=0.2,
            ),
            opt.option(
                "--risk P",
                "largest probability that a manoeuvre leaves the limits (default: 0.05)",
                opt.number("a number between 0 and 1", lambda value: 0 < value < 1),
                default=0.05,
            ),
            opt.option(
                "--margin X",
                "fraction by which responses may exceed the model's (default: 0.15)",
                opt.number("a number, 0 or more", lambda value: value >= 0),
                default=0.15,
            ),
            opt.choice(
                "--gusts",
                ["auto", "none"],
                "of the check: as in the training flights, or none (default: auto)",
            ),
            opt.option(
                "--paths N",
                "aircraft drawn for each check (default: 200)",
                opt.at_least(2),
                default=200,
            ),
        ],
    },
    outputs=r"plan(_\d+)?(_servos)?\.(csv|lua)",
)
