"""Flights by name, of tables, files and logs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from skdgp._flight.checks import check_columns, check_table
from skdgp._flight.clock import flight_rows
from skdgp.io import FlightReadError, is_log, read_flight

Flights = dict[str, pd.DataFrame]


def named_flights(
    flights: Any, *, default: str = "flight", needed: Sequence[str] = (), **reading: Any
) -> Flights:
    """Return one table for each flight by name; a column ``flight`` separates several flights in a table.

    Raises the errors of the readers, and ValueError if two flights have the same name, or a flight
    lacks a column that is needed.

    Parameters
    ----------
    flights : DataFrame, path, dict of name to table, or list of tables and paths
    default : str
        Tables without names are ``default`` 1, 2, ...
    needed : sequence of str
        Columns of each flight.
    **reading
        Of :func:`skdgp.io.read_flight`: ``rename`` for tables, the others for logs of autopilots.

    Returns
    -------
    dict of str to DataFrame
    """
    renaming = {"rename": reading.pop("rename", None)}
    items = [("", item) for item in items_of(flights)]
    if isinstance(flights, Mapping):
        items = list(flights.items())
    if not items:
        raise ValueError("Got no flight, but expected at least one.")
    by_name: Flights = {}
    origin: dict[str, object] = {}
    for number, (key, item) in enumerate(items, start=1):
        is_path = isinstance(item, str | os.PathLike)
        from_log = is_path and is_log(item)
        if is_path:
            table = read_flight(item, **(reading if from_log else renaming))
        else:
            table = check_table(item)
        place = item if is_path else f"table {number}"
        what = f"log (skdgp inspect {item} says why)" if from_log else "flight"
        parts = flights_of(table, f"{default} {number}")
        if key and len(parts) != 1:
            raise ValueError(
                f"Got {len(parts)} flights in the table {key!r}, but expected one for each name."
            )
        for own_name, part in parts.items():
            name = key or own_name
            if name in by_name:
                raise FlightReadError(
                    f"Got flight {name!r} in {origin[name]} and in {place}, but expected each "
                    "once: name a file once, rename one of two files, change the name in the "
                    "column 'flight', or give a dict of names and tables."
                )
            check_columns(part, needed, what=what)
            by_name[name] = part.assign(flight=name)
            origin[name] = place
    return by_name


def items_of(flights: Any) -> list:
    """Return the tables and paths of a dict or a list, or of a single one."""
    if isinstance(flights, Mapping):
        return list(flights.values())
    return list(flights) if isinstance(flights, list | tuple) else [flights]


def flights_of(table: pd.DataFrame, default: str = "flight") -> Flights:
    """Return one table for each flight, in their order."""
    if "flight" not in table:
        table = table.assign(flight=default)
    return {
        name: table.iloc[rows].reset_index(drop=True).assign(flight=name)
        for name, rows in flight_rows(table["flight"]).items()
    }
