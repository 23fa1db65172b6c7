"""Servos: deflections of the surfaces by their commands, with a first-order lag T, T d delta / dt = c - delta."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lfilter

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.clock import Clock, median_step, n_rows
from skdgp._flight.tables import interpolate_missing
from skdgp.dynamics import limited_change, ramp_weights

LAG_DIFFERENCE = 1e-4  # in slopes by the lag [s]


def servo_output(commands: Matrix, lag: float, step: float, rate_limit: float = np.inf) -> Matrix:
    """Return the outputs (n, k) of servos with a first-order lag [s], exact for inputs linear between samples.

    A limit of their rate [1/s] holds for the mean rate of each step.
    """
    kept, of_before, of_command = ramp_weights(lag, step)
    if np.isinf(rate_limit):
        change = commands - commands[0]
        return lfilter([of_command, of_before], [1, -kept], change, axis=0) + commands[0]
    output = commands.copy()
    for k in range(1, len(output)):
        wanted = kept * output[k - 1] + of_before * commands[k - 1] + of_command * commands[k]
        output[k] = limited_change(output[k - 1], wanted, rate_limit * step)
    return output


def servo_slopes(commands: Matrix, lag: float, step: float) -> tuple[Matrix, tuple[Matrix, Matrix]]:
    """Return the outputs (n, k) of servos, and their derivatives by the lag and by a delay."""
    output = servo_output(commands, lag, step)
    later = servo_output(commands, lag + LAG_DIFFERENCE, step)
    by_lag = (later - output) / LAG_DIFFERENCE
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
