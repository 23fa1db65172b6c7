"""The band of frequencies in which a flight shows the motion of the aircraft."""

from __future__ import annotations

import pandas as pd

from skdgp._flight.channels import ALL_SURFACES, RATES
from skdgp._flight.smoothing import motion_band
from skdgp._flight.tables import numeric


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
