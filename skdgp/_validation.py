"""Checks at the door: what was got, what was expected, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

import pandas as pd


def check_table(table, *, what: str = "flight") -> pd.DataFrame:
    """Return ``table`` if it is a DataFrame with named, unique columns and at least one row.

    Raises
    ------
    TypeError
        If it is not a DataFrame.
    ValueError
        If it has no rows or a column name stands twice.
    """
    if not isinstance(table, pd.DataFrame):
        raise TypeError(
            f"Got {type(table).__name__} for {what}, but expected a pandas DataFrame with named columns "
            "(one row per sample): build one with skdgp.io.read_flight or pandas.DataFrame."
        )
    if len(table) == 0:
        raise ValueError(f"Got {what} with no rows, but expected at least one sample.")
    twice = table.columns[table.columns.duplicated()].unique().tolist()
    if twice:
        raise ValueError(f"Got {what} with repeated columns {twice}, but expected each name once: drop one.")
    return table


def check_columns(table: pd.DataFrame, needed: Iterable[str], *, what: str = "flight") -> None:
    """Raise a ValueError that names the columns of ``needed`` that ``table`` lacks, and the nearest ones."""
    have = [str(column) for column in table.columns]
    missing = [name for name in needed if name not in have]
    if not missing:
        return
    hints = []
    for name in missing:
        near = get_close_matches(name, have, n=1, cutoff=0.75)
        hints.append(f"{name!r} (nearest: {near[0]!r})" if near else f"{name!r}")
    raise ValueError(
        f"The {what} lacks the columns {', '.join(hints)}. Got {have}. "
        "Rename or compute them; docs/notation.md lists every name with its unit."
    )
