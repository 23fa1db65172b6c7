"""A plan beside the flight: which manoeuvres were flown, what they taught, and which limits they left."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import oaconvolve
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Array
from skdgp._display.page import DASH, THIN, number, percent, table, text
from skdgp._flight.channels import HAT
from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_segments
from skdgp.design._card import error_table, heading, shown
from skdgp.design._envelope import GROWTH, QUANTITIES, quantities
from skdgp.design._information import (
    Information,
    coefficient_noise,
    errors_of,
    expected_information,
    posterior_information,
)
from skdgp.design._plan import GEOMETRY, Plan, Record, read_plan
from skdgp.design._rehearsal import RESPONSE, ROW_STEP
from skdgp.dynamics import Aircraft, as_aerodynamics

LIKE = 0.85
"""Least correlation of recorded and planned deflections, over a manoeuvre and its ends, by which it
counts as flown.
"""
SIZES = (0.5, 2.0)  # least and largest size of what counts as flown, relative to the plan
ENDS = 0.4  # time at trim before and after a manoeuvre, by which it is recognised too [s]


@dataclass(frozen=True, eq=False)
class FlownPlan:
    """What a plan expected, and what was found after the flight.

    Parameters
    ----------
    errors : DataFrame
        Standard errors of the derivatives of the goal: ``before`` the flight; ``expected`` after
        it; ``found``, by the same formula from the recorded regressors of the manoeuvres that were
        flown; and ``model``, the standard deviations of the model that is judged, at the trims.
    manoeuvres : DataFrame
        Those that were flown: ``flight``, ``start`` [s], ``name``, ``likeness`` (correlation with
        the plan), ``size`` (relative to it), lowest and highest values of what an envelope limits,
        found and expected (``alpha_low``, ``alpha_high``, ``alpha_expected_low``, ...), and
        ``left``, the limits that were left.
    missed : dict of str to int
        How many of each kind were planned but not flown.
    """

    name: ClassVar[str] = "plan"
    errors: pd.DataFrame
    manoeuvres: pd.DataFrame
    missed: dict[str, int]

    @property
    def remaining(self) -> dict[str, float]:
        """Geometric mean of the errors over those before, ``expected``, ``found`` and of the ``model``."""
        with np.errstate(divide="ignore"):  # nothing was known before
            ratios = np.log(
                self.errors.div(self.errors["before"], axis=0)[["expected", "found", "model"]]
            )
        return {str(name): float(np.exp(value)) for name, value in ratios.mean().items()}

    def summary(self) -> list[str]:
        """Return how much of the plan was flown, and what it taught, in a line each."""
        n_missed, left = sum(self.missed.values()), (self.manoeuvres["left"] != "").sum()
        words = ", ".join(f"{name} {value:.0%}" for name, value in self.remaining.items())
        return [
            f"manoeuvres of the plan: {len(self.manoeuvres)} flown, {n_missed} not; {left} left a "
            f"limit",
            f"errors of the goal, of those before: {words}",
        ]

    def section(self) -> str:
        """Return its section of the report on the flight, HTML."""
        heads = {
            "before": "before",
            "expected": "expected<br>after",
            "found": "found",
            "model": "of the<br>model",
        }
        caption = (
            "Standard errors of derivatives, in thousandths. Expected: by the plan. Found: by the "
            "same formula, from "
            "what the flight recorded during its manoeuvres. Of the model: of the one judged "
            "here, which knows of this "
            "flight only if it learned from it. Geometric mean, of those before: "
        )
        caption += (
            ", ".join(
                f"{name} {percent(value, '.0f')}{THIN}%" for name, value in self.remaining.items()
            )
            + "."
        )
        each = f"{caption} Each cell: found and, in grey, expected and before."
        tables = error_table(self.errors, heads, ("found", "expected", "before"), caption, each)
        rows = [
            [
                f"{text(row['name'])}<br><em>{text(row['flight'])}, "
                f"{number(row['start'], '.1f')}{THIN}s</em>",
                percent(row["size"], ".0f"), number(row["likeness"], ".2f"),
                *(f"{_range(name, row, '')}<br><em>{_range(name, row, 'expected_')}</em>" for name in QUANTITIES),
                f'<span class="off">{text(row["left"])}</span>' if row["left"] else "none",
            ]
            for _, row in self.manoeuvres.iterrows()
        ]  # fmt: skip
        head = [
            "manoeuvre",
            "size<br>[%]",
            "like<br>the plan",
            *map(heading, QUANTITIES),
            "limits<br>left",
        ]
        caption = "Manoeuvres of the plan that were flown: the range of each response and, in grey, the expected one."
        tables += table(head, rows, caption=caption)
        if self.missed:
            words = ", ".join(f"{n} of {name}" for name, n in self.missed.items())
            tables += f'<p class="note">Planned, but not found in the flights: {text(words)}.</p>'
        return f"<section><h2>The plan and the flight</h2>{tables}</section>"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        errors, manoeuvres = self.errors.to_dict("index"), self.manoeuvres.to_dict("records")
        return {
            "remaining": self.remaining,
            "errors": errors,
            "manoeuvres": manoeuvres,
            "missed": self.missed,
        }


class Match(NamedTuple):
    """A manoeuvre of a plan, and where a part of a flight is like it."""

    part: pd.DataFrame
    start: float
    planned: Mapping[str, Any]
    likeness: float
    size: float

    @property
    def end(self) -> float:
        """When its inputs end [s]."""
        return self.start + self.planned["duration"]


def flown_plan(
    plan: Plan | str | os.PathLike[str],
    pipeline: Pipeline,
    aircraft: Aircraft,
    flights: Sequence[pd.DataFrame],
) -> FlownPlan:
    """Return what a plan expected beside what was found in flights.

    Raises FileNotFoundError if there is no such file, ValueError if it is no plan, the plan is of
    another aircraft or of other regressors, a column lacks, or no manoeuvre was flown.

    Parameters
    ----------
    plan : Plan or path
        What was to be flown, or the plan.json of ``skdgp plan``.
    pipeline : Pipeline
        Of :func:`skdgp.identification.identify`. Give the model that the plan was made with, or one
        learned from its flights and these: its standard deviations stand beside those of the plan.
    aircraft : Aircraft
    flights : sequence of DataFrame
        What was flown, at the full rate: the tables of ``validate(model, flights).evaluations``,
        for example.

    Returns
    -------
    FlownPlan
        Among the ``supplements`` of an Identification it is part of its report.
    """
    record = read_plan(plan)
    first = pipeline[: list(pipeline.named_steps).index("regressorselector")]
    tables = [one.assign(**first.transform(one)) for one in flights]
    known = dict(zip(record.before.regressors, record.at, strict=True))
    at = [known.get(name, np.nan) for name in as_aerodynamics(pipeline).regressors]
    information = posterior_information(pipeline, at, record.before.coefficients)
    return compare_with_plan(
        record, pd.concat(tables), aircraft, coefficient_noise(pipeline), information
    )


def compare_with_plan(
    plan: Record, flights: pd.DataFrame, aircraft: Aircraft, noise: pd.DataFrame, model: Information
) -> FlownPlan:
    """Return what a plan expected beside what was found in recorded flights; errors are as of `flown_plan`.

    They have the columns ``time``, ``flight``, the deflections of the plan's axes, what an envelope
    limits, and the regressors. The noise is as of `coefficient_noise`, ``model`` what the model
    that is judged knows at the plan's trims.
    """
    planned, before = plan.aircraft, plan.before
    for name in GEOMETRY:
        if not np.isclose(planned[name], getattr(aircraft, name), rtol=1e-3):
            raise ValueError(
                f"Got a plan of the aircraft {planned.get('name')!r} with a {name} of "
                f"{planned[name]:g}, but the model "
                f"is of {aircraft.name!r} with {getattr(aircraft, name):g}: give the plan of this "
                f"aircraft."
            )
    if set(before.regressors) != set(model.regressors):
        raise ValueError(
            f"Got a plan about the regressors {list(before.regressors)}, but the model has "
            f"{list(model.regressors)}: "
            "judge a model with the regressors that the plan was made with."
        )
    axes = sorted({axis for one in plan.manoeuvres for axis in one["inputs"]})
    check_columns(flights, ["time", *axes], what="flight")
    parts = [flights.iloc[rows] for rows in flight_segments(flights["time"], flights["flight"])]
    segments = [part for part in parts if len(part) > 1]
    windows = [_window(plan.limits, match) for match in _recognised(plan, segments, axes)]
    names = {name.removesuffix(HAT).removesuffix("_dot") for name in before.regressors}
    whole = [part.dropna(subset=[name for name in names if name in part]) for _, part in windows]
    thin = [part[np.diff(part["time"] // ROW_STEP, prepend=-1.0) > 0] for part in whole]
    numbered = pd.concat([part.assign(flight=k) for k, part in enumerate(thin)], ignore_index=True)
    about = plan.at if plan.curvature else None
    noise = noise.loc[list(before.coefficients)]
    gained = expected_information(numbered, aircraft, before.regressors, noise, about=about)
    errors = plan.errors.rename(columns={"after": "expected"})
    for name, information in (("found", before + gained), ("model", model)):
        errors[name] = errors_of(information, plan.weights)[list(errors.index)]
    flown = pd.DataFrame([row for row, _ in windows])
    missed = Counter(one["name"] for one in plan.manoeuvres) - Counter(flown["name"])
    return FlownPlan(errors, flown, dict(missed))


def _recognised(plan: Record, segments: list[pd.DataFrame], axes: list[str]) -> list[Match]:
    """Return the manoeuvres of the plan that are recognised, in the order of flight."""
    step, ends = plan.step, round(ENDS / plan.step)
    kinds = {one["name"]: one for one in reversed(plan.manoeuvres)}
    found: list[Match] = []
    nearest: list[Match] = []
    for part in segments:
        time = part["time"].to_numpy(float)
        starts = np.arange(time[0], time[-1], step)
        grid = time[0] + step * np.arange(-ends, len(starts) + ends)
        moved = np.stack([_resampled(grid, time, part[axis].to_numpy(float)) for axis in axes])
        candidates: list[Match] = []
        for one in kinds.values():
            likeness, size = _likeness(moved, _template(one["inputs"], axes, ends))
            fits = np.flatnonzero((likeness >= LIKE) & (size >= SIZES[0]) & (size <= SIZES[1]))
            best = np.abs(likeness).argsort()[-1:]
            for rows, into in ((fits, candidates), (best, nearest)):
                into += [
                    Match(part, float(starts[n]), one, float(likeness[n]), float(size[n]))
                    for n in rows
                ]
        flown: list[Match] = []
        for match in sorted(
            candidates, key=lambda match: -match.likeness
        ):  # the best of those that overlap
            if all(match.end <= other.start or match.start >= other.end for other in flown):
                flown.append(match)
        found += sorted(flown, key=lambda match: match.start)
    if not found:
        raise ValueError(f"Got flights without a manoeuvre of the plan: {_why_none(nearest)}")
    return found


def _why_none(nearest: list[Match]) -> str:
    """Return why no manoeuvre is recognised, and what to do."""
    if not nearest:
        return "all are shorter than any of its manoeuvres. Give the flights that flew this plan."
    best = max(nearest, key=lambda match: abs(match.likeness))
    remedy = "Give the flights that flew this plan."
    if best.likeness <= -LIKE:
        remedy = "It has the opposite sign: check the signs of the deflections."
    elif best.likeness >= LIKE:
        remedy = "Check the units of the deflections (rad), or fly it at its planned size."
    return (
        f"nearest is {best.planned['name']!r} at {best.start:.2f} s of flight "
        f"{best.part['flight'].iloc[0]!r}, with a "
        f"correlation of {best.likeness:.2f} and {abs(best.size):.2g} times its size, but "
        f"expected at least {LIKE} and "
        f"{SIZES[0]:g} to {SIZES[1]:g} times. {remedy}"
    )


def _resampled(grid: Array, time: Array, values: Array) -> Array:
    """Return a control at other times; rows without a value do not count."""
    known = np.isfinite(values)
    return np.interp(grid, time[known], values[known]) if known.any() else np.zeros(len(grid))


def _template(inputs: Mapping[str, list[float]], axes: list[str], ends: int) -> Array:
    """Return the deviations of all axes, (axes, steps), with ``ends`` steps of flight at trim before and after."""
    length = max(map(len, inputs.values()))
    found = np.zeros((len(axes), length + 2 * ends))
    for axis, values in inputs.items():
        found[axes.index(axis), ends : ends + len(values)] = values
    return found


def _likeness(moved: Array, template: Array) -> tuple[Array, Array]:
    """Return correlation and relative size of the template at each start; trims do not count."""
    n = template.shape[1]
    if moved.shape[1] < n:
        return np.zeros(0), np.zeros(0)
    template = template - template.mean(axis=1, keepdims=True)
    used = np.abs(template).max(axis=1) > 0
    moved, template = (
        moved[used] - moved[used].mean(axis=1, keepdims=True),
        template[used],
    )  # for precision
    product = oaconvolve(moved, template[:, ::-1], "valid", axes=1).sum(axis=0)
    sums, squares = (np.cumsum(np.pad(y, [(0, 0), (1, 0)]), axis=1) for y in (moved, moved**2))
    squares = (squares[:, n:] - squares[:, :-n] - (sums[:, n:] - sums[:, :-n]) ** 2 / n).sum(axis=0)
    power = (template**2).sum()
    return product / np.sqrt(power * np.maximum(squares, 1e-12 * power)), product / power


def _window(
    limits: Mapping[str, tuple[float, float]], match: Match
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the facts of a manoeuvre that was flown, and its rows and those of the response after it."""
    planned, part = match.planned, match.part
    part = part[part["time"].between(match.start, match.end + min(planned["pause"], RESPONSE))]
    values = quantities(part)
    facts = {
        "flight": part["flight"].iloc[0], "start": match.start, "name": planned["name"], "likeness": match.likeness,
        "size": match.size,
    }  # fmt: skip
    for name in QUANTITIES:
        facts |= {f"{name}_low": values[name].min(), f"{name}_high": values[name].max()}
        facts |= {
            f"{name}_expected_{end}": planned["expected"][name][end] for end in ("low", "high")
        }
    left = []
    for name, (low, high) in limits.items():
        column = name.removeprefix(GROWTH)
        flown = values[column] if column in values else part.get(column, pd.Series(dtype=float))
        if (flown < low).any() or (flown > high).any():
            left.append(name)
    return facts | {"left": ", ".join(left)}, part


def _range(name: str, row: pd.Series, kind: str) -> str:
    low, high = (row[f"{name}_{kind}{end}"] for end in ("low", "high"))
    return DASH if np.isnan(low) else f"{shown(name, low)} … {shown(name, high)}"
