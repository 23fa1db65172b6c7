"""The entry point: arguments in, exit code out."""

from __future__ import annotations

import io
import os
import shlex
import sys
import traceback
from contextlib import nullcontext
from pathlib import Path

from skdgp._cli._config import check_replaceable
from skdgp._cli._console import Console
from skdgp._cli._derivatives import derivatives
from skdgp._cli._folder import OutputFolder
from skdgp._cli._inspect import inspect
from skdgp._cli._job import CHECKPOINT, demo, identify
from skdgp._cli._parser import build_parser
from skdgp._cli._predict import predict
from skdgp._cli._simulate import fly
from skdgp._cli._task import Task
from skdgp._cli._validate import validate

DONE, FAILED, INTERRUPTED = 0, 1, 130
EXPECTED = (ValueError, TypeError, OSError, ImportError, MemoryError)
COMMANDS = {
    "demo": demo,
    "inspect": inspect,
    "identify": identify,
    "validate": validate,
    "predict": predict,
    "simulate": fly,
    "derivatives": derivatives,
}
OPTIONS = {
    "thrust=None": "--thrust none",
    "thin_targets(": "--samples 755",
    "inference='sparse'": "--inference sparse",
    "airborne=False": "--airborne all or --airborne 6",
}
"""What remedies of the library are called here."""


def main(argv=None) -> int:
    """Run one command and return its exit code: 0 done, 1 an error, 2 wrong usage, 130 stopped by Ctrl-C."""
    argv = sys.argv[1:] if argv is None else list(argv)
    _open_streams()
    folder, console = None, Console()
    try:
        with console:
            options = build_parser().parse_args(argv)
            folder = _folder(options)
            task = Task(options, console, folder, shlex.join(["python", "-m", "skdgp", *argv]))
            with folder or nullcontext():
                if folder is not None:
                    check_replaceable(folder.path / task.config)
                COMMANDS[options.command](task)
    except KeyboardInterrupt:
        console.print_error(_stopped(folder))
        return INTERRUPTED
    except Exception as error:
        if "--traceback" in argv:
            console.print_error(traceback.format_exc().rstrip())
        console.print_error(f"error: {_words(error)}")
        return FAILED
    return DONE


def _open_streams():
    """Let standard output and error take any text in any encoding, and none where they are closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _folder(options) -> OutputFolder | None:
    """Return the folder that the command writes to: the one of its table, where it writes a single one."""
    output = getattr(options, "output", None)
    if output is None:
        return None
    return OutputFolder(Path(output).parent if options.command == "predict" else output)


def _stopped(folder) -> str:
    """Return what is said at the end by Ctrl-C."""
    if folder is None or folder.written:
        return "stopped"
    words = "stopped: no output was written"
    return f"{words}; run again, the fit goes on where it was" if (folder.path / CHECKPOINT).exists() else words


def _words(error: Exception) -> str:
    """Return the message on one line, its remedies as options; the system's own errors with the name of the file."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
    words = " ".join(str(error).split()) or type(error).__name__
    if not isinstance(error, EXPECTED):
        return (
            f"Got an unexpected {type(error).__name__}: {words}. Run again with --traceback, and report what it says."
        )
    options = [option for code, option in OPTIONS.items() if code in words]
    return f"{words} On the command line: {', '.join(options)}." if options else words
