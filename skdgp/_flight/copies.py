"""Flights that are there twice: copies by their rows, or a log and its telemetry by their attitude."""

from __future__ import annotations

import numpy as np

from skdgp._compute.findings import Finding
from skdgp._compute.messages import report
from skdgp._compute.typing import Matrix
from skdgp._flight.channels import EULER, RATES, SPECIFIC_FORCE
from skdgp._flight.findings import Code
from skdgp._flight.frames import wrapped
from skdgp._flight.tables import FlightTable, has_values, interpolated, unwrapped

# fraction of equal rows above which a flight is a copy, and decimals to which they are equal
COPIED = 0.5
ROUNDED = 4
# median distance of attitudes [rad] below which they are of one flight; 0.6 or more apart in nine flights
SAME_ATTITUDE = 0.05
# largest total variance of the difference of attitudes over that of the attitude, of one flight (guess)
UNSHARED = 0.1


def without_copies(
    flights: dict[str, FlightTable], others: dict[str, FlightTable], code: Code
) -> dict[str, FlightTable]:
    """Return the flights that are no copies of others, all if there are only copies; warn of copies by a code."""
    copied = copies(flights, others)
    originals = {name: flight for name, flight in flights.items() if name not in copied}
    for name, other in copied.items():
        kind = code if originals else Code.TESTED_ON_COPY
        report(Finding(kind, flight=name, numbers={"other": other}))
    return originals or flights


def copies(flights: dict[str, FlightTable], others: dict[str, FlightTable]) -> dict[str, str]:
    """Return by name the flights that repeat another one: most of their rows, or its attitude at the same times.

    Where both are the same flights, those that are copied stay, so that the copies of each other do not all go.
    """
    rows = {id(flight): _motion(flight) for flight in [*flights.values(), *others.values()]}
    shortest_first = sorted(others.items(), key=lambda item: len(rows[id(item[1])]))
    found: dict[str, str] = {}
    for name, flight in flights.items():
        if flights is others and name in found.values():
            continue
        for other_name, other in shortest_first:
            is_left_out = flights is others and other_name in found
            if flight is other or is_left_out:
                continue
            own = rows[id(flight)]
            has_its_rows = len(own & rows[id(other)]) > COPIED * len(own)
            if has_its_rows or _has_its_attitude(flight, other):
                found[name] = other_name
    return found


def _has_its_attitude(flight: FlightTable, other: FlightTable) -> bool:
    """Return whether two flights have the same attitude at the same times, as a log and its telemetry have."""
    if not has_values(flight.table, *EULER) or not has_values(other.table, *EULER):
        return False
    is_inside = (flight.time >= other.time[0]) & (flight.time <= other.time[-1])
    if is_inside.sum() <= COPIED * len(is_inside):
        return False
    angles = unwrapped(other.table, EULER)
    there = interpolated(flight.time[is_inside], other.time, angles, beyond=np.nan)
    own = unwrapped(flight.table, EULER)[is_inside]
    apart = wrapped(own - there)
    is_near = np.nanmedian(np.linalg.norm(apart, axis=1)) < SAME_ATTITUDE
    return bool(is_near and _total_variance(apart) < UNSHARED * _total_variance(own))


def _total_variance(angles: Matrix) -> float:
    """Return the sum of the variances of angles (n, 3) [rad^2]."""
    return float(np.nanvar(angles, axis=0).sum())


def _motion(flight: FlightTable) -> set[tuple[float, ...]]:
    """Return the different rows of rates and specific force, rounded below their noise."""
    values = np.column_stack([flight.column(name) for name in (*RATES, *SPECIFIC_FORCE)])
    measured = values[np.isfinite(values).all(axis=1)]
    return {tuple(row) for row in np.round(measured, ROUNDED).tolist()}
