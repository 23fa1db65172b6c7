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
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.frames import STANDARD_GRAVITY, air_data, air_data_slopes, cross_matrix
from skdgp._flight.tables import interpolate_missing
from skdgp.estimation._least_squares import Equations
from skdgp.estimation._sensors import (
    AIR,
    FORCE,
    MEAN_WIND,
    PATH_CONSTANTS,
    RATE,
    FlightSensors,
    SensorErrors,
)

PLACE = {name: place for place, name in enumerate(PATH_CONSTANTS)}
FORCE_BIASES = [PLACE[name] for name in ("ax_bias", "ay_bias", "az_bias")]
RATE_BIASES = [PLACE[name] for name in ("p_bias", "q_bias", "r_bias")]
WINDS = [PLACE[name] for name in MEAN_WIND]
# constants of the lags of the six measurements after air data: velocity, attitude
LATE = [*[PLACE["velocity_lag"]] * 3, *[PLACE["attitude_lag"]] * 3]
# places in a state's errors: NED velocity, rotation vector in body axes, NED gust
VELOCITY = slice(0, 3)
ATTITUDE = slice(3, 6)
GUST = slice(6, 9)
# NED; the local excess of gravity is part of the accelerometers' biases
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])
# signs of a state's errors in a mirror at the x-z plane, and constants that change theirs
MIRROR = (1, -1, 1, -1, 1, -1, 1, -1, 1)
ODD = frozenset(("ay_bias", "p_bias", "r_bias", "wind_east"))
# noise of each process equation, and of each measurement equation
PROCESS_NOISE = (
    *["accelerometer"] * 3,
    *["gyro"] * 3,
    "gust_horizontal",
    "gust_horizontal",
    "gust_vertical",
)
MEASUREMENT_NOISE = (
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

    def part(self, first: int, last: int) -> FlightPath:
        """Return the states of samples ``first`` to ``last`` - 1."""
        states = [values[first:last] for values in self[:-1]]
        return FlightPath._make([*states, self.constants])

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
        return self.gust + np.append(self.constants[WINDS], 0.0)

    def air_velocity(self) -> Matrix:
        """Return the velocity relative to the air (n, 3), body axes [m/s]."""
        return self.attitude.inv().apply(self.velocity - self.wind())

    def inertial(self, sensors: FlightSensors) -> tuple[Matrix, Matrix]:
        """Return specific force and angular rate (n, 3), body axes, without the sensors' biases."""
        errors = SensorErrors.of(dict(zip(PATH_CONSTANTS, self.constants, strict=True)))
        truth = errors.truth(sensors.readings)
        return truth[:, FORCE], truth[:, RATE]


def process_equations(path: FlightPath, sensors: FlightSensors, correlation: Vector) -> Equations:
    """Return the equations between samples: specific force, angular rate, and the change of the gust.

    ``correlation`` (n - 1,) is the correlation of the gusts of a sample and the next.
    """
    n = len(sensors.time) - 1
    equations = Equations(
        residual=np.zeros((n, 9)),
        d_state=np.zeros((n, 9, 9)),
        d_next=np.zeros((n, 9, 9)),
        d_constants=np.zeros((n, 9, len(PATH_CONSTANTS))),
    )
    force, rate = path.inertial(sensors)
    step = np.diff(sensors.time)[:, None]
    turn = path.attitude[:-1].inv() * path.attitude[1:]  # R_k^T R_{k+1}
    _fill_force(equations, path, force, turn, step)
    _fill_rate(equations, rate, turn, step)
    _fill_gust(equations, path.gust, correlation)
    return _without(equations, np.repeat(~sensors.joined[:, None], 9, axis=1))


def _fill_force(
    equations: Equations, path: FlightPath, force: Matrix, turn: Rotation, step: Matrix
) -> None:
    """Set R_k^T ((v_{k+1} - v_k) / h - g - (R_k f_k + R_{k+1} f_{k+1}) / 2)."""
    residual, d_state, d_next, d_constants = equations
    back = path.attitude[:-1].inv()
    turned = turn.as_matrix()
    force_ned = path.attitude.apply(force)
    acceleration = np.diff(path.velocity, axis=0) / step
    mean_force = (force_ned[:-1] + force_ned[1:]) / 2
    residual[:, VELOCITY] = back.apply(acceleration - GRAVITY - mean_force)
    by_velocity = back.as_matrix() / step[..., None]
    d_next[:, VELOCITY, VELOCITY] = by_velocity
    d_state[:, VELOCITY, VELOCITY] = -by_velocity
    d_next[:, VELOCITY, ATTITUDE] = turned @ cross_matrix(force[1:]) / 2
    d_state[:, VELOCITY, ATTITUDE] = cross_matrix(residual[:, VELOCITY] + force[:-1] / 2)
    d_constants[:, VELOCITY, FORCE_BIASES] = (np.eye(3) + turned) / 2


def _fill_rate(equations: Equations, rate: Matrix, turn: Rotation, step: Matrix) -> None:
    """Set Log(R_k^T R_{k+1}) / h - (omega_k + omega_{k+1}) / 2 - (h / 12) omega_k x omega_{k+1}."""
    residual, d_state, d_next, d_constants = equations
    angle = turn.as_rotvec()
    mean_rate = (rate[:-1] + rate[1:]) / 2
    coning = np.cross(rate[:-1], rate[1:]) * step / 12
    residual[:, ATTITUDE] = angle / step - mean_rate - coning
    gradient = _log_gradient(angle)
    d_next[:, ATTITUDE, ATTITUDE] = gradient / step[..., None]
    d_state[:, ATTITUDE, ATTITUDE] = -gradient @ turn.inv().as_matrix() / step[..., None]
    d_constants[:, ATTITUDE, RATE_BIASES] = np.eye(3)


def _fill_gust(equations: Equations, gust: Matrix, correlation: Vector) -> None:
    """Set w_{k+1} - exp(-h / T) w_k."""
    residual, d_state, d_next, _ = equations
    residual[:, GUST] = gust[1:] - correlation[:, None] * gust[:-1]
    d_state[:, GUST, GUST] = -correlation[:, None, None] * np.eye(3)
    d_next[:, GUST, GUST] = np.eye(3)


def measurement_equations(
    path: FlightPath, sensors: FlightSensors, delays: Indices, least_airspeed: float
) -> Equations:
    """Return predicted - measured airspeed, alpha, beta, GPS velocity, and attitude (rotation about NED axes).

    A sensor with a lag is compared with its value ``delays`` (6,) samples later. Over the rest of the
    lag, less than a step, the prediction is continued by its rate of change.
    """
    n = len(sensors.time)
    equations = Equations(
        residual=np.zeros((n, 9)),
        d_state=np.zeros((n, 9, 9)),
        d_next=None,
        d_constants=np.zeros((n, 9, len(PATH_CONSTANTS))),
    )
    _fill_air_data(equations, path, sensors.readings[:, AIR], least_airspeed)
    _fill_path(equations, path, sensors, delays)
    return _without(equations, np.isnan(equations.residual))


def _fill_air_data(
    equations: Equations, path: FlightPath, measured: Matrix, least_airspeed: float
) -> None:
    """Set airspeed, alpha and beta of R^T (v - w), less the measured ones."""
    residual, d_state, _, d_constants = equations
    velocity = path.air_velocity()
    slopes = air_data_slopes(velocity, least_airspeed)
    by_ned = slopes @ path.attitude.as_matrix().mT
    airspeed, alpha, beta = air_data(velocity)
    residual[:, :3] = np.column_stack([airspeed, alpha, beta]) - measured
    residual[airspeed < least_airspeed, 1:3] = np.nan
    d_state[:, :3, VELOCITY] = by_ned
    d_state[:, :3, ATTITUDE] = slopes @ cross_matrix(velocity)
    d_state[:, :3, GUST] = -by_ned
    d_constants[:, :3, WINDS] = -by_ned[:, :, :2]


def _fill_path(
    equations: Equations, path: FlightPath, sensors: FlightSensors, delays: Indices
) -> None:
    """Set velocity and attitude, less those measured one lag later."""
    residual, d_state, _, d_constants = equations
    later, offset = _lagged_rows(sensors, path.constants[LATE], delays)
    measured_velocity = np.take_along_axis(sensors.velocity, later[:, :3], axis=0)
    residual[:, 3:6] = path.velocity - measured_velocity
    d_state[:, 3:6, VELOCITY] = np.eye(3)
    rows = later[:, 3]
    angle = (path.attitude * sensors.attitude[rows].inv()).as_rotvec()
    residual[:, 6:9] = angle
    residual[~sensors.attitude_sampled[rows], 6:9] = np.nan
    d_state[:, 6:9, ATTITUDE] = _log_gradient(-angle) @ path.attitude.as_matrix()
    # over the rest of the lag velocity and attitude move at their rates of change
    force, rate = path.inertial(sensors)
    acceleration = path.attitude.apply(force) + GRAVITY
    rates = np.concatenate([acceleration, path.attitude.apply(rate)], axis=1)
    residual[:, 3:] += offset * rates
    for row, place in enumerate(LATE):
        d_constants[:, 3 + row, place] = -rates[:, row]


def _lagged_rows(sensors: FlightSensors, lags: Vector, delays: Indices) -> tuple[Indices, Matrix]:
    """Return the row measured for each of `LATE`, (n, 6), and its offset in time, NaN where there is none."""
    time, segment = sensors.time, sensors.segment
    n = len(time)
    later = np.arange(n)[:, None] + delays
    inside = np.clip(later, 0, n - 1)
    same = (inside == later) & (segment[inside] == segment[:, None])
    offset = time[inside] - time[:, None] - lags
    return inside, np.where(same, offset, np.nan)


def _log_gradient(angle: Matrix) -> Array:
    """Return the derivative of Log(exp(angle) exp(x)) by x at 0, to second order in the angle: (n, 3, 3)."""
    half = cross_matrix(angle) / 2
    return np.eye(3) + half + half @ half / 3


def _without(equations: Equations, missing: Mask) -> Equations:
    """Return the equations with zeros for the missing ones."""
    for values in equations:
        if values is not None:
            values[missing] = 0.0
    return equations
