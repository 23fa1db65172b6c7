"""Drift: the part of the noise that is correlated in time, estimated from the residuals of a posterior."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skdgp._compute.linalg import output_scale
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp.inference._posterior import Posterior

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


class Drift(NamedTuple):
    """White noise sigma^2 and drift tau^2 exp(-t / T) of one output."""

    white: float
    variance: float
    memory: float


def residual_drift(
    posterior: Posterior,
    X: Matrix,
    Y: Matrix,
    clock: Matrix,
) -> Matrix:
    """Return white noise and drift estimated from the residuals of a posterior.

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
    ndarray (3, P)
        The variances sigma^2 and tau^2 and the correlation time T [s] of each output, see
        ``fit_drift_to_integrals``.
    """
    residual = Y - posterior.predict(X)
    drifts = []
    for e, scale in zip(residual.T, output_scale(Y), strict=True):
        least = LEAST_VARIANCE * scale**2
        observed = np.isfinite(e)
        if observed.sum() > 2:
            drift = fit_drift_to_integrals(e[observed], clock[observed], least)
        else:
            drift = Drift(least, least, 1.0)
        drifts.append(drift)
    return np.transpose(drifts)


def fit_drift_to_integrals(residual: Vector, clock: Matrix, least: float) -> Drift:
    r"""Return sigma^2, tau^2 and T of white noise plus drift, fitted to the integrals of the residuals (n,) over time.

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
    residual = residual[order]
    records, step = _records(clock[order])
    lengths = [np.ptp(record.time) for record in records]
    longest = max(max(lengths), 2 * step)
    flown = sum(lengths)
    power = max(float(np.mean(residual**2)), 10 * least)

    horizons = np.geomspace(2 * step, max(min(longest, LONGEST_HORIZON), 2 * step), N_HORIZONS)
    squares = _mean_squared_integrals(residual, records, horizons)
    usable = (squares > 0) & (horizons < flown)
    if not usable.any():  # nothing shows a drift
        return Drift(power, least, step)
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
    best = float(variance[i, 0, 0])
    return Drift(max(power - best, least), best, float(memory[j, 0]))


class _Record(NamedTuple):
    """Rows without a gap, and their times."""

    rows: Indices
    time: Vector


def _records(clock: Matrix) -> tuple[list[_Record], float]:
    """Return the records of samples in order, and the median sample interval."""
    time, flight = clock.T
    same = flight[1:] == flight[:-1]
    steps = np.diff(time)
    moving = steps[same & (steps > 0)]
    step = float(np.median(moving)) if len(moving) else 1.0
    ends = ~same | (steps > LONGEST_GAP * step)
    rows = np.split(np.arange(len(time)), 1 + np.flatnonzero(ends))
    return [_Record(part, time[part]) for part in rows], step


def _mean_squared_integrals(
    residual: Vector, records: Sequence[_Record], horizons: Vector
) -> Vector:
    """Return the mean square of the integrals of the residuals over each horizon, within records; NaN without one."""
    total = np.zeros(len(horizons))
    count = np.zeros(len(horizons))
    for rows, time in records:
        elapsed = time - time[0]
        integral = np.concatenate([[0.0], np.cumsum(residual[rows[:-1]] * np.diff(elapsed))])
        for k, horizon in enumerate(horizons):
            inside = elapsed + horizon <= elapsed[-1] * (1 + 1e-9)
            later = np.interp(elapsed[inside] + horizon, elapsed, integral)
            change = later - integral[inside]
            total[k] += change @ change
            count[k] += len(change)
    return np.divide(total, count, out=np.full(len(horizons), np.nan), where=count > 0)
