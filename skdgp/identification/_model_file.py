"""The file of an identified model, with a checksum."""

from __future__ import annotations

import json
import os
import warnings
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

import joblib
from sklearn.exceptions import InconsistentVersionWarning, NotFittedError
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import sha256_of, software_versions, write_atomically
from skdgp.dynamics import Aircraft

MAGIC = b"\nskdgp model file "
FORMAT = 2
CHECKSUM, END = b', "sha256": "', b'"}\n'
CHECKSUM_LENGTH = 64
LONGEST_CLOSING = 2**14
MATTERS = ("skdgp", "scikit-learn", "numpy")


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
            f"fitted pipeline and "
            "its Aircraft: call fit first."
        )
    return write_atomically(path, lambda temporary: dump_model(temporary, model))


def model_bunch(pipeline: Pipeline, aircraft: Aircraft, **facts) -> Bunch:
    """Return what a model file holds, with the time and the versions of now."""
    now = {
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": software_versions(),
    }
    return Bunch(pipeline=pipeline, aircraft=aircraft, **facts | now)


def dump_model(path: Path, model: Bunch) -> None:
    """Write the model and, after it, a line of JSON that can be read when the model itself cannot.

    Unpickling stops before that line. It ends in the SHA-256 of all that stands before the digest.
    """
    joblib.dump(model, path)
    closing = {
        "format": FORMAT,
        "bytes": path.stat().st_size,
        "created": model.created,
        "versions": model.versions,
    }
    with path.open("a+b") as file:
        file.write(MAGIC + json.dumps(closing).encode().removesuffix(b"}") + CHECKSUM)
        file.write(sha256_of(file, file.tell()) + END)


def load_model(path: str | os.PathLike) -> Bunch:
    """Return a model that :func:`save_model` or ``python -m skdgp identify`` wrote.

    The file is a pickle, and loading may run any code in it: open only files whose origin you
    trust.

    The result has ``pipeline`` (fitted: a raw flight table in, coefficients out), ``aircraft``,
    ``created``, ``versions`` and the facts saved with it: of :func:`identify` ``options`` (thrust,
    external forces, ...), ``fit`` (samples, seconds, log likelihood, ...) and ``flights`` learned
    from.

    Raises FileNotFoundError if there is no such file, ModelFileError if it is not a model, is cut
    off or differs from what was written in a single bit, or cannot be read by the versions
    installed here. Warns if it was made by other versions of skdgp, scikit-learn or NumPy.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"Got {path}, but there is no such file: python -m skdgp identify writes model.joblib."
        )
    with path.open("rb") as file:
        made_by, here = _closing(file, path)["versions"], software_versions()
        if any(made_by.get(name) != here.get(name) for name in MATTERS):
            warnings.warn(
                f"{path} was made by {_in_words(made_by)}, and this is {_in_words(here)}: its "
                f"predictions may differ. "
                "Compare a few, fit it again, or install those versions.",
                stacklevel=2,
            )
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", InconsistentVersionWarning
                )  # warned of above, once for all
                file.seek(0)
                model = joblib.load(file)
        except Exception as error:  # unpickling may raise anything
            raise ModelFileError(
                f"Got {path}, written by {_in_words(made_by)}, which cannot be read here, with "
                f"{_in_words(here)} "
                f"({type(error).__name__}: {error}): fit it again, or install those versions."
            ) from error
    if not _is_model(model):
        raise ModelFileError(
            f"Got {path}, which holds {type(model).__name__}, but expected a fitted pipeline and "
            f"its aircraft: fit it "
            "again, and write it with skdgp.identification.save_model."
        )
    return model


def _closing(file: BinaryIO, path) -> dict:
    """Return the file's last line, or raise ModelFileError if the file is not whole."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - LONGEST_CLOSING))
    end = file.read()
    start = end.rfind(MAGIC)
    before = size - CHECKSUM_LENGTH - len(END)
    try:
        closing = json.loads(end[start + len(MAGIC) :]) if start >= 0 else {}
        form, made_by = closing["format"], _in_words(closing["versions"])
        whole = closing["bytes"] == size - (len(end) - start)
        whole &= sha256_of(file, before) + END == end[before - size :]
    except (
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        RecursionError,
    ):  # not what dump_model writes
        whole = False
    if not whole:
        raise ModelFileError(
            f"Got {path} ({size} bytes), which is not a whole skdgp model: its closing line is "
            f"missing or does not "
            "fit. Expected a file that python -m skdgp identify or "
            "skdgp.identification.save_model wrote; if it is "
            "one, it was cut off or changed: copy it again."
        )
    if form != FORMAT:
        raise ModelFileError(
            f"Got {path} of format {form}, written by {made_by}, but this skdgp reads format "
            f"{FORMAT}: fit it again, "
            "or install that version."
        )
    return closing


def _is_model(found) -> bool:
    """Whether this is what a model file holds: a fitted estimator and an aircraft."""
    try:
        check_is_fitted(found.pipeline)
    except (AttributeError, TypeError, NotFittedError):
        return False
    return isinstance(found, Bunch) and isinstance(found.get("aircraft"), Aircraft)


def _in_words(versions) -> str:
    return ", ".join(f"{name} {versions.get(name, 'unknown')}" for name in MATTERS)
