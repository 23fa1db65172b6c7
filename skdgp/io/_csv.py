"""CSV: separator, header with or without units, decimal comma."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import pandas as pd

from skdgp._vocabulary import CHANNELS
from skdgp.io._errors import FlightReadError
from skdgp.io._units import base_name, known_unit, to_si

HEADING = re.compile(r"^\s*(?P<name>[^\[(]*?)\s*[\[(](?P<unit>[^\])]*)[\])]\s*$")


def read_csv(path: Path) -> pd.DataFrame:
    """Read a CSV with one header line, ``name`` or ``name [unit]``, and perhaps a line of units under it.

    Raises
    ------
    FlightReadError
        If it is empty, not a table of text, or states a unit that does not fit.
    """
    head = _first_lines(path)
    separator = max(",;\t", key=head[0].count)
    cells = [[cell.strip().strip('"') for cell in line.split(separator)] for line in head]
    names, units = _split_headings(cells[0])
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise FlightReadError(f"Got {path} with columns {twice} repeated, but expected each name once: drop one.")
    skipped = 1
    if len(cells) > 1 and _is_units_row(cells[1], names):
        units |= {n: u for n, u in zip(names, cells[1], strict=True) if base_name(n) in CHANNELS and u}
        skipped = 2
    numbers = head[skipped] if len(head) > skipped else ""
    decimal = "," if separator == ";" and "," in numbers and "." not in numbers else "."
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(
                path,
                sep=separator,
                decimal=decimal,
                names=names,
                skiprows=skipped,
                encoding="utf-8-sig",
                index_col=False,
                skipinitialspace=True,
            )
    except (pd.errors.ParserError, pd.errors.ParserWarning, UnicodeDecodeError) as error:
        raise FlightReadError(f"Got {path}, which is not a CSV table ({error}), but expected one.") from error
    texts = [name for name in units if not pd.api.types.is_numeric_dtype(table[name])]
    return to_si(table, {name: unit for name, unit in units.items() if name not in texts})


def _first_lines(path):
    try:
        with open(path, encoding="utf-8-sig") as file:
            lines = [file.readline().rstrip("\r\n") for _ in range(3)]
    except UnicodeDecodeError as error:
        raise FlightReadError(
            f"Got {path}, which is not text ({error.reason}), but expected a CSV in UTF-8: is the suffix right?"
        ) from error
    if not lines[0].strip():
        raise FlightReadError(f"Got {path}, which is empty or starts with an empty line, but expected a header line.")
    return [line for line in lines if line]


def _split_headings(headings):
    """Names, and the units of those in the vocabulary; other headings stay as they are."""
    names, units = [], {}
    for heading in headings:
        match = HEADING.match(heading)
        if match and base_name(match["name"]) in CHANNELS:
            units[match["name"]] = match["unit"]
            names.append(match["name"])
        else:
            names.append(heading)
    return names, units


def _is_units_row(cells, names):
    """Whether a line holds units: no number in it, and a known unit under every known name but the flight's."""
    if len(cells) != len(names) or any(_is_number(cell) for cell in cells):
        return False
    known = [cell for cell, name in zip(cells, names, strict=True) if base_name(name) in CHANNELS and name != "flight"]
    return bool(known) and any(known) and all(known_unit(cell) is not None for cell in known)


def _is_number(text):
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return text.lower() not in ("nan", "inf", "-inf")
