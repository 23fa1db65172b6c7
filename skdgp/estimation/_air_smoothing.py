"""Smoothed motion through the air and its standard deviations, in the rows of the flight table.

Both errors of the states, given all samples and the parameters, and errors of the parameters count.
With slopes G of air data, rates and wind by the states of covariance P, and their total derivatives
s by the parameters of covariance C, the variances are diag(G P G^T + s C s^T).
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, WIND
from skdgp._flight.frames import air_data, air_data_slopes, rotation_to_euler
from skdgp.estimation._air_fit import AirFit, FittedRecord
from skdgp.estimation._air_linearization import (
    GUST,
    N_STATES,
    RATE_STATES,
    Layout,
    air_velocity,
)
from skdgp.estimation._air_model import AIR_VELOCITY
from skdgp.estimation._air_parameters import WINDS, stacked
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import smoothed, state_slopes

ESTIMATED = (*AIR_DATA, *RATES, *WIND)
"""Smoothed columns, each with its standard deviation."""
OF_AIR_DATA = slice(0, 3)
OF_RATES = slice(3, 6)
OF_WIND = slice(6, 9)
PATH_COLUMNS = (*SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY)
"""Columns of the path over the ground."""
COLUMNS = (*ESTIMATED, *(f"{name}_std" for name in ESTIMATED), *PATH_COLUMNS)


def smoothed_air(
    fit: AirFit, fitted: list[FittedRecord], covariance: Matrix, n_rows: int
) -> pd.DataFrame:
    """Return the smoothed motion through the air; NaN in rows that no record contains."""
    values = np.full((n_rows, len(COLUMNS)), np.nan)
    for item in fitted:
        parts = [*_estimates(fit, item, covariance), _path(item.record)]
        values[item.record.rows] = np.concatenate(parts, axis=1)
    return pd.DataFrame(values, columns=list(COLUMNS))


def _estimates(fit: AirFit, item: FittedRecord, covariance: Matrix) -> tuple[Matrix, Matrix]:
    """Return air data, rates and wind (n, 9), and their standard deviations."""
    record = item.record
    states, P = smoothed(item.linear, item.filter_pass)
    value = fit.parameters.values(fit.x, record.flight)
    air, air_by_state = air_velocity(record, value, states)
    wind = states[:, GUST] + stacked(value, *WINDS)
    estimates = np.column_stack([*air_data(air), states[:, RATE_STATES], wind])
    slopes = _slopes(fit.layout, record, air, air_by_state)
    G = slopes[..., :N_STATES]
    places = fit.parameters.places[record.flight]
    s = slopes[..., N_STATES:] + G @ state_slopes(item.linear, item.filter_pass)
    C = covariance[np.ix_(places, places)]
    variance = _variances(G, P) + _variances(s[..., : len(places)], C)
    return estimates, np.sqrt(variance)


def _slopes(layout: Layout, record: Record, air: Matrix, air_by_state: Array) -> Array:
    """Return derivatives (n, 9, N + q) by the states, and by the parameters at given states."""
    motion = layout.motion_slopes(record.attitude, record.rates, air_by_state)
    by_air = air_data_slopes(air) @ motion[:, AIR_VELOCITY]
    slopes = np.zeros((len(air), len(ESTIMATED), N_STATES + layout.n_slopes))
    slopes[:, OF_AIR_DATA, :N_STATES] = by_air[..., :N_STATES]
    slopes[:, OF_RATES, RATE_STATES] = np.eye(3)
    slopes[:, OF_WIND, GUST] = np.eye(3)
    slopes[:, OF_AIR_DATA, layout.constants] = by_air[..., N_STATES:]
    by_parameters = slopes[..., N_STATES:]
    by_parameters[:, OF_WIND, layout.place(*WINDS)] = np.eye(3)
    return slopes


def _variances(slopes: Array, covariance: Array) -> Matrix:
    """Return the diagonals of G P G^T, (n, k)."""
    return np.sum((slopes @ covariance) * slopes, axis=-1)


def _path(record: Record) -> Matrix:
    """Return specific force, attitude and ground velocity (n, 9) without biases and lags."""
    to_earth = record.attitude.mT
    angles = rotation_to_euler(Rotation.from_matrix(to_earth))
    return np.column_stack([record.force, angles, record.earth_velocity()])
