"""The content of a report: plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.findings import Finding
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._compute.wording import reasons_of, text_of, texts_of
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Trim
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.plotting import EffectsDisplay, FrequencyDisplay, TimeHistoryDisplay


class Thresholds(NamedTuple):
    """What counts as good enough (docs/judging.md, with the sources)."""

    # Largest error over the spread of the coefficients: Theil's coefficient is then 0.27, and 0.25
    # to 0.3 count as good agreement (Jategaonkar 2006, chapter 11).
    error: float = 0.5
    coverage: float = 0.90  # smallest share of measured values in a 95 % band (guess)
    # Smallest share of measured values in a 95 % band of each coefficient for a controller: bands of
    # derivatives are of the same model (guess)
    held: float = 0.80
    widest: float = 0.99  # larger share, which marks bands as too wide (guess)
    # Largest half-width of a 95 % band over its value: a gain margin of 6 dB (MIL-F-9490D) bears
    # half the gain.
    band: float = 0.5
    seconds: float = 1.0  # shortest simulation that is of use [s] (guess)
    # Least seconds and rows for each regressor to learn from: below, the uses are unknown (guesses)
    flown: float = 30.0
    rows: float = 10.0
    tie: float = 0.02  # errors that differ by less than this share are equal (guess)


THRESHOLDS = Thresholds()


class Extent(NamedTuple):
    """Number and duration of flights."""

    flights: int
    seconds: float

    @classmethod
    def of(cls, tables: Sequence[pd.DataFrame]) -> Extent:
        """Return the extent of flight tables."""
        return cls(len(tables), sum(float(np.ptp(table["time"])) for table in tables))

    def __str__(self) -> str:
        time = f"{self.seconds / 60:.1f} minutes" if self.seconds >= 60 else f"{self.seconds:.3g} s"
        return f"{time} of {self.flights} flight{'' if self.flights == 1 else 's'}"


@dataclass(frozen=True)
class Use:
    """A use of a model: ``judgement`` is "yes", "partly", "no" or "unknown", by its ``findings``."""

    purpose: str
    judgement: str
    findings: tuple[Finding, ...]

    @property
    def reason(self) -> str:
        """The findings as a sentence without its stop."""
        return reasons_of(self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "purpose": self.purpose,
            "judgement": self.judgement,
            "reason": self.reason,
            "codes": [finding.code.value for finding in self.findings],
        }


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Training, tests, and the uses that the model is good enough for.

    Parameters
    ----------
    regressors : sequence of str
        Regressors of the model.
    error, coverage : float
        NRMSE and coverage of the 95 % band, means of the coefficients, of all test flights
        together. The error is of those that vary by more than their noise, NaN where none does.
    uses : tuple of Use
        Judgements by `THRESHOLDS`.
    findings : tuple of Finding
        Warnings; the one that costs most comes first.
    tested : Extent
        Test flights.
    trained : Extent, optional
        Training flights; None of a model that existed before.
    samples : int
        Rows learned from.
    least_squares_error : float, optional
        Error of a linear model fitted to the same rows.
    better, worse : tuples of str
        Coefficients whose error is smaller, or larger, than by least squares.
    unvarying : tuple of str
        Coefficients that vary by less than their noise, so that no error judges them.
    """

    regressors: Sequence[str]
    error: float
    coverage: float
    uses: tuple[Use, ...]
    findings: tuple[Finding, ...]
    tested: Extent
    trained: Extent | None = None
    samples: int = 0
    least_squares_error: float | None = None
    better: tuple[str, ...] = ()
    worse: tuple[str, ...] = ()
    unvarying: tuple[str, ...] = ()

    @property
    def learned(self) -> str:
        """A sentence on the model, its training and its test."""
        source = "flights that are not part of this report"
        if self.trained is not None:
            source = f"{self.trained}, {self.samples:,} samples"
        return (
            f"The six coefficients {' '.join(COEFFICIENTS)} as functions of "
            f"{', '.join(self.regressors)}, learned from {source}; tested on {self.tested}."
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings as sentences."""
        return texts_of(self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "learned": self.learned,
            "error": self.error,
            "coverage": self.coverage,
            "uses": [use.to_dict() for use in self.uses],
            "warnings": self.warnings,
            "least_squares_error": self.least_squares_error,
            "better": self.better,
            "worse": self.worse,
            "thresholds": THRESHOLDS._asdict(),
        }

    def compared(self) -> str:
        """Return a sentence on least squares, empty where it is not known."""
        if self.least_squares_error is None or not np.isfinite(self.error):
            return ""
        others = {*self.better, *self.worse, *self.unvarying}
        equal = [name for name in COEFFICIENTS if name not in others]
        kinds = {"better": self.better, "equal": equal, "worse": self.worse}
        parts = [f"{kind} in {' '.join(names)}" for kind, names in kinds.items() if names]
        errors = f"an error of {self.least_squares_error:.3f}, the model {self.error:.3f}"
        return f"Least squares on the same rows has {errors}: the model is {', '.join(parts)}."


# Facts of a trim and columns of derivatives in metrics.json
TRIM = ("airspeed", "altitude", "density", "climb", "alpha", "beta", "phi", "theta", "controls")
DERIVATIVE = (
    *("value", "std", "lower", "upper"),
    *("std_random", "std_method", "std_log", "std_posterior"),
    *("std_merged", "std_aircraft", "aircraft"),
)


@dataclass(frozen=True, kw_only=True)
class FlightMechanics:
    """Trim, derivatives and modes in the middle of the training range.

    Parameters
    ----------
    trim : Trim, optional
        None where there is no steady flight.
    derivatives, least_squares : DataFrame
        Of `skdgp.dynamics.stability_derivatives`, for the model and for a linear one by least
        squares.
    modes : DataFrame, optional
        Of `skdgp.dynamics.LinearModel.modes`.
    simulation : DataFrame, optional
        By state ``spread``, ``limit``, ``error`` at the end, how long it ``lasts`` and its
        ``horizon`` [s].
    simulated : TimeHistoryDisplay, optional
        A part of a test flight, simulated with its bands, and as flown.
    frequency : FrequencyDisplay, optional
        Responses of rates to surfaces in the test flights, beside the model's.
    notes : tuple of Finding
        Why trim, modes or derivatives are missing.
    simulation_note : Finding, optional
        Why the simulation is missing.
    frequency_note : Finding, optional
        Why frequency responses are missing.
    """

    trim: Trim | None = None
    derivatives: pd.DataFrame = field(default_factory=pd.DataFrame)
    least_squares: pd.DataFrame | None = None
    modes: pd.DataFrame | None = None
    simulation: pd.DataFrame | None = None
    simulated: TimeHistoryDisplay | None = None
    frequency: FrequencyDisplay | None = None
    notes: tuple[Finding, ...] = ()
    simulation_note: Finding | None = None
    frequency_note: Finding | None = None

    @property
    def mode_kinds(self) -> pd.Index:
        """Kind of each mode: its name without the number, which several of one kind have."""
        names = pd.Index([]) if self.modes is None else self.modes.index
        return names.astype(str).str.replace(r" \d+$", "", regex=True)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, SI units and radians."""
        plain: dict[str, Any] = {"note": " ".join(map(text_of, self.notes)), "simulation_note": ""}
        if self.simulation_note is not None:
            plain["simulation_note"] = text_of(self.simulation_note)
        if self.trim is not None:
            trim = pd.Series(vars(self.trim))[[*TRIM]].to_dict()
            beyond = {name: list(values) for name, values in self.trim.beyond.items()}
            plain["trim"] = trim | {"beyond": beyond}
        plain["derivatives"] = self.derivatives.filter(DERIVATIVE).to_dict("index")
        modes = self.modes
        if modes is not None:
            modes = modes.drop(columns="eigenvalue")
        tables = {
            "least_squares": self.least_squares,
            "modes": modes,
            "simulation": self.simulation,
            "frequency": None if self.frequency is None else self.frequency.errors(),
        }
        for name, table in tables.items():
            if table is not None:
                plain[name] = table.to_dict("index")
        return plain


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Predictions for one flight and their replay.

    Parameters
    ----------
    name, time : str, (n,)
        What to call it, and the time of the samples [s].
    table : DataFrame
        The flight table, for the inputs and the path.
    measured, mean, std : (n, 6)
        Measured CX CY CZ Cl Cm Cn, NaN = not observed; estimated ones, and their deviations without
        noise.
    measured_as_in_fit, prediction_std : (n, 6)
        Coefficients measured with the noise of the fit, and standard deviations of such measurements.
        ``measured`` is smoothed by the spectra of the flight, and so has more or less noise.
    rows : ndarray of int
        Where standard deviations were computed; between them they are interpolated.
    regressors : (n, d)
        Inputs of the last step of the pipeline.
    truth : (n, 6), optional
        Noise-free coefficients of a simulation.
    baseline : (n, 6), optional
        Coefficients that least squares on the same rows predict.
    replay : DataFrame, optional
        Of `skdgp.dynamics.replay` for ``table``.
    """

    name: str
    time: Vector
    table: pd.DataFrame
    measured: Matrix
    mean: Matrix
    std: Matrix
    measured_as_in_fit: Matrix
    prediction_std: Matrix
    rows: Indices
    regressors: Matrix
    truth: Matrix | None = None
    baseline: Matrix | None = None
    replay: pd.DataFrame | None = None

    @cached_property
    def scores(self) -> dict[str, pd.DataFrame]:
        """The :func:`scores` of this flight."""
        return scores([self])


def scores(flights: Sequence[Evaluation]) -> dict[str, pd.DataFrame]:
    """Return coefficients by metrics, over all rows of the flights, against "measured" and "truth" if all know it.

    Metrics of bands are of the rows where standard deviations were computed.
    """
    measured = [flight.measured for flight in flights]
    in_bands = [flight.measured_as_in_fit for flight in flights]
    bands = [flight.prediction_std for flight in flights]
    against = {"measured": _scores(flights, measured, in_bands, bands)}
    truth = [flight.truth for flight in flights if flight.truth is not None]
    if len(truth) == len(flights):
        against["truth"] = _scores(flights, truth, truth, [flight.std for flight in flights])
    return against


def _scores(
    flights: Sequence[Evaluation],
    reference: Sequence[Matrix],
    in_bands: Sequence[Matrix],
    std: Sequence[Matrix],
) -> pd.DataFrame:
    """Return coefficients by metrics: errors against a reference, and how bands hold values."""
    expected = np.concatenate(reference)
    mean = np.concatenate([flight.mean for flight in flights])
    each: dict[str, Any] = {"multioutput": "raw_values"}
    table = pd.DataFrame(index=list(COEFFICIENTS))
    table["median_relative_error"] = median_relative_error(expected, mean, **each)
    table["normalized_rmse"] = normalized_rmse(expected, mean, **each)
    baselines = [flight.baseline for flight in flights if flight.baseline is not None]
    if len(baselines) == len(flights):
        linear = np.concatenate(baselines)
        table["least_squares_normalized_rmse"] = normalized_rmse(expected, linear, **each)
    has_std = np.zeros(len(mean), dtype=bool)
    begin = 0
    for flight in flights:
        has_std[begin + flight.rows] = True
        begin += len(flight.mean)
    bands = np.concatenate(in_bands)[has_std], mean[has_std], np.concatenate(std)[has_std]
    table["negative_log_predictive_density"] = negative_log_predictive_density(*bands, **each)
    table["interval_coverage"] = interval_coverage(*bands, **each)
    return table


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """The content of a report.

    Parameters
    ----------
    title : str
        Heading of the report.
    verdict, mechanics : Verdict, FlightMechanics
        Verdict on the uses of the model; trim, derivatives and modes.
    train : mapping of str to DataFrame
        Tables of the flights learned from, SI units: at least ``time``; empty for a model that
        existed before.
    test : sequence of Evaluation
        Flights tested on, at least one.
    effects : EffectsDisplay, optional
        Not drawn yet (``ax=False``).
    subtitle : str
        Beneath the heading, such as the name of the aircraft.
    facts : mapping of str to str
        Facts of the fit, ready to read. Empty ones are not shown.
    air : str
        The air that was flown: steady wind and gusts.
    sections : sequence of str
        Further sections, HTML, such as the next flight.
    assumed : sequence of str
        Assumptions where nothing was given.
    units : mapping of str to str
        Units of controls that differ from docs/notation.md.
    command : str, optional
        How the report was made.
    created : datetime
        By default now.
    """

    title: str
    verdict: Verdict
    mechanics: FlightMechanics
    train: Mapping[str, pd.DataFrame]
    test: Sequence[Evaluation]
    effects: EffectsDisplay | None = None
    subtitle: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    air: str = ""
    sections: Sequence[str] = ()
    assumed: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    command: str | None = None
    created: datetime = field(default_factory=lambda: datetime.now().astimezone())
