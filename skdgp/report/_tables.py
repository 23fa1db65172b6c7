"""Tables and text as HTML; text from outside is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS, LATERAL, LONGITUDINAL
from skdgp.plotting._style import display_unit

GROUPS = {"Longitudinal": LONGITUDINAL, "Lateral": LATERAL}
HONEST = (0.90, 0.99)
"""Coverage of a 95 % interval that is not remarked on."""

THIN = "\u202f"
DASH = "–"


def text(value: object) -> str:
    """Return ``value`` as escaped text."""
    return escape(str(value), quote=True)


def number(value: float, form: str = ".2f") -> str:
    """Return a number with a true minus, a dash for NaN, and the sign for infinity."""
    if value is None or np.isnan(value):
        return DASH
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{float(value):z{form}}".rstrip(".").replace("-", "−")


def percent(value: float, form: str = ".1f") -> str:
    """Return a fraction as a percentage without its sign."""
    return number(None if value is None else 100 * value, form)


def coverage(value: float) -> str:
    """Return a coverage in percent, marked when it is not near 95 %."""
    shown = percent(value)
    if value < HONEST[0]:
        return f'<span class="off" title="too sure">▼ {shown}</span>'
    if value > HONEST[1]:
        return f'<span class="off" title="too wide">▲ {shown}</span>'
    return shown


def symbol(name: str) -> str:
    """Return a coefficient's name with its index lowered."""
    return f"<i>C</i><sub>{name[1:]}</sub>" if name in COEFFICIENTS else text(name)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str, classes: str = "") -> str:
    """Return a table of ready HTML cells: the first of each row names it; a row of one cell heads a group."""
    lines = [f'<div class="scroll"><table class="{classes}"><caption>{caption}</caption><thead><tr>']
    lines += [f'<th scope="col">{cell}</th>' for cell in head]
    lines.append("</tr></thead><tbody>")
    for first, *rest in rows:
        if not rest:
            lines.append(f'<tr class="group"><th colspan="{len(head)}" scope="colgroup">{first}</th></tr>')
            continue
        cells = "".join(f"<td>{cell}</td>" for cell in rest)
        lines.append(f'<tr><th scope="row">{first}</th>{cells}</tr>')
    lines.append("</tbody></table></div>")
    return "".join(lines)


def error_table(scores: pd.DataFrame, noise_std=None, *, against: str, with_bands: bool = True) -> str:
    """Return errors by coefficient, grouped, with the mean of each group; ``with_bands``: and how honest bands are."""
    head = ["", "NRMSE", "median rel.<br>error [%]", *(["NLPD", "95 %<br>coverage [%]"] if with_bands else [])]
    head += [] if noise_std is None else ["noise σ<br>[10<sup>−3</sup>]"]
    noise = None if noise_std is None else dict(zip(COEFFICIENTS, noise_std, strict=True))
    rows = []
    for group, members in GROUPS.items():
        rows.append([group])
        rows += [[symbol(name), *_cells(scores.loc[name], with_bands), *_noise(noise, name)] for name in members]
        mean = scores.loc[list(members)].mean()
        rows.append(["<em>mean</em>", *_cells(mean, with_bands), *([""] if noise else [])])
    return table(head, rows, caption=f"Errors against {against}.", classes="numbers")


def _cells(row: pd.Series, with_bands: bool) -> list[str]:
    errors = [number(row["normalized_rmse"], ".3f"), percent(row["median_relative_error"])]
    bands = [number(row["negative_log_predictive_density"]), coverage(row["interval_coverage"])]
    return errors + bands * with_bands


def _noise(noise, name: str) -> list[str]:
    return [] if noise is None else [number(1e3 * noise[name], "#.2g")]


_REPLAY_CAPTION = (
    "Absolute errors of the replayed states: the median over all samples, and the median over the windows of the "
    "error at the end of each. A replay is open loop: between restarts no measurement corrects it, so small errors of "
    "the coefficients add up, angles, velocities and positions drift away, and bands of angles tell little once "
    "they are wide; expect errors to grow quickly with the window, and compare models by the shortest one."
)


def replay_table(errors: pd.DataFrame) -> str:
    """Return the errors of the replayed states by horizon, in the units shown."""
    with_bands = "coverage" in errors.columns
    head = ["", "unit", "median<br>error", "error at the<br>window's end", *(["95 %<br>coverage [%]"] * with_bands)]
    rows = []
    for horizon, of_one in errors.groupby("horizon"):
        rows.append([f"Restarted every {number(horizon, 'g')}{THIN}s"])
        rows += [_replay_row(row, with_bands) for row in of_one.itertuples()]
    return table(head, rows, caption=_REPLAY_CAPTION, classes="numbers narrow")


def _replay_row(row, with_bands: bool) -> list[str]:
    factor, unit = display_unit(row.state)
    sizes = [number(factor * value, "#.3g") for value in (row.median, row.at_end)]
    return [state(row.state), unit, *sizes, *([percent(row.coverage)] if with_bands else [])]


def state(name: str) -> str:
    """Return a state's name as the paper writes it."""
    axes = {"v_north": "N", "v_east": "E", "v_down": "D"}
    return f"<i>v</i><sub>{axes[name]}</sub>" if name in axes else f"<i>{text(name)}</i>"


def facts(pairs: Iterable[tuple[str, object]]) -> str:
    """Return a list of what was done; pairs without a value are left out."""
    shown = [(term, value) for term, value in pairs if value not in (None, "")]
    lines = "".join(f"<div><dt>{text(term)}</dt><dd>{text(value)}</dd></div>" for term, value in shown)
    return f'<dl class="facts">{lines}</dl>' if shown else ""
