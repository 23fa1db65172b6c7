"""The report of an identification: one HTML file to read, print and sign. Text from outside is escaped."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterable
from datetime import datetime
from html import escape
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import text_writer
from skdgp._compute.messages import can_draw, notify
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import MIRRORED
from skdgp.dynamics import Trim, as_aerodynamics
from skdgp.identification import (
    THRESHOLDS,
    Changes,
    Evaluation,
    FlightMechanics,
    Identification,
    Verdict,
    score_table,
)
from skdgp.plotting import (
    Display,
    EffectsDisplay,
    TimeHistoryDisplay,
    display_unit,
    units_shown,
)

__all__ = ["render_report", "save_report"]

STYLE = files("skdgp.report").joinpath("page.css").read_text(encoding="utf-8")
PAGE = Template(files("skdgp.report").joinpath("page.html").read_text(encoding="utf-8"))
PICTURE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "skdgp",
    "font.size": 8,
    "savefig.dpi": 150,
}
SHOWN_FLIGHTS = 3  # with figures (guess)
EXCERPT = 15.0  # length of the look at a flight [s] (guess)

TRIM = ("airspeed", "altitude", "density", "climb", "alpha", "beta", "phi", "theta")
SYMMETRIC, ASYMMETRIC = ("CL", "CD", "Cm"), ("CY", "Cl", "Cn")
JUDGEMENTS = {"yes": "✓ yes", "partly": "◐ partly", "no": "✗ no", "unknown": "? not known"}
DERIVATIVES = (
    "Derivatives by angles [rad], pb/2V, qc/2V, rb/2V, and surfaces: slopes of the best linear "
    "approximation over a normal perturbation of each regressor (its size: metrics.json), ± standard "
    "deviations. ▼: the 95 % band holds both signs. Of aircraft: the effect of errors of its sizes, "
    "which all derivatives of a moment or force share; simulations with this aircraft have none."
)
MODES = (
    "Modes ± standard deviations: frequency [rad/s], time constant [s], negative where a mode "
    "diverges. ▼: its 95 % band holds decay and growth."
)
SIMULATION = (
    "Simulation of the test flights with the recorded controls, started again from measured states "
    "every horizon [s], in the wind and gusts where these are known, else in still air: spread in the "
    "flights, limit, root mean square error at the end, and how long [s] it lasts below its limit."
)
SCORES = (
    "Errors of the coefficients. ▼ covers less than 90 %: too sure. ▲ covers more than 99 %: too "
    "wide. Bands are judged against measured values alone: the true coefficients contain effects "
    "that no sensor saw, such as gusts, which no band promises to hold."
)
EFFECTS = (
    "For each coefficient the regressors along which it changes most, on one scale, the others as in "
    "the trim (vertical line), with the 95 % band. Short lines are quantiles of the samples."
)
HOW_TO_READ = (
    "NRMSE: root mean squared error over the standard deviation of the values; 1 is no better than "
    "their mean. Coverage: fraction of the values inside the band of 1.96 standard deviations; 0.95 "
    "when the band is honest.",
    "± in tables is one standard deviation. Figures and the verdict have 95 % bands.",
    f"Thresholds. Predict: errors of at most {THRESHOLDS.error:g} of the spread of the coefficients, "
    f"and 95 % bands that hold at least {100 * THRESHOLDS.coverage:.0f} %. Simulate, with the "
    "recorded controls from measured states: root mean square errors of at most "
    f"{THRESHOLDS.error:g} of the spread of each state, or 3 times the noise of its sensor. Design a "
    f"controller: 95 % bands of at most ± {100 * THRESHOLDS.band:.0f} % for the derivatives by the "
    "controls and the frequencies of the fast modes, and bands that hold at least "
    f"{100 * THRESHOLDS.held:.0f} % of the measured values of each coefficient.",
    "Coefficients are in body axes: x forward, y right, z down. A right click, or a long press, "
    "saves a figure as an SVG file.",
)
# the page to sign
SIGN = '<div class="sign"><p>Prepared</p><p>Checked</p><p>Approved</p></div>'
NO_FIGURES = 'No figures: they need matplotlib, pip install "skdgp[plot]".'


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
    created = datetime.fromisoformat(result.created)
    count = f"flights: {len(result.train)} training, {len(result.evaluations)} test"
    meta = f"{result.aircraft.name} · {count} · {created:%d %B %Y, %H:%M}"
    with units_shown(result.pipeline.control_units or {}):
        body = "\n".join(_sections(result, effects))
    return PAGE.substitute(title=escape(result.title), meta=escape(meta), body=body, style=STYLE)


def _sections(result: Identification, effects: EffectsDisplay | None) -> list[str]:
    """Return all sections in their order; those without content are empty."""
    done = {**result.facts, "Command": result.command}
    done = {name: value for name, value in done.items() if value}
    scores = {flight.name: score_table([flight]) for flight in result.evaluations}
    return [
        _verdict(result.verdict, scores),
        _changes(result.changes),
        section("What was assumed", bullets(result.assumed)),
        "" if can_draw() else paragraphs([NO_FIGURES]),
        _mechanics(result.mechanics),
        _simulation(result.mechanics),
        *_flights(result.evaluations, scores),
        section("Effects", "" if effects is None else figure(effects, EFFECTS)),
        _flown(result),
        section("What was done", facts(done), SIGN),
        section("How to read", paragraphs(HOW_TO_READ)),
    ]


def section(title: str, *parts: str) -> str:
    """Return a section of ready HTML, empty without parts."""
    body = "".join(parts)
    return f"<section><h2>{escape(title)}</h2>{body}</section>" if body else ""


def paragraphs(sentences: Iterable[str]) -> str:
    """Return texts as paragraphs."""
    return "".join(f"<p>{escape(text)}</p>" for text in sentences)


def bullets(lines: Iterable[str]) -> str:
    """Return texts as a list, empty without texts."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<ul class="alerts">{items}</ul>' if items else ""


def table(frame: pd.DataFrame | pd.Series, caption: str = "", *, header: bool = True) -> str:
    """Return a table with its caption; numbers have three digits."""
    frame = pd.DataFrame(frame)
    with pd.option_context("display.max_colwidth", None):
        rows = frame.to_html(header=header, float_format=number, na_rep="–", border=0)
    return f'<div class="scroll">{rows}{paragraphs([caption] if caption else [])}</div>'


def facts(values: Any) -> str:
    """Return values by name as a table of two columns."""
    return table(pd.Series(values, dtype=object), header=False)


def number(value: Any, form: str = ".3g") -> str:
    """Return a number with a true minus, and the sign for infinity."""
    return f"{value:z{form}}".replace("-", "−").replace("inf", "∞")


def with_std(value: Any, std: Any) -> str:
    """Return a value and its standard deviation, where this is known and not zero."""
    return f"{number(value)} ± {number(std, '.2g')}" if std > 0 else number(value)


def marked(shown: str, lower: Any, upper: Any) -> str:
    """Return a value, marked if its band holds both signs."""
    return f"▼ {shown}" if lower * upper <= 0 or np.isinf(lower * upper) else shown


def figure(display: Display, caption: str) -> str:
    """Return the picture of a display, an SVG file that a reader can save; nothing without matplotlib."""
    if not can_draw():
        return ""
    import matplotlib
    from matplotlib.figure import Figure

    file = BytesIO()
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **PICTURE}):
        canvas = Figure(figsize=display.figsize, layout="constrained")
        display.plot(canvas)
        canvas.savefig(file, format="svg", metadata={"Date": None})
    source = f"data:image/svg+xml;base64,{b64encode(file.getvalue()).decode()}"
    text = escape(caption)
    return f'<figure><img alt="{text}" src="{source}"><figcaption>{text}</figcaption></figure>'


def _verdict(verdict: Verdict, scores: dict[str, pd.DataFrame]) -> str:
    """Return the verdict on the model, and its errors on each of several test flights."""
    uses = pd.DataFrame(
        {
            use.purpose: {"": JUDGEMENTS[use.judgement], "because": use.reason}
            for use in verdict.uses
        }
    ).T
    by_flight = pd.DataFrame({name: table.loc["mean"] for name, table in scores.items()}).T
    return section(
        "Verdict",
        paragraphs([f"On the test flights: {verdict.compared()}."]),
        table(uses, "What the model is good enough for."),
        bullets(verdict.warnings) or paragraphs(["No warning arose."]),
        table(by_flight, "Means of the test flights.") if len(scores) > 1 else "",
    )


def _changes(changes: Changes | None) -> str:
    """Return whether the aircraft has changed since its model was learned."""
    if changes is None:
        return ""
    shown = paragraphs(finding.text for finding in changes.findings)
    p_values = table(changes.p_values, "p-values of no change.")
    return section("Has the aircraft changed?", shown, p_values)


def _mechanics(mechanics: FlightMechanics) -> str:
    """Return trim, derivatives and modes."""
    parts = [paragraphs(note.text for note in mechanics.notes)]
    trim = mechanics.trim
    if trim is not None:
        parts.append(paragraphs(["Steady flight in the middle of the training range:"]))
        parts.append(facts(steady_flight(trim)))
    if len(mechanics.derivatives):
        parts.append(table(derivative_table(mechanics.derivatives), DERIVATIVES))
    if mechanics.modes is not None:
        parts.append(table(mode_table(mechanics.modes), MODES))
    return section("Trim, derivatives and modes", *parts)


def steady_flight(trim: Trim) -> dict[str, str]:
    """Return state and controls of steady flight with their units, as text."""
    flight = {name: vars(trim)[name] for name in TRIM}
    shown = {}
    for name, value in (flight | trim.controls).items():
        factor, unit = display_unit("theta" if name == "climb" else name)
        shown[name] = f"{number(factor * value, '.4g')} {unit}"
    return shown


def derivative_table(table: pd.DataFrame) -> pd.DataFrame:
    """Return derivatives of each plane by the regressors that move in it, as text."""
    is_lateral = table["regressor"].isin(MIRRORED)
    is_of_plane = table["coefficient"].isin(ASYMMETRIC) == is_lateral
    is_shown = table["coefficient"].isin((*SYMMETRIC, *ASYMMETRIC)) & (table["regressor"] != "")
    columns = ["value", "std", "lower", "upper", "std_aircraft", "per"]
    table = table[is_of_plane & is_shown].reindex(columns=columns)
    values = [
        marked(with_std(row.value, row.std), row.lower, row.upper) for row in table.itertuples()
    ]
    shown = pd.DataFrame({"model": values, "± of aircraft": table["std_aircraft"]}, table.index)
    return shown.assign(per=table["per"]).dropna(axis=1, how="all")


def mode_table(modes: pd.DataFrame) -> pd.DataFrame:
    """Return frequency, damping and time constant of each mode as text."""
    shown = {}
    names = ("frequency", "damping", "time_constant")
    columns = [name + suffix for name in names for suffix in ("", "_std", "_lower", "_upper")]
    for row in modes.reindex(columns=columns).itertuples():
        lower, upper = row.time_constant_lower, row.time_constant_upper
        shown[row.Index] = {
            "frequency": with_std(row.frequency, row.frequency_std),
            "damping": with_std(row.damping, row.damping_std),
            "time constant": marked(number(row.time_constant), lower, upper),
        }
    return pd.DataFrame(shown).T


def _simulation(mechanics: FlightMechanics) -> str:
    """Return how long a free simulation follows the test flights."""
    if mechanics.simulation is None:
        return ""
    errors = mechanics.simulation
    units = pd.DataFrame(map(display_unit, errors.index), errors.index, ["factor", "unit"])
    sizes = errors[["spread", "limit", "error"]].mul(units["factor"], axis=0)
    names = [f"{name} [{unit}]" for name, unit in units["unit"].items()]
    return section("Simulation", table(errors.assign(**sizes).set_axis(names), SIMULATION))


def _flights(flights: list[Evaluation], scores: dict[str, pd.DataFrame]) -> list[str]:
    """Return the errors of each test flight, and figures of those predicted worst."""
    worst = sorted(scores, key=lambda name: -scores[name]["NRMSE"]["mean"])[:SHOWN_FLIGHTS]
    parts = []
    for flight in flights:
        shown = scores[flight.name]
        held = shown["in 95 % band"].map(_coverage)
        body = table(shown.assign(**{"in 95 % band": held}), SCORES)
        if flight.name in worst:
            body += _figures(flight)
        parts.append(section(f"Test flight {flight.name}", body))
    return parts


def _coverage(held: float) -> str:
    """Return a coverage, marked where it is below the threshold or above 99 %."""
    shown = number(held)
    if held < THRESHOLDS.coverage:
        return f"▼ {shown}"
    return f"▲ {shown}" if held > THRESHOLDS.widest else shown


def _figures(result: Evaluation) -> str:
    """Return the coefficients of a long flight where the estimates move most."""
    time = result.table["time"].to_numpy(float)
    rows = liveliest_rows(time, result.mean)
    display = TimeHistoryDisplay.from_predictions(
        time[rows],
        result.measured[rows],
        result.mean[rows],
        result.prediction_std[rows],
        truth=None if result.truth is None else result.truth[rows],
        ax=False,
    )
    caption = f"Coefficients of {result.name}"
    if rows != slice(None):
        caption += f", the {EXCERPT:g} s in which the estimates move most"
    return figure(display, f"{caption}.")


def liveliest_rows(time: Vector, values: Matrix) -> slice:
    """Return the rows of the `EXCERPT` with the most motion of ``values``; all of a short record.

    Motion is the sum of squared steps, each column in units of its standard deviation.
    """
    n = max(1, int(EXCERPT / np.median(np.diff(time))))
    if len(time) < 1.5 * n:
        return slice(None)
    motion = pd.DataFrame(values).diff().pow(2) / np.nanvar(values, axis=0)
    begin = int(motion.sum(axis=1).rolling(n).sum().argmax()) + 1 - n
    return slice(begin, begin + n)


def _flown(result: Identification) -> str:
    """Return the inputs of the flights."""
    flown = {f"{name} (train)": flight for name, flight in result.train.items()}
    flown |= {f"{tested.name} (test)": tested.table for tested in result.evaluations}
    figures = [
        figure(TimeHistoryDisplay.from_inputs(flight, ax=False), f"Inputs of {name}.")
        for name, flight in flown.items()
    ]
    return section("What was flown", *figures)
