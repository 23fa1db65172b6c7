"""CSV tables: separator, header, units, decimal comma."""

from __future__ import annotations

import csv
import re
from collections import deque
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from skdgp._compute.files import unguarded
from skdgp._compute.messages import warn
from skdgp._flight.channels import CHANNELS
from skdgp._flight.faults import FlightDataWarning
from skdgp.io._tables import FlightReadError, base_name, check_names, check_width, to_si

HEADING = re.compile(r"([^\[(]*+)[\[(]([^\])]*+)[\])]")
ABOVE = re.compile(
    r"\s*(#|sep=.\s*$)", re.IGNORECASE
)  # above the header: remarks, and Excel's separator
DECIMAL = {
    mark: re.compile(rf"\s*[+-]?\d*{re.escape(mark)}\d+(?:[eE][+-]?\d+)?\s*") for mark in ",."
}


def read_csv(path: Path, rename: Mapping[str, str]) -> pd.DataFrame:
    """Return the table of a CSV with a header of ``name`` or ``name [unit]``.

    Names in the header are replaced by those of ``rename``.

    Empty lines and remarks (#) before the header and columns without a name are left out; a last
    row that is shorter too, with a FlightDataWarning. Raise FlightReadError if it is no such table.
    """
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            return _table(file, path.name, rename)
    except UnicodeDecodeError as error:
        raise FlightReadError(
            f"Got a file that is not text ({error.reason}), but expected a CSV in UTF-8: save it "
            f"so, if it is one."
        ) from error
    except (csv.Error, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise FlightReadError(
            f"Got a file that is not a CSV table ({error}), but expected one."
        ) from error


def _table(file, file_name, rename):
    header = (
        number
        for number, line in enumerate(file)
        if line.strip(" \t\r\n,;") and not ABOVE.match(line)
    )
    if (above := next(header, None)) is None:
        words = "a header line, and a row for each sample under it"
        raise FlightReadError(f"Got a file that is empty, but expected {words}.")
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
    texts = {
        str(name): column.map(unguarded)
        for name, column in table.select_dtypes(exclude="number").items()
    }
    return to_si(table.assign(**texts), units)


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
            names, _ = _split_headings(next(_records(file, above, separator)))
        except csv.Error:  # a wide header without this separator is one long cell
            return 0, 0
        return sum(base_name(name) in CHANNELS for name in names), len(names)

    return max(",;\t", key=n_names)


def _split_headings(headings, rename=MappingProxyType({})):
    """Return names, and the units of those of a flight table; other headings stay as they are."""
    names, units = [], {}
    for heading in map(unguarded, map(str.strip, headings)):
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
    n_rows, cut, examples, marks = 0, "", {}, "" if separator == "," else ",."
    for cells in records:
        if len(cells) < 2 and not "".join(cells).strip():
            continue
        if cut:
            raise _uneven(cut, width, separator)
        n_rows += 1
        if len(cells) != width:
            words = f"line {above + records.line_num} has {len(cells)} cells"
            if any(cell.strip() for cell in cells[width:]):
                raise _uneven(words, width, separator)
            cut = words if len(cells) < needed else ""
        for mark in marks:
            if mark in "".join(cells):
                cell = next(
                    (
                        cells[k]
                        for k in numbers
                        if k < len(cells) and DECIMAL[mark].fullmatch(cells[k])
                    ),
                    None,
                )
                if cell is not None:
                    examples[mark], marks = cell, marks.replace(mark, "")
    if len(examples) == 2:
        raise FlightReadError(
            f"Got {examples[',']!r} with a decimal comma and {examples['.']!r} with a decimal "
            f"point, but expected one "
            "kind: write all with a point, and no separators of thousands."
        )
    return n_rows, cut, "," if "," in examples else "."


def _uneven(words, width, separator):
    hint = " (decimal commas need another one)" if separator == "," else ""
    return FlightReadError(
        f"Got rows of unequal length ({words}, the header has {width}), but expected a cell for "
        f"each name: quote cells "
        f"that hold the separator {separator!r}{hint}, and leave missing values empty between "
        f"separators."
    )
