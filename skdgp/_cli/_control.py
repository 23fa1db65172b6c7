"""Commands for control: margins of an autopilot's loops around a model, and its simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from skdgp._cli._shared import (
    AIRCRAFT,
    AIRSPEED,
    ALTITUDE,
    FULL,
    MODEL,
    OUTPUT,
    PATHS,
    SEED,
    Commands,
    Run,
    changed,
    checked,
    number,
    option,
)
from skdgp._cli._use import read_model_to_fly, trimmed, warn_unfit
from skdgp._compute.files import csv_writer
from skdgp.control import (
    Loop,
    autopilot_loops,
    full_outputs,
    read_parameters,
    suggest_gains,
)
from skdgp.control import fly as fly_model
from skdgp.control import margins as margins_of
from skdgp.dynamics import Turbulence, linearize


def margins(run: Run) -> None:
    """Print the margins of the loops of PX4 or ArduPilot Plane around a model, and gains that have wanted margins.

    The file has the autopilot's parameters, as a ground station saves them. --full gives the deflections
    [rad] with the servos at their ends, as of fly (PX4: at an output of 1); loops of controls that it does not
    name are open. With -o writes margins.csv, suggested.csv and margins.json.

    For example:
      skdgp margins results/model.joblib --params plane.params --airspeed 20 --full aileron=0.42 elevator=0.42
    """
    options = run.options
    loops = autopilot_loops(options.params, dict(options.full))
    model = read_model_to_fly(options)
    warn_unfit(model, "design a controller", "Do not set gains by these margins.")
    steady = trimmed(model, options.airspeed, options.altitude)
    linear = linearize(
        model.pipeline,
        model.aircraft,
        steady,
        n_paths=options.paths,
        random_state=options.seed,
        thrust=model.thrust,
        delay=options.delay,
        perturbation=None if options.slopes == "local" else "flown",
    )
    now = margins_of(linear, loops)
    servos = linear.servos
    late = f"servos behind the logged commands {servos.words}; {1e3 * options.delay:.0f} ms more before (--delay)"
    texts = [f"margins now, at {options.airspeed:g} m/s: {late}", _margin_text(now)]
    for name, part in now.attrs["unstable"].items():
        texts.append(f"the closed loops are unstable in {part:.0%} of the aircraft: {name}")
    files = {"margins.csv": csv_writer(now.reset_index())}
    numbers: dict[str, Any] = {
        "parameters": options.params,
        "servos": servos,
        "delay": options.delay,
        "margins": _with_infinities(now),
        "unstable": now.attrs["unstable"],
    }
    try:
        suggested = suggest_gains(
            linear,
            loops,
            gain_margin=options.gain_margin,
            phase_margin=options.phase_margin,
            probability=options.probability,
        )
    except ValueError as error:
        texts += ["", f"no gains are suggested: {error}"]
    else:
        gains = _gains_of(loops, suggested)
        then = margins_of(linear, suggested)
        texts += ["", "largest gains with the margins asked for", gains.to_string(index=False)]
        texts += ["", "margins with these gains", _margin_text(then)]
        files["suggested.csv"] = csv_writer(gains)
        numbers["gains"] = gains.to_dict("records")
        numbers["margins_suggested"] = _with_infinities(then)
    run.finish(texts, numbers, files, "margins.json")


def _gains_of(loops: list[Loop], suggested: list[Loop]) -> pd.DataFrame:
    """Return the parameters with their values now and suggested."""
    rows = []
    for before, after in zip(loops, suggested, strict=True):
        for name, value in (before.parameters or {}).items():
            new = float(f"{(after.parameters or {})[name]:.4g}")
            rows.append({"parameter": name, "now": value, "suggested": new})
    return pd.DataFrame(rows)


def _with_infinities(table: pd.DataFrame) -> pd.DataFrame:
    """Return margins for JSON, which has no infinity: that of an unstable loop is "-inf", an unlimited one "inf"."""
    return table.astype(object).replace({np.inf: "inf", -np.inf: "-inf"})


def _margin_text(table: pd.DataFrame) -> str:
    """Return margins as text."""
    shown = table.rename_axis(index=["", ""])
    as_percent = {"probability": "{:.0%}".format}
    return shown.to_string(float_format="{:.3g}".format, formatters=as_percent, na_rep="")


PARAMETERS = option(
    "--params",
    help="parameters of the autopilot, for SERVOn_* (default: servos 1 to 4 are aileron, "
    "elevator, throttle, rudder, 1100 to 1900 us)",
)
# Least height of gusts [m], which vanish at the ground
LEAST_GUST_HEIGHT = 100.0


def fly(run: Run) -> None:
    """Fly a model in ArduPilot's simulator, as its physics: JSON interface, UDP.

    Start the simulator beside it: sim_vehicle.py -v ArduPlane --model JSON:127.0.0.1. The aircraft begins at its
    trim, 100 m or --height above the ground, where the flight is over. --full gives deflections [rad] at full output,
    and thrust [N] or propeller_speed [rad/s] where that sets the thrust. With -o writes flight.csv; each start of
    the simulator is a flight in it.

    For example:
      skdgp fly results/model.joblib --airspeed 20 --full aileron=0.42 elevator=0.42 rudder=0.35
      skdgp fly results/model.joblib --airspeed 20 --full aileron=0.42 elevator=0.42 rudder=0.35 --path 3 --gusts 5
    """
    options = run.options
    parameters = read_parameters(options.params) if options.params else None
    model = read_model_to_fly(options)
    warn_unfit(model, "simulate", "Its flights are unlike those of the aircraft.")
    given = {**(model.aircraft.full_deflections or {}), **dict(options.full)}
    full = full_outputs(model.pipeline, model.aircraft, given, model.thrust)
    gusts = _gusts_of(options, model)
    steady = trimmed(model, options.airspeed, options.altitude + options.height)

    def ready() -> None:
        run.console.stage("")
        run.console.print_error(f"waiting for ArduPilot at port {options.port}; Ctrl-C ends")

    flown = fly_model(
        model.pipeline,
        model.aircraft,
        steady,
        full,
        parameters=parameters,
        height=options.height,
        path=options.path,
        wind=options.wind,
        gusts=gusts,
        thrust=model.thrust,
        port=options.port,
        wait=options.wait,
        seconds=options.seconds or np.inf,
        ready=ready,
    )
    rate = flown.steps / max(flown.computing, 1e-9)
    duration, outside = 0.0, 0.0
    if len(flown.table):
        duration = flown.table.groupby("flight")["time"].max().sum()
        outside = (flown.table["beyond"] != "").mean()
    lines = [f"{flown.reason}: {duration:.1f} s of flight, {rate:.0f} steps a second were possible"]
    if outside:
        lines.append(f"{outside:.0%} of the flight is outside of what the model was learned from")
    numbers = {
        "seconds": duration,
        "steps": flown.steps,
        "steps_per_second": rate,
        "outside": outside,
        "reason": flown.reason,
    }
    run.finish(lines, numbers, {"flight.csv": csv_writer(flown.table)})


def _gusts_of(options: Any, model: Any) -> Turbulence | None:
    """Return the gusts of the training flights or of a wind; raise ValueError if those are not known."""
    if options.gusts in (None, 0.0):
        return None
    if options.gusts != "flown":
        return Turbulence.low_altitude(max(options.height, LEAST_GUST_HEIGHT), options.gusts)
    flown = model.pipeline.turbulence_
    if flown is None:
        raise ValueError(
            "Got --gusts flown, but the model does not know the gusts of its flights: expected the wind speed "
            "6 m above the ground, such as --gusts 5."
        )
    return flown


COMMANDS: Commands = {
    margins: {
        "": [
            MODEL,
            AIRCRAFT,
            AIRSPEED,
            ALTITUDE,
            PATHS,
            SEED,
            OUTPUT,
            changed(
                PARAMETERS,
                required=True,
                help="parameters of PX4 or ArduPilot Plane, as a ground station saves them",
            ),
            changed(
                FULL,
                required=True,
                help="deflections [rad] with the servos at their ends (PX4: at an output of 1)",
            ),
            option(
                "--delay",
                type=number(">= 0"),
                default=0.02,
                help="of the commands before they are logged [s], from sampling and computing; the delay of the "
                "servos and the hold of the commands, which the flights show, come on top (default: 0.02)",
            ),
            option(
                "--slopes",
                choices=["flown", "local"],
                default="flown",
                help="over the motion flown, or of small oscillations (default: flown)",
            ),
            option(
                "--gain-margin",
                type=number("> 0"),
                default=6.0,
                help="wanted (default: 6)",
            ),
            option(
                "--phase-margin",
                type=number("> 0"),
                default=45.0,
                help="wanted (default: 45)",
            ),
            option(
                "--probability",
                type=checked("a probability between 0 and 1", float, lambda p: 0 < p < 1),
                default=0.95,
                help="of the wanted margins (default: 0.95)",
            ),
        ],
    },
    fly: {
        "": [
            MODEL,
            AIRCRAFT,
            AIRSPEED,
            FULL,
            OUTPUT,
            PARAMETERS,
            option(
                "--path",
                type=number(">= 0", kind=int),
                help="seed of one aircraft of the posterior, and of the gusts (default: the mean flies)",
            ),
            option(
                "--height",
                type=number("> 0"),
                default=100.0,
                help="of the start above the ground [m] (default: 100)",
            ),
            changed(ALTITUDE, help="of the ground [m] (default: 0)"),
            option(
                "--wind",
                metavar=("NORTH", "EAST", "DOWN"),
                type=number(),
                nargs=3,
                help="velocity of the air [m/s] (default: 0 0 0)",
            ),
            option(
                "--gusts",
                metavar="W|flown",
                type=number(">= 0", "flown"),
                help="gusts as in this wind [m/s] 6 m above ground, or as in the training flights (default: calm)",
            ),
            option(
                "--seconds",
                type=number("> 0"),
                help="of flight (default: until the autopilot is silent)",
            ),
            option(
                "--wait",
                type=number("> 0"),
                default=60.0,
                help="longest silence of the autopilot [s] (default: 60)",
            ),
            option(
                "--port",
                type=number(">= 1", kind=int),
                default=9002,
                help="UDP port (default: 9002)",
            ),
        ],
    },
}
