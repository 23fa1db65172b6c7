"""Flight mechanics of an identified model: trim, derivatives, modes, and simulations of its test flights."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import RATES, WIND
from skdgp._flight.clock import n_rows
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import wrapped
from skdgp._flight.smoothing import noise_level
from skdgp._flight.tables import FlightTable, by_name, interpolated, numeric, unwrapped
from skdgp.dynamics import (
    ATTITUDE,
    VELOCITY,
    Aerodynamics,
    Air,
    Aircraft,
    SimulationWarning,
    Trim,
    air_velocity,
    as_aerodynamics,
    euler_to_quaternion,
    linearize,
    simulate,
    stability_derivatives,
    trim,
)
from skdgp.identification._evaluate import THRESHOLDS

# States of simulations, of no wind and no heading
STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)
# of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s
STEP = 0.05
MOST_STARTS = 60  # guess
TIMES = 20  # parts of the simulated time over which errors are averaged (guess)
LEAST_PART = 0.95  # least duration of a part of a flight over the horizon (guess)
# Functions that give standard deviations of modes with a relative error of 1 / sqrt(2 n), 5 %
N_PATHS = 200


@dataclass(frozen=True, kw_only=True)
class FlightMechanics:
    """Trim, derivatives and modes in the middle of the training range.

    Parameters
    ----------
    trim : Trim, optional
        None where there is no steady flight.
    derivatives : DataFrame
        Of `skdgp.dynamics.stability_derivatives`.
    modes : DataFrame, optional
        Of `skdgp.dynamics.LinearModel.modes`.
    simulation : DataFrame, optional
        By state ``spread``, ``limit``, ``error`` at the end, how long it ``lasts`` and its
        ``horizon`` [s], and whether the wind with its gusts was known (``wind_known``).
    notes : tuple of Finding
        Why trim, modes, derivatives or the simulation are missing.
    """

    trim: Trim | None = None
    derivatives: pd.DataFrame = field(default_factory=pd.DataFrame)
    modes: pd.DataFrame | None = None
    simulation: pd.DataFrame | None = None
    notes: tuple[Finding, ...] = ()


def flight_mechanics(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    conditions: Mapping[str, float],
    flights: Sequence[pd.DataFrame],
    options: Mapping[str, Any],
) -> FlightMechanics:
    """Return trim, derivatives and modes at the ``conditions`` of the fit, and a simulation of test flights.

    Without a thrust the flight is a glide. Where there is no trim, derivatives are at the conditions.
    """
    airspeed, thrust = conditions["airspeed"], options["thrust"]
    given: dict[str, Any] = {"thrust": thrust, "air": Air(density=conditions["density"])}
    notes = []
    steady: Any = None
    try:
        climb = None if thrust is None else 0.0
        altitude = float(np.nan_to_num(conditions.get("altitude", 0.0)))
        steady = trim(pipeline, aircraft, airspeed, altitude=altitude, climb=climb, **given)
        at: tuple[Array, Any] = steady.state, steady.controls
    except ValueError:
        notes.append(Finding(Code.NO_TRIM, airspeed=airspeed))
        at = _median_state(conditions), conditions
    computed: dict[str, Any] = {}
    try:
        derivatives = stability_derivatives(pipeline, aircraft, *at, **given)
        modes = None
        if steady is not None:
            n_paths = N_PATHS if as_aerodynamics(pipeline).is_uncertain else 0
            modes = linearize(pipeline, aircraft, *at, n_paths=n_paths, **given).modes()
        computed = {"derivatives": derivatives, "modes": modes}
    except ValueError as error:
        notes.append(Finding(Code.NO_DERIVATIVES, error=str(error)))
    try:
        computed["simulation"] = simulation_errors(pipeline, aircraft, flights, options)
    except ValueError as error:
        notes.append(Finding(Code.NOT_SIMULATED, error=str(error)))
    return FlightMechanics(trim=steady, notes=tuple(notes), **computed)


def _median_state(conditions: Mapping[str, float]) -> Array:
    """Return the median state with level wings."""
    state = np.zeros(13)
    state[VELOCITY] = air_velocity(conditions["airspeed"], conditions.get("alpha", 0.0), 0.0)
    state[ATTITUDE] = euler_to_quaternion(0.0, 0.0, 0.0)
    return state


def simulation_errors(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    tables: Sequence[pd.DataFrame],
    options: Mapping[str, Any],
) -> pd.DataFrame:
    """Return how long simulations of test flights with the recorded controls follow them, by state.

    They fly in the estimated wind and gusts, else in still air, and start from the measured state again
    every horizon. ``options`` are of `identify`: thrust and horizon. Raises ValueError
    if the flights cannot be simulated.

    Columns: ``spread``, the standard deviation in the flights; ``limit``,
    `THRESHOLDS.error` times that, or three times the noise of the sensor if that
    is more; ``error``, root mean square at the end; ``lasts``, the time [s] at which the error
    passes the limit, at most ``horizon``; ``wind_known``, whether the wind and its gusts were
    estimated.
    """
    common = set.intersection(*map(set, tables))
    lacking = [name for name in STATES if name not in common]
    if lacking:
        raise ValueError(f"the flights lack {', '.join(lacking)}, from which a simulation starts")
    angles = [name for name in (*STATES, "psi") if name in common]
    smooth = [table.assign(**by_name(angles, unwrapped(table, angles))) for table in tables]
    parts = _parts(smooth, options["horizon"])
    wind_known = {*WIND, "psi"} <= common
    flown = _simulated(pipeline, aircraft, parts, options["thrust"], wind_known)
    simulated = numeric(flown, STATES).reshape(len(parts), -1, len(STATES))
    elapsed = flown["time"].to_numpy()[: simulated.shape[1]]
    measured = np.array(
        [interpolated(elapsed, part["time"].to_numpy(), numeric(part, STATES)) for part in parts]
    )
    # an infinite error where a simulation ended
    squares = (np.nan_to_num(simulated - measured, nan=np.inf) ** 2).mean(axis=0)
    n = min(TIMES, len(elapsed))
    means = np.array([rows.mean(axis=0) for rows in np.array_split(squares, n)])
    begins = [times[0] for times in np.array_split(elapsed, n)]

    spread, limit = _limits(smooth)
    # an error that is small in every interval lasts to the end
    late = np.vstack([means > limit**2, np.ones(len(STATES), bool)])
    ends = np.append(begins, elapsed[-1])
    columns = {
        "spread": spread,
        "limit": limit,
        "error": np.sqrt(means[-1]),
        "lasts": ends[late.argmax(axis=0)],
        "horizon": elapsed[-1],
        "wind_known": wind_known,
    }
    return pd.DataFrame(columns, index=[*STATES])


def _limits(tables: Sequence[pd.DataFrame]) -> tuple[Vector, Vector]:
    """Return the spread of each state in flights, and the largest error of a simulation that follows them."""
    spread = np.median([np.nanstd(numeric(table, STATES), axis=0) for table in tables], axis=0)
    # no noise of flights that are too short to show it
    levels = pd.DataFrame([noise_level(table, STATES) for table in tables])
    return spread, np.maximum(THRESHOLDS.error * spread, 3 * np.nan_to_num(levels.median()))


def _simulated(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    parts: Sequence[pd.DataFrame],
    thrust: str | None,
    wind_known: bool,
) -> pd.DataFrame:
    """Return a simulation of parts of flights with their controls, in their air."""
    density = np.nanmedian(np.concatenate([part["density"] for part in parts]))
    wind = [part[["time", *WIND]] for part in parts] if wind_known else None
    not_inputs = [*STATES, *WIND, "flight", "psi"]
    inputs = [part.drop(columns=not_inputs, errors="ignore") for part in parts]
    first = pd.concat([part[:1] for part in parts], ignore_index=True)
    starts = first[[*STATES]]
    if wind_known:  # the flight turns more than once
        starts = starts.assign(psi=wrapped(first["psi"].to_numpy()))
    with warnings.catch_warnings():
        # an end is an error without bound
        warnings.simplefilter("ignore", SimulationWarning)
        return simulate(
            as_aerodynamics(pipeline),
            aircraft,
            starts,
            inputs,
            dt=STEP,
            duration=float(min(table["time"].iloc[-1] for table in inputs)),
            thrust=thrust,
            air=Air(wind, density=float(density)),
        )


def _parts(tables: Sequence[pd.DataFrame], horizon: float) -> list[pd.DataFrame]:
    """Return parts of flights without gaps whose states are known, of nearly equal length, spread over the flights.

    Their time begins at zero.
    """
    segments = []
    for table in tables:
        runs = FlightTable.of(table).segments
        segments += [table.iloc[run] for run in runs if n_rows(run) > 2]
    if segments:
        horizon = min(horizon, float(np.median([np.ptp(part["time"]) for part in segments])))
    parts: list[pd.DataFrame] = []
    for segment in segments if horizon > 2 * STEP else ():
        time = segment["time"]
        for begin in np.arange(time.iloc[0], time.iloc[-1] - LEAST_PART * horizon, horizon):
            part = segment[time.between(begin, begin + horizon)]
            if len(part) > 2 and np.isfinite(numeric(part, STATES)).all():
                elapsed = part["time"] - part["time"].iloc[0]
                parts.append(part.assign(time=elapsed).reset_index(drop=True))
    if not parts:
        raise ValueError(
            f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known"
        )
    chosen = np.linspace(0, len(parts) - 1, min(MOST_STARTS, len(parts))).round().astype(int)
    return [parts[k] for k in chosen]
