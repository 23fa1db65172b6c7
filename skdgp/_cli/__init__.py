"""The command line, ``skdgp COMMAND``: it parses, calls and prints."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
import traceback
from contextlib import nullcontext
from importlib.metadata import version

from skdgp._cli._derivatives import DERIVATIVES
from skdgp._cli._export import EXPORT
from skdgp._cli._identify import DEMO, IDENTIFY
from skdgp._cli._inspect import INSPECT
from skdgp._cli._options import PROGRAM
from skdgp._cli._output import Console, OutputFolder, Run
from skdgp._cli._plan import PLAN
from skdgp._cli._predict import PREDICT, VALIDATE
from skdgp._cli._simulate import SIMULATE

__all__ = ["main"]

DONE, FAILED, INTERRUPTED = 0, 1, 130
EXPECTED = (ValueError, TypeError, OSError, ImportError, MemoryError)
COMMANDS = {
    command.name: command
    for command in (DEMO, INSPECT, IDENTIFY, VALIDATE, PREDICT, SIMULATE, DERIVATIVES, PLAN, EXPORT)
}
DESCRIPTION = """\
Learn an aircraft's six aerodynamic coefficients from flight logs.

  skdgp demo                                     simulated example flights, nothing else needed
  skdgp inspect log.ulg                          what a log holds, and lacks for which step
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
            name = argv[0] if argv and argv[0] in COMMANDS else _parser().parse_args(argv).command
            command = COMMANDS[name]
            options = command.parse(argv[1:])
            if (output := getattr(options, "output", None)) is not None:
                folder = OutputFolder(output, command.writes_table)
            run = Run(command, options, console, folder, shlex.join([*PROGRAM.split(), *argv]))
            with folder or nullcontext():
                command.run(run)
    except KeyboardInterrupt:
        console.print_error(
            "stopped" if folder is None or folder.is_written else "stopped: no output was written"
        )
        return INTERRUPTED
    except Exception as error:
        if "--traceback" in argv:
            console.print_error(traceback.format_exc().rstrip())
        console.print_error(f"error: {_message(error)}")
        return FAILED
    return DONE


def _parser() -> argparse.ArgumentParser:
    """Return the parser of a command line that does not begin with a command."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version", action="version", version=f"skdgp {version('skdgp')}", help="the version"
    )
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help=", ".join(COMMANDS))
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
    words = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, EXPECTED):
        return words
    return f"Got an unexpected {type(error).__name__}: {words}. Run again with --traceback, and report what it says."
