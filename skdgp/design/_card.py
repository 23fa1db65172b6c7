"""The flight card of a plan: a page to print and to fly from."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import numpy as np

from skdgp._compute.files import text_writer, write_atomically
from skdgp._display.page import (
    can_draw,
    heading,
    number,
    percent,
    render_page,
    section,
    shown,
    table,
    text,
)
from skdgp._excitation import Steps
from skdgp._flight.checks import check_full_deflection
from skdgp.design._check import errors_table
from skdgp.design._planner import Plan
from skdgp.plotting import TimeHistoryDisplay

# Responses that are drawn
SHOWN = ("alpha", "airspeed", "phi", "beta")
CREW = (
    '<div class="sign"><p>Date</p><p>Place, aircraft</p><p>Pilot</p><p>Ground station</p>'
    "<p>Wind, mass</p><p>Go or no-go</p><p>Signed</p></div>"
)
AXES_NOTE = "Made by skdgp. Elevator &gt; 0 nose down, aileron &gt; 0 right, rudder &gt; 0 left."
ENTRY = """<ol>
<li>Fly in calm air: the limits were checked without gusts. Trim at the values of the table, hands
off, for the pause.</li>
<li>Start the inputs: the autopilot's switch, or the steps by hand on the count of the clock, in
MANUAL (ArduPilot) or Manual (PX4). A mode that holds attitude makes the responses smaller.</li>
<li>Leave the other controls at their trim while the inputs run.</li>
<li>At any limit: inputs off, and back to the trim by hand. Hold it until the pause is over.</li>
</ol>"""


def write_flight_card(
    path: str | os.PathLike, plan: Plan, *, full: Mapping[str, float] | None = None
) -> Path:
    """Write the flight card of a plan as one HTML file, to print on A4 and to fly from, and return its path.

    It holds trim and entry, abort limits, the order of the manoeuvres, and the promised standard
    deviations. A page for each kind of manoeuvre shows the inputs as pictures and, of pulses, as
    steps, with the expected responses. With the ``full`` deflections of axes [rad], or 1 of the
    throttle, the card says how much of the stick each step is. Raises FileNotFoundError if the
    folder of ``path`` does not exist, and ValueError if a deflection is none.
    """
    for name, value in (full or {}).items():
        check_full_deflection(name, value)
    kinds = plan.manoeuvres.drop_duplicates(["name", "scale"])
    body = [CREW, _entry(plan), _limits(plan), _order(plan), _promise(plan)]
    body += [_manoeuvre(plan, k, full or {}) for k in kinds.index]
    title = f"{plan.aircraft.name or 'Aircraft'}: next flight"
    meta = f"{len(plan.manoeuvres)} manoeuvres of {len(kinds)} kinds · planned {datetime.now():%d %B %Y, %H:%M}"
    page = render_page("Flight card", title, meta, "\n".join(body), AXES_NOTE)
    return write_atomically(path, text_writer(page))


def _entry(plan: Plan) -> str:
    """Return the trim, and how the manoeuvres begin."""
    point = plan.trim
    states = {
        "airspeed": point.airspeed,
        "altitude": point.altitude,
        "bank": point.phi,
        "alpha": point.alpha,
        "theta": point.theta,
        **point.controls,
    }
    row = ["", *map(shown, states, states.values())]
    row.append(number(plan.manoeuvres["start"].iloc[0], ".1f"))
    caption = "Trim, as the model expects it; controls are positions, not deviations."
    if plan.servo_lag > 0:
        caption += f" Surfaces follow these inputs {1e3 * plan.servo_lag:.0f} ms late."
    return section(
        "Trim and entry",
        table(["", *map(heading, states), "pause<br>[s]"], [row], caption=caption),
        ENTRY,
    )


def _limits(plan: Plan) -> str:
    """Return the limits, and the responses that are expected of the flight."""
    ends = plan.abort_limits.join(plan.expected.add_prefix("expected "))
    rows = []
    for name, values in ends.iterrows():
        low, high, lowest, highest = [shown(str(name), value) for value in values]
        rows.append([heading(str(name)), low, high, f"{lowest} … {highest}"])
    caption = (
        f"Limits: asked for, or flown before with the growth that this plan allows. Expected of the "
        f"mean of the model in calm air; responses {plan.margin:.0%} larger are still inside until "
        f"1 s after the inputs, with the controls held."
    )
    if np.isinf(plan.abort_limits).all(axis=None):
        caption = f"<b>Nothing limits this flight, not even a floor.</b> {caption}"
    return section(
        "Abort limits",
        table(["", "abort<br>below", "abort<br>above", "expected"], rows, caption=caption),
    )


def _order(plan: Plan) -> str:
    """Return the manoeuvres in the order of flight."""
    rows = []
    for k, row in enumerate(plan.manoeuvres.to_dict("records"), start=1):
        times = [number(row["start"], ".1f"), number(row["duration"], ".1f")]
        rows.append([f"{k}. {text(row['name'])}", *times, percent(row["scale"], ".0f"), "☐"])
    rows.append(["<b>the flight</b>", "", number(plan.seconds, ".1f"), "", ""])
    return section(
        "Order of flight",
        table(
            ["manoeuvre", "begins<br>[s]", "lasts<br>[s]", "size [% of<br>limit]", "flown"],
            rows,
            caption="Order of flight.",
        ),
    )


def _promise(plan: Plan) -> str:
    """Return the promised standard deviations."""
    caption = (
        f"Standard deviations of derivatives at the trim: before the flight, and promised of a model "
        f"learned from this flight too; 80 % of those found lie between low and high. Geometric mean "
        f"of what is left: "
        f"{percent(plan.remaining, '.0f')} %."
    )
    if not plan.remaining < 1.0:
        caption += (
            " Nothing is promised: the model has no posterior, or too few rows for its slopes."
        )
    return section("For the engineer: promises of the flight", errors_table(plan.errors, caption))


def _manoeuvre(plan: Plan, k: int, full: Mapping[str, float]) -> str:
    """Return the page of a manoeuvre: the steps of its pulses, and pictures."""
    rows = []
    for axis, signal in plan.inputs(k).items():
        if not isinstance(signal, Steps):
            continue
        for time, level in zip(signal.edges, [*signal.levels, 0.0], strict=True):
            position = shown(axis, plan.trim.controls[axis] + level)
            stick = percent(level / full.get(axis, np.nan), ".0f")
            rows.append([heading(axis), number(time), shown(axis, level), position, stick])
    steps = "<p><b>By the autopilot.</b></p>"
    if rows:
        steps = table(
            ["", "at [s]", "by", "to", "of full<br>[%]"],
            rows,
            caption="Steps of the inputs.",
            classes="narrow",
        )
    name = text(plan.manoeuvres["name"].iloc[k])
    return section(name, steps, _pictures(plan, k), classes="flight")


def _pictures(plan: Plan, k: int) -> str:
    """Return figures of the inputs of a manoeuvre, and of the responses."""
    if not can_draw():
        return '<p class="note">No pictures: pip install "skdgp[plot]".</p>'
    flight = plan.flight[plan.flight["flight"] == k]
    time = flight["time"].to_numpy(float)
    fine = np.linspace(0.0, time[-1], 2000)
    inputs = plan.inputs(k)
    signals = np.column_stack([signal(fine) for signal in inputs.values()])
    moved = TimeHistoryDisplay(time=fine, names=tuple(inputs), mean=signals, estimate="input")
    expected = TimeHistoryDisplay(
        time=time, names=SHOWN, mean=flight[[*SHOWN]].to_numpy(float), estimate="expected"
    )
    return moved.html("Inputs, from trim.") + expected.html("Expected responses.")
