"""The air as a user describes it, and as it moves at the aircraft."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.checks import as_floats, check_choice, check_number
from skdgp._flight.frames import STANDARD_GRAVITY, body_to_ned
from skdgp.dynamics._dryden import Gusts
from skdgp.dynamics._turbulence import Turbulence

# From a time or a stage, and states (..., 13), to the air there; None where it is at rest.
AirAt: TypeAlias = "Callable[[Any, Array], LocalAir | None]"


@dataclass(frozen=True, eq=False)
class Air:
    """The air that an aircraft flies in, and gravity: ``air`` of `simulate`, `trim` and others.

    A wind stands for ``Air(wind=wind)``. Raises ValueError if a value is invalid.

    Parameters
    ----------
    wind : array-like (3,), DataFrame or list of DataFrame, optional
        Velocity of the air, north, east, down [m/s]: constant; or a table with ``time``,
        ``wind_north``, ``wind_east``, ``wind_down`` (a list: one for each start). By default at
        rest.
    gusts : "auto", Turbulence or None, default="auto"
        Turbulence: each path of a simulation meets its own gusts, with their rates p, q, r, besides
        the wind. A table as wind contains the velocity of the gusts: then only rates are drawn.
        "auto": the turbulence of this table (`Turbulence.from_wind`), else of the training flights,
        if the model knows it. None: calm air.
    drift : bool, default=True
        Whether each path, and ``return_std``, also has a drift of its own flight: errors of the
        coefficients that change slowly, as the residuals of the training flights did beyond what
        their turbulence explains, if the model knows it. False: the uncertainty of the
        aircraft alone.
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
        _check_gusts(self.gusts)
        check_choice("drift", self.drift, (True, False))
        if not (self.density is None or callable(self.density)):
            check_number("density", self.density, is_open=False, unit="kg/m^3")
        check_number("gravity", self.gravity, -np.inf, unit="m/s^2")


def _check_gusts(gusts: Any) -> None:
    """Raise ValueError if gusts are neither "auto" nor None nor a valid Turbulence."""
    if isinstance(gusts, Turbulence):
        sizes = [as_floats(gusts.intensity), as_floats(gusts.length)]
        is_whole = all(size.shape == (3,) and np.isfinite(size).all() for size in sizes)
        if not (is_whole and (sizes[0] >= 0).all() and (sizes[1] > 0).all()):
            raise ValueError(
                f"Got {gusts}, but expected three intensities >= 0 [m/s] and lengths > 0 [m], of u, v, w."
            )
    elif not (gusts is None or (isinstance(gusts, str) and gusts == "auto")):
        raise ValueError(
            f"Got gusts={gusts!r}, but expected 'auto', a Turbulence, or None: calm air."
        )


def as_air(air: Any) -> Air:
    """Return an `Air` as it is, and the air of a wind."""
    if isinstance(air, str | Turbulence):
        raise ValueError(
            f"Got {air!r} as the air, but expected Air(gusts=...) of a Turbulence, or of None for calm air."
        )
    return air if isinstance(air, Air) else Air(wind=air)


class LocalAir(NamedTuple):
    """Motion of the air at the aircraft: a wind, and gusts that turn with the aircraft."""

    wind: Array | None = None  #: Velocity, north, east, down, (..., 3) [m/s]
    wind_rate: Array | None = None  #: Its rate of change along the flight, (..., 3) [m/s^2]
    gust: Array | None = None  #: Velocity besides the wind, body axes, (..., 3) [m/s]
    gust_rate: Array | None = None  #: Its rate of change, body axes, (..., 3) [m/s^2]
    #: Rates of the air, body axes, (..., 3) [rad/s]: p, q, r as regressors are relative to it
    rotation: Array | None = None

    def velocity(self, attitude: Array) -> Array | None:
        """Return the velocity of wind and gust, north, east, down, (..., 3), at quaternions; None at rest."""
        if self.gust is None:
            return self.wind
        gust = body_to_ned(attitude, self.gust)
        return gust if self.wind is None else self.wind + gust


@dataclass(frozen=True)
class GustyAir:
    """Gusts around each aircraft, on top of a wind."""

    wind: AirAt
    gusts: Gusts  #: At each stage, (n_stages, ..., 3)

    def __call__(self, stage: Any, state: Array) -> LocalAir:
        """Return the air at a stage, or at several, and states (..., 13)."""
        steady = self.wind(stage, state) or LocalAir()
        velocity, acceleration, rotation = (part[stage] for part in self.gusts)
        return steady._replace(gust=velocity, gust_rate=acceleration, rotation=rotation)
