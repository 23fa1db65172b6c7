"""The command ``simulate``: fly a model from a moment of a log or from a trim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, picture_writers
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import csv_writer
from skdgp._compute.messages import without_warnings
from skdgp._display.style import display_unit
from skdgp._flight.channels import AIR_DATA, EULER, RATES, THRUST_FORCES, THRUST_MOMENTS, WIND
from skdgp._flight.checks import check_columns, check_names
from skdgp.design import doublet
from skdgp.dynamics import REASONS, Air, SimulationWarning, Trim, trajectory_bands, trim
from skdgp.dynamics import simulate as simulate_flight
from skdgp.identification import named_flights
from skdgp.plotting import TimeHistoryDisplay
from skdgp.preprocessing import FlightCheck, FlightPathReconstruction, FlightSmoother, LagCorrector

DURATION = 10.0
PULSE = 1.0
"""Start and length of the pulses of a doublet [s], about a quarter of a period of 1.5 rad/s; a
guess.
"""
START = (*AIR_DATA, *EULER, *RATES, "altitude")
THRUST = (*THRUST_FORCES, *THRUST_MOMENTS)
MEASUREMENTS = (FlightCheck, LagCorrector, FlightPathReconstruction, FlightSmoother)
"""Steps of a pipeline that estimate the flight from its sensors."""


@dataclass(frozen=True)
class Start:
    """Initial state, controls and air of a simulation, which starts from a ``log`` or a ``trim``."""

    state: dict[str, float]
    controls: dict | pd.DataFrame
    wind: list[float] | pd.DataFrame | None
    duration: float
    log: pd.DataFrame | None = None
    trim: Trim | None = None


def simulate(run: Run) -> None:
    """Fly a model, from a moment of a log with its controls from there on, or from a trim with its controls held.

    The mean of the model is flown, and functions drawn from its posterior, each an aircraft that
    the data allow: the band of 95 % of them is how certain the trajectory is. From a trim,
    --doublet AXIS=X moves a control by X about its trim, +X from 1 to 2 s and -X from 2 to 3 s.
    Any other inputs: skdgp.dynamics.simulate.

    The mean flies in still air, unless --wind says otherwise, or in the wind that is estimated from
    the log. The drawn functions also meet gusts: as strong as those of this wind, else those of the
    training flights. --gusts none: none.

    Writes into DIR, all or none:
      trajectory.csv    a flight table of the mean; "beyond" names a regressor outside of the training data,
                        "ended" says why a trajectory is over
      bands.csv         median, 2.5 % and 97.5 % of the paths over time
      trajectory.png    a picture
      simulation.json   the command, start, end, when it ended or left the training data

    For example:
      skdgp simulate results/model.joblib --flight wednesday.csv --at 120 --duration 5 -o flown
      skdgp simulate results/model.joblib --trim 35 --altitude 200 --bank 0.5 -o turn
      skdgp simulate results/model.joblib --trim 35 --doublet elevator=0.03 --paths 100 -o doublet
    """
    options = run.options
    run.console.stage("reading")
    model, thrust = read_model_to_fly(options)
    start = _start(options, model, thrust)
    run.console.stage("simulating")
    initial = (model.pipeline, model.aircraft, start.state, start.controls, options.dt)
    conditions: dict[str, Any] = {
        "duration": start.duration,
        "air": Air(start.wind),
        "thrust": thrust,
    }
    trajectory, sampled = simulate_flight(*initial, **conditions), None
    files = {"trajectory.csv": csv_writer(trajectory)}
    if options.paths:
        run.console.stage(f"simulating {options.paths} functions of the posterior")
        with without_warnings(SimulationWarning):  # the summary counts them
            conditions["air"] = Air(start.wind, gusts=opt.none_of(options.gusts))
            sampled = simulate_flight(
                *initial, **conditions, n_paths=options.paths, random_state=options.seed
            )
        files["bands.csv"] = csv_writer(trajectory_bands(sampled).drop(columns="start"))
    numbers = _numbers(options, start, trajectory, sampled)
    drawn, mean = (trajectory, None) if sampled is None else (sampled, trajectory)
    files |= picture_writers(
        "trajectory.png", TimeHistoryDisplay.from_trajectories, drawn, start.log, mean=mean
    )
    earlier = r"bands\.csv|trajectory\.png"
    written = run.write_record("simulation.json", numbers, files, earlier)
    run.print(_text(numbers, written), numbers)


def _start(options, model, thrust) -> Start:
    """Return the start that the options name; raise ValueError if some of them contradict each other."""
    if (options.flight is None) == (options.trim is None):
        raise ValueError(
            "Got both or none of --flight and --trim, but expected one of them to start from."
        )
    belonging = {
        "flight": ("at", "servos", "rename", "airborne"),
        "trim": ("altitude", "climb", "bank", "doublet"),
    }
    other = "trim" if options.trim is None else "flight"
    names = [name for name in belonging[other] if getattr(options, name) not in (None, [])]
    if names:
        given = ", ".join(f"--{name.replace('_', '-')}" for name in names)
        raise ValueError(f"Got {given} without --{other}, to which it belongs: leave it out.")
    return _trimmed(options, model, thrust) if options.flight is None else _logged(options, model)


def _trimmed(options, model, thrust) -> Start:
    """Start from a trim, with its controls, and doublets about them."""
    path = {name: getattr(options, name) for name in ("climb", "bank")}
    if thrust is not None and options.climb is None:  # without thrust it follows
        path["climb"] = 0.0
    path |= {"altitude": options.altitude or 0.0, "thrust": thrust}
    steady: Any = trim(model.pipeline, model.aircraft, options.trim, **path)
    state = {name: getattr(steady, name) for name in (*AIR_DATA, "phi", "theta", "altitude")}
    state |= dict(zip(RATES, steady.rates, strict=True))  # by the air, which the wind carries along
    duration = options.duration or DURATION
    time = np.arange(0.0, duration + options.dt, options.dt)
    pulses = {axis: doublet(PULSE, size)(time - PULSE) for axis, size in options.doublet}
    check_names(pulses, steady.controls, "trim's controls")
    controls = {name: value + pulses.get(name, 0.0) for name, value in steady.controls.items()}
    return Start(
        state, pd.DataFrame({"time": time} | controls), options.wind, duration, trim=steady
    )


def _logged(options, model) -> Start:
    """Start from a moment of a log, its noise removed and its wind estimated by the model's pipeline."""
    if options.at is None:
        raise ValueError(
            "Got --flight without --at, but expected the moment to start from: --at SECONDS."
        )
    flights = named_flights(options.flight, **opt.reading(options, model))
    spans = {
        name: (table["time"].iloc[0], table["time"].iloc[-1]) for name, table in flights.items()
    }
    inside = [name for name, (first, last) in spans.items() if first <= options.at < last]
    if len(inside) != 1:
        times = ", ".join(
            f"{name} {first:g} to {last:g} s" for name, (first, last) in spans.items()
        )
        raise ValueError(
            f"Got --at {options.at:g}, but expected a moment of exactly one flight of the log: "
            f"{times}."
        )
    log = FlightCheck(bridge=0).fit_transform(flights[inside[0]])
    for step in model.pipeline:
        if isinstance(step, MEASUREMENTS):
            log = step.transform(log)
    check_columns(log, START)
    log = log[log["time"] >= options.at].reset_index(drop=True)
    if model.get("options", {}).get("thrust") == "propeller":
        log = log.drop(columns=[name for name in THRUST if name in log])
    wind = options.wind
    if wind is None and set(WIND) <= set(log.columns):
        wind = log[["time", *WIND]]
    state = {name: float(log[name].iloc[0]) for name in (*START, "north", "east") if name in log}
    duration = min(DURATION, np.ptp(log["time"])) if options.duration is None else options.duration
    return Start(state, log, wind, duration, log)


def _numbers(options, start, trajectory, paths) -> dict:
    """Return the summary as numbers, SI units and radians."""
    flying, first = trajectory[trajectory["ended"] == ""], trajectory.iloc[0]
    last = first if flying.empty else flying.iloc[-1]
    outside, beyond = flying[flying["beyond"] != ""], None
    if len(outside):
        beyond = {
            "first": outside["time"].iloc[0] - first["time"],
            "share": len(outside) / len(flying),
            "regressors": sorted(set(outside["beyond"])),
        }
    return {
        "model": options.model,
        "start": {name: first[name] for name in START},
        "trim": None if start.trim is None else start.trim.controls | {"thrust": start.trim.thrust},
        "duration": start.duration,
        "flown": last["time"] - first["time"],
        "ended": next((REASONS[why] for why in trajectory["ended"] if why), None),
        "beyond": beyond,
        "end": {name: last[name] for name in START},
        "paths": None if paths is None else _spread(paths),
    }


def _spread(paths) -> dict:
    """Return how many of the paths ended early, and within what 95 % of the others are at the end."""
    by_path = paths.groupby("path")
    bands = trajectory_bands(paths, columns=START).iloc[-1]
    return {
        "n": by_path.ngroups,
        "air": paths.attrs["air"],
        "ended_early": paths.loc[paths["ended"] != "", "path"].nunique(),
        "beyond": paths.loc[paths["beyond"] != "", "path"].nunique(),
        "end": {name: [bands[f"{name}_low"], bands[f"{name}_high"]] for name in START},
    }


def _text(numbers, files) -> str:
    lines, beyond, paths = (
        [f"flown {numbers['flown']:.4g} s, to the end"],
        numbers["beyond"],
        numbers["paths"],
    )
    if numbers["ended"] is not None:
        lines = [
            f"ended after {numbers['flown']:.4g} of {numbers['duration']:.4g} s: {numbers['ended']}"
        ]
    if numbers["trim"] is not None:
        units = {"throttle": "", "thrust": " N", "propeller_speed": " rad/s"}
        shown = (
            f"{name} {value:.4g}{units.get(name, ' rad')}"
            for name, value in numbers["trim"].items()
        )
        lines.append(f"trim: {', '.join(shown)}")
    if beyond is None:
        lines.append("always within what the model was learned from")
    else:
        lines.append(
            f"beyond what the model was learned from in {100 * beyond['share']:.0f} % of the "
            f"time, the first after "
            f"{beyond['first']:.4g} s: {', '.join(beyond['regressors'])}"
        )
    if paths is not None:
        counts = f"{paths['ended_early']} ended early, {paths['beyond']} left what was learned from"
        lines += [f"{paths['n']} functions of the posterior: {counts}", paths["air"]]
    states = pd.DataFrame({name: numbers[name] for name in ("start", "end")})
    if paths is not None:
        edges = pd.DataFrame(paths["end"], index=["2.5 % of paths", "97.5 %"]).T
        states = states.join(edges)
    shown_units = [display_unit(name) for name in START]
    states = states.loc[list(START)].mul([factor for factor, _ in shown_units], axis=0)
    states["unit"] = [unit for _, unit in shown_units]
    lines += ["", states.to_string(float_format="{:z.2f}".format), "", *map(str, files)]
    return "\n".join(lines)


COMMANDS: opt.Commands = {
    simulate: {
        "": {
            "model": opt.SHARED["model"],
            "--aircraft": opt.SHARED["--aircraft"],
            "--seed": opt.SHARED["--seed"],
            "--output": opt.SHARED["--output"] | {"required": True},
            "--wind": {
                "metavar": ("N", "E", "D"),
                "type": opt.number(),
                "nargs": 3,
                "help": (
                    "velocity of the air [m/s], north, east, down (default: estimated from the "
                    "log, else 0 0 0)"
                ),
            },
            "--gusts": opt.SHARED["--gusts"]
            | {"help": "that the drawn functions meet (default: auto)"},
            "--duration": {
                "metavar": "S",
                "type": opt.positive("seconds"),
                "help": "how long [s] (default: 10, or the rest of the log)",
            },
            "--dt": {
                "metavar": "S",
                "type": opt.positive("seconds"),
                "default": 0.02,
                "help": "time step [s] (default: 0.02)",
            },
            "--paths": opt.SHARED["--paths"]
            | {
                "default": 30,
                "help": "functions of the posterior to fly; 0: the mean alone (default: 30)",
            },
        },
        "start where a flight was": {
            "--flight": {"metavar": "LOG", "help": "the log of the flight"},
            "--at": {
                "metavar": "S",
                "type": opt.number(),
                "help": "when, on the clock of the log [s]",
            },
            **opt.LOG,
        },
        "start from a trim": {
            "--trim": {
                "metavar": "V",
                "type": opt.positive("m/s"),
                "help": "start from steady flight at this airspeed [m/s]",
            },
            "--doublet": opt.AXIS_VALUES
            | {
                "help": (
                    "deviations [rad]: up from 1 to 2 s, down from 2 to 3 s, such as elevator=0.03"
                )
            },
            "--altitude": {
                "metavar": "M",
                "type": opt.number(),
                "help": "of the trim [m] (default: 0)",
            },
            "--climb": {
                "metavar": "RAD",
                "type": opt.number(),
                "help": "flight-path angle [rad] (default: 0; without thrust it follows)",
            },
            "--bank": {
                "metavar": "RAD",
                "type": opt.number(),
                "help": "bank angle of a level turn [rad] (default: 0)",
            },
        },
    },
}
