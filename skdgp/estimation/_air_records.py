r"""Records of the filter-error method: gap-free samples of a flight, its path over the ground, and its inputs.

Biases of the inertial sensors and lags of GPS and attitude are taken out by the path, which needs no
aerodynamics. Surfaces follow their commands by servos of first order; an autopilot moves them in answer to
gusts.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.linalg import least_squares, matrix_vector
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import AIR_DATA
from skdgp._flight.holds import error_between_samples, interpolated_rows
from skdgp._flight.tables import interpolate_missing, numeric
from skdgp.estimation._air_model import Inputs
from skdgp.estimation._path import PathEstimate
from skdgp.estimation._sensors import (
    AIRSPEED,
    INERTIAL_READINGS,
    RATE_READINGS,
    NamedFlight,
    flights_of,
    third_differences,
)
from skdgp.estimation._vibration import vibration_covariance, without_vibration

SAMPLED = ("rows", "time", "velocity", "attitude", "measured", "force", "surface_errors", "answers")
"""Arrays of a record with a row for each sample."""
FEWEST_SAMPLES = 100
"""Samples of a shortest record of flights to learn from."""


class Record(NamedTuple):
    """n samples of a flight without a gap, and its path over the ground."""

    flight: int
    rows: Indices  # (n,) of the table
    time: Vector  # (n,) [s]
    velocity: Matrix  # (n, 3) over the ground, body axes [m/s]
    attitude: Array  # (n, 3, 3) NED to body
    measured: Matrix  # (n, 9) of the sensors, without biases of the path; NaN where not sampled
    force: Matrix  # (n, 3) specific force at the centre of gravity, by measured rates [m/s^2]
    position: Vector  # (3,) of the inertial sensors, zero if unknown [m]
    surface_errors: Matrix  # (n, k) size between samples of a slow clock, zero at these [rad]
    inputs: Inputs  # as logged
    vibration: Matrix  # (6, 6) covariance of what all inertial sensors share and is no motion [SI]
    answers: Matrix  # (n, k + 1) part of surfaces and thrust that answers gusts (autopilot)

    def part(self, rows: slice) -> Record:
        """Return some samples."""
        whole = self._asdict()
        of_rows = {name: whole[name][rows] for name in SAMPLED}
        return self._replace(inputs=self.inputs.part(rows), **of_rows)

    def with_axial_force(self, mass: float) -> Record:
        """Return the record with the measured axial force in place of thrust and CX."""
        measured = self.measured.copy()
        thrust = self.inputs.thrust.copy()
        thrust[:, 0] = mass * self.force[:, 0]
        measured[:, 0] = np.nan
        return self._replace(measured=measured, inputs=self.inputs._replace(thrust=thrust))

    def with_answers(self, innovation: Matrix) -> Record:
        """Return the record with the part of surfaces and thrust that innovations (n - 1, m) explain.

        By least squares on sums of the innovations over bins of the past, wider the earlier. Other
        motion of a surface is a first-order process of the surface's own correlation (Cochrane &
        Orcutt 1949): inputs hold their values for a while.
        """
        inputs = np.column_stack([self.inputs.surfaces, self.inputs.thrust[:, 0]])
        inputs -= inputs.mean(axis=0)
        answers = np.empty_like(inputs)
        X = _sums_before(innovation, self.median_step)
        squares = X.T @ X
        # by the normal equations, as rows are many
        for k, surface in enumerate(inputs.T):
            residual = surface - X @ least_squares(squares, X.T @ surface)
            rho = (residual[1:] @ residual[:-1]) / max(residual @ residual, np.finfo(float).tiny)
            X_rest = X[1:] - rho * X[:-1]
            whitened = surface[1:] - rho * surface[:-1]
            answers[:, k] = X @ least_squares(X_rest.T @ X_rest, X_rest.T @ whitened)
        return self._replace(answers=answers)

    def earth_velocity(self) -> Matrix:
        """Return the velocity over the ground north, east, down (n, 3)."""
        return matrix_vector(self.attitude.mT, self.velocity)

    @property
    def time_step(self) -> Vector:
        """Steps of the clock (n - 1,) [s]."""
        return np.diff(self.time)

    @property
    def rates(self) -> Matrix:
        """Measured rates (n, 3) [rad/s]."""
        return self.measured[:, RATE_READINGS]

    @property
    def airspeed(self) -> float:
        """Mean airspeed [m/s], over the ground where it is not measured."""
        measured = self.measured[:, AIRSPEED]
        if np.isfinite(measured).any():
            return float(np.nanmean(measured))
        return float(np.linalg.norm(self.velocity, axis=1).mean())

    @property
    def median_step(self) -> float:
        """Usual step [s]."""
        return np.median(self.time_step)

    @property
    def sampled(self) -> Mask:
        """Whether a sensor has any sample, (9,)."""
        return np.any(np.isfinite(self.measured[1:]), axis=0)


def _sums_before(innovation: Matrix, step: float) -> Matrix:
    """Return sums (n, bins m) of innovations (n - 1, m) over bins of the past of each sample.

    What comes later is the effect of a surface, and no cause of its motion.
    """
    n = len(innovation) + 1
    # longest delay of the surfaces' answers to gusts [s]
    longest = max(8.0 / step, 2.0)
    # bins of these delays in samples, wider the longer; many would explain inputs by chance
    edges = np.unique(np.geomspace(1, longest, 7).round().astype(int))
    # sums over bins are differences of the cumulative sum, with zeros before the record
    earlier = np.zeros((edges[-1] + 2, innovation.shape[1]))
    total = np.cumsum(np.concatenate([earlier, innovation]), axis=0)
    places = np.arange(n) + edges[-1] + 1
    sums = [total[places - near] - total[places - far] for near, far in pairwise(edges)]
    return np.concatenate(sums, axis=1)


def records_of(
    table: pd.DataFrame, surfaces: list[str], loads: Matrix, paths: Sequence[PathEstimate]
) -> list[Record]:
    """Return the records of a table with propulsive ``loads`` (n, 6).

    ``paths`` are those of its flights over the ground.
    """
    logged = np.hstack([numeric(table, surfaces), loads, numeric(table, ["density"])])
    air_data = table.reindex(columns=list(AIR_DATA)).to_numpy(float)
    records = []
    for number, (flight, path) in enumerate(zip(flights_of(table), paths, strict=True)):
        rows = flight.rows
        record = _whole_flight(number, flight, path, logged[rows], air_data[rows], len(surfaces))
        for segment in flight.sensors.segments():
            if len(segment) > 1:
                # at one to two times the sample rate, or at its own
                rate = (len(segment) - 1) / np.ptp(record.time[segment])
                # rate of samples [Hz]; faster logs are thinned to 50 to 100 Hz
                stride = max(1, int(rate / 50.0 + 1e-6))
                records.append(record.part(slice(segment[0], segment[-1] + 1, stride)))
    return records


def _whole_flight(
    number: int,
    flight: NamedFlight,
    estimate: PathEstimate,
    logged: Matrix,
    air_data: Matrix,
    n_surfaces: int,
) -> Record:
    """Return a flight with its gaps as one record, by its path without air data."""
    sensors = flight.sensors.without_air_data()
    path = estimate.path
    to_body = path.attitude.inv()
    force, rates = path.inertial(sensors)
    inertial = np.concatenate([force + sensors.lever_acceleration, rates], axis=1)
    rate = 1 / np.median(np.diff(sensors.time))
    vibration = vibration_covariance(inertial, estimate.off_path, rate)
    inputs = interpolate_missing(sensors.time, logged)
    surfaces = inputs[:, :n_surfaces]
    position = np.zeros(3)
    stated = sensors.position[np.isfinite(sensors.position).all(axis=1)]
    if len(stated):
        position = np.median(stated, axis=0)
    return Record(
        flight=number,
        rows=flight.rows,
        time=sensors.time,
        velocity=to_body.apply(path.velocity),
        attitude=to_body.as_matrix(),
        measured=np.column_stack([inertial, air_data]),
        force=force,
        position=position,
        surface_errors=_errors_between_samples(sensors.time, surfaces),
        inputs=Inputs(surfaces, inputs[:, n_surfaces:-1], inputs[:, -1]),
        vibration=vibration,
        answers=np.zeros((len(inputs), n_surfaces + 1)),
    )


def _errors_between_samples(time: Vector, surfaces: Matrix) -> Matrix:
    """Return errors (n, k) of surfaces between the samples of slow clocks, zero of others."""
    errors = np.zeros_like(surfaces)
    for k, surface in enumerate(surfaces.T):
        samples = interpolated_rows(time, surface)
        if samples is not None:
            errors[:, k] = error_between_samples(time, surface, samples)
    return errors


def n_samples(records: list[Record]) -> int:
    """Return the number of samples of records."""
    return sum(len(record.rows) for record in records)


def shortened(records: list[Record], most_samples: int) -> list[Record]:
    """Return the first part of each record, ``most_samples`` together."""
    fraction = most_samples / n_samples(records)
    shorter = []
    for record in records:
        n = max(FEWEST_SAMPLES, int(fraction * len(record.rows)))
        shorter.append(record.part(slice(n)))
    return shorter


def quietest_noise(records: list[Record], sensors: slice) -> float:
    """Return the standard deviation of white noise of the quietest of some sensors.

    Gusts shake one axis more than another; all have the same sensor.
    """
    noises = []
    for record in records:
        measured = record.measured[:, INERTIAL_READINGS]
        if record.vibration.any():
            # the axial force may stand in place of CX
            of_path = np.concatenate([record.force, record.rates], axis=1)
            complete = np.where(np.isnan(measured), of_path, measured)
            measured = without_vibration(complete, record.vibration)
        noises.append(third_differences(measured[:, sensors]))
    variances = np.mean(np.concatenate(noises) ** 2, axis=0)
    # at least 1e-4 [SI]
    return max(np.sqrt(np.nanmin(variances)), 1e-4)
