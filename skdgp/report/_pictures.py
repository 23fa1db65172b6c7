"""Pictures of the report, one SVG for each panel."""

from __future__ import annotations

import numpy as np

from skdgp._flight.channels import COEFFICIENTS
from skdgp.plotting import (
    CalibrationDisplay,
    CoefficientDisplay,
    CouplingDisplay,
    EnvelopeDisplay,
    FlightDisplay,
    StateDisplay,
)
from skdgp.plotting._flight import START_MARKERS, named_flights, start_marker
from skdgp.plotting._time_histories import LATERAL_STATES, replay_rows
from skdgp.report._content import FlightResult
from skdgp.report._svg import WIDTH, picture, strip

SQUARE = {"size": (4.0, 3.85), "margins": (0.14, 0.97, 0.13, 0.97)}
EXCERPT = 15.0
"""Length of the close look at a flight [s]."""


def time_slices(n_flights: int) -> int:
    """Return how many slices a line is drawn with: as many as a screen shows, fewer when flights are many."""
    return int(np.clip(600 // max(n_flights, 1), 120, 350))


def busiest_span(time, values, length: float = EXCERPT) -> tuple[float, float] | None:
    """Return begin and end of the ``length`` seconds in which ``values`` move most; None for a short record.

    Movement is the sum of squared steps, each column in units of its standard deviation.
    """
    time, values = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
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
        time=np.asarray(result.time, dtype=float),
        measured=np.asarray(result.measured, dtype=float),
        mean=np.asarray(result.mean, dtype=float),
        std=result.noisy_std,
        # Over a whole flight a third line would only hide the other two.
        truth=None if result.truth is None or span is None else np.asarray(result.truth, dtype=float),
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
    states = [name for name in LATERAL_STATES if name in result.replay and name in result.table]
    rows = replay_rows(result.replay, horizon)

    def draw(ax, name):
        StateDisplay.from_replay(rows, result.table, states=[name], ax=ax, time_span=span, n_bins=n_bins, legend=False)

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
        **SQUARE,
    )


def coupling_panel(correlation) -> str:
    """Return one square panel: the correlation between the outputs."""
    return picture(
        lambda ax: CouplingDisplay.from_correlation(correlation, ax=ax, colorbar=False),
        label="Correlation between the outputs, as written in the cells",
        size=(4.0, 3.65),
        margins=(0.12, 0.98, 0.07, 0.99),
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
