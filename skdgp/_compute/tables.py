"""Tables of any library, and CSV files that a spreadsheet does not compute."""

from __future__ import annotations

import re
from typing import Any

import pandas as pd

from skdgp._compute.files import Writer

FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""How a text begins that a spreadsheet computes (OWASP, CSV injection), perhaps behind apostrophes."""


def column_names(y) -> list[str]:
    """Return the columns of a dataframe of any library, or the name of a series; empty if they are not all texts."""
    names = list(getattr(y, "columns", [getattr(y, "name", None)]))
    return names if all(isinstance(name, str) and name for name in names) else []


def csv_writer(table: pd.DataFrame) -> Writer:
    """Return what writes a table, every digit of it, an apostrophe before texts that a spreadsheet would compute."""
    texts = table.select_dtypes(exclude="number").astype(object).map(guarded)
    safe = table.assign(**{str(name): texts[name] for name in texts}).rename(columns=guarded)
    return lambda path: safe.to_csv(path, index=False)


def guarded(value: Any) -> Any:
    """Return a text with an apostrophe before it if a spreadsheet would compute it, and any other value as it is."""
    return f"'{value}" if isinstance(value, str) and _is_formula(value) else value


def unguarded(value: Any) -> Any:
    """Return the value that :func:`guarded` was given."""
    is_guarded = isinstance(value, str) and value.startswith("'") and _is_formula(value[1:])
    return value[1:] if is_guarded else value


def _is_formula(text: str) -> bool:
    if not FORMULA.match(text):
        return False
    try:
        float(text)
    except ValueError:
        return True
    return False
