r"""Path over the ground: its states, and the equations of its sensors.

States of a sample are ground velocity v (NED), attitude R (body to NED) and gust w (NED); constants are
biases of the inertial sensors, lags of GPS and attitude, and the mean wind. Between samples, h seconds
apart, three process equations have the residuals

.. math:: R_k^T \left( \frac{v_{k+1} - v_k}{h} - g - \frac{R_k f_k + R_{k+1} f_{k+1}}{2} \right), \quad
          \frac{\mathrm{Log}(R_k^T R_{k+1})}{h} - \frac{\omega_k + \omega_{k+1}}{2}
          - \frac{h}{12} \omega_k \times \omega_{k+1}, \quad
          w_{k+1} - e^{-h/T} w_k.

Airspeed, alpha, beta, GPS velocity and attitude of a sample are measurement equations (Jategaonkar
2006, chapter 10). The second residual contains the coning of two samples (Bortz 1971).

The nine process equations and the nine measurement equations of a sample are the rows of `Equations`. The
row of a sensor that was not sampled, or of a step over a gap, is zero: it says nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.frames import STANDARD_GRAVITY, air_data, air_data_slopes, cross_matrix
from skdgp._flight.tables import interpolate_missing
from skdgp.estimation._least_squares import Equations
from skdgp.estimation._sensors import (
    AIR_READINGS,
    FORCE_READINGS,
    PATH_CONSTANTS,
    RATE_READINGS,
    FlightSensors,
    SensorErrors,
)

PLACE = {name: place for place, name in enumerate(PATH_CONSTANTS)}
FORCE_BIAS_CONSTANTS = slice(PLACE["ax_bias"], PLACE["az_bias"] + 1)
RATE_BIAS_CONSTANTS = slice(PLACE["p_bias"], PLACE["r_bias"] + 1)
VELOCITY_LAG = PLACE["velocity_lag"]
ATTITUDE_LAG = PLACE["attitude_lag"]
WIND_CONSTANTS = slice(PLACE["wind_north"], PLACE["wind_east"] + 1)
"""Places among the constants, in the order of `PATH_CONSTANTS`."""
N_STATES = 9
VELOCITY = slice(0, 3)
ATTITUDE = slice(3, 6)
GUST = slice(6, 9)
"""Places in a state's errors: NED velocity, rotation vector in body axes, NED gust."""
FORCE_ROWS = slice(0, 3)
RATE_ROWS = slice(3, 6)
GUST_ROWS = slice(6, 9)
PROCESS_ROWS = slice(0, 9)
INERTIAL_ROWS = slice(0, 6)
AIR_DATA_ROWS = slice(9, 12)
GPS_ROWS = slice(12, 15)
ATTITUDE_ROWS = slice(15, 18)
"""Places among the equations."""
EQUATION_NOISE = (
    "accelerometer",
    "accelerometer",
    "accelerometer",
    "gyro",
    "gyro",
    "gyro",
    "gust_horizontal",
    "gust_horizontal",
    "gust_vertical",
    "airspeed",
    "alpha",
    "beta",
    "v_horizontal",
    "v_horizontal",
    "v_down",
    "tilt",
    "tilt",
    "heading",
)
"""Noise of each equation."""
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])
"""NED; the local excess of gravity is part of the accelerometers' biases."""
POLAR = np.array([1.0, -1.0, 1.0])
MIRROR = np.concatenate([POLAR, -POLAR, POLAR])
"""Signs of a state's errors in a mirror at the x-z plane; a rotation is an axial vector."""
ODD = frozenset(("ay_bias", "p_bias", "r_bias", "wind_east"))
"""Constants that change their sign in it."""


class FlightPath(NamedTuple):
    """The states of a flight, one for every sample, and its constants."""

    velocity: Matrix  # (n, 3) over the ground, NED [m/s]
    attitude: Rotation  # n attitudes, body to NED
    gust: Matrix  # (n, 3) the air's velocity minus the mean wind, NED [m/s]
    constants: Vector  # (c,) in the order of PATH_CONSTANTS

    @classmethod
    def initial(cls, sensors: FlightSensors) -> FlightPath:
        """Return the path of GPS and attitude alone, in air at rest."""
        velocity = interpolate_missing(sensors.time, sensors.velocity)
        gust = np.zeros_like(velocity)
        return cls(velocity, sensors.attitude, gust, np.zeros(len(PATH_CONSTANTS)))

    def moved(self, states: Matrix, constants: Any) -> FlightPath:
        """Return the path with changes of states (n, 9) and constants (c,) added."""
        return FlightPath(
            velocity=self.velocity + states[:, VELOCITY],
            attitude=self.attitude * Rotation.from_rotvec(states[:, ATTITUDE]),
            gust=self.gust + states[:, GUST],
            constants=self.constants + constants,
        )

    def constant(self, *names: str) -> Vector:
        """Return the values (k,) of constants by name, SI units."""
        return self.constants[[PLACE[name] for name in names]]

    def wind(self) -> Matrix:
        """Return the air's velocity (n, 3), NED [m/s]."""
        return self.gust + np.append(self.constants[WIND_CONSTANTS], 0.0)

    def air_velocity(self) -> Matrix:
        """Return the velocity relative to the air (n, 3), body axes [m/s]."""
        return self.attitude.inv().apply(self.velocity - self.wind())

    def inertial(self, sensors: FlightSensors) -> tuple[Matrix, Matrix]:
        """Return specific force and angular rate (n, 3), body axes, without the sensors' biases."""
        errors = SensorErrors.of(dict(zip(PATH_CONSTANTS, self.constants, strict=True)))
        truth = errors.truth(sensors.readings)
        return truth[:, FORCE_READINGS], truth[:, RATE_READINGS]


def path_equations(
    path: FlightPath,
    sensors: FlightSensors,
    correlation: Vector,
    delays: Indices,
) -> Equations:
    """Return the equations of a path: residuals, and slopes by errors of the states and by all constants.

    Parameters
    ----------
    path : FlightPath
    sensors : FlightSensors
    correlation : ndarray (n - 1,)
        Of the gusts of a sample and the next.
    delays : ndarray (2,)
        Lags of GPS velocity and attitude in whole samples.
    """
    n = len(sensors.time)
    columns = np.zeros((n, len(EQUATION_NOISE), 2 * N_STATES + len(PATH_CONSTANTS) + 1))
    equations = Equations(columns, N_STATES)
    force, rate = path.inertial(sensors)
    # between samples
    between = Equations(columns[:-1], N_STATES)
    step = np.diff(sensors.time)[:, None]
    turn = path.attitude[:-1].inv() * path.attitude[1:]  # R_k^T R_{k+1}
    _fill_force(between, path, force, turn, step)
    _fill_rate(between, rate, turn, step)
    _fill_gust(between, path.gust, correlation)
    between.residual[~sensors.joined, PROCESS_ROWS] = np.nan
    # of a sample
    _fill_air_data(equations, path, sensors.readings[:, AIR_READINGS])
    _fill_velocity(equations, path, sensors, force, delays[0])
    _fill_attitude(equations, path, sensors, rate, delays[1])
    # what was not sampled, or lies beyond a gap, is no equation
    columns[np.isnan(equations.residual)] = 0.0
    return equations


def _fill_force(
    equations: Equations, path: FlightPath, force: Matrix, turn: Rotation, step: Matrix
) -> None:
    """Set R_k^T ((v_{k+1} - v_k) / h - g - (R_k f_k + R_{k+1} f_{k+1}) / 2)."""
    back = path.attitude[:-1].inv()
    turned = turn.as_matrix()
    acceleration = np.diff(path.velocity, axis=0) / step
    mean_force = (force[:-1] + turn.apply(force[1:])) / 2
    residual = back.apply(acceleration - GRAVITY) - mean_force
    by_velocity = back.as_matrix() / step[..., None]
    equations.residual[:, FORCE_ROWS] = residual
    equations.d_next[:, FORCE_ROWS, VELOCITY] = by_velocity
    equations.d_state[:, FORCE_ROWS, VELOCITY] = -by_velocity
    equations.d_next[:, FORCE_ROWS, ATTITUDE] = turned @ cross_matrix(force[1:]) / 2
    equations.d_state[:, FORCE_ROWS, ATTITUDE] = cross_matrix(residual + force[:-1] / 2)
    equations.d_constants[:, FORCE_ROWS, FORCE_BIAS_CONSTANTS] = (np.eye(3) + turned) / 2


def _fill_rate(equations: Equations, rate: Matrix, turn: Rotation, step: Matrix) -> None:
    """Set Log(R_k^T R_{k+1}) / h - (omega_k + omega_{k+1}) / 2 - (h / 12) omega_k x omega_{k+1}."""
    angle = turn.as_rotvec()
    mean_rate = (rate[:-1] + rate[1:]) / 2
    coning = np.cross(rate[:-1], rate[1:]) * step / 12
    gradient = _log_gradient(angle) / step[..., None]
    equations.residual[:, RATE_ROWS] = angle / step - mean_rate - coning
    equations.d_next[:, RATE_ROWS, ATTITUDE] = gradient
    equations.d_state[:, RATE_ROWS, ATTITUDE] = -gradient @ turn.inv().as_matrix()
    equations.d_constants[:, RATE_ROWS, RATE_BIAS_CONSTANTS] = np.eye(3)


def _fill_gust(equations: Equations, gust: Matrix, correlation: Vector) -> None:
    """Set w_{k+1} - exp(-h / T) w_k."""
    equations.residual[:, GUST_ROWS] = gust[1:] - correlation[:, None] * gust[:-1]
    equations.d_state[:, GUST_ROWS, GUST] = -correlation[:, None, None] * np.eye(3)
    equations.d_next[:, GUST_ROWS, GUST] = np.eye(3)


def _fill_air_data(equations: Equations, path: FlightPath, measured: Matrix) -> None:
    """Set airspeed, alpha and beta of R^T (v - w), less the measured ones."""
    # below it vanes show no angle [m/s]; guess
    least_airspeed = 3.0
    velocity = path.air_velocity()
    predicted = np.column_stack(air_data(velocity))
    predicted[predicted[:, 0] < least_airspeed, 1:] = np.nan
    slopes = air_data_slopes(velocity, least_airspeed)
    by_ned = slopes @ path.attitude.as_matrix().mT
    equations.residual[:, AIR_DATA_ROWS] = predicted - measured
    equations.d_state[:, AIR_DATA_ROWS, VELOCITY] = by_ned
    equations.d_state[:, AIR_DATA_ROWS, ATTITUDE] = slopes @ cross_matrix(velocity)
    equations.d_state[:, AIR_DATA_ROWS, GUST] = -by_ned
    equations.d_constants[:, AIR_DATA_ROWS, WIND_CONSTANTS] = -by_ned[:, :, :2]


def _fill_velocity(
    equations: Equations, path: FlightPath, sensors: FlightSensors, force: Matrix, delay: int
) -> None:
    """Set velocity at the end of its lag, less the one that GPS shows then."""
    rows, offset = _lagged_rows(sensors, path.constants[VELOCITY_LAG], delay)
    acceleration = path.attitude.apply(force) + GRAVITY
    equations.residual[:, GPS_ROWS] = path.velocity - sensors.velocity[rows] + offset * acceleration
    equations.d_state[:, GPS_ROWS, VELOCITY] = np.eye(3)
    equations.d_constants[:, GPS_ROWS, VELOCITY_LAG] = -acceleration


def _fill_attitude(
    equations: Equations, path: FlightPath, sensors: FlightSensors, rate: Matrix, delay: int
) -> None:
    """Set the rotation about NED axes from the attitude measured at the end of its lag to the path's then."""
    rows, offset = _lagged_rows(sensors, path.constants[ATTITUDE_LAG], delay)
    angle = (path.attitude * sensors.attitude[rows].inv()).as_rotvec()
    angle[~sensors.attitude_sampled[rows]] = np.nan
    rate_ned = path.attitude.apply(rate)
    equations.residual[:, ATTITUDE_ROWS] = angle + offset * rate_ned
    equations.d_state[:, ATTITUDE_ROWS, ATTITUDE] = (
        _log_gradient(-angle) @ path.attitude.as_matrix()
    )
    equations.d_constants[:, ATTITUDE_ROWS, ATTITUDE_LAG] = -rate_ned


def _lagged_rows(sensors: FlightSensors, lag: float, delay: int) -> tuple[Indices, Matrix]:
    """Return the row measured ``delay`` samples later, (n,), and its offset in time from the lag, (n, 1).

    The offset, over which a prediction is continued at its rate of change, is NaN where there is
    no such row in the segment.
    """
    later = np.arange(len(sensors.time)) + delay
    rows = np.clip(later, 0, len(later) - 1)
    same = (rows == later) & (sensors.segment[rows] == sensors.segment)
    offset = sensors.time[rows] - sensors.time - lag
    return rows, np.where(same, offset, np.nan)[:, None]


def _log_gradient(angle: Matrix) -> Array:
    """Return the derivative of Log(exp(angle) exp(x)) by x at 0, to second order in the angle: (n, 3, 3)."""
    half = cross_matrix(angle) / 2
    return np.eye(3) + half + half @ half / 3
