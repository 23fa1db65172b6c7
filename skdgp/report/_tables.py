"""Tables of the report as HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import pandas as pd

from skdgp._display.page import number, percent, symbol, table, text
from skdgp._flight.channels import LATERAL, LONGITUDINAL

GROUPS = {"Longitudinal": LONGITUDINAL, "Lateral": LATERAL}
HONEST = (0.90, 0.99)  # coverage of a 95 % interval that is not marked
# Regressors in a heading; others stand as they are
REGRESSORS = {
    "alpha": "α", "beta": "β", "alpha_dot": "dα/dt", "beta_dot": "dβ/dt",
    "p_hat": "pb/2V", "q_hat": "qc/2V", "r_hat": "rb/2V",
}  # fmt: skip


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


_thousandths = partial(number, form=".3f")
# Heading and format of the columns of the tables of errors, by their names in metrics.json
SCORES: dict[str, tuple[str, Callable[[Any], str]]] = {
    "normalized_rmse": ("NRMSE", _thousandths),
    "least_squares_normalized_rmse": ("NRMSE of<br>least squares", _thousandths),
    "interval_coverage": ("95 %<br>coverage [%]", coverage),
}


def error_table(scores: pd.DataFrame, *, against: str) -> str:
    """Return errors by coefficient, grouped, with the mean of each group."""
    columns = {name: column for name, column in SCORES.items() if name in scores}
    rows = []
    for group, members in GROUPS.items():
        rows.append([group])
        values: dict[str, Any] = {symbol(name): scores.loc[name] for name in members}
        values["<em>mean</em>"] = scores.loc[list(members)].mean()
        for name, row in values.items():
            rows.append([name, *(show(row[key]) for key, (_, show) in columns.items())])
    head = ["", *(title for title, _ in columns.values())]
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
