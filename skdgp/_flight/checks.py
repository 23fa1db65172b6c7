"""Validation of tables, names of columns, and numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches

import numpy as np
import pandas as pd

from skdgp._compute.findings import shortened
from skdgp._compute.typing import Array
from skdgp._flight.channels import ALL_SURFACES, CHANNELS, HIGH_LIFT, MIXED, TRUTH_SUFFIX

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
        " FlightSmoother(derivatives=['alpha', 'beta', 'p', 'q', 'r']) before this step adds rates of change.",
    ),
    **dict.fromkeys(
        MIXED, " ElevonSplitter() before this step makes elevator and aileron of elevons."
    ),
    "density": " skdgp.dynamics.standard_density(altitude) is the density of the standard atmosphere.",
}
MOST_NAMES = 8  # unknown columns that a message names
HEADING_UNIT = re.compile(
    r"[\[(].*|_(deg|rad|dps|(deg|rad)_?s|mps|m_s|ms|kmh|knots|kt|g|m|s)$", re.IGNORECASE
)


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
        unit = CHANNELS[channel].unit
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


def check_full_deflection(name: str, value: object, unit: str = "") -> float:
    """Return the value of a control at full output, which is above zero; raise ValueError at others.

    The unit of surfaces is by default rad, and a right angle is the most.
    """
    if not unit and name in (*ALL_SURFACES, *HIGH_LIFT):
        unit = "rad"
    number = check_number(f"full deflection of the {name}", value, unit=unit)
    if unit == "rad" and number > np.pi / 2:
        raise ValueError(
            f"Got a full deflection of the {name} of {number:g} rad, but expected at most {np.pi / 2:.3g}: "
            "radians, not degrees."
        )
    return number


def check_numbers(name: str, values: object, *sizes: int, unit: str = "") -> Array:
    """Return finite numbers (n,), n one of the ``sizes``; raise ValueError at anything else."""
    array = as_floats(values)
    is_vector = array.ndim == 1 and len(array) in sizes
    if not is_vector or not np.isfinite(array).all():
        count = " to ".join(map(str, sorted({sizes[0], sizes[-1]})))
        suffix = f" [{unit}]" if unit else ""
        raise ValueError(f"Got {name}={values!r}, but expected {count} finite numbers{suffix}.")
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
