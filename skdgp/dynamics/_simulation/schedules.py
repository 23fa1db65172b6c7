"""Controls and wind along a simulation: constants, tables and functions."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._flight.checks import check_columns, check_names, check_table
from skdgp._flight.frames import body_to_ned
from skdgp.dynamics._equations.motion import Air
from skdgp.dynamics._equations.rigid_body import ATTITUDE, POSITION, VELOCITY

__all__ = ["Clock", "control_schedule", "tables_of", "warn_of_clocks", "wind_schedule"]

WIND = ("wind_north", "wind_east", "wind_down")
PROPULSION = (
    *("throttle", "propeller_speed", "thrust", "thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m", "thrust_n"),
)
MOMENT = 1e-3  # s: over which the wind of a function is differentiated


class Clock(NamedTuple):
    """The steps of a simulation, and its stages: the beginning, middle and end of each step."""

    dt: float
    n_steps: int

    @classmethod
    def of(cls, dt, duration, tables: Iterable) -> Clock:
        """Return the clock of a ``duration`` [s], by default as long as all of the ``tables`` last."""
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"Got dt={dt!r}, but expected a time step > 0 [s].")
        spans = [np.ptp(table["time"].to_numpy(float)) for table in tables]
        if duration is None:
            if not spans:
                raise ValueError("Got no duration and no table of controls, but expected one of them to say how long.")
            duration = float(min(spans))
        n_steps = int(np.floor(duration / dt + 1e-6)) if np.isfinite(duration) else 0
        if n_steps < 1:
            raise ValueError(f"Got a duration of {duration!r} s, but expected at least one step of {dt:g} s.")
        if spans and n_steps * dt > min(spans) + 1e-6 * dt:
            raise ValueError(
                f"Got a table that ends after {min(spans):g} s, but the simulation lasts {n_steps * dt:g} s: give a "
                "shorter duration, or controls and wind for all of it."
            )
        return cls(float(dt), n_steps)

    @property
    def stages(self) -> np.ndarray:
        """Times since the start [s], two for each step and the end."""
        return 0.5 * self.dt * np.arange(2 * self.n_steps + 1)


def tables_of(*sources) -> list[pd.DataFrame]:
    """Return the tables among controls and winds, checked: a time that increases."""
    found = []
    for source in sources:
        for table in _as_list(source):
            if isinstance(table, pd.DataFrame):
                check_columns(check_table(table, what="table"), ["time"], what="table")
                if not pd.api.types.is_numeric_dtype(table["time"]):
                    raise ValueError(
                        f"Got a table whose time is {table['time'].dtype}, but expected seconds: "
                        "(time - time.iloc[0]).dt.total_seconds() of stamps."
                    )
                if not (np.diff(table["time"].to_numpy(float)) > 0).all():
                    raise ValueError("Got a table whose time does not increase, but expected seconds, row after row.")
                found.append(table)
    return found


def control_schedule(controls, clock: Clock, wanted, n_starts: int, hold: bool = False) -> Callable:
    """Return a function (step, stage, observe) to controls by name, each () or (n_starts,).

    ``wanted`` says whether a column of a table is a control; ``observe()`` gives what a feedback law sees, which with
    ``hold`` is asked at the beginning of each step alone.
    """
    if callable(controls):
        return _Law(controls, clock, hold)
    if isinstance(controls, Mapping):
        constant = {name: _numbers(value, f"control {name}") for name, value in controls.items()}
        for name, value in constant.items():
            if value.shape not in ((), (n_starts,)) or not np.isfinite(value).all():
                raise ValueError(
                    f"Got control {name} of shape {value.shape}, not all finite, or not one for each of {n_starts} "
                    "starts, but expected a finite number, or one for each start; what varies is a table with time."
                )
        return lambda step, stage, observe: constant
    tables = _tables(controls, "controls", n_starts)
    names = [name for name in tables[0] if name != "time" and wanted(name)]
    if not names:
        raise ValueError(f"Got controls with columns {list(tables[0])}, none of which is a control of this aircraft.")
    values = _interpolated(tables, names, clock, "controls")
    return lambda step, stage, observe: {name: values[name][stage] for name in names}


class _Law:
    """Controls as a function (t, state) to values by name."""

    def __init__(self, law: Callable, clock: Clock, hold: bool):
        self.law, self.times, self.hold, self.held = law, clock.stages, hold, (-1, None)

    def __call__(self, step, stage, observe) -> Mapping:
        if not self.hold:
            return self.law(self.times[stage], observe())
        if self.held[0] != step:
            self.held = step, self.law(self.times[stage], observe())
        return self.held[1]


def air_of(wind, n_starts: int = 1) -> Callable | None:
    """Return a function (t, state) to the velocity of the air and its rate of change, of a constant or a function."""
    if wind is None:
        return None
    if callable(wind):

        def field(t, state):
            position, velocity = state[..., POSITION], body_to_ned(state[..., ATTITUDE], state[..., VELOCITY])
            ahead, behind = (np.asarray(wind(t + s, position + s * velocity), dtype=float) for s in (MOMENT, -MOMENT))
            if ahead.shape not in ((3,), position.shape):
                raise ValueError(
                    f"Got wind of shape {ahead.shape} at positions {position.shape}, but expected a function of "
                    "(t, position) to the velocity of the air, north, east, down: (3,), or as the positions."
                )
            return Air(0.5 * (ahead + behind), (ahead - behind) / (2 * MOMENT))

        return field
    if isinstance(wind, Mapping | pd.Series):
        check_names(dict(wind), WIND, "words of a constant wind")
        wind = [wind.get(name, 0.0) for name in WIND]
    constant = np.asarray(wind, dtype=float)
    if constant.shape not in ((3,), (n_starts, 3)) or not np.isfinite(constant).all():
        raise ValueError(
            f"Got wind of shape {constant.shape}, but expected (3,) or ({n_starts}, 3): the finite velocity of the "
            "air, north, east, down [m/s]; or a function of time and position; or, to simulate, a table with time."
        )
    return lambda t, state: Air(constant)


def wind_schedule(wind, clock: Clock, n_starts: int) -> Callable | None:
    """Return a function (stage, state) to the velocity of the air and its rate of change, (..., 3) each, or None."""
    if wind is None:
        return None
    if not tables_of(wind):
        times, air = clock.stages, air_of(wind, n_starts)
        return lambda stage, state: air(times[stage], state)
    tables = _tables(wind, "wind", n_starts)
    for table in tables:
        check_columns(table, WIND, what="wind")
    columns = _interpolated(tables, WIND, clock, "wind")
    velocity = np.stack([columns[name] for name in WIND], axis=-1)
    rate = np.gradient(velocity, 0.5 * clock.dt, axis=0)
    return lambda stage, state: Air(velocity[stage], rate[stage])


def _tables(source, what, n_starts) -> list[pd.DataFrame]:
    tables = _as_list(source)
    if not all(isinstance(table, pd.DataFrame) for table in tables):
        raise TypeError(
            f"Got {type(source).__name__} as {what}, but expected a table with a column time, a list of such (one "
            "for each start), a mapping of constants, or a function."
        )
    if len(tables) not in (1, n_starts):
        raise ValueError(f"Got {len(tables)} tables as {what} for {n_starts} starts, but expected one, or as many.")
    return tables


def _interpolated(tables, names, clock, what) -> dict[str, np.ndarray]:
    """Return columns at every stage, linear between rows: (n_stages,), or (n_stages, n_starts) of several tables."""
    parts = []
    for table in tables:
        check_columns(table, names, what=what)
        time = table["time"].to_numpy(float) - table["time"].iloc[0]
        needed = table[time <= clock.n_steps * clock.dt + np.diff(time).max()] if len(time) > 1 else table
        values = {name: _numbers(table[name], f"{what} {name}") for name in names}
        holes = [name for name in names if not np.isfinite(values[name][: len(needed)]).all()]
        if holes:
            raise ValueError(f"Got {what} that are NaN or infinite in {holes}: interpolate them, or leave them out.")
        parts.append({name: np.interp(clock.stages, time, values[name]) for name in names})
    if len(parts) == 1:
        return parts[0]
    return {name: np.stack([part[name] for part in parts], axis=-1) for name in names}


def _numbers(values, what) -> np.ndarray:
    """Return values as floats, NaN where a table misses one."""
    try:
        return values.to_numpy(float, na_value=np.nan) if isinstance(values, pd.Series) else np.asarray(values, float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"Got {what} that is no number, but expected numbers: {error}.") from error


def warn_of_clocks(starts, controls, wind, dt: float) -> None:
    """Warn of a start or a wind that carries another time than the first row of the controls, which is the start."""
    tables, air = tables_of(controls), tables_of(wind)
    if not tables:
        return
    spans = [(table["time"].iloc[0], table["time"].iloc[-1]) for table in tables]
    if isinstance(starts, pd.DataFrame) and "time" in starts:
        for k, at in enumerate(starts["time"].to_numpy(float)):
            first = spans[k if len(spans) > 1 else 0][0]
            if abs(at - first) > dt:
                _warn_of_time(f"start {k} is of time {at:g} s", first)
                break
    for table in air:
        first, last = table["time"].iloc[0], table["time"].iloc[-1]
        if any(abs(a - first) > dt and max(a, first) < min(b, last) for a, b in spans):
            _warn_of_time(f"the wind begins at time {first:g} s", spans[0][0])
            break


def _warn_of_time(what: str, first: float) -> None:
    warnings.warn(
        f"Got controls that begin at time {first:g} s, but {what}: the first row of each table is taken for the start. "
        "Cut them alike, table[table['time'] >= start].",
        UserWarning,
        stacklevel=4,
    )


def _as_list(source) -> list:
    return list(source) if isinstance(source, list | tuple) else [source]
