"""Values of options, and the options that several commands have."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from skdgp._flight.channels import REGRESSOR_SETS


class FileName(str):
    """The name of a file or folder, which a configuration keeps as a whole path."""

    def __new__(cls, text: str):
        """Raise ArgumentTypeError if the name is not UTF-8, which no configuration holds, or no name for the system."""
        try:
            text.encode()
            os.stat(text)
        except UnicodeEncodeError:
            raise argparse.ArgumentTypeError(f"got {text!a}, but expected a name in UTF-8: rename it") from None
        except (FileNotFoundError, NotADirectoryError, PermissionError):
            pass  # may be made yet, or the command says what it is
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise argparse.ArgumentTypeError(f"got {text!a}, but expected a file or folder ({reason})") from None
        return super().__new__(cls, text)


class Option(NamedTuple):
    """An option or an operand of a command: what ``ArgumentParser.add_argument`` takes."""

    names: tuple[str, ...]
    keywords: dict

    @property
    def key(self) -> str:
        """Its name in a configuration."""
        return self.names[-1].removeprefix("--")


def option(usage: str, help: str, type: Callable = FileName, **keywords) -> Option:
    """Return an option; ``usage`` is such as "-o --output DIR", or "model MODEL" for an operand."""
    words = usage.split()
    names = tuple(word for word in words if word.startswith("-")) or (words[0],)
    metavar = words[len(names) :]
    if metavar:
        keywords |= {"metavar": tuple(metavar) if len(metavar) > 1 else metavar[0], "type": type}
    return Option(names, keywords | {"help": help})


def choice(name: str, choices: Sequence[str], help: str) -> Option:
    """Return an option that has one of some values, by default the first."""
    return option(name, help, choices=choices, default=choices[0])


def flag(name: str, help: str) -> Option:
    """Return an option without a value."""
    return option(name, help, action="store_true")


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


def at_least(lowest: int, *words: str) -> Callable[[str], float | str]:
    """Return what reads whole numbers from ``lowest`` on, or one of some words."""
    expected = ", or ".join([f"a whole number, {lowest} or more", *words])
    return number(expected, lambda value: value >= lowest, int, words)


def positive(unit: str, *words: str) -> Callable[[str], float | str]:
    """Return what reads numbers > 0, or one of some words."""
    return number(", or ".join([f"{unit} > 0", *words]), lambda value: value > 0, words=words)


jobs = number("a number of processes, 1 or more, or -1 for all cores", bool, int)


def table_file(text: str) -> FileName:
    """Return the name of a table to write."""
    if Path(text).suffix not in (".csv", ".parquet"):
        raise argparse.ArgumentTypeError(f"got {text}, but expected a name that ends in .csv or .parquet")
    return FileName(text)


def regressor_names(text: str) -> str | list[str]:
    """Return the name of a set of regressors, or names of columns with commas between."""
    return text if text in REGRESSOR_SETS else [name.strip() for name in text.split(",") if name.strip()]


MODEL = option("model MODEL", "the model.joblib that identify wrote")
FLIGHTS = option("flight FLIGHT", "flights, as of identify", nargs="+")
AIRCRAFT = option("--aircraft FILE", "the aircraft, JSON or TOML, as with another mass (default: that of the model)")
SERVOS = option("--servos FILE", "TOML for logs of autopilots: servos and angles; inspect writes a template")
AIRBORNE = option(
    "--airborne V|all",
    "airspeed [m/s] above which logs of autopilots are flights, or all of a log (default: estimated)",
    positive("m/s", "all"),
)
HORIZONS = option(
    "--horizons S",
    "seconds between restarts of the replay (default: 2 10)",
    positive("seconds"),
    nargs="+",
    default=[2.0, 10.0],
)
SEED = option("--seed N", "of random numbers (default: 0)", at_least(0), default=0)
FOLDER = option("-o --output DIR", "folder for the outputs", required=True)
OPTIONAL_FOLDER = option("-o --output DIR", "folder for outputs (default: none)")


def loads(thrust: str | None, forces: list[str] | None, default: str) -> list[Option]:
    """Return the options of known loads."""
    engine = "what gives the thrust; none: a glider, or an unknown thrust that becomes part of the coefficients"
    names = "further known loads: tether means the columns tether_x, tether_y, tether_z [N]"
    sources = ["auto", "columns", "propeller", "none"]
    return [
        option("--thrust", f"{engine} (default: {default})", choices=sources, default=thrust),
        option("--external-forces NAME", names, str, nargs="+", default=forces),
    ]


def paths(default: int, use: str) -> Option:
    """Return the option of how many functions of the posterior are drawn."""
    kind = number("0, or 2 or more: one path has no spread", lambda value: value == 0 or value >= 2, int)
    return option("--paths N", f"functions of the posterior {use} (default: {default})", kind, default=default)


def by_axis(words: list[str]) -> dict[str, float]:
    """Return numbers by axis, of words such as ``elevator=0.4``."""
    return {axis: float(value) for axis, _, value in (word.partition("=") for word in words)}


def value_and_std(text: str) -> tuple[float, float]:
    """Return the numbers of ``3.2+-0.05``; without a deviation it is 0. Raise ValueError if it is no size."""
    value, _, std = text.partition("+-")
    found = float(value), float(std or 0.0)
    if not (0 < found[0] < math.inf and 0 <= found[1] < math.inf):
        raise ValueError
    return found


def factors_of(text: str) -> tuple[float, float]:
    """Return the numbers of ``10x5``; raise ValueError if they are not two numbers > 0."""
    first, _, second = text.partition("x")
    found = float(first), float(second)
    if not all(0 < value < math.inf for value in found):
        raise ValueError
    return found


def words_of(read: Callable[[str], object], expected: str) -> Callable[[str], str]:
    """Return what returns words as they are, for the configuration, if they can be read."""

    def check(text):
        try:
            read(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}") from None
        return text

    return check


axis_value = words_of(lambda text: by_axis([text]), "AXIS=NUMBER such as elevator=0.4")
size = words_of(value_and_std, "a number > 0, or with its deviation such as 3.2+-0.05")
factors = words_of(factors_of, "two numbers > 0 such as 10x5")


def axis_values(name: str, help: str) -> Option:
    """Return an option that has numbers by axis."""
    return option(f"{name} AXIS=X", help, axis_value, nargs="+", default=[])


def none_of(words: Any) -> Any:
    """Return None for "none", which the command line says for it."""
    return None if words == "none" else words


def reading(options: argparse.Namespace, model: Mapping | None = None) -> dict:
    """Return the keywords of ``skdgp.io.read_flight`` for logs of autopilots; surfaces in the unit of the model."""
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    learned = {} if model is None else model.get("options", {})
    return {"servos": options.servos or learned.get("servos"), "airborne": airborne}
