"""Pictures of a page: SVG with its colours as variables."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from html import escape
from io import StringIO
from typing import Any

from skdgp._display.style import PALETTE, QUIET, ROLES

INK = "#20242a"
WIDTH = 4.6  # width of a panel [in]: half a desktop page, or a phone with letters still readable
POINTS = 72  # units of an SVG in an inch
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "skdgp", "font.size": 8, "axes.linewidth": 0.6,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 3, "ytick.major.size": 3,
    "figure.facecolor": "none", "axes.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}  # fmt: skip

# Colours of the pictures and the page's variables for them, which change with light and dark.
_VARIABLES = {INK: "ink", QUIET: "quiet", "#b0b0b0": "quiet", ROLES["measured"]: "measured"}
_VARIABLES |= {color: name for name, color in PALETTE.items()}
_VARIABLES = {color.lower(): f"var(--{name})" for color, name in _VARIABLES.items()}


def strip(draw: Callable, *, label: str, bottom: bool = True) -> str:
    """Return the SVG of a low panel against time; only the ``bottom`` panel of a column names the axis."""
    above, below = 0.08, 0.4 if bottom else 0.23  # margins [in]
    height = above + 1.1 + below

    def drawn(ax):
        draw(ax)
        ax.yaxis.set_label_coords(-0.14, 0.5)
        if not bottom:
            ax.set_xlabel("")

    margins = (0.145, 0.985, below / height, 1 - above / height)
    return picture(drawn, label=label, size=(WIDTH, height), margins=margins)


def picture(draw: Callable, *, label: str, size: tuple[float, float], margins: tuple, located: bool = False) -> str:
    """Return the SVG of what ``draw(ax)`` draws into one Axes.

    ``label`` is read aloud; ``size`` is width and height [in], ``margins`` are left, right, bottom and top of the Axes
    as parts of these. With ``located`` the attribute ``data-map`` holds "a b c d": data (X, Y) are at a + b X, c + d Y.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        figure = Figure(figsize=size)
        canvas = FigureCanvasSVG(figure)
        figure.subplots_adjust(**dict(zip(("left", "right", "bottom", "top"), margins, strict=True)))
        ax = figure.subplots()
        draw(ax)
        text = StringIO()
        canvas.print_svg(text, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
        (left, low), (right, high) = ax.transData.transform([(0, 0), (1, 1)]) * POINTS / figure.dpi
    place = (left, right - left, size[1] * POINTS - low, low - high)
    return adapt(text.getvalue(), label, f' data-map="{" ".join(f"{v:.7g}" for v in place)}"' if located else "")


def adapt(svg: str, label: str, attributes: str = "") -> str:
    """Return an SVG document as an element of a page: no prolog, variables for colours, unique names."""
    size = re.search(r'viewBox="0 0 [\d.]+ [\d.]+"', svg)[0]  # type: ignore[index]
    body = svg[svg.index(">", svg.index("<svg")) + 1 : svg.rindex("</svg>")]
    body = re.sub(r"<!--.*?-->|<style.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r" font-family: [^;\"]*;?", "", body)
    body = re.sub(r' transform="rotate\(-0 [^"]*"', "", body).replace("xlink:href", "href")
    body = re.sub(r"(stroke|fill): (#[0-9a-f]{6})", _themed, body)
    body = re.sub(r'\b(d|x|y|transform)="([^"]*)"', _shortened, body)
    body = _gathered(re.sub(r"\s*\n\s*", "", _renamed(body, label)))
    name = escape(label)
    return f'<svg {size} role="img" aria-label="{name}"{attributes}>{body}</svg>'


def _themed(match: re.Match) -> str:
    kind, color = match.groups()
    return "stroke: var(--paper)" if match[0] == "stroke: #ffffff" else f"{kind}: {_VARIABLES.get(color, color)}"


def _shortened(match: re.Match) -> str:
    """Return an attribute with coordinates rounded to what a screen resolves, without letters that SVG implies."""
    name, value = match.groups()
    digits = 1 if len(value) > 1000 else 2
    value = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}".rstrip("0").rstrip("."), value)
    value = " ".join(value.split()) if name == "d" else value
    return f'{name}="{value if set("CQ") & set(value) else value.replace(" L ", " ")}"'


def _renamed(body: str, label: str) -> str:
    """Return a body without unused names, the others different from those of other pictures of the page."""
    used = set(re.findall(r"(?:url\(|href=\")#([^\")]+)", body))
    prefix = f"s{zlib.crc32((label + body).encode()):08x}"
    names = {name: f"{prefix}-{k}" for k, name in enumerate(sorted(used))}
    body = re.sub(r' id="([^"]*)"', lambda name: f' id="{names[name[1]]}"' if name[1] in used else "", body)
    return re.sub(r"(url\(|href=\")#([^\")]+)", lambda use: f"{use[1]}#{names[use[2]]}", body)


def _gathered(body: str) -> str:
    """Return a body in which neighbouring marks share their style."""
    several = (
        r'((?:<use href="#[^"]*" x="[^"]*" y="[^"]*")( style="[^"]*")/>(?:<use href="#[^"]*" x="[^"]*" y="[^"]*"\2/>)+)'
    )
    return re.sub(several, lambda marks: f"<g{marks[2]}>{marks[1].replace(marks[2], '')}</g>", body)
