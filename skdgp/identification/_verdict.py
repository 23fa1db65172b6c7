"""The verdict on a model: the uses that it is good enough for, and warnings, by numbers and findings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from skdgp._compute.findings import Code, Finding, Severity
from skdgp._flight.channels import ACCELERATION_LENGTHS, HAT, SPECIFIC_FORCE
from skdgp.report import (
    THRESHOLDS,
    Evaluation,
    Extent,
    FitRecord,
    FlightMechanics,
    Use,
    Verdict,
    scores,
)

CONTROLS = ("Cm_elevator", "Cl_aileron", "Cn_rudder")  # derivatives of each moment by its control
# Signs of derivatives of a conventional stable aircraft (docs/notation.md)
SIGNS = {
    "CZ_alpha": -1, "CY_beta": -1, "Cm_alpha": -1, "Cn_beta": 1, "Cl_beta": -1, "Cl_p": -1,
    "Cm_q": -1, "Cn_r": -1, "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1,
}  # fmt: skip
# kinds of modes that a controller of attitude works in
FAST_MODES = ("short period", "Dutch roll", "roll", "roll-spiral")
MOMENTS = ("Cl", "Cm", "Cn")
# Regressors that are known only after a flight
ACCELERATIONS = {
    *SPECIFIC_FORCE,
    *ACCELERATION_LENGTHS,
    *(name + HAT for name in ACCELERATION_LENGTHS),
}


def judge(
    train: Iterable[pd.DataFrame],
    evaluations: Sequence[Evaluation],
    fit: FitRecord,
    mechanics: FlightMechanics,
    findings: Sequence[Finding],
) -> Verdict:
    """Return the verdict, by the thresholds of `skdgp.report.THRESHOLDS`."""
    table = scores(evaluations)["measured"]
    errors = table["normalized_rmse"]
    doubts = _doubts(fit, findings)
    faults = [*doubts, *_wrong_signs(mechanics.derivatives)]
    uses = (
        _prediction(table),
        _simulation(mechanics, fit.regressors),
        _control(mechanics, errors, faults),
    )
    warnings = [*faults, *_scored(table, evaluations)]
    if not fit.converged:
        warnings.append(Finding(Code.FIT_NOT_CONVERGED))
    warnings += [finding for finding in findings if finding.severity is not Severity.DOUBT]
    learned = list(train)
    linear = table.get("least_squares_normalized_rmse")
    ratio = pd.Series(dtype=float) if linear is None else errors / linear
    return Verdict(
        regressors=fit.regressors,
        tested=Extent.of([flight.table for flight in evaluations]),
        trained=Extent.of(learned) if learned else None,
        samples=fit.training.samples if fit.training else 0,
        error=float(errors.mean()),
        coverage=float(table["interval_coverage"].mean()),
        least_squares_error=None if linear is None else float(linear.mean()),
        better=tuple(ratio.index[ratio < 1 - THRESHOLDS.tie]),
        worse=tuple(ratio.index[ratio > 1 + THRESHOLDS.tie]),
        uses=tuple(_with_doubts(use, doubts) for use in uses),
        findings=tuple(warnings),
    )


def _doubts(fit: FitRecord, findings: Sequence[Finding]) -> list[Finding]:
    """Return the doubts of the fit, and further ones of the test flights, one of each code."""
    doubts = fit.doubts
    for finding in findings:
        is_known = finding.code in [doubt.code for doubt in doubts]
        if finding.severity is Severity.DOUBT and not is_known:
            doubts.append(finding)
    return doubts


def _with_doubts(use: Use, doubts: Sequence[Finding]) -> Use:
    """Return a judgement with the doubts; no use is then judged with "yes"."""
    if use.fit != "yes" or not doubts:
        return use
    return Use(use.purpose, "partly", (*use.findings, *doubts))


def _wrong_signs(derivatives: pd.DataFrame) -> list[Finding]:
    """Return the finding of derivatives of other sign than on a conventional stable aircraft, if any."""
    values = derivatives.get("value", pd.Series(dtype=float)).reindex(list(SIGNS))
    wrong = values[values * pd.Series(SIGNS) < 0]
    if wrong.empty:
        return []
    return [
        Finding(Code.WRONG_SIGNS, numbers={"values": wrong.to_dict(), "names": list(wrong.index)})
    ]


def _prediction(table: pd.DataFrame) -> Use:
    """Return whether the model predicts coefficients."""
    purpose = "predict coefficients"
    errors = table["normalized_rmse"]
    coverages = table["interval_coverage"]
    large = errors[~(errors <= THRESHOLDS.error)]
    narrow = coverages[~(coverages >= THRESHOLDS.coverage)]
    poor = [name for name in table.index if name in large or name in narrow]
    if not poor:
        numbers = {"smallest": errors.min(), "largest": errors.max()}
        return Use(purpose, "yes", (Finding(Code.ERRORS_SMALL, numbers=numbers),))
    good = [name for name in table.index if name not in poor]
    lacks = {
        "good": good,
        "poor": poor,
        "errors": large.to_dict(),
        "coverages": narrow.to_dict(),
    }
    finding = Finding(Code.ERRORS_TOO_LARGE, numbers=lacks)
    return Use(purpose, "partly" if good else "no", (finding,))


def _simulation(mechanics: FlightMechanics, regressors: Sequence[str]) -> Use:
    """Return whether the model simulates flights."""
    purpose = "simulate"
    accelerations = sorted(ACCELERATIONS & set(regressors))
    if accelerations:
        finding = Finding(Code.ACCELERATIONS_AS_REGRESSORS, numbers={"names": accelerations})
        return Use(purpose, "no", (finding,))
    table = mechanics.simulation
    if table is None:
        note = mechanics.simulation_note
        return Use(purpose, "unknown", () if note is None else (note,))
    ends = table["lasts"].sort_values()
    seconds = float(ends.iloc[0])
    horizon = float(table["horizon"].iloc[0])
    if seconds >= horizon:
        return Use(purpose, "yes", (Finding(Code.FOLLOWS, numbers={"horizon": horizon}),))
    apart = float(table["lasts_without_gusts"].min())
    if seconds < THRESHOLDS.seconds <= apart:
        numbers = {"seconds": seconds, "gusts": float(table["gusts"].iloc[0]), "apart": apart}
        return Use(purpose, "unknown", (Finding(Code.GUSTS_HIDE_ERRORS, numbers=numbers),))
    late = {
        "seconds": seconds,
        "horizon": horizon,
        "late": ends[ends < horizon].to_dict(),
        "states": len(table),
    }
    fit = "partly" if seconds >= THRESHOLDS.seconds else "no"
    return Use(purpose, fit, (Finding(Code.FOLLOWS_SHORTLY, numbers=late),))


def _control(mechanics: FlightMechanics, errors: pd.Series, faults: Sequence[Finding]) -> Use:
    """Return whether the model serves to design a controller."""
    purpose = "design a controller"
    if faults:
        return Use(purpose, "no", tuple(faults))
    if mechanics.trim is None or mechanics.derivatives.empty:
        return Use(purpose, "no", mechanics.notes)
    if "std" not in mechanics.derivatives:
        return Use(purpose, "unknown", (Finding(Code.NO_BANDS),))
    widths = _half_widths(mechanics)
    if widths is None:
        return Use(purpose, "no", (Finding(Code.CONTROLS_MISSING),))
    wide = widths[~(widths <= THRESHOLDS.band)]
    if len(wide):
        finding = Finding(Code.CONTROLS_TOO_UNCERTAIN, numbers={"widths": wide.to_dict()})
        return Use(purpose, "no", (finding,))
    controls_known = Finding(
        Code.CONTROLS_KNOWN, numbers={"width": widths.max(), "widest": widths.idxmax()}
    )
    beyond = list(mechanics.trim.beyond)
    if beyond:
        return Use(
            purpose, "no", (Finding(Code.TRIM_BEYOND, numbers={"names": beyond}), controls_known)
        )
    poor = [name for name in MOMENTS if errors[name] > 1]
    if poor:
        finding = Finding(Code.CONSTANT_BETTER_IN_MOMENTS, numbers={"names": poor})
        return Use(purpose, "partly", (controls_known, finding))
    return Use(purpose, "yes", (controls_known,))


def _half_widths(mechanics: FlightMechanics) -> pd.Series | None:
    """Return half widths of 95 % bands over values, of controls and fast modes; None without controls."""
    table = mechanics.derivatives
    bands = table.loc[table.index.isin(CONTROLS), ["value", "std"]]
    if bands.empty:
        return None
    if mechanics.modes is not None:
        is_fast = mechanics.mode_kinds.isin(FAST_MODES)
        fast = mechanics.modes.loc[is_fast, ["frequency", "frequency_std"]]
        bands = pd.concat([bands, fast.set_axis(["value", "std"], axis=1)])
    return 1.96 * bands["std"] / bands["value"].abs()


def _scored(table: pd.DataFrame, evaluations: Sequence[Evaluation]) -> list[Finding]:
    """Return the findings of the scores, the costliest first."""
    findings = []
    means = {
        flight.name: flight.scores["measured"]["normalized_rmse"].mean() for flight in evaluations
    }
    bad = [name for name, error in means.items() if error > 1]
    if bad:
        numbers = {"flights": bad, "worse": len(bad), "tested": len(means)}
        findings.append(Finding(Code.CONSTANT_BETTER_IN_FLIGHTS, numbers=numbers))

    error = table["normalized_rmse"]
    linear = (1 + THRESHOLDS.tie) * table.get("least_squares_normalized_rmse", np.inf * error)
    worse = list(table.index[error > linear])
    if len(worse) >= len(table) / 2 or error.mean() > linear.mean():
        numbers = {"names": worse, "worse": len(worse), "coefficients": len(table)}
        findings.append(Finding(Code.LEAST_SQUARES_BETTER, numbers=numbers))

    held = table["interval_coverage"]
    narrow = held[held < THRESHOLDS.coverage]
    if len(narrow):
        numbers = {"coverages": narrow.to_dict()}
        findings.append(Finding(Code.BANDS_TOO_NARROW, numbers=numbers))
    return findings
