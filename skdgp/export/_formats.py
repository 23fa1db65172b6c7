"""All formats of an export."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import Bunch

from skdgp.export._c import c_bytes, write_c
from skdgp.export._casadi import write_casadi
from skdgp.export._file import file_bytes, save_portable
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import PortableModel
from skdgp.export._pipeline import portable_model


class Format(NamedTuple):
    """What writes a format into a folder and returns the files, the size of a model in it, and the largest."""

    write: Callable[[Path, PortableModel], list[Path]]
    size: Callable[[PortableModel], int] = file_bytes
    # Compilers and simulators take no larger source in reasonable time
    most: float = 2**26


def write_portable(folder: Path, model: PortableModel) -> list[Path]:
    """Write the portable file into a folder."""
    return [save_portable(folder / "model.npz", model)]


# Formats of `export_model` by name
FORMATS: dict[str, Format] = {
    "portable": Format(write_portable, most=np.inf),
    "c": Format(write_c, c_bytes),
    "jsbsim": Format(write_jsbsim),
    "casadi": Format(write_casadi),
}


def export_model(
    folder: str | os.PathLike[str],
    model: Bunch | PortableModel,
    to: str,
    *,
    full: Mapping[str, float] | None = None,
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
    full : mapping of str to float, optional
        For JSBSim: see :func:`write_jsbsim`.

    Returns
    -------
    dict
        ``files``, paths; ``size``, bytes of the flash memory for C, else of the portable file.
    """
    if to not in FORMATS:
        raise ValueError(f"Got the format {to!r}, but expected one of {', '.join(FORMATS)}.")
    write, size, most = FORMATS[to]
    if full:
        if to != "jsbsim":
            raise ValueError(
                f"Got full deflections for the format {to}, but only jsbsim has commands: leave them out."
            )
        write = partial(write_jsbsim, full=full)
    portable = portable_model(**model) if isinstance(model, Bunch) else model
    if (bytes_needed := size(portable)) > most:
        raise ValueError(
            f"Got a model of {bytes_needed / 1e6:.0f} MB, but expected at most {most / 1e6:.0f} MB for the "
            f"format {to}: learn with sparse inference of fewer inducing inputs, inference='sparse' and n_inducing "
            "(identify --inference sparse --inducing 50)."
        )
    return {"files": write(Path(folder), portable), "size": bytes_needed}
