"""Figures of a page: panels, their key and their caption, as HTML."""

from __future__ import annotations

from skdgp.report._tables import text


def _key(entries) -> str:
    """Return a list of samples and names; a sample is a line (""), an area, a hatched area, or a marker's sign."""
    lines = ""
    for color, name, kind in entries:
        sample = f'<i class="{kind}"></i>' if kind in ("", "area", "hatch") else f'<i class="mark">{kind}</i>'
        lines += f'<li style="color: var(--{color})">{sample}<span>{text(name)}</span></li>'
    return f'<ul class="key">{lines}</ul>' if lines else ""


def still(words: str) -> str:
    """Return words on the pictures, shown where no chart is."""
    return f'<span class="still">{words}</span>'


def figure(panels, caption: str, key=(), chart: str = "", layout: str = "") -> str:
    """Return a figure of panels side by side; ``key`` holds colour, name and kind of each sample."""
    classes = f"panels {layout}" if len(panels) > 1 else layout or "single"
    return _framed(f'{_key(key)}<div class="{classes}">{"".join(panels)}</div>', caption, chart)


def columns(by_head: dict[str, list[str]], key, caption: str, chart: str = "") -> str:
    """Return a figure of headed columns; on a phone one follows the other."""
    rows = max(map(len, by_head.values()))
    cells = "".join(f"<p>{head}</p>{''.join(panels)}" for head, panels in by_head.items())
    return _framed(f'{_key(key)}<div class="panels columns" style="--rows: {rows}">{cells}</div>', caption, chart)


def _framed(pictures: str, caption: str, chart: str) -> str:
    """Return a figure: pictures, and the samples of which a script makes a chart in their place."""
    if chart:
        pictures = f'<div class="static">{pictures}</div>'
    kind = ' class="chart"' if chart else ""
    return f"<figure{kind}>{pictures}{chart}<figcaption>{caption}</figcaption></figure>"
