"""The options of each command."""

from __future__ import annotations

from skdgp._cli import _help as words
from skdgp._cli import _values as read
from skdgp._cli._values import FileName


def _add_identify(parser):
    parser.add_argument("train", nargs="+", type=FileName, metavar="TRAIN", help="flights to learn from")
    parser.add_argument("--aircraft", type=FileName, required=True, metavar="FILE", help="the aircraft, JSON or TOML")
    parser.add_argument(
        "--test",
        nargs="+",
        type=FileName,
        default=[],
        metavar="TEST",
        help="flights to try the model on (default: the last training flight, or the last quarter of a single one, "
        "is held out)",
    )
    _add_logs(parser)
    _add_loads(parser, thrust="auto", forces=[], said="auto, columns where they stand, else the propeller")
    _add_learning(parser)
    _add_horizons(parser)
    _add_folder(parser, required=True)


def _add_demo(parser):
    _add_learning(parser)
    _add_horizons(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=FileName,
        metavar="DIR",
        default="skdgp-demo",
        help="folder for the outputs (default: %(default)s)",
    )


def _add_inspect(parser):
    parser.add_argument("log", type=FileName, metavar="LOG", help="the log")
    _add_servos(parser)
    parser.add_argument(
        "--servo-template",
        type=FileName,
        metavar="FILE",
        help="write such a file for this log, to be filled in with the angles",
    )


def _add_predict(parser):
    _add_model(parser)
    parser.add_argument("flight", nargs="+", type=FileName, metavar="FLIGHT", help="flights to predict")
    _add_logs(parser)
    parser.add_argument(
        "--include-noise",
        action="store_true",
        help="standard deviations of new measurements, instead of those of the coefficients themselves",
    )
    parser.add_argument(
        "-o", "--output", type=read.table_file, metavar="FILE", required=True, help="the table: .csv or .parquet"
    )


def _add_validate(parser):
    _add_model(parser)
    parser.add_argument("flight", nargs="+", type=FileName, metavar="FLIGHT", help="flights to try it on")
    _add_aircraft(parser)
    _add_logs(parser)
    _add_loads(parser, thrust=None, forces=None, said="as the model was learned")
    _add_horizons(parser)
    _add_folder(parser, required=False)


def _add_simulate(parser):
    _add_model(parser)
    _add_aircraft(parser)
    start = parser.add_argument_group("start, of a log or of a trim")
    start.add_argument("--flight", type=FileName, metavar="LOG", help="start where this flight was")
    start.add_argument("--at", type=read.number, metavar="S", help="when, on the clock of the log [s]")
    _add_logs(start)
    start.add_argument("--trim", type=read.speed, metavar="V", help="start from steady flight at this airspeed [m/s]")
    start.add_argument("--altitude", type=read.number, metavar="M", help="of the trim [m] (default: 0)")
    start.add_argument(
        "--climb",
        type=read.number,
        metavar="RAD",
        help="angle of its flight path [rad] (default: 0; of a glider, what follows)",
    )
    start.add_argument("--turn-rate", type=read.number, metavar="RAD/S", help="of its heading [rad/s] (default: 0)")
    start.add_argument("--bank", type=read.number, metavar="RAD", help="its bank angle [rad], instead of a turn rate")
    parser.add_argument("--controls", type=FileName, metavar="TABLE", help="the controls to fly with")
    parser.add_argument(
        "--wind",
        nargs=3,
        type=read.number,
        metavar=("N", "E", "D"),
        help="velocity of the air [m/s], north, east, down (default: what the log tells, else 0 0 0)",
    )
    parser.add_argument(
        "--duration", type=read.seconds, metavar="S", help="how long [s] (default: 10, or as long as the log lasts)"
    )
    parser.add_argument("--dt", type=read.seconds, default=0.02, metavar="S", help="time step [s] (default: 0.02)")
    _add_paths(parser, default=30, said="to fly; 0: the mean alone")
    parser.add_argument(
        "--format", choices=["csv", "parquet"], default="csv", help="of the tables (default: %(default)s)"
    )
    _add_folder(parser, required=True)


def _add_derivatives(parser):
    _add_model(parser)
    _add_aircraft(parser)
    parser.add_argument(
        "--airspeed", nargs="+", type=read.speed, required=True, metavar="V", help="of the trims [m/s], one or several"
    )
    parser.add_argument("--altitude", type=read.number, default=0.0, metavar="M", help="of the trims [m] (default: 0)")
    parser.add_argument(
        "--axes",
        choices=["body", "stability"],
        default="body",
        help="of forces, moments and rates: the body's, or those turned to the alpha of the trim (default: body)",
    )
    _add_paths(parser, default=200, said="that tell the standard deviations; 0: none")
    _add_folder(parser, required=False)


def _add_model(parser):
    parser.add_argument("model", type=FileName, metavar="MODEL", help="the model.joblib that identify wrote")


def _add_aircraft(parser):
    parser.add_argument(
        "--aircraft",
        type=FileName,
        metavar="FILE",
        help="the aircraft, JSON or TOML, such as with another mass (default: the one in the model)",
    )


def _add_logs(parser):
    _add_servos(parser)
    parser.add_argument(
        "--airborne",
        type=read.airborne,
        metavar="V|all",
        help="airspeed [m/s] above which logs of autopilots are flights, or all of a log (default: told by the log)",
    )


def _add_servos(parser):
    parser.add_argument(
        "--servos",
        type=FileName,
        metavar="FILE",
        help="TOML for logs of autopilots: which channel moves which surface, and by how much; inspect begins one",
    )


def _add_loads(parser, *, thrust, forces, said):
    parser.add_argument(
        "--thrust",
        choices=["auto", "columns", "propeller", "none"],
        default=thrust,
        help=f"what tells the propulsion: thrust columns, the aircraft's propeller, or there is none (default: {said})",
    )
    parser.add_argument(
        "--external-forces",
        nargs="+",
        default=forces,
        metavar="NAME",
        help="further known loads: tether means the columns tether_x, tether_y, tether_z [N]",
    )


def _add_horizons(parser):
    parser.add_argument(
        "--horizons",
        nargs="+",
        type=read.seconds,
        default=[2.0, 10.0],
        metavar="S",
        help="seconds from restart to restart of the replay (default: 2 10)",
    )


def _add_paths(parser, *, default, said):
    parser.add_argument(
        "--paths",
        type=read.paths,
        default=default,
        metavar="N",
        help=f"functions of the posterior {said} (default: {default})",
    )
    parser.add_argument("--seed", type=read.at_least(0), default=0, metavar="N", help="of these functions (default: 0)")


def _add_folder(parser, *, required):
    parser.add_argument(
        "-o",
        "--output",
        type=FileName,
        metavar="DIR",
        required=required,
        help="folder for the outputs" if required else "folder for outputs (default: none are written)",
    )


def _add_learning(parser):
    group = parser.add_argument_group("model")
    group.add_argument(
        "--samples",
        type=read.samples,
        metavar="N|all",
        help="rows to learn from, spread over the flights (default: all; 755 with --inference exact)",
    )
    group.add_argument(
        "--inference",
        choices=["auto", "exact", "sparse"],
        default="auto",
        help="exact conditions on every row learned from, in time that grows with their cube; sparse on inducing "
        "variables, so that it learns from all rows of a long flight (default: auto, exact up to a thousand rows)",
    )
    group.add_argument("--inducing", type=read.at_least(1), metavar="N", help="inducing inputs of sparse inference")
    group.add_argument(
        "--regressors",
        type=read.regressors,
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
        type=read.latents,
        metavar="M|auto",
        help="latent processes that the outputs share; auto: as many as the data show (default: 2)",
    )
    group.add_argument("--max-iter", type=read.at_least(1), metavar="N", help="iterations of the fit")
    group.add_argument(
        "--restarts",
        type=read.at_least(0),
        default=0,
        metavar="N",
        help="further starting points of the fit (default: 0)",
    )
    group.add_argument(
        "--seed", type=read.at_least(0), default=0, metavar="N", help="of the starting values (default: 0)"
    )
    group.add_argument("--n-jobs", type=read.jobs, metavar="N", help="processes for the restarts; -1: all cores")


COMMANDS = {
    "demo": (_add_demo, "identify, on simulated example flights", words.DEMO, words.DEMO_EXAMPLES),
    "inspect": (_add_inspect, "what a log holds and what it lacks", words.INSPECT, words.INSPECT_EXAMPLES),
    "identify": (_add_identify, "learn a model from flight logs", words.IDENTIFY, words.TABLES),
    "validate": (_add_validate, "try a model on other flights", words.VALIDATE, words.VALIDATE_EXAMPLES),
    "predict": (_add_predict, "coefficients of flights, by a model", words.PREDICT, words.PREDICT_EXAMPLES),
    "simulate": (_add_simulate, "fly a model", words.SIMULATE, words.SIMULATE_EXAMPLES),
    "derivatives": (
        _add_derivatives,
        "trims, stability derivatives and modes",
        words.DERIVATIVES,
        words.DERIVATIVES_EXAMPLES,
    ),
}
