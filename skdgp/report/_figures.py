"""Figures of the report: panels drawn by the displays of `skdgp.plotting`."""

from __future__ import annotations

from functools import partial
from typing import Any, cast

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.flights import START_MARKERS, named_flights, start_marker
from skdgp._display.page import MARGINS, THIN, WIDTH, figure, number, picture, strip, symbol, text
from skdgp._display.style import CYCLE, PALETTE, display_unit, tidy
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    EffectsDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
    TrajectoryDisplay,
)
from skdgp.report._content import FlightResult
from skdgp.report._tables import regressor

EXCERPT = 15.0
"""Length of the close look at a flight [s]."""
CHAPTER = 60.0
"""Shortest length of the parts in which a long flight is shown whole [s]."""
MOST_CHAPTERS = 6
"""Parts that the figures of one page are divided into at most, which keeps it small."""
N_BINS = 300
"""Slices that a line over time is drawn with: as many as a screen shows."""
N_EFFECTS = 4
"""Regressors shown for each coefficient: those whose effects vary most over the samples."""
SIGNS = dict(zip(START_MARKERS, "○□△◇▽☆", strict=True))
"""Letters that look like the markers of paths."""
KEY = [("grey", "measured", ""), ("blue", "estimated", ""), ("sky", "95 % band", "area")]
TRUTH = ("vermillion", "truth", "")
SMALL: dict[str, Any] = {"size": (2.9, 1.75), "margins": (0.6, 0.08, 0.42, 0.08)}


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


def coefficient_figure(result: FlightResult, span: Any, caption: str) -> str:
    """Return measured and estimated coefficients over a span, with residuals and their band beneath each."""
    display = CoefficientDisplay(
        time=result.time, measured=result.measured, mean=result.mean, truth=result.truth,
        std=result.noisy_std, output_names=COEFFICIENTS,
    )  # fmt: skip

    def draw(figure, name):
        options = {"time_span": span, "n_bins": N_BINS, "legend": False}
        display.plot(figure, outputs=name, kind="both", **options)
        for ax in figure.axes:
            ax.yaxis.set_label_coords(-0.185, 0.5)

    panels = [
        picture(
            partial(draw, name=name),
            label=f"{name} against time: measured and estimated with its 95 % band, and residuals",
            size=(WIDTH, 2.25),
            margins=(0.82, *MARGINS[1:]),
        )
        for name in COEFFICIENTS
    ]
    key = KEY + ([] if result.truth is None else [TRUTH])
    return figure(panels, caption, key)


def chapters(result: FlightResult, length: float) -> str:
    """Return the coefficients of a long flight in parts of ``length`` [s], to be opened by hand."""
    begin, end = result.time[[0, -1]]
    parts = ""
    for first in np.arange(begin, end, length) if end - begin > 1.5 * CHAPTER else ():
        last = min(first + length, end)
        if np.any((result.time >= first) & (result.time <= last)):
            words = f"{number(first, '.0f')} to {number(last, '.0f')}{THIN}s"
            caption = f"Coefficients of {text(result.name)}, {words}."
            body = coefficient_figure(result, (first, last), caption)
            parts += f"<details><summary>{words}</summary>{body}</details>"
    return parts


def state_figure(result: FlightResult, horizon: float, span: Any) -> str:
    """Return the lateral states that were replayed and measured; empty where there is none."""
    if not result.measured_states:
        return ""
    rows = result.replay_over(horizon)
    table = cast("pd.DataFrame", result.table)
    span = span if span is not None and rows["time"].between(*span).any() else None

    def draw(ax, name):
        options = {"time_span": span, "n_bins": N_BINS, "legend": False}
        StateDisplay.from_replay(rows, table, states=[name], ax=ax, **options)

    panels = [
        strip(partial(draw, name=name), label=f"{name} against time: measured and replayed")
        for name in result.measured_states
    ]
    caption = (
        f"Coefficients of {text(result.name)} in motion (the paper's figure 7): states integrated "
        f"from the coefficients estimated at the measured states, restarted from the measured state "
        f"every {number(horizon, 'g')}{THIN}s. No control or stability of the aircraft corrects "
        f"their drift, so this is not a simulation."
    )
    key = [KEY[0], ("blue", "integrated", ""), KEY[2]]
    return figure(panels, caption, key)


def simulation_figure(display: TrajectoryDisplay, caption: str) -> str:
    """Return a simulated flight with its bands beside the flown one."""
    panels = []
    for k, name in enumerate(display.names):
        panels.append(
            strip(
                partial(display.plot, legend=False, columns=[name]),
                label=f"{name} against time: simulated with its 95 % band, and flown",
                bottom=k >= len(display.names) - 2,
            )
        )
    key = [("blue", "simulated", ""), ("sky", "95 % band", "area"), ("vermillion", "flown", "")]
    if display.beyond is not None and (display.beyond > 0).any():
        key.append(("orange", "outside what was learned from", "▬"))
    return figure(panels, caption, key)


def input_figure(name: str, table: pd.DataFrame, color: str) -> str:
    """Return the inputs of one flight."""
    display = FlightDisplay(flights={name: table})

    def draw(ax, channel):
        display.plot_inputs(ax, channels=channel, n_bins=N_BINS)
        display.lines_[0].set_color(color)
        ax.set_title("")

    channels = display.inputs
    panels = [
        strip(partial(draw, channel=channel), label=f"{channel} against time", bottom=True)
        for channel in channels
    ]
    return figure(panels, f"Inputs of {text(name)}.")


def path_figure(flights: dict[str, pd.DataFrame]) -> str:
    """Return the ground paths, coloured by flight."""
    display = FlightDisplay(flights=named_flights(flights))
    panel = picture(
        partial(display.plot_path, legend=False),
        label="Path over the ground, coloured by flight",
        size=(WIDTH, 4.0),
    )
    names = {color: name for name, color in PALETTE.items()}
    key = [
        (names[CYCLE[k % len(CYCLE)]], name, SIGNS[start_marker(k)])
        for k, name in enumerate(flights)
    ]
    caption = "Path over the ground, north up; the flight's marker shows where it begins."
    if any("north" not in table.columns for table in flights.values()):
        caption += " Without recorded positions: integrated from the velocities, from the origin."
    return figure([panel], caption, key, "single")


def calibration_figure(values: Matrix, mean: Matrix, std: Matrix) -> str:
    """Return nominal against observed coverage."""
    panel = picture(
        lambda figure: CalibrationDisplay.from_predictions(
            values, mean, std, output_names=COEFFICIENTS, ax=figure
        ),
        label="Observed against nominal coverage of measured coefficients",
        size=(4.0, 3.85),
    )
    caption = (
        "How often intervals, with the noise, hold the measured values of all test flights. On the "
        "dotted line they hold as often as they say."
    )
    return figure([panel], caption, layout="single")


def effect_figures(display: EffectsDisplay) -> str:
    """Return for each output its largest effects, on one scale, and its strongest interactions."""
    parts = []
    for output in map(str, display.importance):
        names = list(display.importance.loc[list(display.curves), output].nlargest(N_EFFECTS).index)
        k = list(display.importance).index(output)
        curves = [display.curves[name] for name in names]
        tops = [np.abs(one.mean[:, k]).max() + 1.96 * one.std[:, k].min() for one in curves]
        top = 1.08 * max(tops, default=1.0)

        def draw_effect(figure, name, output=output, top=top):
            ax = figure.subplots()
            tidy(ax)
            display.draw_effect(ax, output, name)
            ax.set_ylim(-top, top)
            ax.set_xlabel(display_unit(name)[1])

        def draw_interaction(figure, number, output=output):
            ax = figure.subplots()
            tidy(ax)
            display.draw_interaction(ax, output, number)

        titles = [f"{symbol(output)} by {regressor(name)}" for name in names]
        panels = [
            picture(partial(draw_effect, name=name), label=f"Effect of {name} on {output}", **SMALL)
            for name in names
        ]
        for n, found in enumerate(display.interactions.get(output, ())):
            first, second = found.regressors
            titles.append(f"{symbol(output)} by {regressor(first)}, at two {regressor(second)}")
            label = f"Effect of {first} on {output} at two values of {second}"
            panels.append(picture(partial(draw_interaction, number=n), label=label, **SMALL))
        cells = [f"<div><p>{a}</p>{b}</div>" for a, b in zip(titles, panels, strict=True)]
        parts.append(figure(cells, f"Effects on {symbol(output)}.", layout="trio"))
    return "".join(parts)


def envelope_figure(display: EnvelopeDisplay) -> str:
    """Return a panel for each pair of regressors: samples, relative uncertainty, another flight."""
    left, right, below, above = MARGINS
    panels = [
        picture(
            partial(display.plot, pairs=[pair], legend=False),
            label=f"{pair[1]} against {pair[0]}: where samples were flown, and how uncertain the model is there",
            size=(2.9, 2.45), margins=(left - 0.1, right, below + 0.05, above),
        )
        for pair in display.pairs
    ]  # fmt: skip
    key = [("#333333", "learned from", "•"), ("blue", "relative uncertainty", "")]
    key += [] if display.path is None else [("vermillion", "test flights", "•")]
    caption = (
        "Pairs of regressors; those that a panel does not show are at their medians. Contours: the "
        "standard deviation of the coefficients, over how much they vary where samples were flown: "
        "0 where they are known, 1 where any value flown is as likely. Where a test flight, or a "
        "simulation, leaves the dots for darker blue, coefficients are extrapolated."
    )
    return figure(panels, caption, key, "trio")
