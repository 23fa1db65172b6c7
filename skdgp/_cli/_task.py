"""A running command: its options, output folder and console."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from skdgp._cli._config import config_text
from skdgp._cli._console import Console
from skdgp._cli._folder import OutputFolder
from skdgp._cli._writers import Writer, plain, text_writer


@dataclass(frozen=True)
class Task:
    """A command under way. ``folder`` is None where nothing is to be written."""

    options: Namespace
    console: Console
    folder: OutputFolder | None
    command: str

    @property
    def config(self) -> str:
        """Name of the configuration: beside a single table it has the name of that."""
        output = Path(self.options.output)
        return f"{output.stem}.config.toml" if self.options.command == "predict" else "config.toml"

    def write(self, writers: dict[str, Writer]) -> dict[str, Path]:
        """Write all outputs, and the configuration that repeats them, or none; return where they are, by name."""
        self.console.stage("writing")
        writers = writers | {self.config: text_writer(config_text(self.options))}
        self.folder.write(writers)
        return {name: self.folder.path / name for name in writers}

    def say(self, text: str, numbers: dict) -> None:
        """Print the summary: text, or on request JSON."""
        self.console.print(json.dumps(plain(numbers), indent=1, allow_nan=False) if self.options.json else text)
