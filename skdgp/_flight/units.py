"""SI units and radians: flights whose numbers are in others are refused, or warned of."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.messages import report, warn
from skdgp._compute.typing import Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    FULL_THROW,
    HIGH_LIFT,
    RATES,
    SPECIFIC_FORCE,
    WRAPPED,
)
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import density_or_nan
from skdgp._flight.tables import FlightTable, check_columns, has_values

# noise may carry an angle beyond its limit by this [rad]
ANGLE_NOISE = 0.05
# 99 % of the values of a flight are smaller [rad, rad/s]
USUAL = {
    **dict.fromkeys(("alpha", "beta", "theta"), 1.7),
    "phi": np.pi + ANGLE_NOISE,
    "psi": 2 * np.pi + ANGLE_NOISE,
    **dict.fromkeys((*ALL_SURFACES, *HIGH_LIFT), 1.6),
    **dict.fromkeys(RATES, 20.0),
}
# with an afterburner
MOST_THROTTLE = 2.1


class Limit(NamedTuple):
    """Limits of a number of flights in SI units; guesses without another source."""

    value: Callable[[FlightTable], float]
    least: float
    most: float
    #: Message with the ``value``
    text: str
    #: Whether other flights are refused, in place of a warning
    is_error: bool = True

    def check(self, flights: FlightTable) -> None:
        """Raise ValueError, or warn, if the flights have a number outside; none is inside."""
        value = self.value(flights)
        if not (value < self.least or value > self.most):
            return
        text = self.text.format(value=value)
        if self.is_error:
            raise ValueError(text)
        warn(text)


def _quantile_of(name: str, fraction: float = 0.5) -> Callable[[FlightTable], float]:
    """Return the function of a quantile of a channel."""
    return lambda flights: _quantile(flights.column(name), fraction)


def _specific_force(flights: FlightTable) -> float:
    force = [flights.column(name) for name in SPECIFIC_FORCE]
    return _quantile(np.linalg.norm(force, axis=0), 0.5)


def _force_with_gravity(flights: FlightTable) -> float:
    """Return the median specific force, NaN if it is less than 0.5 even in g: gravity was removed."""
    force = _specific_force(flights)
    return force if force > 0.5 else np.nan


def _turning_over_gyro(flights: FlightTable) -> float:
    """Return the spread of changes of theta over that of q times the step, NaN of steps below half a second."""
    step = _quantile(np.diff(flights.time), 0.5)
    if not step >= 0.5 or not has_values(flights.table, "theta", "q"):
        return np.nan
    turned = np.nanstd(np.diff(flights.column("theta")))
    by_gyro = step * np.nanstd(flights.column("q"))
    return float(turned / by_gyro) if by_gyro > 0 else np.nan


def _density_over_standard(flights: FlightTable) -> float:
    """Return the median density over that of the standard atmosphere at the median altitude."""
    standard = density_or_nan(np.array(_quantile(flights.column("altitude"), 0.5)))
    return float(_quantile(flights.column("density"), 0.5) / standard)


DENSITY = (
    "Got a density of {value:g}, but expected air in kg/m^3 (1.225 at sea level): convert it, or use "
    "skdgp.dynamics.standard_density(altitude)."
)
ALTITUDE = (
    "The median density is {value:.2f} times that of the standard atmosphere at the median altitude: check the "
    "units of both."
)
FORCE = (
    "The median specific force is {value:.3g} m/s^2, but level flight gives 9.8: an accelerometer reads specific "
    "force, so add gravity if it was subtracted."
)
# units of single channels
LIMITS = (
    Limit(_quantile_of("density"), 0.05, 2.5, DENSITY),
    Limit(
        _quantile_of("throttle", 0.99),
        -np.inf,
        MOST_THROTTLE,
        "Got throttle up to {value:g}, but expected 0 to 1: divide it by its full range (100 for per "
        "cent, or 'throttle [%]' in the header).",
    ),
    Limit(
        _force_with_gravity,
        2.0,
        np.inf,
        "Got a specific force ax, ay, az of {value:.3g} (median magnitude), but expected near 9.8 m/s^2: this "
        "looks like g. Multiply by 9.80665, or say the unit in the header, as in 'az [g]'; if gravity "
        "was removed, add it (az is -9.8 in level flight).",
    ),
    Limit(
        lambda flights: _quantile(np.diff(flights.time), 0.5),
        -np.inf,
        5.0,
        "Got a median time step of {value:g}, but expected seconds: this looks like milliseconds or "
        "microseconds. Divide time by 1e3 or 1e6, or say the unit in the header, as in 'time [ms]'.",
    ),
    Limit(
        _turning_over_gyro,
        0.1,
        np.inf,
        "Got a theta that changes {value:.2g} times as fast as q says, in steps of half a second or more: time looks "
        "like milliseconds. Divide it by 1e3, or say the unit in the header, as in 'time [ms]'.",
    ),
    Limit(
        lambda flights: _quantile(np.diff(flights.time), 0.5),
        9e-4,
        np.inf,
        "The median time step is {value:g} s: if this is in minutes, multiply time by 60.",
        is_error=False,
    ),
    Limit(_density_over_standard, 0.8, 1.25, ALTITUDE, is_error=False),
)
# of flights whose coefficients are computed
LIMITS_OF_MOTION = (
    Limit(_quantile_of("density", 0.0), np.nextafter(0.0, 1.0), np.inf, DENSITY),
    Limit(_specific_force, 3.0, 300.0, FORCE, is_error=False),
    Limit(
        _quantile_of("az"),
        -np.inf,
        3.0,
        "The median specific force az is {value:+.2f} m/s^2, but -9.8 in level flight: z points down in body axes, "
        "which are forward, right, down.",
        is_error=False,
    ),
)


def degrees_error(got: str, expected: str, name: str) -> ValueError:
    """Return the error of an angle or a rate that is too large for radians."""
    return ValueError(
        f"Got {got}, but expected {expected}: if it is in degrees, use numpy.deg2rad({name})."
    )


def check_flight(flight: pd.DataFrame | FlightTable, needed: Iterable[str]) -> FlightTable:
    """Return the flights of a table that has the ``needed`` columns in SI units.

    Flights without faults were checked before.

    Raises ValueError if a column is missing or not numeric, time does not increase within a flight
    or has no usual step, airspeed or density is not positive, or values are impossible in SI units. Warns of
    values that are probably of another unit or sign.
    """
    flights = flight if isinstance(flight, FlightTable) else FlightTable.of(flight, needed)
    if flights.findings is not None:
        check_columns(flights.table, needed)
        return flights
    # raises where time has no usual step
    _ = flights.segments
    check_airspeed(flights.column("airspeed"))
    check_units(flights)
    for limit in LIMITS_OF_MOTION:
        limit.check(flights)
    return flights


def check_units(flights: FlightTable) -> None:
    """Raise ValueError if the numbers of flights are in degrees, per cent, g, g/cm^3 or milliseconds.

    A hundredth of the values may be faults. Warn of surfaces in radians that are probably commands.
    """
    check_radians(flights.table)
    for limit in LIMITS:
        limit.check(flights)
    if FULL_THROW not in flights.table:
        _warn_of_commands(flights)


def check_radians(table: pd.DataFrame, names: Iterable[str] = USUAL) -> None:
    """Raise ValueError if angles or rates of ``names`` are in degrees; absent ones pass."""
    degrees: dict[str, float] = {}
    for name in [name for name in USUAL if name in names and name in table]:
        usual = USUAL[name]
        sizes = np.abs(table[name].to_numpy(float, na_value=np.nan))
        top = _quantile(sizes, 0.99)
        if top > usual:
            too_large = sizes[sizes > usual]
            # marks are -99 or -999; a doublet of 5 or flaps of 20 are degrees, as a heading of 359 is
            is_one_mark = np.ptp(too_large) == 0 and too_large[0] > 90.0
            if is_one_mark and name not in WRAPPED and (sizes <= usual).any():
                raise ValueError(
                    f"Got {name} of magnitude {too_large[0]:g} in {len(too_large)} rows, and of no other above "
                    f"{usual:.3g}: this looks like a mark of missing values. Leave these cells empty."
                )
            degrees[name] = round(top, 1)
    counts = {name: top for name, top in degrees.items() if name in ALL_SURFACES and top > 90.0}
    if counts:
        raise ValueError(
            f"Got magnitudes up to {counts} (99th percentile), but expected surfaces in radians: these look like "
            f"counts or pulses of servos. Subtract those at trim, and multiply by the deflection [rad] of one count."
        )
    if degrees:
        raise ValueError(
            f"Got magnitudes up to {degrees} (99th percentile), but expected radians and radians "
            f"per second: these look like degrees. Convert them with numpy.deg2rad, or say the unit in "
            f"the header, as in 'alpha [deg]'. If they are the values of another column, correct the "
            f"header. Unwrapped roll and heading are wrapped by numpy.angle(numpy.exp(1j * psi))."
        )


def _warn_of_commands(flights: FlightTable) -> None:
    """Warn of surfaces that are probably commands from -1 to 1: large, or at 1 exactly.

    The largest deflection of seven logs is 0.31 rad; 0.7 are 40 degrees.
    """
    large = {}
    for name in ALL_SURFACES:
        angles = np.abs(flights.column(name))
        top = _quantile(angles, 0.99)
        if top > 0.7 or (angles == 1).sum() > 1:
            large[name] = float(np.nanmax(angles))
    if large:
        report(Finding(Code.LARGE_SURFACES, largest=large))


def check_airspeed(airspeed: Vector) -> None:
    """Raise ValueError if an airspeed is not positive."""
    bad = np.flatnonzero(airspeed <= 0)
    if bad.size:
        raise ValueError(
            f"Got airspeed {airspeed[bad[0]]:g} m/s at row {bad[0]} and {bad.size} rows with "
            f"airspeed <= 0, but coefficients are loads over rho V^2 / 2 and need airspeed > 0: cut "
            f"the part on the ground, e.g. flight[flight.airspeed > 5], or set the airspeed of those "
            f"rows to NaN."
        )


def _quantile(values: Vector, fraction: float) -> float:
    """Return a quantile of the finite values, NaN of none."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, fraction)) if finite.size else np.nan
