"""Plans as HTML: names and numbers in the units that are shown, and the section of a report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._display.html import DASH, THIN, number, percent, symbol, table, text
from skdgp._display.style import display_unit
from skdgp.design._envelope import QUANTITIES

MOST_LISTED = 16
"""Derivatives in one list; more stand in a table of coefficients by regressors."""
GOALS = {
    "function": ("all coefficients", "over the flown range, each in units of its spread"),
    "free-flight": ("free flight", "after 2 s: of alpha, beta, bank and pitch [rad]"),
}
"""In words: the goals that are no derivatives."""
LABELS = {"load_factor": ("load factor", 1.0, "g"), "bank": ("bank", float(np.rad2deg(1.0)), "deg")}
NO_BREAK = "\u00a0"


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


def by_coefficient(errors: pd.DataFrame, names: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """Return heads and rows of a table of coefficients by regressors; all names but the first stand in grey."""
    pairs = [name.split("_", 1) for name in errors.index if "_" in name]
    regressors = list(dict.fromkeys(second for _, second in pairs))
    rows = []
    for coefficient in dict.fromkeys(first for first, _ in pairs):
        keys = [f"{coefficient}_{name}" for name in regressors]
        values = [[milli(errors[name][key]) for name in names] if key in errors.index else [""] for key in keys]
        cells = ["<br>".join([first, *(f"<em>{one}</em>" for one in others)]) for first, *others in values]
        rows.append([symbol(coefficient), *cells])
    return ["", *(heading(name, unit=False) for name in regressors)], rows


def milli(value: float) -> str:
    """Return a thousandth's number with two digits that count, never in powers of ten."""
    if not np.isfinite(value):
        return number(value)
    return np.format_float_positional(float(f"{1e3 * value:.2g}"), trim="-")


def flown_section(plan: Any) -> str:
    """Return a FlownPlan as a section of the report on the flight."""
    names = {"before": "before", "expected": "expected<br>after", "found": "found", "model": "of the<br>model"}
    errors = plan.errors
    if len(errors) <= MOST_LISTED:
        rows = [[derivative(str(name)), *(milli(row[key]) for key in names)] for name, row in errors.iterrows()]
        head, classes, each = ["", *names.values()], "narrow", ""
    else:
        (head, rows), classes = by_coefficient(errors, ("found", "expected", "before")), ""
        each = " Each cell: found and, in grey, expected and before."
    caption = (
        "Standard errors of derivatives, in thousandths. Expected: by the plan. Found: by the same formula, from what "
        "the flight recorded during its manoeuvres. Of the model: of the one judged here, which knows of this flight "
        "only if it learned from it. Geometric mean, of those before: "
    )
    caption += ", ".join(f"{name} {percent(value, '.0f')}{THIN}%" for name, value in plan.remaining.items())
    tables = table(head, rows, caption=f"{caption}.{each}", classes=classes)
    rows = [
        [
            f"{text(row['name'])}<br><em>{text(row['flight'])}, {number(row['start'], '.1f')}{THIN}s</em>",
            percent(row["size"], ".0f"), number(row["likeness"], ".2f"),
            *(f"{_range(name, row, '')}<br><em>{_range(name, row, 'expected_')}</em>" for name in QUANTITIES),
            f'<span class="off">{text(row["left"])}</span>' if row["left"] else "none",
        ]
        for _, row in plan.manoeuvres.iterrows()
    ]  # fmt: skip
    head = ["manoeuvre", "size<br>[%]", "like<br>the plan", *map(heading, QUANTITIES), "limits<br>left"]
    caption = "Manoeuvres of the plan that were flown: the range of each response and, in grey, the expected one."
    tables += table(head, rows, caption=caption)
    if plan.missed:
        words = ", ".join(f"{n} of {name}" for name, n in plan.missed.items())
        tables += f'<p class="note">Planned, but not found in the flights: {text(words)}.</p>'
    return f"<section><h2>The plan and the flight</h2>{tables}</section>"


def _range(name: str, row: pd.Series, kind: str) -> str:
    low, high = (row[f"{name}_{kind}{end}"] for end in ("low", "high"))
    return DASH if np.isnan(low) else f"{shown(name, low)} … {shown(name, high)}"
