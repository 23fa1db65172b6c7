r"""Slopes by instrumental variables, which noise of the regressors does not flatten.

Controls do not follow the noise of other regressors, nor the rates of the air. Slopes by the part of the
regressors X that controls W of the last second explain (two-stage least squares: Söderström & Stoica 1989,
section 8.1),

.. math:: b_W = (X^T P X)^{-1} X^T P y, \quad P = W (W^T W)^{-1} W^T,

are therefore right where those by least squares are too small, and less certain. Without such noise their
difference D has the covariance :math:`S = \sigma^2 ((X^T P X)^{-1} - (X^T X)^{-1})`, and
:math:`T = D^T S^{-1} D` the mean k of k noisy regressors (Hausman 1978). Least squares lacks
:math:`(1 - k / T) D` if T > k (a positive part estimator: James & Stein 1961), known as well as D.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg

from skdgp._compute.linalg import eigen_root
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix
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


def by_instruments(regressors: pd.DataFrame, Y: Any, clock: Clock) -> KnownSlopes | None:
    """Return the slopes of targets (n, P) by regressors (n, d) of flights with a clock.

    None where rows are fewer than ten for each instrument, or all or none of the regressors are controls.
    """
    is_control = np.isin(regressors.columns, CONTROLS)
    delays = np.arange(0.0, MEMORY, STEP)
    n_instruments = np.count_nonzero(is_control) * len(delays)
    n_noisy = np.count_nonzero(~is_control)
    Y = np.asarray(Y, dtype=float)
    rows = np.flatnonzero((clock.elapsed > MEMORY) & np.isfinite(Y).all(axis=1))
    if not n_instruments or not n_noisy or len(rows) < 10 * n_instruments:
        return None
    X = regressors.to_numpy()
    earlier = [_earlier(X[:, is_control], clock, delay)[rows] for delay in delays]
    W = linalg.orth(np.hstack([np.ones((len(rows), 1)), *earlier]), RANK_TOLERANCE)
    x, y = (values[rows] - values[rows].mean(axis=0) for values in (X, Y))
    of_controls = np.linalg.pinv(W @ (W.T @ x), RANK_TOLERANCE)
    of_all = np.linalg.pinv(x, RANK_TOLERANCE)
    difference = ((of_controls - of_all) @ y).T
    residuals = y - x @ (of_controls @ y)
    variance = np.array([autocorrelation_time(e) * np.mean(e**2) for e in residuals.T])
    # of what no regressor holds, surplus instruments explain more than chance (Sargan 1958)
    n_surplus = max(W.shape[1] - 1 - x.shape[1], 1)
    variance = np.maximum(variance, np.sum((W.T @ residuals) ** 2, axis=0) / n_surplus)
    covariance = of_controls @ of_controls.T - of_all @ of_all.T
    # a control is its own instrument: the difference has the rank of the other regressors
    precision = linalg.pinvh(covariance[np.ix_(~is_control, ~is_control)])
    D = difference[:, ~is_control]
    statistic = np.einsum("pj,jk,pk->p", D, precision, D) / variance
    weight = 1.0 - n_noisy / np.maximum(statistic, n_noisy)
    value = linear_weights(X, Y)[1:].T + weight[:, None] * difference
    root = np.sqrt(variance)[:, None, None] * eigen_root(covariance)[:, -n_noisy:]
    # of each output by itself
    errors = np.einsum("pdk,pq->pdqk", root, np.eye(len(root)))
    return KnownSlopes(value, errors.reshape(*value.shape, -1), includes_noise=False)


def _earlier(controls: Matrix, clock: Clock, delay: float) -> Matrix:
    """Return the controls (n, k) a delay [s] earlier, the first ones of a segment before it."""
    moved = np.empty_like(controls)
    for run in clock.segments:
        time = clock.time[run]
        for k, values in enumerate(controls[run].T):
            moved[run, k] = np.interp(time - delay, time, values)
    return moved
