"""Pictures of the report: one SVG for each panel, drawn by matplotlib, in the page's fonts and colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.flights import START_MARKERS, named_flights, start_marker
from skdgp._display.style import display_unit, draw_curve, mark_samples, tidy
from skdgp._display.svg import WIDTH, picture, strip
from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    EffectsDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
)
from skdgp.report._content import FlightResult

EXCERPT = 15.0
"""Length of the close look at a flight [s]."""
N_BINS = 350
"""Slices that a line over time is drawn with: as many as a screen shows."""


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


def coefficient_panels(result: FlightResult, span) -> list[str]:
    """Return six panels of a span, or of the whole flight: measured, estimated with band, truth."""
    shown = {name: getattr(result, name) for name in ("time", "measured", "mean", "truth")}
    display = CoefficientDisplay(**shown, std=result.noisy_std, output_names=COEFFICIENTS)

    def draw(ax, name):
        display.plot(ax, outputs=name, time_span=span, n_bins=N_BINS, legend=False)

    return _strips(COEFFICIENTS, draw, "measured, and estimated with its 95 % band")


def state_panels(result: FlightResult, horizon: float, span) -> list[str]:
    """Return one panel for each lateral state that was replayed and measured."""
    states, rows, table = list(result.measured_states), result.replay_over(horizon), cast("pd.DataFrame", result.table)

    def draw(ax, name):
        StateDisplay.from_replay(rows, table, states=[name], ax=ax, time_span=span, n_bins=N_BINS, legend=False)

    return _strips(states, draw, "measured, and replayed with its band")


def _strips(names: Sequence[str], draw: Callable, words: str) -> list[str]:
    """Return a strip for each name, two side by side."""
    return [
        strip(partial(draw, name=name), label=f"{name} against time: {words}", bottom=name in names[-2:])
        for name in names
    ]


def calibration_panel(values, mean, std) -> str:
    """Return one square panel: nominal against observed coverage."""
    return picture(
        lambda ax: CalibrationDisplay.from_predictions(values, mean, std, output_names=COEFFICIENTS, ax=ax),
        label="Observed against nominal coverage of measured coefficients",
        size=(4.0, 3.85),
        margins=(0.14, 0.97, 0.13, 0.97),
    )


def effect_panels(display: EffectsDisplay, output: str, names: Sequence[str]) -> list[str]:
    """Return one panel for each regressor named: its effect on an output; all have the same vertical scale."""
    k = list(display.importance).index(output)
    curves = {name: display.curves[name] for name in names}
    top = 1.08 * max(np.abs(one.mean[:, k]).max() + 1.96 * one.std[:, k].min() for one in curves.values())

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
    return [picture(partial(draw, name=name), label=f"Effect of {name} on {output}", **place) for name in names]


def envelope_panels(display: EnvelopeDisplay) -> list[str]:
    """Return one panel for each pair of regressors: density of the samples, relative uncertainty, another flight."""
    words = "where samples were flown, and how uncertain the model is there"
    place: dict[str, Any] = {"size": (2.9, 2.45), "margins": (0.21, 0.97, 0.18, 0.98)}
    return [
        picture(
            partial(display.plot, pairs=[pair], legend=False), label=f"{pair[1]} against {pair[0]}: {words}", **place
        )
        for pair in display.pairs
    ]


def start_sign(k: int) -> str:
    """Return the letter that looks like the marker at the begin of the k-th flight's path."""
    return dict(zip(START_MARKERS, "●■▲◆▼★", strict=True))[start_marker(k)]


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
