"""Results on standard output; progress line, warnings and errors on standard error."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CLEAR = "\r\x1b[K"
PERIOD = 0.2  # seconds between two states of the progress line


class Console:
    """What a command shows; a context manager, which removes the progress line at its end."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        self.interrupts = 0
        self._is_terminal = self.stream.isatty()
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._stage, self._began, self._detail = "", time.monotonic(), ""
        self._evaluations: dict[str, int] = {}

    def __enter__(self) -> Console:
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.simplefilter("ignore")
        for category in (UserWarning, RuntimeWarning):
            warnings.simplefilter("always", category)
        warnings.showwarning = self._show_warning
        if self._is_terminal:
            self._thread = threading.Thread(target=self._refresh, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, kind, error, trace):
        self.close()
        self._warnings.__exit__(kind, error, trace)
        self._write()
        self.print()

    def close(self) -> None:
        """Remove the progress line for good."""
        if self._is_terminal and not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            self._write(CLEAR)

    def print(self, text: str | None = None) -> None:
        """Print a result, and flush standard output; raise OSError if it cannot be written."""
        self.close()
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
        """Show from now on what is being done."""
        with self._lock:
            self._stage, self._began, self._detail = words, time.monotonic(), ""

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Show the stage of an identification; the listener of ``skdgp.listening``, called from any thread."""
        if n_evaluations == 0:
            self.stage(stage)
            if self.interrupts > 1:  # both ended searches of the fit, the second one shall end everything
                raise KeyboardInterrupt
            return
        with self._lock:
            if self.interrupts == 0:
                self._stage = "fit"
            if stage.startswith("output"):
                self._evaluations[stage] = n_evaluations
                total = sum(self._evaluations.values())
                self._detail = f"{len(self._evaluations)} outputs, each alone · {total} evaluations"
            else:
                self._detail = f"all outputs together · {n_evaluations} evaluations"
                if abs(log_likelihood) < float("inf"):
                    words = "bound on the log likelihood" if stage == "bound" else "log likelihood"
                    self._detail += f" · {words} {log_likelihood:.1f}"

    @contextmanager
    def counting_interrupts(self) -> Iterator[None]:
        """Count Ctrl-C: the first one ends a fit, which keeps the best model so far, the second one everything."""
        handler = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is not threading.main_thread() or handler in (signal.SIG_IGN, None):
            yield  # started in the background, where Ctrl-C is for others
            return
        signal.signal(signal.SIGINT, self._interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)

    def _interrupt(self, number, frame):
        self.interrupts += 1
        self._stage = "interrupted: keeping the best so far (Ctrl-C again: stop)"  # no printing in a signal handler
        raise KeyboardInterrupt

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time."""
        place = f" ({Path(filename).name}, line {lineno})" if issubclass(category, RuntimeWarning) else ""
        text = " ".join(str(message).split()) + place
        with self._lock:
            if text not in self.messages:
                self.messages.append(text)
                self._write(f"{CLEAR if self._is_terminal else ''}warning: {text}\n")

    def _refresh(self):
        while not self._stop.wait(PERIOD):
            with self._lock:
                if self._stage:
                    parts = [self._stage, self._detail, f"{time.monotonic() - self._began:.0f} s"]
                    line = " · ".join(part for part in parts if part)
                    self._write(CLEAR + line[: shutil.get_terminal_size().columns - 1])

    def _write(self, text=None):
        try:
            if text is not None:  # in UTF-16 even an empty text is a mark
                self.stream.write(text)
            self.stream.flush()
        except OSError:  # what can go on without a word goes on
            _redirect_to_null(self.stream)


def _redirect_to_null(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
