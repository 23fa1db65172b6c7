"""Flight-path reconstruction: the logs of flights, their states, and the process and measurement equations.

The process equations relate neighbouring samples: specific force, angular rate and gusts. The measurement equations
relate a state to airspeed, alpha, beta, GPS velocity and attitude at one sample.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE
from skdgp._flight.checks import numeric
from skdgp._flight.clock import check_clock, flight_rows, runs_by_flight
from skdgp._flight.frames import air_data, air_data_slopes, cross_matrix
from skdgp.preprocessing._table import has_values, interpolate_missing

NEEDED = (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, "airspeed")  # alpha and beta are optional

VELOCITY, ATTITUDE, GUST = slice(0, 3), slice(3, 6), slice(6, 9)
"""Places in the vector of a state's errors: NED velocity, rotation vector in body axes, NED gust."""

INERTIAL = {
    "ax_bias": 0.3, "ay_bias": 0.3, "az_bias": 0.3, "p_bias": 0.02, "q_bias": 0.02, "r_bias": 0.02,
}  # fmt: skip
SENSORS = {
    "airspeed_scale": 0.1, "alpha_bias": 0.03, "alpha_scale": 0.2, "beta_bias": 0.03, "beta_scale": 0.2,
    "airspeed_lag": 0.1, "vane_lag": 0.1, "velocity_lag": 0.1, "attitude_lag": 0.1,
}  # fmt: skip
MEAN_WIND = dict.fromkeys(("wind_north", "wind_east"), 30.0)
CONSTANTS = INERTIAL | SENSORS | MEAN_WIND
"""Constants of a flight, with their prior standard deviations (SI). Measured is truth + bias, (1 + scale) truth + bias,
or truth a lag [s] ago; wind_north and wind_east are the mean wind."""
PLACE = {name: place for place, name in enumerate(CONSTANTS)}
LAGS = ("airspeed_lag", "vane_lag", "vane_lag", *["velocity_lag"] * 3, *["attitude_lag"] * 3)  # of the measurements
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY])  # NED; what it is more here is in the accelerometers' biases
MIN_AIRSPEED = 3.0  # m/s, below which vanes show no angle


class Equations(NamedTuple):
    """Linear equations residual + d_state x_k + d_next x_{k+1} + d_constants c = 0, m for each of n samples k."""

    residual: Matrix  # (n, m)
    d_state: Array  # (n, m, s)
    d_next: Array | None  # (n, m, s); None for measurement equations
    d_constants: Array  # (n, m, c)

    def part(self, first: int, last: int) -> Equations:
        """Return the equations of the samples from first to before last."""
        return Equations._make(None if values is None else values[first:last] for values in self)

    def changes(self, states: Array, constants: Matrix) -> Array:
        """Return the changes of the residuals, (n, m, k), by k sets of states (N, s, k) and constants (c, k)."""
        n = len(self.d_state)
        total = self.d_state @ states[:n] + self.d_constants @ constants
        return total if self.d_next is None else total + self.d_next @ states[1 : n + 1]


class Log(NamedTuple):
    """The sensors of one flight, n samples."""

    time: Vector  # (n,) [s]
    segment: Indices  # (n,) number of the gap-free segment of a sample
    force: Matrix  # (n, 3) accelerometers [m/s^2]
    rate: Matrix  # (n, 3) gyros [rad/s]
    air: Matrix  # (n, 3) airspeed [m/s], alpha, beta [rad]; NaN where not sampled
    velocity: Matrix  # (n, 3) GPS velocity, NED [m/s]; NaN where not sampled
    attitude: Rotation  # n attitudes, body to NED
    attitude_sampled: Mask  # (n,) where the attitude was sampled
    delays: tuple[int, ...] = (0,) * 9  # lag of each measurement in whole samples

    def part(self, first: int, last: int) -> Log:
        """Return the samples from first to before last."""
        return Log._make([*(values[first:last] for values in self[:-1]), self.delays])

    @property
    def joined(self) -> Mask:
        """Whether a sample and the next are in one segment, (n - 1,)."""
        return self.segment[1:] == self.segment[:-1]


class FlightPath(NamedTuple):
    """The states of a flight, one for every sample, and its constants."""

    velocity: Matrix  # (n, 3) over the ground, NED [m/s]
    attitude: Rotation  # n attitudes, body to NED
    gust: Matrix  # (n, 3) the air's velocity minus the mean wind, NED [m/s]
    constants: Vector  # (c,) in the order of CONSTANTS

    def part(self, first: int, last: int) -> FlightPath:
        """Return the states from first to before last."""
        return FlightPath(self.velocity[first:last], self.attitude[first:last], self.gust[first:last], self.constants)

    def moved(self, states: Matrix, constants: Any) -> FlightPath:
        """Return the path with errors (n, 9), (c,) added."""
        turned = self.attitude * Rotation.from_rotvec(states[:, ATTITUDE])
        velocity, gust = self.velocity + states[:, VELOCITY], self.gust + states[:, GUST]
        return FlightPath(velocity, turned, gust, self.constants + constants)

    def constant(self, *names: str) -> Vector:
        """Return constants by name."""
        return self.constants[[PLACE[name] for name in names]]

    def wind(self) -> Matrix:
        """Return the air's velocity (n, 3), NED [m/s]."""
        return self.gust + np.append(self.constant(*MEAN_WIND), 0.0)

    def air_velocity(self) -> Matrix:
        """Return the velocity relative to the air (n, 3), body axes [m/s]."""
        return self.attitude.inv().apply(self.velocity - self.wind())

    def force(self, log: Log) -> Matrix:
        """Return the specific force (n, 3), body axes, without the sensors' bias."""
        return log.force - self.constant("ax_bias", "ay_bias", "az_bias")

    def rate(self, log: Log) -> Matrix:
        """Return the angular rate (n, 3), body axes, without the sensors' bias."""
        return log.rate - self.constant("p_bias", "q_bias", "r_bias")


def flight_logs(table: pd.DataFrame) -> list[tuple[object, Indices, Log]]:
    """Return name, rows and log of every flight in the table.

    Raise ValueError if time does not increase, or a needed channel has no value in a flight.
    """
    names = np.asarray(table["flight"], dtype=object) if "flight" in table else np.zeros(len(table), int)
    time, codes = check_clock(numeric(table, ["time"])[:, 0], names)
    logs = []
    for runs in runs_by_flight(time, codes):
        rows = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        segment = np.repeat(np.arange(len(runs)), [run.stop - run.start for run in runs])
        logs.append((names[rows[0]], rows, _log(table.iloc[rows], time[rows], segment)))
    return logs


def missing_channels(table: pd.DataFrame) -> list[str]:
    """Return the needed channels that are absent, or have no value in some flight."""
    absent = [name for name in ("time", *NEEDED) if name not in table]
    rows = flight_rows(table["flight"]).values() if "flight" in table else [slice(None)]
    there = [name for name in NEEDED if name not in absent]
    return absent + [name for name in there if not all(has_values(table.iloc[part], name) for part in rows)]


def first_guess(log: Log, constants: Vector) -> FlightPath:
    """Return the path of GPS and attitude alone, in air at rest."""
    velocity = interpolate_missing(log.time, log.velocity)
    return FlightPath(velocity, log.attitude, np.zeros_like(velocity), constants)


def _log(table: pd.DataFrame, time: Vector, segment: Indices) -> Log:
    if empty := [name for name in NEEDED if not has_values(table, name)]:
        flight = f"flight {table['flight'].iloc[0]!r}" if "flight" in table else "the flight"
        raise ValueError(
            f"Got no value of {', '.join(empty)} in {flight}, but expected some: a path cannot be reconstructed "
            "without them. Leave the flight out, or smooth it with FlightSmoother."
        )
    angles = numeric(table, EULER).copy()
    sampled = np.all(np.isfinite(angles), axis=1)
    angles[sampled] = np.unwrap(angles[sampled], axis=0)
    attitude = Rotation.from_euler("ZYX", interpolate_missing(time, angles)[:, ::-1])
    inertial = interpolate_missing(time, numeric(table, [*SPECIFIC_FORCE, *RATES]))
    air = numeric(table.reindex(columns=list(AIR_DATA)), AIR_DATA)
    velocity = numeric(table, EARTH_VELOCITY)
    return Log(time, segment, inertial[:, :3], inertial[:, 3:], air, velocity, attitude, sampled)


def air_data_rates(path: FlightPath, log: Log) -> Matrix:
    """Return the rates of airspeed, alpha, beta (n, 3) in air of constant velocity: v' = f - omega x v + R^T g."""
    velocity = path.air_velocity()
    acceleration = path.force(log) + path.attitude.inv().apply(GRAVITY) - np.cross(path.rate(log), velocity)
    return np.einsum("nij,nj->ni", air_data_slopes(velocity, MIN_AIRSPEED), acceleration)


def air_data_equations(path: FlightPath) -> Equations:
    """Return airspeed, alpha, beta as residuals, with their derivatives by path and mean wind."""
    velocity, R = path.air_velocity(), path.attitude.as_matrix()
    gradient = air_data_slopes(velocity, MIN_AIRSPEED)
    by_ned = gradient @ R.swapaxes(1, 2)
    d_state = np.concatenate([by_ned, gradient @ cross_matrix(velocity), -by_ned], axis=2)
    d_constants = np.zeros((len(R), 3, len(CONSTANTS)))
    d_constants[:, :, [PLACE[name] for name in MEAN_WIND]] = -by_ned[:, :, :2]
    return Equations(np.column_stack(air_data(velocity)), d_state, None, d_constants)


def process_equations(path: FlightPath, log: Log, correlation: Vector) -> Equations:
    """Return predicted - measured specific force and angular rate between samples, and the change of the gust."""
    n, c = len(log.time) - 1, len(CONSTANTS)
    residual, d_constants = np.zeros((n, 9)), np.zeros((n, 9, c))
    d_state, d_next = np.zeros((n, 9, 9)), np.zeros((n, 9, 9))
    step = np.diff(log.time)[:, None]
    back, turn = path.attitude[:-1].inv(), path.attitude[:-1].inv() * path.attitude[1:]
    turned = turn.as_matrix()

    # R_k^T ((v_{k+1} - v_k) / h - g - (R_k f_k + R_{k+1} f_{k+1}) / 2) over a step of h seconds.
    force = path.force(log)
    force_ned = path.attitude.apply(force)
    acceleration = np.diff(path.velocity, axis=0) / step
    residual[:, VELOCITY] = back.apply(acceleration - GRAVITY - (force_ned[:-1] + force_ned[1:]) / 2)
    d_next[:, VELOCITY, VELOCITY] = back.as_matrix() / step[..., None]
    d_state[:, VELOCITY, VELOCITY] = -d_next[:, VELOCITY, VELOCITY]
    d_next[:, VELOCITY, ATTITUDE] = turned @ cross_matrix(force[1:]) / 2
    d_state[:, VELOCITY, ATTITUDE] = cross_matrix(residual[:, VELOCITY] + force[:-1] / 2)
    d_constants[:, VELOCITY, PLACE["ax_bias"] : PLACE["az_bias"] + 1] = (np.eye(3) + turned) / 2

    # Log(R_k^T R_{k+1}) / h - (omega_k + omega_{k+1}) / 2 - (h / 12) omega_k x omega_{k+1}.
    rate = path.rate(log)
    angle = turn.as_rotvec()
    coning = np.cross(rate[:-1], rate[1:]) * step / 12
    residual[:, ATTITUDE] = angle / step - (rate[:-1] + rate[1:]) / 2 - coning
    d_next[:, ATTITUDE, ATTITUDE] = _log_gradient(angle) / step[..., None]
    d_state[:, ATTITUDE, ATTITUDE] = -_log_gradient(angle) @ turn.inv().as_matrix() / step[..., None]
    d_constants[:, ATTITUDE, PLACE["p_bias"] : PLACE["r_bias"] + 1] = np.eye(3)

    residual[:, GUST] = path.gust[1:] - correlation[:, None] * path.gust[:-1]
    d_state[:, GUST, GUST] = -correlation[:, None, None] * np.eye(3)
    d_next[:, GUST, GUST] = np.eye(3)
    return _without(Equations(residual, d_state, d_next, d_constants), np.repeat(~log.joined[:, None], 9, axis=1))


def measurement_equations(path: FlightPath, log: Log) -> Equations:
    """Return predicted - measured airspeed, alpha, beta, GPS velocity, and attitude (rotation about NED axes).

    A sensor with a lag is compared with its value m samples later. Over the rest of the lag, less than a step, the
    prediction is continued by its rate of change.
    """
    n = len(log.time)
    later, offset = _lagged_rows(log, path.constant(*LAGS))
    scale = 1 + path.constant("airspeed_scale", "alpha_scale", "beta_scale")
    bias = np.array([0.0, *path.constant("alpha_bias", "beta_bias")])
    acceleration, turning = path.attitude.apply(path.force(log)) + GRAVITY, path.attitude.apply(path.rate(log))
    rates = np.concatenate([scale * air_data_rates(path, log), acceleration, turning], axis=1)
    residual, d_state, d_constants = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, 9, len(CONSTANTS)))

    air = air_data_equations(path)
    residual[:, :3] = scale * air.residual + bias - np.take_along_axis(log.air, later[:, :3], axis=0)
    residual[air.residual[:, 0] < MIN_AIRSPEED, 1:3] = np.nan
    d_state[:, :3] = scale[:, None] * air.d_state
    d_constants[:, :3] = scale[:, None] * air.d_constants
    for row, name in enumerate(AIR_DATA):
        d_constants[:, row, PLACE[f"{name}_scale"]] = air.residual[:, row]
    d_constants[:, 1, PLACE["alpha_bias"]] = d_constants[:, 2, PLACE["beta_bias"]] = 1.0

    residual[:, 3:6] = path.velocity - np.take_along_axis(log.velocity, later[:, 3:6], axis=0)
    d_state[:, 3:6, VELOCITY] = np.eye(3)
    angle = (path.attitude * log.attitude[later[:, 6]].inv()).as_rotvec()
    residual[:, 6:9] = angle
    residual[~log.attitude_sampled[later[:, 6]], 6:9] = np.nan
    d_state[:, 6:9, ATTITUDE] = _log_gradient(-angle) @ path.attitude.as_matrix()

    residual += offset * rates
    for row, name in enumerate(LAGS):
        d_constants[:, row, PLACE[name]] = -rates[:, row]
    return _without(Equations(residual, d_state, None, d_constants), np.isnan(residual))


def _lagged_rows(log: Log, lag: Vector) -> tuple[Indices, Matrix]:
    """Return the row of the log for each measurement, (n, 9), and its offset in time, NaN where there is none."""
    later = np.arange(len(log.time))[:, None] + np.array(log.delays)
    inside = np.clip(later, 0, len(log.time) - 1)
    offset = log.time[inside] - log.time[:, None] - lag
    return inside, np.where((inside == later) & (log.segment[inside] == log.segment[:, None]), offset, np.nan)


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
