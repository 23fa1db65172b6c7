"""The report as one HTML file: its sections in their order."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import text_writer, write_atomically
from skdgp._display.flights import start_marker
from skdgp._display.page import (
    DASH,
    THIN,
    can_draw,
    figure,
    key_of,
    number,
    percent,
    render_page,
    symbol,
    table,
    text,
)
from skdgp._display.style import CYCLE, PALETTE, display_unit, units_shown
from skdgp._flight.channels import COEFFICIENTS, MIRRORED
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay
from skdgp.report import _figures as figures
from skdgp.report._content import THRESHOLDS, FlightMechanics, FlightResult, ReportContent, Verdict
from skdgp.report._tables import (
    SCORES,
    derivative,
    error_table,
    facts,
    regressor,
    replay_table,
    state,
)

SCRIPT = files("skdgp.report").joinpath("chart.js").read_text(encoding="utf-8")
_FIT = {
    "yes": '<b class="yes">✓ yes</b>',
    "partly": '<b class="partly">◐ partly</b>',
    "no": '<b class="off">✗ no</b>',
    "unknown": "? not known",
}
_THRESHOLDS = (
    f"<b>Thresholds.</b> Predict: errors of at most {THRESHOLDS.error:g} of the spread of what is "
    f"predicted, and 95 % "
    f"bands that hold at least {100 * THRESHOLDS.coverage:.0f} %. Simulate, with the recorded "
    f"controls from measured "
    f"states: root mean square errors of at most {THRESHOLDS.error:g} of the spread of each "
    f"state, or 3 times the "
    f"noise of its sensor. Design a controller: 95 % bands of at most "
    f"±{THIN}{100 * THRESHOLDS.band:.0f}{THIN}% for "
    "the derivatives by the controls and the frequencies of the fast modes."
)
HOW_TO_READ = (
    '<div class="note">'
    "<p><b>Median relative error</b>: the median of |measured − estimated| / |measured|. It hides "
    "tails, and grows "
    "without bound where a coefficient passes through zero. <b>NRMSE</b>: root mean squared error "
    "over the "
    "standard deviation of the values; 1 is no better than their mean.</p>"
    "<p><b>NLPD</b>: negative log predictive density, in nats per value; small when estimates are "
    "close and "
    "say so. <b>95 % coverage</b>: share of the values inside the band of 1.96 standard "
    "deviations; 95 when "
    "the band is honest. <b>Noise σ</b>: standard deviation of the measurement noise the model "
    "learned.</p>"
    "<p>Coefficients are in body axes: <i>x</i> forward, <i>y</i> right, <i>z</i> down. Lateral: "
    "<i>C</i><sub>Y</sub> <i>C</i><sub>l</sub> <i>C</i><sub>n</sub>. Longitudinal: "
    "<i>C</i><sub>X</sub> "
    "<i>C</i><sub>Z</sub> <i>C</i><sub>m</sub>.</p></div>"
)
N_WARNINGS = 3
GROUPED = {"Longitudinal": ("CL", "CD", "Cm"), "Lateral": ("CY", "Cl", "Cn")}
STRONG = 0.3
"""Correlation of two outputs that is worth naming."""
MOST_OPEN = 3
"""Flights that a page shows in full; of more each is opened by hand, but for the one that is
predicted worst.
"""
N_EFFECTS = 4
"""Regressors shown for each coefficient: those whose effects vary most over the samples."""


def write_report(path: str | os.PathLike, content: ReportContent) -> Path:
    """Write a report as one HTML file that needs nothing else, no network, no other file; return its path.

    The file appears whole or not at all. It holds pictures as they are printed; on a screen its
    script makes charts of them, to zoom and to read values. Without matplotlib the report has no
    pictures and says so. Raises FileNotFoundError if the folder does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skdgp.report import ReportContent, write_report
    >>> path = write_report(Path(tempfile.mkdtemp()) / "report.html", ReportContent(title="Brumby, first flights"))
    >>> path.read_text(encoding="utf-8").splitlines()[0]
    '<!DOCTYPE html>'
    """
    return write_atomically(path, text_writer(render_report(content)))


def render_report(content: ReportContent) -> str:
    """Return the report as one HTML document."""
    aircraft = (
        content.aircraft
        if isinstance(content.aircraft, str)
        else content.aircraft.get("Aircraft", "")
    )
    created = datetime.now().astimezone() if content.created is None else content.created
    count = f"flights: {len(content.train)} training, {len(content.test)} test"
    meta = " · ".join(
        text(part) for part in (aircraft, count, f"{created:%d %B %Y, %H:%M}") if part
    )
    made = text(f"Made by skdgp {content.model.versions.get('skdgp', '')}".rstrip())
    colophon = f"{made}. SI units; degrees in pictures and in the table of states."
    kind = "Aerodynamic identification report"
    with units_shown(content.units):
        return render_page(kind, content.title, meta, _body(content), colophon, script=SCRIPT)


def _body(content: ReportContent) -> str:
    draw, every = can_draw(), figures.thinning(content)
    parts = [verdict(content), assumed(content), messages(content)]
    if content.mechanics is not None:
        parts.append(mechanics(content.mechanics))
    parts.append(what_was_done(content))
    if not draw:
        parts.append(_note('No pictures: they need matplotlib, pip install "skdgp[plot]".'))
    parts += [*content.sections, *flights(content, every, draw)]
    if draw and content.test:
        parts.append(calibration(content))
    if draw and content.effects is not None:
        parts.append(effects(content.effects))
    if draw and content.envelope is not None:
        parts.append(envelope(content.envelope))
    if flown_tables(content):
        parts.append(flown(content, every, draw))
    return "\n".join([*parts, _section("How to read the numbers", HOW_TO_READ)])


def _section(title: str, *parts: str, classes: str = "") -> str:
    """Return a section of ready HTML."""
    kind = f' class="{classes}"' if classes else ""
    return f"<section{kind}><h2>{title}</h2>{''.join(parts)}</section>"


def _note(words: str) -> str:
    return f'<p class="note">{words}</p>'


def verdict(content: ReportContent) -> str:
    """Return what was learned, what the model is good enough for, and how it did on each test flight."""
    if not content.test:
        words = "No test flight was given: nothing here shows how the model does away from the flights it learned from."
        return _section("Verdict", _note(words))
    found, parts = content.verdict, []
    if found is not None:
        uses = [[text(use.purpose), _FIT[use.fit], text(use.reason)] for use in found.uses]
        parts = [
            f'<p class="lead">{text(found.learned)}</p>',
            _tiles(found),
            table(
                ["good enough to", "", "because"],
                uses,
                caption="What the model is good for.",
                classes="words",
            ),
            _note(_THRESHOLDS),
            f"<p>{text(found.compared())}</p>",
            "<h3>The warnings that matter most</h3>",
            _warnings("ol", found.warnings[:N_WARNINGS]),
        ]
    if found is None or len(content.test) > 1:
        head, rows = ["", "length<br>[s]", *(score.head for score in SCORES.values())], []
        for result in content.test:
            means = result.scores["measured"].mean()
            cells = [score.show(means[name]) for name, score in SCORES.items()]
            rows.append([text(result.name), number(np.ptp(result.time), ".3g"), *cells])
        caption = "Test flights, against measured values: means of the six coefficients."
        parts.append(table(head, rows, caption=caption, classes="numbers"))
    return _section("Verdict", *parts)


def _tiles(found: Verdict) -> str:
    linear = found.least_squares_error
    beside = "" if linear is None else f"<span>least squares {number(linear, '.3f')}</span>"
    return (
        f'<div class="head"><div><b>{number(found.error, ".3f")}</b><span>error over spread '
        f"(NRMSE), mean of the six"
        f"</span>{beside}</div><div><b>{percent(found.coverage)}<small>%</small></b><span>of "
        f"measured values inside "
        "the 95 % band</span><span>95 is right</span></div></div>"
    )


def _warnings(kind: str, lines: Iterable[str]) -> str:
    shown = "".join(f"<li>{text(line)}</li>" for line in lines)
    return f'<{kind} class="alerts">{shown}</{kind}>' if shown else _note("No warning arose.")


def assumed(content: ReportContent) -> str:
    """Return what was assumed where nothing was told, empty where all was."""
    lines = "".join(f"<li>{text(line)}</li>" for line in content.assumed)
    return _section("What was assumed", f"<ul>{lines}</ul>") if lines else ""


def messages(content: ReportContent) -> str:
    """Return the warnings that the verdict does not show, or that none arose."""
    if content.verdict is None:
        return _section("Warnings", _warnings("ul", dict.fromkeys(content.messages)))
    rest = content.verdict.warnings[N_WARNINGS:]
    return _section("Further warnings", _warnings("ul", rest)) if rest else ""


def mechanics(found: FlightMechanics) -> str:
    """Return trim, derivatives, modes, and how long a simulation follows the test flights."""
    parts = []
    if found.trim is None:
        parts.append(_note(text(found.note)))
    else:
        angles = {
            name: getattr(found.trim, name)
            for name in ("airspeed", "alpha", "theta", "phi", "climb")
        }
        shown = [
            (name, _in_words(name, value)) for name, value in (angles | found.trim.controls).items()
        ]
        parts.append("<p>Steady flight in the middle of what was flown:</p>" + facts(shown))
    if len(found.derivatives):
        tables = "".join(_derivatives(found, *group) for group in GROUPED.items())
        parts.append(f'<div class="pair">{tables}</div>')
    if found.modes is not None:
        parts.append(_modes(found.modes))
    if found.simulation is not None:
        parts.append(_simulation(found.simulation))
    return _section("Trim, derivatives and modes", *parts)


def _in_words(name: str, value: float) -> str:
    factor, unit = display_unit("theta" if name == "climb" else name)
    return f"{number(factor * value, '.2f' if unit == 'deg' else '.3g')} {unit}"


def _derivatives(found: FlightMechanics, group: str, coefficients: Sequence[str]) -> str:
    """Return the derivatives of one plane with their bands; a band that holds zero leaves the sign open."""
    derivatives, linear = found.derivatives, found.least_squares
    across = group == "Lateral"
    chosen = derivatives[derivatives["regressor"] != ""]
    rows = []
    for coefficient in coefficients:
        for name, row in chosen[chosen["coefficient"] == coefficient].iterrows():
            if (row["regressor"] in MIRRORED) != across:
                continue
            open_sign = "std" in row and not row["lower"] * row["upper"] > 0
            beside = DASH if linear is None else _band(*linear.loc[str(name), ["value", "std"]])
            value = _band(row["value"], row.get("std"))
            value = f'<span class="off">▼ {value}</span>' if open_sign else value
            sizes = (
                [f"± {number(1.96 * row['std_aircraft'], '.2g')}"] if "std_aircraft" in row else []
            )
            rows.append([derivative(*row[["coefficient", "regressor"]]), value, beside, *sizes])
    caption = (
        f"{group} derivatives, by angles [rad] and by pb/2V, qc/2V, rb/2V, with half their 95 % "
        f"bands. "
        "▼: the log cannot tell it, its band holds both signs."
    )
    head = ["", "model", "least squares"]
    if "std_aircraft" in derivatives:
        head.append("aircraft")
        caption += (
            " Aircraft: half the 95 % band of what errors of its sizes make of them, which all "
            "derivatives of a moment "
            "or force share; it matters against other sources, not for trim, modes and "
            "simulations with this aircraft."
        )
    if "full throw" in set(derivatives.get("per", ())):
        caption += " Those by surfaces are by their full throw."
    return table(head, rows, caption=caption, classes="numbers named")


def _band(value: float, std: float | None) -> str:
    """Return a value and half of its 95 % band, both to the second digit of the band."""
    if std is None or not np.isfinite(std) or std <= 0:
        return number(value, ".3g")
    half = 1.96 * std
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 6))
    return f"{number(value, f'.{digits}f')} ± {number(half, f'.{digits}f')}"


def _modes(modes: pd.DataFrame) -> str:
    rows = []
    for name, row in modes.drop(columns="eigenvalue").iterrows():
        times = number(row["time_constant"], ".3g")
        if (
            "time_constant_lower" in row
            and not 0 < row["time_constant_lower"] * row["time_constant_upper"] < np.inf
        ):
            times = f'<span class="off">▼ {times}</span>'
        damping = (
            DASH if abs(row["damping"]) == 1 else _band(row["damping"], row.get("damping_std"))
        )
        rows.append([text(name), _band(row["frequency"], row.get("frequency_std")), damping, times])
    caption = (
        "Modes, with half their 95 % bands. The time constant is negative where a mode diverges. "
        "▼: the log cannot "
        "tell whether it decays."
    )
    head = ["", "frequency<br>[rad/s]", "damping<br>ratio", "time constant<br>[s]"]
    return table(head, rows, caption=caption, classes="numbers narrow")


def _simulation(errors: pd.DataFrame) -> str:
    rows = []
    for name, row in errors.iterrows():
        factor, unit = display_unit(str(name))
        cells = [number(factor * row[column], ".3g") for column in ("spread", "limit", "error")]
        lasts = number(row["lasts"], ".2g")
        lasts = (
            f"all {lasts}"
            if row["lasts"] >= row["horizon"]
            else f'<span class="off">{lasts}</span>'
        )
        rows.append([state(str(name)), unit, *cells, lasts])
    caption = (
        "Simulation of the test flights with the recorded controls, in still air, started again "
        "from measured states: "
        "root mean square error at the end, and how long it stays below the limit."
    )
    head = [
        "",
        "unit",
        "spread in<br>the flights",
        "limit",
        "error at<br>the end",
        "follows<br>for [s]",
    ]
    return table(head, rows, caption=caption, classes="numbers narrow")


def what_was_done(content: ReportContent) -> str:
    """Return samples, regressors, model, time and versions."""
    model, aircraft = content.model, content.aircraft
    latent = {"shared": model.n_latent, "private": model.n_private}
    is_bound = "sparse" in (
        model.inference or ""
    )  # which is not comparable with the likelihood of an exact model
    at_limit = (
        model.n_iter is not None and model.max_iter is not None and model.n_iter >= model.max_iter
    )
    end = " (limit reached)" if at_limit else ""
    pairs = [
        *([] if isinstance(aircraft, str) else aircraft.items()),
        (
            "Learned from",
            _all_flown([(name, table["time"]) for name, table in content.train.items()]),
        ),
        ("Tested on", _all_flown([(result.name, result.time) for result in content.test])),
        ("Samples", " of ".join(filter(None, map(_grouped, (model.n_samples, model.n_available))))),
        ("Regressors", ", ".join(map(str, model.regressors))),
        ("Latent processes", ", ".join(f"{n} {kind}" for kind, n in latent.items() if n)),
        ("Kernel", model.kernel),
        ("Trend", model.trend),
        ("Inference", model.inference),
        ("Coupling of outputs", _coupling(model.correlation)),
        (
            "Log likelihood" + ", lower bound" * is_bound,
            _grouped(model.log_marginal_likelihood, ".1f"),
        ),
        (
            "Iterations",
            _grouped(model.n_iter)
            + (end if model.converged else " (not converged: raise max_iter)"),
        ),
        (
            "Time of the fit",
            None if model.fit_seconds is None else f"{model.fit_seconds:.1f}{THIN}s",
        ),
        *model.extra.items(),
        ("Versions", ", ".join(f"{name} {version}" for name, version in model.versions.items())),
        ("Command", content.command),
    ]
    # Shown in print only: the first page is the one to sign.
    sign = '<div class="sign"><p>Prepared</p><p>Checked</p><p>Approved</p></div>'
    return _section("What was done", facts(pairs), sign)


def _coupling(correlation: Any) -> str | None:
    """Return the pairs of outputs that the model couples, None where that is not known."""
    if correlation is None:
        return None
    matrix = np.asarray(getattr(correlation, "correlation", correlation), dtype=float)
    pairs = {
        f"{COEFFICIENTS[i]} and {COEFFICIENTS[j]}": matrix[i, j] for i in range(6) for j in range(i)
    }
    strong = (
        pd.Series(pairs)
        .loc[lambda values: values.abs() >= STRONG]
        .sort_values(key=lambda values: -values.abs())
    )
    found = [f"{words} {number(value)}" for words, value in strong.items()]
    return f"correlations {', '.join(found)}" if found else f"no correlation of {STRONG:g} or more"


def _all_flown(flights: Sequence[tuple[str, Any]]) -> str:
    """Return flights with their durations; of many their number."""
    if len(flights) <= MOST_OPEN:
        return ", ".join(_flown(*pair) for pair in flights)
    seconds = sum(float(np.ptp(time)) for _, time in flights)
    return f"{len(flights)} flights, {number(seconds, '.3g')}{THIN}s together: {', '.join(name for name, _ in flights)}"


def _flown(name: str, time) -> str:
    """Return a flight with its duration and sample rate."""
    steps = np.diff(np.asarray(time, dtype=float))
    steps = steps[steps > 0]
    if not steps.size:
        return name
    seconds = number(np.ptp(time), ".3g" if np.ptp(time) < 100 else ",.0f")
    return f"{name} ({seconds}{THIN}s at {number(1 / np.median(steps), '.3g')}{THIN}Hz)"


def _grouped(value: float | None, form: str = ".0f") -> str:
    return "" if value is None else number(value, "," + form).replace(",", THIN)


def flights(content: ReportContent, every: int, draw: bool) -> list[str]:
    """Return everything about each test flight; ``draw``: of the one predicted worst also pictures, for paper."""
    errors = [float(result.scores["measured"]["normalized_rmse"].mean()) for result in content.test]
    parts = []
    for result, error in zip(content.test, errors, strict=True):
        worst = not error < max(errors)
        body = _flight(result, content.model.noise_std, every, draw and worst)
        title = f"Test flight {text(result.name)}"
        if len(errors) <= MOST_OPEN:
            parts.append(_section(title, body, classes="flight"))
        else:
            parts.append(
                f"<details{' open' * worst}><summary><h2>{title}</h2></summary>{body}</details>"
            )
    return parts


def _flight(result: FlightResult, noise_std, every: int, draw: bool) -> str:
    scores = result.scores
    tables = error_table(scores["measured"], noise_std, against="measured coefficients")
    words = "▼ covers less than 90 %: too sure. ▲ covers more than 99 %: too wide."
    if "truth" in scores:
        tables += error_table(scores["truth"], against="truth", with_bands=False)
        words += (
            " Bands are judged against measured values alone: the true coefficients contain what "
            "no sensor saw, such "
            "as gusts, which no band promises to hold."
        )
    span = figures.busiest_span(result.time, result.mean)
    coefficients = figures.coefficient_figure(result, span, every, draw)
    parts = [
        f'<div class="pair">{tables}</div>',
        _note(words),
        "<h3>Coefficients</h3>",
        coefficients,
    ]
    errors, horizons = result.replay_errors, [] if result.replay is None else result.horizons()
    if result.replay is not None or errors is not None:
        parts.append("<h3>Replayed states</h3>")
    if errors is not None:
        parts.append(replay_table(errors[errors["horizon"].isin(horizons)] if horizons else errors))
    for horizon in horizons:
        parts.append(
            figures.state_figure(result, horizon, span, every, draw and horizon == horizons[0])
        )
    return "".join(parts)


def calibration(content: ReportContent) -> str:
    """Return how often intervals hold the measured values of all test flights."""
    whole = [
        np.concatenate([getattr(one, name) for one in content.test])
        for name in ("measured", "mean", "noisy_std")
    ]
    caption = (
        "Calibration: how often intervals, with the noise, hold the measured values of all test "
        "flights. On the dotted "
        "line they hold as often as they say."
    )
    return _section("Calibration", figure([figures.calibration_panel(*whole)], caption))


def effects(display: EffectsDisplay) -> str:
    """Return the largest effects of regressors on each output."""
    key = [("blue", "effect", ""), ("sky", "95 % band", "area"), ("measured", "samples", "|")]
    share = display.importance
    several = [name for name in share.index if name not in display.curves]
    parts = []
    for output in map(str, share):
        names = list(share.loc[list(display.curves), output].nlargest(N_EFFECTS).index)
        cells = "".join(
            f"<div><p>{symbol(str(output))} by {regressor(name)}</p>{panel}</div>"
            for name, panel in zip(
                names, figures.effect_panels(display, output, names), strict=True
            )
        )
        parts.append(f'<div class="panels quartet">{cells}</div>')
    caption = (
        f"For each coefficient the {N_EFFECTS} regressors whose effect varies most, on one scale, "
        f"with mean zero over "
        "the samples. Bands are wide where regressors moved together in the flights: the sum is "
        "then known better than "
        "its terms."
    )
    if several:
        rest = share.loc[several].pow(2).sum() ** 0.5 / share.pow(2).sum() ** 0.5
        words = ", ".join(
            f"{symbol(str(name))} {percent(value, '.0f')}" for name, value in rest.items()
        )
        caption += (
            f" What no single regressor explains, in percent of the spread of the effects: {words}."
        )
    return _section(
        "Effects",
        f"<figure>{key_of(key)}{''.join(parts)}<figcaption>{caption}</figcaption></figure>",
    )


def envelope(display: EnvelopeDisplay) -> str:
    """Return where the samples are, and where around them the model is uncertain."""
    key = [
        ("grey", "95 % and half of the samples learned from", "area"),
        ("blue", "relative uncertainty", ""),
        ("grey", "above 0.5: hardly known", "hatch"),
        *([] if display.path is None else [("vermillion", "test flights", "•")]),
    ]
    caption = (
        "Pairs of regressors; those that a panel does not show are at their medians. Lines: the "
        "standard deviation of "
        "the coefficients, over how much they vary where samples were flown: 0 where they are "
        "known, 1 where any value "
        "flown is as likely. Where a test flight, or a simulation, leaves the grey area for the "
        "hatched, coefficients "
        "are extrapolated."
    )
    return _section(
        "Where the model knows",
        figure(figures.envelope_panels(display), caption, key, layout="trio"),
    )


def flown(content: ReportContent, every: int, draw: bool) -> str:
    """Return the inputs and the path of every flight that came with its table."""
    flights = flown_tables(content)
    linked = {id(result.table): result.name for result in content.test}
    links = {name: linked.get(id(table), name) for name, table in flights.items()}
    parts = []
    positions = {"north", "east"}, {"v_north", "v_east"}
    tracked = {
        name: table
        for name, table in flights.items()
        if any(pair <= set(table) for pair in positions)
    }
    if tracked and draw:
        key = [
            (_color(k), name, figures.START_SIGNS[start_marker(k)])
            for k, name in enumerate(tracked)
        ]
        caption = "Path over the ground, north up; the flight's marker shows where it begins."
        if any("north" not in table.columns for table in tracked.values()):
            caption += (
                " Without recorded positions: integrated from the velocities, from the origin."
            )
        path = figure([figures.path_panel(tracked)], caption, key)
        parts.append(f'<div class="map">{path}{figures.flight_tracks(tracked, links)}</div>')
    inputs = "".join(
        figures.input_figure(table, name, links[name], _color(k), every)
        for k, (name, table) in enumerate(flights.items())
    )
    if len(flights) > MOST_OPEN:
        inputs = f"<details><summary>Inputs of {len(flights)} flights</summary>{inputs}</details>"
    return _section("What was flown", *parts, inputs)


def flown_tables(content: ReportContent) -> dict[str, pd.DataFrame]:
    """Return the flight tables by name: those learned from, then those tested on."""
    pairs = [(f"{name} (train)", table) for name, table in content.train.items()]
    pairs += [
        (f"{result.name} (test)", result.table)
        for result in content.test
        if result.table is not None
    ]
    tables: dict[str, pd.DataFrame] = {}
    for name, flight in pairs:
        twins = sum(other == name or other.startswith(f"{name} no. ") for other in tables)
        tables[f"{name} no. {twins + 1}" if twins else name] = flight
    return tables


def _color(k: int) -> str:
    """Return the name of the colour of the k-th flight."""
    return list(PALETTE)[k % len(CYCLE)]
