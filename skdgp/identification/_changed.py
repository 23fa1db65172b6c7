"""Whether an aircraft has changed since a model of it was learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control
from sklearn.pipeline import Pipeline

from skdgp._compute.linalg import constant_columns
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, COEFFICIENTS, HAT, VANES
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._evaluate import Evaluation
from skdgp.identification._log_errors import dynamic_load
from skdgp.identification._pipeline import (
    FlightPipeline,
    reconstruction_of,
    regressor_names,
)
from skdgp.inference import training_inputs

WHOLE = "whole"
MOST_NAMED = 3  # derivatives in the summary
LEVEL = 0.05  # p-value below which the summary says that the aircraft has changed
FEWEST_SECONDS = 5.0  # shortest flight [s] (guess)
# Lag at which autocovariances end, in autocorrelation times of the residuals, and at most in parts of
# the flight (guesses)
WINDOW_TIMES = 6.0
LONGEST_LAG = 0.25
SPARE_SAMPLES = 12  # independent samples that a flight has at least more than weights (guess)
MOST_ROWS = 100  # at which the covariance of the function is evaluated
# Standard deviations of constant errors that differ from flight to flight, of accelerometers [m/s^2],
# vanes [rad], and times of surfaces [samples] (guesses)
ACCELEROMETER_OFFSET = 0.05
VANE_OFFSET = 0.005
SURFACE_DELAY = 0.5
# Variance of an unknown correlation of errors, uniform between -1 and 1
CORRELATION_VARIANCE = 1 / 3


@dataclass(frozen=True)
class Changes:
    """Test of flights for a change of the aircraft, by `changes_of`.

    Attributes
    ----------
    p_values : DataFrame
        By flight: of CX CY CZ Cl Cm Cn and of the whole. Probability of residuals at least as far
        from zero if the aircraft has not changed; NaN where the flight is too short.
    derivatives : DataFrame
        By flight and derivative such as Cm_alpha: the likely ``change`` and its ``std``. The change
        of a coefficient itself, at the mean of the training flights, has its name alone.
    """

    p_values: pd.DataFrame
    derivatives: pd.DataFrame

    def summary(self) -> list[str]:
        """Return a line for each flight."""
        lines = []
        for flight, p in self.p_values[WHOLE].items():
            text = f"no change of the aircraft found (p = {p:.2g})"
            if not np.isfinite(p):
                text = "too short to tell whether the aircraft has changed"
            elif p < LEVEL:
                table: Any = self.derivatives.loc[str(flight)]
                deviations = (table["change"] / table["std"]).abs()
                parts = []
                for name, row in table.loc[deviations.nlargest(MOST_NAMED).index].iterrows():
                    parts.append(f"{name} {row['change']:+.2g} +- {row['std']:.1g}")
                likely = ", ".join(parts)
                text = f"the aircraft has changed (p = {p:.2g}): likely {likely}, +- one standard deviation"
            lines.append(f"flight {flight}: {text}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        derivatives = {}
        for flight in self.p_values.index:
            derivatives[flight] = self.derivatives.loc[flight].to_dict("index")
        return {"p_values": self.p_values.to_dict("index"), "derivatives": derivatives}


class FlightResiduals(NamedTuple):
    """Residuals of a flight, and what their errors depend on.

    Parameters
    ----------
    regressors : ndarray (n, d)
        Of the last step of the model.
    residuals : ndarray (n, 6)
        Measured coefficients, not smoothed, less predicted ones; NaN where unknown.
    by_acceleration : ndarray (n,) or None
        Change of the force coefficients by an acceleration, m / (qbar S) [s^2/m]. None: accelerometers
        have no constant errors.
    """

    regressors: Matrix
    residuals: Matrix
    by_acceleration: Vector | None = None


def changes_in_flights(
    pipeline: FlightPipeline,
    flights: Sequence[Evaluation],
    aircraft: Aircraft,
    options: Mapping[str, Any],
) -> Changes:
    """Return the changes that evaluated flights show, see `changes_of`; ``options`` are those of the model."""
    loads = {name: options[name] for name in ("thrust", "external_forces")}
    residuals = {}
    for flight in flights:
        # a smoother that depends on the flight takes more signal from a gentle one
        measured = aerodynamic_coefficients(flight.table, aircraft, cutoff=None, **loads)
        error = measured.to_numpy() - flight.mean
        if np.ptp(flight.time) < FEWEST_SECONDS:
            error[:] = np.nan
        by_acceleration = aircraft.mass / dynamic_load(flight.table, aircraft)
        residuals[flight.name] = FlightResiduals(flight.regressors, error, by_acceleration)
    return changes_of(pipeline, residuals)


def changes_of(pipeline: Pipeline, flights: Mapping[str, FlightResiduals]) -> Changes:
    r"""Return the changes of the aircraft of a model that residuals of new flights show.

    The residuals r of a coefficient, measured without smoothing less predicted, are fitted by least
    squares on the regressors, Q = (1, x): the weights :math:`w = G Q^T r`, :math:`G = (Q^T Q)^{-1}`, are the
    likely change of its derivatives. Without a change their covariance is

    .. math:: C = G Q^T (R + K) Q G + \sum_j d_j d_j^T.

    R are the autocovariances of the residuals of this fit, with Bartlett's window (Newey & West
    1987): rougher air widens it. K is the uncertainty of the function. The :math:`d_j` are the
    effects of one standard deviation of errors of the log: constant ones that differ from flight
    to flight, of accelerometers, of vanes, and of the times of the surfaces, with the effects
    :math:`a_j` on the residuals :math:`d_j = G Q^T a_j`; and errors of the regressors. With their
    covariance :math:`S_0` in the fit, and S in the flight, and the slopes J, slopes differ by

    .. math:: (S^{-1} - S_0^{-1})\, c, \quad c_k = \sum_j \rho_{jk} s_j s_k J_j,

    which is zero in flights with the same motion, and large in gentler ones (Fuller 1987,
    section 1.1). How far a filter makes the errors s of one regressor correlate with the estimate
    of another, :math:`\rho_{jk}`, is unknown, and independent for each k.

    With k weights, :math:`w^T C^{-1} w\, (\nu - k + 1) / (\nu k)` is compared with
    :math:`F(k, \nu - k + 1)`, where :math:`\nu` are the 3 n / 2 L degrees of freedom of autocovariances
    up to the lag L, six autocorrelation times but at most a quarter of the flight (Priestley 1981,
    table 6.2, at frequency zero). Where :math:`\nu` is below k, or the flight has few independent
    samples or lasts less than 5 s, it is too short.
    The p-values of the coefficients are combined into the whole by Simes' test, which
    allows for positive dependence (Simes 1986).

    A weight of a regressor that did not move in the fit is left out, as its slope was not learned; so
    is the mean where such a regressor is held at another value.

    Parameters
    ----------
    pipeline : Pipeline
    flights : mapping of str to FlightResiduals

    Returns
    -------
    Changes
    """
    terms = ["", *(f"_{name.removesuffix(HAT)}" for name in regressor_names(pipeline))]
    scale = np.append(1.0, pipeline["standardscaler"].scale_)
    p_values = {}
    derivatives = {}
    for name, flight in flights.items():
        rows = np.flatnonzero(np.isfinite(flight.residuals).all(axis=1))
        X = flight.regressors[rows]
        known = _known_weights(pipeline, X)
        of_model = _covariance_by_function(pipeline, X) + _covariance_by_errors(
            pipeline, flight, rows
        )
        p = []
        for coefficient, residual, further in zip(
            COEFFICIENTS, flight.residuals[rows].T, of_model, strict=True
        ):
            weights, covariance, freedom = flight_weights(X, residual)
            weights = weights[known]
            covariance = (covariance + further)[np.ix_(known, known)]
            p.append(_p_value(weights, covariance, freedom))
            std = np.sqrt(np.diag(covariance))
            for k, change, deviation in zip(known, weights, std, strict=True):
                derivative = f"{coefficient}{terms[k]}"
                derivatives[name, derivative] = change / scale[k], deviation / scale[k]
        p_values[name] = [*p, combined(p)]
    table = pd.DataFrame.from_dict(derivatives, orient="index", columns=["change", "std"])
    table.index = pd.MultiIndex.from_tuples(table.index, names=["flight", "derivative"])
    columns = [*COEFFICIENTS, WHOLE]
    return Changes(pd.DataFrame.from_dict(p_values, orient="index", columns=columns), table)


def flight_weights(X: Matrix, residual: Vector) -> tuple[Vector, Matrix, float]:
    """Return weights of least squares on (1, x) of regressors (n, d), their covariance, and its degrees of freedom."""
    Q = _terms(X)
    n, k = Q.shape
    G = np.asarray(np.linalg.pinv(Q.T @ Q, hermitian=True), dtype=float)
    weights = G @ (Q.T @ residual)
    e = residual - Q @ weights
    # a change that follows a slow motion makes the residual last longer, not e
    lasting = max(min(autocorrelation_time(residual), autocorrelation_time(e)), 2.0)
    if n < (k + SPARE_SAMPLES) * lasting:
        return weights, np.full((k, k), np.nan), 0.0
    longest = min(WINDOW_TIMES * lasting, LONGEST_LAG * n)
    autocovariance = correlate(e, e, method="fft")[n - 1 :] / (n - k * lasting)
    window = np.maximum(1 - np.arange(n) / longest, 0.0)
    covariance = G @ Q.T @ matmul_toeplitz(autocovariance * window, Q) @ G
    return weights, covariance, 1.5 * n / longest


def _p_value(weights: Vector, covariance: Matrix, freedom: float) -> float:
    """Return the probability of weights as far from zero, NaN if the flight is too short."""
    k = len(weights)
    remaining = freedom - k + 1
    if remaining <= 0:
        return float("nan")
    inverse = np.linalg.pinv(covariance, hermitian=True)
    statistic = weights @ inverse @ weights * remaining / (freedom * k)
    return float(f_distribution.sf(statistic, k, remaining))


def combined(p_values: Sequence[float]) -> float:
    """Return the p-value by Simes' test of those that are known, min n p_(k) / k, NaN if none is."""
    known = [p for p in p_values if np.isfinite(p)]
    return float(false_discovery_control(known).min()) if known else float("nan")


def _terms(X: Matrix) -> Matrix:
    """Return Q = (1, x), (n, d + 1)."""
    return np.column_stack([np.ones(len(X)), X])


def _known_weights(pipeline: Pipeline, X: Matrix) -> Indices:
    """Return the places of the weights of (1, x) that a model knows, of a flight X (n, d).

    An unknown effect that is constant in the flight moves the mean.
    """
    trained = training_inputs(pipeline[-1].posterior_)
    is_constant = constant_columns(trained)
    is_elsewhere = is_constant & constant_columns(X) & ~np.isclose(X[0], trained[0])
    return np.flatnonzero(np.append(not is_elsewhere.any(), ~is_constant))


def _covariance_by_function(pipeline: Pipeline, X: Matrix) -> Array:
    """Return the covariance of the weights by the uncertainty of the function, (P, d + 1, d + 1)."""
    rows = np.linspace(0, len(X) - 1, min(MOST_ROWS, len(X))).astype(int)
    mean, cov = pipeline[-1].predict(X[rows], return_cov=True, include_input_noise=False)
    n_outputs = mean.shape[1]
    K = cov.reshape(n_outputs, len(rows), n_outputs, len(rows))
    fitting = np.linalg.pinv(_terms(X[rows]))  # G Q^T
    return np.stack([fitting @ K[i, :, i] @ fitting.T for i in range(n_outputs)])


def _covariance_by_errors(pipeline: Pipeline, flight: FlightResiduals, rows: Indices) -> Array:
    """Return the covariance of the weights by errors of the log, (P, d + 1, d + 1)."""
    X = flight.regressors[rows]
    constant = np.linalg.pinv(_terms(X)) @ _constant_errors(pipeline, flight, rows)
    effects = np.concatenate([constant, _errors_of_regressors(pipeline, X)], axis=2)
    return effects @ effects.swapaxes(1, 2)


def _constant_errors(pipeline: Pipeline, flight: FlightResiduals, rows: Indices) -> Array:
    """Return the effects of constant errors of vanes, times of surfaces, and accelerometers on residuals (P, n, J)."""
    slopes = pipeline[-1].predict_gradient(flight.regressors[rows])
    scale = pipeline["standardscaler"].scale_
    steps = np.diff(flight.regressors, axis=0, prepend=flight.regressors[:1])[rows]
    effects = []
    for k, name in enumerate(regressor_names(pipeline)):
        if name in VANES:
            effects.append(slopes[:, :, k] * VANE_OFFSET / scale[k])
        if name in ALL_SURFACES:
            effects.append(slopes[:, :, k] * SURFACE_DELAY * steps[:, [k]])
    if flight.by_acceleration is not None:
        for axis in np.eye(slopes.shape[1])[:3]:
            by_offset = ACCELEROMETER_OFFSET * flight.by_acceleration[rows]
            effects.append(by_offset[:, None] * axis)
    return np.moveaxis(np.array(effects).reshape(len(effects), *slopes.shape[:2]), (2, 1), (0, 1))


def _errors_of_regressors(pipeline: Pipeline, X: Matrix) -> Array:
    """Return the effects of errors of the regressors of a flight X (n, d) on the weights, (P, d + 1, d)."""
    trained = training_inputs(pipeline[-1].posterior_)
    J = pipeline[-1].predict_gradient(trained.mean(axis=0, keepdims=True))[0]
    variances = _noise_variances(pipeline)
    # of the unknown correlations: an error's with its own regressor is one
    spread = np.full((len(variances), len(variances)), CORRELATION_VARIANCE)
    np.fill_diagonal(spread, 1.0)
    c = np.sqrt(J**2 @ (spread * variances[:, None] * variances))
    in_flight = np.linalg.pinv(np.atleast_2d(np.cov(X.T)), hermitian=True)
    in_fit = np.linalg.pinv(np.atleast_2d(np.cov(trained.T)), hermitian=True)
    # a bias of slopes turns the function about the mean of the regressors
    turning = np.vstack([-X.mean(axis=0), np.eye(X.shape[1])])
    return turning @ (in_flight - in_fit) * c[:, None, :]


def _noise_variances(pipeline: Pipeline) -> Vector:
    """Return the variances (d,) of the errors of the regressors, learned from the residuals.

    Angles that a filter derived from the forces agree with the residuals, so there its own
    variances count, the larger ones.
    """
    variances = np.diag(pipeline[-1].input_covariance_)
    reconstruction = reconstruction_of(pipeline)
    if reconstruction is None or reconstruction.air_motion_ is None:
        return variances
    air = reconstruction.air_motion_.air.mean()
    std = np.array([air.get(f"{name}_std", 0.0) for name in regressor_names(pipeline)])
    return np.maximum(variances, (std / pipeline["standardscaler"].scale_) ** 2)
