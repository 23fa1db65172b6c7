"""The verdict on a model: what it was learned from, what it is good enough for, and the warnings that matter most."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS
from skdgp.identification._evaluation import Evaluation, scores
from skdgp.report import THRESHOLDS, FlightMechanics, Use, Verdict

CONTROLS = ("Cm_elevator", "Cl_aileron", "Cn_rudder")  # derivatives of each moment by its control
FAST_MODES = ("short period", "Dutch roll", "roll")  # modes that a controller of attitude works in
ACCELERATIONS = {"ax", "ay", "az", *(f"{rate}_dot{end}" for rate in "pqr" for end in ("", "_hat"))}


def judge(
    train: Iterable[pd.DataFrame],
    evaluations: Sequence[Evaluation],
    fit: dict,
    mechanics: FlightMechanics,
    messages: Sequence[str],
) -> Verdict:
    """Return the verdict, by the thresholds of `skdgp.report.THRESHOLDS`."""
    table, known = scores(evaluations)["measured"], list(train)
    means = [{"duration": float(np.ptp(one.time)), **scores([one])["measured"].mean()} for one in evaluations]
    flights = pd.DataFrame(means, index=[one.name for one in evaluations])
    linear = table.get("least_squares_normalized_rmse")
    ratio = pd.Series(dtype=float) if linear is None else table["normalized_rmse"] / linear
    source = f"{_amount(known)}, {fit['samples']:,} samples" if known else "flights that are not part of this report"
    tested = _amount([one.table for one in evaluations if one.table is not None])
    return Verdict(
        learned=f"The six coefficients {' '.join(COEFFICIENTS)} as functions of {', '.join(fit['regressors'])}, "
        f"learned from {source}; tested on {tested}.",
        error=float(table["normalized_rmse"].mean()),
        coverage=float(table["interval_coverage"].mean()),
        least_squares_error=None if linear is None else float(linear.mean()),
        better=tuple(ratio.index[ratio < 1 - THRESHOLDS.tie]),
        worse=tuple(ratio.index[ratio > 1 + THRESHOLDS.tie]),
        uses=(_prediction(table), _simulation(mechanics, fit["regressors"]), _control(mechanics)),
        warnings=_warnings(table, flights, fit, messages),
        flights=flights,
    )


def _amount(tables: Sequence[pd.DataFrame]) -> str:
    seconds = sum(float(np.ptp(table["time"])) for table in tables)
    time = f"{seconds / 60:.1f} minutes" if seconds >= 60 else f"{seconds:.3g} s"
    return f"{time} of {len(tables)} flight{'s' * (len(tables) != 1)}"


def _prediction(table: pd.DataFrame) -> Use:
    lacks = {}
    for name, row in table.iterrows():
        error, held = row["normalized_rmse"], row["interval_coverage"]
        far, sure = not error <= THRESHOLDS.error, not held >= THRESHOLDS.coverage
        words = [f"error {error:.2f} of its spread"] * far + [f"its 95 % band holds {100 * held:.0f} %"] * sure
        if words:
            lacks[str(name)] = f"{name}: {', '.join(words)}"
    good, errors = [name for name in table.index if name not in lacks], table["normalized_rmse"]
    reason = f"only {' '.join(good)}. " * bool(good and lacks) + "; ".join(lacks.values())
    reason = reason or f"errors {errors.min():.2f} to {errors.max():.2f} of the spread of the coefficients"
    return Use("predict coefficients", "yes" if not lacks else "partly" if good else "no", reason)


def _simulation(mechanics: FlightMechanics, regressors: Sequence[str]) -> Use:
    purpose, table = "simulate", mechanics.simulation
    if found := sorted(ACCELERATIONS & set(regressors)):
        return Use(purpose, "no", f"the regressors {', '.join(found)} are known only after a flight")
    if table is None:
        return Use(purpose, "unknown", mechanics.simulation_note)
    ends = table["lasts"].sort_values()
    seconds, horizon = float(ends.iloc[0]), float(table["horizon"].iloc[0])
    if seconds >= horizon:
        return Use(purpose, "yes", f"it follows the test flights for the {horizon:.2g} s that were simulated")
    late = [f"{name} {value:.2g} s" for name, value in ends.items() if value < horizon]
    rest = f"; the other states for all {horizon:.2g} s" if len(late) < len(table) else ""
    fit = "partly" if seconds >= THRESHOLDS.seconds else "no"
    return Use(purpose, fit, f"it follows the test flights for {seconds:.2g} s: {_some(late)}{rest}")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _control(mechanics: FlightMechanics) -> Use:
    purpose = "design a controller"
    if mechanics.trim is None:
        return Use(purpose, "no", mechanics.note.partition(":")[0])
    if "std" not in mechanics.derivatives:
        return Use(purpose, "unknown", "the model has no bands of derivatives")
    table = mechanics.derivatives
    slopes = [name for name in CONTROLS if name in table.index]
    if not slopes:
        return Use(purpose, "no", "the model has none of the controls elevator, aileron, rudder")
    bands = {name: tuple(table.loc[name, ["value", "std"]]) for name in slopes}
    if (modes := mechanics.modes) is not None:
        fast = [name for name in FAST_MODES if name in modes.index]
        bands |= {name: tuple(modes.loc[name, ["frequency", "frequency_std"]]) for name in fast}
    widths = {name: 1.96 * std / abs(value) if value else np.inf for name, (value, std) in bands.items()}
    if wide := {name: width for name, width in widths.items() if not width <= THRESHOLDS.band}:
        words = (f"{name} ± {100 * width:.0f} %" if width < 10 else f"{name} unknown" for name, width in wide.items())
        return Use(purpose, "no", f"not known well enough: {', '.join(words)}")
    worst = max(widths, key=lambda name: widths[name])
    reason = f"controls and fast modes are known to {100 * widths[worst]:.0f} % or better ({worst})"
    if mechanics.trim.beyond:
        return Use(purpose, "no", f"the trim is beyond what was flown in {', '.join(mechanics.trim.beyond)}; {reason}")
    return Use(purpose, "yes", reason)


def _warnings(table: pd.DataFrame, flights: pd.DataFrame, fit: dict, messages: Sequence[str]) -> tuple[str, ...]:
    """Return warnings, that which costs most first: what the scores show before what the log or the fit said."""
    found, bad = [], flights.index[flights["normalized_rmse"] > 1]
    if len(bad):
        words = f"In {len(bad)} of {len(flights)} test flights a constant predicts better (error above 1)"
        found.append(f"{words}: {_some([*map(str, bad)])}.")
    if "least_squares_normalized_rmse" in table:
        linear, error = table["least_squares_normalized_rmse"], table["normalized_rmse"]
        worse = table.index[error > (1 + THRESHOLDS.tie) * linear]
        if len(worse) >= len(table) / 2 or error.mean() > (1 + THRESHOLDS.tie) * linear.mean():
            found.append(f"Least squares is better in {len(worse)} of {len(table)} coefficients: {' '.join(worse)}.")
    held = table["interval_coverage"]
    narrow = [f"{name} {100 * held[name]:.0f} %" for name in table.index if held[name] < THRESHOLDS.coverage]
    if narrow:
        found.append(f"95 % bands are too narrow: they hold {', '.join(narrow)} of the measured values.")
    if not fit.get("converged", True):
        found.append("The fit has not converged: raise max_iter.")
    return tuple(found) + grouped(messages)


def grouped(messages: Sequence[str]) -> tuple[str, ...]:
    """Return messages, of those that differ only in names and numbers the first, with the number of the others.

    Examples
    --------
    >>> grouped(["Flight 'a' lasts 1.5 s.", "A gap.", "Flight 'b' lasts 2 s."])
    ("Flight 'a' lasts 1.5 s. (1 more of this kind)", 'A gap.')
    """
    kinds: dict[str, list[str]] = {}
    for message in messages:
        kinds.setdefault(re.sub(r"'[^']*'|[-+]?\d[\d.]*", "", message), []).append(message)
    return tuple(of[0] if len(of) == 1 else f"{of[0]} ({len(of) - 1} more of this kind)" for of in kinds.values())
