"""The air as a user describes it, and as it moves at the aircraft."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.frames import body_to_ned, cross
from skdgp.dynamics._rigid_body import ATTITUDE, RATES
from skdgp.dynamics._turbulence import Gusts, Turbulence


@dataclass(frozen=True, eq=False)
class Air:
    """The air that an aircraft flies in, and gravity: ``air`` of `simulate`, `trim` and others.

    Where it is the only thing to say, a wind, a `Turbulence` or "calm" stands for ``Air(wind=wind)``,
    ``Air(gusts=turbulence)`` and ``Air(gusts=None)``. Raises ValueError if a value is not one of those below.

    Parameters
    ----------
    wind : array-like (3,), DataFrame, list of DataFrame or callable, optional
        Velocity of the air, north, east, down [m/s]: constant; a table with ``time``, ``wind_north``, ``wind_east``,
        ``wind_down`` (a list: one for each start); or a function (t, position (..., 3)). By default at rest.
    gusts : "auto", Turbulence or None, default="auto"
        Turbulence in which each path of a simulation meets gusts of its own, with their rates p, q, r, besides the
        wind. A table or function as wind contains the velocity of the gusts: then only rates are drawn. "auto": that
        of this table or function (`Turbulence.from_wind`), else that of the training flights, if the model knows it.
        None: calm air.
    drift : bool, default=True
        Whether each path, and ``return_std``, also has a drift of its own flight: errors of the coefficients that
        change slowly, as the residuals of the training flights did, besides what drawn gusts explain: smaller in calmer
        air, if the model knows the turbulence of its flights. False: the uncertainty of the aircraft alone.
    density : float or callable, optional
        [kg/m^3], or a function of altitude [m]; by default the standard atmosphere.
    gravity : float, default=9.80665
        [m/s^2].

    Examples
    --------
    >>> from skdgp.dynamics import Air, Turbulence
    >>> Air(wind=[5.0, 0.0, 0.0], gusts=None)
    Air(wind=[5.0, 0.0, 0.0], gusts=None, drift=True, density=None, gravity=9.80665)
    """

    wind: Any = None
    gusts: Turbulence | Literal["auto"] | None = "auto"
    drift: bool = True
    density: float | Callable | None = None
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        if isinstance(self.gusts, Turbulence):
            intensity, length = (np.asarray(part, dtype=float) for part in self.gusts[:2])
            size = np.stack([intensity, length]) if intensity.shape == length.shape == (3,) else np.full((2, 3), np.nan)
            if not (np.isfinite(size).all() and (intensity >= 0).all() and (length > 0).all()):
                raise ValueError(
                    f"Got {self.gusts}, but expected three intensities >= 0 [m/s] and lengths > 0 [m], of u, v, w."
                )
        elif not (self.gusts is None or (isinstance(self.gusts, str) and self.gusts == "auto")):
            raise ValueError(f"Got gusts={self.gusts!r}, but expected 'auto', a Turbulence, or None: calm air.")
        if not isinstance(self.drift, bool | np.bool_):
            raise ValueError(f"Got drift={self.drift!r}, but expected True or False.")
        density, gravity = self.density, self.gravity
        if not (density is None or callable(density) or (isinstance(density, Real) and 0 <= float(density) < np.inf)):
            raise ValueError(f"Got density={density!r}, but expected kg/m^3 from 0 on, or a function of altitude [m].")
        if not (isinstance(gravity, Real) and np.isfinite(float(gravity))):
            raise ValueError(f"Got gravity={gravity!r}, but expected a finite number [m/s^2].")


def as_air(air: Any) -> Air:
    """Return what a user says of the air as an `Air`: one as it is; or a wind, a Turbulence, or "calm"."""
    if isinstance(air, Air):
        return air
    if isinstance(air, Turbulence):
        return Air(gusts=air)
    if isinstance(air, str):
        if air != "calm":
            raise ValueError(f"Got air={air!r}, but expected 'calm', an Air, a wind or a Turbulence.")
        return Air(gusts=None)
    return Air(wind=air)


class LocalAir(NamedTuple):
    """Motion of the air at the aircraft."""

    wind: Array
    """Velocity, north, east, down, (..., 3) [m/s]."""
    wind_rate: Array | None = None
    """Its rate of change along the flight, (..., 3) [m/s^2]."""
    rotation: Array | None = None
    """Rates of the air, body axes, (..., 3) [rad/s]: p, q, r as regressors are relative to it."""


AirAt: TypeAlias = "Callable[[Any, Array], LocalAir | None]"
"""From a time or a stage, and states (..., 13), to the air there; None where it is at rest."""


@dataclass(frozen=True)
class GustyAir:
    """Gusts around each aircraft, on top of a wind."""

    wind: AirAt
    gusts: Gusts
    """At each stage, (n_stages, ..., 3)."""

    def __call__(self, stage: Any, state: Array) -> LocalAir:
        """Return the air at a stage, or at several, and states (..., 13)."""
        velocity, acceleration, rotation = (part[stage] for part in self.gusts)
        rate = acceleration + cross(state[..., RATES], velocity)  # a gust turns with the aircraft
        gust, gust_rate = body_to_ned(state[..., ATTITUDE], np.stack([velocity, rate]))
        steady = self.wind(stage, state)
        if steady is None:
            return LocalAir(gust, gust_rate, rotation)
        gust_rate = gust_rate if steady.wind_rate is None else steady.wind_rate + gust_rate
        return LocalAir(steady.wind + gust, gust_rate, rotation)
