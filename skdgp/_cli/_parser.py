"""Commands: their arguments, from words and from a configuration, and the configuration that repeats a run."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import getdoc
from pathlib import Path

from skdgp._cli._options import FileName, Option, flag, option
from skdgp._compute.files import read_toml
from skdgp._compute.versions import software_versions

PROGRAM = "python -m skdgp"
HEAD = f"# {PROGRAM} "
CHECKSUM = "# sha256 "
NOT_KEPT = ("config", "output", "traceback")  # in a configuration
COMPARED = ("skdgp", "scikit-learn", "numpy", "scipy")  # versions that numbers depend on
PARSED = ("type", "choices", "nargs")  # keywords of an option that a value of a configuration needs
COMMON = [
    flag("--json", "print JSON instead of text"),
    option("--config FILE", "TOML with options by name; the command line wins over it"),
    flag("--traceback", "on an error also show where it arose"),
]


@dataclass(frozen=True)
class Command:
    """A command of ``python -m skdgp``."""

    run: Callable
    """Its docstring is the help."""
    options: dict[str, list[Option]]
    """By the title of their group."""
    outputs: str = ""
    """Pattern of the names of files that not every run writes: those of an earlier run are removed."""
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

        SystemExit, as of argparse, ends wrong usage; a wrong configuration raises ValueError or OSError.
        """
        parser = self.parser({})
        self._refuse_unknown(words, parser)
        finder = argparse.ArgumentParser(prog=parser.prog, add_help=False, allow_abbrev=False)
        finder.add_argument("--config", type=FileName)
        config = finder.parse_known_args(words)[0].config
        values = {} if config is None else self._read_config(config)
        return (self.parser(values) if values else parser).parse_intermixed_args(words)

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

    def _refuse_unknown(self, words, parser) -> None:
        """End with a message that names the nearest option, before a missing operand is complained of."""
        known = ["help", *(each.key for each in self.all_options if each.names[-1].startswith("--"))]
        words = words[: words.index("--")] if "--" in words else words
        for key in (word[2:].split("=")[0] for word in words if word.startswith("--")):
            if key not in known:
                near = get_close_matches(key, known, n=1)
                hint = f"did you mean --{near[0]}?" if near else "--help lists the options"
                parser.error(f"unknown option --{key}: {hint}")

    def _read_config(self, path: FileName) -> dict:
        if not Path(path).exists():
            raise FileNotFoundError(f"Got {path} as the configuration, but there is no such file.")
        values = read_toml(path)
        above, found, line = Path(path).read_text(encoding="utf-8-sig").rpartition(CHECKSUM)
        if found and line.split(" ")[0] != _checksum(above):
            warnings.warn(
                f"{path} is not as the run wrote it, which it would no longer repeat. If you changed it, remove its "
                "last line.",
                stacklevel=2,
            )
        command = values.pop("command", self.name)
        if command != self.name:
            raise ValueError(f"Got {path} of the command {command}, but the command is {self.name}: say {command}.")
        _warn_of_versions(path, values.pop("versions", {}))
        known = {each.key: each for each in self.all_options if each.key != "config"}
        options = {}
        for name, value in values.items():
            key = name.replace("_", "-")
            if key not in known:
                near = get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else f"known options are {', '.join(known)}."
                raise ValueError(f"Got unknown option {name!r} in {path}: {hint}")
            try:
                options[key] = _converted(known[key], value)
            except ValueError as error:
                shown = json.dumps(value, default=str)
                raise ValueError(f"Got {name} = {shown} in {path}: {error}.") from None
        return options

    def config_text(self, options: argparse.Namespace) -> str:
        """Return all options of a run as TOML, files by their whole paths, and the versions that it ran on."""
        kept = {name: value for name, value in vars(options).items() if name not in NOT_KEPT and value is not None}
        lines = [
            f"{HEAD}{self.name} --config THIS_FILE -o ELSEWHERE runs the same again.",
            f"command = {_toml(self.name)}",
            *(f"{name.replace('_', '-')} = {_toml(value)}" for name, value in kept.items()),
            "",
            "[versions]",
            *(f"{name} = {_toml(value)}" for name, value in software_versions().items()),
        ]
        text = "\n".join(lines) + "\n"
        return f"{text}{CHECKSUM}{_checksum(text)} of the lines above: remove this line when you change them.\n"


def _checksum(text) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _warn_of_versions(path, made_by) -> None:
    if not isinstance(made_by, dict):
        raise ValueError(f"Got versions = {made_by!r} in {path}, but expected a table of names and versions.")
    here = software_versions()
    others = [f"{name} {made_by[name]}" for name in COMPARED if made_by.get(name, here.get(name)) != here.get(name)]
    if others:
        now = ", ".join(f"{name} {here.get(name)}" for name in COMPARED)
        warnings.warn(
            f"{path} is of a run with {', '.join(others)}, and this is {now}: the numbers may differ.", stacklevel=2
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
    parser.add_argument("--value", **{key: each.keywords[key] for key in PARSED if key in each.keywords})
    try:
        return parser.parse_args(["--value", *map(str, words)]).value
    except argparse.ArgumentError as error:
        raise ValueError(error.message) from None
