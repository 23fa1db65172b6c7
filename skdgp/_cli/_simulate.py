"""The command ``simulate``: fly a model from a moment of a log or from a trim."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd

from skdgp._cli._model import engine_of, read_model
from skdgp._cli._task import Task
from skdgp._cli._writers import Writer, check_writable, json_writer, picture_writers, table_writer
from skdgp._flight.checks import check_columns
from skdgp.dynamics import SimulationWarning, as_aerodynamics, simulate, trajectory_bands, trim
from skdgp.dynamics._simulation.trajectory import REASONS
from skdgp.identification._rows import checked
from skdgp.identification._source import read_named
from skdgp.io import read_flight
from skdgp.plotting import TrajectoryDisplay
from skdgp.plotting._style import display_unit
from skdgp.preprocessing import FlightCheck, FlightPathReconstruction, FlightSmoother

DURATION = 10.0
AIR = ("airspeed", "alpha", "beta")
START = (*AIR, "phi", "theta", "psi", "p", "q", "r", "altitude")
WIND = ("wind_north", "wind_east", "wind_down")
THRUST = ("thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m", "thrust_n")
MEASUREMENTS = (FlightCheck, FlightPathReconstruction, FlightSmoother)
"""Steps of a pipeline that make of what sensors said what the flight was."""


@dataclass(frozen=True)
class Start:
    """Where a simulation begins, its controls and its air; ``log`` is what happened in flight under these controls."""

    state: dict[str, float]
    controls: dict | pd.DataFrame
    wind: list[float] | pd.DataFrame | None
    duration: float
    log: pd.DataFrame | None = None


def fly(task: Task) -> None:
    """Fly a model, write trajectory, bands and picture, and print how it went."""
    options = task.options
    suffix = f".{options.format}"
    check_writable(suffix)
    task.console.stage("reading")
    model = read_model(options)
    engine = engine_of(model)
    start = _start(options, model, engine)
    task.console.stage("flying")
    conditions = {"duration": start.duration, "wind": start.wind, "thrust": engine}

    def flown(**paths):
        return simulate(model.pipeline, model.aircraft, start.state, start.controls, options.dt, **conditions, **paths)

    trajectory, paths = flown(), None
    files = {f"trajectory{suffix}": table_writer(trajectory, suffix)}
    if options.paths:
        task.console.stage(f"flying {options.paths} functions of the posterior")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SimulationWarning)  # the summary says which share of them
            paths = flown(n_paths=options.paths, random_state=options.seed)
        bands = trajectory_bands(paths).drop(columns="start")
        files[f"bands{suffix}"] = table_writer(bands, suffix)
    numbers = _numbers(options, start, trajectory, paths)
    files |= _picture(trajectory if paths is None else paths, start.log) | {"simulation.json": json_writer(numbers)}
    task.say(_text(numbers, task.write(files)), numbers)


def _start(options, model, engine) -> Start:
    if (options.flight is None) == (options.trim is None):
        raise ValueError("Got both or none of --flight and --trim, but expected one of them to start from.")
    only = {"flight": ("at", "servos", "airborne"), "trim": ("altitude", "climb", "turn_rate", "bank")}
    other = "trim" if options.trim is None else "flight"
    given = [f"--{name.replace('_', '-')}" for name in only[other] if getattr(options, name) is not None]
    if given:
        raise ValueError(f"Got {', '.join(given)} without --{other}, to which it belongs: leave it out.")
    return _trimmed(options, model, engine) if options.flight is None else _logged(options, model)


def _trimmed(options, model, engine) -> Start:
    climb = 0.0 if options.climb is None and engine is not None else options.climb  # a glider's follows
    found = trim(
        model.pipeline,
        model.aircraft,
        options.trim,
        altitude=options.altitude or 0.0,
        climb=climb,
        turn_rate=options.turn_rate,
        bank=options.bank,
        thrust=engine,
    )
    state = {name: getattr(found, name) for name in (*AIR, "phi", "theta", "altitude")}
    state |= dict(zip(("p", "q", "r"), found.rates, strict=True))  # by the air, which the wind carries along
    if options.controls is None:
        return Start(state, found.controls, options.wind, options.duration or DURATION)
    table = read_flight(options.controls)
    mixing = as_aerodynamics(model.pipeline).mixing
    mixed = mixing.controls if mixing is not None and set(mixing.surfaces) <= set(table) else ()
    held = {name: value for name, value in found.controls.items() if name not in (*table, *mixed)}
    return Start(state, table.assign(**held), options.wind, _duration(options, table))


def _logged(options, model) -> Start:
    """Start from a moment of a log, as the pipeline sees it: noise out, and the wind told where that can be known."""
    if options.at is None:
        raise ValueError("Got --flight without --at, but expected the moment to start from: --at SECONDS.")
    log = _around(options.at, read_named([options.flight], options))
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


def _around(at, flights) -> pd.DataFrame:
    """Return the flight that a moment lies in."""
    spans = {name: (table["time"].iloc[0], table["time"].iloc[-1]) for name, table in flights.items()}
    inside = [name for name, (first, last) in spans.items() if first <= at < last]
    if len(inside) != 1:
        said = ", ".join(f"{name} {first:g} to {last:g} s" for name, (first, last) in spans.items())
        raise ValueError(f"Got --at {at:g}, but expected a moment of exactly one flight of the log: {said}.")
    return checked({inside[0]: flights[inside[0]]})[inside[0]]


def _duration(options, *tables) -> float:
    lasts = min(np.ptp(table["time"].to_numpy(float)) for table in tables)
    return min(DURATION, lasts) if options.duration is None else options.duration


def _picture(trajectories, log) -> dict[str, Writer]:
    return picture_writers("trajectory.png", TrajectoryDisplay.from_trajectories, trajectories, log)


def _numbers(options, start, trajectory, paths) -> dict:
    """Return the summary as numbers, SI units and radians."""
    flying = trajectory[trajectory["ended"] == ""]
    first = trajectory.iloc[0]
    last = first if flying.empty else flying.iloc[-1]
    beyond = flying[flying["beyond"] != ""]
    ended = next((REASONS[why] for why in trajectory["ended"] if why), None)
    return {
        "model": options.model,
        "start": {name: first[name] for name in START},
        "controls": dict(start.controls) if isinstance(start.controls, dict) else None,
        "duration": start.duration,
        "flown": last["time"] - first["time"],
        "ended": ended,
        "beyond": None
        if beyond.empty
        else {
            "first": beyond["time"].iloc[0] - first["time"],
            "share": len(beyond) / len(flying),
            "regressors": sorted(set(beyond["beyond"])),
        },
        "end": {name: last[name] for name in START},
        "paths": None if paths is None else _spread(paths),
    }


def _spread(paths) -> dict:
    """Return how many of the paths ended early, and within what 95 % of the others are at the end."""
    by_path = paths.groupby("path")
    bands = trajectory_bands(paths, columns=START).iloc[-1]
    return {
        "n": by_path.ngroups,
        "ended_early": int(by_path["ended"].agg(lambda ended: (ended != "").any()).sum()),
        "beyond": int(by_path["beyond"].agg(lambda beyond: (beyond != "").any()).sum()),
        "end": {name: [bands[f"{name}_low"], bands[f"{name}_high"]] for name in START},
    }


def _text(numbers, files) -> str:
    lines = []
    if numbers["ended"] is None:
        lines.append(f"flown {numbers['flown']:.4g} s, to the end")
    else:
        lines.append(f"ended after {numbers['flown']:.4g} of {numbers['duration']:.4g} s: {numbers['ended']}")
    beyond, paths = numbers["beyond"], numbers["paths"]
    if beyond is None:
        lines.append("always within what the model was learned from")
    else:
        lines.append(
            f"beyond what the model was learned from in {100 * beyond['share']:.0f} % of the time, the first after "
            f"{beyond['first']:.4g} s: {', '.join(beyond['regressors'])}"
        )
    if paths is not None:
        lines.append(
            f"{paths['n']} functions of the posterior: {paths['ended_early']} ended early, {paths['beyond']} left what "
            "was learned from"
        )
    lines += ["", f"{'':<10}{'start':>10}{'end':>10}{'' if paths is None else '95 % of the paths':>24}"]
    for name in START:
        factor, unit = display_unit(name)
        row = f"{name:<10}{factor * numbers['start'][name]:>z10.2f}{factor * numbers['end'][name]:>z10.2f}"
        if paths is not None:
            low, high = (factor * edge for edge in paths["end"][name])
            row += f"{low:>z12.2f} to {high:<z8.2f}"
        lines.append(f"{row}  {unit}".rstrip())
    width = max(map(len, files)) + 2
    return "\n".join([*lines, "", *(f"{name:<{width}}{path}" for name, path in files.items())])
