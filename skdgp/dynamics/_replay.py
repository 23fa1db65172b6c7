"""Replay: motion by predicted coefficients along a flight, restarted from the measured state (the paper's figure 7)."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array, Indices
from skdgp._flight.channels import EARTH_VELOCITY, EULER, POSITION, RATES
from skdgp._flight.clock import true_runs
from skdgp._flight.frames import STANDARD_GRAVITY, wrapped_near
from skdgp._flight.tables import FlightTable
from skdgp._flight.units import check_flight
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._inputs import table_states
from skdgp.dynamics._integrate import channels
from skdgp.dynamics._rigid_body import (
    aerodynamic_loads,
    propulsive_loads,
    rigid_body_derivative,
    rk4_step,
)

COMPARED_STATES = [*EARTH_VELOCITY, *EULER, *RATES]


def replay(
    flight: pd.DataFrame | FlightTable,
    aircraft: Aircraft,
    coefficients: ArrayLike,
    *,
    horizon: float = 2.0,
    thrust: str | None = "auto",
    gravity: float = STANDARD_GRAVITY,
) -> pd.DataFrame:
    """Return predicted coefficients integrated along a flight, restarting from the measured state every horizon.

    RK4 of `rigid_body_derivative` over the log's samples, with the loads of the predicted
    coefficients at the measured airspeed and density, the propulsive loads and gravity, linear
    between the samples. Raises ValueError if a column is missing, shapes disagree, or a parameter
    is out of its range.

    Parameters
    ----------
    flight : pandas.DataFrame
        ``time``, ``airspeed``, ``density``, ``phi``, ``theta``, ``psi``, ``p``, ``q``, ``r``;
        ``v_north``, ``v_east``, ``v_down``; ``north``, ``east``, ``down`` where measured;
        ``flight`` (id); the columns of the thrust.
    aircraft : Aircraft
        Mass, inertia and reference lengths.
    coefficients : array-like of shape (n, 6)
        CX CY CZ Cl Cm Cn at every row of the flight. Rows with NaN are not flown: windows end
        there.
    horizon : float, default=2.0
        Seconds from restart to restart.
    thrust : {"auto", None}, default="auto"
        As for `aerodynamic_coefficients`.
    gravity : float, default=9.80665
        [m/s^2].

    Returns
    -------
    pandas.DataFrame
        Indexed as the flight: ``time``, ``flight`` (if present), ``horizon``,
        ``window`` (count of restarts), ``elapsed`` [s] since the restart, and the states (north,
        east, down where measured) v_north, v_east, v_down, phi, theta, psi, p, q, r. A row where
        one window ends and the next starts shows the end. Rows that are not flown are NaN, their
        window -1: rows without loads, and rows before the first complete state.
    """
    if not horizon > 0:
        raise ValueError(f"Got horizon={horizon!r}, but expected seconds > 0.")
    flights = check_flight(flight, ["airspeed", "density", *COMPARED_STATES])
    flight = flights.table
    time = flights.time
    measured = table_states(flight)
    if np.shape(coefficients) != (len(flight), 6):
        raise ValueError(
            f"Got coefficients of shape {np.shape(coefficients)}, but expected ({len(flight)}, 6): six at every row of "
            "the flight."
        )
    aerodynamic = aerodynamic_loads(coefficients, flight["airspeed"], flight["density"], aircraft)
    propulsive = propulsive_loads(flight, aircraft, thrust)
    loads = np.hstack(aerodynamic) + np.hstack(propulsive)
    has_loads: Any = np.isfinite(loads).all(axis=1)
    is_complete: Any = np.isfinite(measured).all(axis=1)
    windows: list[tuple[int, int]] = []
    for segment in flights.segments:
        for run in true_runs(has_loads[segment]):
            rows = np.arange(segment.start, segment.stop)[run]
            windows += _windows(rows, time[rows], is_complete[rows], horizon)
    first, last = np.array(windows, dtype=int).reshape(-1, 2).T
    steps = np.arange(1 + (last - first).max(initial=0))
    rows = np.minimum(first + steps[:, None], last)  # a shorter window repeats its last row
    states = _integrated(measured, loads, time, rows, aircraft, gravity)
    return _table(flight, rows, states, horizon)


def _table(flight: pd.DataFrame, rows: Indices, states: Array, horizon: float) -> pd.DataFrame:
    """Return the states of all windows (n_samples, n_windows, 13) in the order of the flight."""
    columns = channels(states)
    columns["window"] = np.broadcast_to(np.arange(rows.shape[1]), rows.shape)
    time = flight["time"].to_numpy(float)
    columns["elapsed"] = time[rows] - time[rows[0]]
    table = flight[[name for name in ("time", "flight") if name in flight]].astype({"time": float})
    table["horizon"] = horizon
    measured = [name for name in POSITION if name in flight]
    for name in ("window", "elapsed", *measured, *COMPARED_STATES):
        values = np.full(len(flight), -1 if name == "window" else np.nan)
        # a row that two windows share shows the end of the first
        values[rows[0]] = columns[name][0]
        values[rows[1:]] = columns[name][1:]
        if name in EULER:
            # the turn nearest to the log's, which may count heading from 0 to 2 pi
            values = wrapped_near(values, flight[name].to_numpy(float))
        table[name] = values
    return table.astype({"window": int})


def _windows(
    rows: Indices, time: Array, is_complete: Array, horizon: float
) -> list[tuple[int, int]]:
    """Return the first and the last row of each window in a run of ``rows`` (n,) without gaps.

    A window starts at a complete state and ends at the last one no more than ``horizon`` [s] later,
    where the next one starts; where there is none, it ends with the horizon.
    """
    windows = []
    starts = np.flatnonzero(is_complete[:-1])
    while len(starts):
        first = starts[0]
        # a millionth of the horizon forgives the rounding of stored times
        end = time[first] + horizon * (1 + 1e-6) + 1e-9
        last = max(int(np.searchsorted(time, end, side="right")) - 1, first + 1)
        restarts = starts[(starts > first) & (starts <= last)]
        if len(restarts) and last < len(rows) - 1:
            last = restarts[-1]
        windows.append((rows[first], rows[last]))
        starts = starts[starts >= last]
    return windows


def _integrated(
    measured: Array, loads: Array, time: Array, rows: Indices, aircraft: Aircraft, gravity: float
) -> Array:
    """Return the states (n_samples, n_windows, 13) of each window, its loads linear over every step."""
    states = np.empty((*rows.shape, 13))
    states[0] = measured[rows[0]]
    for k, (first, second) in enumerate(pairwise(rows)):
        dt = (time[second] - time[first])[:, None]
        begin = loads[first]
        change = loads[second] - begin

        def rate(fraction: float, state: Array, begin=begin, change=change, dt=dt) -> Array:
            load = begin + fraction * change
            return rigid_body_derivative(state, load[:, :3], load[:, 3:], aircraft, gravity) * dt

        states[k + 1] = rk4_step(rate, 0.0, states[k], 1.0)
    return states
