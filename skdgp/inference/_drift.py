"""Drift: the part of the noise that is correlated in time, estimated from the residuals of a posterior."""

from __future__ import annotations

import numpy as np

from skdgp._compute.linalg import output_scale
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._average import Posterior

LEAST_VARIANCE = 1e-6
"""Smallest variance, over the variance of the output."""
LONGEST_HORIZON = 10.0
"""Longest time over which residuals are integrated [s]."""
N_HORIZONS = 12
"""Number of times over which they are integrated."""
MODEL_ERROR = 0.3
"""Relative error of the model, of the variances of integrals; guess."""
LONGEST_GAP = 4.0
"""Interval, over the median one, above which a record ends."""
N_VALUES = 150
"""Values of variance and correlation time that are tried."""


def residual_drift(
    posterior: Posterior,
    X: Matrix,
    Y: Matrix,
    clock: Matrix,
) -> tuple[Vector, Vector]:
    """Return the drift of each output, estimated from the residuals of a posterior.

    Parameters
    ----------
    posterior : ExactPosterior or SparsePosterior
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    clock : ndarray (n, 2)
        Time and flight number of each sample.

    Returns
    -------
    variance, memory : ndarray (P,)
        The variance tau^2 and the correlation time T [s], see ``fit_drift_to_integrals``.
    """
    drifts = []
    least = LEAST_VARIANCE * output_scale(Y) ** 2
    for e, smallest in zip((Y - posterior.predict(X)).T, least, strict=True):
        observed = np.isfinite(e)
        if observed.sum() > 2:
            drifts.append(fit_drift_to_integrals(e[observed], clock[observed], smallest))
        else:
            drifts.append((smallest, 1.0))
    variance, memory = np.transpose(drifts)
    return variance, memory


def fit_drift_to_integrals(residual: Vector, clock: Matrix, least: float) -> tuple[float, float]:
    r"""Return tau^2 and T [s] of white noise plus drift, fitted to the integrals of the residuals (n,) over time.

    A simulated flight integrates the errors of the coefficients, so the estimate is judged by
    integrals. Over a time h, the integral of white noise with the sample interval d and of a drift
    has the variance

    .. math:: \sigma^2 d h + 2 \tau^2 T^2 (h / T - 1 + e^{-h / T}).

    tau^2 and T minimise the squared differences between its logarithm and the logarithm of the
    residuals' variance, over horizons h from two sample intervals to 10 s or the longest record.
    sigma^2 + tau^2 is the mean square of the residuals. With n = the time flown over h, a logarithm
    has the weight 1 / (0.3^2 + 2 / n): the variance of n squares, and an error of the model.
    Residuals are not exactly white noise plus a drift: maximum likelihood would fit the differences
    of neighbouring samples best, and integrals over seconds worse.

    The constant of the function takes up the mean of the residuals, so the mean square of n
    independent integrals is multiplied by n / (n - 1). The clock (n, 2) holds time and flight; no
    variance is smaller than ``least``.
    """
    order = np.lexsort(clock.T)
    integrals, step = _integrals(residual[order], *clock[order].T)
    lengths = [elapsed[-1] for elapsed, _ in integrals]
    longest = max(*lengths, 2 * step)
    flown = sum(lengths)
    power = max(float(np.mean(residual**2)), 10 * least)

    horizons = np.geomspace(2 * step, min(longest, max(LONGEST_HORIZON, 2 * step)), N_HORIZONS)
    changes = [np.concatenate([_changes(*part, h) for part in integrals]) for h in horizons]
    squares = np.array([change @ change / max(len(change), 1) for change in changes])
    usable = (squares > 0) & (horizons < flown)
    if not usable.any():  # nothing shows a drift
        return least, step
    horizons = horizons[usable]
    target = np.log(squares[usable] / (1 - horizons / flown))
    weight = 1 / (MODEL_ERROR**2 + 2 * horizons / flown)

    # a grid, as the loss has several minima
    variance = np.geomspace(least, power, N_VALUES)[:, None, None]
    memory = np.geomspace(step, longest, N_VALUES)[:, None]
    ratio = horizons / memory
    drift = 2 * variance * memory**2 * (ratio + np.expm1(-ratio))
    white = (power - variance) * step * horizons
    loss = (np.log(drift + white) - target) ** 2 @ weight
    i, j = np.unravel_index(loss.argmin(), loss.shape)
    return float(variance[i, 0, 0]), float(memory[j, 0])


def _integrals(
    residual: Vector, time: Vector, flight: Vector
) -> tuple[list[tuple[Vector, Vector]], float]:
    """Return elapsed time and integral of each record without a gap, and the median sample interval."""
    steps = np.diff(time)
    is_same = np.diff(flight) == 0
    moving = steps[is_same & (steps > 0)]
    step = float(np.median(moving)) if len(moving) else 1.0
    ends = ~is_same | (steps > LONGEST_GAP * step)
    records = []
    for rows in np.split(np.arange(len(time)), 1 + np.flatnonzero(ends)):
        elapsed = time[rows] - time[rows[0]]
        areas = residual[rows[:-1]] * np.diff(elapsed)
        records.append((elapsed, np.concatenate([[0.0], np.cumsum(areas)])))
    return records, step


def _changes(elapsed: Vector, integral: Vector, horizon: float) -> Vector:
    """Return the integrals over a horizon from each time of a record that is followed by it."""
    start = elapsed + horizon <= elapsed[-1] * (1 + 1e-9)
    return np.interp(elapsed[start] + horizon, elapsed, integral) - integral[start]
