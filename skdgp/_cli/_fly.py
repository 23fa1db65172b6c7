"""Commands that use a model: predict, simulate, derivatives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._cli import _options as opt
from skdgp._cli._output import Run
from skdgp._compute.files import Writer, csv_writer
from skdgp._compute.messages import warn, without_warnings
from skdgp._flight.channels import (
    AIR_DATA,
    EULER,
    RATES,
)
from skdgp._flight.checks import check_names
from skdgp.design import doublet
from skdgp.dynamics import (
    REASONS,
    Air,
    Aircraft,
    SimulationWarning,
    Trim,
    linearize,
    stability_derivatives,
    trajectory_bands,
    trim,
)
from skdgp.dynamics import simulate as simulate_flight
from skdgp.identification import (
    check_identified,
    load_model,
    named_flights,
    predict_flight,
    usable_flights_of_model,
)

# Intensity [m/s] from which derivatives by rates lose notably: two thirds of light turbulence of
# MIL-F-8785C
NOTABLE_GUSTS = 0.5
DURATION = 10.0
# Start and length of the pulses of a doublet [s], about a quarter of a period of 1.5 rad/s; a guess
PULSE = 1.0
START = (*AIR_DATA, *EULER, *RATES, "altitude")


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
    learned = model.get("options", {})
    if learned.get("external_forces"):
        warn(
            f"The simulation flies without the external forces {learned['external_forces']} of "
            f"the flights that the "
            "model was learned from.",
            stacklevel=2,
        )
    turbulence = getattr(model.pipeline, "turbulence_", None)
    if turbulence is not None and max(turbulence.intensity) > NOTABLE_GUSTS:
        warn(
            f"The model was learned in gusts of {max(turbulence.intensity):.1f} m/s, so its "
            f"derivatives by rates are too small: learn from flights in calmer air to simulate or "
            f"to linearise.",
            stacklevel=2,
        )
    return model, None if learned.get("thrust", "auto") in (None, "none") else "auto"


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
    table = pd.concat(
        [
            _predictions(model.pipeline, flight, options.include_noise)
            for flight in flights.values()
        ],
        ignore_index=True,
    )
    run.write({output.name: csv_writer(table)})
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
    values = np.hstack(predict_flight(pipeline, flight, include_noise=include_noise))
    table = pd.DataFrame(values, columns=columns)
    return flight[["flight", "time"]].reset_index(drop=True).join(table)


def simulate(run: Run) -> None:
    """Fly a model from a trim with its controls held.

    The mean of the model is flown, and functions drawn from its posterior, each an aircraft that
    the data allow: the band of 95 % of the paths shows how certain the trajectory is.
    --doublet AXIS=X moves a control by X about its trim, +X from 1 to 2 s and -X from 2 to 3 s.
    Any other inputs, or the controls of a log: skdgp.dynamics.simulate. How well flights are
    followed: skdgp validate. Pictures: skdgp.plotting.TimeHistoryDisplay.from_trajectories.

    The mean flies in still air, unless --wind says otherwise. The drawn functions also meet gusts,
    as strong as in the training flights. --gusts none: none.

    Writes into DIR, all or none:
      trajectory.csv    a flight table of the mean; "beyond" names a regressor outside of the training data,
                        "ended" says why a trajectory is over
      bands.csv         median, 2.5 % and 97.5 % of the paths over time
      simulation.json   the command, start, end, when it ended or left the training data

    For example:
      skdgp simulate results/model.joblib --trim 35 --altitude 200 --bank 0.5 -o turn
      skdgp simulate results/model.joblib --trim 35 --doublet elevator=0.03 --paths 100 -o doublet
    """
    options = run.options
    run.console.stage("reading")
    model, thrust = read_model_to_fly(options)
    steady, controls = _trimmed(options, model, thrust)
    run.console.stage("simulating")
    initial = (model.pipeline, model.aircraft, _state(steady), controls, options.dt)
    conditions: dict[str, Any] = {"duration": options.duration, "thrust": thrust}
    trajectory = simulate_flight(*initial, **conditions, air=Air(options.wind))
    sampled = None
    files = {"trajectory.csv": csv_writer(trajectory)}
    if options.paths:
        run.console.stage(f"simulating {options.paths} functions of the posterior")
        with without_warnings(SimulationWarning):  # the summary counts them
            sampled = simulate_flight(
                *initial,
                **conditions,
                air=Air(options.wind, gusts=opt.none_of(options.gusts)),
                n_paths=options.paths,
                random_state=options.seed,
            )
        files["bands.csv"] = csv_writer(trajectory_bands(sampled).drop(columns="start"))
    numbers = _numbers(options, steady, trajectory, sampled)
    written = run.write(files, "simulation.json", numbers, r"bands\.csv")
    run.print(_simulation_text(numbers, written), numbers)


def _trimmed(options, model, thrust) -> tuple[Trim, pd.DataFrame]:
    """Return the trim, and its controls over time with doublets about them."""
    climb = options.climb
    if thrust is not None and climb is None:  # without thrust it follows
        climb = 0.0
    steady: Any = trim(
        model.pipeline,
        model.aircraft,
        options.trim,
        climb=climb,
        bank=options.bank,
        altitude=options.altitude,
        thrust=thrust,
    )
    time = np.arange(0.0, options.duration + options.dt, options.dt)
    pulses = {axis: doublet(PULSE, size)(time - PULSE) for axis, size in options.doublet}
    check_names(pulses, steady.controls, "trim's controls")
    controls = {name: value + pulses.get(name, 0.0) for name, value in steady.controls.items()}
    return steady, pd.DataFrame({"time": time} | controls)


def _state(steady: Trim) -> dict[str, float]:
    """Return the state of a trim, with rates by the air, which the wind carries along."""
    names = (*AIR_DATA, "phi", "theta", "altitude")
    rates = dict(zip(RATES, steady.rates, strict=True))
    return {name: getattr(steady, name) for name in names} | rates


def _numbers(options, steady, trajectory, paths) -> dict:
    """Return the summary as numbers, SI units and radians."""
    flying = trajectory[trajectory["ended"] == ""]
    first, last = trajectory.iloc[0], pd.concat([trajectory[:1], flying]).iloc[-1]
    outside = flying[flying["beyond"] != ""]
    beyond = {
        "first": outside["time"].min() - first["time"],
        "fraction": len(outside) / max(len(flying), 1),
        "regressors": sorted(set(outside["beyond"])),
    }
    return {
        "model": options.model,
        "start": {name: first[name] for name in START},
        "trim": steady.controls | {"thrust": steady.thrust},
        "duration": options.duration,
        "flown": last["time"] - first["time"],
        "ended": next((REASONS[why] for why in trajectory["ended"] if why), None),
        "beyond": beyond if len(outside) else None,
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


def _simulation_text(numbers, files) -> str:
    """Return duration, end and files of a simulation as text."""
    beyond, paths = numbers["beyond"], numbers["paths"]
    seconds = f"{numbers['flown']:.4g}"
    lines = [f"flown {seconds} s, to the end"]
    if numbers["ended"] is not None:
        lines = [f"ended after {seconds} of {numbers['duration']:.4g} s: {numbers['ended']}"]
    lines.append(
        "always within the training data"
        if beyond is None
        else f"beyond the training data in {100 * beyond['fraction']:.0f} % of the time, the first "
        f"after {beyond['first']:.4g} s: {', '.join(beyond['regressors'])}"
    )
    if paths is not None:
        counts = f"{paths['ended_early']} ended early, {paths['beyond']} left the training data"
        lines += [f"{paths['n']} functions of the posterior: {counts}", paths["air"]]
    return "\n".join([*lines, "", *map(str, files)])


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation, whose parts are in derivatives.csv. With -o writes derivatives.csv,
    modes.csv, trims.csv and derivatives.json into DIR, all or none.

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
    table = stability_derivatives(model.pipeline, model.aircraft, trims, **spread)
    run.console.stage("modes")
    modes = [_modes(linearize(model.pipeline, model.aircraft, point, **spread)) for point in trims]
    points: list[Any] = [(point, table.loc[k], modes[k]) for k, point in enumerate(trims)]
    numbers = {name: getattr(options, name) for name in ("model", "altitude")}
    numbers["points"] = [_point(*point) for point in points]
    blocks = [_derivatives_text(*point) for point in points]
    if run.folder is not None:
        written = run.write(_writers(trims, table, modes), "derivatives.json", numbers)
        blocks.append("wrote " + ", ".join(map(str, written)))
    run.print("\n\n".join(blocks), numbers)


def _warn_beyond(trims: list[Trim]) -> None:
    """Warn of trims whose regressors are outside the range of the training data."""
    beyond = [
        f"{point.airspeed:g} m/s: {name} {value:.3g} ({low:.3g} to {high:.3g})"
        for point in trims
        for name, (value, low, high) in point.beyond.items()
    ]
    if beyond:
        warn(f"Trims are beyond the training data: {', '.join(beyond)}.", stacklevel=3)


def _modes(linear: Any) -> pd.DataFrame:
    """Return the modes with the two parts of their eigenvalues."""
    modes = linear.modes()
    parts = {"real": np.real(modes["eigenvalue"]), "imaginary": np.imag(modes["eigenvalue"])}
    return modes.drop(columns="eigenvalue").assign(**parts)


def _point(point: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> dict:
    """Return the numbers of one airspeed."""
    names = ("airspeed", "climb", "alpha", "beta", "phi", "theta", "controls")
    columns = table.columns.intersection(["value", "std", "lower", "upper", "std_merged"])
    return {name: getattr(point, name) for name in names} | {
        "beyond": {name: list(values) for name, values in point.beyond.items()},
        "derivatives": table[columns].to_dict("index"),
        "modes": modes.to_dict("index"),
    }


def _writers(trims: list[Trim], table: pd.DataFrame, modes: list) -> dict[str, Writer]:
    airspeeds = [point.airspeed for point in trims]
    named = pd.concat(modes, keys=airspeeds, names=["airspeed", "mode"])
    return {
        "derivatives.csv": csv_writer(table.reset_index(names=["point", "derivative"])),
        "modes.csv": csv_writer(named.reset_index()),
        "trims.csv": csv_writer(pd.concat([point.to_frame() for point in trims])),
    }


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
            modes.drop(columns=["real", "imaginary"]).to_string(float_format="{:.3g}".format),
        ]
    )


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
                "help": "velocity of the air [m/s], north, east, down (default: 0 0 0)",
            },
            "--gusts": opt.SHARED["--gusts"]
            | {"help": "that the drawn functions meet (default: auto)"},
            "--duration": {
                "metavar": "S",
                "type": opt.positive("seconds"),
                "default": DURATION,
                "help": "how long [s] (default: 10)",
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
            "--trim": {
                "metavar": "V",
                "type": opt.positive("m/s"),
                "required": True,
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
                "default": 0.0,
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
}
