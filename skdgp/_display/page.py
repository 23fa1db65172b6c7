"""Pages: text, numbers, tables, figures and pictures (SVG) as HTML; text from outside is escaped here."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from io import StringIO
from string import Template
from typing import Any
from urllib.parse import quote

import numpy as np

from skdgp._flight.channels import COEFFICIENTS

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


def symbol(name: str) -> str:
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


def render_page(kind: str, title: str, meta: str, body: str, colophon: str) -> str:
    """Return the document; title and kind are text, the rest is HTML."""
    fields = {"kind": text(kind), "title": text(title), "meta": meta, "body": body}
    return PAGE.substitute(fields, colophon=colophon, style=STYLE)


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


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
        nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
        canvas.print_svg(file, metadata=nothing)
    svg = file.getvalue()
    svg = re.sub(r"<!.*?>|<\?.*?>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"font-family: [^;\"]*", f"font-family: {FONTS}", svg)
    svg = re.sub(r'\b(d|x|y|transform)="([^"]*)"', _shortened, re.sub(r"\s*\n\s*", " ", svg))
    source = quote(svg, safe=" /:;=,.()'!*@$&?[]|+")
    return f'<img alt="{escape(label)}" src="data:image/svg+xml,{source}">'


def _shortened(match: re.Match) -> str:
    """Return an attribute with coordinates rounded to what a screen resolves, without letters that SVG implies."""
    name, value = match.groups()
    digits = 1 if len(value) > 1000 else 2
    value = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}", value)
    return f'{name}="{value if set("CQ") & set(value) else value.replace(" L ", " ")}"'
