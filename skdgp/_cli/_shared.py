"""What commands share: options and the types of their values; output, progress, and files, all or none."""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import threading
import time
import warnings
from argparse import Namespace
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from inspect import getdoc
from pathlib import Path
from typing import Any, TextIO, TypeAlias

from skdgp._compute.files import Writer, json_text, text_writer, write_together
from skdgp._compute.messages import FindingWarning, Progress
from skdgp._flight.channels import CHANNELS, REGRESSOR_SETS
from skdgp._regressor import FitCode

# Functions of commands, with their options by groups
Commands: TypeAlias = "dict[Callable, dict[str, dict[str, dict[str, Any]]]]"
TRUST = "loading runs code that is in it, so open only files that you trust"


def checked(
    expected: str, read: Callable[[str], Any], accept: Callable[[Any], bool] = lambda value: True
) -> Callable[[str], Any]:
    """Return a type of argparse that reads and checks a value; its error names the expected one."""

    def value(text: str) -> Any:
        with suppress(ValueError, OverflowError):
            result = read(text)
            if accept(result):
                return result
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}")

    return value


def number(
    expected: str = "a number",
    least: float = -math.inf,
    *keywords: str,
    kind: type = float,
) -> Callable[[str], float | str]:
    """Return the type of finite numbers from ``least`` on, or of some words."""

    def read(text: str) -> float | str:
        return text if text in keywords else kind(text)

    def accept(value: Any) -> bool:
        return value in keywords or (least <= value and math.isfinite(value))

    return checked(", or ".join([expected, *keywords]), read, accept)


def at_least(lowest: int, *keywords: str) -> Callable[[str], float | str]:
    """Return the type of whole numbers from ``lowest`` on, or of some words."""
    return number(f"a whole number, {lowest} or more", lowest, *keywords, kind=int)


def positive(unit: str, *keywords: str) -> Callable[[str], float | str]:
    """Return the type of numbers > 0, or of some words."""
    return number(f"{unit} > 0", math.nextafter(0.0, 1.0), *keywords)


def from_zero(*keywords: str) -> Callable[[str], float | str]:
    """Return the type of numbers from 0 on, or of some words."""
    return number("a number, 0 or more", 0.0, *keywords)


def _pair(text: str, separator: str, first: type = float, second: type = float) -> tuple[Any, Any]:
    before, after = text.split(separator)
    return first(before), second(after)


table_file = checked("a name that ends in .csv", str, lambda text: Path(text).suffix == ".csv")
axis_value = checked("AXIS=NUMBER such as elevator=0.4", lambda text: _pair(text, "=", str))
renaming = checked(
    "OLD=NEW, where NEW is a column of docs/notation.md without a unit (units stand in the header "
    "of the file, such as 'de [deg]')",
    lambda text: _pair(text, "=", str, str),
    lambda names: names[0] != "" and names[1] in CHANNELS,
)
size = checked(
    "a number > 0, or with its standard deviation such as 3.2+-0.05",
    lambda text: _pair(text if "+-" in text else f"{text}+-0", "+-"),
    lambda pair: 0 < pair[0] < math.inf and 0 <= pair[1] < math.inf,
)
factors = checked(
    "two numbers > 0 such as 10x5",
    lambda text: _pair(text, "x"),
    lambda pair: min(pair) > 0 and max(pair) < math.inf,
)
n_paths = checked(
    "0, or 2 or more: one path has no spread", int, lambda value: value == 0 or value >= 2
)


def regressors(text: str) -> str | list[str]:
    """Return a set of regressors by its name, or a list of columns."""
    return text if text in REGRESSOR_SETS else [name.strip() for name in text.split(",")]


# Options of every command that reads logs: how `reading` reads them
LOG: dict[str, dict[str, Any]] = {
    "--servos": {
        "metavar": "FILE",
        "help": "TOML for logs of autopilots: servos and angles, see docs/logs.md",
    },
    "--rename": {
        "metavar": "OLD=NEW",
        "nargs": "+",
        "type": renaming,
        "default": [],
        "help": "names of a flight table for columns of tables, such as de=elevator for 'de' or 'de [deg]'",
    },
    "--airborne": {
        "metavar": "V|all",
        "type": positive("m/s", "all"),
        "help": "airspeed [m/s] above which logs of autopilots are flights, or all of a log "
        "(default: estimated)",
    },
}
AXIS_VALUES: dict[str, Any] = {
    "metavar": "AXIS=X",
    "type": axis_value,
    "nargs": "+",
    "default": [],
}
# Options that several commands have, with their arguments of ``add_argument``
SHARED: dict[str, dict[str, Any]] = {
    **LOG,
    "model": {
        "metavar": "MODEL",
        "help": f"the model.joblib that identify wrote; {TRUST}",
    },
    "flight": {"metavar": "FLIGHT", "nargs": "+", "help": "flights, as of identify"},
    "--aircraft": {
        "metavar": "FILE",
        "help": "the aircraft, JSON or TOML, as with another mass (default: the model's)",
    },
    "--horizon": {
        "metavar": "S",
        "type": positive("seconds"),
        "default": 10.0,
        "help": "seconds after which simulations start again (default: 10)",
    },
    "--seed": {
        "metavar": "N",
        "type": at_least(0),
        "default": 0,
        "help": "of random numbers (default: 0)",
    },
    "--output": {"metavar": "DIR", "help": "folder for the outputs"},
    "--airspeed": {
        "metavar": "V",
        "type": positive("m/s"),
        "required": True,
        "help": "of the trim [m/s]",
    },
    "--altitude": {
        "metavar": "M",
        "type": number(),
        "default": 0.0,
        "help": "of the trim [m] (default: 0)",
    },
    "--paths": {
        "metavar": "N",
        "type": n_paths,
        "default": 200,
        "help": "aircraft of the posterior (default: 200)",
    },
    "--full": {
        **AXIS_VALUES,
        "help": "deflections [rad] at full output (default: of the aircraft file)",
    },
}
# Options of every command
COMMON: dict[str, dict[str, Any]] = {
    "--json": {"action": "store_true", "help": "print JSON instead of text"},
}


def shared(*names: str, **changes: Any) -> dict[str, dict[str, Any]]:
    """Return options that several commands have, with other arguments."""
    return {name: {**SHARED[name], **changes} for name in names}


def add_command(commands: Any, run: Callable, options: Mapping[str, Mapping[str, dict]]) -> None:
    """Add a command, whose help is the docstring of ``run``, with its options by groups."""
    parser = commands.add_parser(
        run.__name__,
        description=getdoc(run),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run, parser=parser)
    for title, group in {**options, "every command": COMMON}.items():
        target = parser.add_argument_group(title) if title else parser
        for name, keywords in group.items():
            target.add_argument(*["-o"] * (name == "--output"), name, **keywords)


def reading(options: argparse.Namespace, model: Mapping | None = None) -> dict:
    """Return the keywords of ``skdgp.io.read_flight``; surfaces of logs in the unit of the model."""
    airborne = {None: True, "all": False}.get(options.airborne, options.airborne)
    servos = options.servos
    if model is not None and servos is None:
        servos = model.get("options", {}).get("servos")
    return {"servos": servos, "airborne": airborne, "rename": dict(options.rename)}


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
        self._is_terminal = self.stream.isatty()
        self._period = period or (REFRESH if self._is_terminal else LINE_SECONDS)
        self._began = time.monotonic()
        self._stage = ""
        self._steps = ""
        self._evaluations = ""
        self._steps_began = self._began
        self._first_step = 0
        self._last_step = (0, 0)
        self._done = threading.Event()

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

    @property
    def _clear(self) -> str:
        return CLEAR if self._is_terminal else ""

    def stage(self, text: str) -> None:
        """Show the stage that begins."""
        self._began = time.monotonic()
        self._stage = text
        self._steps = ""
        self._evaluations = ""

    def end_stage(self) -> None:
        """Show no stage until the next one begins."""
        self._stage = ""
        self._write(self._clear)

    def _show_stages(self):
        while not self._done.wait(self._period):
            if self._stage:
                seconds = f"{time.monotonic() - self._began:.0f} s"
                line = f"{self._stage}{self._steps}{self._evaluations} · {seconds}"
                width = shutil.get_terminal_size().columns - 1
                self._write(CLEAR + line[:width] if self._is_terminal else f"{line}\n")

    def progress(self, stage: str, n_evaluations: int, log_likelihood: float) -> None:
        """Note the stage of an identification; the listener of ``skdgp.listening``."""
        if isinstance(stage, Progress):
            self._count_steps(stage)
        elif n_evaluations == 0:
            self.stage(stage)
        else:
            self._steps = ""
        if n_evaluations:
            self._stage = f"fit · {STAGES.get(stage, stage)}"
            self._evaluations = f" · {n_evaluations} evaluations"
            if math.isfinite(log_likelihood):
                self._evaluations += f" · log likelihood {log_likelihood:.1f}"

    def _count_steps(self, progress: Progress) -> None:
        """Keep the bar of a stage with a number of steps, and the time that is left at the rate of those done."""
        now = time.monotonic()
        done = progress.done
        if (done, progress.total) < self._last_step or self._steps == "":
            self._steps_began, self._first_step = now, done
        self._last_step = done, progress.total
        filled = round(BAR * done / progress.total)
        bar = "#" * filled + "-" * (BAR - filled)
        name = "" if progress in STAGES else f"{progress} "
        self._steps = f" · {name}[{bar}] {done} of {progress.total}"
        if done > self._first_step:
            left = (now - self._steps_began) * (progress.total - done) / (done - self._first_step)
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
        """Print a warning the first time; where it arose, if it is not meant for users."""
        finding = message.finding if isinstance(message, FindingWarning) else None
        if finding is not None and finding.code is FitCode.CONSTANT_INPUTS:
            return  # the pipeline names these regressors
        text = " ".join(str(message).split())
        if issubclass(category, RuntimeWarning):
            text += f" ({Path(filename).name}, line {lineno})"
        if text not in self.messages:
            self.messages.append(text)
            self.print_error(f"warning: {text}")


def _discard(stream) -> None:
    """Discard what a stream cannot write: at its end the interpreter would try once more, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def wrote(files: list[Path]) -> str:
    """Return the line that names written files."""
    return f"wrote {', '.join(map(str, files))}"


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
        stale: str = "",
    ) -> list[Path]:
        """Write all outputs, and numbers with the command line as a ``record`` in JSON, or none.

        Returns where they are. Where a record of this name was before, a file ``stale`` that is not
        written again is of that run, and is removed.
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
        if again and stale and stale not in writers:
            (self.folder / stale).unlink(missing_ok=True)
        return files

    def print(self, text: str, numbers: dict) -> None:
        """Print the result: text, or on request JSON."""
        record = {"command": self.command_line} | numbers
        self.console.print(json_text(record).rstrip() if self.options.json else text)
