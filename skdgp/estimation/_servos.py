"""Servos: deflections of the surfaces by their commands, with a first-order lag T, T d delta / dt = c - delta."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lfilter

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.clock import Clock, median_step, n_rows
from skdgp._flight.tables import interpolate_missing
from skdgp.estimation._settings import SERVOS


def servo_output(commands: Matrix, lag: float, step: float, rate_limit: float = np.inf) -> Matrix:
    """Return the outputs (n, k) of servos with a first-order lag [s], exact for inputs linear between samples.

    A limit of their rate [1/s] holds for the mean rate of each step.
    """
    r = max(lag, SERVOS.least_lag) / step
    a = np.exp(-1 / r)
    if np.isfinite(rate_limit):
        return _limited_output(commands, r, a, rate_limit * step)
    numerator = [1 - (1 - a) * r, (1 - a) * r - a]
    denominator = [1, -a]
    return lfilter(numerator, denominator, commands - commands[0], axis=0) + commands[0]


def _limited_output(commands: Matrix, r: float, a: float, reach: float) -> Matrix:
    """Return the outputs of servos that move at most by ``reach`` in a step; r is the lag in steps, a = exp(-1 / r)."""
    output = np.empty_like(commands)
    output[0] = delta = commands[0]
    for k, change in enumerate(np.diff(commands, axis=0)):
        behind = r * change
        wanted = commands[k + 1] - behind + a * (delta - commands[k] + behind)
        delta = delta + np.minimum(np.maximum(wanted - delta, -reach), reach)
        output[k + 1] = delta
    return output


def servo_slopes(commands: Matrix, lag: float, step: float) -> tuple[Matrix, tuple[Matrix, Matrix]]:
    """Return the outputs (n, k) of servos, and their derivatives by the lag and by a delay."""
    lag = max(lag, SERVOS.least_lag)
    output = servo_output(commands, lag, step)
    later = servo_output(commands, lag + SERVOS.lag_difference, step)
    by_lag = (later - output) / SERVOS.lag_difference
    return output, (by_lag, -np.gradient(output, step, axis=0))


def delayed_surfaces(
    time: Vector, commands: Matrix, lag: float, flight: Any = None, rate_limit: float = np.inf
) -> Matrix:
    r"""Return the deflections (n, k) of servos with a first-order lag.

    They solve :math:`T \dot\delta = c - \delta` within each gap-free segment, in which the servos begin
    at rest.

    Parameters
    ----------
    time : ndarray (n,)
        [s].
    commands : ndarray (n, k)
        Commands c; NaN is interpolated.
    lag : float
        T [s].
    flight : array-like (n,), optional
        Identifiers of flights.
    rate_limit : float, default=inf
        Largest rate of the deflections, in their unit per second.

    Returns
    -------
    ndarray (n, k)

    Examples
    --------
    >>> import numpy as np
    >>> time = 0.02 * np.arange(100)
    >>> ramp = time[:, None]
    >>> delayed_surfaces(time, ramp, 0.1)[-1].round(3)
    array([1.88])
    """
    out = np.empty_like(commands)
    commands = interpolate_missing(time, commands)
    for run in Clock.of(time, flight).segments:
        # a single sample is at rest, whatever the step
        step = median_step(time, [run]) if n_rows(run) > 1 else 1.0
        out[run] = servo_output(commands[run], lag, step, rate_limit)
    return out
