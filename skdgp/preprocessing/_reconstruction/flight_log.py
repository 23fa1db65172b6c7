"""Logs that the reconstruction reads, one for each flight, with a first guess of the path."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._flight.clock import check_clock, flight_rows, runs_by_flight
from skdgp.preprocessing._reconstruction.kinematics import CONSTANTS, Log, Path
from skdgp.preprocessing._table import numeric

FORCE, RATE = ("ax", "ay", "az"), ("p", "q", "r")
AIR, VELOCITY, ATTITUDE = ("airspeed", "alpha", "beta"), ("v_north", "v_east", "v_down"), ("phi", "theta", "psi")
NEEDED = (*RATE, *FORCE, *ATTITUDE, *VELOCITY, "airspeed")
"""What a flight table must hold; alpha and beta are used where they are there."""


def flight_logs(table: pd.DataFrame, gravity: float) -> list[tuple[object, np.ndarray, Log]]:
    """Return name, rows and log of every flight in the table.

    Raises
    ------
    ValueError
        If time does not increase, or an inertial sensor, the GPS, the attitude or the airspeed is silent throughout a
        flight.
    """
    names = np.asarray(table["flight"], dtype=object) if "flight" in table else np.zeros(len(table), int)
    time, codes = check_clock(numeric(table, ["time"])[:, 0], names)
    logs = []
    for runs in runs_by_flight(time, codes):
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        stretch = np.repeat(np.arange(len(runs)), [run.stop - run.start for run in runs])
        logs.append((names[rows[0]], rows, _log(table.iloc[rows], time[rows], stretch, gravity)))
    return logs


def missing_in(table: pd.DataFrame) -> list[str]:
    """Return which needed channels are not there, or silent throughout some flight."""
    absent = [name for name in ("time", *NEEDED) if name not in table]
    rows = flight_rows(table["flight"]).values() if "flight" in table else [slice(None)]
    flights = [table.iloc[of_one] for of_one in rows]
    return absent + sorted({name for part in flights for name in _silent(part, absent)}, key=NEEDED.index)


def _silent(table, absent=()):
    there = [name for name in NEEDED if name not in absent]
    return [name for name in there if not np.isfinite(numeric(table, [name])).any()]


def first_guess(log: Log, constants) -> Path:
    """Return the path that GPS and attitude show by themselves, in air at rest."""
    return Path(_bridged(log.time, log.velocity), log.attitude, np.zeros_like(log.velocity), constants)


def _log(table, time, stretch, gravity):
    _check_heard(table)
    attitude = numeric(table, ATTITUDE).copy()
    seen = np.isfinite(attitude).all(axis=1)
    attitude[seen] = np.unwrap(attitude[seen], axis=0)
    attitude = Rotation.from_euler("ZYX", _bridged(time, attitude)[:, ::-1])
    inertial = _bridged(time, numeric(table, [*FORCE, *RATE]))
    air = np.column_stack([numeric(table, [name]) if name in table else np.full(len(table), np.nan) for name in AIR])
    return Log(time, stretch, inertial[:, :3], inertial[:, 3:], air, numeric(table, VELOCITY), attitude, seen, gravity)


def _check_heard(table):
    silent = _silent(table)
    if silent:
        flight = f"flight {table['flight'].iloc[0]!r}" if "flight" in table else "the flight"
        raise ValueError(
            f"Got no value of {', '.join(silent)} in {flight}, but expected some: a path cannot be reconstructed "
            "without them. Leave the flight out, or smooth it with FlightSmoother."
        )


def _bridged(time, values):
    """Return the columns with missing values interpolated, a row seen by all or none where they go together."""
    values = values.copy()
    for column in values.T:
        known = np.isfinite(column)
        if not known.all():
            column[~known] = np.interp(time[~known], time[known], column[known])
    return values


def no_constants() -> np.ndarray:
    """Return the constants of perfect sensors in air at rest."""
    return np.zeros(len(CONSTANTS))
