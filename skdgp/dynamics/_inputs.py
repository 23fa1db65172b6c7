"""Controls and wind of a simulation as functions of its stages, and its clock."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import WIND
from skdgp._flight.tables import (
    as_floats,
    check_columns,
    check_number,
    check_table,
    interpolated,
    numeric,
)
from skdgp.dynamics._air import AirAt, LocalAir


class StepClock(NamedTuple):
    """Times of the steps of a simulation and of their stages: the beginning, middle and end of each step."""

    dt: float
    n_steps: int

    @classmethod
    def of(cls, dt: float, duration: float | None, tables: Iterable[pd.DataFrame]) -> StepClock:
        """Return the clock of a ``duration`` [s], by default as long as all of the ``tables`` last."""
        dt = check_number("dt", dt, unit="s")
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
        return cls(dt, n_steps)

    @property
    def stages(self) -> np.ndarray:
        """Times since the start [s], two for each step and the end."""
        return 0.5 * self.dt * np.arange(2 * self.n_steps + 1)


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


def wind_schedule(
    wind: Any, tables: Sequence[pd.DataFrame], clock: StepClock, n_starts: int
) -> AirAt:
    """Return a function (stage, state) to the air by tables of a wind, or a constant."""
    if wind is None:
        return lambda stage, state: LocalAir()
    if tables:
        velocity = np.moveaxis(_at_stages(tables, WIND, clock, "wind"), 0, -1)
        rate = np.gradient(velocity, 0.5 * clock.dt, axis=0)
        return lambda stage, state: LocalAir(velocity[stage], rate[stage])
    constant = as_floats(wind)
    if constant.shape not in ((3,), (n_starts, 3)) or not np.isfinite(constant).all():
        raise ValueError(
            f"Got wind of shape {constant.shape}, but expected (3,) or ({n_starts}, 3): the "
            f"finite velocity of the air, north, east, down [m/s]; or a table with time."
        )
    return lambda stage, state: LocalAir(constant)


def control_schedule(
    controls: Any,
    tables: Sequence[pd.DataFrame],
    clock: StepClock,
    names: Collection[str],
    n_starts: int,
) -> Callable:
    """Return a function (step, stage, observe) to controls by name, each () or (n_starts,).

    ``names`` of controls choose columns of the tables, which may be whole logs; ``observe()``
    returns what a feedback law sees.
    """
    if tables:
        chosen = [name for name in map(str, tables[0]) if name in names]
        if not chosen:
            raise ValueError(
                f"Got controls with columns {list(tables[0])}, none of which is a control of this aircraft."
            )
        values = _at_stages(tables, chosen, clock, "controls")
        return lambda step, stage, observe: dict(zip(chosen, values[:, stage], strict=True))
    if callable(controls):
        return _held(controls, clock)
    if not isinstance(controls, Mapping):
        raise TypeError(
            f"Got {type(controls).__name__} as controls, but expected a table with a column time, a list of such "
            "(one for each start), a mapping of constants, or a function."
        )
    constants = {str(name): as_floats(value) for name, value in controls.items()}
    for name, value in constants.items():
        if value.shape not in ((), (n_starts,)) or not np.isfinite(value).all():
            raise ValueError(
                f"Got control {name} of shape {value.shape}, or not finite, but expected a finite number, or one for "
                f"each of {n_starts} starts; what varies is a table with time."
            )
    return lambda step, stage, observe: constants


def _held(law: Callable, clock: StepClock) -> Callable:
    """Return a feedback law as controls: it is asked once a step, as in a flight computer, and held to its end."""
    held: dict[int, Mapping] = {}

    def controls(step: int, stage: int, observe: Callable[[], Mapping]) -> Mapping:
        if step not in held:
            held.clear()
            held[step] = law(clock.stages[stage], observe())
        return held[step]

    return controls


def _at_stages(
    tables: Sequence[pd.DataFrame], names: Sequence[str], clock: StepClock, what: str
) -> Array:
    """Return columns at every stage, linear between rows: (columns, n_stages), of several tables (..., n_starts)."""
    parts = []
    for table in tables:
        check_columns(table, names, what=what)
        time = table["time"].to_numpy(float) - table["time"].iloc[0]
        values = numeric(table, names)
        longest = np.diff(time, append=time[-1]).max()
        is_needed = time <= clock.n_steps * clock.dt + longest
        is_whole = np.isfinite(values[is_needed]).all(axis=0)
        if not is_whole.all():
            holes = np.array(names)[~is_whole].tolist()
            raise ValueError(
                f"Got {what} that are NaN or infinite in {holes}: interpolate them, or leave them out."
            )
        parts.append(interpolated(clock.stages, time, values).T)
    return parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)


def warn_of_clocks(starts: pd.DataFrame | Array, tables: Sequence[pd.DataFrame], dt: float) -> None:
    """Warn of a start that carries another time than the first row of the controls, which is the start."""
    if not (tables and isinstance(starts, pd.DataFrame) and "time" in starts):
        return
    times = starts["time"].to_numpy(float)
    begins = np.broadcast_to([table["time"].iloc[0] for table in tables], times.shape)
    off = np.abs(times - begins)
    k = int(np.argmax(off))
    if off[k] > dt:
        warn(
            f"Got controls that begin at time {begins[k]:g} s, but start {k} is of time {times[k]:g} s: "
            "the first row of each table counts as the start. Cut the controls, "
            "table[table['time'] >= start]."
        )
