"""Columns of a reconstructed flight, by its path over the ground or by the motion of the air."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, WIND
from skdgp._flight.frames import air_data, rotation_to_euler
from skdgp._flight.tables import interpolate_missing
from skdgp.estimation._path_equations import FlightPath
from skdgp.estimation._sensors import FlightSensors

ANGLE_RATES = ("alpha_dot", "beta_dot")
MOTION_COLUMNS = (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, *WIND)
RECONSTRUCTED = (*AIR_DATA, *ANGLE_RATES, *MOTION_COLUMNS)
"""Columns of a reconstructed flight."""


def path_columns(path: FlightPath, sensors: FlightSensors) -> dict[str, Vector]:
    """Return the columns `RECONSTRUCTED` (n,) by a flight's path, SI units and radians."""
    air = np.column_stack(air_data(path.air_velocity()))
    euler = rotation_to_euler(path.attitude)
    force, rate = path.inertial(sensors)
    return _columns(sensors, air, np.hstack([rate, force, euler, path.velocity, path.wind()]))


def air_columns(air: pd.DataFrame, sensors: FlightSensors) -> dict[str, Vector]:
    """Return reconstructed columns (n,) of a flight by ``air``, its n rows of `AirMotion.air`.

    Between the rows that records contain values are interpolated; rates of alpha and beta [rad/s]
    are the derivatives of cubic splines.
    """
    motion = air[[*AIR_DATA, *MOTION_COLUMNS]].reset_index(drop=True)
    euler = motion[[*EULER]].dropna()
    # angles of thinned rows: between pi and -pi is pi, not zero
    motion.loc[euler.index, [*EULER]] = np.unwrap(euler.to_numpy(), axis=0)
    values = interpolate_missing(sensors.time, motion.to_numpy())
    return _columns(sensors, values[:, : len(AIR_DATA)], values[:, len(AIR_DATA) :])


def _columns(sensors: FlightSensors, air: Matrix, motion: Matrix) -> dict[str, Vector]:
    """Return the columns `RECONSTRUCTED` by air data (n, 3) and motion (n, k)."""
    columns = np.hstack([air, angle_rates(sensors, air), motion])
    return dict(zip(RECONSTRUCTED, columns.T, strict=True))


def angle_rates(sensors: FlightSensors, air: Matrix) -> Matrix:
    """Return the rates of change of alpha and beta (n, 2) by air data (n, 3), NaN of single samples."""
    rates = np.full((len(air), 2), np.nan)
    for rows in sensors.segments():
        if len(rows) > 1:
            time = sensors.time[rows]
            rates[rows] = CubicSpline(time, air[rows, 1:])(time, 1)
    return rates
