"""SI units and radians: flights whose numbers are in others are refused, or warned of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from skdgp._compute.messages import report, warn
from skdgp._compute.typing import Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    EARTH_VELOCITY,
    FULL_THROW,
    HIGH_LIFT,
    RATES,
    SPECIFIC_FORCE,
    WRAPPED,
)
from skdgp._flight.checks import check_columns
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import HIGHEST, LOWEST, standard_density, wrapped
from skdgp._flight.ground import flying_airspeed, on_ground
from skdgp._flight.tables import FlightTable, has_values

# largest angles [rad], and rates [rad/s], eight turns a second; noise may carry an angle beyond
ANGLE_NOISE = 0.05
FASTEST_RATE = 50.0
LARGEST_ANGLE = {
    "alpha": np.pi,
    "beta": np.pi / 2,
    "phi": np.pi,
    "theta": np.pi / 2,
    "psi": 2 * np.pi,
}
# 99 % of the values of a flight are smaller [rad, rad/s]
USUAL = {
    **dict.fromkeys(("alpha", "beta", "theta"), 1.7),
    "phi": LARGEST_ANGLE["phi"] + ANGLE_NOISE,
    "psi": LARGEST_ANGLE["psi"] + ANGLE_NOISE,
    **dict.fromkeys((*ALL_SURFACES, *HIGH_LIFT), 1.6),
    **dict.fromkeys(RATES, 20.0),
}
# the rates that turn the angles that go round
GYROS = {"phi": RATES, "psi": ("q", "r")}
# 90 % of a flight is slower [rad/s]: else gyros are in degrees, too
FASTEST_TURN = {"phi": 2 * np.pi, "psi": np.pi}


@dataclass(frozen=True)
class UnitSettings:
    """Limits of numbers in SI units and radians; guesses without another source."""

    # median of the size of an angle in degrees, but for roll and heading
    largest_middle: float = 30.0
    # median time step [s]
    longest_step: float = 5.0
    # 99 % of the throttle are smaller
    most_throttle: float = 1.5
    # median of a specific force in g
    force_in_g: tuple[float, float] = (0.5, 2.0)
    # [rad], 40 degrees: larger deflections may be commands; the largest of seven logs is 0.31
    largest_deflection: float = 0.7

    # an angle that changes by so many times the integral of the gyros is in degrees
    clearly_faster: float = 57.3**0.5
    # change in a second [rad] that needs no turn
    no_turn: float = 0.1
    # of an angle without gyros 90 % is slower [rad/s], and 99 % are fewer turns
    slow_turn: float = 1.0
    most_turns: float = 10.0
    # least number of seconds to judge an angle by
    enough: int = 5


UNITS = UnitSettings()


def check_radians(table: pd.DataFrame, names: Iterable[str]) -> None:
    """Raise a ValueError if a column of ``names``, angles and rates, is too large for radians; absent ones pass.

    Roll and heading may be unwrapped: see `is_unwrapped`.
    """
    for name in names:
        if name not in table:
            continue
        most = FASTEST_RATE
        if name in LARGEST_ANGLE:
            most = LARGEST_ANGLE[name] + ANGLE_NOISE
        values = np.abs(table[name].to_numpy(float, na_value=np.nan))
        top = np.max(values, initial=0.0, where=np.isfinite(values))
        if top > most and not is_unwrapped(table, name):
            unit = "rad/s" if name in RATES else "radians"
            expected = f"{unit}, at most {most:.4g}"
            raise degrees_error(f"{name} up to {top:g}", expected, f"flight[{name!r}]", name)


def degrees_error(got: str, expected: str, name: str, angle: str = "") -> ValueError:
    """Return the error of an angle or a rate that is too large for radians."""
    return ValueError(
        f"Got {got}, but expected {expected}: if it is in degrees, use numpy.deg2rad({name})."
        f"{_how_to_wrap(angle)}"
    )


def _how_to_wrap(*names: str) -> str:
    """Return the remedy of unwrapped angles, empty if none of the names goes round."""
    if not {*names} & {*WRAPPED}:
        return ""
    return " Unwrapped roll and heading can be wrapped by numpy.angle(numpy.exp(1j * psi))."


def is_unwrapped(table: pd.DataFrame, name: str) -> bool:
    """Return whether roll or heading beyond a turn is in radians without jumps, and not in degrees.

    It does not jump by 360, and changes over a second by no more than the gyros turn; degrees
    change 57 times as fast. Without gyros, it begins within a turn, as unwrapping leaves it, turns
    slowly, and a few times only. A tenth of the seconds may be faster, so spikes do not count.
    """
    if name not in GYROS or "time" not in table:
        return False
    flights = FlightTable.of(table)
    angle = flights.column(name)
    change = np.abs(_over_a_second(flights, angle))
    jumps_by_degrees = ((change > 300) & (change < 361)).any()
    if np.isfinite(change).sum() < UNITS.enough or jumps_by_degrees:
        return False
    fastest = _quantile(change, 0.9)
    if has_values(table, *GYROS[name]) and fastest > 0:
        turns = [_turn_in_a_second(flights, rate) for rate in GYROS[name]]
        turned = _quantile(np.linalg.norm(turns, axis=0), 0.9)
        most = max(UNITS.clearly_faster * turned, UNITS.no_turn)
        return fastest <= min(most, FASTEST_TURN[name])
    first = table[name].groupby(flights.clock.flight).first()
    begins_within_a_turn = first.abs().max() <= 2 * np.pi + ANGLE_NOISE
    n_turns = _quantile(np.abs(angle), 0.99) / (2 * np.pi)
    is_slow = fastest <= UNITS.slow_turn and n_turns <= UNITS.most_turns
    return bool(begins_within_a_turn and is_slow)


def _over_a_second(flights: FlightTable, values: Vector) -> Vector:
    """Return the changes of values over about a second of a flight, NaN where it has a gap; none of short ones."""
    flight = flights.clock.flight
    time = flights.time
    longest = int(np.bincount(flight, minlength=1).max())
    if longest < 3:
        return np.empty(0)
    step = np.median(np.diff(time))
    lag = min(max(round(1.0 / step), 1), longest // 2)
    is_same = flight[lag:] == flight[:-lag]
    seconds = time[lag:] - time[:-lag]
    is_unbroken = is_same & (np.abs(seconds - lag * step) < step)
    change = values[lag:] - values[:-lag]
    return np.where(is_unbroken, change, np.nan)


def _turn_in_a_second(flights: FlightTable, rate: str) -> Vector:
    """Return the integrals of a rate over about a second."""
    step = np.median(np.diff(flights.time))
    angle = step * np.nancumsum(flights.column(rate))
    return _over_a_second(flights, angle)


def check_flight(flight: pd.DataFrame | FlightTable, needed: Iterable[str]) -> FlightTable:
    """Return the flights of a table that has the ``needed`` columns in SI units.

    Flights without faults were checked before.

    Raises ValueError if a column is missing or not numeric, time does not increase within a flight
    or has no usual step, airspeed or density is not positive, or values are impossible in SI units. Warns of
    values that are probably of another unit or sign.
    """
    if isinstance(flight, FlightTable) and flight.findings is not None:
        check_columns(flight.table, needed)
        return flight
    flights = flight if isinstance(flight, FlightTable) else FlightTable.of(flight, needed)
    # raises where time has no usual step
    _ = flights.segments
    _check_airspeed(flights)
    check_units(flights)
    if _quantile(flights.column("density"), 0.0) <= 0:
        raise ValueError(_density_message(flights))
    _check_roll_rate(flights)
    _check_accelerations(flights)
    return flights


def check_units(flights: FlightTable) -> None:
    """Raise ValueError if the numbers of flights are in degrees, per cent, g, g/cm^3 or milliseconds.

    A hundredth of the values may be faults. Warn of surfaces in radians that are probably commands.
    """
    _check_angles(flights)
    _check_density(flights)
    throttle = _quantile(flights.column("throttle"), 0.99)
    if throttle > UNITS.most_throttle:
        raise ValueError(
            f"Got throttle up to {throttle:g}, but expected 0 to 1: divide it by its full range "
            f"(100 for per cent, or 'throttle [%]' in the header)."
        )
    force = _quantile(_size(flights, SPECIFIC_FORCE), 0.5)
    low, high = UNITS.force_in_g
    if low < force < high:
        raise ValueError(
            f"Got a specific force ax, ay, az of {force:.3g} (median magnitude), but expected near "
            f"9.8 m/s^2: this looks like g. Multiply by 9.80665, or say the unit in the header, as "
            f"in 'az [g]'; if gravity was removed, add it (az is -9.8 in level flight)."
        )
    step = _quantile(np.diff(flights.time), 0.5)
    if step > UNITS.longest_step:
        raise ValueError(
            f"Got a median time step of {step:g}, but expected seconds: this looks like "
            f"milliseconds or microseconds. Divide time by 1e3 or 1e6, or say the unit in the "
            f"header, as in 'time [ms]'."
        )
    if FULL_THROW not in flights.table:
        _warn_of_commands(flights)


def _check_angles(flights: FlightTable) -> None:
    """Raise ValueError if angles or rates are in degrees."""
    degrees: dict[str, float] = {}
    shifted: dict[str, float] = {}
    for name, usual in USUAL.items():
        sizes = np.abs(flights.column(name))
        top = _quantile(sizes, 0.99)
        if top > usual and not is_unwrapped(flights.table, name):
            degrees[name] = round(top, 1)
            middle = _quantile(sizes, 0.5)
            if middle > UNITS.largest_middle and name not in WRAPPED:
                shifted[name] = round(middle, 1)
    if shifted:
        raise ValueError(
            f"Got {shifted} as medians of angles, more than an aircraft flies at even in degrees: "
            f"these look like the values of another column. Check that each name in the header "
            f"stands above its own values."
        )
    if degrees:
        raise ValueError(
            f"Got magnitudes up to {degrees} (99th percentile), but expected radians and radians "
            f"per second: these look like degrees. Convert them with numpy.deg2rad, or say the "
            f"unit in the header, as in 'alpha [deg]'.{_how_to_wrap(*degrees)}"
        )


def _warn_of_commands(flights: FlightTable) -> None:
    """Warn of surfaces that are probably commands from -1 to 1: large, or at 1 exactly."""
    large = {}
    for name in ALL_SURFACES:
        angles = np.abs(flights.column(name))
        top = _quantile(angles, 0.99)
        if top > UNITS.largest_deflection or (angles == 1).sum() > 1:
            large[name] = float(np.nanmax(angles))
    if large:
        report(Finding(Code.LARGE_SURFACES, numbers={"largest": large}))


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


def _check_airspeed(flights: FlightTable) -> None:
    airspeed = flights.column("airspeed")
    check_airspeed(airspeed)
    middle = flying_airspeed(airspeed)
    is_slow = airspeed < 0.2 * middle
    if is_slow.any():
        warn(
            f"In {100 * is_slow.mean():.1f} % of the samples the airspeed is under a fifth of its "
            f"median ({middle:.1f} m/s), where noise over rho V^2 / 2 drowns the coefficients: is "
            f"the part on the ground still in the flight? Cut it, e.g. "
            f"flight[flight.airspeed > 5]."
        )
    ground_speed = _size(flights, EARTH_VELOCITY)
    ratio = middle / _quantile(ground_speed[~on_ground(flights)], 0.5)
    if ratio < 0.5 or ratio > 1.8:
        warn(
            f"The median airspeed is {ratio:.2f} times the median ground speed, but both should "
            f"be m/s (1.94: airspeed in knots; 3.6: in km/h). Ignore this only if the wind was "
            f"that strong."
        )


def _density_message(flights: FlightTable) -> str:
    """Return the error text of values that are no densities of air."""
    density = flights.column("density")
    return (
        f"Got density from {np.nanmin(density):g} to {np.nanmax(density):g}, but expected air in kg/m^3 (1.225 at "
        "sea level): convert it, or use skdgp.dynamics.standard_density(altitude)."
    )


def _check_density(flights: FlightTable) -> None:
    """Raise ValueError if the density is not of air in kg/m^3; warn if it is far from that at the altitude."""
    middle = _quantile(flights.column("density"), 0.5)
    if middle <= 0.05 or middle >= 2.5:
        raise ValueError(_density_message(flights))
    height = _quantile(flights.column("altitude"), 0.5)
    if not LOWEST <= height <= HIGHEST:
        return
    standard = float(standard_density(height))
    if middle < 0.8 * standard or middle > 1.25 * standard:
        warn(
            f"The median density {middle:.3f} kg/m^3 is far from the {standard:.3f} kg/m^3 of "
            f"the standard atmosphere at the median altitude {height:.0f} m: check the units "
            f"of both."
        )


def _check_roll_rate(flights: FlightTable) -> None:
    """Raise ValueError if the roll rate and the changes of roll over seconds are of different units."""
    change = wrapped(_over_a_second(flights, flights.column("phi")))
    turned = _quantile(np.abs(change), 0.9)
    gyro = _quantile(np.abs(_turn_in_a_second(flights, "p")), 0.9)
    if not (turned > 0.02 and gyro > 0.02):
        return
    ratio = gyro / turned
    if ratio < 1 / 15 or ratio > 15:
        raise ValueError(
            f"The roll rate p integrates to {ratio:.3g} times the change of phi, but "
            f"expected about 1: one of them is in degrees (ratio 57.3 or 0.017). Use numpy.deg2rad "
            f"on it, and on q and r as on p."
        )


def _check_accelerations(flights: FlightTable) -> None:
    size = _quantile(_size(flights, SPECIFIC_FORCE), 0.5)
    down = _quantile(flights.column("az"), 0.5)
    if size < 3.0 or size > 300.0 or down > 3.0:
        warn(
            f"The median specific force is {size:.3g} m/s^2, its az {down:+.2f} m/s^2, but level "
            f"flight gives 9.8 and -9.8: an accelerometer reads specific force, so add gravity if "
            f"it was subtracted, and change the signs of ay and az if the sensor's z points up."
        )


def _size(flights: FlightTable, names: Iterable[str]) -> Vector:
    """Return the length of a vector of channels."""
    return np.linalg.norm([flights.column(name) for name in names], axis=0)


def _quantile(values: Vector, fraction: float) -> float:
    """Return a quantile of the finite values, NaN of none."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, fraction)) if finite.size else np.nan
