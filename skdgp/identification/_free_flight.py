"""Simulations of test flights with their recorded controls, and the errors of these."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._compute.typing import Matrix, Vector
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
    as_aerodynamics,
    simulate,
)
from skdgp.identification._evaluate import THRESHOLDS

STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)  # of no wind and no heading
# of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s
STEP = 0.05
MOST_STARTS = 60  # guess
TIMES = 20  # parts of the simulated time over which errors are averaged (guess)
LEAST_PART = 0.95  # least duration of a part of a flight over the horizon (guess)


@dataclass(frozen=True)
class Part:
    """A part of a flight without gaps, whose time begins at zero, and the state that it starts from."""

    start: pd.Series
    flown: pd.DataFrame


class FreeFlight:
    """Simulations of parts of test flights with the recorded controls, from their measured states.

    They fly in the estimated wind and gusts, else in still air, and start again every
    horizon. ``options`` are of `identify`: thrust, external_forces and horizon. Raises ValueError
    if the flights cannot be simulated.
    """

    def __init__(
        self,
        pipeline: Pipeline | Aerodynamics,
        aircraft: Aircraft,
        tables: Sequence[pd.DataFrame],
        options: Mapping[str, Any],
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
        self.parts = _parts(tables, options["horizon"])
        self.knows_wind = all(_knows_wind(part.flown) for part in self.parts)

    def errors(self) -> pd.DataFrame:
        """Return how long the simulations follow the flights, by state.

        Columns: ``spread``, the standard deviation in the flights; ``limit``,
        `THRESHOLDS.error` times that, or three times the noise of the sensor if that
        is more; ``error``, root mean square at the end; ``lasts``, the time [s] at which the error
        passes the limit, at most ``horizon``; ``wind_known``, whether the wind and its gusts were
        estimated.
        """
        flown = self._simulated()
        simulated = numeric(flown, STATES).reshape(len(self.parts), -1, len(STATES))
        elapsed = flown["time"].to_numpy()[: simulated.shape[1]]
        measured = np.array([_at(elapsed, part.flown) for part in self.parts])
        # an infinite error where a simulation ended
        squares = (np.nan_to_num(simulated - measured, nan=np.inf) ** 2).mean(axis=0)
        edges = np.unique(np.arange(TIMES) * len(elapsed) // TIMES)
        counts = np.diff([*edges, len(elapsed)])
        means = np.add.reduceat(squares, edges, axis=0) / counts[:, None]
        ends = np.append(elapsed[edges], elapsed[-1])

        spreads = [np.nanstd(unwrapped(table, STATES), axis=0) for table in self.tables]
        spread = np.median(spreads, axis=0)
        # no noise of flights that are too short to show it
        levels = [noise_level(table, STATES) for table in self.tables]
        noise = np.nan_to_num(pd.DataFrame(levels).median())
        limit = np.maximum(THRESHOLDS.error * spread, 3 * noise)
        late = means > limit**2
        first = np.where(late.any(axis=0), late.argmax(axis=0), -1)
        errors = pd.DataFrame({"spread": spread, "limit": limit}, index=[*STATES])
        errors["error"] = np.sqrt(means[-1])
        errors["lasts"] = ends[first]
        errors["horizon"] = elapsed[-1]
        errors["wind_known"] = self.knows_wind
        return errors

    def _simulated(self) -> pd.DataFrame:
        """Return a simulation of the parts with their controls, in their air."""
        parts = self.parts
        density = np.nanmedian(np.concatenate([part.flown["density"] for part in parts]))
        wind = [part.flown[["time", *WIND]] for part in parts] if self.knows_wind else None
        not_inputs = [*STATES, *WIND, "flight", "psi"]
        inputs = [part.flown.drop(columns=not_inputs, errors="ignore") for part in parts]
        starts = pd.DataFrame([part.start for part in parts]).reset_index(drop=True)
        with warnings.catch_warnings():
            # an end is an error without bound
            warnings.simplefilter("ignore", SimulationWarning)
            return simulate(
                self.model,
                self.aircraft,
                starts,
                inputs,
                dt=STEP,
                duration=min(float(table["time"].iloc[-1]) for table in inputs),
                thrust=self.thrust,
                air=Air(wind, density=float(density)),
            )


def _at(elapsed: Vector, part: pd.DataFrame) -> Matrix:
    """Return the measured states (n, n_states) at times of the simulation."""
    columns = [np.interp(elapsed, part["time"], part[name]) for name in STATES]
    return np.column_stack(columns)


def _knows_wind(table: pd.DataFrame) -> bool:
    """Return whether a table has the wind, and the heading that brings it into body axes."""
    return {*WIND, "psi"} <= {*table}


def _parts(tables: Sequence[pd.DataFrame], horizon: float) -> list[Part]:
    """Return parts of flights without gaps, of nearly equal length, spread over the flights."""
    segments: list[pd.DataFrame] = []
    for table in tables:
        segments += _segments(table)
    lengths = [np.ptp(segment["time"]) for segment in segments]
    if segments:
        horizon = min(horizon, float(np.median(lengths)))
    parts: list[Part] = []
    if horizon > 2 * STEP:
        for segment in segments:
            parts += _parts_of(segment, horizon)
    if not parts:
        raise ValueError(
            f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known"
        )
    chosen = np.linspace(0, len(parts) - 1, min(MOST_STARTS, len(parts))).round().astype(int)
    return [parts[k] for k in chosen]


def _segments(table: pd.DataFrame) -> list[pd.DataFrame]:
    """Return the segments of a flight without gaps, whose angles do not jump."""
    names = [name for name in (*STATES, "psi") if name in table]
    smooth = table.copy()
    smooth[names] = unwrapped(table, names)
    runs = FlightTable.of(smooth).segments
    return [smooth.iloc[run] for run in runs if n_rows(run) > 2]


def _parts_of(segment: pd.DataFrame, horizon: float) -> Iterator[Part]:
    """Yield the parts of a segment whose states are known."""
    names = [*STATES, "psi"] if _knows_wind(segment) else [*STATES]
    time = segment["time"].to_numpy(float)
    for begin in np.arange(time[0], time[-1] - LEAST_PART * horizon, horizon):
        flown = segment[(time >= begin) & (time <= begin + horizon)]
        if len(flown) < 3 or not np.isfinite(numeric(flown, STATES)).all():
            continue
        flown = flown.assign(time=flown["time"] - flown["time"].iloc[0]).reset_index(drop=True)
        start = flown.loc[0, names].copy()
        if "psi" in start:
            start["psi"] = wrapped(start["psi"])  # the flight turns more than once
        yield Part(start, flown)
