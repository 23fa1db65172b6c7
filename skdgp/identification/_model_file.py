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

from sklearn.exceptions import InconsistentVersionWarning
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import software_versions, write_atomically
from skdgp._compute.messages import report
from skdgp._flight.findings import Code, Finding
from skdgp.dynamics import Aircraft, check_aircraft

FORMAT = 15  # a pickle, a line of JSON, and the SHA-256 of all bytes before it
DIGEST = 64  # its length
# Packages whose versions may change predictions of a model that can be read
MATTERS = ("skdgp", "scikit-learn", "numpy")


class ModelFileError(ValueError):
    """A file could not be read as a model."""


def save_model(
    path: str | os.PathLike, pipeline: Pipeline, aircraft: Aircraft, **facts: Any
) -> Path:
    """Write a fitted pipeline, its aircraft and facts into one file, which appears whole or not at all.

    Raises NotFittedError if ``pipeline`` is not fitted, TypeError if it is no estimator or ``aircraft`` no
    `Aircraft`.

    Parameters
    ----------
    path : path-like
    pipeline : Pipeline
    aircraft : Aircraft
    **facts
        Further entries, such as ``options={"thrust": None}``.

    Returns
    -------
    Path
    """
    check_is_fitted(pipeline)
    check_aircraft(aircraft)
    made = {
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": software_versions(),
    }
    model = Bunch(pipeline=pipeline, aircraft=aircraft, **facts | made)

    def write(temporary: Path) -> None:
        closing = json.dumps({"format": FORMAT, **made}).encode()
        temporary.write_bytes(_with_digest(pickle.dumps(model, protocol=5) + b"\n" + closing))

    return write_atomically(path, write)


def _with_digest(content: bytes) -> bytes:
    """Return the bytes of a file, and after them their SHA-256."""
    return content + hashlib.sha256(content).hexdigest().encode()


def load_model(path: str | os.PathLike) -> Bunch:
    """Return a model that :func:`save_model` or ``skdgp identify`` wrote.

    The file is a pickle, which ``joblib.load`` reads too, without these checks, and loading may run any
    code in it: open only files whose origin you trust.

    The result has ``pipeline`` (fitted: a raw flight table in, coefficients out), ``aircraft``,
    ``created``, ``versions`` and the facts saved with it: of :func:`identify` ``options`` (thrust,
    ...), ``fit`` (samples, seconds, log likelihood, ...) and ``flights`` learned
    from.

    Raises FileNotFoundError if there is no such file, ModelFileError if it is not a model, is cut
    off or was changed in a single bit, or cannot be read by the versions
    installed here. Warns if it was made by other versions of skdgp, scikit-learn or NumPy.
    """
    data = Path(path).read_bytes()
    content = data[:-DIGEST]
    if data != _with_digest(content):
        raise ModelFileError(
            f"Got {path} ({len(data)} bytes), which is not a whole skdgp model. Expected a file that skdgp identify "
            f"or skdgp.identification.save_model wrote; if it is one, it was cut off or changed, or "
            f"written by another version: copy it again, or fit it again."
        )
    pickled, _, line = content.rpartition(b"\n")
    header = json.loads(line)
    made_by, installed = _in_words(header["versions"]), _in_words(software_versions())
    if header["format"] != FORMAT:
        raise ModelFileError(
            f"Got {path} of format {header['format']}, written with {made_by}, but this skdgp reads format "
            f"{FORMAT}: fit it again, or install that version."
        )
    if made_by != installed:
        report(
            Finding(
                Code.OTHER_VERSIONS,
                path=str(path),
                differences=f"{made_by} (installed: {installed})",
            )
        )
    try:
        with warnings.catch_warnings():
            # the versions are told above
            warnings.simplefilter("ignore", InconsistentVersionWarning)
            return pickle.loads(pickled)
    except Exception as error:  # unpickling may raise anything
        raise ModelFileError(
            f"Got {path}, written with {made_by}, which cannot be read by {installed} here "
            f"({type(error).__name__}: {error}). Fit it again, or install those versions."
        ) from error


def _in_words(versions: dict) -> str:
    """Return the versions of the packages that matter."""
    return ", ".join(f"{name} {versions.get(name, 'unknown')}" for name in MATTERS)
