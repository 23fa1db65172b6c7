"""The file of an identified model, with a checksum."""

from __future__ import annotations

import json
import os
import pickle
import warnings
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

from sklearn.exceptions import InconsistentVersionWarning, NotFittedError
from sklearn.pipeline import Pipeline
from sklearn.utils import Bunch
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import sha256_of, software_versions, write_atomically
from skdgp._compute.messages import report
from skdgp._flight.findings import Code, Finding
from skdgp.dynamics import Aircraft

MAGIC = b"\nskdgp model file "
FORMAT = 12
CHECKSUM, END = b', "sha256": "', b'"}\n'
CHECKSUM_LENGTH = 64
LONGEST_CLOSING = 2**14
# Packages whose versions may change predictions of a model that can be read
MATTERS = ("skdgp", "scikit-learn", "numpy")


def options_of(model: Bunch) -> dict[str, Any]:
    """Return the options that a model was identified with; of another one its thrust is found in the flights."""
    return {"thrust": "auto", "external_forces": []} | model.get("options", {})


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
        Further entries, such as ``options={"thrust": None}``.

    Returns
    -------
    Path
    """
    now = {
        "created": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": software_versions(),
    }
    model = Bunch(pipeline=pipeline, aircraft=aircraft, **facts | now)
    if not _is_model(model):
        raise TypeError(
            f"Got {type(pipeline).__name__} and {type(aircraft).__name__} to save, but expected a "
            f"fitted pipeline and its Aircraft: call fit first."
        )
    return write_atomically(path, lambda temporary: _dump(temporary, model))


def _dump(path: Path, model: Bunch) -> None:
    """Write the model and, after it, a line of JSON that can be read when the model itself cannot.

    Unpickling stops before that line. It ends in the SHA-256 of all bytes before the digest.
    """
    closing = {"format": FORMAT, "created": model.created, "versions": model.versions}
    with path.open("x+b") as file:
        pickle.dump(model, file, protocol=5)
        file.write(MAGIC + json.dumps(closing).encode().removesuffix(b"}") + CHECKSUM)
        file.write(sha256_of(file, file.tell()) + END)


def load_model(path: str | os.PathLike) -> Bunch:
    """Return a model that :func:`save_model` or ``skdgp identify`` wrote.

    The file is a pickle, and loading may run any code in it: open only files whose origin you
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
    with path.open("rb") as file:
        made_by = _closing(file, path)["versions"]
        installed = software_versions()
        if any(made_by.get(name) != installed.get(name) for name in MATTERS):
            differences = f"{_in_words(made_by)} (installed: {_in_words(installed)})"
            numbers = {"path": str(path), "differences": differences}
            report(Finding(Code.OTHER_VERSIONS, numbers=numbers))
        file.seek(0)
        try:
            with warnings.catch_warnings():
                # the versions are told above
                warnings.simplefilter("ignore", InconsistentVersionWarning)
                model = pickle.load(file)
        except Exception as error:  # unpickling may raise anything
            raise ModelFileError(
                f"Got {path}, written with {_in_words(made_by)}, which cannot be read by "
                f"{_in_words(installed)} here ({type(error).__name__}: {error}). Fit it again, or install those "
                "versions."
            ) from error
    if not _is_model(model):
        raise ModelFileError(
            f"Got {path}, which holds {type(model).__name__}, but expected a fitted pipeline and "
            f"its aircraft: fit it again, and write it with skdgp.identification.save_model."
        )
    return model


def _closing(file: BinaryIO, path) -> dict:
    """Return the file's last line, or raise ModelFileError if the file is not whole."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - LONGEST_CLOSING))
    end = file.read()
    before = size - CHECKSUM_LENGTH - len(END)
    if before <= 0 or sha256_of(file, before) + END != end[before - size :]:
        raise ModelFileError(
            f"Got {path} ({size} bytes), which is not a whole skdgp model: its closing line is "
            f"missing or does not fit. Expected a file that skdgp identify or "
            f"skdgp.identification.save_model wrote; if it is one, it was cut off or changed: "
            f"copy it again."
        )
    closing = json.loads(end.split(MAGIC)[-1])
    if closing["format"] != FORMAT:
        made_by = _in_words(closing["versions"])
        raise ModelFileError(
            f"Got {path} of format {closing['format']}, written with {made_by}, but this skdgp reads format "
            f"{FORMAT}: fit it again, or install that version."
        )
    return closing


def _is_model(content: Any) -> bool:
    """Return whether this is the content of a model file: a fitted estimator and an aircraft."""
    try:
        check_is_fitted(content.pipeline)
    except (AttributeError, TypeError, NotFittedError):
        return False
    return isinstance(content, Bunch) and isinstance(content.get("aircraft"), Aircraft)


def _in_words(versions: dict) -> str:
    return ", ".join(f"{name} {versions.get(name, 'unknown')}" for name in MATTERS)
