"""Values of options, and the options that several commands have."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from skdgp.preprocessing._selector import REGRESSOR_SETS


class Option(NamedTuple):
    """An option or an operand of a command: what ``ArgumentParser.add_argument`` takes."""

    names: tuple[str, ...]
    keywords: dict

    @property
    def key(self) -> str:
        """Its name in a configuration."""
        return self.names[-1].removeprefix("--")


def option(*names: str, **keywords) -> Option:
    """Return an option; the arguments are those of ``ArgumentParser.add_argument``."""
    return Option(names, keywords)


class FileName(str):
    """The name of a file or folder, which a configuration keeps as a whole path."""

    def __new__(cls, text):
        """Raise ArgumentTypeError if the name is not UTF-8, which no configuration and no report could hold."""
        try:
            text.encode()
        except UnicodeEncodeError:
            raise argparse.ArgumentTypeError(f"got {text!a}, but expected a name in UTF-8: rename it") from None
        return super().__new__(cls, text)


def table_file(text: str) -> FileName:
    """Return the name of a table to write."""
    if Path(text).suffix not in (".csv", ".parquet"):
        raise argparse.ArgumentTypeError(f"got {text}, but expected a name that ends in .csv or .parquet")
    return FileName(text)


def regressor_names(text: str) -> str | list[str]:
    """Return the name of a set of regressors, or names of columns with commas between."""
    return text if text in REGRESSOR_SETS else [name.strip() for name in text.split(",") if name.strip()]


def number(
    expected: str = "a number",
    accept: Callable[[float], bool] = math.isfinite,
    kind: type = float,
    words: tuple[str, ...] = (),
) -> Callable[[str], float | str]:
    """Return what reads a finite number that is accepted, or one of some words."""

    def read(text):
        if text in words:
            return text
        try:
            value = kind(text)
            if math.isfinite(value) and accept(value):
                return value
        except (ValueError, OverflowError):
            pass
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}")

    return read


def at_least(lowest: int, *words: str):
    """Return what reads whole numbers from ``lowest`` on, or one of some words."""
    expected = ", or ".join([f"a whole number, {lowest} or more", *words])
    return number(expected, lambda value: value >= lowest, int, words)


seconds = number("seconds > 0", lambda value: value > 0)
speed = number("m/s > 0", lambda value: value > 0)
path_count = number("0, or 2 or more: one path has no spread", lambda value: value == 0 or value >= 2, int)

MODEL = option("model", type=FileName, metavar="MODEL", help="the model.joblib that identify wrote")
AIRCRAFT = option(
    "--aircraft",
    type=FileName,
    metavar="FILE",
    help="the aircraft, JSON or TOML, such as with another mass (default: the one in the model)",
)
FLIGHTS = option("flight", nargs="+", type=FileName, metavar="FLIGHT", help="flights, as of identify")
SERVOS = option(
    "--servos",
    type=FileName,
    metavar="FILE",
    help="TOML for logs of autopilots: which channel moves which surface, and by how much; inspect writes a template",
)
AIRBORNE = option(
    "--airborne",
    type=number("m/s > 0, or all", lambda value: value > 0, words=("all",)),
    metavar="V|all",
    help="airspeed [m/s] above which logs of autopilots are flights, or all of a log (default: estimated)",
)
HORIZONS = option(
    "--horizons",
    nargs="+",
    type=seconds,
    default=[2.0, 10.0],
    metavar="S",
    help="seconds from restart to restart of the replay (default: 2 10)",
)
SEED = option("--seed", type=at_least(0), default=0, metavar="N", help="of random numbers (default: 0)")
FOLDER = option("-o", "--output", type=FileName, metavar="DIR", required=True, help="folder for the outputs")
OPTIONAL_FOLDER = option("-o", "--output", type=FileName, metavar="DIR", help="folder for outputs (default: none)")


def loads(thrust: str | None, forces: list[str] | None, default: str) -> list[Option]:
    """Return the options of known loads."""
    return [
        option(
            "--thrust",
            choices=["auto", "columns", "propeller", "none"],
            default=thrust,
            help=f"where the thrust is from: columns, the aircraft's propeller, or none (default: {default})",
        ),
        option(
            "--external-forces",
            nargs="+",
            default=forces,
            metavar="NAME",
            help="further known loads: tether means the columns tether_x, tether_y, tether_z [N]",
        ),
    ]


def paths(default: int, use: str) -> Option:
    """Return the option of how many functions of the posterior are drawn."""
    return option(
        "--paths",
        type=path_count,
        default=default,
        metavar="N",
        help=f"functions of the posterior, {use} (default: {default})",
    )


def reading(options: argparse.Namespace) -> dict:
    """Return the keywords of ``skdgp.io.read_flight`` for logs of autopilots."""
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    return {"servos": options.servos, "airborne": airborne}


def thrust_of(words: str) -> str | None:
    """Return the thrust as the library takes it: None for "none"."""
    return None if words == "none" else words
