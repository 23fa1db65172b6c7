"""Signals of the checks: channels of flights at one rate, their changes and integrals over windows; the settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, ELEVONS, EULER, POSITION, by_elevons
from skdgp._flight.clock import median_step, n_rows
from skdgp._flight.faults import dead_channels, on_ground
from skdgp._flight.frames import euler_to_matrix
from skdgp._flight.holds import CONTROL_GROUPS, SENSOR_GROUPS, without_repeats
from skdgp._flight.sensor_position import at_centre_of_gravity
from skdgp._flight.tables import FlightTable


@dataclass(frozen=True)
class PhysicsSettings:
    """Settings of the checks of physics."""

    # rows are averaged to about this rate [Hz], above the frequencies of flight dynamics
    rate: float = 20.0
    # window of kinematics [s], longer than the usual lags
    kinematic_window: float = 1.0
    # window of forces and moments [s], shorter than the time constant of roll
    response_window: float = 0.1
    # larger angles [rad] are in degrees
    largest_radians: float = 2.1 * np.pi
    # flights shorter than this [s] are judged together with others only
    long_flight: float = 30.0

    # fewer rows, or fewer effective samples, decide nothing
    least_rows: int = 40
    least_samples: float = 10.0
    # least distance of a slope from its admissible interval, in standard deviations
    least_t: float = 5.0

    # largest mean of the unit vectors ahead in flights that turn: one heading has 1, a circle 0 (guess)
    most_ahead: float = 0.8

    # equalities: least t of the reverse slope, which tells noise of x from a wrong scale, and its
    # largest standard deviation that tells anything (guesses)
    reverse_t: float = 1.5
    reverse_std: float = 0.5
    # a longer lag [s] is a contradiction: LagCorrector corrects 0.3 s, holds of slow GPS add to it
    usual_lag: float = 0.5
    # the same of the airspeed [s], and its least t: gusts reach it before the aircraft follows, which
    # makes lags up to 1.0 s (25 simulated flights); beyond, none had a t above zero, and 2 s had 3.7
    # to 10
    usual_airspeed_lag: float = 1.0
    least_airspeed_t: float = 4.0
    # the same of vanes against the motion: gusts lead it (54 simulated flights)
    usual_vane_lag: float = 0.15
    least_vane_t: float = 10.0
    # a response is earlier than its surface by no more than this [s], where filters of recorders differ; the
    # largest t beyond was 5.5 in 64 sound flights, and surfaces late by 0.3 s had 10 and more: set on the
    # flights that judge it
    usual_lead: float = 0.15
    least_lead_t: float = 10.0
    # contradictions from which on a mistake of several channels at once is looked for
    several: int = 3
    # least correlation at a lag that is a contradiction, whatever the slope, and of a wrong clock (guess)
    lagged_correlation: float = 0.5

    # largest factor of a wrong clock (guess)
    clock_factor: float = 3.0

    # least ratio of explained to unexplained variance of a copy: rounding and means of samples remain (guess)
    copied: float = 1e6
    # least part of the wind across the heading in the airspeed that tells it from the speed over the ground (guess)
    least_drift: float = 0.05

    # a surface that stands still: largest step [rad], least seconds, and least residual of its response over that
    # in other rows: 1.1 at most in 30 sound flights, 2.1 to 7 where it is stuck, 1.7 to 2.5 where it is clipped
    still: float = 1e-9
    still_window: float = 0.5
    still_ratio: float = 2.0
    # and largest spread of an effect in these rows over that in other rows, where it is learned: 2.4 where a
    # surface is stuck, 20 or more where surfaces move one after another
    still_spread: float = 5.0

    # scale of vanes: least ratio of explained to unexplained variance of a contradiction, a correlation of 0.9,
    # and its least t (guess)
    smooth: float = 4.3
    least_scale_t: float = 4.0

    # signs and exchanges: least partial correlation; feedback, lags and gusts cause weaker ones
    least_correlation: float = 0.3
    # a lag is possible if the ratio of explained to unexplained variance is this fraction of the best
    possible_lag: float = 1 / 3
    # the same of lags from zero where the angle that a surface turns the aircraft to was not measured
    possible_lag_without_angle: float = 1 / 8


PHYSICS = PhysicsSettings()
# Lags that are tried [s], positive where y is late against x
KINEMATIC_LAGS = (0.0, -1.0, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 1.0)
# further ones of the airspeed, which gusts reach before the aircraft follows
AIRSPEED_LAGS = (-1.4, 1.4, -1.8, 1.8, -2.2, 2.2, -2.6, 2.6, -3.0, 3.0)
VANE_LAGS = (0.0, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
# of surfaces, whose servos are late
SURFACE_LAGS = (0.0, -0.1, -0.05, 0.05, 0.1, 0.15, -0.2, -0.3, -0.4, -0.5)
GROUPS = (*CONTROL_GROUPS, *SENSOR_GROUPS, POSITION, ("altitude",))
"""Channels that may repeat samples, by their clock."""


@dataclass(frozen=True)
class Signals:
    """Channels of flights at one rate, and the segment of each row. A missing value is NaN."""

    channels: dict[str, Vector]
    segment: Indices
    step: float  # [s]
    rate: float = np.nan  # rows of the flights [Hz]

    def __getitem__(self, name: str) -> Vector:
        return self.channels[name]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def rotation(self) -> Array:
        """Rotation matrices from body to earth axes (n, 3, 3)."""
        return euler_to_matrix(self["phi"], self["theta"], self["psi"])

    def exchanged(self, first: str, second: str) -> Signals:
        """Return the signals with two channels exchanged."""
        changed = {first: self[second], second: self[first]}
        return replace(self, channels=self.channels | changed)

    def vector(self, names: tuple[str, ...]) -> Matrix:
        """Return channels as vectors (n, k)."""
        return np.column_stack([self[name] for name in names])

    def window_rows(self, seconds: float) -> int:
        """Return the steps of a window, at least one."""
        return max(round(seconds / self.step), 1)

    def change(self, values: Array, seconds: float = PHYSICS.kinematic_window) -> Array:
        """Return the changes of values (n, ...) over windows that begin at each row, NaN at a segment's end."""
        length = self.window_rows(seconds)
        is_inside = self.segment[length:] == self.segment[:-length]
        difference = values[length:] - values[:-length]
        change = np.full(values.shape, np.nan)
        change[:-length][is_inside] = difference[is_inside]
        return change

    def integral(self, values: Array, seconds: float = PHYSICS.kinematic_window) -> Array:
        """Return the integrals over these windows by the trapezoidal rule, NaN where a value is missing."""
        is_missing = ~np.isfinite(values)
        filled = np.where(is_missing, 0.0, values)
        total = np.cumsum(filled, axis=0) - filled / 2
        integral = self.step * self.change(total, seconds)
        n_missing = self.change(np.cumsum(is_missing, axis=0, dtype=float), seconds)
        integral[is_missing | (n_missing > 0)] = np.nan
        return integral

    def ahead(self, values: Vector, seconds: float) -> Vector:
        """Return the value of each row ``seconds`` later, NaN beyond its segment."""
        rows = np.arange(len(values))
        place = rows + seconds / self.step
        ahead = np.interp(place, rows, values, left=np.nan, right=np.nan)
        for end in (np.floor(place), np.ceil(place)):
            row = np.clip(end, 0, len(rows) - 1).astype(int)
            is_outside = self.segment[row] != self.segment
            ahead[is_outside] = np.nan
        return ahead


def signals_of(flights: FlightTable, names: Iterable[str]) -> Signals:
    """Return channels of flights at about ``PHYSICS.rate``, without the rows on the ground.

    The specific force is that at the centre of gravity, where the position of the sensors is known. Dead sensors
    count as not there. With elevons, elevator and aileron follow from them.
    """
    living = flights.table.drop(columns=dead_channels(flights))
    flights = replace(flights, table=at_centre_of_gravity(living))
    time = flights.time
    segments = [rows for rows in flights.segments if n_rows(rows) > 1]
    if not segments:
        return Signals({}, np.empty(0, int), 1.0)
    usual_step = median_step(time, segments)
    n_averaged = max(1, int(1 / usual_step // PHYSICS.rate))
    step = usual_step * n_averaged
    clocks = [_block_clock(time[rows], step) for rows in segments]
    lengths = [len(clock) for clock in clocks]
    measured = replace(flights, table=without_repeats(flights.table, GROUPS))
    columns = measured.numeric_channels(names)
    columns["ground"] = on_ground(flights).astype(float)
    channels = {}
    for name, values in columns.items():
        parts = []
        for rows, clock in zip(segments, clocks, strict=True):
            parts.append(_averaged(name, time[rows], values[rows], clock))
        channel = np.concatenate(parts)
        # a surface that never moves has no effect
        sampled = values[np.isfinite(values)]
        is_still = name in ALL_SURFACES and (sampled == sampled[:1]).all()
        if np.isfinite(channel).any() and not is_still:
            channels[name] = channel
    is_on_ground = channels.pop("ground") > 0
    if {*ELEVONS} <= channels.keys():
        channels |= by_elevons(channels)
    channels = {name: np.where(is_on_ground, np.nan, values) for name, values in channels.items()}
    segment = np.repeat(np.arange(len(segments)), lengths)
    return Signals(channels, segment, step, 1 / usual_step)


def _block_clock(time: Vector, step: float) -> Matrix:
    """Return the times of whole blocks (n, k) of ``step`` [s], with the k samples of the segment's own rate."""
    n_samples = round(step / np.median(np.diff(time)))
    size = max(1, n_samples)
    spacing = step / size
    # the tolerance is of rounded clocks
    n = 1 + int(np.ptp(time) / spacing + 1e-3)
    n_blocks = n // size
    points = time[0] + spacing * np.arange(n_blocks * size)
    return np.minimum(points, time[-1]).reshape(-1, size)


def _averaged(name: str, time: Vector, values: Vector, clock: Matrix) -> Vector:
    """Return means over the blocks of a clock (n, k) of a channel, linear between its samples; NaN without samples."""
    is_sample = np.isfinite(values)
    samples = values[is_sample]
    if not samples.size:
        return np.full(len(clock), np.nan)
    if name in EULER:
        is_degrees = np.abs(samples).max() > PHYSICS.largest_radians
        samples = np.unwrap(samples, period=360.0 if is_degrees else 2 * np.pi)
    sampled = np.interp(clock, time[is_sample], samples, left=np.nan, right=np.nan)
    return sampled.mean(axis=1)
