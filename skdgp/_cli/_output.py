"""Output: results on standard output; progress, warnings and errors on standard error; files, all or none."""

from __future__ import annotations

import math
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd

from skdgp._compute.files import Writer, csv_writer, json_text, text_writer, write_together
from skdgp._compute.messages import warn

CLEAR = "\r\x1b[K"
PERIOD = 0.2  # seconds between two states of the progress line
STAGES = {"fit": "all outputs", "members": "components of the average"}


@contextmanager
def ctrl_c() -> Iterator[Callable[[Any], object]]:
    """Yield a function that sets what Ctrl-C does until the end of the block; it does nothing off the main thread."""
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or handler is None:
        yield lambda new: None
        return
    try:
        yield lambda new: signal.signal(signal.SIGINT, new)
    finally:
        signal.signal(signal.SIGINT, handler)


class Console:
    """Output of a command; a context manager, which removes the progress line at its end."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        self.interrupts = 0
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
        self._write()
        self.print()

    def print(self, text: str | None = None) -> None:
        """Print a result, and flush standard output; raise OSError if it cannot be written."""
        if self._shows_progress:
            self._write(CLEAR)
            self._shows_progress = False
        try:
            if text is not None:
                print(text)
            sys.stdout.flush()
        except BrokenPipeError:  # nobody reads any more
            _redirect_to_null(sys.stdout)
        except OSError as error:
            _redirect_to_null(sys.stdout)
            raise OSError(error.errno, error.strerror, "standard output") from error

    def print_error(self, text: str) -> None:
        """Print on standard error, where it is open."""
        self._write(f"{text}\n")

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
        with ctrl_c() as set_handler:
            if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as in the background
                set_handler(self._interrupt)
            yield

    def _interrupt(self, number, frame):
        self.interrupts += 1
        if self._shows_progress:  # not through the stream, which the handler may have interrupted
            text = "stopping with the best so far, if there is one yet (Ctrl-C again: at once)"
            os.write(self.stream.fileno(), f"{CLEAR}{text}".encode())
        raise KeyboardInterrupt

    def _show(self, line):
        if self._shows_progress:
            self._shown = time.monotonic()
            self._write(CLEAR + line[: shutil.get_terminal_size().columns - 1])

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time; where it arose, if it is not meant for users."""
        text = " ".join(str(message).split())
        if issubclass(category, RuntimeWarning):
            text += f" ({Path(filename).name}, line {lineno})"
        if text not in self.messages:
            self.messages.append(text)
            self._write(f"{CLEAR if self._shows_progress else ''}warning: {text}\n")

    def _write(self, text=None):
        try:
            if text is not None:  # in UTF-16 even an empty text is a mark
                self.stream.write(text)
            self.stream.flush()
        except OSError:  # the command continues without the message
            _redirect_to_null(self.stream)


def _redirect_to_null(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class OutputFolder:
    """The folder of the outputs, or of a single table; if it was made for them and stays empty, it is removed.

    The ``with`` block begins with an OSError if the folder cannot be made or written to.
    """

    def __init__(self, output, is_table: bool = False):
        self.path = Path(output).parent if is_table else Path(output)
        self.is_written = False

    def __enter__(self) -> OutputFolder:
        self._made = [p for p in (self.path, *self.path.parents) if not p.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            self._remove()
            reason = "it is a file" if self.path.is_file() else error.strerror
            raise OSError(
                f"Got {str(self.path)!r} as the folder for the outputs, but nothing can be "
                f"written there ({reason}): name another one after -o."
            ) from error
        return self

    def __exit__(self, kind, error, trace):
        if kind is not None:
            self._remove()

    def _remove(self):
        for path in self._made:  # innermost first
            with suppress(OSError):  # not empty, or never made
                path.rmdir()

    def write(self, writers: dict[str, Writer], earlier: str = "") -> None:
        """Write all files or none, then remove others whose whole names match ``earlier``.

        Once all are complete, Ctrl-C waits until they are in their places.
        """
        with ctrl_c() as set_handler:
            write_together(self.path, writers, lambda: set_handler(signal.SIG_IGN))
            self.is_written = True
            for path in self.path.iterdir():
                if path.name not in writers and path.is_file() and re.fullmatch(earlier, path.name):
                    path.unlink()


@dataclass(frozen=True)
class Run:
    """A running command; ``folder`` is None where nothing is to be written."""

    options: Namespace
    console: Console
    folder: OutputFolder | None
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
        again = (self.folder.path / record).is_file()
        if record:
            text = json_text({"command": self.command_line} | (numbers or {}))
            writers = writers | {record: text_writer(text)}
        self.folder.write(writers, earlier if again else "")
        return [self.folder.path / name for name in writers]

    def print(self, text: str, numbers: dict) -> None:
        """Print the result: text, or on request JSON."""
        record = {"command": self.command_line} | numbers
        self.console.print(json_text(record).rstrip() if self.options.json else text)


def table_writer(table: pd.DataFrame, suffix: str) -> Writer:
    """Return the writer of a table as ".csv" or ".parquet", with every digit."""
    if suffix == ".parquet":
        return lambda path: table.to_parquet(path, index=False)
    return csv_writer(table)


def check_writable(suffix: str) -> None:
    """Raise ImportError if tables of this suffix cannot be written here."""
    if suffix == ".parquet" and find_spec("pyarrow") is None:
        raise ImportError(
            'Parquet needs pyarrow, which is not installed: pip install "skdgp[parquet]", or '
            "write CSV."
        )


def picture_writers(name: str, draw: Callable, *data, **options) -> dict[str, Writer]:
    """Return the writer of a figure of a display; none, and a warning, without matplotlib."""
    if find_spec("matplotlib") is None:
        warn('No picture: it needs pip install "skdgp[plot]".', stacklevel=2)
        return {}
    from matplotlib.figure import Figure

    display = draw(*data, **options, ax=Figure(layout="constrained"))
    return {name: lambda path: display.figure_.savefig(path, dpi=150)}
