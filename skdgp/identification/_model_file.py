"""The file of an identified model, with a checksum."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import warnings
from datetime import datetime
from pathlib import Path
from typing import Any

from sklearn.exceptions import InconsistentVersionWarning, NotFittedError
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import software_versions, write_atomically
from skdgp._compute.messages import warn
from skdgp.dynamics import Aircraft

MAGIC = b"skdgp model file "
DIGEST = 64  # hexadecimal digits of SHA-256
FORMAT = 4
MATTERS = ("skdgp", "scikit-learn", "numpy")
"""Packages whose versions may change predictions of a model that can be read."""


class ModelFileError(ValueError):
    """A file could not be read as a model."""


def save_model(
    path: str | os.PathLike, pipeline: Pipeline, aircraft: Aircraft, **facts: Any
) -> Path:
    """Write a fitted pipeline, its aircraft and facts into one file, which appears whole or not at all.

    Raises TypeError if ``pipeline`` is not a fitted estimator or ``aircraft`` no `Aircraft`.

    Parameters
    ----------
    path : path-like
        In a folder that exists.
    pipeline : Pipeline
    aircraft : Aircraft
    **facts
        Further entries, such as ``options={"thrust": "columns"}``.

    Returns
    -------
    Path
    """
    model = model_bunch(pipeline, aircraft, **facts)
    if not _is_model(model):
        raise TypeError(
            f"Got {type(pipeline).__name__} and {type(aircraft).__name__} to save, but expected a "
            f"fitted pipeline and its Aircraft: call fit first."
        )
    return write_atomically(path, lambda temporary: dump_model(temporary, model))


def model_bunch(pipeline: Pipeline, aircraft: Aircraft, **facts) -> Bunch:
    """Return the content of a model file, with the current time and versions."""
    now = {
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": software_versions(),
    }
    return Bunch(pipeline=pipeline, aircraft=aircraft, **facts | now)


def dump_model(path: Path, model: Bunch) -> None:
    """Write a line with the SHA-256 of the rest, a line of JSON, and the pickled model."""
    header = {"format": FORMAT, "created": model.created, "versions": model.versions}
    content = json.dumps(header).encode() + b"\n" + pickle.dumps(model, protocol=5)
    path.write_bytes(MAGIC + hashlib.sha256(content).hexdigest().encode() + b"\n" + content)


def load_model(path: str | os.PathLike) -> Bunch:
    """Return a model that :func:`save_model` or ``skdgp identify`` wrote.

    The file holds a pickle, and loading may run any code in it: open only files whose origin you
    trust.

    The result has ``pipeline`` (fitted: a raw flight table in, coefficients out), ``aircraft``,
    ``created``, ``versions`` and the facts saved with it: of :func:`identify` ``options`` (thrust,
    external forces, ...), ``fit`` (samples, seconds, log likelihood, ...) and ``flights`` learned
    from.

    Raises FileNotFoundError if there is no such file, ModelFileError if it is not a model, is cut
    off or was changed in a single bit, or cannot be read by the versions
    installed here. Warns if it was made by other versions of skdgp, scikit-learn or NumPy.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"Got {path}, but there is no such file: skdgp identify writes model.joblib."
        )
    header, data = _checked_content(path)
    installed = software_versions()
    versions = _differences(header["versions"], installed)
    if any(header["versions"].get(name) != installed.get(name) for name in MATTERS):
        warn(
            f"Got {path}, written with {versions}: its predictions may differ. Compare a few, fit "
            f"it again, or install those versions.",
            stacklevel=2,
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InconsistentVersionWarning)  # it is warned of above
            model = pickle.loads(data)
    except Exception as error:  # unpickling may raise anything
        raise ModelFileError(
            f"Got {path}, written with {versions}, which cannot be read here "
            f"({type(error).__name__}: {error}). Fit it again, or install those versions."
        ) from error
    if not _is_model(model):
        raise ModelFileError(
            f"Got {path}, which holds {type(model).__name__}, but expected a fitted pipeline and "
            f"its aircraft: fit it again, and write it with skdgp.identification.save_model."
        )
    return model


def _checked_content(path: Path) -> tuple[dict, bytes]:
    """Return the header of a model file and the pickled model; raise ModelFileError if it is not whole."""
    data = path.read_bytes()
    start = len(MAGIC) + DIGEST + 1
    content = data[start:]
    first_line = MAGIC + hashlib.sha256(content).hexdigest().encode() + b"\n"
    if data[:start] != first_line:
        raise ModelFileError(
            f"Got {path} ({len(data)} bytes), which is not a whole skdgp model of this format: its "
            f"checksum is missing or does not fit. Expected a file that skdgp identify or "
            f"skdgp.identification.save_model wrote; if it is one, it was cut off or changed: "
            f"copy it again."
        )
    line, _, model = content.partition(b"\n")
    header = json.loads(line)
    if header["format"] != FORMAT:
        made_by = _in_words(header["versions"], MATTERS)
        raise ModelFileError(
            f"Got {path} of format {header['format']}, written with {made_by}, but this skdgp "
            f"reads format {FORMAT}: fit it again, or install that version."
        )
    return header, model


def _is_model(content: Any) -> bool:
    """Return whether this is the content of a model file: a fitted estimator and an aircraft."""
    try:
        check_is_fitted(content.pipeline)
    except (AttributeError, TypeError, NotFittedError):
        return False
    return isinstance(content, Bunch) and isinstance(content.get("aircraft"), Aircraft)


def _differences(made_by: dict, installed: dict) -> str:
    """Return the versions that differ, then those that are installed."""
    names = [name for name, number in installed.items() if made_by.get(name) != number]
    if not names:
        return "the versions that are installed here"
    return f"{_in_words(made_by, names)} (installed: {_in_words(installed, names)})"


def _in_words(versions: dict, names: Any) -> str:
    return ", ".join(f"{name} {versions.get(name, 'unknown')}" for name in names)
