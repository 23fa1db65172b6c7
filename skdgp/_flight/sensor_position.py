r"""Specific force at the centre of gravity, from inertial sensors at another position.

A sensor at r from the centre of gravity reads, with the specific force f there (Stevens, Lewis &
Johnson 2016, section 1.7),

.. math:: f + \dot\omega \times r + \omega \times (\omega \times r).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import RATES, SPECIFIC_FORCE
from skdgp._flight.clock import Clock
from skdgp._flight.frames import cross
from skdgp._flight.smoothing import differentiate, smooth
from skdgp._flight.tables import (
    by_name,
    interpolate_missing,
    numeric,
    sensor_position,
    with_sensors_at,
)


def acceleration_by_rotation(spin: Array, rates: Array, position: Array) -> Array:
    """Return the acceleration (..., 3) of a position relative to the centre of gravity [m/s^2].

    ``spin`` is the angular acceleration [rad/s^2], ``rates`` are the angular rates [rad/s].
    """
    return cross(spin, position) + cross(rates, cross(rates, position))


def sensor_acceleration(table: pd.DataFrame) -> Matrix:
    """Return the acceleration (n, 3) of the inertial sensors relative to the centre of gravity [m/s^2].

    By smoothed rates; zero where the position of the sensors is unknown.
    """
    position = np.nan_to_num(sensor_position(table))
    if not position.any():
        return position
    time = table["time"].to_numpy(float)
    flight = table.get("flight")
    options: dict[str, Any] = {"flight": flight, "shrink": False, "is_quiet": True}
    measured = numeric(table, RATES)
    spin = differentiate(measured, time, **options)
    rates = smooth(measured, time, **options)
    acceleration = acceleration_by_rotation(spin, rates, position)
    for rows in Clock.of(time, flight).rows.values():
        acceleration[rows] = interpolate_missing(time[rows], acceleration[rows])
    return np.nan_to_num(acceleration)  # of a flight without rates


def at_centre_of_gravity(table: pd.DataFrame) -> pd.DataFrame:
    """Return flights with the specific force at the centre of gravity, by the position of their sensors."""
    if not {*SPECIFIC_FORCE, *RATES} <= {*table.columns}:
        return table
    acceleration = sensor_acceleration(table)
    if not acceleration.any():
        return table
    moved = table.assign(**by_name(SPECIFIC_FORCE, numeric(table, SPECIFIC_FORCE) - acceleration))
    return with_sensors_at(moved, 0.0 * sensor_position(table))  # unknown ones stay unknown
