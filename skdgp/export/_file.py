"""The file of a portable model: arrays and JSON, no code."""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np

from skdgp._compute.files import write_atomically
from skdgp.export._model import PortableModel

FORMAT = "skdgp portable model"
VERSION = 8
HEAD = "model.json"


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
            # Members have the same time always, so that equal models are equal files
            archive.writestr(zipfile.ZipInfo(HEAD), text)
            for name, array in model.arrays().items():
                data = io.BytesIO()
                np.save(data, np.ascontiguousarray(array), allow_pickle=False)
                archive.writestr(zipfile.ZipInfo(f"{name}.npy"), data.getbuffer())

    return write_atomically(path, write)


def load_portable(path: str | os.PathLike[str]) -> PortableModel:
    """Return a portable model that :func:`save_portable` or ``skdgp export`` wrote, the same to the bit.

    No code is run. Raises FileNotFoundError if there is no such file, PortableFileError if it is
    not a portable model, holds other numbers or names than were written, or is of another version.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"Got {path}, but there is no such file.")
    try:
        model = _read(path)
        model.predict(model.shift[None], return_std=True)
    except Exception as error:  # a damaged archive may raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PortableFileError(
            f"Got {path}, which is not a portable model of this version ({reason}): copy it again, "
            "or export the model again."
        ) from error
    return model


def _read(path: Path) -> PortableModel:
    """Return the model of a file; raise ValueError if it is of another version or was changed."""
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        head = json.loads(file[HEAD])
        if (head["format"], head["version"]) != (FORMAT, VERSION):
            raise ValueError(f"its format is {head['format']} {head['version']}")
        arrays = {name: file[name] for name in file.files if name != HEAD}
    model = PortableModel.from_arrays(head, arrays)
    if model.content_hash != head["content_hash"]:
        raise ValueError("its content is not what its hash says")
    return model
