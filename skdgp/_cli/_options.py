"""The options of all commands, in one table, and the types of their values."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from inspect import getdoc
from pathlib import Path
from typing import Any, TypeAlias

from skdgp._flight.channels import REGRESSOR_SETS
from skdgp._flight.excitation import AXES
from skdgp.dynamics import KINDS
from skdgp.export import FORMATS

# Functions of commands, with the names of their options in `OPTIONS` by groups; those with a "!" are required
Commands: TypeAlias = dict[Callable, dict[str, str]]
TRUST = "loading runs code that is in it, so open only files that you trust"


def checked(
    expected: str, read: Callable[[str], Any], accept: Callable[[Any], bool] = lambda value: True
) -> Callable[[str], Any]:
    """Return a type of argparse that reads and checks a value; its error names the expected one."""

    def value(text: str) -> Any:
        with suppress(ValueError, OverflowError):
            result = read(text)
            if accept(result):
                return result
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}")

    return value


def number(
    least: float = -math.inf, *words: str, kind: type = float
) -> Callable[[str], float | str]:
    """Return the type of finite numbers that are not below ``least``, or of some words."""
    bound = "" if least == -math.inf else f" >= {least:g}"
    expected = f"a {'whole number' if kind is int else 'number'}{bound}"
    return checked(
        ", or ".join([expected, *words]),
        lambda text: text if text in words else kind(text),
        lambda value: value in words or least <= float(value) < math.inf,
    )


def _pair(text: str, separator: str, first: type = float, second: type = float) -> tuple[Any, Any]:
    before, after = text.split(separator)
    return first(before), second(after)


table_file = checked("a name that ends in .csv", str, lambda text: Path(text).suffix == ".csv")
axis_value = checked("AXIS=NUMBER such as elevator=0.4", lambda text: _pair(text, "=", str))
renaming = checked("OLD=NEW such as de=elevator", lambda text: _pair(text, "=", str, str))
size = checked(
    "a number > 0, or with its standard deviation such as 3.2+-0.05",
    lambda text: _pair(text if "+-" in text else f"{text}+-0", "+-"),
    lambda pair: 0 < pair[0] < math.inf and 0 <= pair[1] < math.inf,
)
factors = checked(
    "two numbers > 0 such as 10x5",
    lambda text: _pair(text, "x"),
    lambda pair: min(pair) > 0 and max(pair) < math.inf,
)
positive = checked("a number > 0", float, lambda value: 0 < value < math.inf)
n_paths = checked(
    "0, or 2 or more: one path has no spread", int, lambda value: value >= 0 and value != 1
)
count = number(0, kind=int)


def regressors(text: str) -> str | list[str]:
    """Return a set of regressors by its name, or a list of columns."""
    return text if text in REGRESSOR_SETS else [name.strip() for name in text.split(",")]


# Arguments of ``add_argument`` by the name of an option; "flags" where these are not "--" and the name
OPTIONS: dict[str, dict[str, Any]] = {
    # what is read
    "log": {"flags": "log", "metavar": "LOG", "help": "the log"},
    "train": {
        "flags": "train",
        "metavar": "TRAIN",
        "nargs": "+",
        "help": "flights to learn from",
    },
    "flights": {
        "flags": "flight",
        "metavar": "FLIGHT",
        "nargs": "+",
        "help": "flights, as of identify",
    },
    "model": {
        "flags": "model",
        "metavar": "MODEL",
        "help": f"the model.joblib that identify wrote; {TRUST}",
    },
    "test": {
        "metavar": "TEST",
        "nargs": "+",
        "help": "flights to judge the model on (default: the last of several, or the last "
        "quarter of one, is held out)",
    },
    "servos": {"help": "TOML for logs of autopilots: servos and angles, see docs/logs.md"},
    "rename": {
        "metavar": "OLD=NEW",
        "nargs": "+",
        "type": renaming,
        "default": [],
        "help": "names of a flight table for columns of tables, such as de=elevator for 'de' or 'de [deg]'",
    },
    "airborne": {
        "metavar": "V|all",
        "type": number(0.0, "all"),
        "help": "airspeed [m/s] above which logs of autopilots are flights, or all of a log "
        "(default: estimated)",
    },
    # the aircraft
    "aircraft": {
        "help": "the aircraft, JSON or TOML, as with another mass (default: the model's; without a model "
        "--mass and --span)"
    },
    "mass": {"type": size, "help": "[kg]"},
    "span": {"type": size, "help": "of the wing [m]"},
    "wing-area": {"type": size, "help": "[m^2]"},
    "chord": {"type": size, "help": "mean chord of the wing [m]"},
    "length": {"type": size, "help": "from nose to tail [m]"},
    "kind": {
        "choices": list(KINDS),
        "help": "kind of the aircraft, for the estimates (default: conventional)",
    },
    "propeller": {
        "metavar": "AxB",
        "type": factors,
        "help": "diameter x pitch in inches, as printed on it, such as 10x5: the usual thrust of this size",
    },
    "motor": {
        "metavar": "AxB",
        "type": factors,
        "help": "rpm per volt x volts in flight, such as 900x11.1: the propeller's speed where it was not logged",
    },
    "sensor-position": {
        "metavar": ("X", "Y", "Z"),
        "nargs": 3,
        "type": number(),
        "help": "of the inertial sensors from the centre of gravity, forward, right, down [m], to about 1 cm",
    },
    "thrust": {
        "choices": ["auto", "none"],
        "default": "auto",
        "help": "what gives the thrust; none: a glider, or an unknown thrust that becomes part of the coefficients",
    },
    # the fit
    "samples": {
        "metavar": "N",
        "type": number(2, kind=int),
        "help": "rows to learn from (default: all, at most 30,000)",
    },
    "regressors": {
        "type": regressors,
        "default": "quasi-steady",
        "help": "quasi-steady (alpha, beta, rates, controls), classical (alpha_dot, beta_dot too), paper "
        "(accelerations too), or columns such as alpha,beta,q_hat,elevator (default: quasi-steady)",
    },
    "max-iter": {
        "type": number(1, kind=int),
        "help": "largest number of steps of the fit from each start (default: 300)",
    },
    "seed": {"type": count, "default": 0, "help": "of random numbers (default: 0)"},
    "horizon": {
        "type": positive,
        "default": 10.0,
        "help": "seconds after which simulations start again (default: 10)",
    },
    # what is written
    "output": {
        "flags": "-o --output",
        "help": "folder for the outputs (by default skdgp-results for identify, skdgp-demo for demo)",
    },
    "table": {
        "flags": "-o --output",
        "metavar": "FILE",
        "type": table_file,
        "help": "the table, .csv",
    },
    "include-noise": {
        "action": "store_true",
        "help": "standard deviations of new measurements, not of the coefficients themselves",
    },
    "json": {"action": "store_true", "help": "print JSON instead of text"},
    # steady flight and the model around it
    "airspeed": {"type": positive, "help": "of the trim [m/s]"},
    "airspeeds": {
        "flags": "--airspeed",
        "type": positive,
        "nargs": "+",
        "help": "of the trims [m/s]",
    },
    "altitude": {
        "type": number(),
        "default": 0.0,
        "help": "of the trim (fly: of the ground) [m] (default: 0)",
    },
    "flown-altitude": {
        "flags": "--altitude",
        "type": number(),
        "help": "[m] (default: the highest that was flown)",
    },
    "paths": {
        "type": n_paths,
        "default": 200,
        "help": "aircraft of the posterior; 0: no standard deviations (default: 200)",
    },
    "to": {"choices": list(FORMATS), "help": "the format"},
    "full": {
        "metavar": "AXIS=X",
        "type": axis_value,
        "nargs": "+",
        "default": [],
        "help": "deflections [rad] with the servos at their ends, see above",
    },
    "params": {
        "help": "parameters of the autopilot, as a ground station saves them (fly: SERVOn_*, by default servos 1 to 4 "
        "are aileron, elevator, throttle, rudder, 1100 to 1900 us)",
    },
    # plan
    "seconds": {
        "type": positive,
        "help": "of all flights together (fly: by default until the autopilot is silent)",
    },
    "axes": {"choices": AXES, "nargs": "+", "help": "controls to move"},
    "goal": {"nargs": "+", "help": "derivatives such as Cm_q Cn_rudder (default: all)"},
    "limits": {
        "metavar": "AXIS=X",
        "type": axis_value,
        "nargs": "+",
        "default": [],
        "help": "largest deviations from trim [rad] (default: as flown)",
    },
    "growth": {
        "type": number(0.0),
        "default": 0.2,
        "help": "part of its range by which a quantity may leave its range in training (default: 0.2)",
    },
    # margins
    "delay": {
        "type": number(0.0),
        "default": 0.02,
        "help": "of the commands before they are logged [s], from sampling and computing; the delay of the "
        "servos and the hold of the commands, which the flights show, come on top (default: 0.02)",
    },
    "slopes": {
        "choices": ["flown", "local"],
        "default": "flown",
        "help": "over the motion flown, or of small oscillations (default: flown)",
    },
    "gain-margin": {"type": positive, "default": 6.0, "help": "wanted [dB] (default: 6)"},
    "phase-margin": {"type": positive, "default": 45.0, "help": "wanted [deg] (default: 45)"},
    # fly
    "path": {
        "type": count,
        "help": "seed of one aircraft of the posterior, and of the gusts (default: the mean flies)",
    },
    "height": {
        "type": positive,
        "default": 100.0,
        "help": "of the start above the ground [m] (default: 100)",
    },
    "wind": {
        "metavar": ("NORTH", "EAST", "DOWN"),
        "type": number(),
        "nargs": 3,
        "help": "velocity of the air [m/s] (default: 0 0 0)",
    },
    "gusts": {
        "metavar": "W|flown",
        "type": number(0.0, "flown"),
        "help": "gusts as in this wind [m/s] 6 m above ground, or as in the training flights (default: calm)",
    },
    "wait": {
        "type": positive,
        "default": 60.0,
        "help": "longest silence of the autopilot [s] (default: 60)",
    },
    "port": {"type": number(1, kind=int), "default": 9002, "help": "UDP port (default: 9002)"},
}


def add_command(commands: Any, run: Callable, groups: Mapping[str, str]) -> None:
    """Add a command, whose help is the docstring of ``run``, with its options by groups."""
    parser = commands.add_parser(
        run.__name__,
        description=getdoc(run),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run, parser=parser)
    for title, names in {**groups, "every command": "json"}.items():
        target = parser.add_argument_group(title) if title else parser
        for name in names.split():
            known = OPTIONS[name.removesuffix("!")].copy()
            flags = known.pop("flags", f"--{name.removesuffix('!')}").split()
            if name.endswith("!"):
                known["required"] = True
            target.add_argument(*flags, **known)


def reading(options: argparse.Namespace, model: Mapping | None = None) -> dict:
    """Return the keywords of ``skdgp.io.read_flight``; surfaces of logs in the unit of the model."""
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    servos = options.servos
    if model is not None and servos is None:
        servos = model.get("options", {}).get("servos")
    return {"servos": servos, "airborne": airborne, "rename": dict(options.rename)}
