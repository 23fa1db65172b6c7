"""Zero-phase smoothing and differentiation of flight logs, segment by segment."""

from __future__ import annotations

import warnings
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import interpolate, signal

from skdgp._flight.clock import check_clock, runs_by_flight, uniform_grid
from skdgp._flight.wiener import (
    LEAST_SAMPLES,
    Spectrum,
    convolve,
    expected_error,
    flight_spectrum,
    impulse_response,
    noise_and_gain,
)

ORDER = 2


def smooth(
    values: ArrayLike,
    time: ArrayLike,
    *,
    cutoff: float | str | None = "auto",
    flight: ArrayLike | None = None,
    joint: bool = False,
    derivative: bool = False,
) -> np.ndarray:
    """Return channels (n,) or (n, k) without sensor noise and without delay, segment by segment.

    NaN means not sampled: such rows stay NaN, and the channel is filtered on the clock of its other rows (a slow sensor
    in a fast table). Unwrap angles that pass through +-pi first. Jittered clocks are resampled to a uniform grid and
    back. Time (n,) [s] increases within a flight.

    ``cutoff`` is the corner frequency [Hz] of a forward-backward Butterworth filter (gain 1/2 there); "auto", the
    Wiener smoother of the channel's spectrum over its flight, which needs a segment of 128 samples, else it warns and
    leaves the channel as it is; or None, no smoothing. With ``joint``, "auto" estimates each channel from all channels
    sampled at the same rows, through their cross-spectra: for few channels that move together, such as alpha and q.
    With ``derivative`` their rates of change are returned, see `differentiate`.

    Raises ValueError if time does not increase or is too irregular, a value is infinite, or the cutoff is not below
    half the sampling rate.
    """
    columns, times, codes = _checked(values, time, flight)
    if isinstance(cutoff, str | None):
        known = cutoff in ("auto", None)
    else:
        known = isinstance(cutoff, Real) and not isinstance(cutoff, bool) and 0 < float(cutoff) < np.inf
    if not known:
        raise ValueError(
            f"Got cutoff={cutoff!r}, but expected a positive frequency [Hz], 'auto', or None (no smoothing)."
        )
    out = np.full(columns.shape, np.nan)
    remarks: set[str] = set()
    for rows, channels in _same_rows(columns):
        part = columns[np.ix_(rows, channels)]
        out[np.ix_(rows, channels)] = _per_flight(part, times[rows], codes[rows], cutoff, joint, derivative, remarks)
    for remark in sorted(remarks):
        warnings.warn(remark, stacklevel=2)
    return out.reshape(np.shape(values))


def differentiate(values: ArrayLike, time: ArrayLike, **options: Any) -> np.ndarray:
    """Return the rate of change of the smoothed channels: the slope of the cubic spline through them.

    Options and errors are those of `smooth`. A segment of a single sample has no rate: NaN, with a warning.
    """
    return smooth(values, time, derivative=True, **options)


class NoiseLevel(NamedTuple):
    """Standard deviations of the error of each channel: its measured white noise, and the error after ``smooth``."""

    measured: np.ndarray
    smoothed: np.ndarray


def noise_level(
    values: ArrayLike, time: ArrayLike, *, flight: ArrayLike | None = None, joint: bool = False
) -> NoiseLevel:
    """Return the standard deviation of the white noise in each channel, (k,) or (), before and after `smooth`.

    Flights are pooled by their number of samples; NaN where all are too short.
    """
    columns, times, codes = _checked(values, time, flight)
    found = np.full((2, columns.shape[1]), np.nan)
    for rows, channels in _same_rows(columns):
        part, levels, weights = columns[np.ix_(rows, channels)], [], []
        for runs in runs_by_flight(times[rows], codes[rows]):
            spectrum = _spectrum_of_flight(part, times[rows], runs)
            if spectrum is not None:
                floor, gain = noise_and_gain(spectrum, joint)
                levels.append((floor * spectrum.frequency[-1], expected_error(spectrum, floor, gain)))
                weights.append(sum(run.stop - run.start for run in runs))
        if levels:
            found[:, channels] = np.sqrt(np.average(levels, axis=0, weights=weights))
    return NoiseLevel(*(found[:, 0] if np.ndim(values) == 1 else found))


def _same_rows(columns: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rows and channels of each group of channels that were sampled at the same rows."""
    masks, group = np.unique(np.isfinite(columns), axis=1, return_inverse=True)
    groups = ((np.flatnonzero(keep), np.flatnonzero(group.ravel() == g)) for g, keep in enumerate(masks.T))
    return [(rows, channels) for rows, channels in groups if rows.size]


def _per_flight(columns, time, codes, cutoff, joint, derivative, remarks: set[str]) -> np.ndarray:
    out = np.empty_like(columns)
    for runs in runs_by_flight(time, codes):
        kernel = None
        if isinstance(cutoff, str):
            spectrum = _spectrum_of_flight(columns, time, runs)
            if spectrum is None:
                remarks.add(
                    f"A flight has no gap-free stretch of {LEAST_SAMPLES} samples: too short to tell noise from "
                    "signal, so cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff in Hz."
                )
            else:
                kernel = impulse_response(noise_and_gain(spectrum, joint)[1])
        for run in runs:
            out[run] = _filter_run(columns[run], time[run], cutoff, kernel, derivative)
            if derivative and run.stop - run.start == 1:
                remarks.add(
                    "A segment of a single sample has no rate of change: its derivative is NaN. "
                    "Drop isolated samples, or give the whole flight at its full rate."
                )
    return out


def _filter_run(columns, time, cutoff, kernel, derivative) -> np.ndarray:
    """Return one run without gaps smoothed on a uniform grid: its values, or slopes, at the run's times."""
    n = len(time)
    if n == 1:
        return np.full_like(columns, np.nan) if derivative else columns
    grid, jittered = uniform_grid(time)
    if cutoff is None or (kernel is None and isinstance(cutoff, str)):
        return _slope(columns, time if jittered else grid) if derivative else columns
    on_grid = interpolate.CubicSpline(time, columns)(grid) if jittered else columns
    step = (grid[-1] - grid[0]) / (len(grid) - 1)
    smoothed = _butterworth(on_grid, 1 / step, cutoff) if kernel is None else convolve(on_grid, kernel)
    if not jittered:
        return _slope(smoothed, grid) if derivative else smoothed
    return interpolate.CubicSpline(grid, smoothed)(time, int(derivative))


def _spectrum_of_flight(columns: np.ndarray, time: np.ndarray, runs: list[slice]) -> Spectrum | None:
    steps = np.concatenate([np.diff(time[run]) for run in runs])
    return flight_spectrum([columns[run] for run in runs], np.median(steps)) if steps.size else None


def _slope(columns: np.ndarray, time: np.ndarray) -> np.ndarray:
    return interpolate.CubicSpline(time, columns)(time, 1)


def _butterworth(columns: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half the "
            f"sampling rate ({rate / 2:.4g} Hz): lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(ORDER, cutoff, fs=rate, output="sos")
    padding = min(len(columns) - 1, int(np.ceil(5 * rate / cutoff)))
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=padding)


def _checked(values, time, flight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the channels (n, k), time (n,) and flight codes (n,)."""
    columns = np.asarray(values, dtype=float)
    if columns.ndim not in (1, 2):
        raise ValueError(f"Got values of shape {columns.shape}, but expected (n,) or (n, k).")
    columns = columns.reshape(len(columns), -1)
    if np.isinf(columns).any():
        raise ValueError(
            f"Got {int(np.isinf(columns).sum())} infinite values, but expected finite ones or NaN (not "
            "sampled): replace them by NaN."
        )
    times, codes = check_clock(time, flight)
    if len(columns) != len(times):
        raise ValueError(f"Got {len(columns)} rows of values and {len(times)} times, but expected as many.")
    return columns, times, codes
