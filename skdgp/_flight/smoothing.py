"""Zero-phase smoothing and differentiation of flight logs, one contiguous stretch at a time.

Two smoothers. A cutoff in Hz is SciPy's Butterworth filter run forwards and backwards. ``"auto"`` is the Wiener
smoother that the channels' own spectra imply: see ``_spectrum``.
"""

from __future__ import annotations

import warnings
from numbers import Real
from typing import NamedTuple

import numpy as np
from scipy import interpolate, signal

from skdgp._flight.clock import check_clock, flight_segments, runs_by_flight, uniform_grid
from skdgp._flight.wiener import (
    LEAST_SAMPLES,
    convolve,
    expected_error,
    flight_spectrum,
    impulse_response,
    joint_gain,
    noise_floors,
    own_gain,
)

__all__ = ["NoiseLevel", "differentiate", "flight_segments", "noise_level", "smooth"]

ORDER = 2


def smooth(values, time, *, cutoff="auto", flight=None, joint=False) -> np.ndarray:
    """Remove sensor noise without delay, segment by segment.

    Parameters
    ----------
    values : array-like of shape (n,) or (n, k)
        Channels. NaN means not sampled: such rows stay NaN and the channel is filtered on the clock of its
        other rows (so a slow sensor in a fast table is fine). Unwrap angles that pass through +-pi first.
    time : array-like of shape (n,)
        Time [s], strictly increasing within a flight. Jittered clocks are resampled to a uniform grid and
        back.
    cutoff : float, "auto" or None, default="auto"
        Corner frequency [Hz] of a forward-backward Butterworth filter (gain 1/2 there), or the Wiener
        smoother chosen by the spectrum of each channel over its flight, or no smoothing. A flight without a
        stretch of 128 samples is too short to tell noise from signal: "auto" warns and leaves it as it is.
    flight : array-like of shape (n,), optional
        Flight identifiers.
    joint : bool, default=False
        With "auto": estimate each channel from all that were sampled at the same rows, through their cross-spectra,
        instead of from itself alone. For few channels that move together, such as alpha and q.

    Returns
    -------
    ndarray
        Smoothed values, shaped like ``values``.

    Raises
    ------
    ValueError
        If time is not increasing or too irregular, a value is infinite, or the cutoff is not below half the
        sampling rate.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 60, 0.025)
    >>> truth = 0.1 * np.sin(2 * np.pi * 0.5 * time)
    >>> noisy = truth + np.random.default_rng(0).normal(0, 0.02, time.size)
    >>> bool(np.std(smooth(noisy, time) - truth) < 0.3 * np.std(noisy - truth))
    True
    """
    return _per_channel(values, time, flight, cutoff, joint, derivative=False)


def differentiate(values, time, *, cutoff="auto", flight=None, joint=False) -> np.ndarray:
    """Return the rate of change of the smoothed channels: the slope of the cubic spline through them.

    Parameters are those of :func:`smooth`. A segment of a single sample has no rate: NaN, with a warning.

    Returns
    -------
    ndarray
        Derivatives [unit of values per second], shaped like ``values``.

    Raises
    ------
    ValueError
        As :func:`smooth`.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 10, 0.1)
    >>> rate = differentiate(np.sin(time), time, cutoff=None)
    >>> bool(np.allclose(rate, np.cos(time), atol=1e-4))
    True
    """
    return _per_channel(values, time, flight, cutoff, joint, derivative=True)


class NoiseLevel(NamedTuple):
    """White noise of each channel: in the measurement, and what is left of the error after ``smooth``."""

    measured: np.ndarray
    smoothed: np.ndarray


def noise_level(values, time, *, flight=None, joint=False) -> NoiseLevel:
    """Estimate the standard deviation of the white noise in each channel, before and after ``smooth``.

    Parameters
    ----------
    values : array-like of shape (n,) or (n, k)
        Channels, as for :func:`smooth`.
    time : array-like of shape (n,)
        Time [s].
    flight : array-like of shape (n,), optional
        Flight identifiers; flights are pooled by their number of samples.
    joint : bool, default=False
        As for :func:`smooth`.

    Returns
    -------
    NoiseLevel
        ``measured`` and ``smoothed``, each of shape (k,) or (); NaN where every flight is too short.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.arange(0, 60, 0.025)
    >>> noise = np.random.default_rng(0).normal(0, 0.02, time.size)
    >>> bool(abs(noise_level(np.sin(time) + noise, time).measured - 0.02) < 1e-3)
    True
    """
    columns = _columns(values)
    time, codes = check_clock(time, flight)
    _same_length(columns, time)
    found = np.full((2, columns.shape[1]), np.nan)
    for rows, channels in _same_rows(columns):
        part, levels, weights = columns[np.ix_(rows, channels)], [], []
        for runs in runs_by_flight(time[rows], codes[rows]):
            spectrum = _spectrum(part, time[rows], runs)
            if spectrum is not None:
                floor, gain = _wiener(spectrum, joint)
                levels.append((floor * spectrum.frequency[-1], expected_error(spectrum, floor, gain)))
                weights.append(sum(run.stop - run.start for run in runs))
        if levels:
            found[:, channels] = np.sqrt(np.average(levels, axis=0, weights=weights))
    return NoiseLevel(*(found[:, 0] if np.ndim(values) == 1 else found))


def _per_channel(values, time, flight, cutoff, joint, *, derivative):
    """Filter each group of channels that were sampled at the same rows."""
    columns = _columns(values)
    time, codes = check_clock(time, flight)
    _same_length(columns, time)
    _check_cutoff(cutoff)
    out = np.full(columns.shape, np.nan)
    remarks = set()
    for rows, channels in _same_rows(columns):
        part = columns[np.ix_(rows, channels)]
        out[np.ix_(rows, channels)] = _per_flight(part, time[rows], codes[rows], cutoff, joint, derivative, remarks)
    for remark in sorted(remarks):
        warnings.warn(remark, UserWarning, stacklevel=3)
    return out.reshape(np.shape(values))


def _same_rows(columns):
    """Rows and channels of each group of channels that were sampled at the same rows."""
    masks, group = np.unique(np.isfinite(columns), axis=1, return_inverse=True)
    groups = ((np.flatnonzero(keep), np.flatnonzero(group.ravel() == g)) for g, keep in enumerate(masks.T))
    return [(rows, channels) for rows, channels in groups if rows.size]


def _per_flight(columns, time, codes, cutoff, joint, derivative, remarks):
    out = np.empty_like(columns)
    for runs in runs_by_flight(time, codes):
        kernel = None
        if isinstance(cutoff, str):
            spectrum = _spectrum(columns, time, runs)
            if spectrum is None:
                remarks.add(
                    f"A flight has no gap-free stretch of {LEAST_SAMPLES} samples: too short to tell "
                    "noise from signal, so cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff "
                    "in Hz."
                )
            else:
                kernel = impulse_response(_wiener(spectrum, joint)[1])
        for run in runs:
            out[run] = _filter_run(columns[run], time[run], cutoff, kernel, derivative)
            if derivative and run.stop - run.start == 1:
                remarks.add(
                    "A segment of a single sample has no rate of change: its derivative is NaN. "
                    "Drop isolated samples, or give the whole flight at its full rate."
                )
    return out


def _filter_run(columns, time, cutoff, kernel, derivative):
    """Smooth one gap-free run on a uniform grid; return values or slopes at its own times."""
    n = len(time)
    if n == 1:
        return np.full_like(columns, np.nan) if derivative else columns
    if cutoff is None or (kernel is None and isinstance(cutoff, str)):
        grid, jittered = uniform_grid(time)
        return _slope(columns, time if jittered else grid) if derivative else columns
    grid, jittered = uniform_grid(time)
    on_grid = interpolate.CubicSpline(time, columns)(grid) if jittered else columns
    step = (grid[-1] - grid[0]) / (len(grid) - 1)
    smoothed = _butterworth(on_grid, 1 / step, cutoff) if kernel is None else convolve(on_grid, kernel)
    if not jittered:
        return _slope(smoothed, grid) if derivative else smoothed
    return interpolate.CubicSpline(grid, smoothed)(time, int(derivative))


def _spectrum(columns, time, runs):
    """Spectrum of one flight, or None."""
    steps = np.concatenate([np.diff(time[run]) for run in runs])
    return flight_spectrum([columns[run] for run in runs], np.median(steps)) if steps.size else None


def _wiener(spectrum, joint):
    """Noise floors and gains, each channel's own or joint."""
    floor = noise_floors(spectrum)
    return floor, (joint_gain if joint else own_gain)(spectrum, floor)


def _slope(columns, time):
    return interpolate.CubicSpline(time, columns)(time, 1)


def _butterworth(columns, rate, cutoff):
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half the "
            f"sampling rate ({rate / 2:.4g} Hz): lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(ORDER, cutoff, fs=rate, output="sos")
    reach = min(len(columns) - 1, int(np.ceil(5 * rate / cutoff)))
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=reach)


def _columns(values):
    columns = np.asarray(values, dtype=float)
    if columns.ndim not in (1, 2):
        raise ValueError(f"Got values of shape {columns.shape}, but expected (n,) or (n, k).")
    columns = columns.reshape(len(columns), -1)
    if np.isinf(columns).any():
        raise ValueError(
            f"Got {int(np.isinf(columns).sum())} infinite values, but expected finite ones or NaN (not "
            "sampled): replace them by NaN."
        )
    return columns


def _same_length(columns, time):
    if len(columns) != len(time):
        raise ValueError(f"Got {len(columns)} rows of values and {len(time)} times, but expected as many.")


def _check_cutoff(cutoff):
    if cutoff is None or (isinstance(cutoff, str) and cutoff == "auto"):
        return
    if not isinstance(cutoff, Real) or isinstance(cutoff, bool) or not (np.isfinite(cutoff) and cutoff > 0):
        raise ValueError(
            f"Got cutoff={cutoff!r}, but expected a positive frequency [Hz], 'auto', or None (no smoothing)."
        )
