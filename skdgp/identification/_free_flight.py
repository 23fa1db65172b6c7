"""Simulations of test flights with their recorded controls, and the errors of these."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import RATES, WIND
from skdgp._flight.clock import n_rows
from skdgp._flight.frames import wrapped
from skdgp._flight.smoothing import noise_level
from skdgp._flight.tables import FlightTable, numeric, unwrapped
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    SimulationWarning,
    Turbulence,
    as_aerodynamics,
    simulate,
)
from skdgp.identification._thresholds import THRESHOLDS

STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)  # of no wind and no heading


@dataclass(frozen=True)
class FreeFlightSettings:
    """Constants of the simulations of test flights."""

    # Step of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s.
    step: float = 0.05
    # Time over which measured states are smoothed by a parabola to start from [s], so that a
    # sample's noise is not flown (guess). Their mean lags a roll of 0.1 s by its whole size.
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


class FreeFlight:
    """Simulations of parts of test flights with the recorded controls, from their measured states.

    They fly in the estimated wind and gusts, else in still air, and start again every longest
    horizon. ``options`` are of `identify`: thrust, external_forces and horizons. Raises ValueError
    if the flights cannot be simulated.
    """

    def __init__(
        self,
        pipeline: Pipeline | Aerodynamics,
        aircraft: Aircraft,
        tables: Sequence[pd.DataFrame],
        options: Mapping[str, Any],
        settings: FreeFlightSettings = SETTINGS,
    ) -> None:
        loads = options["external_forces"]
        if loads:
            raise ValueError(f"the flights have loads that a simulation lacks: {', '.join(loads)}")
        common = set.intersection(*map(set, tables))
        lacking = [name for name in STATES if name not in common]
        if lacking:
            raise ValueError(
                f"the flights lack {', '.join(lacking)}, from which a simulation starts"
            )
        self.model = as_aerodynamics(pipeline)
        self.aircraft = aircraft
        self.tables = tables
        self.thrust = options["thrust"]
        self.settings = settings
        self.parts = _parts(tables, max(options["horizons"]), settings)

    def errors(self) -> pd.DataFrame:
        """Return how long the simulations follow the flights, by state.

        Columns: ``spread``, the standard deviation in the flights; ``limit``,
        `THRESHOLDS.error` times that, or three times the noise of the sensor if that
        is more; ``error``, root mean square at the end; ``lasts``, the time [s] at which the error
        passes the limit, at most ``horizon``; ``lasts_without_gusts``, the same for the part of the
        error that ``gusts`` [m/s], where they are not estimated, do not explain.
        """
        flown = self._simulated(self.model, self.parts)
        simulated = _by_state(flown, len(self.parts))
        elapsed = flown["time"].to_numpy()[: simulated.shape[-1]]
        measured = np.array([_at(elapsed, part.flown) for part in self.parts])
        # an infinite error where a simulation ended
        squares = (np.nan_to_num(simulated - measured, nan=np.inf) ** 2).mean(axis=0)
        by_gusts = np.zeros(squares.shape)
        gusts = 0.0
        turbulence = self._unknown_gusts()
        if turbulence is not None:
            by_gusts = self._squares_by(turbulence, simulated)
            gusts = float(np.sqrt(np.mean(np.square(turbulence.intensity))))
        n_parts = self.settings.parts
        edges = np.unique(np.arange(n_parts) * len(elapsed) // n_parts)
        total = _means_between(squares, edges)
        explained = _means_between(by_gusts, edges)
        ends = np.append(elapsed[edges], elapsed[-1])

        spread = _spread(self.tables)
        limit = np.maximum(THRESHOLDS.error * spread, 3 * _noise(self.tables))
        errors = pd.DataFrame({"spread": spread, "limit": limit}, index=[*STATES])
        errors["error"] = np.sqrt(total[:, -1])
        errors["lasts"] = _first_beyond(total, limit, ends)
        errors["lasts_without_gusts"] = _first_beyond(total - explained, limit, ends)
        errors["gusts"] = gusts
        errors["horizon"] = elapsed[-1]
        return errors

    def example(self) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
        """Return simulated paths of the part in the middle, their mean, and the flight."""
        middle = self.parts[len(self.parts) // 2]
        mean = self._simulated(self.model, [middle])
        paths = mean
        if self.model.is_uncertain:
            n_paths = self.settings.shown_paths
            paths = self._simulated(self.model, [middle], n_paths=n_paths)
        return paths, mean, middle.flown

    def _air(self, parts: Sequence[Part]) -> Air:
        """Return the density of parts of flights, and their estimated wind with its gusts, where it is known."""
        density = np.nanmedian(np.concatenate([part.flown["density"] for part in parts]))
        wind = None
        if all(_knows_wind(part.flown) for part in parts):
            wind = [part.flown[["time", *WIND]] for part in parts]
        return Air(wind, density=float(density))

    def _unknown_gusts(self) -> Turbulence | None:
        """Return the gusts that a simulation lacks, else the training flights' gusts; None if known."""
        if self._air(self.parts).wind is not None:
            return None
        named = [table.assign(flight=str(k)) for k, table in enumerate(self.tables)]
        try:
            return Turbulence.from_flight(pd.concat(named), self.aircraft.span)
        except ValueError:  # they are too short, or lack attitude or velocity
            return self.model.turbulence

    def _squares_by(self, turbulence: Turbulence, simulated: Array) -> Array:
        """Return the mean squares (n_states, n_times) by which drawn gusts move the simulations."""
        n_paths = max(1, self.settings.most_starts // len(self.parts))
        drawn = self._simulated(_mean_alone(self.model), self.parts, turbulence, n_paths=n_paths)
        paths = _by_state(drawn, n_paths * len(self.parts)).reshape(n_paths, *simulated.shape)
        return np.nan_to_num((paths - simulated) ** 2).mean(axis=(0, 1))

    def _simulated(
        self,
        model: Aerodynamics,
        parts: Sequence[Part],
        gusts: Turbulence | None = None,
        **options: Any,
    ) -> pd.DataFrame:
        """Return a simulation of parts of flights with their controls, in their air or drawn gusts."""
        air = self._air(parts)
        if gusts is not None:
            air = replace(air, gusts=gusts)
        not_inputs = [*STATES, *WIND, "flight", "psi"]
        inputs = [part.flown.drop(columns=not_inputs, errors="ignore") for part in parts]
        starts = pd.DataFrame([part.start for part in parts]).reset_index(drop=True)
        with warnings.catch_warnings():
            # an end is an error without bound
            warnings.simplefilter("ignore", SimulationWarning)
            return simulate(
                model,
                self.aircraft,
                starts,
                inputs,
                dt=self.settings.step,
                duration=min(float(table["time"].iloc[-1]) for table in inputs),
                thrust=self.thrust,
                air=air,
                **options,
            )


def _at(elapsed: Vector, part: pd.DataFrame) -> Array:
    """Return the measured states (n_states, n) at times of the simulation."""
    return np.array([np.interp(elapsed, part["time"], part[name]) for name in STATES])


def _by_state(flown: pd.DataFrame, n_runs: int) -> Array:
    """Return simulated states (n_runs, n_states, n_times)."""
    values = numeric(flown, STATES)
    return values.reshape(n_runs, -1, len(STATES)).swapaxes(1, 2)


def _means_between(squares: Array, edges: Indices) -> Array:
    """Return means (n_states, n_parts) over the parts of the time that begin at the edges."""
    counts = np.diff([*edges, squares.shape[1]])
    return np.add.reduceat(squares, edges, axis=1) / counts


def _spread(tables: Sequence[pd.DataFrame]) -> Vector:
    """Return the standard deviation of each state in the flights."""
    deviations = [np.nanstd(unwrapped(table, STATES), axis=0) for table in tables]
    return np.median(deviations, axis=0)


def _noise(tables: Sequence[pd.DataFrame]) -> Vector:
    """Return the noise of the sensor of each state, zero where flights are too short to show it."""
    levels = [noise_level(unwrapped(table, STATES), table["time"]) for table in tables]
    return np.nan_to_num(pd.DataFrame(levels).median())


def _first_beyond(squares: Array, limit: Vector, ends: Vector) -> Vector:
    """Return the time of each state at which its mean squared error passes the square of the limit."""
    late = squares > limit[:, None] ** 2
    first = np.where(late.any(axis=1), late.argmax(axis=1), -1)
    return ends[first]


def _mean_alone(model: Aerodynamics) -> Aerodynamics:
    """Return the model without its uncertainty."""
    mean = model.with_function(model, model.gradient)
    return replace(mean, sampler=lambda n_paths, random_state: (model, model.gradient))


def _knows_wind(table: pd.DataFrame) -> bool:
    """Return whether a table has the wind, and the heading that brings it into body axes."""
    return {*WIND, "psi"} <= {*table}


def _parts(
    tables: Sequence[pd.DataFrame], horizon: float, settings: FreeFlightSettings
) -> list[Part]:
    """Return parts of flights without gaps, of nearly equal length, spread over the flights."""
    segments: list[pd.DataFrame] = []
    for table in tables:
        segments += _segments(table)
    lengths = [np.ptp(segment["time"]) for segment in segments]
    if segments:
        horizon = min(horizon, float(np.median(lengths)) - settings.start / 2)
    parts: list[Part] = []
    if horizon > 2 * settings.step:
        for segment in segments:
            parts += _parts_of(segment, horizon, settings)
    if not parts:
        raise ValueError(
            f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known"
        )
    n = min(settings.most_starts, len(parts))
    chosen = np.linspace(0, len(parts) - 1, n).round().astype(int)
    return [parts[k] for k in np.unique(chosen)]


def _segments(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the segments of a flight without gaps, whose angles do not jump."""
    names = [name for name in (*STATES, "psi") if name in table]
    smooth = table.copy()
    smooth[names] = unwrapped(table, names)
    runs = FlightTable.of(smooth).segments
    return [smooth.iloc[run] for run in runs if n_rows(run) > 2]


def _parts_of(
    segment: pd.DataFrame, horizon: float, settings: FreeFlightSettings
) -> Iterator[Part]:
    """Yield the parts of a segment whose states are known; the start is smoothed around the first row."""
    half_start = settings.start / 2
    time = segment["time"].to_numpy(float)
    last = time[-1] - settings.least_part * horizon
    for begin in np.arange(time[0] + half_start, last, horizon):
        flown = segment[(time >= begin) & (time <= begin + horizon)]
        if len(flown) < 3 or not np.isfinite(numeric(flown, STATES)).all():
            continue
        names = [*STATES, "psi"] if _knows_wind(segment) else [*STATES]
        first = flown["time"].iloc[0]
        near = np.abs(time - first) <= half_start
        start: Any = pd.Series(
            _smoothed(time[near] - first, numeric(segment[near], names)), index=names
        )
        if "psi" in start:
            start["psi"] = wrapped(start["psi"])  # the flight turns more than once
        yield Part(start, flown.assign(time=flown["time"] - first).reset_index(drop=True))


def _smoothed(time: Vector, values: Matrix) -> Vector:
    """Return the values (k,) at time zero of parabolas through samples (n, k), of lines through two."""
    degree = min(2, len(time) - 1)
    return np.polyfit(time, values, degree)[-1]
