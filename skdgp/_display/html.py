"""Text, numbers, tables, figures and pages as HTML; text from outside is escaped here."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from string import Template

import numpy as np

from skdgp._flight.channels import COEFFICIENTS

THIN = "\u202f"
DASH = "–"
STYLE = files("skdgp._display").joinpath("page.css").read_text(encoding="utf-8")
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'"
"""The browser allows the page's own script and nothing else: no other file, no network."""
PAGE = Template(files("skdgp._display").joinpath("page.html").read_text(encoding="utf-8"))


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


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str, classes: str = "") -> str:
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
        sample = f'<i class="{kind}"></i>' if kind in ("", "area", "hatch") else f'<i class="mark">{kind}</i>'
        lines += f'<li style="color: var(--{color})">{sample}<span>{text(name)}</span></li>'
    return f'<ul class="key">{lines}</ul>' if lines else ""


def figure(panels, caption: str, key=(), chart: str = "", layout: str = "") -> str:
    """Return a figure of panels side by side; ``key`` holds colour, name and kind of each sample.

    On a screen a script makes a ``chart`` in their place; without panels there is nothing else, and nothing on paper.
    """
    if not panels:
        return f'<figure class="chart screen">{chart}<figcaption>{caption}</figcaption></figure>' if chart else ""
    classes = f"panels {layout}" if len(panels) > 1 else layout or "single"
    pictures = f'{key_of(key)}<div class="{classes}">{"".join(panels)}</div>'
    if chart:
        pictures = f'<div class="static">{pictures}</div>'
    kind = ' class="chart"' if chart else ""
    return f"<figure{kind}>{pictures}{chart}<figcaption>{caption}</figcaption></figure>"


def render_page(kind: str, title: str, meta: str, body: str, colophon: str, *, script: str = "") -> str:
    """Return the document; title and kind are text, ``script`` is JavaScript, the rest is HTML."""
    policy = POLICY.format(base64.b64encode(hashlib.sha256(script.encode()).digest()).decode())
    script = f"<script>{script}</script>" if script else ""
    words = {"kind": text(kind), "title": text(title), "meta": meta, "body": body, "colophon": colophon}
    return PAGE.substitute(words, policy=policy, style=STYLE, script=script)


def can_draw() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None
