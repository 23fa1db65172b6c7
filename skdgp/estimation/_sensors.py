r"""Sensors of a flight, and the one model of their biases, lags and noises for path and air.

A reading of the nine sensors ax, ay, az, p, q, r, airspeed, alpha, beta is

.. math:: y = s \, h(x) + b + v,

with the true value h(x), scale s (of the airspeed alone), constant bias b and white noise v. GPS
velocity and attitude are late by a constant lag.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE
from skdgp._flight.clock import n_rows
from skdgp._flight.frames import euler_to_rotation
from skdgp._flight.holds import SENSOR_GROUPS, without_repeats
from skdgp._flight.sensor_position import sensor_acceleration
from skdgp._flight.tables import (
    FlightTable,
    has_values,
    interpolate_missing,
    numeric,
    sensor_position,
    unwrapped,
)

SENSORS = (*SPECIFIC_FORCE, *RATES, *AIR_DATA)
FORCE_READINGS = slice(0, 3)
RATE_READINGS = slice(3, 6)
INERTIAL_READINGS = slice(0, 6)
AIR_READINGS = slice(6, 9)
AIRSPEED = SENSORS.index("airspeed")
"""Places of specific force, rates, both, air data and airspeed among the sensors."""
READINGS_OF = {
    "gyro": RATE_READINGS,
    "accelerometer": FORCE_READINGS,
    **{name: slice(AIRSPEED + k, AIRSPEED + k + 1) for k, name in enumerate(AIR_DATA)},
}
"""Readings of each sensor."""
PATH_CHANNELS = (*RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, "airspeed")
"""Channels that a path needs; alpha and beta are optional."""

WIND_STD = 30.0  # m/s, of the steady horizontal wind; wide
INERTIAL_BIASES = dict.fromkeys(("ax_bias", "ay_bias", "az_bias"), 0.3) | dict.fromkeys(
    ("p_bias", "q_bias", "r_bias"), 0.02
)
"""Prior standard deviations of the biases [m/s^2, rad/s], guesses."""
LAGS = {"velocity_lag": 0.1, "attitude_lag": 0.1}
"""Prior standard deviations of the lags of GPS velocity and attitude [s], guesses."""
MEAN_WIND = dict.fromkeys(("wind_north", "wind_east"), WIND_STD)
PATH_CONSTANTS = INERTIAL_BIASES | LAGS | MEAN_WIND
"""Prior standard deviations of all constants of a path; prior means are zero."""

Prior = dict[str, tuple[float, float]]
"""Mean and standard deviation by name; of noises the median, and that of the logarithm."""

AIR_SENSOR_ERRORS: Prior = {
    "airspeed_scale": (0.0, 0.03),  # guess
    "arm_x": (0.0, 0.03),  # inertial sensors from their position in the table, or from the CG [m]
    "arm_y": (0.0, 0.01),
    "arm_z": (0.0, 0.03),
    "alpha_bias": (0.0, 0.02),  # of vanes [rad]
    "beta_bias": (0.0, 0.02),
}
"""Errors of sensors that all flights of an aircraft share."""
KNOWN_ARM: Prior = {"arm_x": (0.0, 0.01), "arm_y": (0.0, 0.005), "arm_z": (0.0, 0.01)}
"""Error of a known position of the inertial sensors [m]: the centre of gravity is balanced to about 1 cm."""
RATE_BIASES: Prior = {
    "p_bias": (0.0, 0.003),  # left over by the path [rad/s]
    "q_bias": (0.0, 0.003),
    "r_bias": (0.0, 0.003),
}
"""Errors of sensors of one flight, after its path."""
BIASED = {f"{name}_bias": place for place, name in enumerate(SENSORS)}
"""Place of each bias among the sensors."""

PATH_NOISE = {
    "accelerometer": 0.05,
    "gyro": 0.003,
    "airspeed": 0.5,
    "alpha": 0.01,
    "beta": 0.01,
    "v_horizontal": 0.2,
    "v_down": 0.2,
    "tilt": 0.01,
    "heading": 0.02,
}
"""Initial white noise of the sensors, standard deviation of a sample [SI]; data sheets."""
GUST_TIME = 10.0
"""Correlation time of gusts [s]; guess, docs/preprocessing.md."""
GUSTS = {"gust_horizontal": 0.2, "gust_vertical": 0.2}
"""Initial standard deviation of a change of the gusts in 1 s [m/s]."""
AIR_NOISE: Prior = {
    "ax": (0.1, 0.3),  # sensors, with effects that the model lacks; medians follow the flight
    "ay": (0.1, 0.3),
    "az": (0.1, 0.3),
    "gyro": (0.005, 0.3),
    "airspeed": (0.3, 0.5),
    "vane": (0.01, 1.0),
}
"""Priors of the noises of the sensors in `estimate_air_motion` [SI]."""


class SensorErrors(NamedTuple):
    """Scale and bias of the nine sensors."""

    scale: Vector  # (9,)
    bias: Vector  # (9,)

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> SensorErrors:
        """Return the errors of constants by name; others are absent."""
        scale = np.ones(len(SENSORS))
        scale[AIRSPEED] += value.get("airspeed_scale", 0.0)
        bias = np.array([value.get(name, 0.0) for name in BIASED])
        return cls(scale, bias)

    def readings(self, truth: Array) -> Array:
        """Return the readings (..., 9) of true values."""
        return self.scale * truth + self.bias

    def truth(self, readings: Array) -> Array:
        """Return the true values (..., 9) of readings."""
        return (readings - self.bias) / self.scale


class FlightSensors(NamedTuple):
    """Sensors of one flight, n samples."""

    time: Vector  # (n,) [s]
    segment: Indices  # (n,) number of the gap-free segment of a sample
    readings: Matrix  # (n, 9) of `SENSORS`, SI, forces at the CG; air data NaN where not sampled
    velocity: Matrix  # (n, 3) GPS velocity, NED [m/s]; NaN where not sampled
    attitude: Rotation  # n attitudes, body to NED
    attitude_sampled: Mask  # (n,) where the attitude was sampled
    position: Matrix  # (n, 3) of the inertial sensors [m], NaN where it is unknown
    lever_acceleration: Matrix  # (n, 3) of these relative to the CG, which the forces lack [m/s^2]

    def part(self, first: int, last: int) -> FlightSensors:
        """Return samples ``first`` to ``last`` - 1."""
        return FlightSensors._make(values[first:last] for values in self)

    def segments(self) -> list[Indices]:
        """Return the rows of each gap-free segment."""
        return [np.flatnonzero(self.segment == number) for number in np.unique(self.segment)]

    def without_air_data(self) -> FlightSensors:
        """Return the sensors without airspeed, alpha and beta."""
        readings = self.readings.copy()
        readings[:, AIR_READINGS] = np.nan
        return self._replace(readings=readings)

    @property
    def joined(self) -> Mask:
        """Whether a sample and the next are in one segment, (n - 1,)."""
        return self.segment[1:] == self.segment[:-1]


class NamedFlight(NamedTuple):
    """One flight of a table."""

    name: object
    rows: Indices  # (n,) of the table
    sensors: FlightSensors


def flights_of(table: pd.DataFrame) -> list[NamedFlight]:
    """Return name, rows and sensors of every flight in the table, SI units and radians.

    A sample that rows repeat counts once.

    Raise ValueError if time does not increase, or one of `PATH_CHANNELS` has no value in a flight.
    """
    checked = FlightTable.of(table)
    table = without_repeats(table, SENSOR_GROUPS)
    flights = []
    for name, runs in zip(checked.clock.names, checked.clock.segments_by_flight, strict=True):
        rows: Indices = np.r_[tuple(runs)]
        segment = np.repeat(np.arange(len(runs)), list(map(n_rows, runs)))
        sensors = _sensors_of(name, table.iloc[rows], checked.time[rows], segment)
        flights.append(NamedFlight(name, rows, sensors))
    return flights


def _sensors_of(name: object, table: pd.DataFrame, time: Vector, segment: Indices) -> FlightSensors:
    """Return the sensors of one flight; inertial sensors and attitude are interpolated."""
    silent = [name for name in PATH_CHANNELS if not has_values(table, name)]
    if silent:
        raise ValueError(
            f"Got no value of {', '.join(silent)} in flight {name!r}, but expected some: a path cannot be "
            "reconstructed without them. Leave the flight out, or smooth it with FlightSmoother."
        )
    angles = unwrapped(table, EULER)
    inertial = interpolate_missing(time, numeric(table, [*SPECIFIC_FORCE, *RATES]))
    lever_acceleration = sensor_acceleration(table)
    inertial[:, FORCE_READINGS] -= lever_acceleration
    air = numeric(table.reindex(columns=list(AIR_DATA)), AIR_DATA)
    return FlightSensors(
        time=time,
        segment=segment,
        readings=np.concatenate([inertial, air], axis=1),
        velocity=numeric(table, EARTH_VELOCITY),
        attitude=euler_to_rotation(interpolate_missing(time, angles)),
        attitude_sampled=np.all(np.isfinite(angles), axis=1),
        position=sensor_position(table),
        lever_acceleration=lever_acceleration,
    )


def missing_channels(table: pd.DataFrame) -> list[str]:
    """Return the channels needed by a path that are absent, or have no value in some flight."""
    flights = [table]
    if "flight" in table:
        flights = [flight for _, flight in table.groupby("flight", sort=False, observed=True)]
    silent = [name for name in PATH_CHANNELS if not all(has_values(t, name) for t in flights)]
    return silent if "time" in table else ["time", *silent]


def moving(table: pd.DataFrame, names: Iterable[str]) -> list[str]:
    """Return the names of channels that the table has and that move."""
    present = [name for name in names if has_values(table, name)]
    return [name for name in present if table[name].max() > table[name].min()]


def third_differences(values: Array) -> Array:
    """Return third differences (n - 3, ...) of readings, scaled to the variance of their white noise."""
    return np.diff(values, 3, axis=0) / np.sqrt(20)  # 1 + 9 + 9 + 1, squares of the coefficients


def noise_by_differences(flights: Sequence[FlightSensors], columns: slice) -> float:
    """Return the standard deviation of the white noise in some readings of all flights; NaN if unknown.

    Samples that are not finite are left out; differences do not cross gaps.
    """
    squares = []
    for sensors in flights:
        for column in sensors.readings.T[columns]:
            rows = np.flatnonzero(np.isfinite(column))
            joined = sensors.segment[rows[3:]] == sensors.segment[rows[:-3]]
            squares.append(third_differences(column[rows])[joined] ** 2)
    values = np.concatenate(squares)
    return float(np.sqrt(values.mean())) if len(values) else np.nan
