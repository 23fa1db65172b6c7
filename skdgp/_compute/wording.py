"""The text of findings, for warnings, the command line and reports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Formatter
from typing import Any, TypeAlias

from skdgp._compute.findings import Code, Finding, Severity

# A template (see `_Formatter`) over flight, channel and numbers, or a function of the finding
Text: TypeAlias = str | Callable[[Finding], str]

MOST_FAULTS = 8  # lines on faults in one warning
MOST_NAMES = 3  # names in a list that is shortened
SHORT = "short"  # format spec of such a list

FAULTS: dict[Code, str] = {
    Code.GAP: "jumps forward {times}, by {longest:.3g} s at most",
    Code.MISSING: "has no value {times}, for {longest:.2g} s at most",
    Code.STUCK: "is stuck at {value:.4g}",
    Code.IMPOSSIBLE: "has impossible values, such as {value:.4g}",
    Code.SPIKE: "leaps from its neighbours and back {times}",
    Code.CONSTANT: "never changes, while {moving} {move}",
}
REMEDIES: dict[Code, str] = {
    Code.GAP: "nothing is filtered across it",
    Code.MISSING: "leave out these rows where the gap is too long to interpolate",
    Code.STUCK: "not measured; if it was, name the column in ignore",
    Code.IMPOSSIBLE: "not measured; write missing values as empty cells",
    Code.SPIKE: "not measured",
    Code.CONSTANT: "a dead sensor, or none: drop the column unless the flight was simulated so",
}
DEGREES = 57.29578  # in a radian
# Text of a sensor that contradicts the others, unit, and number of these in the SI unit
SENSORS: dict[str, tuple[str, str, float]] = {
    "gyro": ("the attitude does not follow the gyros", "deg/s", DEGREES),
    "accelerometer": ("the velocity does not follow the accelerometers", "m/s2", 1.0),
    "airspeed": ("airspeed does not follow the motion", "m/s", 1.0),
    "alpha": ("alpha does not follow the motion", "deg", DEGREES),
    "beta": ("beta does not follow the motion", "deg", DEGREES),
}


def text_of(finding: Finding) -> str:
    """Return a finding as sentences.

    Examples
    --------
    >>> text_of(Finding(Code.LONE_ROWS, flight="a", numbers={"rows": 2}))
    "Flight 'a': 2 rows that stand alone between gaps are left out."
    """
    return _filled(TEXTS[finding.code], finding)


def reason_of(finding: Finding) -> str:
    """Return a finding as a part of a sentence, such as the reason of a judgement.

    Examples
    --------
    >>> reason_of(Finding(Code.NO_TRIM, numbers={"airspeed": 20.0}))
    'no steady flight was found at 20 m/s'
    """
    return _filled(REASONS[finding.code], finding)


def reasons_of(findings: Iterable[Finding]) -> str:
    """Return several findings as one sentence without its stop: the first warning after a note follows a "but".

    Examples
    --------
    >>> small = Finding(Code.ERRORS_SMALL, numbers={"smallest": 0.1, "largest": 0.2})
    >>> reasons = reasons_of([small, Finding(Code.GUSTS_UNKNOWN), Finding(Code.NO_BANDS)])
    >>> reasons.partition("; ")[2]
    'but gusts without vanes are not known; the model has no bands of derivatives'
    """
    text = ""
    follows_note = False
    for finding in findings:
        is_note = finding.severity is Severity.NOTE
        if text:
            text += "; but " if follows_note and not is_note else "; "
        text += reason_of(finding)
        follows_note = is_note
    return text


def texts_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the text of each finding; of several of one kind the first, and the number of the others.

    Examples
    --------
    >>> texts_of(Finding(Code.LONE_ROWS, flight=name, numbers={"rows": 2}) for name in "ab")
    ("Flight 'a': 2 rows that stand alone between gaps are left out. (1 more of this kind)",)
    """
    kinds: dict[tuple[Code, str], list[Finding]] = {}
    for finding in findings:
        kind = finding.code, finding.numbers.get("text", "")
        kinds.setdefault(kind, []).append(finding)
    return tuple(_with_count(text_of(first), len(others)) for first, *others in kinds.values())


def _with_count(text: str, n_others: int) -> str:
    return f"{text} ({n_others} more of this kind)" if n_others else text


def grouped_faults(faults: Iterable[Finding]) -> list[str]:
    """Return one line for all faults of one kind in one channel: their number and the longest."""
    groups: dict[tuple[str | None, Code], list[Finding]] = {}
    for fault in faults:
        groups.setdefault((fault.channel, fault.code), []).append(fault)
    lines = []
    for group in groups.values():
        longest = max(group, key=lambda fault: fault.numbers["samples"])
        times = f"{len(group)} times, the longest: " if len(group) > 1 else ""
        lines.append(f"flight {longest.flight}: {times}{text_of(longest)}")
    return lines


class _Formatter(Formatter):
    """Formats templates: items of a list are joined by its format spec, values of a mapping take it.

    ``SHORT`` joins the first items by a comma, and counts the others.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text."""
        if isinstance(value, Mapping):
            return ", ".join(
                f"{name} {self.format_field(item, format_spec)}" for name, item in value.items()
            )
        if isinstance(value, float):
            return format(value, format_spec).replace("%", " %")
        if not isinstance(value, list):
            return format(value, format_spec)
        return shortened(value) if format_spec == SHORT else (format_spec or ", ").join(value)


def _filled(text: Text, finding: Finding) -> str:
    if not isinstance(text, str):
        return text(finding)
    names = {"flight": finding.flight, "channel": finding.channel, **finding.numbers}
    return _Formatter().vformat(text, (), names)


def _fault(fault: Finding) -> str:
    """Return the channel, the fault, its place and its consequence; times count from ``origin``."""
    numbers = dict(fault.numbers)
    times = numbers.get("times", 1)
    moving = numbers.get("moving", ())
    numbers["times"] = "once" if times == 1 else f"{times} times"
    numbers["moving"] = " and ".join(moving)
    numbers["move"] = "moves" if len(moving) == 1 else "move"
    is_empty = fault.code is Code.MISSING and "longest" not in numbers
    description = "has no value" if is_empty else FAULTS[fault.code].format(**numbers)
    begin = numbers["start"] - numbers["origin"]
    end = numbers["end"] - numbers["origin"]
    place = f"{begin:.6g} to {end:.6g} s, {numbers['samples']} samples"
    return f"{fault.channel} {description} ({place}): {REMEDIES[fault.code]}"


def _faults(finding: Finding) -> str:
    lines = grouped_faults(finding.numbers["faults"])
    n_hidden = len(lines) - MOST_FAULTS
    shown = "; ".join(lines[:MOST_FAULTS])
    hidden = f"; and {n_hidden} more, see skdgp.preprocessing.inspect_flight"
    return f"Faults in the log: {shown}{hidden if n_hidden > 0 else ''}."


def _faults_bridged(finding: Finding) -> str:
    gap = finding.numbers["longest_bridge"]
    return f"{_faults(finding)} Faulty values are NaN, gaps up to {gap:g} s are interpolated."


def _faults_excluded(finding: Finding) -> str:
    return f"{_faults(finding)} The coefficients are not known there (NaN)."


def _contradiction(finding: Finding) -> str:
    """Return the channels that may be wrong, the slope or lag that shows it, and how sure it is."""
    template = (
        "{channels: or } is probably wrong: the slope of {y} over {x} is {slope:.3g} ± {std:.2g}, "
        "but expected {expected}"
    )
    if "lag" in finding.numbers:
        template = (
            "{channels: or } is probably wrong: {y} is {lag:.2g} ± {std:.2g} s late against {x}"
        )
    if finding.flight is not None:
        template = "flight {flight}: " + template
    template += (
        " (t = {t:.1f}, correlation {correlation:.2f}, {effective_samples:.0f} effective samples)"
    )
    return _filled(template, finding)


def _contradiction_sentence(finding: Finding) -> str:
    return f"Contradiction in the flights: {_contradiction(finding)}."


def _large_surfaces(finding: Finding) -> str:
    surfaces = ", ".join(
        f"{name} {top:.2f} rad ({DEGREES * top:.0f} deg)"
        for name, top in finding.numbers["largest"].items()
    )
    return (
        f"Got surfaces up to {surfaces}, more than most servos reach: if these are commands from -1 "
        "to 1, multiply each by its largest deflection [rad]."
    )


def _gusts_unknown(finding: Finding) -> str:
    text = f"Gusts are not known: {text_of(finding.numbers['cause'])}"
    if finding.numbers.get("angles_lack_gusts"):
        text += " alpha and beta lack them."
    if finding.numbers.get("general_bands"):
        text += " Bands of derivatives are those of small aircraft in general."
    return text


def _paths(finding: Finding) -> str:
    is_reconstructed = finding.code is Code.PATHS_RECONSTRUCTED
    kind = (
        "reconstructed from all sensors" if is_reconstructed else "not reconstructed, only smoothed"
    )
    return f"{kind}: {_paths_reason(finding)}"


def _paths_reason(finding: Finding) -> str:
    """Return why flight paths are reconstructed, or only smoothed."""
    numbers = finding.numbers
    if numbers["missing"]:
        return f"the flights lack {', '.join(numbers['missing'])}"
    if numbers["air"]:
        return f"alpha and beta by the motion that gusts cause: {numbers['air']}"
    if not numbers["contradictions"]:
        return "no sensor contradicts the others"
    parts = []
    for contradiction in numbers["contradictions"]:
        text, unit, factor = SENSORS[contradiction["sensor"]]
        residual = factor * contradiction["residual"]
        noise = factor * contradiction["noise"]
        parts.append(f"{text} (residual {residual:.2g} {unit}, noise {noise:.2g})")
    reasons = "; ".join(parts)
    return f"although {reasons}" if finding.code is Code.PATHS_RECONSTRUCTED else reasons


def _sizes_estimated(finding: Finding) -> str:
    sizes = ", ".join(
        f"{name.replace('_', ' ')} {value:.3g} {unit} ± {100 * std:.2g} %"
        for name, (value, unit, std) in finding.numbers["sizes"].items()
    )
    return f"Of the aircraft: {sizes}; their part in errors of derivatives is std_aircraft."


def _lags_corrected(finding: Finding) -> str:
    lags: Mapping[str, float] = finding.numbers["lags"]
    parts = [
        f"{name} {abs(lag):.3f} s {'late' if lag > 0 else 'early'}" for name, lag in lags.items()
    ]
    text = f"Lags against the inertial unit, corrected: {', '.join(parts)}."
    if lags.get("surfaces", 0) < 0:
        text += " Surfaces that are early are commands of slower servos."
    return text


def _approximation_poor(finding: Finding) -> str:
    numbers = finding.numbers
    exact = numbers["exact"]
    text = (
        f"{numbers['inducing']} inducing inputs leave {numbers['neglected']:.2g} of the noise "
        "variance unexplained: "
    )
    if exact is None:
        return text + (
            "predictions are less accurate than those of exact inference. Raise n_inducing."
        )
    return text + (
        f"the model is learned from {exact} of the values instead. Raise n_inducing to learn from "
        "all."
    )


def _few_rows(finding: Finding) -> str:
    numbers = finding.numbers
    worth = ""
    if numbers["lasting"] > 1:
        worth = (
            f", worth {numbers['independent']:.0f} independent ones as errors last "
            f"{numbers['lasting']:.0f} rows,"
        )
    return (
        f"Got {numbers['rows']} rows{worth} for {numbers['regressors']} regressors, "
        f"{numbers['each']:.2g} for each, but expected at least {numbers['least']} for each: with "
        "fewer, the model leans on the linear trend, and standard deviations may be too small. Give "
        "more rows or minutes of manoeuvres, or name fewer regressors."
    )


def _search_stopped(finding: Finding) -> str:
    numbers = finding.numbers
    scale = ""
    if numbers["unscaled"]:
        scale = f", or scale the regressors {numbers['unscaled']} (StandardScaler)"
    return (
        f"The fit stopped at max_iter={numbers['max_iter']} before it converged: in as many "
        f"iterations again the log likelihood is expected to rise by {numbers['remaining']:,.0f} "
        f"nats. Raise max_iter{scale}."
    )


def _errors_too_large(finding: Finding) -> str:
    """Return the coefficients that are predicted well, then those that are not, and why."""
    numbers = finding.numbers
    parts = []
    for name in numbers["poor"]:
        lacks = []
        if name in numbers["errors"]:
            lacks.append(f"error {numbers['errors'][name]:.2f} of its spread")
        if name in numbers["coverages"]:
            lacks.append(f"its 95 % band holds {100 * numbers['coverages'][name]:.0f} %")
        parts.append(f"{name}: {', '.join(lacks)}")
    only = f"only {' '.join(numbers['good'])}. " if numbers["good"] else ""
    return only + "; ".join(parts)


def _controls_too_uncertain(finding: Finding) -> str:
    widths: Mapping[str, float] = finding.numbers["widths"]
    wide = [
        f"{name} ± {100 * width:.0f} %" if width < 10 else f"{name} unknown"
        for name, width in widths.items()
    ]
    return f"not known well enough, half of the 95 % interval: {', '.join(wide)}"


def _follows_shortly(finding: Finding) -> str:
    numbers = finding.numbers
    late = [f"{name} {seconds:.2g} s" for name, seconds in numbers["late"].items()]
    text = f"it follows the test flights for {numbers['seconds']:.2g} s: {shortened(late)}"
    if len(late) < numbers["states"]:
        text += f"; the other states for all {numbers['horizon']:.2g} s"
    return text


def shortened(names: Sequence[str]) -> str:
    """Return the first names, and the number of the others."""
    text = ", ".join(names[:MOST_NAMES])
    n_hidden = len(names) - MOST_NAMES
    return f"{text} and {n_hidden} more" if n_hidden > 0 else text


TEXTS: dict[Code, Text] = {
    Code.MESSAGE: "{text}",
    **dict.fromkeys(FAULTS, _fault),
    Code.FAULTS_BRIDGED: _faults_bridged,
    Code.FAULTS_EXCLUDED: _faults_excluded,
    Code.CONTRADICTION: _contradiction_sentence,
    Code.LARGE_SURFACES: _large_surfaces,
    Code.LONE_ROWS: "Flight {flight!r}: {rows} rows that stand alone between gaps are left out.",
    Code.NO_ELEVATOR: "Got flights without an elevator: its effect goes into the coefficients of "
    "alpha and q, so Cm_q and Cm_alpha may be wrong, even in sign. Give the column elevator.",
    Code.ROWS_LEFT_OUT: "Flight {flight!r}: {left_out} of {rows} rows are left out, because "
    "regressors are missing there (by rows: {missing}). Bring slow sensors to the clock of the "
    "others if these are many.",
    Code.ENGINE_UNEXPLAINED: "Got thrust=None for flights with {names: and }: the coefficients "
    "include the thrust, and no regressor explains it. Name regressors with {names[0]!r} and "
    "'airspeed', or give the thrust.",
    Code.FULL_THROWS: "Surfaces are in parts of their full throw, as no servo file gives angles: "
    "effects are of a full throw.",
    Code.SIZES_ESTIMATED: _sizes_estimated,
    Code.SIZES_SOURCES: "Estimated by: {sources}.",
    Code.THRUST_IN_COEFFICIENTS: "Neither columns (thrust, or thrust_x, thrust_y, thrust_z) nor a "
    "propeller and its speed give the thrust, so it is part of the coefficients, with throttle and "
    "airspeed as regressors: CX is thrust less drag, which the model does not tell apart.",
    Code.ALREADY_LEARNED: "The model learned from a flight {flight!r}: if it is this one, its "
    "errors say nothing about others.",
    Code.HELD_OUT_FLIGHT: "No test flight was named: the last flight, {flight}, is held out of the "
    "fit and tested on.",
    Code.HELD_OUT_QUARTER: "No test flight was named: the last quarter of the only flight, "
    "{flight}, is held out of the fit and tested on.",
    Code.OTHER_VERSIONS: "Got {path}, written with {differences}: its predictions may differ. "
    "Compare a few, fit it again, or install those versions.",
    Code.TESTED_ON_TRAINING: "Flight {flight!r} is both learned from and tested on: its errors say "
    "nothing about other flights.",
    Code.AIR_NOT_CONVERGED: "the estimate did not converge. Give longer flights with inputs of every "
    "surface, and look at the signs and units of their sensors.",
    Code.AIR_NOT_ESTIMATED: "{error}",
    Code.CONSTANT_REGRESSORS: "In the training flights {names!r} never change, so the model cannot "
    "learn their effects. Fly manoeuvres that move them, or leave them out of the regressors.",
    Code.GUSTS_UNKNOWN: _gusts_unknown,
    Code.LAGS_CORRECTED: _lags_corrected,
    Code.NO_AIRCRAFT: "no sensor measures alpha and beta, and no aircraft is given.",
    Code.PATHS_NOT_CONVERGED: "The paths of these flights did not converge: {flights:short}. Their "
    "sensors contradict one another: look for wrong signs, units or clocks.",
    Code.PATHS_RECONSTRUCTED: _paths,
    Code.PATHS_SMOOTHED: _paths,
    Code.SENSORS_MISSING: "Got flights without {names!r}, which those of the fit had: they are "
    "smoothed channel by channel (FlightSmoother), not reconstructed. Expect larger errors than "
    "with those sensors.",
    Code.TRUTH_AS_REGRESSORS: "Regressors {names!r} are noise-free truth of a simulation, which no "
    "aircraft has: use them only to score, or to measure the effect of sensor noise.",
    Code.APPROXIMATION_POOR: _approximation_poor,
    Code.BOUNDS_REACHED: "Got hyperparameters that end at a bound of the kernel: {reached:short}. "
    "Widen the bounds, unless they are known to hold.",
    Code.CONSTANT_INPUTS: "The regressors {names!r} are constant over the samples: their effect "
    "cannot be learned, and predictions at other values are not reliable. Leave them out, or add "
    "samples in which they vary.",
    Code.CONSTANT_OUTPUTS: "The outputs {names!r} are constant over the samples: nothing can be "
    "learned about them, and their stated uncertainty is not reliable. Leave them out, or check "
    "the log.",
    Code.FEW_ROWS: _few_rows,
    Code.FIT_INTERRUPTED: "The fit was interrupted; the best hyperparameters so far are kept. Fit "
    "again to continue.",
    Code.INDICES_DIFFER: "The indices of X and y differ; rows are matched by position. If rows of "
    "one were dropped or sorted, do the same to the other (y.loc[X.index]).",
    Code.SAMPLES_REPEATED: "{repeated} of {samples} samples repeat another sample with the same "
    "regressors and targets. They count as independent, so the uncertainty is too small: drop "
    "repeated rows (was a log read twice?).",
    Code.SEARCH_STOPPED: _search_stopped,
    Code.FIT_NOT_CONVERGED: "The fit has not converged: raise max_iter.",
    Code.BANDS_TOO_NARROW: "95 % bands are too narrow: they hold {coverages:.0%} of the measured "
    "values.",
    Code.CONSTANT_BETTER_IN_FLIGHTS: "In {worse} of {tested} test flights a constant predicts better "
    "(error above 1): {flights:short}.",
    Code.LEAST_SQUARES_BETTER: "Least squares is better in {worse} of {coefficients} coefficients: "
    "{names: }.",
    Code.NO_DERIVATIVES: "No derivatives: {error}",
    Code.NO_TRIM: "No steady flight was found at {airspeed:.3g} m/s: the reference is the median "
    "state, and there are no modes.",
    Code.NOT_SIMULATED: "{error}",
    Code.WRONG_SIGNS: "Signs are not as on a conventional stable aircraft: {values:+.2g}. Look at "
    "the signs of the log's surfaces and rates, and at gusts without vanes.",
}  # fmt: skip

REASONS: dict[Code, Text] = {
    Code.MESSAGE: "{text}",
    Code.CONTRADICTION: _contradiction,
    Code.HELD_OUT_FLIGHT: "the last flight, {flight}",
    Code.HELD_OUT_QUARTER: "the last quarter of the only flight, {flight}",
    Code.GUSTS_UNKNOWN: "gusts without vanes are not known",
    Code.PATHS_NOT_CONVERGED: "a reconstruction did not converge",
    Code.PATHS_RECONSTRUCTED: _paths_reason,
    Code.PATHS_SMOOTHED: _paths_reason,
    Code.WRONG_SIGNS: "wrong sign of {names}",
    Code.CONSTANT_BETTER_IN_MOMENTS: "a constant predicts {names: } of the test flights better",
    Code.ERRORS_SMALL: "errors {smallest:.2f} to {largest:.2f} of the spread of the coefficients",
    Code.ERRORS_TOO_LARGE: _errors_too_large,
    Code.CONTROLS_KNOWN: "controls and fast modes are known to {width:.0%} or better ({widest})",
    Code.CONTROLS_MISSING: "the model has none of the controls elevator, aileron, rudder",
    Code.CONTROLS_TOO_UNCERTAIN: _controls_too_uncertain,
    Code.NO_BANDS: "the model has no bands of derivatives",
    Code.NO_DERIVATIVES: "no derivatives",
    Code.NO_TRIM: "no steady flight was found at {airspeed:.3g} m/s",
    Code.TRIM_BEYOND: "the trim is outside the flown range in {names}",
    Code.ACCELERATIONS_AS_REGRESSORS: "the regressors {names} are known only after a flight",
    Code.FOLLOWS: "it follows the test flights for the {horizon:.2g} s that were simulated",
    Code.FOLLOWS_SHORTLY: _follows_shortly,
    Code.GUSTS_HIDE_ERRORS: "not testable in this air: it follows the test flights for "
    "{seconds:.2g} s, and gusts of {gusts:.2g} m/s, which are not estimated, explain the "
    "difference for {apart:.2g} s",
    Code.NOT_SIMULATED: "{error}",
}  # fmt: skip
