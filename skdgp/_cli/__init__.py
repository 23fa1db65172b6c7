"""The command line, ``skdgp COMMAND``: it parses, calls and prints."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
import traceback
from contextlib import nullcontext
from difflib import get_close_matches
from importlib.metadata import version

from skdgp._cli import _fly, _learn, _write
from skdgp._cli import _options as opt
from skdgp._cli._output import Console, OutputFolder, Run

__all__ = ["main"]

DONE, FAILED, INTERRUPTED = 0, 1, 130
EXPECTED = (ValueError, TypeError, OSError, ImportError, MemoryError)
COMMANDS: opt.Commands = {**_learn.COMMANDS, **_fly.COMMANDS, **_write.COMMANDS}
DESCRIPTION = """\
Learn an aircraft's six aerodynamic coefficients from flight logs.

  skdgp demo                                     simulated example flights, nothing else needed
  skdgp inspect log.ulg                          content of a log, and what each step lacks
  skdgp identify log.ulg --mass 3.2 --span 1.6   from a log, a scale and a tape measure
  skdgp identify a.csv b.csv --aircraft uav.json -o results
  skdgp validate results/model.joblib c.csv      is the model right about another flight?
  skdgp predict results/model.joblib c.csv -o coefficients.csv
  skdgp simulate results/model.joblib --trim 35 -o flown
  skdgp derivatives results/model.joblib --airspeed 30 35 40
  skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron -o next
  skdgp export results/model.joblib --to c -o flight_code

COMMAND --help explains each. SI units and radians throughout. Exit codes: 0 done, 1 an error, in one line, 2 wrong
usage, 130 stopped by Ctrl-C.
"""


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 an error, 2 wrong usage, 130 stopped by Ctrl-C."""
    argv = sys.argv[1:] if argv is None else list(argv)
    _open_streams()
    folder: OutputFolder | None = None
    console = Console()
    try:
        with console:
            options = parse(argv)
            if (output := getattr(options, "output", None)) is not None:
                folder = OutputFolder(output, options.command == "predict")
            with folder or nullcontext():
                options.run(Run(options, console, folder, shlex.join(["skdgp", *argv])))
    except KeyboardInterrupt:
        is_written = folder is None or folder.is_written
        console.print_error("stopped" if is_written else "stopped: no output was written")
        return INTERRUPTED
    except Exception as error:
        if "--traceback" in argv:
            console.print_error(traceback.format_exc().rstrip())
        console.print_error(f"error: {_message(error)}")
        return FAILED
    return DONE


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the options of a command line; SystemExit, as of argparse, ends wrong usage."""
    options, unknown = make_parser().parse_known_args(argv)
    strange = [word for word in argv if word != word.encode(errors="replace").decode()]
    if strange:  # no record of the run could hold it
        options.parser.error(f"got {strange[0]!a}, but expected a name in UTF-8: rename it")
    if unknown:
        names = ["--" + name.replace("_", "-") for name in vars(options)]
        near = get_close_matches(unknown[0].split("=")[0], names, n=1)
        hint = f"did you mean {near[0]}?" if near else "--help lists the options"
        options.parser.error(f"unrecognized arguments {' '.join(unknown)}: {hint}")
    return options


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="skdgp",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version", action="version", version=f"skdgp {version('skdgp')}", help="the version"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for run, options in COMMANDS.items():
        opt.add_command(commands, run, options)
    return parser


def _open_streams() -> None:
    """Let standard output and error take any text in any encoding, and discard it where they are closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _message(error: Exception) -> str:
    """Return the message on one line; of the system's errors with the file's name."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, EXPECTED):
        return message
    return f"Got an unexpected {type(error).__name__}: {message}. Run again with --traceback, and report what it says."
