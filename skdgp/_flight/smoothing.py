"""Zero-phase smoothing and differentiation of flight logs, segment by segment.

With P(f) the measured (cross-)power of k channels and N the white noise of their sensors, the
linear smoother of least mean squared error is, for one channel and for all jointly (Wiener 1949),

    h_i(f) = max(0, 1 - N_i / P_ii(f)),        H(f) = (P - N) P^-1.

Beyond the last frequency at which signal is as strong as noise, both are made non-increasing in f.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import interpolate, ndimage, optimize, signal

from skdgp._compute.messages import warn
from skdgp._flight.checks import check_number
from skdgp._flight.clock import check_clock, runs_by_flight, uniform_grid

ORDER = 2  # of the Butterworth filter, run forward and backward
WINDOW_SECONDS = 6.4  # s, of a periodogram
SHORTEST_WINDOW = 32  # samples
LEAST_SAMPLES = 4 * SHORTEST_WINDOW  # of a segment that shows a spectrum
EVIDENCE = 2.0  # least gain in log likelihood by white noise in a spectrum
TINY = 1e-300  # avoids the logarithm of zero
# remarks of `smooth`
TOO_SHORT = (
    f"A flight has no gap-free stretch of {LEAST_SAMPLES} samples: too short to tell noise from signal, so "
    "cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff in Hz."
)
NO_RATE = (
    "A segment of a single sample has no rate of change: its derivative is NaN. Drop isolated samples, or "
    "give the whole flight at its full rate."
)


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

    NaN means not sampled: such rows stay NaN, and the channel is filtered on the clock of its other
    rows (a slow sensor in a fast table). Unwrap angles that pass through +-pi first. Jittered
    clocks are resampled to a uniform grid and back. Time (n,) [s] increases within a flight.

    ``cutoff`` is the corner frequency [Hz] of a forward-backward Butterworth filter (gain 1/2
    there); "auto", the Wiener smoother of the channel's spectrum over its flight, which needs a
    segment of 128 samples, else it warns and leaves the channel as it is; or None, no smoothing.
    With ``joint``, "auto" estimates each channel from all channels sampled at the same rows,
    through their cross-spectra: for few channels that move together, such as alpha and q. With
    ``derivative`` their rates of change are returned, see `differentiate`.

    Raises ValueError if time does not increase or is too irregular, a value is infinite, or the
    cutoff is not below half the sampling rate.
    """
    columns, times, codes = _checked(values, time, flight)
    if cutoff is not None and cutoff != "auto":
        check_number("cutoff", cutoff, unit="Hz, or 'auto', or None")
    out = np.full(columns.shape, np.nan)
    remarks: set[str] = set()
    for rows, channels in _same_rows(columns):
        place = np.ix_(rows, channels)
        out[place] = _per_flight(
            columns[place], times[rows], codes[rows], cutoff, joint, derivative, remarks
        )
    for remark in sorted(remarks):
        warn(remark, stacklevel=2)
    return out.reshape(np.shape(values))


def differentiate(values: ArrayLike, time: ArrayLike, **options: Any) -> np.ndarray:
    """Return the rate of change of the smoothed channels: the slope of the cubic spline through them.

    Options and errors: see `smooth`. A segment of a single sample has no rate: NaN, with a
    warning.
    """
    return smooth(values, time, derivative=True, **options)


def noise_level(
    values: ArrayLike, time: ArrayLike, *, flight: ArrayLike | None = None
) -> np.ndarray:
    """Return the standard deviation of the white noise in each channel, (k,) or ().

    Flights are pooled by their number of samples; NaN where all are too short.
    """
    columns, times, codes = _checked(values, time, flight)
    std = np.full(columns.shape[1], np.nan)
    for rows, channels in _same_rows(columns):
        part = columns[np.ix_(rows, channels)]
        levels = []
        weights = []
        for runs in runs_by_flight(times[rows], codes[rows]):
            spectrum = _flight_spectrum(part, times[rows], runs)
            if spectrum is not None:
                levels.append(white_noise(spectrum) * spectrum.frequency[-1])
                weights.append(sum(run.stop - run.start for run in runs))
        if levels:
            std[channels] = np.sqrt(np.average(levels, axis=0, weights=weights))
    return std.reshape(np.shape(values)[1:])


def _same_rows(columns: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rows and channels of each group of channels that were sampled at the same rows."""
    masks, group = np.unique(np.isfinite(columns), axis=1, return_inverse=True)
    groups = []
    for number, sampled in enumerate(masks.T):
        if sampled.any():
            channels = np.flatnonzero(group.ravel() == number)
            groups.append((np.flatnonzero(sampled), channels))
    return groups


def _per_flight(columns, time, codes, cutoff, joint, derivative, remarks: set[str]) -> np.ndarray:
    out = np.empty_like(columns)
    for runs in runs_by_flight(time, codes):
        kernel = None
        if isinstance(cutoff, str):
            spectrum = _flight_spectrum(columns, time, runs)
            if spectrum is None:
                remarks.add(TOO_SHORT)
            else:
                gain = _joint_gain if joint else _single_gain
                kernel = impulse_response(gain(spectrum, white_noise(spectrum)))
        for run in runs:
            out[run] = _filter_run(columns[run], time[run], cutoff, kernel, derivative)
            if derivative and run.stop - run.start == 1:
                remarks.add(NO_RATE)
    return out


def _filter_run(columns, time, cutoff, kernel, derivative) -> np.ndarray:
    """Return one run without gaps smoothed on a uniform grid: its values, or slopes, at the run's times."""
    if len(time) == 1:
        return np.full_like(columns, np.nan) if derivative else columns
    grid, jittered = uniform_grid(time)
    times = time if jittered else grid
    if cutoff is None or (kernel is None and isinstance(cutoff, str)):
        return interpolate.CubicSpline(times, columns)(times, 1) if derivative else columns
    on_grid = interpolate.CubicSpline(time, columns)(grid) if jittered else columns
    if kernel is None:
        step = (grid[-1] - grid[0]) / (len(grid) - 1)
        smoothed = _butterworth(on_grid, 1 / step, cutoff)
    else:
        smoothed = convolve(on_grid, kernel)
    if not (jittered or derivative):
        return smoothed
    return interpolate.CubicSpline(grid, smoothed)(times, int(derivative))


def _butterworth(columns: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half "
            f"the sampling rate ({rate / 2:.4g} Hz): lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(ORDER, cutoff, fs=rate, output="sos")
    padding = min(len(columns) - 1, int(np.ceil(5 * rate / cutoff)))
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=padding)


def _checked(values, time, flight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the channels (n, k), time (n,) and flight codes (n,)."""
    columns = np.asarray(values, dtype=float).reshape(len(values), -1)
    n_infinite = int(np.isinf(columns).sum())
    if n_infinite:
        raise ValueError(
            f"Got {n_infinite} infinite values, but expected finite ones or NaN (not sampled): "
            "replace them by NaN."
        )
    return columns, *check_clock(time, flight)


class Spectrum(NamedTuple):
    """Welch's estimate over the segments of a flight."""

    frequency: np.ndarray  # (m,) [Hz]
    power: np.ndarray  # (m, k, k) cross-spectral density
    averages: float  # independent periodograms in it
    rounding: np.ndarray  # (k,) white power that rounding makes

    @property
    def channel_power(self) -> np.ndarray:
        """Power of each channel alone, (m, k)."""
        return np.einsum("mii->mi", self.power).real


def _flight_spectrum(columns: np.ndarray, time: np.ndarray, runs: list[slice]) -> Spectrum | None:
    """Return the spectrum of the runs of a flight's channels (n, k); None where none is long enough.

    Samples are counted, not timed: interpolation between jittered ones would colour white noise.
    """
    longest = max(run.stop - run.start for run in runs)
    if longest < LEAST_SAMPLES:
        return None
    step = np.median(np.concatenate([np.diff(time[run]) for run in runs]))
    size = int(max(WINDOW_SECONDS / step, 2 * SHORTEST_WINDOW))
    size = 2 * (min(size, longest // 4) // 2)
    long_runs = [run for run in runs if run.stop - run.start >= size]
    pieces = np.concatenate([_windows(columns[run], size) for run in long_runs])
    taper = signal.windows.hann(size)
    tapered = signal.detrend(pieces, axis=-1) * taper
    waves = np.fft.rfft(tapered, axis=-1).transpose(2, 1, 0)
    unit = 2 * step / (len(pieces) * np.sum(taper**2))  # of a periodogram [1/Hz]
    power = waves @ waves.conj().swapaxes(1, 2) * unit
    rounding = 2 * step * (1e-9 * np.abs(pieces).max(axis=(0, 2))) ** 2
    return Spectrum(
        frequency=np.fft.rfftfreq(size, step),
        power=power,
        averages=0.375 * len(pieces),  # each sample is in four windows
        rounding=rounding,
    )


def white_noise(spectrum: Spectrum) -> np.ndarray:
    """Return the white noise power of each channel, (k,)."""
    floor = np.zeros(len(spectrum.rounding))
    for channel, power in enumerate(spectrum.channel_power.T):
        floor[channel] = _noise_floor(spectrum.frequency, power, spectrum.averages)
    return np.where(floor > spectrum.rounding, floor, 0.0)


def _single_gain(spectrum: Spectrum, floor: np.ndarray) -> np.ndarray:
    """Return the smoother of each channel alone, (m, k)."""
    log_power = np.log(spectrum.channel_power + TINY)
    steady = np.exp(ndimage.gaussian_filter1d(log_power, 1.0, axis=0, mode="nearest"))
    gain = np.where(floor > 0, np.clip(1 - floor / steady, 0, 1), 1.0)
    gain[0] = 1.0  # the mean of a channel is signal
    return gain * _falling(gain)


def _joint_gain(spectrum: Spectrum, floor: np.ndarray) -> np.ndarray:
    """Return the smoother of each channel from all, (m, k, k); the row of a noise-free channel is the identity.

    In units of noise, P has eigenvalues 1 where there is no signal, spread by sampling up to the
    edge of Marchenko and Pastur (1967). Only eigenvalues beyond the edge are signal.
    """
    power = spectrum.channel_power
    k = len(floor)
    # root of the noise power, or of a small power where there is no noise
    small = 1e-2 * power.min(axis=0) + 1e-12 * power.max(axis=0) + TINY
    unit = np.sqrt(np.where(floor > 0, floor, small))
    size, axes = np.linalg.eigh(spectrum.power / (unit[:, None] * unit))
    edge = (1 + np.sqrt(k / spectrum.averages)) ** 2
    gains = np.where(size > edge, 1 - 1 / np.maximum(size, edge), 0.0)
    gain = np.einsum("mik,mk,mjk->mij", axes, gains, axes.conj()) * (unit[:, None] / unit)
    gain[0] = np.eye(k)
    # power of the signal, in units of noise
    strength = np.einsum("mik,mk->mi", np.abs(axes) ** 2, gains * size)
    strength[0] = np.inf
    falling = _falling(1 / (1 + 1 / np.maximum(strength, 1e-12)))
    return np.where((floor > 0)[:, None], gain * falling[:, :, None], np.eye(k))


def impulse_response(gain: np.ndarray) -> np.ndarray:
    """Return impulse responses of gains, (2 m - 3, ...), Hann-tapered; constants pass unchanged."""
    size = 2 * (len(gain) - 1)
    taper = signal.windows.hann(size + 1)[1:-1].reshape(-1, *[1] * (gain.ndim - 1))
    response = np.fft.fftshift(np.fft.irfft(gain, size, axis=0), axes=0)[1:] * taper
    return response + (gain[0].real - response.sum(axis=0)) * taper / taper.sum()


def convolve(columns: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return columns (n, k), continued oddly beyond their ends, filtered by (l, k) or joint (l, k, k) responses."""
    half = len(response) // 2
    padded = np.pad(columns, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    if response.ndim == 2:
        return signal.oaconvolve(padded, response, mode="valid", axes=0)
    filtered = []
    for part in np.moveaxis(response, 1, 0):
        from_all = signal.oaconvolve(padded, part, mode="valid", axes=0)
        filtered.append(from_all.sum(axis=1))
    return np.stack(filtered, axis=1)


def _falling(gain: np.ndarray) -> np.ndarray:
    """Return factors (m, k) that keep gains from rising beyond the last frequency at which they are 1/2."""
    last = len(gain) - 1 - np.argmax(gain[::-1] >= 0.5, axis=0)
    beyond = np.arange(len(gain))[:, None] > last
    least = np.minimum.accumulate(np.where(beyond, gain, 0.5), axis=0)
    return np.where(beyond, least / np.maximum(gain, 1e-12), 1.0)


def _windows(segment: np.ndarray, size: int) -> np.ndarray:
    """Return half-overlapping windows (s, k, size), counted from either end so that no sample is left over."""
    views = np.lib.stride_tricks.sliding_window_view(segment, size, axis=0)
    return np.concatenate([views[:: size // 2], views[:: -(size // 2)]])


def _noise_floor(frequency: np.ndarray, power: np.ndarray, averages: float) -> float:
    """Return the flat part of the upper half of a spectrum, without the falling part.

    A sampled process whose power falls as f^-2k appears, folded at the Nyquist frequency F, near
    sin(pi f / 2F)^-2k. These shapes and a constant are fitted with non-negative weights; the
    constant stands only if Whittle's log likelihood without it is lower by more than ``EVIDENCE``.
    """
    top = slice(len(power) // 2, -1)
    observed = power[top]
    if not observed.min() > 1e-24 * power.max():
        return 0.0
    fall = np.sin(0.5 * np.pi * frequency[top] / frequency[-1]) ** -2
    shapes = np.column_stack([fall**k for k in (0, 1, 2, 4, 8)])
    shapes /= shapes.max(axis=0)
    weights, misfit = _fit_weights(shapes, observed)
    _, misfit_without = _fit_weights(shapes[:, 1:], observed)
    return weights[0] if averages * (misfit_without - misfit) > EVIDENCE else 0.0


def _fit_weights(shapes: np.ndarray, observed: np.ndarray) -> tuple[np.ndarray, float]:
    """Return non-negative weights of the shapes, and minus Whittle's log likelihood of one periodogram."""
    fitted = observed
    for _ in range(4):
        weights, _ = optimize.nnls(shapes / fitted[:, None], observed / fitted)
        fitted = shapes @ weights
    return weights, np.sum(np.log(fitted) + observed / fitted)
