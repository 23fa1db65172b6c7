"""Configuration files: the options of a command as TOML, read before the command line and written beside outputs."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import warnings
from difflib import get_close_matches
from pathlib import Path

from skdgp._cli._values import FileName
from skdgp._compute.files import read_toml
from skdgp.identification._model_file import software_versions

COMMAND, VERSIONS = "command", "versions"
NOT_KEPT = (COMMAND, "config", "output", "traceback")
MATTERS = ("skdgp", "scikit-learn", "numpy", "scipy")


HEAD = "# python -m skdgp "
CHECKSUM = "# sha256 "


def check_replaceable(path: Path) -> None:
    """Raise a FileExistsError if the configuration of a run would replace a file that no run wrote."""
    if path.is_file() and not path.read_text(encoding="utf-8", errors="replace").startswith(HEAD):
        raise FileExistsError(
            f"Got {str(path)!r}, where the configuration of this run would be kept, but it is there already and no run "
            "wrote it: name another output after -o, or move it."
        )


def config_text(options: argparse.Namespace) -> str:
    """Return all options of a run as TOML, files by their whole paths, and the versions that it ran on."""
    kept = {name: value for name, value in vars(options).items() if name not in NOT_KEPT and value is not None}
    lines = [
        f"{HEAD}{options.command} --config THIS_FILE -o ELSEWHERE runs the same again.",
        f"{COMMAND} = {_toml(options.command)}",
        *(f"{name.replace('_', '-')} = {_toml(value)}" for name, value in kept.items()),
        "",
        f"[{VERSIONS}]",
        *(f"{name} = {_toml(value)}" for name, value in software_versions().items()),
    ]
    text = "\n".join(lines) + "\n"
    return f"{text}{CHECKSUM}{_checksum(text)} of the lines above: remove this line when you change them.\n"


def _checksum(text) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _check_unchanged(path) -> None:
    """Warn of a configuration that is not as its run wrote it."""
    above, found, line = Path(path).read_text(encoding="utf-8-sig").rpartition(CHECKSUM)
    if found and line.split(" ")[0] != _checksum(above):
        warnings.warn(
            f"{path} is not as the run wrote it, which it would no longer repeat. If you changed it, remove its last "
            "line.",
            UserWarning,
            stacklevel=2,
        )


def _toml(value) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        text = os.path.abspath(value) if isinstance(value, FileName) else value
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else repr(value)


def take_config(parser: argparse.ArgumentParser, command: str, path: str) -> None:
    """Make the values of a configuration the defaults of a command's parser, which then requires them no more.

    Raises
    ------
    ValueError
        If the file is not TOML, is of another command, holds an option that the command does not know (the nearest is
        named), or a value that the option refuses.
    FileNotFoundError
        If there is no such file.
    """
    known = {_name(action): action for action in parser._actions if action.dest not in ("help", "config")}
    for key, value in _read(path, command).items():
        action = known.get(key.replace("_", "-"))
        if action is None:
            near = get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known options are {', '.join(known)}."
            raise ValueError(f"Got unknown option {key!r} in {path}: {hint}")
        try:
            action.default = _converted(parser, action, value)
        except argparse.ArgumentError as error:
            raise ValueError(f"Got {key} = {json.dumps(value, default=str)} in {path}: {error.message}.") from None
        action.required = False
        if not action.option_strings:
            action.nargs = "?" if action.nargs is None else "*"


def _name(action) -> str:
    return next((option[2:] for option in action.option_strings if option.startswith("--")), action.dest)


def _read(path, command) -> dict:
    if not Path(path).exists():
        raise FileNotFoundError(f"Got {path} as the configuration, but there is no such file.")
    values = read_toml(path)
    _check_unchanged(path)
    of = values.pop(COMMAND, command)
    if of != command:
        raise ValueError(f"Got {path}, which is of the command {of}, but the command is {command}: say {of}.")
    made_by, here = values.pop(VERSIONS, {}), software_versions()
    if not isinstance(made_by, dict):
        raise ValueError(f"Got {VERSIONS} = {made_by!r} in {path}, but expected a table of names and versions.")
    others = [f"{name} {made_by[name]}" for name in MATTERS if made_by.get(name, here.get(name)) != here.get(name)]
    if others:
        now = ", ".join(f"{name} {here.get(name)}" for name in MATTERS)
        warnings.warn(
            f"{path} is of a run with {', '.join(others)}, and this is {now}: the numbers may differ.",
            UserWarning,
            stacklevel=2,
        )
    return values


def _converted(parser, action, value):
    """Return a value of a configuration as the option would be after the same words on the command line."""
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise argparse.ArgumentError(action, "expected true or false")
        return value
    many = action.nargs is not None
    if not many and isinstance(value, list):
        value = ",".join(map(str, value))
    words = value if isinstance(value, list) else [value]
    if any(isinstance(word, bool | dict | list) for word in words):
        raise argparse.ArgumentError(action, "expected text or numbers")
    if isinstance(action.nargs, int) and len(words) != action.nargs:
        raise argparse.ArgumentError(action, f"expected {action.nargs} values")
    if action.nargs == "+" and not words and action.required:
        raise argparse.ArgumentError(action, "expected one or more")
    found = [parser._get_value(action, str(word)) for word in words]
    for one in found:
        parser._check_value(action, one)
    return found if many else found[0]
