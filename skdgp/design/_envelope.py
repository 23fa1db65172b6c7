"""Limits of a planned flight: asked for, or the training range of a model and a little more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import HAT, LENGTHS, rate_factor
from skdgp._flight.checks import as_floats, check_columns
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.dynamics import Aerodynamics, Aircraft, as_aerodynamics

# What an envelope limits, and the options of the command line
OPTIONS = {
    "alpha": "--alpha",
    "beta": "--beta",
    "load_factor": "--load-factor",
    "bank": "--max-bank",
    "airspeed": "--speeds",
    "altitude": "--floor",
}
QUANTITIES = tuple(OPTIONS)
# Before the name of a limit from the training range
GROWTH = "growth of "
# Lowest and highest value that a control can have, beyond which no limit grows
WHOLE_RANGE = {"throttle": (0.0, 1.0)}
UNLIMITED = (-np.inf, np.inf)


def _is_range(value: Any) -> bool:
    return value.shape == (2,) and value[0] < value[1]


def _is_positive(value: Any) -> bool:
    return value.shape == () and value > 0


def _is_not_negative(value: Any) -> bool:
    return value.shape == () and value >= 0


def _is_number(value: Any) -> bool:
    return value.shape == () and not np.isnan(value)


ENDS = (_is_range, "the lowest and the highest value")
# What each value of an envelope must be
RULES: dict[str, tuple[Callable[[Any], bool], str]] = {
    "alpha": ENDS,
    "beta": ENDS,
    "load_factor": ENDS,
    "airspeed": ENDS,
    "bank": (_is_positive, "a number > 0"),
    "altitude": (_is_number, "a number"),
    "growth": (_is_not_negative, "a number >= 0"),
    "margin": (_is_not_negative, "a number >= 0"),
}


@dataclass(frozen=True)
class Envelope:
    """Limits of a flight in calm air, and the margin that the model's responses keep to them.

    Other limits are the training range, and a fraction ``growth`` more. A model of
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
    >>> bounds["bank"], bounds["growth of airspeed"]
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
    #: Limited quantities, and their options of the command line
    command_options: ClassVar[Mapping[str, str]] = OPTIONS

    def __post_init__(self) -> None:
        values = vars(self)
        for name, (is_valid, expected) in RULES.items():
            value = values[name]
            if value is None and name in QUANTITIES:
                continue
            if not is_valid(as_floats(value)):
                raise ValueError(f"Got {name}={value!r}, but expected {expected}.")

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each channel: "bank" asked, "growth of bank" flown."""
        requested = self._asked()
        bounds = dict.fromkeys(QUANTITIES, UNLIMITED) | requested
        if np.isinf(self.growth):
            return bounds
        ranges = flown_quantities(model)
        for name in requested:
            ranges.pop(name, None)
        if model.limits is not None:
            ranges |= dict(zip(model.regressors, model.limits.T, strict=True))
        for name, (low, high) in ranges.items():
            growth = 0.5 * self.growth * (high - low)
            least, most = WHOLE_RANGE.get(name, UNLIMITED)
            grown = (max(least, low - growth), min(most, high + growth))
            bounds[GROWTH + name] = (low, np.inf) if name == "altitude" else grown
        return bounds

    def _asked(self) -> dict[str, Any]:
        """Return the lowest and the highest value of the quantities that were given."""
        values = vars(self)
        requested = {name: values[name] for name in QUANTITIES if values[name] is not None}
        if self.bank is not None:
            requested["bank"] = (-self.bank, self.bank)
        if self.altitude is not None:
            requested["altitude"] = (self.altitude, np.inf)
        return requested

    def altitudes(self, model: Aerodynamics | BaseEstimator) -> tuple[float, float]:
        """Return the lowest and the highest altitude that a model was learned from [m], 0 and 100 if unknown."""
        return flown_quantities(as_aerodynamics(model)).get("altitude", (0.0, 100.0))

    def unlimited(self, model: Aerodynamics) -> list[str]:
        """Return the quantities with neither a limit nor a training range; none if growth is inf."""
        if np.isinf(self.growth):
            return []
        bounds = self.bounds(model)
        without = [name for name in QUANTITIES if np.isinf(bounds[name]).all()]
        return [name for name in without if GROWTH + name not in bounds]

    def channels(
        self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics
    ) -> pd.DataFrame:
        """Return the values of each of the ``bounds`` along one simulated flight."""
        limited = quantities(flight)
        X = regressors_of(flight, aircraft, model.regressors)
        regressors = pd.DataFrame(X, columns=list(model.regressors), index=flight.index)
        quantity_limits = limited.drop(columns=[name for name in limited if name in regressors])
        grown = regressors.join(quantity_limits).add_prefix(GROWTH)
        return limited.join(grown)[[*self.bounds(model)]]


def flown_quantities(model: Aerodynamics) -> dict[str, tuple[float, float]]:
    """Return lowest and highest value of each limited quantity in the flights of a model, where it changed."""
    ends = quantities(pd.DataFrame(model.flown, index=["low", "high"]))
    ranges = {}
    for name, pair in ends.items():
        if np.ptp(pair) > 0:
            ranges[str(name)] = (min(pair), max(pair))
    return ranges


def option_of(limit: str, model: Aerodynamics) -> str:
    """Return the option of the command line that changes a limit of an envelope."""
    name = limit.removeprefix(GROWTH)
    if limit != name and name in model.regressors:
        return "--growth"
    return OPTIONS.get(name, "--limits")


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return the limited quantities of each row of a flight; angles in radians, load factor -az / g."""
    names = ["alpha", "beta", "airspeed", "altitude", "az", "phi"]
    flight = flight.reindex(columns=names).astype(float)
    flight["load_factor"] = -flight["az"] / STANDARD_GRAVITY
    flight["bank"] = flight["phi"]
    return flight[list(QUANTITIES)]


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
    lengths = {"span": aircraft.span, "chord": aircraft.chord}
    columns = []
    for name in names:
        channel = name if name in flight else name.removesuffix(HAT)
        is_slope = channel in ("alpha_dot", "beta_dot") and channel not in flight
        source = channel.removesuffix("_dot") if is_slope else channel
        check_columns(flight, [source, "airspeed"])
        values = flight[source].to_numpy(float)
        if is_slope:
            values = np.gradient(values, flight["time"].to_numpy(float))
        if channel != name and channel in LENGTHS:
            airspeed = flight["airspeed"].to_numpy(float)
            values = values * rate_factor(channel, lengths[LENGTHS[channel]], airspeed)
        columns.append(values)
    return np.stack(columns, axis=-1)
