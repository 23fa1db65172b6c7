"""What a planned flight must not leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix
from skdgp.design._information import regressors_of
from skdgp.dynamics import Aerodynamics, Aircraft
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY

QUANTITIES = ("alpha", "beta", "load_factor", "bank", "airspeed", "altitude")
GROWTH = "growth of "


@dataclass(frozen=True)
class Envelope:
    """What a flight must not leave, and the risk that is accepted.

    Parameters
    ----------
    alpha, beta : tuple of float
        Lowest and highest [rad].
    load_factor : tuple of float
        Lowest and highest of -az / g.
    bank : float
        Largest, to either side [rad].
    airspeed : tuple of float
        Lowest and highest [m/s].
    altitude : float
        Lowest [m].
    growth : float, default=0.2
        By which part of its range a regressor may leave what the model was learned from; inf: no limit.
    risk : float, default=0.05
        Largest probability that a manoeuvre leaves any of these.
    margin : float, default=0.15
        Fraction by which the response to a manoeuvre may exceed the model's: slopes learned in gusts err by more than
        the posterior says.

    Examples
    --------
    >>> from skdgp.design import Envelope
    >>> Envelope(bank=0.8, altitude=60.0, risk=0.01).alpha
    (-inf, inf)
    """

    alpha: tuple[float, float] = (-np.inf, np.inf)
    beta: tuple[float, float] = (-np.inf, np.inf)
    load_factor: tuple[float, float] = (-np.inf, np.inf)
    bank: float = np.inf
    airspeed: tuple[float, float] = (0.0, np.inf)
    altitude: float = -np.inf
    growth: float = 0.2
    risk: float = 0.05
    margin: float = 0.15

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "load_factor", "airspeed"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"Got {name}=({low}, {high}), but expected the lowest and the highest value.")
        if not (self.bank > 0 and self.growth >= 0 and 0 < self.risk < 1 and self.margin >= 0):
            raise ValueError(
                f"Got bank={self.bank}, growth={self.growth}, risk={self.risk}, margin={self.margin}, but expected "
                "bank > 0, growth >= 0, margin >= 0 and a risk between 0 and 1."
            )

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each channel of `channels`."""
        found = {name: getattr(self, name) for name in ("alpha", "beta", "airspeed", "load_factor")}
        found |= {"bank": (-self.bank, self.bank), "altitude": (self.altitude, np.inf)}
        if model.limits is not None and np.isfinite(self.growth):
            grown = 0.5 * self.growth * np.ptp(model.limits, axis=0)
            for name, low, high in zip(model.regressors, model.limits[0] - grown, model.limits[1] + grown, strict=True):
                found[GROWTH + name] = (low, high)
        return found

    def channels(self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics) -> pd.DataFrame:
        """Return what is limited, along one simulated flight."""
        X = regressors_of(flight, aircraft, model.regressors)
        growth = pd.DataFrame(X, flight.index, [GROWTH + name for name in model.regressors])
        return pd.concat([quantities(flight), growth], axis=1)[[*self.bounds(model)]]

    def left(
        self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics, more: Matrix | float = 0.0
    ) -> pd.DataFrame:
        """Return which limits each row of a simulated flight leaves; a flight that ended early has left ``ended``.

        ``more`` (n, c) is added to its channels.
        """
        low, high = np.array([*self.bounds(model).values()]).T
        values = self.channels(flight, aircraft, model) + more
        return ((values < low) | (values > high)).assign(ended=flight["ended"].to_numpy() != "")


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return what an envelope limits, of each row of a flight; angles in radians, load factor -az / g."""
    found = {name: flight[name].to_numpy(float) for name in ("alpha", "beta", "airspeed", "altitude")}
    found["load_factor"] = -flight["az"].to_numpy(float) / STANDARD_GRAVITY
    found["bank"] = flight["phi"].to_numpy(float)
    return pd.DataFrame(found, index=flight.index)[list(QUANTITIES)]


def with_band(flight: pd.DataFrame, paths: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Return a flight with the central share of others at its times: columns such as ``alpha_low``, ``alpha_high``."""
    others = quantities(paths).to_numpy().reshape(-1, len(flight), len(QUANTITIES))
    flown = np.isfinite(others).any(axis=0).all(axis=-1)
    bounds = np.full((2, *others.shape[1:]), np.nan)
    bounds[:, flown] = np.nanquantile(others[:, flown], [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
    names = [[f"{name}_{end}" for name in QUANTITIES] for end in ("low", "high")]
    return pd.concat([flight, *(pd.DataFrame(b, flight.index, n) for b, n in zip(bounds, names, strict=True))], axis=1)
