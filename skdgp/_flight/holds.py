"""Clocks of single channels: rows in which a log repeats the last sample of a slower channel.

A log of one clock repeats the last sample of a channel with a lower rate (zero-order hold). Taken for
fresh ones, repeated samples are late by half a period on average. Numbers of the search are guesses.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from skdgp._compute.typing import Indices, Mask, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.tables import FlightTable

CONTROL_GROUPS: tuple[Sequence[str], ...] = (ALL_SURFACES, ("throttle",), ("propeller_speed",))
SENSOR_GROUPS: tuple[Sequence[str], ...] = (
    ("airspeed",), VANES, RATES, SPECIFIC_FORCE, EULER, EARTH_VELOCITY,
)  # fmt: skip
"""Channels of one message, which have one clock."""


class Hold(NamedTuple):
    """Channels that repeat their samples."""

    names: list[str]
    rate: float  # of the samples [Hz]
    repeated: Mask  # (n,) rows that repeat a sample


def find_holds(flights: FlightTable, groups: Iterable[Sequence[str]]) -> list[Hold]:
    """Return the channels that repeat their samples, group by group."""
    holds = []
    for group in groups:
        channels = flights.numeric_channels(group)
        if not channels:
            continue
        values = np.column_stack(list(channels.values()))
        repeated = np.zeros(len(values), dtype=bool)
        rates = []
        for run in flights.segments:
            fresh = fresh_rows(values[run])
            seconds = float(np.ptp(flights.time[run]))
            # a GPS of 1 Hz is the slowest
            if fresh is None or seconds > 1.1 * len(fresh):
                continue
            repeated[run] = True
            repeated[run.start + fresh] = False
            rates.append(len(fresh) / seconds)
        if rates:
            holds.append(Hold(list(channels), float(np.median(rates)), repeated))
    return holds


def fresh_rows(values: Matrix) -> Indices | None:
    """Return the rows of fresh samples of channels (n, k) of one clock, None unless they repeat samples.

    The channels change after multiples of a steady period of two or more rows. A sample may equal
    the one before: between changes the clock goes on. Channels that lack more than a tenth of the rows repeat none.
    """
    values = values[:, np.isfinite(values).any(axis=0)]
    is_whole = np.isfinite(values).all(axis=1)
    if not values.size or is_whole.mean() < 0.9:
        return None
    changes = 1 + np.flatnonzero(np.any(values[1:] != values[:-1], axis=1))
    return clock_rows(changes, len(values))


def clock_rows(changes: Indices, n: int) -> Indices | None:
    """Return the rows of n of a steady clock that shows in the rows of changes, None if there is none.

    It shows in 20 changes, of which 95 % are within a quarter of a period of it, and 70 % are one period after the
    one before. Noise changes a channel in every row, and a sequence of steps pauses more often.
    """
    if len(changes) < 20:
        return None
    gaps = np.diff(changes)
    usual = np.median(gaps)
    period = gaps[np.abs(gaps - usual) <= max(1.0, usual / 4)].mean()
    if period < 1.9:
        return None
    n_periods = np.maximum(np.rint(gaps / period), 1)
    is_on_clock = np.abs(gaps - n_periods * period) <= period / 4 + 0.1
    if is_on_clock.mean() < 0.95 or np.mean(n_periods == 1) < 0.7:
        return None
    before = np.arange(changes[0] - period, -0.5, -period)
    after = np.arange(changes[-1], n - 0.5, period)
    number = np.append(0, np.cumsum(n_periods))
    between = np.interp(np.arange(number[-1]), number, changes)
    return np.unique(np.rint(np.concatenate([before, between, after])).astype(int))


def interpolated_rows(time: Vector, values: Vector) -> Indices | None:
    """Return the rows of the samples of a channel that is a cubic spline between these, None if it is not.

    Divided differences of fourth order are zero where no sample lies inside of five rows, so samples
    must be four rows or more apart.
    """
    scale = float(np.nanstd(values))
    if len(time) < 5 or not scale > 0:
        return None
    differences = values
    for order in range(1, 5):
        differences = np.diff(differences) / (time[order:] - time[:-order])
    step = float(np.median(np.diff(time)))
    is_bend = np.abs(differences) * step**4 > 1e-9 * scale
    # the last but one of the five rows
    samples = 4 + np.flatnonzero(is_bend[1:] & ~is_bend[:-1])
    return clock_rows(samples, len(time))


def error_between_samples(time: Vector, values: Vector, samples: Indices) -> Vector:
    """Return the size of the error of a spline (n,) between the rows of its samples, zero at these.

    Half of the curvature of the samples, in trials on simulated inputs at 10 Hz.
    """
    number = np.interp(time, time[samples], np.arange(len(samples)))
    fraction = number % 1.0
    curvature = np.abs(np.gradient(np.gradient(values[samples])))
    return 2 * fraction * (1 - fraction) * np.interp(time, time[samples], curvature)


def without_repeats(table: pd.DataFrame, groups: Iterable[Sequence[str]]) -> pd.DataFrame:
    """Return a table with time, with NaN in rows that repeat a sample."""
    for hold in find_holds(FlightTable.of(table), groups):
        fresh = {name: table[name].mask(hold.repeated) for name in hold.names}
        table = table.assign(**fresh)
    return table


def between_samples(flights: FlightTable, holds: Iterable[Hold]) -> dict[str, Vector]:
    """Return channels that repeat samples, as cubic splines between these.

    A straight line has 8 to 14 % less of the motion above 1 Hz than a surface that is sampled at
    10 Hz, a spline 0 to 3 %.
    """
    columns: dict[str, Vector] = {}
    for hold in holds:
        for name in hold.names:
            values = flights.column(name)
            columns[name] = values.copy()
            for run in flights.segments:
                time = flights.time[run]
                is_measured = np.isfinite(values[run])
                samples = is_measured & ~hold.repeated[run]
                between = is_measured & hold.repeated[run]
                if between.any() and samples.sum() > 1:
                    spline = CubicSpline(time[samples], values[run][samples])
                    first, last = time[samples][[0, -1]]
                    columns[name][run][between] = spline(np.clip(time[between], first, last))
    return columns


def with_own_clocks(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with time, controls between their samples and sensors NaN where they repeat one."""
    flights = FlightTable.of(table)
    controls = between_samples(flights, find_holds(flights, CONTROL_GROUPS))
    return without_repeats(table.assign(**controls), SENSOR_GROUPS)
