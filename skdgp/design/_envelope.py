"""Limits of a planned flight: asked for, or the training range of a model and a little more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import VANES
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp._flight.tables import as_floats, check_names, check_number, numeric
from skdgp.dynamics import Aerodynamics, Motion

# Limited quantities
QUANTITIES = ("alpha", "beta", "load_factor", "bank", "airspeed", "altitude")
# Lowest and highest value that a control can have, beyond which no limit grows
WHOLE_RANGE = {"throttle": (0.0, 1.0)}
UNLIMITED = (-np.inf, np.inf)
Range: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class Envelope:
    """Limits of a flight in calm air, and the margin that the model's responses keep to them.

    Other limits are the training range, and a fraction ``growth`` more; a regressor that is also
    limited here keeps the narrower limits. A model of
    :class:`skdgp.preprocessing.RegressorSelector` knows this range where its flights have the
    channels airspeed, phi, az, altitude.

    Parameters
    ----------
    limits : mapping of str to tuple of float, optional
        Lowest and highest alpha, beta, bank [rad], load_factor (-az / g), airspeed [m/s], altitude [m], or
        of a regressor; inf: none. By default the altitude is no lower than was flown.
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
    >>> bounds = Envelope({"bank": (-0.8, 0.8)}, growth=0.2).bounds(flown)
    >>> bounds["bank"], bounds["airspeed"]
    ((-0.8, 0.8), (19.0, 31.0))
    """

    limits: Mapping[str, Range] = field(default_factory=dict)
    growth: float = 0.2
    margin: float = 0.3

    def __post_init__(self) -> None:
        for name, value in self.limits.items():
            ends = as_floats(value)
            if ends.shape != (2,) or not ends[0] < ends[1]:
                raise ValueError(
                    f"Got {name}={value!r}, but expected the lowest and the highest value."
                )
        if self.growth != np.inf:
            check_number("growth", self.growth, is_open=False)
        check_number("margin", self.margin, is_open=False)

    def bounds(self, model: Aerodynamics) -> dict[str, Range]:
        """Return the lowest and the highest value of each limited quantity, and of each regressor."""
        check_names(self.limits, [*QUANTITIES, *model.regressors], "quantities of an envelope")
        bounds = dict.fromkeys(QUANTITIES, UNLIMITED) | dict(self.limits)
        if np.isinf(self.growth):
            return bounds
        flown = flown_quantities(model)
        others = {name: ends for name, ends in flown.items() if name not in self.limits}
        for name, (low, high) in (others | model.training_ranges).items():
            growth = 0.5 * self.growth * (high - low)
            grown = (low, np.inf) if name == "altitude" else (low - growth, high + growth)
            whole = WHOLE_RANGE.get(name, UNLIMITED)
            bounds[name] = common_range(grown, whole, self.limits.get(name, UNLIMITED))
        return bounds


def common_range(*ranges: Range) -> Range:
    """Return the lowest and the highest value that are inside all ranges."""
    lowest, highest = zip(*ranges, strict=True)
    return max(lowest), min(highest)


def flown_quantities(model: Aerodynamics) -> dict[str, Range]:
    """Return lowest and highest value of each limited quantity in the flights of a model, where it changed."""
    ends = quantities(pd.DataFrame(model.flown, index=["low", "high"])).agg(["min", "max"])
    return {str(name): tuple(ends[name].tolist()) for name in ends if np.ptp(ends[name]) > 0}


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return the limited quantities of each row of a flight; angles in radians, load factor -az / g."""
    quantities = flight.rename(columns={"phi": "bank"}).reindex(columns=QUANTITIES).astype(float)
    if "az" in flight:
        quantities["load_factor"] = -flight["az"] / STANDARD_GRAVITY
    return quantities


def regressors_of(flight: pd.DataFrame, motion: Motion) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
    time = flight["time"].to_numpy(float)
    slopes = {}
    for angle in VANES:
        slopes[f"{angle}_dot"] = np.gradient(flight[angle].to_numpy(float), time)
    channels = numeric(flight.assign(**slopes), motion.regressors)
    return channels * motion.factors(flight["airspeed"].to_numpy(float))
