"""Figures: pictures by matplotlib, for paper, and data of the charts that the page's script makes of them."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp._compute.typing import Array, ArrayLike, Matrix, Vector
from skdgp._display.flights import START_MARKERS, ground_path, named_flights
from skdgp._display.page import THIN, WIDTH, figure, number, picture, strip, symbol, text
from skdgp._display.style import display_unit, draw_curve, mark_samples, tidy
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    EffectsDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
)
from skdgp.report._content import FlightResult, ReportContent
from skdgp.report._tables import state

EXCERPT = 15.0
"""Length of the close look at a flight [s]."""
N_BINS = 350
"""Slices that a line over time is drawn with: as many as a screen shows."""
TICK = 1e-4
"""Resolution of time [s]."""
LEVELS = 65_534
"""Steps between the smallest and the largest value of a column: 0.002 % of its range."""
START_SIGNS = dict(
    zip(START_MARKERS, "●■▲◆▼★", strict=True)
)  # letters that look like markers of paths
MOST_VALUES = 1_500_000
"""Values that the charts of one page hold: those of an hour at 40 Hz take some three megabytes."""


def busiest_span(
    time: Vector, values: Matrix, length: float = EXCERPT
) -> tuple[float, float] | None:
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


def coefficient_figure(result: FlightResult, span, every: int, draw: bool) -> str:
    """Return measured and estimated coefficients: a chart of the flight, with ``draw`` pictures of the span, too."""
    band = "95 % band" if result.measured_std is None else "95 % band of a measurement"
    panels = []
    for k, name in enumerate(COEFFICIENTS):
        mean, truth = result.mean[:, k], None if result.truth is None else result.truth[:, k]
        series = _compared(
            "estimated", mean, result.measured[:, k], band, result.noisy_std[:, k], truth
        )
        title = f"{name} against time: {', '.join(one.name for one in series)}"
        panels.append(Panel(title, symbol(name), "", series, base=mean))
    caption = f"Measured and estimated coefficients of {text(result.name)}."
    if span is not None and draw:
        seconds = number(span[1] - span[0], "g")  # of the pictures, where no chart is
        caption += (
            f'<span class="still"> The {seconds}{THIN}s in which the estimates move most.</span>'
        )
    made = chart("Coefficients", result.name, result.time, panels, span=span, every=every)
    shown = {name: getattr(result, name) for name in ("time", "measured", "mean", "truth")}
    display = CoefficientDisplay(**shown, std=result.noisy_std, output_names=COEFFICIENTS)

    def drawn(ax, name):
        display.plot(ax, outputs=name, time_span=span, n_bins=N_BINS, legend=False)

    pictures = (
        _strips(COEFFICIENTS, drawn, "measured, and estimated with its 95 % band") if draw else []
    )
    return figure(pictures, caption, _key(panels[0].series), made)


def state_figure(result: FlightResult, horizon: float, span, every: int, draw: bool) -> str:
    """Return the lateral states that were replayed and measured, likewise; empty where there is none."""
    rows, states = result.replay_over(horizon), result.measured_states
    if not states:
        return ""
    time = rows["time"].to_numpy(dtype=float)
    span = span if span is not None and rows["time"].between(*span).any() else None
    panels = []
    for name, measured in states.items():
        factor, unit = display_unit(name)
        replayed = factor * rows[name].to_numpy(dtype=float)
        std = factor * rows[f"{name}_std"].to_numpy(dtype=float) if f"{name}_std" in rows else None
        series = _compared("replayed", replayed, factor * measured, "95 % band", std)
        panels.append(Panel(f"{name} against time", state(name), unit, series))
    window = rows["window"].to_numpy(dtype=float) if "window" in rows else None
    title = f"States restarted every {horizon:g} s"
    made = chart(title, result.name, time, panels, span=span, window=window, every=every)
    caption = (
        f"States of {text(result.name)}, integrated from the estimated coefficients, restarted "
        f"from the measured state "
        f"every {number(horizon, 'g')}{THIN}s; lines break there. Bands end where they are wider "
        f"than the motion."
    )
    table = cast("pd.DataFrame", result.table)

    def drawn(ax, name):
        StateDisplay.from_replay(
            rows, table, states=[name], ax=ax, time_span=span, n_bins=N_BINS, legend=False
        )

    pictures = _strips(list(states), drawn, "measured, and replayed with its band") if draw else []
    return figure(pictures, caption, _key(panels[0].series), made)


def input_figure(table: pd.DataFrame, name: str, link: str, color: str, every: int) -> str:
    """Return the chart of the inputs of one flight, in that flight's colour."""
    panels = []
    for channel in FlightDisplay(flights={name: table}).inputs:
        factor, unit = display_unit(channel)
        values = factor * table[channel].to_numpy(dtype=float)
        words = channel.replace("_", " ")
        panels.append(
            Panel(f"{words} against time", text(words), unit, [Series(words, color, values)])
        )
    made = chart(
        f"Inputs of {name}", link, table["time"].to_numpy(dtype=float), panels, every=every
    )
    return figure([], f"Inputs of {text(name)}.", chart=made)


def _compared(
    estimate: str, mean: Array, measured: Array, band: str, std: Any, truth: Any = None
) -> list[Series]:
    """Return the lines of a panel.

    What is thin lies over what is broad: so all are seen where they agree.
    """
    series = [] if std is None else [Series(band, "sky", mean, std=std)]
    series.append(Series(estimate, "blue", mean, width=2.5))
    series += [] if truth is None else [Series("truth", "vermillion", truth, dashed=True)]
    return [*series, Series("measured", "measured", measured, width=0.8)]


def _key(series: Sequence[Series]) -> list[tuple[str, str, str]]:
    """Return the key of a panel: measured, estimate, band, truth."""
    order = sorted(
        series, key=lambda one: ("measured", "blue", "sky", "vermillion").index(one.color)
    )
    return [(one.color, one.name, "" if one.std is None else "area") for one in order]


def _strips(names: Sequence[str], draw: Callable, words: str) -> list[str]:
    """Return a strip for each name, two side by side."""
    return [
        strip(
            partial(draw, name=name),
            label=f"{name} against time: {words}",
            bottom=name in names[-2:],
        )
        for name in names
    ]


def calibration_panel(values, mean, std) -> str:
    """Return one square panel: nominal against observed coverage."""
    return picture(
        lambda ax: CalibrationDisplay.from_predictions(
            values, mean, std, output_names=COEFFICIENTS, ax=ax
        ),
        label="Observed against nominal coverage of measured coefficients",
        size=(4.0, 3.85),
        margins=(0.14, 0.97, 0.13, 0.97),
    )


def effect_panels(display: EffectsDisplay, output: str, names: Sequence[str]) -> list[str]:
    """Return one panel for each regressor named: its effect on an output; all have the same vertical scale."""
    k = list(display.importance).index(output)
    curves = {name: display.curves[name] for name in names}
    top = 1.08 * max(
        np.abs(one.mean[:, k]).max() + 1.96 * one.std[:, k].min() for one in curves.values()
    )

    def draw(ax, name):
        tidy(ax)
        curve, (factor, unit) = curves[name], display_unit(name)
        draw_curve(ax, factor * curve.at, curve.mean[:, k], curve.std[:, k], 0.95, "effect")
        mark_samples(ax, factor * display.samples[name])
        edges = factor * curve.at[[0, -1]]
        digits = max(0, 1 - int(np.floor(np.log10(np.ptp(edges) or 1.0))))
        ax.set_xticks(edges, [f"{edge:z.{digits}f}".replace("-", "−") for edge in edges])
        ax.set(ylim=(-top, top), xlim=edges)
        ax.locator_params(axis="y", nbins=4)
        ax.get_xticklabels()[0].set_horizontalalignment("left")
        ax.get_xticklabels()[-1].set_horizontalalignment("right")
        ax.set_xlabel(unit, labelpad=-7)

    place: dict[str, Any] = {"size": (2.0, 1.35), "margins": (0.23, 0.98, 0.19, 0.97)}
    return [
        picture(partial(draw, name=name), label=f"Effect of {name} on {output}", **place)
        for name in names
    ]


def envelope_panels(display: EnvelopeDisplay) -> list[str]:
    """Return one panel for each pair of regressors: density of the samples, relative uncertainty, another flight."""
    words = "where samples were flown, and how uncertain the model is there"
    place: dict[str, Any] = {"size": (2.9, 2.45), "margins": (0.21, 0.97, 0.18, 0.98)}
    return [
        picture(
            partial(display.plot, pairs=[pair], legend=False),
            label=f"{pair[1]} against {pair[0]}: {words}",
            **place,
        )
        for pair in display.pairs
    ]


def path_panel(flights: dict) -> str:
    """Return the ground paths, coloured by flight."""
    display = FlightDisplay(flights=named_flights(flights))
    return picture(
        lambda ax: display.plot_path(ax, color_by="flight", legend=False),
        label="Path over the ground, coloured by flight",
        size=(WIDTH, 4.0),
        margins=(0.145, 0.985, 0.13, 0.97),
        located=True,
    )


class Series(NamedTuple):
    """One quantity of a panel: a line, with a band if ``std`` is given."""

    name: str
    color: str
    values: Array
    std: Array | None = None
    width: float = 1.0
    dashed: bool = False


class Panel(NamedTuple):
    """One vertical axis: ``title`` is for screen readers, ``label`` is HTML; values may be relative to ``base``."""

    title: str
    label: str
    unit: str
    series: Sequence[Series]
    base: Array | None = None


def thinning(content: ReportContent) -> int:
    """Return of how many samples a chart keeps one, so that the page stays light."""
    n_values = sum(5 * len(table) for table in content.train.values())
    for result in content.test:
        horizons = 0 if result.replay is None else result.replay["horizon"].nunique()
        n_values += len(result.time) * (24 + 10 * horizons + 5)
    return max(1, -(-n_values // MOST_VALUES))


def flight_tracks(flights: Mapping[str, pd.DataFrame], links: Mapping[str, str]) -> str:
    """Return where the flights were, for the script that marks the cursor on the maps; of those it is known of."""
    paths = {
        links[name]: ground_path(table, name)[["time", "east", "north"]]
        for name, table in flights.items()
    }
    return _data([
        {"link": link, **path.round(2).to_dict("list")} for link, path in paths.items()
        if path.notna().all(axis=None) and path["time"].is_monotonic_increasing
    ])  # fmt: skip


def chart(
    title: str, link: str, time: Array, panels: Sequence[Panel], *, span=None, window=None, every=1
) -> str:
    """Return the element that the script makes a chart of; empty where time does not increase.

    Charts of one ``link`` show the same seconds. A button leads to ``span``, begin and end [s];
    lines break where ``window`` changes. Of each ``2 * every`` samples the lowest and the highest
    are kept (`thinned`).
    """
    rows = slice(0, len(time) // every * every, every)
    n = len(time[rows])
    if n < 2 or not (np.diff(time) > 0).all():
        return ""
    packs = [pack(time[rows], step=max(TICK, np.ptp(time) / 2**30))]
    numbers: dict[int, int] = {}

    def column(values: Array | None) -> int | None:
        """Pack a column once, however many series refer to it, and return its number."""
        if values is not None and id(values) not in numbers:
            numbers[id(values)] = len(numbers)
            packs.append(pack(values[rows] if values is window else thinned(values, every)[:n]))
        return None if values is None else numbers[id(values)]

    spec = {
        "title": title,
        "link": link,
        "spans": [] if span is None else [span],
        "window": column(window),
        "level": norm.ppf(0.975),
        "every": every,
        "n": n,
        "panels": [
            panel._asdict()
            | {
                "base": column(panel.base),
                "series": [
                    one._asdict() | {"values": column(one.values), "std": column(one.std)}
                    for one in panel.series
                ],
            }
            for panel in panels
        ],
        "columns": [scale for scale, _ in packs],
        "data": base64.b64encode(zlib.compress(b"".join(data for _, data in packs), 9)).decode(),
    }
    return _data(spec)


def _data(content: Any) -> str:
    # A "<" in a name must not end the element.
    return f'<script type="application/json">{json.dumps(content).replace("<", chr(92) + "u003c")}</script>'


def pack(values: ArrayLike, *, step: float | None = None) -> tuple[list[float], bytes]:
    """Return the smallest value, the step and the bytes of a count; and a column as bytes that compress well.

    Values are counted in steps from the smallest, 1 on; 0 is a hole. Differences of neighbouring
    counts are stored, little-endian, modulo 2^16 (2^32 where the step is given), all first bytes
    first.

    Examples
    --------
    >>> scale, data = pack(np.array([1.0, np.nan, 3.0]), step=0.5)
    >>> scale, list(data)
    ([1.0, 0.5, 4], [1, 255, 5, 0, 255, 0, 0, 255, 0, 0, 255, 0])
    """
    values = np.asarray(values, dtype=float)
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    dtype = np.dtype("<u2" if step is None else "<u4")
    step = step or (high - low) / LEVELS or 1.0
    count = np.where(known, np.rint((np.where(known, values, low) - low) / step) + 1, 0).astype(
        dtype
    )
    change = np.diff(count, prepend=dtype.type(0)).astype(dtype)
    return [float(low), float(step), dtype.itemsize], change.view(np.uint8).reshape(
        -1, dtype.itemsize
    ).T.tobytes()


def thinned(values: Array, every: int) -> Array:
    """Return a column with one value for ``every`` samples: of each pair of such groups both extremes, in their order.

    Examples
    --------
    >>> thinned(np.array([0.0, 5.0, 1.0, -3.0, 2.0, 2.0, 2.0, 9.0]), 2)
    array([ 5., -3.,  2.,  9.])
    """
    if every == 1:
        return values
    whole = len(values) // (2 * every) * 2 * every
    groups = values[:whole].reshape(-1, 2 * every)
    low = np.argmin(np.where(np.isfinite(groups), groups, np.inf), axis=1)
    high = np.argmax(np.where(np.isfinite(groups), groups, -np.inf), axis=1)
    places = np.sort(np.column_stack([low, high]), axis=1)
    return np.concatenate(
        [np.take_along_axis(groups, places, axis=1).ravel(), values[whole::every]]
    )
