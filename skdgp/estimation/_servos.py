"""Channels moved in time: deflections by their commands, and sensors without their lag, segment by segment.

Servos have a first-order lag T, T d delta / dt = c - delta.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.clock import Clock, uniform_grid
from skdgp.dynamics import ramp_weights


def servo_output(commands: Matrix, lag: float, step: float, rate_limit: float = np.inf) -> Matrix:
    """Return the outputs (n, k) of servos with a first-order lag [s], exact for inputs linear between samples.

    A limit of their rate [1/s] holds for the mean rate of each step.
    """
    kept, of_before, of_command = ramp_weights(lag, step)
    if np.isinf(rate_limit):
        change = commands - commands[0]
        return lfilter([of_command, of_before], [1, -kept], change, axis=0) + commands[0]
    push = of_before * commands[:-1] + of_command * commands[1:]
    reach = rate_limit * step
    outputs = []
    # numbers of Python, as NumPy takes ten times as long for one at a time
    for first, pushes in zip(commands[0].tolist(), push.T.tolist(), strict=True):
        output = [first]
        for now in pushes:
            begun = output[-1]
            output.append(min(max(kept * begun + now, begun - reach), begun + reach))
        outputs.append(output)
    return np.array(outputs).T


def without_lag(
    time: Vector, values: Vector, lag: float, flight: Any = None, *, noisy: bool, repeats: bool
) -> Vector:
    """Return a channel (n,) without its lag [s], on the rows where it was sampled.

    Parameters
    ----------
    time, values : ndarray (n,)
        Clock [s] and channel, NaN where not sampled.
    lag : float
        Positive if late [s].
    flight : array-like (n,), optional
        Identifiers of flights.
    noisy : bool
        Whether a channel on a uniform clock is shifted in the frequency domain, which keeps white
        noise white. Otherwise by cubic splines.
    repeats : bool
        Whether the last value stands beyond the end of a segment. Otherwise NaN.

    Returns
    -------
    ndarray (n,)
    """
    out = values.copy()
    rows = np.flatnonzero(np.isfinite(values))
    names = None if flight is None else np.asarray(flight)[rows]
    for run in Clock.of(time[rows], names).segments:
        run_rows = rows[run]
        n = len(run_rows)
        if n < 2:
            continue
        grid, jittered = uniform_grid(time[run_rows])
        clock = time[run_rows] if jittered else grid
        later = clock + lag
        if noisy and not jittered:
            rate = (n - 1) / (grid[-1] - grid[0])
            shifted = _advanced(values[run_rows], lag * rate)
        else:
            shifted = CubicSpline(clock, values[run_rows])(np.clip(later, clock[0], clock[-1]))
        shifted[later > clock[-1]] = values[run_rows[-1]] if repeats else np.nan
        shifted[later < clock[0]] = values[run_rows[0]] if repeats else np.nan
        out[run_rows] = shifted
    return out


def _advanced(values: Vector, steps: float) -> Vector:
    """Return equidistant values a fraction of steps later: every frequency's phase is shifted, white noise stays white.

    Less the line through both ends, which is shifted by itself, they are continued oddly beyond these, so
    that the periodic signal is continuous (Oppenheim & Schafer 2010, section 4.5).
    """
    line = np.linspace(values[0], values[-1], len(values))
    rest = values - line
    periodic = np.concatenate([rest, -rest[-2:0:-1]])
    n = len(periodic)
    phase = np.exp(2j * np.pi * np.fft.rfftfreq(n) * steps)
    shifted = np.fft.irfft(np.fft.rfft(periodic) * phase, n)
    return shifted[: len(line)] + line + steps * (line[1] - line[0])
