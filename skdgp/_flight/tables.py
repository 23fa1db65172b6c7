"""Tables of flights, whose columns, numbers and clock are checked: a function of a FlightTable checks none again."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.findings import Finding, shortened
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import (
    CHANNELS,
    MIXED,
    SENSOR_POSITION,
    TRUTH_SUFFIX,
    WRAPPED,
)
from skdgp._flight.clock import Clock
from skdgp._flight.frames import wrapped_near

# Names in other programs and textbooks, in lower case
OTHER_NAMES = {
    "airspeed": "ias tas va vtas vias aspd", "alpha": "aoa alfa", "beta": "aos ssa sideslip",
    "elevator": "de elev delta_e stab", "aileron": "da ail delta_a", "rudder": "dr rud delta_r",
    "elevon_left": "elevon_l", "elevon_right": "elevon_r",
    "throttle": "dthr dt thr delta_t", "propeller_speed": "rpm omega", "density": "rho", "altitude": "alt",
    "phi": "roll", "theta": "pitch", "psi": "yaw heading hdg",
    "time": "t", "v_north": "vn", "v_east": "ve", "v_down": "vd",
    "p": "gx gyrx", "q": "gy gyry", "r": "gz gyrz", "ax": "accx", "ay": "accy", "az": "accz",
}  # fmt: skip
REMEDIES = {
    "airspeed": " Airspeed comes from a pitot tube, or from ground velocity less an estimated wind: "
    "give a column airspeed [m/s].",
    **dict.fromkeys(
        ("alpha_dot", "beta_dot", "p_dot", "q_dot", "r_dot"),
        " FlightSmoother() before this step adds rates of change.",
    ),
    **dict.fromkeys(
        MIXED, " ElevonSplitter() before this step makes elevator and aileron of elevons."
    ),
    "density": " skdgp.dynamics.standard_density(altitude) is the density of the standard atmosphere.",
}
MOST_NAMES = 8  # unknown columns that a message names
# farthest inertial sensors and engine from the centre of gravity [spans]; farther ones are given in mm; a guess
FARTHEST = 2.0
HEADING_UNIT = re.compile(
    r"[\[(].*|_(deg|rad|dps|(deg|rad)_?s|mps|m_s|ms|kmh|knots|kt|g|m|s)$", re.IGNORECASE
)


@dataclass(frozen=True)
class FlightTable:
    """One flight, or several: a table whose columns, numbers and clock were checked.

    Attributes
    ----------
    table : DataFrame (n, ...)
        SI units and radians; the names, units and axes of its channels are `CHANNELS`.
    clock : Clock
        Time and flight of each row, and the segments without gaps.
    findings : tuple of Finding or None
        What was found in flights whose faults are removed; None of others.
    """

    table: pd.DataFrame
    clock: Clock
    findings: tuple[Finding, ...] | None = None

    @classmethod
    def of(cls, table: object, needed: Iterable[str] = (), *, what: str = "flight") -> FlightTable:
        """Return the flights of a table with ``time`` and the ``needed`` columns.

        Raises TypeError if it is no DataFrame, and ValueError if a column is missing or not
        numeric, time does not increase within a flight, or a row names no flight.
        """
        checked = check_table(table, what=what)
        columns = ["time", *needed]
        check_columns(checked, columns, what=what)
        time = numeric(checked, columns)[:, 0]
        return cls(checked, Clock.of(time, checked.get("flight")))

    @property
    def time(self) -> Vector:
        """Time of each row [s], increasing within each flight."""
        return self.clock.time

    @property
    def segments(self) -> list[slice]:
        """Rows of one flight without gaps, in order, every row once."""
        return self.clock.segments

    @property
    def flights(self) -> dict[str, FlightTable]:
        """Each flight by itself, by name."""
        return {name: self.part(rows) for name, rows in self.clock.rows.items()}

    def part(self, rows: Indices) -> FlightTable:
        """Return the flights of some rows, in their order."""
        return FlightTable(self.table.iloc[rows], self.clock.part(rows), self.findings)

    @classmethod
    def together(cls, flights: Iterable[FlightTable]) -> FlightTable:
        """Return several flights in one table."""
        flights = list(flights)
        joined = cls.of(pd.concat([flight.table for flight in flights], ignore_index=True))
        if any(flight.findings is None for flight in flights):
            return joined
        return replace(joined, findings=())

    def named(self, name: str) -> FlightTable:
        """Return a single flight by another name, its rows counted from 0."""
        table = self.table.reset_index(drop=True).assign(flight=name)
        return FlightTable(table, Clock.of(self.time, table["flight"]), self.findings)

    def column(self, name: str) -> Vector:
        """Return a column as floats, NaN where it is absent."""
        if name not in self.table:
            return np.full(len(self.table), np.nan)
        return numeric(self.table, [name])[:, 0]

    def numeric_channels(self, names: Iterable[str]) -> dict[str, Vector]:
        """Return those of the channels that are in the table and hold numbers, as copies."""
        channels = {}
        for name in names:
            if name in self.table and pd.api.types.is_numeric_dtype(self.table[name]):
                channels[name] = self.column(name).copy()
        return channels


def numeric(table: pd.DataFrame, columns: Iterable[str]) -> Matrix:
    """Return columns as floats (n, k); raise ValueError with the names of columns that are not numeric."""
    columns = list(columns)
    try:
        return table[columns].to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError):
        kinds = {}
        for name in columns:
            if not pd.api.types.is_numeric_dtype(table[name]):
                kinds[name] = str(table[name].dtype)
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


def wrap_near(new: dict[str, Vector], table: pd.DataFrame, names: Sequence[str] = WRAPPED) -> None:
    """Shift the angles among new columns by multiples of 2 pi to less than pi from those of the table."""
    for name in [name for name in names if name in new]:
        reference = table[name].to_numpy(float, na_value=np.nan)
        new[name] = wrapped_near(new[name], reference)


def by_name(names: Sequence[str], values: Array) -> dict[str, Array]:
    """Return the last axis of ``values`` (..., n) by name."""
    return {name: values[..., k] for k, name in enumerate(names)}


def has_values(table: pd.DataFrame, *names: str) -> bool:
    """Return whether the table has all these columns, each with a finite value."""
    if not {*names} <= {*table.columns}:
        return False
    is_sampled = np.isfinite(numeric(table, names))
    return bool(is_sampled.any(axis=0).all())


def interpolated(at: Vector, time: Vector, values: Matrix, beyond: float | None = None) -> Matrix:
    """Return columns (n, k) at other times, by straight lines, ``beyond`` the ends (by default the end's value)."""
    columns = [np.interp(at, time, column, left=beyond, right=beyond) for column in values.T]
    return np.column_stack(columns)


def interpolate_missing(time: Vector, values: Matrix) -> Matrix:
    """Return columns (n, k) with linear interpolation of values that are not finite."""
    sampled = np.where(np.isfinite(values), values, np.nan)
    table = pd.DataFrame(sampled, index=time)
    return np.array(table.interpolate("index", limit_direction="both"), order="C")


# -- the position of the inertial sensors, which columns state


def sensor_position(table: pd.DataFrame) -> Matrix:
    """Return the position of the inertial sensors (n, 3) [m] by its columns, NaN where it is unknown.

    Two of three coordinates state nothing. Raises ValueError if one is infinite.
    """
    position = numeric(table.reindex(columns=list(SENSOR_POSITION)), SENSOR_POSITION)
    if np.isinf(position).any():
        raise ValueError(
            f"Got infinite values in {SENSOR_POSITION}, but expected metres from the centre of gravity."
        )
    is_whole = np.isfinite(position).all(axis=1, keepdims=True)
    return np.where(is_whole, position, np.nan)


def with_sensor_position(table: pd.DataFrame, aircraft: Any) -> pd.DataFrame:
    """Return flights with the position of the aircraft's inertial sensors, where they do not state theirs.

    Raises ValueError if they state one that is too far from the centre of gravity.
    """
    if aircraft is None:
        return table
    stated = sensor_position(table)
    check_distance("sensor_position", stated, aircraft.span)
    if aircraft.sensor_position is None:
        return table
    position = np.where(np.isfinite(stated), stated, aircraft.sensor_position)
    return with_sensors_at(table, position)


def with_sensors_at(table: pd.DataFrame, position: Array) -> pd.DataFrame:
    """Return the table with the position of the inertial sensors, (3,) or (n, 3) [m]."""
    return table.assign(**by_name(SENSOR_POSITION, position))


# -- checks of tables, names and numbers


def check_table(table: object, *, what: str = "flight") -> pd.DataFrame:
    """Return a DataFrame with unique column names and at least one row; raise TypeError or ValueError at any other."""
    if not isinstance(table, pd.DataFrame):
        raise TypeError(
            f"Got {type(table)} for {what}, but expected a pandas DataFrame with named columns (one row "
            f"per sample): build one with skdgp.io.read_flight or pandas.DataFrame, or convert another "
            f"library's with its to_pandas(). set_output must not ask steps for polars."
        )
    if len(table) == 0:
        raise ValueError(f"Got {what} with no rows, but expected at least one sample.")
    twice = table.columns[table.columns.duplicated()].unique().tolist()
    if twice:
        raise ValueError(
            f"Got {what} with repeated columns {twice}, but expected each name once: drop one."
        )
    return table


def suggestions(names: Iterable[str], available: Collection[str]) -> dict[str, str]:
    """Return by unknown name the nearest name of a flight table that is not there yet.

    >>> suggestions(["ias", "de", "trottle", "voltage"], available=["time", "alpha"])
    {'ias': 'airspeed', 'de': 'elevator', 'trottle': 'throttle'}
    """
    free = [name for name in CHANNELS if name not in available]
    nearest: dict[str, str] = {}
    for unknown in map(str, names):
        word = HEADING_UNIT.sub("", unknown).strip().lower()
        near = [name for name in free if word == name or word in OTHER_NAMES.get(name, "").split()]
        if len(word) > 4:
            near += get_close_matches(word, free, n=1, cutoff=0.87)
        if near and near[0] not in nearest.values():
            nearest[unknown] = near[0]
    return nearest


def unknown_columns_message(names: Collection[str], available: Collection[str]) -> str:
    """Return one line on columns of no known name: suggestions, then the others.

    >>> unknown_columns_message(["de", "voltage"], available=["time", "alpha"])
    "'de' (did you mean 'elevator' [rad]?), voltage"
    """
    near = suggestions(names, available)
    hints = []
    for name, channel in near.items():
        unit = CHANNELS[channel]
        meant = f"{channel!r} [{unit}]" if unit else f"{channel!r}"
        hints.append(f"{name!r} (did you mean {meant}?)")
    unlike = [name for name in names if name not in near]
    if unlike:
        hints.append(shortened(unlike, MOST_NAMES))
    return ", ".join(hints)


def unknown_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns of a table whose names are none of a flight table, nor of simulated truth."""
    names = map(str, table.columns)
    return [name for name in names if name.removesuffix(TRUTH_SUFFIX) not in CHANNELS]


def check_columns(table: pd.DataFrame, needed: Iterable[str], *, what: str = "flight") -> None:
    """Raise a ValueError that names the columns of ``needed`` that ``table`` lacks, and the nearest ones."""
    lacking = _lacking(needed, [str(column) for column in table.columns])
    if not lacking:
        return
    if what == "flight" and "flight" in table:
        names = table["flight"].astype(str).unique()
        if len(names) == 1:
            what = f"flight {names.item()!r}"
    remedies = dict.fromkeys(text for name, text in REMEDIES.items() if f"'{name}'" in lacking)
    raise ValueError(
        f"The {what} lacks the columns {lacking}. Rename or compute them; docs/notation.md lists "
        f"every name with its unit.{''.join(remedies)}"
    )


def check_spelling(table: pd.DataFrame, names: Iterable[str]) -> None:
    """Raise a ValueError if a table lacks one of the names, and a column of no known name seems to be it."""
    meant = suggestions(unknown_columns(table), table.columns).values()
    check_columns(table, [name for name in names if name in meant])


def check_names(needed: Iterable[str], available: Iterable[str], what: str) -> None:
    """Raise a ValueError that names what ``available`` lacks of the ``needed`` names, and the nearest ones."""
    names = [str(name) for name in available]
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
    objects = np.ravel(np.array(values, dtype=object))
    if any(isinstance(value, bool) for value in objects):
        return np.array(np.nan)
    return array


def check_number(
    name: str, value: object, least: float = 0.0, *, is_open: bool = True, unit: str = ""
) -> float:
    """Return a finite number above ``least``, or from it on if not ``is_open``; raise ValueError at another."""
    number = as_floats(value)
    if number.shape == ():
        is_inside = number > least if is_open else number >= least
        if is_inside and number < np.inf:
            return float(number)
    bound = "a finite number"
    if least > -np.inf:
        bound = f"a number {'>' if is_open else '>='} {least:g}"
    if unit:
        bound += f" [{unit}]"
    raise ValueError(f"Got {name}={value!r}, but expected {bound}.")


def check_full_deflections(
    full: object, known: Iterable[str], units: Mapping[str, str] = CHANNELS
) -> dict[str, float]:
    """Return the values at full output of some of the ``known`` controls, above zero; raise ValueError at others.

    Of a surface in rad a right angle is the most.
    """
    if not isinstance(full, Mapping):
        raise ValueError(
            f"Got full deflections {full!r}, but expected deflections by name: {{control: value}}."
        )
    known = [*known]
    unknown = _lacking(full, known)
    if unknown:
        raise ValueError(
            f"Got a full deflection of {unknown}, but expected some of {known}: use these names."
        )
    values = {}
    for name, value in full.items():
        unit = units.get(name, "")
        values[name] = check_number(f"full deflection of the {name}", value, unit=unit)
        if unit == "rad" and values[name] > np.pi / 2:
            raise ValueError(
                f"Got a full deflection of the {name} of {value:g} rad, but expected at most {np.pi / 2:.3g}: "
                "radians, not degrees."
            )
    return values


def check_distance(name: str, positions: Array, span: float) -> None:
    """Raise ValueError if a position (n, 3) is too far from the centre of gravity."""
    distance = np.nan_to_num(np.linalg.norm(positions, axis=1))
    if distance.max(initial=0.0) > FARTHEST * span:
        farthest = positions[distance.argmax()].tolist()
        raise ValueError(
            f"Got {name} {farthest}, but expected metres: it is farther from the centre of gravity than "
            f"{FARTHEST:g} spans of {span:g} m."
        )


def check_numbers(name: str, values: object, *sizes: int, unit: str = "") -> Array:
    """Return finite numbers (n,), n one of the ``sizes``; raise ValueError at anything else."""
    array = as_floats(values)
    is_vector = array.ndim == 1 and len(array) in sizes
    if not is_vector or not np.isfinite(array).all():
        count = " to ".join(map(str, sorted({sizes[0], sizes[-1]})))
        plural = "s" if sizes[-1] > 1 else ""
        suffix = f" [{unit}]" if unit else ""
        raise ValueError(
            f"Got {name}={values!r}, but expected {count} finite number{plural}{suffix}."
        )
    return array


def _lacking(needed: Iterable[str], names: list[str]) -> str:
    """Return the missing names, each with the nearest one there is; empty if none is missing."""
    unknown = [name for name in names if name not in CHANNELS]
    meant = {channel: name for name, channel in suggestions(unknown, names).items()}
    hints = []
    for name in dict.fromkeys(needed):
        if name not in names:
            hint = repr(name)
            near = [meant[name]] if name in meant else get_close_matches(name, names, 1, 0.75)
            if near:
                hint += f" (nearest: {near[0]!r})"
            hints.append(hint)
    return ", ".join(hints)
