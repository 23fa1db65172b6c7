"""The output folder: checked for writing before a long fit, and removed again when nothing was written."""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

from skdgp._compute.files import write_atomically


class OutputFolder:
    """Make the folder, and take it away again if nothing was written into it.

    Raises
    ------
    OSError
        At the beginning of the ``with`` block, if it cannot be made or written to.
    """

    def __init__(self, path):
        self.path = Path(path)
        self.written = False

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

    def write(self, writers: dict[str, Callable[[Path], object]]) -> None:
        """Write several files: all are complete beside their places before the first is put into its own.

        From then on Ctrl-C waits until the last one is there.
        """
        with _ctrl_c_kept() as ignore_ctrl_c:
            self._write(list(writers.items()), ignore_ctrl_c)
            self.written = True

    def _write(self, writers, when_complete):
        if not writers:
            when_complete()
            return
        (name, writer), *rest = writers

        def write_with_rest(temporary):
            writer(temporary)
            self._write(rest, when_complete)

        write_atomically(self.path / name, write_with_rest)


@contextmanager
def _ctrl_c_kept():
    """Yield what makes Ctrl-C do nothing until the end of the block."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield lambda: None
        return
    try:
        yield lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)
    finally:
        signal.signal(signal.SIGINT, before)
