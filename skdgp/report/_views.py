"""Samples behind the charts of the report."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import FlightDisplay
from skdgp.plotting._flight import ground_path
from skdgp.plotting._style import display_unit
from skdgp.plotting._time_histories import LATERAL_STATES, replay_rows
from skdgp.report._charts import Chart, Panel, Series, chart, tracks
from skdgp.report._content import FlightResult, ReportContent
from skdgp.report._tables import state, symbol, text

MOST_VALUES = 1_500_000
"""Values that the charts of one page hold: those of an hour at 40 Hz fill some three megabytes."""


def thinning(content: ReportContent) -> int:
    """Return of how many samples a chart keeps one, so that the page stays light."""
    tables = [record.table for record in content.train]
    n_values = sum(5 * len(table) for table in tables)
    for result in content.test:
        horizons = 0 if result.replay is None else result.replay["horizon"].nunique()
        n_values += len(result.time) * (24 + 10 * horizons + 5)
    return max(1, -(-n_values // MOST_VALUES))


def coefficient_chart(result: FlightResult, band: str, span, every: int) -> str:
    """Return the chart of the six coefficients."""
    columns = {"measured": result.measured, "mean": result.mean, "truth": result.truth, "std": result.noisy_std}
    columns = {name: None if values is None else np.asarray(values, dtype=float) for name, values in columns.items()}
    panels = []
    for k, name in enumerate(COEFFICIENTS):
        mean = columns["mean"][:, k]
        # What is thin lies over what is broad: so all are seen where they agree.
        series = [
            Series(name=band, color="sky", values=mean, std=columns["std"][:, k]),
            Series(name="estimated", color="blue", values=mean, width=2.5),
        ]
        if columns["truth"] is not None:
            series.append(Series(name="truth", color="vermillion", values=columns["truth"][:, k], dashed=True))
        series.append(Series(name="measured", color="measured", values=columns["measured"][:, k], width=0.8))
        title = f"{name} against time: {', '.join(one.name for one in series)}"
        panels.append(Panel(title=title, label=symbol(name), unit="", series=series, base=mean))
    return chart(
        Chart(title="Coefficients", link=result.name, time=result.time, panels=panels, spans=_spans(span)), every=every
    )


def state_chart(result: FlightResult, horizon: float, span, every: int) -> str:
    """Return the chart of the lateral states that were replayed and measured."""
    rows = replay_rows(result.replay, horizon)
    panels = []
    for name in (name for name in LATERAL_STATES if name in rows and name in result.table):
        factor, unit = display_unit(name)
        replayed = factor * rows[name].to_numpy(dtype=float)
        series = [
            Series(name="replayed", color="blue", values=replayed, width=2.5),
            Series(
                name="measured", color="measured", values=factor * result.table[name].to_numpy(dtype=float), width=0.8
            ),
        ]
        if f"{name}_std" in rows:
            std = factor * rows[f"{name}_std"].to_numpy(dtype=float)
            series.insert(0, Series(name="95 % band", color="sky", values=replayed, std=std))
        panels.append(Panel(title=f"{name} against time", label=state(name), unit=unit, series=series))
    return chart(
        Chart(
            title=f"States restarted every {horizon:g} s",
            link=result.name,
            time=rows["time"].to_numpy(dtype=float),
            panels=panels,
            spans=_spans(span),
            window=rows["window"].to_numpy(dtype=float) if "window" in rows else None,
        ),
        every=every,
    )


def input_chart(table, name: str, link: str, color: str, every: int) -> str:
    """Return the chart of the inputs of one flight, in that flight's colour."""
    panels = []
    for channel in FlightDisplay(flights={name: table}).inputs:
        factor, unit = display_unit(channel)
        values = factor * table[channel].to_numpy(dtype=float)
        words = channel.replace("_", " ")
        series = [Series(name=words, color=color, values=values)]
        panels.append(Panel(title=f"{words} against time", label=text(words), unit=unit, series=series))
    time = table["time"].to_numpy(dtype=float)
    return chart(Chart(title=f"Inputs of {name}", link=link, time=time, panels=panels), every=every)


def flight_tracks(flights: dict, links: dict[str, str]) -> str:
    """Return where the flights were, for the maps; of those whose time goes on and whose place is known."""
    paths = {
        links.get(name, name): ground_path(table, name)[["time", "east", "north"]] for name, table in flights.items()
    }
    whole = {link: path for link, path in paths.items() if path.notna().all(axis=None)}
    return tracks({link: path for link, path in whole.items() if path["time"].is_monotonic_increasing})


def _spans(span) -> list[tuple[float, float]]:
    return [] if span is None else [span]
