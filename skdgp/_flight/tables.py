"""Columns of flight tables: which have values, and values where a sensor has no sample."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.checks import numeric


def has_values(table: pd.DataFrame, *names: str) -> bool:
    """Return whether the table has all these columns, each with a finite value."""
    return all(name in table and np.isfinite(numeric(table, [name])).any() for name in names)


def interpolate_missing(time: Vector, values: Matrix) -> Matrix:
    """Return columns (n, k) with linear interpolation of values that are not finite."""
    table = pd.DataFrame(np.where(np.isfinite(values), values, np.nan), index=time)
    return np.array(table.interpolate("index", limit_direction="both"), order="C")
