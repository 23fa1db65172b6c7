"""The words of the command line."""

from __future__ import annotations

import argparse
from difflib import get_close_matches
from importlib.metadata import version

from skdgp.preprocessing._selector import REGRESSOR_SETS

DESCRIPTION = """\
Learn an aircraft's six aerodynamic coefficients from flight logs.

  python -m skdgp demo                                       simulated example flights, nothing else needed
  python -m skdgp identify a.csv b.csv --aircraft uav.json   your own
  python -m skdgp inspect log.ulg                            what a log holds, and lacks for which step
"""

IDENTIFY = """\
Learn the coefficients CX CY CZ Cl Cm Cn from the flights TRAIN, and try the model on other flights.

 1. Inverse dynamics: forces and moments from accelerations and rates, less thrust and other known loads, over
    rho V^2 S / 2.
 2. The path of each flight is reconstructed from all its sensors, and a dependent Gaussian process learns all six
    coefficients at once from --samples rows spread over the flights.
 3. On flights it has not seen its coefficients are compared with the measured ones and flown: integrated from
    the measured state, which is taken anew every --horizons seconds.

Writes into DIR, all or none:
  report.html    tables and pictures; open it in a browser, print it
  metrics.json   the same numbers for other programs
  model.joblib   the model: skdgp.identification.load_model reads it
"""

TABLES = """\
flight tables:
  CSV, Parquet or MATLAB (v7), one row per sample, SI units and radians (or units in the header, as in "alpha [deg]"):
  time, airspeed, density, alpha, beta, p, q, r, ax, ay, az (specific force, what accelerometers read),
  elevator, aileron, rudder (or elevon_left, elevon_right), throttle, and thrust_x, thrust_y, thrust_z
  (or propeller_speed, with a propeller in the aircraft's file). For the replay also phi, theta, psi,
  v_north, v_east, v_down. A column "flight" tells several flights in one file apart.
  Logs of autopilots, PX4 (.ulg) and ArduPilot (.bin), are read too; --servos tells the angles of their surfaces.

aircraft file:
  {"name": "uav", "mass": 12.0, "inertia": [[1.1, 0, -0.1], [0, 2.3, 0], [-0.1, 0, 3.1]],
   "wing_area": 1.3, "span": 2.6, "chord": 0.55}
  kg, m, kg m^2 about the centre of gravity; off the diagonal MINUS the products of inertia. Or TOML.

examples:
  python -m skdgp identify train.csv --aircraft uav.json --test test.csv -o results
  python -m skdgp identify mon.parquet tue.parquet --aircraft uav.toml -o results    (holds out the last flight)
  python -m skdgp identify kite.csv --aircraft kite.json --thrust none --external-forces tether -o results

Ctrl-C during the fit keeps the best model so far and goes on; a second one stops, and nothing is written.
A fit that is killed goes on where it was when the same command is run again: DIR/checkpoint holds what it needs.
"""

INSPECT = """\
Say what a log holds: vehicle, firmware, topics with rates and gaps, the columns that a flight table gets and where
they are from, stretches of flight, and what is missing for coefficients, reconstruction, regressors, replay.

LOG is a PX4 ULog (.ulg), an ArduPilot DataFlash log (.bin), or a table (.csv, .parquet, .mat).
"""

DEMO = """\
Do what identify does on the example flights: a simulated delta-wing UAV of 45 kg in turbulence, whose true
coefficients are known. Two flights to learn from, one to be tested on. About a minute on two cores.
"""


class Parser(argparse.ArgumentParser):
    """A parser whose options stand in full, and that names the nearest to an unknown one."""

    def parse_known_args(self, args=None, namespace=None):
        """Parse, but refuse unknown options before anything else is found wrong."""
        commands = next((action.choices for action in self._actions if action.dest == "command"), None)
        if commands is None:
            self._refuse_unknown(args)
        return super().parse_known_args(args, namespace)

    def _refuse_unknown(self, words):
        words = words[: words.index("--")] if "--" in words else words
        known = [option[2:] for option in self._option_string_actions if option.startswith("--")]
        for word in (word[2:].split("=")[0] for word in words if word.startswith("--")):
            if word not in known:
                near = get_close_matches(word, known, n=1)
                hint = f"did you mean --{near[0]}?" if near else "--help lists the options"
                self.error(f"unknown option --{word}: {hint}")


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of ``python -m skdgp``."""
    parser = _parser(Parser, prog="python -m skdgp", description=DESCRIPTION)
    parser.add_argument(
        "--version", action="version", version=f"skdgp {version('skdgp')}", help="the version, and exit"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    identify = _parser(
        commands.add_parser, "identify", help="learn a model from flight logs", description=IDENTIFY, epilog=TABLES
    )
    _add_flights(identify)
    _add_model(identify, samples=None, said="all; 755 with --inference exact")
    identify.add_argument("-o", "--output", metavar="DIR", required=True, help="folder for the outputs")
    demo = _parser(commands.add_parser, "demo", help="the same on simulated example flights", description=DEMO)
    _add_model(demo, samples=None, said="all; 755 with --inference exact")
    demo.add_argument(
        "-o", "--output", metavar="DIR", default="skdgp-demo", help="folder for the outputs (default: %(default)s)"
    )
    demo.set_defaults(thrust="auto", external_forces=[])
    inspect = _parser(commands.add_parser, "inspect", help="what a log holds and what it lacks", description=INSPECT)
    _add_log(inspect)
    return parser


def _parser(make, *args, **kwargs):
    return make(*args, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **kwargs)


def _add_flights(parser):
    parser.add_argument("train", nargs="+", metavar="TRAIN", help="flights to learn from")
    parser.add_argument("--aircraft", required=True, metavar="FILE", help="the aircraft, JSON or TOML")
    parser.add_argument(
        "--test",
        nargs="+",
        default=[],
        metavar="TEST",
        help="flights to try the model on (default: the last training flight, or the last quarter of a single one, "
        "is held out)",
    )
    parser.add_argument(
        "--servos",
        metavar="FILE",
        help="TOML for logs of autopilots: which channel moves which surface, and by how much; inspect begins one",
    )
    parser.add_argument(
        "--thrust",
        choices=["auto", "columns", "propeller", "none"],
        default="auto",
        help="what tells the propulsion: thrust columns, the aircraft's propeller, or there is none (default: auto, "
        "columns where they stand, else the propeller)",
    )
    parser.add_argument(
        "--external-forces",
        nargs="+",
        default=[],
        metavar="NAME",
        help="further known loads: tether means the columns tether_x, tether_y, tether_z [N]",
    )


def _add_log(parser):
    parser.add_argument("log", metavar="LOG", help="the log")
    parser.add_argument("--servos", metavar="FILE", help="TOML: which channel moves which surface, and by how much")
    parser.add_argument(
        "--servo-template", metavar="FILE", help="write such a file for this log, to be filled in with the angles"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    parser.add_argument("--traceback", action="store_true", help="on an error also show where it arose")


def _add_model(parser, *, samples, said):
    group = parser.add_argument_group("model")
    group.add_argument(
        "--samples",
        type=_samples,
        default=samples,
        metavar="N|all",
        help=f"rows to learn from, spread over the flights (default: {said})",
    )
    group.add_argument(
        "--inference",
        choices=["auto", "exact", "sparse"],
        default="auto",
        help="exact conditions on every row learned from, in time that grows with their cube; sparse on inducing "
        "variables, so that it learns from all rows of a long flight (default: auto, exact up to a thousand rows)",
    )
    group.add_argument(
        "--inducing", type=_at_least(1), default=None, metavar="N", help="inducing inputs of sparse inference"
    )
    group.add_argument(
        "--regressors",
        type=_regressors,
        default="quasi-steady",
        metavar="SET",
        help="quasi-steady (alpha, beta, rates, controls), classical (alpha_dot, beta_dot too), paper (accelerations "
        "too), or columns such as alpha,beta,q_hat,elevator (default: quasi-steady)",
    )
    group.add_argument(
        "--reconstruction",
        choices=["auto", "none"],
        default="auto",
        help="auto reconstructs the path of each flight from all its sensors, where the log holds accelerations, "
        "attitude, ground velocity and airspeed; none smooths channel by channel (default: auto)",
    )
    group.add_argument(
        "--input-noise",
        choices=["learned", "none"],
        default="learned",
        help="learned: the model finds how noisy its regressors are; none takes them for exact (default: learned)",
    )
    group.add_argument(
        "--trend",
        choices=["linear", "constant", "none"],
        default="linear",
        help="what the process is added to: linear goes on where there were no data (default: linear)",
    )
    group.add_argument(
        "--latents",
        type=_latents,
        default=None,
        metavar="M|auto",
        help="latent processes that the outputs share; auto: as many as the data show (default: 2)",
    )
    group.add_argument("--max-iter", type=_at_least(1), default=None, metavar="N", help="iterations of the fit")
    group.add_argument(
        "--restarts", type=_at_least(0), default=0, metavar="N", help="further starting points of the fit (default: 0)"
    )
    group.add_argument("--seed", type=_at_least(0), default=0, help="of the starting values (default: 0)")
    group.add_argument(
        "--n-jobs", type=_jobs, default=None, metavar="N", help="processes for the restarts; -1: all cores"
    )
    parser.add_argument(
        "--horizons",
        nargs="+",
        type=_seconds,
        default=[2.0, 10.0],
        metavar="S",
        help="seconds from restart to restart of the replay (default: 2 10)",
    )
    parser.add_argument("--traceback", action="store_true", help="on an error also show where it arose")


def _at_least(lowest):
    def integer(text):
        value = _whole(text, f"a whole number, {lowest} or more")
        if value < lowest:
            raise argparse.ArgumentTypeError(f"got {text}, but expected {lowest} or more")
        return value

    return integer


def _whole(text, expected):
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}") from None


def _latents(text):
    return text if text == "auto" else _at_least(0)(text)


def _samples(text):
    if text == "all":
        return text
    value = _whole(text, "a whole number, 2 or more, or all")
    if value < 2:
        raise argparse.ArgumentTypeError(f"got {text}, but expected 2 or more, or all")
    return value


def _jobs(text):
    expected = "a number of processes, 1 or more, or -1 for all cores"
    value = _whole(text, expected)
    if value == 0:
        raise argparse.ArgumentTypeError(f"got 0, but expected {expected}")
    return value


def _regressors(text):
    names = [name.strip() for name in text.split(",") if name.strip()]
    return text if text in REGRESSOR_SETS else names


def _seconds(text):
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {text}, but expected seconds > 0")
    return value
