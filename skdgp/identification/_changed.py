"""Whether an aircraft has changed since a model of it was learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control
from sklearn.pipeline import Pipeline

from skdgp._compute.linalg import constant_columns
from skdgp._compute.statistics import autocorrelation_time, half_width
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, MIRRORED, VANES
from skdgp._flight.findings import Code, Finding
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._evaluate import CONTROL_DERIVATIVES, THRESHOLDS, Evaluation
from skdgp.identification._log_errors import dynamic_load
from skdgp.identification._pipeline import (
    FlightPipeline,
    named_regressors,
    reconstruction_of,
    regressor_names,
    scaling_of,
)
from skdgp.inference import FunctionErrors

WHOLE = "whole"
MOST_NAMED = 3  # changes in the summary
LEVEL = 0.05  # p-value below which the summary says that the aircraft has changed
# Lag at which autocovariances end, in autocorrelation times of the residuals, and at most in parts of
# the flight (guesses)
WINDOW_TIMES = 6.0
LONGEST_LAG = 0.25
SPARE_SAMPLES = 12  # independent samples that a flight has at least more than weights (guess)
MOST_ROWS = 100  # at which the covariance of the function is evaluated
# Standard deviations of constant errors, from flight to flight (guesses)
VANE_OFFSET = 0.005  # [rad]
ACCELEROMETER_OFFSET = 0.05  # [m/s^2]
# Standard deviation of the slope of a regressor that did not move in the fit [1/unit] (guess; far above
# slopes by surfaces and throttle)
UNLEARNED_SLOPE = 10.0
# Variance of a correlation between -1 and 1 of which nothing is known
CORRELATION_VARIANCE = 1 / 3
FORCES = "forces"
CHANGE = ["change", "std"]
# CY and CZ, which thrust and drag do not change
LIFT = (1, 2)
# Relative standard deviation of mass over dynamic pressure and wing area, from flight to flight: fuel, and a
# temperature of the air that is wrong by 6 degrees (guess)
LOADING_STD = 0.02


@dataclass(frozen=True)
class Changes:
    r"""Test of flights for a change of the aircraft since its model was learned.

    The residuals r of a coefficient, measured without smoothing less predicted, are fitted by least
    squares on a constant and the regressors x less their means, Q: the weights :math:`w = G Q^T r`,
    :math:`G = (Q^T Q)^{-1}`, are the likely change of the coefficient and of its derivatives. Without
    a change their covariance is

    .. math:: C = G Q^T (R + K + \sum_j a_j a_j^T) Q G.

    R are the autocovariances of the residuals of this fit, with Bartlett's window (Newey & West
    1987): rougher air widens it. K is the uncertainty of the function, without the errors of the log
    that the measured coefficients have, too. The :math:`a_j` are the effects of one standard deviation
    of a constant error of each vane, 0.3 deg, and of each accelerometer, 0.05 m/s², of the errors
    of regressors, and of unknown slopes of regressors that did not move in the fit. Errors of
    regressors flatten slopes J the more, the less an aircraft moves (Fuller 1987, section 1.1), by
    :math:`(\rho S^{-1} - S_0^{-1}) E J`, where S and :math:`S_0` are the covariances of the regressors in
    the flight and in the fit, E is that of their errors in the fit, whose correlations are unknown within
    symmetric and within lateral regressors, and :math:`\rho \ge 1` the noise of rougher air over that of the
    fit. Rates of rougher air, which no sensor sees, are errors, too, of each weight by itself.

    With k weights, :math:`w^T C^{-1} w\, (\nu - k + 1) / (\nu k)` is compared with
    :math:`F(k, \nu - k + 1)`, where :math:`\nu` are the 3 n / 2 L degrees of freedom of autocovariances
    up to the lag L, six autocorrelation times but at most a quarter of the flight (Priestley 1981,
    table 6.2, at frequency zero). Where :math:`\nu - k + 1` is not positive, or the flight has few independent
    samples, it is too short. The p-values of the coefficients are combined into the whole by Simes'
    test, which allows for positive dependence (Simes 1986).

    Attributes
    ----------
    p_values : DataFrame
        By flight: of CX CY CZ Cl Cm Cn, of one factor of the forces (by CY and CZ), and of the whole. Probability of
        weights at least as far from zero if the aircraft has not changed; NaN where the flight is too short.
    derivatives : DataFrame
        By flight and derivative such as Cm_alpha, or coefficient such as CX, at the mean regressors of
        the flight: the likely ``change`` and its ``std``, and the model's ``value``; "forces": c, its std and 1.
    """

    p_values: pd.DataFrame
    derivatives: pd.DataFrame

    @property
    def findings(self) -> list[Finding]:
        """Whether the aircraft has changed, a finding for each flight."""
        return [self._finding(flight, p) for flight, p in self.p_values.iterrows()]

    def _finding(self, flight: Any, p: pd.Series) -> Finding:
        """Return what a flight shows, with the most certain changes of the coefficients that have changed."""
        if np.isnan(p[WHOLE]):
            return Finding(Code.CHANGE_UNKNOWN, flight=flight)
        table: Any = self.derivatives.loc[flight]
        if p[WHOLE] >= LEVEL:
            controls = table.reindex(CONTROL_DERIVATIVES).dropna()
            hidden = half_width(0.95) * controls["std"] / controls["value"].abs()
            return Finding(
                Code.NO_CHANGE, flight=flight, p=p[WHOLE], hidden=hidden.to_dict() or None
            )
        forces = tuple(table.loc[FORCES, CHANGE]) if p[FORCES] < LEVEL else None
        table = table[table.index.str[:2].isin(p.index[p < LEVEL])]
        certain = (table["change"] / table["std"]).abs().nlargest(MOST_NAMED).index
        likely = {name: tuple(table.loc[name, CHANGE]) for name in certain}
        return Finding(Code.CHANGED, flight=flight, p=p[WHOLE], forces=forces, likely=likely)


class Compared(NamedTuple):
    """A flight beside a model."""

    regressors: Matrix  #: Of the last step, (n, d)
    residuals: Matrix  #: Measured less predicted coefficients (n, 6), NaN where unknown
    by_acceleration: Vector  #: Force coefficients of an acceleration of 1 m/s² (n,)
    noise_ratio: float = 1.0  #: Variance of the noise of the regressors over that in the fit
    by_air: FunctionErrors | None = None  #: Errors by the rates of its air beyond those of the fit


def changes_in_flights(
    pipeline: FlightPipeline, flights: Sequence[Evaluation], aircraft: Aircraft
) -> Changes:
    """Return the changes of an aircraft that evaluated flights show."""
    compared = {}
    for flight in flights:
        # a smoother that depends on the flight takes more signal from a gentle one
        measured = aerodynamic_coefficients(
            flight.table, aircraft, cutoff=None, thrust=pipeline.thrust
        )
        by_acceleration = aircraft.mass / dynamic_load(flight.table, aircraft)
        residuals = measured.to_numpy() - flight.mean
        named = named_regressors(pipeline, flight.regressors)
        compared[flight.name] = Compared(
            flight.regressors,
            residuals,
            by_acceleration,
            float(flight.noise_ratio.mean()),
            pipeline.errors_by_air(named, flight.table, pipeline.turbulence_),
        )
    changes = changes_of(pipeline, compared, pipeline.log_errors_)
    if pipeline.seconds_ is not None and pipeline.seconds_ < THRESHOLDS.flown:
        # whose uses are not judged either: bands of short records are too narrow
        return replace(changes, p_values=changes.p_values * np.nan)
    return changes


def changes_of(
    pipeline: Pipeline,
    flights: Mapping[str, Compared],
    log_errors: FunctionErrors | None = None,
) -> Changes:
    """Return the changes of the aircraft of a model, by `Changes`.

    Parameters
    ----------
    pipeline : Pipeline
    flights : mapping of str to Compared
    log_errors : FunctionErrors, optional
        Errors of the model's function that the measured coefficients have, too.
    """
    p_values = {}
    tables = {}
    for flight, compared in flights.items():
        p_values[flight], tables[flight] = _changes_of_flight(pipeline, compared, log_errors)
    return Changes(pd.DataFrame(p_values).T, pd.concat(tables, names=["flight", "derivative"]))


def _changes_of_flight(
    pipeline: Pipeline, flight: Compared, log_errors: FunctionErrors | None
) -> tuple[dict[str, float], pd.DataFrame]:
    """Return the p-values of a flight, and its likely changes with their standard deviations, see `Changes`."""
    endings = ["", *(f"_{name.removesuffix(HAT)}" for name in regressor_names(pipeline))]
    names = [coefficient + ending for coefficient in COEFFICIENTS for ending in endings]
    units = np.append(1.0, scaling_of(pipeline)[1])
    rows = np.isfinite(flight.residuals).all(axis=1)
    X = flight.regressors[rows]
    flight = flight._replace(regressors=X, by_acceleration=flight.by_acceleration[rows])
    Q = np.column_stack([np.ones(len(X)), X - X.mean(axis=0)])
    fits = [residual_weights(Q, residual) for residual in flight.residuals[rows].T]
    weights = np.array([fit[0] for fit in fits])
    covariance = _covariance(pipeline, flight, Q, log_errors)
    p = {}
    for i, (coefficient, (_, scatter, freedom)) in enumerate(zip(COEFFICIENTS, fits, strict=True)):
        covariance[i, :, i] += scatter
        p[coefficient] = _p_value(weights[i], covariance[i, :, i], freedom)
    stds = np.sqrt(np.einsum("ikik->ik", covariance))
    expected = np.linalg.pinv(Q) @ pipeline[-1].predict(X)
    by_derivative = {"change": weights, "std": stds, "value": expected.T}
    columns = {name: (values / units).ravel() for name, values in by_derivative.items()}
    table = pd.DataFrame(columns, names)
    known = [i for i in LIFT if fits[i][2]]
    factor, variance = _factor_of_forces(weights, covariance, expected.T, known)
    freedom = min((fits[i][2] for i in known), default=0.0)
    p[FORCES] = _p_value(np.array([factor]), np.array([[variance]]), freedom)
    table.loc[FORCES] = factor, variance**0.5, 1.0
    return p | {WHOLE: combined([*p.values()])}, table


def residual_weights(Q: Matrix, residual: Vector) -> tuple[Vector, Matrix, float]:
    """Return weights of residuals (n,) by columns (n, k), their covariance, and its degrees of freedom."""
    n, k = Q.shape
    fitting = np.linalg.pinv(Q)  # G Q^T
    weights = fitting @ residual
    e = residual - Q @ weights
    # a change that follows a slow motion makes the residual last longer, not e
    times = autocorrelation_time(residual - residual.mean()), autocorrelation_time(e)
    lasting = max(min(times), 2.0)
    if n < (k + SPARE_SAMPLES) * lasting:
        return weights, np.full((k, k), np.nan), 0.0
    longest = min(WINDOW_TIMES * lasting, LONGEST_LAG * n)
    autocovariance = correlate(e, e, method="fft")[n - 1 :] / (n - k * lasting)
    window = np.maximum(1 - np.arange(n) / longest, 0.0)
    covariance: Any = fitting @ matmul_toeplitz(autocovariance * window, fitting.T)
    return weights, covariance, 1.5 * n / longest


def _p_value(weights: Vector, covariance: Matrix, freedom: float) -> float:
    """Return the probability of weights as far from zero, NaN if the flight is too short."""
    k = len(weights)
    remaining = freedom - k + 1
    if remaining <= 0:
        return float("nan")
    statistic = weights @ np.linalg.pinv(covariance, hermitian=True) @ weights
    return float(f_distribution.sf(statistic * remaining / (freedom * k), k, remaining))


def combined(p_values: Sequence[float]) -> float:
    """Return the p-value by Simes' test of those that are known, min n p_(k) / k, NaN if none is."""
    known = [p for p in p_values if np.isfinite(p)]
    return float(false_discovery_control(known).min()) if known else float("nan")


def _factor_of_forces(
    weights: Matrix, covariance: Array, expected: Matrix, known: list[int]
) -> tuple[float, float]:
    """Return the relative change of all forces by one factor, which some ``known`` forces show, and its variance.

    By generalized least squares of the weights (6, k) of the residuals, of ``covariance`` (6, k, 6, k), over
    those of the coefficients themselves, ``expected``.
    """
    if not known:
        return np.nan, np.nan
    v = expected[known].ravel()
    of_forces = covariance[known][:, :, known].reshape(len(v), len(v))
    precision = np.linalg.pinv(of_forces, hermitian=True)
    information = v @ precision @ v
    factor = v @ precision @ weights[known].ravel() / information
    return float(factor), float(1 / information + LOADING_STD**2)


def _covariance(
    pipeline: Pipeline, flight: Compared, Q: Matrix, log_errors: FunctionErrors | None
) -> Array:
    """Return the covariance (P, k, P, k) of the weights of Q by the model and by constant errors."""
    rows = np.linspace(0, len(Q) - 1, min(MOST_ROWS, len(Q))).astype(int)
    at = flight.regressors[rows]
    mean, function = pipeline[-1].predict(at, return_cov=True, include_input_noise=False)
    if log_errors is not None:
        function = function - log_errors.covariance(at)
    effects = _effects(pipeline, flight, rows)
    K = function.reshape(*mean.T.shape, *mean.T.shape)
    K = K + np.einsum("nij,mlj->inlm", effects, effects)
    fitting = np.linalg.pinv(Q[rows])  # G Q^T
    covariance = np.einsum("ka,iajb,lb->ikjl", fitting, K, fitting, optimize=True)
    if flight.by_air is not None:
        weights = fitting @ flight.by_air.linear(at)
        np.einsum("ikik->ik", covariance)[:] += np.sum(weights**2, axis=0).T
    return covariance


def _effects(pipeline: Pipeline, flight: Compared, rows: Indices) -> Array:
    """Return the effects (n, 6, J) of J errors of sensors, regressors and slopes at n rows of a flight."""
    regressor = pipeline[-1]
    X = flight.regressors
    at = X[rows]
    by_acceleration = flight.by_acceleration[rows]
    trained = regressor.posterior_.inputs
    is_vane = np.isin(regressor_names(pipeline), VANES)
    offsets = VANE_OFFSET * is_vane / scaling_of(pipeline)[1]
    by_vanes = regressor.predict_gradient(at) * offsets
    by_accelerometers = ACCELEROMETER_OFFSET * by_acceleration[:, None, None] * np.eye(6, 3)
    unlearned = (at - trained[0]) * constant_columns(trained) * UNLEARNED_SLOPE
    by_slopes = np.kron(unlearned[:, None], np.eye(6))  # each of one output
    rougher = max(flight.noise_ratio, 1.0)
    moved = (at - X.mean(axis=0)) @ (rougher * _precision(X) - _precision(trained))
    slopes = regressor.predict_gradient(trained.mean(axis=0, keepdims=True))[0]
    by_noise = moved[:, None] * _noise_effects(pipeline, slopes)
    return np.concatenate([by_vanes, by_accelerometers, by_slopes, by_noise], axis=-1)


def _noise_effects(pipeline: Pipeline, slopes: Matrix) -> Matrix:
    """Return the standard deviations (6, d) of E J for slopes J (6, d), with the sign of these.

    Correlations of errors are unknown within symmetric and within lateral regressors. Their sizes are learned
    from the residuals; angles that a filter derived from the forces agree with these, so there its own
    count, the larger ones.
    """
    names = [name.removesuffix(HAT) for name in regressor_names(pipeline)]
    std = np.sqrt(np.diag(pipeline[-1].input_covariance_))
    reconstruction = reconstruction_of(pipeline)
    if reconstruction is not None and reconstruction.air_motion_ is not None:
        of_filter = [f"{name}_std" for name in regressor_names(pipeline)]
        stated = reconstruction.air_motion_.air.mean().reindex(of_filter).to_numpy()
        std = np.fmax(std, stated / scaling_of(pipeline)[1])
    is_lateral = np.isin(names, [*MIRRORED])
    correlations = np.where(is_lateral[:, None] == is_lateral, CORRELATION_VARIANCE, 0.0)
    np.fill_diagonal(correlations, 1.0)
    return np.copysign(np.sqrt((slopes * std) ** 2 @ correlations) * std, slopes)


def _precision(X: Matrix) -> Matrix:
    """Return the inverse of the covariance of regressors X (n, d), zero along directions that do not vary."""
    return np.linalg.pinv(np.atleast_2d(np.cov(X.T)), hermitian=True)
