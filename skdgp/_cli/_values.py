"""Conversion of option values from text."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from skdgp.preprocessing._selector import REGRESSOR_SETS


class FileName(str):
    """A file or folder that was named: configurations keep where it is, wherever they are read."""

    def __new__(cls, text):
        """Refuse a name that no configuration and no report could hold."""
        try:
            text.encode()
        except UnicodeEncodeError:
            raise argparse.ArgumentTypeError(f"got {text!a}, but expected a name in UTF-8: rename it") from None
        return super().__new__(cls, text)


def airborne(text):
    """Read the airspeed above which a log is a flight, or all of it."""
    return text if text == "all" else speed(text)


def at_least(lowest):
    """Return what reads whole numbers from ``lowest`` on."""

    def integer(text):
        value = _whole(text, f"a whole number, {lowest} or more")
        if value < lowest:
            raise argparse.ArgumentTypeError(f"got {text}, but expected {lowest} or more")
        return value

    return integer


def _whole(text, expected):
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}") from None


def latents(text):
    """Read a number of latent processes, or auto."""
    return text if text == "auto" else at_least(0)(text)


def samples(text):
    """Read how many rows are learned from, or all."""
    if text == "all":
        return text
    value = _whole(text, "a whole number, 2 or more, or all")
    if value < 2:
        raise argparse.ArgumentTypeError(f"got {text}, but expected 2 or more, or all")
    return value


def paths(text):
    """Read how many functions of the posterior tell a spread: none, or at least two."""
    value = at_least(0)(text)
    if value == 1:
        raise argparse.ArgumentTypeError("got 1, but expected 0 or at least 2: one path has no spread")
    return value


def jobs(text):
    """Read a number of processes."""
    expected = "a number of processes, 1 or more, or -1 for all cores"
    value = _whole(text, expected)
    if value == 0:
        raise argparse.ArgumentTypeError(f"got 0, but expected {expected}")
    return value


def regressors(text):
    """Read the name of a set of regressors, or names of columns with commas between."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    return text if text in REGRESSOR_SETS else names


def number(text, expected="a number"):
    """Read a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"got {text}, but expected {expected}")
    return value


def positive(what):
    """Return what reads numbers > 0 of ``what``."""

    def read(text):
        value = number(text, f"{what} > 0")
        if value <= 0:
            raise argparse.ArgumentTypeError(f"got {text}, but expected {what} > 0")
        return value

    return read


seconds = positive("seconds")
speed = positive("m/s")


def table_file(text):
    """Read the name of a table to be written."""
    if Path(text).suffix not in (".csv", ".parquet"):
        raise argparse.ArgumentTypeError(f"got {text}, but expected a name that ends in .csv or .parquet")
    return FileName(text)
