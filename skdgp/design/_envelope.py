"""What a planned flight must not leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from skdgp.design._information import regressors_of
from skdgp.dynamics import Aerodynamics, Aircraft
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY


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

    def __post_init__(self) -> None:
        for name in ("alpha", "beta", "load_factor", "airspeed"):
            low, high = getattr(self, name)
            if not low < high:
                raise ValueError(f"Got {name}=({low}, {high}), but expected the lowest and the highest value.")
        if not (self.bank > 0 and self.growth >= 0 and 0 < self.risk < 1):
            raise ValueError(
                f"Got bank={self.bank}, growth={self.growth}, risk={self.risk}, but expected bank > 0, growth >= 0 and "
                "a risk between 0 and 1."
            )

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each channel of `channels`."""
        found = {name: getattr(self, name) for name in ("alpha", "beta", "airspeed", "load_factor")}
        found |= {"bank": (-self.bank, self.bank), "altitude": (self.altitude, np.inf)}
        if model.limits is not None and np.isfinite(self.growth):
            grown = 0.5 * self.growth * np.ptp(model.limits, axis=0)
            for name, low, high in zip(model.regressors, model.limits[0] - grown, model.limits[1] + grown, strict=True):
                found[f"growth of {name}"] = (low, high)
        return found

    def channels(self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics) -> pd.DataFrame:
        """Return what is limited, along one simulated flight."""
        values = {name: flight[name].to_numpy(float) for name in ("alpha", "beta", "airspeed", "altitude")}
        values |= {
            "load_factor": -flight["az"].to_numpy(float) / STANDARD_GRAVITY,
            "bank": flight["phi"].to_numpy(float),
        }
        X = regressors_of(flight, aircraft, model.regressors)
        values |= {f"growth of {name}": column for name, column in zip(model.regressors, X.T, strict=True)}
        return pd.DataFrame(values)[[*self.bounds(model)]]

    def left(self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics) -> pd.DataFrame:
        """Return which limits each row of a simulated flight leaves; a flight that ended early has left ``ended``."""
        low, high = np.array([*self.bounds(model).values()]).T
        values = self.channels(flight, aircraft, model)
        return ((values < low) | (values > high)).assign(ended=flight["ended"].to_numpy() != "")
