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

from skdgp._compute.statistics import remaining_error
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER
from skdgp._flight.clock import Clock
from skdgp._flight.frames import air_velocity, euler_to_rotation
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
        return remaining_error(self.value, self.std, prior, self.removable(settings) != 0)


UNKNOWN_SCALE = AirspeedScale(0.0, np.inf)


def without_airspeed_error(table: pd.DataFrame, scale: float) -> pd.DataFrame:
    """Return flights without a relative error ``scale`` of their airspeed."""
    if not scale or "airspeed" not in table:
        return table
    return table.assign(airspeed=table["airspeed"] / (1 + scale))


class _Moments(NamedTuple):
    """One flight: sums of products with the instrument, the unit vector forward, over blocks of time."""

    of_ground: Vector  # (k,) complex
    of_air: Vector  # (k,) complex
    of_instrument: Vector  # (k,)


def airspeed_scale(table: pd.DataFrame, settings: PathSettings = PATH_SETTINGS) -> AirspeedScale:
    r"""Return the relative error of the airspeed of flights.

    :math:`c = \sum h^* v / \sum h^* u` with the horizontal velocities v over the ground and u
    through the air, and the unit vector forward h, all without mean and trend in each flight, and
    :math:`s = 1 / |c| - 1`. Gusts of different blocks of ``gust_time`` are independent.

    Parameters
    ----------
    table : pandas.DataFrame
        ``time`` [s], ``airspeed``, ``v_north``, ``v_east``, ``v_down`` [m/s], ``alpha``, ``beta``,
        ``phi``, ``theta``, ``psi`` [rad]; ``flight`` where there are several.
    settings : PathSettings

    Returns
    -------
    AirspeedScale
        Of infinite standard deviation if a column is missing, or the flights hardly turn.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.estimation import airspeed_scale
    >>> psi = np.linspace(0, 4 * np.pi, 1200)
    >>> circles = pd.DataFrame({"time": 0.1 * np.arange(1200), "airspeed": 1.02 * 22, "alpha": 0.0, "beta": 0.0,
    ...                         "phi": 0.0, "theta": 0.0, "psi": psi, "v_north": 22 * np.cos(psi) + 6,
    ...                         "v_east": 22 * np.sin(psi) - 3, "v_down": 0.0})
    >>> round(airspeed_scale(circles).value, 4)
    0.02
    """
    if not has_values(table, "time", *NEEDED):
        return UNKNOWN_SCALE
    is_sampled = np.isfinite(numeric(table, NEEDED)).all(axis=1)
    if not is_sampled.any():
        return UNKNOWN_SCALE
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
    attitude = euler_to_rotation(numeric(flight, EULER))
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
