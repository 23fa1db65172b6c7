"""The command ``simulate``: fly a model from a moment of a log or from a trim."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, check_writable, picture_writers, table_writer
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import json_text, text_writer
from skdgp._display.style import display_unit
from skdgp._flight.channels import AIR_DATA, EULER, RATES, THRUST_FORCES, THRUST_MOMENTS, WIND
from skdgp._flight.checks import check_columns, check_names
from skdgp._mechanics.record import REASONS
from skdgp.design import doublet
from skdgp.dynamics import Air, SimulationWarning, Trim, as_aerodynamics, trajectory_bands, trim
from skdgp.dynamics import simulate as simulate_flight
from skdgp.identification import named_flights
from skdgp.io import read_flight
from skdgp.plotting import TrajectoryDisplay
from skdgp.preprocessing import FlightCheck, FlightPathReconstruction, FlightSmoother, LagCorrector

DURATION = 10.0
PULSE = 1.0
"""Start and length of the pulses of a doublet [s], about a quarter of a period of 1.5 rad/s; a
guess.
"""
OUT_OF_TRIM = 0.005
"""Largest difference of a table's first row to the trim without a warning [rad, or part of the
throttle]; a guess.
"""
START = (*AIR_DATA, *EULER, *RATES, "altitude")
THRUST = (*THRUST_FORCES, *THRUST_MOMENTS)
MEASUREMENTS = (FlightCheck, LagCorrector, FlightPathReconstruction, FlightSmoother)
"""Steps of a pipeline that estimate from sensors what the flight was."""


@dataclass(frozen=True)
class Start:
    """Initial state, controls and air of a simulation; ``log`` or ``trim`` is what it starts from."""

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
    --deviations TABLE holds deviations from the trim, and --controls TABLE the controls themselves,
    which a trim does not change: columns time [s], the first row the start, elevator, aileron,
    rudder [rad], throttle. What the table lacks is held.

    The mean flies in still air, unless --wind says otherwise, or in the wind that is estimated from
    the log. The drawn functions also meet gusts: as strong as those of this wind, else those of the
    training flights. --gusts none: none.

    Writes into DIR, all or none:
      trajectory.csv    a flight table of the mean; "beyond" names a regressor outside of the training data,
                        "ended" says why a trajectory is over
      bands.csv         median, 2.5 % and 97.5 % of the paths over time
      trajectory.png    a picture
      simulation.json   start, end, when it ended or left the training data
      config.toml       all options of this run

    For example:
      skdgp simulate results/model.joblib --flight wednesday.csv --at 120 --duration 5 -o flown
      skdgp simulate results/model.joblib --trim 35 --altitude 200 --bank 0.5 -o turn
      skdgp simulate results/model.joblib --trim 35 --doublet elevator=0.03 --paths 100 -o doublet
    """
    options = run.options
    suffix = f".{options.format}"
    check_writable(suffix)
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
    files = {f"trajectory{suffix}": table_writer(trajectory, suffix)}
    if options.paths:
        run.console.stage(f"simulating {options.paths} functions of the posterior")
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", SimulationWarning
            )  # the summary says which share of them
            conditions["air"] = Air(start.wind, gusts=opt.none_of(options.gusts))
            sampled = simulate_flight(
                *initial, **conditions, n_paths=options.paths, random_state=options.seed
            )
        files[f"bands{suffix}"] = table_writer(
            trajectory_bands(sampled).drop(columns="start"), suffix
        )
    numbers = _numbers(options, start, trajectory, sampled)
    drawn, mean = (trajectory, None) if sampled is None else (sampled, trajectory)
    files |= picture_writers(
        "trajectory.png", TrajectoryDisplay.from_trajectories, drawn, start.log, mean=mean
    )
    files["simulation.json"] = text_writer(json_text(numbers))
    run.print(_text(numbers, run.write(files)), numbers)


def _start(options, model, thrust) -> Start:
    if (options.flight is None) == (options.trim is None):
        raise ValueError(
            "Got both or none of --flight and --trim, but expected one of them to start from."
        )
    of_trim = ("altitude", "climb", "turn_rate", "bank", "deviations", "doublet")
    belonging = {"flight": ("at", "servos", "airborne"), "trim": of_trim}
    other = "trim" if options.trim is None else "flight"
    given = [
        f"--{name.replace('_', '-')}"
        for name in belonging[other]
        if getattr(options, name) not in (None, [])
    ]
    if given:
        raise ValueError(
            f"Got {', '.join(given)} without --{other}, to which it belongs: leave it out."
        )
    moving = [
        f"--{name}" for name in ("controls", "deviations", "doublet") if getattr(options, name)
    ]
    if len(moving) > 1:
        raise ValueError(
            f"Got {' and '.join(moving)}, but expected one of them: give one table of all controls."
        )
    return _trimmed(options, model, thrust) if options.flight is None else _logged(options, model)


def _trimmed(options, model, thrust) -> Start:
    climb = (
        0.0 if options.climb is None and thrust is not None else options.climb
    )  # without thrust it follows
    path = {"climb": climb, "turn_rate": options.turn_rate, "bank": options.bank}
    altitude = options.altitude or 0.0
    steady = cast(
        Trim,
        trim(
            model.pipeline, model.aircraft, options.trim, altitude=altitude, thrust=thrust, **path
        ),
    )
    state = {name: getattr(steady, name) for name in (*AIR_DATA, "phi", "theta", "altitude")}
    state |= dict(zip(RATES, steady.rates, strict=True))  # by the air, which the wind carries along
    if options.controls is not None:
        table = read_flight(options.controls)
        mixing = as_aerodynamics(model.pipeline).mixing
        known: Any = dict(table.iloc[0])
        if mixing is not None and set(mixing.surfaces) <= set(table):
            known |= dict(
                zip(
                    mixing.controls,
                    mixing.matrix @ [known[name] for name in mixing.surfaces],
                    strict=True,
                )
            )
        _warn_out_of_trim(known, steady)
    elif options.deviations is not None or options.doublet:
        known = table = _moved(options, steady)
    else:
        return Start(
            state, steady.controls, options.wind, options.duration or DURATION, trim=steady
        )
    constant = {name: value for name, value in steady.controls.items() if name not in known}
    return Start(
        state, table.assign(**constant), options.wind, _duration(options, table), trim=steady
    )


def _moved(options, steady) -> pd.DataFrame:
    """Return the controls of a trim with the deviations of the options."""
    if options.deviations is not None:
        table = read_flight(options.deviations)
    else:
        time = np.arange(0.0, (options.duration or DURATION) + options.dt, options.dt)
        moves = {
            axis: doublet(PULSE, size)(time - PULSE)
            for axis, size in opt.by_axis(options.doublet).items()
        }
        table = pd.DataFrame({"time": time} | moves)
    axes = [name for name in map(str, table) if name not in ("time", "flight")]
    check_names(axes, steady.controls, "trim's controls")
    return table.assign(**{name: steady.controls[name] + table[name] for name in axes})


def _warn_out_of_trim(first, steady) -> None:
    """Warn if the first controls are far from those of the trim: the table may hold deviations."""
    far = {
        n: v for n, v in steady.controls.items() if n in first and abs(first[n] - v) > OUT_OF_TRIM
    }
    if far:
        found = ", ".join(
            f"{name} {first[name]:.4g} (trim {value:.4g})" for name, value in far.items()
        )
        warnings.warn(
            f"The first row of --controls is not the trim: {found}. If the table holds deviations "
            f"from the trim, give "
            "--deviations TABLE.",
            stacklevel=2,
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
    if options.controls is None:
        return Start(state, log, wind, _duration(options, log), log)
    table = read_flight(options.controls)
    return Start(state, table, wind, _duration(options, log, table))


def _duration(options, *tables) -> float:
    longest = min(np.ptp(table["time"].to_numpy(float)) for table in tables)
    return min(DURATION, longest) if options.duration is None else options.duration


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
    lines += [
        "",
        f"{'':<10}{'start':>10}{'end':>10}{'' if paths is None else '95 % of the paths':>24}",
    ]
    for name in START:
        factor, unit = display_unit(name)
        row = f"{name:<10}{factor * numbers['start'][name]:>z10.2f}{factor * numbers['end'][name]:>z10.2f}"
        if paths is not None:
            low, high = (factor * edge for edge in paths["end"][name])
            row += f"{low:>z12.2f} to {high:<z8.2f}"
        lines.append(f"{row}  {unit}".rstrip())
    width = max(len(path.name) for path in files) + 2
    return "\n".join([*lines, "", *(f"{path.name:<{width}}{path}" for path in files)])


SIMULATE = opt.Command(
    simulate,
    {
        "": [
            *(opt.MODEL, opt.AIRCRAFT, opt.FOLDER),
            opt.option(
                "--controls TABLE",
                "the controls to fly with: deflections [rad], not deviations from a trim",
            ),
            opt.option(
                "--wind N E D",
                "velocity of the air [m/s], north, east, down (default: estimated from the log, "
                "else 0 0 0)",
                opt.number(),
                nargs=3,
            ),
            opt.choice(
                "--gusts", ["auto", "none"], "that the drawn functions meet (default: auto)"
            ),
            opt.option(
                "--duration S",
                "how long [s] (default: 10, or the rest of the log)",
                opt.positive("seconds"),
            ),
            opt.option(
                "--dt S", "time step [s] (default: 0.02)", opt.positive("seconds"), default=0.02
            ),
            opt.paths(30, "to fly; 0: the mean alone"),
            opt.SEED,
            opt.choice("--format", ["csv", "parquet"], "of the tables (default: csv)"),
        ],
        "start, of a log or of a trim": [
            opt.option("--flight LOG", "start where this flight was"),
            opt.option("--at S", "when, on the clock of the log [s]", opt.number()),
            *(opt.SERVOS, opt.AIRBORNE),
            opt.option(
                "--trim V", "start from steady flight at this airspeed [m/s]", opt.positive("m/s")
            ),
            opt.axis_values(
                "--doublet",
                "deviations [rad]: up from 1 to 2 s, down from 2 to 3 s, such as elevator=0.03",
            ),
            opt.option("--deviations TABLE", "deviations of the controls from the trim"),
            opt.option("--altitude M", "of the trim [m] (default: 0)", opt.number()),
            opt.option(
                "--climb RAD",
                "flight-path angle [rad] (default: 0; without thrust it follows)",
                opt.number(),
            ),
            opt.option("--turn-rate RAD/S", "of the heading [rad/s] (default: 0)", opt.number()),
            opt.option("--bank RAD", "bank angle [rad], instead of a turn rate", opt.number()),
        ],
    },
    outputs=r"bands\.(csv|parquet)|trajectory\.png",
)
