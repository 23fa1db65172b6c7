"""The folder that the outputs go to: known to be writable before hours of work, left as found when that fails."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from skdgp._files import write_atomically


class OutputFolder:
    """Make the folder, and take it away again if nothing was written into it.

    Raises
    ------
    OSError
        At the beginning of the ``with`` block, if it cannot be made or written to.
    """

    def __init__(self, path):
        self.path = Path(path)

    def __enter__(self) -> OutputFolder:
        self._made = [p for p in (self.path, *self.path.parents) if not p.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            self._remove_made()
            reason = "it is a file" if self.path.is_file() else error.strerror
            raise OSError(
                f"Got {str(self.path)!r} as the folder for the outputs, but nothing can be written there ({reason}): "
                "name another one after -o."
            ) from error
        return self

    def __exit__(self, kind, error, trace):
        if kind is not None:
            self._remove_made()

    def _remove_made(self):
        for path in self._made:  # innermost first
            try:
                path.rmdir()
            except OSError:  # not empty, or never made
                return

    def write(self, writers: dict[str, Callable[[Path], object]]) -> list[Path]:
        """Write several files: all are complete beside their places before the first is put into its own."""
        if not writers:
            return []
        (name, writer), *rest = writers.items()
        written = []

        def write_with_rest(temporary):
            writer(temporary)
            written.extend(self.write(dict(rest)))

        return [write_atomically(self.path / name, write_with_rest), *written]
