"""Pages: text, numbers, tables, figures and pictures (SVG) as HTML; text from outside is escaped here."""

from __future__ import annotations

import base64
import hashlib
import re
import zlib
from collections.abc import Callable, Iterable, Sequence
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from io import StringIO
from string import Template
from typing import Any

import numpy as np

from skdgp._display.style import PALETTE, QUIET, ROLES
from skdgp._flight.channels import COEFFICIENTS

THIN = "\u202f"
DASH = "–"
STYLE = files("skdgp._display").joinpath("page.css").read_text(encoding="utf-8")
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'"
"""The browser allows the page's own script and nothing else: no other file, no network."""
PAGE = Template(files("skdgp._display").joinpath("page.html").read_text(encoding="utf-8"))
INK = "#20242a"
WIDTH = 4.6  # width of a panel [in]: half a desktop page, or a phone with letters still readable
POINTS = 72  # units of an SVG in an inch
_PICTURE_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none", "svg.hashsalt": "skdgp", "font.size": 8, "axes.linewidth": 0.6,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "xtick.major.size": 3, "ytick.major.size": 3,
    "figure.facecolor": "none", "axes.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}  # fmt: skip
# Colours of the pictures and the page's variables for them, which change with light and dark.
_VARIABLES = {INK: "ink", QUIET: "quiet", "#b0b0b0": "quiet", ROLES["measured"]: "measured"}
_VARIABLES |= {color: name for name, color in PALETTE.items()}
_VARIABLES = {color.lower(): f"var(--{name})" for color, name in _VARIABLES.items()}


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
    for first, *rest in rows:
        cells = "".join(f"<td>{cell}</td>" for cell in rest)
        group = f'<tr class="group"><th colspan="{len(head)}" scope="colgroup">{first}</th></tr>'
        body += f'<tr><th scope="row">{first}</th>{cells}</tr>' if rest else group
    words = f"<caption>{caption}</caption><thead><tr>{heads}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="scroll"><table class="{classes}">{words}</table></div>'


def key_of(entries) -> str:
    """Return a list of samples and names; a sample is a line (""), an area, a hatched area, or a marker's sign."""
    lines = ""
    for color, name, kind in entries:
        sample = (
            f'<i class="{kind}"></i>'
            if kind in ("", "area", "hatch")
            else f'<i class="mark">{kind}</i>'
        )
        lines += f'<li style="color: var(--{color})">{sample}<span>{text(name)}</span></li>'
    return f'<ul class="key">{lines}</ul>' if lines else ""


def figure(panels, caption: str, key=(), chart: str = "", layout: str = "") -> str:
    """Return a figure of panels side by side; ``key`` holds colour, name and kind of each sample.

    On a screen a script makes a ``chart`` in their place; without panels there is nothing else, and
    nothing on paper.
    """
    if not panels:
        return (
            f'<figure class="chart screen">{chart}<figcaption>{caption}</figcaption></figure>'
            if chart
            else ""
        )
    classes = f"panels {layout}" if len(panels) > 1 else layout or "single"
    pictures = f'{key_of(key)}<div class="{classes}">{"".join(panels)}</div>'
    if chart:
        pictures = f'<div class="static">{pictures}</div>'
    kind = ' class="chart"' if chart else ""
    return f"<figure{kind}>{pictures}{chart}<figcaption>{caption}</figcaption></figure>"


def render_page(
    kind: str, title: str, meta: str, body: str, colophon: str, *, script: str = ""
) -> str:
    """Return the document; title and kind are text, ``script`` is JavaScript, the rest is HTML."""
    policy = POLICY.format(base64.b64encode(hashlib.sha256(script.encode()).digest()).decode())
    script = f"<script>{script}</script>" if script else ""
    words = {
        "kind": text(kind),
        "title": text(title),
        "meta": meta,
        "body": body,
        "colophon": colophon,
    }
    return PAGE.substitute(words, policy=policy, style=STYLE, script=script)


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


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


def picture(
    draw: Callable, *, label: str, size: tuple[float, float], margins: tuple, located: bool = False
) -> str:
    """Return the SVG of what ``draw(ax)`` draws into one Axes.

    ``label`` is read aloud; ``size`` is width and height [in], ``margins`` are left, right, bottom
    and top of the Axes as parts of these. With ``located`` the attribute ``data-map`` holds "a b c
    d": data (X, Y) are at a + b X, c + d Y.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_PICTURE_STYLE)
        figure = Figure(figsize=size)
        canvas = FigureCanvasSVG(figure)
        figure.subplots_adjust(
            **dict(zip(("left", "right", "bottom", "top"), margins, strict=True))
        )
        ax = figure.subplots()
        draw(ax)
        text = StringIO()
        canvas.print_svg(
            text, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
        (left, low), (right, high) = ax.transData.transform([(0, 0), (1, 1)]) * POINTS / figure.dpi
    place = (left, right - left, size[1] * POINTS - low, low - high)
    return adapt(
        text.getvalue(),
        label,
        f' data-map="{" ".join(f"{v:.7g}" for v in place)}"' if located else "",
    )


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
    return (
        "stroke: var(--paper)"
        if match[0] == "stroke: #ffffff"
        else f"{kind}: {_VARIABLES.get(color, color)}"
    )


def _shortened(match: re.Match) -> str:
    """Return an attribute with coordinates rounded to what a screen resolves, without letters that SVG implies."""
    name, value = match.groups()
    digits = 1 if len(value) > 1000 else 2
    value = re.sub(
        r"-?\d+\.\d+",
        lambda number: f"{float(number[0]):.{digits}f}".rstrip("0").rstrip("."),
        value,
    )
    value = " ".join(value.split()) if name == "d" else value
    return f'{name}="{value if set("CQ") & set(value) else value.replace(" L ", " ")}"'


def _renamed(body: str, label: str) -> str:
    """Return a body without unused names, the others different from those of other pictures of the page."""
    used = set(re.findall(r"(?:url\(|href=\")#([^\")]+)", body))
    prefix = f"s{zlib.crc32((label + body).encode()):08x}"
    names = {name: f"{prefix}-{k}" for k, name in enumerate(sorted(used))}
    body = re.sub(
        r' id="([^"]*)"', lambda name: f' id="{names[name[1]]}"' if name[1] in used else "", body
    )
    return re.sub(r"(url\(|href=\")#([^\")]+)", lambda use: f"{use[1]}#{names[use[2]]}", body)


def _gathered(body: str) -> str:
    """Return a body in which neighbouring marks share their style."""
    several = (
        r'((?:<use href="#[^"]*" x="[^"]*" y="[^"]*")( style="[^"]*")/>'
        r'(?:<use href="#[^"]*" x="[^"]*" y="[^"]*"\2/>)+)'
    )
    return re.sub(several, lambda marks: f"<g{marks[2]}>{marks[1].replace(marks[2], '')}</g>", body)
