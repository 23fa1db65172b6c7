"""Figures of a page: panels, their key and their caption, as HTML."""

from __future__ import annotations

from skdgp.report._tables import text


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
