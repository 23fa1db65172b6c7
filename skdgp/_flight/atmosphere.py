"""The standard atmosphere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import inv_boxcox

GAS_CONSTANT = 287.05287  # of dry air [J/(kg K)]
HEAT_RATIO = 1.4
STANDARD_GRAVITY = 9.80665
LOWEST, HIGHEST = -5000.0, 32000.0
SEA_LEVEL_DENSITY, SEA_LEVEL_PRESSURE = 1.225, 101325.0  # [kg/m^3, Pa]
BASE = np.array(
    [0.0, 11000.0, 20000.0]
)  # where the layers begin [m]; the first one reaches down to `LOWEST`
LAPSE = np.array([-0.0065, 0.0, 0.001])  # of the temperature in each layer [K/m]


class Atmosphere(NamedTuple):
    """State of still air, arrays of one shape: [kg/m^3], [Pa], [K], [m/s]."""

    density: np.ndarray
    pressure: np.ndarray
    temperature: np.ndarray
    speed_of_sound: np.ndarray


def standard_atmosphere(altitude: ArrayLike) -> Atmosphere:
    """Return the International Standard Atmosphere at geopotential altitudes h [m], -5000 to 32000; NaN gives NaN.

    In each layer (U.S. Standard Atmosphere 1976, section 1.3; ISO 2533:1975)

        T = T_b + L (h - h_b),   p = p_b (T / T_b)^(-g / (R L)),   rho = p / (R T),   a = sqrt(1.4 R T)

    and p = p_b exp(-g (h - h_b) / (R T_b)) where L = 0. Geometric altitude z above the ellipsoid is
    more by z^2 / 6356766 m: 1.6 m at 3.2 km. Raises ValueError outside of these altitudes.

    Examples
    --------
    >>> from skdgp.dynamics import standard_atmosphere
    >>> air = standard_atmosphere([0.0, 11000.0, 25000.0])
    >>> air.density.round(4), air.temperature.round(2)
    (array([1.225 , 0.3639, 0.0395]), array([288.15, 216.65, 221.65]))
    """
    altitude = np.asarray(altitude, dtype=float)
    if (outside := (altitude < LOWEST) | (altitude > HIGHEST)).any():
        raise ValueError(
            f"Got altitude {altitude[outside].flat[0]:g} m, but expected {LOWEST:g} to "
            f"{HIGHEST:g} m, where the "
            "standard atmosphere is given: use metres above the sea, upward, or density from "
            "elsewhere."
        )
    layer = np.searchsorted(BASE[1:], altitude)
    temperature = _TEMPERATURE[layer] + LAPSE[layer] * (altitude - BASE[layer])
    pressure = _PRESSURE[layer] * _pressure_ratio(altitude, layer)
    density = pressure / (GAS_CONSTANT * temperature)
    return Atmosphere(
        density, pressure, temperature, np.sqrt(HEAT_RATIO * GAS_CONSTANT * temperature)
    )


def standard_density(altitude: ArrayLike) -> np.ndarray:
    """Return the density [kg/m^3] of the `standard_atmosphere` at geopotential altitude [m].

    Examples
    --------
    >>> from skdgp.dynamics import standard_density
    >>> standard_density([0.0, 1000.0]).round(3)
    array([1.225, 1.112])
    """
    return standard_atmosphere(altitude).density


def _pressure_ratio(altitude: np.ndarray, layer: np.ndarray) -> np.ndarray:
    """Return p / p_b. The Box-Cox power (1 + k x)^(1/k), k = -R L / g, is exp(x) where L = 0."""
    scale_height = GAS_CONSTANT * _TEMPERATURE[layer] / STANDARD_GRAVITY
    return inv_boxcox(
        (BASE[layer] - altitude) / scale_height, -GAS_CONSTANT / STANDARD_GRAVITY * LAPSE[layer]
    )


_TEMPERATURE = 288.15 + np.append(0.0, np.cumsum(LAPSE[:-1] * np.diff(BASE)))
_PRESSURE = SEA_LEVEL_PRESSURE * np.append(1.0, np.cumprod(_pressure_ratio(BASE[1:], np.arange(2))))
