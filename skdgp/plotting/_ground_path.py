"""The path over the ground, from positions or integrated velocities."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

from skdgp._flight.checks import check_columns

PATH_POINTS = 600
"""Points of one flight's path; more than a picture resolves."""


def ground_path(flight: pd.DataFrame, name: str = "flight") -> pd.DataFrame:
    """Return time, north and east [m], and altitude where known, of at most some hundred points.

    Where the positions are absent the velocities are integrated: north = int v_north dt, by trapezoids, a hole
    of the log taken at its mean velocity.
    """
    time = flight["time"].to_numpy(dtype=float)
    if {"north", "east"} <= set(flight.columns):
        north, east = flight["north"].to_numpy(dtype=float), flight["east"].to_numpy(dtype=float)
    else:
        check_columns(flight, ["v_north", "v_east"], what=f"flight {name!r} (for its path)")
        north, east = (_integrated(flight[column], time) for column in ("v_north", "v_east"))
    points = {"time": time, "north": north, "east": east}
    if "altitude" in flight.columns:
        points["altitude"] = flight["altitude"].to_numpy(dtype=float)
    return pd.DataFrame(points).iloc[_spread(north, east)]


def _integrated(velocity: pd.Series, time: np.ndarray) -> np.ndarray:
    filled = velocity.astype(float).interpolate(limit_direction="both").to_numpy()
    return cumulative_trapezoid(filled, time, initial=0.0)


def _spread(north, east) -> np.ndarray:
    """Return indices evenly spread over the way flown, so that slow turns get no more points than straights."""
    step = np.nan_to_num(np.hypot(np.diff(north), np.diff(east)))
    way = np.concatenate([[0.0], np.cumsum(step)])
    if way[-1] == 0:
        return np.array([0])
    return np.unique(np.searchsorted(way, np.linspace(0, way[-1], PATH_POINTS)).clip(0, len(way) - 1))
