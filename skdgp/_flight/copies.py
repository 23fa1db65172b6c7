"""Flights that are there twice: copies by their rows, or a log and its telemetry by their attitude."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._compute.findings import Finding
from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import EULER, RATES, SPECIFIC_FORCE
from skdgp._flight.findings import Code
from skdgp._flight.frames import wrapped
from skdgp._flight.tables import FlightTable, has_values, interpolated, unwrapped

# fraction of equal rows above which a flight is a copy
COPIED = 0.5
# delays of telemetry that are tried [s]
LAGS = np.linspace(-0.4, 0.4, 9)


def without_copies(
    train: dict[str, FlightTable], tests: dict[str, FlightTable]
) -> tuple[dict[str, FlightTable], dict[str, FlightTable], list[Finding]]:
    """Return training and test flights without those that repeat another training flight, and a finding of each.

    They have most of their rows in common, or the attitude at the same times. Of training flights the longer
    one stays; if all test flights are copies, they stay.
    """
    kept: dict[str, FlightTable] = {}
    twice: dict[str, str] = {}
    copied: dict[str, str] = {}
    longest_first = sorted(train.items(), key=lambda item: -len(item[1].time))
    for number, (name, flight) in enumerate([*longest_first, *tests.items()]):
        is_test = number >= len(train)
        other = _original(flight, kept)
        if other is not None:
            (copied if is_test else twice)[name] = other
        elif not is_test:
            kept[name] = flight
    others = {name: flight for name, flight in tests.items() if name not in copied}
    code = Code.COPY_LEFT_OUT if others else Code.TESTED_ON_COPY
    findings = [Finding(Code.FLIGHT_TWICE, flight=name, other=twice[name]) for name in twice]
    findings += [Finding(code, flight=name, other=copied[name]) for name in copied]
    return {name: train[name] for name in train if name in kept}, others or tests, findings


def _original(flight: FlightTable, others: dict[str, FlightTable]) -> str | None:
    """Return the name of the flight that a flight repeats, None if it repeats none."""
    motion = _motion(flight)
    for name, other in others.items():
        n_common = np.isin(motion, _motion(other)).sum()
        if n_common > COPIED * len(motion) or _has_its_attitude(flight, other):
            return name
    return None


def _has_its_attitude(flight: FlightTable, other: FlightTable) -> bool:
    """Return whether two flights have the same attitude at the same times, as a log and its telemetry have."""
    if not has_values(flight.table, *EULER) or not has_values(other.table, *EULER):
        return False
    is_inside = (flight.time >= other.time[0]) & (flight.time <= other.time[-1])
    n_rows = max(1, round(1 / float(np.median(np.diff(flight.time)))))
    if is_inside.mean() <= COPIED or len(is_inside) <= n_rows + 1:
        return False
    own = unwrapped(flight.table, EULER)
    angles = unwrapped(other.table, EULER)
    fast = own[n_rows:] - own[:-n_rows]
    for lag in LAGS:
        there = interpolated(flight.time - lag, other.time, angles, beyond=np.nan)
        apart = wrapped(own - there)
        unshared = apart[n_rows:] - apart[:-n_rows]
        if np.isfinite(unshared).all(axis=1).any():
            # [rad]; 0.6 or more apart in nine flights
            is_near = np.nanmedian(np.linalg.norm(apart, axis=1)) < 0.05
            # changes within a second differ by 0.0 to 0.4 of their variance in copies, 0.7 to 9 in flights with the
            # same inputs on one course (38 pairs)
            if is_near and _total_variance(unshared) < 0.5 * _total_variance(fast):
                return True
    return False


def _total_variance(angles: Matrix) -> float:
    """Return the sum of the variances of angles (n, 3) [rad^2]."""
    return float(np.nanvar(angles, axis=0).sum())


def _motion(flight: FlightTable) -> Array:
    """Return hash values of the different rows of rates and specific force, rounded below their noise."""
    channels = flight.table.reindex(columns=[*RATES, *SPECIFIC_FORCE])
    values = channels.to_numpy(float, na_value=np.nan)
    measured = values[np.isfinite(values).all(axis=1)]
    rounded = pd.DataFrame(np.round(measured, 4))
    return np.unique(pd.util.hash_pandas_object(rounded, index=False))
