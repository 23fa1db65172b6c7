"""The air that the paths of a simulation meet: their gusts, and the drift of the coefficients besides these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, solve_continuous_lyapunov

from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import RATES, SENSOR_GUST, WIND
from skdgp._flight.frames import by_components
from skdgp.dynamics._aerodynamics import Drift, separate_generator
from skdgp.dynamics._air import Air, AirAt, GustyAir
from skdgp.dynamics._dryden import Gusts, dryden_gusts, dryden_system
from skdgp.dynamics._inputs import StepClock, tables_of
from skdgp.dynamics._integrate import channels
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._rigid_body import ATTITUDE
from skdgp.dynamics._turbulence import LENGTH, TooShort, Turbulence

STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))


@dataclass(frozen=True)
class DriftSettings:
    """Settings of the drift in other air than in the training flights."""

    # Largest factor of a drift's variance, in rougher air than in the training flights; a guess
    roughest: float = 2.0
    # Time [s] over which the effects of rotation and drift are compared
    horizon: float = 1.0
    # Points of the integral over this time
    points: int = 101


DRIFT = DriftSettings()


class PathsAir(NamedTuple):
    """Air that the paths of a simulation meet."""

    air: AirAt
    drift: Drift | None  #: Of the coefficients
    text: str  #: On the gusts


def paths_air(
    described: Air,
    air: AirAt,
    motion: Motion,
    clock: StepClock,
    states: Array,
    n_paths: int,
    random_state: Any,
) -> PathsAir:
    """Return the gusts and the drift that paths from states (n_starts, 13) meet, besides the ``air``."""
    met, text = met_turbulence(described, air, motion, states)
    drift = None
    if described.drift:
        drift = drift_in(met, motion, float(airspeeds(states, air).mean()))
    if met is not None and np.any(met.intensity):
        air = gusty_air(described, met, air, motion, clock, states, n_paths, random_state)
    return PathsAir(air, drift, text)


def met_turbulence(
    described: Air, air: AirAt, motion: Motion, states: Array
) -> tuple[Turbulence | None, str]:
    """Return the turbulence to fly in, None if unknown, and a sentence about it."""
    if described.gusts is None:
        return STILL, "Air without gusts, as asked."
    if isinstance(described.gusts, Turbulence):
        return described.gusts, f"Gusts {_sizes(described.gusts)}, as described."
    of_wind = _turbulence_of_wind(described, airspeeds(states, air), motion.aircraft.span)
    if of_wind is not None:
        return of_wind, f"Gusts as those of the wind, {_sizes(of_wind)}."
    flown = motion.aerodynamics.turbulence
    if flown is None:
        return None, (
            "No gusts are drawn, but errors as in the training flights: their turbulence is not known."
        )
    return flown, (
        f"Gusts as in the training flights, {_sizes(flown)}: nothing else is said of the air."
    )


def _turbulence_of_wind(described: Air, speeds: Vector, span: float) -> Turbulence | None:
    """Return the turbulence of the tables of the wind, met at airspeeds (n,); None where they show none."""
    winds = [table[["time", *WIND]] for table in tables_of(described.wind)]
    if not winds:
        return None
    try:
        return Turbulence.from_wind(winds, speeds if len(winds) > 1 else speeds.mean(), span)
    except TooShort:
        return None


def _sizes(turbulence: Turbulence) -> str:
    """Return the intensities in words."""
    u, v, w = turbulence.intensity
    return f"{u:.2g}, {v:.2g}, {w:.2g} m/s (u, v, w)"


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


def drift_in(met: Turbulence | None, motion: Motion, start_speed: float) -> Drift | None:
    r"""Return the drift in the turbulence that is met, besides the rates of its gusts, which are drawn.

    Of the variance :math:`\tau^2` that the training flights had, the rates of their gusts explain g.
    The rest are other effects of gusts, and errors of regressors that a simulation lacks. It is

    .. math:: \min(1, \rho) (\tau^2 - g),
              \quad \rho = \frac{\sigma^2 + \sigma_0^2}{\sigma_\mathrm{flown}^2 + \sigma_0^2},

    where :math:`\sigma_0` is what sensors show of calm air.
    """
    model = motion.aerodynamics
    drift = model.drift
    flown = model.turbulence
    if drift is None or flown is None or met is None:
        return drift
    speed = start_speed if flown.airspeed is None else flown.airspeed
    slopes = _rate_slopes(motion, speed)
    besides = without_rotation(drift, flown, slopes, speed, motion.aircraft.span)
    met_power = np.sum(np.square(met.intensity)) + SENSOR_GUST**2
    flown_power = np.sum(np.square(flown.intensity)) + SENSOR_GUST**2
    # fraction of the flown air's measured power that is gusts, zero in calm air
    in_gusts = 1.0 - SENSOR_GUST**2 / flown_power
    largest = 1.0 + (DRIFT.roughest - 1.0) * in_gusts
    return drift._replace(variance=min(met_power / flown_power, largest) * besides)


def _rate_slopes(motion: Motion, airspeed: float) -> Array:
    """Return the slopes (6, 3) of the coefficients by p, q, r [s], in the middle of the training ranges."""
    model = motion.aerodynamics
    middle = np.zeros(len(model.regressors))
    if model.limits is not None:
        middle = model.limits.mean(axis=0)
    gradient = model.gradient(middle[None])[0]
    slopes = np.zeros((6, 3))
    for k, name in enumerate(motion.regressors):
        if name in RATES:
            slopes[:, RATES.index(name)] += gradient[:, k] * motion.factor(k, np.array(airspeed))
    return slopes


def without_rotation(
    drift: Drift,
    flown: Turbulence,
    slopes: Array,
    airspeed: float,
    span: float,
) -> Vector:
    """Return the part (6,) of a drift's variance that the rates p, q, r of the gusts ``flown`` do not explain.

    Of each coefficient, tau^2 is reduced by the share of the rates in the variance of its integral
    over 1 s. ``slopes`` (6, 3) of the coefficients are by p, q, r [s], at this airspeed
    [m/s].
    """
    A, B, C = dryden_system(airspeed, flown.length, flown.intensity, span)
    rates = C[6:]
    covariance = solve_continuous_lyapunov(A, -B @ B.T)
    lags = np.linspace(0.0, DRIFT.horizon, DRIFT.points)
    step = expm(A * DRIFT.horizon / (DRIFT.points - 1))
    autocovariance = np.empty((DRIFT.points, 3))
    for k in range(DRIFT.points):
        autocovariance[k] = np.einsum("ij,jk,ik->i", rates, covariance, rates)
        covariance = step @ covariance
    # The variance of an integral over T is proportional to int (T - t) R(t) dt, by the trapezoidal
    # rule; the last weight is zero
    weight = DRIFT.horizon - lags
    weight[0] *= 0.5
    rotation = slopes**2 @ (weight @ autocovariance)
    total = weight @ (drift.variance * np.exp(-lags[:, None] / drift.memory))
    share = np.divide(rotation, total, out=np.zeros(6), where=total > 0)
    return drift.variance * np.maximum(1 - share, 0.0)


def airspeeds(states: Array, air: AirAt) -> Vector:
    """Return the airspeed of starts (n, 13)."""
    local = air(0, states)
    wind = None if local is None else local.velocity(states[:, ATTITUDE])
    return channels(states, wind)["airspeed"]
