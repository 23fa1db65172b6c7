"""What all readers of tables check: size, names, units, magnitudes; FlightReadError, which names the file."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import pandas as pd

from skdgp._flight.channels import ALL_SURFACES, CHANNELS, RATES, SPECIFIC_FORCE, TRUTH_SUFFIX
from skdgp._flight.checks import ANGLE_NOISE, GYROS, LARGEST_ANGLE, is_unwrapped, warn_of_commands

MOST_COLUMNS = 10_000
ROOM, ROOM_PER_BYTE = (
    2**28,
    100,
)  # bytes that any file may take when unpacked, and bytes more for each byte of it
TO_SI = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6),
    "rad": ("rad", 1.0), "deg": ("rad", np.pi / 180),
    "rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", np.pi / 180), "rpm": ("rad/s", np.pi / 30),
    "rad/s^2": ("rad/s^2", 1.0), "deg/s^2": ("rad/s^2", np.pi / 180),
    "m": ("m", 1.0), "ft": ("m", 0.3048),
    "m/s": ("m/s", 1.0), "kt": ("m/s", 1852 / 3600), "km/h": ("m/s", 1 / 3.6), "ft/s": ("m/s", 0.3048),
    "m/s^2": ("m/s^2", 1.0), "g": ("m/s^2", 9.80665),
    "kg/m^3": ("kg/m^3", 1.0), "N": ("N", 1.0), "N m": ("N m", 1.0), "": ("", 1.0), "%": ("", 0.01),
}  # fmt: skip
SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "dps": "deg/s", "sec": "s", "µs": "us", "-": "",
    "1": "", "kts": "kt", "knots": "kt", "m/s2": "m/s^2", "m/s²": "m/s^2", "rad/s2": "rad/s^2", "rad/s²": "rad/s^2",
    "deg/s2": "deg/s^2", "°/s²": "deg/s^2", "kg/m3": "kg/m^3", "kg/m³": "kg/m^3", "nm": "N m", "n": "N",
}  # fmt: skip

# Above these the 99th percentile of a flight is not in radians.
LIMITS = {
    **dict.fromkeys(("alpha", "beta", "theta"), 1.7),
    **dict.fromkeys(ALL_SURFACES, 1.6),
    **dict.fromkeys(RATES, 20.0),
}
LONGEST_STEP = 5.0  # s
LARGEST_MIDDLE = (
    30.0  # median of the size of an angle in degrees, but for roll and heading; a guess
)


class FlightReadError(ValueError):
    """A file cannot be read as a flight; its path stands before the message."""

    path: str | os.PathLike | None = None

    def __str__(self) -> str:
        return super().__str__() if self.path is None else f"{self.path}: {super().__str__()}"


@contextmanager
def reading(path: str | os.PathLike) -> Iterator[None]:
    """Name the file in a FlightReadError of the block."""
    try:
        yield
    except FlightReadError as error:
        error.path = path
        raise


def check_width(n_columns: int) -> None:
    """Raise a FlightReadError if a table has too many columns."""
    if n_columns > MOST_COLUMNS:
        raise FlightReadError(
            f"Got {n_columns} columns, but expected at most {MOST_COLUMNS}: keep those of the "
            f"flight, with a row for "
            "each sample."
        )


def room_for(n_bytes: int) -> int:
    """Return how many bytes a file of n_bytes may take when unpacked."""
    return ROOM + ROOM_PER_BYTE * n_bytes


def check_room(needed: int, room: int) -> None:
    """Raise a FlightReadError if what is unpacked takes more bytes than there is room for."""
    if needed > room:
        raise FlightReadError(
            f"Got a file that takes {needed / 2**20:.0f} MiB when unpacked, but expected at most "
            f"{room / 2**20:.0f} "
            f"MiB (256 MiB and {ROOM_PER_BYTE} times its size): write each flight into a file of "
            f"its own."
        )


def base_name(column: str) -> str:
    """Return the name of the vocabulary of a column of simulated truth."""
    return column.removesuffix(TRUTH_SUFFIX)


def known_unit(text: str) -> str | None:
    """Return a unit as this module spells it, or None."""
    text = text.strip()
    text = SPELLINGS.get(text.lower(), text)
    return next((unit for unit in TO_SI if unit.lower() == text.lower()), None)


def check_names(names: Iterable[str]) -> None:
    """Raise a FlightReadError if a column name stands twice."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise FlightReadError(
            f"Got columns {twice} repeated, but expected each name once: drop one."
        )


def to_floats(column: pd.Series) -> np.ndarray:
    """Return a column as floats, whatever type holds its numbers; raise FlightReadError for a row that is none."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        column = pd.Series(np.asarray(column), name=column.name)
    if pd.api.types.is_numeric_dtype(column):
        return column.to_numpy(dtype=float, na_value=np.nan)
    timed = pd.api.types.is_datetime64_any_dtype(column) or pd.api.types.is_timedelta64_dtype(
        column
    )
    numbers = pd.Series(np.nan, column.index) if timed else pd.to_numeric(column, errors="coerce")
    values = numbers.to_numpy(dtype=float, na_value=np.nan)
    bad = np.flatnonzero(np.isnan(values) & column.notna().to_numpy())
    if bad.size:
        raise FlightReadError(
            f"Got {column.iloc[bad[0]]!r} in column {column.name!r} at row {bad[0]} ({bad.size} "
            f"rows are not numbers), "
            f"but expected numbers [{CHANNELS[base_name(str(column.name))].unit}]: leave missing "
            f"values empty, and "
            "write no separators of thousands."
        )
    return values


def to_si(table: pd.DataFrame, units: dict[str, str]) -> pd.DataFrame:
    """Convert columns whose unit the file states; raise FlightReadError for a unit of another quantity."""
    converted = {}
    for name, text in units.items():
        expected = CHANNELS[base_name(name)].unit
        quantity, factor = TO_SI.get(known_unit(text) or "unknown", ("unknown", 1.0))
        if quantity != expected:
            fitting = [unit for unit, (si, _) in TO_SI.items() if si == expected]
            raise FlightReadError(
                f"Got unit {text!r} for column {name!r}, but expected one of {fitting}."
            )
        if factor != 1.0:
            converted[name] = to_floats(table[name]) * factor
    return table.assign(**converted)


def check_magnitudes(table: pd.DataFrame) -> None:
    """Raise FlightReadError if the numbers of a column are in degrees, per cent, g or milliseconds.

    Warn of surfaces that are probably commands from -1 to 1.
    """
    limits = LIMITS | {name: LARGEST_ANGLE[name] + ANGLE_NOISE for name in GYROS}
    large = {name: _typical_maximum(table, name) for name in limits if name in table}
    degrees = {
        name: round(most, 1)
        for name, most in large.items()
        if most > limits[name] and not (name in GYROS and is_unwrapped(table, name))
    }
    middles = {name: float(np.nanmedian(np.abs(table[name]))) for name in degrees}
    shifted = {name: round(most, 1) for name, most in middles.items() if most > LARGEST_MIDDLE}
    if shifted.keys() - GYROS.keys():
        raise FlightReadError(
            f"Got {shifted} as medians of angles, more than an aircraft flies at even in degrees: "
            f"these look like the values of another column. Check that each name in the header "
            f"stands above its own values."
        )
    if degrees:
        raise FlightReadError(
            f"Got magnitudes up to {degrees} (99th percentile), but expected radians and radians "
            f"per second: these "
            "look like degrees. Convert them with numpy.deg2rad, or say the unit in the header, "
            "as in 'alpha [deg]'."
            + " Roll and heading in radians can be wrapped by numpy.angle(numpy.exp(1j * psi))."
            * bool(degrees.keys() & GYROS)
        )
    if "throttle" in table and (most := _typical_maximum(table, "throttle")) > 1.5:
        raise FlightReadError(
            f"Got throttle up to {most:g}, but expected 0 to 1: divide it by its full range (100 "
            f"for per cent, or "
            "'throttle [%]' in the header)."
        )
    if {*SPECIFIC_FORCE} <= {*table}:
        sizes = np.linalg.norm(table[list(SPECIFIC_FORCE)].to_numpy(float), axis=1)
        sizes = sizes[np.isfinite(sizes)]
        force = float(np.median(sizes)) if sizes.size else np.nan
        if 0.5 < force < 2.0:
            raise FlightReadError(
                f"Got a specific force ax, ay, az of {force:.3g} (median magnitude), but expected "
                f"near 9.8 m/s^2: this "
                "looks like g. Multiply by 9.80665, or say the unit in the header, as in 'az [g]'."
            )
    warn_of_commands(table)
    step = np.median(np.diff(table["time"].to_numpy(float))) if len(table) > 1 else 0.0
    if step > LONGEST_STEP:
        raise FlightReadError(
            f"Got a median time step of {step:g}, but expected seconds: this looks like "
            f"milliseconds or microseconds. "
            "Divide time by 1e3 or 1e6, or say the unit in the header, as in 'time [ms]'."
        )


def _typical_maximum(table, name) -> float:
    values = np.abs(table[name].to_numpy(float))
    values = values[np.isfinite(values)]
    return float(np.percentile(values, 99)) if values.size else 0.0
