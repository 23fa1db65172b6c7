"""Rows of flights on the ground, by their airspeed."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._compute.messages import report
from skdgp._compute.typing import Mask
from skdgp._flight.clock import true_runs
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import FlightTable

# Below this fraction of a fast airspeed, its 95 % quantile, no wing carries: the lift coefficient would be 16
# times as large. From there the aircraft rolls up to the second fraction.
STANDING = 0.25
ROLLING = 0.5
SHORTEST = 2.0  # [s] on the ground


def on_ground(flights: FlightTable) -> Mask:
    """Return which rows (n,) stand or roll on the ground, none without an airspeed."""
    airspeed = flights.column("airspeed")
    ground = np.zeros(len(airspeed), dtype=bool)
    for rows in flights.clock.rows.values():
        speed = airspeed[rows]
        measured = speed[np.isfinite(speed)]
        if not measured.size:
            continue
        fast = float(np.quantile(measured, 0.95))
        time = flights.time[rows]
        for run in true_runs(speed < ROLLING * fast):
            standing = true_runs(speed[run] < STANDING * fast)
            seconds = [np.ptp(time[run][part]) for part in standing]
            ground[rows[run]] = max(seconds, default=0.0) >= SHORTEST
    return ground


def without_ground(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Return the rows of flights that fly; warn of the others, by the name of the table."""
    ground = on_ground(FlightTable.of(table))
    if not ground.any():
        return table
    report(Finding(Code.ON_GROUND, flight=name, numbers={"percent": 100 * ground.mean()}))
    flown = table[~ground].reset_index(drop=True)
    flown.attrs = table.attrs
    return flown
