"""Progress line and warnings on standard error."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
import time
import warnings
from contextlib import contextmanager
from pathlib import Path

SHOWN = (UserWarning, RuntimeWarning)
CLEAR = "\r\x1b[K"
PERIOD = 0.2
"""Seconds between two states of the line."""


class Console:
    """Progress and warnings on standard error; used as a context manager, which clears the line at its end."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        self.interrupts = 0
        self._live = self.stream.isatty()
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._stage, self._began, self._detail, self._alone = "", time.monotonic(), "", {}

    def __enter__(self) -> Console:
        self._catching = warnings.catch_warnings()
        self._catching.__enter__()
        warnings.simplefilter("ignore")
        for category in SHOWN:
            warnings.simplefilter("always", category)
        warnings.showwarning = self._show
        if self._live:
            self._ticker = threading.Thread(target=self._tick, daemon=True)
            self._ticker.start()
        return self

    def __exit__(self, kind, error, trace):
        self.close()
        self._catching.__exit__(kind, error, trace)
        self._write()
        self.print()

    def close(self) -> None:
        """Take the line away for good."""
        if self._live and not self._stop.is_set():
            self._stop.set()
            self._ticker.join()
            self._write(CLEAR)

    def print(self, text: str | None = None) -> None:
        """Print a result on standard output, and what waits there; raise an OSError if it cannot be written."""
        self.close()
        try:
            if text is not None:
                print(text)
            sys.stdout.flush()
        except BrokenPipeError:  # nobody reads any more
            _give_up(sys.stdout)
        except OSError as error:
            _give_up(sys.stdout)
            raise OSError(error.errno, error.strerror, "standard output") from error

    def print_error(self, text: str) -> None:
        """Print on standard error, where it is open."""
        self._write(f"{text}\n")

    def _show(self, message, category, filename, lineno, file=None, line=None):
        where = f" ({Path(filename).name}, line {lineno})" if issubclass(category, RuntimeWarning) else ""
        self.warn(str(message) + where)

    def stage(self, words: str) -> None:
        """Say what is being done from now on."""
        with self._lock:
            self._stage, self._began, self._detail = words, time.monotonic(), ""

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Show where a fit is; the listener of ``skdgp._compute.progress.listening``, called from any thread."""
        with self._lock:
            if stage.startswith("output"):
                self._alone[stage] = n_evaluations
                self._detail = f"{len(self._alone)} outputs, each alone · {sum(self._alone.values())} evaluations"
            else:
                self._detail = f"all outputs together · {n_evaluations} evaluations"
                if abs(log_likelihood) < float("inf"):
                    words = "bound on the log likelihood" if stage == "bound" else "log likelihood"
                    self._detail += f" · {words} {log_likelihood:.1f}"

    def warn(self, message: str) -> None:
        """Print a warning the first time, and keep it for the report."""
        message = " ".join(message.split())
        with self._lock:
            if message not in self.messages:
                self.messages.append(message)
                self._write(f"{CLEAR if self._live else ''}warning: {message}\n")

    @contextmanager
    def keeping_the_best(self):
        """Let the first Ctrl-C end the fit with the best model so far, and the second one end everything."""
        if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) in (
            signal.SIG_IGN,  # started in the background, where Ctrl-C is not ours
            None,
        ):
            yield
            return
        before = signal.signal(signal.SIGINT, self._interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        if self.interrupts > 1:
            raise KeyboardInterrupt

    def _interrupt(self, number, frame):
        self.interrupts += 1
        self._stage = "interrupted: keeping the best so far (Ctrl-C again: stop)"  # no printing in a signal handler
        raise KeyboardInterrupt

    def _tick(self):
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
        except OSError:  # no reason to end what can go on in silence
            _give_up(self.stream)


def _give_up(stream) -> None:
    """Throw away what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
