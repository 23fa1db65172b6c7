"""Output files: the folder, written to by all or none, and writers of tables and pictures."""

from __future__ import annotations

import re
import signal
import tempfile
import warnings
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from skdgp._cli._console import Console, ctrl_c
from skdgp._cli._parser import HEAD, Command
from skdgp._compute.files import Writer, json_text, text_writer, write_together
from skdgp._compute.tables import csv_writer


class OutputFolder:
    """A folder made for outputs, or that of a single table; removed again if nothing was written into it.

    The ``with`` block begins with an OSError if the folder cannot be made or written to, or if the configuration of the
    run would replace a file that no run wrote.
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
                f"Got {str(self.path)!r} as the folder for the outputs, but nothing can be written there ({reason}): "
                "name another one after -o."
            ) from error
        if self.config.is_file() and not _text(self.config).startswith(HEAD):
            raise FileExistsError(
                f"Got {str(self.config)!r}, where the configuration of this run belongs, but it is there already and "
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

        Outputs of an earlier run of the same command that this one does not write do not stay beside them.
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
        raise ImportError('Parquet needs pyarrow, which is not installed: pip install "skdgp[parquet]", or write CSV.')


def picture_writers(name: str, draw: Callable, *data, **more) -> dict[str, Writer]:
    """Return what writes the picture that ``draw`` of a display makes; nothing, and a warning, without matplotlib."""
    if find_spec("matplotlib") is None:
        warnings.warn('No picture: it needs pip install "skdgp[plot]".', stacklevel=2)
        return {}
    from matplotlib.figure import Figure

    display = draw(*data, **more, ax=Figure(layout="constrained"))
    return {name: lambda path: display.figure_.savefig(path, dpi=150)}
