"""The content of a report: plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Trim
from skdgp.metrics import (
    interval_coverage,
    median_relative_error,
    negative_log_predictive_density,
    normalized_rmse,
)
from skdgp.plotting import EffectsDisplay, TimeHistoryDisplay

HONEST = (0.90, 0.99)  # coverage of a 95 % interval that is not marked


class Thresholds(NamedTuple):
    """What counts as good enough (docs/judging.md, with the sources)."""

    # Largest error over the spread of the coefficients: Theil's coefficient is then 0.27, and 0.25
    # to 0.3 count as good agreement (Jategaonkar 2006, chapter 11).
    error: float = 0.5
    coverage: float = HONEST[0]  # smallest share of measured values in a 95 % band (guess)
    # Largest half-width of a 95 % band over its value: a gain margin of 6 dB (MIL-F-9490D) bears
    # half the gain.
    band: float = 0.5
    seconds: float = 1.0  # shortest simulation that is of use [s] (guess)
    tie: float = 0.02  # errors that differ by less than this share are equal (guess)


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
    least_squares_error: float | None = None
    better: tuple[str, ...] = ()
    worse: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        uses = [use._asdict() for use in self.uses]
        return asdict(self) | {"uses": uses, "thresholds": THRESHOLDS._asdict()}

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
            names = ("airspeed", "altitude", "climb", "alpha", "beta", "phi", "theta", "controls")
            found["trim"] = {name: getattr(self.trim, name) for name in names}
            found["trim"]["beyond"] = {
                name: list(values) for name, values in self.trim.beyond.items()
            }
        columns = ("value", "std", "lower", "upper", "std_merged", "std_aircraft", "aircraft")
        found["derivatives"] = self.derivatives.filter(columns).to_dict("index")
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
    measured_std : (n, 6)
        Standard deviations of new measurements.
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
    measured_std: Matrix
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
    pairs = {"measured": ("measured", "measured_std"), "truth": ("truth", "std")}
    if any(flight.truth is None for flight in flights):
        del pairs["truth"]
    return {against: _scores(flights, *names) for against, names in pairs.items()}


def _scores(flights: Sequence[Evaluation], reference: str, std: str) -> pd.DataFrame:
    def all_rows(name: str) -> Matrix:
        return np.concatenate([getattr(flight, name) for flight in flights])

    means = all_rows(reference), all_rows("mean")
    bands = [
        np.concatenate([getattr(flight, name)[flight.rows] for flight in flights])
        for name in (reference, "mean", std)
    ]
    columns: dict[str, Any] = {
        metric.__name__: metric(*means, multioutput="raw_values")
        for metric in (median_relative_error, normalized_rmse)
    }
    if all(flight.baseline is not None for flight in flights):
        linear = normalized_rmse(means[0], all_rows("baseline"), multioutput="raw_values")
        columns["least_squares_normalized_rmse"] = linear
    for metric in (negative_log_predictive_density, interval_coverage):
        columns[metric.__name__] = metric(*bands, multioutput="raw_values")
    return pd.DataFrame(columns, index=list(COEFFICIENTS))


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
