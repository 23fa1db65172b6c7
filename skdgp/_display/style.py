"""Style of all pictures: colours, symbols, units, legends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any

import numpy as np

from skdgp._compute.typing import Vector
from skdgp._flight.channels import CHANNELS

# Okabe & Ito (2008), Color Universal Design.
PALETTE = {
    "blue": "#0072B2", "vermillion": "#D55E00", "green": "#009E73", "purple": "#CC79A7", "sky": "#56B4E9",
    "orange": "#E69F00", "yellow": "#F0E442", "grey": "#8A8A8A",
}  # fmt: skip
ROLES = {
    "measured": PALETTE["grey"],
    "mean": PALETTE["blue"],
    "band": PALETTE["sky"],
    "truth": PALETTE["vermillion"],
}

_SYMBOLS = {
    **{name: f"C_{name[1:]}" for name in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")},
    **{name: rf"\{name}" for name in ("alpha", "beta", "phi", "theta", "psi")},
    **{f"{name}_dot": rf"\dot{{\{name}}}" for name in ("alpha", "beta")},
    **{name: name for name in "pqruvw"},
    **{f"{name}_dot": rf"\dot{{{name}}}" for name in "pqr"},
    **{f"{name}_hat": rf"\hat{{{name}}}" for name in "pqr"},
    **{f"a{axis}": f"a_{axis}" for axis in "xyz"},
    **{f"v_{way}": f"v_{way[0].upper()}" for way in ("north", "east", "down")},
    "airspeed": "V",
    "altitude": "h",
}
_UNITS: ContextVar[Mapping[str, str]] = ContextVar("_UNITS", default=MappingProxyType({}))


@contextmanager
def units_shown(units: Mapping[str, str]) -> Iterator[None]:
    """Show columns in these units inside the ``with`` block, such as surfaces in parts of their full throw."""
    token = _UNITS.set(units)
    try:
        yield
    finally:
        _UNITS.reset(token)


def display_unit(name: str) -> tuple[float, str]:
    """Return the factor from SI to the displayed unit, and that unit. Only pictures use degrees."""
    if name in _UNITS.get():
        return 1.0, _UNITS.get()[name]
    unit = CHANNELS[name].unit if name in CHANNELS else ""
    if unit.startswith("rad") and name != "propeller_speed":
        return float(np.rad2deg(1.0)), unit.replace("rad", "deg")
    return 1.0, unit


def symbol(name: str) -> str:
    """Return the symbol of a column for a label, or its name in words."""
    return f"${_SYMBOLS[name]}$" if name in _SYMBOLS else plain(name.replace("_", " "))


def plain(name: str) -> str:
    """Return ``name`` escaped for matplotlib: no mathematics, no hidden label."""
    return (f" {name}" if name.startswith("_") else name).replace("$", r"\$")


def axis_label(name: str) -> str:
    """Return symbol and unit, such as ``$p$ [deg/s]``."""
    unit = display_unit(name)[1]
    return f"{symbol(name)} [{unit}]" if unit else symbol(name)


def tidy(ax: Any) -> None:
    """Remove two spines and draw a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, linewidth=0.4, alpha=0.35)
    ax.set_axisbelow(True)
    ax.margins(x=0)


def draw_curve(
    ax: Any,
    x: Vector,
    mean: Vector,
    std: Vector,
    label: str,
    color: str = ROLES["mean"],
    band: str = ROLES["band"],
) -> None:
    """Draw a line with its 95 % band."""
    half = 1.96 * std
    style = {"color": band, "alpha": 0.35, "linewidth": 0}
    ax.fill_between(x, mean - half, mean + half, label="95 % band", **style)
    ax.plot(x, mean, color=color, label=label)


def legend_above(ax: Any) -> None:
    """Draw the legend above the axes, where it covers no data."""
    if ax.get_legend_handles_labels()[0] and ax.get_legend() is None:
        style = {"borderaxespad": 0.2, "handlelength": 1.6, "columnspacing": 1.4}
        place = {"loc": "lower left", "bbox_to_anchor": (0, 1)}
        ax.legend(ncols=4, frameon=False, fontsize="small", **place, **style)
        ax.get_legend().set_in_layout(False)  # it may be wider than its panel
        ax.set_title(" ")  # room for it
