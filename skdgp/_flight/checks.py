"""Validation of flight tables: columns, limits of angles and rates, degrees instead of radians."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches

import numpy as np
import pandas as pd

from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import report, warn
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    CHANNELS,
    EARTH_VELOCITY,
    RATES,
    SPECIFIC_FORCE,
    TRUTH_SUFFIX,
)
from skdgp._flight.clock import flight_codes, flight_segments
from skdgp._flight.frames import HIGHEST, LOWEST, standard_density, wrapped

LARGEST_ANGLE = {
    "alpha": np.pi,
    "beta": np.pi / 2,
    "phi": np.pi,
    "theta": np.pi / 2,
    "psi": 2 * np.pi,
}
# angles that go round, and the rates that turn them
GYROS = {"phi": RATES, "psi": ("q", "r")}
# an angle that changes by so many times the integral of the gyros is in degrees
CLEARLY_FASTER = 57.3**0.5
# angles that jump by 2 pi
WRAPPED = (*GYROS,)
# change in a second [rad] that needs no turn
NO_TURN = 0.1
# 90 % of a flight is slower [rad/s]: else gyros are in degrees, too
FASTEST_TURN = {"phi": 2 * np.pi, "psi": np.pi}
# of an angle without gyros 90 % is slower [rad/s]
SLOW_TURN = 1.0
# an angle without gyros is smaller [turns]
MOST_TURNS = 10.0
# least number of changes to judge an angle by
ENOUGH = 5
ANGLE_NOISE = 0.05  # noise that may carry an angle over its largest value [rad]
FASTEST_RATE = 50.0  # rates beyond this [rad/s], eight turns a second, are in other units
# 99 % of the values of a flight are smaller [rad, rad/s]
USUAL = {
    **dict.fromkeys(("alpha", "beta", "theta"), 1.7),
    **{name: LARGEST_ANGLE[name] + ANGLE_NOISE for name in WRAPPED},
    **dict.fromkeys(ALL_SURFACES, 1.6),
    **dict.fromkeys(RATES, 20.0),
}
# median of the size of an angle in degrees, but for roll and heading; a guess
LARGEST_MIDDLE = 30.0
LONGEST_STEP = 5.0  # s
# Names in other programs and textbooks, in lower case
ALIASES = {
    **dict.fromkeys(("ias", "tas", "va", "vtas", "vias", "aspd"), "airspeed"),
    **dict.fromkeys(("aoa", "alfa"), "alpha"), **dict.fromkeys(("aos", "ssa", "sideslip"), "beta"),
    **dict.fromkeys(("de", "elev", "delta_e", "stab"), "elevator"),
    **dict.fromkeys(("da", "ail", "delta_a"), "aileron"),
    **dict.fromkeys(("dr", "rud", "delta_r"), "rudder"),
    **dict.fromkeys(("dthr", "dt", "thr", "delta_t"), "throttle"),
    **dict.fromkeys(("rpm", "omega"), "propeller_speed"), "rho": "density", "alt": "altitude",
    "roll": "phi", "pitch": "theta", "yaw": "psi", "heading": "psi", "hdg": "psi",
    "t": "time", "vn": "v_north", "ve": "v_east", "vd": "v_down",
    "gx": "p", "gy": "q", "gz": "r", "gyrx": "p", "gyry": "q", "gyrz": "r",
    "accx": "ax", "accy": "ay", "accz": "az",
}  # fmt: skip
WRAP = " Unwrapped roll and heading can be wrapped by numpy.angle(numpy.exp(1j * psi))."
REMEDIES = {
    "airspeed": " Airspeed comes from a pitot tube, or from ground velocity less an estimated wind: "
    "give a column airspeed [m/s].",
    "density": " skdgp.dynamics.standard_density(altitude) is the density of the standard atmosphere.",
}
MOST_NAMES = 8  # unknown columns that a message names
HEADING_UNIT = re.compile(
    r"[\[(].*|_(deg|rad|dps|(deg|rad)_?s|mps|m_s|ms|kmh|knots|kt|g|m|s)$", re.IGNORECASE
)
# [rad], 40 degrees: beyond may be commands from -1 to 1; the largest of seven logs is 0.31
LARGEST_DEFLECTION = 0.7


def check_table(table: object, *, what: str = "flight") -> pd.DataFrame:
    """Return a DataFrame with unique column names and at least one row; raise TypeError or ValueError at any other."""
    if not isinstance(table, pd.DataFrame):
        raise TypeError(
            f"Got {type(table).__name__} for {what}, but expected a pandas DataFrame with named "
            f"columns (one row per sample): build one with skdgp.io.read_flight or "
            f"pandas.DataFrame, or convert another library's with its to_pandas()."
        )
    if len(table) == 0:
        raise ValueError(f"Got {what} with no rows, but expected at least one sample.")
    twice = table.columns[table.columns.duplicated()].unique().tolist()
    if twice:
        raise ValueError(
            f"Got {what} with repeated columns {twice}, but expected each name once: drop one."
        )
    return table


def suggestions(names: Iterable[str], have: Collection[str]) -> dict[str, str]:
    """Return by unknown name the nearest name of a flight table that is not there yet.

    >>> suggestions(["ias", "de", "trottle", "voltage"], have=["time", "alpha"])
    {'ias': 'airspeed', 'de': 'elevator', 'trottle': 'throttle'}
    """
    free = [name for name in CHANNELS if name not in have]
    nearest: dict[str, str] = {}
    for name in map(str, names):
        word = HEADING_UNIT.sub("", name).strip().lower()
        near = [channel for channel in free if channel in (word, ALIASES.get(word))]
        if len(word) > 4:
            near += get_close_matches(word, free, n=1, cutoff=0.87)
        if near and near[0] not in nearest.values():
            nearest[name] = near[0]
    return nearest


def unknown_columns_message(names: Collection[str], have: Collection[str]) -> str:
    """Return one line on columns of no known name: suggestions, then the others.

    >>> unknown_columns_message(["de", "voltage"], have=["time", "alpha"])
    "'de' (did you mean 'elevator' [rad]?), and 1 other: voltage"
    """
    near = suggestions(names, have)
    hints = []
    for name, channel in near.items():
        unit = CHANNELS[channel].unit
        meant = f"{channel!r} [{unit}]" if unit else f"{channel!r}"
        hints.append(f"{name!r} (did you mean {meant}?)")
    unlike = [name for name in names if name not in near]
    if unlike:
        shown = ", ".join(unlike[:MOST_NAMES])
        if len(unlike) > MOST_NAMES:
            shown += ", ..."
        count = f"{len(unlike)}"
        if near:
            count = "and 1 other" if len(unlike) == 1 else f"and {len(unlike)} others"
        hints.append(f"{count}: {shown}")
    return ", ".join(hints)


def unknown_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns of a table whose names are none of a flight table, nor of simulated truth."""
    return [
        str(name) for name in table.columns if str(name).removesuffix(TRUTH_SUFFIX) not in CHANNELS
    ]


def check_columns(table: pd.DataFrame, needed: Iterable[str], *, what: str = "flight") -> None:
    """Raise a ValueError that names the columns of ``needed`` that ``table`` lacks, and the nearest ones."""
    lacking = _lacking(needed, [str(column) for column in table.columns])
    if not lacking:
        return
    if what == "flight" and "flight" in table:
        names = table["flight"].astype(str).unique()
        if len(names) == 1:
            what = f"flight {names.item()!r}"
    remedies = [text for name, text in REMEDIES.items() if f"'{name}'" in lacking]
    raise ValueError(
        f"The {what} lacks the columns {lacking}. Rename or compute them; docs/notation.md lists "
        f"every name with its unit.{''.join(remedies)}"
    )


def check_names(needed: Iterable[str], have: Iterable[str], what: str) -> None:
    """Raise a ValueError that names what ``have`` lacks of the ``needed`` names, and the nearest ones."""
    names = [str(name) for name in have]
    lacking = _lacking(needed, names)
    if lacking:
        raise ValueError(
            f"The {what} lack {lacking}: got {names}. docs/notation.md lists every name with its "
            f"unit."
        )


def check_choice(name: str, value: object, choices: Collection[object]) -> None:
    """Raise ValueError if a parameter is none of its choices."""
    if value not in choices:
        *first, last = map(repr, choices)
        raise ValueError(f"Got {name}={value!r}, but expected {', '.join(first)} or {last}.")


def as_floats(values: object) -> Array:
    """Return values as floats; a single NaN if any is a truth value or no number."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.array(np.nan)
    is_bool = any(isinstance(value, bool) for value in np.ravel(np.array(values, dtype=object)))
    return np.array(np.nan) if is_bool else array


def check_number(
    name: str, value: object, least: float = 0.0, *, is_open: bool = True, unit: str = ""
) -> float:
    """Return a finite number above ``least``, or from it on if not ``is_open``; raise ValueError at another."""
    number = as_floats(value)
    is_inside = number.shape == () and (number > least if is_open else number >= least)
    if is_inside and number < np.inf:
        return float(number)
    bound = "a finite number"
    if least > -np.inf:
        bound = f"a number {'>' if is_open else '>='} {least:g}"
    if unit:
        bound += f" [{unit}]"
    raise ValueError(f"Got {name}={value!r}, but expected {bound}.")


def check_numbers(name: str, values: object, *sizes: int) -> Array:
    """Return finite numbers (n,), n one of the ``sizes``; raise ValueError at anything else."""
    array = as_floats(values)
    if array.ndim != 1 or len(array) not in sizes or not np.isfinite(array).all():
        count = " to ".join(map(str, sorted({sizes[0], sizes[-1]})))
        raise ValueError(f"Got {name}={values!r}, but expected {count} finite numbers.")
    return array


def _lacking(needed: Iterable[str], names: list[str]) -> str:
    """Return the missing names, each with the nearest one there is; empty if none is missing."""
    hints = []
    for name in dict.fromkeys(needed):
        if name not in names:
            near = get_close_matches(name, names, n=1, cutoff=0.75)
            hints.append(f"{name!r} (nearest: {near[0]!r})" if near else f"{name!r}")
    return ", ".join(hints)


def check_radians(table: pd.DataFrame, names: Iterable[str]) -> None:
    """Raise a ValueError if a column of ``names``, angles and rates, is too large for radians; absent ones pass.

    Roll and heading may be unwrapped: see `is_unwrapped`.
    """
    for name in names:
        most = LARGEST_ANGLE[name] + ANGLE_NOISE if name in LARGEST_ANGLE else FASTEST_RATE
        values = np.abs(_values(table, name))
        top = np.max(values, initial=0.0, where=np.isfinite(values))
        if top > most and not is_unwrapped(table, name):
            expected = f"{'rad/s' if name in RATES else 'radians'}, at most {most:.4g}"
            raise degrees_error(f"{name} up to {top:g}", expected, f"flight[{name!r}]", name)


def check_units(table: pd.DataFrame) -> None:
    """Raise ValueError if the numbers of a flight are in degrees, per cent, g or milliseconds.

    A hundredth of the values may be faults. Warn of surfaces that are probably commands.
    """
    degrees: dict[str, float] = {}
    shifted: dict[str, float] = {}
    for name, usual in USUAL.items():
        sizes = np.abs(_values(table, name))
        top = _quantile(sizes, 0.99)
        if top > usual and not is_unwrapped(table, name):
            degrees[name] = round(top, 1)
            middle = _quantile(sizes, 0.5)
            if middle > LARGEST_MIDDLE and name not in WRAPPED:
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
            f"unit in the header, as in 'alpha [deg]'." + WRAP * bool(degrees.keys() & {*WRAPPED})
        )
    if (throttle := _quantile(_values(table, "throttle"), 0.99)) > 1.5:
        raise ValueError(
            f"Got throttle up to {throttle:g}, but expected 0 to 1: divide it by its full range "
            f"(100 for per cent, or 'throttle [%]' in the header)."
        )
    force = _quantile(_size(table, SPECIFIC_FORCE), 0.5)
    if 0.5 < force < 2.0:
        raise ValueError(
            f"Got a specific force ax, ay, az of {force:.3g} (median magnitude), but expected near "
            f"9.8 m/s^2: this looks like g. Multiply by 9.80665, or say the unit in the header, as "
            f"in 'az [g]'."
        )
    step = _quantile(np.diff(_values(table, "time")), 0.5)
    if step > LONGEST_STEP:
        raise ValueError(
            f"Got a median time step of {step:g}, but expected seconds: this looks like "
            f"milliseconds or microseconds. Divide time by 1e3 or 1e6, or say the unit in the "
            f"header, as in 'time [ms]'."
        )
    _warn_of_commands(table)


def is_unwrapped(table: pd.DataFrame, name: str) -> bool:
    """Return whether roll or heading beyond a turn is in radians without jumps, and not in degrees.

    It does not jump by 360, and changes over a second by no more than the gyros turn; degrees
    change 57 times as fast. Without gyros, it begins within a turn, as unwrapping leaves it, turns
    slowly, and a few times only. A tenth of the seconds may be faster, so spikes do not count.
    """
    if name not in GYROS or "time" not in table:
        return False
    values = _values(table, name)
    sampled = np.isfinite(values)
    angle = values[sampled]
    is_next_flight = np.diff(_codes(table)[sampled]) != 0
    steps = np.abs(np.diff(angle))[~is_next_flight]
    jumps_by_degrees = ((steps > 300) & (steps < 361)).any()
    change = np.abs(_over_a_second(table, values))
    if np.isfinite(change).sum() < ENOUGH or jumps_by_degrees:
        return False
    fastest = float(np.nanquantile(change, 0.9))
    rates = [_values(table, rate) for rate in GYROS[name]]
    turned = np.hypot.reduce([_over_a_second(table, rate, rate=True) for rate in rates])
    if np.isfinite(turned).any() and fastest > 0:
        most = max(CLEARLY_FASTER * float(np.nanquantile(turned, 0.9)), NO_TURN)
        return fastest <= min(most, FASTEST_TURN[name])
    is_first = np.concatenate([[True], is_next_flight])
    begins = np.abs(angle[is_first]).max()
    turns = np.quantile(np.abs(angle), 0.99) / (2 * np.pi)
    begins_within_a_turn = begins <= 2 * np.pi + ANGLE_NOISE
    return bool(begins_within_a_turn and fastest <= SLOW_TURN and turns <= MOST_TURNS)


def degrees_error(got: str, expected: str, name: str, angle: str = "") -> ValueError:
    """Return the error of an angle or a rate that is too large for radians."""
    return ValueError(
        f"Got {got}, but expected {expected}: if it is in degrees, use numpy.deg2rad({name})."
        + WRAP * (angle in WRAPPED)
    )


def check_flight(flight: pd.DataFrame, needed: Iterable[str]) -> list[slice]:
    """Return the segments without gaps of a flight table that has the ``needed`` columns in SI units.

    Raises ValueError if a column is missing or not numeric, time does not increase within a flight,
    airspeed is not positive, or values are impossible in SI units. Warns of values that are
    probably of another unit or sign.
    """
    check_columns(check_table(flight), needed)
    numeric(flight, needed)
    segments = flight_segments(flight["time"].to_numpy(float), flight.get("flight"))
    for check in (_airspeed, _density, check_units, _roll_rate, _accelerations):
        check(flight)
    return segments


def check_airspeed(flight: pd.DataFrame) -> None:
    """Raise ValueError if an airspeed is not positive."""
    airspeed = _values(flight, "airspeed")
    bad = np.flatnonzero(airspeed <= 0)
    if bad.size:
        raise ValueError(
            f"Got airspeed {airspeed[bad[0]]:g} m/s at row {bad[0]} and {bad.size} rows with "
            f"airspeed <= 0, but coefficients are loads over rho V^2 / 2 and need airspeed > 0: cut "
            f"the part on the ground, e.g. flight[flight.airspeed > 5], or set the airspeed of those "
            f"rows to NaN."
        )


def _airspeed(flight: pd.DataFrame) -> None:
    check_airspeed(flight)
    airspeed = _values(flight, "airspeed")
    middle = _quantile(airspeed, 0.5)
    if (slow := airspeed < 0.2 * middle).any():
        warn(
            f"In {100 * slow.mean():.1f} % of the samples the airspeed is under a fifth of its "
            f"median ({middle:.1f} m/s), where noise over rho V^2 / 2 drowns the coefficients: is "
            f"the part on the ground still in the flight? Cut it, e.g. "
            f"flight[flight.airspeed > 5].",
            stacklevel=4,
        )
    ratio = middle / _quantile(_size(flight, EARTH_VELOCITY), 0.5)
    if ratio < 0.5 or ratio > 1.8:
        warn(
            f"The median airspeed is {ratio:.2f} times the median ground speed, but both should "
            f"be m/s (1.94: airspeed in knots; 3.6: in km/h). Ignore this only if the wind was "
            f"that strong.",
            stacklevel=4,
        )


def _density(flight: pd.DataFrame) -> None:
    density = _values(flight, "density")
    lowest = _quantile(density, 0.0)
    middle = _quantile(density, 0.5)
    if lowest <= 0 or middle <= 0.05 or middle >= 2.5:
        raise ValueError(
            f"Got density from {lowest:g} to {np.nanmax(density):g}, but expected air in kg/m^3 "
            f"(1.225 at sea level): convert it, or use "
            f"skdgp.dynamics.standard_density(altitude)."
        )
    height = _quantile(_values(flight, "altitude"), 0.5)
    if LOWEST <= height <= HIGHEST:
        standard = float(standard_density(height))
        if middle < 0.8 * standard or middle > 1.25 * standard:
            warn(
                f"The median density {middle:.3f} kg/m^3 is far from the {standard:.3f} kg/m^3 of "
                f"the standard atmosphere at the median altitude {height:.0f} m: check the units "
                f"of both.",
                stacklevel=4,
            )


def _warn_of_commands(flight: pd.DataFrame) -> None:
    """Warn of surfaces that are probably commands from -1 to 1: beyond `LARGEST_DEFLECTION`, or at 1 exactly."""
    large = {}
    for name in ALL_SURFACES:
        angles = np.abs(_values(flight, name))
        top = _quantile(angles, 0.99)
        if top > LARGEST_DEFLECTION or (angles == 1).sum() > 1:
            large[name] = top
    if large:
        report(Finding(Code.LARGE_SURFACES, numbers={"largest": large}), stacklevel=4)


def _roll_rate(flight: pd.DataFrame) -> None:
    """Raise ValueError if the roll rate and the changes of roll over seconds are of different units."""
    time = _values(flight, "time")
    if len(time) < 2:
        return
    rows = max(round(1.0 / np.median(np.diff(time))), 1)
    seconds = np.arange(0, len(time) - rows, rows)
    if not seconds.size:
        return
    changes = wrapped(np.diff(_values(flight, "phi")[::rows]))
    turned = _quantile(np.abs(changes), 0.9)
    steps = _values(flight, "p") * np.diff(time, append=np.nan)
    gyro = _quantile(np.abs(np.add.reduceat(steps, seconds)), 0.9)
    if not (turned > 0.02 and gyro > 0.02):
        return
    ratio = gyro / turned
    if ratio < 1 / 15 or ratio > 15:
        raise ValueError(
            f"The roll rate p integrates to {ratio:.3g} times the change of phi, but "
            f"expected about 1: one of them is in degrees (ratio 57.3 or 0.017). Use numpy.deg2rad "
            f"on it, and on q and r as on p."
        )


def _over_a_second(flight: pd.DataFrame, values: np.ndarray, *, rate: bool = False) -> np.ndarray:
    """Return by how much values change over about a second of a flight, or of a rate its integral; NaN in gaps."""
    time = _values(flight, "time")
    codes = _codes(flight)
    longest = int(np.bincount(codes).max())
    if longest < 3:
        return np.full(len(time), np.nan)
    step = np.nanmedian(np.diff(time))
    lag = min(max(round(1.0 / step), 1), longest // 2)
    unbroken = (codes[lag:] == codes[:-lag]) & (
        np.abs(time[lag:] - time[:-lag] - lag * step) < step
    )
    sums = np.convolve(values, np.ones(lag), mode="valid")[: len(time) - lag] * step
    return np.where(unbroken, sums if rate else values[lag:] - values[:-lag], np.nan)


def _accelerations(flight: pd.DataFrame) -> None:
    size = _quantile(_size(flight, SPECIFIC_FORCE), 0.5)
    down = _quantile(_values(flight, "az"), 0.5)
    if size < 3.0 or size > 300.0 or down > 3.0:
        warn(
            f"The median specific force is {size:.3g} m/s^2, its az {down:+.2f} m/s^2, but level "
            f"flight gives 9.8 and -9.8: an accelerometer reads specific force, so add gravity if "
            f"it was subtracted, and change the signs of ay and az if the sensor's z points up.",
            stacklevel=4,
        )


def _codes(flight: pd.DataFrame) -> np.ndarray:
    """Return the number of each row's flight."""
    if "flight" not in flight:
        return np.zeros(len(flight), int)
    return flight_codes(flight["flight"])[0]


def _values(flight: pd.DataFrame, name: str) -> Vector:
    """Return a column as floats, NaN where it is absent."""
    if name not in flight:
        return np.full(len(flight), np.nan)
    return flight[name].to_numpy(float, na_value=np.nan)


def _size(flight: pd.DataFrame, names: Iterable[str]) -> Vector:
    return np.linalg.norm([_values(flight, name) for name in names], axis=0)


def _quantile(values: Vector, fraction: float) -> float:
    """Return a quantile of the finite values, NaN of none."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, fraction)) if finite.size else np.nan


def numeric(table: pd.DataFrame, columns: Iterable[str]) -> Matrix:
    """Return columns as floats (n, k); raise ValueError with the names of columns that are not numeric."""
    columns = list(columns)
    try:
        return table[columns].to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError):
        kinds = {
            name: str(table[name].dtype)
            for name in columns
            if not pd.api.types.is_numeric_dtype(table[name])
        }
        raise ValueError(
            f"Got columns of type {kinds}, but expected numbers: convert or drop them."
        ) from None


def unwrapped(table: pd.DataFrame, names: Iterable[str]) -> Matrix:
    """Return columns as floats (n, k), roll and heading without their jumps of 2 pi."""
    names = list(names)
    values = numeric(table, names).copy()
    for j, name in enumerate(names):
        if name in WRAPPED:
            sampled = np.isfinite(values[:, j])
            values[sampled, j] = np.unwrap(values[sampled, j])
    return values
