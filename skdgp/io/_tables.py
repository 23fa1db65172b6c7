"""Tables: what their readers check, and the readers of CSV and Parquet files."""

from __future__ import annotations

import csv
import os
import re
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._flight.channels import CHANNELS, TRUTH_SUFFIX
from skdgp._flight.faults import FlightDataWarning

MOST_COLUMNS = 10_000
# bytes that any file may take when unpacked, and bytes more for each byte of it
ROOM, ROOM_PER_BYTE = (2**28, 100)
TO_SI = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6),
    "rad": ("rad", 1.0), "deg": ("rad", np.pi / 180),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", np.pi / 180), "rpm": ("rad/s", np.pi / 30),
    "rad/s^2": ("rad/s^2", 1.0), "deg/s^2": ("rad/s^2", np.pi / 180),
    "m": ("m", 1.0), "ft": ("m", 0.3048),
    "m/s": ("m/s", 1.0), "kt": ("m/s", 1852 / 3600), "km/h": ("m/s", 1 / 3.6), "ft/s": ("m/s", 0.3048),
    "m/s^2": ("m/s^2", 1.0), "g": ("m/s^2", 9.80665),
    "kg/m^3": ("kg/m^3", 1.0), "N": ("N", 1.0), "N m": ("N m", 1.0), "": ("", 1.0), "%": ("", 0.01),
}  # fmt: skip
UNITS = {unit.lower(): meaning for unit, meaning in TO_SI.items()}
SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "dps": "deg/s", "sec": "s", "µs": "us", "-": "",
    "1": "", "kts": "kt", "knots": "kt", "m/s2": "m/s^2", "m/s²": "m/s^2", "rad/s2": "rad/s^2", "rad/s²": "rad/s^2",
    "deg/s2": "deg/s^2", "°/s²": "deg/s^2", "kg/m3": "kg/m^3", "kg/m³": "kg/m^3", "nm": "N m", "n": "N",
}  # fmt: skip


class FlightReadError(ValueError):
    """A file cannot be read as a flight; its path stands before the message."""

    path: str | os.PathLike | None = None

    def __str__(self) -> str:
        return super().__str__() if self.path is None else f"{self.path}: {super().__str__()}"


@contextmanager
def reading(path: str | os.PathLike) -> Iterator[None]:
    """Name the file in a FlightReadError of the block."""
    try:
        yield
    except FlightReadError as error:
        error.path = path
        raise


def check_width(n_columns: int) -> None:
    """Raise a FlightReadError if a table has too many columns."""
    if n_columns > MOST_COLUMNS:
        raise FlightReadError(
            f"Got {n_columns} columns, but expected at most {MOST_COLUMNS}: keep those of the "
            f"flight, with a row for "
            "each sample."
        )


def base_name(column: str) -> str:
    """Return the name of the vocabulary of a column of simulated truth."""
    return column.removesuffix(TRUTH_SUFFIX)


def check_names(names: Iterable[str]) -> None:
    """Raise a FlightReadError if a column name stands twice."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise FlightReadError(
            f"Got columns {twice} repeated, but expected each name once: drop one."
        )


def to_floats(column: pd.Series) -> np.ndarray:
    """Return a column as floats, whatever type holds its numbers; raise FlightReadError for a row that is none."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        column = pd.Series(np.asarray(column), name=column.name)
    if pd.api.types.is_numeric_dtype(column):
        return column.to_numpy(dtype=float, na_value=np.nan)
    timed = pd.api.types.is_datetime64_any_dtype(column) or pd.api.types.is_timedelta64_dtype(
        column
    )
    numbers = pd.Series(np.nan, column.index) if timed else pd.to_numeric(column, errors="coerce")
    values = numbers.to_numpy(dtype=float, na_value=np.nan)
    bad = np.flatnonzero(np.isnan(values) & column.notna().to_numpy())
    if bad.size:
        raise FlightReadError(
            f"Got {column.iloc[bad[0]]!r} in column {column.name!r} at row {bad[0]} ({bad.size} "
            f"rows are not numbers), "
            f"but expected numbers [{CHANNELS[base_name(str(column.name))].unit}]: leave missing "
            f"values empty, and "
            "write no separators of thousands."
        )
    return values


def to_si(table: pd.DataFrame, units: dict[str, str]) -> pd.DataFrame:
    """Convert columns whose unit the file states; raise FlightReadError for a unit of another quantity."""
    converted = {}
    for name, text in units.items():
        expected = CHANNELS[base_name(name)].unit
        unit = SPELLINGS.get(text.strip().lower(), text.strip()).lower()
        quantity, factor = UNITS.get(unit, ("unknown", 1.0))
        if quantity != expected:
            fitting = [unit for unit, (si, _) in TO_SI.items() if si == expected]
            raise FlightReadError(
                f"Got unit {text!r} for column {name!r}, but expected one of {fitting}."
            )
        if factor != 1.0:
            converted[name] = to_floats(table[name]) * factor
    return table.assign(**converted)


HEADING = re.compile(r"([^\[(]*+)[\[(]([^\])]*+)[\])]")
ABOVE = re.compile(
    r"\s*(#|sep=.\s*$)", re.IGNORECASE
)  # above the header: remarks, and Excel's separator
DECIMAL = {
    mark: re.compile(rf"\s*[+-]?\d*{re.escape(mark)}\d+(?:[eE][+-]?\d+)?\s*") for mark in ",."
}


def read_csv(path: Path, rename: Mapping[str, str]) -> pd.DataFrame:
    """Return the table of a CSV with a header of ``name`` or ``name [unit]``.

    ``rename`` replaces names in the header.

    Empty lines and remarks (#) before the header and columns without a name are left out; a last
    row that is shorter too, with a FlightDataWarning. Raise FlightReadError if it is no such table.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            return _csv_table(file, path.name, rename)
    except UnicodeDecodeError as error:
        raise FlightReadError(
            f"Got a file that is not text ({error.reason}), but expected a CSV in UTF-8: save it "
            f"so, if it is one."
        ) from error
    except (csv.Error, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise FlightReadError(
            f"Got a file that is not a CSV table ({error}), but expected one."
        ) from error


def _csv_table(file, file_name, rename):
    header = (
        number
        for number, line in enumerate(file)
        if line.strip(" \t\r\n,;") and not ABOVE.match(line)
    )
    if (above := next(header, None)) is None:
        expected = "a header line, and a row for each sample under it"
        raise FlightReadError(f"Got a file that is empty, but expected {expected}.")
    separator = _separator(file, above)
    records = _records(file, above, separator)
    names, units = _split_headings(next(records), rename)
    check_width(len(names))
    check_names(name for name in names if name)
    below = above + records.line_num
    n_rows, cut, decimal = _check_rows(_records(file, below, separator), names, separator, below)
    _forward(file, below)
    table = pd.read_csv(
        file,
        sep=separator,
        decimal=decimal,
        header=None,
        names=[name for name in names if name],
        usecols=[place for place, name in enumerate(names) if name],
        dtype={"flight": str} if "flight" in names else None,
        index_col=False,
        skipinitialspace=True,
        low_memory=False,
    ).copy()  # one piece of memory instead of one for each column
    if len(table) != n_rows:
        raise FlightReadError(
            f"Got {n_rows} or {len(table)} rows, by how quotes are read, but expected one number."
        )
    if cut:
        warn(
            f"{file_name}: {cut}, so it was cut off and is left out.",
            FlightDataWarning,
            stacklevel=4,
        )
        table = table.iloc[:-1]
    return to_si(table, units)


def _forward(file, n_lines):
    """Skip lines from the begin of the file."""
    file.seek(0)
    deque(islice(file, n_lines), maxlen=0)


def _records(file, n_lines, separator):
    _forward(file, n_lines)
    return csv.reader(file, delimiter=separator, skipinitialspace=True)


def _separator(file, above) -> str:
    """Return the separator that gives the header most names of the vocabulary, then most names."""

    def n_names(separator):
        try:
            names, _ = _split_headings(next(_records(file, above, separator)), {})
        except csv.Error:  # a wide header without this separator is one long cell
            return 0, 0
        return sum(base_name(name) in CHANNELS for name in names), len(names)

    return max(",;\t", key=n_names)


def _split_headings(headings, rename):
    """Return names, and units by name of a flight table; other headings stay as they are."""
    names, units = [], {}
    for heading in map(str.strip, headings):
        match = HEADING.fullmatch(heading)
        name = match[1].strip() if match else heading
        name = rename.get(heading, rename.get(name, name))
        is_known = base_name(name) in CHANNELS
        if match and is_known:
            units[name] = match[2]
        names.append(name if is_known else heading)
    return names, units


def _check_rows(records, names, separator, above) -> tuple[int, str, str]:
    """Return the number of rows, a remark if the last one is cut off, and the decimal mark."""
    width = len(names)
    needed = max((place + 1 for place, name in enumerate(names) if name), default=0)
    numbers = [
        place
        for place, name in enumerate(names)
        if base_name(name) in CHANNELS and name != "flight"
    ]
    n_rows, cut = 0, ""
    examples = dict.fromkeys("" if separator == "," else ",.")
    for cells in records:
        if len(cells) < 2 and not "".join(cells).strip():
            continue
        if cut:
            raise _uneven(cut, width, separator)
        n_rows += 1
        if len(cells) != width:
            remark = f"line {above + records.line_num} has {len(cells)} cells"
            if any(cell.strip() for cell in cells[width:]):
                raise _uneven(remark, width, separator)
            cut = remark if len(cells) < needed else ""
        for mark, example in examples.items():
            decimals = (
                cells[k] for k in numbers if k < len(cells) and DECIMAL[mark].fullmatch(cells[k])
            )
            examples[mark] = example or next(decimals, None)
    if examples and all(examples.values()):
        raise FlightReadError(
            f"Got {examples[',']!r} with a decimal comma and {examples['.']!r} with a decimal "
            f"point, but expected one kind: write all with a point, and no separators of "
            f"thousands."
        )
    return n_rows, cut, "," if examples.get(",") else "."


def _uneven(remark, width, separator):
    hint = " (decimal commas need another one)" if separator == "," else ""
    return FlightReadError(
        f"Got rows of unequal length ({remark}, the header has {width}), but expected a cell for "
        f"each name: quote cells "
        f"that hold the separator {separator!r}{hint}, and leave missing values empty between "
        f"separators."
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
        return _parquet_table(path, pyarrow)
    except (FlightReadError, Warning):
        raise
    except Exception as error:  # a damaged file makes pyarrow raise nearly anything
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise FlightReadError(
            f"Got a file that is not a whole parquet file ({reason}), but expected one: copy or "
            f"export it again."
        ) from error


def _parquet_table(path: Path, pyarrow: Any) -> pd.DataFrame:
    with pyarrow.parquet.ParquetFile(path) as file:
        schema, size = file.schema_arrow, file.metadata
        check_width(len(schema.names))
        check_names(name.strip() for name in schema.names)
        fields = [field for field in schema if not field.name.startswith(INDEX)]
        nested = {
            field.name: str(field.type)
            for field in fields
            if not _has_one_value(field.type, pyarrow.types)
        }
        if nested:
            raise FlightReadError(
                f"Got columns of types {nested}, but expected one value in each row: drop them, "
                f"or write one column for each value."
            )
        packed = sum(size.row_group(g).total_byte_size for g in range(size.num_row_groups))
        needed = max(8 * size.num_rows * len(fields), packed)
        room = ROOM + ROOM_PER_BYTE * path.stat().st_size
        if needed > room:
            raise FlightReadError(
                f"Got a file that takes {needed / 2**20:.0f} MiB when unpacked, but expected at "
                f"most {room / 2**20:.0f} MiB (256 MiB and {ROOM_PER_BYTE} times its size): write "
                f"each flight into a file of its own."
            )
        table = file.read(columns=[field.name for field in fields]).replace_schema_metadata(None)
    return table.to_pandas()


def _has_one_value(kind: Any, types: Any) -> bool:
    """Return whether a cell of this type is a number, a text or a time."""
    kind = kind.value_type if types.is_dictionary(kind) else kind
    tests = (
        types.is_primitive,
        types.is_null,
        types.is_decimal,
        types.is_string,
        types.is_large_string,
    )
    return any(test(kind) for test in tests)
