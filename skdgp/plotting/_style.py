"""Style of all figures: colours, symbols and units of columns, legends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any

import numpy as np

from skdgp._flight.channels import CHANNELS

# Okabe & Ito (2008), Color Universal Design.
ROLES = {
    "measured": "#8A8A8A",
    "mean": "#0072B2",
    "band": "#56B4E9",
    "truth": "#D55E00",
    "beyond": "#E69F00",
}

_SYMBOLS = {
    "CX": "C_X", "CY": "C_Y", "CZ": "C_Z", "Cl": "C_l", "Cm": "C_m",
    "Cn": "C_n", "alpha": r"\alpha", "beta": r"\beta", "phi": r"\phi", "theta": r"\theta",
    "psi": r"\psi", "alpha_dot": r"\dot{\alpha}", "beta_dot": r"\dot{\beta}", "p": "p", "q": "q",
    "r": "r", "u": "u", "v": "v", "w": "w", "p_dot": r"\dot{p}",
    "q_dot": r"\dot{q}", "r_dot": r"\dot{r}", "p_hat": r"\hat{p}", "q_hat": r"\hat{q}", "r_hat": r"\hat{r}",
    "ax": "a_x", "ay": "a_y", "az": "a_z", "v_north": "v_N", "v_east": "v_E",
    "v_down": "v_D", "airspeed": "V", "altitude": "h",
}  # fmt: skip
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
    channel = "phi" if name == "bank" else name
    unit = CHANNELS.get(channel, "")
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


def legend_above(ax: Any) -> None:
    """Draw the legend above the axes, where it covers no data, right of the multiplier of the axis."""
    if ax.get_legend_handles_labels()[0] and ax.get_legend() is None:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0.15, 1), ncols=4, frameon=False, fontsize="small",
            borderaxespad=0.2, handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip
        ax.get_legend().set_in_layout(False)  # it may be wider than its panel
        ax.set_title(" ")  # room for it
