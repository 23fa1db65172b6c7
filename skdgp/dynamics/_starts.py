"""Starts of a simulation: states of names and values, of flights and of trims."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    CHANNELS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
)
from skdgp._flight.frames import (
    air_velocity,
    euler_to_quaternion,
    ned_to_body,
)
from skdgp._flight.tables import check_names, check_number
from skdgp._flight.units import check_radians
from skdgp.dynamics._air import LocalAir
from skdgp.dynamics._rigid_body import ATTITUDE, STATE_NAMES, VELOCITY, stacked
from skdgp.dynamics._trim import Trim

START_NAMES = (*AIR_DATA, *EARTH_VELOCITY, *EULER, *RATES, *POSITION, "altitude")


# Relative difference of the airspeed, and the airspeed of ground speed and wind, above which a start gets a
# warning
AIRSPEED_DIFFERENCE = 0.15
# Altitude of the lowest land there is [m]
LOWEST = -450.0


def as_starts(x0: Any) -> pd.DataFrame | Array:
    """Return one start or several as a table of names or an array of states, with a row for each.

    ``x0`` is a mapping, Series or DataFrame by name, an array (13,) or (n, 13), a `Trim` or a list
    of trims.
    """
    if isinstance(x0, Mapping):
        _check_start_names([str(name) for name in x0])
    if isinstance(x0, Mapping | pd.Series):
        return pd.DataFrame({name: np.atleast_1d(value) for name, value in dict(x0).items()})
    if isinstance(x0, pd.DataFrame) and len(x0):
        return x0
    points = [x0] if isinstance(x0, Trim) else x0
    if isinstance(points, list | tuple) and any(isinstance(point, Trim) for point in points):
        points = [point.state for point in points]
    states = np.atleast_2d(np.array(points, dtype=float))
    if states.ndim != 2 or states.shape[1] != len(STATE_NAMES) or not len(states):
        raise ValueError(
            f"Got x0 of shape {np.shape(x0)}, but expected names and values, or (13,) or (n, 13): "
            f"{', '.join(STATE_NAMES)}."
        )
    return states


def _check_start_names(names: Sequence[str]) -> None:
    """Raise ValueError at an unknown name that resembles a name of a start."""
    lacking = [name for name in START_NAMES if name not in names]
    for name in names:
        near = get_close_matches(name, lacking, n=1, cutoff=0.75)
        if name not in CHANNELS and near:
            raise ValueError(
                f"Got {name!r} in x0, but expected a name of docs/notation.md: did you mean {near[0]!r}?"
            )


def initial_states(starts: pd.DataFrame | Array, air_at: Callable[[Array], LocalAir]) -> Array:
    """Return the states (n, 13) of starts, in the air that ``air_at`` returns at states (n, 13).

    By name: the velocity as v_north, v_east, v_down, or airspeed, alpha, beta (relative to the
    air); what else is not given is zero. Altitude counts before down, as the density follows
    from it. Raises ValueError if the velocity is missing, or a value is not finite or not in
    radians. Warns if ground speed, wind and airspeed do not fit, or a start lies below any land.
    """
    states = _from_table(starts, air_at) if isinstance(starts, pd.DataFrame) else starts
    is_bad = ~np.isfinite(states).all(axis=0)
    if is_bad.any():
        raise ValueError(
            f"Got a start whose {np.array(STATE_NAMES)[is_bad].tolist()} are NaN or infinite: choose "
            "rows in which the state was measured."
        )
    if not (np.linalg.norm(states[:, ATTITUDE], axis=1) > 0).all():
        raise ValueError(
            "Got a start whose quaternion is zero, but expected q0, q1, q2, q3 of an attitude."
        )
    return states


def table_states(table: pd.DataFrame) -> Array:
    """Return the states (n, 13) of a flight table, zero where a column is absent."""
    n = (len(table),)
    attitude = euler_to_quaternion(*stacked(table, EULER, n).T)
    velocity = ned_to_body(attitude, stacked(table, EARTH_VELOCITY, n))
    position = stacked(table, POSITION, n)
    return np.hstack([position, velocity, attitude, stacked(table, RATES, n)])


def _from_table(table: pd.DataFrame, air_at: Callable[[Array], LocalAir]) -> Array:
    """Return the states (n, 13) of starts by name."""
    check_radians(table, (*EULER, *RATES, "alpha", "beta"))
    states = table_states(table)
    if "altitude" in table:
        states[:, 2] = -table["altitude"].to_numpy(float)
    lowest = -states[:, 2].max()
    if lowest < LOWEST:
        warn(
            f"Got a start at an altitude of {lowest:g} m, below any land: down is positive downwards, "
            "altitude = -down."
        )
    attitude = states[:, ATTITUDE]
    moving = air_at(states).velocity(attitude)
    wind = 0.0 if moving is None else ned_to_body(attitude, moving)
    if set(EARTH_VELOCITY) <= set(table):
        if "airspeed" in table:
            _warn_of_wind(table["airspeed"].to_numpy(float), states[:, VELOCITY] - wind)
        return states
    # u, v, w alone do not determine the angles
    needed = ["airspeed"] if set(BODY_VELOCITY).isdisjoint(table) else AIR_DATA
    check_names(needed, table.columns, "columns of x0 (or v_north, v_east, v_down)")
    for speed in table["airspeed"]:
        check_number("airspeed of x0", speed, unit="m/s")
    through_air = air_velocity(*stacked(table, AIR_DATA, (len(table),)).T)
    states[:, VELOCITY] = through_air + wind
    return states


def _warn_of_wind(stated: Array, velocity: Array) -> None:
    """Warn of an airspeed (n,) that differs from the velocity (n, 3) through the air."""
    airspeed = np.linalg.norm(velocity, axis=1)
    off = np.nan_to_num(np.abs(airspeed / stated - 1.0))
    worst = int(np.argmax(off))
    if off[worst] > AIRSPEED_DIFFERENCE:
        warn(
            f"At start {worst} ground velocity and wind make an airspeed of {airspeed[worst]:.1f} m/s, "
            f"but x0 says {stated[worst]:.1f} m/s: give the wind of that flight (air=wind)."
        )
