"""Covariance of the parameters of the filter-error method, in named steps, and the smoothed motion of the air.

Errors of the states, given all samples and the parameters, and errors of the parameters are in the standard
deviations of the motion. With slopes G of air data, rates and wind by the states of covariance P, and their total
derivatives s by the parameters of covariance C, the variances are diag(G P G^T + s C s^T).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, WIND
from skdgp._flight.frames import air_data, air_data_slopes, rotation_to_euler
from skdgp.estimation._air_fit import AirFit, FittedRecord
from skdgp.estimation._air_linearization import (
    CONSTANTS,
    GUST,
    N_STATES,
    RATE_STATES,
    air_velocity,
    air_velocity_slopes,
    means_of_neighbours,
    slopes_by_constants,
)
from skdgp.estimation._air_parameters import (
    ARM,
    SENSOR_CONSTANTS,
    STATE_TERMS,
    WINDS,
    stacked,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import parameter_slopes, smoothed

ESTIMATED = (*AIR_DATA, *RATES, *WIND)
"""Smoothed columns, each with its standard deviation."""
OF_AIR_DATA = slice(0, 3)
OF_RATES = slice(3, 6)
OF_WIND = slice(6, 9)
PATH_COLUMNS = (*SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY)
"""Columns of the path over the ground."""
COLUMNS = (*ESTIMATED, *(f"{name}_std" for name in ESTIMATED), *PATH_COLUMNS)


def with_variances(covariance: Matrix, variance: Vector) -> Matrix:
    """Return the covariance with other variances (p,), and its own correlations."""
    scale = np.sqrt(variance / np.diag(covariance))
    return scale[:, None] * covariance * scale


def sandwich(information: Matrix, variation: Matrix) -> Matrix:
    r"""Return the covariance of estimates whose score has the covariance :math:`B`, and not the information A.

    The variances are those of :math:`A^{-1} B A^{-1}` (White 1982), or of :math:`A^{-1}` where these are larger: a
    model that lacks an effect has innovations that repeat while it acts.
    """
    covariance: Any = np.linalg.inv(information)
    varied = covariance @ variation @ covariance
    return with_variances(covariance, np.maximum(np.diag(covariance), np.diag(varied)))


def without_estimate(offset: Vector, prior_std: Vector) -> Matrix:
    """Return the covariance where the search hardly began: the prior's, and the distance from its mean."""
    return np.diag(prior_std**2) + np.outer(offset, offset)


def spread_of(history: list[Vector]) -> Matrix:
    """Return the mean square distance of the last passes of a search (k, p) from its end.

    Errors of a search that did not converge.
    """
    offsets = np.array(history) - history[-1]
    return offsets.T @ offsets / len(offsets)


def misfit_of(constants: Vector) -> float:
    """Return the root mean square of constants in their prior standard deviations, at least one.

    Effects that the model lacks shift constants whose priors hold for any flight; by this ratio all
    standard deviations are too small (Birge 1932).
    """
    return max(1.0, float(np.sqrt(np.mean(constants**2))))


def inflate(covariance: Matrix, factor: float) -> Matrix:
    """Return the covariance of errors that are larger by a factor."""
    return covariance * factor**2


def add_model_error(covariance: Matrix, derivatives: Vector, fraction: float) -> Matrix:
    """Return the covariance with independent errors of the derivatives, the first parameters, by a linear model."""
    n = len(derivatives)
    total = covariance.copy()
    total[:n, :n] += np.diag((fraction * derivatives) ** 2)
    return total


def add_attenuation(
    covariance: Matrix, values: Vector, prior_std: Vector, fraction: Vector
) -> Matrix:
    r"""Return the covariance where a ``fraction`` f (p,) of each parameter's evidence is error of the sensors.

    A slope by a term of which the fraction f is error seems to be flatter by up to f (Fuller 1987,
    section 1.1): of the estimate :math:`\hat\theta` with the variance :math:`\sigma^2`,

    .. math:: f^2 \mathrm E \theta^2, \quad
              \mathrm E \theta^2 = \min\left(s^2, (\hat\theta^2 + \sigma^2) / (1 - f)^2\right),

    is added to the part :math:`1 - f^2` of the variance. Where all is error, this is the prior
    variance :math:`s^2`.
    """
    variance = np.diag(covariance)
    motion = np.maximum(1 - fraction, np.finfo(float).eps)
    mean_square = np.minimum(prior_std**2, (values**2 + variance) / motion**2)
    weight = np.sqrt(1 - fraction**2)
    return weight[:, None] * covariance * weight + np.diag(fraction**2 * mean_square)


def add_delay_error(covariance: Matrix, information: Matrix, place: int, std: float) -> Matrix:
    r"""Return the covariance with the error of a delay of the servos, a parameter that keeps its value.

    It moves the others by :math:`-A^{-1} a` times as much (Schmidt 1966), with their information A and the column
    a of the delay.
    """
    others = np.arange(len(information)) != place
    by_delay = np.ones(len(information))
    within = information[np.ix_(others, others)]
    by_delay[others] = -np.linalg.solve(within, information[others, place])
    total: Matrix = covariance + std**2 * np.outer(by_delay, by_delay)
    return total


def unfinished_covariance(fit: AirFit, covariance: Matrix) -> Matrix:
    """Return the covariance of a search that did not converge: wider, by its last passes too, or the prior's.

    No parameter is known less than without its estimate. Slopes by alpha and beta are not known better, as a
    search may end at gusts that are too large with slopes that are too small.
    """
    unknown = without_estimate(fit.x - fit.parameters.mean, fit.parameters.std)
    # last passes of a search that did not converge, whose spread is an error
    last = fit.history[-15:]
    if len(last) == len(fit.history):
        return unknown
    # factor of the standard deviations of such a search; trials on flights with vibration
    covariance = inflate(covariance, 2.0) + spread_of(last)
    variance = np.minimum(np.diag(covariance), np.diag(unknown))
    by_angles = np.flatnonzero(fit.layout.is_by("alpha", "alpha2", "beta"))
    variance[by_angles] = np.diag(unknown)[by_angles]
    return with_variances(covariance, variance)


def misfit_of_sensors(fit: AirFit) -> float:
    """Return the misfit of the sensors' constants, or of their position if that is larger."""
    offset = (fit.x - fit.parameters.mean) / fit.parameters.std
    groups = [fit.parameters.places_of_all(names) for names in (SENSOR_CONSTANTS, ARM)]
    return max(misfit_of(offset[places]) for places in groups)


def widened(covariance: Matrix, fit: AirFit, misfit: float) -> Matrix:
    """Return the covariance with the misfit of sensors, and errors by vibration and of the model."""
    covariance = inflate(covariance, misfit)
    if fit.vibrates:
        # factor of the standard deviations where flights vibrate; trials on these flights
        covariance = inflate(covariance, 1.5)
    # standard deviation by effects that the model lacks, over a derivative; each of six aircraft left
    # out in turn, docs/preprocessing.md
    return add_model_error(covariance, fit.x[: fit.layout.n_derivatives], 0.04)


def error_fractions(fit: AirFit, fitted: list[FittedRecord]) -> Vector:
    """Return the fraction (p,) of errors of path and sensors in the variance of each derivative's term.

    One where surfaces do not move the term: an error then looks like motion. Zero of constants.
    """
    motion = []
    for item in fitted:
        # in the motion without the answers to gusts that the last innovations show
        caused = item.expansion.instrument_terms(item.record.answers)
        terms = means_of_neighbours(caused)
        motion.append(terms - terms.mean(axis=0))
    variance = np.concatenate(motion).var(axis=0)
    error = _term_errors(fit, fitted, len(variance))
    fraction = error**2 / np.maximum(error**2 + variance, np.finfo(float).tiny)
    fraction[STATE_TERMS.index("alpha2")] = fraction[STATE_TERMS.index("alpha")]
    of_parameters = np.zeros(len(fit.x))
    of_parameters[: fit.layout.n_derivatives] = fraction[fit.layout.columns]
    return of_parameters


def _term_errors(fit: AirFit, fitted: list[FittedRecord], n_terms: int) -> Vector:
    """Return the errors (n_terms,) of the terms of the coefficients by path, rates and surfaces."""
    velocity = np.concatenate([item.record.velocity for item in fitted])
    speed = np.linalg.norm(velocity, axis=1).mean()
    # errors of the path [m/s], rates [rad/s] and surfaces [rad] that look like motion; guesses
    angle = 0.02 / speed
    rates = 0.002 * fit.layout.aircraft.moment_lengths / (2 * speed)
    error = np.full(n_terms, 0.001)
    # the same of thrust over dynamic pressure and wing area; guess
    error[: len(STATE_TERMS)] = [0.0, angle, 0.0, angle, *rates, 0.001]
    return error


def smoothed_air(
    fit: AirFit, fitted: list[FittedRecord], covariance: Matrix, n_rows: int
) -> pd.DataFrame:
    """Return the smoothed motion through the air; NaN in rows that no record contains."""
    values = np.full((n_rows, len(COLUMNS)), np.nan)
    for item in fitted:
        record = item.record
        # without biases and lags
        angles = rotation_to_euler(Rotation.from_matrix(record.attitude.mT))
        path = [record.force, angles, record.earth_velocity()]
        estimates = _estimates(fit, item, covariance)
        values[record.rows] = np.concatenate([*estimates, *path], axis=1)
    return pd.DataFrame(values, columns=list(COLUMNS))


def _estimates(fit: AirFit, item: FittedRecord, covariance: Matrix) -> tuple[Matrix, Matrix]:
    """Return air data, rates and wind (n, 9), and their standard deviations."""
    record = item.record
    layout = fit.layout
    states, P = smoothed(item.linear, item.filter_pass)
    value = fit.parameters.values(fit.x, record.flight)
    air = air_velocity(record, value, states)
    G = np.zeros((len(air), len(ESTIMATED), N_STATES))
    G[:, OF_AIR_DATA] = air_data_slopes(air) @ air_velocity_slopes(record, value)
    G[:, OF_RATES, RATE_STATES] = np.eye(3)
    G[:, OF_WIND, GUST] = np.eye(3)
    # the first parameters of a flight are derivatives, and what is behind them instruments
    n = len(layout.names)
    slopes = np.zeros((len(air), len(ESTIMATED), n))
    slopes[..., layout.n_derivatives :] = slopes_by_constants(
        lambda moved: _estimated(record, moved, states), value, CONSTANTS
    )
    for steps, _, Z in parameter_slopes(item.linear, item.filter_pass, item.expansion.slopes):
        rows = slice(steps.start + 1, steps.stop + 1)
        slopes[rows] += G[rows] @ Z[..., :n]
    places = fit.parameters.places[record.flight]
    C = covariance[np.ix_(places, places)]
    return _estimated(record, value, states), np.sqrt(_variances(G, P) + _variances(slopes, C))


def _estimated(record: Record, value: Mapping[str, Any], states: Matrix) -> Matrix:
    """Return air data, rates and wind (n, 9) at parameters by name and states (n, N)."""
    air = air_velocity(record, value, states)
    wind = states[:, GUST] + stacked(value, *WINDS)
    return np.column_stack([*air_data(air), states[:, RATE_STATES], wind])


def _variances(slopes: Array, covariance: Array) -> Matrix:
    """Return the diagonals of G P G^T, (n, k)."""
    return np.sum((slopes @ covariance) * slopes, axis=-1)
