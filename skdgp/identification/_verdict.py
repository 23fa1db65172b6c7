"""The verdict on a model: findings with numbers, and the table of limits that turns them into judgements.

A new limit is a kind of finding, a function that finds it, and its place in `LIMITS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skdgp._compute.findings import Severity, clauses_of, texts_of
from skdgp._compute.statistics import half_width
from skdgp._flight.channels import ACCELERATION_LENGTHS, HAT, SPECIFIC_FORCE
from skdgp._flight.findings import Code, Finding, with_codes
from skdgp._regressor import FitCode
from skdgp.identification._evaluate import (
    CONTROL_DERIVATIVES,
    THRESHOLDS,
    Evaluation,
    scores,
)
from skdgp.identification._mechanics import FlightMechanics

# Signs of derivatives of a conventional stable aircraft (docs/notation.md)
USUAL_SIGNS = {
    "CZ_alpha": -1, "CY_beta": -1, "Cm_alpha": -1, "Cn_beta": 1, "Cl_beta": -1, "Cl_p": -1,
    "Cm_q": -1, "Cn_r": -1, "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1,
}  # fmt: skip
# Vanes without which a coefficient is predicted from angles that its own accelerometer gave
VANES_OF = {"CZ": "alpha", "CY": "beta"}
# Kinds of modes that a controller of attitude works in
FAST_MODES = ("short period", "Dutch roll", "roll", "roll-spiral")
# Regressors that are known only after a flight
ACCELERATION_REGRESSORS = {
    *SPECIFIC_FORCE,
    *ACCELERATION_LENGTHS,
    *(name + HAT for name in ACCELERATION_LENGTHS),
}
# columns of scores
NRMSE = "normalized_rmse"
LINEAR_NRMSE = "least_squares_normalized_rmse"
COVERAGE = "interval_coverage"

# Faults of a log that other findings follow from
CAUSES = (Code.CONTRADICTION, Code.CHANNELS_TOGETHER, Code.WRONG_CLOCK, Code.SLOW_LOG)
DOUBTS = (Code.GUSTS_UNKNOWN, Code.PATHS_NOT_CONVERGED)
# Channels of which some are wrong
DISPUTED = (Code.CONTRADICTION, Code.CHANNELS_TOGETHER, Code.WRONG_CLOCK, Code.SENSORS_DISAGREE)
# For each use its limits, judgement and kinds of findings: the first that has a finding decides. A
# "yes" needs a finding too; without any the judgement is "unknown".
LIMITS: dict[str, tuple[tuple[str, tuple[Code, ...]], ...]] = {
    "predict coefficients": (
        ("no", (Code.SIZES_QUESTIONED,)),
        ("unknown", (Code.TOO_LITTLE_FLOWN, Code.TESTED_ON_COPY)),
        ("no", (Code.DIVERGING,)),
        ("unknown", (Code.NOTHING_JUDGED,)),
        ("no", (Code.ALL_ERRORS_TOO_LARGE, Code.AIR_NOT_CONVERGED)),
        ("partly", (Code.ERRORS_TOO_LARGE, Code.BY_CONSTRUCTION, Code.NOT_VARYING, *DOUBTS)),
        ("partly", DISPUTED),
        ("yes", (Code.ERRORS_SMALL,)),
    ),
    "simulate": (
        ("no", (Code.ACCELERATIONS_AS_REGRESSORS, Code.SIZES_QUESTIONED)),
        ("unknown", (Code.TOO_LITTLE_FLOWN, Code.TESTED_ON_COPY)),
        ("unknown", (Code.NOT_SIMULATED, Code.GUSTS_HIDE_ERRORS)),
        ("no", (Code.FOLLOWS_TOO_SHORTLY, Code.AIR_NOT_CONVERGED)),
        ("partly", (Code.FOLLOWS_SHORTLY, *DOUBTS, *DISPUTED)),
        ("yes", (Code.FOLLOWS,)),
    ),
    "design a controller": (
        ("no", (Code.SIZES_QUESTIONED,)),
        ("unknown", (Code.TOO_LITTLE_FLOWN, Code.TESTED_ON_COPY)),
        ("no", (*DOUBTS, Code.SLOW_LOG, Code.WRONG_SIGNS, Code.SIGNS_UNKNOWN)),
        ("no", (Code.NO_TRIM, Code.NO_DERIVATIVES)),
        ("no", (Code.CONTROLS_MISSING,)),
        ("no", (Code.CONTROLS_TOO_UNCERTAIN, Code.BANDS_DO_NOT_HOLD, Code.TRIM_BEYOND)),
        ("partly", (Code.MOMENTS_UNEXPLAINED, Code.FOLLOWS_TOO_SHORTLY)),
        ("partly", (Code.ACCELERATIONS_AS_REGRESSORS, *DISPUTED)),
        ("yes", (Code.CONTROLS_KNOWN,)),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Use:
    """A use of a model: ``judgement`` is "yes", "partly", "no" or "unknown", by its ``findings``."""

    purpose: str
    judgement: str
    findings: tuple[Finding, ...]

    @property
    def reason(self) -> str:
        """The findings as a sentence without its stop."""
        return clauses_of(self.findings)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Scores, and the uses that the model is good enough for.

    Parameters
    ----------
    error : float
        NRMSE, mean of the coefficients that vary; NaN where none does.
    coverage : float
        Coverage of the 95 % bands, mean of the coefficients.
    least_squares_error : float
        Error of a linear model of the same rows.
    unvarying : tuple of str
        Coefficients that vary by less than their noise, so that no error judges them.
    uses : tuple of Use
        Judgements by `LIMITS`.
    findings : tuple of Finding
        Warnings; the one that costs most comes first.
    """

    error: float
    coverage: float
    least_squares_error: float
    unvarying: tuple[str, ...]
    uses: tuple[Use, ...]
    findings: tuple[Finding, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return texts_of(self.findings)

    def compared(self) -> str:
        """Return a sentence on error, coverage, and the error of least squares on the same rows."""
        text = f"error {self.error:.3f} of the spread, {100 * self.coverage:.1f} % in 95 % bands"
        if self.unvarying:
            text += f" (errors without {' '.join(self.unvarying)})"
        return (
            f"{text}; least squares on the same rows has an error of {self.least_squares_error:.3f}"
        )


def judge(
    evaluations: Sequence[Evaluation],
    fit: Bunch,
    mechanics: FlightMechanics,
    findings: Sequence[Finding],
) -> Verdict:
    """Return the verdict: of all findings the judgement of each use by `LIMITS`, and the warnings.

    ``findings`` of the identification are judged and told again with those of scores and mechanics.
    """
    table = scores(evaluations)["measured"]
    unvarying = _not_varying(evaluations, table, fit)
    varying = table.drop(index=unvarying)
    causes = with_codes(findings, *CAUSES)
    warnings = [
        finding
        for finding in findings
        if finding.severity is Severity.WARNING and finding.code not in CAUSES
    ]
    warnings.sort(key=lambda finding: not isinstance(finding.code, FitCode))
    # the costliest first
    every = [
        *_doubts(fit, findings),
        *causes,
        *_sign_findings(mechanics.derivatives),
        *_against_least_squares(varying),
        *_band_findings(table),
        *_if_any(Code.NOT_VARYING, names=unvarying),
        *warnings,
        *_training_findings(fit),
        *_error_findings(varying, _by_construction(evaluations, fit)),
        *mechanics.notes,
        *_simulation_findings(mechanics),
        *_control_findings(mechanics, varying),
    ]
    means = varying.mean()
    return Verdict(
        error=float(means[NRMSE]),
        coverage=float(table[COVERAGE].mean()),
        least_squares_error=means[LINEAR_NRMSE],
        unvarying=tuple(unvarying),
        uses=tuple(_judged(purpose, every) for purpose in LIMITS),
        findings=tuple(finding for finding in every if finding.severity is not Severity.NOTE),
    )


def _judged(purpose: str, findings: Sequence[Finding]) -> Use:
    """Return the judgement of a use by the first of its limits that has findings."""
    for judgement, codes in LIMITS[purpose]:
        decisive = tuple(finding for finding in findings if finding.code in codes)
        if decisive:
            return Use(purpose, judgement, decisive)
    return Use(purpose, "unknown", ())


def _if_any(code: Code, **numbers: Any) -> list[Finding]:
    """Return a finding if the first of its numbers, names or a series, is not empty."""
    if not len(next(iter(numbers.values()))):
        return []
    for name, values in numbers.items():
        numbers[name] = values.to_dict() if isinstance(values, pd.Series) else list(values)
    return [Finding(code, **numbers)]


def _doubts(fit: Bunch, findings: Sequence[Finding]) -> list[Finding]:
    """Return the doubts of the fit and of the test flights, one of each code, and failures behind them."""
    doubts: dict[Any, Finding] = {}
    for finding in [*fit.doubts, *findings]:
        if finding.severity is Severity.DOUBT:
            doubts.setdefault(finding.code, finding)
    causes = [doubt.numbers["cause"] for doubt in doubts.values() if "cause" in doubt.numbers]
    # alpha and beta are wrong
    return [*doubts.values(), *with_codes(causes, Code.AIR_NOT_CONVERGED)]


def _training_findings(fit: Bunch) -> list[Finding]:
    """Return the findings of too few seconds or rows, and of regressors that are known only after a flight."""
    accelerations = sorted(ACCELERATION_REGRESSORS & set(fit.regressors))
    findings = _if_any(Code.ACCELERATIONS_AS_REGRESSORS, names=accelerations)
    rows_by_regressor = fit.samples / len(fit.regressors)
    if fit.flown < THRESHOLDS.flown or rows_by_regressor < THRESHOLDS.rows:
        findings.append(
            Finding(
                Code.TOO_LITTLE_FLOWN,
                seconds=fit.flown,
                each=rows_by_regressor,
                least_seconds=THRESHOLDS.flown,
                least_rows=THRESHOLDS.rows,
            )
        )
    return findings


def _not_varying(evaluations: Sequence[Evaluation], table: pd.DataFrame, fit: Bunch) -> list[str]:
    """Return coefficients whose spread in the test flights is below their noise, so that no error judges them.

    An error below the spread judges a coefficient all the same, and so does a band that does not hold.
    """
    spread = np.nanstd(np.concatenate([flight.measured for flight in evaluations]), axis=0)
    is_still = spread < pd.Series(fit.noise_std).reindex(table.index)
    is_excused = (table[COVERAGE] >= THRESHOLDS.held) & (table[NRMSE] > 1)
    return list(table.index[is_still & is_excused])


def _by_construction(evaluations: Sequence[Evaluation], fit: Bunch) -> dict[str, str]:
    """Return coefficients that agree with their measurement by construction, and the vane that is missing."""
    measured = {name for flight in evaluations for name in flight.table}
    return {
        coefficient: vane
        for coefficient, vane in VANES_OF.items()
        if vane in fit.regressors and vane not in measured
    }


def _error_findings(varying: pd.DataFrame, vanes: dict[str, str]) -> list[Finding]:
    """Return the findings of the errors and bands of coefficients, without those that lack their ``vanes``."""
    findings = []
    mean_error = varying[NRMSE].mean()
    if mean_error > 1:
        findings.append(Finding(Code.DIVERGING, error=mean_error))
    unjudged = [name for name in vanes if name in varying.index]
    lacking = [vanes[name] for name in unjudged]
    findings += _if_any(Code.BY_CONSTRUCTION, names=unjudged, vanes=lacking)
    judged = varying.drop(index=unjudged)
    if judged.empty:
        return [*findings, Finding(Code.NOTHING_JUDGED)]
    errors = judged[NRMSE]
    # NaN is neither small nor wide enough
    is_large = ~(errors <= THRESHOLDS.error)
    is_narrow = ~(judged[COVERAGE] >= THRESHOLDS.coverage)
    is_poor = is_large | is_narrow
    if not is_poor.any():
        return [*findings, Finding(Code.ERRORS_SMALL, smallest=errors.min(), largest=errors.max())]
    return findings + _if_any(
        Code.ALL_ERRORS_TOO_LARGE if is_poor.all() else Code.ERRORS_TOO_LARGE,
        poor=judged.index[is_poor],
        good=judged.index[~is_poor],
        errors=errors[is_large],
        coverages=judged.loc[is_narrow, COVERAGE],
    )


def _simulation_findings(mechanics: FlightMechanics) -> list[Finding]:
    """Return how long each state of a simulation stays near the flights."""
    table = mechanics.simulation
    if table is None:
        return []
    lasts = table["lasts"].sort_values()
    seconds = float(lasts.min())
    horizon = float(table["horizon"].min())
    numbers = {
        "seconds": seconds,
        "horizon": horizon,
        "late": lasts[lasts < horizon].to_dict(),
    }
    code = Code.FOLLOWS_TOO_SHORTLY
    if seconds >= horizon:
        code = Code.FOLLOWS
    elif seconds >= THRESHOLDS.seconds:
        code = Code.FOLLOWS_SHORTLY
    elif not table["wind_known"].all():
        code = Code.GUSTS_HIDE_ERRORS
    return [Finding(code, **numbers)]


def _control_findings(mechanics: FlightMechanics, varying: pd.DataFrame) -> list[Finding]:
    """Return what a controller depends on: trim, derivatives by the controls, fast modes, errors of the moments."""
    findings = []
    widths = _half_widths(mechanics)
    if mechanics.trim is None or widths.empty:
        return [Finding(Code.CONTROLS_MISSING)]
    errors = varying[NRMSE].reindex(["Cl", "Cm", "Cn"])
    findings += _if_any(Code.CONTROLS_TOO_UNCERTAIN, widths=widths[~(widths <= THRESHOLDS.band)])
    findings += _if_any(Code.TRIM_BEYOND, names=mechanics.trim.beyond)
    findings += _if_any(Code.MOMENTS_UNEXPLAINED, errors=errors[errors > THRESHOLDS.error])
    return [*findings, Finding(Code.CONTROLS_KNOWN, width=widths.max(), widest=widths.idxmax())]


def _half_widths(mechanics: FlightMechanics) -> pd.Series:
    """Return half widths of 95 % bands over values, of controls and fast modes; empty without controls."""
    table = mechanics.derivatives.reindex(columns=["value", "std"])
    bands = table[table.index.isin(CONTROL_DERIVATIVES)]
    if mechanics.modes is not None and len(bands):
        # without the numbers of several of one kind
        names = mechanics.modes.index
        kinds = names.str.replace(r" \d+$", "", regex=True)
        fast = mechanics.modes.loc[kinds.isin(FAST_MODES), ["frequency", "frequency_std"]]
        bands = pd.concat([bands, fast.set_axis(["value", "std"], axis=1)])
    return half_width(0.95) * bands["std"] / bands["value"].abs()


def _sign_findings(derivatives: pd.DataFrame) -> list[Finding]:
    """Return the findings of derivatives whose sign is, or may be, other than on a conventional stable aircraft.

    Wrong is a sign that the 95 % band excludes; the others are not known.
    """
    if derivatives.empty:
        return []
    usual = pd.Series(USUAL_SIGNS).reindex(derivatives.index)
    wrong = derivatives[derivatives["value"] * usual < 0]
    is_known = wrong["value"].abs() > half_width(0.95) * wrong["std"]
    return [
        *_if_any(Code.WRONG_SIGNS, values=wrong["value"][is_known]),
        *_if_any(Code.SIGNS_UNKNOWN, values=wrong["value"][~is_known]),
    ]


def _against_least_squares(varying: pd.DataFrame) -> list[Finding]:
    """Return the warning that least squares predicts better, if it does."""
    limits = (1 + THRESHOLDS.tie) * varying[LINEAR_NRMSE]
    worse = list(varying.index[varying[NRMSE] > limits])
    is_worse_in_half = bool(worse) and len(worse) >= len(varying) / 2
    if is_worse_in_half or varying[NRMSE].mean() > limits.mean():
        return [
            Finding(
                Code.LEAST_SQUARES_BETTER, names=worse, worse=len(worse), coefficients=len(varying)
            )
        ]
    return []


def _band_findings(table: pd.DataFrame) -> list[Finding]:
    """Return the findings of bands that are too narrow or too wide, of all coefficients."""
    held = table[COVERAGE]
    return [
        *_if_any(Code.BANDS_TOO_NARROW, coverages=held[held < THRESHOLDS.coverage]),
        *_if_any(Code.BANDS_TOO_WIDE, coverages=held[held > THRESHOLDS.widest]),
        *_if_any(Code.BANDS_DO_NOT_HOLD, coverages=held[~(held >= THRESHOLDS.held)]),
    ]
