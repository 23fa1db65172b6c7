"""The summary printed at the end of a command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skdgp.identification._evaluation import Evaluation, grouped, scores
from skdgp.identification._outcome import Outcome
from skdgp.plotting._style import display_unit

SHOWN_STATES = ("v_east", "p", "r")
WORDS = {"report.html": "report", "metrics.json": "numbers", "model.joblib": "model", "config.toml": "options"}
MARGIN, WIDTH = 16, 11


def summary(outcome: Outcome, files: dict[str, Path]) -> str:
    """Return the summary as text: a table for all test flights together, a line or a table for each, the files."""
    tested = outcome.evaluations
    lines = [_fit_line(outcome)]
    if len(tested) == 1:
        lines += ["", f"flight {tested[0].name}", *_score_table(tested), "", *_states(tested[0])]
    else:
        lines += ["", f"{len(tested)} test flights together", *_score_table(tested), ""]
        for evaluation in tested:
            lines += [f"flight {evaluation.name}", _row("all", _means([evaluation], "all")), *_states(evaluation)]
    lines += ["", *(f"{WORDS[name]:<9}{path}" for name, path in files.items())]
    return "\n".join(lines).rstrip()


def _fit_line(outcome) -> str:
    fit = outcome.fit
    end = f"log likelihood {fit['log_marginal_likelihood']:.1f}"
    if "seconds" not in fit:
        return f"{outcome.aircraft.name}: {end}"
    on = f"{fit['seconds']:.1f} s on {fit['samples']} of {fit['samples_available']} samples"
    return f"{outcome.aircraft.name}: {'interrupted' if fit['interrupted'] else 'fitted'} in {on}, {end}"


def _score_table(evaluations: Sequence[Evaluation]) -> list[str]:
    tables = scores(evaluations)
    above = [f"{'against measured':>{3 * WIDTH}}", f"{'against truth':>{2 * WIDTH}}"][: len(tables)]
    lines = [" " * MARGIN + "".join(above)]
    for words in (("median", "NRMSE", "in 95 %"), ("rel. error", "", "band")):
        cells = [f"{word:>{WIDTH}}" for word in (*words, *words[:2] * (len(tables) - 1))]
        lines.append(" " * MARGIN + "".join(cells).rstrip())
    names = tables["measured"].index
    lines += [_row(name, [table.loc[name] for table in tables.values()]) for name in names]
    return [*lines, "", *(_row(group, _means(evaluations, group)) for group in ("longitudinal", "lateral", "all"))]


def _means(evaluations, group):
    return [grouped(table).loc[group] for table in scores(evaluations).values()]


def _row(name, rows) -> str:
    """Return errors and coverage against measured; of truth the errors alone, as it holds what no band knows: gusts."""
    measured, *truth = rows
    cells = [_percent(measured.median_relative_error), f"{measured.normalized_rmse:.3f}"]
    cells.append(_percent(measured.interval_coverage))
    for row in truth:
        cells += [_percent(row.median_relative_error), f"{row.normalized_rmse:.3f}"]
    return f"  {name:<{MARGIN - 2}}" + "".join(f"{cell:>{WIDTH}}" for cell in cells)


def _states(evaluation: Evaluation) -> list[str]:
    if not evaluation.states:
        return []
    lines = []
    for horizon, part in evaluation.states["measured"].groupby("horizon"):
        median = part.set_index("state")["median"]
        cells = []
        for state in (name for name in SHOWN_STATES if name in median):
            factor, unit = display_unit(state)
            cells.append(f"{state} {factor * median[state]:.3g} {unit}")
        lines.append(f"  replayed over {horizon:g} s, median error: {', '.join(cells)}")
    return lines


def _percent(fraction) -> str:
    return f"{100 * fraction:.1f} %" if np.isfinite(fraction) else "-"
