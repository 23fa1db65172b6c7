"""Output: results on standard output; progress, warnings and errors on standard error; files, all or none."""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
import time
import warnings
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from skdgp._compute.files import Writer, json_text, text_writer, write_together

CLEAR = "\r\x1b[K"
PERIOD = 0.2  # seconds between two states of the progress line
STAGES = {"fit": "all outputs", "members": "components of the average"}


class Console:
    """Output of a command; a context manager, which removes the progress line at its end."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        self._shows_progress = self.stream.isatty()
        self._began = time.monotonic()
        self._shown = -PERIOD

    def __enter__(self) -> Console:
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.simplefilter("ignore")
        for category in (UserWarning, RuntimeWarning):
            warnings.simplefilter("always", category)
        warnings.showwarning = self._show_warning
        return self

    def __exit__(self, kind, error, trace):
        self._warnings.__exit__(kind, error, trace)
        self._end_progress()

    def print(self, text: str) -> None:
        """Print a result; raise OSError if it cannot be written."""
        self._end_progress()
        try:
            print(text, flush=True)
        except OSError:
            _discard(sys.stdout)
            raise

    def print_error(self, text: str) -> None:
        """Print a line on standard error, where it can be written."""
        self._write(f"{text}\n")

    def stage(self, text: str) -> None:
        """Show the stage that begins."""
        self._began = time.monotonic()
        self._show(text)

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Show the stage of an identification; the listener of ``skdgp.listening``."""
        if n_evaluations == 0:
            self.stage(stage)
        elif time.monotonic() - self._shown >= PERIOD:
            value = (
                f" · log likelihood {log_likelihood:.1f}" if math.isfinite(log_likelihood) else ""
            )
            seconds = f"{time.monotonic() - self._began:.0f} s"
            name = STAGES.get(stage, stage)
            self._show(f"fit · {name} · {n_evaluations} evaluations{value} · {seconds}")

    def _show(self, line):
        if self._shows_progress:
            self._shown = time.monotonic()
            self._write(CLEAR + line[: shutil.get_terminal_size().columns - 1])

    def _end_progress(self):
        if self._shows_progress:
            self._write(CLEAR)
            self._shows_progress = False

    def _write(self, text):
        try:
            self.stream.write(text)
            self.stream.flush()
        except OSError:  # the command continues without the message
            _discard(self.stream)

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time; where it arose, if it is not meant for users."""
        text = " ".join(str(message).split())
        if issubclass(category, RuntimeWarning):
            text += f" ({Path(filename).name}, line {lineno})"
        if text not in self.messages:
            self.messages.append(text)
            self.print_error(f"{CLEAR if self._shows_progress else ''}warning: {text}")


def _discard(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def check_folder(folder: Path) -> None:
    """Raise OSError if outputs cannot be written into a folder, which need not exist."""
    nearest = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise OSError(
            f"Got {str(folder)!r} as the folder for the outputs, but {str(nearest)!r} is no folder "
            f"that can be written to: name another one after -o."
        )


@dataclass(frozen=True)
class Run:
    """A running command; ``folder`` is None where nothing is to be written."""

    options: Namespace
    console: Console
    folder: Path | None
    command_line: str

    def write(
        self,
        writers: dict[str, Writer],
        record: str = "",
        numbers: dict | None = None,
        earlier: str = "",
    ) -> list[Path]:
        """Write all outputs, and numbers with the command line as a ``record`` in JSON, or none.

        Returns where they are. Where a record of this name was before, other files whose whole
        names match ``earlier`` are of that run, and are removed.
        """
        if self.folder is None:
            return []
        self.console.stage("writing")
        again = (self.folder / record).is_file()
        if record:
            text = json_text({"command": self.command_line} | (numbers or {}))
            writers = writers | {record: text_writer(text)}
        files = [self.folder / name for name in writers]
        for path in files:
            path.parent.mkdir(parents=True, exist_ok=True)
        write_together(self.folder, writers)
        for path in self.folder.iterdir() if again else ():
            if path not in files and path.is_file() and re.fullmatch(earlier, path.name):
                path.unlink()
        return files

    def print(self, text: str, numbers: dict) -> None:
        """Print the result: text, or on request JSON."""
        record = {"command": self.command_line} | numbers
        self.console.print(json_text(record).rstrip() if self.options.json else text)
