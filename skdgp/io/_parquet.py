"""Parquet tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from skdgp._compute.messages import warn
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


def _table(path: Path, pyarrow: Any) -> pd.DataFrame:
    with pyarrow.parquet.ParquetFile(path) as file:
        schema, size = file.schema_arrow, file.metadata
    check_width(len(schema.names))
    check_names(name.strip() for name in schema.names)
    fields = [field for field in schema if not field.name.startswith(INDEX)]
    kinds = {field.name: _plain(field.type, pyarrow) for field in fields}
    left_out = {name: str(schema.field(name).type) for name in kinds if kinds[name] is None}
    for name, kind in left_out.items():
        if base_name(name.strip()) in CHANNELS:
            raise FlightReadError(
                f"Got column {name!r} of type {kind}, but expected one value in each row: write "
                f"one column for each value."
            )
    if left_out:
        words = f"{path.name}: columns that hold neither numbers, texts nor times are left out: {left_out}."
        warn(words, FlightDataWarning, stacklevel=4)
    kinds = {name: kind for name, kind in kinds.items() if kind is not None}
    packed = sum(size.row_group(g).total_byte_size for g in range(size.num_row_groups))
    check_room(max(8 * size.num_rows * len(kinds), packed), room_for(path.stat().st_size))
    texts = [name for name, kind in kinds.items() if pyarrow.types.is_dictionary(kind)]
    with pyarrow.parquet.ParquetFile(path, read_dictionary=texts) as file:
        table = file.read(columns=list(kinds))
    frame = table.cast(pyarrow.schema(kinds)).to_pandas(ignore_metadata=True)
    return frame.astype(dict.fromkeys(texts, object))  # rows of one text share it


def _plain(kind: Any, pyarrow: Any) -> Any:
    """Return the type that a table holds: of numbers, texts or times; None for others."""
    types = pyarrow.types
    kind = kind.value_type if types.is_dictionary(kind) else kind
    if types.is_string(kind) or types.is_large_string(kind):
        return pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    if types.is_decimal(kind):
        return pyarrow.float64()
    return kind if types.is_primitive(kind) or types.is_null(kind) else None
