"""The portable file, arrays and JSON without code, and the table of all formats that a model is exported to."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import Bunch

from skdgp._compute.files import write_atomically
from skdgp.export._c import c_bytes, write_c
from skdgp.export._graphs import write_casadi, write_onnx
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import PortableModel
from skdgp.export._pipeline import portable_model
from skdgp.export._reduce import reduced

FORMAT, VERSION = "skdgp portable model", 5
HEAD = "model.json"
EPOCH = (1980, 1, 1, 0, 0, 0)  # equal models are equal files
MEMBER_BYTES = 300  # of an array in the file, besides its numbers


class PortableFileError(ValueError):
    """A file could not be read as a portable model."""


def save_portable(path: str | os.PathLike[str], model: PortableModel) -> Path:
    """Write a portable model into one file, which appears whole or not at all, and return its path.

    The file is an uncompressed zip archive, which ``numpy.load`` opens: ``model.json`` and one
    ``.npy`` for each array. Raises TypeError if ``model`` is no `PortableModel`.
    """
    if not isinstance(model, PortableModel):
        raise TypeError(
            f"Got {type(model).__name__} to save, but expected a PortableModel: make one with "
            "skdgp.export.portable_model(pipeline, aircraft)."
        )
    head = {"format": FORMAT, "version": VERSION, "content_hash": model.content_hash}
    text = json.dumps(head | model.head(), indent=1, allow_nan=False)

    def write(temporary: Path) -> None:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
            archive.writestr(zipfile.ZipInfo(HEAD, EPOCH), text)
            for name, array in model.arrays().items():
                data = io.BytesIO()
                np.save(data, np.ascontiguousarray(array), allow_pickle=False)
                archive.writestr(zipfile.ZipInfo(f"{name}.npy", EPOCH), data.getbuffer())

    return write_atomically(path, write)


def load_portable(path: str | os.PathLike[str]) -> PortableModel:
    """Return a portable model that :func:`save_portable` or ``skdgp export`` wrote, the same to the bit.

    No code is run. Raises FileNotFoundError if there is no such file, PortableFileError if it is
    not a portable model, holds other numbers or names than were written, or is of another version.
    """
    path = Path(path)
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            head = json.loads(file[HEAD])
            if (head["format"], head["version"]) != (FORMAT, VERSION):
                raise ValueError(f"its format is {head['format']} {head['version']}")
            arrays = {name: file[name] for name in file.files if name != HEAD}
        model = PortableModel.from_arrays(head, arrays)
        if model.content_hash != head["content_hash"]:
            raise ValueError("its content is not what its hash says")
        model.predict(model.shift[None], return_std=True)
    except Exception as error:  # a damaged archive may raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PortableFileError(
            f"Got {path}, which is not a portable model of this version ({reason}): copy it again, "
            "or export the model again."
        ) from error
    return model


def file_bytes(model: PortableModel) -> int:
    """Return the size of the file of a model."""
    sizes = (MEMBER_BYTES + array.nbytes for array in model.arrays().values())
    return sum(sizes, MEMBER_BYTES + len(json.dumps(model.head(), indent=1)))


MAX_BYTES = 2**26  # compilers and simulators take no larger source in reasonable time


class Format(NamedTuple):
    """What writes a format into a folder and returns the files, the size of a model in it, and the largest."""

    write: Callable[[Path, PortableModel], list[Path]]
    size: Callable[[PortableModel], int] = file_bytes
    most: float = MAX_BYTES


# Formats of `export_model` by name
FORMATS: dict[str, Format] = {
    "portable": Format(
        lambda folder, model: [save_portable(folder / "model.npz", model)], most=np.inf
    ),
    "c": Format(write_c, c_bytes),
    "jsbsim": Format(write_jsbsim),
    "casadi": Format(write_casadi),
    "onnx": Format(write_onnx),
}


def export_model(
    folder: str | os.PathLike[str],
    model: Bunch | PortableModel,
    to: str,
    *,
    max_kb: float | None = None,
) -> dict[str, Any]:
    """Write a model in one of the ``FORMATS`` into a folder, which must exist, and return its facts.

    Raises ValueError if there is no such format, the model is too large for it, or has no portable
    form.

    Parameters
    ----------
    folder : path-like
    model : Bunch or PortableModel
        What :func:`skdgp.identification.load_model` or :func:`load_portable` returns.
    to : str
        Name of the format.
    max_kb : float, optional
        Largest size [kB], of the flash memory for C, else of the portable file: the
        model gets fewer basis functions. Default: the whole model.

    Returns
    -------
    dict
        ``files``, paths, and ``loss`` by a smaller size of each coefficient: root mean square
        changes of "mean" and "std", in posterior standard deviations.
    """
    if to not in FORMATS:
        raise ValueError(f"Got the format {to!r}, but expected one of {', '.join(FORMATS)}.")
    write, size, most = FORMATS[to]
    portable = portable_model(**model) if isinstance(model, Bunch) else model
    if max_kb is not None:
        if not 0 < max_kb < np.inf:
            raise ValueError(f"Got max_kb={max_kb!r}, but expected a size > 0 [kB].")
        portable = reduced(portable, size, int(1024 * max_kb))
    if (bytes_needed := size(portable)) > most:
        raise ValueError(
            f"Got a model of {bytes_needed / 1e6:.0f} MB, but expected at most {most / 1e6:.0f} MB for the "
            f"format {to}: give max_kb=256 (--max-kb 256), or another size."
        )
    return {
        "files": write(Path(folder), portable),
        "loss": portable.provenance.get("reduction", {}),
    }
