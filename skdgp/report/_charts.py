"""Interactive charts: data for the script of the page."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import norm

from skdgp._compute.typing import Array, ArrayLike
from skdgp._display.flights import ground_path
from skdgp._display.html import symbol, text
from skdgp._display.style import display_unit
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import FlightDisplay
from skdgp.report._content import FlightResult, ReportContent
from skdgp.report._tables import state

TICK = 1e-4
"""Resolution of time [s]."""
LEVELS = 65_534
"""Steps between the smallest and the largest value of a column: 0.002 % of its range."""
MOST_VALUES = 1_500_000
"""Values that the charts of one page hold: those of an hour at 40 Hz take some three megabytes."""


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


def coefficient_chart(result: FlightResult, band: str, span, every: int) -> str:
    """Return the chart of the six coefficients."""
    panels = []
    for k, name in enumerate(COEFFICIENTS):
        mean, truth = result.mean[:, k], None if result.truth is None else result.truth[:, k]
        series = _compared("estimated", mean, result.measured[:, k], band, result.noisy_std[:, k], truth)
        title = f"{name} against time: {', '.join(one.name for one in series)}"
        panels.append(Panel(title, symbol(name), "", series, base=mean))
    return chart("Coefficients", result.name, result.time, panels, span=span, every=every)


def state_chart(result: FlightResult, horizon: float, span, every: int) -> str:
    """Return the chart of the lateral states that were replayed and measured."""
    rows = result.replay_over(horizon)
    panels = []
    for name, measured in result.measured_states.items():
        factor, unit = display_unit(name)
        replayed = factor * rows[name].to_numpy(dtype=float)
        std = factor * rows[f"{name}_std"].to_numpy(dtype=float) if f"{name}_std" in rows else None
        series = _compared("replayed", replayed, factor * measured, "95 % band", std)
        panels.append(Panel(f"{name} against time", state(name), unit, series))
    title, time = f"States restarted every {horizon:g} s", rows["time"].to_numpy(dtype=float)
    window = rows["window"].to_numpy(dtype=float) if "window" in rows else None
    return chart(title, result.name, time, panels, span=span, window=window, every=every)


def _compared(estimate: str, mean: Array, measured: Array, band: str, std: Any, truth: Any = None) -> list[Series]:
    """Return the lines of a panel. What is thin lies over what is broad: so all are seen where they agree."""
    series = [] if std is None else [Series(band, "sky", mean, std=std)]
    series.append(Series(estimate, "blue", mean, width=2.5))
    series += [] if truth is None else [Series("truth", "vermillion", truth, dashed=True)]
    return [*series, Series("measured", "measured", measured, width=0.8)]


def input_chart(table, name: str, link: str, color: str, every: int) -> str:
    """Return the chart of the inputs of one flight, in that flight's colour."""
    panels = []
    for channel in FlightDisplay(flights={name: table}).inputs:
        factor, unit = display_unit(channel)
        values = factor * table[channel].to_numpy(dtype=float)
        words = channel.replace("_", " ")
        panels.append(Panel(f"{words} against time", text(words), unit, [Series(words, color, values)]))
    return chart(f"Inputs of {name}", link, table["time"].to_numpy(dtype=float), panels, every=every)


def flight_tracks(flights: Mapping[str, pd.DataFrame], links: Mapping[str, str]) -> str:
    """Return where the flights were, for the script that marks the cursor on the maps; of those it is known of."""
    paths = {links[name]: ground_path(table, name)[["time", "east", "north"]] for name, table in flights.items()}
    return _data([
        {"link": link, **path.round(2).to_dict("list")} for link, path in paths.items()
        if path.notna().all(axis=None) and path["time"].is_monotonic_increasing
    ])  # fmt: skip


def chart(title: str, link: str, time: Array, panels: Sequence[Panel], *, span=None, window=None, every=1) -> str:
    """Return the element that the script makes a chart of; empty where time does not increase.

    Charts of one ``link`` show the same seconds. A button leads to ``span``, begin and end [s]; lines break where
    ``window`` changes. Of each ``2 * every`` samples the lowest and the highest are kept (`thinned`).
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
                    one._asdict() | {"values": column(one.values), "std": column(one.std)} for one in panel.series
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

    Values are counted in steps from the smallest, 1 on; 0 is a hole. Differences of neighbouring counts are stored,
    little-endian, modulo 2^16 (2^32 where the step is given), all first bytes first.

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
    count = np.where(known, np.rint((np.where(known, values, low) - low) / step) + 1, 0).astype(dtype)
    change = np.diff(count, prepend=dtype.type(0)).astype(dtype)
    return [float(low), float(step), dtype.itemsize], change.view(np.uint8).reshape(-1, dtype.itemsize).T.tobytes()


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
    return np.concatenate([np.take_along_axis(groups, places, axis=1).ravel(), values[whole::every]])
