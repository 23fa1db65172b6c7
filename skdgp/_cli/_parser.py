"""The argument parser, which also reads a configuration file."""

from __future__ import annotations

import argparse
from difflib import get_close_matches
from importlib.metadata import version

from skdgp._cli import _help as words
from skdgp._cli._config import take_config
from skdgp._cli._options import COMMANDS
from skdgp._cli._values import FileName


class Parser(argparse.ArgumentParser):
    """A parser whose options stand in full, and that names the nearest to an unknown one.

    That of a command takes its files in any order with the options, and what ``--config`` holds for its defaults.
    """

    _within = False

    def parse_known_args(self, args=None, namespace=None):
        """Parse, but refuse unknown options before anything else is found wrong."""
        is_command = not any(action.dest == "command" for action in self._actions)
        if not is_command or self._within:
            return super().parse_known_args(args, namespace)
        self._refuse_unknown(args)
        for place, word in enumerate(args):
            if word.split("=")[0] == "--config" and (path := [*word.split("=", 1)[1:], *args[place + 1 :]]):
                take_config(self, self.prog.split()[-1], path[0])
        self._within = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._within = False

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
    parser = _parser(Parser, prog="python -m skdgp", description=words.DESCRIPTION)
    parser.add_argument(
        "--version", action="version", version=f"skdgp {version('skdgp')}", help="the version, and exit"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (add_options, said, description, epilog) in COMMANDS.items():
        command = _parser(commands.add_parser, name, help=said, description=description, epilog=epilog)
        add_options(command)
        command.add_argument("--json", action="store_true", help="print JSON instead of text")
        command.add_argument(
            "--config", type=FileName, metavar="FILE", help="TOML with options by name; words here win over it"
        )
        command.add_argument("--traceback", action="store_true", help="on an error also show where it arose")
    return parser


def _parser(make, *args, **kwargs):
    return make(*args, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **kwargs)
