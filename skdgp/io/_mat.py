"""Reader of MATLAB tables: vectors named as columns, loose or as fields of one struct."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS
from skdgp.io._errors import FlightReadError
from skdgp.io._mat5 import parse_mat5
from skdgp.io._units import base_name

HDF5 = b"MATLAB 7.3"


def read_mat(path: Path) -> pd.DataFrame:
    """Read a MATLAB file of version 5 to 7.

    Raises
    ------
    FlightReadError
        If it is damaged, far larger unpacked, of another version, holds no vector ``time``, or vectors of the
        vocabulary differ in length.
    """
    data = path.read_bytes()
    if data.startswith(HDF5):
        raise FlightReadError(
            f"Got {path} of MATLAB's version 7.3 (HDF5), but expected version 7 or earlier: save('flight.mat', "
            "'-v7', ...) in MATLAB, or writetable(..., 'flight.csv')."
        )
    try:
        content = parse_mat5(data)
    except FlightReadError:
        raise
    except ValueError as error:
        raise FlightReadError(
            f"Got {path}, which is not a whole MATLAB file ({error}), but expected one of version 5 to 7: save it "
            "again, with '-v7'."
        ) from error
    tables = {name: vectors for name, vectors in _structs("", content) if "time" in vectors}
    if len(tables) != 1:
        found = [name or "loose vectors" for name in tables]
        told = f"several tables, {found}" if found else f"no vector 'time' among {sorted(content)[:12]}"
        raise FlightReadError(
            f"Got {told}, but expected one: vectors of equal length, loose or in one struct (of a MATLAB table: "
            "table2struct(T, 'ToScalar', true))."
        )
    (vectors,) = tables.values()
    n = len(vectors["time"])
    uneven = {name: len(each) for name, each in vectors.items() if len(each) != n and base_name(name) in CHANNELS}
    if uneven:
        raise FlightReadError(f"Got vectors of lengths {uneven}, but expected {n}, as many values as time has.")
    return pd.DataFrame({name: each for name, each in vectors.items() if len(each) == n})


def _structs(name, content):
    """Yield the struct's own vectors, then those of the structs in it."""
    vectors = {key: _vector(value) for key, value in content.items()}
    yield name, {key: vector for key, vector in vectors.items() if vector is not None}
    for key, value in content.items():
        if isinstance(value, dict):
            yield from _structs(f"{name}.{key}".lstrip("."), value)


def _vector(value):
    """Return numbers or texts as a vector, or None if they are none."""
    if isinstance(value, list):
        return np.array(value, dtype=object)
    if isinstance(value, np.ndarray) and value.size and value.size == max(value.shape):
        return value.astype(float).ravel()
    return None
