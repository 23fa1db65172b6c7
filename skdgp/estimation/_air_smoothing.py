"""Smoothed motion through the air and its standard deviations, in the rows of the flight table.

Both errors of the states, given all samples and the parameters, and errors of the parameters count.
With slopes G of air data, rates and wind by the states of covariance P, and their total derivatives
s by the parameters of covariance C, the variances are diag(G P G^T + s C s^T).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, WIND
from skdgp._flight.frames import air_data, air_data_slopes, rotation_to_euler
from skdgp.estimation._air_fit import AirFit, FittedRecord
from skdgp.estimation._air_linearization import (
    CONSTANTS,
    GUST,
    N_STATES,
    RATE_STATES,
    air_velocity,
    air_velocity_slopes,
    slopes_by_constants,
)
from skdgp.estimation._air_parameters import (
    WINDS,
    stacked,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import parameter_slopes, smoothed

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
    layout = fit.layout
    states, P = smoothed(item.linear, item.filter_pass)
    value = fit.parameters.values(fit.x, record.flight)
    air = air_velocity(record, value, states)
    G = np.zeros((len(air), len(ESTIMATED), N_STATES))
    G[:, OF_AIR_DATA] = air_data_slopes(air) @ air_velocity_slopes(record, value)
    G[:, OF_RATES, RATE_STATES] = np.eye(3)
    G[:, OF_WIND, GUST] = np.eye(3)
    # the first parameters of a flight are derivatives, and what is behind them instruments
    n = len(layout.names)
    by_constants = slopes_by_constants(
        lambda moved: _estimated(record, moved, states), value, CONSTANTS
    )
    places = fit.parameters.places[record.flight]
    C = covariance[np.ix_(places, places)]
    variance = _variances(G, P)
    # the first sample has its states from no other
    variance[:1] += _variances(by_constants[:1], C[layout.n_derivatives :, layout.n_derivatives :])
    for steps, _, Z in parameter_slopes(item.linear, item.filter_pass, item.expansion.slopes):
        rows = slice(steps.start + 1, steps.stop + 1)
        s = G[rows] @ Z[..., :n]
        s[..., layout.n_derivatives :] += by_constants[rows]
        variance[rows] += _variances(s, C)
    return _estimated(record, value, states), np.sqrt(variance)


def _estimated(record: Record, value: Mapping[str, Any], states: Matrix) -> Matrix:
    """Return air data, rates and wind (n, 9) at parameters by name and states (n, N)."""
    air = air_velocity(record, value, states)
    wind = states[:, GUST] + stacked(value, *WINDS)
    return np.column_stack([*air_data(air), states[:, RATE_STATES], wind])


def _variances(slopes: Array, covariance: Array) -> Matrix:
    """Return the diagonals of G P G^T, (n, k)."""
    return np.sum((slopes @ covariance) * slopes, axis=-1)


def _path(record: Record) -> Matrix:
    """Return specific force, attitude and ground velocity (n, 9) without biases and lags."""
    to_earth = record.attitude.mT
    angles = rotation_to_euler(Rotation.from_matrix(to_earth))
    return np.column_stack([record.force, angles, record.earth_velocity()])
