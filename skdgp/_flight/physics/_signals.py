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
    # of slower rows [Hz] no law is judged, as they miss motion between them: of 20 sound flights of small aircraft
    # all were accused at 1.0 and 1.5 Hz, 17 at 2.0, 11 at 2.5, 2 at 3.3, 1 at 4.2, none at 5.0 and 8.0
    slowest: float = 4.5
    # fewer rows, or fewer effective samples, decide nothing
    least_rows: int = 40
    least_samples: float = 10.0
    # least distance of a slope from its admissible interval, in standard deviations
    least_t: float = 5.0
    # signs and exchanges: least ratio of explained to unexplained variance, of a partial correlation of 0.3;
    # feedback, lags and gusts cause weaker ones
    least_explained: float = 0.1
    # least correlation at a lag that is a contradiction, whatever the slope, and of a wrong clock: sound sensors
    # far ahead of the centre of gravity have 0.50, channels that are late 0.66 and more
    clear_correlation: float = 0.6


PHYSICS = PhysicsSettings()
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
    segments = [rows for rows in flights.segments if n_rows(rows) > 1]
    if not segments:
        return Signals({}, np.empty(0, int), 1.0)
    living = at_centre_of_gravity(flights.table.drop(columns=dead_channels(flights)))
    measured = replace(flights, table=without_repeats(living, GROUPS))
    columns = measured.numeric_channels(names)
    columns["ground"] = on_ground(flights).astype(float)
    usual_step = median_step(flights.time, segments)
    step = usual_step * max(1, int(1 / usual_step // PHYSICS.rate))
    clocks = [_block_clock(flights.time[rows], step) for rows in segments]
    channels = {}
    for name, values in columns.items():
        parts = []
        for rows, clock in zip(segments, clocks, strict=True):
            parts.append(_averaged(name, flights.time[rows], values[rows], clock))
        channel = np.concatenate(parts)
        is_measured = np.isfinite(channel)
        # a surface that never moves but for rounding has no effect
        if is_measured.any() and (name not in ALL_SURFACES or np.ptp(channel[is_measured]) > 1e-6):
            channels[name] = channel
    if {*ELEVONS} <= channels.keys():
        channels |= by_elevons(channels)
    flies = channels.pop("ground", np.empty(0)) == 0
    channels = {name: np.where(flies, values, np.nan) for name, values in channels.items()}
    segment = np.repeat(np.arange(len(segments)), [len(clock) for clock in clocks])
    return Signals(channels, segment, step, 1 / usual_step)


def _block_clock(time: Vector, step: float) -> Matrix:
    """Return the times of whole blocks (n, k) of ``step`` [s], with the k samples of the segment's own rate."""
    size = max(1, round(step / np.median(np.diff(time))))
    spacing = step / size
    # the tolerance is of rounded clocks
    n_samples = 1 + int(np.ptp(time) / spacing + 1e-3)
    n_whole = n_samples // size * size
    points = time[0] + spacing * np.arange(n_whole)
    return np.minimum(points, time[-1]).reshape(-1, size)


def _averaged(name: str, time: Vector, values: Vector, clock: Matrix) -> Vector:
    """Return means over the blocks of a clock (n, k) of a channel, linear between its samples; NaN without samples."""
    is_sample = np.isfinite(values)
    samples = values[is_sample]
    if not samples.size:
        return np.full(len(clock), np.nan)
    if name in EULER:
        samples = np.unwrap(samples)
    sampled = np.interp(clock, time[is_sample], samples, left=np.nan, right=np.nan)
    return sampled.mean(axis=1)
