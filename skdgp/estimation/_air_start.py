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
from skdgp._flight.channels import COEFFICIENTS
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


class SteadyRegression:
    """Coefficients of records by inverse dynamics in steady wind, and their regressors."""

    def __init__(self, layout: Layout, parameters: Parameters) -> None:
        self.layout = layout
        self.parameters = parameters

    def __call__(self, record: Record, x: Vector) -> tuple[Matrix, Matrix]:
        """Return terms (n, f) and coefficients (n, 6) at parameters x."""
        value = self.parameters.values(x, record.flight)
        air = air_velocity(record, value, np.zeros((len(record.rows), N_STATES)))
        # half of the moving mean of the rates before they are differentiated in steady wind [s]
        width = 2 * round(0.05 / record.median_step) + 1
        smooth = uniform_filter1d(record.rates, width, axis=0, mode="nearest")
        spin = np.gradient(smooth, record.time, axis=0)
        model = self.layout.model(value)
        flow = air_data(air)
        coefficients = model.coefficients(record.force, record.rates, spin, flow[0], record.inputs)
        return model.terms(flow, record.rates, record.inputs), coefficients

    def derivatives(self, records: list[Record], x: Vector) -> Vector:
        """Return parameters with derivatives by least squares, but slopes by alpha and beta as in x.

        In gusts, alpha and beta of the path in steady wind are too noisy for least squares.
        """
        equations = [self(record, x) for record in records]
        X, C = map(np.concatenate, zip(*equations, strict=True))
        X = X[:, self.layout.columns]  # of each derivative
        x = x.copy()
        names = self.layout.names[: self.layout.n_derivatives]
        is_held = self.layout.is_by("alpha", "beta") | [is_coupling(name) for name in names]
        for row in range(6):
            of_row = self.layout.rows == row
            held = np.flatnonzero(of_row & is_held)
            free = np.flatnonzero(of_row & ~is_held)
            if len(free):
                residual = C[:, row] - X[:, held] @ x[held]
                x[free] = least_squares(X[:, free], residual)
        return x


def add_mean_lift(sums: Sums, record: Record, x: Vector, regression: SteadyRegression) -> None:
    """Add the equation of the mean lift: as in steady wind, except for a mean vertical gust.

    Alpha is observed by forces alone, so its mean and CZ_0 could not be separated otherwise.
    """
    X, C = regression(record, x)
    places = np.flatnonzero(regression.layout.rows == COEFFICIENTS.index("CZ"))
    slopes = X.mean(axis=0)[regression.layout.columns[places]]
    residual = slopes @ x[places] - C[:, 2].mean()
    speed = np.linalg.norm(record.velocity, axis=1).mean()
    # a typical slope of lift by alpha [1/rad], and the standard deviation of the mean vertical gust of a record [m/s]
    std = 4.5 * 0.2 / speed
    sums.add_equations(places, slopes[None], np.array([residual]), std**2)


def add_airspeed(
    sums: Sums, record: Record, x: Vector, parameters: Parameters, variance: float
) -> None:
    """Add the equations of the airspeed in a steady wind, whose samples have a variance.

    Turns separate wind and scale without coefficients or attitudes; the instruments contain little
    information about both.
    """
    places = parameters.places_of(record.flight, PITOT)
    slopes, error = airspeed_error(record, x[places])
    sums.add_equations(places, slopes, error, variance)
