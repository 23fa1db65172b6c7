"""Tables of the report as HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import pandas as pd

from skdgp._display.page import number, percent, symbol, table, text
from skdgp._flight.channels import LATERAL, LONGITUDINAL
from skdgp.metrics import interval_coverage, normalized_rmse

GROUPS = {"Longitudinal": LONGITUDINAL, "Lateral": LATERAL}
HONEST = (0.90, 0.99)
"""Coverage of a 95 % interval that is not marked."""
REGRESSORS = {
    "alpha": "α", "beta": "β", "alpha_dot": "dα/dt", "beta_dot": "dβ/dt",
    "p_hat": "pb/2V", "q_hat": "qc/2V", "r_hat": "rb/2V",
}  # fmt: skip
"""Regressors in a heading; others stand as they are."""


def coverage(value: float) -> str:
    """Return a coverage in percent, marked when it is not near 95 %."""
    shown = percent(value)
    if value < HONEST[0]:
        return f'<span class="off" title="too sure">▼ {shown}</span>'
    if value > HONEST[1]:
        return f'<span class="off" title="too wide">▲ {shown}</span>'
    return shown


def regressor(name: str) -> str:
    """Return a regressor's name as a heading writes it."""
    return text(REGRESSORS.get(name, name.replace("_", " ")))


def derivative(coefficient: str, name: str) -> str:
    """Return a derivative's name with its indices lowered."""
    return f'<span class="name"><i>C</i><sub>{coefficient[1:]} {regressor(name)}</sub></span>'


class Score(NamedTuple):
    """A column of the tables of errors: its function in skdgp.metrics, heading and format."""

    function: Callable
    head: str
    show: Callable[[float], str]
    of_band: bool = False
    """Whether the function needs the standard deviations."""
    of_baseline: bool = False
    """Whether it is of least squares instead of the model."""


_thousandths = partial(number, form=".3f")
SCORES = {
    "normalized_rmse": Score(normalized_rmse, "NRMSE", _thousandths),
    "least_squares_normalized_rmse": Score(
        normalized_rmse, "NRMSE of<br>least squares", _thousandths, of_baseline=True
    ),
    "interval_coverage": Score(interval_coverage, "95 %<br>coverage [%]", coverage, of_band=True),
}
"""Columns of the tables of errors, by their names in metrics.json and skdgp.metrics."""


def error_table(scores: pd.DataFrame, *, against: str, with_bands: bool = True) -> str:
    """Return errors by coefficient, grouped, with the mean of each group; scores of bands only ``with_bands``."""
    columns = {
        name: score for name, score in SCORES.items()
        if (with_bands or not score.of_band) and (not score.of_baseline or scores[name].notna().any())
    }  # fmt: skip
    rows = []
    for group, members in GROUPS.items():
        rows.append([group])
        values: dict[str, Any] = {symbol(name): scores.loc[name] for name in members}
        values["<em>mean</em>"] = scores.loc[list(members)].mean()
        for name, row in values.items():
            rows.append([name, *(score.show(row[key]) for key, score in columns.items())])
    head = ["", *(score.head for score in columns.values())]
    return table(head, rows, caption=f"Errors against {against}.", classes="numbers")


def state(name: str) -> str:
    """Return a state's name as the paper writes it."""
    axes = {"v_north": "N", "v_east": "E", "v_down": "D"}
    if name in REGRESSORS:
        return regressor(name)
    return f"<i>v</i><sub>{axes[name]}</sub>" if name in axes else f"<i>{text(name)}</i>"


def facts(pairs: Iterable[tuple[str, object]]) -> str:
    """Return a list of facts; pairs without a value are left out."""
    lines = "".join(
        f"<div><dt>{text(term)}</dt><dd>{text(value)}</dd></div>" for term, value in pairs if value
    )
    return f'<dl class="facts">{lines}</dl>' if lines else ""
