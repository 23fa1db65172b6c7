"""What a plan is flown from: the flight card, to print, and the script that ArduPilot runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.files import text_writer, write_atomically
from skdgp._display.page import (
    DASH,
    THIN,
    can_draw,
    display_unit,
    number,
    percent,
    render_page,
    table,
    text,
)
from skdgp._excitation import ROUNDING, Signal, Steps, Wavetrain
from skdgp._flight.checks import check_names, check_number
from skdgp.design._manoeuvres import QUANTITIES, REACTION, RESPONSE
from skdgp.design._planner import Plan
from skdgp.plotting import TimeHistoryDisplay

QUICK = 0.5  # shortest step that a pilot can time by counting [s]
SHOWN = ("alpha", "airspeed", "phi", "beta")  # responses that are drawn
BANDS_OF_BANK = {"bank_low": "phi_low", "bank_high": "phi_high"}
WIND_TO_GUST = 10.0  # wind at 6 m over vertical gusts below 1000 ft (MIL-F-8785C, 3.7.3)
DIRECTIONS = {
    "elevator": ("nose down", "nose up"),
    "aileron": ("roll right", "roll left"),
    "rudder": ("nose left", "nose right"),
    "throttle": ("more power", "less power"),
}
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
ENTRY = (
    "Trim at the values of the table, hands off, for the pause: FBWB or CRUISE (ArduPilot), "
    "Altitude (PX4), or by hand.",
    "Start the inputs: the autopilot's switch, or the steps by hand on the count of the clock, in "
    "MANUAL (ArduPilot) or Manual (PX4). A mode that holds attitude makes the responses smaller.",
    "Leave the other controls at their trim while the inputs run.",
    "Return to the trim, and hold it until the pause is over.",
)
LABELS = {
    "load_factor": ("load factor", 1.0, "g"),
    **dict.fromkeys(("bank", "phi"), ("bank", float(np.rad2deg(1.0)), "deg")),
    "theta": ("pitch", float(np.rad2deg(1.0)), "deg"),
}


def write_flight_card(
    path: str | os.PathLike, plan: Plan, *, full: Mapping[str, float] | None = None
) -> Path:
    """Write the flight card of a plan as one HTML file, to print on A4 and to fly from, and return its path.

    The crew's pages come first: go and no-go, trim and entry, abort limits, the order of the
    manoeuvres and their risks. A page for each kind of manoeuvre shows the inputs as pictures and,
    of pulses, as steps, with the responses expected of 95 % of the aircraft drawn. The last page
    is the engineer's: the promised standard deviations. With the ``full`` deflections of axes
    [rad], or 1 of
    the throttle, the card says how much of the stick each step is. Raises FileNotFoundError if the
    folder of ``path`` does not exist.
    """
    draw = can_draw()
    note = '<p class="note">No pictures: they need matplotlib, pip install "skdgp[plot]".</p>'
    kinds = plan.manoeuvres.reset_index().groupby(["name", "scale"], sort=False)["index"]
    body = [
        *(_fields(CREW), _go(plan), _entry(plan), _limits(plan), _order(plan)),
        *([] if draw else [note]),
        *(_manoeuvre(plan, list(rows), full or {}, draw) for _, rows in kinds),
        _promise(plan),
    ]
    meta = (
        f"{len(plan.manoeuvres)} manoeuvres of {len(kinds)} kind{'s' * (len(kinds) > 1)}"
        f" · planned {datetime.now().astimezone():%d %B %Y, %H:%M}"
    )
    colophon = "Made by skdgp. Angles in degrees; elevator &gt; 0 nose down, aileron &gt; 0 right, rudder &gt; 0 left."
    title = f"{plan.aircraft.name or 'Aircraft'}: next flight"
    page = render_page("Flight card", title, meta, "\n".join(body), colophon)
    return write_atomically(path, text_writer(page))


def _fields(names: Sequence[str]) -> str:
    """Return fields to fill in by hand."""
    return f'<div class="sign">{"".join(f"<p>{name}</p>" for name in names)}</div>'


def _go(plan: Plan) -> str:
    """Return the wind and gusts that allow the flight to begin."""
    rows = [["gusts", "calm air: no gust was checked", "any that is felt"]]
    caption = "When the flight may begin. Risks and expected responses are for calm air."
    if plan.gusts is not None:
        wind = f"{number(WIND_TO_GUST * plan.gusts[2], '.1f')}{THIN}m/s"
        swing = f"{number(2.0 * plan.gusts[0], '.1f')}{THIN}m/s"
        rows = [
            [f"wind 6{THIN}m above ground", f"at most {wind}", "above"],
            ["airspeed in trimmed flight, hands off", f"within ±{swing} for 10{THIN}s", "beyond"],
        ]
        sizes = ", ".join(number(value, ".2f") for value in plan.gusts)
        caption = (
            f"When the flight may begin. Risks and expected responses are those of gusts u, v, w "
            f"with standard deviations of {sizes}{THIN}m/s: below 300{THIN}m those of this wind "
            f"(MIL-F-8785C)."
        )
    return _section("Go or no-go", table(["", "go", "no-go"], rows, caption=caption))


def _entry(plan: Plan) -> str:
    states = ("airspeed", "altitude", "phi", "alpha", "theta")
    values = {name: getattr(plan.trim, name) for name in states} | plan.trim.controls
    row = ["", *(shown(name, value) for name, value in values.items())]
    row.append(number(plan.manoeuvres["start"].iloc[0], ".1f"))
    caption = (
        "Trim, as the model expects it; deflections of the controls are positions, not deviations."
    )
    head = ["", *map(heading, values), "pause<br>[s]"]
    steps = "".join(f"<li>{step}</li>" for step in ENTRY)
    return _section("Trim and entry", f"{table(head, [row], caption=caption)}<ol>{steps}</ol>")


def _order(plan: Plan) -> str:
    head = [
        "manoeuvre",
        "begins<br>[s]",
        "lasts<br>[s]",
        "size [% of<br>limit]",
        "risk [%]",
        "flown",
    ]
    rows = [
        [
            f"{k + 1}. {text(row['name'])}", number(row["start"], ".1f"),
            number(row["duration"], ".1f"), percent(row["scale"], ".0f"), percent(row["risk"]), "☐",
        ]
        for k, row in enumerate(plan.manoeuvres.to_dict("records"))
    ]  # fmt: skip
    total = f"<b>{percent(plan.risk)}</b>"
    rows.append(["<b>the flight</b>", "", number(plan.seconds, ".1f"), "", total, ""])
    caption = (
        "Order of flight. Risk: predicted probability of "
        "leaving a limit; if K of N simulated flights leave one, it is (K + 1) / (N + 2). That of "
        "the flight: of any of them, if they are independent."
    )
    return _section("Order of flight", table(head, rows, caption=caption) + _fields(FLOWN))


def _limits(plan: Plan) -> str:
    """Return the limits, and the responses that are expected of the flight."""
    limits = plan.abort_limits
    instruction = (
        "<p><b>At any of these limits: inputs off, and back to the trim by hand.</b></p>"
        if len(limits)
        else "<p><b>Nothing limits this flight, not even a floor.</b> Agree before the flight when "
        "to abort: inputs off, and back to the trim by hand.</p>"
    )
    expected: Any = plan.expected.to_dict("index")
    ends: Any = limits.reindex(QUANTITIES)[["low", "high"]].astype(float).to_dict("index")
    rows = []
    for name in QUANTITIES:
        low, high = (shown(name, ends[name][end]) for end in ("low", "high"))
        source = limits["source"].get(name, "no limit")
        span = f"{shown(name, expected[name]['low'])} … {shown(name, expected[name]['high'])}"
        rows.append([_words(name), _unit(name), low, high, source, span])
    head = ["", "unit", "abort<br>below", "abort<br>above", "limit is", "expected"]
    is_drawn = "alpha_low" in plan.flight
    of = "95 % of the aircraft and gusts drawn" if is_drawn else "the mean of the model"
    caption = (
        f"Limits: asked for, or flown before with the growth that this plan allows. Expected of "
        f"{of}, up to {RESPONSE:g}{THIN}s after the inputs with the controls held; the "
        f"risk counts only {REACTION:g}{THIN}s, in which nobody acts."
    )
    if plan.servo_lag > 0:
        caption += f" Surfaces follow these inputs {1e3 * plan.servo_lag:.0f}{THIN}ms late."
    return _section("Abort limits", instruction + table(head, rows, caption=caption))


def _promise(plan: Plan) -> str:
    """Return the engineer's page."""
    rows = [
        [
            text(name),
            *(number(row[end], ".2g") for end in ("before", "promised")),
            percent(row["promised"] / row["before"], ".0f"),
        ]
        for name, row in plan.errors.iterrows()
    ]
    left = plan.errors["promised"] / plan.errors["before"]
    caption = (
        f"Standard deviations of derivatives at the trim, as <code>derivatives</code> states "
        f"them: before the flight, and promised of a model learned from this flight too. Geometric "
        f"mean of what is left: {percent(plan.remaining, '.0f')}{THIN}%."
    )
    if np.isclose(left.fillna(1.0), 1.0).all():
        caption += (
            " Nothing is promised: the model has no posterior, does not hold its rows, or has fewer "
            "than ten for each slope."
        )
    elif (left > 1.0).any():
        caption += (
            " Over 100: errors that more rows do not lower, such as of alpha_dot, are larger in the "
            "planned ones."
        )
    shown_errors = table(
        ["derivative", "before", "promised", "left [%]"], rows, caption=caption, classes="narrow"
    )
    return _section("For the engineer: promises of the flight", shown_errors, "flight")


def _manoeuvre(plan: Plan, rows: Sequence[int], full: Mapping[str, float], draw: bool) -> str:
    """Return the page of a kind of manoeuvre, which is flown in one or several rows of the order."""
    row = plan.manoeuvres.iloc[rows[0]]
    inputs = plan.inputs(rows[0])
    order = ", ".join(str(k + 1) for k in rows)
    starts = ", ".join(number(plan.manoeuvres["start"].iloc[k], ".1f") for k in rows)
    facts = (
        f"<p>No. {order} of the order, at {starts}{THIN}s. "
        f"Risk of leaving a limit: {percent(row['risk'])}{THIN}%.</p>"
    )
    body = facts + _steps(inputs, plan.trim.controls, full)
    if draw:
        body += _pictures(plan, rows[0], inputs)
    return _section(text(row["name"]), body, "flight")


def _steps(
    inputs: Mapping[str, Signal], controls: Mapping[str, float], full: Mapping[str, float]
) -> str:
    """Return who can fly the inputs, and the table of their steps, if they have steps."""
    highest = max(1.0 / signal.period for signal in inputs.values())
    steps = {axis: signal for axis, signal in inputs.items() if isinstance(signal, Steps)}
    if len(steps) < len(inputs):
        return (
            f"<p><b>By the autopilot: sums of sines up to {number(highest, '.2g')}{THIN}Hz.</b></p>"
        )
    rows = []
    for axis, signal in steps.items():
        holds = [*signal.durations, np.nan]
        for time, level, hold in zip(signal.edges, [*signal.levels, 0.0], holds, strict=True):
            way = DIRECTIONS.get(axis, ("up", "down"))[int(level < 0)] if level else "back to trim"
            rows.append([
                f"{_words(axis)}: {way}", number(time, ".2f"), number(hold, ".2f"),
                shown(axis, level), shown(axis, controls.get(axis, 0.0) + level),
                percent(level / full.get(axis, np.nan), ".0f"),
            ])  # fmt: skip
    units = ", ".join(f"{_words(axis)} in {_unit(axis) or 'parts of 1'}" for axis in steps)
    quick = min(min(signal.durations) for signal in steps.values())
    hand = (
        "By hand, or by the autopilot."
        if quick >= QUICK
        else "By the autopilot: too quick for a hand."
    )
    head = ["", "at [s]", "hold [s]", "by", "to", "of full<br>[%]"]
    caption = f"Steps, from the start of the manoeuvre: {units}; hold the other controls at trim."
    return f"<p><b>{hand}</b></p>{table(head, rows, caption=caption, classes='narrow')}"


def _pictures(plan: Plan, k: int, inputs: Mapping[str, Signal]) -> str:
    """Return figures of the inputs of a manoeuvre, and of the responses, with the band of the aircraft drawn."""
    flight = plan.flight[plan.flight["flight"] == k].rename(columns=BANDS_OF_BANK)
    time = flight["time"].to_numpy(float)
    fine = np.linspace(0.0, time[-1], 2000)
    signals = np.column_stack([signal(fine) for signal in inputs.values()])
    moved = TimeHistoryDisplay(
        time=fine, names=tuple(inputs), mean=signals, estimate="input, deviation from trim"
    )
    low, high = (
        flight[[f"{name}_{end}" for name in SHOWN]].to_numpy(float)
        if "alpha_low" in flight
        else None
        for end in ("low", "high")
    )
    responses = TimeHistoryDisplay(
        time=time, names=SHOWN, mean=flight[[*SHOWN]].to_numpy(float), lower=low, upper=high,
        estimate="expected",
    )  # fmt: skip
    caption = "Expected responses, from the start of the manoeuvre."
    return moved.html("Inputs.") + responses.html(caption)


def _section(title: str, body: str, kind: str = "") -> str:
    return f'<section class="{kind}"><h2>{title}</h2>{body}</section>'


def _label(name: str) -> tuple[str, float, str]:
    """Return the words of a quantity, the factor from SI to the displayed unit, and that unit."""
    return LABELS.get(name, (name.replace("_", " "), *display_unit(name)))


def _words(name: str) -> str:
    return text(_label(name)[0])


def _unit(name: str) -> str:
    return text(_label(name)[2])


def heading(name: str) -> str:
    """Return the head of a column, with its unit."""
    return f"{_words(name)}<br>[{_unit(name)}]" if _unit(name) else _words(name)


def shown(name: str, value: float) -> str:
    """Return a value in the displayed unit, a dash where there is none."""
    _, factor, unit = _label(name)
    if not np.isfinite(value):
        return DASH
    return number(factor * value, ".0f" if name == "altitude" else ".2f" if not unit else ".1f")


SCRIPT = Path(__file__).with_name("replay.lua")
# SERVOn_FUNCTION and sign: ArduPilot's positive commands raise the nose, roll and yaw right, move
# elevons and halves of a V-tail up
ARDUPILOT = {
    "elevator": (19, -1.0), "aileron": (4, 1.0), "rudder": (21, -1.0), "throttle": (70, 1.0),
    "elevon_left": (77, -1.0), "elevon_right": (78, -1.0), "vtail_left": (79, -1.0), "vtail_right": (80, -1.0),
}  # fmt: skip
# Surfaces that several axes move
MIXES = {
    "elevon_left": {"elevator": 1.0, "aileron": 1.0}, "elevon_right": {"elevator": 1.0, "aileron": -1.0},
    "vtail_left": {"elevator": 1.0, "rudder": 1.0}, "vtail_right": {"elevator": 1.0, "rudder": -1.0},
}  # fmt: skip
# ArduPilot's scaled commands at full deflection: per cent, and centidegrees of a range of 45
THROTTLE_SCALE, SURFACE_SCALE = 100.0, 4500.0
NO_LIMIT = 1e30  # amplitude of an axis without a limit
FASTEST = 1000.0  # Rate of a script [Hz]: ArduPilot counts milliseconds.
SWITCHES = range(300, 308)  # RCn_OPTION of Scripting1 to Scripting8: others act on the aircraft


def ardupilot_script(
    train: Wavetrain, rate: float, full: Mapping[str, float], switch: int = 300
) -> str:
    """Return a Lua script for ArduPilot that adds inputs to the autopilot's commands while a switch is high.

    The script holds the signals as formulas, not as samples: some kilobytes for any duration. It
    keeps the limits of the axes at every step, also where steps come late. The inputs end at once
    when the switch is low or the aircraft is disarmed, and the autopilot's own commands return
    within five steps if the script stops. It logs them (PLAN). Write it to a file such as
    ``plan.lua`` in ``APM/scripts`` of the autopilot's card and set SCR_ENABLE to 1.

    Parameters
    ----------
    train : Wavetrain
        Of elevator, aileron, rudder, throttle, or of the elevons.
    rate : float
        At which the script runs [Hz].
    full : mapping of str to float
        The surfaces the aircraft has (SERVOn_FUNCTION), each with its deflection at the end of the
        servo's range [rad]. ``elevon_left`` and ``elevon_right`` move with elevator and aileron,
        ``vtail_left`` and ``vtail_right`` with elevator and rudder. The throttle needs none.
    switch : int, default=300
        RCn_OPTION of the switch of the transmitter, Scripting1 to Scripting8: 300 to 307.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If the rate is above 1000 Hz, the switch none of these, an axis moves none of the surfaces,
        ArduPilot has no servo function for one, a full deflection is no number > 0 or smaller than
        the inputs of the surface, or as of `Wavetrain.table`.

    Examples
    --------
    >>> from skdgp.design import Wavetrain, ardupilot_script, doublet
    >>> script = ardupilot_script(Wavetrain({"elevator": {1.0: doublet(0.5, 0.05)}}), 50.0, {"elevator": 0.4})
    >>> "SRV_Channels" in script
    True
    """
    if not (rate <= FASTEST and switch in SWITCHES):
        raise ValueError(
            f"Got rate={rate:g} Hz and switch={switch!r}, but expected at most {FASTEST:g} Hz and "
            f"an RCn_OPTION of "
            f"{SWITCHES[0]} to {SWITCHES[-1]}."
        )
    full = dict(full) | ({"throttle": 1.0} if "throttle" in train.inputs else {})
    mixes = surface_mixes(list(train.inputs), full)
    _check_room(train.table(rate), mixes, full)
    axes = [
        {
            "name": axis, "amplitude": train.limits.get(axis, NO_LIMIT),
            "signals": [_parts(item) | {"start": t} for t, item in train.inputs[axis].items()],
        }
        for axis in train.inputs
    ]  # fmt: skip
    surfaces = [
        {
            "name": name, "servo": ARDUPILOT[name][0], "full": ARDUPILOT[name][1] * full[name],
            "range": name == "throttle", "scale": THROTTLE_SCALE if name == "throttle" else SURFACE_SCALE,
            "parts": [mix.get(axis, 0.0) for axis in train.inputs],
        }
        for name, mix in mixes.items()
    ]  # fmt: skip
    plan = {
        "switch": switch, "period": int(1000.0 / rate), "duration": train.duration,
        "labels": ",".join(["t", *train.inputs]), "format": "f" * (1 + len(axes)), "axes": axes,
        "surfaces": surfaces,
    }  # fmt: skip
    return SCRIPT.read_text(encoding="utf-8").replace("--[[PLAN]]", _lua(plan))


def surface_mixes(axes: Sequence[str], full: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the gains of the axes that move each surface of ArduPilot; raise ValueError as `ardupilot_script`."""
    check_names(full, ARDUPILOT, "servo functions of ArduPilot")
    for name, value in full.items():
        check_number(f"full deflection of the {name}", value)
    gains = {name: {name: 1.0} | MIXES.get(name, {}) for name in full}
    mixes = {
        name: {axis: gain for axis, gain in mix.items() if axis in axes}
        for name, mix in gains.items()
    }
    if still := [axis for axis in axes if not any(axis in mix for mix in mixes.values())]:
        raise ValueError(
            f"Got full deflections of {list(full)}, but expected also those of surfaces that move "
            f"with the {' and the '.join(still)}: add them."
        )
    return {name: mix for name, mix in mixes.items() if mix}


def _check_room(table: pd.DataFrame, mixes: Mapping, full: Mapping[str, float]) -> None:
    """Raise ValueError if a full deflection is smaller than the inputs of a surface."""
    for name, mix in mixes.items():
        peak = np.abs(sum(gain * table[axis] for axis, gain in mix.items())).max()
        if not peak <= full[name] * (1.0 + ROUNDING):
            raise ValueError(
                f"Got inputs of the {name} up to {peak:.4g}, but its full deflection is "
                f"{full[name]:g}: make them smaller."
            )


def _parts(signal: Signal) -> dict[str, Any]:
    """Return the numbers of a signal for the script."""
    kind = {"kind": type(signal).__name__, "duration": signal.duration}
    if isinstance(signal, Steps):
        swings = np.diff([0.0, *signal.levels, 0.0])
        return kind | {"edges": signal.edges.tolist(), "swings": swings.tolist()}
    return kind | vars(signal)


def _lua(value: Any) -> str:
    """Return a value as Lua writes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name} = {_lua(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "{" + ", ".join(map(_lua, value)) + "}"
    return json.dumps(value)
