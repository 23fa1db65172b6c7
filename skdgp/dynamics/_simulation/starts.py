"""Initial states of simulations, from rows of a flight or from a few numbers."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skdgp._flight.channels import CHANNELS, EULER
from skdgp._flight.checks import check_names, check_radians
from skdgp._flight.frames import (
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_euler,
)
from skdgp.dynamics._equations.rigid_body import ATTITUDE, POSITION, RATES, STATE_NAMES, VELOCITY

__all__ = ["BODY", "EARTH", "as_starts", "checked_std", "initial_states", "perturbed"]

BODY, EARTH, AIR = ("u", "v", "w"), ("v_north", "v_east", "v_down"), ("airspeed", "alpha", "beta")
WORDS = (*AIR, *BODY, *EARTH, *EULER, *STATE_NAMES[10:], *STATE_NAMES[:3], "altitude")
SLACK = 0.15
"""By which the airspeed of a start may differ from what its ground speed and the wind make of it."""
LOWEST_LAND = -450.0
"""Altitude of the lowest land there is [m]."""


def as_starts(x0) -> pd.DataFrame | np.ndarray:
    """Return one start or several as a table of names or an array of states, with a row for each.

    ``x0`` is a mapping, Series or DataFrame by name, an array (13,) or (n, 13), or has a ``state``, or is several that
    have.
    """
    if isinstance(x0, Sequence) and len(x0) and all(hasattr(one, "state") for one in x0):
        x0 = [one.state for one in x0]
    if isinstance(x0, Mapping):
        _check_spelling(x0)
    if not isinstance(x0, Mapping | pd.Series | pd.DataFrame):
        x0 = getattr(x0, "state", x0)
    if hasattr(x0, "columns") and not isinstance(x0, pd.DataFrame):
        x0 = {name: np.asarray(x0[name]) for name in x0.columns}
    if isinstance(x0, Mapping | pd.Series):
        x0 = pd.DataFrame({name: np.atleast_1d(value) for name, value in dict(x0).items()})
    if isinstance(x0, pd.DataFrame) and len(x0):
        return x0
    states = np.atleast_2d(np.array(x0, dtype=float))
    if states.ndim != 2 or states.shape[1] != len(STATE_NAMES) or not len(states):
        raise ValueError(
            f"Got x0 of shape {np.shape(x0)}, but expected names and values, or (13,) or (n, 13): "
            f"{', '.join(STATE_NAMES)}."
        )
    return states


def initial_states(starts: pd.DataFrame | np.ndarray, air: Callable | None = None) -> np.ndarray:
    """Return states (n, 13) of what `as_starts` gave; ``air`` tells the wind (..., 3) at states (n, 13).

    By name: the velocity as u, v, w, or v_north, v_east, v_down, or airspeed, alpha, beta (relative to the air); phi,
    theta, psi, p, q, r, north, east, down or altitude are zero where they are not given. Where both altitude and down
    are, the altitude counts, as the air's density follows from it.

    Raises
    ------
    ValueError
        If the velocity is not given, a name is misspelt, or a value is not finite, or not in radians.

    Warns
    -----
    UserWarning
        If ground speed, wind and airspeed of a start do not fit each other, or it lies below any land.
    """
    states = _from_table(starts, air) if isinstance(starts, pd.DataFrame) else starts
    if not np.isfinite(states).all():
        bad = [name for name, column in zip(STATE_NAMES, states.T, strict=True) if not np.isfinite(column).all()]
        raise ValueError(f"Got a start whose {bad} are NaN or infinite: choose rows in which the state was measured.")
    if not (np.linalg.norm(states[:, ATTITUDE], axis=1) > 0).all():
        raise ValueError("Got a start whose quaternion is zero, but expected q0, q1, q2, q3 of an attitude.")
    return states


def _from_table(table: pd.DataFrame, air) -> np.ndarray:
    check_radians(table, (*EULER, "p", "q", "r", "alpha", "beta"))
    states = np.zeros((len(table), len(STATE_NAMES)))

    def of(names):
        return np.stack([table[n].to_numpy(float) if n in table else np.zeros(len(table)) for n in names], axis=-1)

    states[:, ATTITUDE] = euler_to_quaternion(*of(EULER).T)
    states[:, RATES] = of(("p", "q", "r"))
    states[:, POSITION] = of(("north", "east", "down"))
    if "altitude" in table:
        states[:, 2] = -table["altitude"].to_numpy(float)
    if (states[:, 2] > -LOWEST_LAND).any():
        warnings.warn(
            f"Got a start at an altitude of {-states[:, 2].max():g} m, below any land: down is positive downwards, "
            "altitude = -down.",
            UserWarning,
            stacklevel=4,
        )
    wind = 0.0 if air is None else ned_to_body(states[:, ATTITUDE], air(states))
    if all(name in table for name in BODY):
        states[:, VELOCITY] = of(BODY)
    elif all(name in table for name in EARTH):
        states[:, VELOCITY] = ned_to_body(states[:, ATTITUDE], of(EARTH))
    else:
        check_names(["airspeed"], table.columns, "columns of x0 (or u, v, w, or v_north, v_east, v_down)")
        if (table["airspeed"].to_numpy(float) <= 0).any():
            raise ValueError(f"Got airspeed {table['airspeed'].min():g} m/s in x0, but expected one > 0.")
        states[:, VELOCITY] = air_velocity(*of(AIR).T) + wind
    _warn_of_wind(table, states, wind)
    return states


def _check_spelling(given: Mapping) -> None:
    """Raise a ValueError at a name that nobody knows, and that is nearly one of those that a start lacks."""
    lacking = [name for name in WORDS if name not in given]
    for name in map(str, given):
        near = get_close_matches(name, lacking, n=1, cutoff=0.75)
        if near and name not in CHANNELS:
            raise ValueError(f"Got {name!r} in x0, but expected a name of docs/notation.md: did you mean {near[0]!r}?")


def _warn_of_wind(table, states, wind) -> None:
    if "airspeed" not in table:
        return
    airspeed = np.linalg.norm(states[:, VELOCITY] - wind, axis=1)
    said = table["airspeed"].to_numpy(float)
    off = np.abs(airspeed - said)
    if (off > SLACK * np.abs(said)).any():
        worst = int(np.nanargmax(off))
        warnings.warn(
            f"At start {worst} ground velocity and wind make an airspeed of {airspeed[worst]:.1f} m/s, but x0 says "
            f"{table['airspeed'].iloc[worst]:.1f} m/s: give the wind of that flight (wind=...).",
            UserWarning,
            stacklevel=5,
        )


def checked_std(std: Mapping[str, float] | None) -> dict[str, float]:
    """Return standard deviations of a start, by name.

    Raises
    ------
    ValueError
        If a name is none of a start's, or a deviation is not finite, or negative.
    """
    std = dict(std or {})
    check_names(std, (*STATE_NAMES[:6], *EULER, *EARTH, *STATE_NAMES[10:]), "names of initial_std")
    for name, size in std.items():
        if not (np.isfinite(size) and size >= 0):
            raise ValueError(f"Got initial_std of {name} {size!r}, but expected a finite number from 0 on.")
    return std


def perturbed(states: np.ndarray, std: Mapping[str, float] | None, n_paths: int, random_state) -> np.ndarray:
    """Return a start for each path, (n_paths, n, 13): the states (n, 13), off by standard deviations by name."""
    std = checked_std(std)
    drawn = np.tile(states, (n_paths, 1, 1))
    draw = check_random_state(random_state).standard_normal
    off = {name: float(size) * draw(drawn.shape[:2]) for name, size in std.items()}
    zero = np.zeros(drawn.shape[:2])

    def of(names):
        return np.stack([off.get(name, zero) for name in names], axis=-1)

    drawn[..., POSITION] += of(STATE_NAMES[POSITION])
    drawn[..., VELOCITY] += of(BODY) + ned_to_body(drawn[..., ATTITUDE], of(EARTH))
    drawn[..., RATES] += of(STATE_NAMES[RATES])
    if any(name in std for name in EULER):
        angles = quaternion_to_euler(drawn[..., ATTITUDE]) + of(EULER)
        ground = body_to_ned(drawn[..., ATTITUDE], drawn[..., VELOCITY])
        drawn[..., ATTITUDE] = euler_to_quaternion(*np.moveaxis(angles, -1, 0))
        if not any(name in std for name in BODY):  # the velocity over the ground is what was measured
            drawn[..., VELOCITY] = ned_to_body(drawn[..., ATTITUDE], ground)
    return drawn
