"""Findings of checks, reconstruction, fit and evaluation; `wording` turns them into text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any


class Severity(Enum):
    """Consequence of a finding for who uses a model."""

    NOTE = "note"  # information
    WARNING = "warning"  # something to look at
    DOUBT = "doubt"  # no use of the model is judged with "yes"


class Code(Enum):
    """Kind of a finding."""

    MESSAGE = "message"  # a text that has no code of its own

    # faults of a channel of a log
    GAP = "gap"
    MISSING = "missing"
    STUCK = "stuck"
    IMPOSSIBLE = "impossible"
    SPIKE = "spike"
    CONSTANT = "constant"
    # all faults of a log, by their treatment
    FAULTS_BRIDGED = "faults_bridged"
    FAULTS_EXCLUDED = "faults_excluded"

    # flights
    CONTRADICTION = "contradiction"
    LARGE_SURFACES = "large_surfaces"
    LONE_ROWS = "lone_rows"
    NO_ELEVATOR = "no_elevator"
    ROWS_LEFT_OUT = "rows_left_out"
    SENSOR_POSITIONS_DIFFER = "sensor_positions_differ"
    SLOW_CHANNELS = "slow_channels"

    # assumptions
    ENGINE_UNEXPLAINED = "engine_unexplained"
    FULL_THROWS = "full_throws"
    SIZES_QUESTIONED = "sizes_questioned"
    SIZES_ESTIMATED = "sizes_estimated"
    SIZES_SOURCES = "sizes_sources"
    THRUST_IN_COEFFICIENTS = "thrust_in_coefficients"

    # training and test
    ALREADY_LEARNED = "already_learned"
    HELD_OUT_FLIGHT = "held_out_flight"
    HELD_OUT_QUARTER = "held_out_quarter"
    OTHER_VERSIONS = "other_versions"
    TESTED_ON_TRAINING = "tested_on_training"

    # transformers
    AIRSPEED_CORRECTED = "airspeed_corrected"
    VIBRATION = "vibration"
    AIR_NOT_CONVERGED = "air_not_converged"
    AIR_NOT_ESTIMATED = "air_not_estimated"
    COUPLINGS_FOUND = "couplings_found"
    SENSORS_ELSEWHERE = "sensors_elsewhere"
    CONSTANT_REGRESSORS = "constant_regressors"
    GUSTS_UNKNOWN = "gusts_unknown"
    LAGS_CORRECTED = "lags_corrected"
    NO_AIRCRAFT = "no_aircraft"
    PATHS_NOT_CONVERGED = "paths_not_converged"
    PATHS_RECONSTRUCTED = "paths_reconstructed"
    PATHS_SMOOTHED = "paths_smoothed"
    SENSORS_MISSING = "sensors_missing"
    TRUTH_AS_REGRESSORS = "truth_as_regressors"

    # fit
    APPROXIMATION_POOR = "approximation_poor"
    BOUNDS_REACHED = "bounds_reached"
    CONSTANT_INPUTS = "constant_inputs"
    CONSTANT_OUTPUTS = "constant_outputs"
    FEW_ROWS = "few_rows"
    FIT_INTERRUPTED = "fit_interrupted"
    FIT_NOT_CONVERGED = "fit_not_converged"
    INDICES_DIFFER = "indices_differ"
    SAMPLES_REPEATED = "samples_repeated"
    SEARCH_STOPPED = "search_stopped"

    # scores
    BANDS_TOO_NARROW = "bands_too_narrow"
    BANDS_TOO_WIDE = "bands_too_wide"
    BY_CONSTRUCTION = "by_construction"
    CONSTANT_BETTER_IN_FLIGHTS = "constant_better_in_flights"
    DIVERGING = "diverging"
    ERRORS_SMALL = "errors_small"
    ERRORS_TOO_LARGE = "errors_too_large"
    LEAST_SQUARES_BETTER = "least_squares_better"
    MOMENTS_UNEXPLAINED = "moments_unexplained"
    NOT_VARYING = "not_varying"
    TOO_LITTLE_FLOWN = "too_little_flown"

    # flight mechanics
    CONTROLS_KNOWN = "controls_known"
    CONTROLS_MISSING = "controls_missing"
    CONTROLS_TOO_UNCERTAIN = "controls_too_uncertain"
    NO_DERIVATIVES = "no_derivatives"
    NO_TRIM = "no_trim"
    TRIM_BEYOND = "trim_beyond"
    IMPLAUSIBLE_SIZES = "implausible_sizes"
    SIGNS_UNKNOWN = "signs_unknown"
    WRONG_SIGNS = "wrong_signs"

    # simulation
    ACCELERATIONS_AS_REGRESSORS = "accelerations_as_regressors"
    FOLLOWS = "follows"
    FOLLOWS_SHORTLY = "follows_shortly"
    GUSTS_HIDE_ERRORS = "gusts_hide_errors"
    NOT_EXCITED = "not_excited"
    NOT_SIMULATED = "not_simulated"
    NO_FREQUENCY_RESPONSES = "no_frequency_responses"


DOUBTS = frozenset({Code.GUSTS_UNKNOWN, Code.PATHS_NOT_CONVERGED, Code.SIZES_QUESTIONED})
NOTES = frozenset(
    {
        Code.AIRSPEED_CORRECTED,
        Code.CONTROLS_KNOWN,
        Code.COUPLINGS_FOUND,
        Code.ERRORS_SMALL,
        Code.FOLLOWS,
        Code.LAGS_CORRECTED,
        Code.PATHS_RECONSTRUCTED,
        Code.PATHS_SMOOTHED,
        Code.SLOW_CHANNELS,
        Code.VIBRATION,
    }
)


@dataclass(frozen=True)
class Finding:
    """A finding of a check, a reconstruction, a fit or an evaluation.

    Parameters
    ----------
    code : Code
        Kind of the finding; rules decide by it.
    flight, channel : str, optional
        Flight and channel that it is about.
    numbers : mapping of str to object
        Numbers, names, and further findings that the text shows.
    """

    code: Code
    flight: Any = None
    channel: str | None = None
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def severity(self) -> Severity:
        """Consequence, which follows from the code."""
        if self.code in DOUBTS:
            return Severity.DOUBT
        return Severity.NOTE if self.code in NOTES else Severity.WARNING

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "code": self.code.value,
            "severity": self.severity.value,
            "flight": self.flight,
            "channel": self.channel,
            "numbers": {name: _plain(value) for name, value in self.numbers.items()},
        }


def _plain(value: Any) -> Any:
    """Return a number of a finding; further findings as plain values."""
    if isinstance(value, Finding):
        return value.to_dict()
    return [_plain(item) for item in value] if isinstance(value, list) else value


def with_codes(findings: Iterable[Finding], *codes: Code) -> list[Finding]:
    """Return the findings that have one of the codes."""
    return [finding for finding in findings if finding.code in codes]
