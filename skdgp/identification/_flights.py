"""Flights by name: reading, holding out, and the rows that are usable for training."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._flight.channels import (
    CHANNELS,
    EARTH_VELOCITY,
    ELEVONS,
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
from skdgp._flight.frames import with_air_data
from skdgp._flight.physics import block_means, find_contradictions
from skdgp._flight.turns import airspeed_from_turns
from skdgp.io import FlightReadError, is_log, read_flight
from skdgp.preprocessing import FlightCheck

Flights = dict[str, pd.DataFrame]

MEASURED = (
    "airspeed",
    "density",
    *SPECIFIC_FORCE,
    *RATES,
)  # columns that the coefficients follow from
FORCES = (*MEASURED, *THRUST_FORCES, "propeller_speed")
ENGINE = ("throttle", "propeller_speed")  # columns that an unknown thrust depends on
INTERCHANGEABLE = (
    *MIXED,
    *ELEVONS,
)  # elevons may stand for elevator and aileron, and the other way round
AIRSPEED_ERROR = "relative error of airspeed"  # attribute of tables whose airspeed is that of turns


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
    found: Flights = {}
    if isinstance(flights, Mapping):
        for name, table in flights.items():
            parts = flights_of(check_table(table))
            if len(parts) != 1:
                raise ValueError(
                    f"Got {len(parts)} flights in the table {name!r}, but expected one for each "
                    f"name."
                )
            found[name] = _checked_columns(next(iter(parts.values())).assign(flight=name), needed)
        return found
    of_tables = {"rename": reading.pop("rename", None)}
    items = items_of(flights)
    if not items:
        raise ValueError("Got no flight, but expected at least one.")
    origin: dict[str, str | os.PathLike | None] = {}
    for number, item in enumerate(items, start=1):
        path = item if isinstance(item, str | os.PathLike) else None
        table = (
            check_table(item)
            if path is None
            else read_flight(path, **(reading if is_log(path) else of_tables))
        )
        for name, part in flights_of(table, f"{default} {number}").items():
            if name in found:
                raise FlightReadError(_same_name(name, origin[name], path))
            found[name], origin[name] = _checked_columns(part, needed, path), path
    return found


def items_of(flights: Any) -> list:
    """Return the tables and paths of a dict or a list, or of a single one."""
    flights = list(flights.values()) if isinstance(flights, Mapping) else flights
    return list(flights) if isinstance(flights, list | tuple) else [flights]


def flights_of(table: pd.DataFrame, default: str = "flight") -> Flights:
    """Return one table for each flight, in their order."""
    if "flight" not in table:
        return {default: table.reset_index(drop=True).assign(flight=default)}
    rows = flight_rows(table["flight"])
    return {
        name: table.iloc[here].reset_index(drop=True).assign(flight=name)
        for name, here in rows.items()
    }


def _checked_columns(table, needed, path=None) -> pd.DataFrame:
    table = _with_airspeed(with_air_data(table), needed)
    try:
        check_columns(table, needed)
    except ValueError as error:
        if not is_log(path):
            raise
        raise ValueError(
            f"{error} What a log has, and why it lacks them: skdgp inspect {path}"
        ) from None
    return table


def _with_airspeed(flight: pd.DataFrame, needed: Sequence[str]) -> pd.DataFrame:
    """Return a flight with the airspeed of its turns, if it has none but the velocity over the ground; warn of it."""
    measured = "airspeed" in flight and flight["airspeed"].notna().any()
    if measured or not {"time", *EARTH_VELOCITY} <= set(flight):
        return flight
    try:
        found = airspeed_from_turns(flight)
    except ValueError:
        if "airspeed" in needed:
            raise
        return flight
    error, wind = (
        (found[["airspeed_std"]] ** 2).mean().iloc[0] ** 0.5,
        found[["wind_north", "wind_east"]].mean(),
    )
    warn(
        f"Flight {flight['flight'].iloc[0]!r} has no airspeed: that of its turns is used, ± "
        f"{error:.2g} m/s, in a wind "
        f"of {np.hypot(*wind):.2g} m/s.",
        FlightDataWarning,
        stacklevel=5,
    )
    flight = flight.assign(airspeed=found["airspeed"])
    flight.attrs = {**flight.attrs, AIRSPEED_ERROR: float(error / found["airspeed"].mean())}
    return flight


def _same_name(name, first, second) -> str:
    """Return the message for two flights of one name, with the remedy."""
    if first is None or second is None:
        return (
            f"Got flight {name!r} twice, but expected each once: give a dict of names and tables."
        )
    columns = [str(path) for path in (second, first) if Path(path).stem != name]
    if Path(first).resolve() == Path(second).resolve():
        remedy = "name the file once"
    elif columns:
        remedy = f"the name stands in column 'flight' of {columns[0]}; change it there"
    else:
        remedy = (
            "rename one of the files, or where a file has a column 'flight', change the name there"
        )
    return f"Got flight {name!r} in {first} and in {second}, but expected each once: {remedy}."


def train_and_test(train: Flights, test: Flights) -> tuple[Flights, Flights, str | None]:
    """Return flights to learn from and to test on, and words for those held out where no test flight is named.

    Held out are the last flight of several, or the last quarter of a single one.
    """
    if test:
        for name in train.keys() & test.keys():
            _warn(
                f"Flight {name!r} is both learned from and tested on: its errors say nothing "
                f"about other flights.",
                4,
            )
        return train, test, None
    *others, last = train
    if others:
        held_out, found = f"the last flight, {last}", train
    else:
        held_out, split = (
            f"the last quarter of the only flight, {last}",
            round(0.75 * len(train[last])),
        )
        rows = {
            f"{last}, first three quarters": slice(0, split),
            f"{last}, last quarter": slice(split, None),
        }
        found = {
            name: train[last].iloc[part].assign(flight=name).reset_index(drop=True)
            for name, part in rows.items()
        }
    _warn(f"No test flight was named: {held_out}, is held out of the fit and tested on.", 4)
    *_, last = found
    return (
        {name: table for name, table in found.items() if name != last},
        {last: found[last]},
        held_out,
    )


def check_controls(flights: Flights, regressors) -> None:
    """Raise ValueError if flights lack a surface and a column of another name seems to hold it.

    Warn of a missing elevator, whose effect other regressors then take.
    """
    columns = {name: None for table in flights.values() for name in table.columns}
    lacking = [name for name in SURFACES if name in _names(regressors) and name not in columns]
    lacking = [name for name in lacking if not (name in MIXED and {*ELEVONS} & {*columns})]
    near = suggestions([name for name in columns if name not in CHANNELS], columns)
    meant = {name: channel for name, channel in near.items() if channel in lacking}
    if meant:
        words = " ".join(f"{name}={channel}" for name, channel in meant.items())
        raise ValueError(
            f"Got flights without {' and '.join(meant.values())}: did you mean "
            f"{' and '.join(map(repr, meant))}? Rename the columns in the table, or by --rename "
            f"{words} (reading={{'rename': {dict(meant)}}})."
        )
    if "elevator" in lacking:
        _warn(
            "Got flights without an elevator: its effect goes into the coefficients of alpha and "
            "q, so Cm_q and Cm_alpha may be wrong, even in sign. Give the column elevator.",
            3,
        )


def _names(regressors) -> Sequence[str]:
    return REGRESSOR_SETS[regressors] if isinstance(regressors, str) else regressors


def regressor_columns(tables: Iterable[pd.DataFrame], regressors) -> list[str]:
    """Return the measured columns of the tables that regressors are made from."""
    names, found = _names(regressors), list[str]()
    for table in tables:
        needed = {"airspeed"}
        for name in (str(name).removesuffix("_hat") for name in names):
            needed |= {name} if name in table else {name.removesuffix("_dot")}
        if {"elevator", "aileron"} & set(names):
            needed |= {*ELEVONS}
        found += [name for name in table.columns if name in needed and name not in found]
    return found


def usable_flights(flights: Flights, regressors, columns: Sequence[str]) -> Flights:
    """Return flights without faults, and only rows that a model can learn from or predict.

    Warns of faults, of contradictions of physics, and of the rows that are left out. Raises
    ValueError if a flight lacks one of the columns, which the model's flights have, or no row of it
    is left.
    """
    for table in flights.values():
        check_columns(table, [name for name in columns if name not in INTERCHANGEABLE])
    check = FlightCheck()
    checked = {name: check.fit_transform(table) for name, table in flights.items()}
    for each in (
        find_contradictions(pd.concat(checked.values(), ignore_index=True)) if checked else ()
    ):
        warn(f"Contradiction in the flights: {each}.", FlightDataWarning, stacklevel=3)
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
        _warn(
            f"Flight {flight!r}: {len(table) - len(complete)} of {len(table)} rows are left out, "
            f"because regressors "
            f"are missing there (by rows: {counts}). Bring slow sensors to the clock of the "
            f"others if these are many."
        )
    segments = flight_segments(complete["time"].to_numpy(float))
    rows = [np.arange(run.start, run.stop) for run in segments if run.stop - run.start > 1]
    if not rows:
        raise ValueError(
            f"Flight {flight!r} has {len(complete)} usable rows, none beside another, but "
            f"expected thousands: rates "
            "of change need neighbours. Is the log whole, and time in seconds?"
        )
    kept = np.concatenate(rows)
    if len(kept) < len(complete):
        _warn(
            f"Flight {flight!r}: {len(complete) - len(kept)} rows that stand alone between gaps "
            f"are left out."
        )
    return complete.iloc[kept].reset_index(drop=True)


def _warn(message, stacklevel=5):
    warn(message, stacklevel=stacklevel)


def check_known(Y: pd.DataFrame, table: pd.DataFrame) -> None:
    """Raise ValueError if the coefficients are known at fewer than two rows, with what is missing."""
    known = int(Y.notna().all(axis=1).sum())
    if known < 2:
        missing = {
            name: n for name in FORCES if name in table and (n := int(table[name].isna().sum()))
        }
        raise ValueError(
            f"Got coefficients at {known} of {len(Y)} rows of the training flights, but expected "
            f"at least two, better "
            f"thousands. Missing values, by rows: {missing}: bring slow sensors to the clock of "
            f"the others, or drop "
            "columns that are empty."
        )


def warn_of_short_flights(flights: Flights, regressors) -> None:
    """Warn if regressors pass their means less often than there are regressors."""
    columns = [
        name
        for name in regressor_columns(list(flights.values())[:1], regressors)
        if name != "airspeed"
    ]
    crossings = np.zeros(len(columns))
    for table in flights.values():
        time, values = table["time"].to_numpy(float), table[columns].to_numpy(float)
        size = (
            max(1, round(0.25 / np.median(np.diff(time)))) if len(time) > 1 else 1
        )  # noise does not count
        blocks = block_means(values, size) - values.mean(axis=0)
        crossings += np.sum(blocks[1:] * blocks[:-1] < 0, axis=0)
    if np.median(crossings) < len(columns):
        seconds = sum(np.ptp(table["time"]) for table in flights.values())
        warn(
            f"The training flights last {seconds:.3g} s, in which {columns} pass their means "
            f"{np.median(crossings):g} "
            f"times (median): too few changes to learn the effect of each of {len(columns)}. Fly "
            f"longer, or name fewer "
            "regressors.",
            FlightDataWarning,
            stacklevel=3,
        )


def warn_of_engine(flights: Flights, regressors) -> None:
    """Warn if the thrust is part of the coefficients, an engine changes it, and no regressor tells how."""
    table = pd.concat(flights.values(), ignore_index=True)
    varied = [name for name in ENGINE if name in table and table[name].nunique() > 1]
    if varied and not set(varied) & set(_names(regressors)):
        _warn(
            f"Got thrust=None for flights with {' and '.join(varied)}: the coefficients include "
            f"the thrust, and no "
            f"regressor explains it. Name regressors with {varied[0]!r} and 'airspeed', or give "
            f"the thrust.",
            3,
        )
