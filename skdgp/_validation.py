"""Checks at the door: what was got, what was expected, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

import numpy as np
import pandas as pd

LARGEST_ANGLE = {"alpha": np.pi, "beta": np.pi / 2, "phi": np.pi, "theta": np.pi / 2, "psi": 2 * np.pi}
SLACK = 0.05
"""Noise that may carry an angle over its largest value [rad]."""
FASTEST = 50.0
"""Rates beyond this [rad/s], eight turns a second, are in other units."""


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
            "(one row per sample): build one with skdgp.io.read_flight or pandas.DataFrame, or convert another "
            "library's with its to_pandas()."
        )
    if len(table) == 0:
        raise ValueError(f"Got {what} with no rows, but expected at least one sample.")
    twice = table.columns[table.columns.duplicated()].unique().tolist()
    if twice:
        raise ValueError(f"Got {what} with repeated columns {twice}, but expected each name once: drop one.")
    return table


def check_columns(table: pd.DataFrame, needed: Iterable[str], *, what: str = "flight") -> None:
    """Raise a ValueError that names the columns of ``needed`` that ``table`` lacks, and the nearest ones."""
    lacking = _lacking(needed, [str(column) for column in table.columns])
    if lacking:
        raise ValueError(
            f"The {_named(table, what)} lacks the columns {lacking}. "
            "Rename or compute them; docs/notation.md lists every name with its unit."
        )


def check_names(needed: Iterable[str], have: Iterable[str], what: str) -> None:
    """Raise a ValueError that tells which of the ``needed`` names are not among those there are, and the nearest."""
    have = [str(name) for name in have]
    lacking = _lacking(needed, have)
    if lacking:
        raise ValueError(f"The {what} lack {lacking}: got {have}. docs/notation.md lists every name with its unit.")


def _lacking(needed, have) -> str:
    """Return what is missing, each with the nearest name that there is; empty if nothing is."""
    hints = []
    for name in dict.fromkeys(needed):
        if name not in have:
            near = get_close_matches(name, have, n=1, cutoff=0.75)
            hints.append(f"{name!r} (nearest: {near[0]!r})" if near else f"{name!r}")
    return ", ".join(hints)


def check_radians(table: pd.DataFrame, names: Iterable[str]) -> None:
    """Raise a ValueError if one of the ``names``, angles and rates, holds what no radians can be; absent ones pass."""
    for name in names:
        values = np.abs(table[name].to_numpy(float, na_value=np.nan)) if name in table else np.empty(0)
        if not np.isfinite(values).any():
            continue
        top = np.nanmax(values)
        if name in LARGEST_ANGLE and top > LARGEST_ANGLE[name] + SLACK:
            raise ValueError(
                f"Got {name} up to {top:g}, but expected radians, at most {LARGEST_ANGLE[name]:.3f}: if these are "
                f"degrees, use numpy.deg2rad(flight[{name!r}])."
            )
        if name in ("p", "q", "r") and top > FASTEST:
            raise ValueError(
                f"Got |{name}| up to {top:g}, but expected rad/s ({FASTEST:g} rad/s is eight turns a second): if these "
                f"are degrees per second, use numpy.deg2rad(flight[{name!r}])."
            )


def _named(table, what) -> str:
    """Return what a table is, with the name of the flight where it holds one."""
    if what != "flight" or "flight" not in table:
        return what
    names = table["flight"].astype(str).unique()
    return f"flight {names[0]!r}" if len(names) == 1 else what
