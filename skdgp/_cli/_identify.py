"""The commands ``identify`` and ``demo``: learn a model from flights and judge it on others."""

from __future__ import annotations

from dataclasses import replace

from skdgp._cli._options import (
    AIRBORNE,
    FOLDER,
    HORIZONS,
    SEED,
    SERVOS,
    FileName,
    at_least,
    loads,
    number,
    option,
    reading,
    regressor_names,
    thrust_of,
)
from skdgp._cli._output import Run
from skdgp._cli._parser import Command
from skdgp._compute.checkpoint import checkpointing
from skdgp._compute.progress import listening
from skdgp._regressor import DependentGPRegressor
from skdgp.datasets import load_example_flights
from skdgp.identification import Identification
from skdgp.identification import identify as learn

CHECKPOINT = "checkpoint"  # in the folder of the outputs, until these are written


LEARNING = [
    option(
        "--samples",
        type=at_least(2, "all"),
        metavar="N|all",
        help="rows to learn from, spread over the flights (default: all; 755 with --inference exact)",
    ),
    option(
        "--inference",
        choices=["auto", "exact", "sparse"],
        default="auto",
        help="exact conditions on every row, in time that grows with their cube; sparse on inducing variables, in time "
        "that grows with the rows (default: auto, exact up to a thousand rows)",
    ),
    option("--inducing", type=at_least(1), metavar="N", help="inducing inputs of sparse inference"),
    option(
        "--regressors",
        type=regressor_names,
        default="quasi-steady",
        metavar="SET",
        help="quasi-steady (alpha, beta, rates, controls), classical (alpha_dot, beta_dot too), paper (accelerations "
        "too), or columns such as alpha,beta,q_hat,elevator (default: quasi-steady)",
    ),
    option(
        "--reconstruction",
        choices=["auto", "none"],
        default="auto",
        help="auto reconstructs the path of each flight from all its sensors, where the log holds accelerations, "
        "attitude, ground velocity and airspeed; none smooths channel by channel (default: auto)",
    ),
    option("--lags", action="store_true", help="estimate and correct lags of air data, surfaces, attitude and GPS"),
    option(
        "--input-noise",
        choices=["learned", "none"],
        default="learned",
        help="learned: how noisy regressors are is estimated; none: they are exact (default: learned)",
    ),
    option(
        "--trend",
        choices=["linear", "constant", "none"],
        default="linear",
        help="mean of the process: linear extrapolates where there are no data (default: linear)",
    ),
    option(
        "--latents",
        type=at_least(0, "auto"),
        metavar="M|auto",
        help="latent processes that the outputs share; auto: as many as the data show (default: 2)",
    ),
    option(
        "--calibrate",
        action="store_true",
        help="scale standard deviations to what training flights show that are held out in turn; two flights at least",
    ),
    option("--max-iter", type=at_least(1), metavar="N", help="iterations of the fit"),
    option(
        "--restarts", type=at_least(0), default=0, metavar="N", help="further starting points of the fit (default: 0)"
    ),
    SEED,
    option(
        "--n-jobs",
        type=number("a number of processes, 1 or more, or -1 for all cores", bool, int),
        metavar="N",
        help="processes for the restarts; -1: all cores",
    ),
]


def identify(run: Run) -> None:
    """Learn a model from the flights that the options name."""
    options = run.options
    known = {"thrust": thrust_of(options.thrust), "external_forces": options.external_forces}
    _learn(run, options.train, options.aircraft, options.test or None, **known, **reading(options))


def demo(run: Run) -> None:
    """Learn a model from the example flights."""
    run.console.stage("simulating the example flights")
    example = load_example_flights()
    _learn(run, example.train, example.aircraft, example.test, title="Example flights: a simulated UAV")


def _learn(run, train, aircraft, test, title=None, **known):
    options, console = run.options, run.console
    given = {"n_latent": options.latents, "max_iter": options.max_iter, "n_inducing": options.inducing}
    regressor = DependentGPRegressor(
        trend=None if options.trend == "none" else options.trend,
        inference=options.inference,
        input_noise=None if options.input_noise == "none" else options.input_noise,
        n_restarts_optimizer=options.restarts,
        n_jobs=options.n_jobs,
        random_state=options.seed,
        **{name: value for name, value in given.items() if value is not None},
    )
    with checkpointing(run.folder.path / CHECKPOINT), listening(console.progress):
        with console.counting_interrupts():
            result = learn(
                train,
                aircraft,
                test=test,
                regressors=options.regressors,
                reconstruction="passthrough" if options.reconstruction == "none" else "auto",
                lags="auto" if options.lags else None,
                samples=options.samples,
                regressor=regressor,
                calibrate=options.calibrate,
                horizons=options.horizons,
                **known,
            )
        finish(run, replace(result, command=run.command_line, title=title or result.title))


def finish(run: Run, result: Identification) -> None:
    """Write the outputs, where a folder is named, and print the summary."""
    files = run.write(result.writers()) if run.folder is not None else []
    lines = [f"{CONTENTS[path.name]:<9}{path}" for path in files]
    run.print("\n".join([result.summary(), "", *lines]).rstrip(), result.metrics)


CONTENTS = {"report.html": "report", "metrics.json": "numbers", "model.joblib": "model", "config.toml": "options"}

IDENTIFY = Command(
    name="identify",
    run=identify,
    summary="learn a model from flight logs",
    description="""\
Learn the coefficients CX CY CZ Cl Cm Cn from the flights TRAIN, and judge the model on other flights.

 1. Inverse dynamics: forces and moments from accelerations and rates, less thrust and other known loads, over
    rho V^2 S / 2.
 2. The path of each flight is reconstructed from all its sensors, and a dependent Gaussian process learns all six
    coefficients at once from --samples rows.
 3. On flights it has not seen its coefficients are compared with the measured ones and replayed: integrated from the
    measured state, restarted every --horizons seconds.

Writes into DIR, all or none:
  report.html    tables and pictures; open it in a browser, print it
  metrics.json   the same numbers for other programs
  model.joblib   the model with its aircraft, for the other commands and skdgp.identification.load_model
  config.toml    all options of this run: --config DIR/config.toml -o ELSEWHERE runs the same again
""",
    examples="""\
flight tables:
  CSV, Parquet or MATLAB (v7), one row per sample, SI units and radians (or units in the header, as in "alpha [deg]"):
  time, airspeed, density, alpha, beta, p, q, r, ax, ay, az (specific force, what accelerometers read),
  elevator, aileron, rudder (or elevon_left, elevon_right), throttle, and thrust_x, thrust_y, thrust_z
  (or propeller_speed, with a propeller in the aircraft's file). For the replay also phi, theta, psi,
  v_north, v_east, v_down. A column "flight" tells several flights in one file apart.
  Logs of PX4 (.ulg) and ArduPilot (.bin) are read too; --servos gives the angles of their surfaces.

aircraft file:
  {"name": "uav", "mass": 12.0, "inertia": [[1.1, 0, -0.1], [0, 2.3, 0], [-0.1, 0, 3.1]],
   "wing_area": 1.3, "span": 2.6, "chord": 0.55}
  kg, m, kg m^2 about the centre of gravity; off the diagonal MINUS the products of inertia. Or TOML.

examples:
  python -m skdgp identify train.csv --aircraft uav.json --test test.csv -o results
  python -m skdgp identify mon.parquet tue.parquet --aircraft uav.toml -o results    (holds out the last flight)
  python -m skdgp identify kite.csv --aircraft kite.json --thrust none --external-forces tether -o results

Ctrl-C during the fit keeps the best model so far and goes on; a second one stops, and nothing is written.
A killed fit goes on where it was when the same command is run again: DIR/checkpoint holds what it needs.
""",
    options={
        "": [
            option("train", nargs="+", type=FileName, metavar="TRAIN", help="flights to learn from"),
            option("--aircraft", type=FileName, required=True, metavar="FILE", help="the aircraft, JSON or TOML"),
            option(
                "--test",
                nargs="+",
                type=FileName,
                default=[],
                metavar="TEST",
                help="flights to judge the model on (default: the last training flight, or the last quarter of a "
                "single one, is held out)",
            ),
            SERVOS,
            AIRBORNE,
            *loads("auto", [], "auto, columns where the flights have them, else the propeller"),
            HORIZONS,
            FOLDER,
        ],
        "model": LEARNING,
    },
)
DEMO = Command(
    name="demo",
    run=demo,
    summary="identify, on simulated example flights",
    description="""\
Do what identify does on the example flights: a simulated delta-wing UAV of 45 kg in turbulence, whose true
coefficients are known. Two flights to learn from, one to be tested on. About a minute on two cores.
""",
    examples="""\
examples:
  python -m skdgp demo
  python -m skdgp demo --samples 250 --inference exact -o quick
""",
    options={
        "": [
            HORIZONS,
            option(
                *FOLDER.names, type=FileName, metavar="DIR", default="skdgp-demo", help="folder (default: skdgp-demo)"
            ),
        ],
        "model": LEARNING,
    },
)
