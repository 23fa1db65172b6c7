"""The band of frequencies in which a flight shows the motion of the aircraft."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import ALL_SURFACES, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.smoothing import FittedFilter, motion_band, power_beyond, smooth
from skdgp._flight.tables import has_values, numeric

# Least band of the motion [Hz]: errors of a narrower one correlate between ten rows a second
LEAST_BAND = 5.0


def vibration_band(table: pd.DataFrame) -> float:
    """Return the frequency [Hz] beyond which flights with vanes vibrate; infinite where they do not.

    Vibration beyond the motion biases slopes. Without it nothing should be removed, as gusts there
    contribute to the mean of a nonlinear function. Without vanes the noise of the filter contains it.
    """
    if not has_values(table, "time", *SPECIFIC_FORCE, *VANES):
        return np.inf
    band = max(motion_band_of(table), LEAST_BAND)
    return band if vibrates_beyond(table, band) else np.inf


def motion_band_of(table: pd.DataFrame) -> float:
    """Return the frequency [Hz] up to which flights show the motion of the aircraft; infinite if unknown.

    Surfaces cause the motion and the rates follow it, so the band of either is enough: that of the
    rates is too wide where they vibrate, that of the surfaces where these carry noise.
    """
    time = numeric(table, ["time"])[:, 0]
    flight = table.get("flight")
    bands = []
    for group in (RATES, ALL_SURFACES):
        names = [name for name in group if name in table]
        bands.append(motion_band(numeric(table, names), time, flight=flight))
    return min(bands)


def vibrates_beyond(table: pd.DataFrame, band: float) -> bool:
    """Return whether two of the three specific forces have more power beyond the band [Hz] than within.

    Gusts move the aircraft within it: two of the forces have up to 29 % beyond it in 16 simulated
    flights of four aircraft without vibration, and 16 to 96 % in 16 flights with vibration.
    """
    time = numeric(table, ["time"])[:, 0]
    forces = numeric(table, SPECIFIC_FORCE)
    parts = power_beyond(forces, time, band, flight=table.get("flight"))
    return bool(np.sum(parts > 0.5) >= 2)


def band_limited(values: Matrix, table: pd.DataFrame, band: float) -> Matrix:
    """Return columns (n, k) of flights without frequencies beyond a band [Hz]; as they are if it is infinite."""
    if np.isinf(band):
        return values
    time = numeric(table, ["time"])[:, 0]
    cutoff = FittedFilter.up_to(band, values.shape[1])
    return smooth(values, time, flight=table.get("flight"), cutoff=cutoff)
