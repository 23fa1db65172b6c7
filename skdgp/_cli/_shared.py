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
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from inspect import getdoc
from pathlib import Path
from typing import Any, TextIO, TypeAlias

from skdgp._compute.files import Writer, json_text, text_writer, write_together
from skdgp._compute.messages import FindingWarning, Progress
from skdgp._flight.channels import REGRESSOR_SETS
from skdgp._regressor import FitCode

Option: TypeAlias = tuple[tuple[str, ...], dict[str, Any]]
# Functions of commands, with their options by groups
Commands: TypeAlias = dict[Callable, dict[str, list[Option]]]
TRUST = "loading runs code that is in it, so open only files that you trust"


def option(*names: str, **keywords: Any) -> Option:
    """Return an option of a command, with the arguments of ``add_argument``."""
    return names, keywords


def changed(known: Option, **keywords: Any) -> Option:
    """Return an option with other arguments."""
    names, arguments = known
    return names, arguments | keywords


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
    least: float = -math.inf, *words: str, kind: type = float
) -> Callable[[str], float | str]:
    """Return the type of finite numbers that are not below ``least``, or of some words."""
    bound = "" if least == -math.inf else f" >= {least:g}"
    expected = f"a {'whole number' if kind is int else 'number'}{bound}"
    return checked(
        ", or ".join([expected, *words]),
        lambda text: text if text in words else kind(text),
        lambda value: value in words or least <= float(value) < math.inf,
    )


def _pair(text: str, separator: str, first: type = float, second: type = float) -> tuple[Any, Any]:
    before, after = text.split(separator)
    return first(before), second(after)


table_file = checked("a name that ends in .csv", str, lambda text: Path(text).suffix == ".csv")
axis_value = checked("AXIS=NUMBER such as elevator=0.4", lambda text: _pair(text, "=", str))
renaming = checked("OLD=NEW such as de=elevator", lambda text: _pair(text, "=", str, str))
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
POSITIVE = checked("a number > 0", float, lambda value: 0 < value < math.inf)
n_paths = checked(
    "0, or 2 or more: one path has no spread", int, lambda value: value >= 0 and value != 1
)


def regressors(text: str) -> str | list[str]:
    """Return a set of regressors by its name, or a list of columns."""
    return text if text in REGRESSOR_SETS else [name.strip() for name in text.split(",")]


# Options that several commands have. `reading` reads logs by these:
LOG = [
    option(
        "--servos",
        help="TOML for logs of autopilots: servos and angles, see docs/logs.md",
    ),
    option(
        "--rename",
        metavar="OLD=NEW",
        nargs="+",
        type=renaming,
        default=[],
        help="names of a flight table for columns of tables, such as de=elevator for 'de' or 'de [deg]'",
    ),
    option(
        "--airborne",
        metavar="V|all",
        type=number(0.0, "all"),
        help="airspeed [m/s] above which logs of autopilots are flights, or all of a log "
        "(default: estimated)",
    ),
]
MODEL = option("model", metavar="MODEL", help=f"the model.joblib that identify wrote; {TRUST}")
FLIGHT = option("flight", metavar="FLIGHT", nargs="+", help="flights, as of identify")
AIRCRAFT = option(
    "--aircraft",
    help="the aircraft, JSON or TOML, as with another mass (default: the model's)",
)
HORIZON = option(
    "--horizon",
    type=POSITIVE,
    default=10.0,
    help="seconds after which simulations start again (default: 10)",
)
SEED = option("--seed", type=number(0, kind=int), default=0, help="of random numbers (default: 0)")
OUTPUT = option("-o", "--output", help="folder for the outputs")
AIRSPEED = option("--airspeed", type=POSITIVE, required=True, help="of the trim [m/s]")
ALTITUDE = option("--altitude", type=number(), default=0.0, help="of the trim [m] (default: 0)")
PATHS = option(
    "--paths",
    type=n_paths,
    default=200,
    help="aircraft of the posterior (default: 200)",
)
FULL = option(
    "--full",
    metavar="AXIS=X",
    type=axis_value,
    nargs="+",
    default=[],
    help="deflections [rad] at full output (default: of the aircraft file)",
)
# of every command
JSON = option("--json", action="store_true", help="print JSON instead of text")


def add_command(commands: Any, run: Callable, groups: Mapping[str, Sequence[Option]]) -> None:
    """Add a command, whose help is the docstring of ``run``, with its options by groups."""
    parser = commands.add_parser(
        run.__name__,
        description=getdoc(run),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run, parser=parser)
    for title, options in {**groups, "every command": [JSON]}.items():
        target = parser.add_argument_group(title) if title else parser
        for names, keywords in options:
            target.add_argument(*names, **keywords)


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
