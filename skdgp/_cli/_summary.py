"""What is printed at the end: the few numbers that one looks at first, and where the rest is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skdgp._cli._evaluation import Evaluation, grouped
from skdgp._cli._outputs import Outcome
from skdgp.plotting._style import display_unit

SHOWN_STATES = ("v_east", "p", "r")


def summary(outcome: Outcome, folder: Path) -> str:
    """Return the summary as text."""
    lines = [_fit_line(outcome)]
    for evaluation in outcome.evaluations:
        lines += ["", *_scores(evaluation), *_states(evaluation)]
    lines += ["", *(f"{words:<8}{folder / name}" for words, name in _FILES)]
    return "\n".join(lines)


_FILES = (
    ("report", "report.html"),
    ("numbers", "metrics.json"),
    ("model", "model.joblib"),
)


def _fit_line(outcome) -> str:
    state = "interrupted" if outcome.interrupted else "fitted"
    return (
        f"{outcome.source.aircraft.name}: {state} in {outcome.seconds:.1f} s on {outcome.n_samples} of "
        f"{outcome.n_available} samples, log likelihood {outcome.regressor.log_marginal_likelihood_value_:.1f}"
    )


def _scores(evaluation: Evaluation) -> list[str]:
    against = list(evaluation.scores)
    head = f"{'flight ' + evaluation.name:<40}"
    lines = [head.rstrip(), " " * 14 + "".join(f"{'against ' + name:^36}" for name in against).rstrip()]
    lines.append(" " * 14 + "".join(f"{'median':>11}{'NRMSE':>11}{'in 95 %':>11}   " for _ in against).rstrip())
    lines.append(" " * 14 + "".join(f"{'rel. error':>11}{'':>11}{'band':>11}   " for _ in against).rstrip())
    tables = list(evaluation.scores.values())
    means = [grouped(scores) for scores in tables]
    for name in tables[0].index:
        lines.append(_row(name, [scores.loc[name] for scores in tables]))
    lines.append("")
    for name in means[0].index:
        lines.append(_row(name, [scores.loc[name] for scores in means]))
    return lines


def _row(name, rows) -> str:
    cells = "".join(
        f"{_percent(row.median_relative_error):>11}{row.normalized_rmse:>11.3f}{_percent(row.interval_coverage):>11}   "
        for row in rows
    )
    return f"  {name:<12}{cells}".rstrip()


def _states(evaluation: Evaluation) -> list[str]:
    if not evaluation.states:
        return []
    errors = evaluation.states["measured"]
    lines = ["", "  replayed, median absolute error"]
    for horizon, part in errors.groupby("horizon"):
        part = part.set_index("state")
        cells = []
        for state in (name for name in SHOWN_STATES if name in part.index):
            factor, unit = display_unit(state)
            cells.append(f"{state} {factor * part['median'][state]:.3g} {unit}")
        lines.append(f"  every {horizon:>4g} s  " + ",  ".join(cells))
    return lines


def _percent(fraction) -> str:
    return f"{100 * fraction:.1f} %" if np.isfinite(fraction) else "-"
