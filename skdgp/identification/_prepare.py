"""Checks of the flights of an identification, and its assumptions.

Flights are checked here, once; from here on they are without faults and have their usable rows.
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
    RATES,
    REGRESSOR_SETS,
    SPECIFIC_FORCE,
    SURFACES,
    THRUST_COLUMNS,
)
from skdgp._flight.channels import FULL_THROW as IN_FULL_THROWS
from skdgp._flight.clock import n_rows
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics import find_contradictions
from skdgp._flight.tables import FlightTable, check_spelling, numeric, sensor_position
from skdgp._flight.units import check_flight
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import (
    QUANTITIES,
    Aircraft,
    ScaleFactor,
    check_aircraft,
    propeller_speed_of,
    with_sensor_position,
)
from skdgp.identification._flights import Flights
from skdgp.identification._pipeline import FlightPipeline, regressor_names
from skdgp.preprocessing import clean

# columns that the coefficients follow from
MEASURED = ("airspeed", "density", *SPECIFIC_FORCE, *RATES)
ENGINE_COLUMNS = ("throttle", "propeller_speed")  # columns that an unknown thrust depends on
# elevons may stand for elevator and aileron, and the other way round
INTERCHANGEABLE = (*MIXED, *ELEVONS)

# steps that an evaluation of a model reads
STEPS = {"flightpathreconstruction", "regressorselector", "standardscaler"}

POSITION_TOLERANCE = 0.01  # of the inertial sensors [m]


def as_aircraft(aircraft: Any) -> Aircraft:
    """Return the aircraft, read from a file where a path is given."""
    is_path = isinstance(aircraft, str | os.PathLike)
    return Aircraft.from_file(aircraft) if is_path else check_aircraft(aircraft)


def names_of(regressors: str | Sequence[str]) -> Sequence[str]:
    """Return the names of regressors, those of a set where its name is given."""
    return REGRESSOR_SETS[regressors] if isinstance(regressors, str) else regressors


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
        cleaned = clean(flight)
        _check_surfaces(name, cleaned.table, in_radians)
        _warn_of_positions(name, cleaned.table, aircraft)
        check_flight(cleaned.table, needed)
        check_spelling(cleaned.table, surfaces)
        for finding in cleaned.findings or ():
            report(finding, FlightDataWarning)
        checked[name] = replace(cleaned, table=with_sensor_position(cleaned.table, aircraft))
    _warn_of_contradictions(checked, aircraft)
    return {name: _complete_rows(name, flight, regressors) for name, flight in checked.items()}


def _check_surfaces(name: str, table: pd.DataFrame, in_radians: bool) -> None:
    """Raise ValueError if surfaces of a flight are in radians, and others in parts of their full throw."""
    has_surfaces = not {*ALL_SURFACES, *HIGH_LIFT}.isdisjoint(table)
    if has_surfaces and in_radians == (IN_FULL_THROWS in table):
        unit = "parts of their full throw" if in_radians else "rad"
        raise ValueError(
            f"Got flight {name!r} with surfaces in {unit}, and others that are not: expected one unit. "
            f"Give logs with a servo file, or all in parts of the full throw with a column {IN_FULL_THROWS} of 1."
        )


def _warn_of_contradictions(flights: Flights, aircraft: Aircraft) -> None:
    """Warn of channels, and of sizes of the aircraft, that contradict others by physics, in all flights together."""
    together = FlightTable.together(flights.values())
    only = next(iter(flights)) if len(flights) == 1 else None
    for contradiction in find_contradictions(together):
        report(replace(contradiction, flight=contradiction.flight or only), FlightDataWarning)
    question = aircraft.question_of_sizes(together)
    if question is not None:
        report(question)


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


def _warn_of_positions(flight: str, table: pd.DataFrame, aircraft: Aircraft) -> None:
    """Warn if a flight states another position of the inertial sensors than the aircraft.

    An aircraft without one was learned with
    the sensors at the centre of gravity, to which also the forces of a simulation refer.
    """
    stated = np.nan_to_num(sensor_position(table)).mean(axis=0)
    distance = float(np.linalg.norm(stated - np.array(aircraft.sensor_position or np.zeros(3))))
    if stated.any() and distance > POSITION_TOLERANCE:
        numbers = {"distance": distance}
        report(Finding(Code.SENSOR_POSITIONS_DIFFER, flight=flight, numbers=numbers))


def _complete_rows(flight: str, flights: FlightTable, regressors: Sequence[str]) -> FlightTable:
    """Return the rows whose regressors are all sampled and have a neighbour, so that they have a rate of change."""
    table = flights.table
    columns = regressor_columns([table], regressors)
    missing = pd.DataFrame(~np.isfinite(numeric(table, columns)), columns=columns)
    complete = np.flatnonzero(~missing.any(axis=1))
    counts = missing.sum()[missing.any()].to_dict()
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
    if len(continuous) < len(table):
        numbers = {
            "left_out": len(table) - len(continuous),
            "rows": len(table),
            "missing": counts,
            "alone": len(complete) - len(continuous) or None,
        }
        report(Finding(Code.ROWS_LEFT_OUT, flight=flight, numbers=numbers))
    return flights.part(continuous).named(flight)


def thrust_of(
    flights: Flights,
    aircraft: Aircraft,
    regressors: Sequence[str],
    thrust: str | None = "auto",
) -> str | None:
    """Return the thrust as an option, None where it is a part of the coefficients; warn of that.

    It is where the flights have a throttle, and nothing gives the thrust that this sets. Warn, too, if
    then an engine changes it, and no regressor tells how.
    """
    table = pd.concat([flight.table for flight in flights.values()])
    has_thrust = not {*THRUST_COLUMNS}.isdisjoint(table)
    has_propeller = propeller_speed_of(aircraft.propeller, table) is not None
    if thrust == "auto" and "throttle" in table and not (has_thrust or has_propeller):
        thrust = None
        if (table["throttle"] > 0).any():
            report(Finding(Code.THRUST_IN_COEFFICIENTS))
    varied = [name for name in ENGINE_COLUMNS if name in table and table[name].nunique() > 1]
    if thrust is None and varied and {*varied}.isdisjoint(regressors):
        report(Finding(Code.ENGINE_UNEXPLAINED, numbers={"names": varied}))
    return thrust


def assumed_sizes(aircraft: Aircraft, errors: Mapping[str, ScaleFactor]) -> list[Finding]:
    """Return the findings of sizes that are uncertain, by errors of all causes together, and of their sources.

    ``errors`` are those of the aircraft's model.
    """
    findings = []
    sizes = {}
    for name, value in aircraft.sizes.items():
        std = aircraft.relative_std(name)
        if std:
            label = f"{name.replace('_', ' ')} [{QUANTITIES.get(name, 'kg m^2')}]"
            sizes[label] = value, std * value
    if sizes:
        findings.append(Finding(Code.SIZES_ESTIMATED, numbers={"sizes": sizes}))
    factors = {**(aircraft.deviations or {}), **errors}
    sources = {
        name: factor.source
        for name, factor in factors.items()
        if factor.source not in ("", "given")
    }
    if sources:
        findings.append(Finding(Code.SIZES_SOURCES, numbers={"sources": sources}))
    return findings
