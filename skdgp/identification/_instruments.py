r"""Slopes by instrumental variables, which noise of the regressors does not flatten.

Controls do not follow the noise of other regressors, nor the rates of the air. Slopes of y by the part of the
regressors X that controls W of the last 1.5 s explain (two-stage least squares: Söderström & Stoica 1989,
section 8.1),

.. math:: b_W = (X^T P X)^{-1} X^T P y, \quad P = W (W^T W)^{-1} W^T,

are therefore right where those by least squares are too small, and less certain. Of the residuals of a learned
function they are what it lacks, less what least squares finds. Without such noise this difference D has the
covariance :math:`S = \sigma^2 ((X^T P X)^{-1} - (X^T X)^{-1})`, and :math:`T = D^T S^{-1} D` the mean k of k noisy
regressors (Hausman 1978). The function lacks :math:`(1 - k / T) D` if T > k (a positive part estimator: James &
Stein 1961), known as well as D. The errors :math:`\sigma` are those of the targets about their slopes, as the
function has learned their curvature from the same rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from skdgp._compute.linalg import eigen_root
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, AUXILIARY
from skdgp._flight.clock import Clock
from skdgp.inference import KnownSlopes, linear_weights

# Time within which controls move the aircraft, and the step of their earlier values [s], as of lags
MEMORY = 1.5
STEP = 0.125
# Regressors nearer than this to a combination of others are left out, relative
RANK_TOLERANCE = 1e-6
CONTROLS = (*ALL_SURFACES, *AUXILIARY, "throttle", "airspeed")
"""Regressors that do not follow the rates of the air."""


def by_instruments(
    regressors: pd.DataFrame, Y: Any, function: Any, clock: Clock
) -> KnownSlopes | None:
    """Return the slopes of a ``function`` (n, P) by regressors (n, d), with what it lacks of targets Y (n, P).

    ``clock`` is that of the rows. None where there are no `instruments`, or all regressors are controls.
    """
    X = regressors.to_numpy()
    Y = pd.DataFrame(Y).to_numpy(float)
    is_noisy = ~np.isin(regressors.columns, CONTROLS)
    n_noisy = np.count_nonzero(is_noisy)
    used = np.isfinite(Y).all(axis=1)
    rows, W = instruments(regressors, clock, used)
    if W is None or not n_noisy:
        return None
    x, y, lacked = (values[rows] - values[rows].mean(axis=0) for values in (X, Y, Y - function))
    of_controls = two_stage(x, W)
    of_all = np.linalg.pinv(x, RANK_TOLERANCE)
    difference = ((of_controls - of_all) @ lacked).T
    residuals = y - x @ (of_controls @ y)
    variance = np.array([autocorrelation_time(e) * np.mean(e**2) for e in residuals.T])
    variance = np.maximum(variance, unexplained_by_chance(residuals, W, x.shape[1]))
    covariance = of_controls @ of_controls.T - of_all @ of_all.T
    # a control is its own instrument: the difference has the rank of the other regressors
    precision = linalg.pinvh(covariance[np.ix_(is_noisy, is_noisy)])
    D = difference[:, is_noisy]
    exact = np.finfo(float).tiny  # targets have no variance about their slopes
    statistic = np.einsum("pj,jk,pk->p", D, precision, D) / np.maximum(variance, exact)
    weight = 1.0 - n_noisy / np.maximum(statistic, n_noisy)
    value = linear_weights(X[used], function[used])[1:].T + weight[:, None] * difference
    root = np.sqrt(variance)[:, None, None] * eigen_root(covariance)[:, -n_noisy:]
    # of each output by itself
    errors = np.einsum("pdk,pq->pdqk", root, np.eye(len(root)))
    return KnownSlopes(value, errors.reshape(*value.shape, -1), includes_noise=False)


def instruments(
    regressors: pd.DataFrame, clock: Clock, used: Mask
) -> tuple[Indices, Matrix | None]:
    """Return which of the ``used`` rows (n,) have earlier controls, and these as orthonormal columns with the constant.

    None where rows are fewer than ten for each of them, or no regressor is a control.
    """
    rows = np.flatnonzero((clock.elapsed > MEMORY) & used)
    controls = regressors.loc[:, np.isin(regressors.columns, CONTROLS)].to_numpy()
    delays = np.arange(0.0, MEMORY, STEP)
    if not controls.shape[1] or len(rows) < 10 * controls.shape[1] * len(delays):
        return rows, None
    earlier = [_earlier(controls, clock, delay)[rows] for delay in delays]
    return rows, linalg.orth(np.hstack([np.ones((len(rows), 1)), *earlier]), RANK_TOLERANCE)


def two_stage(X: Matrix, W: Matrix) -> Array:
    """Return the matrix (k, n) from targets to their weights by X (n, k), with instruments W (n, m), orthonormal."""
    return np.asarray(np.linalg.pinv(W @ (W.T @ X), RANK_TOLERANCE), dtype=float)


def unexplained_by_chance(residuals: Matrix, W: Matrix, n_regressors: int) -> Vector:
    """Return the variance (P,) of residuals (n, P) along surplus instruments W (n, m), beside a constant (Sargan 1958).

    Of what no regressor holds they explain more than chance.
    """
    n_surplus = max(W.shape[1] - 1 - n_regressors, 1)
    return np.sum((W.T @ residuals) ** 2, axis=0) / n_surplus


def _earlier(controls: Matrix, clock: Clock, delay: float) -> Matrix:
    """Return the controls (n, k) a delay [s] earlier, the first ones of a segment before it."""
    moved = np.empty_like(controls)
    for run in clock.segments:
        time = clock.time[run]
        for k, values in enumerate(controls[run].T):
            moved[run, k] = np.interp(time - delay, time, values)
    return moved
