"""Commands that use a model: predict, derivatives, plan, export, and margins and fly for control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._cli._options import Commands, reading
from skdgp._cli._shared import Run
from skdgp._compute.files import Writer, csv_writer, text_writer
from skdgp._compute.messages import can_draw, listening, report, warn
from skdgp._flight.findings import Code, Finding
from skdgp.control import (
    Loop,
    autopilot_loops,
    full_outputs,
    read_parameters,
    suggest_gains,
)
from skdgp.control import fly as fly_model
from skdgp.control import margins as margins_of
from skdgp.design import RATE, Envelope, Plan, ardupilot_script, surface_mixes
from skdgp.design import plan as plan_flight
from skdgp.dynamics import (
    Aircraft,
    Trim,
    Turbulence,
    as_aerodynamics,
    linearize,
    stability_derivatives,
    trim,
)
from skdgp.export import export_model, portable_model
from skdgp.identification import (
    FlightMechanics,
    check_identified,
    load_model,
    named_flights,
    usable_flights_of_model,
)
from skdgp.plotting import units_shown
from skdgp.report import derivative_table, mode_table, steady_flight

# Gusts [m/s] above which derivatives by rates lose notably: two thirds of light turbulence of MIL-F-8785C
CALM_GUSTS = 0.5
# Least height of gusts [m], which vanish at the ground
LEAST_GUST_HEIGHT = 100.0


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
    """Return the model, as of `read_model`; warn of thrust and gusts of its flights."""
    model = read_model(options)
    if model.pipeline.thrust is None:
        warn(
            "No thrust was subtracted in this model: where an engine ran, CX holds its thrust, and CD "
            "is drag less thrust."
        )
    turbulence = model.pipeline.turbulence_
    gusts = 0.0 if turbulence is None else max(turbulence.intensity)
    if gusts > CALM_GUSTS:
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
    names = model.pipeline[-1].output_names_
    columns = [*names, *(f"{name}_std" for name in names)]
    parts = []
    rows = {}
    for name, flight in flights.items():
        mean, std = model.pipeline.predict(
            flight, return_std=True, include_noise=options.include_noise
        )
        clock = flight.table[["flight", "time"]].reset_index(drop=True)
        parts.append(clock.join(pd.DataFrame(np.hstack([mean, std]), columns=columns)))
        rows[name] = len(mean)
    lines = [f"{n} rows of flight {name}" for name, n in rows.items()]
    table = csv_writer(pd.concat(parts, ignore_index=True))
    run.finish(lines, {"flights": rows}, {output.name: table})


def derivatives(run: Run) -> None:
    """Print stability and control derivatives and modes of the model, in level flight at each airspeed.

    CL_alpha, Cm_q, Cn_rudder ..., rates non-dimensional: pb/2V, qc/2V, rb/2V; each with its
    standard deviation. All, and the parts of their deviations, are in derivatives.csv. With -o writes derivatives.csv,
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
        report(Finding(Code.TRIM_BEYOND, names=beyond))
    spread = {"n_paths": options.paths, "thrust": model.pipeline.thrust}
    points = []
    for at in trims:
        table = stability_derivatives(model.pipeline, model.aircraft, at, **spread)
        modes = linearize(model.pipeline, model.aircraft, at, **spread).modes()
        points.append(FlightMechanics(trim=at, derivatives=table, modes=modes))
    slopes = [
        point.derivatives.assign(alpha=at.alpha, beta=at.beta)
        for at, point in zip(trims, points, strict=True)
    ]
    files = {
        "derivatives.csv": csv_writer(_joined(airspeeds, slopes, "derivative")),
        "modes.csv": csv_writer(_joined(airspeeds, [point.modes for point in points], "mode")),
    }
    with units_shown(model.pipeline.control_units or {}):
        text = "\n\n".join(map(_derivatives_text, points))
    units = "frequency in rad/s, time constant in s"
    lines = [text, "", f"{units}; ± one standard deviation; ▼: the 95 % band holds both signs", ""]
    run.finish(lines, {"points": points}, files, "derivatives.json")


def _joined(airspeeds: list[float], tables: list[Any], name: str) -> pd.DataFrame:
    """Return the tables of all airspeeds in one."""
    return pd.concat(tables, keys=airspeeds, names=["airspeed", name]).reset_index()


def trimmed(model: Bunch, airspeed: float, altitude: float) -> Trim:
    """Return steady level flight; without a thrust the climb follows."""
    thrust = model.pipeline.thrust
    climb = None if thrust is None else 0.0
    given = {"altitude": altitude, "climb": climb, "thrust": thrust}
    return trim(model.pipeline, model.aircraft, airspeed, **given)


def _derivatives_text(mechanics: Any) -> str:
    """Return trim, derivatives and modes as the report shows them."""
    tables = [
        pd.DataFrame({"": steady_flight(mechanics.trim)}),
        derivative_table(mechanics.derivatives),
        mode_table(mechanics.modes),
    ]
    return "\n\n".join(table.to_string(na_rep="") for table in tables)


def plan(run: Run) -> None:
    """Choose the manoeuvres of the next flight: those that lower the errors of a goal most in the given time.

    Doublets, 3-2-1-1s and multisines are simulated from a trim of the model in calm air. Each is made
    smaller or left out if its response leaves the limits, the range of the training flights with
    --growth (others in Python, skdgp.design.Envelope). The controls are open loop
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
            envelope=Envelope(growth=options.growth),
            thrust=model.pipeline.thrust,
        )
    numbers = {
        "aircraft": model.aircraft.name,
        "seconds": planned.seconds,
        "trim": planned.trim,
        "manoeuvres": planned.manoeuvres.to_dict("records"),
        "limits": planned.limits,
        "errors": planned.errors,
    }
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
    lines = [_table(manoeuvres), "", _table(planned.errors), "", _table(limits), ""]
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
    jsbsim    aircraft/NAME/NAME.xml: an aircraft that flies the mean; --full gives deflections at a command of 1
              (by default of the aircraft file; 1 of controls in parts of their full throw), and thrust [N] without a
              propeller
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
    folder = Path(options.output)
    files = export_model(folder, portable_model(**model), options.to, full=full)
    sizes = {str(file.relative_to(folder)): file.stat().st_size for file in files}
    lines = [f"{size / 1024:>9.1f} kB  {name}" for name, size in sizes.items()]
    run.print([*lines, f"wrote {', '.join(map(str, files))}"], {"files": sizes})


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
        thrust=model.pipeline.thrust,
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
    gains = {"now": _parameters_of(loops), "suggested": _parameters_of(suggested)}
    return pd.DataFrame(gains).rename_axis("parameter").reset_index()


def _parameters_of(loops: list[Loop]) -> dict[str, float]:
    """Return the gains of loops, to four digits."""
    gains = {}
    for loop in loops:
        for name, value in (loop.parameters or {}).items():
            gains[name] = float(f"{value:.4g}")
    return gains


def _with_infinities(table: pd.DataFrame) -> pd.DataFrame:
    """Return margins for JSON, which has no infinity: that of an unstable loop is "-inf", an unlimited one "inf"."""
    return table.astype(object).replace({np.inf: "inf", -np.inf: "-inf"})


def _margin_text(table: pd.DataFrame) -> str:
    """Return margins as text."""
    shown = table.rename_axis(index=["", ""])
    as_percent = {"probability": "{:.0%}".format}
    return shown.to_string(float_format="{:.3g}".format, formatters=as_percent, na_rep="")


def fly(run: Run) -> None:
    """Fly a model in ArduPilot's simulator, as its physics: JSON interface, UDP.

    Start the simulator beside it: sim_vehicle.py -v ArduPlane --model JSON:127.0.0.1. The aircraft begins at its
    trim, 100 m or --height above the ground, where the flight is over. --full gives deflections [rad] at full output,
    by default those of the aircraft file, and thrust [N] or propeller_speed [rad/s] where that sets the thrust. With -o
    writes flight.csv; each start of the simulator is a flight in it.

    For example:
      skdgp fly results/model.joblib --airspeed 20 --full aileron=0.42 elevator=0.42 rudder=0.35
      skdgp fly results/model.joblib --airspeed 20 --full aileron=0.42 elevator=0.42 rudder=0.35 --path 3 --gusts 5
    """
    options = run.options
    parameters = read_parameters(options.params) if options.params else None
    model = read_model_to_fly(options)
    warn_unfit(model, "simulate", "Its flights are unlike those of the aircraft.")
    thrust = model.pipeline.thrust
    full = full_outputs(model.pipeline, model.aircraft, dict(options.full), thrust)
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
        thrust=thrust,
        port=options.port,
        wait=options.wait,
        seconds=options.seconds or np.inf,
        ready=ready,
    )
    rate = flown.steps / max(flown.computing, 1e-9)
    duration = 0.0
    if len(flown.table):
        duration = flown.table.groupby("flight")["time"].max().sum()
    lines = [f"{flown.reason}: {duration:.1f} s of flight, {rate:.0f} steps a second were possible"]
    numbers = {
        "seconds": duration,
        "steps": flown.steps,
        "steps_per_second": rate,
        "outside": flown.outside,
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
    predict: {"": "model flights servos rename airborne include-noise table!"},
    derivatives: {"": "model aircraft altitude output airspeeds! paths"},
    plan: {
        "": "model aircraft output! airspeed! seconds! axes! goal flown-altitude full",
        "limits": "limits growth",
    },
    export: {"": "model aircraft output! to! full"},
    margins: {
        "": "model aircraft airspeed! altitude paths output params! full! delay slopes gain-margin phase-margin",
    },
    fly: {
        "": "model aircraft airspeed! full output params path height altitude wind gusts seconds wait port",
    },
}
