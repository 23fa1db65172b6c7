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
from skdgp._flight.frames import air_data, air_data_slopes, cross_matrix
from skdgp.estimation._air_fit import AirFit, FittedRecord
from skdgp.estimation._air_linearization import FAST, N_STATES, SLOW, TURN, air_velocity
from skdgp.estimation._air_parameters import ARM, WINDS, stacked
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import smoothed, state_slopes
from skdgp.estimation._sensors import FORCE

ESTIMATED = (*AIR_DATA, *RATES, *WIND)
"""Smoothed columns, each with its standard deviation."""
OF_AIR_DATA = slice(0, 3)
OF_RATES = slice(3, 6)
OF_WIND = slice(6, 9)
PATH = (*SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY)
"""Columns of the path over the ground."""
COLUMNS = (*ESTIMATED, *(f"{name}_std" for name in ESTIMATED), *PATH)


def smoothed_air(
    fit: AirFit, fitted: list[FittedRecord], covariance: Matrix, n_rows: int
) -> pd.DataFrame:
    """Return the smoothed motion through the air; NaN in rows that no record contains."""
    values = np.full((n_rows, len(COLUMNS)), np.nan)
    for item in fitted:
        parts = [*_estimates(fit, item, covariance), _path(item.record, fit.aircraft.mass)]
        values[item.record.rows] = np.concatenate(parts, axis=1)
    return pd.DataFrame(values, columns=list(COLUMNS))


def _estimates(fit: AirFit, item: FittedRecord, covariance: Matrix) -> tuple[Matrix, Matrix]:
    """Return air data, rates and wind (n, 9), and their standard deviations."""
    record, linear, run, _ = item
    states, P = smoothed(linear, run)
    value = fit.parameters.values(fit.x, record.flight)
    velocity, by_state = air_velocity(record, value, states)
    wind = states[:, SLOW] + states[:, FAST] + stacked(value, *WINDS)
    estimates = np.column_stack([*air_data(velocity), states[:, TURN], wind])
    by_air = air_data_slopes(velocity)
    G = np.zeros((len(states), len(ESTIMATED), N_STATES))
    G[:, OF_AIR_DATA] = by_air @ by_state
    G[:, OF_RATES, TURN] = np.eye(3)
    G[:, OF_WIND, SLOW] = np.eye(3)
    G[:, OF_WIND, FAST] = np.eye(3)
    variance = np.einsum("nij,njk,nik->ni", G, P, G)
    places = fit.parameters.places[record.flight]
    s = _parameter_slopes(fit, item, G, by_air)[:, :, : len(places)]
    C = covariance[np.ix_(places, places)]
    variance += np.einsum("nij,jk,nik->ni", s, C, s)
    return estimates, np.sqrt(variance)


def _parameter_slopes(fit: AirFit, item: FittedRecord, G: Array, by_air: Array) -> Array:
    """Return d (air data, rates, wind) / d parameters (n, 9, p), as of the filtered states."""
    record = item.record
    wind = fit.layout.place(*WINDS)
    arm = fit.layout.place(*ARM)
    slopes = G @ state_slopes(item.linear, item.run)
    slopes[:, OF_AIR_DATA, wind] -= by_air @ record.attitude
    slopes[:, OF_AIR_DATA, arm] -= by_air @ cross_matrix(record.rates)
    slopes[:, OF_WIND, wind] += np.eye(3)
    return slopes


def _path(record: Record, mass: float) -> Matrix:
    """Return specific force, attitude and ground velocity (n, 9) without biases and lags."""
    to_earth = record.attitude.mT
    angles = Rotation.from_matrix(to_earth).as_euler("ZYX")[:, ::-1]
    force = record.measured[:, FORCE].copy()
    if not record.sampled[0]:  # it took the place of thrust
        force[:, 0] = record.inputs.thrust[:, 0] / mass
    return np.column_stack([force, angles, record.earth_velocity()])
