"""Commands that read flights: inspect a log, learn a model from flights, and judge it on others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from skdgp._cli._options import Commands, reading
from skdgp._cli._shared import Run
from skdgp._cli._use import read_model
from skdgp._compute.files import without_nones
from skdgp._compute.messages import listening, notify
from skdgp._regressor import DependentGPRegressor
from skdgp.datasets import load_example_flights
from skdgp.dynamics import Aircraft, Propeller
from skdgp.identification import Identification
from skdgp.identification import identify as identify_flights
from skdgp.identification import validate as validate_flights
from skdgp.io import inspect_log
from skdgp.report import save_report

SIZES = ("mass", "span", "wing_area", "chord", "length", "kind")


def inspect(run: Run) -> None:
    """Print what a log holds: vehicle, firmware, topics with rates, columns of its flight table, flights.

    And faults of its channels, and which channels contradict physics (a wrong sign, unit or axis). With
    --mass and --span or a file of the aircraft, whether the lift carries it.

    LOG is a log of PX4 (.ulg) or ArduPilot (.bin), telemetry of
    both (.tlog), or a table (.csv, .parquet).

    For example:
      skdgp inspect log.ulg
      skdgp inspect log.bin --servos servo.toml
      skdgp inspect log.bin --mass 3.2 --span 1.6
    """
    options = run.options
    given = vars(options)
    is_named = without_nones({name: given[name] for name in ("aircraft", *SIZES)})
    aircraft = _aircraft(run, options.log) if is_named else None
    summary = inspect_log(options.log, aircraft=aircraft, **reading(options))
    run.print([str(summary)], summary.to_dict())


def identify(run: Run) -> None:
    """Learn the coefficients CX CY CZ Cl Cm Cn from the flights TRAIN, and judge the model on other flights.

     1. Inverse dynamics: forces and moments from accelerations and rates, less thrust and other
        known loads, over rho V^2 S / 2.
     2. The path of each flight is reconstructed from all its sensors, and a dependent Gaussian
        process learns all six coefficients at once from --samples rows.
     3. On flights it has not seen its coefficients are compared with the measured ones, and the
        aircraft is simulated from measured states, restarted every --horizon seconds.

    Writes into DIR, all or none:
      report.html    tables and pictures; open it in a browser, print it
      metrics.json   the same numbers for other programs, with the command and its options
      model.joblib   the model with its aircraft, for the other commands and skdgp.identification.load_model

    Flight tables:
      CSV or Parquet, one row per sample, SI units and radians (or units in the header:
      "alpha [deg]"): time, airspeed, density, alpha, beta, p, q, r, ax, ay, az (specific force,
      what accelerometers read), elevator, aileron, rudder (or elevon_left, elevon_right), throttle,
      and thrust along the thrust line (or thrust_x, thrust_y, thrust_z, or propeller_speed, with
      a propeller in the aircraft's file). For the simulation also phi, theta, psi, v_north, v_east,
      v_down. A column "flight" tells several flights in one file apart. Logs of PX4 (.ulg),
      ArduPilot (.bin) and telemetry (.tlog) are read too; --servos gives angles of surfaces.

    Aircraft file:
      {"name": "uav", "mass": 12.0, "inertia": [[1.1, 0, -0.1], [0, 2.3, 0], [-0.1, 0, 3.1]],
       "wing_area": 1.3, "span": 2.6, "chord": 0.55}
      kg, m, kg m^2 about the centre of gravity; off the diagonal MINUS the products of inertia.
      "sensor_position": [x, y, z] of the inertial sensors, forward, right, down of it, where it was
      measured. Or TOML. Without a file: --mass and --span. The rest is estimated, and the summary lists
      assumptions, their possible errors, and the next measurement to make. A log of an autopilot
      then needs no servo file and no thrust either.

    For example:
      skdgp identify sortie.ulg --mass 3.2 --span 1.6
      skdgp identify train.csv --aircraft uav.json --test test.csv -o results
      skdgp identify mon.parquet tue.parquet --aircraft uav.toml -o results    (holds out the last flight)
    """
    options = run.options
    _identify(
        run,
        options.train,
        _aircraft(run, options.train[0]),
        options.test,
        thrust=None if options.thrust == "none" else options.thrust,
        reading=reading(options),
    )


def _aircraft(run: Run, log: str) -> Aircraft:
    """Return the aircraft of a file, or its estimate of a mass and a span."""
    options = run.options
    names = ("aircraft", *SIZES, "sensor_position", "propeller", "motor")
    given = without_nones({name: vars(options).get(name) for name in names})
    if [*given] == ["aircraft"]:
        return Aircraft.from_file(options.aircraft)
    if "aircraft" in given or not {"mass", "span"} <= given.keys():
        got = [f"--{name.replace('_', '-')}" for name in given]
        options.parser.error(
            f"got {' '.join(got) or 'no aircraft'}, but expected --aircraft FILE, or --mass and "
            "--span, of which the rest is estimated"
        )
    motor = {}
    if "motor" in given:
        rpm_per_volt, voltage = given.pop("motor")
        motor = {"motor_constant": rpm_per_volt * np.pi / 30, "voltage": voltage}
    if "propeller" in given:
        diameter, pitch = given["propeller"]  # [in]
        given["propeller"] = Propeller.from_size(0.0254 * diameter, 0.0254 * pitch, **motor)
    elif motor:
        options.parser.error(
            "got --motor without --propeller, but expected its size, such as --propeller 10x5"
        )
    return Aircraft.estimate(**given, name=Path(log).stem)


def demo(run: Run) -> None:
    """Do what identify does on the example flights: a simulated delta-wing UAV in turbulence, 45 kg.

    Its true coefficients are known. Two flights to learn from, one to be tested on. About a minute
    on two cores.

    For example:
      skdgp demo
      skdgp demo --samples 250 -o quick
    """
    with listening(run.console.progress):
        notify("simulating the example flights")
        example = load_example_flights()
    _identify(run, example.train, example.aircraft, example.test)


def _identify(run, train, aircraft, test, **loads):
    """Learn a model with the options of the command line, write it and print its summary."""
    options = run.options
    parameters = without_nones({"max_iter": options.max_iter})
    regressor = DependentGPRegressor(random_state=options.seed, **parameters)
    with listening(run.console.progress):
        result = identify_flights(
            train,
            aircraft,
            test=test,
            regressors=options.regressors,
            regressor=regressor,
            samples=options.samples,
            horizon=options.horizon,
            **loads,
        )
        _finish(run, result)


def _finish(run: Run, result: Identification) -> None:
    """Write the outputs, where a folder is named, and print the summary."""
    result = replace(result, command=run.command_line)
    lines = [result.summary()]
    if run.folder is not None:
        save_report(result, run.folder)
        names = ["report.html", "metrics.json", *(["model.joblib"] if result.train else [])]
        lines += ["", f"wrote {', '.join(str(run.folder / name) for name in names)}"]
    run.print(lines, result.metrics)


def validate(run: Run) -> None:
    """Judge a model on flights that it has not seen, as identify does on its test flights.

    Its coefficients are compared with the measured ones, and the aircraft is simulated from measured
    states, restarted every --horizon seconds. Prints the scores and whether the aircraft has
    changed since the flights of the model, and with -o writes report.html
    and metrics.json into DIR, all or none.

    For example:
      skdgp validate results/model.joblib thursday.csv
      skdgp validate results/model.joblib thursday.csv friday.csv -o validation --horizon 5
      skdgp validate results/model.joblib thursday.csv --aircraft heavier.json --json
    """
    options = run.options
    with listening(run.console.progress):
        model = read_model(options)
        result = validate_flights(
            model, options.flight, horizon=options.horizon, reading=reading(options)
        )
        _finish(run, result)


LEARNING = "samples regressors max-iter seed"

COMMANDS: Commands = {
    inspect: {
        "": "log servos rename airborne",
        "the aircraft": "aircraft mass span wing-area chord length kind",
    },
    demo: {"": "horizon output", "model": LEARNING},
    identify: {
        "": "train aircraft test thrust servos rename airborne horizon output",
        "an aircraft without a file; 3.2+-0.05 is a size and its standard deviation": "mass span "
        "wing-area chord length kind propeller motor sensor-position",
        "model": LEARNING,
    },
    validate: {"": "model flights aircraft servos rename airborne horizon output"},
}
