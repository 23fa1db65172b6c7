"""From words on the command line to an exit code."""

from __future__ import annotations

import os
import shlex
import sys
import traceback
from contextlib import nullcontext

from skdgp._checkpoint import checkpointing
from skdgp._cli._console import Console
from skdgp._cli._folder import OutputFolder
from skdgp._cli._inspect import inspect
from skdgp._cli._job import run
from skdgp._cli._parser import build_parser
from skdgp._cli._source import example_source, file_source

DONE, FAILED, INTERRUPTED = 0, 1, 130
CHECKPOINT = "checkpoint"  # in the folder of the outputs, while these are made
OPTIONS = {
    "thrust=None": "--thrust none",
    "thin_targets(": "--samples 755",
    "inference='sparse'": "--inference sparse",
}
"""What remedies of the library are called here."""


def main(argv=None) -> int:
    """Run one command and return its exit code: 0 done, 1 an error, 2 wrong usage, 130 stopped by Ctrl-C."""
    argv = sys.argv[1:] if argv is None else list(argv)
    options = build_parser().parse_args(argv)
    console = Console()
    folder = OutputFolder(options.output) if "output" in options else nullcontext()
    try:
        with console, folder:
            if options.command == "inspect":
                console.stage("reading")
                said = inspect(options)
                console.close()
                print(said)
                return DONE
            console.stage("flying the example flights" if options.command == "demo" else "reading")
            source = example_source() if options.command == "demo" else file_source(options)
            with checkpointing(folder.path / CHECKPOINT):
                run(source, options, folder, console, command=shlex.join(["python", "-m", "skdgp", *argv]))
    except KeyboardInterrupt:
        print(_stopped(folder), file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output is gone; our files are written
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except (ValueError, TypeError, OSError, ImportError, MemoryError) as error:
        if options.traceback:
            traceback.print_exc()
        print(f"error: {_words(error)}", file=sys.stderr)
        return FAILED
    return DONE


def _stopped(folder) -> str:
    """Return what is said at the end by Ctrl-C."""
    if getattr(folder, "written", True):
        return "stopped"
    words = "stopped: no output was written"
    return f"{words}; run again, the fit goes on where it was" if (folder.path / CHECKPOINT).exists() else words


def _words(error: Exception) -> str:
    """Return the message on one line, its remedies as options; the system's own errors with the name of the file."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or ''}: {error.strerror}".removeprefix(": ")
    words = " ".join(str(error).split()) or type(error).__name__
    options = [option for code, option in OPTIONS.items() if code in words]
    return f"{words} On the command line: {', '.join(options)}." if options else words
