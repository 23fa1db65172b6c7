"""Figures of the report: the displays of `skdgp.plotting`, each panel an image of its own."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.page import MARGINS, THIN, WIDTH, figure, number, picture, text
from skdgp._display.style import tidy
from skdgp.plotting import TimeHistoryDisplay
from skdgp.report._content import Evaluation

LABEL_PLACE = 0.17  # distance of the vertical axis' label from the left edge of a panel [in]
EXCERPT = 15.0  # length of the close look at a flight [s]


def display_figure(*displays: Any, caption: str) -> str:
    """Return a figure of all panels of displays, side by side; panels of one key stand beneath each other."""
    layout = {1: "single"}.get(
        len(displays[0].keys), "" if displays[0].size[0] >= WIDTH else "trio"
    )
    first: list[Any] = []

    def image(display: Any, key: Any) -> str:
        def draw(figure: Any) -> None:
            ax = figure.subplots()
            first.append(ax)
            tidy(ax)
            display.draw(ax, key)
            inches = ax.get_position().width * figure.get_figwidth()
            ax.yaxis.set_label_coords((LABEL_PLACE - MARGINS[0]) / inches, 0.5)

        return picture(draw, label=display.words(key), size=display.size)

    panels = [
        f"<div>{''.join(image(display, key) for display in displays)}</div>"
        for key in displays[0].keys
    ]
    return figure(panels, caption, _legend(first[0]), layout)


def _legend(ax: Any) -> list[tuple[str, str, str]]:
    """Return colour, name and kind of each labelled artist of a panel; none where it has a legend itself."""
    from matplotlib.collections import Collection
    from matplotlib.colors import to_hex

    if ax.get_legend() is not None:
        return []
    entries = []
    artist: Any
    for artist, label in zip(*ax.get_legend_handles_labels(), strict=True):
        label = re.sub(r"(?<!\\)\$(\w)_(\w)\$", r"\1\2", label).replace(r"\$", "$")
        if isinstance(artist, Collection):
            area: Any = artist.get_facecolor()
            entries.append((to_hex(area[0]), label, "area"))
        else:
            sign = "•" if artist.get_linestyle() == "None" else ""
            entries.append((to_hex(artist.get_color()), label, sign))
    return entries


def busiest_span(
    time: Vector, values: Matrix, length: float = EXCERPT
) -> tuple[float, float] | None:
    """Return begin and end of the ``length`` seconds with the most motion of ``values``; None for a short record.

    Movement is the sum of squared steps, each column in units of its standard deviation.
    """
    if np.any(np.diff(time) <= 0) or time[-1] - time[0] < 1.5 * length:
        return None
    spread = np.nanstd(values, axis=0)
    steps = np.diff(values, axis=0, prepend=values[:1]) / np.where(spread > 0, spread, 1.0)
    moved = np.cumsum(np.nansum(steps**2, axis=1))
    begin = np.searchsorted(time, time[time <= time[-1] - length])
    gain = moved[np.searchsorted(time, time[begin] + length, side="right") - 1] - moved[begin]
    first = float(time[begin[np.argmax(gain)]])
    return first, first + length


def coefficient_figure(result: Evaluation) -> str:
    """Return the coefficients of a flight, of a long one where the estimates move most, with residuals beneath."""
    moments = result.measured, result.mean, result.measured_std
    display = TimeHistoryDisplay.from_predictions(
        result.time, *moments, truth=result.truth, ax=False
    )
    caption = f"Coefficients of {text(result.name)}"
    span = busiest_span(result.time, result.mean)
    if span is not None:
        display = display.between(*span)
        caption += f", the {EXCERPT:g}{THIN}s in which the estimates move most"
    caption += ", and beneath each measured less estimated, in the 95 % band."
    return display_figure(display, display.residuals(), caption=caption)


def state_figure(result: Evaluation) -> str:
    """Return the lateral states that were replayed over the shortest horizon; empty where there are none."""
    if result.replay is None:
        return ""
    horizon = float(result.replay["horizon"].min())
    display = TimeHistoryDisplay.from_replay(result.replay, result.table, ax=False)
    span = busiest_span(result.time, result.mean)
    if span is not None:
        display = display.between(*span)
    caption = (
        f"Coefficients of {text(result.name)} in motion (the paper's figure 7): states integrated "
        f"from the coefficients estimated at the measured states, restarted from the measured state "
        f"every {number(horizon, 'g')}{THIN}s. No control or stability of the aircraft corrects "
        f"their drift, so this is not a simulation."
    )
    return display_figure(display, caption=caption)
