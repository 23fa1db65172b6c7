"""Flight mechanics of an identified model: trim, derivatives and modes, and how long a simulation follows flights."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from skdgp._flight.channels import COEFFICIENTS, RATES
from skdgp._flight.checks import unwrapped
from skdgp._flight.clock import flight_segments
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    SimulationWarning,
    as_aerodynamics,
    linearize,
    simulate,
    stability_derivatives,
    trim,
)
from skdgp.identification._evaluation import sensor_noise
from skdgp.report import THRESHOLDS, FlightMechanics

N_PATHS = 100  # functions that give the standard deviations: these have a relative error of 1 / sqrt(2 n), 7 %
STATES = ("airspeed", "alpha", "beta", "phi", "theta", *RATES)  # depend neither on wind nor on heading
FLIGHT_STEP = 0.05  # of the simulation [s]: Runge and Kutta's method is stable for modes of up to 55 rad/s
START = 0.25  # time over which measured states are averaged to start from [s], so that a sample's noise is not flown
MOST_STARTS, PARTS = 60, 20  # starts that are simulated, and parts of their time over which errors are averaged


def flight_mechanics(
    pipeline: Pipeline,
    aircraft: Aircraft,
    train: Sequence[pd.DataFrame],
    test: Sequence[pd.DataFrame],
    settings: dict,
    fit: dict,
) -> FlightMechanics:
    """Return trim, derivatives and modes at the median airspeed and density flown, and a simulation of test flights.

    Without a thrust the flight is a glide. Where there is no trim, derivatives are at the median of what was flown.
    """
    flown = pd.concat(train or test).median(numeric_only=True)
    thrust = _thrust(settings)
    conditions: dict[str, Any] = {"thrust": thrust, "air": Air(density=float(flown["density"]))}
    n_paths = N_PATHS if as_aerodynamics(pipeline).is_uncertain else 0
    drawn: dict[str, Any] = {"n_paths": n_paths, "random_state": 0, **conditions}
    found: dict[str, Any] = {}
    try:
        climb = None if thrust is None else 0.0
        found["trim"] = trim(pipeline, aircraft, float(flown["airspeed"]), climb=climb, **conditions)
        at: tuple = (found["trim"],)
    except ValueError:
        where = f"{flown['airspeed']:.3g} m/s"
        found["note"] = f"No steady flight was found at {where}: derivatives are at the median state, without modes."
        state, alpha = np.zeros(13), float(flown.get("alpha", 0.0))  # wings level
        state[[3, 5, 6]] = flown["airspeed"] * np.cos(alpha), flown["airspeed"] * np.sin(alpha), 1.0
        at = state, {str(name): float(value) for name, value in flown.items()}
    try:
        found["derivatives"] = stability_derivatives(pipeline, aircraft, *at, **drawn)
        if "least_squares_std" in fit:
            model = _least_squares(pipeline, fit)
            linear = stability_derivatives(model, aircraft, *at, n_paths=N_PATHS, **conditions)
            found["least_squares"] = linear[["value", "std"]]
        if "trim" in found:
            found["modes"] = linearize(pipeline, aircraft, *at, **drawn).modes()
    except ValueError as error:
        found["note"] = f"No derivatives: {error}"
    try:
        found["simulation"] = simulation_errors(pipeline, aircraft, test, settings)
    except ValueError as error:
        found["simulation_note"] = str(error)
    return FlightMechanics(**found)


def _thrust(settings: dict) -> Any:
    return None if settings["thrust"] in (None, "none") else "auto"


def _least_squares(pipeline: Pipeline, fit: dict) -> Aerodynamics:
    """Return the linear model of the same rows; its paths have slopes with the standard deviations of least squares."""
    known = as_aerodynamics(pipeline)
    weights, std = (
        np.array([[fit[table][name][column] for column in known.regressors] for name in COEFFICIENTS])
        for table in ("least_squares", "least_squares_std")
    )
    intercept = np.array([fit["least_squares"][name]["intercept"] for name in COEFFICIENTS])

    def values(X):
        return intercept + X @ weights.T

    def sampler(n_paths, random_state):
        drawn = weights + std * np.random.default_rng(random_state).standard_normal((n_paths, *weights.shape))
        return values, lambda X: np.broadcast_to(drawn[:, None], (*X.shape[:-1], *weights.shape))

    return Aerodynamics(
        values,
        known.regressors,
        gradient=lambda X: np.broadcast_to(weights, (*X.shape[:-1], *weights.shape)),
        sampler=sampler,
        span=known.span,
        chord=known.chord,
        mixing=known.mixing,
    )


def simulation_errors(
    pipeline: Pipeline, aircraft: Aircraft, tables: Sequence[pd.DataFrame], settings: dict
) -> pd.DataFrame:
    """Return how long a simulation with the recorded controls follows flights from their measured states, by state.

    It is in still air, and started again every longest horizon. Columns: ``spread``, the standard deviation in the
    flights; ``limit``, `skdgp.report.THRESHOLDS.error` times that, or three times the noise of the sensor if that is
    more; ``error``, root mean square at the end; ``lasts``, the time [s] at which the error passes the limit, at most
    ``horizon``. Raises ValueError if it cannot be simulated.
    """
    if settings["external_forces"]:
        raise ValueError(f"a simulation lacks the loads {', '.join(settings['external_forces'])} of the flights")
    lacking = [name for name in STATES if not all(name in table for table in tables)]
    if lacking:
        raise ValueError(f"the flights lack {', '.join(lacking)}, from which a simulation starts")
    starts, parts = _windows(tables, max(settings["horizons"]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)  # an end is an error without bound
        flown = simulate(
            pipeline,
            aircraft,
            starts,
            [part.drop(columns=[*STATES, "flight"], errors="ignore") for part in parts],
            dt=FLIGHT_STEP,
            duration=min(float(part["time"].iloc[-1]) for part in parts),
            thrust=_thrust(settings),
            air=Air(density=float(np.median(np.concatenate([part["density"] for part in parts])))),
        )
    each = [flown] if "start" not in flown else [part for _, part in flown.groupby("start", sort=True)]
    elapsed = each[0]["time"].to_numpy()
    measured = np.array([[np.interp(elapsed, part["time"], part[name]) for name in STATES] for part in parts])
    squares = np.nan_to_num(np.array([one[list(STATES)].to_numpy().T for one in each]) - measured, nan=np.inf) ** 2
    edges = np.unique(np.arange(PARTS) * len(elapsed) // PARTS)
    counts = np.diff([*edges, len(elapsed)])
    error = np.sqrt(np.add.reduceat(squares.mean(axis=0), edges, axis=1) / counts)
    spread = np.median([np.nanstd(unwrapped(table, STATES), axis=0) for table in tables], axis=0)
    noise = np.median([list(sensor_noise(table, STATES).values()) for table in tables], axis=0)
    limit = np.maximum(THRESHOLDS.error * spread, 3 * noise)
    late = np.column_stack([error > limit[:, None], np.ones(len(STATES), bool)])
    lasts = np.append(elapsed[edges], elapsed[-1])[late.argmax(axis=1)]
    columns = {"spread": spread, "limit": limit, "error": error[:, -1], "lasts": lasts, "horizon": elapsed[-1]}
    return pd.DataFrame(columns, index=list(STATES))


def _windows(tables: Sequence[pd.DataFrame], horizon: float) -> tuple[pd.DataFrame, list[pd.DataFrame]]:
    """Return starts, and parts of flights without gaps, of nearly equal length; their time begins at zero.

    Starts are means over `START`. Angles do not jump.
    """
    runs = []
    for table in tables:
        smooth = table.assign(**dict(zip(STATES, unwrapped(table, STATES).T, strict=True)))
        runs += [smooth.iloc[run] for run in flight_segments(table["time"].to_numpy(float)) if run.stop - run.start > 2]
    horizon = min(horizon, float(np.median([np.ptp(run["time"]) for run in runs] or [0.0])) - START / 2)
    found = []
    for run in runs:
        time = run["time"].to_numpy(float)
        for begin in np.arange(time[0] + START / 2, time[-1] - 0.95 * horizon, horizon):
            part = run[(time >= begin) & (time <= begin + horizon)]
            if len(part) > 2 and np.isfinite(part[list(STATES)].to_numpy(float)).all():
                first = part["time"].iloc[0]
                start = run.loc[np.abs(time - first) <= START / 2, list(STATES)].mean()
                found.append((start, part.assign(time=part["time"] - first).reset_index(drop=True)))
    if not found or not horizon > 2 * FLIGHT_STEP:
        raise ValueError(f"the flights have no part of {horizon:.3g} s in which {', '.join(STATES)} are known")
    chosen = np.unique(np.linspace(0, len(found) - 1, min(MOST_STARTS, len(found))).round().astype(int))
    starts, parts = zip(*(found[k] for k in chosen), strict=True)
    return pd.DataFrame(starts).reset_index(drop=True), list(parts)
