"""Flights by name: reading, holding out, usable rows; and what is assumed where neither flights nor caller say."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._flight.channels import (
    CHANNELS,
    COEFFICIENTS,
    ELEVONS,
    HAT,
    MIXED,
    RATES,
    REGRESSOR_SETS,
    SPECIFIC_FORCE,
    SURFACES,
    THRUST_FORCES,
)
from skdgp._flight.checks import check_columns, check_table, suggestions
from skdgp._flight.clock import flight_rows, flight_segments
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.physics import find_contradictions
from skdgp.dynamics import (
    MOMENTS,
    QUANTITIES,
    Aircraft,
    ScaleFactor,
    dynamic_pressure,
    propeller_speed_of,
    propulsive_loads,
)
from skdgp.io import FULL_THROW, FlightReadError, is_log, names_servos, read_flight, reversed_of
from skdgp.preprocessing import FlightCheck

Flights = dict[str, pd.DataFrame]

# columns that the coefficients follow from
MEASURED = ("airspeed", "density", *SPECIFIC_FORCE, *RATES)
ENGINE = ("throttle", "propeller_speed")  # columns that an unknown thrust depends on
# elevons may stand for elevator and aileron, and the other way round
INTERCHANGEABLE = (*MIXED, *ELEVONS)


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
    of_tables = {"rename": reading.pop("rename", None)}
    items = (
        flights.items() if isinstance(flights, Mapping) else [("", x) for x in items_of(flights)]
    )
    if not items:
        raise ValueError("Got no flight, but expected at least one.")
    by_name: Flights = {}
    origin: dict[str, object] = {}
    for number, (key, item) in enumerate(items, start=1):
        path = item if isinstance(item, str | os.PathLike) else None
        table = (
            check_table(item)
            if path is None
            else read_flight(path, **(reading if is_log(path) else of_tables))
        )
        parts = flights_of(table, f"{default} {number}")
        if key and len(parts) != 1:
            raise ValueError(
                f"Got {len(parts)} flights in the table {key!r}, but expected one for each name."
            )
        for own_name, part in parts.items():
            name = key or own_name
            place = path or f"table {number}"
            if name in by_name:
                raise FlightReadError(
                    f"Got flight {name!r} in {origin[name]} and in {place}, but expected each "
                    f"once: name a file once, rename one of two files, change the name in the "
                    f"column 'flight', or give a dict of names and tables."
                )
            hint = f"log (skdgp inspect {path} says why)" if is_log(path) else "flight"
            check_columns(part, needed, what=hint)
            by_name[name] = part.assign(flight=name)
            origin[name] = place
    return by_name


def items_of(flights: Any) -> list:
    """Return the tables and paths of a dict or a list, or of a single one."""
    flights = list(flights.values()) if isinstance(flights, Mapping) else flights
    return list(flights) if isinstance(flights, list | tuple) else [flights]


def flights_of(table: pd.DataFrame, default: str = "flight") -> Flights:
    """Return one table for each flight, in their order."""
    table = table if "flight" in table else table.assign(flight=default)
    return {
        name: table.iloc[flight].reset_index(drop=True).assign(flight=name)
        for name, flight in flight_rows(table["flight"]).items()
    }


def train_and_test(train: Flights, test: Flights) -> tuple[Flights, Flights, str | None]:
    """Return training and test flights, and the name of the part held out where no test flight is named.

    Held out are the last flight of several, or the last quarter of a single one.
    """
    if test:
        for name in train.keys() & test.keys():
            warn(
                f"Flight {name!r} is both learned from and tested on: its errors say nothing "
                f"about other flights.",
                stacklevel=3,
            )
        return train, test, None
    *earlier, last = train
    if earlier:
        held_out = f"the last flight, {last}"
        learned, tested = {name: train[name] for name in earlier}, {last: train[last]}
    else:
        held_out = f"the last quarter of the only flight, {last}"
        split = round(0.75 * len(train[last]))
        learned = flights_of(train[last][:split].assign(flight=f"{last}, first three quarters"))
        tested = flights_of(train[last][split:].assign(flight=f"{last}, last quarter"))
    warn(
        f"No test flight was named: {held_out}, is held out of the fit and tested on.", stacklevel=3
    )
    return learned, tested, held_out


def check_controls(flights: Flights, regressors) -> None:
    """Raise ValueError if flights lack a surface and a column of another name seems to hold it.

    Warn of a missing elevator, whose effect other regressors then take.
    """
    columns = {name: None for table in flights.values() for name in table.columns}
    given = {*columns, *(MIXED if {*ELEVONS} & {*columns} else ())}
    lacking = [name for name in SURFACES if name in _names(regressors) and name not in given]
    near = suggestions([name for name in columns if name not in CHANNELS], columns)
    meant = {name: channel for name, channel in near.items() if channel in lacking}
    if meant:
        renaming = " ".join(f"{name}={channel}" for name, channel in meant.items())
        raise ValueError(
            f"Got flights without {' and '.join(meant.values())}: did you mean "
            f"{' and '.join(map(repr, meant))}? Rename the columns in the table, or by --rename "
            f"{renaming} (reading={{'rename': {dict(meant)}}})."
        )
    if "elevator" in lacking:
        warn(
            "Got flights without an elevator: its effect goes into the coefficients of alpha and "
            "q, so Cm_q and Cm_alpha may be wrong, even in sign. Give the column elevator.",
            stacklevel=2,
        )


def _names(regressors) -> Sequence[str]:
    return REGRESSOR_SETS[regressors] if isinstance(regressors, str) else regressors


def regressor_columns(tables: Iterable[pd.DataFrame], regressors) -> list[str]:
    """Return the measured columns of the tables that regressors are made from."""
    names = _names(regressors)
    columns: dict[str, None] = {}
    for table in tables:
        bare = [str(name).removesuffix("_hat") for name in names]
        needed = {name if name in table else name.removesuffix("_dot") for name in bare}
        needed |= {"airspeed"} | ({*ELEVONS} if {"elevator", "aileron"} & set(names) else set())
        columns |= dict.fromkeys(name for name in table.columns if name in needed)
    return list(columns)


def usable_flights(flights: Flights, regressors, columns: Sequence[str]) -> Flights:
    """Return flights without faults, and only rows that a model can learn from or predict.

    Warns of faults, of contradictions of physics, and of the rows that are left out. Raises
    ValueError if a flight lacks one of the columns, which the model's flights have, or none of
    its rows is left.
    """
    for table in flights.values():
        check_columns(table, [name for name in columns if name not in INTERCHANGEABLE])
    checked = {name: FlightCheck().fit_transform(table) for name, table in flights.items()}
    for contradiction in find_contradictions(pd.concat(checked.values(), ignore_index=True)):
        warn(f"Contradiction in the flights: {contradiction}.", FlightDataWarning, stacklevel=3)
    return {name: _complete_rows(name, table, regressors) for name, table in checked.items()}


def _complete_rows(flight, table, regressors) -> pd.DataFrame:
    """Return the rows whose regressors are all sampled and have a neighbour, so that they have a rate of change."""
    columns = regressor_columns([table], regressors)
    missing = ~np.isfinite(table[columns].to_numpy(dtype=float))
    counts = {
        name: int(count) for name, count in zip(columns, missing.sum(axis=0), strict=True) if count
    }
    complete = table[~missing.any(axis=1)]
    if complete.empty:
        raise ValueError(
            f"Flight {flight!r} has no row in which all of {columns} were sampled (missing, by "
            f"rows: {counts}): bring "
            "slow sensors to the clock of the others, drop columns that are empty, or name other "
            "regressors."
        )
    if counts:
        warn(
            f"Flight {flight!r}: {len(table) - len(complete)} of {len(table)} rows are left out, "
            f"because regressors "
            f"are missing there (by rows: {counts}). Bring slow sensors to the clock of the "
            f"others if these are many.",
            stacklevel=4,
        )
    segments = flight_segments(complete["time"].to_numpy(float))
    rows = [np.arange(run.start, run.stop) for run in segments if run.stop - run.start > 1]
    if not rows:
        raise ValueError(
            f"Flight {flight!r} has {len(complete)} usable rows, none beside another, but "
            f"expected thousands: rates "
            "of change need neighbours. Is the log whole, and time in seconds?"
        )
    continuous = np.concatenate(rows)
    if len(continuous) < len(complete):
        warn(
            f"Flight {flight!r}: {len(complete) - len(continuous)} rows that stand alone between gaps "
            f"are left out.",
            stacklevel=4,
        )
    return complete.iloc[continuous].reset_index(drop=True)


def warn_of_engine(flights: Flights, regressors) -> None:
    """Warn if the thrust is part of the coefficients, an engine changes it, and no regressor tells how."""
    table = pd.concat(flights.values(), ignore_index=True)
    varied = [name for name in ENGINE if name in table and table[name].nunique() > 1]
    if varied and not set(varied) & set(_names(regressors)):
        warn(
            f"Got thrust=None for flights with {' and '.join(varied)}: the coefficients include "
            f"the thrust, and no "
            f"regressor explains it. Name regressors with {varied[0]!r} and 'airspeed', or give "
            f"the thrust.",
            stacklevel=2,
        )


THRUST_IN_COEFFICIENTS = (
    "Neither thrust_x, thrust_y, thrust_z nor a propeller and its speed give the thrust (a column "
    "thrust is for simulations), so it is part of the coefficients, with throttle and airspeed as "
    "regressors: CX is thrust less drag, which the model does not tell apart."
)
FULL_THROWS = "Surfaces are in parts of their full throw, as no servo file gives angles: effects are of a full throw."


def servos_for(servos: Any, *flights: Any) -> Any:
    """Return ``servos``, or without them "full throw" for logs of autopilots whose parameters name servos.

    Raises ValueError of logs without servos beside tables, whose surfaces are in radians.
    """
    items = [item for part in flights if part is not None for item in items_of(part)]
    logs = [is_log(item) for item in items]
    if servos is not None or not any(logs):
        return servos
    if not all(logs):
        raise ValueError(
            "Got logs of autopilots without servos beside tables, but expected surfaces in one "
            "unit: give servos, a "
            "file of the angles of the surfaces."
        )
    return FULL_THROW if any(map(names_servos, items)) else None


def with_thrust_errors(
    aircraft: Aircraft, table: pd.DataFrame, regressors: pd.DataFrame
) -> Aircraft:
    """Return the aircraft, with the errors of coefficients by the error of its propeller's thrust.

    If the thrust is T (1 + e), coefficients lack e T / (qbar S) of it, and a model learns that as
    the nearest linear function of its regressors.
    """
    propeller = aircraft.propeller
    if propeller is None or not propeller.load_std:
        return aircraft
    scale = dynamic_pressure(table["airspeed"], table["density"])[:, None] * aircraft.wing_area
    force, moment = propulsive_loads(table, aircraft)
    missing = -np.hstack([force, moment / aircraft.moment_lengths]) / scale
    X = np.column_stack([np.ones(len(regressors)), regressors])
    sampled = np.isfinite(missing).all(axis=1) & np.isfinite(X).all(axis=1)
    X[:, 1:] -= X[sampled, 1:].mean(axis=0)  # the intercept is the mean
    slopes = np.linalg.lstsq(X[sampled], missing[sampled], rcond=None)[0]
    names = ["", *(f"_{str(name).removesuffix(HAT)}" for name in regressors)]
    effects = [coefficient + name for coefficient in COEFFICIENTS for name in names]
    added = dict(zip(effects, slopes.T.ravel().tolist(), strict=True))
    factor = ScaleFactor(propeller.load_std, source="size of the propeller", added=added)
    return replace(aircraft, deviations={**(aircraft.deviations or {}), "thrust": factor})


def lacks_thrust(thrust: str | None, tables: Iterable[pd.DataFrame], aircraft: Aircraft) -> bool:
    """Return whether nothing gives the thrust of any flight, but a throttle explains it."""
    return thrust == "auto" and all(
        "throttle" in table
        and not {*THRUST_FORCES} & {*table}
        and propeller_speed_of(aircraft.propeller, table) is None
        for table in tables
    )


def assumptions(aircraft: Aircraft, *, servos: Any, thrust_unknown: bool) -> list[str]:
    """Return the assumptions, in a line each; sizes are uncertain by errors of all causes together."""
    factors = (aircraft.deviations or {}).values()
    rules = sorted({f.source.rpartition(", ")[2] for f in factors if f.source != "given"})
    values = {
        **{name: getattr(aircraft, name) for name in QUANTITIES},
        **dict(zip(MOMENTS, aircraft.inertia.diagonal(), strict=True)),
    }
    stds = {
        name: float(np.linalg.norm([f.std * f.powers.get(name, 0.0) for f in factors]))
        for name in values
    }
    sizes = [
        f"{name.replace('_', ' ')} {values[name]:.3g} {QUANTITIES.get(name, 'kg m^2')} ± "
        f"{100 * std:.2g} %"
        for name, std in stds.items()
        if std
    ]
    lines = {
        f"Of the aircraft: {', '.join(sizes)}; their part in errors of derivatives is std_aircraft.": sizes,
        f"Estimated by: {'; '.join(rules)}.": rules,
        FULL_THROWS: reversed_of(servos) is not None,
        THRUST_IN_COEFFICIENTS: thrust_unknown,
    }
    return [line for line, applies in lines.items() if applies]
