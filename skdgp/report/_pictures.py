"""Pictures of the report: one SVG for each panel, drawn by matplotlib, in the page's fonts and colours."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable
from html import escape
from io import StringIO
from typing import Any, cast

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    CouplingDisplay,
    EffectsDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
)
from skdgp.plotting._flight import START_MARKERS, named_flights, start_marker
from skdgp.plotting._style import PALETTE, QUIET, ROLES
from skdgp.report._content import FlightResult, measured_states

EXCERPT = 15.0
"""Length of the close look at a flight [s]."""
INK = "#20242a"
WIDTH = 4.6
"""Width of a panel [in]: half a desktop page, or a phone with letters still readable."""
POINTS = 72
"""Units of an SVG in an inch."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "skdgp",
    "font.size": 8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
}

# Colours of the pictures and the page's variables for them, which change with light and dark.
_VARIABLES = {
    INK: "ink",
    QUIET.lower(): "quiet",
    "#b0b0b0": "quiet",
    ROLES["measured"]: "measured",
    **{color: name for name, color in PALETTE.items()},
}
_VARIABLES = {color.lower(): f"var(--{name})" for color, name in _VARIABLES.items()}


def time_slices(n_flights: int) -> int:
    """Return how many slices a line is drawn with: as many as a screen shows, fewer when flights are many."""
    return int(np.clip(600 // max(n_flights, 1), 120, 350))


def busiest_span(time: Vector, values: Matrix, length: float = EXCERPT) -> tuple[float, float] | None:
    """Return begin and end of the ``length`` seconds in which ``values`` move most; None for a short record.

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


def coefficient_panels(result: FlightResult, span, n_bins: int) -> list[str]:
    """Return six panels: measured, estimated with band, truth."""
    display = CoefficientDisplay(
        time=result.time,
        measured=result.measured,
        mean=result.mean,
        std=result.noisy_std,
        # Over a whole flight a third line would only hide the other two.
        truth=None if span is None else result.truth,
        output_names=COEFFICIENTS,
    )
    return [
        strip(
            lambda ax, name=name: display.plot(ax, outputs=name, time_span=span, n_bins=n_bins, legend=False),
            label=f"{name} against time: measured, and estimated with its 95 % band",
            bottom=name == COEFFICIENTS[-1],
        )
        for name in COEFFICIENTS
    ]


def state_panels(result: FlightResult, horizon: float, span, n_bins: int) -> list[str]:
    """Return one panel for each lateral state that was replayed and measured."""
    states, rows, table = list(measured_states(result)), result.replay_over(horizon), cast("pd.DataFrame", result.table)

    def draw(ax, name):
        StateDisplay.from_replay(rows, table, states=[name], ax=ax, time_span=span, n_bins=n_bins, legend=False)

    return [
        strip(
            lambda ax, name=name: draw(ax, name),
            label=f"{name} against time: measured, and replayed with its band",
            bottom=name == states[-1],
        )
        for name in states
    ]


def calibration_panel(values, mean, std, against: str) -> str:
    """Return one square panel: nominal against observed coverage."""
    return picture(
        lambda ax: CalibrationDisplay.from_predictions(values, mean, std, output_names=COEFFICIENTS, ax=ax),
        label=f"Observed against nominal coverage of {against} coefficients",
        size=(4.0, 3.85),
        margins=(0.14, 0.97, 0.13, 0.97),
    )


def coupling_panel(correlation) -> str:
    """Return one square panel: the correlation between the outputs."""
    return picture(
        lambda ax: CouplingDisplay.from_correlation(correlation, ax=ax, colorbar=False),
        label="Correlation between the outputs, as written in the cells",
        size=(4.0, 3.65),
        margins=(0.12, 0.98, 0.07, 0.99),
    )


def effects_panel(display: EffectsDisplay) -> str:
    """Return one wide panel: the effect of each regressor on each output."""
    return picture(
        lambda ax: display.plot(ax, legend=False),
        label="Effect of each regressor, in columns, on each coefficient, in rows",
        size=(2 * WIDTH, 7.2),
        margins=(0.075, 0.99, 0.075, 0.99),
    )


def envelope_panels(display: EnvelopeDisplay) -> list[str]:
    """Return one panel for each pair of regressors: density of the samples, relative uncertainty, another flight."""
    return [
        picture(
            lambda ax, pair=pair: display.plot(ax, pairs=[pair], legend=False),
            label=f"{pair[1]} against {pair[0]}: where samples were flown, and how uncertain the model is there",
            size=(2.9, 2.45),
            margins=(0.21, 0.97, 0.18, 0.98),
        )
        for pair in display.pairs
    ]


def input_panels(flights: dict, name: str, n_bins: int) -> list[str]:
    """Return one panel for each input of one flight, in that flight's colour."""
    display = FlightDisplay(flights=flights)
    channels = FlightDisplay(flights={name: flights[name]}).inputs
    return [
        strip(
            lambda ax, channel=channel: display.plot_inputs(
                ax, channels=channel, flights=name, n_bins=n_bins, titles=False
            ),
            label=f"{channel} against time",
            bottom=channel in channels[-2:],
        )
        for channel in channels
    ]


def start_sign(k: int) -> str:
    """Return the letter that looks like the marker at the begin of the k-th flight's path."""
    return dict(zip(START_MARKERS, "●■▲◆▼★", strict=True))[start_marker(k)]


def path_panels(flights: dict) -> dict[str, str]:
    """Return the ground paths by their headings: coloured by flight, and by altitude where every flight has it."""
    display = FlightDisplay(flights=named_flights(flights))
    altitude = all("altitude" in table.columns for table in flights.values())
    return {
        f"Coloured by {by}": picture(
            lambda ax, by=by: display.plot_path(ax, color_by=by, legend=False),
            label=f"Path over the ground, coloured by {by}",
            size=(WIDTH, 4.0),
            # Room for the scale of altitude beside both, so that their axes are the same.
            margins=(0.145, 0.83 if altitude else 0.985, 0.13, 0.97),
            located=True,
        )
        for by in (("flight", "altitude") if altitude else ("flight",))
    }


def strip(draw: Callable, *, label: str, bottom: bool = True) -> str:
    """Return the SVG of a low panel against time; only the ``bottom`` panel of a column names the axis."""
    below = 0.4 if bottom else 0.23
    height = 1.1 + 0.08 + below
    edges = (0.145, 0.985, below / height, 1 - 0.08 / height)

    def drawn(ax):
        draw(ax)
        ax.yaxis.set_label_coords(-0.14, 0.5)
        if not bottom:
            ax.set_xlabel("")

    return picture(drawn, label=label, size=(WIDTH, height), margins=edges)


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
    ((width, height),) = re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    body = svg[svg.index(">", svg.index("<svg")) + 1 : svg.rindex("</svg>")]
    body = re.sub(r"<!--.*?-->|<style.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r" font-family: [^;\"]*;?", "", body)
    body = re.sub(r' transform="rotate\(-0 [^"]*"', "", body).replace("xlink:href", "href")
    body = re.sub(r"(stroke|fill): (#[0-9a-f]{6})", _themed, body)
    body = re.sub(r'\b(d|x|y|transform)="([^"]*)"', _shortened, body)
    body = _gathered(re.sub(r"\s*\n\s*", "", _renamed(body)))
    name = escape(label, quote=True)
    return f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{name}"{attributes}>{body}</svg>'


def _themed(match: re.Match) -> str:
    kind, color = match.groups()
    if (kind, color) == ("stroke", "#ffffff"):
        return "stroke: var(--paper)"
    return f"{kind}: {_VARIABLES.get(color, color)}"


def _shortened(match: re.Match) -> str:
    """Return an attribute with coordinates rounded to what a screen resolves, without letters that SVG implies."""
    name, value = match.groups()
    digits = 1 if len(value) > 1000 else 2
    value = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}".rstrip("0").rstrip("."), value)
    if name == "d":
        value = " ".join(value.split())
        if "C" not in value and "Q" not in value:
            value = value.replace(" L ", " ")
    return f'{name}="{value}"'


def _renamed(body: str) -> str:
    """Return a body without unused names, the others different from those of other pictures of the page."""
    used = set(re.findall(r"(?:url\(|href=\")#([^\")]+)", body))
    prefix = f"s{zlib.crc32(body.encode()):08x}"
    names = {name: f"{prefix}-{k}" for k, name in enumerate(sorted(used))}
    body = re.sub(r' id="([^"]*)"', lambda name: f' id="{names[name[1]]}"' if name[1] in used else "", body)
    return re.sub(r"(url\(|href=\")#([^\")]+)", lambda use: f"{use[1]}#{names[use[2]]}", body)


def _gathered(body: str) -> str:
    """Return a body in which neighbouring marks share their style."""
    several = (
        r'((?:<use href="#[^"]*" x="[^"]*" y="[^"]*")( style="[^"]*")/>(?:<use href="#[^"]*" x="[^"]*" y="[^"]*"\2/>)+)'
    )
    return re.sub(several, lambda marks: f"<g{marks[2]}>{marks[1].replace(marks[2], '')}</g>", body)
