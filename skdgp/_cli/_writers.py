"""Writers of output files: text, JSON, tables, pictures."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

Writer = Callable[[Path], object]


def text_writer(text: str) -> Writer:
    """Return what writes the text."""
    return lambda path: path.write_text(text, encoding="utf-8")


def json_writer(value) -> Writer:
    """Return what writes the value as JSON."""
    return text_writer(json.dumps(plain(value), indent=1, allow_nan=False) + "\n")


def table_writer(table: pd.DataFrame, suffix: str, *, index: bool = False) -> Writer:
    """Return what writes a table as ".csv" or ".parquet", every digit of it."""
    if suffix == ".parquet":
        return lambda path: table.to_parquet(path, index=index)
    return lambda path: table.to_csv(path, index=index)


def check_writable(suffix: str) -> None:
    """Raise an ImportError if tables of this suffix cannot be written here."""
    if suffix == ".parquet" and find_spec("pyarrow") is None:
        raise ImportError('Parquet needs pyarrow, which is not installed: pip install "skdgp[parquet]", or write CSV.')


def picture_writers(name: str, draw: Callable, *data, **options) -> dict[str, Writer]:
    """Return what writes the picture that a display's ``draw`` makes; nothing, and a warning, without matplotlib."""
    if find_spec("matplotlib") is None:
        warnings.warn('No picture: it needs pip install "skdgp[plot]".', UserWarning, stacklevel=2)
        return {}
    from matplotlib.figure import Figure

    display = draw(*data, ax=Figure(layout="constrained"), **options)
    return {name: lambda path: display.figure_.savefig(path, dpi=150)}


def plain(value):
    """Return the value as JSON knows it: what is not a finite number is null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
