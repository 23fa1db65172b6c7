r"""Relative error of the airspeed, by wind that turns with the heading.

With the velocities over the ground v and through the air u, horizontal and as complex numbers north +
i east, a reading (1 + s) V of the airspeed V and headings that are wrong by an angle leave

.. math:: v = w + c \, u, \quad |c| = 1 / (1 + s).

Legs of several headings determine the mean wind w and c (calibration of airspeed by GPS: Gray 1999;
Jategaonkar 2006, chapter 10). Gusts along u change u as well, so the heading is its instrument.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import detrend
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER
from skdgp._flight.clock import Clock
from skdgp._flight.frames import air_velocity
from skdgp._flight.tables import has_values, numeric
from skdgp.estimation._settings import PATH_SETTINGS, PathSettings

NEEDED = (*AIR_DATA, *EULER, *EARTH_VELOCITY)


class AirspeedScale(NamedTuple):
    """Relative error s of the airspeed and its standard deviation; that of an unknown error is infinite."""

    value: float
    std: float

    def removable(self, settings: PathSettings = PATH_SETTINGS) -> float:
        """Return the error to remove, zero where it is not significant."""
        is_significant = abs(self.value) > settings.significance * self.std
        return self.value if is_significant else 0.0

    def left(self, settings: PathSettings = PATH_SETTINGS) -> float:
        """Return what remains of the error, root mean square; zero where the flights do not show it.

        An airspeed that no flight contradicts is trusted.
        """
        prior = settings.airspeed_scale
        if self.std > prior:
            return 0.0
        weight = prior**2 / (prior**2 + self.std**2)
        kept = weight * (self.value - self.removable(settings))
        return float(np.hypot(kept, np.sqrt(weight) * self.std))


UNKNOWN_SCALE = AirspeedScale(0.0, np.inf)


class _Moments(NamedTuple):
    """One flight: sums of products with the instrument, the unit vector forward, over blocks of time."""

    of_ground: Vector  # (k,) complex
    of_air: Vector  # (k,) complex
    of_instrument: Vector  # (k,)


def airspeed_scale(table: pd.DataFrame, settings: PathSettings = PATH_SETTINGS) -> AirspeedScale:
    """Return the relative error of the airspeed of flights.

    The wind may drift linearly in time. Its errors last up to ``gust_time``.
    """
    if not has_values(table, *NEEDED):
        return UNKNOWN_SCALE
    is_sampled = np.isfinite(numeric(table, NEEDED)).all(axis=1)
    sampled = table.iloc[np.flatnonzero(is_sampled)]
    clock = Clock.of(sampled["time"], sampled.get("flight"))
    blocks = []
    for rows in clock.rows.values():
        flight: Any = sampled.iloc[rows]
        blocks.append(_moments(flight, settings))
    of_ground = np.concatenate([block.of_ground for block in blocks])
    of_air = np.concatenate([block.of_air for block in blocks])
    turning = np.concatenate([block.of_instrument for block in blocks]).sum() / len(sampled)
    n = len(of_air)
    n_unknowns = 6  # real numbers: c, mean and drift of the wind
    if n <= n_unknowns or turning < settings.least_turning:
        return UNKNOWN_SCALE
    total = of_air.sum()
    slope = of_ground.sum() / total
    # effect of each block on |c|
    effects = (np.conj(slope) / abs(slope) * (of_ground - slope * of_air) / total).real
    std = np.sqrt(np.sum(effects**2) * n / (n - n_unknowns))
    return AirspeedScale(float(1 / abs(slope) - 1), float(std / abs(slope) ** 2))


def _moments(flight: pd.DataFrame, settings: PathSettings) -> _Moments:
    attitude = Rotation.from_euler("ZYX", numeric(flight, EULER)[:, ::-1])
    through_air = attitude.apply(air_velocity(*numeric(flight, AIR_DATA).T))
    forward = _horizontal(attitude.apply([1.0, 0.0, 0.0]))
    instrument = np.conj(forward)
    time = flight["time"].to_numpy(float)
    block = ((time - time[0]) // settings.gust_time).astype(int)
    return _Moments(
        of_ground=_sums(block, instrument * _horizontal(numeric(flight, EARTH_VELOCITY))),
        of_air=_sums(block, instrument * _horizontal(through_air)),
        of_instrument=_sums(block, instrument * forward).real,
    )


def _horizontal(vectors: Matrix) -> Vector:
    """Return NED vectors (n, 3) as complex numbers without mean and trend."""
    return detrend(vectors[:, 0]) + 1j * detrend(vectors[:, 1])


def _sums(block: Array, values: Vector) -> Vector:
    return np.bincount(block, values.real) + 1j * np.bincount(block, values.imag)
