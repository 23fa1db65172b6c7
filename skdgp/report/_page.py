"""The report as one HTML file: its sections in their order."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.files import text_writer
from skdgp._compute.messages import can_draw, notify
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import LATERAL, LONGITUDINAL, MIRRORED
from skdgp.dynamics import Trim, as_aerodynamics
from skdgp.identification import (
    THRESHOLDS,
    Changes,
    Evaluation,
    FlightMechanics,
    Identification,
    Verdict,
)
from skdgp.plotting import (
    EffectsDisplay,
    FrequencyDisplay,
    TimeHistoryDisplay,
    display_unit,
    units_shown,
)
from skdgp.report._html import (
    THIN,
    figure,
    lowered,
    number,
    percent,
    render_page,
    section,
    table,
    text,
)

NRMSE = "normalized_rmse"
GROUPS = {"Longitudinal": LONGITUDINAL, "Lateral": LATERAL}
# Regressors in a heading; others stand as they are
REGRESSORS = {
    "alpha": "α", "beta": "β", "alpha_dot": "dα/dt", "beta_dot": "dβ/dt",
    "p_hat": "pb/2V", "q_hat": "qc/2V", "r_hat": "rb/2V",
}  # fmt: skip


def coverage(value: float) -> str:
    """Return a coverage in percent, marked when it is below the threshold or above 99 %."""
    shown = percent(value)
    if value < THRESHOLDS.coverage:
        return f'<span class="off" title="too sure">▼ {shown}</span>'
    if value > 0.99:
        return f'<span class="off" title="too wide">▲ {shown}</span>'
    return shown


def regressor(name: str) -> str:
    """Return a regressor's name as a heading writes it."""
    return text(REGRESSORS.get(name, name.replace("_", " ")))


def derivative(coefficient: str, name: str) -> str:
    """Return a derivative's name with its indices lowered."""
    return f'<span class="name"><i>C</i><sub>{coefficient[1:]} {regressor(name)}</sub></span>'


_thousandths = partial(number, form=".3f")
_three_digits = partial(number, form=".3g")


class Column(NamedTuple):
    """Heading and format of the values of a column."""

    heading: str
    show: Callable[[Any], str]


# Columns of the tables of errors, by their names in metrics.json
SCORES = {
    "normalized_rmse": Column("NRMSE", _thousandths),
    "least_squares_normalized_rmse": Column("NRMSE of<br>least squares", _thousandths),
    "interval_coverage": Column("95 %<br>coverage [%]", coverage),
}


# Columns of simulations and of frequency responses
SIMULATION = {
    "spread": Column("spread in<br>the flights", _three_digits),
    "limit": Column("limit", _three_digits),
    "error": Column("error at<br>the end", _three_digits),
    "lasts": Column("follows<br>for [s]", _three_digits),
    "horizon": Column("of [s]", _three_digits),
    "lasts_without_gusts": Column("less gusts<br>for [s]", _three_digits),
    "gusts": Column("gusts<br>[m/s]", _three_digits),
}
DERIVATIVES = {
    "model": Column("model", str),
    "least_squares": Column("least squares", _three_digits),
    "of_aircraft": Column("± of<br>aircraft", _three_digits),
}
RESPONSES = {
    "lowest": Column("excited<br>from [rad/s]", _three_digits),
    "highest": Column("to [rad/s]", _three_digits),
    "gain": Column("gain<br>[dB]", _three_digits),
    "phase": Column("phase<br>[deg]", _three_digits),
}


def _cells(row: pd.Series, columns: Mapping[str, Column]) -> list[str]:
    """Return the values of a row in the columns that it has."""
    return [column.show(row[name]) for name, column in columns.items() if name in row]


def frame_table(
    frame: pd.DataFrame,
    columns: Mapping[str, Column],
    caption: str,
    classes: str = "numbers narrow",
) -> str:
    """Return a table of the columns that a frame has, whose index is ready HTML."""
    rows = [[str(name), *_cells(row, columns)] for name, row in frame.iterrows()]
    head = ["", *(column.heading for name, column in columns.items() if name in frame)]
    return table(head, rows, caption=caption, classes=classes)


def error_table(scores: pd.DataFrame, *, against: str) -> str:
    """Return errors by coefficient, grouped, with the mean of each group."""
    rows = []
    for group, members in GROUPS.items():
        of_group = scores.loc[list(members)]
        rows.append([group])
        for name, row in of_group.iterrows():
            rows.append([lowered(str(name)), *_cells(row, SCORES)])
        rows.append(["<em>mean</em>", *_cells(of_group.mean(), SCORES)])
    head = ["", *(column.heading for name, column in SCORES.items() if name in scores)]
    return table(head, rows, caption=f"Errors against {against}.", classes="numbers")


def state(name: str) -> str:
    """Return a state's name as the paper writes it."""
    axes = {"v_north": "N", "v_east": "E", "v_down": "D"}
    if name in REGRESSORS:
        return regressor(name)
    return f"<i>v</i><sub>{axes[name]}</sub>" if name in axes else f"<i>{text(name)}</i>"


def facts(pairs: Iterable[tuple[str, object]]) -> str:
    """Return a list of facts; pairs without a value are left out."""
    lines = ""
    for term, value in pairs:
        if value:
            lines += f"<div><dt>{text(term)}</dt><dd>{text(value)}</dd></div>"
    return f'<dl class="facts">{lines}</dl>' if lines else ""


_JUDGEMENTS = {
    "yes": '<b class="yes">✓ yes</b>',
    "partly": '<b class="partly">◐ partly</b>',
    "no": '<b class="off">✗ no</b>',
    "unknown": "? not known",
}
_THRESHOLDS = (
    f"<b>Thresholds.</b> Predict: errors of at most {THRESHOLDS.error:g} of the spread of the "
    f"coefficients, and 95 % bands that hold at least {100 * THRESHOLDS.coverage:.0f} %. Simulate, "
    f"with the recorded controls from measured states: root mean square errors of at most "
    f"{THRESHOLDS.error:g} of the spread of each state, or 3 times the noise of its sensor. Design "
    f"a controller: 95 % bands of at most ±{THIN}{100 * THRESHOLDS.band:.0f}{THIN}% for the "
    f"derivatives by the controls and the frequencies of the fast modes, and bands that hold at "
    f"least {100 * THRESHOLDS.held:.0f} % of the measured values of each coefficient."
)
SLOPES = (
    "Derivatives are slopes of the best linear approximation over a normal perturbation of each "
    "regressor, with the standard deviation flown around the trims; see metrics.json for its size."
)
OF_AIRCRAFT = (
    "± of aircraft: the effect of errors of its sizes, which all derivatives of a moment or force "
    "share; it does not matter for simulations with this aircraft."
)
SIMULATED_STATES = ("airspeed", "alpha", "phi", "theta", "p", "q")
# Captions of the displays of the model
EFFECTS = (
    "For each coefficient the regressors along which it changes most, on one scale, the others as in "
    "the trim (vertical line), with the 95 % band. Short lines are quantiles of the samples."
)
SIMULATED = (
    "One of these simulations, from a measured state with the recorded controls. The band holds 95 % "
    "of the aircraft that the model allows, in the same air: gusts that no sensor shows are not in "
    "it."
)
FREQUENCY_ERRORS = (
    "Frequency responses of the test flights: the band that they excite, and root mean square "
    "differences of the model there."
)
FREQUENCY = (
    "Responses estimated from the test flights without a model, where they are excited, with 95 % "
    "errors, and the model's with the band of 95 % of its aircraft; beneath each gain its phase."
)
HOW_TO_READ = (
    '<div class="note"><p><b>NRMSE</b>: root mean squared error over the standard deviation of the '
    "values; 1 is no better than their mean. <b>95 % coverage</b>: share of the values inside the "
    "band of 1.96 standard deviations; 95 when the band is honest.</p>"
    "<p><b>±</b> in tables is one standard deviation. Figures and the verdict have 95 % bands.</p>"
    f"<p>{_THRESHOLDS}</p>"
    "<p>Coefficients are in body axes: <i>x</i> forward, <i>y</i> right, <i>z</i> down. A right "
    "click, or a long press, saves a figure as an SVG file.</p></div>"
)
# Shown in print, too: the page to sign
SIGN = '<div class="sign"><p>Prepared</p><p>Checked</p><p>Approved</p></div>'
NO_FIGURES = 'No figures: they need matplotlib, pip install "skdgp[plot]".'
GROUPED = {"Longitudinal": ("CL", "CD", "Cm"), "Lateral": ("CY", "Cl", "Cn")}


# What a reader takes in (guesses): warnings in the verdict, others stand below it; flights with
# figures, of more only the one that is predicted worst has them; length of the look at a flight [s]
SHOWN_WARNINGS = 3
SHOWN_FLIGHTS = 3
EXCERPT = 15.0


def save_report(result: Identification, path: str | os.PathLike) -> Path:
    """Write report.html beside the files of `Identification.save` into a folder, all or none."""
    notify("report")
    page = text_writer(render_report(result, _effects(result) if can_draw() else None))
    return result.save(path, **{"report.html": page})


def _effects(result: Identification) -> EffectsDisplay:
    """Return slices of a model through its trim, through the mean of the flights if it has none."""
    aerodynamics: Any = as_aerodynamics(result.pipeline)
    rows = pd.DataFrame(aerodynamics.learned.training_rows(), columns=aerodynamics.regressors)
    trim = result.mechanics.trim
    steady = {} if trim is None else {"alpha": trim.alpha, "beta": trim.beta, **trim.controls}
    at = {name: steady[name] for name in aerodynamics.regressors if name in steady}
    return EffectsDisplay.from_estimator(result.pipeline[-2:], rows, at, ax=False)


def render_report(result: Identification, effects: EffectsDisplay | None = None) -> str:
    """Return the report as one HTML document that needs nothing else, no network, no script.

    Its figures are SVG images. Without matplotlib it has no figures and says so.
    """
    count = f"flights: {len(result.train)} training, {len(result.evaluations)} test"
    created = datetime.fromisoformat(result.created)
    meta = f"{text(result.aircraft.name)} · {count} · {created:%d %B %Y, %H:%M}"
    colophon = "Made by skdgp. SI units; degrees in figures and in the table of states."
    with units_shown(result.units):
        body = _with_contents(_sections(result, effects))
    return render_page("Aerodynamic identification report", result.title, meta, body, colophon)


def _sections(result: Identification, effects: EffectsDisplay | None) -> list[str]:
    """Return all sections in their order; those without content are empty."""
    draw = can_draw()
    further = _list(result.verdict.warnings[SHOWN_WARNINGS:], "ul", "alerts")
    sections = [
        _verdict(result),
        _changes(result.changes),
        section("Further warnings", further),
        section("What was assumed", _list(result.assumed)),
    ]
    if not draw:
        sections.append(_note(NO_FIGURES))
    sections.append(_mechanics(result.mechanics))
    sections.append(_simulation(result.mechanics, draw))
    sections.append(_frequency(result.mechanics, draw))
    sections += _flights(result, draw)
    if draw and effects is not None:
        sections.append(section("Effects", figure(effects, EFFECTS)))
    if draw:
        sections.append(_flown(result))
    done = facts([*result.facts.items(), ("Command", result.command)])
    sections.append(section("What was done", done, SIGN))
    sections.append(section("How to read", HOW_TO_READ))
    return sections


def _changes(changes: Changes | None) -> str:
    """Return whether the aircraft has changed since its model was learned."""
    if changes is None:
        return ""
    lines = "".join(f"<p>{text(line)}</p>" for line in changes.summary())
    p_values = changes.p_values.to_html(float_format="{:.2g}".format, border=0)
    return section("Has the aircraft changed?", lines, p_values)


def _with_contents(sections: Iterable[str]) -> str:
    """Return the sections, numbered in a list of contents before them."""
    links = ""
    body = ""
    for k, part in enumerate(filter(None, sections)):
        heading = re.search(r"<h2>(.*?)</h2>", part)
        if heading:
            links += f' <a href="#s{k}">{heading[1]}</a>'
            part = part.replace("<h2>", f'<h2 id="s{k}">', 1)
        body += part + "\n"
    return f'<nav class="contents">{links.strip()}</nav>\n{body}'


def _note(sentence: str) -> str:
    return f'<p class="note">{sentence}</p>' if sentence else ""


def _verdict(result: Identification) -> str:
    """Return the verdict on the model in the air that was flown, and its errors on each test flight."""
    verdict = result.verdict
    air = f"Air: {text(result.air)}." if result.air else "The air was not estimated."
    uses = [
        [text(use.purpose), _JUDGEMENTS[use.judgement], text(use.reason)] for use in verdict.uses
    ]
    head = ["good enough to", "", "because"]
    alerts = _note("No warning arose.")
    if verdict.findings:
        alerts = _list(verdict.warnings[:SHOWN_WARNINGS], "ol", "alerts")
    return section(
        "Verdict",
        f"<p>{text(verdict.learned)} {air}</p>",
        _error_and_coverage(verdict),
        table(head, uses, caption="What the model is good for.", classes="words"),
        f"<p>{text(verdict.compared())}.</p>",
        alerts,
        _errors_by_flight(result.evaluations) if len(result.evaluations) > 1 else "",
    )


def _error_and_coverage(verdict: Verdict) -> str:
    """Return the error, beside the one of least squares, and the coverage of 95 % bands."""
    beside = ""
    if verdict.least_squares_error is not None:
        beside = f"<span>least squares {_thousandths(verdict.least_squares_error)}</span>"
    return (
        f'<div class="head"><div><b>{_thousandths(verdict.error)}</b><span>error over spread '
        f"(NRMSE), mean of the coefficients</span>{beside}</div><div><b>{percent(verdict.coverage)}"
        "<small>%</small></b><span>of measured values inside the 95 % band</span>"
        "<span>95 is right</span></div></div>"
    )


def _errors_by_flight(flights: Sequence[Evaluation]) -> str:
    rows = {}
    for flight in flights:
        means = flight.scores["measured"].mean().to_dict()
        rows[text(flight.name)] = {"length": np.ptp(flight.time), **means}
    columns = {"length": Column("length<br>[s]", _three_digits), **SCORES}
    caption = "Test flights, against measured values: means of the six coefficients."
    return frame_table(pd.DataFrame.from_dict(rows, orient="index"), columns, caption, "numbers")


def _of_plane(derivatives: pd.DataFrame, plane: str) -> pd.DataFrame:
    """Return the derivatives of the coefficients of a plane by the regressors that move in it."""
    names = GROUPED[plane]
    moves_in_it = derivatives["regressor"].isin(MIRRORED) == (plane == "Lateral")
    is_of_it = derivatives["coefficient"].isin(names) & (derivatives["regressor"] != "")
    return derivatives[is_of_it & moves_in_it].sort_values(
        "coefficient", key=lambda c: c.map(names.index), kind="stable"
    )


def _list(lines: Iterable[str], kind: str = "ul", classes: str = "") -> str:
    items = "".join(f"<li>{text(line)}</li>" for line in lines)
    return f'<{kind} class="{classes}">{items}</{kind}>' if items else ""


def _mechanics(mechanics: FlightMechanics) -> str:
    """Return trim, derivatives and modes."""
    parts = [_note(text(note.text)) for note in mechanics.notes]
    if mechanics.trim is not None:
        parts.append("<p>Steady flight in the middle of the training range:</p>")
        parts.append(_trim(mechanics.trim))
    if len(mechanics.derivatives):
        tables = [_derivatives(mechanics, plane) for plane in GROUPED]
        parts.append(_note(SLOPES))
        parts.append(f'<div class="pair">{"".join(tables)}</div>')
    if "std_aircraft" in mechanics.derivatives:
        parts.append(_note(OF_AIRCRAFT))
    if mechanics.modes is not None:
        parts.append(_modes(mechanics.modes))
    return section("Trim, derivatives and modes", *parts)


def _trim(trim: Trim) -> str:
    """Return state and controls of a steady flight."""
    shown = []
    for name in ("airspeed", "altitude", "density", "alpha", "theta", "phi", "climb"):
        factor, unit = display_unit("theta" if name == "climb" else name)
        shown.append((name, f"{number(factor * getattr(trim, name), '.4g')} {unit}"))
    for name, value in trim.controls.items():
        factor, unit = display_unit(name)
        shown.append((name, f"{number(factor * value, '.4g')} {unit}"))
    return facts(shown)


def _derivatives(mechanics: FlightMechanics, plane: str) -> str:
    """Return the derivatives of one plane."""
    derivatives = _of_plane(mechanics.derivatives, plane)
    names = [derivative(*row) for row in derivatives[["coefficient", "regressor"]].to_numpy()]
    shown = pd.DataFrame({"model": [_value(row) for _, row in derivatives.iterrows()]}, index=names)
    if mechanics.least_squares is not None:
        linear = mechanics.least_squares["value"].reindex(derivatives.index)
        shown["least_squares"] = linear.to_numpy()
    if "std_aircraft" in derivatives:
        shown["of_aircraft"] = derivatives["std_aircraft"].to_numpy()
    caption = (
        f"{plane} derivatives, by angles [rad] and by pb/2V, qc/2V, rb/2V: values ± standard "
        "deviations. ▼: the 95 % band holds both signs."
    )
    if "merged" in derivatives and derivatives["merged"].any():
        caption += " Derivatives by q and r include the effect of alpha_dot and beta_dot."
    if "per" in derivatives and derivatives["per"].eq("full throw").any():
        caption += " Those by surfaces are by their full throw."
    return f"<div>{frame_table(shown, DERIVATIVES, caption, 'numbers named')}</div>"


def _value(row: pd.Series) -> str:
    """Return a derivative with its standard deviation, marked if its band holds both signs."""
    value = _with_std(row["value"], row.get("std"))
    is_signed = row.get("lower", 1.0) * row.get("upper", 1.0) > 0
    return value if is_signed else f'<span class="off">▼ {value}</span>'


def _with_std(value: float, std: float | None) -> str:
    """Return a value and its standard deviation, both to the second digit of that."""
    if std is None or not np.isfinite(std) or std <= 0:
        return number(value, ".3g")
    digits = int(np.clip(1 - np.floor(np.log10(std)), 0, 6))
    return f"{number(value, f'.{digits}f')} ± {number(std, f'.{digits}f')}"


def _modes(modes: pd.DataFrame) -> str:
    rows = {}
    for name, row in modes.drop(columns="eigenvalue").iterrows():
        time = number(row["time_constant"], ".3g")
        limits = row.get("time_constant_lower", 1.0) * row.get("time_constant_upper", 1.0)
        rows[text(name)] = {
            "frequency": _with_std(row["frequency"], row.get("frequency_std")),
            "damping": _with_std(row["damping"], row.get("damping_std")),
            "time": time if 0 < limits < np.inf else f'<span class="off">▼ {time}</span>',
        }
    caption = (
        "Modes: values ± standard deviations. The time constant is negative where a mode diverges. "
        "▼: its 95 % band holds decay and growth."
    )
    columns = {
        "frequency": Column("frequency<br>[rad/s]", str),
        "damping": Column("damping<br>ratio", str),
        "time": Column("time constant<br>[s]", str),
    }
    return frame_table(pd.DataFrame.from_dict(rows, orient="index"), columns, caption)


def _simulation(mechanics: FlightMechanics, draw: bool) -> str:
    """Return how long a free simulation follows the test flights, and one flight with its bands."""
    parts = []
    if mechanics.simulation_note is not None:
        parts.append(_note(f"Not simulated: {text(mechanics.simulation_note.clause)}."))
    if mechanics.simulation is not None:
        parts.append(_simulation_errors(mechanics.simulation))
    if draw and mechanics.simulated is not None:
        paths, mean, flown = mechanics.simulated
        names = [name for name in SIMULATED_STATES if name in flown]
        display = TimeHistoryDisplay.from_trajectories(
            paths, flown, mean=mean, columns=names, ax=False
        )
        parts.append(figure(display, SIMULATED))
    return section("Simulation", *parts)


def _simulation_errors(errors: pd.DataFrame) -> str:
    """Return the table of the errors of each state, and how long they stay below their limits."""
    caption = (
        "Simulation of the test flights with the recorded controls, started again from measured "
        "states, in the estimated wind and gusts, else in still air: root mean square error at "
        "the end, and how long it stays below the limit. Less gusts: without the part of the error that "
        "gusts explain, which are not estimated."
    )
    units = pd.DataFrame(
        [display_unit(str(name)) for name in errors.index], columns=["factor", "unit"]
    )
    shown = errors.set_axis(
        errors.index.map(lambda name: state(str(name))) + " [" + units["unit"] + "]"
    )
    sizes = ["spread", "limit", "error"]
    shown[sizes] = shown[sizes].mul(units["factor"].to_numpy(), axis=0)
    if shown["gusts"].max() == 0:
        shown = shown.drop(columns=["gusts", "lasts_without_gusts"])
    return frame_table(shown, SIMULATION, caption)


def _frequency(mechanics: FlightMechanics, draw: bool) -> str:
    """Return the model's errors of frequency responses in the test flights, and the responses."""
    parts = []
    if mechanics.frequency_note is not None:
        parts.append(_note(text(mechanics.frequency_note.text)))
    errors = mechanics.frequency_errors
    if errors is not None:
        parts.append(frame_table(errors.rename(text), RESPONSES, FREQUENCY_ERRORS))
    if draw and mechanics.frequency is not None:
        display = FrequencyDisplay(responses=mechanics.frequency)
        parts.append(figure(display, FREQUENCY, display.phases()))
    return section("Frequency responses", *parts)


def _flights(result: Identification, draw: bool) -> list[str]:
    """Return errors and figures of each test flight; of many, figures of the one predicted worst."""
    flights = result.evaluations
    errors = [float(flight.scores["measured"][NRMSE].mean()) for flight in flights]
    parts = []
    for flight, error in zip(flights, errors, strict=True):
        body = _errors(flight)
        if draw and (len(errors) <= SHOWN_FLIGHTS or not error < max(errors)):
            body += _figures(flight)
        parts.append(section(f"Test flight {text(flight.name)}", body, classes="flight"))
    return parts


def _errors(result: Evaluation) -> str:
    """Return the errors of a test flight."""
    scores = result.scores
    tables = error_table(scores["measured"], against="measured coefficients")
    legend = "▼ covers less than 90 %: too sure. ▲ covers more than 99 %: too wide."
    if "truth" in scores:
        tables += error_table(scores["truth"].drop(columns="interval_coverage"), against="truth")
        legend += (
            " Bands are judged against measured values alone: the true coefficients contain effects "
            "that no sensor saw, such as gusts, which no band promises to hold."
        )
    return f'<div class="pair">{tables}</div>{_note(legend)}'


def _figures(result: Evaluation) -> str:
    """Return coefficients with residuals, and replayed states, of a long flight where the estimates move most."""
    rows = liveliest_rows(result.time, result.mean)
    display = TimeHistoryDisplay.from_predictions(
        result.time[rows],
        result.measured_as_in_fit[rows],
        result.mean[rows],
        result.prediction_std[rows],
        truth=None if result.truth is None else result.truth[rows],
        ax=False,
    )
    caption = f"Coefficients of {text(result.name)}"
    if rows != slice(None):
        caption += f", the {EXCERPT:g}{THIN}s in which the estimates move most"
    caption += ", and beneath each measured less estimated, in the 95 % band."
    body = figure(display, caption, display.residuals())
    if result.replay is None:
        return body
    horizon = number(result.replay["horizon"].iloc[0], "g")
    caption = (
        f"Coefficients of {text(result.name)} in motion (the paper's figure 7): states integrated "
        f"from the coefficients estimated at the measured states, restarted from the measured state "
        f"every {horizon}{THIN}s. No control or stability of the aircraft corrects their drift, so "
        f"this is not a simulation."
    )
    states = TimeHistoryDisplay.from_replay(result.replay[rows], result.table[rows], ax=False)
    return body + figure(states, caption)


def liveliest_rows(time: Vector, values: Matrix, length: float = EXCERPT) -> slice:
    """Return the rows of the ``length`` seconds with the most motion of ``values``; all rows of a short record.

    Motion is the sum of squared steps, each column in units of its standard deviation.
    """
    n = max(1, int(length / np.median(np.diff(time))))
    if len(time) < 1.5 * n:
        return slice(None)
    spread = np.nanstd(values, axis=0)
    steps = np.diff(values[:, spread > 0] / spread[spread > 0], axis=0)
    moved = np.cumsum(np.nansum(steps**2, axis=1))
    begin = int(np.argmax(moved[n - 1 :] - moved[: len(moved) - n + 1]))
    return slice(begin, begin + n)


def _flown(result: Identification) -> str:
    """Return the inputs of the flights."""
    parts = []
    for name, flight in result.train.items():
        parts.append(_inputs(f"{name} (train)", flight))
    for tested in result.evaluations:
        parts.append(_inputs(f"{tested.name} (test)", tested.table))
    return section("What was flown", *parts)


def _inputs(name: str, flight: pd.DataFrame) -> str:
    display = TimeHistoryDisplay.from_inputs(flight, ax=False)
    return figure(display, f"Inputs of {text(name)}.")
