"""Interactive charts: samples packed into the page for its script."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp.report._packing import pack, thinned

TICK = 1e-4
"""Resolution of time [s]."""
_HERE = files("skdgp.report")
_SCRIPTS = ("samples.js", "chart.js", "page.js")
SCRIPT = "\n".join(_HERE.joinpath(name).read_text(encoding="utf-8") for name in _SCRIPTS)
STYLE = _HERE.joinpath("chart.css").read_text(encoding="utf-8")
_DIGEST = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
POLICY = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{_DIGEST}'"
"""What the browser is told to allow: this script and nothing else, no other file, no network."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """One quantity of a panel: a line, or with ``std`` the band about it."""

    name: str
    color: str
    values: np.ndarray
    std: np.ndarray | None = None
    width: float = 1.0
    dashed: bool = False


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One vertical axis; ``label`` is ready HTML, ``title`` is for readers who do not see it.

    With ``base`` everything can be shown relative to that line.
    """

    title: str
    label: str
    unit: str
    series: Sequence[Series]
    base: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Panels over one time axis; charts of one ``link`` show the same seconds.

    Lines break where ``window`` changes. ``spans`` are begins and ends [s] that a button leads to.
    """

    title: str
    link: str
    time: np.ndarray
    panels: Sequence[Panel]
    spans: Sequence[tuple[float, float]] = ()
    window: np.ndarray | None = None


def tracks(paths: Mapping[str, pd.DataFrame]) -> str:
    """Return where the flights were, by their links: the script marks the place of the cursor on the maps."""
    return _data([{"link": link, **path.round(2).to_dict("list")} for link, path in paths.items()])


def chart(content: Chart, *, every: int = 1) -> str:
    """Return the element that the script makes a chart of; empty where time does not go on steadily.

    Of each ``2 * every`` samples the lowest and the highest are kept (`thinned`).
    """
    time = np.asarray(content.time, dtype=float)
    rows = slice(0, len(time) // every * every, every)
    if len(time[rows]) < 2 or not (np.diff(time) > 0).all():
        return ""
    columns, place = [], {}

    def column(values) -> int:
        # A measured state stands once, though two bands refer to it.
        if id(values) not in place:
            place[id(values)] = len(columns)
            columns.append(values)
        return place[id(values)]

    panels = [
        {
            "title": panel.title,
            "label": panel.label,
            "unit": panel.unit,
            "base": None if panel.base is None else column(panel.base),
            "series": [
                {
                    "name": one.name,
                    "color": one.color,
                    "width": one.width,
                    "dashed": one.dashed,
                    "values": column(one.values),
                    "std": None if one.std is None else column(one.std),
                }
                for one in panel.series
            ],
        }
        for panel in content.panels
    ]
    window = None if content.window is None else column(content.window)
    packs = [pack(time[rows], step=max(TICK, np.ptp(time) / 2**30))]
    for k, values in enumerate(columns):
        values = np.asarray(values, dtype=float)
        packs.append(pack(values[rows] if k == window else thinned(values, every)[: len(time[rows])]))
    spec = {
        "title": content.title,
        "link": content.link,
        "spans": list(content.spans),
        "window": window,
        "level": norm.ppf(0.975),
        "every": every,
        "n": len(time[rows]),
        "panels": panels,
        "columns": [[low, step] for low, step, _ in packs],
        "data": base64.b64encode(zlib.compress(b"".join(data for *_, data in packs), 9)).decode(),
    }
    return _data(spec)


def _data(content) -> str:
    # A "<" in a name must not end the element.
    return f'<script type="application/json">{json.dumps(content).replace("<", chr(92) + "u003c")}</script>'
