"""Flights by name, of tables, files and logs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skdgp._compute.messages import report
from skdgp._flight.channels import (
    ALL_SURFACES,
)
from skdgp._flight.channels import FULL_THROW as IN_FULL_THROWS
from skdgp._flight.copies import without_copies
from skdgp._flight.faults import without_ground
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import FlightTable, check_table
from skdgp.io import FULL_THROW, FlightReadError, is_log, names_servos, read_flight

Flights = dict[str, FlightTable]
SLOWEST = 8.0  # rows a second that show the fast modes; a guess


def train_and_test(
    flights: Any, test: Any, regressors: Sequence[str], needed: Sequence[str], **reading: Any
) -> tuple[Flights, Flights, Any]:
    """Return flights to learn from, flights to be tested on, each once, and what gave their surfaces.

    Without test flights the last of several is held out, of a single one the last quarter. Warns of
    that, of slow logs, and of copies.
    """
    given = [*items_of(flights), *([] if test is None else items_of(test))]
    servos = _servos_for(reading.get("servos"), given, regressors)
    reading["servos"] = servos
    train = named_flights(flights, needed=needed, **reading)
    if servos is None and any(IN_FULL_THROWS in flight.table for flight in train.values()):
        servos = FULL_THROW
    steps = [np.median(np.diff(flight.time)) for flight in train.values() if len(flight.time) > 1]
    if max(steps, default=0.0) > 1 / SLOWEST:
        report(Finding(Code.SLOW_LOG, numbers={"rate": float(1 / max(steps))}))
    tested: Flights = {}
    if test is not None:
        tested = named_flights(test, default="test flight", needed=needed, **reading)
    train, tested = without_copies(train, tested)
    if test is None:
        train, tested = _without_last(train)
    return train, tested, servos


def _without_last(flights: Flights) -> tuple[Flights, Flights]:
    """Return training flights and the one that is held out; report it."""
    *earlier, last = flights
    flight = flights[last]
    if earlier:
        report(Finding(Code.HELD_OUT_FLIGHT, flight=last))
        return {name: flights[name] for name in earlier}, {last: flight}
    report(Finding(Code.HELD_OUT_QUARTER, flight=last))
    names = f"{last}, first three quarters", f"{last}, last quarter"
    rows = np.arange(len(flight.time))
    parts = np.split(rows, [round(0.75 * len(rows))])
    learned, tested = (
        flight.part(part).named(name) for part, name in zip(parts, names, strict=True)
    )
    return {names[0]: learned}, {names[1]: tested}


def _servos_for(servos: Any, flights: Sequence[Any], regressors: Sequence[str]) -> Any:
    """Return ``servos``, or without them "full throw" for logs of autopilots.

    None where no surface is a regressor, and no parameter names servos.
    """
    if servos is not None or not any(map(is_log, flights)):
        return servos
    needs_surfaces = not {*ALL_SURFACES}.isdisjoint(regressors)
    return FULL_THROW if needs_surfaces or any(map(names_servos, flights)) else None


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
        if isinstance(item, str | os.PathLike):
            place = item
            if is_log(item):
                what = f"log (skdgp inspect {item} says why)"
            table = read_flight(item, **(reading if is_log(item) else {"rename": rename}))
        else:
            table = without_ground(check_table(item), key or f"{default} {number}")
            if "flight" not in table:
                table = table.assign(flight=f"{default} {number}")
        parts = FlightTable.of(table, needed, what=what).flights
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


def items_of(flights: Any) -> list:
    """Return the tables and paths of a dict or a list, or of a single one."""
    if isinstance(flights, Mapping):
        return list(flights.values())
    return list(flights) if isinstance(flights, list | tuple) else [flights]
