"""MATLAB files: vectors named as in the vocabulary, loose or as the fields of one struct."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat

from skdgp._vocabulary import CHANNELS
from skdgp.io._errors import FlightReadError
from skdgp.io._units import base_name

HDF5 = b"MATLAB 7.3"


def read_mat(path: Path) -> pd.DataFrame:
    """Read a MATLAB file of version 4 to 7.

    Raises
    ------
    FlightReadError
        If it is damaged, of version 7.3, holds no vector ``time``, or vectors of the vocabulary differ in length.
    """
    with open(path, "rb") as file:
        if file.read(len(HDF5)) == HDF5:
            raise FlightReadError(
                f"Got {path} of MATLAB's version 7.3 (HDF5), but expected version 7 or earlier: save('flight.mat', "
                "'-v7', ...) in MATLAB, or writetable(..., 'flight.csv')."
            )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of variables that are no numbers
            content = loadmat(path, simplify_cells=True)
    except Exception as error:  # the parser raises whatever it stumbles on
        raise FlightReadError(
            f"Got {path}, which is not a whole MATLAB file ({str(error) or type(error).__name__}), but expected one of "
            "version 7 or earlier: save it again."
        ) from error
    tables = {name: vectors for name, vectors in _structs("", content) if "time" in vectors}
    if len(tables) != 1:
        found = [name or "loose vectors" for name in tables]
        told = f"several tables, {found}" if found else f"no vector 'time' among {sorted(content)[:12]}"
        raise FlightReadError(f"Got {told}, but expected one: vectors of equal length, loose or in one struct.")
    (vectors,) = tables.values()
    n = len(vectors["time"])
    uneven = {name: len(each) for name, each in vectors.items() if len(each) != n and base_name(name) in CHANNELS}
    if uneven:
        raise FlightReadError(f"Got vectors of lengths {uneven}, but expected {n}, as many values as time has.")
    return pd.DataFrame({name: each for name, each in vectors.items() if len(each) == n})


def _structs(name, content):
    """Yield the struct's own vectors, then those of the structs in it."""
    yield name, {key: _vector(value) for key, value in content.items() if _vector(value) is not None}
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _structs(f"{name}.{key}".lstrip("."), value)


def _vector(value):
    """Return numbers or texts as a vector, or None if they are none."""
    value = np.asarray(value)
    if value.ndim == 1 and value.dtype.kind in "iufbUO":
        return value.astype(float) if value.dtype.kind in "iufb" else value.astype(str)
    return None
