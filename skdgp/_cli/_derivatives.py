"""The command ``derivatives``: trims, stability derivatives and modes over airspeed, with standard deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, picture_writers
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import Writer, csv_writer
from skdgp._compute.messages import warn
from skdgp.dynamics import Trim, linearize, stability_derivatives, trim
from skdgp.plotting import DerivativeDisplay

WIDTH = 11  # of a column


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation, whose parts are in derivatives.csv. With -o writes derivatives.csv,
    modes.csv, trims.csv, derivatives.json and, of several airspeeds, a picture derivatives.png into
    DIR, all or none.

    For example:
      skdgp derivatives results/model.joblib --airspeed 35
      skdgp derivatives results/model.joblib --airspeed 30 35 40 --axes stability -o sweep
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
    table = stability_derivatives(
        model.pipeline, model.aircraft, trims, axes=options.axes, **spread
    )
    run.console.stage("modes")
    modes = [_modes(linearize(model.pipeline, model.aircraft, point, **spread)) for point in trims]
    points: list[Any] = [(point, table.loc[k], modes[k]) for k, point in enumerate(trims)]
    numbers = {name: getattr(options, name) for name in ("model", "axes", "altitude")}
    numbers["points"] = [_point(*point) for point in points]
    blocks = [_text(*point) for point in points]
    if run.folder is not None:
        files = _writers(trims, table, modes)
        written = run.write_record("derivatives.json", numbers, files, r"derivatives\.png")
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
        warn(
            f"Trims are beyond what the model was learned from: {', '.join(beyond)}.", stacklevel=3
        )


def _modes(linear: Any) -> pd.DataFrame:
    """Return the modes with the two parts of their eigenvalues."""
    modes = linear.modes()
    parts = {"real": np.real(modes["eigenvalue"]), "imaginary": np.imag(modes["eigenvalue"])}
    return modes.drop(columns="eigenvalue").assign(**parts)


def _point(point: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> dict:
    """Return the numbers of one airspeed."""
    names = ("airspeed", "climb", "alpha", "beta", "phi", "theta", "controls")
    columns = table.columns.intersection(["value", "std", "lower", "upper", "std_unmerged"])
    return {name: getattr(point, name) for name in names} | {
        "beyond": {name: list(values) for name, values in point.beyond.items()},
        "derivatives": table[columns].to_dict("index"),
        "modes": modes.to_dict("index"),
    }


def _writers(trims: list[Trim], table: pd.DataFrame, modes: list) -> dict[str, Writer]:
    airspeeds = [point.airspeed for point in trims]
    named = pd.concat(modes, keys=airspeeds, names=["airspeed", "mode"])
    files = {
        "derivatives.csv": csv_writer(table.reset_index(names=["point", "derivative"])),
        "modes.csv": csv_writer(named.reset_index()),
        "trims.csv": csv_writer(pd.concat([point.to_frame() for point in trims])),
    }
    if len(trims) == 1:
        return files
    return files | picture_writers("derivatives.png", DerivativeDisplay.from_sweep, table)


def _text(point: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> str:
    """Return trim, derivatives over their standard deviations, and modes."""
    controls = ", ".join(f"{name} {value:.4g}" for name, value in point.controls.items())
    lines = [f"{point.airspeed:g} m/s: alpha {np.rad2deg(point.alpha):.3g} deg, {controls}"]
    lines += ["values, +- one standard deviation"] * ("std" in table) + [""]
    regressors = table["regressor"].unique()
    lines.append(f"{'':4}" + "".join(f"{name or 'at trim':>{WIDTH}}" for name in regressors))
    for name, rows in table.groupby("coefficient", sort=False):
        row = rows.set_index("regressor").loc[regressors]
        lines.append(f"{name:4}" + "".join(f"{value:>z{WIDTH}.4f}" for value in row["value"]))
        if "std" in row:
            lines.append(" " * 4 + "".join(f"{f'+- {std:.2g}':>{WIDTH}}" for std in row["std"]))
    lines += ["", f"{'':14}{'frequency':>25}{'damping':>15}{'time constant':>15}"]
    for motion, mode in modes.iterrows():
        frequency = f"{mode['frequency']:.3g}{_deviation(mode, 'frequency_std', '.2g')} rad/s"
        damping = f"{mode['damping']:.2f}{_deviation(mode, 'damping_std', '.2f')}"
        lines.append(f"{motion:14}{frequency:>25}{damping:>15}{mode['time_constant']:>13.3g} s")
    return "\n".join(lines)


def _deviation(row: pd.Series, name: str, form: str) -> str:
    return f" +- {row[name]:{form}}" if name in row else ""


COMMANDS: opt.Commands = {
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
            "--axes": {
                "choices": ["body", "stability"],
                "default": "body",
                "help": "of forces, moments and rates (default: body)",
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
