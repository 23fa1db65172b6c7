"""Commands: their options, from words and from a configuration, and the configuration that repeats a run."""

from __future__ import annotations

import argparse
import json
import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import getdoc
from pathlib import Path
from typing import Any, NamedTuple

from skdgp._compute.files import read_toml, software_versions
from skdgp._flight.channels import REGRESSOR_SETS

PROGRAM = "skdgp"
HEAD = f"# {PROGRAM} "
NOT_KEPT = ("config", "output", "traceback")  # in a configuration
COMPARED = ("skdgp", "scikit-learn", "numpy", "scipy")  # versions that numbers depend on
PARSED = ("type", "choices", "nargs")  # keywords of an option that a value of a configuration needs


class FileName(str):
    """The name of a file or folder, which a configuration keeps as a whole path."""

    def __new__(cls, text: str):
        """Raise ArgumentTypeError if the name is not UTF-8, which no configuration holds."""
        try:
            text.encode()
        except UnicodeEncodeError:
            raise argparse.ArgumentTypeError(
                f"got {text!a}, but expected a name in UTF-8: rename it"
            ) from None
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
        raise argparse.ArgumentTypeError(
            f"got {text}, but expected a name that ends in .csv or .parquet"
        )
    return FileName(text)


def regressor_names(text: str) -> str | list[str]:
    """Return the name of a set of regressors, or names of columns with commas between."""
    return (
        text
        if text in REGRESSOR_SETS
        else [name.strip() for name in text.split(",") if name.strip()]
    )


COMMON = [
    flag("--json", "print JSON instead of text"),
    option("--config FILE", "TOML with options by name; the command line wins over it"),
    flag("--traceback", "on an error also show where it arose"),
]
TRUST = "loading runs code that is in it, so open only files that you trust"
MODEL = option("model MODEL", f"the model.joblib that identify wrote; {TRUST}")
FLIGHTS = option("flight FLIGHT", "flights, as of identify", nargs="+")
AIRCRAFT = option(
    "--aircraft FILE",
    "the aircraft, JSON or TOML, as with another mass (default: that of the model)",
)
SERVOS = option(
    "--servos FILE", "TOML for logs of autopilots: servos and angles; inspect writes a template"
)
AIRBORNE = option(
    "--airborne V|all",
    "airspeed [m/s] above which logs of autopilots are flights, or all of a log (default: "
    "estimated)",
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
    kind = number(
        "0, or 2 or more: one path has no spread", lambda value: value == 0 or value >= 2, int
    )
    return option(
        "--paths N", f"functions of the posterior {use} (default: {default})", kind, default=default
    )


def by_axis(words: list[str]) -> dict[str, float]:
    """Return numbers by axis, of words such as ``elevator=0.4``."""
    return {axis: float(value) for axis, _, value in (word.partition("=") for word in words)}


def value_and_std(text: str) -> tuple[float, float]:
    """Return the numbers of ``3.2+-0.05``; without a deviation it is 0.

    Raise ValueError if it is no size.
    """
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
    """Return None for "none"."""
    return None if words == "none" else words


def reading(options: argparse.Namespace, model: Mapping | None = None) -> dict:
    """Return the keywords of ``skdgp.io.read_flight`` for logs of autopilots; surfaces in the unit of the model."""
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    learned = {} if model is None else model.get("options", {})
    return {"servos": options.servos or learned.get("servos"), "airborne": airborne}


@dataclass(frozen=True)
class Command:
    """A command of ``skdgp``."""

    run: Callable
    """Its docstring is the help."""
    options: dict[str, list[Option]]
    """By the title of their group."""
    outputs: str = ""
    """Pattern of the names of files that not every run writes: those of an earlier run are removed.
    """
    writes_table: bool = False
    """Whether its output is the file of a single table, not a folder."""

    @property
    def name(self) -> str:
        """Its name on the command line."""
        return self.run.__name__

    @property
    def all_options(self) -> list[Option]:
        """Its options, and those of every command."""
        return [*(each for group in self.options.values() for each in group), *COMMON]

    def parse(self, words: list[str]) -> argparse.Namespace:
        """Return the options of a command line; those that it lacks are the ones of ``--config``.

        SystemExit, as of argparse, ends wrong usage; a wrong configuration raises ValueError or
        OSError.
        """
        self._refuse_unknown(words)
        finder = argparse.ArgumentParser(
            prog=f"{PROGRAM} {self.name}", add_help=False, allow_abbrev=False
        )
        finder.add_argument("--config", type=FileName)
        config = finder.parse_known_args(words)[0].config
        return self.parser(
            {} if config is None else self._read_config(config)
        ).parse_intermixed_args(words)

    def parser(self, values: dict) -> argparse.ArgumentParser:
        """Return the argument parser; ``values`` are the defaults from a configuration."""
        parser = argparse.ArgumentParser(
            prog=f"{PROGRAM} {self.name}",
            description=getdoc(self.run),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        for title, options in (self.options | {"every command": COMMON}).items():
            group = parser.add_argument_group(title) if title else parser
            for each in options:
                keywords = dict(each.keywords)
                if each.key in values:
                    keywords["default"] = values[each.key]
                    keywords.pop("required", None)
                    if not each.names[0].startswith("-"):
                        keywords["nargs"] = "*" if "nargs" in keywords else "?"
                group.add_argument(*each.names, **keywords)
        return parser

    def _refuse_unknown(self, words) -> None:
        """End with a message that names the nearest option, before a missing operand is complained of."""
        known = [
            "help",
            *(each.key for each in self.all_options if each.names[-1].startswith("--")),
        ]
        words = words[: words.index("--")] if "--" in words else words
        for key in (word[2:].split("=")[0] for word in words if word.startswith("--")):
            if key not in known:
                near = get_close_matches(key, known, n=1)
                hint = f"did you mean --{near[0]}?" if near else "--help lists the options"
                self.parser({}).error(f"unknown option --{key}: {hint}")

    def _read_config(self, path: FileName) -> dict:
        if not Path(path).exists():
            raise FileNotFoundError(f"Got {path} as the configuration, but there is no such file.")
        values = read_toml(path)
        command = values.pop("command", self.name)
        if command != self.name:
            raise ValueError(
                f"Got {path} of the command {command}, but the command is {self.name}: say "
                f"{command}."
            )
        _warn_of_versions(path, values.pop("versions", {}))
        known = {each.key: each for each in self.all_options if each.key != "config"}
        options = {}
        for name, value in values.items():
            key = name.replace("_", "-")
            if key not in known:
                near = get_close_matches(key, known, n=1)
                hint = (
                    f"did you mean {near[0]!r}?"
                    if near
                    else f"known options are {', '.join(known)}."
                )
                raise ValueError(f"Got unknown option {name!r} in {path}: {hint}")
            try:
                options[key] = _converted(known[key], value)
            except ValueError as error:
                shown = json.dumps(value, default=str)
                raise ValueError(f"Got {name} = {shown} in {path}: {error}.") from None
        return options

    def config_text(self, options: argparse.Namespace) -> str:
        """Return all options of a run as TOML, files by their whole paths, and the versions that it ran on."""
        kept = {
            name: value
            for name, value in vars(options).items()
            if name not in NOT_KEPT and value is not None
        }
        lines = [
            f"{HEAD}{self.name} --config THIS_FILE -o ELSEWHERE runs the same again.",
            f"command = {_toml(self.name)}",
            *(f"{name.replace('_', '-')} = {_toml(value)}" for name, value in kept.items()),
            "",
            "[versions]",
            *(f"{name} = {_toml(value)}" for name, value in software_versions().items()),
        ]
        return "\n".join(lines) + "\n"


def _warn_of_versions(path, made_by) -> None:
    if not isinstance(made_by, dict):
        raise ValueError(
            f"Got versions = {made_by!r} in {path}, but expected a table of names and versions."
        )
    here = software_versions()
    others = [
        f"{name} {made_by[name]}"
        for name in COMPARED
        if made_by.get(name, here.get(name)) != here.get(name)
    ]
    if others:
        now = ", ".join(f"{name} {here.get(name)}" for name in COMPARED)
        warnings.warn(
            f"{path} is of a run with {', '.join(others)}, and this is {now}: the numbers may "
            f"differ.",
            stacklevel=2,
        )


def _toml(value) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        text = os.path.abspath(value) if isinstance(value, FileName) else value
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _converted(each: Option, value):
    """Return a value of a configuration as the same words on the command line would give it."""
    if each.keywords.get("action") == "store_true":
        if not isinstance(value, bool):
            raise ValueError("expected true or false")
        return value
    if isinstance(value, list) and "nargs" not in each.keywords:
        value = ",".join(map(str, value))
    words = value if isinstance(value, list) else [value]
    if any(isinstance(word, bool | dict | list) for word in words):
        raise ValueError("expected text or numbers")
    if not words and each.keywords.get("default") == []:
        return []
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    parser.add_argument(
        "--value", **{key: each.keywords[key] for key in PARSED if key in each.keywords}
    )
    try:
        return parser.parse_args(["--value", *map(str, words)]).value
    except argparse.ArgumentError as error:
        raise ValueError(error.message) from None
