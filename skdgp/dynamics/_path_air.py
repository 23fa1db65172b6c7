"""The air that the paths of a simulation meet: their gusts, and the drift of the coefficients besides these."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import SENSOR_GUST, WIND
from skdgp._flight.frames import by_components
from skdgp.dynamics._aerodynamics import Aerodynamics, Drift, separate_generator
from skdgp.dynamics._air import LENGTH, Air, AirAt, GustyAir, TooShort, Turbulence
from skdgp.dynamics._dryden import Gusts, dryden_gusts
from skdgp.dynamics._inputs import StepClock, tables_of
from skdgp.dynamics._integrate import channels
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._rigid_body import ATTITUDE

STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))


def paths_air(
    described: Air,
    air: AirAt,
    motion: Motion,
    clock: StepClock,
    states: Array,
    n_paths: int,
    random_state: Any,
) -> tuple[AirAt, Drift | None]:
    """Return the air with gusts that paths from states (n_starts, 13) meet, and the drift."""
    met = met_turbulence(described, air, motion, states)
    drift = None
    if described.drift:
        drift = drift_in_still_air(motion.aerodynamics)
    if met is not None and np.any(met.intensity):
        air = gusty_air(described, met, air, motion, clock, states, n_paths, random_state)
    return air, drift


def met_turbulence(described: Air, air: AirAt, motion: Motion, states: Array) -> Turbulence | None:
    """Return the turbulence to fly in, None if unknown."""
    if described.gusts is None:
        return STILL
    if isinstance(described.gusts, Turbulence):
        return described.gusts
    of_wind = _turbulence_of_wind(described, airspeeds(states, air), motion.aircraft.span)
    return motion.aerodynamics.turbulence if of_wind is None else of_wind


def _turbulence_of_wind(described: Air, speeds: Vector, span: float) -> Turbulence | None:
    """Return the turbulence of the tables of the wind, met at airspeeds (n,); None where they show none."""
    winds = [table[["time", *WIND]] for table in tables_of(described.wind)]
    if not winds:
        return None
    try:
        return Turbulence.from_wind(winds, speeds if len(winds) > 1 else speeds.mean(), span)
    except TooShort:
        return None


def gusty_air(
    described: Air,
    met: Turbulence,
    air: AirAt,
    motion: Motion,
    clock: StepClock,
    states: Array,
    n_paths: int,
    seed: Any,
) -> GustyAir:
    """Return the air (n_paths, n_starts) with gusts, or with their rates alone where the wind contains them."""
    n_starts = len(states)
    n_stages = len(clock.stages)
    drawn = dryden_gusts(
        n_stages,
        0.5 * clock.dt,
        airspeeds(states, air),
        np.tile(met.length, (n_starts, 1)),
        np.tile(met.intensity, (n_starts, 1)),
        motion.aircraft.span,
        separate_generator(seed, 5),
        n_draws=n_paths,
    )
    velocity, acceleration, rates = (
        by_components(part.reshape(n_stages, -1, n_starts, 3)) for part in drawn
    )
    if tables_of(described.wind):
        velocity = acceleration = np.zeros_like(rates)
    return GustyAir(air, Gusts(velocity, acceleration, rates))


def drift_in_still_air(model: Aerodynamics) -> Drift | None:
    r"""Return the part of a drift that is not of the gusts of the training flights, all of it if these are unknown.

    Of the variance :math:`\tau^2` it is :math:`\sigma_0^2 / (\sigma_\mathrm{flown}^2 + \sigma_0^2)`, with
    what sensors show of calm air, :math:`\sigma_0`. Gusts, with their rates, are drawn themselves: with the whole
    drift besides, spreads of the roll rate were 1.5 times the true ones, without it 0.9 to 1.1.
    """
    drift = model.drift
    flown = model.turbulence
    if drift is None or flown is None:
        return drift
    flown_power = np.sum(np.square(flown.intensity)) + SENSOR_GUST**2
    return drift._replace(variance=SENSOR_GUST**2 / flown_power * drift.variance)


def airspeeds(states: Array, air: AirAt) -> Vector:
    """Return the airspeed of starts (n, 13)."""
    local = air(0, states)
    wind = None if local is None else local.velocity(states[:, ATTITUDE])
    return channels(states, wind)["airspeed"]
