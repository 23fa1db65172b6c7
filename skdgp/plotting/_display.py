"""Base of the displays: panels, lines with gaps, and the style of all figures: colours, symbols, units, legends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.statistics import half_width
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import CHANNELS

BAND = half_width(0.95)  # in standard deviations
# Okabe & Ito (2008), Color Universal Design.
ROLES = {
    "measured": "#8A8A8A",
    "mean": "#0072B2",
    "band": "#56B4E9",
    "truth": "#D55E00",
}

# Without accents: as text of an SVG they are drawn beside their letter
_SYMBOLS = {
    "CX": "C_X", "CY": "C_Y", "CZ": "C_Z", "Cl": "C_l", "Cm": "C_m",
    "Cn": "C_n", "alpha": r"\alpha", "beta": r"\beta", "phi": r"\phi", "theta": r"\theta",
    "psi": r"\psi", "alpha_dot": r"d\alpha/dt", "beta_dot": r"d\beta/dt", "p": "p", "q": "q",
    "r": "r", "u": "u", "v": "v", "w": "w", "p_dot": "dp/dt",
    "q_dot": "dq/dt", "r_dot": "dr/dt", "p_hat": r"p\,b/2V", "q_hat": r"q\,c/2V", "r_hat": r"r\,b/2V",
    "ax": "a_x", "ay": "a_y", "az": "a_z", "v_north": "v_N", "v_east": "v_E",
    "v_down": "v_D", "airspeed": "V", "altitude": "h",
}  # fmt: skip
_UNITS: ContextVar[Mapping[str, str]] = ContextVar("_UNITS", default=MappingProxyType({}))


class Display(ABC):
    """Base of displays: ``keys`` name the panels, and ``draw`` draws a panel."""

    axes_: np.ndarray
    figure_: Any
    size: tuple[float, float] = (4.6, 1.5)  # of a panel [in]
    by_column = False  # whether panels follow each other column by column
    sharey: Any = False  # whether panels have one vertical scale

    @property
    @abstractmethod
    def keys(self) -> Sequence:
        """The keys of all panels."""

    @property
    def n_columns(self) -> int:
        """Number of columns of panels."""
        return 1 if len(self.keys) <= 3 else 2

    @property
    def n_rows(self) -> int:
        """Number of rows of panels."""
        return -(-len(self.keys) // self.n_columns)

    @property
    def figsize(self) -> tuple[float, float]:
        """Width and height of a figure of all panels [in]."""
        width, height = self.size
        return self.n_columns * width, 1 + self.n_rows * height

    @abstractmethod
    def draw(self, ax: Any, key: Any) -> None:
        """Draw the panel of a key into an Axes."""

    def plot(self, ax: Any = None) -> Self:
        """Draw all panels; for ``ax`` see :mod:`skdgp.plotting`."""
        if ax is False:
            return self
        keys = list(self.keys)
        extra("matplotlib", "plot")
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.figure(figsize=self.figsize, layout="constrained")
        self.figure_ = ax
        self.axes_ = ax.subplots(self.n_rows, self.n_columns, squeeze=False, sharey=self.sharey)
        cells = list(self.axes_.T.flat if self.by_column else self.axes_.flat)
        for cell, key in zip(cells, keys, strict=False):
            tidy(cell)
            self.draw(cell, key)
        for cell in cells[len(keys) :]:
            cell.set_visible(False)
        legend_above(cells[0])
        return self


def segments(time: Vector, values: Array) -> Matrix:
    """Return time and columns of values (n, ...), rows with NaN where a line breaks.

    Rows that are not known are left out. A line breaks at a gap longer than five times the usual step, and when
    time goes back.

    >>> segments(np.array([0.0, 1.0, 2.0, 9.0]), np.array([5.0, 6.0, 7.0, 8.0]))[1]
    array([ 5.,  6.,  7., nan,  8.])
    """
    rows = np.column_stack([time, values])
    rows = rows[np.isfinite(rows).all(axis=1)]
    step = np.diff(rows[:, 0])
    forward = step[step > 0]
    usual = np.median(forward) if forward.size else np.inf
    cut = ~((step > 0) & (step <= 5.0 * usual))
    return np.insert(rows, np.flatnonzero(cut) + 1, np.nan, axis=0).T


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
    unit = CHANNELS.get(name, "")
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
