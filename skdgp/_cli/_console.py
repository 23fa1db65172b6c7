"""Results on standard output; progress line, warnings and errors on standard error."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CLEAR = "\r\x1b[K"
PERIOD = 0.2  # seconds between two states of the progress line, so that a terminal is not what takes the time


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
        if self.interrupts > 1:  # both ended searches of the fit; the second one shall end everything
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
            if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as in the background, where it is for others
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
        place = f" ({Path(filename).name}, line {lineno})" if issubclass(category, RuntimeWarning) else ""
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
