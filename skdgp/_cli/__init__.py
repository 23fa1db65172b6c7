"""The command line, ``skdgp COMMAND``: it parses, calls and prints."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from skdgp._cli import _learn, _use
from skdgp._cli._options import Commands, add_command
from skdgp._cli._shared import Console, Run

__all__ = ["main"]

DONE, FAILED, INTERRUPTED = 0, 1, 130
EXPECTED = (ValueError, TypeError, OSError, ImportError, MemoryError)
COMMANDS: Commands = {**_learn.COMMANDS, **_use.COMMANDS}
# where a command writes without being told
FOLDERS = {"identify": "skdgp-results", "demo": "skdgp-demo"}
DESCRIPTION = """\
Learn an aircraft's six aerodynamic coefficients from flight logs.

  skdgp demo                                     simulated example flights, nothing else needed
  skdgp inspect log.ulg                          content and faults of a log
  skdgp identify log.ulg --mass 3.2 --span 1.6   from a log, a scale and a tape measure
  skdgp identify a.csv b.csv --aircraft uav.json -o results
  skdgp validate results/model.joblib c.csv      is the model right about another flight?
  skdgp predict results/model.joblib c.csv -o coefficients.csv
  skdgp derivatives results/model.joblib --airspeed 30 35 40
  skdgp plan results/model.joblib --airspeed 35 --seconds 60 --axes elevator aileron -o next
  skdgp export results/model.joblib --to c -o flight_code
  skdgp margins results/model.joblib --params plane.params --airspeed 35 --full aileron=0.42 elevator=0.42
  skdgp fly results/model.joblib --airspeed 35 --full aileron=0.42 elevator=0.42 rudder=0.35

COMMAND --help explains each. SI units and radians throughout. Exit codes: 0 done, 1 an error, in one line, 2 wrong
usage, 130 stopped by Ctrl-C.
"""


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 1 an error, 2 wrong usage, 130 stopped by Ctrl-C."""
    argv = sys.argv[1:] if argv is None else list(argv)
    sys.stdout = _open(sys.stdout)
    sys.stderr = _open(sys.stderr)
    console = Console()
    try:
        with console:
            options = parse(argv)
            folder = _folder(options)
            console.stage(options.command)
            options.run(Run(options, console, folder, shlex.join(["skdgp", *argv])))
    except KeyboardInterrupt:
        console.print_error("stopped")
        return INTERRUPTED
    except BrokenPipeError:  # nobody reads any more
        return DONE
    except EXPECTED as error:
        console.print_error(f"error: {_message(error)}")
        return FAILED
    return DONE


def _folder(options: argparse.Namespace) -> Path | None:
    """Return the folder of the outputs, if any; raise OSError if it cannot be written to."""
    output = vars(options).get("output") or FOLDERS.get(options.command)
    if output is None:
        return None
    folder = Path(output).parent if options.command == "predict" else Path(output)
    nearest = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise OSError(
            f"Got {str(folder)!r} as the folder for the outputs, but {str(nearest)!r} is no folder that can be "
            "written to: name another one after -o."
        )
    return folder


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the options of a command line; SystemExit, as of argparse, ends wrong usage."""
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
        add_command(commands, run, options)
    return parser.parse_args(argv)


def _open(stream: Any) -> Any:
    """Let a stream take any text in any encoding; return one that discards it in place of a closed one."""
    if stream is None:
        return open(os.devnull, "w", encoding="utf-8")
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="backslashreplace")
    return stream


def _message(error: Exception) -> str:
    """Return the message on one line; of the system's errors with the file's name."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
    return " ".join(str(error).split()) or type(error).__name__
