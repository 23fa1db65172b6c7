"""The air of a simulation: its wind, the gusts that paths meet, and their drift in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import expm, solve_continuous_lyapunov
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import RATES, SENSOR_GUST, WIND
from skdgp._flight.checks import check_columns, check_names
from skdgp._flight.frames import body_to_ned, ned_to_body
from skdgp.dynamics._aerodynamics import Drift
from skdgp.dynamics._air import (
    LENGTH,
    Air,
    AirAt,
    Gusts,
    GustyAir,
    LocalAir,
    TooShort,
    Turbulence,
    dryden_gusts,
    dryden_system,
)
from skdgp.dynamics._inputs import as_tables, interpolated, tables_of
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._record import Clock
from skdgp.dynamics._rigid_body import ATTITUDE, POSITION, VELOCITY

STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))
WIND_STEP = 1e-3  # Over which the wind of a function is differentiated [s]
# Largest factor of a drift's variance, in rougher air than in the training flights. On eleven
# aircraft 1 and 2 have the same score and no limit a worse one; 2 has the higher lowest coverage
# (docs/simulation.md).
ROUGHEST = 2.0
# Time [s] over which the effects of rotation and drift are compared, and points of the integral
HORIZON, POINTS = 1.0, 101


def wind_field(wind: Any, n_starts: int = 1) -> AirAt:
    """Return a function (t, state) to the air, of a wind that is constant, a function or None."""
    if wind is None:
        return lambda t, state: None
    if callable(wind):

        def field(t: float, state: Array) -> LocalAir:
            position = state[..., POSITION]
            velocity = body_to_ned(state[..., ATTITUDE], state[..., VELOCITY])
            ahead, behind = (
                np.asarray(wind(t + step, position + step * velocity), dtype=float)
                for step in (WIND_STEP, -WIND_STEP)
            )
            if ahead.shape not in ((3,), position.shape):
                raise ValueError(
                    f"Got wind of shape {ahead.shape} at positions {position.shape}, but expected "
                    f"a function of "
                    "(t, position) to the velocity of the air, north, east, down: (3,), or as the "
                    "positions."
                )
            return LocalAir(0.5 * (ahead + behind), (ahead - behind) / (2 * WIND_STEP))

        return field
    if isinstance(wind, Mapping | pd.Series):
        check_names(dict(wind), WIND, "names of a constant wind")
        wind = [wind.get(name, 0.0) for name in WIND]
    constant = np.asarray(wind, dtype=float)
    if constant.shape not in ((3,), (n_starts, 3)) or not np.isfinite(constant).all():
        raise ValueError(
            f"Got wind of shape {constant.shape}, but expected (3,) or ({n_starts}, 3): the "
            f"finite velocity of the "
            "air, north, east, down [m/s]; or a function of time and position; or, to simulate, a "
            "table with time."
        )
    return lambda t, state: LocalAir(constant)


def wind_schedule(wind: Any, clock: Clock, n_starts: int) -> AirAt:
    """Return a function (stage, state) to the air."""
    if not tables_of(wind):
        times, field = clock.stages, wind_field(wind, n_starts)
        return lambda stage, state: field(times[stage], state)
    tables = as_tables(wind, "wind", n_starts)
    for table in tables:
        check_columns(table, WIND, what="wind")
    columns = interpolated(tables, WIND, clock, "wind")
    velocity = np.stack([columns[name] for name in WIND], axis=-1)
    rate = np.gradient(velocity, 0.5 * clock.dt, axis=0)
    return lambda stage, state: LocalAir(velocity[stage], rate[stage])


def met_turbulence(
    described: Air, air: AirAt, motion: Motion, clock: Clock, states: Array
) -> tuple[Turbulence | None, str]:
    """Return the turbulence to fly in, None if unknown, and a sentence about it."""
    flown = motion.aerodynamics.turbulence
    if described.gusts is None:
        return STILL, "Air without gusts, as asked."
    if isinstance(described.gusts, Turbulence):
        return described.gusts, f"Gusts {_sizes(described.gusts)}, as described."
    if _has_gusts(described.wind):
        found = _turbulence_of(described.wind, air, motion, clock, states)
        if found is not None:
            return found, f"Gusts as those of the wind, {_sizes(found)}."
    if flown is None:
        return (
            None,
            "No gusts are drawn, but errors as in the training flights: their turbulence is not "
            "known.",
        )
    return (
        flown,
        f"Gusts as in the training flights, {_sizes(flown)}: nothing else is said of the air.",
    )


def _sizes(turbulence: Turbulence) -> str:
    """Return the intensities in words."""
    u, v, w = turbulence.intensity
    return f"{u:.2g}, {v:.2g}, {w:.2g} m/s (u, v, w{', of which u and v are not told apart' * turbulence.is_tied})"


def _has_gusts(wind: Any) -> bool:
    """Return whether a wind contains its gusts: a table or a function."""
    return callable(wind) or bool(tables_of(wind))


def _turbulence_of(
    wind: Any, air: AirAt, motion: Motion, clock: Clock, states: Array
) -> Turbulence | None:
    """Return the turbulence of a wind, None if it is too short to show it; a function is followed straight ahead."""
    speeds, tables = airspeeds(states, air), tables_of(wind)
    if not tables:
        ground = body_to_ned(states[:, ATTITUDE], states[:, VELOCITY])
        met = []
        for k in range(clock.n_steps + 1):
            moved = states.copy()
            moved[:, POSITION] += k * clock.dt * ground
            met.append(np.broadcast_to(air(2 * k, moved).wind, (len(states), 3)))  # type: ignore[union-attr]
        time = clock.dt * np.arange(clock.n_steps + 1)
        tables = [pd.DataFrame(w, columns=[*WIND]).assign(time=time) for w in np.stack(met, axis=1)]
    try:
        return Turbulence.from_wind(
            tables, speeds if len(tables) > 1 else speeds.mean(), motion.aircraft.span
        )
    except TooShort:
        return None


def gusty_air(
    described: Air,
    met: Turbulence,
    air: AirAt,
    motion: Motion,
    clock: Clock,
    states: Array,
    n_paths: int,
    seed: Any,
) -> GustyAir:
    """Return the air (n_paths, n_starts) with gusts, or with their rates alone where the wind contains them."""
    seeds = check_random_state(seed).randint(2**31 - 1, size=5)  # other numbers than for the paths
    n = len(states)
    length, intensity = (np.tile(part, (n, 1)) for part in (met.length, met.intensity))
    drawn = dryden_gusts(
        len(clock.stages), 0.5 * clock.dt, airspeeds(states, air), length, intensity, motion.aircraft.span,
        np.random.default_rng(seeds), n_draws=n_paths,
    )  # fmt: skip
    parts = [part.reshape(len(part), -1, n, 3) for part in drawn]
    if _has_gusts(described.wind):
        parts[:2] = (np.zeros_like(part) for part in parts[:2])
    return GustyAir(air, Gusts(*parts), motion.is_implicit)


def drift_in(met: Turbulence | None, motion: Motion, start_speed: float) -> Drift | None:
    r"""Return the drift in the turbulence that is met, besides the rates of its gusts, which are drawn.

    Of the variance :math:`\tau^2` that the training flights had, the misfit m is of the function,
    and the rates of their gusts explain g. The rest are other effects of gusts, and errors of
    regressors that a simulation lacks. It is

    .. math:: m + \min(1, \rho) (\tau^2 - g - m),
              \quad \rho = \frac{\sigma^2 + \sigma_0^2}{\sigma_\mathrm{flown}^2 + \sigma_0^2},

    where :math:`\sigma_0` is what sensors show of calm air.
    """
    model = motion.aerodynamics
    drift, flown = model.drift, model.turbulence
    if drift is None or flown is None or met is None:
        return drift
    speed = start_speed if flown.airspeed is None else flown.airspeed
    middle = np.zeros(len(model.regressors)) if model.limits is None else model.limits.mean(axis=0)
    gradient = model.gradient(middle[None])[0]
    slopes = np.zeros((6, 3))
    for k, name in enumerate(motion.regressors):
        if name in RATES:
            slopes[:, RATES.index(name)] += gradient[:, k] * motion.factor(k, np.array(speed))
    besides = without_rotation(drift, flown, slopes, speed, motion.aircraft.span)
    ratio = np.divide(*(np.square(part.intensity).sum() + SENSOR_GUST**2 for part in (met, flown)))
    in_gusts = 1.0 - SENSOR_GUST**2 / (
        np.square(flown.intensity).sum() + SENSOR_GUST**2
    )  # none in calm air
    largest = 1.0 + (ROUGHEST - 1.0) * in_gusts
    variance = drift.misfit + min(ratio, largest) * np.maximum(besides - drift.misfit, 0.0)
    return drift._replace(variance=variance)


def without_rotation(
    drift: Drift, flown: Turbulence, slopes: Array, airspeed: float, span: float
) -> Vector:
    """Return the part (6,) of a drift's variance that the rates p, q, r of the gusts ``flown`` do not explain.

    Of each coefficient, tau^2 is reduced by the share of the rates in the variance of its integral
    over 1 s. ``slopes`` (6, 3) of the coefficients are by p, q, r [s], at this airspeed
    [m/s].
    """
    A, B, C = dryden_system(airspeed, flown.length, flown.intensity, span)
    covariance, step = solve_continuous_lyapunov(A, -B @ B.T), expm(A * HORIZON / (POINTS - 1))
    lags = np.linspace(0.0, HORIZON, POINTS)
    autocovariance = np.empty((POINTS, 3))
    for k in range(POINTS):
        autocovariance[k] = np.einsum("ij,jk,ik->i", C[6:], covariance, C[6:])
        covariance = step @ covariance
    weight = 2 * np.gradient(lags) * (HORIZON - lags)
    weight[[0, -1]] *= 0.5
    rotation = slopes**2 @ (weight @ autocovariance)
    whole = weight @ (drift.variance * np.exp(-lags[:, None] / drift.memory))
    share = np.divide(rotation, whole, out=np.zeros(6), where=whole > 0)
    return drift.variance * np.maximum(1 - share, 0.0)


def airspeeds(states: Array, air: AirAt) -> Vector:
    """Return the airspeed of starts (n, 13)."""
    local = air(0, states)
    wind = (
        0.0
        if local is None
        else ned_to_body(states[:, ATTITUDE], np.broadcast_to(local.wind, (len(states), 3)))
    )
    return np.linalg.norm(states[:, VELOCITY] - wind, axis=-1)
