"""Tables of any library: pandas, polars and others."""

from __future__ import annotations


def column_names(y) -> list[str]:
    """Return the columns of a dataframe of any library, or the name of a series; empty if they are not all texts."""
    names = list(getattr(y, "columns", [getattr(y, "name", None)]))
    return names if all(isinstance(name, str) and name for name in names) else []
