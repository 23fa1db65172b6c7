"""Errors of a flight log that its flights leave, and their effect on the learned coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression

from skdgp._compute.statistics import remaining_error
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    COEFFICIENTS,
    HAT,
    SENSOR_POSITION,
    SPECIFIC_FORCE,
    SURFACES,
    THRUST_COLUMNS,
    VANES,
)
from skdgp._flight.clock import Clock, median_step
from skdgp._flight.sensor_position import acceleration_by_rotation, rotation, sensor_position
from skdgp._flight.smoothing import differentiate
from skdgp._flight.tables import has_values, numeric
from skdgp.dynamics import PRESSURE, Aircraft, ScaleFactor, dynamic_pressure, propulsive_loads
from skdgp.estimation import AIR_SENSOR_ERRORS, KNOWN_ARM
from skdgp.identification._least_squares import linear_terms

# Standard deviation of the time of a channel against the inertial sensors, by its motion between
# samples [steps of the log], and prior of this time [s] (guess)
CLOCK_STEPS = 0.1
CLOCK = 0.01
CHANNELS_OF_CLOCK = {"surfaces": SURFACES, "air": VANES}
"""Regressors by their group in `LagCorrector.lags_`."""


def learned_errors(
    flights: pd.DataFrame,
    aircraft: Aircraft,
    regressors: pd.DataFrame,
    least_squares: Mapping[str, Mapping[str, float]],
    lags: pd.DataFrame | None,
    airspeed_std: float,
) -> dict[str, ScaleFactor]:
    """Return the errors of coefficients learned from flights, by errors of the log.

    Errors are the times of surfaces and vanes, after the removal of ``lags`` (`LagCorrector.lags_`),
    the position of the inertial sensors, the airspeed, of relative error ``airspeed_std``, and the
    angles between the inertial sensors and the axes of the attitude. Without vanes all but the last
    are parameters of the filter.
    """
    added = _by_accelerations(flights, aircraft, regressors)
    if has_values(flights, *VANES):
        added = _by_clocks(flights, regressors, least_squares, lags) | added
    factors = {name: ScaleFactor(1.0, added=effect) for name, effect in added.items()}
    if airspeed_std and has_values(flights, *VANES):
        factors["airspeed"] = ScaleFactor(2 * airspeed_std, {PRESSURE: 1.0})
    return factors


def thrust_errors(
    flights: pd.DataFrame, aircraft: Aircraft, regressors: pd.DataFrame
) -> dict[str, ScaleFactor]:
    """Return the errors of coefficients learned from flights, by the error of the propeller's thrust.

    If the thrust is T (1 + e), coefficients lack e T / (qbar S).
    """
    propeller = aircraft.propeller
    is_unused = not {*THRUST_COLUMNS}.isdisjoint(flights)
    if is_unused or propeller is None or not propeller.load_std:
        return {}
    force, moment = propulsive_loads(flights, aircraft)
    missing = (
        -np.hstack([force, moment / aircraft.moment_lengths])
        / dynamic_load(flights, aircraft)[:, None]
    )
    added = learned_as(missing, regressors)
    return {"thrust": ScaleFactor(propeller.load_std, source="size of the propeller", added=added)}


def learned_as(changes: Matrix, regressors: pd.DataFrame) -> dict[str, float]:
    """Return what changes of the coefficients (n, 6) add to these at their mean, and to their slopes.

    A model learns the changes as the nearest linear function of its regressors.
    """
    is_sampled = np.isfinite(changes).all(axis=1) & np.isfinite(regressors).all(axis=1)
    changes = changes[is_sampled]
    linear = LinearRegression().fit(regressors[is_sampled], changes)
    added = dict(zip(COEFFICIENTS, changes.mean(axis=0).tolist(), strict=True))
    for name, slopes in zip(regressors, linear.coef_.T.tolist(), strict=True):
        for coefficient, slope in zip(COEFFICIENTS, slopes, strict=True):
            added[f"{coefficient}_{str(name).removesuffix(HAT)}"] = slope
    return added


def _by_clocks(
    table: pd.DataFrame,
    regressors: pd.DataFrame,
    least_squares: Mapping[str, Mapping[str, float]],
    lags: pd.DataFrame | None,
) -> dict[str, dict[str, float]]:
    """Return the effects of one standard deviation of the time of each group of channels."""
    time = table["time"].to_numpy(float)
    flight = table.get("flight")
    step = median_step(time, Clock.of(time, flight).segments)
    _, slopes = linear_terms(least_squares)
    rates = differentiate(regressors.to_numpy(), time, flight=flight, cutoff=None)
    effects = {}
    for group, names in CHANNELS_OF_CLOCK.items():
        is_of_group = np.isin(regressors.columns, names)
        changes = clock_std(lags, group, step) * rates[:, is_of_group] @ slopes[is_of_group]
        effects[f"time of {group}"] = learned_as(changes, regressors)
    return effects


def clock_std(lags: pd.DataFrame | None, group: str, step: float) -> float:
    """Return the error of the time of a group of channels after its lag is removed [s], root mean square."""
    least = CLOCK_STEPS * step
    if lags is None or group not in lags.index:
        return float(np.hypot(CLOCK, least))
    lag, std, applied = map(float, lags.loc[group, ["lag", "std", "applied"]])
    if not np.isfinite(std):  # given, or not shown
        return least if applied else float(np.hypot(CLOCK, least))
    return float(np.hypot(remaining_error(lag, std, CLOCK, applied != 0), least))


def _by_accelerations(
    table: pd.DataFrame, aircraft: Aircraft, regressors: pd.DataFrame
) -> dict[str, dict[str, float]]:
    """Return the effects of one standard deviation of position and angles of the inertial sensors.

    A rotation by a small vector e adds e x f to the specific force f.
    """
    accelerations = {}
    if has_values(table, *VANES):
        is_known = np.isfinite(sensor_position(table)).all()
        errors = KNOWN_ARM if is_known else AIR_SENSOR_ERRORS
        spin, rates = rotation(table)
        for axis, name in zip(np.eye(3), SENSOR_POSITION, strict=True):
            _, std = errors[f"arm_{name[-1]}"]
            by_arm = acceleration_by_rotation(spin, rates, np.broadcast_to(std * axis, rates.shape))
            accelerations[name.replace("_", " ")] = -by_arm
    if has_values(table, "sensor_tilt", *SPECIFIC_FORCE):
        std = np.nanmax(table["sensor_tilt"])
        for axis, name in zip(np.eye(3), ("roll", "pitch"), strict=False):
            by_tilt = np.cross(std * axis, numeric(table, SPECIFIC_FORCE))
            accelerations[f"{name} of the inertial sensors"] = by_tilt
    load = dynamic_load(table, aircraft)[:, None]
    effects = {}
    for name, acceleration in accelerations.items():
        force = aircraft.mass * acceleration / load
        effects[name] = learned_as(np.hstack([force, np.zeros_like(force)]), regressors)
    return effects


def dynamic_load(table: pd.DataFrame, aircraft: Aircraft) -> Vector:
    """Return the dynamic pressure times the wing area, qbar S (n,) [N]."""
    qbar = dynamic_pressure(table["airspeed"], table["density"])
    return np.asarray(qbar) * aircraft.wing_area
