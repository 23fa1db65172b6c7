"""The flight card of a plan, to print and to fly from."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import text_writer, write_atomically
from skdgp._display.page import (
    DASH,
    THIN,
    can_draw,
    figure,
    number,
    percent,
    render_page,
    strip,
    symbol,
    table,
    text,
)
from skdgp._display.style import PALETTE, ROLES, display_unit, tidy
from skdgp._excitation import Steps
from skdgp._flight.channels import HAT
from skdgp.design._envelope import GROWTH, QUANTITIES, quantities
from skdgp.design._information import errors_of
from skdgp.design._plan import Plan
from skdgp.design._rehearsal import REACTION, RESPONSE

QUICK = 0.5  # shortest step that a pilot can time by counting [s]
SHOWN = (
    "alpha",
    "load_factor",
    "airspeed",
    "bank",
    "beta",
)  # responses that are drawn; altitude stands in the table
NEAR = 0.6  # a limit is drawn if it is nearer to the response than this part of its range
DIRECTIONS = {
    "elevator": ("nose down", "nose up"), "aileron": ("roll right", "roll left"), "rudder": ("nose left", "nose right"),
    "throttle": ("more power", "less power"),
}  # fmt: skip
SOME = 0.95  # part of an error that is left, above which a manoeuvre teaches nothing worth naming
NAMED = ". Before is std_unmerged of the command derivatives, std now is std: with what alpha_dot and beta_dot may hold"
CREW = (
    "Date",
    "Place, aircraft",
    "Pilot",
    "Ground station",
    "Engineer",
    "Wind at 6 m, gusts",
    "Mass",
    "Go or no-go",
)
FLOWN = ("Flown at", "Remarks", "Signed")
MOST_NAMED = 4  # derivatives that a manoeuvre teaches which are named
# of manoeuvres whose expected responses stand beside the limits each; of more, those of the flight
MOST_KINDS = 4
WIND_TO_GUST = 10.0
"""Wind 6 m above ground over the standard deviation of vertical gusts below 1000 ft (MIL-F-8785C,
3.7.3).
"""
MODES = (
    ("inputs", "MANUAL (ArduPilot), Manual (PX4), or the stick by hand: the risk is that of "
               "controls that nothing "
     "corrects. A mode that holds attitude or path (FBWA, CRUISE, Stabilized) makes the responses "
     "smaller."),
    ("pauses", "FBWB or CRUISE (ArduPilot), Altitude (PX4), or by hand: back to the trim."),
)  # fmt: skip
"""Of the autopilot, during and between the manoeuvres."""
MOST_LISTED = 16  # derivatives in one list; more stand in a table of coefficients by regressors
GOALS = {
    "function": ("all coefficients", "over the flown range, each in units of its spread"),
    "free-flight": ("free flight", "after 2 s: of alpha, beta, bank and pitch [rad]"),
}
"""In words: the goals that are no derivatives."""
LABELS = {"load_factor": ("load factor", 1.0, "g"), "bank": ("bank", float(np.rad2deg(1.0)), "deg")}
NO_BREAK = "\u00a0"


def write_flight_card(
    path: str | os.PathLike, plan: Plan, *, full: Mapping[str, float] | None = None
) -> Path:
    """Write the flight card of a plan as one HTML file, to print on A4 and to fly from, and return its path.

    The crew's pages come first: wind and gusts, trim and entry, modes of the autopilot, abort
    limits, the order of the manoeuvres, and the risks. A page for each kind of manoeuvre shows the
    inputs as pictures and, where a pilot can fly them, as steps; the responses expected of 95 % of
    the aircraft drawn; and its risk. The last page is the engineer's: what the flight teaches. With
    the ``full`` deflections of axes [rad], or 1 of the throttle, the card says how much of the
    stick each step is. Raises FileNotFoundError if the folder of ``path`` does not exist.
    """
    draw = can_draw()
    body = [_fields(CREW), _headline(plan), _go(plan), _entry(plan), _limits(plan), _order(plan)]
    if not draw:
        body.append(
            '<p class="note">No pictures: they need matplotlib, pip install "skdgp[plot]".</p>'
        )
    body += [_manoeuvre(plan, kind, full or {}, draw) for kind in _kinds(plan).values()]
    body.append(_teaching(plan))
    meta = f"{_count(len(plan.manoeuvres), 'manoeuvre')} of {_count(len(_kinds(plan)), 'kind')}"
    meta += f" · planned {datetime.now().astimezone():%d %B %Y, %H:%M}"
    colophon = "Made by skdgp. Angles in degrees; elevator &gt; 0 nose down, aileron &gt; 0 right, rudder &gt; 0 left."
    title = f"{plan.aircraft.name or 'Aircraft'}: next flight"
    page = render_page("Flight card", title, meta, "\n".join(body), colophon)
    return write_atomically(path, text_writer(page))


def _kinds(plan: Plan) -> dict[tuple, list[int]]:
    """Return the rows of ``manoeuvres`` by kind: name, wavetrain and size."""
    kinds: dict[tuple, list[int]] = {}
    for k, row in enumerate(plan.manoeuvres.itertuples()):
        kinds.setdefault((row.name, row.train, row.scale), []).append(k)
    return kinds


def _fields(names: Sequence[str]) -> str:
    """Return fields to fill in by hand."""
    return f'<div class="sign">{"".join(f"<p>{name}</p>" for name in names)}</div>'


def _tiles(*tiles: tuple[str, str]) -> str:
    return f'<div class="head">{"".join(f"<div><b>{n}</b><span>{words}</span></div>" for n, words in tiles)}</div>'


def _headline(plan: Plan) -> str:
    rows = plan.manoeuvres
    return _tiles(
        (
            f"{number(plan.seconds, '.0f')}<small>s</small>",
            "of flight at the trim, pauses included",
        ),
        (f"{len(rows)}", "manoeuvres, one after another" if len(rows) > 1 else "manoeuvre"),
        (
            percent(plan.risk) + "<small>%</small>",
            "risk of the flight: that any manoeuvre leaves a limit",
        ),
        (percent(rows["risk"].max()) + "<small>%</small>", "largest risk of a manoeuvre"),
    )


def _go(plan: Plan) -> str:
    """Return in which wind and gusts the flight may begin."""
    caption = "When the flight may begin. Risks and expected responses are those "
    if plan.gusts is None:
        rows = [["gusts", "calm air: no gust was checked", "any that is felt"]]
        caption += "of calm air."
    else:
        wind, swing = (
            f"{number(v, '.1f')}{THIN}m/s"
            for v in (WIND_TO_GUST * plan.gusts[2], 2.0 * plan.gusts[0])
        )
        rows = [
            [f"wind 6{THIN}m above ground", f"at most {wind}", "above"],
            ["airspeed in trimmed flight, hands off", f"within ±{swing} for 10{THIN}s", "beyond"],
        ]
        along, across, up = (f"{number(value, '.2f')}{THIN}m/s" for value in plan.gusts)
        caption += (
            f"of gusts with standard deviations of {along} along the flight, {across} across, "
            f"{up} vertically: below "
            f"300{THIN}m those of this wind (MIL-F-8785C); 95 % of the swings of the airspeed are "
            f"smaller than this."
        )
    rows.append(
        [
            "wind and crosswind for take-off and landing",
            "within the aircraft's own limits",
            "beyond",
        ]
    )
    return f"<section><h2>Go or no-go</h2>{table(['', 'go', 'no-go'], rows, caption=caption)}</section>"


def _entry(plan: Plan) -> str:
    states = ("airspeed", "altitude", "phi", "alpha", "theta")
    axes = dict.fromkeys(axis for one in plan.trims for axis in one.controls)
    head = ["", *map(heading, (*states, *axes)), "pause<br>[s]"]
    pauses = plan.manoeuvres.groupby("train")["start"].first()
    rows = []
    for k, one in enumerate(plan.trims):
        values = {name: getattr(one, name) for name in states} | {
            name: one.controls.get(name, np.nan) for name in axes
        }
        rows.append(
            [_train(plan, k), *(shown(*item) for item in values.items()), number(pauses[k], ".1f")]
        )
    steps = (
        "<li>Trim at the values of the table, hands off, for the pause.</li>"
        "<li>Start the inputs: the autopilot's switch, or the steps by hand on the count of the "
        "clock.</li>"
        "<li>Leave the other controls at their trim while the inputs run: corrections spoil the "
        "measurement.</li>"
        "<li>Return to the trim, and hold it until the pause is over. Wait longer if airspeed and "
        "pitch "
        "are not back; the order may be interrupted between manoeuvres, not within one.</li>"
    )
    caption = (
        "Trim, as the model expects it; deflections of the controls are positions, not deviations."
    )
    modes = "".join(f"<div><dt>{when}</dt><dd>{mode}</dd></div>" for when, mode in MODES)
    modes = f'<h3>Mode of the autopilot</h3><dl class="facts">{modes}</dl>'
    return f"<section><h2>Trim and entry</h2>{table(head, rows, caption=caption)}<ol>{steps}</ol>{modes}</section>"


def _order(plan: Plan) -> str:
    head = [
        "manoeuvre",
        "begins<br>[s]",
        "lasts<br>[s]",
        "size [% of<br>deflection allowed]",
        "risk [%]",
        "flown",
    ]
    rows: list[list[str]] = []
    begins = ~plan.manoeuvres["train"].duplicated()
    for k, row in enumerate(plan.manoeuvres.to_dict("records")):
        if len(plan.trims) > 1 and begins.iloc[k]:
            rows.append([_train(plan, row["train"])])
        numbers = [
            number(row["start"], ".1f"),
            number(row["duration"], ".1f"),
            percent(row["scale"], ".0f"),
        ]
        rows.append([f"{k + 1}. {text(row['name'])}", *numbers, percent(row["risk"]), "☐"])
    rows.append(
        [
            "<b>the flight</b>",
            "",
            number(plan.seconds, ".1f"),
            "",
            f"<b>{percent(plan.risk)}</b>",
            "",
        ]
    )
    caption = (
        "Order of flight. Risk: predicted probability of leaving a limit; if K of N simulated "
        "flights leave one, it is "
        "(K + 1) / (N + 2), never zero. That of the flight: of any of them, if they are "
        "independent."
    )
    return f"<section><h2>Order of flight</h2>{table(head, rows, caption=caption)}{_fields(FLOWN)}</section>"


def _limits(plan: Plan) -> str:
    """Return the limits, and what is expected of each kind of manoeuvre, or of the flight."""
    limits, kinds = plan.abort_limits, _kinds(plan)
    words = (
        "<p><b>At any of these limits: inputs off, and back to the trim by hand.</b> Flown: the "
        "range of the training "
        "flights, with the growth that this plan allows (none of the floor). Asked: given for "
        "this plan.</p>"
        if len(limits)
        else "<p><b>Nothing limits this flight, not even a floor: no manoeuvre was checked "
        "against a limit.</b> Agree "
        "before the flight when to abort: inputs off, and back to the trim by hand.</p>"
    )
    if any(name.startswith(GROWTH) for name in plan.limits.index):
        words += (
            '<p class="note">The plan also keeps rates and deflections near what was flown '
            "before; the risk of a "
            "manoeuvre counts these too.</p>"
        )
    named = {name: rows for (name, *_), rows in kinds.items()}  # of two sizes the last
    if not len(named) == len(kinds) <= MOST_KINDS:
        named = {"all manoeuvres": [*range(len(plan.manoeuvres))]}
    expected = {name: plan.expected(rows) for name, rows in named.items()}
    lines = []
    for name in QUANTITIES:
        ends = (_value(name, limits, end) for end in ("low", "high"))
        ranges = (
            f"{_value(name, one, 'low')} … {_value(name, one, 'high')}" for one in expected.values()
        )
        lines.append(
            [name_of(name), unit_of(name), *ends, limits["source"].get(name, "no limit"), *ranges]
        )
    head = [
        "",
        "unit",
        "abort<br>below",
        "abort<br>above",
        "limit is",
        *(f"expected:<br>{text(n)}" for n in expected),
    ]
    of = (
        "95 % of the aircraft and gusts drawn"
        if "alpha_low" in plan.flight
        else "the mean of the model"
    )
    caption = (
        f"Limits, and what is expected of {of}, up to {RESPONSE:g}{THIN}s after the inputs with "
        f"the controls held. "
        f"This may pass a limit: the risk counts only {REACTION:g}{THIN}s, in which nobody acts."
    )
    return f"<section><h2>Abort limits</h2>{words}{table(head, lines, caption=caption)}</section>"


def _teaching(plan: Plan) -> str:
    """Return the engineer's page."""
    errors = plan.errors
    known = np.isfinite(errors[["before", "after"]]).all(axis=None)
    ratio = np.exp(np.log(errors["after"] / errors["before"]).mean()) if known else np.nan
    whole = [GOALS[name][0] for name in plan.goal if name in GOALS]
    others = [name for name in plan.goal if name not in GOALS]
    what = text(
        " and ".join([*whole, *(others if len(others) < 3 else [f"{len(others)} derivatives"])])
    )
    tile = (
        percent(ratio, ".0f") + "<small>%</small>",
        f"of the error of {what} is left (geometric mean)",
    )
    tiles = _tiles(tile if known else ("new", f"nothing was known of {what}"))
    left = (errors["after"] / errors["before"]).where(
        np.isfinite(errors["before"]) & (errors["before"] > 0)
    )
    now = {"std": "std now"} if plan.merged else {}
    of_list = f"Standard errors of the goal, before and after the flight, in thousandths{NAMED if now else ''}"
    of_list += "".join(f"; {' '.join(GOALS[name])}" for name in plan.goal if name in GOALS) + "."
    of_grid = "Standard errors of the derivatives, in thousandths: after the flight and, in grey, before it"
    of_grid += f", and std now{NAMED}." if now else "."
    heads = {"before": "before", "after": "after"} | now | {"left": "left [%]"}
    shown = error_table(
        errors.assign(left=left), heads, ("after", "before", *now), of_list, of_grid
    )
    pairs = plan.confounded
    if len(pairs):
        named = [
            f"{one['first']} and {one['second']} in {one['coefficient']} "
            f"({number(one['correlation'], '.2f')})"
            for one in pairs.head(5).to_dict("records")
        ]
        more = f" and {_count(len(pairs) - 5, 'more pair')}" if len(pairs) > 5 else ""
        shown += (
            '<p class="note">Errors that are still correlated, so that a combination of the two '
            "is known better than "
            f"each: {text(', '.join(named)).replace(HAT, '')}{more}.</p>"
        )
    alone = "".join(
        f"<li><b>{text(kind[0])}</b>: {_most_taught(plan, one)}</li>"
        for kind, one in _kinds(plan).items()
    )
    shown = f"<h2>For the engineer: what the flight teaches</h2>{tiles}{shown}<ul>{alone}</ul>"
    return f'<section class="flight">{shown}</section>'


def _manoeuvre(plan: Plan, rows: Sequence[int], full: Mapping[str, float], draw: bool) -> str:
    """Return the page of a kind of manoeuvre, which is flown in one or several rows of the order."""
    row, inputs = plan.manoeuvres.iloc[rows[0]], plan.inputs(rows[0])
    starts = ", ".join(
        f"{number(start, '.1f')}{THIN}s" for start in plan.manoeuvres["start"].iloc[list(rows)]
    )
    trim = plan.trims[int(row["train"])]
    facts = [
        f"No. {', '.join(str(k + 1) for k in rows)} of the order, at {starts}.",
        f"Entry: {_train(plan, int(row['train']))}, altitude "
        f"{shown('altitude', trim.altitude)}{THIN}m.",
    ]
    if not np.isnan(row["risk"]):
        facts.append(f"Risk of leaving a limit: {percent(row['risk'])}{THIN}%.")
    words, steps = _steps(inputs, trim.controls, full)
    parts = [f"<h2>{text(row['name'])}</h2><p>{' '.join(facts)}</p><p><b>{words}</b></p>{steps}"]
    parts += [_pictures(plan, rows[0], inputs)] if draw else []
    return f'<section class="flight">{"".join(parts)}</section>'


def _steps(
    inputs: Mapping[str, Any], controls: Mapping[str, float], full: Mapping[str, float]
) -> tuple[str, str]:
    """Return who can fly the inputs, and the table of their steps, if they have steps."""
    if not all(isinstance(signal, Steps) for signal in inputs.values()):
        highest = max(1.0 / signal.period for signal in inputs.values())
        return (
            f"By the autopilot: sums of sines up to {number(highest, '.2g')}{THIN}Hz, which no "
            f"pilot can fly.",
            "",
        )
    quick = min(min(signal.durations) for signal in inputs.values())
    by_hand = "By hand, or by the autopilot."
    if quick < QUICK:
        by_hand = (
            f"By the autopilot: steps of {number(quick, '.2f')}{THIN}s are too quick for a hand."
        )
    sticks = bool(set(inputs) & set(full))
    head = [
        name_of(next(iter(inputs))) if len(inputs) == 1 else "move",
        "at [s]",
        "hold [s]",
        "by",
        "to",
    ]
    head += ["of full<br>deflection [%]"] if sticks else []
    rows, said = [], []
    for axis, signal in inputs.items():
        unit = f"{THIN}{unit_of(axis)}".rstrip()
        for time, level, hold in zip(
            signal.edges, [*signal.levels, 0.0], [*signal.durations, np.nan], strict=True
        ):
            way = DIRECTIONS.get(axis, ("up", "down"))[int(level < 0)] if level else "back to trim"
            trim = controls.get(axis, 0.0)
            cells = [_signed(level, shown(axis, level)) + unit, shown(axis, trim + level) + unit]
            part = 100.0 * level / full.get(axis, np.nan)
            stick = [_signed(level, number(part, ".0f")) if axis in full else ""] if sticks else []
            what = way if len(inputs) == 1 else f"{name_of(axis)}: {way}"
            size = (
                f" {shown(axis, abs(level))}{unit}, {way}, for {number(round(hold, 2), 'g')}{THIN}s"
            )
            said.append(name_of(axis) + (size if level else f" {way}"))
            rows.append((time, [what, number(time, ".2f"), number(hold, ".2f"), *cells, *stick]))
    rows.sort(key=lambda one: one[0])
    if quick >= QUICK:
        by_hand += f" {'; '.join(said).capitalize()}."
    caption = "Steps, from the start of the manoeuvre; hold the other controls at trim."
    return by_hand, table(head, [row for _, row in rows], caption=caption, classes="narrow")


def _pictures(plan: Plan, k: int, inputs: Mapping[str, Any]) -> str:
    flight = plan.flight[plan.flight["flight"] == k]
    time, values, limits = flight["time"].to_numpy(float), quantities(flight), plan.abort_limits
    end = plan.manoeuvres["duration"].iloc[k]
    fine = np.linspace(0.0, time[-1], 2000)
    names = [*inputs, *SHOWN]

    def draw(ax, name):
        label, factor, unit = label_of(name)
        if name in inputs:
            ax.plot(fine, factor * inputs[name](fine), color=PALETTE["purple"], linewidth=1.2)
            ax.axhline(0.0, color=PALETTE["grey"], linewidth=0.5)
        else:
            if f"{name}_low" in flight:
                low, high = (
                    factor * flight[f"{name}_{side}"].to_numpy(float) for side in ("low", "high")
                )
                ax.fill_between(time, low, high, color=ROLES["band"], alpha=0.45, linewidth=0)
            ax.plot(time, factor * values[name].to_numpy(), color=ROLES["mean"], linewidth=1.2)
            bottom, top = ax.get_ylim()
            for limit in factor * limits.loc[name, ["low", "high"]] if name in limits.index else ():
                if bottom - NEAR * (top - bottom) < limit < top + NEAR * (top - bottom):
                    ax.axhline(
                        limit, color=PALETTE["vermillion"], linewidth=1.0, linestyle=(0, (4, 2))
                    )
        ax.axvline(end, color=PALETTE["grey"], linewidth=0.5)
        ax.set(xlabel="time [s]", ylabel=f"{label} [{unit}]" if unit else label)
        tidy(ax)

    panels = [
        strip(
            partial(draw, name=name), bottom=name in names[-2:],
            label=f"{label_of(name)[0]} against time" + ("" if name in inputs else ": expected, with its 95 % band"),
        )
        for name in names
    ]  # fmt: skip
    key = [("purple", "input, deviation from trim", ""), ("blue", "expected", "")]
    key += [("sky", "95 % of the aircraft drawn", "area")] if "alpha_low" in flight else []
    key += [("vermillion", "abort limit", "")]
    caption = (
        "Inputs and expected responses, from the start of the manoeuvre; the thin line marks the "
        "end of the inputs. "
        "Limits that the response does not come near are not drawn."
    )
    return figure(panels, caption, key)


def _most_taught(plan: Plan, rows: Sequence[int]) -> str:
    """Return what these manoeuvres do to the errors in their turn, and to which of the goal if they alone are flown."""
    goal = list(plan.goal)
    before = errors_of(plan.before, plan.weights)[goal]
    after = errors_of(sum((plan.parts[k] for k in rows), plan.before), plan.weights)[goal]
    left = (
        (after / before)
        .where(np.isfinite(before), 0.0)
        .where(np.isfinite(after), 1.0)
        .sort_values(kind="stable")
    )
    shown = [
        f"{percent(left[name], '.0f')}{THIN}% of the error of {derivative(name)}"
        if left[name] > 0 else f"{derivative(name)} known to ±{number(after[name], '.2g')}"
        for name in map(str, left.index[:MOST_NAMED]) if left[name] < SOME
    ]  # fmt: skip
    turns = ", ".join(percent(-plan.manoeuvres["gain"].iloc[k], ".0f") for k in rows)
    words = f"If only this is flown, it leaves {', '.join(shown)}." if shown else ""
    words = words or "It teaches nothing of the goal by itself."
    return f"errors of the goal in its turn (geometric mean) {turns}{THIN}%. {words}"


def _train(plan: Plan, k: int) -> str:
    trim = plan.trims[k]
    bank = f", bank {shown('phi', trim.phi)}°" if abs(trim.phi) > np.deg2rad(0.5) else ""
    return f"{number(trim.airspeed, 'g')}{THIN}m/s{bank}"


def _value(name: str, frame: pd.DataFrame, end: str) -> str:
    value = frame[end].get(name, np.nan)
    return shown(name, value) if np.isfinite(value) else DASH


def _signed(value: float, shown: str) -> str:
    return f"+{shown}" if value > 0 else shown


def _count(n: int, name: str) -> str:
    return f"{n} {name}{'' if n == 1 else 's'}"


def label_of(name: str) -> tuple[str, float, str]:
    """Return the words of a quantity, the factor from SI to the displayed unit, and that unit."""
    return LABELS.get(name, (name.replace("_", " "), *display_unit(name)))


def name_of(name: str) -> str:
    """Return the words of a quantity."""
    return text(label_of(name)[0])


def unit_of(name: str) -> str:
    """Return the displayed unit of a quantity."""
    return text(label_of(name)[2])


def heading(name: str, unit: bool = True) -> str:
    """Return the head of a column."""
    named = {"phi": "bank", "theta": "pitch"}.get(name, name_of(name))
    return f"{named}<br>[{unit_of(name)}]" if unit and unit_of(name) else named


def shown(name: str, value: float) -> str:
    """Return a value in the displayed unit."""
    _, factor, unit = label_of(name)
    return number(factor * value, ".0f" if name == "altitude" else ".2f" if not unit else ".1f")


def derivative(name: str) -> str:
    """Return a derivative with its indices lowered, or another goal in words."""
    coefficient, _, regressor = name.partition("_")
    if not regressor:  # another goal
        return text(GOALS[name][0])
    return f"<i>C</i><sub>{text(coefficient[1:])}{NO_BREAK}{text(regressor.replace('_', NO_BREAK))}</sub>"


def error_table(
    errors: pd.DataFrame,
    heads: Mapping[str, str],
    inside: Sequence[str],
    of_list: str,
    of_grid: str,
) -> str:
    """Return standard errors as a list of derivatives, or many as a table of coefficients by regressors.

    The cells of that hold the columns ``inside``, all but the first in grey. The last two are the
    captions of either.
    """
    if len(errors) <= MOST_LISTED:
        rows = [
            [
                derivative(str(name)),
                *(percent(row[key], ".0f") if key == "left" else milli(row[key]) for key in heads),
            ]
            for name, row in errors.iterrows()
        ]
        return table(["", *heads.values()], rows, caption=of_list, classes="narrow")
    pairs = [name.split("_", 1) for name in errors.index if "_" in name]
    regressors = list(dict.fromkeys(second for _, second in pairs))
    rows = []
    for coefficient in dict.fromkeys(first for first, _ in pairs):
        keys = [f"{coefficient}_{name}" for name in regressors]
        values = [
            [milli(errors[name][key]) for name in inside] if key in errors.index else [""]
            for key in keys
        ]
        cells = [
            "<br>".join([first, *(f"<em>{one}</em>" for one in others)])
            for first, *others in values
        ]
        rows.append([symbol(coefficient), *cells])
    return table(["", *(heading(name, unit=False) for name in regressors)], rows, caption=of_grid)


def milli(value: float) -> str:
    """Return a thousandth's number with two digits that count, never in powers of ten."""
    if not np.isfinite(value):
        return number(value)
    return np.format_float_positional(float(f"{1e3 * value:.2g}"), trim="-")
