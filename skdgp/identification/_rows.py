"""Rows and columns of a log that can be learned from."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd

from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_segments
from skdgp._flight.faults import FlightDataWarning
from skdgp.preprocessing import FlightCheck
from skdgp.preprocessing._selector import REGRESSOR_SETS

FORCES = ("airspeed", "density", "ax", "ay", "az", "p", "q", "r", "thrust_x", "thrust_y", "thrust_z", "propeller_speed")
QUARTER = 0.25  # s
MIXED = ("elevator", "aileron", "elevon_left", "elevon_right")


def checked(flights: dict[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the flights with NaN for what was not measured; warn of all faults found, once."""
    check = FlightCheck(bridge=0)
    return {name: check.fit_transform(table) for name, table in flights.items()}


def complete_rows(table: pd.DataFrame, regressors) -> pd.DataFrame:
    """Return the rows of a flight whose regressors were all sampled and have a rate of change; warn of the others.

    Raises
    ------
    ValueError
        If no row is left.
    """
    columns = _columns_read(table, regressors)
    holes = ~np.isfinite(table[columns].to_numpy(dtype=float))
    found = {name: int(count) for name, count in zip(columns, holes.sum(axis=0), strict=True) if count}
    kept = table[~holes.any(axis=1)]
    name, n = table["flight"].iloc[0], len(table)
    if kept.empty:
        raise ValueError(
            f"Flight {name!r} has no row in which all of {columns} were sampled (missing, by rows: {found}): bring "
            "slow sensors to the clock of the others, drop columns that are empty, or name other --regressors."
        )
    if found:
        _warn(
            f"Flight {name!r}: {n - len(kept)} of {n} rows are left out, because regressors are missing there (by "
            f"rows: {found}). Bring slow sensors to the clock of the others if these are many."
        )
    return _in_company(kept, name).reset_index(drop=True)


def check_known(Y: pd.DataFrame, table: pd.DataFrame) -> None:
    """Raise a ValueError if the coefficients are known at fewer than two rows, with what is missing."""
    known = int(Y.notna().all(axis=1).sum())
    if known < 2:
        missing = {name: int(table[name].isna().sum()) for name in FORCES if name in table and table[name].isna().any()}
        raise ValueError(
            f"Got coefficients at {known} of {len(Y)} rows of the training flights, but expected at least two, better "
            f"thousands. Missing values, by rows: {missing}: bring slow sensors to the clock of the others, or drop "
            "columns that are empty."
        )


def warn_of_short(train: dict[str, pd.DataFrame], regressors) -> None:
    """Warn of flights in which regressors change their side less often than there are regressors to tell apart."""
    columns = [name for name in _columns_read(next(iter(train.values())), regressors) if name != "airspeed"]
    changes = np.sum([[_changes(table, name) for name in columns] for table in train.values()], axis=0)
    if np.median(changes) < len(columns):
        seconds = sum(np.ptp(table["time"]) for table in train.values())
        warnings.warn(
            f"The training flights last {seconds:.3g} s, in which {columns} pass their means {np.median(changes):g} "
            f"times (median): too few changes to tell what each of {len(columns)} does. Fly longer, or name fewer "
            "--regressors.",
            FlightDataWarning,
            stacklevel=2,
        )


def _changes(table, name) -> int:
    """Return how often a channel passes its mean; quarters of a second at a time, lest noise counts."""
    time, values = table["time"].to_numpy(float), table[name].to_numpy(float)
    side = max(1, round(QUARTER / np.median(np.diff(time)))) if len(time) > 1 else 1
    blocks = values[: len(values) // side * side].reshape(-1, side).mean(axis=1) - values.mean()
    return int(np.sum(blocks[1:] * blocks[:-1] < 0))


def check_same_columns(train: dict[str, pd.DataFrame], test: dict[str, pd.DataFrame], regressors) -> None:
    """Raise a ValueError if a flight lacks a column of regressors that a training flight has, before time is spent.

    Elevons may stand for elevator and aileron, and the other way round.
    """
    read = [name for table in train.values() for name in _columns_read(table, regressors)]
    for table in (*train.values(), *test.values()):
        check_columns(table, [name for name in read if name not in MIXED])


def _columns_read(table, regressors) -> list[str]:
    """Return the measured columns that regressors are made from, of those that stand in the table."""
    names = REGRESSOR_SETS[regressors] if isinstance(regressors, str) else regressors
    needed = {"airspeed"}
    for name in (str(name).removesuffix("_hat") for name in names):
        needed |= {name} if name in table else {name.removesuffix("_dot")}
    if {"elevator", "aileron"} & set(names):
        needed |= {"elevon_left", "elevon_right"}
    return [name for name in table.columns if name in needed]


def _in_company(table, name) -> pd.DataFrame:
    """Leave out rows that stand alone between gaps: they have no rate of change."""
    runs = flight_segments(table["time"].to_numpy(float))
    rows = [np.arange(run.start, run.stop) for run in runs if run.stop - run.start > 1]
    if not rows:
        raise ValueError(
            f"Flight {name!r} has {len(table)} usable rows, none beside another, but expected thousands: rates "
            "of change need neighbours. Is the log whole, and time in seconds?"
        )
    rows = np.concatenate(rows)
    if len(rows) < len(table):
        _warn(f"Flight {name!r}: {len(table) - len(rows)} rows that stand alone between gaps are left out.")
    return table.iloc[rows]


def _warn(words):
    warnings.warn(words, UserWarning, stacklevel=3)
