"""The content of a report: plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._display.flights import LATERAL_STATES, check_time
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Trim
from skdgp.plotting import EffectsDisplay, EnvelopeDisplay, TimeHistoryDisplay
from skdgp.report._tables import HONEST, SCORES


class Thresholds(NamedTuple):
    """What counts as good enough (docs/judging.md, with the sources)."""

    error: float = 0.5
    """Largest error over the spread of the coefficients: Theil's coefficient is then 0.27, and 0.25 to
    0.3 count as good agreement (Jategaonkar 2006, chapter 11)."""
    coverage: float = HONEST[0]
    """Smallest share of measured values in a 95 % band (guess)."""
    band: float = 0.5
    """Largest half-width of a 95 % band over its value: a gain margin of 6 dB (MIL-F-9490D) bears
    half the gain.
    """
    seconds: float = 1.0
    """Shortest simulation that is of use [s] (guess)."""
    tie: float = 0.02
    """Errors that differ by less than this share are equal (guess)."""


THRESHOLDS = Thresholds()


class Use(NamedTuple):
    """A use of a model: ``fit`` is "yes", "partly", "no" or "unknown"; the reason is a sentence without its stop."""

    purpose: str
    fit: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Training, tests, and the uses that the model is good enough for.

    Parameters
    ----------
    learned : str
        Sizes of training and test.
    error, coverage : float
        NRMSE and coverage of the 95 % band, means of the six coefficients, of all test flights
        together.
    uses, warnings : tuples of Use and of str
        The warning that costs most comes first.
    flights : DataFrame
        Per test flight ``duration`` [s] and the means of its scores.
    least_squares_error : float, optional
        Error of a linear model fitted to the same rows.
    better, worse : tuples of str
        Coefficients whose error is smaller, or larger, than by least squares.
    """

    learned: str
    error: float
    coverage: float
    uses: tuple[Use, ...]
    warnings: tuple[str, ...]
    flights: pd.DataFrame
    least_squares_error: float | None = None
    better: tuple[str, ...] = ()
    worse: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values; the flights are in the scores."""
        values = {name: value for name, value in asdict(self).items() if name != "flights"}
        return values | {
            "uses": [use._asdict() for use in self.uses],
            "thresholds": THRESHOLDS._asdict(),
        }

    def compared(self) -> str:
        """Return a sentence on least squares, empty where it is not known."""
        if self.least_squares_error is None:
            return ""
        equal = [name for name in COEFFICIENTS if name not in (*self.better, *self.worse)]
        kinds = {"better": self.better, "equal": equal, "worse": self.worse}
        parts = [f"{kind} in {' '.join(names)}" for kind, names in kinds.items() if names]
        errors = f"an error of {self.least_squares_error:.3f}, the model {self.error:.3f}"
        return f"Least squares on the same rows has {errors}: the model is {', '.join(parts)}."


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
    note, simulation_note : str
        Why derivatives, or the simulation, are missing.
    """

    trim: Trim | None = None
    derivatives: pd.DataFrame = field(default_factory=pd.DataFrame)
    least_squares: pd.DataFrame | None = None
    modes: pd.DataFrame | None = None
    simulation: pd.DataFrame | None = None
    simulated: TimeHistoryDisplay | None = None
    note: str = ""
    simulation_note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, SI units and radians."""
        found: dict[str, Any] = {"note": self.note, "simulation_note": self.simulation_note}
        if self.trim is not None:
            names = ("airspeed", "alpha", "beta", "phi", "theta", "controls")
            found["trim"] = {name: getattr(self.trim, name) for name in names}
            path = "glide_without_thrust" if "climb" in self.trim.solved else "climb"
            found["trim"][path] = self.trim.climb
            found["trim"]["beyond"] = {
                name: list(values) for name, values in self.trim.beyond.items()
            }
        names_kept = ("value", "std", "lower", "upper", "std_merged", "std_aircraft", "aircraft")
        columns = [name for name in names_kept if name in self.derivatives]
        found["derivatives"] = self.derivatives[columns].to_dict("index")
        modes = None if self.modes is None else self.modes.drop(columns="eigenvalue")
        tables = {
            "least_squares": self.least_squares,
            "modes": modes,
            "simulation": self.simulation,
        }
        return found | {
            name: table.to_dict("index") for name, table in tables.items() if table is not None
        }


@dataclass(frozen=True, kw_only=True)
class FlightResult:
    """A test flight and its predictions; raises ValueError if the shapes do not belong together.

    Parameters
    ----------
    name, time : str, (n,)
        What to call it, and the time of the samples [s].
    measured, mean, std : (n, 6)
        Measured CX CY CZ Cl Cm Cn, NaN = not observed; estimated ones, and their deviations without
        noise.
    measured_std : (n, 6), optional
        Standard deviations of new measurements (``include_noise=True``); default ``std``.
    truth : (n, 6), optional
        Noise-free coefficients of a simulation.
    table : DataFrame, optional
        The flight table, for the inputs and the path.
    replay : DataFrame, optional
        Of `skdgp.dynamics.replay` for ``table``, of one or several horizons.
    baseline : (n, 6), optional
        Coefficients that least squares on the same rows predict.
    metrics : mapping, optional
        ``{"measured": {metric: six numbers}, "truth": {...}}`` with the names of skdgp.metrics, by
        which they are computed by default.
    """

    name: str
    time: Vector
    measured: Matrix
    mean: Matrix
    std: Matrix
    measured_std: Matrix | None = None
    truth: Matrix | None = None
    table: pd.DataFrame | None = None
    replay: pd.DataFrame | None = None
    baseline: Matrix | None = None
    metrics: Mapping[str, Mapping[str, object]] | None = None

    def __post_init__(self):
        object.__setattr__(self, "time", check_time(self.time))
        expected = len(self.time), len(COEFFICIENTS)
        for name in ("measured", "mean", "std", "measured_std", "truth", "baseline"):
            if getattr(self, name) is None:
                continue
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape != expected:
                raise ValueError(
                    f"Got {name} of shape {values.shape} for flight {self.name!r}, but expected "
                    f"{expected}: one row "
                    f"per time, columns {' '.join(COEFFICIENTS)}."
                )
            object.__setattr__(self, name, values)
        if self.replay is not None and self.table is None:
            raise ValueError(f"Got a replay of flight {self.name!r} without its table: give both.")

    @property
    def replayed_states(self) -> list[str]:
        """Lateral states that were measured and replayed."""
        if self.replay is None or self.table is None:
            return []
        return [name for name in LATERAL_STATES if name in self.replay and name in self.table]

    @property
    def noisy_std(self) -> Matrix:
        """Standard deviations to compare measured values with."""
        return self.std if self.measured_std is None else self.measured_std

    @cached_property
    def scores(self) -> dict[str, pd.DataFrame]:
        """Scores against "measured" and, where it is known, "truth": coefficients by metrics."""
        metrics = self.metrics
        if metrics is None:
            metrics = {"measured": self._scores(self.measured, self.noisy_std)}
            if self.truth is not None:
                metrics["truth"] = self._scores(self.truth, self.std)
        return {
            against: pd.DataFrame(dict(scores), list(COEFFICIENTS)).reindex(columns=list(SCORES))
            for against, scores in metrics.items()
        }

    def _scores(self, values: Matrix, std: Matrix) -> dict[str, Vector]:
        scores = {}
        for name, score in SCORES.items():
            mean = self.baseline if score.of_baseline else self.mean
            if mean is not None:
                moments = (mean, std) if score.of_band else (mean,)
                scores[name] = score.function(values, *moments, multioutput="raw_values")
        return scores


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """The content of a report.

    Parameters
    ----------
    title : str
        Heading of the report.
    train : mapping of str to DataFrame
        Tables of the flights learned from, SI units: at least ``time``.
    test : sequence of FlightResult
        Flights tested on.
    subtitle : str
        Beneath the heading, such as the name of the aircraft.
    facts : mapping of str to str
        Facts of the fit: aircraft, samples, regressors, kernel, likelihood, versions, ready to
        read.
        Empty ones are not shown.
    verdict, mechanics : Verdict, FlightMechanics, optional
        Verdict on the uses of the model; trim, derivatives and modes.
    envelope, effects : EnvelopeDisplay, EffectsDisplay, optional
        Not drawn yet (``ax=False``).
    air : str
        The air that was flown: steady wind and gusts.
    sections : sequence of str
        Further sections, HTML, such as the next flight.
    assumed, messages : sequences of str
        Assumptions where nothing was given; warnings.
    units : mapping of str to str
        Units of controls that differ from docs/notation.md.
    command, created : str, datetime, optional
        How the report was made, and when; default: now.
    """

    title: str
    train: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    test: Sequence[FlightResult] = ()
    subtitle: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict | None = None
    mechanics: FlightMechanics | None = None
    envelope: EnvelopeDisplay | None = None
    effects: EffectsDisplay | None = None
    air: str = ""
    sections: Sequence[str] = ()
    assumed: Sequence[str] = ()
    messages: Sequence[str] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    command: str | None = None
    created: datetime | None = None
