"""Style of all pictures: colours, symbols, units, axes."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import CHANNELS, COEFFICIENTS, LONGITUDINAL

# Okabe & Ito (2008), Color Universal Design.
PALETTE = {
    "blue": "#0072B2",
    "vermillion": "#D55E00",
    "green": "#009E73",
    "purple": "#CC79A7",
    "sky": "#56B4E9",
    "orange": "#E69F00",
    "yellow": "#F0E442",
    "grey": "#8A8A8A",
}
CYCLE = tuple(PALETTE[name] for name in ("blue", "vermillion", "green", "purple", "sky", "orange"))

QUIET = "#5F6973"
"""Of words that explain: grey, and yet readable on white (contrast 5.6, WCAG 2.1 asks for 4.5)."""
MARKERS = ("o", "s", "^", "D", "v", "P")
"""Beside the colours of ``CYCLE``, for who does not tell them apart."""

ROLES = {"measured": "#333333", "mean": PALETTE["blue"], "band": PALETTE["sky"], "truth": PALETTE["vermillion"]}

_SYMBOLS = {
    **{name: f"C_{name[1:]}" for name in ("CX", "CY", "CZ", "Cl", "Cm", "Cn")},
    **{name: rf"\{name}" for name in ("alpha", "beta", "phi", "theta", "psi")},
    **{name: rf"\dot{{{name[0]}}}" for name in ("p_dot", "q_dot", "r_dot")},
    **{name: rf"\dot{{\{name[:-4]}}}" for name in ("alpha_dot", "beta_dot")},
    **{name: name for name in ("p", "q", "r", "u", "v", "w")},
    **{f"{name}_hat": rf"\hat{{{name}}}" for name in ("p", "q", "r")},
    **{name: f"a_{name[1]}" for name in ("ax", "ay", "az")},
    "v_north": "v_N",
    "v_east": "v_E",
    "v_down": "v_D",
    "airspeed": "V",
    "altitude": "h",
}


def check_matplotlib(who: str) -> None:
    """Raise an ImportError that names the extra to install when matplotlib is absent."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            f'{who} draws with matplotlib, which is not installed: run pip install "skdgp[plot]".'
        ) from error


def display_unit(name: str) -> tuple[float, str]:
    """Return the factor from SI to the unit shown, and that unit: pictures, and only they, use degrees."""
    unit = CHANNELS[name].unit if name in CHANNELS else ""
    if unit.startswith("rad") and name != "propeller_speed":
        return float(np.rad2deg(1.0)), unit.replace("rad", "deg")
    return 1.0, unit


def symbol(name: str) -> str:
    """Return the symbol of a column for a label, or its name in words."""
    return f"${_SYMBOLS[name]}$" if name in _SYMBOLS else plain(name.replace("_", " "))


def plain(name: str) -> str:
    """Return ``name`` so that matplotlib takes it as it stands: no mathematics, no hidden label."""
    return (f" {name}" if name.startswith("_") else name).replace("$", r"\$")


def axis_label(name: str) -> str:
    """Return symbol and unit, such as ``$p$ [deg/s]``."""
    unit = display_unit(name)[1]
    return f"{symbol(name)} [{unit}]" if unit else symbol(name)


def dashes(name: str):
    """Return the line style that tells an output beside its colour: lateral coefficients dashed, others solid."""
    return "-" if name in LONGITUDINAL or name not in COEFFICIENTS else (0, (4, 1.5))


def panels(ax, n_rows: int, n_cols: int, *, figsize: tuple[float, float], **subplots) -> np.ndarray:
    """Return an ``(n_rows, n_cols)`` array of axes.

    ``ax`` is None (a new pyplot figure), a Figure or SubFigure (filled), an array of as many axes as panels,
    or one Axes, which is divided when there are several panels.
    """
    from matplotlib.axes import Axes

    shape = (n_rows, n_cols)
    if ax is None:
        import matplotlib.pyplot as plt

        return plt.subplots(*shape, figsize=figsize, layout="constrained", squeeze=False, **subplots)[1]
    if hasattr(ax, "subplots"):
        return ax.subplots(*shape, squeeze=False, **subplots)
    if isinstance(ax, Axes):
        return np.array([[ax]]) if shape == (1, 1) else _divide(ax, shape, subplots)
    given = np.asarray(ax, dtype=object)
    if given.size != n_rows * n_cols or not all(isinstance(one, Axes) for one in given.flat):
        raise ValueError(
            f"Got {given.size} axes, but expected {n_rows * n_cols} (or one Axes, a Figure, or None): "
            f"use fig, axes = plt.subplots({n_rows}, {n_cols})."
        )
    return given.reshape(shape)


def _divide(ax, shape: tuple[int, int], subplots: dict) -> np.ndarray:
    ax.set_axis_off()
    spec = ax.get_subplotspec()
    if spec is None:
        raise ValueError(
            f"Got one free-standing Axes for {shape[0]} x {shape[1]} panels, but expected one made by subplots, "
            f"which can be divided: give a Figure instead."
        )
    return spec.subgridspec(*shape).subplots(squeeze=False, **subplots)


def tidy(ax) -> None:
    """Take away what carries no information: two spines, heavy ticks; leave a faint grid."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, linewidth=0.4, alpha=0.35)
    ax.set_axisbelow(True)
    ax.margins(x=0)


def scale_beside(ax, artist, label: str, **options):
    """Draw the colour scale of ``artist`` as tall as the axes, beside them."""
    # An inset follows axes of fixed aspect; room stolen from their parent would not.
    bar = ax.figure.colorbar(artist, cax=ax.inset_axes([1.03, 0.0, 0.035, 1.0]), label=label, **options)
    bar.outline.set_visible(False)
    return bar


def legend_above(ax, handles=None) -> None:
    """Put the legend over the axes, where it covers no data."""
    handles = ax.get_legend_handles_labels()[0] if handles is None else handles
    if handles:
        ax.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0, 1),
            ncols=4,
            frameon=False,
            fontsize="small",
            borderaxespad=0.2,
            handlelength=1.6,
            columnspacing=1.4,
        )
