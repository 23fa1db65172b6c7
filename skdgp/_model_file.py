"""The file that keeps a model: whole or refused, and never read in silence by other versions than wrote it."""

from __future__ import annotations

import json
import os
import platform
import warnings
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import joblib
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch

from skdgp._files import write_atomically
from skdgp.dynamics import Aircraft

__all__ = ["ModelFileError", "dump_model", "load_model", "model_bunch", "save_model", "software_versions"]

MAGIC = b"\nskdgp model file "
FORMAT = 1
LONGEST_CLOSING = 2**14
MATTERS = ("skdgp", "scikit-learn", "numpy")


class ModelFileError(ValueError):
    """A file could not be read as a model: what was got, what was expected, what to do."""


def save_model(path: str | os.PathLike, pipeline: Pipeline, aircraft: Aircraft, **facts) -> Path:
    """Keep a fitted pipeline, its aircraft and how they came about in one file, which appears whole or not at all.

    Parameters
    ----------
    path : path-like
        Such as ``model.joblib``; its folder must exist.
    pipeline : Pipeline
        Fitted.
    aircraft : Aircraft
    **facts
        What else to remember, such as ``options={"thrust": "columns"}``.

    Returns
    -------
    Path
        ``path``.
    """
    model = model_bunch(pipeline, aircraft, **facts)
    return write_atomically(path, lambda temporary: dump_model(temporary, model))


def model_bunch(pipeline: Pipeline, aircraft: Aircraft, **facts) -> Bunch:
    """Return what a model file holds, with the time and the versions of now."""
    created = datetime.now().astimezone().isoformat(timespec="seconds")
    return Bunch(pipeline=pipeline, aircraft=aircraft, created=created, versions=software_versions(), **facts)


def dump_model(path: Path, model: Bunch) -> None:
    """Write the model and, after it, a line of JSON that can be read when the model itself cannot.

    Unpickling stops before that line, so ``joblib.load`` reads the file too; and a file that lacks the line is cut off.
    """
    joblib.dump(model, path)
    closing = {"format": FORMAT, "bytes": path.stat().st_size, "created": model.created, "versions": model.versions}
    with path.open("ab") as file:
        file.write(MAGIC + json.dumps(closing).encode() + b"\n")


def load_model(path: str | os.PathLike) -> Bunch:
    """Read a model that :func:`save_model` or ``python -m skdgp identify`` wrote.

    Loading runs what the file says (it is a pickle): open only files whose origin you trust.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Bunch
        ``pipeline`` (fitted, raw flight table in, coefficients out), ``aircraft``, ``created``, ``versions`` and what
        else was remembered: the command line adds ``options`` (thrust, external forces, ...), ``fit`` (samples,
        seconds, log likelihood, ...) and ``flights`` learned from.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ModelFileError
        If the file is not a model, is cut off, or cannot be read by the versions installed here.

    Warns
    -----
    UserWarning
        If it was made by other versions of skdgp, scikit-learn or NumPy.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Got {path}, but there is no such file: python -m skdgp identify writes model.joblib.")
    closing = _closing(path)
    if closing["format"] != FORMAT:
        raise ModelFileError(
            f"Got {path} of format {closing['format']}, written by {_said(closing['versions'])}, but this skdgp reads "
            f"format {FORMAT}: fit it again, or install that version."
        )
    if not _same_versions(closing["versions"]):
        warnings.warn(
            f"{path} was made by {_said(closing['versions'])}, and this is {_said(software_versions())}: its "
            "predictions may differ. Compare a few, fit it again, or install those versions.",
            UserWarning,
            stacklevel=2,
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InconsistentVersionWarning)  # said above, once for all
            return joblib.load(path)
    except Exception as error:  # unpickling may raise anything
        raise ModelFileError(
            f"Got {path}, written by {_said(closing['versions'])}, which cannot be read here, with "
            f"{_said(software_versions())} ({type(error).__name__}: {error}): fit it again, or install those versions."
        ) from error


def software_versions() -> dict[str, str]:
    """Return the versions of skdgp and of what its numbers depend on."""
    found = {"skdgp": "unknown", "python": platform.python_version()}
    for name in ("skdgp", "scikit-learn", "numpy", "scipy", "pandas"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # run from a folder that was never installed
            continue
    return found


def _closing(path) -> dict:
    """Return what the file's last line says."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - LONGEST_CLOSING))
        end = file.read()
    start = end.rfind(MAGIC)
    try:
        closing = json.loads(end[start + len(MAGIC) :]) if start >= 0 else {}
    except ValueError:
        closing = {}
    if closing.get("bytes") != size - (len(end) - start):
        raise ModelFileError(
            f"Got {path} ({size} bytes), which is not a whole skdgp model: its closing line is missing or does not "
            "fit. Expected a file that python -m skdgp identify or skdgp.identification.save_model wrote; if it is "
            "one, it was cut off or changed: copy it again."
        )
    return closing


def _same_versions(made_by) -> bool:
    here = software_versions()
    return all(made_by.get(name) == here.get(name) for name in MATTERS)


def _said(versions) -> str:
    return ", ".join(f"{name} {versions.get(name, 'unknown')}" for name in MATTERS)
