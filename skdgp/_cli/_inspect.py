"""The command ``inspect``: what a log holds, its lags, and a template of its servo file."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from skdgp._cli import _options as opt
from skdgp._cli._output import Run
from skdgp._compute.files import text_writer, write_atomically
from skdgp._compute.messages import without_warnings
from skdgp.io import inspect_log, read_flight, servo_template
from skdgp.preprocessing import LagCorrector


def inspect(run: Run) -> None:
    """Print what a log holds: vehicle, firmware, topics with rates and gaps, columns of its flight table, flights.

    And what is missing for coefficients, reconstruction, regressors, replay; which channels
    contradict physics (a wrong sign, unit or axis); and how late air data, surfaces, attitude and
    GPS are against the inertial unit (identify corrects them).

    LOG is a PX4 ULog (.ulg), an ArduPilot DataFlash log (.bin), or a table (.csv, .parquet, .mat).

    For example:
      skdgp inspect log.ulg
      skdgp inspect log.bin --servo-template servo.toml
    """
    options = run.options
    run.console.stage("reading")
    summary = inspect_log(options.log, servos=options.servos, rename=dict(options.rename))
    if options.servo_template is not None:
        path, text = Path(options.servo_template), servo_template(options.log)
        if path.exists():
            raise FileExistsError(
                f"Got {str(path)!r} for the servo template, but it is there already: name another "
                f"one."
            )
        write_atomically(path, text_writer(text))
    run.console.stage("estimating lags")
    lags, why = _lags(options) if len(summary.flights) else (None, "there is no flight")
    lines = [
        "",
        "  lags              "
        + (f"not estimated: {why}" if lags is None else "seconds, positive where late"),
    ]
    for name, row in {} if lags is None else lags.iterrows():
        is_estimated = row["std"] == row["std"]  # not NaN
        value = f"{row['lag']:>z8.3f} +- {row['std']:.3f} s  " if is_estimated else " " * 20
        lines.append(f"    {name:<16}{value}{row['remark']}")
    numbers = summary.to_dict() | {"lags": None if lags is None else lags.to_dict("index")}
    run.print("\n".join([str(summary), *lines]), numbers)


def _lags(options) -> tuple[pd.DataFrame | None, str]:
    """Return the lags of a log, or None and why they cannot be estimated."""
    with without_warnings():  # the summary shows them
        try:
            table = read_flight(options.log, servos=options.servos, rename=dict(options.rename))
            return LagCorrector().fit(table).lags_, ""
        except ValueError as error:
            return None, str(error)


COMMANDS: opt.Commands = {
    inspect: {
        "": {
            "log": {"metavar": "LOG", "help": "the log"},
            "--servos": opt.SHARED["--servos"],
            "--rename": opt.SHARED["--rename"],
            "--servo-template": {
                "metavar": "FILE",
                "help": "write such a file for this log, to be filled in with the angles",
            },
        },
    },
}
