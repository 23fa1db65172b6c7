"""What commands share: output, progress, and files, all or none."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
import warnings
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from skdgp._compute.files import Writer, json_text, text_writer, write_together
from skdgp._compute.messages import FindingWarning, Progress
from skdgp._regressor import FitCode

CLEAR = "\r\x1b[K"
BAR = 10  # characters
LINE_SECONDS = 5.0  # between two lines of progress without a terminal
REFRESH = 0.2  # the same on a terminal
STAGES = {"fit": "all outputs", "members": "components of the average"}


class Console:
    """Output of a command; a context manager, which removes the progress line at its end.

    A thread shows the stage with its seconds: on a terminal in one line, else in a line every five seconds.
    """

    def __init__(self, stream: TextIO | None = None, period: float | None = None) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.messages: list[str] = []
        is_terminal = self.stream.isatty()
        self._clear = CLEAR if is_terminal else ""
        self._period = period or (REFRESH if is_terminal else LINE_SECONDS)
        self._done = threading.Event()
        self._first_step = Progress("", 0, 0)
        self._first_time = 0.0
        self.stage("")

    def __enter__(self) -> Console:
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.simplefilter("ignore")
        for category in (UserWarning, RuntimeWarning):
            warnings.simplefilter("always", category)
        warnings.showwarning = self._show_warning
        threading.Thread(target=self._show_stages, daemon=True).start()
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
        self._write(f"{self._clear}{text}\n")

    def stage(self, text: str) -> None:
        """Show the stage that begins, none of an empty text."""
        self._began = time.monotonic()
        self._stage = text
        self._steps = ""

    def _show_stages(self):
        while not self._done.wait(self._period):
            if self._stage:
                seconds = time.monotonic() - self._began
                line = f"{self._stage}{self._steps} · {seconds:.0f} s"
                width = shutil.get_terminal_size().columns - 1
                self._write(CLEAR + line[:width] if self._clear else f"{line}\n")

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Note the stage of an identification; the listener of ``skdgp.listening``."""
        if isinstance(stage, Progress):
            self._count_steps(stage)
        else:
            self.stage(stage)
        if n_evaluations:
            self._stage = "fit"

    def _count_steps(self, step: Progress) -> None:
        """Keep the bar of a stage with a number of steps, and the time that is left at the rate of those done."""
        now = time.monotonic()
        if step != self._first_step or step.done <= self._first_step.done:
            self._first_step = step
            self._first_time = now
        bar = ("#" * round(BAR * step.done / step.total)).ljust(BAR, "-")
        self._steps = f" · {STAGES.get(step, step)} [{bar}] {step.done} of {step.total}"
        counted = step.done - self._first_step.done
        if counted:
            left = (now - self._first_time) * (step.total - step.done) / counted
            self._steps += f", about {left:.0f} s left"

    def _end_progress(self):
        if not self._done.is_set():
            self._done.set()
            self._write(self._clear)

    def _write(self, text):
        try:
            self.stream.write(text)
            self.stream.flush()
        except OSError:  # the command continues without the message
            _discard(self.stream)

    def _show_warning(self, message, category, filename, lineno, file=None, line=None):
        """Print a warning the first time."""
        finding = message.finding if isinstance(message, FindingWarning) else None
        if finding is not None and finding.code is FitCode.CONSTANT_INPUTS:
            return  # the pipeline names these regressors
        text = " ".join(str(message).split())
        if text not in self.messages:
            self.messages.append(text)
            self.print_error(f"warning: {text}")


def _discard(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@dataclass(frozen=True)
class Run:
    """A running command; ``folder`` is None where nothing is to be written."""

    options: Namespace
    console: Console
    folder: Path | None
    command_line: str

    def finish(
        self,
        lines: list[str],
        numbers: dict[str, Any],
        files: Mapping[str, Writer],
        record: str = "",
    ) -> None:
        """Write files into the folder, if there is one, all or none, and print the result with their names.

        The numbers are one more file in JSON, of the name ``record``.
        """
        if self.folder is not None:
            writers = dict(files)
            if record:
                writers[record] = text_writer(self._json(numbers))
            write_together(self.folder, writers)
            names = ", ".join(str(self.folder / name) for name in writers)
            lines = [*lines, f"wrote {names}"]
        self.print(lines, numbers)

    def print(self, lines: list[str], numbers: dict[str, Any]) -> None:
        """Print the result: lines of text, or on request numbers in JSON."""
        text = self._json(numbers) if self.options.json else "\n".join(lines)
        self.console.print(text.rstrip())

    def _json(self, numbers: dict[str, Any]) -> str:
        return json_text({"command": self.command_line} | numbers)
