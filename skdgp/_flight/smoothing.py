"""Zero-phase smoothing and differentiation of flight logs, segment by segment, and the band of their motion.

With P(f) the measured power of a channel and N the white noise of its sensor, the linear smoother of
least mean squared error is (Wiener 1949)

    h(f) = max(0, 1 - N / P(f)).

Beyond the last frequency at which signal is as strong as noise, it is made non-increasing in f.

A gain below one shrinks the signal with the noise. That is right for the regressors of a regression,
whose slopes then come out unbiased (Carroll et al. 2006, section 4.2), and wrong for its targets: a
target keeps a gain of one up to that frequency.

A filter that both sides of a linear equation pass leaves the equation true (Klein & Morelli 2006,
chapter 7): `without_vibration` for targets and regressors of flights that vibrate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate, ndimage, optimize, signal
from scipy.signal.windows import hann

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.clock import Clock, median_step, n_rows, uniform_grid
from skdgp._flight.tables import check_number, has_values, numeric, unwrapped

# Least samples of a segment that shows a spectrum (guess)
LEAST_SAMPLES = 128
# avoids the logarithm of zero
TINY = 1e-300
TOO_SHORT = (
    f"A flight has no gap-free stretch of {LEAST_SAMPLES} samples: too short to tell "
    "noise from signal, so cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff in Hz."
)
LowPass: TypeAlias = Callable[[Matrix, float], Matrix]
"""Filter of equidistant channels (n, k) of a rate [Hz]."""


def smooth(
    values: ArrayLike,
    time: ArrayLike,
    *,
    cutoff: float | str | LowPass | None = "auto",
    flight: ArrayLike | None = None,
    shrink: bool | Sequence[bool] = True,
    derivative: bool = False,
    is_quiet: bool = False,
) -> np.ndarray:
    """Return channels (n,) or (n, k) without sensor noise and without delay, segment by segment.

    NaN means not sampled: such rows stay NaN, and the channel is filtered on the clock of its other
    rows (a slow sensor in a fast table). Unwrap angles that pass through +-pi first. Jittered
    clocks are resampled to a uniform grid and back. Time (n,) [s] increases within a flight.

    ``cutoff`` is the corner frequency [Hz] of a forward-backward Butterworth filter (gain 1/2
    there); "auto", the Wiener smoother of the channel's spectrum over its flight, which needs a
    segment of 128 samples, else it leaves the channel as it is and, unless ``is_quiet``, warns; a
    filter of columns of a rate [Hz]; or None, no smoothing.
    Without ``shrink``, of all channels or one for each, the gain of a channel alone is one up to the last
    frequency at which signal is as strong as noise: more noise stays, but no signal is lost there,
    as the targets of a regression need it. With ``derivative`` their rates of change are returned,
    see `differentiate`.

    Raises ValueError if time does not increase or is too irregular, a value is infinite, or the
    cutoff is not below half the sampling rate.
    """
    columns, clock = _checked(values, time, flight)
    shrinks = np.broadcast_to(shrink, columns.shape[1])
    if not (callable(cutoff) or isinstance(cutoff, str | None)):
        check_number("cutoff", cutoff, unit="Hz, or 'auto', or None")
    out = np.full(columns.shape, np.nan)
    is_short = False
    for group in _channel_groups(columns, clock):
        is_short |= max(group.lengths) < LEAST_SAMPLES
        filter_of_group = _filter_of(group, cutoff, shrinks[group.channels])
        for run in group.runs:
            place = np.ix_(group.rows[run], group.channels)
            out[place] = _filtered(group.columns[run], group.time[run], filter_of_group, derivative)
    if is_short and cutoff == "auto" and not is_quiet:
        warn(TOO_SHORT)
    return out.reshape(np.shape(values))


def differentiate(values: ArrayLike, time: ArrayLike, **options: Any) -> np.ndarray:
    """Return the rate of change of the smoothed channels: the slope of the cubic spline through them.

    Options and errors: see `smooth`. A segment of a single sample has no rate: NaN.
    """
    return smooth(values, time, derivative=True, **options)


def _spectra(table: pd.DataFrame, names: Sequence[str]) -> Iterator[tuple[Indices, Spectrum]]:
    """Yield the channels that were sampled at the same rows, and their spectrum, of each flight that shows one."""
    time = numeric(table, ["time"])[:, 0]
    values = unwrapped(table, names)
    for group in _channel_groups(*_checked(values, time, table.get("flight"))):
        spectrum = _flight_spectrum(group)
        if spectrum is not None:
            yield group.channels, spectrum


def noise_level(table: pd.DataFrame, names: Sequence[str]) -> Vector:
    """Return the standard deviation of the white noise of a flight's channels, (k,); NaN if it is too short."""
    std = np.full(len(names), np.nan)
    for channels, spectrum in _spectra(table, names):
        std[channels] = np.sqrt(noise_power(spectrum) * spectrum.frequency[-1])
    return std


def _checked(values: Any, time: ArrayLike, flight: ArrayLike | None) -> tuple[Matrix, Clock]:
    """Return the channels (n, k) and their clock."""
    columns = np.asarray(values, dtype=float).reshape(len(values), -1)
    n_infinite = int(np.isinf(columns).sum())
    if n_infinite:
        raise ValueError(
            f"Got {n_infinite} infinite values, but expected finite ones or NaN (not sampled): "
            "replace them by NaN."
        )
    return columns, Clock.of(time, flight)


class ChannelGroup(NamedTuple):
    """Channels of a flight that were sampled at the same rows, beside those of the other flights."""

    # of the table, of all flights
    rows: Indices
    channels: Indices
    # (n_rows, n_channels) and (n_rows,)
    columns: Matrix
    time: Vector
    # runs without gaps of this flight, among the rows
    runs: list[slice]

    @property
    def lengths(self) -> list[int]:
        """Number of rows of each run."""
        return [n_rows(run) for run in self.runs]


def _channel_groups(columns: Matrix, clock: Clock) -> Iterator[ChannelGroup]:
    """Yield each flight of each group of channels that were sampled at the same rows."""
    masks, group = np.unique(np.isfinite(columns), axis=1, return_inverse=True)
    for number, sampled in enumerate(masks.T):
        if sampled.any():
            rows = np.flatnonzero(sampled)
            channels = np.flatnonzero(group.ravel() == number)
            together = columns[np.ix_(rows, channels)]
            its_clock = clock.part(rows)
            for runs in its_clock.segments_by_flight:
                yield ChannelGroup(rows, channels, together, its_clock.time, runs)


def _filtered(columns: Matrix, time: Vector, smoother: LowPass | None, derivative: bool) -> Matrix:
    """Return one run without gaps filtered on a uniform grid: its values, or slopes, at the run's times."""
    if len(time) == 1:
        return np.full_like(columns, np.nan) if derivative else columns
    grid, is_jittered = uniform_grid(time)
    at = time if is_jittered else grid
    knots = at
    if smoother is not None:
        knots = grid
        if is_jittered:
            columns = interpolate.CubicSpline(time, columns)(grid)
        rate = (len(grid) - 1) / np.ptp(grid)
        columns = smoother(columns, rate)
    if knots is at and not derivative:
        return columns
    return interpolate.CubicSpline(knots, columns)(at, int(derivative))


def low_pass(columns: Array, rate: float, cutoff: float, *, order: int = 2) -> Array:
    """Return equidistant values (n, ...) of a rate [Hz] through a Butterworth filter, forward and backward.

    The gain is 1/2 at the cutoff [Hz]. Raises ValueError if this is not below half the rate.
    """
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half "
            f"the sampling rate ({rate / 2:.4g} Hz): lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(order, cutoff, fs=rate, output="sos")
    transient = int(np.ceil(5 * rate / cutoff))
    padding = min(len(columns) - 1, transient)
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=padding)


def _filter_of(
    group: ChannelGroup,
    cutoff: float | str | LowPass | None,
    shrinks: NDArray[np.bool_],
) -> LowPass | None:
    """Return the filter of a flight's channels; None without a cutoff, or where no run is long enough."""
    if cutoff is None or callable(cutoff):
        return cutoff
    if not isinstance(cutoff, str):
        return partial(low_pass, cutoff=cutoff)
    spectrum = _flight_spectrum(group)
    if spectrum is None:
        return None
    response = impulse_response(_separate_gain(spectrum, shrinks))
    return lambda values, rate: convolve(values, response)


class Spectrum(NamedTuple):
    """Welch's estimate over the segments of a flight."""

    # (m,) [Hz]
    frequency: np.ndarray
    # (m, k) of each channel
    channel_power: Matrix
    # independent periodograms in it
    averages: float
    # (k,) white power that rounding makes
    rounding: np.ndarray


def _flight_spectrum(group: ChannelGroup) -> Spectrum | None:
    """Return the spectrum of a flight's channels; None where no run is long enough.

    Samples are counted, not timed: interpolation between jittered ones would colour white noise.
    """
    longest = max(group.lengths)
    if longest < LEAST_SAMPLES:
        return None
    step = median_step(group.time, group.runs)
    # windows of 6.4 s, and 64 rows (guesses)
    half = int(min(max(6.4 / step, 64), longest // 4)) // 2
    runs = [group.columns[run] for run in group.runs]
    frequency, power, n_windows = power_spectra(runs, step, 2 * half)
    largest = np.abs(group.columns[np.r_[tuple(group.runs)]]).max(axis=0)
    return Spectrum(
        frequency=frequency,
        channel_power=power,
        # each sample is in four windows
        averages=0.375 * n_windows,
        rounding=2 * step * (1e-9 * largest) ** 2,
    )


def noise_power(spectrum: Spectrum) -> Vector:
    """Return the white noise power of each channel, (k,)."""
    floor = np.zeros(len(spectrum.rounding))
    for channel, power in enumerate(spectrum.channel_power.T):
        floor[channel] = _noise_floor(spectrum.frequency, power, spectrum.averages)
    return np.where(floor > spectrum.rounding, floor, 0.0)


def _noise_floor(frequency: Vector, power: Vector, averages: float) -> float:
    """Return the flat part of the upper half of a spectrum, without the falling part.

    A sampled process whose power falls as f^-2k appears, folded at the Nyquist frequency F, near
    sin(pi f / 2F)^-2k. These shapes and a constant are fitted with non-negative weights; the
    constant stands only if Whittle's log likelihood without it is lower by more than 2.
    """
    top = slice(len(power) // 2, -1)
    observed = power[top]
    if not observed.min() > 1e-24 * power.max():
        return 0.0
    angle = 0.5 * np.pi * frequency[top] / frequency[-1]
    fall = np.sin(angle) ** -2
    shapes = np.column_stack([fall**k for k in (0, 1, 2, 4, 8)])
    shapes /= shapes.max(axis=0)
    weights, misfit = _fit_weights(shapes, observed)
    _, misfit_without = _fit_weights(shapes[:, 1:], observed)
    gain = averages * (misfit_without - misfit)
    return weights[0] if gain > 2 else 0.0


def _fit_weights(shapes: Matrix, observed: Vector) -> tuple[Vector, float]:
    """Return non-negative weights of the shapes, and minus Whittle's log likelihood of one periodogram."""
    fitted = observed
    for _ in range(4):
        relative = shapes / fitted[:, None]
        weights, _ = optimize.nnls(relative, observed / fitted)
        fitted = shapes @ weights
    misfit = np.sum(np.log(fitted) + observed / fitted)
    return weights, misfit


def _separate_gain(spectrum: Spectrum, shrinks: NDArray[np.bool_]) -> Matrix:
    """Return the smoother of each channel alone, (m, k), for channels that do not shrink as for a target."""
    gain = _wiener_gain(spectrum, noise_power(spectrum))
    return np.where(shrinks | _is_beyond(gain), gain, 1.0)


def _wiener_gain(spectrum: Spectrum, floor: Vector) -> Matrix:
    """Return Wiener's smoother of each channel alone, (m, k)."""
    log_power = np.log(spectrum.channel_power + TINY)
    # fewer periodograms than 20 are also averaged over neighbouring frequencies (guess)
    width = max(1.0, 20 / spectrum.averages)
    smoothed = ndimage.gaussian_filter1d(log_power, width, axis=0, mode="nearest")
    steady = np.exp(smoothed)
    # h = max(0, 1 - N / P)
    gain = np.clip(1 - floor / steady, 0, 1)
    gain[:, floor == 0] = 1.0
    # the mean of a channel is signal
    gain[0] = 1.0
    # that does not rise beyond the last frequency at which it is 1/2
    is_beyond = _is_beyond(gain)
    least = np.minimum.accumulate(np.where(is_beyond, gain, 0.5), axis=0)
    return np.where(is_beyond, least, gain)


def _is_beyond(gain: Matrix) -> NDArray[np.bool_]:
    """Return whether a frequency lies beyond the last at which gains (m, k) are 1/2, signal as strong as noise."""
    is_strong = gain >= 0.5
    last = len(gain) - 1 - np.argmax(is_strong[::-1], axis=0)
    return np.arange(len(gain))[:, None] > last


def impulse_response(gain: Array) -> Array:
    """Return impulse responses of gains, (2 m - 3, ...), Hann-tapered; constants pass unchanged."""
    size = 2 * (len(gain) - 1)
    taper = signal.windows.hann(size + 1)[1:-1]
    taper = taper.reshape(-1, *[1] * (gain.ndim - 1))
    centred = np.fft.fftshift(np.fft.irfft(gain, size, axis=0), axes=0)
    response = centred[1:] * taper
    lacking = gain[0].real - response.sum(axis=0)
    return response + lacking * taper / taper.sum()


def convolve(columns: Matrix, response: Matrix) -> Matrix:
    """Return columns (n, k), continued oddly beyond their ends, filtered by responses (l, k)."""
    half = len(response) // 2
    padded = np.pad(columns, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return signal.oaconvolve(padded, response, mode="valid", axes=0)


def power_spectra(runs: Sequence[Matrix], step: float, size: int) -> tuple[Vector, Matrix, int]:
    """Return frequencies [Hz] (m,), one-sided powers (m, k) of channels, and the number of their windows (Welch 1967).

    Runs (n, k) at even steps [s] that are shorter than a window are left out. Windows by Hann overlap by half and
    lose their trends; they are counted from either end of a run, so that no sample is left over.
    """
    options: Any = {"fs": 1.0 / step, "window": hann(size), "nperseg": size, "axis": 0}
    options["detrend"] = "linear"
    total: Any = 0.0
    n_windows = 0
    for run in runs:
        n_left_over = (len(run) - size) % (size - size // 2)
        for part in (run, run[n_left_over:]):
            if len(part) >= size:
                n = 1 + (len(part) - size) // (size - size // 2)
                frequency, power = signal.welch(part, **options)
                total = total + n * power
                n_windows += n
    return frequency, total / n_windows, n_windows


# Least band of the motion [Hz]: errors of a narrower one correlate between ten rows a second
LEAST_BAND = 5.0


def vibration_band(table: pd.DataFrame) -> float:
    """Return the frequency [Hz] beyond which flights with vanes vibrate; infinite where they do not.

    Vibration beyond the motion biases slopes. Without it nothing should be removed, as gusts there
    contribute to the mean of a nonlinear function. Without vanes the noise of the filter contains it.
    """
    if not has_values(table, "time", *SPECIFIC_FORCE, *VANES):
        return np.inf
    band = max(motion_band_of(table), LEAST_BAND)
    return band if vibrates_beyond(table, band) else np.inf


def motion_band_of(table: pd.DataFrame) -> float:
    """Return the frequency [Hz] below which lies nearly all motion of the aircraft in each flight; infinite if unknown.

    Surfaces cause the motion and the rates follow it, so the band of either is enough: that of the
    rates is too wide where they vibrate, that of the surfaces where these carry noise. It holds 98 % of
    the power; in trials on simulated flights of four aircraft 95 to 99 % were alike.
    """
    bands = []
    for group in (RATES, ALL_SURFACES):
        names = [name for name in group if name in table]
        of_group = []
        for _, spectrum in _spectra(table, names):
            is_moving = spectrum.channel_power.sum(axis=0) > spectrum.rounding
            sums = np.cumsum(spectrum.channel_power[:, is_moving], axis=0)
            places = np.argmax(sums >= 0.98 * sums[-1], axis=0)
            of_group += spectrum.frequency[places].tolist()
        bands.append(max(of_group, default=np.inf))
    return min(bands)


def vibrates_beyond(table: pd.DataFrame, band: float) -> bool:
    """Return whether two of the three specific forces have more power beyond the band [Hz] than within.

    Means and trends are no power. Gusts move the aircraft within the band: two of the forces have up
    to 29 % beyond it in 16 simulated flights of four aircraft without vibration, and 16 to 96 % in
    16 flights with vibration.
    """
    beyond, within = np.zeros((2, len(SPECIFIC_FORCE)))
    for channels, spectrum in _spectra(table, SPECIFIC_FORCE):
        weighted = spectrum.averages * spectrum.channel_power
        is_beyond = spectrum.frequency > band
        beyond[channels] += weighted[is_beyond].sum(axis=0)
        within[channels] += weighted[~is_beyond].sum(axis=0)
    return bool(np.sum(beyond > within) >= 2)


def band_limited(values: Matrix, table: pd.DataFrame, band: float) -> Matrix:
    """Return columns (n, k) of flights without frequencies beyond a band [Hz]; as they are if it is infinite."""
    if np.isinf(band):
        return values
    time = numeric(table, ["time"])[:, 0]
    return smooth(values, time, flight=table.get("flight"), cutoff=without_vibration(band))


def without_vibration(band: float) -> LowPass | str:
    """Return the smoothing of flights that vibrate beyond a band [Hz]; "auto" if it is infinite."""
    if np.isinf(band):
        return "auto"

    def filtered(columns: Matrix, rate: float) -> Matrix:
        is_below = band < 0.49 * rate
        return low_pass(columns, rate, band, order=8) if is_below else columns

    return filtered
