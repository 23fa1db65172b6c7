"""Limits of a planned flight: asked for, or the training range of a model and a little more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import VANES
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp._flight.tables import as_floats, check_columns, check_number
from skdgp.dynamics import Aerodynamics, Aircraft, as_aerodynamics
from skdgp.preprocessing import RateNondimensionalizer

# Limited quantities, and the options of the command line, or arguments, that limit them
OPTIONS = {
    "alpha": "Envelope(alpha=...)",
    "beta": "Envelope(beta=...)",
    "load_factor": "Envelope(load_factor=...)",
    "bank": "--max-bank",
    "airspeed": "Envelope(airspeed=...)",
    "altitude": "--floor",
}
QUANTITIES = tuple(OPTIONS)
# Lowest and highest value that a control can have, beyond which no limit grows
WHOLE_RANGE = {"throttle": (0.0, 1.0)}
UNLIMITED = (-np.inf, np.inf)


@dataclass(frozen=True)
class Envelope:
    """Limits of a flight in calm air, and the margin that the model's responses keep to them.

    Other limits are the training range, and a fraction ``growth`` more; a regressor that is also
    limited here keeps the narrower limits. A model of
    :class:`skdgp.preprocessing.RegressorSelector` knows this range where its flights have the
    channels airspeed, phi, az, altitude.

    Parameters
    ----------
    alpha, beta, load_factor : tuple of float, optional
        Lowest and highest [rad], and of -az / g.
    bank : float, optional
        Largest, to either side [rad].
    airspeed : tuple of float, optional
        Lowest and highest [m/s].
    altitude : float, optional
        Lowest [m]; by default the lowest that was flown, without growth.
    growth : float, default=0.2
        Allowed excess of a regressor, or of a quantity above without a value, over its training
        range, relative to the range: half at either end. inf: no limit.
    margin : float, default=0.3
        Relative excess over the model's response for which a manoeuvre still stays inside: for
        errors of the model, of the entry, and light gusts.

    Examples
    --------
    >>> from skdgp.design import Envelope
    >>> from skdgp.dynamics import Aerodynamics
    >>> flown = Aerodynamics(lambda X: 0 * X, ["alpha"], flown={"airspeed": (20.0, 30.0)})
    >>> bounds = Envelope(bank=0.8, growth=0.2).bounds(flown)
    >>> bounds["bank"], bounds["airspeed"]
    ((-0.8, 0.8), (19.0, 31.0))
    """

    alpha: tuple[float, float] | None = None
    beta: tuple[float, float] | None = None
    load_factor: tuple[float, float] | None = None
    bank: float | None = None
    airspeed: tuple[float, float] | None = None
    altitude: float | None = None
    growth: float = 0.2
    margin: float = 0.3

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "load_factor", "airspeed"):
            value = vars(self)[name]
            ends = as_floats(UNLIMITED if value is None else value)
            if ends.shape != (2,) or not ends[0] < ends[1]:
                raise ValueError(
                    f"Got {name}={value!r}, but expected the lowest and the highest value."
                )
        if self.bank is not None:
            check_number("bank", self.bank)
        if self.altitude is not None:
            check_number("altitude", self.altitude, -np.inf)
        if self.growth != np.inf:
            check_number("growth", self.growth, is_open=False)
        check_number("margin", self.margin, is_open=False)

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each limited quantity, and of each regressor."""
        requested = self._requested()
        bounds = dict.fromkeys(QUANTITIES, UNLIMITED) | requested
        if np.isinf(self.growth):
            return bounds
        flown = flown_quantities(model)
        for name in requested:
            flown.pop(name, None)
        flown |= model.training_ranges
        for name, (low, high) in flown.items():
            growth = 0.5 * self.growth * (high - low)
            grown = (low, np.inf) if name == "altitude" else (low - growth, high + growth)
            bounds[name] = common_range(grown, WHOLE_RANGE.get(name, UNLIMITED))
            bounds[name] = common_range(bounds[name], requested.get(name, UNLIMITED))
        return bounds

    def _requested(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of the quantities that were given."""
        ranges = {
            "alpha": self.alpha,
            "beta": self.beta,
            "load_factor": self.load_factor,
            "airspeed": self.airspeed,
            "bank": None if self.bank is None else (-self.bank, self.bank),
            "altitude": None if self.altitude is None else (self.altitude, np.inf),
        }
        return {name: ends for name, ends in ranges.items() if ends is not None}

    def altitudes(self, model: Aerodynamics | BaseEstimator) -> tuple[float, float]:
        """Return the lowest and the highest altitude that a model was learned from [m], 0 and 100 if unknown."""
        return flown_quantities(as_aerodynamics(model)).get("altitude", (0.0, 100.0))

    def unlimited(self, model: Aerodynamics) -> list[str]:
        """Return the quantities with neither a limit nor a training range; none if growth is inf."""
        if np.isinf(self.growth):
            return []
        bounds = self.bounds(model)
        return [name for name in QUANTITIES if np.isinf(bounds[name]).all()]

    def channels(
        self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics
    ) -> pd.DataFrame:
        """Return the values of each of the ``bounds`` along one simulated flight."""
        values = quantities(flight)
        values[[*model.regressors]] = regressors_of(flight, aircraft, model.regressors)
        return values[[*self.bounds(model)]]


def common_range(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Return the lowest and the highest value that are inside both ranges."""
    return max(first[0], second[0]), min(first[1], second[1])


def flown_quantities(model: Aerodynamics) -> dict[str, tuple[float, float]]:
    """Return lowest and highest value of each limited quantity in the flights of a model, where it changed."""
    ends = quantities(pd.DataFrame(model.flown, index=["low", "high"]))
    ranges = {}
    for name, values in ends.items():
        low, high = sorted(values)
        if low < high:
            ranges[str(name)] = (low, high)
    return ranges


def option_of(name: str) -> str:
    """Return the option of the command line that changes a limit of an envelope."""
    return OPTIONS.get(name, "--growth")


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return the limited quantities of each row of a flight; angles in radians, load factor -az / g."""
    flight = (
        flight.assign(load_factor=-flight["az"] / STANDARD_GRAVITY) if "az" in flight else flight
    )
    return flight.rename(columns={"phi": "bank"}).reindex(columns=QUANTITIES).astype(float)


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
    time = flight["time"].to_numpy(float)
    slopes = {}
    for angle in VANES:
        slopes[f"{angle}_dot"] = np.gradient(flight[angle].to_numpy(float), time)
    table = flight.assign(**slopes)
    table = RateNondimensionalizer(aircraft.span, aircraft.chord).fit_transform(table)
    check_columns(table, names)
    return table[[*names]].to_numpy(float)
