"""The formats that a model is exported to, by name."""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from sklearn.utils import Bunch

from skdgp.dynamics import Aircraft
from skdgp.export._build_up import build_up, write_build_up
from skdgp.export._c import C_FILES, TOLERANCE, c_bytes, write_c
from skdgp.export._graphs import write_casadi, write_onnx
from skdgp.export._jsbsim import write_jsbsim
from skdgp.export._model import PortableModel, save_portable
from skdgp.export._pipeline import portable_model
from skdgp.export._reduce import loss_of, reduced_to_kb

Facts: TypeAlias = dict[str, Any]
MEMBER_BYTES = 300  # of an array in a file, besides its numbers


def export_model(
    folder: str | os.PathLike[str], model: Any, to: str, **options: Any
) -> dict[str, Any]:
    """Write a model in one of the ``FORMATS`` into a folder, which must exist, and return facts of it.

    Raises ValueError if there is no such format, it has no such option, or the model has no such
    form.

    Parameters
    ----------
    folder : path-like
    model : Bunch or PortableModel
        What :func:`skdgp.identification.load_model` or :func:`load_portable` returns.
    to : str
        Name of the format.
    **options
        Of the format: ``max_kb``, ``precision``, ``form``, ``draws``.

    Returns
    -------
    dict
        ``files``, paths, and ``loss`` of each coefficient: by a smaller size "mean" and "std" in
        posterior deviations; by tables and derivatives "loss" and "deviation", root mean squares.
    """
    if to not in FORMATS:
        raise ValueError(f"Got the format {to!r}, but expected one of {', '.join(FORMATS)}.")
    known = [
        name
        for name in inspect.signature(FORMATS[to]).parameters
        if name not in ("folder", "model", "aircraft")
    ]
    unknown = [name for name in options if name not in known]
    if unknown:
        raise ValueError(
            f"Got the options {unknown} for the format {to}, but expected {known or 'none'}."
        )
    if to in ARRAY_FORMATS:
        portable = portable_model(**model) if isinstance(model, Bunch) else model
        return ARRAY_FORMATS[to](Path(folder), portable, **options)
    if not isinstance(model, Bunch):
        raise ValueError(
            f"Got a portable model for the format {to}, but expected the model.joblib that "
            f"identify wrote: the format "
            "needs the pipeline and its samples, which a portable model does not hold."
        )
    return SAMPLE_FORMATS[to](Path(folder), model.pipeline, model.aircraft, **options)


def _one_file(
    name: str, write: Callable, folder: Path, model: PortableModel, *, max_kb: float | None = None
) -> Facts:
    """Write the portable model, in at most ``max_kb`` of a portable file, in one file of another format."""
    model = reduced_to_kb(model, _file_bytes, max_kb)
    return {"files": [write(folder / name, model)], "loss": loss_of(model)}


def _c(
    folder: Path, model: PortableModel, *, precision: str = "double", max_kb: float | None = None
) -> Facts:
    model = reduced_to_kb(model, partial(c_bytes, precision=precision), max_kb)
    write_c(folder, model, precision=precision)
    return {"files": [folder / name for name in C_FILES], "loss": loss_of(model)}


def _file_bytes(model: PortableModel) -> int:
    """Return the size of the file of a model."""
    arrays = sum(array.nbytes + MEMBER_BYTES for array in model.arrays().values())
    return (
        arrays
        + 4 * MEMBER_BYTES * (1 + len(model.regressors))
        + len(json.dumps(model.provenance, indent=1))
    )


def _tables(folder: Path, model: Any, aircraft: Aircraft) -> Facts:
    """Write the build-up."""
    build, files = build_up(model, aircraft), [folder / "build_up.json"]
    write_build_up(files[0], build)
    return {"files": files, "loss": build.loss.to_dict("index")}


def _jsbsim(
    folder: Path, model: Any, aircraft: Aircraft, *, form: str = "functions", draws: int = 0
) -> Facts:
    return {"files": write_jsbsim(folder, model, aircraft, form=form, n_draws=draws)}


ARRAY_FORMATS: dict[str, Callable[..., Facts]] = {
    "portable": partial(_one_file, "model.npz", save_portable),
    "c": _c,
    "casadi": partial(_one_file, "aero.casadi", write_casadi),
    "onnx": partial(_one_file, "aero.onnx", write_onnx),
}
"""Formats of a portable model."""
SAMPLE_FORMATS: dict[str, Callable[..., Facts]] = {
    "build-up": _tables,
    "jsbsim": _jsbsim,
}
"""Formats of a pipeline and its samples."""
CHOICES = {"precision": [*TOLERANCE], "form": ["functions", "tables"]}
"""The values of options that are words, of one format or another."""
FORMATS = ARRAY_FORMATS | SAMPLE_FORMATS
"""The function of each format: it writes a model into a folder, takes the options of the format,
and returns facts.
"""
