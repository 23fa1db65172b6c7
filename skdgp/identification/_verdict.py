"""The verdict on a model: the uses that it is good enough for, and warnings, by numbers and findings.

`judge` calls a function for each use, `_prediction`, `_simulation` and `_control`. Each returns at the
first condition that decides, with the finding and its numbers. `_limited` then lowers the judgement
where data or estimates do not allow it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.findings import Code, Finding, Severity
from skdgp._compute.statistics import half_width
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, HAT, SPECIFIC_FORCE
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

CONTROL_DERIVATIVES = (
    "Cm_elevator",
    "Cl_aileron",
    "Cn_rudder",
)  # derivatives of each moment by its control
# Signs of derivatives of a conventional stable aircraft (docs/notation.md)
USUAL_SIGNS = {
    "CZ_alpha": -1, "CY_beta": -1, "Cm_alpha": -1, "Cn_beta": 1, "Cl_beta": -1, "Cl_p": -1,
    "Cm_q": -1, "Cn_r": -1, "Cm_elevator": -1, "Cl_aileron": 1, "Cn_rudder": -1,
}  # fmt: skip
# The rudder's side force is opposite to its yawing moment, as it acts behind the centre of gravity
OPPOSITE = ("CY_rudder", "Cn_rudder")
# Largest effects on drag by non-dimensional rates: textbooks neglect them (guess)
LARGEST_DRAG_SLOPES = {"CD_q": 5.0, "CD_p": 5.0, "CD_r": 5.0}
# Vanes without which a coefficient is predicted from angles that its own accelerometer gave
VANES_OF = {"CZ": "alpha", "CY": "beta"}
# kinds of modes that a controller of attitude works in
FAST_MODES = ("short period", "Dutch roll", "roll", "roll-spiral")
MOMENT_COEFFICIENTS = ("Cl", "Cm", "Cn")
# parts of the standard deviation of a derivative
PARTS = ("std_random", "std_method", "std_log", "std_posterior")
# Regressors that are known only after a flight
ACCELERATION_REGRESSORS = {
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
    """Return the verdict, by the thresholds of `skdgp.report.THRESHOLDS`.

    Of all ``findings`` of the identification, doubts exclude the judgement "yes", and warnings are told
    again. Doubts, wrong signs and sizes are faults, with which no controller is designed.
    """
    table = scores(evaluations)["measured"]
    unvarying = _not_varying(evaluations, table)
    varying = table.drop(index=unvarying)
    doubts = _doubts(fit, findings)
    derivatives = mechanics.derivatives
    faults = [*doubts, *_sign_findings(derivatives), *_implausible_sizes(derivatives)]
    simulation = _simulation(mechanics, fit.regressors)
    by_scores = (
        _prediction(varying, _by_construction(evaluations, fit), unvarying),
        simulation,
        _control(mechanics, table, varying, faults, simulation),
    )
    too_little = _too_little(fit)
    better, worse = _against_least_squares(varying)

    # the costliest first
    warnings = [
        *faults,
        *_warnings_of_errors(varying, evaluations, worse),
        *_warnings_of_bands(table),
    ]
    if unvarying:
        warnings.append(Finding(Code.NOT_VARYING, numbers={"names": unvarying}))
    if not fit.converged:
        warnings.append(Finding(Code.FIT_NOT_CONVERGED))
    warnings += [finding for finding in findings if finding.severity is Severity.WARNING]

    learned = list(train)
    means = varying.mean()
    return Verdict(
        regressors=fit.regressors,
        tested=Extent.of([flight.table for flight in evaluations]),
        trained=Extent.of(learned) if learned else None,
        samples=fit.training.samples if fit.training else 0,
        error=float(means["normalized_rmse"]),
        coverage=float(table["interval_coverage"].mean()),
        least_squares_error=means.get("least_squares_normalized_rmse"),
        better=better,
        worse=worse,
        unvarying=tuple(unvarying),
        uses=tuple(_limited(use, too_little, doubts) for use in by_scores),
        findings=tuple(warnings),
    )


def _prediction(table: pd.DataFrame, lacking_vane: dict[str, str], unvarying: list[str]) -> Use:
    """Return whether the model predicts coefficients; ``table`` are the scores of those that vary.

    ``lacking_vane``: coefficients that no error judges, and their vanes. Beside ``unvarying`` ones
    the judgement is "partly" at best.
    """
    purpose = "predict coefficients"
    mean_error = table["normalized_rmse"].mean()
    if mean_error > 1:
        return _use(purpose, "no", Code.DIVERGING, error=mean_error)
    vanes = {name: vane for name, vane in lacking_vane.items() if name not in unvarying}
    unjudged = []
    if vanes:
        numbers = {"names": list(vanes), "vanes": list(vanes.values())}
        unjudged.append(Finding(Code.BY_CONSTRUCTION, numbers=numbers))
    if unvarying:
        unjudged.append(Finding(Code.NOT_VARYING, numbers={"names": unvarying}))
    table = table.drop(index=list(vanes))
    if table.empty:
        return Use(purpose, "unknown", tuple(unjudged))
    use = _use_by_scores(purpose, table)
    judgement = "partly" if use.judgement == "yes" and unjudged else use.judgement
    return Use(purpose, judgement, (*use.findings, *unjudged))


def _not_varying(evaluations: Sequence[Evaluation], table: pd.DataFrame) -> list[str]:
    """Return coefficients whose spread in the test flights is below their noise, so that no error judges them.

    An error below the spread judges a coefficient all the same, and so does a band that does not hold.
    """
    measured = np.concatenate([flight.measured for flight in evaluations])
    spread = np.nanstd(measured, axis=0)
    variances = [flight.prediction_std**2 - flight.std**2 for flight in evaluations]
    noise = np.sqrt(np.maximum(np.nanmean(np.concatenate(variances), axis=0), 0.0))
    is_still = pd.Series(spread < noise, index=list(COEFFICIENTS))
    is_excused = (table["interval_coverage"] >= THRESHOLDS.held) & (table["normalized_rmse"] > 1)
    return [name for name in COEFFICIENTS if is_still[name] and is_excused[name]]


def _by_construction(evaluations: Sequence[Evaluation], fit: FitRecord) -> dict[str, str]:
    """Return coefficients that agree with their measurement by construction, and the vane that is missing."""
    by_construction = {}
    for coefficient, vane in VANES_OF.items():
        is_measured = any(vane in flight.table for flight in evaluations)
        if vane in fit.regressors and not is_measured:
            by_construction[coefficient] = vane
    return by_construction


def _use_by_scores(purpose: str, table: pd.DataFrame) -> Use:
    """Return the judgement of coefficients by their errors and bands."""
    errors = table["normalized_rmse"]
    coverages = table["interval_coverage"]
    # NaN is neither small nor wide enough
    is_large = ~(errors <= THRESHOLDS.error)
    is_narrow = ~(coverages >= THRESHOLDS.coverage)
    is_poor = is_large | is_narrow
    if not is_poor.any():
        return _use(purpose, "yes", Code.ERRORS_SMALL, smallest=errors.min(), largest=errors.max())
    return _use(
        purpose,
        "no" if is_poor.all() else "partly",
        Code.ERRORS_TOO_LARGE,
        good=list(table.index[~is_poor]),
        poor=list(table.index[is_poor]),
        errors=errors[is_large].to_dict(),
        coverages=coverages[is_narrow].to_dict(),
    )


def _simulation(mechanics: FlightMechanics, regressors: Sequence[str]) -> Use:
    """Return whether the model simulates flights: how long each state stays near the flight."""
    purpose = "simulate"
    accelerations = sorted(ACCELERATION_REGRESSORS & set(regressors))
    if accelerations:
        return _use(purpose, "no", Code.ACCELERATIONS_AS_REGRESSORS, names=accelerations)
    table = mechanics.simulation
    if table is None:
        note = mechanics.simulation_note
        return Use(purpose, "unknown", () if note is None else (note,))
    lasts = table["lasts"].sort_values()
    seconds = float(lasts.min())
    horizon = float(table["horizon"].min())
    if seconds >= horizon:
        return _use(purpose, "yes", Code.FOLLOWS, horizon=horizon)
    without_gusts = float(table["lasts_without_gusts"].min())
    if seconds < THRESHOLDS.seconds <= without_gusts:
        numbers = {"seconds": seconds, "gusts": float(table["gusts"].min()), "apart": without_gusts}
        return _use(purpose, "unknown", Code.GUSTS_HIDE_ERRORS, **numbers)
    return _use(
        purpose,
        "partly" if seconds >= THRESHOLDS.seconds else "no",
        Code.FOLLOWS_SHORTLY,
        seconds=seconds,
        horizon=horizon,
        late=lasts[lasts < horizon].to_dict(),
        states=len(table),
    )


def _control(
    mechanics: FlightMechanics,
    table: pd.DataFrame,
    varying: pd.DataFrame,
    faults: Sequence[Finding],
    simulation: Use,
) -> Use:
    """Return whether the model serves to design a controller.

    ``varying`` are the rows of the table of scores whose errors count. The use needs a trim, derivatives
    by the controls, and no fault. "yes" needs a ``simulation`` that
    is not refuted by the test flights.
    """
    purpose = "design a controller"
    if faults:
        return Use(purpose, "no", tuple(faults))
    if mechanics.trim is None or mechanics.derivatives.empty:
        return Use(purpose, "no", mechanics.notes)
    widths = _half_widths(mechanics)
    if widths is None:
        return _use(purpose, "no", Code.CONTROLS_MISSING)
    wide = widths[~(widths <= THRESHOLDS.band)]
    if len(wide):
        parts = _largest_parts(mechanics.derivatives, wide.index)
        return _use(purpose, "no", Code.CONTROLS_TOO_UNCERTAIN, widths=wide.to_dict(), parts=parts)
    coverages = table["interval_coverage"]
    narrow = coverages[~(coverages >= THRESHOLDS.held)]
    if len(narrow):
        return _use(purpose, "no", Code.BANDS_TOO_NARROW, coverages=narrow.to_dict())
    use = _control_of_known(purpose, list(mechanics.trim.beyond), widths, varying)
    if use.judgement == "yes" and simulation.judgement == "no":
        return Use(purpose, "partly", (*use.findings, *simulation.findings))
    return use


def _control_of_known(
    purpose: str, beyond: Sequence[str], widths: pd.Series, varying: pd.DataFrame
) -> Use:
    """Return the judgement where controls and fast modes are known.

    Regressors of the trim ``beyond`` what was flown, and the errors of the moments, decide.
    """
    numbers = {"width": widths.max(), "widest": widths.idxmax()}
    controls_known = Finding(Code.CONTROLS_KNOWN, numbers=numbers)
    if beyond:
        trim_beyond = Finding(Code.TRIM_BEYOND, numbers={"names": list(beyond)})
        return Use(purpose, "no", (trim_beyond, controls_known))
    errors = varying["normalized_rmse"].reindex([*MOMENT_COEFFICIENTS])
    poor = errors[errors > THRESHOLDS.error]
    if len(poor):
        unexplained = Finding(Code.MOMENTS_UNEXPLAINED, numbers={"errors": poor.to_dict()})
        return Use(purpose, "partly", (controls_known, unexplained))
    return Use(purpose, "yes", (controls_known,))


def _half_widths(mechanics: FlightMechanics) -> pd.Series | None:
    """Return half widths of 95 % bands over values, of controls and fast modes; None without controls."""
    table = mechanics.derivatives
    bands = table.loc[table.index.isin(CONTROL_DERIVATIVES), ["value", "std"]]
    if bands.empty:
        return None
    if mechanics.modes is not None:
        is_fast = mechanics.mode_kinds.isin(FAST_MODES)
        fast = mechanics.modes.loc[is_fast, ["frequency", "frequency_std"]]
        bands = pd.concat([bands, fast.set_axis(["value", "std"], axis=1)])
    return half_width(0.95) * bands["std"] / bands["value"].abs()


def _largest_parts(derivatives: pd.DataFrame, names: Iterable[str]) -> dict[str, str]:
    """Return by derivative the part of its standard deviation that makes up more than half of the variance."""
    parts = {}
    columns = [name for name in PARTS if name in derivatives]
    for name in names:
        if name in derivatives.index and columns:
            squares = derivatives.loc[name, columns].astype(float) ** 2
            if squares.max() > 0.5 * squares.sum():
                parts[name] = str(squares.idxmax())
    return parts


def _use(purpose: str, judgement: str, code: Code, **numbers: Any) -> Use:
    """Return a judgement by one finding."""
    return Use(purpose, judgement, (Finding(code, numbers=numbers),))


def _limited(use: Use, too_little: Finding | None, doubts: Sequence[Finding]) -> Use:
    """Return a judgement by the scores, no better than the data and the estimates behind them allow.

    Of a model from too little data nothing is known, but what its regressors exclude. Otherwise "no"
    and "unknown" remain, and doubts turn "yes" into "partly", the doubt of a failed estimate both
    into "no". A controller has "no" by its doubts already, which are among its faults.
    """
    is_excluded = any(finding.code is Code.ACCELERATIONS_AS_REGRESSORS for finding in use.findings)
    if too_little is not None and not is_excluded:
        return Use(use.purpose, "unknown", (too_little,))
    if use.judgement not in ("yes", "partly"):
        return use
    if any(map(_is_failure, doubts)):
        return Use(use.purpose, "no", (*use.findings, *doubts))
    if doubts and use.judgement == "yes":
        return Use(use.purpose, "partly", (*use.findings, *doubts))
    return use


def _too_little(fit: FitRecord) -> Finding | None:
    """Return the finding of a model that learned from too few seconds or rows to be judged, if it did."""
    training = fit.training
    if training is None:
        return None
    seconds = np.inf if training.flown is None else training.flown
    rows_by_regressor = training.samples / len(fit.regressors)
    if seconds >= THRESHOLDS.flown and rows_by_regressor >= THRESHOLDS.rows:
        return None
    numbers = {
        "seconds": seconds,
        "each": rows_by_regressor,
        "least_seconds": THRESHOLDS.flown,
        "least_rows": THRESHOLDS.rows,
    }
    return Finding(Code.TOO_LITTLE_FLOWN, numbers=numbers)


def _doubts(fit: FitRecord, findings: Sequence[Finding]) -> list[Finding]:
    """Return the doubts of the fit, and further ones of the test flights, one of each code."""
    doubts: dict[Code, Finding] = {}
    for finding in [*fit.doubts, *findings]:
        if finding.severity is Severity.DOUBT:
            doubts.setdefault(finding.code, finding)
    return list(doubts.values())


def _is_failure(doubt: Finding) -> bool:
    """Return whether sizes are of another aircraft, or the estimate of the air did not converge."""
    if doubt.code is Code.SIZES_QUESTIONED:
        return True
    cause = doubt.numbers.get("cause")
    return cause is not None and cause.code is Code.AIR_NOT_CONVERGED


def _sign_findings(derivatives: pd.DataFrame) -> list[Finding]:
    """Return the findings of derivatives whose sign is, or may be, other than on a conventional stable aircraft.

    Wrong is a sign that the 95 % band excludes; the others are not known. The side force of the
    rudder is small on some aircraft, so that its unknown sign is no fault.
    """
    if derivatives.empty:
        return []
    signed = derivatives["value"].reindex([*USUAL_SIGNS]) * pd.Series(USUAL_SIGNS)
    wrong = derivatives["value"].reindex(signed.index[signed < 0])
    is_known = wrong.abs() > half_width(0.95) * derivatives["std"].reindex(wrong.index)
    if _is_rudder_ahead(derivatives):
        side_force = OPPOSITE[0]
        wrong[side_force] = derivatives.at[side_force, "value"]
        is_known[side_force] = True
    findings = []
    if is_known.any():
        findings.append(_of_derivatives(Code.WRONG_SIGNS, wrong[is_known]))
    unknown = wrong[~is_known]
    if len(unknown):
        parts = _largest_parts(derivatives, unknown.index)
        findings.append(_of_derivatives(Code.SIGNS_UNKNOWN, unknown, parts=parts))
    return findings


def _is_rudder_ahead(derivatives: pd.DataFrame) -> bool:
    """Return whether side force and yawing moment of the rudder surely have the same sign."""
    of_rudder = derivatives.reindex([*OPPOSITE])
    ratio = of_rudder["value"] / (half_width(0.95) * of_rudder["std"])
    return bool((ratio > 1).all() or (ratio < -1).all())


def _implausible_sizes(derivatives: pd.DataFrame) -> list[Finding]:
    """Return the finding of derivatives that are surely larger than on any aircraft, if any."""
    if derivatives.empty:
        return []
    values = derivatives.loc[derivatives.index.isin(LARGEST_DRAG_SLOPES), ["value", "std"]]
    least = values["value"].abs() - half_width(0.95) * values["std"]
    large = values.loc[least > pd.Series(LARGEST_DRAG_SLOPES).reindex(values.index), "value"]
    return [] if large.empty else [_of_derivatives(Code.IMPLAUSIBLE_SIZES, large)]


def _of_derivatives(code: Code, values: pd.Series, **numbers: Any) -> Finding:
    """Return a finding of derivatives with their values, and further numbers."""
    names = list(values.index)
    return Finding(code, numbers={"values": values.to_dict(), "names": names, **numbers})


def _against_least_squares(table: pd.DataFrame) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the coefficients whose error is smaller, and larger, than by least squares on the same rows."""
    if "least_squares_normalized_rmse" not in table:
        return (), ()
    ratio = table["normalized_rmse"] / table["least_squares_normalized_rmse"]
    better = ratio.index[ratio < 1 - THRESHOLDS.tie]
    worse = ratio.index[ratio > 1 + THRESHOLDS.tie]
    return tuple(better), tuple(worse)


def _warnings_of_errors(
    table: pd.DataFrame, evaluations: Sequence[Evaluation], worse: Sequence[str]
) -> list[Finding]:
    """Return the warnings of the errors of coefficients that vary, the costliest first."""
    findings = []
    diverging = []
    for flight in evaluations:
        if flight.scores["measured"].loc[table.index, "normalized_rmse"].mean() > 1:
            diverging.append(flight.name)
    if diverging:
        numbers = {"flights": diverging, "worse": len(diverging), "tested": len(evaluations)}
        findings.append(Finding(Code.CONSTANT_BETTER_IN_FLIGHTS, numbers=numbers))
    means = table.mean()
    limit = (1 + THRESHOLDS.tie) * means.get("least_squares_normalized_rmse", np.inf)
    is_mostly_worse = bool(worse) and len(worse) >= len(table) / 2
    if is_mostly_worse or means["normalized_rmse"] > limit:
        numbers = {"names": list(worse), "worse": len(worse), "coefficients": len(table)}
        findings.append(Finding(Code.LEAST_SQUARES_BETTER, numbers=numbers))
    return findings


def _warnings_of_bands(table: pd.DataFrame) -> list[Finding]:
    """Return the warnings of bands that are too narrow or too wide, of all coefficients."""
    findings = []
    coverages = table["interval_coverage"]
    narrow = coverages[coverages < THRESHOLDS.coverage]
    if len(narrow):
        numbers = {"coverages": narrow.to_dict()}
        findings.append(Finding(Code.BANDS_TOO_NARROW, numbers=numbers))
    wide = coverages[coverages > THRESHOLDS.widest]
    if len(wide):
        findings.append(Finding(Code.BANDS_TOO_WIDE, numbers={"coverages": wide.to_dict()}))
    return findings
