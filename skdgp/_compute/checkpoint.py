"""Checkpoints: evaluations of the likelihood kept in files, so that a killed fit resumes.

Where a search asks for the likelihood next follows from the values it got. So a file holds the evaluations of every
stage: a fit that begins again reads them instead of computing them, takes the same way, and goes on from there.
"""

from __future__ import annotations

import hashlib
import io
import json
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from pickle import PicklingError
from threading import Lock
from time import monotonic
from typing import Any

import joblib
import numpy as np

from skdgp._compute.files import write_atomically
from skdgp._compute.typing import Matrix, Vector

FORMAT = 3
FILES, LEFT_OVER = "skdgp-*.npz", ".skdgp-*.part.npz"
CHECKSUM_SIZE = 16  # bytes at the end of a file
WRITING_SHARE = 0.05  # largest share of the time that goes into writing, however slow the disk
PACKAGES = ("skdgp", "numpy", "scipy", "scikit-learn")  # whose versions must be the same

_block: ContextVar[_Block | None] = ContextVar("skdgp_checkpoints", default=None)
_file: ContextVar[_File | None] = ContextVar("skdgp_checkpoint_file", default=None)


@contextmanager
def checkpointing(folder: Any, *, every: float = 5.0) -> Iterator[None]:
    """Let every fit of ``DependentGPRegressor`` inside the ``with`` block resume where a killed one was.

    What a fit has evaluated is written into the folder every few seconds (``every``; longer where the disk is slow),
    each file whole or not at all. When the process is killed, run the same lines again: a fit of the same data with the
    same settings and versions reads the files and ends where it would have ended. Fits that were finished are not
    evaluated again, so put what must be safe (saving the model, a whole search) into the block. At its end the files
    are removed; they stay after an exception, and after a Ctrl-C that made a fit stop early, which resumes the next
    time.

    The folder is created, in one that exists, when there is something to keep. It holds arrays without code. Raises
    ValueError if ``every`` is negative; in ``fit``, if a setting cannot be recognised later (a lambda as
    ``optimizer``). A fit warns if the folder holds a checkpoint of other data or settings, which is removed, or if a
    file cannot be read or written: it goes on without.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from skdgp import DependentGPRegressor, checkpointing
    >>> x = np.linspace(0.0, 6.0, 40)[:, None]
    >>> folder = Path(tempfile.mkdtemp()) / "checkpoint"
    >>> with checkpointing(folder):
    ...     model = DependentGPRegressor(n_latent=1, random_state=0).fit(x, np.sin(x[:, 0]))
    >>> folder.exists()
    False
    """
    if not every >= 0:
        raise ValueError(f"Got every={every!r}, but expected seconds between two states of a fit, from 0 on.")
    folder = Path(folder).resolve()
    token = _block.set(_Block(folder, every, untouched=any(folder.glob(FILES))))
    try:
        yield
    finally:
        _block.reset(token)
    if all(content is None or content["done"] for content in map(_read, folder.glob(FILES))):
        _remove(folder)


@dataclass
class _Block:
    """One ``with checkpointing`` block; ``untouched`` until a fit uses or removes the files that were there before."""

    folder: Path
    every: float
    untouched: bool


@dataclass(frozen=True)
class FitRecord:
    """Where a fit is kept, and what identifies it; can be sent to other processes."""

    folder: Path
    name: str
    facts: dict[str, Any]
    seeds: list[int]  # of the starting points: those of the fit that this one resumes
    every: float


def fit_record(X: Matrix, Y: Matrix, seeds: list[int], settings: dict[str, Any]) -> FitRecord | None:
    """Return the record of a fit within a ``checkpointing`` block, None outside."""
    block = _block.get()
    if block is None:
        return None
    versions = {name: [found.version for found in distributions(name=name)] for name in PACKAGES}
    facts = {"format": FORMAT, "data": joblib.hash((X, Y)), "settings": _hashes(settings), "versions": versions}
    name = joblib.hash(json.dumps(facts, sort_keys=True))[:16]
    resumed = _first_content(block.folder, f"skdgp-{name}-*.npz")
    if resumed is None and block.untouched:
        other = _first_content(block.folder, FILES)
        if other is not None:
            _warn(
                f"Got a checkpoint in {block.folder} of {_differences(other['facts'], facts)}: it is removed, and the "
                "fit starts anew. To resume a fit, use the same data and settings."
            )
        _remove(block.folder)
    block.untouched = False
    seeds = resumed["seeds"] if resumed else [int(seed) for seed in seeds]
    return FitRecord(block.folder, name, facts, seeds, block.every)


def run_recorded(record: FitRecord | None, part: str, function: Callable, **options: Any) -> Any:
    """Return ``function(**options)``, whose evaluations are kept in a file of their own if there is a record.

    ``part`` names what one process does of the fit. The result has a field ``interrupted``.
    """
    if record is None:
        return function(**options)
    file = _File(record, part)
    token = _file.set(file)
    try:
        result = function(**options)
        file.done = not result.interrupted
        return result
    finally:
        _file.reset(token)
        if file.done or record.folder.is_dir():  # an early end leaves nothing unless something was written before
            with file.lock:
                file.write()


def stage_record(stage: str) -> StageRecord:
    """Return what is recorded of a stage of the search; empty where nothing is recorded."""
    file = _file.get()
    if file is None:
        return StageRecord()
    with file.lock:
        return file.stages.setdefault(stage, StageRecord(file))


class StageRecord:
    """Evaluations of one stage in their order: value, theta and gradient in one vector each."""

    def __init__(self, file: _File | None = None, evaluations: Iterable[Vector] = ()):
        self.file, self.evaluations = file, list(evaluations)

    def start(self, theta: Vector) -> Vector:
        """Return where the recorded search began; if that is another point, the best that was evaluated."""
        if not self.evaluations:
            return theta
        first = self._theta(self.evaluations[0])
        if _close(first, theta):
            return first
        best = self._theta(max(self.evaluations, key=lambda row: row[0]))
        self.evaluations = []
        return best if best.shape == theta.shape else theta

    def recall(self, k: int, theta: Vector) -> tuple[float, Vector] | None:
        """Return value and gradient of the k-th evaluation, if it is recorded and was at this point."""
        if k < len(self.evaluations) and _close(self._theta(self.evaluations[k]), theta):
            row = self.evaluations[k]
            return float(row[0]), row[1 + len(theta) :]
        return None

    def add(self, k: int, theta: Vector, value: float, gradient: Vector) -> None:
        """Record the k-th evaluation, and write the file if it is time to."""
        if self.file is not None:
            with self.file.lock:
                self.evaluations[k:] = [np.concatenate([[value], theta, gradient])]
                if monotonic() >= self.file.due:
                    self.file.write()

    @staticmethod
    def _theta(row):
        return row[1 : 1 + len(row) // 2]


class _File:
    """The stages that one process runs of a fit: an archive of arrays without code, and its checksum behind it."""

    def __init__(self, record, part):
        self.record, self.path = record, record.folder / f"skdgp-{record.name}-{part}.npz"
        self.lock, self.done, self.due = Lock(), False, monotonic() + record.every
        content = _read(self.path) if self.path.is_file() else None
        stages = content["stages"] if content else {}
        self.stages = {name: StageRecord(self, evaluations) for name, evaluations in stages.items()}

    def write(self):
        """Write all stages; the caller holds the lock."""
        began, buffer = monotonic(), io.BytesIO()
        header = json.dumps({"facts": self.record.facts, "seeds": self.record.seeds, "done": self.done})
        arrays: dict[str, Any] = {f"stage/{name}": stage.evaluations for name, stage in self.stages.items()}
        np.savez(buffer, header=header, **arrays)
        data = buffer.getvalue()
        try:
            self.record.folder.mkdir(exist_ok=True)
            write_atomically(self.path, lambda temporary: temporary.write_bytes(data + _checksum(data)))
        except OSError as error:
            _warn(
                f"No checkpoint could be written to {self.path} ({error.strerror or error}): the fit goes on without."
            )
        self.due = monotonic() + max(self.record.every, (monotonic() - began) / WRITING_SHARE)


def _read(path: Path) -> dict[str, Any] | None:
    """Return facts, whether the part is done, and the stages; None, with a warning, of a damaged file."""
    try:
        data = path.read_bytes()
        data, checksum = data[:-CHECKSUM_SIZE], data[-CHECKSUM_SIZE:]
        if checksum != _checksum(data):
            raise ValueError("its checksum does not fit")
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            header = json.loads(str(archive["header"]))
            stages = {name.removeprefix("stage/"): archive[name] for name in archive.files if name != "header"}
    except Exception as error:  # a damaged archive may raise anything
        _warn(f"Got {path}, which cannot be read as a checkpoint ({error}): it is ignored.")
        return None
    return header | {"stages": stages}


def _first_content(folder, pattern):
    return next((content for content in map(_read, sorted(folder.glob(pattern))) if content is not None), None)


def _remove(folder):
    """Remove all files of checkpoints, and the folder if that leaves it empty."""
    for pattern in (FILES, LEFT_OVER):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
    try:
        folder.rmdir()
    except OSError:  # never made, or it holds other files
        return


def _checksum(data):
    return hashlib.blake2b(data, digest_size=CHECKSUM_SIZE).digest()


def _close(first, second) -> bool:
    return first.shape == second.shape and np.allclose(first, second, rtol=1e-9, atol=1e-12)


def _hashes(settings) -> dict[str, str]:
    hashes = {}
    for name, value in settings.items():
        if name != "n_jobs":  # does not change the result
            try:
                hashes[name] = joblib.hash(value)
            except (PicklingError, AttributeError) as error:
                raise ValueError(
                    f"Got {name}={value!r} within checkpointing, but expected what another process can recognise: "
                    "define it at the top of a module, or fit without checkpoints."
                ) from error
    return hashes


def _differences(saved, facts) -> str:
    words = ["other data"] if saved["data"] != facts["data"] else []
    other = [name for name, value in facts["settings"].items() if saved["settings"].get(name) != value]
    words += [f"other settings ({', '.join(other)})"] if other else []
    words += ["other versions of the software"] if saved["versions"] != facts["versions"] else []
    return ", ".join(words) or "another format"


def _warn(message):
    warnings.warn(message, stacklevel=2)
