"""All formats of an export."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from skdgp._compute.files import write_atomically
from skdgp._flight.tables import check_choice
from skdgp.export._c import write_c
from skdgp.export._casadi import write_casadi
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import PortableModel

# Compilers and simulators take no larger source in reasonable time [bytes]
LARGEST = 2**26

FORMAT = "skdgp portable model"
VERSION = 10
HEAD = "model.json"


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
    head = {"format": FORMAT, "version": VERSION}
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


def write_portable(folder: Path, model: PortableModel) -> list[Path]:
    """Write the portable file into a folder."""
    return [save_portable(folder / "model.npz", model)]


# Formats of `export_model` by name
FORMATS: dict[str, Callable[[Path, PortableModel], list[Path]]] = {
    "portable": write_portable,
    "c": write_c,
    "jsbsim": write_jsbsim,
    "casadi": write_casadi,
}


def export_model(
    folder: str | os.PathLike[str],
    model: PortableModel,
    to: str,
    *,
    full: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write a model as portable, c, jsbsim or casadi into a folder, which is made, and return its files.

    Raises ValueError if there is no such format, the model is too large for it, or has no portable
    form.

    Parameters
    ----------
    folder : path-like
    model : PortableModel
    to : str
        Name of the format.
    full : mapping of str to float, optional
        For JSBSim: see :func:`write_jsbsim`.

    Returns
    -------
    list of Path
    """
    check_choice("to", to, FORMATS)
    write = FORMATS[to]
    if full:
        if to != "jsbsim":
            raise ValueError(
                f"Got full deflections for the format {to}, but only jsbsim has commands: leave them out."
            )
        write = partial(write_jsbsim, full=full)
    if to != "portable" and model.nbytes > LARGEST:
        raise ValueError(
            f"Got a model of {model.nbytes / 1e6:.0f} MB, but expected at most {LARGEST / 1e6:.0f} MB for the "
            f"format {to}: learn with sparse inference of fewer inducing inputs, inference='sparse', n_inducing=50."
        )
    return write(Path(folder), model)
