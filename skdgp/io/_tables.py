"""Tables: what their readers check, and the readers of CSV and Parquet files."""

from __future__ import annotations

import csv
import io
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import extra, warn
from skdgp._flight.channels import CHANNELS, TRUTH_SUFFIX
from skdgp._flight.faults import FlightDataWarning

# factors of units by the unit of SI
TO_SI = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "rad": {"rad": 1.0, "deg": np.pi / 180},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": np.pi / 180},
    "m": {"m": 1.0, "ft": 0.3048},
    "m/s": {
        "m/s": 1.0, "kt": 1852 / 3600, "km/h": 1 / 3.6, "ft/s": 0.3048, "ft/min": 0.3048 / 60, "mph": 0.44704,
    },
    "m/s^2": {"m/s^2": 1.0, "g": 9.80665, "ft/s^2": 0.3048},
    "kg": {"kg": 1.0, "lb": 0.45359237, "slug": 14.593903},
    "kg/m^3": {"kg/m^3": 1.0, "lb/ft^3": 16.018463, "slug/ft^3": 515.378818},
    "N": {"lbf": 4.4482216, "N": 1.0},
    "N m": {"N m": 1.0},
    "": {"": 1.0, "%": 0.01},
}  # fmt: skip
SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "°/s^2": "deg/s^2", "dps": "deg/s", "µs": "us",
    "-": "", "1": "", "kts": "kt", "knots": "kt", "nm": "N m", "n m": "N m", "n": "N", "fpm": "ft/min",
    "lbs": "lb", "mi/h": "mph",
}  # fmt: skip
# Powers and seconds have several spellings in any unit: m/s2, m/s², m/sec^2
POWER = re.compile(r"(?<=[a-z])([23])\b")


class FlightReadError(ValueError):
    """A file cannot be read as a flight; its path stands before the message."""

    path: str | os.PathLike | None = None

    def __str__(self) -> str:
        message = super().__str__()
        return message if self.path is None else f"{self.path}: {message}"


@contextmanager
def reading(path: str | os.PathLike) -> Iterator[None]:
    """Name the file in a FlightReadError of the block."""
    try:
        yield
    except FlightReadError as error:
        error.path = path
        raise


def base_name(column: str) -> str:
    """Return the name of the vocabulary of a column of simulated truth."""
    return column.removesuffix(TRUTH_SUFFIX)


def is_number(column: str) -> bool:
    """Return whether the vocabulary has a column of this name, and numbers in it."""
    return base_name(column) in CHANNELS and column != "flight"


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
    # times are no numbers
    if column.dtype.kind in "mM":
        numbers = pd.Series(np.nan, index=column.index)
    else:
        numbers = pd.to_numeric(column, errors="coerce")
    values = numbers.to_numpy(dtype=float, na_value=np.nan)
    bad = np.flatnonzero(np.isnan(values) & column.notna().to_numpy())
    if bad.size:
        raise _no_numbers(column, bad)
    return values


def _no_numbers(column: pd.Series, bad: np.ndarray) -> FlightReadError:
    """Return the error of a column with rows that are no numbers."""
    row = bad[0]
    cell = column.iloc[row]
    unit = CHANNELS[base_name(str(column.name))]
    remedy = "leave missing values empty, write no separators of thousands, one decimal mark, units in the header"
    if column.name == "time":
        remedy = "write seconds, with another unit in the header, or dates as 2024-05-03T12:00:00.25 (ISO 8601)"
    return FlightReadError(
        f"Got {cell!r} in column {column.name!r} at row {row} ({bad.size} rows are not "
        f"numbers), but expected numbers [{unit}]: {remedy}."
    )


def to_si(table: pd.DataFrame, units: dict[str, str]) -> pd.DataFrame:
    """Convert columns whose unit the file states; raise FlightReadError for a unit of another quantity."""
    converted = {}
    for name, text in units.items():
        factors = TO_SI[CHANNELS[base_name(name)]]
        factor = factors.get(_usual_spelling(text))
        if factor is None:
            raise FlightReadError(
                f"Got unit {text!r} for column {name!r}, but expected one of {[*factors]}."
            )
        if factor != 1.0:
            converted[name] = to_floats(table[name]) * factor
    return table.assign(**converted)


def _usual_spelling(unit: str) -> str:
    """Return a unit as the table of units spells it, if it has it."""
    written = unit.strip().lower().replace("²", "2").replace("³", "3").replace("sec", "s")
    written = POWER.sub(r"^\1", written)
    return SPELLINGS.get(written, written)


HEADING = re.compile(r"([^\[(]*+)[\[(]([^\])]*+)[\])]")
# above the header: empty lines, remarks, and Excel's separator
ABOVE = re.compile(r"[ \t,;]*$|\s*#|\s*sep=.\s*$", re.IGNORECASE)


def read_csv(path: Path, rename: Mapping[str, str]) -> pd.DataFrame:
    """Return the table of a CSV with a header of ``name`` or ``name [unit]``.

    ``rename`` replaces names in the header.

    Empty lines and remarks (#) before the header and columns without a name are left out; a last
    row that is shorter too, with a FlightDataWarning. Raise FlightReadError if it is no such table.
    """
    try:
        return _csv_table(path.read_text(encoding="utf-8-sig"), path.name, rename)
    except UnicodeDecodeError as error:
        raise FlightReadError(
            f"Got a file that is not text ({error.reason}), but expected a CSV in UTF-8: save it so, if it is one."
        ) from error
    except (csv.Error, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise FlightReadError(
            f"Got a file that is not a CSV table ({error}), but expected one."
        ) from error


def _csv_table(text: str, file_name: str, rename: Mapping[str, str]) -> pd.DataFrame:
    lines = io.StringIO(text).readlines()
    n_above = 0
    while n_above < len(lines) and ABOVE.match(lines[n_above]):
        n_above += 1
    if n_above == len(lines):
        raise FlightReadError(
            "Got a file that is empty, but expected a header line, and a row for each sample under it."
        )
    lines = lines[n_above:]
    separator = max(",;\t|", key=lambda mark: _n_names(lines, mark))
    records = _records(lines, separator)
    names, units = _split_headings(next(records), rename)
    check_names(name for name in names if name)
    rows = "".join(lines[records.line_num :])
    cut = _check_rows(records, names, n_above, separator)
    table = _parsed(rows, names, separator)
    if cut:
        remark = f"{file_name}: {cut}, so it was cut off and is left out."
        warn(remark, FlightDataWarning)
        table = table.iloc[:-1]
    # one piece of memory instead of one for each column
    return to_si(table.copy(), units)


def _parsed(rows: str, names: list[str], separator: str) -> pd.DataFrame:
    """Return the columns that have a name; the file does not say which decimal mark it has.

    It is the one by which more columns are numbers, as times may be dates.
    """
    named = [name for name in names if name]
    numbers = [name for name in named if is_number(name)]
    tables = []
    for decimal in "." if separator == "," else ".,":
        table = pd.read_csv(
            io.StringIO(rows),
            sep=separator,
            decimal=decimal,
            header=None,
            names=named,
            usecols=[place for place, name in enumerate(names) if name],
            dtype={"flight": str} if "flight" in names else None,
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )
        is_numeric = table[numbers].dtypes.map(pd.api.types.is_numeric_dtype)
        tables.append((is_numeric.sum(), table))
    _, table = max(tables, key=lambda item: item[0])
    return table


def _records(lines: list[str], separator: str) -> Any:
    return csv.reader(lines, delimiter=separator, skipinitialspace=True)


def _n_names(lines: list[str], separator: str) -> tuple[int, int]:
    """Return how many names of the vocabulary a separator gives the header, and how many names."""
    try:
        names, _ = _split_headings(next(_records(lines, separator)), {})
    except csv.Error:  # a wide header without this separator is one long cell
        return 0, 0
    return sum(base_name(name) in CHANNELS for name in names), len(names)


def _split_headings(
    headings: list[str], rename: Mapping[str, str]
) -> tuple[list[str], dict[str, str]]:
    """Return names, and units by name of a flight table; other headings stay as they are."""
    names = []
    units = {}
    for heading in map(str.strip, headings):
        match = HEADING.fullmatch(heading)
        name = match[1].strip() if match else heading
        name = rename.get(heading, rename.get(name, name))
        if base_name(name) not in CHANNELS:
            name = heading
        elif match:
            units[name] = match[2]
        names.append(name)
    return names, units


def _check_rows(records: Any, names: list[str], above: int, separator: str) -> str:
    """Return a remark if the last row is cut off; raise FlightReadError if others have too few or too many cells."""
    width = len(names)
    needed = max((place + 1 for place, name in enumerate(names) if name), default=0)
    uneven = ""
    for cells in records:
        is_longer = any(cell.strip() for cell in cells[width:])
        is_row = len(cells) > 1 or any(cells)
        if is_row and not uneven and (is_longer or len(cells) < needed):
            uneven = f"line {above + records.line_num} has {len(cells)} cells"
            is_row = is_longer
        # only a last row may be short
        if is_row and uneven:
            hint = " (decimal commas need another one)" if separator == "," else ""
            raise FlightReadError(
                f"Got rows of unequal length ({uneven}, the header has {width}), but expected a cell for each name: "
                f"quote cells that hold the separator {separator!r}{hint}, and leave missing values empty between "
                "separators."
            )
    return uneven


# the names that pandas gives to an index without one
INDEX = re.compile(r"__index_level_\d+__")


def read_parquet(path: Path, rename: Mapping[str, str]) -> pd.DataFrame:
    """Return the table of a Parquet file; an index that pandas wrote into it is a column if it has a name.

    ``rename`` is not needed, as names have no units. Raise FlightReadError if it is damaged or a column has lists or
    records, ImportError without pyarrow.
    """
    parquet = extra("pyarrow.parquet", "parquet")
    try:
        table = parquet.ParquetFile(path).read()
    except Exception as error:  # a damaged file makes pyarrow raise nearly anything
        reason = next(iter(str(error).splitlines()), type(error).__name__)
        raise FlightReadError(
            f"Got a file that is not a whole parquet file ({reason}), but expected one: copy or export it again."
        ) from error
    is_nested = extra("pyarrow.types", "parquet").is_nested
    nested = {field.name: str(field.type) for field in table.schema if is_nested(field.type)}
    if nested:
        raise FlightReadError(
            f"Got columns of lists or records, {nested}, but expected one number, text or time in each cell: write a "
            "column for each element, or leave them out."
        )
    names = [name for name in table.column_names if not INDEX.match(name)]
    check_names(name.strip() for name in names)
    return table.select(names).replace_schema_metadata(None).to_pandas()
