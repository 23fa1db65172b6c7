"""Channels without their lag: values at t + tau instead of t, segment by segment."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from skdgp._compute.typing import Vector
from skdgp._flight.clock import Clock, uniform_grid


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

    They are continued oddly beyond both ends, and the line between these is shifted by itself, so
    that the periodic signal is continuous (Oppenheim & Schafer 2010, section 4.5).
    """
    margin = min(len(values) - 1, 64 + int(np.ceil(abs(steps))))
    padded = np.pad(values, margin, mode="reflect", reflect_type="odd")
    n = len(padded)
    slope = (padded[-1] - padded[0]) / (n - 1)
    line = padded[0] + slope * np.arange(n)
    phase = np.exp(2j * np.pi * np.fft.rfftfreq(n) * steps)
    periodic = np.fft.irfft(np.fft.rfft(padded - line) * phase, n)
    shifted = periodic + line + slope * steps
    return shifted[margin : n - margin]
