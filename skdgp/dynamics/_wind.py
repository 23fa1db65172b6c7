"""The air of a simulation: its wind, and the gusts that paths meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import WIND
from skdgp._flight.checks import check_columns, check_names
from skdgp._flight.frames import body_to_ned, ned_to_body
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
)
from skdgp.dynamics._inputs import as_tables, interpolated, tables_of
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._record import Clock
from skdgp.dynamics._rigid_body import ATTITUDE, POSITION, VELOCITY

STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))
WIND_STEP = 1e-3
"""Over which the wind of a function is differentiated [s]."""


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
    described: Air, air: AirAt, motion: Motion, states: Array
) -> tuple[Turbulence | None, str]:
    """Return the turbulence to fly in, None if unknown, and a sentence about it."""
    flown = motion.aerodynamics.turbulence
    if described.gusts is None:
        return STILL, "Air without gusts, as asked."
    if isinstance(described.gusts, Turbulence):
        return described.gusts, f"Gusts {_sizes(described.gusts)}, as asked."
    if tables := tables_of(described.wind):
        of_wind = _turbulence_of(tables, airspeeds(states, air), motion.aircraft.span)
        if of_wind is not None:
            return of_wind, f"Gusts as those of the wind, {_sizes(of_wind)}."
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


def _turbulence_of(tables: list, speeds: Vector, span: float) -> Turbulence | None:
    """Return the turbulence of winds, None if they are too short to show it."""
    try:
        return Turbulence.from_wind(tables, speeds if len(tables) > 1 else speeds.mean(), span)
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


def airspeeds(states: Array, air: AirAt) -> Vector:
    """Return the airspeed of starts (n, 13)."""
    local = air(0, states)
    wind = (
        0.0
        if local is None
        else ned_to_body(states[:, ATTITUDE], np.broadcast_to(local.wind, (len(states), 3)))
    )
    return np.linalg.norm(states[:, VELOCITY] - wind, axis=-1)
