"""Sections of the report, as HTML."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS, LATERAL, LONGITUDINAL
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay
from skdgp.plotting._style import CYCLE, PALETTE
from skdgp.report import _charts as charts
from skdgp.report import _figure_html as figures
from skdgp.report import _pictures as pictures
from skdgp.report._content import FlightResult, ModelSummary, ReportContent, measured_states
from skdgp.report._tables import SCORES, THIN, error_table, facts, number, replay_table, text

_FLIGHT_COLORS = [name for color in CYCLE for name, value in PALETTE.items() if value == color]


def summary(content: ReportContent) -> str:
    """Return the headline numbers of every test flight."""
    if not content.test:
        return (
            '<section><h2>Result</h2><p class="note">No test flight was given: nothing here shows how the model '
            "does away from the flights it learned from.</p></section>"
        )
    flights = "".join(_headline(result) for result in content.test)
    return f"<section><h2>Result</h2>{flights}</section>"


def _headline(result: FlightResult) -> str:
    scores = result.scores
    measured, truth = scores["measured"], scores.get("truth")
    tiles = [
        _tile(measured, truth, "normalized_rmse", LATERAL, "", "normalised RMSE, lateral"),
        _tile(measured, truth, "normalized_rmse", LONGITUDINAL, "", "normalised RMSE, longitudinal"),
        _tile(measured, truth, "median_relative_error", COEFFICIENTS, "%", "median relative error, mean of six"),
        _tile(measured, None, "interval_coverage", COEFFICIENTS, "%", "of measured values inside the 95 % band"),
    ]
    return f'<h3>{text(result.name)}</h3><div class="head">{"".join(tiles)}</div>'


def _tile(measured, truth, metric, members, unit, words) -> str:
    def value(scores):
        return SCORES[metric].show(scores[metric].loc[list(members)].mean())

    unit = f"<small>{unit}</small>" if unit else ""
    against = "" if truth is None else f"<span>against truth {value(truth)}{unit and THIN + '%'}</span>"
    return f"<div><b>{value(measured)}{unit}</b><span>{words}</span>{against}</div>"


def messages(content: ReportContent) -> str:
    """Return the warnings that arose, or that none did."""
    if not content.messages:
        return '<section><h2>Warnings</h2><p class="note">No warning arose.</p></section>'
    lines = "".join(f"<li>{text(message)}</li>" for message in dict.fromkeys(content.messages))
    return f'<section><h2>Warnings</h2><ul class="alerts">{lines}</ul></section>'


def what_was_done(content: ReportContent) -> str:
    """Return samples, regressors, model, time and versions."""
    model, aircraft = content.model, content.aircraft
    pairs: list[tuple[str, object]] = [] if isinstance(aircraft, str) else list(aircraft.items())
    is_bound = "sparse" in (model.inference or "")  # which is not comparable with the likelihood of an exact model
    likelihood = "Log likelihood, lower bound" if is_bound else "Log likelihood"
    pairs += [
        ("Learned from", ", ".join(_flown(record.name, record.table["time"]) for record in content.train)),
        ("Tested on", ", ".join(_flown(result.name, result.time) for result in content.test)),
        ("Samples", _samples(model)),
        ("Regressors", ", ".join(map(str, model.regressors))),
        (
            "Latent processes",
            ", ".join(f"{n} {kind}" for n, kind in ((model.n_latent, "shared"), (model.n_private, "private")) if n),
        ),
        ("Kernel", model.kernel),
        ("Trend", model.trend),
        ("Inference", model.inference),
        (likelihood, _grouped(model.log_marginal_likelihood, ".1f")),
        ("Iterations", _iterations(model)),
        ("Time of the fit", None if model.fit_seconds is None else f"{model.fit_seconds:.1f}{THIN}s"),
        *model.extra.items(),
        ("Versions", ", ".join(f"{name} {version}" for name, version in model.versions.items())),
        ("Command", content.command),
    ]
    # Shown in print only: the first page is the one to sign.
    sign = '<div class="sign"><p>Prepared</p><p>Checked</p><p>Approved</p></div>'
    return f"<section><h2>What was done</h2>{facts(pairs)}{sign}</section>"


def _samples(model: ModelSummary) -> str | None:
    if model.n_samples is None:
        return None
    of = "" if model.n_available is None else f" of {_grouped(model.n_available)}"
    return f"{_grouped(model.n_samples)}{of}"


def _flown(name: str, time) -> str:
    """Return a flight with its duration and sample rate."""
    time = np.asarray(time, dtype=float)
    steps = np.diff(time)
    steps = steps[steps > 0]
    if not steps.size:
        return name
    return f"{name} ({number(np.ptp(time), ',.0f')}{THIN}s at {number(1 / np.median(steps), '.3g')}{THIN}Hz)"


def _iterations(model: ModelSummary) -> str | None:
    n_iter, most = model.n_iter, model.max_iter
    if not model.converged:
        return f"{_grouped(n_iter)} (not converged: raise max_iter)"
    at_limit = n_iter is not None and most is not None and n_iter >= most
    return f"{_grouped(n_iter)} (limit reached)" if at_limit else _grouped(n_iter)


def _grouped(value, form: str = ".0f") -> str | None:
    if value is None:
        return None
    return number(value, "," + form).replace(",", THIN)


_NO_BANDS_OF_TRUTH = (
    "Bands are judged against measured values alone: the true coefficients contain what no sensor saw, such as gusts, "
    "and no band promises to cover that."
)


class Detail(NamedTuple):
    """Resolution of the drawings: slices of time in a figure, samples per point of a chart."""

    n_bins: int
    every: int = 1


def flight(result: FlightResult, noise_std, detail: Detail, draw: bool) -> str:
    """Return everything about one test flight."""
    scores = result.scores
    tables = error_table(scores["measured"], noise_std, against="measured coefficients")
    if "truth" in scores:
        tables += error_table(scores["truth"], against="truth", with_bands=False)
    no_bands = f" {_NO_BANDS_OF_TRUTH}" if "truth" in scores else ""
    parts = [
        f'<section class="flight"><h2>Test flight {text(result.name)}</h2>',
        f'<div class="pair">{tables}</div>',
        f'<p class="note">▼ covers less than 90 %: too sure. ▲ covers more than 99 %: too wide.{no_bands}</p>',
    ]
    span = pictures.busiest_span(result.time, result.mean)
    if draw:
        parts.append(_coefficients(result, span, detail))
    if result.replay is not None or result.replay_errors is not None:
        parts.append("<h3>Replayed states</h3>")
    if result.replay_errors is not None:
        parts.append(replay_table(result.replay_errors))
    if draw and result.replay is not None:
        parts += [_states(result, horizon, span, detail) for horizon in np.unique(result.replay["horizon"])]
    if draw:
        parts.append(_calibration(result))
    return "".join([*parts, "</section>"])


def _coefficients(result: FlightResult, span, detail: Detail) -> str:
    band = "95 % band" if result.measured_std is None else "95 % band of a measurement"
    key = [("measured", "measured", ""), ("blue", "estimated", ""), ("sky", band, "area")]
    key += [] if result.truth is None else [("vermillion", "truth", "")]
    columns = _close_and_whole(span, lambda span: pictures.coefficient_panels(result, span, detail.n_bins))
    caption = "Measured and estimated coefficients."
    if span is not None:
        length = f"{number(span[1] - span[0], 'g')}{THIN}s"
        caption += figures.still(
            f" First the {length} in which the estimates move most, where a wrong model shows first; then the whole "
            "flight."
        )
    chart = charts.coefficient_chart(result, band, span, detail.every)
    return f"<h3>Coefficients</h3>{figures.columns(columns, key, caption, chart)}"


def _states(result: FlightResult, horizon: float, span, detail: Detail) -> str:
    rows, names = result.replay_over(horizon), list(measured_states(result))
    if not names:
        return ""
    key = [("measured", "measured", ""), ("blue", "replayed", "")]
    key += [("sky", "95 % band", "area")] if f"{names[0]}_std" in rows else []
    span = span if span is not None and rows["time"].between(*span).any() else None
    columns = _close_and_whole(span, lambda span: pictures.state_panels(result, horizon, span, detail.n_bins))
    caption = (
        f"States integrated from the estimated coefficients, restarted from the measured state every "
        f"{number(horizon, 'g')}{THIN}s; lines break there."
    )
    caption += figures.still(" Marks at the upper edge show where.")
    if span is not None:
        caption += figures.still(" First the same seconds as of the coefficients, then the whole flight.")
    return figures.columns(columns, key, caption, charts.state_chart(result, horizon, span, detail.every))


def _calibration(result: FlightResult) -> str:
    panel = pictures.calibration_panel(result.measured, result.mean, result.noisy_std, "measured")
    noise = "" if result.measured_std is None else ", with the noise,"
    caption = (
        f"Calibration: how often the intervals{noise} hold measured values. On the dotted line they hold as often as "
        "they say."
    )
    return f"<h3>Calibration</h3>{figures.figure([panel], caption)}"


def coupling(content: ReportContent) -> str:
    """Return the heat map of the coupling between the outputs."""
    caption = (
        "Correlation between the outputs that the model learned, at the shift where it is largest. "
        "Strong coupling lets one coefficient inform another."
    )
    panel = pictures.coupling_panel(content.model.correlation)
    return f"<section><h2>Coupling between outputs</h2>{figures.figure([panel], caption)}</section>"


def effects(display: EffectsDisplay) -> str:
    """Return the effect of each regressor on each output."""
    key = [("blue", "effect", ""), ("sky", "95 % band", "area"), ("measured", "samples", "|")]
    several = [name for name in display.importance.index if name not in display.curves]
    key += [("purple", "terms of several regressors", "area")] if several else []
    caption = (
        "Effect of each regressor on each coefficient, with mean zero over the samples; the coefficient is the sum of "
        "its row and a constant. Panels of a row have the same scale. Bands are wide where regressors moved together "
        "in the flights: the sum is then known better than its terms."
    )
    if several:
        caption += " The last column is what no single regressor explains: the range of 95 % of its values."
    figure = figures.figure([pictures.effects_panel(display)], caption, key, layout="wide")
    return f"<section><h2>Effects</h2>{figure}</section>"


def envelope(display: EnvelopeDisplay) -> str:
    """Return where the samples are, and where around them the model is uncertain."""
    key = [("grey", "95 % and half of the samples learned from", "area"), ("blue", "relative uncertainty", "")]
    key += [("grey", "above 0.5: hardly known", "hatch")]
    key += [("vermillion", "test flights", "•")] if display.path is not None else []
    caption = (
        "Pairs of regressors; those that a panel does not show are at their medians. Lines: the standard deviation of "
        "the coefficients, over how much they vary where samples were flown: 0 where they are known, 1 where any value "
        "flown is as likely. Where a test flight, or a simulation, leaves the grey area for the hatched, coefficients "
        "are extrapolated."
    )
    figure = figures.figure(pictures.envelope_panels(display), caption, key, layout="trio")
    return f"<section><h2>Where the model knows</h2>{figure}</section>"


def flown(content: ReportContent, detail: Detail) -> str:
    """Return the inputs and the path of every flight that came with its table."""
    flights = flown_tables(content)
    linked = {id(result.table): result.name for result in content.test}
    links = {name: linked.get(id(table), name) for name, table in flights.items()}
    parts = ["<section><h2>What was flown</h2>"]
    for k, name in enumerate(flights):
        key = [(_color(k), name, "")]
        panels = pictures.input_panels(flights, name, pictures.time_slices(len(flights)))
        chart = charts.input_chart(flights[name], name, links[name], _color(k), detail.every)
        parts.append(figures.figure(panels, f"Inputs of {text(name)}.", key, chart))
    positions = {"north", "east"}, {"v_north", "v_east"}
    tracked = {name: table for name, table in flights.items() if any(pair <= set(table) for pair in positions)}
    if tracked:
        key = [(_color(k), name, pictures.start_sign(k)) for k, name in enumerate(tracked)]
        paths = pictures.path_panels(tracked)
        caption = "Path over the ground, north up; the flight's marker shows where it begins."
        caption += " First coloured by flight, then by altitude [m], on the same axes." if len(paths) > 1 else ""
        if any("north" not in table.columns for table in tracked.values()):
            caption += " Without recorded positions: integrated from the velocities, from the origin."
        figure = figures.columns({head: [panel] for head, panel in paths.items()}, key, caption)
        parts.append(f'<div class="map">{figure}{charts.flight_tracks(tracked, links)}</div>')
    return "".join([*parts, "</section>"])


def flown_tables(content: ReportContent) -> dict[str, pd.DataFrame]:
    """Return the flight tables by name: those learned from, then those tested on."""
    pairs = [(f"{record.name} (train)", record.table) for record in content.train]
    pairs += [(f"{result.name} (test)", result.table) for result in content.test if result.table is not None]
    tables: dict[str, pd.DataFrame] = {}
    for name, table in pairs:
        twins = sum(other == name or other.startswith(f"{name} no. ") for other in tables)
        tables[f"{name} no. {twins + 1}" if twins else name] = table
    return tables


def how_to_read() -> str:
    """Return what the numbers mean."""
    return (
        '<section><h2>How to read the numbers</h2><div class="note">'
        "<p><b>Median relative error</b>: the median of |measured − estimated| / |measured|. It hides tails, and grows "
        "without bound where a coefficient passes through zero. <b>NRMSE</b>: root mean squared error over the "
        "standard deviation of the values; 1 is no better than their mean.</p>"
        "<p><b>NLPD</b>: negative log predictive density, in nats per value; small when estimates are close and "
        "say so. <b>95 % coverage</b>: share of the values inside the band of 1.96 standard deviations; 95 when "
        "the band is honest. <b>Noise σ</b>: standard deviation of the measurement noise the model learned.</p>"
        "<p>Coefficients are in body axes: <i>x</i> forward, <i>y</i> right, <i>z</i> down. Lateral: "
        "<i>C</i><sub>Y</sub> <i>C</i><sub>l</sub> <i>C</i><sub>n</sub>. Longitudinal: <i>C</i><sub>X</sub> "
        "<i>C</i><sub>Z</sub> <i>C</i><sub>m</sub>.</p></div></section>"
    )


def _color(k: int) -> str:
    return _FLIGHT_COLORS[k % len(_FLIGHT_COLORS)]


def _close_and_whole(span, panels) -> dict[str, list[str]]:
    """Return the panels of the span, if there is one, and of the whole flight, by their headings."""
    close = {} if span is None else {f"{number(span[0], '.0f')} to {number(span[1], '.0f')}{THIN}s": panels(span)}
    return close | {"Whole flight": panels(None)}
