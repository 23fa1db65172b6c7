"""Training data of a model for other air: mirrored flights, and targets without the effect of past gusts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from skdgp._compute.typing import Matrix
from skdgp._flight.channels import COEFFICIENTS, ELEVONS, HAT
from skdgp._flight.clock import flight_segments

LATERAL = frozenset(("beta", "beta_dot", "p", "r", "p_dot", "r_dot", "ay", "aileron", "rudder", "CY", "Cl", "Cn"))
"""Regressors and coefficients whose sign changes in a mirror."""
EARLIEST, LATEST, N_LAGS = 0.05, 0.2, 7
"""Past errors that predict an error [s]: smoothing mixes closer ones with it, gust rates forget earlier ones."""
ROUNDS, TOLERANCE = 100, 1e-3


def mirrored(regressors: pd.DataFrame, targets: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return regressors (n, d) and coefficients (n, P) of the flights as seen in a mirror.

    A symmetric aircraft flies the mirrored flight with the mirrored controls. Lateral coefficients change their sign
    about their value without sideslip, rates and lateral controls, by least squares: an asymmetry stays. Raises
    ValueError for single elevons.
    """
    if set(ELEVONS) & set(regressors):
        raise ValueError(
            f"Got regressors {list(regressors)} of a symmetric aircraft, but expected elevator and aileron in place of "
            "single elevons: put ElevonSplitter() before RegressorSelector."
        )
    lateral = [name for name in map(str, regressors) if name.removesuffix(HAT) in LATERAL]
    X, Y = regressors.copy(), targets.copy()
    X[lateral] = -X[lateral]
    A = np.column_stack([np.ones(len(X)), regressors[lateral]])
    for name in LATERAL & set(Y):
        known = Y[name].notna().to_numpy()
        straight = np.linalg.lstsq(A[known], Y[name].to_numpy()[known], rcond=None)[0][0]
        Y[name] = 2 * straight - Y[name]
    return X, Y


def named_targets(y: Any) -> pd.DataFrame:
    """Return targets with the names of a table, or an array's as the six coefficients; ValueError for other arrays."""
    if isinstance(y, pd.DataFrame):
        return y
    if np.ndim(y) != 2 or np.shape(y)[1] != len(COEFFICIENTS):
        raise ValueError(
            f"Got targets of shape {np.shape(y)} without names, but expected a table with columns such as CY, Cl, Cn, "
            "or the six coefficients: give a DataFrame."
        )
    return pd.DataFrame(np.asarray(y, dtype=float), columns=COEFFICIENTS)


def without_gusts(X: Matrix, Y: Matrix, time: Any, flight: Any) -> Matrix:
    r"""Return targets (n, P) without what past errors predict of their errors, of regressors X (n, d).

    Gusts that turn the air change the loads and, a moment later, the measured rates. So the error :math:`e` of a load
    correlates with the rates at the same time, and least squares underestimates the damping. What is new in :math:`e`
    does not depend on the rates, which follow it. Extended least squares (Ljung 1999, section 10.4) subtracts the rest:

    .. math:: y^*_t = y_t - \sum_k a_k e_{t-k}, \quad e = y - f(x),

    with :math:`f` by least squares of :math:`y^*` on second order terms and absolute values of the regressors, and
    :math:`a` by least squares of :math:`e`, for each output, in turn until neither changes.

    Rows are in the order of the log; those with NaN remain as they are, and are not used. Nothing is predicted across
    gaps in the time (n,) [s] and flights (labels (n,) or None). Raises ValueError if most rows have no target.
    """
    known = np.isfinite(Y).all(axis=1)
    if 2 * known.sum() < len(Y):
        raise ValueError(
            f"Got targets in {known.sum()} of {len(Y)} rows, but gusty=True needs those of most rows, as errors "
            "are predicted over tenths of a second: do not thin them."
        )
    step = np.median(np.diff(time))
    lags = np.unique(np.maximum(1, np.round(np.linspace(EARLIEST, LATEST, N_LAGS) / step).astype(int)))
    segments = list(flight_segments(time, flight))
    Z = StandardScaler().fit(X[known]).transform(X)
    Q = np.linalg.qr(np.column_stack([PolynomialFeatures(2).fit_transform(Z), np.abs(Z)])[known])[0]
    predicted, scale = np.zeros_like(Y), Y[known].std(axis=0)
    for _ in range(ROUNDS):
        before, clean, error = predicted, (Y - predicted)[known], np.zeros_like(Y)
        error[known] = Y[known] - Q @ (Q.T @ clean)
        predicted = _predicted(error, lags, segments, known)
        if (np.abs(predicted - before).max(axis=0) <= TOLERANCE * scale).all():
            break
    return Y - predicted


def _predicted(error, lags, segments, known):
    """Return what the errors at the lags predict of the errors, (n, P)."""
    past = np.zeros((len(lags), *error.shape))
    for rows in segments:
        part = error[rows]
        for k, lag in enumerate(lags):
            past[k, rows][lag:] = part[:-lag]
    predicted = np.zeros_like(error)
    for j, e in enumerate(error.T):
        weights = np.linalg.lstsq(past[:, known, j].T, e[known], rcond=None)[0]
        predicted[known, j] = weights @ past[:, known, j]
    return predicted
