"""Limits of a planned flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import HAT, LENGTHS, rate_factor
from skdgp._flight.checks import as_floats, check_columns
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.dynamics import Aerodynamics, Aircraft, Turbulence, as_aerodynamics, trajectory_bands

# What an envelope limits, and the options of the command line
OPTIONS = {
    "alpha": "--alpha", "beta": "--beta", "load_factor": "--load-factor", "bank": "--max-bank", "airspeed": "--speeds",
    "altitude": "--floor",
}  # fmt: skip
QUANTITIES = tuple(OPTIONS)
GROWTH = "growth of "  # before the name of a limit from the training range
ENDS = (lambda x: x.shape == (2,) and x[0] < x[1], "the lowest and the highest value")
NOT_NEGATIVE = (lambda x: x.shape == () and x >= 0, "a number >= 0")
# What each value of an envelope must be
RULES: dict[str, tuple[Callable[[Any], Any], str]] = {
    **dict.fromkeys(("alpha", "beta", "load_factor", "airspeed"), ENDS),
    "bank": (lambda x: x.shape == () and x > 0, "a number > 0"),
    "altitude": (lambda x: x.shape == () and not np.isnan(x), "a number"),
    **dict.fromkeys(("growth", "margin"), NOT_NEGATIVE),
    "risk": (lambda x: x.shape == () and 0 < x < 1, "a number between 0 and 1"),
}
WHOLE_RANGE = {
    "throttle": (0.0, 1.0)
}  # lowest and highest value that a control can have, beyond which no limit grows


@dataclass(frozen=True)
class Envelope:
    """Limits of a flight, and the accepted risk.

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
        Fraction of its training range by which a regressor, or a quantity above without a value,
        may exceed it: half at either end. inf: no limit.
    risk : float, default=0.05
        Largest probability that a manoeuvre leaves any of these.
    margin : float, default=0.15
        Relative excess of the response to a manoeuvre over the model's: slopes learned in
        gusts err by more than the posterior says.
    gusts : Turbulence, "auto" or None, default="auto"
        Gusts of the predicted risk. "auto": as in the training flights, with a warning if the
        model does not know it. None: calm air.
    n_paths : int, default=200
        Aircraft drawn for each prediction. A risk of 5 % is then known to 1.5 %.

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
    risk: float = 0.05
    margin: float = 0.15
    gusts: Turbulence | Literal["auto"] | None = "auto"
    n_paths: int = 200
    #: Limited quantities, and their options of the command line
    command_options: ClassVar[Mapping[str, str]] = OPTIONS

    def __post_init__(self) -> None:
        for name, (is_valid, expected) in RULES.items():
            value = getattr(self, name)
            is_absent = value is None and name in QUANTITIES
            if not (is_absent or is_valid(as_floats(value))):
                raise ValueError(f"Got {name}={value!r}, but expected {expected}.")

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each channel: "bank" asked, "growth of bank" flown."""
        limits: dict[str, Any] = {
            name: value for name in QUANTITIES if (value := getattr(self, name)) is not None
        }
        if "bank" in limits:
            limits["bank"] = (-limits["bank"], limits["bank"])
        if "altitude" in limits:
            limits["altitude"] = (limits["altitude"], np.inf)
        bounds = dict.fromkeys(QUANTITIES, (-np.inf, np.inf)) | limits
        if np.isfinite(self.growth):
            ranges = {
                name: pair for name, pair in flown_quantities(model).items() if name not in limits
            }
            if model.limits is not None:
                ranges |= dict(zip(model.regressors, model.limits.T, strict=True))
            for name, (low, high) in ranges.items():
                growth = 0.5 * self.growth * (high - low)
                least, most = WHOLE_RANGE.get(name, (-np.inf, np.inf))
                grown = (low, np.inf) if name == "altitude" else (low - growth, high + growth)
                bounds[GROWTH + name] = max(least, grown[0]), min(most, grown[1])
        return bounds

    def altitudes(self, model: Aerodynamics | BaseEstimator) -> tuple[float, float]:
        """Return the lowest and the highest altitude that a model was learned from [m], 0 and 100 if unknown."""
        return flown_quantities(as_aerodynamics(model)).get("altitude", (0.0, 100.0))

    def unlimited(self, model: Aerodynamics) -> list[str]:
        """Return the quantities with neither a limit nor a training range."""
        bounds = self.bounds(model)
        free = [
            name
            for name in QUANTITIES
            if getattr(self, name) is None and GROWTH + name not in bounds
        ]
        return free if np.isfinite(self.growth) else []

    def channels(
        self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics
    ) -> pd.DataFrame:
        """Return the limited quantities along one simulated flight."""
        limited = quantities(flight)
        X = regressors_of(flight, aircraft, model.regressors)
        growth = limited.assign(**dict(zip(model.regressors, X.T, strict=True))).add_prefix(GROWTH)
        return pd.concat([limited, growth], axis=1)[[*self.bounds(model)]]

    def left(
        self,
        flight: pd.DataFrame,
        aircraft: Aircraft,
        model: Aerodynamics,
        margin: Matrix | float = 0.0,
    ) -> pd.DataFrame:
        """Return which limits each row of a flight leaves, with ``more`` (n, c) added; ``ended``: it ended early."""
        low, high = np.array([*self.bounds(model).values()]).T
        values = self.channels(flight, aircraft, model) + margin
        return ((values < low) | (values > high)).assign(ended=flight["ended"].to_numpy() != "")


def flown_quantities(model: Aerodynamics) -> dict[str, tuple[float, float]]:
    """Return lowest and highest value of each limited quantity in the flights of a model, where it changed."""
    ends = quantities(pd.DataFrame(model.flown, index=["low", "high"]))
    return {str(name): (min(pair), max(pair)) for name, pair in ends.items() if np.ptp(pair) > 0}


def option_of(limit: str, model: Aerodynamics) -> str:
    """Return the option of the command line that changes a limit of an envelope."""
    name = limit.removeprefix(GROWTH)
    return (
        "--growth" if limit != name and name in model.regressors else OPTIONS.get(name, "--limits")
    )


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return the limited quantities of each row of a flight; angles in radians, load factor -az / g."""
    names = ["alpha", "beta", "airspeed", "altitude", "az", "phi"]
    flight = flight.reindex(columns=names).astype(float)
    return flight.assign(load_factor=-flight["az"] / STANDARD_GRAVITY, bank=flight["phi"])[
        list(QUANTITIES)
    ]


def with_band(flight: pd.DataFrame, paths: pd.DataFrame) -> pd.DataFrame:
    """Return a flight with the central 95 % of others at its times: columns such as ``alpha_low``, ``alpha_high``."""
    bands = trajectory_bands(
        paths.assign(path=paths["flight"], **quantities(paths)), 0.95, QUANTITIES
    )
    return flight.join(bands.filter(regex="_(low|high)$"))


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
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
            length = getattr(aircraft, LENGTHS[channel])
            values = values * rate_factor(channel, length, flight["airspeed"].to_numpy(float))
        columns.append(values)
    return np.stack(columns, axis=-1)
