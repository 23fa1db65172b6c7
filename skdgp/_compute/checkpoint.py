"""Checkpoints: evaluations of the likelihood kept in files, so that a killed fit resumes.

Where a search asks for the likelihood next follows from the answers it got. So the answers of stages under way are
kept, and of stages that are done their ends: a fit that begins again gets them back instead of computing them, goes
the same way, and from there on.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from pickle import PicklingError
from threading import Lock
from time import monotonic

import joblib
import numpy as np

from skdgp._compute.files import write_atomically

FORMAT = 2
SHARE = 0.05  # of the time, at most, goes into writing, however slow the disk
FILES = "skdgp-*.npz"
LEFT_OVER = ".skdgp-*.part.npz"
VERSIONS = ("skdgp", "numpy", "scipy", "scikit-learn")
ELSEWHERE = ("n_jobs",)  # settings that do not change what is found

_block: ContextVar[_Block | None] = ContextVar("skdgp_checkpoints", default=None)
_part: ContextVar[_Part | None] = ContextVar("skdgp_checkpoint_of_part", default=None)


@contextmanager
def checkpointing(folder, *, every: float = 5.0) -> Iterator[None]:
    """Let every fit of ``DependentGPRegressor`` inside the ``with`` block go on where a killed one was.

    What a fit has evaluated is written into the folder every few seconds, each file whole or not at all. When the
    process is killed, run the same lines again: a fit of the same data with the same settings and versions takes up
    what the files hold, and ends where it would have ended. Fits that were done by then are not done again, so put
    what shall be safe, saving the model or a whole search, into the block. At its end the files are removed; they stay
    when it ends with an exception, or when Ctrl-C made a fit stop early, which then goes on the next time.

    Parameters
    ----------
    folder : path-like
        Made when there is something to keep; the folder that it stands in must exist. It holds arrays without code.
    every : float
        Seconds between two states of a fit; longer where the disk is slow.

    Raises
    ------
    ValueError
        When ``every`` is negative; in ``fit``, when a setting cannot be recognised later (a lambda as ``optimizer``).

    Warns
    -----
    UserWarning
        In ``fit``, when the folder holds a checkpoint of other data or settings: it is removed, and the fit starts
        anew. When a file cannot be read or written: the fit goes on without.

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
    block = _Block(Path(folder).resolve(), every)
    token = _block.set(block)
    try:
        yield
    finally:
        _block.reset(token)
    block.end()


def record_of_fit(X, Y, seeds, settings: dict) -> Record | None:
    """Return the record of a fit, with the seeds of what it goes on from; None where nothing is recorded."""
    block = _block.get()
    return None if block is None else block.record(X, Y, [int(seed) for seed in seeds], settings)


def kept_in(record: Record | None, part: str, function, **options):
    """Return ``function(**options)``, what it evaluates kept as one part of the fit, if the fit is recorded.

    A part is what one process does, in a file of its own. What the function returns says in ``interrupted`` whether it
    was ended early.
    """
    if record is None:
        return function(**options)
    kept = _Part(record, part)
    token = _part.set(kept)
    try:
        result = function(**options)
        kept.done = not result.interrupted
        return result
    finally:
        _part.reset(token)
        kept.end()


def answers_of(stage: str) -> Answers:
    """Return what is known of a stage of the search: nothing, where nothing is recorded."""
    part = _part.get()
    return Answers() if part is None else part.answers(stage)


class Answers:
    """Value and gradient at the places where one stage asked for them, and where it ended.

    Attributes
    ----------
    end : tuple or None
        What the stage found, once it is done.
    """

    def __init__(self, part: _Part | None = None, end: tuple | None = None, past=()):
        self.part, self.end, self.past = part, end, list(past)

    def start(self, theta):
        """Return where the search began, so that it goes the same way; from other places, the best that is known."""
        if not self.past:
            return theta
        first = self.past[0][0]
        if _alike(first, theta):
            return first
        best = max(self.past, key=lambda answer: answer[1])[0]
        self.past = []
        return best if best.shape == theta.shape else theta

    def recall(self, k, theta):
        """Return value and gradient of the k-th question, if it was asked before and was this one."""
        if k < len(self.past) and _alike(self.past[k][0], theta):
            return self.past[k][1:]
        return None

    def add(self, k, theta, value, gradient):
        """Keep the answer to the k-th question."""
        if self.part is not None:
            with self.part.lock:
                self.past[k:] = [(np.array(theta), float(value), np.array(gradient))]
            self.part.write_if_due()

    def finish(self, end: tuple):
        """Keep the end of the stage in the place of its answers."""
        if self.part is not None:
            with self.part.lock:
                self.end, self.past = end, []


class _Block:
    """The folder of one ``with`` block, and whether what stood there has been taken up."""

    def __init__(self, folder, every):
        self.folder, self.every = folder, every
        self.strange = any(folder.glob(FILES))  # until a fit of this block finds its own there

    def record(self, X, Y, seeds, settings):
        facts = {"format": FORMAT, "data": _hash_of_arrays(X=X, Y=Y), "settings": _hashes(settings)}
        facts["versions"] = {name: _version(name) for name in VERSIONS}
        name = hashlib.blake2b(json.dumps(facts, sort_keys=True).encode(), digest_size=8).hexdigest()
        own = [_load(path) for path in sorted(self.folder.glob(f"skdgp-{name}-*.npz"))]
        found = next((part["facts"] for part in own if part is not None), None)
        if found is None and self.strange:
            self._say_strange(facts)
            self.remove()
        self.strange = False
        return Record(self.folder, name, facts | {"seeds": found["seeds"] if found else seeds}, self.every)

    def _say_strange(self, facts):
        found = next((part["facts"] for part in map(_load, self.folder.glob(FILES)) if part is not None), None)
        if found is not None:
            _warn(
                f"Got a checkpoint in {self.folder} of {_differences(found, facts)}: it is removed, and the fit starts "
                "anew. To go on from one, fit the same data with the same settings."
            )

    def end(self):
        """Remove the files, unless one of them is of a fit that was interrupted."""
        parts = [_load(path) for path in self.folder.glob(FILES)]
        if all(part is None or part["done"] for part in parts):
            self.remove()

    def remove(self):
        """Remove all files of checkpoints, and the folder if that leaves it empty."""
        for pattern in (FILES, LEFT_OVER):
            for path in self.folder.glob(pattern):
                path.unlink(missing_ok=True)
        try:
            self.folder.rmdir()
        except OSError:  # never made, or it holds what is not ours
            return


@dataclass(frozen=True)
class Record:
    """Where a fit is kept, and what it is of; can be sent to other processes."""

    folder: Path
    name: str
    facts: dict
    every: float

    @property
    def seeds(self) -> list[int]:
        """Seeds of the starting points: those of the fit that this one goes on from."""
        return self.facts["seeds"]


class _Part:
    """What one process evaluates of a fit, and its file."""

    def __init__(self, record, name):
        self.record, self.path = record, record.folder / f"skdgp-{record.name}-{name}.npz"
        self.lock, self.done = Lock(), False
        self.stages = {}
        kept = _load(self.path) if self.path.is_file() else None
        for stage, (end, past) in (kept["stages"] if kept else {}).items():
            self.stages[stage] = Answers(self, end, past)
        self.due = monotonic() + record.every

    def answers(self, stage):
        with self.lock:
            return self.stages.setdefault(stage, Answers(self))

    def write_if_due(self):
        """Write if it is time to, and nobody is at it."""
        if monotonic() >= self.due and self.lock.acquire(blocking=False):
            try:
                self._write()
            finally:
                self.lock.release()

    def end(self):
        """Write the end of the part; of a fit that was broken off early, only if it was long enough to be written."""
        if self.done or self.record.folder.is_dir():
            with self.lock:
                self._write()

    def _write(self):
        began = monotonic()
        arrays = {"facts": np.array(json.dumps(self.record.facts)), "done": np.array(self.done)}
        for stage, answers in self.stages.items():
            if answers.end is not None:
                theta, *story = answers.end
                arrays |= {f"{stage}/theta": theta, f"{stage}/story": np.array(json.dumps(story))}
            elif answers.past:
                thetas, values, gradients = map(np.array, zip(*answers.past, strict=True))
                arrays |= {f"{stage}/thetas": thetas, f"{stage}/values": values, f"{stage}/gradients": gradients}
        arrays["checksum"] = np.array(_hash_of_arrays(**arrays))
        try:
            self.record.folder.mkdir(exist_ok=True)
            write_atomically(self.path, lambda path: np.savez(path, **arrays))
        except OSError as error:
            _warn(
                f"No checkpoint could be written to {self.path} ({error.strerror or error}): the fit goes on without."
            )
        self.due = monotonic() + max(self.record.every, (monotonic() - began) / SHARE)


def _load(path) -> dict | None:
    """Return what a file holds: facts, whether its part is done, and the end or the answers of each stage."""
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = dict(file)
        if str(arrays.pop("checksum")) != _hash_of_arrays(**arrays):
            raise ValueError("its checksum does not fit")
        facts, done = json.loads(str(arrays.pop("facts"))), bool(arrays.pop("done"))
        stages = {}
        for stage in {name.rpartition("/")[0] for name in arrays}:
            if f"{stage}/story" in arrays:
                stages[stage] = (arrays[f"{stage}/theta"], *json.loads(str(arrays[f"{stage}/story"]))), ()
            else:
                columns = [arrays[f"{stage}/{name}"] for name in ("thetas", "values", "gradients")]
                stages[stage] = None, list(zip(*columns, strict=True))
    except Exception as error:  # a damaged archive may raise anything
        _warn(f"Got {path}, which cannot be read as a checkpoint ({error}): it is left aside.")
        return None
    return {"facts": facts, "done": done, "stages": stages}


def _version(name) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # run from a folder that was never installed
        return "unknown"


def _alike(first, second) -> bool:
    return first.shape == second.shape and np.allclose(first, second, rtol=1e-9, atol=1e-12)


def _hash_of_arrays(**arrays) -> str:
    found = hashlib.blake2b(digest_size=16)
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()


def _hashes(settings) -> dict[str, str]:
    found = {}
    for name, value in settings.items():
        if name not in ELSEWHERE:
            try:
                found[name] = joblib.hash(value)
            except (PicklingError, AttributeError) as error:
                raise ValueError(
                    f"Got {name}={value!r} within checkpointing, but expected what can be recognised by another "
                    "process: define it at the top of a module, or fit without checkpoints."
                ) from error
    return found


def _differences(found, facts) -> str:
    words = ["other data"] if found["data"] != facts["data"] else []
    known = found["settings"]
    other = [name for name, value in facts["settings"].items() if known.get(name) != value]
    if other:
        words.append(f"other settings ({', '.join(other)})")
    if found["versions"] != facts["versions"]:
        words.append("other versions of the software")
    return ", ".join(words) or "another format"


def _warn(message):
    warnings.warn(message, UserWarning, stacklevel=2)
