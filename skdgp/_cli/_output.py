"""Output: results on standard output; progress, warnings and errors on standard error; files, all or none."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import sys
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from skdgp._compute.files import Writer, csv_writer, json_text, text_writer, write_together
from skdgp._compute.messages import warn

CLEAR = "\r\x1b[K"
PERIOD = 0.2  # seconds between two states of the progress line
STAGES = {"fit": "all outputs", "members": "components of the average"}


class Console:
    """Output of a command: one line of progress, where standard error is a terminal, and messages."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        self.interrupts = 0
        self._shows_progress = self.stream.isatty()
        self._began = time.monotonic()
        self._shown = -PERIOD

    @contextmanager
    def showing_warnings(self) -> Iterator[None]:
        """Show warnings that are meant for users, each once."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for category in (UserWarning, RuntimeWarning):
                warnings.simplefilter("always", category)
            warnings.showwarning = self._show_warning
            yield

    def print(self, text: str) -> None:
        """Print a result, and flush standard output; raise OSError if it cannot be written."""
        self.end_progress()
        try:
            print(text)
            sys.stdout.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # not to try again
            if not isinstance(error, BrokenPipeError):  # as of "skdgp ... | head"
                raise

    def print_error(self, text: str) -> None:
        """Print on standard error."""
        self.end_progress()
        print(text, file=self.stream, flush=True)

    def end_progress(self) -> None:
        """Remove the line of progress."""
        if self._shows_progress:
            print(CLEAR, end="", file=self.stream, flush=True)
            self._shows_progress = False

    def stage(self, text: str) -> None:
        """Show the stage that begins."""
        self._began = time.monotonic()
        self._show(text)

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Show the stage of an identification; the listener of ``skdgp.listening``."""
        if self.interrupts > 1:  # the first one ended the search, this one ends the command
            raise KeyboardInterrupt
        if n_evaluations == 0:
            self.stage(stage)
        elif time.monotonic() - self._shown >= PERIOD:
            value = (
                f" · log likelihood {log_likelihood:.1f}" if math.isfinite(log_likelihood) else ""
            )
            seconds = f"{time.monotonic() - self._began:.0f} s"
            name = STAGES.get(stage, stage)
            self._show(f"fit · {name} · {n_evaluations} evaluations{value} · {seconds}")

    @contextmanager
    def counting_interrupts(self) -> Iterator[None]:
        """Count Ctrl-C: the first one ends a search, which keeps the best so far, if any; the second one everything."""
        handler = signal.getsignal(signal.SIGINT)
        if handler is not signal.SIG_IGN:  # as in the background
            signal.signal(signal.SIGINT, self._interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)

    def _interrupt(self, number, frame):
        self.interrupts += 1
        if self._shows_progress:  # not through the stream, which the handler may have interrupted
            text = "stopping with the best so far, if there is one yet (Ctrl-C again: at once)"
            os.write(self.stream.fileno(), f"{CLEAR}{text}".encode())
        raise KeyboardInterrupt

    def _show(self, line):
        if self._shows_progress:
            self._shown = time.monotonic()
            width = shutil.get_terminal_size().columns - 1
            print(CLEAR + line[:width], end="", file=self.stream, flush=True)

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time; where it arose, if it is not meant for users."""
        text = " ".join(str(message).split())
        if issubclass(category, RuntimeWarning):
            text += f" ({Path(filename).name}, line {lineno})"
        if text not in self.messages:
            self.messages.append(text)
            clear = CLEAR if self._shows_progress else ""
            print(f"{clear}warning: {text}", file=self.stream, flush=True)


def check_folder(folder: Path) -> None:
    """Raise OSError if a folder for the outputs cannot be made, or nothing be written there."""
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        reason = "is read-only" if nearest.is_dir() else "is a file"
        raise OSError(
            f"Got {str(folder)!r} as the folder for the outputs, but {str(nearest)!r} {reason}: "
            f"name another one after -o."
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
        self.folder.mkdir(parents=True, exist_ok=True)
        again = (self.folder / record).is_file()
        if record:
            text = json_text({"command": self.command_line} | (numbers or {}))
            writers = writers | {record: text_writer(text)}
        write_together(self.folder, writers)
        for path in self.folder.iterdir() if again else ():
            if path.name not in writers and path.is_file() and re.fullmatch(earlier, path.name):
                path.unlink()
        return [self.folder / name for name in writers]

    def print(self, text: str, numbers: dict) -> None:
        """Print the result: text, or on request JSON."""
        record = {"command": self.command_line} | numbers
        self.console.print(json_text(record).rstrip() if self.options.json else text)


def table_writer(table: pd.DataFrame, suffix: str) -> Writer:
    """Return the writer of a table as ".csv" or ".parquet", with every digit."""
    if suffix == ".parquet":
        return lambda path: table.to_parquet(path, index=False)
    return csv_writer(table)


def picture_writers(name: str, draw: Callable, *data, **options) -> dict[str, Writer]:
    """Return the writer of a figure of a display; none, and a warning, without matplotlib."""
    if find_spec("matplotlib") is None:
        warn('No picture: it needs pip install "skdgp[plot]".', stacklevel=2)
        return {}
    from matplotlib.figure import Figure

    display = draw(*data, **options, ax=Figure(layout="constrained"))
    return {name: lambda path: display.figure_.savefig(path, dpi=150)}
