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
MOST_CHANNELS = 8  # channels with gaps
SHORT = "short"  # format spec of such a list

FAULTS = {
    "gap": "jumps forward {times}, by {longest:.3g} s at most",
    "missing": "has no value {times}, for {longest:.2g} s at most",
    "stuck": "is stuck at {value:.4g}",
    "impossible": "has impossible values, such as {value:.4g}",
    "spike": "leaps from its neighbours and back {times}",
    "constant": "never changes, while {moving} {move}",
}
REMEDIES = {
    "gap": "nothing is filtered across it",
    "missing": "leave out these rows where the gap is too long to interpolate",
    "stuck": "not measured; if it was, name the column in ignore",
    "impossible": "not measured; write missing values as empty cells",
    "spike": "not measured",
    "constant": "a dead sensor, or none: drop the column unless the flight was simulated so",
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
    >>> reasons = reasons_of([small, Finding(Code.GUSTS_UNKNOWN), Finding(Code.NO_DERIVATIVES)])
    >>> reasons.partition("; ")[2]
    'but gusts without vanes are not known; no derivatives'
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
    """Return one line for all faults of one kind in one channel: their number and the longest.

    Gaps of several channels are one line, as these are often the same.
    """
    groups: dict[tuple[str | None, Code], list[Finding]] = {}
    for fault in faults:
        channel = None if _is_gap(fault) else fault.channel
        groups.setdefault((channel, fault.code), []).append(fault)
    lines = []
    for group in groups.values():
        longest = max(group, key=lambda fault: fault.numbers["samples"])
        channels = list(dict.fromkeys(str(fault.channel) for fault in group))
        n_faults = sum(fault.channel == longest.channel for fault in group)
        times = f"{n_faults} times, the longest: " if n_faults > 1 else ""
        text = text_of(longest)
        if len(channels) > 1:
            text += f"; gaps in {len(channels)} channels: {shortened(channels, MOST_CHANNELS)}"
        lines.append(f"flight {longest.flight}: {times}{text}")
    return lines


def _is_gap(fault: Finding) -> bool:
    """Return whether a channel lacks some of its values, not all."""
    return fault.code is Code.MISSING and "longest" in fault.numbers


class _Formatter(Formatter):
    """Formats templates: items of a list are joined by its format spec, values of a mapping take it.

    ``SHORT`` joins the first items by a comma, and counts the others. A finding is its text.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as text."""
        if isinstance(value, Finding):
            return text_of(value)
        if isinstance(value, Mapping):
            parts = [f"{name} {self.format_field(value[name], format_spec)}" for name in value]
            return ", ".join(parts)
        if isinstance(value, float):
            return format(value, format_spec).replace("%", " %")
        if not isinstance(value, list):
            return format(value, format_spec)
        if format_spec == SHORT:
            return shortened(value)
        return (format_spec or ", ").join(value)


def _filled(text: Text, finding: Finding, **values: Any) -> str:
    """Return a template with flight, channel and numbers of a finding, and further values."""
    if not isinstance(text, str):
        return text(finding)
    names = {"flight": finding.flight, "channel": finding.channel, **finding.numbers, **values}
    return _Formatter().vformat(text, (), names)


def _fault(fault: Finding) -> str:
    """Return the channel, the fault, its place and its consequence; times count from ``origin``."""
    numbers = fault.numbers
    kind = fault.code.value
    times = numbers.get("times", 1)
    moving = numbers.get("moving", ())
    description = FAULTS[kind]
    if fault.code is Code.MISSING and "longest" not in numbers:
        description = "has no value"
    place = "({begin:.6g} to {last:.6g} s, {samples} samples)"
    return _filled(
        f"{{channel}} {description} {place}: {REMEDIES[kind]}",
        fault,
        times="once" if times == 1 else f"{times} times",
        moving=" and ".join(moving) if len(moving) < MOST_NAMES else shortened(moving),
        move="moves" if len(moving) == 1 else "move",
        begin=numbers["start"] - numbers["origin"],
        last=numbers["end"] - numbers["origin"],
    )


def _faults(finding: Finding) -> str:
    """Return the first faults, and what was done about them."""
    lines = grouped_faults(finding.numbers["faults"])
    n_hidden = len(lines) - MOST_FAULTS
    shown = "; ".join(lines[:MOST_FAULTS])
    if n_hidden > 0:
        shown += f"; and {n_hidden} more, see skdgp.preprocessing.inspect_flight"
    treatment = "The coefficients are not known there (NaN)."
    if finding.code is Code.FAULTS_BRIDGED:
        treatment = "Faulty values are NaN, gaps up to {longest_bridge:g} s are interpolated."
    return _filled("Faults in the log: {shown}. " + treatment, finding, shown=shown)


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
    if finding.numbers.get("causes"):
        template += ": {causes: or }?"
    if finding.flight is not None:
        template = "flight {flight}: " + template
    template += (
        " (t = {t:.1f}, correlation {correlation:.2f}, {effective_samples:.0f} effective samples)"
    )
    return _filled(template, finding)


def _contradiction_sentence(finding: Finding) -> str:
    return f"Contradiction in the flights: {_contradiction(finding)}."


def _large_surfaces(finding: Finding) -> str:
    surfaces = []
    for name, top in finding.numbers["largest"].items():
        surfaces.append(f"{name} {top:.2f} rad ({DEGREES * top:.0f} deg)")
    text = (
        "Got surfaces up to {surfaces}, more than most servos reach: if these are commands from -1 "
        "to 1, multiply each by its largest deflection [rad]."
    )
    return _filled(text, finding, surfaces=surfaces)


def _gusts_unknown(finding: Finding) -> str:
    text = "Gusts are not known: {cause}"
    if finding.numbers.get("angles_lack_gusts"):
        text += " alpha and beta lack them."
    if finding.numbers.get("general_bands"):
        text += " Bands of derivatives are those of small aircraft in general."
    return _filled(text, finding)


def _couplings(finding: Finding) -> str:
    couplings = []
    for name, (value, std) in finding.numbers["couplings"].items():
        couplings.append(f"{name} {value:.2g} ± {std:.1g}")
    text = "Terms beyond the usual ones are significant in the motion of the air: {couplings}."
    return _filled(text, finding, couplings=couplings)


def _paths(finding: Finding) -> str:
    kind = "not reconstructed, only smoothed"
    if finding.code is Code.PATHS_RECONSTRUCTED:
        kind = "reconstructed from all sensors"
    return f"{kind}: {_paths_reason(finding)}"


def _paths_reason(finding: Finding) -> str:
    """Return why flight paths are reconstructed, or only smoothed."""
    if finding.numbers["missing"]:
        return _filled("the flights lack {missing}", finding)
    if finding.numbers["air"]:
        return _filled("alpha and beta by the motion that gusts cause: {air}", finding)
    parts = []
    for contradiction in finding.numbers["contradictions"]:
        text, unit, factor = SENSORS[contradiction["sensor"]]
        residual = factor * contradiction["residual"]
        noise = factor * contradiction["noise"]
        if contradiction["is_smoothed"]:
            text = f"{contradiction['sensor']} is smoothed, so its noise is not known"
        parts.append(f"{text} (residual {residual:.2g} {unit}, noise {noise:.2g})")
    if not parts:
        return "no sensor contradicts the others"
    although = "although " if finding.code is Code.PATHS_RECONSTRUCTED else ""
    return although + "; ".join(parts)


# Sizes of an aircraft, and the airspeed of its flights, that a question is about, with their units
ASKED = {
    "mass": ("the mass", "kg"),
    "span": ("the span", "m"),
    "chord": ("the chord", "m"),
    "wing_area": ("the wing area", "m^2"),
    "airspeed": ("the median airspeed", "m/s"),
}


def _sizes_questioned(finding: Finding) -> str:
    laws = []
    for name, (value, least, most) in finding.numbers["laws"].items():
        laws.append(f"{name} is {value:.3g}, but of aeroplanes {least:g} to {most:g}")
    return f"{'; '.join(laws)}. {_question(finding)}"


def _question(finding: Finding) -> str:
    """Return the question for sizes in another unit, or for all of them as they are."""
    asked = []
    for name, value, given, unit in finding.numbers["asked"]:
        what, si_unit = ASKED[name]
        origin = f" ({given:.4g} {unit})" if unit else ""
        asked.append(f"{what} {value:.4g} {si_unit}{origin}")
    joint = " or " if finding.numbers["asked"][0][3] else " and "
    verb = "Is" if joint == " or " or len(asked) == 1 else "Are"
    return f"{verb} {joint.join(asked)}?"


def _sizes_estimated(finding: Finding) -> str:
    sizes = []
    for name, (value, unit, std) in finding.numbers["sizes"].items():
        sizes.append(f"{name.replace('_', ' ')} {value:.3g} {unit} ± {100 * std:.2g} %")
    text = "Of the aircraft: {sizes}; their part in errors of derivatives is std_aircraft."
    return _filled(text, finding, sizes=sizes)


def _lags_corrected(finding: Finding) -> str:
    lags: Mapping[str, float] = finding.numbers["lags"]
    parts = []
    for name, lag in lags.items():
        parts.append(f"{name} {abs(lag):.3f} s {'late' if lag > 0 else 'early'}")
    text = "Lags against the inertial unit, corrected: {lags}."
    if lags.get("surfaces", 0) < 0 or "servos" in lags:
        text += " The logged surfaces are commands of slower servos."
    return _filled(text, finding, lags=parts)


def _approximation_poor(finding: Finding) -> str:
    text = "{inducing} inducing inputs leave {neglected:.2g} of the noise variance unexplained: "
    if finding.numbers["exact"] is None:
        text += "predictions are less accurate than those of exact inference. Raise n_inducing."
    else:
        text += (
            "the model is learned from {exact} of the values instead. Raise n_inducing to learn "
            "from all."
        )
    return _filled(text, finding)


def _few_rows(finding: Finding) -> str:
    text = "Got {rows} rows"
    if finding.numbers["lasting"] > 1:
        text += ", worth {independent:.0f} independent ones as errors last {lasting:.0f} rows,"
    text += (
        " for {regressors} regressors, {each:.2g} for each, but expected at least {least} for each: "
        "with fewer, the model leans on the linear trend, and standard deviations may be too small. "
        "Give more rows or minutes of manoeuvres, or name fewer regressors."
    )
    return _filled(text, finding)


def _search_stopped(finding: Finding) -> str:
    text = (
        "The fit stopped at max_iter={max_iter} before it converged: in as many iterations again the "
        "log likelihood is expected to rise by {remaining:,.0f} nats. Raise max_iter"
    )
    if finding.numbers["unscaled"]:
        text += ", or scale the regressors {unscaled!r} (StandardScaler)"
    return _filled(text + ".", finding)


def _errors_small(finding: Finding) -> str:
    """Return the range of the errors, one number where they are shown alike."""
    smallest, largest = (f"{finding.numbers[name]:.2f}" for name in ("smallest", "largest"))
    if smallest == largest:
        return f"error {largest} of the spread"
    return f"errors {smallest} to {largest} of the spread of the coefficients"


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


# causes of the parts of the standard deviation of a derivative
CAUSES = {
    "std_random": "errors that last",
    "std_method": "gusts, or noise of the regressors",
    "std_log": "times of channels, position of sensors, airspeed",
    "std_posterior": "few or small inputs",
}


def _cause(name: str, finding: Finding) -> str:
    """Return in brackets what makes the band of a derivative wide; empty if it is no part alone."""
    part = finding.numbers["parts"].get(name)
    return "" if part is None else f" ({CAUSES[part]})"


def _signs_unknown(finding: Finding) -> str:
    derivatives = []
    for name, value in finding.numbers["values"].items():
        derivatives.append(f"{name} {value:+.2g}{_cause(name, finding)}")
    return (
        "The signs of these derivatives are not known, as their 95 % bands hold zero: "
        f"{', '.join(derivatives)}. Fly larger inputs of every surface."
    )


def _controls_too_uncertain(finding: Finding) -> str:
    widths: Mapping[str, float] = finding.numbers["widths"]
    wide = []
    for name, width in widths.items():
        text = f"{name} ± {100 * width:.0f} %" if width < 10 else f"{name} unknown"
        wide.append(text + _cause(name, finding))
    return f"not known well enough, half of the 95 % interval: {', '.join(wide)}"


def _follows_shortly(finding: Finding) -> str:
    numbers = finding.numbers
    late = [f"{name} {seconds:.2g} s" for name, seconds in numbers["late"].items()]
    text = f"it follows the test flights for {numbers['seconds']:.2g} s: {shortened(late)}"
    if len(late) < numbers["states"]:
        text += f"; the other states for all {numbers['horizon']:.2g} s"
    return text


def shortened(names: Sequence[str], most: int = MOST_NAMES) -> str:
    """Return the first names, and the number of the others."""
    text = ", ".join(names[:most])
    n_hidden = len(names) - most
    return f"{text} and {n_hidden} more" if n_hidden > 0 else text


def _by_code(**texts: Text) -> dict[Code, Text]:
    """Return texts by the codes of these names."""
    return {Code(name): text for name, text in texts.items()}


TEXTS = _by_code(
    message="{text}",
    **dict.fromkeys(FAULTS, _fault),
    faults_bridged=_faults,
    faults_excluded=_faults,
    contradiction=_contradiction_sentence,
    large_surfaces=_large_surfaces,
    lone_rows="Flight {flight!r}: {rows} rows that stand alone between gaps are left out.",
    no_elevator="Got flights without an elevator: its effect goes into the coefficients of "
    "alpha and q, so Cm_q and Cm_alpha may be wrong, even in sign. Give the column elevator.",
    couplings_found=_couplings,
    slow_channels="Channels with slower clocks than the log [Hz]: {rates:.3g}. A repeated sample "
    "counts once, and controls are splines between samples.",
    rows_left_out="Flight {flight!r}: {left_out} of {rows} rows are left out, because "
    "regressors are missing there (by rows: {missing}). Bring slow sensors to the clock of the "
    "others if these are many.",
    sensor_positions_differ="Flight {flight!r} states inertial sensors {distance:.2g} m from where the "
    "aircraft of the model has them (the centre of gravity, if it states no position): the "
    "flight's position counts. Correct the wrong one, or learn the model again.",
    engine_unexplained="Got thrust=None for flights with {names: and }: the coefficients "
    "include the thrust, and no regressor explains it. Name regressors with {names[0]!r} and "
    "'airspeed', or give the thrust.",
    full_throws="Surfaces are in parts of their full throw, as no servo file gives angles: "
    "effects are of a full throw.",
    sizes_questioned=_sizes_questioned,
    sizes_estimated=_sizes_estimated,
    sizes_sources="Estimated by: {sources}.",
    thrust_in_coefficients="Neither columns (thrust, or thrust_x, thrust_y, thrust_z) nor a "
    "propeller and its speed give the thrust, so it is part of the coefficients: CX is thrust less "
    "drag, which the model does not tell apart. Throttle and airspeed are regressors if held-out "
    "parts show them.",
    already_learned="The model learned from a flight {flight!r}: if it is this one, its "
    "errors say nothing about others.",
    held_out_flight="No test flight was named: the last flight, {flight}, is held out of the "
    "fit and tested on.",
    held_out_quarter="No test flight was named: the last quarter of {flight}, which has most of "
    "the rows, is held out of the fit and tested on.",
    other_versions="Got {path}, written with {differences}: its predictions may differ. "
    "Compare a few, fit it again, or install those versions.",
    tested_on_training="Flight {flight!r} is both learned from and tested on: its errors say "
    "nothing about other flights.",
    air_not_converged="the estimate did not converge. Give longer flights with inputs of every "
    "surface, and look at the signs and units of their sensors.",
    air_not_estimated="{error}",
    constant_regressors="In the training flights {names!r} never change, so the model cannot "
    "learn their effects. Fly manoeuvres that move them, or leave them out of the regressors.",
    gusts_unknown=_gusts_unknown,
    lags_corrected=_lags_corrected,
    no_aircraft="no sensor measures alpha and beta, and no aircraft is given.",
    paths_not_converged="The paths of these flights did not converge: {flights:short}. Wrong "
    "signs, units or clocks of their sensors may be the cause.",
    paths_reconstructed=_paths,
    paths_smoothed=_paths,
    airspeed_corrected="The airspeed has an error of {percent:+.2g} ± {std_percent:.2g} %, by the velocity over "
    "the ground in a steady wind, and is corrected: calibrate the pitot tube, or check the density.",
    vibration="The specific forces vibrate beyond {band:.2g} Hz, where the aircraft does not move: "
    "coefficients and regressors were filtered to that frequency, and errors of test flights are within it.",
    sensors_elsewhere="By the motion of the flights the inertial sensors are {distance:.2g} m from the "
    "position that was given, or from the centre of gravity if none was given. Bands are wider by it: "
    "measure the position.",
    sensors_missing="Got flights without {names!r}, which those of the fit had: they are "
    "smoothed channel by channel (FlightSmoother), not reconstructed. Expect larger errors than "
    "with those sensors.",
    truth_as_regressors="Regressors {names!r} are noise-free truth of a simulation, which no "
    "aircraft has: use them only to score, or to measure the effect of sensor noise.",
    approximation_poor=_approximation_poor,
    bounds_reached="Got hyperparameters that end at a bound of the kernel: {reached:short}. "
    "Widen the bounds, unless they are known to hold.",
    constant_inputs="The regressors {names!r} are constant over the samples: their effect "
    "cannot be learned, and predictions at other values are not reliable. Leave them out, or add "
    "samples in which they vary.",
    constant_outputs="The outputs {names!r} are constant over the samples: nothing can be "
    "learned about them, and their stated uncertainty is not reliable. Leave them out, or check "
    "the log.",
    few_rows=_few_rows,
    fit_interrupted="The fit was interrupted; the best hyperparameters so far are kept. Fit "
    "again to continue.",
    indices_differ="The indices of X and y differ; rows are matched by position. If rows of "
    "one were dropped or sorted, do the same to the other (y.loc[X.index]).",
    samples_repeated="{repeated} of {samples} samples repeat another sample with the same "
    "regressors and targets. They count as independent, so the uncertainty is too small: drop "
    "repeated rows (was a log read twice?).",
    search_stopped=_search_stopped,
    fit_not_converged="The fit has not converged: raise max_iter.",
    bands_too_narrow="95 % bands are too narrow: they hold {coverages:.0%} of the measured "
    "values.",
    bands_too_wide="95 % bands are too wide: they hold {coverages:.1%} of the measured values.",
    constant_better_in_flights="In {worse} of {tested} test flights a constant predicts better "
    "(error above 1): {flights:short}.",
    least_squares_better="Least squares is better in {worse} of {coefficients} coefficients: "
    "{names: }.",
    not_varying="In the test flights {names: } vary by less than their noise, so their errors over "
    "the spread tell nothing: test on a flight with inputs of every surface.",
    no_derivatives="No derivatives: {error}",
    no_trim="No steady flight was found at {airspeed:.3g} m/s: the reference is the median "
    "state, and there are no modes.",
    not_excited="No response of a rate to a surface is shown: at hardly a frequency does it stand out "
    "of the noise of the test flights.",
    not_simulated="{error}",
    no_frequency_responses="No frequency responses are shown: {error}",
    implausible_sizes="No aircraft has such effects: {values:+.2g}. Look at the place and the signs "
    "of the accelerometers, and at gusts without vanes.",
    signs_unknown=_signs_unknown,
    wrong_signs="Signs are not as on a conventional stable aircraft: {values:+.2g}. Look at "
    "the signs of the log's surfaces and rates, at the place and the signs of the accelerometers, "
    "and at gusts without vanes.",
)  # fmt: skip

REASONS = _by_code(
    message="{text}",
    contradiction=_contradiction,
    held_out_flight="the last flight, {flight}",
    held_out_quarter="the last quarter of {flight}, which has most of the rows",
    gusts_unknown="gusts without vanes are not known",
    sizes_questioned="no aeroplane has these sizes",
    paths_not_converged="a reconstruction did not converge",
    paths_reconstructed=_paths_reason,
    paths_smoothed=_paths_reason,
    bands_too_wide="95 % bands are too wide",
    by_construction="{names: and } cannot be judged without {vanes: and }: the angles follow from "
    "the same accelerometers",
    diverging="the error is {error:.3g} of the spread, so a constant predicts better",
    implausible_sizes="implausible {names}",
    not_varying="{names: } vary by less than their noise in the test flights",
    signs_unknown="unknown sign of {names}",
    too_little_flown="learned from {seconds:.3g} s and {each:.2g} rows for each regressor: a "
    "judgement needs {least_seconds:g} s and {least_rows:g} rows",
    wrong_signs="wrong sign of {names}",
    bands_too_narrow="the bands do not hold on the test flights: {coverages:.0%} of the "
    "measured values",
    moments_unexplained="errors over the spread of the test flights are {errors:.2f}: what else "
    "turned the aircraft, such as gusts, may bias derivatives",
    errors_small=_errors_small,
    errors_too_large=_errors_too_large,
    controls_known="controls and fast modes are known to {width:.0%} or better ({widest})",
    controls_missing="the model has none of the controls elevator, aileron, rudder",
    controls_too_uncertain=_controls_too_uncertain,
    no_derivatives="no derivatives",
    no_trim="no steady flight was found at {airspeed:.3g} m/s",
    trim_beyond="the trim is outside the flown range in {names}",
    accelerations_as_regressors="the regressors {names} are known only after a flight",
    follows="it follows the test flights for the {horizon:.2g} s that were simulated",
    follows_shortly=_follows_shortly,
    gusts_hide_errors="not testable in this air: it follows the test flights for "
    "{seconds:.2g} s, and gusts of {gusts:.2g} m/s, which are not estimated, explain the "
    "difference for {apart:.2g} s",
    not_simulated="{error}",
)  # fmt: skip
