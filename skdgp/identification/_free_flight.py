"""Simulations of test flights with their recorded controls, and the errors of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.messages import without_warnings
from skdgp._compute.typing import Array, Vector
from skdgp._flight.channels import RATES, WIND
from skdgp._flight.clock import n_rows
from skdgp._flight.frames import wrapped
from skdgp._flight.smoothing import noise_level
from skdgp._flight.tables import FlightTable, unwrapped
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    SimulationWarning,
    Turbulence,
    as_aerodynamics,
    simulate,
)
from skdgp.plotting import TimeHistoryDisplay
from skdgp.report import THRESHOLDS

STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)  # of no wind and no heading
SHOWN_STATES = ("airspeed", "alpha", "phi", "theta", "p", "q")


@dataclass(frozen=True)
class FreeFlightSettings:
    """Constants of the simulations of test flights."""

    # Step of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s.
    step: float = 0.05
    # Time over which measured states are averaged to start from [s], so that a sample's noise is
    # not flown (guess).
    start: float = 0.25
    # Largest number of starts (guess).
    most_starts: int = 60
    # Parts of the simulated time over which errors are averaged (guess).
    parts: int = 20
    # Paths of the simulation that the report draws (guess).
    shown_paths: int = 30
    # Least duration over the longest horizon of a part of a flight (guess).
    least_part: float = 0.95


SETTINGS = FreeFlightSettings()


@dataclass(frozen=True)
class Part:
    """A part of a flight without gaps, whose time begins at zero, and the state that it starts from."""

    start: pd.Series
    flown: pd.DataFrame


def simulation_errors(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    tables: Sequence[pd.DataFrame],
    settings: dict,
    constants: FreeFlightSettings = SETTINGS,
) -> pd.DataFrame:
    """Return how long a simulation with the recorded controls follows flights from their measured states, by state.

    It flies in the estimated wind and gusts, else in still air, and is started again every longest
    horizon. Columns: ``spread``, the standard deviation in the flights; ``limit``,
    `skdgp.report.THRESHOLDS.error` times that, or three times the noise of the sensor if that is
    more; ``error``, root mean square at the end; ``lasts``, the time [s] at which the error passes
    the limit, at most ``horizon``; ``lasts_without_gusts``, the same for the part of the error that
    ``gusts`` [m/s], where they are not estimated, do not explain. Raises ValueError if it cannot be
    simulated.
    """
    if settings["external_forces"]:
        raise ValueError(
            "the flights have loads that a simulation lacks: "
            f"{', '.join(settings['external_forces'])}"
        )
    lacking = [name for name in STATES if not all(name in table for table in tables)]
    if lacking:
        raise ValueError(f"the flights lack {', '.join(lacking)}, from which a simulation starts")
    parts = _parts(tables, max(settings["horizons"]), constants)
    flown = _simulated(pipeline, aircraft, parts, settings, constants)
    elapsed = flown["time"].to_numpy()[: len(flown) // len(parts)]
    measured = np.array([_at(elapsed, part.flown) for part in parts])
    simulated = _by_state(flown, len(parts), len(elapsed))
    # an infinite error where a simulation ended
    squares = (np.nan_to_num(simulated - measured, nan=np.inf) ** 2).mean(axis=0)
    by_gusts = np.zeros(squares.shape)
    turbulence = _unknown_gusts(pipeline, aircraft, tables, parts)
    if turbulence is not None:
        n_paths = max(1, constants.most_starts // len(parts))
        model = _mean_alone(pipeline)
        drawn = _simulated(
            model, aircraft, parts, settings, constants, gusts=turbulence, n_paths=n_paths
        )
        paths = _by_state(drawn, n_paths * len(parts), len(elapsed))
        difference = paths.reshape(n_paths, *simulated.shape) - simulated
        by_gusts = np.nan_to_num(difference**2).mean(axis=(0, 1))

    # means over parts of the time
    edges = np.unique(np.arange(constants.parts) * len(elapsed) // constants.parts)
    counts = np.diff([*edges, len(elapsed)])
    total = np.add.reduceat(squares, edges, axis=1) / counts
    explained = np.add.reduceat(by_gusts, edges, axis=1) / counts
    ends = np.append(elapsed[edges], elapsed[-1])

    spread = np.median([np.nanstd(unwrapped(table, STATES), axis=0) for table in tables], axis=0)
    limit = np.maximum(THRESHOLDS.error * spread, 3 * _noise(tables))
    columns = {
        "spread": spread,
        "limit": limit,
        "error": np.sqrt(total[:, -1]),
        "lasts": _first_beyond(total, limit, ends),
        "lasts_without_gusts": _first_beyond(total - explained, limit, ends),
        "gusts": 0.0 if turbulence is None else _rms(turbulence.intensity),
        "horizon": elapsed[-1],
    }
    return pd.DataFrame(columns, index=list(STATES))


def simulated_flight(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    tables: Sequence[pd.DataFrame],
    settings: dict,
    constants: FreeFlightSettings = SETTINGS,
) -> TimeHistoryDisplay:
    """Return the simulation of the middle one of the parts of `simulation_errors`, with its band, and as flown."""
    parts = _parts(tables, max(settings["horizons"]), constants)
    middle = parts[len(parts) // 2]
    mean = _simulated(pipeline, aircraft, [middle], settings, constants)
    paths = mean
    if as_aerodynamics(pipeline).is_uncertain:
        n_paths = constants.shown_paths
        paths = _simulated(pipeline, aircraft, [middle], settings, constants, n_paths=n_paths)
    columns = [name for name in SHOWN_STATES if name in middle.flown]
    return TimeHistoryDisplay.from_trajectories(
        paths, middle.flown, mean=mean, columns=columns, ax=False
    )


def _at(elapsed: Vector, part: pd.DataFrame) -> Array:
    """Return the measured states (n_states, n) at times of the simulation."""
    return np.array([np.interp(elapsed, part["time"], part[name]) for name in STATES])


def _by_state(flown: pd.DataFrame, n_runs: int, n_times: int) -> Array:
    """Return simulated states (n_runs, n_states, n_times)."""
    values = flown[list(STATES)].to_numpy()
    return values.reshape(n_runs, n_times, len(STATES)).swapaxes(1, 2)


def _noise(tables: Sequence[pd.DataFrame]) -> Vector:
    """Return the noise of the sensor of each state, zero where flights are too short to show it."""
    levels = [noise_level(unwrapped(table, STATES), table["time"]) for table in tables]
    return np.nan_to_num(pd.DataFrame(levels).median())


def _first_beyond(squares: Array, limit: Vector, ends: Vector) -> Vector:
    """Return the time of each state at which its mean squared error passes the square of the limit."""
    late = squares > limit[:, None] ** 2
    never = np.ones(len(STATES), bool)
    return ends[np.column_stack([late, never]).argmax(axis=1)]


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _mean_alone(pipeline: Pipeline | Aerodynamics) -> Aerodynamics:
    """Return the model without its uncertainty: its paths differ by the gusts alone."""
    mean = as_aerodynamics(pipeline)
    certain: dict[str, Any] = dict.fromkeys(("drift", "narrowing", "function_errors"))
    return replace(
        mean,
        function=mean,
        slopes=mean.gradient,
        sampler=lambda n_paths, random_state: (mean, mean.gradient),
        **certain,
    )


def _unknown_gusts(
    pipeline: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    tables: Sequence[pd.DataFrame],
    parts: Sequence[Part],
) -> Turbulence | None:
    """Return the gusts that a simulation lacks, else the training flights' gusts; None if known."""
    if _air(parts).wind is not None:
        return None
    named = [table.assign(flight=str(k)) for k, table in enumerate(tables)]
    try:
        return Turbulence.from_flight(pd.concat(named), aircraft.span)
    except ValueError:  # they are too short, or lack attitude or velocity
        return as_aerodynamics(pipeline).turbulence


def _air(parts: Sequence[Part]) -> Air:
    """Return the density of parts of flights, and their estimated wind with its gusts, where it is known."""
    density = float(np.median(np.concatenate([part.flown["density"] for part in parts])))
    wind = None
    if all(_knows_wind(part.flown) for part in parts):
        wind = [part.flown[["time", *WIND]] for part in parts]
    return Air(wind, density=density)


def _knows_wind(table: pd.DataFrame) -> bool:
    """Return whether a table has the wind, and the heading that brings it into body axes."""
    return {*WIND, "psi"} <= {*table}


def _simulated(
    model: Pipeline | Aerodynamics,
    aircraft: Aircraft,
    parts: Sequence[Part],
    settings: dict,
    constants: FreeFlightSettings,
    gusts: Turbulence | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Return a simulation of parts of flights with their controls, in their air or drawn gusts."""
    air = _air(parts)
    if gusts is not None:
        air = replace(air, gusts=gusts)
    starts = pd.DataFrame([part.start for part in parts]).reset_index(drop=True)
    not_inputs = [*STATES, *WIND, "flight", "psi"]
    with without_warnings(SimulationWarning):  # an end is an error without bound
        return simulate(
            model,
            aircraft,
            starts,
            [part.flown.drop(columns=not_inputs, errors="ignore") for part in parts],
            dt=constants.step,
            duration=min(float(part.flown["time"].iloc[-1]) for part in parts),
            thrust=settings["thrust"],
            air=air,
            **options,
        )


def _parts(
    tables: Sequence[pd.DataFrame], horizon: float, constants: FreeFlightSettings
) -> list[Part]:
    """Return parts of flights without gaps, of nearly equal length, spread over the flights."""
    segments: list[pd.DataFrame] = []
    for table in tables:
        segments += _segments(table)
    half_start = constants.start / 2
    lengths = [np.ptp(segment["time"]) for segment in segments]
    horizon = min(horizon, float(np.median(lengths or [0.0])) - half_start)
    parts: list[Part] = []
    for segment in segments:
        time = segment["time"].to_numpy(float)
        last = time[-1] - constants.least_part * horizon
        for begin in np.arange(time[0] + half_start, last, horizon):
            rows = (time >= begin) & (time <= begin + horizon)
            if (
                rows.sum() > 2
                and np.isfinite(segment.loc[rows, list(STATES)].to_numpy(float)).all()
            ):
                parts.append(_part(segment, rows, half_start))
    if not parts or not horizon > 2 * constants.step:
        raise ValueError(
            f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known"
        )
    n = min(constants.most_starts, len(parts))
    chosen = np.linspace(0, len(parts) - 1, n).round().astype(int)
    return [parts[k] for k in np.unique(chosen)]


def _segments(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the segments of a flight without gaps, whose angles do not jump."""
    names = [name for name in (*STATES, "psi") if name in table]
    smooth = table.assign(**dict(zip(names, unwrapped(table, names).T, strict=True)))
    runs = FlightTable.of(smooth).segments
    return [smooth.iloc[run] for run in runs if n_rows(run) > 2]


def _part(segment: pd.DataFrame, rows: Vector, half_start: float) -> Part:
    """Return the rows of a segment as a part; its start is the mean state around their first."""
    flown = segment[rows]
    first = flown["time"].iloc[0]
    names = [*STATES, "psi"] if _knows_wind(segment) else [*STATES]
    near = np.abs(segment["time"] - first) <= half_start
    start = segment.loc[near, names].mean()
    if "psi" in start:
        start["psi"] = wrapped(start["psi"])  # the flight turns more than once
    return Part(start, flown.assign(time=flown["time"] - first).reset_index(drop=True))
