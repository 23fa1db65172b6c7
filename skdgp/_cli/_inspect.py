"""The command ``inspect``: what a log holds, and a template of its servo file."""

from __future__ import annotations

from pathlib import Path

from skdgp._cli._task import Task
from skdgp._compute.files import write_atomically
from skdgp.io import inspect_log, servo_template


def inspect(task: Task) -> None:
    """Print what a log holds; write a template of its servo file where one is asked for.

    Raises
    ------
    ValueError, OSError
        If the log or the servo file cannot be read, or the template would replace a file.
    """
    options = task.options
    task.console.stage("reading")
    summary = inspect_log(options.log, servos=options.servos)
    if options.servo_template is not None:
        _write_template(Path(options.servo_template), servo_template(options.log))
    task.say(str(summary), summary.to_dict())


def _write_template(path, text):
    if path.exists():
        raise FileExistsError(f"Got {str(path)!r} for the servo template, but it is there already: name another file.")
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
