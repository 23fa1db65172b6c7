"""Flights of an identification: by name, of tables, files and logs, and checked, once.

Behind `usable_flights` flights are without faults and have their usable rows.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import report
from skdgp._flight.channels import (
    ALL_SURFACES,
    ELEVONS,
    HAT,
    HIGH_LIFT,
    MIXED,
    SURFACES,
    THRUST_COLUMNS,
)
from skdgp._flight.channels import FULL_THROW as IN_FULL_THROWS
from skdgp._flight.clock import n_rows
from skdgp._flight.copies import without_copies
from skdgp._flight.faults import FlightDataWarning, clean, slow_log, without_ground
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics import find_contradictions
from skdgp._flight.tables import (
    FlightTable,
    check_spelling,
    check_table,
    numeric,
    sensor_position,
    with_sensor_position,
)
from skdgp._flight.units import check_flight
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft, numbers_in_flight, propeller_speed_of
from skdgp.identification._pipeline import FlightPipeline, regressor_names
from skdgp.io import FlightReadError, is_log, read_flight

Flights = dict[str, FlightTable]
# elevons may stand for elevator and aileron, and the other way round
INTERCHANGEABLE = (*MIXED, *ELEVONS)
# steps that an evaluation of a model reads
STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}
ENGINE_COLUMNS = ("throttle", "propeller_speed")  # columns that an unknown thrust depends on
POSITION_TOLERANCE = 0.01  # of the inertial sensors [m]


def train_and_test(
    flights: Any, test: Any, needed: Sequence[str], **reading: Any
) -> tuple[Flights, Flights]:
    """Return flights to learn from and flights to be tested on, each once.

    Without test flights the last of several is held out, of a single one the last quarter. Warns of
    that, of slow logs, and of copies.
    """
    train = named_flights(flights, needed=needed, **reading)
    findings = slow_log(FlightTable.together(train.values()))
    tested: Flights = {}
    if test is not None:
        tested = named_flights(test, default="test flight", needed=needed, **reading)
    train, tested, copies = without_copies(train, tested)
    findings += copies
    if test is None:
        train, tested, held_out = _without_last(train)
        findings.append(held_out)
    for finding in findings:
        report(finding)
    return train, tested


def are_in_full_throws(flights: Flights) -> bool:
    """Return whether surfaces of flights are in parts of their full throw."""
    return any(IN_FULL_THROWS in flight.table for flight in flights.values())


def _without_last(flights: Flights) -> tuple[Flights, Flights, Finding]:
    """Return training flights and the one that is held out, of a single one its last quarter, and the finding of it."""
    *earlier, last = flights
    flight = flights[last]
    if earlier:
        held_out = Finding(Code.HELD_OUT_FLIGHT, flight=last)
        return {name: flights[name] for name in earlier}, {last: flight}, held_out
    learned, tested = f"{last}, first three quarters", f"{last}, last quarter"
    rows = np.arange(len(flight.time))
    begin = round(0.75 * len(rows))
    return (
        {learned: flight.part(rows[:begin]).named(learned)},
        {tested: flight.part(rows[begin:]).named(tested)},
        Finding(Code.HELD_OUT_QUARTER, flight=last),
    )


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
    items = [("", flights)]
    if isinstance(flights, Mapping):
        items = list(flights.items())
    elif isinstance(flights, list | tuple):
        items = [("", item) for item in flights]
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


def regressor_columns(tables: Iterable[pd.DataFrame], regressors: Sequence[str]) -> list[str]:
    """Return the measured columns of the tables that regressors are made from."""
    needed = {"airspeed"}
    if not {*MIXED}.isdisjoint(regressors):
        needed |= {*ELEVONS}
    for name in regressors:
        bare = str(name).removesuffix(HAT)
        needed |= {bare, bare.removesuffix("_dot")}
    return list(dict.fromkeys(name for table in tables for name in table if name in needed))


def usable_flights(
    flights: Flights,
    aircraft: Aircraft,
    regressors: Sequence[str],
    columns: Sequence[str],
    *,
    in_radians: bool,
) -> Flights:
    """Return flights without faults, and only rows that a model can learn from or predict.

    They have the position of the inertial sensors, where flights or aircraft state it.

    Warns of faults, of contradictions of physics, and of the rows that are left out. Raises
    ValueError if a flight lacks one of the columns, which the model's flights have, or none of
    its rows is left.
    """
    needed = [name for name in columns if name not in INTERCHANGEABLE]
    surfaces = [name for name in SURFACES if name in regressors]
    checked = {}
    for name, flight in flights.items():
        _check_surfaces(name, flight.table, in_radians)
        _warn_of_positions(name, flight.table, aircraft)
        located = replace(flight, table=with_sensor_position(flight.table, aircraft))
        cleaned = clean(located)
        check_flight(cleaned.table, needed)
        check_spelling(cleaned.table, surfaces)
        for finding in cleaned.findings or ():
            report(finding, FlightDataWarning)
        checked[name] = cleaned
    together = FlightTable.together(checked.values())
    for contradiction in find_contradictions(together):  # in all flights
        only = next(iter(checked)) if len(checked) == 1 else None
        report(contradiction.of_flight(contradiction.flight or only), FlightDataWarning)
    question = aircraft.question_of_sizes(*numbers_in_flight(together, aircraft))
    if question is not None:
        report(question if aircraft.question_of_sizes() else question.of_flight(", ".join(checked)))
    usable = {}
    left_out: list[Finding] = []
    for name, flight in checked.items():
        usable[name], findings = _complete_rows(name, flight, regressors)
        left_out += findings
    for finding in left_out:
        report(finding)
    return usable


def _check_surfaces(name: str, table: pd.DataFrame, in_radians: bool) -> None:
    """Raise ValueError if surfaces of a flight are in radians, and others in parts of their full throw."""
    has_surfaces = not {*ALL_SURFACES, *HIGH_LIFT}.isdisjoint(table)
    if has_surfaces and in_radians == (IN_FULL_THROWS in table):
        unit = "parts of their full throw" if in_radians else "rad"
        raise ValueError(
            f"Got flight {name!r} with surfaces in {unit}, and others that are not: expected one unit. "
            f"Give logs with a servo file, or all in parts of the full throw with a column {IN_FULL_THROWS} of 1."
        )


def _warn_of_positions(flight: str, table: pd.DataFrame, aircraft: Aircraft) -> None:
    """Warn if a flight states another position of the inertial sensors than the aircraft.

    An aircraft without one was learned with
    the sensors at the centre of gravity, to which also the forces of a simulation refer.
    """
    stated = np.nan_to_num(sensor_position(table)).mean(axis=0)
    distance = float(np.linalg.norm(stated - np.array(aircraft.sensor_position or np.zeros(3))))
    if stated.any() and distance > POSITION_TOLERANCE:
        report(Finding(Code.SENSOR_POSITIONS_DIFFER, flight=flight, distance=distance))


def _complete_rows(
    flight: str, flights: FlightTable, regressors: Sequence[str]
) -> tuple[FlightTable, list[Finding]]:
    """Return the rows with all regressors and a neighbour, so that they have a rate of change; and of the others."""
    table = flights.table
    columns = regressor_columns([table], regressors)
    missing = ~np.isfinite(numeric(table, columns))
    complete = np.flatnonzero(~missing.any(axis=1))
    counts = {name: int(n) for name, n in zip(columns, missing.sum(axis=0), strict=True) if n}
    runs = flights.part(complete).segments if complete.size else []
    rows = [complete[run] for run in runs if n_rows(run) > 1]
    if not rows:
        raise ValueError(
            f"Flight {flight!r} has {len(complete)} rows in which all of {columns} were sampled (missing, by "
            f"rows: {counts}), none beside another, but expected thousands: bring slow sensors to the "
            "clock of the others, drop columns that are empty, or name other regressors. Is the log "
            "whole, and time in seconds?"
        )
    continuous = np.concatenate(rows)
    numbers = {
        "left_out": len(table) - len(continuous),
        "rows": len(table),
        "missing": counts,
        "alone": len(complete) - len(continuous) or None,
    }
    left_out = [Finding(Code.ROWS_LEFT_OUT, flight=flight, **numbers)]
    usable = flights.part(continuous).named(flight)
    return usable, left_out if numbers["left_out"] else []


def usable_flights_of_model(pipeline: Pipeline, flights: Flights, aircraft: Aircraft) -> Flights:
    """Return of each flight the rows that a fitted pipeline can predict; warn of the others, and of faults once.

    Flights that do not state the position of their inertial sensors get the aircraft's. Raises
    ValueError if the pipeline is not of `identify`, or a flight lacks a column that its training
    flights had.
    """
    check_identified(pipeline)
    regressors = regressor_names(pipeline)
    of_fit = pd.DataFrame(columns=pipeline[0].feature_names_in_)
    columns = regressor_columns([of_fit], regressors)
    in_radians = not pipeline.control_units
    return usable_flights(flights, aircraft, regressors, columns, in_radians=in_radians)


def check_identified(pipeline: Pipeline) -> None:
    """Raise ValueError if the pipeline is not one of `make_identification_pipeline` with a DependentGPRegressor."""
    is_whole = isinstance(pipeline, FlightPipeline) and pipeline.named_steps.keys() >= STEPS
    if not is_whole or not isinstance(pipeline[-1], DependentGPRegressor):
        raise ValueError(
            f"Got a model {type(pipeline).__name__}, but expected what make_identification_pipeline "
            "makes, with a DependentGPRegressor: learn it with identify."
        )


def with_position_of(aircraft: Aircraft, flights: Flights) -> Aircraft:
    """Return the aircraft with the one position of the inertial sensors that all flights state, if it has none.

    A model then has it for flights that state none.
    """
    stated = np.unique(
        np.concatenate([sensor_position(flight.table) for flight in flights.values()]), axis=0
    )
    if aircraft.sensor_position is not None or len(stated) != 1 or not np.isfinite(stated).all():
        return aircraft
    return replace(aircraft, sensor_position=stated[0].tolist())


def thrust_of(
    flights: pd.DataFrame,
    aircraft: Aircraft,
    regressors: Sequence[str],
    thrust: str | None = "auto",
) -> str | None:
    """Return the thrust as an option, None where it is a part of the coefficients; warn of that.

    It is where the flights have a throttle or propeller speed, and nothing gives the thrust that this sets. Warn,
    too, if then an engine changes it, and no regressor tells how.
    """
    engine = [name for name in ENGINE_COLUMNS if name in flights]
    has_thrust = not {*THRUST_COLUMNS}.isdisjoint(flights)
    has_propeller = propeller_speed_of(aircraft.propeller, flights) is not None
    if thrust == "auto" and engine and not (has_thrust or has_propeller):
        thrust = None
        if (flights[engine] > 0).any(axis=None):
            report(Finding(Code.THRUST_IN_COEFFICIENTS))
    varied = [name for name in engine if flights[name].nunique() > 1]
    if thrust is None and varied and {*varied}.isdisjoint(regressors):
        report(Finding(Code.ENGINE_UNEXPLAINED, names=varied))
    return thrust
