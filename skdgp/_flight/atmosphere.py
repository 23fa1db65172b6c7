"""The standard atmosphere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

GAS_CONSTANT = 287.05287  # of dry air [J/(kg K)]
STANDARD_GRAVITY = 9.80665
LOWEST, HIGHEST = -5000.0, 20000.0
SEA_LEVEL_DENSITY, SEA_LEVEL_PRESSURE = 1.225, 101325.0  # [kg/m^3, Pa]
SEA_LEVEL_TEMPERATURE = 288.15  # [K]
LAPSE, TROPOPAUSE = 0.0065, 11000.0  # [K/m] up to an altitude [m], zero above


def standard_density(altitude: ArrayLike) -> np.ndarray:
    """Return the density [kg/m^3] of the International Standard Atmosphere at geopotential altitudes h [m].

    Up to 11 km (U.S. Standard Atmosphere 1976, section 1.3; ISO 2533:1975)

        T = T_0 - L h,   p = p_0 (T / T_0)^(g / (R L)),   rho = p / (R T),

    and above rho falls by exp(-g (h - 11 km) / (R T)). Geometric altitude z above the ellipsoid is
    more by z^2 / 6356766 m: 1.6 m at 3.2 km. NaN gives NaN; raises ValueError outside of -5 to
    20 km.

    Examples
    --------
    >>> from skdgp.dynamics import standard_density
    >>> standard_density([0.0, 1000.0]).round(3)
    array([1.225, 1.112])
    """
    altitude = np.asarray(altitude, dtype=float)
    outside = (altitude < LOWEST) | (altitude > HIGHEST)
    if outside.any():
        raise ValueError(
            f"Got altitude {altitude[outside].flat[0]:g} m, but expected {LOWEST:g} to "
            f"{HIGHEST:g} m, where the standard atmosphere is given: use metres above the sea, "
            f"upward, or density from elsewhere."
        )
    temperature = SEA_LEVEL_TEMPERATURE - LAPSE * np.minimum(altitude, TROPOPAUSE)
    exponent = STANDARD_GRAVITY / (GAS_CONSTANT * LAPSE)
    pressure = SEA_LEVEL_PRESSURE * (temperature / SEA_LEVEL_TEMPERATURE) ** exponent
    above = np.maximum(altitude - TROPOPAUSE, 0.0)
    pressure = pressure * np.exp(-STANDARD_GRAVITY * above / (GAS_CONSTANT * temperature))
    return pressure / (GAS_CONSTANT * temperature)
