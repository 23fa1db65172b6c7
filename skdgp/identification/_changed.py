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
from skdgp._flight.channels import COEFFICIENTS, HAT, VANES
from skdgp._flight.clock import Clock
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import FlightTable
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._evaluate import CONTROL_DERIVATIVES, THRESHOLDS, Evaluation
from skdgp.identification._instruments import instruments, two_stage, unexplained_by_chance
from skdgp.identification._log_errors import dynamic_load
from skdgp.identification._pipeline import FlightPipeline, regressor_names, scaling_of
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
# Standard deviation of the slope of a regressor that did not move in the fit, or is not moved in the flight
# by its controls [1/unit] (guess; far above slopes by surfaces and throttle)
UNLEARNED_SLOPE = 10.0
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

    The residuals r of a coefficient, measured without smoothing less the learned function, are fitted on a
    constant and the regressors x less their means, Q, with the controls of the last 1.5 s as instruments
    (docs/theory.md, slopes by instruments): noise of the regressors and rates of the air flatten slopes by least
    squares the more, the less an aircraft moves, and not these. With their matrix A the weights
    :math:`w = A r` are the likely change of the coefficient and of its derivatives. Without a change their
    covariance is

    .. math:: C = A R A^T + G Q^T (K + \sum_j a_j a_j^T) Q G, \quad G = (Q^T Q)^{-1}.

    R are the autocovariances of the residuals of this fit, with Bartlett's window (Newey & West
    1987): rougher air widens it, and so does what surplus instruments explain beyond chance (Sargan 1958).
    K is the uncertainty of the function, without the errors of the log that the measured coefficients have, too.
    The :math:`a_j` are the effects of one standard deviation of a constant error of each vane, 0.3 deg, and of
    each accelerometer, 0.05 m/s², and of unknown slopes of regressors that did not move in the fit.

    With k weights, :math:`w^T C^{-1} w\, (\nu - k + 1) / (\nu k)` is compared with
    :math:`F(k, \nu - k + 1)`, where :math:`\nu` are the 3 n / 2 L degrees of freedom of autocovariances
    up to the lag L, six autocorrelation times but at most a quarter of the flight (Priestley 1981,
    table 6.2, at frequency zero). Where :math:`\nu - k + 1` is not positive, or the flight has few independent
    samples or no controls, it tells nothing. The p-values of the coefficients are combined into the whole by Simes'
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
    residuals: Matrix  #: Measured coefficients less the learned function (n, 6), NaN where unknown
    by_acceleration: Vector  #: Force coefficients of an acceleration of 1 m/s² (n,)
    clock: Clock  #: Of its rows


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
        compared[flight.name] = Compared(
            flight.regressors,
            measured.to_numpy() - pipeline[-1].predict(flight.regressors),
            aircraft.mass / dynamic_load(flight.table, aircraft),
            FlightTable.of(flight.table).clock,
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
    regressors = pd.DataFrame(flight.regressors, columns=regressor_names(pipeline))
    endings = ["", *(f"_{name.removesuffix(HAT)}" for name in regressor_names(pipeline))]
    names = [coefficient + ending for coefficient in COEFFICIENTS for ending in endings]
    units = np.append(1.0, scaling_of(pipeline)[1])
    observed: Any = np.isfinite(flight.residuals).all(axis=1)
    rows, W = instruments(regressors, flight.clock, observed)
    if W is None:
        unknown = dict.fromkeys([*COEFFICIENTS, FORCES, WHOLE], np.nan)
        return unknown, pd.DataFrame(np.nan, [*names, FORCES], [*CHANGE, "value"])
    X = flight.regressors[rows]
    flight = flight._replace(regressors=X, by_acceleration=flight.by_acceleration[rows])
    Q = np.column_stack([np.ones(len(X)), X - X.mean(axis=0)])
    fits = [residual_weights(Q, residual, W) for residual in flight.residuals[rows].T]
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


def residual_weights(Q: Matrix, residual: Vector, W: Matrix) -> tuple[Vector, Matrix, float]:
    """Return weights of residuals (n,) by columns (n, k), their covariance, and its degrees of freedom.

    W (n, m) are instruments, orthonormal.
    """
    n, k = Q.shape
    fitting = two_stage(Q, W)
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
    (explained,) = unexplained_by_chance(e[:, None], W, k - 1)
    covariance *= max(1.0, explained / (lasting * np.mean(e**2)))
    unmoved = np.eye(k) - fitting @ Q  # by the controls
    covariance += UNLEARNED_SLOPE**2 * unmoved @ unmoved.T
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
    return np.einsum("ka,iajb,lb->ikjl", fitting, K, fitting, optimize=True)


def _effects(pipeline: Pipeline, flight: Compared, rows: Indices) -> Array:
    """Return the effects (n, 6, J) of J errors of sensors and slopes at n rows of a flight."""
    regressor = pipeline[-1]
    at = flight.regressors[rows]
    by_acceleration = flight.by_acceleration[rows]
    trained = regressor.posterior_.inputs
    is_vane = np.isin(regressor_names(pipeline), VANES)
    offsets = VANE_OFFSET * is_vane / scaling_of(pipeline)[1]
    by_vanes = regressor.predict_gradient(at) * offsets
    by_accelerometers = ACCELEROMETER_OFFSET * by_acceleration[:, None, None] * np.eye(6, 3)
    unlearned = (at - trained[0]) * constant_columns(trained) * UNLEARNED_SLOPE
    by_slopes = np.kron(unlearned[:, None], np.eye(6))  # each of one output
    return np.concatenate([by_vanes, by_accelerometers, by_slopes], axis=-1)
