"""Whether an aircraft has changed since a model of it was learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control
from sklearn.pipeline import Pipeline

from skdgp._compute.linalg import constant_columns
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, MIRRORED, VANES
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification._evaluate import Evaluation
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
# Variance of an unknown correlation of errors, uniform between -1 and 1
CORRELATION_VARIANCE = 1 / 3
VANE_OFFSET = 0.005  # std of a constant error of a vane, from flight to flight [rad] (guess)


@dataclass(frozen=True)
class Changes:
    r"""Test of flights for a change of the aircraft since its model was learned.

    The residuals r of a coefficient, measured without smoothing less predicted, are fitted by least
    squares on the regressors x less their means, Q: the weights :math:`w = G Q^T r`,
    :math:`G = (Q^T Q)^{-1}`, are the likely change of its derivatives. Without a change their
    covariance is

    .. math:: C = G Q^T (R + K + \sum_j a_j a_j^T) Q G + D \operatorname{diag}(c_k^2) D, \quad D = S^{-1} - S_0^{-1}.

    R are the autocovariances of the residuals of this fit, with Bartlett's window (Newey & West
    1987): rougher air widens it. K is the uncertainty of the function. The :math:`a_j` are the
    changes by one standard deviation of a constant error of each vane, 0.3 deg. The last term are errors of
    the regressors, of standard deviations s, which flatten slopes J the more, the less an aircraft
    moves (Fuller 1987, section 1.1): S and :math:`S_0` are the covariances of the regressors in the
    flight and in the fit, and

    .. math:: c_k^2 = \sum_j \operatorname{E}[\rho_{jk}^2] s_j^2 s_k^2 J_j^2.

    How far a filter makes the errors of one regressor correlate with the estimate of another,
    :math:`\rho_{jk}`, is unknown; of regressors on both sides of the plane of symmetry it is zero, as
    a mirrored flight changes its sign.

    With k weights, :math:`w^T C^{-1} w\, (\nu - k + 1) / (\nu k)` is compared with
    :math:`F(k, \nu - k + 1)`, where :math:`\nu` are the 3 n / 2 L degrees of freedom of autocovariances
    up to the lag L, six autocorrelation times but at most a quarter of the flight (Priestley 1981,
    table 6.2, at frequency zero). Where :math:`\nu` is below k, or the flight has few independent
    samples or lasts less than 5 s, it is too short. The p-values of the coefficients are combined
    into the whole by Simes' test, which allows for positive dependence (Simes 1986).

    Weights of regressors that did not move in the fit are left out, as their slopes were not
    learned. Constants are not tested: offsets of accelerometers and vanes change them from flight to
    flight.

    Attributes
    ----------
    p_values : DataFrame
        By flight: of CX CY CZ Cl Cm Cn and of the whole. Probability of slopes of the residuals at
        least as far from zero if the aircraft has not changed; NaN where the flight is too short.
    derivatives : DataFrame
        By flight and derivative such as Cm_alpha: the likely ``change`` and its ``std``.
    """

    p_values: pd.DataFrame
    derivatives: pd.DataFrame

    def summary(self) -> list[str]:
        """Return a line for each flight."""
        lines = []
        for flight, p in self.p_values[WHOLE].items():
            text = f"no change of its derivatives found (p = {p:.2g})"
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


def changes_in_flights(
    pipeline: FlightPipeline,
    flights: Sequence[Evaluation],
    aircraft: Aircraft,
    options: Mapping[str, Any],
) -> Changes:
    """Return the changes that evaluated flights show; ``options`` are those of the model."""
    loads = {name: options[name] for name in ("thrust", "external_forces")}
    residuals = {}
    for flight in flights:
        # a smoother that depends on the flight takes more signal from a gentle one
        measured = aerodynamic_coefficients(flight.table, aircraft, cutoff=None, **loads)
        error = measured.to_numpy() - flight.mean
        if np.ptp(flight.time) < FEWEST_SECONDS:
            error[:] = np.nan
        residuals[flight.name] = flight.regressors, error
    return changes_of(pipeline, residuals)


def changes_of(pipeline: Pipeline, flights: Mapping[str, tuple[Matrix, Matrix]]) -> Changes:
    """Return the changes of the aircraft of a model, by `Changes`.

    Parameters
    ----------
    pipeline : Pipeline
    flights : mapping of str to tuple of ndarray
        Regressors (n, d) of the last step, and residuals (n, 6), NaN where unknown.
    """
    names = [name.removesuffix(HAT) for name in regressor_names(pipeline)]
    scale = pipeline["standardscaler"].scale_
    moved = np.flatnonzero(~constant_columns(training_inputs(pipeline[-1].posterior_)))
    p_values = {}
    derivatives = {}
    for flight, (regressors, residuals) in flights.items():
        is_known = np.isfinite(residuals).all(axis=1)
        X = regressors[is_known]
        of_model = (
            _covariance_by_function(pipeline, X)
            + _covariance_by_noise(pipeline, X)
            + _covariance_by_vanes(pipeline, X)
        )
        p = []
        for coefficient, residual, further in zip(
            COEFFICIENTS, residuals[is_known].T, of_model, strict=True
        ):
            slopes, covariance, freedom = residual_slopes(X, residual)
            slopes = slopes[moved]
            covariance = (covariance + further)[np.ix_(moved, moved)]
            p.append(_p_value(slopes, covariance, freedom))
            std = np.sqrt(np.diag(covariance))
            for k, change, deviation in zip(moved, slopes, std, strict=True):
                derivative = f"{coefficient}_{names[k]}"
                derivatives[flight, derivative] = change / scale[k], deviation / scale[k]
        p_values[flight] = [*p, combined(p)]
    table = pd.DataFrame.from_dict(derivatives, orient="index", columns=["change", "std"])
    table.index = pd.MultiIndex.from_tuples(table.index, names=["flight", "derivative"])
    columns = [*COEFFICIENTS, WHOLE]
    return Changes(pd.DataFrame.from_dict(p_values, orient="index", columns=columns), table)


def residual_slopes(X: Matrix, residual: Vector) -> tuple[Vector, Matrix, float]:
    """Return slopes of residuals (n,) by regressors (n, d), their covariance, and its degrees of freedom."""
    Q = X - X.mean(axis=0)
    n, k = Q.shape
    G = np.asarray(np.linalg.pinv(Q.T @ Q, hermitian=True), dtype=float)
    slopes = G @ (Q.T @ residual)
    residual = residual - residual.mean()
    e = residual - Q @ slopes
    # a change that follows a slow motion makes the residual last longer, not e
    lasting = max(min(autocorrelation_time(residual), autocorrelation_time(e)), 2.0)
    if n < (k + SPARE_SAMPLES) * lasting:
        return slopes, np.full((k, k), np.nan), 0.0
    longest = min(WINDOW_TIMES * lasting, LONGEST_LAG * n)
    autocovariance = correlate(e, e, method="fft")[n - 1 :] / (n - k * lasting)
    window = np.maximum(1 - np.arange(n) / longest, 0.0)
    covariance = G @ Q.T @ matmul_toeplitz(autocovariance * window, Q) @ G
    return slopes, covariance, 1.5 * n / longest


def _p_value(slopes: Vector, covariance: Matrix, freedom: float) -> float:
    """Return the probability of slopes as far from zero, NaN if the flight is too short."""
    k = len(slopes)
    remaining = freedom - k + 1
    if remaining <= 0:
        return float("nan")
    inverse = np.linalg.pinv(covariance, hermitian=True)
    statistic = slopes @ inverse @ slopes * remaining / (freedom * k)
    return float(f_distribution.sf(statistic, k, remaining))


def combined(p_values: Sequence[float]) -> float:
    """Return the p-value by Simes' test of those that are known, min n p_(k) / k, NaN if none is."""
    known = [p for p in p_values if np.isfinite(p)]
    return float(false_discovery_control(known).min()) if known else float("nan")


def _covariance_by_function(pipeline: Pipeline, X: Matrix) -> Array:
    """Return the covariance of the slopes by the uncertainty of the function, (P, d, d)."""
    rows = np.linspace(0, len(X) - 1, min(MOST_ROWS, len(X))).astype(int)
    mean, cov = pipeline[-1].predict(X[rows], return_cov=True, include_input_noise=False)
    n_outputs = mean.shape[1]
    K = cov.reshape(n_outputs, len(rows), n_outputs, len(rows))
    fitting = np.linalg.pinv(X[rows] - X[rows].mean(axis=0))  # G Q^T
    return np.stack([fitting @ K[i, :, i] @ fitting.T for i in range(n_outputs)])


def _covariance_by_noise(pipeline: Pipeline, X: Matrix) -> Array:
    """Return the covariance of the slopes by errors of the regressors of a flight X (n, d), (P, d, d)."""
    trained = training_inputs(pipeline[-1].posterior_)
    J = pipeline[-1].predict_gradient(trained.mean(axis=0, keepdims=True))[0]
    variances = _noise_variances(pipeline)
    is_lateral = np.array(
        [name.removesuffix(HAT) in MIRRORED for name in regressor_names(pipeline)]
    )
    correlations = np.where(is_lateral[:, None] == is_lateral, CORRELATION_VARIANCE, 0.0)
    np.fill_diagonal(correlations, 1.0)
    c_squared = J**2 @ (correlations * variances[:, None] * variances)
    in_flight = np.linalg.pinv(np.atleast_2d(np.cov(X.T)), hermitian=True)
    in_fit = np.linalg.pinv(np.atleast_2d(np.cov(trained.T)), hermitian=True)
    D = in_flight - in_fit
    return D * c_squared[:, None, :] @ D


def _covariance_by_vanes(pipeline: Pipeline, X: Matrix) -> Array:
    """Return the covariance of the slopes by constant errors of the vanes in a flight X (n, d), (P, d, d)."""
    is_vane = np.isin(regressor_names(pipeline), VANES)
    slopes = pipeline[-1].predict_gradient(X)[:, :, is_vane]
    residuals = slopes * VANE_OFFSET / pipeline["standardscaler"].scale_[is_vane]
    fitting = np.linalg.pinv(X - X.mean(axis=0))  # G Q^T
    effects = np.einsum("kn,npj->pkj", fitting, residuals)
    return effects @ effects.swapaxes(1, 2)


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
