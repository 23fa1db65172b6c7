"""The command ``derivatives``: trims, stability derivatives and modes over airspeed, with standard deviations."""

from __future__ import annotations

import warnings
from textwrap import wrap
from typing import Any, cast

import numpy as np
import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run, picture_writers, table_writer
from skdgp._cli._predict import read_model_to_fly
from skdgp._compute.files import Writer, json_text, text_writer
from skdgp.dynamics import Trim, linearize, stability_derivatives, trim
from skdgp.plotting import DerivativeDisplay

DEGREE = np.pi / 180
COLUMN, WIDTH = 11, 110
NOTABLE = 0.9
"""Part of a deviation that is left without what is merged, from which on it is not worth a word."""


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation, whose parts are in derivatives.csv. With -o writes derivatives.csv,
    modes.csv, trims.csv, derivatives.json, config.toml and, of several airspeeds, a picture
    derivatives.png into DIR, all or none.

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
    trims = cast(
        list[Trim],
        trim(model.pipeline, model.aircraft, sorted(set(options.airspeed)), **conditions),
    )
    for one in trims:
        if one.beyond:
            names = [
                f"{name} {value:.3g} ({low:.3g} to {high:.3g})"
                for name, (value, low, high) in one.beyond.items()
            ]
            warnings.warn(
                f"The trim at {one.airspeed:g} m/s is beyond what the model was learned from: "
                f"{', '.join(names)}.",
                stacklevel=2,
            )
    run.console.stage("derivatives")
    spread = {"n_paths": options.paths, "random_state": options.seed, "thrust": thrust}
    table = stability_derivatives(
        model.pipeline, model.aircraft, trims, axes=options.axes, **spread
    )
    run.console.stage("modes")
    modes = [linearize(model.pipeline, model.aircraft, point, **spread).modes() for point in trims]
    points: list[Any] = [
        (one, table.loc[number], modes[number]) for number, one in enumerate(trims)
    ]
    numbers = {name: getattr(options, name) for name in ("model", "axes", "altitude")}
    numbers["points"] = [_point(*point) for point in points]
    blocks = [_text(*point) for point in points]
    if written := run.write(_writers(trims, table, modes, numbers)):
        blocks.append("wrote " + ", ".join(map(str, written)))
    run.print("\n\n".join(blocks), numbers)


def _point(one: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> dict:
    """Return the numbers of one airspeed."""
    numbers = ["value", "std", "lower", "upper", "std_unmerged"]
    return {
        **{
            name: getattr(one, name)
            for name in ("airspeed", "climb", "alpha", "beta", "phi", "theta", "controls")
        },
        "beyond": {name: list(values) for name, values in one.beyond.items()},
        "derivatives": table[[name for name in numbers if name in table]].to_dict("index"),
        "modes": _real(modes).to_dict("index"),
    }


def _real(modes: pd.DataFrame) -> pd.DataFrame:
    """Return the modes with the two parts of their eigenvalues."""
    parts = {"real": np.real(modes["eigenvalue"]), "imaginary": np.imag(modes["eigenvalue"])}
    return modes.drop(columns="eigenvalue").assign(**parts)


def _writers(trims, table, modes, numbers) -> dict[str, Writer]:
    named = pd.concat(
        [_real(one) for one in modes],
        keys=[one.airspeed for one in trims],
        names=["airspeed", "mode"],
    )
    files = {
        "derivatives.csv": table_writer(table.reset_index(names=["point", "derivative"]), ".csv"),
        "modes.csv": table_writer(named.reset_index(), ".csv"),
        "trims.csv": table_writer(pd.concat([one.to_frame() for one in trims]), ".csv"),
        "derivatives.json": text_writer(json_text(numbers)),
    }
    return files | (
        picture_writers("derivatives.png", DerivativeDisplay.from_sweep, table)
        if len(trims) > 1
        else {}
    )


def _text(one: Trim, table: pd.DataFrame, modes: pd.DataFrame) -> str:
    controls = ", ".join(f"{name} {value:.4g}" for name, value in one.controls.items())
    head = f"{one.airspeed:g} m/s: alpha {one.alpha / DEGREE:.3g} deg, {controls}"
    if "std" in table:
        head += "\nvalues, +- one standard deviation"
    return "\n".join([head, "", *_matrix(table), "", *_mode_rows(modes)])


def _matrix(table: pd.DataFrame) -> list[str]:
    """Return coefficients by regressors; under each value its standard deviation, where it is known."""
    regressors = table["regressor"].unique()
    lines = [f"{'':4}" + "".join(f"{name or 'at trim':>{COLUMN}}" for name in regressors)]
    for name, rows in table.groupby("coefficient", sort=False):
        row = rows.set_index("regressor").loc[regressors]
        lines.append(f"{name:4}" + "".join(f"{number:>z{COLUMN}.4f}" for number in row["value"]))
        if "std" in row:
            lines.append(
                f"{'':4}"
                + "".join(f"{'+- ' + format(number, '.2g'):>{COLUMN}}" for number in row["std"])
            )
    if "std_merged" in table:
        held = table[table["std_unmerged"] < NOTABLE * table["std"]]
        named = [
            f"{name} {row['std_unmerged']:.2g} (without {row['merged']})"
            for name, row in held.iterrows()
        ]
        lines += [
            "",
            *wrap(f"std_unmerged: {', '.join(named) or 'the same'}", WIDTH),
        ]
    if "std_aircraft" in table:
        sizes = table["value"].abs()
        known = table[(table["regressor"] != "") & (sizes > 2 * table.get("std", 0.0))]
        parts = (known["std_aircraft"] / sizes[known.index]).groupby(known["coefficient"])
        largest = [(name, parts.get_group(key)[name]) for key, name in parts.idxmax().items()]
        words = [
            f"{name} {100 * part:.2g} % ({table.loc[name, 'aircraft']})" for name, part in largest
        ]
        sentence = (
            "std_aircraft, errors of the aircraft that derivatives share, the largest of each"
        )
        lines += ["", *wrap(f"{sentence} coefficient: {', '.join(words) or 'none'}", WIDTH)]
    return lines


def _mode_rows(modes: pd.DataFrame) -> list[str]:
    lines = [f"{'':14}{'frequency':>25}{'damping':>15}{'time constant':>15}"]
    for name, row in _real(modes).iterrows():
        frequency, damping = f"{row['frequency']:.3g}", f"{row['damping']:.2f}"
        if "frequency_std" in modes:
            frequency, damping = (
                f"{frequency} +- {row['frequency_std']:.2g}",
                f"{damping} +- {row['damping_std']:.2f}",
            )
        lines.append(
            f"{name:14}{frequency + ' rad/s':>25}{damping:>15}{row['time_constant']:>13.3g} s"
        )
    return lines


DERIVATIVES = opt.Command(
    derivatives,
    {
        "": [
            *(opt.MODEL, opt.AIRCRAFT, opt.SEED, opt.OPTIONAL_FOLDER),
            opt.option(
                "--airspeed V", "of the trims [m/s]", opt.positive("m/s"), nargs="+", required=True
            ),
            opt.option("--altitude M", "of the trims [m] (default: 0)", opt.number(), default=0.0),
            opt.choice(
                "--axes", ["body", "stability"], "of forces, moments and rates (default: body)"
            ),
            opt.paths(200, "for the standard deviations; 0: none"),
        ]
    },
    outputs=r"derivatives\.png",
)
