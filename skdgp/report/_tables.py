"""Tables of the report as HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._display.page import THIN, number, percent, symbol, table, text
from skdgp._display.style import display_unit
from skdgp._flight.channels import COEFFICIENTS, LATERAL, LONGITUDINAL
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)

GROUPS = {"Longitudinal": LONGITUDINAL, "Lateral": LATERAL}
HONEST = (0.90, 0.99)
"""Coverage of a 95 % interval that is not marked."""


def coverage(value: float) -> str:
    """Return a coverage in percent, marked when it is not near 95 %."""
    shown = percent(value)
    if value < HONEST[0]:
        return f'<span class="off" title="too sure">▼ {shown}</span>'
    if value > HONEST[1]:
        return f'<span class="off" title="too wide">▲ {shown}</span>'
    return shown


REGRESSORS = {
    "alpha": "α", "beta": "β", "alpha_dot": "dα/dt", "beta_dot": "dβ/dt",
    "p_hat": "pb/2V", "q_hat": "qc/2V", "r_hat": "rb/2V",
}  # fmt: skip
"""Regressors in a heading; others stand as they are."""


def regressor(name: str) -> str:
    """Return a regressor's name as a heading writes it."""
    return text(REGRESSORS.get(name, name.replace("_", " ")))


def derivative(coefficient: str, name: str) -> str:
    """Return a derivative's name with its indices lowered."""
    return f"<i>C</i><sub>{coefficient[1:]} {regressor(name)}</sub>"


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
    "median_relative_error": Score(median_relative_error, "median rel.<br>error [%]", percent),
    "negative_log_predictive_density": Score(
        negative_log_predictive_density, "NLPD", number, of_band=True
    ),
    "interval_coverage": Score(interval_coverage, "95 %<br>coverage [%]", coverage, of_band=True),
}
"""By the names in metrics.json, those of skdgp.metrics; one more line is one more column of the
report.
"""


def error_table(
    scores: pd.DataFrame, noise_std=None, *, against: str, with_bands: bool = True
) -> str:
    """Return errors by coefficient, grouped, with the mean of each group; those of bands only ``with_bands``."""
    columns = {
        name: score for name, score in SCORES.items()
        if (with_bands or not score.of_band) and (not score.of_baseline or scores[name].notna().any())
    }  # fmt: skip

    def cells(row):
        return [score.show(row[name]) for name, score in columns.items()]

    head = ["", *(score.head for score in columns.values())]
    noise = {} if noise_std is None else dict(zip(COEFFICIENTS, noise_std, strict=True))
    head += ["noise σ<br>[10<sup>−3</sup>]"] if noise else []
    rows = []
    for group, members in GROUPS.items():
        rows.append([group])
        for name in members:
            last = (
                [number(1e3 * noise[name], "#.2g" if noise[name] < 0.0995 else ".0f")]
                if noise
                else []
            )
            rows.append([symbol(name), *cells(scores.loc[name]), *last])
        rows.append(
            ["<em>mean</em>", *cells(scores.loc[list(members)].mean()), *([""] if noise else [])]
        )
    return table(head, rows, caption=f"Errors against {against}.", classes="numbers")


_REPLAY_COLUMNS = {
    "median": "median<br>error",
    "at_end": "error at the<br>window's end",
    "spread": "spread in<br>the flight",
    "relative": "at the end,<br>over spread",
    "coverage": "95 %<br>coverage [%]",
}
"""Headings by column of `skdgp.dynamics.replay_errors`."""


def replay_table(errors: pd.DataFrame) -> str:
    """Return the errors of the replayed states by horizon, in the units shown."""
    if "spread" in errors:
        errors = errors.assign(relative=errors["at_end"] / errors["spread"])
    columns = {name: head for name, head in _REPLAY_COLUMNS.items() if name in errors}

    def show(name, value, factor):
        if name == "coverage":
            return percent(value)
        if name != "relative":
            return number(factor * value, "#.3g")
        # Where the error is larger than the spread, a constant would do as well.
        return f'<span class="off">▼ {number(value)}</span>' if value > 1 else number(value)

    rows = []
    for horizon in np.unique(errors["horizon"]):
        rows.append([f"Restarted every {number(horizon, 'g')}{THIN}s"])
        for _, row in errors[errors["horizon"] == horizon].iterrows():
            factor, unit = display_unit(row["state"])
            rows.append(
                [state(row["state"]), unit, *(show(name, row[name], factor) for name in columns)]
            )
    caption = (
        "Absolute errors of the replayed states: the median over all samples, and the median over "
        "the windows of the "
        "error at the end of each; the standard deviation of the state in the flight; ▼ where the "
        "error is larger than "
        "that, so that the mean state would do as well. A replay is open loop: between restarts "
        "no measurement "
        "corrects it, so small errors of the coefficients add up; compare models by the shortest "
        "window."
    )
    return table(["", "unit", *columns.values()], rows, caption=caption, classes="numbers narrow")


def state(name: str) -> str:
    """Return a state's name as the paper writes it."""
    axes = {"v_north": "N", "v_east": "E", "v_down": "D"}
    if name in REGRESSORS:
        return regressor(name)
    return f"<i>v</i><sub>{axes[name]}</sub>" if name in axes else f"<i>{text(name)}</i>"


def facts(pairs: Iterable[tuple[str, object]]) -> str:
    """Return a list of what was done; pairs without a value are left out."""
    lines = "".join(
        f"<div><dt>{text(term)}</dt><dd>{text(value)}</dd></div>" for term, value in pairs if value
    )
    return f'<dl class="facts">{lines}</dl>' if lines else ""
