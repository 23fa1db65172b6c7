"""Flights by name, of tables, files and logs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.channels import EULER, RATES, SPECIFIC_FORCE
from skdgp._flight.checks import check_table
from skdgp._flight.frames import wrapped
from skdgp._flight.ground import without_ground
from skdgp._flight.tables import FlightTable, has_values, interpolated, unwrapped
from skdgp.io import FlightReadError, is_log, read_flight

Flights = dict[str, FlightTable]
# fraction of equal rows above which a flight is a copy, and decimals to which they are equal
COPIED = 0.5
ROUNDED = 4
# median distance of attitudes [rad] below which they are of one flight; 0.6 or more apart in nine flights
SAME_ATTITUDE = 0.05


def named_flights(
    flights: Any, *, default: str = "flight", needed: Sequence[str] = (), **reading: Any
) -> Flights:
    """Return the flights by name; a column ``flight`` separates several flights in a table.

    Raises the errors of the readers, and ValueError if two flights have the same name, a flight
    lacks a column that is needed, or its time does not increase.

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
    dict of str to FlightTable
    """
    rename = reading.pop("rename", None)
    items = [("", item) for item in items_of(flights)]
    if isinstance(flights, Mapping):
        items = list(flights.items())
    if not items:
        raise ValueError("Got no flight, but expected at least one.")
    by_name: Flights = {}
    origin: dict[str, object] = {}
    for number, (key, item) in enumerate(items, start=1):
        place: object = f"table {number}"
        what = "flight"
        table = item
        if is_log(item):
            place = item
            what = f"log (skdgp inspect {item} says why)"
            table = read_flight(item, **reading)
        elif isinstance(item, str | os.PathLike):
            place = item
            table = read_flight(item, rename=rename)
        if not is_log(item):
            table = without_ground(check_table(table, what=what), key or f"{default} {number}")
        parts = split_flights(table, f"{default} {number}", needed, what=what)
        if key and len(parts) != 1:
            raise ValueError(
                f"Got {len(parts)} flights in the table {key!r}, but expected one for each name."
            )
        for own_name, flight in parts.items():
            name = key or own_name
            if name in by_name:
                raise FlightReadError(
                    f"Got flight {name!r} in {origin[name]} and in {place}, but expected each "
                    "once: name a file once, rename one of two files, change the name in the "
                    "column 'flight', or give a dict of names and tables."
                )
            by_name[name] = flight.named(name)
            origin[name] = place
    return by_name


def tables_of(flights: Flights) -> dict[str, pd.DataFrame]:
    """Return the tables of flights by name."""
    return {name: flight.table for name, flight in flights.items()}


def copies(flights: Flights, others: Flights) -> dict[str, str]:
    """Return by name the flights that are another one's copy: most of their rows are rows of it, at whatever time.

    Where both are the same flights, each pair is told once.
    """
    every = {**flights, **others}
    rows = {name: _motion(flight) for name, flight in every.items()}
    found: dict[str, str] = {}
    for name in flights:
        for other in others:
            is_pair = name != other and found.get(other) != name
            if not is_pair:
                continue
            has_its_rows = len(rows[name] & rows[other]) > COPIED * len(rows[name])
            if has_its_rows or _has_its_attitude(every[name], every[other]):
                found[name] = other
    return found


def _has_its_attitude(flight: FlightTable, other: FlightTable) -> bool:
    """Return whether two flights have the same attitude at the same times, as a log and its telemetry have."""
    if not has_values(flight.table, *EULER) or not has_values(other.table, *EULER):
        return False
    is_inside = (flight.time >= other.time[0]) & (flight.time <= other.time[-1])
    if is_inside.sum() <= COPIED * len(is_inside):
        return False
    angles = unwrapped(other.table, EULER)
    there = interpolated(flight.time[is_inside], other.time, angles, beyond=np.nan)
    apart = wrapped(unwrapped(flight.table, EULER)[is_inside] - there)
    return bool(np.nanmedian(np.linalg.norm(apart, axis=1)) < SAME_ATTITUDE)


def _motion(flight: FlightTable) -> set[tuple[float, ...]]:
    """Return the different rows of rates and specific force, rounded below their noise."""
    values = np.column_stack([flight.column(name) for name in (*RATES, *SPECIFIC_FORCE)])
    measured = values[np.isfinite(values).all(axis=1)]
    return {tuple(row) for row in np.round(measured, ROUNDED).tolist()}


def items_of(flights: Any) -> list:
    """Return the tables and paths of a dict or a list, or of a single one."""
    if isinstance(flights, Mapping):
        return list(flights.values())
    return list(flights) if isinstance(flights, list | tuple) else [flights]


def split_flights(
    table: Any, default: str = "flight", needed: Sequence[str] = (), *, what: str = "flight"
) -> Flights:
    """Return each flight of a table, in their order; raise ValueError at a table that is none of flights."""
    table = check_table(table, what=what)
    if "flight" not in table:
        table = table.assign(flight=default)
    return FlightTable.of(table, needed, what=what).flights
