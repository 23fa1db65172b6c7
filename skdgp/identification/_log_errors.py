"""Errors of a learned function that its flights do not show: by the log, and by the thrust."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.statistics import remaining_error
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    COEFFICIENTS,
    HAT,
    RATES,
    SPECIFIC_FORCE,
    THRUST_COLUMNS,
    VANES,
)
from skdgp._flight.clock import Clock, median_step
from skdgp._flight.sensor_position import sensor_acceleration
from skdgp._flight.smoothing import differentiate
from skdgp._flight.tables import has_values, numeric, sensor_position, with_sensors_at
from skdgp.dynamics import (
    Aircraft,
    ScaleFactor,
    Servos,
    dynamic_pressure,
    propulsive_loads,
)
from skdgp.estimation import AIR_SENSOR_ERRORS, KNOWN_ARM, servo_output
from skdgp.inference import FunctionErrors, linear_weights

# Standard deviation of the time of a channel against the inertial sensors, by its motion between
# samples [steps of the log], and prior of this time [s] (guess)
CLOCK_STEPS = 0.1
CLOCK = 0.01
CHANNELS_OF_CLOCK = {"surfaces": ALL_SURFACES, "air": VANES}
"""Regressors by their group in `LagCorrector.lags_`."""


def fit_least_squares(regressors: pd.DataFrame, Y: Any) -> pd.DataFrame:
    """Return intercept and slopes (1 + d, P) of targets (n, P) by regressors (n, d), where they are observed."""
    targets = pd.DataFrame(Y)
    names = ["intercept", *regressors]
    return pd.DataFrame(linear_weights(regressors.to_numpy(), targets), names, [*targets])


def by_least_squares(regressors: pd.DataFrame, linear: pd.DataFrame) -> Matrix:
    """Return the coefficients (n, 6) at regressors (n, d) by `fit_least_squares`."""
    columns = regressors.assign(intercept=1.0)[linear.index]
    return columns.to_numpy() @ linear.to_numpy()


def regression_calibration(weights: Matrix, X: Matrix, noise_ratio: Vector) -> Matrix:
    r"""Return what is added to a function at X (n, d) for the mean coefficients of logged rows (n, P).

    Regressors of a logged row are estimates. The mean of y, given an estimate x, is not the
    function f(x) (regression calibration: Carroll et al. 2006, chapter 4). With b and A (1 + d, P), what
    known slopes have added to the function with its sign changed, it is

    .. math:: \mathrm{E}[y \mid x] = f(x) + \rho \, (b + A^T x),

    where :math:`\rho` (n,) is the variance of the noise of the regressors over its value in the training
    flights, at most one: more noise than that was never compared.
    """
    fraction = np.minimum(noise_ratio, 1.0)
    return fraction[:, None] * (weights[0] + X @ weights[1:])


def learned_errors(
    flights: pd.DataFrame,
    aircraft: Aircraft,
    regressors: pd.DataFrame,
    linear: pd.DataFrame,
    lags: pd.DataFrame | None,
    servos: Servos,
    airspeed_std: float,
) -> FunctionErrors:
    """Return the errors of coefficients that a model of regressors (n, d) learns from flights, by errors of the log.

    Errors are the times of surfaces and vanes, after the removal of ``lags`` (`LagCorrector.lags_`),
    lag and delay of ``servos``, the position of the inertial sensors, the airspeed, of relative error
    ``airspeed_std``, and the angles between the inertial sensors and the axes of the attitude. Without
    vanes all but the last are parameters of the filter. The model learns each change of the
    coefficients as the nearest linear function.
    """
    changes = _by_accelerations(flights, aircraft)
    if has_values(flights, *VANES):
        changes += _by_clocks(flights, regressors, linear, lags, servos)
        changes.append(airspeed_std * _by_airspeed(regressors, linear))
    return learned_as(changes, regressors)


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
    (weights,) = learned_as([missing], regressors).weights
    endings = ["", *(f"_{str(name).removesuffix(HAT)}" for name in regressors)]
    table = pd.DataFrame(weights, endings, [*COEFFICIENTS])
    added = {C + ending: table[C][ending] for C in COEFFICIENTS for ending in endings}
    return {"thrust": ScaleFactor(propeller.load_std, source="size of the propeller", added=added)}


def learned_as(changes: Sequence[Matrix], regressors: pd.DataFrame) -> FunctionErrors:
    """Return changes of the coefficients, (n, 6) each, as the nearest linear functions of regressors (n, d)."""
    X = regressors.to_numpy()
    centre = X.mean(axis=0)
    weights = [linear_weights(X - centre, change) for change in changes]
    return FunctionErrors(np.reshape(weights, (-1, X.shape[1] + 1, len(COEFFICIENTS))), centre)


def _by_clocks(
    table: pd.DataFrame,
    regressors: pd.DataFrame,
    linear: pd.DataFrame,
    lags: pd.DataFrame | None,
    servos: Servos,
) -> list[Matrix]:
    r"""Return the changes (n, 6) by one standard deviation of the time of each group of channels, and of the servos.

    A deflection has the transfer function :math:`e^{-\tau s} / (1 + T s)` from its command. An error of T and the
    opposite one of :math:`\tau` change it by

    .. math:: \dot\delta \, \sigma_\tau - \frac{\dot\delta}{1 + T s} \sigma_T.
    """
    time = table["time"].to_numpy(float)
    flight = table.get("flight")
    segments = Clock.of(time, flight).segments
    step = median_step(time, segments)
    rates = differentiate(regressors.to_numpy(), time, flight=flight, cutoff=None)
    changes = []
    for group, names in CHANNELS_OF_CLOCK.items():
        is_of_group = np.isin(regressors.columns, names)
        slopes = linear.loc[regressors.columns[is_of_group]].to_numpy()
        changes.append(clock_std(lags, group, step) * rates[:, is_of_group] @ slopes)
    if servos.lag_std:
        surfaces = regressors.columns.isin(ALL_SURFACES)
        of_surfaces = rates[:, surfaces]
        late = [servo_output(of_surfaces[run], servos.lag, step) for run in segments]
        error = servos.delay_std * of_surfaces - servos.lag_std * np.concatenate(late)
        changes.append(error @ linear.loc[regressors.columns[surfaces]].to_numpy())
    return changes


def _by_airspeed(regressors: pd.DataFrame, linear: pd.DataFrame) -> Matrix:
    """Return the change (n, 6) by an airspeed that is too large by its own size, to first order.

    Coefficients fall with its square, and non-dimensional rates with itself.
    """
    rates = regressors.filter([f"{name}{HAT}" for name in RATES])
    by_rates = rates.to_numpy() @ linear.loc[rates.columns].to_numpy()
    return by_rates - 2.0 * by_least_squares(regressors, linear)


def clock_std(lags: pd.DataFrame | None, group: str, step: float) -> float:
    """Return the error of the time of a group of channels after its lag is removed [s], root mean square.

    A lag of servos that is removed stands for a delay of their commands too.
    """
    error = CLOCK
    if lags is not None and group in lags.index:
        columns = ["lag", "applied", "std"]
        lag, applied, std = lags.loc[group, columns].to_numpy(float)
        if group == "surfaces" and "servos" in lags.index:
            of_servos, applied_to_servos, _ = lags.loc["servos", columns].to_numpy(float)
            lag, applied = lag - of_servos, applied - applied_to_servos
        if np.isfinite(std):
            left = lag - applied
            error = (
                float(np.hypot(left, std))
                if applied
                else remaining_error(float(lag), float(std), CLOCK)
            )
        elif applied:  # given
            error = 0.0
    return float(np.hypot(error, CLOCK_STEPS * step))


def _by_accelerations(table: pd.DataFrame, aircraft: Aircraft) -> list[Matrix]:
    """Return the changes (n, 6) by one standard deviation of position and angles of the inertial sensors.

    A rotation by a small vector e adds e x f to the specific force f.
    """
    accelerations = []
    if has_values(table, *VANES):
        is_known = np.isfinite(sensor_position(table)).all()
        errors = KNOWN_ARM if is_known else AIR_SENSOR_ERRORS
        stds = [errors[f"arm_{axis}"][1] for axis in "xyz"]
        for arm in np.diag(stds):
            accelerations.append(-sensor_acceleration(with_sensors_at(table, arm)))
    if has_values(table, "sensor_tilt", *SPECIFIC_FORCE):
        std = np.nanmax(table["sensor_tilt"])
        for axis in np.eye(3)[:2]:  # roll and pitch
            accelerations.append(np.cross(std * axis, numeric(table, SPECIFIC_FORCE)))
    load = dynamic_load(table, aircraft)[:, None]
    forces = [aircraft.mass * acceleration / load for acceleration in accelerations]
    return [np.hstack([force, np.zeros_like(force)]) for force in forces]


def dynamic_load(table: pd.DataFrame, aircraft: Aircraft) -> Vector:
    """Return the dynamic pressure times the wing area, qbar S (n,) [N]."""
    qbar = dynamic_pressure(table["airspeed"], table["density"])
    return np.asarray(qbar) * aircraft.wing_area
