"""Parquet tables."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from skdgp._flight.channels import CHANNELS
from skdgp._flight.faults import FlightDataWarning
from skdgp.io._tables import (
    FlightReadError,
    base_name,
    check_names,
    check_room,
    check_width,
    room_for,
)

INDEX = "__index_level_"  # begin of the name that pandas gives to an index without one


def read_parquet(path: Path) -> pd.DataFrame:
    """Return the table of a Parquet file; an index that pandas wrote into it is a column if it has a name.

    Raise FlightReadError if it is damaged, too wide, or takes far more memory than its size,
    ImportError without pyarrow. Columns of lists, structs and bytes are left out, with a
    FlightDataWarning.
    """
    try:
        import pyarrow.compute
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(
            "Reading parquet needs pyarrow, which is not installed: pip install 'skdgp[parquet]', "
            "or write a CSV."
        ) from error
    try:
        return _table(path, pyarrow)
    except (FlightReadError, Warning):
        raise
    except Exception as error:  # a damaged file makes pyarrow raise nearly anything
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise FlightReadError(
            f"Got a file that is not a whole parquet file ({reason}), but expected one: copy or "
            f"export it again."
        ) from error


def _table(path, pyarrow):
    with pyarrow.parquet.ParquetFile(path) as file:
        schema, size, room = file.schema_arrow, file.metadata, room_for(path.stat().st_size)
    check_width(len(schema.names))
    check_names(name.strip() for name in schema.names)
    plain = {
        field.name: _plain(field, pyarrow) for field in schema if not field.name.startswith(INDEX)
    }
    left_out = {name: str(schema.field(name).type) for name, kind in plain.items() if kind is None}
    if needed := [name for name in left_out if base_name(name.strip()) in CHANNELS]:
        raise FlightReadError(
            f"Got column {needed[0]!r} of type {left_out[needed[0]]}, but expected one value in "
            f"each row: write one "
            "column for each value."
        )
    if left_out:
        words = f"{path.name}: columns that hold neither numbers, texts nor times are left out: {left_out}."
        warnings.warn(words, FlightDataWarning, stacklevel=4)
    plain = {name: kind for name, kind in plain.items() if kind is not None}
    packed = [size.row_group(g).total_byte_size for g in range(size.num_row_groups)]
    check_room(max(8 * size.num_rows * len(plain), sum(packed)), room)
    texts = [name for name, kind in plain.items() if kind == pyarrow.large_string()]
    with pyarrow.parquet.ParquetFile(
        path, read_dictionary=texts
    ) as file:  # a text that repeats is read once
        table = file.read(columns=list(plain))
    check_room(sum(_text_bytes(table[name], pyarrow) for name in texts), room)
    return table.cast(pyarrow.schema(plain)).to_pandas(ignore_metadata=True)


def _plain(field, pyarrow):
    """Return the type that a table holds: of numbers, texts or times; None for others."""
    types, kind = pyarrow.types, field.type
    kind = kind.value_type if types.is_dictionary(kind) else kind
    of_bytes = types.is_binary(kind) or types.is_large_binary(kind)
    if (
        types.is_string(kind)
        or types.is_large_string(kind)
        or (of_bytes and field.name.strip() == "flight")
    ):
        return pyarrow.large_string()
    if types.is_decimal(kind):
        return pyarrow.float64()
    simple = types.is_integer, types.is_floating, types.is_boolean, types.is_null, types.is_temporal
    return kind if any(is_one(kind) for is_one in simple) else None


def _text_bytes(column, pyarrow) -> int:
    """Return how many bytes the texts of a column take, without writing them out."""
    total = 0
    for chunk in column.chunks:
        if pyarrow.types.is_dictionary(chunk.type):
            lengths = np.append(
                pyarrow.compute.binary_length(chunk.dictionary).fill_null(0).to_numpy(False), 0
            )
            total += int(lengths[chunk.indices.fill_null(-1).to_numpy(False)].sum())
        else:
            total += chunk.nbytes
    return total
