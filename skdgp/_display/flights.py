"""Flights and their replays as they are drawn."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

from skdgp._compute.typing import ArrayLike, Vector
from skdgp._flight.checks import check_columns

PATH_POINTS = 600  # of one flight; a picture resolves no more
LATERAL_STATES = (
    "v_east",
    "p",
    "r",
)  # the states of the paper's figure 7: east velocity, roll rate, yaw rate


def check_time(time: ArrayLike, n_samples: int | None = None) -> Vector:
    """Return ``time`` as finite floats, ``(n,)`` with n at least one."""
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size == 0 or not np.isfinite(time).all():
        raise ValueError(
            f"Got time of shape {time.shape} with {np.count_nonzero(~np.isfinite(time))} values "
            f"that are not "
            "finite, but expected (n,) seconds, n at least 1: drop the rows without a time."
        )
    if n_samples is not None and len(time) != n_samples:
        raise ValueError(f"Got {len(time)} times for {n_samples} samples: give one per sample.")
    return time


def ground_path(flight: pd.DataFrame, name: str = "flight") -> pd.DataFrame:
    """Return time, north and east [m], and altitude where known, at no more than 600 points, equally far apart.

    Without positions, velocities are integrated: north = int v_north dt, by trapezoids, linear
    across holes of the log.
    """
    time = flight["time"].to_numpy(dtype=float)
    if {"north", "east"} <= set(flight.columns):
        north, east = flight[["north", "east"]].to_numpy(dtype=float).T
    else:
        check_columns(flight, ["v_north", "v_east"], what=f"flight {name!r} (for its path)")
        velocity = (
            flight[["v_north", "v_east"]]
            .astype(float)
            .interpolate(limit_direction="both")
            .to_numpy()
        )
        north, east = cumulative_trapezoid(velocity, time, axis=0, initial=0).T
    points = {"time": time, "north": north, "east": east}
    if "altitude" in flight.columns:
        points["altitude"] = flight["altitude"].to_numpy(dtype=float)
    distance = np.append(0.0, np.cumsum(np.nan_to_num(np.hypot(np.diff(north), np.diff(east)))))
    rows = np.searchsorted(distance, np.linspace(0, distance[-1], PATH_POINTS)).clip(
        0, len(distance) - 1
    )
    return pd.DataFrame(points).iloc[np.unique(rows)]


def replay_rows(trajectory: pd.DataFrame, horizon: float | None) -> pd.DataFrame:
    """Return the rows of one horizon of a replay; the longest, for None."""
    check_columns(trajectory, ["horizon"], what="trajectory")
    horizons = np.unique(trajectory["horizon"])
    horizon = horizons[-1] if horizon is None else horizon
    rows = trajectory[np.isclose(trajectory["horizon"], horizon)]
    if len(rows) == 0:
        raise ValueError(
            f"Got horizon={horizon!r} s, but the trajectory holds {horizons.tolist()} s."
        )
    return rows
