"""Inputs of a simulation: initial states, controls, wind, the gusts that paths meet, and their drift."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm, solve_continuous_lyapunov
from sklearn.utils import check_random_state

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    CHANNELS,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
    SENSOR_GUST,
    WIND,
)
from skdgp._flight.checks import (
    as_floats,
    check_columns,
    check_names,
    check_number,
    check_radians,
    check_table,
    numeric,
)
from skdgp._flight.frames import (
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_euler,
)
from skdgp.dynamics import _rigid_body as rigid_body
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
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._rigid_body import ATTITUDE, STATE_NAMES, VELOCITY, stacked

STILL = Turbulence(np.zeros(3), np.full(3, LENGTH))
# Largest factor of a drift's variance, in rougher air than in the training flights; a guess
ROUGHEST = 2.0
# Time [s] over which the effects of rotation and drift are compared, and points of the integral
HORIZON, POINTS = 1.0, 101


class Clock(NamedTuple):
    """Times of the steps of a simulation and of their stages: the beginning, middle and end of each step."""

    dt: float
    n_steps: int

    @classmethod
    def of(cls, dt: float, duration: float | None, tables: Iterable[pd.DataFrame]) -> Clock:
        """Return the clock of a ``duration`` [s], by default as long as all of the ``tables`` last."""
        dt = check_number("dt", dt, unit="s")
        spans = [np.ptp(table["time"].to_numpy(float)) for table in tables]
        if duration is None:
            if not spans:
                raise ValueError(
                    "Got no duration and no table of controls, but expected one of them to say "
                    "how long."
                )
            duration = float(min(spans))
        n_steps = int(np.floor(duration / dt + 1e-6)) if np.isfinite(duration) else 0
        if n_steps < 1:
            raise ValueError(
                f"Got a duration of {duration!r} s, but expected at least one step of {dt:g} s."
            )
        if spans and n_steps * dt > min(spans) + 1e-6 * dt:
            raise ValueError(
                f"Got a table that ends after {min(spans):g} s, but the simulation lasts "
                f"{n_steps * dt:g} s: give a "
                "shorter duration, or controls and wind for all of it."
            )
        return cls(dt, n_steps)

    @property
    def stages(self) -> np.ndarray:
        """Times since the start [s], two for each step and the end."""
        return 0.5 * self.dt * np.arange(2 * self.n_steps + 1)


def wind_schedule(wind: Any, clock: Clock, n_starts: int) -> AirAt:
    """Return a function (stage, state) to the air, None where it is still."""
    if wind is None:
        return lambda stage, state: None
    if not tables_of(wind):
        constant = as_floats(wind)
        if constant.shape not in ((3,), (n_starts, 3)) or not np.isfinite(constant).all():
            raise ValueError(
                f"Got wind of shape {constant.shape}, but expected (3,) or ({n_starts}, 3): the "
                f"finite velocity of the air, north, east, down [m/s]; or a table with time."
            )
        return lambda stage, state: LocalAir(constant)
    columns = interpolated(as_tables(wind, "wind", n_starts), WIND, clock, "wind")
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
        return described.gusts, f"Gusts {_sizes(described.gusts)}, as described."
    if tables := tables_of(described.wind):
        speeds = airspeeds(states, air)
        with suppress(TooShort):
            found = Turbulence.from_wind(
                [table[["time", *WIND]] for table in tables],
                speeds if len(tables) > 1 else [speeds.mean()],
                motion.aircraft.span,
            )
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
    return f"{u:.2g}, {v:.2g}, {w:.2g} m/s (u, v, w)"


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
    if tables_of(described.wind):
        parts[:2] = (np.zeros_like(part) for part in parts[:2])
    return GustyAir(air, Gusts(*parts))


def drift_in(met: Turbulence | None, motion: Motion, start_speed: float) -> Drift | None:
    r"""Return the drift in the turbulence that is met, besides the rates of its gusts, which are drawn.

    Of the variance :math:`\tau^2` that the training flights had, the rates of their gusts explain g.
    The rest are other effects of gusts, and errors of regressors that a simulation lacks. It is

    .. math:: \min(1, \rho) (\tau^2 - g),
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
    return drift._replace(variance=min(ratio, largest) * besides)


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


START_NAMES = (*AIR_DATA, *EARTH_VELOCITY, *EULER, *RATES, *POSITION, "altitude")
# States of a start that may have standard deviations
DRAWN = (*POSITION, *BODY_VELOCITY, *EULER, *RATES, *EARTH_VELOCITY)
# Relative difference of a start's airspeed and the airspeed of its ground speed and wind, at most
AIRSPEED_TOLERANCE = 0.15
LOWEST_LAND = -450.0  # Altitude of the lowest land there is [m]


class UncertainStart(NamedTuple):
    """A start of paths that is known with standard deviations: ``simulate(model, aircraft, UncertainStart(...), ...)``.

    ``std`` is by name ("u", "v", "w", "v_north", ..., "phi", ...). Deviations of angles alone leave
    the velocity over the ground as it is, which is how it is measured.
    """

    x0: Any
    std: Mapping[str, float]


def as_starts(x0: Any) -> pd.DataFrame | Array:
    """Return one start or several as a table of names or an array of states, with a row for each.

    ``x0`` is a mapping, Series or DataFrame by name, an array (13,) or (n, 13), a `Trim` or a list
    of trims.
    """
    if isinstance(x0, Sequence) and len(x0) and all(hasattr(point, "state") for point in x0):
        x0 = [point.state for point in x0]
    x0 = getattr(x0, "state", x0)
    if hasattr(x0, "columns") and not isinstance(x0, pd.DataFrame):
        x0 = {name: np.asarray(x0[name]) for name in x0.columns}
    if isinstance(x0, Mapping):
        _check_start_names([str(name) for name in x0])
    if isinstance(x0, Mapping | pd.Series):
        x0 = pd.DataFrame({name: np.atleast_1d(value) for name, value in dict(x0).items()})
    if isinstance(x0, pd.DataFrame) and len(x0):
        return x0
    states = np.atleast_2d(np.array(x0, dtype=float))
    if states.ndim != 2 or states.shape[1] != len(STATE_NAMES) or not len(states):
        raise ValueError(
            f"Got x0 of shape {np.shape(x0)}, but expected names and values, or (13,) or (n, 13): "
            f"{', '.join(STATE_NAMES)}."
        )
    return states


def _check_start_names(names: Sequence[str]) -> None:
    """Raise ValueError at an unknown name that resembles a name of a start."""
    lacking = [name for name in START_NAMES if name not in names]
    for name in names:
        near = get_close_matches(name, lacking, n=1, cutoff=0.75)
        if name not in CHANNELS and near:
            raise ValueError(
                f"Got {name!r} in x0, but expected a name of docs/notation.md: did you mean "
                f"{near[0]!r}?"
            )


def initial_states(
    starts: pd.DataFrame | Array, air_at: Callable[[Array], LocalAir | None] = lambda states: None
) -> Array:
    """Return the states (n, 13) of starts, in the air that ``air_at`` returns at states (n, 13).

    By name: the velocity as v_north, v_east, v_down, or airspeed, alpha, beta (relative to the
    air); what else is not given is zero. Altitude counts before down, as the density follows
    from it. Raises ValueError if the velocity is missing, or a value is not finite or not in
    radians. Warns if ground speed, wind and airspeed do not fit, or a start lies below any land.
    """
    states = _from_table(starts, air_at) if isinstance(starts, pd.DataFrame) else starts
    is_bad = ~np.isfinite(states).all(axis=0)
    if is_bad.any():
        raise ValueError(
            f"Got a start whose {np.array(STATE_NAMES)[is_bad].tolist()} are NaN or infinite: "
            f"choose rows in which the state was measured."
        )
    if not (np.linalg.norm(states[:, ATTITUDE], axis=1) > 0).all():
        raise ValueError(
            "Got a start whose quaternion is zero, but expected q0, q1, q2, q3 of an attitude."
        )
    return states


def table_states(table: pd.DataFrame) -> Array:
    """Return the states (n, 13) of a flight table, zero where a column is absent."""
    n = (len(table),)
    states = np.zeros((*n, len(STATE_NAMES)))
    states[:, ATTITUDE] = euler_to_quaternion(*stacked(table, EULER, n).T)
    states[:, rigid_body.RATES] = stacked(table, RATES, n)
    states[:, rigid_body.POSITION] = stacked(table, POSITION, n)
    states[:, VELOCITY] = ned_to_body(states[:, ATTITUDE], stacked(table, EARTH_VELOCITY, n))
    return states


def _from_table(table: pd.DataFrame, air_at: Callable[[Array], LocalAir | None]) -> Array:
    check_radians(table, (*EULER, *RATES, "alpha", "beta"))
    states = table_states(table)
    if "altitude" in table:
        states[:, 2] = -table["altitude"].to_numpy(float)
    if (states[:, 2] > -LOWEST_LAND).any():
        warn(
            f"Got a start at an altitude of {-states[:, 2].max():g} m, below any land: down is "
            f"positive downwards, altitude = -down.",
            stacklevel=4,
        )
    air = air_at(states)
    wind = 0.0 if air is None else ned_to_body(states[:, ATTITUDE], air.wind)
    if not set(EARTH_VELOCITY) <= set(table):
        # u, v, w alone do not say the angles
        needed = AIR_DATA if set(BODY_VELOCITY) & set(table) else ["airspeed"]
        check_names(needed, table.columns, "columns of x0 (or v_north, v_east, v_down)")
        for speed in table["airspeed"]:
            check_number("airspeed of x0", speed, unit="m/s")
        states[:, VELOCITY] = air_velocity(*stacked(table, AIR_DATA, (len(table),)).T) + wind
    elif "airspeed" in table:
        stated = table["airspeed"].to_numpy(float)
        airspeed = np.linalg.norm(states[:, VELOCITY] - wind, axis=1)
        off = np.nan_to_num(np.abs(airspeed / stated - 1.0))
        worst = int(np.argmax(off))
        if off[worst] > AIRSPEED_TOLERANCE:
            warn(
                f"At start {worst} ground velocity and wind make an airspeed of "
                f"{airspeed[worst]:.1f} m/s, but x0 says {stated[worst]:.1f} m/s: give the wind of "
                f"that flight (air=wind).",
                stacklevel=4,
            )
    return states


def perturbed(
    states: Array, std: Mapping[str, float] | None, n_paths: int, random_state: Any
) -> Array:
    """Return a start for each path, (n_paths, n, 13), drawn around the states (n, 13) with deviations by name."""
    std = std or {}
    check_names(std, DRAWN, "names of standard deviations of a start")
    for name, size in std.items():
        check_number(f"standard deviation of {name}", size, is_open=False)
    drawn = np.tile(states, (n_paths, 1, 1))
    draw = check_random_state(random_state).standard_normal
    off = {name: float(size) * draw(drawn.shape[:2]) for name, size in std.items()}
    zero = np.zeros(drawn.shape[:2])

    def errors(names):
        return np.stack([off.get(name, zero) for name in names], axis=-1)

    drawn[..., rigid_body.POSITION] += errors(POSITION)
    drawn[..., VELOCITY] += errors(BODY_VELOCITY) + ned_to_body(
        drawn[..., ATTITUDE], errors(EARTH_VELOCITY)
    )
    drawn[..., rigid_body.RATES] += errors(RATES)
    if any(name in std for name in EULER):
        angles = quaternion_to_euler(drawn[..., ATTITUDE]) + errors(EULER)
        ground = body_to_ned(drawn[..., ATTITUDE], drawn[..., VELOCITY])
        drawn[..., ATTITUDE] = euler_to_quaternion(*np.moveaxis(angles, -1, 0))
        if not any(
            name in std for name in BODY_VELOCITY
        ):  # the velocity over the ground was measured
            drawn[..., VELOCITY] = ned_to_body(drawn[..., ATTITUDE], ground)
    return drawn


def tables_of(*sources: Any) -> list[pd.DataFrame]:
    """Return the tables among controls and winds, checked: a time that increases."""
    every = [table for source in sources for table in _as_list(source)]
    tables = [table for table in every if isinstance(table, pd.DataFrame)]
    for table in tables:
        check_columns(check_table(table, what="table"), ["time"], what="table")
        if not pd.api.types.is_numeric_dtype(table["time"]):
            raise ValueError(
                f"Got a table whose time is {table['time'].dtype}, but expected seconds: "
                "(time - time.iloc[0]).dt.total_seconds() of stamps."
            )
        if not (np.diff(table["time"].to_numpy(float)) > 0).all():
            raise ValueError(
                "Got a table whose time does not increase, but expected seconds, row after row."
            )
    return tables


class FlightComputer(NamedTuple):
    """A feedback law that is asked once a step, as in a flight computer: ``simulate(..., FlightComputer(law))``.

    By itself a law is asked at every stage of a step, as if it acted without a delay.
    """

    law: Callable  #: (t, state) to controls by name


def control_schedule(
    controls: Any, clock: Clock, names: Collection[str], n_starts: int
) -> Callable:
    """Return a function (step, stage, observe) to controls by name, each () or (n_starts,).

    ``names`` of controls choose columns of a table, which may be a whole log; ``observe()``
    returns what a feedback law sees.
    """
    if isinstance(controls, FlightComputer):
        held: dict[int, Mapping] = {}

        def of_step(step: int, stage: int, observe: Callable[[], Mapping]) -> Mapping:
            if step not in held:  # asked at the beginning of a step, held to its end
                held.clear()
                held[step] = controls.law(clock.stages[stage], observe())
            return held[step]

        return of_step
    if callable(controls):
        return lambda step, stage, observe: controls(clock.stages[stage], observe())
    if isinstance(controls, Mapping):
        constants = {str(name): as_floats(value) for name, value in controls.items()}
        for name, value in constants.items():
            if value.shape not in ((), (n_starts,)) or not np.isfinite(value).all():
                raise ValueError(
                    f"Got control {name} of shape {value.shape}, not all finite, or not one for "
                    f"each of {n_starts} starts, but expected a finite number, or one for each "
                    f"start; what varies is a table with time."
                )
        return lambda step, stage, observe: constants
    tables = as_tables(controls, "controls", n_starts)
    chosen = [name for name in map(str, tables[0]) if name in names]
    if not chosen:
        raise ValueError(
            f"Got controls with columns {list(tables[0])}, none of which is a control of this "
            f"aircraft."
        )
    values = interpolated(tables, chosen, clock, "controls")
    return lambda step, stage, observe: {name: values[name][stage] for name in chosen}


def as_tables(source: Any, what: str, n_starts: int) -> list[pd.DataFrame]:
    """Return a table, or a list of one for each start, as a list; raise TypeError or ValueError if it is neither."""
    tables = _as_list(source)
    if not all(isinstance(table, pd.DataFrame) for table in tables):
        raise TypeError(
            f"Got {type(source).__name__} as {what}, but expected a table with a column time, a "
            f"list of such (one "
            "for each start), a mapping of constants, or a function."
        )
    if len(tables) not in (1, n_starts):
        raise ValueError(
            f"Got {len(tables)} tables as {what} for {n_starts} starts, but expected one, or as "
            f"many."
        )
    return tables


def interpolated(
    tables: list[pd.DataFrame], names: Sequence[str], clock: Clock, what: str
) -> dict[str, Array]:
    """Return columns at every stage, linear between rows: (n_stages,), or (n_stages, n_starts) of several tables."""
    parts = []
    for table in tables:
        check_columns(table, names, what=what)
        time = table["time"].to_numpy(float) - table["time"].iloc[0]
        values = numeric(table, names)
        longest = np.diff(time, append=time[-1]).max()
        is_needed = time <= clock.n_steps * clock.dt + longest
        is_whole = np.isfinite(values[is_needed]).all(axis=0)
        if holes := [name for name, complete in zip(names, is_whole, strict=True) if not complete]:
            raise ValueError(
                f"Got {what} that are NaN or infinite in {holes}: interpolate them, or leave them "
                f"out."
            )
        parts.append([np.interp(clock.stages, time, column) for column in values.T])
    stacks = [np.stack(columns, axis=-1) for columns in zip(*parts, strict=True)]
    return {
        name: stack[:, 0] if len(tables) == 1 else stack
        for name, stack in zip(names, stacks, strict=True)
    }


def warn_of_clocks(starts: pd.DataFrame | Array, controls: Any, dt: float) -> None:
    """Warn of a start that carries another time than the first row of the controls, which is the start."""
    firsts = [table["time"].iloc[0] for table in tables_of(controls)]
    if not (firsts and isinstance(starts, pd.DataFrame) and "time" in starts):
        return
    times = starts["time"].to_numpy(float)
    begins = np.broadcast_to(firsts, times.shape)
    k = int(np.argmax(np.abs(times - begins)))
    if abs(times[k] - begins[k]) > dt:
        warn(
            f"Got controls that begin at time {begins[k]:g} s, but start {k} is of "
            f"time {times[k]:g} s: the first row of each table counts as the start. Cut the "
            f"controls, table[table['time'] >= start].",
            stacklevel=3,
        )


def _as_list(source: Any) -> list:
    return list(source) if isinstance(source, list | tuple) else [source]
