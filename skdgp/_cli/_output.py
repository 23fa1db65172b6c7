"""Output: results on standard output; progress, warnings and errors on standard error; files, all or none."""

from __future__ import annotations

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
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd

from skdgp._cli._options import HEAD, Command
from skdgp._compute.files import Writer, csv_writer, json_text, text_writer, write_together

CLEAR = "\r\x1b[K"
# seconds between two states of the progress line, so that a terminal is not what takes the time
PERIOD = 0.2


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
        self._lock = threading.RLock()
        self._began, self._shown = 0.0, -PERIOD
        self._evaluations: dict[str, int] = {}

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

    def stage(self, words: str) -> None:
        """Show what is being done from now on."""
        self._began = time.monotonic()
        self._show(words)

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Show the stage of an identification; the listener of ``skdgp.listening``, called from any thread."""
        if (
            self.interrupts > 1
        ):  # both ended searches of the fit; the second one shall end everything
            raise KeyboardInterrupt
        if n_evaluations == 0:
            self.stage(stage)
            return
        with self._lock:
            self._evaluations[stage] = n_evaluations
            if not self._shows_progress or time.monotonic() - self._shown < PERIOD:
                return
            if stage.startswith("output"):
                total = sum(self._evaluations.values())
                detail = f"{len(self._evaluations)} outputs, each alone · {total} evaluations"
            else:
                detail = f"all outputs together · {n_evaluations} evaluations"
                if abs(log_likelihood) < float("inf"):
                    words = "log likelihood of a part" if stage == "members" else "log likelihood"
                    detail += f" · {words} {log_likelihood:.1f}"
            self._show(f"fit · {detail} · {time.monotonic() - self._began:.0f} s")

    @contextmanager
    def counting_interrupts(self) -> Iterator[None]:
        """Count Ctrl-C: the first one ends a search, which keeps the best so far, if any; the second one everything."""
        with ctrl_c() as set_handler:
            if (
                signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
            ):  # as in the background, where it is for others
                set_handler(self._interrupt)
            yield

    def _interrupt(self, number, frame):
        self.interrupts += 1
        if self._shows_progress:  # not through the stream, which the handler may have interrupted
            words = "stopping with the best so far, if there is one yet (Ctrl-C again: at once)"
            os.write(self.stream.fileno(), f"{CLEAR}{words}".encode())
        raise KeyboardInterrupt

    def _show(self, line):
        if self._shows_progress:
            self._shown = time.monotonic()
            self._write(CLEAR + line[: shutil.get_terminal_size().columns - 1])

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time."""
        place = (
            f" ({Path(filename).name}, line {lineno})"
            if issubclass(category, RuntimeWarning)
            else ""
        )
        text = " ".join(str(message).split()) + place
        if text not in self.messages:
            self.messages.append(text)
            self._write(f"{CLEAR if self._shows_progress else ''}warning: {text}\n")

    def _write(self, text=None):
        try:
            with self._lock:
                if text is not None:  # in UTF-16 even an empty text is a mark
                    self.stream.write(text)
                self.stream.flush()
        except OSError:  # what can go on without a word goes on
            _redirect_to_null(self.stream)


def _redirect_to_null(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class OutputFolder:
    """A folder made for outputs, or that of a single table; removed again if nothing was written into it.

    The ``with`` block begins with an OSError if the folder cannot be made or written to, or if the
    configuration of the run would replace a file that no run wrote.
    """

    def __init__(self, output, is_table: bool = False):
        path = Path(output)
        self.path = path.parent if is_table else path
        self.config = self.path / (f"{path.stem}.config.toml" if is_table else "config.toml")
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
                f"written there ({reason}): "
                "name another one after -o."
            ) from error
        if self.config.is_file() and not _text(self.config).startswith(HEAD):
            raise FileExistsError(
                f"Got {str(self.config)!r}, where the configuration of this run belongs, but it "
                f"is there already and "
                "no run wrote it: name another output after -o, or move it."
            )
        return self

    def __exit__(self, kind, error, trace):
        if kind is not None:
            self._remove()

    def _remove(self):
        for path in self._made:  # innermost first
            try:
                path.rmdir()
            except OSError:  # not empty, or never made
                return

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

    command: Command
    options: Namespace
    console: Console
    folder: OutputFolder | None
    command_line: str

    def write(self, writers: dict[str, Writer]) -> list[Path]:
        """Write all outputs, and the configuration that repeats them, or none; return where they are.

        Outputs of an earlier run of the same command that this one does not write do not stay
        beside them.
        """
        if self.folder is None:
            return []
        self.console.stage("writing")
        text, config = self.command.config_text(self.options), self.folder.config
        again = config.is_file() and _text(config).startswith(text.partition("\n")[0])
        writers = writers | {config.name: text_writer(text)}
        self.folder.write(writers, self.command.outputs if again else "")
        return [self.folder.path / name for name in writers]

    def print(self, text: str, numbers: dict) -> None:
        """Print the result: text, or on request JSON."""
        self.console.print(json_text(numbers).rstrip() if self.options.json else text)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


def table_writer(table: pd.DataFrame, suffix: str) -> Writer:
    """Return what writes a table as ".csv" or ".parquet", every digit of it."""
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


def picture_writers(name: str, draw: Callable, *data, **more) -> dict[str, Writer]:
    """Return what writes the picture that ``draw`` of a display makes; nothing, and a warning, without matplotlib."""
    if find_spec("matplotlib") is None:
        warnings.warn('No picture: it needs pip install "skdgp[plot]".', stacklevel=2)
        return {}
    from matplotlib.figure import Figure

    display = draw(*data, **more, ax=Figure(layout="constrained"))
    return {name: lambda path: display.figure_.savefig(path, dpi=150)}
