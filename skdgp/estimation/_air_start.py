r"""Starting values of the filter: steady wind, scale of the pitot, and derivatives in steady wind.

Airspeed V is the speed over the ground less the steady wind w, but for gusts and a scale error s,

.. math:: (1 + s) |v - w| - V = 0.

In steady wind the coefficients follow from specific force and rates by inverse dynamics, and their
derivatives by least squares.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from skdgp._compute.linalg import least_squares
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.frames import air_data
from skdgp.estimation._air_linearization import N_STATES, Layout, air_velocity
from skdgp.estimation._air_parameters import (
    AIRCRAFT_CONSTANTS,
    PITOT,
    Parameters,
    Sums,
    is_coupling,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._sensors import AIRSPEED, WIND_STD


def airspeed_error(record: Record, pitot: Vector) -> tuple[Matrix, Vector]:
    """Return the derivatives by `PITOT` of the airspeed in a steady wind less the measured one, and this error."""
    sampled = np.isfinite(record.measured[:, AIRSPEED])
    scale, north, east = pitot
    air = record.earth_velocity()[sampled] - [north, east, 0.0]
    speed = np.linalg.norm(air, axis=1)
    by_wind = -(1 + scale) * air[:, :2] / speed[:, None]
    error = (1 + scale) * speed - record.measured[sampled, AIRSPEED]
    return np.column_stack([speed, by_wind]), error


def steady_wind(records: list[Record]) -> tuple[Vector, float]:
    """Return `PITOT` (3,) of a flight by least squares of its airspeed, and the variance of a sample of it [m^2/s^2].

    By Gauss-Newton steps. Gusts correlate over seconds, so a sample counts as one over their correlation time.
    """
    _, scale_std = AIRCRAFT_CONSTANTS["airspeed_scale"]
    # mean airspeed of a flight times the root of its samples, standard deviation [m/s]; typical
    prior = np.diag(10.0 / np.array([scale_std, WIND_STD, WIND_STD]))
    pitot = np.zeros(3)
    # Gauss-Newton steps for the steady wind
    for _ in range(5):
        slopes = [prior]
        residuals = [prior @ pitot]
        for record in records:
            by_pitot, error = airspeed_error(record, pitot)
            slopes.append(by_pitot)
            residuals.append(error)
        residual = np.concatenate(residuals)
        pitot = pitot - least_squares(np.vstack(slopes), residual)
    errors = residual[len(prior) :]
    least = 0.01  # [m^2/s^2]
    if not len(errors):
        return pitot, least
    return pitot, max(autocorrelation_time(errors) * errors.var(), least)


def steady_derivatives(
    records: list[Record], layout: Layout, parameters: Parameters, x: Vector
) -> Vector:
    """Return parameters with derivatives by least squares in steady wind, but slopes by alpha and beta as in x.

    In gusts, alpha and beta of the path in steady wind are too noisy for least squares.
    """
    terms = []
    coefficients = []
    for record in records:
        value = parameters.values(x, record.flight)
        model = layout.model(value)
        flow = air_data(air_velocity(record, value, np.zeros((len(record.rows), N_STATES))))
        # half of the moving mean of the rates before they are differentiated [s]
        width = 2 * round(0.05 / record.median_step) + 1
        smooth = uniform_filter1d(record.rates, width, axis=0, mode="nearest")
        spin = np.gradient(smooth, record.time, axis=0)
        motion = (record.force, record.rates, spin, flow[0], record.inputs)
        terms.append(model.terms(flow, record.rates, record.inputs))
        coefficients.append(model.coefficients(*motion))
    X = np.concatenate(terms)[:, layout.columns]  # of each derivative
    C = np.concatenate(coefficients)
    x = x.copy()
    names = layout.names[: layout.n_derivatives]
    is_held = np.array([name.endswith(("_alpha", "_beta")) or is_coupling(name) for name in names])
    for row in range(6):
        of_row = layout.rows == row
        held = np.flatnonzero(of_row & is_held)
        free = np.flatnonzero(of_row & ~is_held)
        residual = C[:, row] - X[:, held] @ x[held]
        x[free] = least_squares(X[:, free], residual)
    return x


def add_airspeed(
    sums: Sums, record: Record, x: Vector, parameters: Parameters, variance: float
) -> None:
    """Add the equations of the airspeed in a steady wind, whose samples have a variance.

    Turns separate wind and scale without coefficients or attitudes; the instruments contain little
    information about both.
    """
    places = parameters.places_of(record.flight, PITOT)
    slopes, error = airspeed_error(record, x[places])
    weighted = slopes.T / variance
    sums.add(places, weighted @ error, weighted @ slopes)
