"""The command line, ``skdgp COMMAND``: it parses, calls and prints."""

from __future__ import annotations

import argparse
import io
import shlex
import sys
import traceback
from importlib.metadata import version
from pathlib import Path

from skdgp._cli import _fly, _learn, _write
from skdgp._cli import _options as opt
from skdgp._cli._output import Console, Run, check_folder

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
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # any text in any encoding
            stream.reconfigure(errors="backslashreplace")
    console = Console()
    try:
        options = make_parser().parse_args(argv)
        folder = getattr(options, "output", None) and Path(options.output)
        if folder is not None:
            folder = folder.parent if options.command == "predict" else folder
            check_folder(folder)
        with console.showing_warnings():
            options.run(Run(options, console, folder, shlex.join(["skdgp", *argv])))
    except KeyboardInterrupt:
        console.print_error("stopped")
        return INTERRUPTED
    except Exception as error:
        if "--traceback" in argv:
            console.print_error(traceback.format_exc().rstrip())
        console.print_error(f"error: {_message(error)}")
        return FAILED
    return DONE


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


def _message(error: Exception) -> str:
    """Return the message on one line; of the system's errors with the file's name."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
    message = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, EXPECTED):
        return message
    return f"Got an unexpected {type(error).__name__}: {message}. Run again with --traceback, and report what it says."
