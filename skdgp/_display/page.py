"""How values look: text, numbers, tables and pictures (SVG) as HTML, colours, symbols and units of all pictures.

Text from outside is escaped here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from html import escape
from importlib.resources import files
from io import StringIO
from string import Template
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import numpy as np

from skdgp._compute.typing import Vector
from skdgp._flight.channels import CHANNELS, COEFFICIENTS

THIN = "\u202f"
DASH = "–"
STYLE = files("skdgp._display").joinpath("page.css").read_text(encoding="utf-8")
PAGE = Template(files("skdgp._display").joinpath("page.html").read_text(encoding="utf-8"))
WIDTH = 4.6  # width of a panel [in]: half a desktop page, or a phone with letters still readable
MARGINS = (0.67, 0.14, 0.4, 0.16)  # left, right, below and above the axes [in]
FONTS = "Helvetica, Roboto, 'Liberation Sans', Arial, sans-serif"
_PICTURE_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "skdgp", "font.size": 8, "axes.linewidth": 0.6,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 3, "ytick.major.size": 3,
    "figure.facecolor": "none", "axes.facecolor": "none",
}  # fmt: skip


def text(value: object) -> str:
    """Return ``value`` as escaped text."""
    return escape(str(value))


def number(value: float, form: str = ".2f") -> str:
    """Return a number with a true minus, a dash for NaN, and the sign for infinity."""
    if value is None or np.isnan(value):
        return DASH
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{float(value):z{form}}".rstrip(".").replace("-", "−")


def percent(value: float, form: str = ".1f") -> str:
    """Return a fraction as a percentage without its sign."""
    return number(None if value is None else 100 * value, form)


def lowered(name: str) -> str:
    """Return a coefficient's name with its index lowered."""
    return f"<i>C</i><sub>{name[1:]}</sub>" if name in COEFFICIENTS else text(name)


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str, classes: str = ""
) -> str:
    """Return a table of ready HTML cells: the first of each row names it; a row of one cell heads a group."""
    heads = "".join(f'<th scope="col">{cell}</th>' for cell in head)
    body = ""
    for first, *cells_of_row in rows:
        cells = "".join(f"<td>{cell}</td>" for cell in cells_of_row)
        group = f'<tr class="group"><th colspan="{len(head)}" scope="colgroup">{first}</th></tr>'
        body += f'<tr><th scope="row">{first}</th>{cells}</tr>' if cells_of_row else group
    content = f"<caption>{caption}</caption><thead><tr>{heads}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="{classes}">{content}</table></div>'


def section(title: str, *parts: str, classes: str = "") -> str:
    """Return a section of ready HTML, empty without parts."""
    body = "".join(parts)
    kind = f' class="{classes}"' if classes else ""
    return f"<section{kind}><h2>{title}</h2>{body}</section>" if body else ""


def render_page(kind: str, title: str, meta: str, body: str, colophon: str) -> str:
    """Return the document; title and kind are text, the rest is HTML."""
    return PAGE.substitute(
        kind=text(kind), title=text(title), meta=meta, body=body, colophon=colophon, style=STYLE
    )


def picture(draw: Callable, *, label: str, size: tuple[float, float]) -> str:
    """Return an image, the SVG drawn by ``draw(figure)``; a reader can save it as a file.

    ``label`` is read aloud; ``size`` is width and height [in].
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    width, height = size
    left, right, below, above = MARGINS
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_PICTURE_STYLE)
        figure = Figure(figsize=size)
        canvas = FigureCanvasSVG(figure)
        figure.subplots_adjust(left / width, below / height, 1 - right / width, 1 - above / height)
        draw(figure)
        file = StringIO()
        canvas.print_svg(file, metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    source = quote(_compact(file.getvalue()), safe=" /:;=,.()'!*@$&?[]|+")
    return f'<img alt="{escape(label)}" src="data:image/svg+xml,{source}">'


def _compact(svg: str) -> str:
    """Return a picture without comments, with fonts of the reader's machine and short coordinates."""
    svg = re.sub(r"<!.*?>|<\?.*?>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"font-family: [^;\"]*", f"font-family: {FONTS}", svg)
    svg = re.sub(r"\s*\n\s*", " ", svg)
    return re.sub(r'\b(d|x|y|transform)="([^"]*)"', _shortened, svg)


def _shortened(match: re.Match) -> str:
    """Return an attribute with coordinates rounded to what a screen resolves, without letters that SVG implies."""
    name, value = match.groups()
    digits = 1 if len(value) > 1000 else 2
    value = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}", value)
    return f'{name}="{value if set("CQ") & set(value) else value.replace(" L ", " ")}"'


# -- style of all pictures: colours, symbols, units, legends
# -------------------------------------------------------------------------------------

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
    unit = CHANNELS[channel].unit if channel in CHANNELS else ""
    if unit.startswith("rad") and name != "propeller_speed":
        return float(np.rad2deg(1.0)), unit.replace("rad", "deg")
    return 1.0, unit


def heading(name: str) -> str:
    """Return a column's name in words, with its unit beneath."""
    unit = display_unit(name)[1]
    return text(name.replace("_", " ")) + (f"<br>[{unit}]" if unit else "")


def shown(name: str, value: float) -> str:
    """Return a value of a column in the displayed unit, a dash where there is none."""
    factor, unit = display_unit(name)
    return number(factor * value, ".1f" if unit else ".2f") if np.isfinite(value) else DASH


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
    ax.fill_between(
        x, mean - half, mean + half, label="95 % band", color=band, alpha=0.35, linewidth=0
    )
    ax.plot(x, mean, color=color, label=label)


def legend_above(ax: Any) -> None:
    """Draw the legend above the axes, where it covers no data."""
    if ax.get_legend_handles_labels()[0] and ax.get_legend() is None:
        ax.legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=4, frameon=False, fontsize="small",
            borderaxespad=0.2, handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip
        ax.get_legend().set_in_layout(False)  # it may be wider than its panel
        ax.set_title(" ")  # room for it
