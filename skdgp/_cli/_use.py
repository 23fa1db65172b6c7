"""Commands that use a model: predict, derivatives, plan, export."""

from __future__ import annotations

import shutil
import tempfile
from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._cli._shared import (
    AIRCRAFT,
    AIRSPEED,
    ALTITUDE,
    FLIGHT,
    FULL,
    LOG,
    MODEL,
    OUTPUT,
    PATHS,
    SEED,
    Commands,
    Run,
    axis_value,
    changed,
    number,
    option,
    reading,
    table_file,
)
from skdgp._compute.files import Writer, csv_writer, text_writer
from skdgp._compute.messages import can_draw, listening, report, warn
from skdgp._flight.excitation import AXES
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import FlightTable
from skdgp.design import RATE, Envelope, Plan, ardupilot_script, surface_mixes
from skdgp.design import plan as plan_flight
from skdgp.dynamics import (
    Aircraft,
    Trim,
    as_aerodynamics,
    linearize,
    stability_derivatives,
    trim,
)
from skdgp.export import FORMATS, export_model
from skdgp.identification import (
    FlightMechanics,
    FlightPipeline,
    check_identified,
    load_model,
    named_flights,
    usable_flights_of_model,
)


def read_model(options) -> Bunch:
    """Return the model that the options name, with its own aircraft or theirs; raise ValueError if it is of no use.

    Warns of surfaces that are not in radians.
    """
    model = load_model(options.model)
    check_identified(model.pipeline)
    if model.pipeline.control_units:
        warn(
            "Surfaces of this model are in parts of their full throw, -1 to 1, wherever radians "
            "are expected of them: in controls, limits, plans and exports."
        )
    if vars(options).get("aircraft") is not None:  # predict has no such option
        model.aircraft = Aircraft.from_file(options.aircraft)
    return model


def read_model_to_fly(options) -> Bunch:
    """Return the model and its ``thrust`` in motion, "auto" or None; warn of thrust and gusts of its flights."""
    model = read_model(options)
    model.thrust = model.get("options", {}).get("thrust", "auto")
    if model.thrust is None:
        warn(
            "No thrust was subtracted in this model: where an engine ran, CX holds its thrust, and CD "
            "is drag less thrust."
        )
    turbulence = model.pipeline.turbulence_
    gusts = 0.0 if turbulence is None else max(turbulence.intensity)
    # two thirds of light turbulence of MIL-F-8785C: derivatives by rates lose notably
    if gusts > 0.5:
        warn(
            f"The model was learned in gusts of {gusts:.1f} m/s, so its derivatives by rates are too "
            f"small: learn from flights in calmer air."
        )
    return model


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
    if output.resolve() in [Path(flight).resolve() for flight in options.flight]:
        raise FileExistsError(
            f"Got {options.output} as the output, but it is one of the flights: name another."
        )
    model = read_model(options)
    named = named_flights(options.flight, **reading(options, model))
    flights = usable_flights_of_model(model.pipeline, named, model.aircraft)
    parts = [_predictions(model.pipeline, flight, options) for flight in flights.values()]
    table = pd.concat(parts, ignore_index=True)
    rows = table.groupby("flight", sort=False).size().to_dict()
    lines = [f"{count} rows of flight {name}" for name, count in rows.items()]
    run.finish(lines, {"flights": rows}, {output.name: csv_writer(table)})


def _predictions(pipeline: FlightPipeline, flight: FlightTable, options: Namespace) -> pd.DataFrame:
    """Return the coefficients of a flight and their standard deviations, ``CX`` and ``CX_std``, beside its time."""
    mean, std = pipeline.predict(flight, return_std=True, include_noise=options.include_noise)
    table = flight.table[["flight", "time"]].reset_index(drop=True)
    names = pipeline[-1].output_names_
    table[names] = mean
    table[[f"{name}_std" for name in names]] = std
    return table


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation, whose parts are in derivatives.csv. With -o writes derivatives.csv,
    modes.csv and derivatives.json into DIR, all or none.

    For example:
      skdgp derivatives results/model.joblib --airspeed 35
      skdgp derivatives results/model.joblib --airspeed 30 35 40 -o sweep
    """
    options = run.options
    model = read_model_to_fly(options)
    airspeeds = sorted(set(options.airspeed))
    trims = [trimmed(model, airspeed, options.altitude) for airspeed in airspeeds]
    beyond = sorted({name for point in trims for name in point.beyond})
    if beyond:
        report(Finding(Code.TRIM_BEYOND, numbers={"names": beyond}))
    spread = {"n_paths": options.paths, "random_state": options.seed, "thrust": model.thrust}
    points = []
    for point in trims:
        derivatives = stability_derivatives(model.pipeline, model.aircraft, point, **spread)
        modes = linearize(model.pipeline, model.aircraft, point, **spread).modes()
        points.append(FlightMechanics(trim=point, derivatives=derivatives, modes=modes))
    numbers = {"points": points}
    texts = [_derivatives_text(point) for point in points]
    run.finish(["\n\n".join(texts), ""], numbers, _derivatives_files(points), "derivatives.json")


def _derivatives_files(points: Sequence[FlightMechanics]) -> dict[str, Writer]:
    """Return the writers of the tables of all trims."""
    derivatives = {}
    modes = {}
    for point in points:
        at: Any = point.trim
        derivatives[at.airspeed] = point.derivatives.assign(alpha=at.alpha, beta=at.beta)
        modes[at.airspeed] = point.modes
    tables = {
        "derivatives.csv": pd.concat(derivatives, names=["airspeed", "derivative"]),
        "modes.csv": pd.concat(modes, names=["airspeed", "mode"]),
    }
    return {name: csv_writer(table.reset_index()) for name, table in tables.items()}


def trimmed(model: Bunch, airspeed: float, altitude: float) -> Trim:
    """Return steady level flight; without a thrust the climb follows."""
    climb = None if model.thrust is None else 0.0
    given = {"altitude": altitude, "climb": climb, "thrust": model.thrust}
    return trim(model.pipeline, model.aircraft, airspeed, **given)


def _derivatives_text(mechanics: FlightMechanics) -> str:
    """Return trim, derivatives with their standard deviations, and modes."""
    point: Any = mechanics.trim
    modes: Any = mechanics.modes
    table = mechanics.derivatives.replace({"regressor": {"": "at trim"}})
    cells = table["value"].map("{:z.4f}".format)
    if "std" in table:
        cells += table["std"].map(" +- {:.2g}".format)
    wide = cells.set_axis([table["regressor"], table["coefficient"]]).unstack(sort=False)
    controls = "".join(f", {name} {value:.4g}" for name, value in point.controls.items())
    return "\n".join(
        [
            f"{point.airspeed:g} m/s at {point.altitude:.4g} m, in air of {point.density:.4g} kg/m^3: "
            f"alpha {np.rad2deg(point.alpha):.3g} deg{controls}",
            "values, +- one standard deviation",
            "",
            wide.rename_axis(index=None, columns=None).to_string(),
            "",
            "modes, in rad/s and s",
            _table(modes.drop(columns="eigenvalue")),
        ]
    )


def plan(run: Run) -> None:
    """Choose the manoeuvres of the next flight: those that lower the errors of a goal most in the given time.

    Doublets, 3-2-1-1s and multisines are simulated from a trim of the model in calm air. Each is made
    smaller or left out if its response leaves the limits. These are the range of the training flights,
    with --growth, unless given (others in Python, skdgp.design.Envelope). The controls are open loop
    during a manoeuvre; return to the trim in the pause after it.

    Writes into DIR, all or none, and removes a script there that an earlier plan wrote:
      plan.csv       time [s] and deviations from trim of the axes [rad, throttle 0 to 1], at 50 Hz
      plan.lua       a script for ArduPilot; with --full, the deflections at the ends of the servos' ranges
      plan.svg       the controls and the expected responses; needs matplotlib
      expected.csv   the flight that the model expects, manoeuvre by manoeuvre
      plan.json      trim, manoeuvres, limits, standard deviations before and expected

    For example:
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron rudder -o next
      skdgp plan results/model.joblib --airspeed 30 --seconds 120 --axes elevator --goal Cm_q -o pitch
      skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes rudder --full rudder=0.4 -o yaw
    """
    options = run.options
    axes = list(dict.fromkeys(options.axes))
    full = dict(options.full)
    if full:  # the search takes long
        surface_mixes([axis for axis in axes if axis != "throttle"], full)
    envelope = Envelope(bank=options.max_bank, altitude=options.floor, growth=float(options.growth))
    model = read_model_to_fly(options)
    altitude = options.altitude
    if altitude is None:  # the highest of the training flights
        flown = as_aerodynamics(model.pipeline).flown
        _, altitude = flown.get("altitude", (0.0, 100.0))
    with listening(run.console.progress):
        planned = plan_flight(
            model.pipeline,
            model.aircraft,
            trimmed(model, options.airspeed, altitude),
            seconds=options.seconds,
            axes=axes,
            goal=options.goal,
            limits=dict(options.limits),
            envelope=envelope,
            thrust=model.thrust,
        )
    numbers = {"seconds": planned.seconds, **planned.to_dict()}
    writers = _plan_writers(planned, full)
    folder = Path(options.output)
    was_planned = (folder / "plan.json").is_file()
    run.finish(_plan_lines(planned, full), numbers, writers, "plan.json")
    if was_planned and "plan.lua" not in writers:  # a script of another plan
        (folder / "plan.lua").unlink(missing_ok=True)


def _plan_writers(planned: Plan, full: dict[str, float]) -> dict[str, Writer]:
    """Return the writers of the files of a plan, with a script where there are full deflections."""
    writers: dict[str, Writer] = {
        "plan.csv": csv_writer(planned.train.table(RATE)),
        "expected.csv": csv_writer(planned.flight),
    }
    if can_draw():
        writers["plan.svg"] = lambda path: planned.plot().figure_.savefig(
            path, format="svg", dpi=150
        )
    if full:
        try:
            script = ardupilot_script(planned.train, RATE, full)
            writers["plan.lua"] = text_writer(script)
        except ValueError as error:  # the plan is kept
            warn(f"No script for ArduPilot: {error}")
    return writers


def _plan_lines(planned: Plan, full: dict[str, float]) -> list[str]:
    """Return manoeuvres and standard deviations as tables."""
    manoeuvres = planned.manoeuvres[["start", "name", "scale"]]
    limits = planned.limits.rename_axis("limit")
    lines = []
    for table in (manoeuvres, planned.errors, limits):
        lines += [_table(table), ""]
    if np.isinf(planned.limits).all(axis=None):
        lines.append("no limits, not even a floor: set them by --growth, --max-bank, --floor ...")
    if not full:
        lines.append("no script for ArduPilot: --full gives the full deflections that it needs")
    return lines


def _table(table: pd.DataFrame) -> str:
    return table.to_string(float_format="{:.3g}".format)


def warn_unfit(model: Mapping[str, Any], purpose: str, advice: str) -> None:
    """Warn if the verdict on a model says no to a purpose."""
    if model.get("uses", {}).get(purpose) == "no":
        warn(f'The report of this model says no to "{purpose}". {advice}')


def export(run: Run) -> None:
    """Write a model in a form that other programs read, without Python or without pickle.

    portable  model.npz: arrays and JSON, no code; examples/read_portable.py reads it with NumPy alone
    c         aero.h, aero.c: mean, deviation, slopes and limits in C99; "make test" compares them with the model
    jsbsim    aircraft/NAME/NAME.xml: an aircraft that flies the mean; --full gives its full deflections
    casadi    aero.casadi: mean, deviation and Jacobian as a Function, aero_mean.casadi: the mean alone; needs CasADi

    All files are written into DIR, or none.

    For example:
      skdgp export results/model.joblib --to portable -o portable
      skdgp export results/model.joblib --to c -o flight_code
      skdgp export results/model.joblib --to jsbsim --full elevator=0.42 aileron=0.42 rudder=0.35 -o jsbsim
    """
    options = run.options
    model = read_model(options)
    warn_unfit(model, "simulate", "Use the export to predict coefficients, not in a simulator.")
    full = dict(options.full)
    writers: dict[str, Writer] = {}
    sizes = {}
    with tempfile.TemporaryDirectory() as temporary:
        for file in export_model(temporary, model, options.to, full=full):
            name = str(Path(file).relative_to(temporary))
            writers[name] = partial(shutil.copyfile, file)
            sizes[name] = Path(file).stat().st_size
        numbers = {"files": sizes}
        lines = [f"{size / 1024:>9.1f} kB  {name}" for name, size in sizes.items()]
        run.finish(lines, numbers, writers)


COMMANDS: Commands = {
    predict: {
        "": [
            MODEL,
            FLIGHT,
            *LOG,
            option(
                "--include-noise",
                action="store_true",
                help="standard deviations of new measurements, not of the coefficients themselves",
            ),
            changed(OUTPUT, metavar="FILE", type=table_file, required=True, help="the table, .csv"),
        ],
    },
    derivatives: {
        "": [
            MODEL,
            AIRCRAFT,
            ALTITUDE,
            SEED,
            OUTPUT,
            changed(AIRSPEED, nargs="+", help="of the trims [m/s]"),
            changed(PATHS, help="of the posterior; 0: no standard deviations (default: 200)"),
        ],
    },
    plan: {
        "": [
            MODEL,
            AIRCRAFT,
            changed(OUTPUT, required=True),
            AIRSPEED,
            option(
                "--seconds",
                type=number("> 0"),
                required=True,
                help="of all flights together",
            ),
            option("--axes", choices=AXES, nargs="+", required=True, help="controls to move"),
            option(
                "--goal",
                nargs="+",
                help="derivatives such as Cm_q Cn_rudder (default: all)",
            ),
            changed(ALTITUDE, default=None, help="[m] (default: the highest that was flown)"),
            changed(
                FULL, help="deflections [rad] at the ends of the servos' ranges, for the script"
            ),
        ],
        "limits": [
            option(
                "--limits",
                metavar="AXIS=X",
                type=axis_value,
                nargs="+",
                default=[],
                help="largest deviations from trim [rad] (default: as flown)",
            ),
            option("--max-bank", type=number("> 0"), help="to either side"),
            option(
                "--floor",
                type=number(),
                help="lowest altitude [m] (default: the lowest that was flown)",
            ),
            option(
                "--growth",
                type=number(">= 0", "inf"),
                default=0.2,
                help="part of its range by which a quantity may leave its range in training; inf: no "
                "limit (default: 0.2)",
            ),
        ],
    },
    export: {
        "": [
            MODEL,
            AIRCRAFT,
            changed(OUTPUT, required=True),
            option("--to", choices=list(FORMATS), required=True, help="the format"),
            changed(
                FULL,
                help="of jsbsim: deflections [rad] at a command of 1 (default: of the aircraft "
                "file, else the largest that were flown), thrust [N] without a propeller",
            ),
        ],
    },
}
