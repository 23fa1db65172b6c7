"""MATLAB tables: vectors named as columns, loose or as fields of one struct, in files of versions 5 to 7."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS
from skdgp.io import _mat_vectors
from skdgp.io._tables import FlightReadError, base_name, check_width, room_for

HDF5 = b"MATLAB 7.3"
HEADER_SIZE = 128
BYTE_ORDERS = (b"IM", b"MI")  # last bytes of the header
TIMEOUT = 60  # seconds for one file; 100 MiB take a second


def read_mat(path: Path) -> pd.DataFrame:
    """Return the table of a MATLAB file; raise FlightReadError if it is damaged or holds no table with ``time``.

    ``scipy.io.loadmat`` trusts types and sizes in a file: of 3000 damaged files 18 end the process
    (SciPy 1.17.1; https://github.com/scipy/scipy/issues/6072). So it runs in a process of its own.
    """
    with open(path, "rb") as file:
        head = file.read(HEADER_SIZE)
    if head.startswith(HDF5):
        raise FlightReadError(
            "Got a file of MATLAB's version 7.3 (HDF5), but expected version 7 or earlier: "
            "save('flight.mat', '-v7', ...) in MATLAB, or writetable(..., 'flight.csv')."
        )
    if head[-2:] not in BYTE_ORDERS:
        raise _refusal("it does not begin as one of these versions does")
    room = str(room_for(path.stat().st_size))
    command = [sys.executable, "-P", _mat_vectors.__file__, str(path), room]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIMEOUT, env=environment)
    except subprocess.TimeoutExpired as error:
        raise _refusal(f"it takes more than {TIMEOUT} s") from error
    if done.returncode:
        *_, reason = done.stderr.decode(errors="replace").splitlines() or ["SciPy fails on it"]
        raise _refusal(reason)
    with np.load(io.BytesIO(done.stdout)) as arrays:
        names, *vectors = arrays.values()
    return _table(dict(zip(names.tolist(), vectors, strict=True)))


def _refusal(reason: str) -> FlightReadError:
    return FlightReadError(
        f"Got a file that is not a whole MATLAB file ({reason}), but expected one of version 5 "
        f"to 7: save it again, with '-v7'."
    )


def _table(vectors: dict[str, np.ndarray]) -> pd.DataFrame:
    """Return the only table with ``time`` among vectors, named ``struct.field`` or ``name``."""
    check_width(len(vectors))
    tables: dict[str, dict[str, np.ndarray]] = {}
    for place, vector in vectors.items():
        struct, _, name = place.rpartition(".")
        tables.setdefault(struct, {})[name] = vector
    timed = {name: columns for name, columns in tables.items() if "time" in columns}
    if len(timed) != 1:
        names = [name or "loose vectors" for name in timed]
        lacking = f"no vector 'time' among {sorted(vectors)[:12]}"
        raise FlightReadError(
            f"Got {f'several tables, {names}' if names else lacking}, but expected one: vectors "
            "of equal length, loose or in one struct (of a MATLAB table: table2struct(T, "
            "'ToScalar', true))."
        )
    (columns,) = timed.values()
    n = len(columns["time"])
    lengths = {name: len(vector) for name, vector in columns.items() if len(vector) != n}
    uneven = {name: length for name, length in lengths.items() if base_name(name) in CHANNELS}
    if uneven:
        raise FlightReadError(
            f"Got vectors of lengths {uneven}, but expected {n}, as many values as time has."
        )
    return pd.DataFrame({name: column for name, column in columns.items() if len(column) == n})
