"""Zero-phase smoothing and differentiation of flight logs, one contiguous stretch at a time.

Two smoothers. A cutoff in Hz is SciPy's Butterworth filter run forwards and backwards. ``"auto"`` is the
Wiener smoother that each channel's own spectrum implies: with P(f) the measured power and N the sensor's
white noise,

    H(f) = max(0, 1 - N / P(f)), made non-increasing in f,

the linear zero-phase filter of least mean squared error (Wiener 1949). N is the part of P that does not
fall towards the Nyquist frequency; a channel without such a part has N = 0 and comes through unchanged.
"""

from __future__ import annotations

import warnings
from itertools import pairwise
from numbers import Real
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import interpolate, ndimage, optimize, signal

GAP = 2.5
"""A step longer than this many median steps starts a new segment (one lost sample is bridged)."""
JITTER = 0.02
"""Samples nearer than this fraction of a step to a uniform grid are taken to lie on it (rounded clocks)."""
WINDOW_SECONDS = 6.4
SHORTEST_WINDOW = 32
ORDER = 2
EVIDENCE = 2.0
"""Gain in log likelihood from which white noise is believed in."""


def flight_segments(time, flight=None) -> list[slice]:
    """Split a log into contiguous stretches of one flight without gaps.

    A new segment starts where ``flight`` changes and where a step exceeds 2.5 times the median step of its
    flight.

    Parameters
    ----------
    time : array-like of shape (n,)
        Time [s], strictly increasing within a flight.
    flight : array-like of shape (n,), optional
        Flight identifiers, rows of a flight together; by default all rows are one flight.

    Returns
    -------
    list of slice
        In order, covering every row once.

    Raises
    ------
    ValueError
        If time is not finite, does not increase, or steps so irregularly that no sampling rate can be told.

    Examples
    --------
    >>> flight_segments([0.0, 0.1, 0.2, 0.9, 1.0, 0.0, 0.1], ["a"] * 5 + ["b"] * 2)
    [slice(0, 3, None), slice(3, 5, None), slice(5, 7, None)]
    """
    time, codes = _check_clock(time, flight)
    return _split(time, codes)


def smooth(values, time, *, cutoff="auto", flight=None) -> np.ndarray:
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
    return _per_channel(values, time, flight, cutoff, derivative=False)


def differentiate(values, time, *, cutoff="auto", flight=None) -> np.ndarray:
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
    return _per_channel(values, time, flight, cutoff, derivative=True)


class NoiseLevel(NamedTuple):
    """White noise of each channel: in the measurement, and what is left of the error after ``smooth``."""

    measured: np.ndarray
    smoothed: np.ndarray


def noise_level(values, time, *, flight=None) -> NoiseLevel:
    """Estimate the standard deviation of the white noise in each channel, before and after ``smooth``.

    The expected squared error of a Wiener smoother is the integral of N H(f) over frequency.

    Parameters
    ----------
    values : array-like of shape (n,) or (n, k)
        Channels, as for :func:`smooth`.
    time : array-like of shape (n,)
        Time [s].
    flight : array-like of shape (n,), optional
        Flight identifiers; flights are pooled by their number of samples.

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
    time, codes = _check_clock(time, flight)
    _same_length(columns, time)
    found = np.full((2, columns.shape[1]), np.nan)
    for j, column in enumerate(columns.T):
        keep = np.isfinite(column)
        levels = []
        for runs in _runs_by_flight(time[keep], codes[keep]):
            spectrum = _spectrum(column[keep, None], time[keep], runs)
            if spectrum is not None:
                gain, floor = _wiener_gain(spectrum)
                left = np.trapezoid(gain[:, 0], spectrum.frequency) * floor[0]
                levels.append((sum(r.stop - r.start for r in runs), floor[0] * spectrum.frequency[-1], left))
        if levels:
            weight, measured, smoothed = np.array(levels).T
            found[:, j] = np.sqrt(np.average([measured, smoothed], axis=1, weights=weight))
    return NoiseLevel(*(found[:, 0] if np.ndim(values) == 1 else found))


def _per_channel(values, time, flight, cutoff, *, derivative):
    """Filter each group of channels that were sampled at the same rows."""
    columns = _columns(values)
    time, codes = _check_clock(time, flight)
    _same_length(columns, time)
    _check_cutoff(cutoff)
    out = np.full(columns.shape, np.nan)
    masks, group = np.unique(np.isfinite(columns), axis=1, return_inverse=True)
    remarks = set()
    for g, keep in enumerate(masks.T):
        channels = np.flatnonzero(group.ravel() == g)
        rows = np.flatnonzero(keep)
        if rows.size:
            part = _per_flight(columns[np.ix_(rows, channels)], time[rows], codes[rows], cutoff, derivative, remarks)
            out[np.ix_(rows, channels)] = part
    for remark in sorted(remarks):
        warnings.warn(remark, UserWarning, stacklevel=3)
    return out.reshape(np.shape(values))


def _per_flight(columns, time, codes, cutoff, derivative, remarks):
    out = np.empty_like(columns)
    for runs in _runs_by_flight(time, codes):
        kernel = None
        if isinstance(cutoff, str):
            spectrum = _spectrum(columns, time, runs)
            if spectrum is None:
                remarks.add(
                    f"A flight has no gap-free stretch of {4 * SHORTEST_WINDOW} samples: too short to tell "
                    "noise from signal, so cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff "
                    "in Hz."
                )
            else:
                kernel = _impulse_response(_wiener_gain(spectrum)[0])
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
        grid, jittered = _grid(time)
        return _slope(columns, time if jittered else grid) if derivative else columns
    grid, jittered = _grid(time)
    on_grid = interpolate.CubicSpline(time, columns)(grid) if jittered else columns
    step = (grid[-1] - grid[0]) / (len(grid) - 1)
    smoothed = _butterworth(on_grid, 1 / step, cutoff) if kernel is None else _convolve(on_grid, kernel)
    if not jittered:
        return _slope(smoothed, grid) if derivative else smoothed
    return interpolate.CubicSpline(grid, smoothed)(time, int(derivative))


def _slope(columns, time):
    return interpolate.CubicSpline(time, columns)(time, 1)


def _grid(time):
    """Return the uniform grid of a run, and whether the samples lie off it (so must be resampled)."""
    n = len(time)
    if n < 3:
        return time, False
    count = np.arange(n)
    line = np.polynomial.Polynomial.fit(count, time, 1)(count)
    step = (line[-1] - line[0]) / (n - 1)
    if np.abs(time - line).max() <= JITTER * step:
        return line, False
    size = max(n, 1 + round((time[-1] - time[0]) / np.median(np.diff(time))))
    return np.linspace(time[0], time[-1], size), True


def _butterworth(columns, rate, cutoff):
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half the "
            f"sampling rate ({rate / 2:.4g} Hz): lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(ORDER, cutoff, fs=rate, output="sos")
    reach = min(len(columns) - 1, int(np.ceil(5 * rate / cutoff)))
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=reach)


class _Spectrum(NamedTuple):
    frequency: np.ndarray  # (m,) [Hz]
    power: np.ndarray  # (m, k)
    averages: float  # independent periodograms in it


def _spectrum(columns, time, runs) -> _Spectrum | None:
    """Welch's spectrum of a flight, averaged over its runs; None where no run is long enough."""
    longest = max(run.stop - run.start for run in runs)
    step = np.median(np.concatenate([np.diff(time[run]) for run in runs])) if longest > 1 else np.nan
    if longest // 4 < SHORTEST_WINDOW:
        return None
    window = 2 * (min(int(max(WINDOW_SECONDS / step, 2 * SHORTEST_WINDOW)), longest // 4) // 2)
    power, weight = 0.0, 0
    for run in runs:
        if run.stop - run.start >= window:
            # By count, not resampled: interpolation between jittered samples would colour white noise.
            for part in (columns[run], columns[run][::-1]):  # windows from either end: no sample is left over
                frequency, found = signal.welch(part, 1 / step, nperseg=window, detrend="linear", axis=0)
                power, weight = power + found * len(part), weight + len(part)
    return _Spectrum(frequency, power / weight, 0.75 * weight / window)  # Hann windows that overlap by half


def _wiener_gain(spectrum):
    """Gains H(f), (m, k), and noise floors N, (k,)."""
    floor = np.array([_noise_floor(spectrum.frequency, power, spectrum.averages) for power in spectrum.power.T])
    steady = np.exp(ndimage.gaussian_filter1d(np.log(spectrum.power + 1e-300), 1.0, axis=0, mode="nearest"))
    gain = np.where(floor > 0, np.clip(1 - floor / steady, 0, 1), 1.0)
    gain[0] = 1.0  # the mean of a channel is signal
    return np.minimum.accumulate(gain, axis=0), floor


def _noise_floor(frequency, power, averages):
    """Return the flat part of the upper half of a spectrum, the falling part taken away.

    A sampled process whose power falls as f^-2k appears, folded at the Nyquist frequency F, near
    sin(pi f / 2F)^-2k. These shapes and a constant are fitted with non-negative shares; the constant stands only if
    Whittle's log likelihood without it is lower by more than ``EVIDENCE``.
    """
    top = slice(len(power) // 2, -1)
    observed = power[top]
    if not observed.min() > 1e-24 * power.max():
        return 0.0
    fall = np.sin(0.5 * np.pi * frequency[top] / frequency[-1]) ** -2
    shapes = np.column_stack([fall**k for k in (0, 1, 2, 4, 8)])
    shapes /= shapes.max(axis=0)
    share, misfit = _fit_shares(shapes, observed)
    _, misfit_without = _fit_shares(shapes[:, 1:], observed)
    return share[0] if averages * (misfit_without - misfit) > EVIDENCE else 0.0


def _fit_shares(shapes, observed):
    """Non-negative shares of the shapes, and minus Whittle's log likelihood of one periodogram."""
    fitted = observed
    for _ in range(4):
        share, _ = optimize.nnls(shapes / fitted[:, None], observed / fitted)
        fitted = shapes @ share
    return share, np.sum(np.log(fitted) + observed / fitted)


def _impulse_response(gain):
    """Symmetric impulse responses, (2 m - 3, k), of the gains; Hann-tapered, of unit sum."""
    window = 2 * (len(gain) - 1)
    response = np.fft.fftshift(np.fft.irfft(gain, window, axis=0), axes=0)[1:]
    response *= signal.windows.hann(window + 1)[1:-1, None]
    return response / response.sum(axis=0)


def _convolve(columns, kernel):
    reach = len(kernel) // 2
    padded = np.pad(columns, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return signal.oaconvolve(padded, kernel, mode="valid", axes=0)


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


def _check_clock(time, flight):
    """Return time (n,) as float and integer flight codes (n,)."""
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or not np.isfinite(time).all():
        raise ValueError(f"Got time of shape {time.shape}, but expected (n,), every value finite [s].")
    codes = np.zeros(len(time), int) if flight is None else pd.factorize(np.asarray(flight))[0]
    _same_length(codes, time)
    step = np.diff(time)
    back = np.flatnonzero((step <= 0) & (np.diff(codes) == 0))
    if back.size:
        row = back[0] + 1
        raise ValueError(
            f"Got time {time[row]:g} s after {time[row - 1]:g} s at row {row}, but expected time to increase "
            "strictly within a flight: sort the rows by flight and time, drop repeated ones, or name the "
            "flights apart."
        )
    return time, codes


def _split(time, codes):
    """Segments of a checked clock; refuses clocks without a rate."""
    if not len(time):
        return []
    step, same = np.diff(time), np.diff(codes) == 0
    usual = pd.Series(step[same]).groupby(codes[1:][same]).median()
    usual_here = usual.reindex(codes[1:]).to_numpy()
    gap = same & (step > GAP * usual_here)
    starts = ~same | gap
    uneven = ~starts & (np.abs(step - usual_here) > 0.5 * usual_here)
    if max(gap.sum(), uneven.sum()) > 0.1 * max(same.sum(), 10):
        raise ValueError(
            f"Got time steps from {step[same].min():.3g} s to {step[same].max():.3g} s (median "
            f"{np.median(step[same]):.3g} s), but expected a nearly constant rate with few gaps: resample "
            "the "
            "log to one uniform clock first."
        )
    edges = [0, *(np.flatnonzero(starts) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _runs_by_flight(time, codes):
    """Group the segments by flight."""
    runs = {}
    for segment in _split(time, codes):
        runs.setdefault(int(codes[segment.start]), []).append(segment)
    return list(runs.values())
