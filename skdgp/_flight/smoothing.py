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
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy import interpolate, ndimage, optimize, signal, special
from scipy.signal.windows import hann

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector
from skdgp._flight.channels import ALL_SURFACES, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.clock import Clock, uniform_grid
from skdgp._flight.tables import (
    check_number,
    has_values,
    numeric,
    unwrapped,
)

# Least samples of a segment that shows a spectrum (guess)
LEAST_SAMPLES = 128
TOO_SHORT = (
    f"A flight has no gap-free stretch of {LEAST_SAMPLES} samples: too short to tell "
    "noise from signal, so cutoff='auto' leaves it unsmoothed. Give a longer log or a cutoff in Hz."
)
LowPass: TypeAlias = Callable[[Vector, float], Vector]
"""Filter of an equidistant channel (n,) of a rate [Hz]."""


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
    for number, column in enumerate(columns.T):
        for runs in _sampled_runs(column, clock):
            is_short |= max(map(len, runs)) < LEAST_SAMPLES
            smoother = _filter_of(column, clock.time, runs, cutoff, shrinks[number])
            for rows in runs:
                time_of_run = clock.time[rows]
                out[rows, number] = _filtered(column[rows], time_of_run, smoother, derivative)
    if is_short and cutoff == "auto" and not is_quiet:
        warn(TOO_SHORT)
    return out.reshape(np.shape(values))


def differentiate(values: ArrayLike, time: ArrayLike, **options: Any) -> np.ndarray:
    """Return the rate of change of the smoothed channels: the slope of the cubic spline through them.

    Options and errors: see `smooth`. A segment of a single sample has no rate: NaN.
    """
    return smooth(values, time, derivative=True, **options)


def _spectra(table: pd.DataFrame, names: Sequence[str]) -> Iterator[tuple[int, Spectrum]]:
    """Yield the number of a channel and its spectrum in each flight that shows one."""
    time = numeric(table, ["time"])[:, 0]
    columns, clock = _checked(unwrapped(table, names), time, table.get("flight"))
    for number, column in enumerate(columns.T):
        for runs in _sampled_runs(column, clock):
            spectrum = _spectrum(column, clock.time, runs)
            if spectrum is not None:
                yield number, spectrum


def noise_level(table: pd.DataFrame, names: Sequence[str]) -> Vector:
    """Return the standard deviation of the white noise of a flight's channels, (k,); NaN if it is too short."""
    std = np.full(len(names), np.nan)
    for number, spectrum in _spectra(table, names):
        std[number] = np.sqrt(noise_power(spectrum) * spectrum.frequency[-1])
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


def _sampled_runs(column: Vector, clock: Clock) -> Iterator[list[Indices]]:
    """Yield, for each flight, the rows of the runs without gaps in which a channel was sampled."""
    rows = np.flatnonzero(np.isfinite(column))
    for runs in clock.part(rows).segments_by_flight:
        yield [rows[run] for run in runs]


def _filtered(values: Vector, time: Vector, smoother: LowPass | None, derivative: bool) -> Vector:
    """Return one run without gaps filtered on a uniform grid: its values, or slopes, at the run's times."""
    if len(time) == 1:
        return np.full_like(values, np.nan) if derivative else values
    grid, is_jittered = uniform_grid(time)
    at = time if is_jittered else grid
    knots = at
    if smoother is not None:
        knots = grid
        if is_jittered:
            values = interpolate.CubicSpline(time, values)(grid)
        rate = (len(grid) - 1) / np.ptp(grid)
        values = smoother(values, rate)
    if knots is at and not derivative:
        return values
    return interpolate.CubicSpline(knots, values)(at, int(derivative))


def low_pass(columns: Array, rate: float, cutoff: float, *, order: int = 2) -> Array:
    """Return equidistant values (n, ...) of a rate [Hz] through a Butterworth filter, forward and backward.

    The gain is 1/2 at the cutoff [Hz]. Raises ValueError if this is not below half the rate.
    """
    if cutoff > rate / 2 * (1 - 1e-6):
        raise ValueError(
            f"Got cutoff={cutoff:g} Hz for a log sampled at {rate:.4g} Hz, but expected less than half the "
            "sampling rate: lower it, or use cutoff=None for no smoothing."
        )
    sections = signal.butter(order, cutoff, fs=rate, output="sos")
    transient = int(np.ceil(5 * rate / cutoff))
    padding = min(len(columns) - 1, transient)
    return signal.sosfiltfilt(sections, columns, axis=0, padlen=padding)


def _filter_of(
    column: Vector,
    time: Vector,
    runs: list[Indices],
    cutoff: float | str | LowPass | None,
    shrinks: bool,
) -> LowPass | None:
    """Return the filter of a channel in a flight; None without a cutoff, or where no run is long enough."""
    if cutoff is None or callable(cutoff):
        return cutoff
    if not isinstance(cutoff, str):
        return partial(low_pass, cutoff=cutoff)
    spectrum = _spectrum(column, time, runs)
    if spectrum is None:
        return None
    gain = _wiener_gain(spectrum)
    if not shrinks:
        gain = np.where(_is_beyond(gain), gain, 1.0)
    response = _impulse_response(gain)
    return lambda values, rate: _convolved(values, response)


class Spectrum(NamedTuple):
    """Welch's estimate of a channel over the runs of a flight."""

    frequency: Vector  # (m,) [Hz]
    power: Vector  # (m,)
    averages: float  # independent periodograms in it
    rounding: float  # white power that rounding makes


def _spectrum(column: Vector, time: Vector, runs: list[Indices]) -> Spectrum | None:
    """Return the spectrum of a channel in a flight; None where no run is long enough (Welch 1967).

    Samples are counted, not timed: interpolation between jittered ones would colour white noise. Windows by Hann
    overlap by half and lose their trends; they are counted from either end of a run, so that no sample is left over.
    """
    longest = max(map(len, runs))
    if longest < LEAST_SAMPLES:
        return None
    step = float(np.median(np.concatenate([np.diff(time[rows]) for rows in runs])))
    # windows of 6.4 s, and 64 rows (guesses)
    half = round(min(max(6.4 / step, 64), longest // 4)) // 2
    parts = []
    for rows in runs:
        if len(rows) >= 2 * half:
            for part in (rows, rows[len(rows) % half :]):
                parts.append(sliding_window_view(column[part], 2 * half)[::half])
    windows = np.concatenate(parts)
    options: Any = {"window": hann(2 * half), "detrend": "linear"}
    frequency, powers = signal.periodogram(windows, 1 / step, **options)
    largest = np.abs(column[np.concatenate(runs)]).max()
    return Spectrum(
        frequency=frequency,
        power=powers.mean(axis=0),
        # each sample is in four windows
        averages=0.375 * len(powers),
        rounding=2 * step * (1e-9 * largest) ** 2,
    )


def noise_power(spectrum: Spectrum) -> float:
    """Return the white noise power: the flat part of the upper three quarters of a spectrum, or of its upper half.

    The upper half of a short record does not tell noise from a falling spectrum: of 500 samples of white noise
    a third had none. It is used where the flat part of three quarters is much stronger than the upper end, as
    beyond a resonance in a slow log.
    """
    quarter = len(spectrum.power) // 4
    noise = _flat_part(spectrum, quarter)
    # 1.2 to 2.6 in two real stalls, whose errors are 12 and 30 % larger with the upper half; from 4 on at a resonance
    if noise > 3.0 * np.mean(spectrum.power[3 * quarter : -1]):
        noise = _flat_part(spectrum, 2 * quarter)
    return noise


def _flat_part(spectrum: Spectrum, begin: int) -> float:
    """Return the flat part of a spectrum from an index on, without the falling part.

    A sampled process whose power falls as f^-2k appears, folded at the Nyquist frequency F, near
    sin(pi f / 2F)^-2k. These shapes and a constant are fitted with non-negative weights. The constant
    counts with its probability: that by Whittle's likelihood with and without it, of prior odds exp(-2).
    """
    top = slice(begin, -1)
    observed = spectrum.power[top]
    if not observed.min() > 1e-24 * spectrum.power.max():
        return 0.0
    angle = 0.5 * np.pi * spectrum.frequency[top] / spectrum.frequency[-1]
    fall = np.sin(angle) ** -2
    shapes = np.column_stack([fall**k for k in (0, 1, 2, 4, 8)])
    shapes /= shapes.max(axis=0)
    weights, misfit = _fit_weights(shapes, observed)
    _, misfit_without = _fit_weights(shapes[:, 1:], observed)
    gain = spectrum.averages * (misfit_without - misfit)
    noise = weights[0] * special.expit(gain - 2.0)
    return float(noise) if noise > spectrum.rounding else 0.0


def _fit_weights(shapes: Matrix, observed: Vector) -> tuple[Vector, float]:
    """Return non-negative weights of the shapes, and minus Whittle's log likelihood of one periodogram."""
    fitted = observed
    for _ in range(4):
        relative = shapes / fitted[:, None]
        weights, _ = optimize.nnls(relative, observed / fitted)
        fitted = shapes @ weights
    misfit = np.sum(np.log(fitted) + observed / fitted)
    return weights, misfit


def _wiener_gain(spectrum: Spectrum) -> Vector:
    """Return Wiener's smoother of a channel, (m,)."""
    floor = noise_power(spectrum)
    if floor == 0:
        return np.ones_like(spectrum.power)
    # fewer periodograms than 20 are also averaged over neighbouring frequencies (guess)
    width = max(1.0, 20 / spectrum.averages)
    log_power = np.log(spectrum.power + np.finfo(float).tiny)
    smoothed = ndimage.gaussian_filter1d(log_power, width, mode="nearest")
    # h = max(0, 1 - N / P)
    gain = np.clip(1 - floor / np.exp(smoothed), 0, 1)
    # the mean of a channel is signal
    gain[0] = 1.0
    # that does not rise beyond the last frequency at which it is 1/2
    is_beyond = _is_beyond(gain)
    least = np.minimum.accumulate(np.where(is_beyond, gain, 0.5))
    return np.where(is_beyond, least, gain)


def _is_beyond(gain: Vector) -> Mask:
    """Return whether a frequency lies beyond the last at which the gain (m,) is 1/2, signal as strong as noise."""
    last = np.flatnonzero(gain >= 0.5)[-1]
    return np.arange(len(gain)) > last


def _impulse_response(gain: Vector) -> Vector:
    """Return the impulse response of a gain, (2 m - 3,), Hann-tapered; a constant passes unchanged."""
    size = 2 * (len(gain) - 1)
    taper = hann(size + 1)[1:-1]
    centred = np.fft.fftshift(np.fft.irfft(gain, size))
    response = centred[1:] * taper
    lacking = gain[0] - response.sum()
    return response + lacking * taper / taper.sum()


def _convolved(values: Vector, response: Vector) -> Vector:
    """Return values (n,), continued oddly beyond their ends, filtered by a response (l,)."""
    padded = np.pad(values, len(response) // 2, mode="reflect", reflect_type="odd")
    return signal.oaconvolve(padded, response, mode="valid")


def vibration_band(table: pd.DataFrame) -> float:
    """Return the frequency [Hz] beyond which flights with vanes vibrate; infinite where they do not.

    Vibration beyond the motion biases slopes. Without it nothing should be removed, as gusts there
    contribute to the mean of a nonlinear function. Without vanes the noise of the filter contains it.
    """
    if not has_values(table, "time", *SPECIFIC_FORCE, *VANES):
        return np.inf
    # [Hz]: errors of a narrower one correlate between ten rows a second
    band = max(motion_band_of(table), 5.0)
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
            sums = np.cumsum(spectrum.power)
            if sums[-1] > spectrum.rounding:
                of_group.append(float(spectrum.frequency[sums >= 0.98 * sums[-1]][0]))
        bands.append(max(of_group, default=np.inf))
    return min(bands)


def vibrates_beyond(table: pd.DataFrame, band: float) -> bool:
    """Return whether two of the three specific forces have more power beyond the band [Hz] than within.

    Means and trends are no power. Gusts move the aircraft within the band: two of the forces have up
    to 29 % beyond it in 16 simulated flights of four aircraft without vibration, and 16 to 96 % in
    16 flights with vibration.
    """
    beyond, within = np.zeros((2, len(SPECIFIC_FORCE)))
    for number, spectrum in _spectra(table, SPECIFIC_FORCE):
        weighted = spectrum.averages * spectrum.power
        is_beyond = spectrum.frequency > band
        beyond[number] += weighted[is_beyond].sum()
        within[number] += weighted[~is_beyond].sum()
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

    def filtered(values: Vector, rate: float) -> Vector:
        is_below = band < 0.49 * rate
        return low_pass(values, rate, band, order=8) if is_below else values

    return filtered
