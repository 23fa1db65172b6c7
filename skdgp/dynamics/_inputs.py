"""What a simulation is given: starts, controls and wind as functions of its stages, and their times."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    CHANNELS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    WIND,
)
from skdgp._flight.frames import air_velocity, euler_to_quaternion, ned_to_body
from skdgp._flight.tables import (
    check_columns,
    check_names,
    check_number,
    check_numbers,
    check_table,
    interpolated,
    numeric,
)
from skdgp._flight.units import check_radians
from skdgp.dynamics._air import AirAt, LocalAir
from skdgp.dynamics._rigid_body import STATE_NAMES, VELOCITY, stacked
from skdgp.dynamics._trim import Trim

START_NAMES = (*AIR_DATA, *EARTH_VELOCITY, *EULER, *RATES, *POSITION, "altitude")


# Relative difference of the airspeed, and the airspeed of ground speed and wind, above which a start gets a
# warning
AIRSPEED_DIFFERENCE = 0.15
# Altitude of the lowest land there is [m]
LOWEST = -450.0


def as_starts(x0: Any) -> pd.DataFrame:
    """Return one start or several as a table of names, with a row for each.

    ``x0`` is a mapping, Series or DataFrame by name, a `Trim` or a list of trims, which hold relative to the air.
    """
    if isinstance(x0, Mapping):
        _check_start_names([str(name) for name in x0])
    if isinstance(x0, Mapping | pd.Series):
        return pd.DataFrame({name: np.atleast_1d(value) for name, value in dict(x0).items()})
    if isinstance(x0, pd.DataFrame) and len(x0):
        return x0
    points = [x0] if isinstance(x0, Trim) else x0
    if isinstance(points, list | tuple) and points and all(isinstance(at, Trim) for at in points):
        return pd.DataFrame([point.start for point in points])
    raise ValueError(
        f"Got x0={x0!r}, but expected names and values, a table of them, or trims: see docs/notation.md."
    )


def _check_start_names(names: Sequence[str]) -> None:
    """Raise ValueError at an unknown name that resembles a name of a start."""
    lacking = [name for name in START_NAMES if name not in names]
    for name in names:
        near = get_close_matches(name, lacking, n=1, cutoff=0.75)
        if name not in CHANNELS and near:
            raise ValueError(
                f"Got {name!r} in x0, but expected a name of docs/notation.md: did you mean {near[0]!r}?"
            )


def initial_states(table: pd.DataFrame, air_at: Callable[[Array], LocalAir]) -> Array:
    """Return the states (n, 13) of starts, in the air that ``air_at`` returns at states (n, 13).

    The velocity is v_north, v_east, v_down, or airspeed, alpha, beta (relative to the
    air); what else is not given is zero. Altitude counts before down, as the density follows
    from it. Raises ValueError if the velocity is missing, or a value is not finite or not in
    radians. Warns if ground speed, wind and airspeed do not fit, or a start lies below any land.
    """
    check_radians(table, (*EULER, *RATES, "alpha", "beta"))
    n = (len(table),)
    attitude = euler_to_quaternion(*stacked(table, EULER, n).T)
    velocity = ned_to_body(attitude, stacked(table, EARTH_VELOCITY, n))
    position = stacked(table, POSITION, n)
    states = np.hstack([position, velocity, attitude, stacked(table, RATES, n)])
    if "altitude" in table:
        states[:, 2] = -table["altitude"].to_numpy(float)
    lowest = -states[:, 2].max()
    if lowest < LOWEST:
        warn(
            f"Got a start at an altitude of {lowest:g} m, below any land: down is positive downwards, "
            "altitude = -down."
        )
    moving = air_at(states).velocity(attitude)
    wind = 0.0 if moving is None else ned_to_body(attitude, moving)
    if set(EARTH_VELOCITY) <= set(table):
        if "airspeed" in table:
            _warn_of_wind(table["airspeed"].to_numpy(float), states[:, VELOCITY] - wind)
    else:
        # u, v, w alone do not determine the angles
        needed = ["airspeed"] if set(BODY_VELOCITY).isdisjoint(table) else AIR_DATA
        check_names(needed, table.columns, "columns of x0 (or v_north, v_east, v_down)")
        for speed in table["airspeed"]:
            check_number("airspeed of x0", speed, unit="m/s")
        through_air = air_velocity(*stacked(table, AIR_DATA, n).T)
        states[:, VELOCITY] = through_air + wind
    is_bad = ~np.isfinite(states).all(axis=0)
    if is_bad.any():
        raise ValueError(
            f"Got a start whose {np.array(STATE_NAMES)[is_bad].tolist()} are NaN or infinite: choose "
            "rows in which the state was measured."
        )
    return states


def _warn_of_wind(stated: Array, velocity: Array) -> None:
    """Warn of an airspeed (n,) that differs from the velocity (n, 3) through the air."""
    airspeed = np.linalg.norm(velocity, axis=1)
    off = np.nan_to_num(np.abs(airspeed / stated - 1.0))
    worst = int(np.argmax(off))
    if off[worst] > AIRSPEED_DIFFERENCE:
        warn(
            f"At start {worst} ground velocity and wind make an airspeed of {airspeed[worst]:.1f} m/s, "
            f"but x0 says {stated[worst]:.1f} m/s: give the wind of that flight (air=wind)."
        )


def stages_of(dt: float, duration: float | None, tables: Iterable[pd.DataFrame]) -> Array:
    """Return the times since the start [s] of the stages, two for each step of ``dt`` [s] and the end.

    The ``duration`` [s] is by default as long as all of the ``tables`` last.
    """
    check_number("dt", dt, unit="s")
    shortest = min((np.ptp(table["time"].to_numpy(float)) for table in tables), default=np.inf)
    if duration is None:
        if shortest == np.inf:
            raise ValueError(
                "Got no duration and no table of controls, but expected one of them to say how long."
            )
        duration = float(shortest)
    n_steps = int(np.floor(duration / dt + 1e-6)) if np.isfinite(duration) else 0
    if n_steps < 1:
        raise ValueError(
            f"Got a duration of {duration!r} s, but expected at least one step of {dt:g} s."
        )
    if n_steps * dt > shortest + 1e-6 * dt:
        raise ValueError(
            f"Got a table that ends after {shortest:g} s, but the simulation lasts "
            f"{n_steps * dt:g} s: give a shorter duration, or controls and wind for all of it."
        )
    stages: Any = 0.5 * dt * np.arange(2 * n_steps + 1)
    return stages


def tables_of(source: Any, what: str, n_starts: int) -> list[pd.DataFrame]:
    """Return a table, or the tables of a list, one for each start, checked; none of any other controls or wind."""
    tables = list(source) if isinstance(source, list | tuple) else [source]
    if not any(isinstance(table, pd.DataFrame) for table in tables):
        return []
    for table in tables:
        check_columns(check_table(table, what=what), ["time"], what=what)
        if not pd.api.types.is_numeric_dtype(table["time"]):
            raise ValueError(
                f"Got {what} whose time is {table['time'].dtype}, but expected seconds: "
                "(time - time.iloc[0]).dt.total_seconds() of stamps."
            )
        if not (np.diff(table["time"].to_numpy(float)) > 0).all():
            raise ValueError(
                f"Got {what} whose time does not increase, but expected seconds, row after row."
            )
    if len(tables) not in (1, n_starts):
        raise ValueError(
            f"Got {len(tables)} tables as {what} for {n_starts} starts, but expected one, or as many."
        )
    return tables


def wind_schedule(wind: Any, tables: Sequence[pd.DataFrame], stages: Array) -> AirAt:
    """Return a function (stage, state) to the air by tables of a wind, or a constant."""
    if wind is None:
        return lambda stage, state: LocalAir()
    if tables:
        velocity = np.moveaxis(_at_stages(tables, WIND, stages, "wind"), 0, -1)
        rate = np.gradient(velocity, stages[1], axis=0)
        return lambda stage, state: LocalAir(velocity[stage], rate[stage])
    constant = check_numbers("wind", wind, 3, unit="m/s north, east, down")
    return lambda stage, state: LocalAir(constant)


def control_schedule(
    controls: Any,
    tables: Sequence[pd.DataFrame],
    stages: Array,
    names: Collection[str],
) -> Callable:
    """Return a function (step, stage, observe) to controls by name, numbers, or of tables (n_starts,) too.

    ``names`` of controls choose columns of the tables, which may be whole logs; ``observe()``
    returns what a feedback law sees.
    """
    if tables:
        chosen = [name for name in map(str, tables[0]) if name in names]
        if not chosen:
            raise ValueError(
                f"Got controls with columns {list(tables[0])}, none of which is a control of this aircraft."
            )
        values = _at_stages(tables, chosen, stages, "controls")
        return lambda step, stage, observe: dict(zip(chosen, values[:, stage], strict=True))
    if callable(controls):
        return _held(controls, stages)
    if not isinstance(controls, Mapping):
        raise TypeError(
            f"Got {type(controls).__name__} as controls, but expected a table with a column time, a list of such "
            "(one for each start), a mapping of constants, or a function."
        )
    constants = {}
    for name, value in controls.items():
        constants[str(name)] = check_number(f"control {name}", value, -np.inf)
    return lambda step, stage, observe: constants


def _held(law: Callable, stages: Array) -> Callable:
    """Return a feedback law as controls: it is asked once a step, as in a flight computer, and held to its end."""
    held: dict[int, Mapping] = {}

    def controls(step: int, stage: int, observe: Callable[[], Mapping]) -> Mapping:
        if step not in held:
            held.clear()
            held[step] = law(stages[stage], observe())
        return held[step]

    return controls


def _at_stages(
    tables: Sequence[pd.DataFrame], names: Sequence[str], stages: Array, what: str
) -> Array:
    """Return columns at every stage, linear between rows: (columns, n_stages), of several tables (..., n_starts)."""
    parts = []
    for table in tables:
        check_columns(table, names, what=what)
        time = table["time"].to_numpy(float) - table["time"].iloc[0]
        values = numeric(table, names)
        longest = np.diff(time, append=time[-1]).max()
        is_needed = time <= stages[-1] + longest
        is_whole = np.isfinite(values[is_needed]).all(axis=0)
        if not is_whole.all():
            holes = np.array(names)[~is_whole].tolist()
            raise ValueError(
                f"Got {what} that are NaN or infinite in {holes}: interpolate them, or leave them out."
            )
        parts.append(interpolated(stages, time, values).T)
    return parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)


def warn_of_clocks(starts: pd.DataFrame, tables: Sequence[pd.DataFrame], dt: float) -> None:
    """Warn of a start that carries another time than the first row of the controls, which is the start."""
    if not tables or "time" not in starts:
        return
    begins = [float(table["time"].iloc[0]) for table in tables]
    late = begins - starts["time"].to_numpy(float)
    if (np.abs(late) > dt).any():
        warn(
            f"Got controls that begin {late.round(3).tolist()} s from the times of their starts: the first row of a "
            "table counts as the start. Cut the controls, table[table['time'] >= start]."
        )
