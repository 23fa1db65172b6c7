r"""Relative error of the airspeed, by wind that turns with the heading.

With the velocities over the ground v and through the air u, horizontal and as complex numbers north +
i east, a reading (1 + s) V of the airspeed V and headings that are wrong by an angle leave

.. math:: v = w + c \, u, \quad |c| = 1 / (1 + s).

Legs of several headings determine the mean wind w and c (calibration of airspeed by GPS: Gray 1999;
Jategaonkar 2006, chapter 10). Gusts along u change u as well, so the heading is its instrument.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import detrend

from skdgp._compute.statistics import remaining_error
from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER
from skdgp._flight.frames import air_velocity, euler_to_rotation
from skdgp._flight.tables import FlightTable, has_values, numeric
from skdgp.estimation._sensors import AIR_SENSOR_ERRORS, GUST_TIME

NEEDED = (*AIR_DATA, *EULER, *EARTH_VELOCITY)


class AirspeedScale(NamedTuple):
    """Relative error s of the airspeed and its standard deviation; that of an unknown error is infinite."""

    value: float
    std: float

    def removable(self) -> float:
        """Return the error to remove, zero where it is not significant."""
        # errors of the airspeed below this many standard deviations are not removed; convention
        is_significant = abs(self.value) > 2.0 * self.std
        return self.value if is_significant else 0.0

    def left(self) -> float:
        """Return what remains of the error, root mean square; zero where the flights do not show it.

        An airspeed that no flight contradicts is trusted.
        """
        _, prior = AIR_SENSOR_ERRORS["airspeed_scale"]
        if self.std > prior:
            return 0.0
        return self.std if self.removable() else remaining_error(self.value, self.std, prior)


UNKNOWN_SCALE = AirspeedScale(0.0, np.inf)


def airspeed_scale(table: pd.DataFrame) -> AirspeedScale:
    r"""Return the relative error of the airspeed of flights.

    :math:`c = \sum h^* v / \sum h^* u` with the horizontal velocities v over the ground and u
    through the air, and the unit vector forward h, all without mean and trend in each flight, and
    :math:`s = 1 / |c| - 1`. Gusts of different blocks of 10 s are independent.

    Parameters
    ----------
    table : pandas.DataFrame
        ``time`` [s], ``airspeed``, ``v_north``, ``v_east``, ``v_down`` [m/s], ``alpha``, ``beta``,
        ``phi``, ``theta``, ``psi`` [rad]; ``flight`` where there are several.

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
    flights = FlightTable.of(table[is_sampled])
    blocks = [_moments(flight.table) for flight in flights.flights.values()]
    of_ground, of_air, of_instrument = np.concatenate(blocks, axis=1)
    turning = of_instrument.real.sum() / is_sampled.sum()
    n = len(of_air)
    n_unknowns = 6  # real numbers: c, mean and drift of the wind
    # least variance of the unit vector forward that shows it: gusts turn a straight flight; a circle has 1; guess
    if n <= n_unknowns or turning < 0.1:
        return UNKNOWN_SCALE
    total = of_air.sum()
    slope = of_ground.sum() / total
    # effect of each block on |c|
    effects = (np.conj(slope) / abs(slope) * (of_ground - slope * of_air) / total).real
    std = np.sqrt(np.sum(effects**2) * n / (n - n_unknowns))
    return AirspeedScale(float(1 / abs(slope) - 1), float(std / abs(slope) ** 2))


def _moments(flight: pd.DataFrame) -> Array:
    """Return sums over blocks (3, k) of products of the instrument with velocities over ground, in air and itself."""
    attitude = euler_to_rotation(numeric(flight, EULER))
    through_air = attitude.apply(air_velocity(*numeric(flight, AIR_DATA).T))
    over_ground = numeric(flight, EARTH_VELOCITY)
    vectors = [over_ground, through_air, attitude.apply([1.0, 0.0, 0.0])]
    # horizontal ones without mean and trend
    values = np.array([detrend(v[:, 0]) + 1j * detrend(v[:, 1]) for v in vectors])
    time = flight["time"].to_numpy(float)
    block = ((time - time[0]) // GUST_TIME).astype(int)
    _, starts = np.unique(block, return_index=True)
    return np.add.reduceat(np.conj(values[2]) * values, starts, axis=1)
