"""Kinematic equations that relate inertial sensors, air data, attitude and GPS velocity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skdgp._flight.frames import air_data, air_data_slopes, cross_matrix
from skdgp.preprocessing._reconstruction.bordered import Rows

Floats = NDArray[np.float64]

VELOCITY, ATTITUDE, GUST = slice(0, 3), slice(3, 6), slice(6, 9)
"""Places in the vector of a state's errors: NED velocity, rotation vector in body axes, NED gust."""

INERTIAL = {
    **dict.fromkeys(("ax_bias", "ay_bias", "az_bias"), 0.3),
    **dict.fromkeys(("p_bias", "q_bias", "r_bias"), 0.02),
}
SENSORS = {
    "airspeed_scale": 0.1,
    "alpha_bias": 0.03,
    "alpha_scale": 0.2,
    "beta_bias": 0.03,
    "beta_scale": 0.2,
    **dict.fromkeys(("airspeed_lag", "vane_lag", "velocity_lag", "attitude_lag"), 0.1),
}
WIND = dict.fromkeys(("wind_north", "wind_east"), 30.0)
CONSTANTS = INERTIAL | SENSORS | WIND
"""Constants of a flight, and how large they may be beforehand (standard deviation, SI). Measured is truth + bias,
(1 + scale) truth + bias, or truth a lag [s] ago; wind_north and wind_east are the mean wind."""
PLACE = {name: place for place, name in enumerate(CONSTANTS)}
LAGS = ("airspeed_lag", "vane_lag", "vane_lag", *["velocity_lag"] * 3, *["attitude_lag"] * 3)
"""The lag of each of the nine looks."""
SLOWEST = 3.0
"""Airspeed [m/s] below which vanes hang still."""


class Log(NamedTuple):
    """One flight's sensors, n samples."""

    time: Floats
    """(n,) [s]"""
    stretch: NDArray[np.int_]
    """(n,) number of the gap-free stretch that a sample belongs to."""
    force: Floats
    """(n, 3) accelerometers [m/s^2]"""
    rate: Floats
    """(n, 3) gyros [rad/s]"""
    air: Floats
    """(n, 3) airspeed [m/s], alpha, beta [rad]; NaN where not sampled"""
    velocity: Floats
    """(n, 3) GPS velocity, NED [m/s]; NaN where not sampled"""
    attitude: Rotation
    """n attitudes, body to NED"""
    attitude_seen: NDArray[np.bool_]
    """(n,) where the attitude was sampled"""
    gravity: float
    """[m/s^2]"""
    late: tuple[int, ...] = (0,) * 9
    """By how many samples each look comes too late, roughly; the rest of the lag is continued by its rate of change."""

    def part(self, first, last) -> Log:
        """Return the samples from first to before last."""
        return Log(*(values[first:last] for values in self[:-2]), *self[-2:])

    @property
    def joined(self):
        """Whether a sample and the next belong to one stretch, (n - 1,)."""
        return self.stretch[1:] == self.stretch[:-1]


class Path(NamedTuple):
    """Where the flight is thought to have gone: a state for every sample, and the constants of the flight."""

    velocity: Floats
    """(n, 3) over the ground, NED [m/s]"""
    attitude: Rotation
    """n attitudes, body to NED"""
    gust: Floats
    """(n, 3) departure of the air's velocity from the mean wind, NED [m/s]"""
    constants: Floats
    """(c,) in the order of CONSTANTS"""

    def part(self, first, last) -> Path:
        """Return the states from first to before last."""
        return Path(*(values[first:last] for values in self[:-1]), self.constants)

    def moved(self, states, constants) -> Path:
        """Return the path with errors (n, 9), (c,) added."""
        turned = self.attitude * Rotation.from_rotvec(states[:, ATTITUDE])
        velocity, gust = self.velocity + states[:, VELOCITY], self.gust + states[:, GUST]
        return Path(velocity, turned, gust, self.constants + constants)

    def of(self, *names) -> Floats:
        """Return constants by name."""
        return self.constants[[PLACE[name] for name in names]]

    def wind(self) -> Floats:
        """Return the air's velocity (n, 3), NED [m/s]."""
        return self.gust + np.append(self.of(*WIND), 0.0)

    def air_velocity(self) -> Floats:
        """Return the velocity relative to the air (n, 3), body axes [m/s]."""
        return self.attitude.inv().apply(self.velocity - self.wind())

    def force(self, log) -> Floats:
        """Return the specific force (n, 3), body axes, without the sensors' bias."""
        return log.force - self.of("ax_bias", "ay_bias", "az_bias")

    def rate(self, log) -> Floats:
        """Return the angular rate (n, 3), body axes, without the sensors' bias."""
        return log.rate - self.of("p_bias", "q_bias", "r_bias")


def air_data_rates(path: Path, log: Log) -> Floats:
    """Return the rates of change of airspeed, alpha, beta (n, 3) in air that keeps its velocity.

    With v the velocity through the air in body axes, v' = f - omega x v + R^T g. The gusts' own rates of change, white
    noise to this model, are left out.
    """
    velocity = path.air_velocity()
    acceleration = path.force(log) + path.attitude.inv().apply(_gravity(log)) - np.cross(path.rate(log), velocity)
    return np.einsum("nij,nj->ni", air_data_slopes(velocity, SLOWEST), acceleration)


def air_data_rows(path: Path) -> Rows:
    """Return airspeed, alpha, beta themselves as rows: their values, and how they change with path and mean wind."""
    velocity, R = path.air_velocity(), path.attitude.as_matrix()
    slopes = air_data_slopes(velocity, SLOWEST)
    toward = slopes @ R.swapaxes(1, 2)
    here = np.concatenate([toward, slopes @ cross_matrix(velocity), -toward], axis=2)
    shared = np.zeros((len(R), 3, len(CONSTANTS)))
    shared[:, :, [PLACE[name] for name in WIND]] = -toward[:, :, :2]
    return Rows(np.column_stack(air_data(velocity)), here, None, shared)


def ties(path: Path, log: Log, correlation: Floats) -> Rows:
    """Return what ties a sample to the next: specific force, angular rate, and change of gust, predicted - measured."""
    n = len(log.time) - 1
    rows = Rows(np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, 9, 9)), np.zeros((n, 9, len(CONSTANTS))))
    turn = path.attitude[:-1].inv() * path.attitude[1:]
    _tie_velocity(rows, path, log, turn.as_matrix())
    _tie_attitude(rows, path, log, turn)
    rows.residual[:, GUST] = path.gust[1:] - correlation[:, None] * path.gust[:-1]
    rows.here[:, GUST, GUST] = -correlation[:, None, None] * np.eye(3)
    rows.after[:, GUST, GUST] = np.eye(3)
    return _without(rows, np.broadcast_to(~log.joined[:, None], (n, 9)))


def _tie_velocity(rows, path, log, turned):
    """R_k^T ((v_{k+1} - v_k) / h - g - (R_k f_k + R_{k+1} f_{k+1}) / 2) over a step of h seconds."""
    step = np.diff(log.time)[:, None]
    back = path.attitude[:-1].inv()
    force = path.force(log)
    pushed = path.attitude.apply(force)
    gained = np.diff(path.velocity, axis=0) / step - _gravity(log) - (pushed[:-1] + pushed[1:]) / 2
    rows.residual[:, VELOCITY] = back.apply(gained)
    rows.after[:, VELOCITY, VELOCITY] = back.as_matrix() / step[..., None]
    rows.here[:, VELOCITY, VELOCITY] = -rows.after[:, VELOCITY, VELOCITY]
    rows.after[:, VELOCITY, ATTITUDE] = turned @ cross_matrix(force[1:]) / 2
    rows.here[:, VELOCITY, ATTITUDE] = cross_matrix(rows.residual[:, VELOCITY] + force[:-1] / 2)
    rows.shared[:, VELOCITY, PLACE["ax_bias"] : PLACE["az_bias"] + 1] = (np.eye(3) + turned) / 2


def _tie_attitude(rows, path, log, turn):
    """Log(R_k^T R_{k+1}) / h - (omega_k + omega_{k+1}) / 2 - (h / 12) omega_k x omega_{k+1}."""
    step = np.diff(log.time)[:, None]
    rate = path.rate(log)
    angle = turn.as_rotvec()
    coning = np.cross(rate[:-1], rate[1:]) * step / 12
    rows.residual[:, ATTITUDE] = angle / step - (rate[:-1] + rate[1:]) / 2 - coning
    bend = _slope_of_log(angle)
    rows.after[:, ATTITUDE, ATTITUDE] = bend / step[..., None]
    rows.here[:, ATTITUDE, ATTITUDE] = -bend @ turn.inv().as_matrix() / step[..., None]
    rows.shared[:, ATTITUDE, PLACE["p_bias"] : PLACE["r_bias"] + 1] = np.eye(3)


def looks(path: Path, log: Log) -> Rows:
    """Return predicted minus measured airspeed, alpha, beta, GPS velocity, and attitude (rotation about NED axes).

    A sensor that lags is compared, m samples later, with what it saw then: prediction and measurement are less than a
    step apart, over which the prediction is continued by its rate of change.
    """
    n = len(log.time)
    lag = path.of(*LAGS)
    later, apart = _lagging(log, lag)
    scale = np.array([1 + path.of(f"{name}_scale")[0] for name in ("airspeed", "alpha", "beta")])
    bias = np.array([0.0, *path.of("alpha_bias", "beta_bias")])
    rates = _rates(path, log, scale)
    residual, here, shared = np.zeros((n, 9)), np.zeros((n, 9, 9)), np.zeros((n, 9, len(CONSTANTS)))

    air = air_data_rows(path)
    residual[:, :3] = scale * air.residual + bias - np.take_along_axis(log.air, later[:, :3], axis=0)
    residual[air.residual[:, 0] < SLOWEST, 1:3] = np.nan
    here[:, :3] = scale[:, None] * air.here
    shared[:, :3] = scale[:, None] * air.shared
    for row, name in enumerate(("airspeed", "alpha", "beta")):
        shared[:, row, PLACE[f"{name}_scale"]] = air.residual[:, row]
    shared[:, 1, PLACE["alpha_bias"]] = shared[:, 2, PLACE["beta_bias"]] = 1.0

    residual[:, 3:6] = path.velocity - np.take_along_axis(log.velocity, later[:, 3:6], axis=0)
    here[:, 3:6, VELOCITY] = np.eye(3)
    angle = (path.attitude * log.attitude[later[:, 6]].inv()).as_rotvec()
    residual[:, 6:9] = angle
    residual[~log.attitude_seen[later[:, 6]], 6:9] = np.nan
    here[:, 6:9, ATTITUDE] = _slope_of_log(-angle) @ path.attitude.as_matrix()

    residual += apart * rates
    for row, name in enumerate(LAGS):
        shared[:, row, PLACE[name]] = -rates[:, row]
    return _without(Rows(residual, here, None, shared), np.isnan(residual))


def _lagging(log, lag):
    """Return the row of the log (n, 9) that each look is compared with, and how far off it is in time (NaN: none)."""
    row = np.arange(len(log.time))[:, None]
    later = row + np.array(log.late)
    inside = np.clip(later, 0, len(log.time) - 1)
    apart = log.time[inside] - log.time[:, None] - lag
    return inside, np.where((inside == later) & (log.stretch[inside] == log.stretch[:, None]), apart, np.nan)


def _rates(path, log, scale):
    """Return how fast the nine looks change, (n, 9)."""
    R = path.attitude
    velocity = R.apply(path.force(log)) + _gravity(log)
    return np.concatenate([scale * air_data_rates(path, log), velocity, R.apply(path.rate(log))], axis=1)


def _slope_of_log(angle):
    """Return the derivative of Log(exp(angle) exp(x)) by x at 0, to second order in the angle: (n, 3, 3)."""
    half = cross_matrix(angle) / 2
    return np.eye(3) + half + half @ half / 3


def _gravity(log):
    return np.array([0.0, 0.0, log.gravity])


def _without(rows, missing):
    """Return the rows with the missing ones saying nothing."""
    for values in rows:
        if values is not None:
            values[missing] = 0.0
    return rows
