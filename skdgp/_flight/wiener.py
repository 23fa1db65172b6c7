"""Spectra of noisy channels, and their Wiener smoothers.

With P(f) the measured (cross-)power of k channels and N the white noise of their sensors, the linear smoother of
least mean squared error is, for one channel and for all jointly,

    h_i(f) = max(0, 1 - N_i / P_ii(f)),        H(f) = (P - N) P^-1

(Wiener 1949). Beyond the last frequency at which signal is as strong as noise, both are made non-increasing in f.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage, optimize, signal

WINDOW_SECONDS = 6.4
SHORTEST_WINDOW = 32
LEAST_SAMPLES = 4 * SHORTEST_WINDOW
EVIDENCE = 2.0  # least gain in log likelihood for which a spectrum is given white noise


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


def flight_spectrum(segments: list[np.ndarray], step: float) -> Spectrum | None:
    """Return the spectrum of segments, each (n, k), sampled every ``step`` s; None where none is long enough.

    Samples are counted, not timed: interpolation between jittered ones would colour white noise.
    """
    longest = max(len(segment) for segment in segments)
    if longest < LEAST_SAMPLES:
        return None
    size = 2 * (min(int(max(WINDOW_SECONDS / step, 2 * SHORTEST_WINDOW)), longest // 4) // 2)
    pieces = np.concatenate([_windows(segment, size) for segment in segments if len(segment) >= size])
    taper = signal.windows.hann(size)
    waves = np.fft.rfft(signal.detrend(pieces, axis=-1) * taper, axis=-1).transpose(2, 1, 0)
    power = waves @ waves.conj().swapaxes(1, 2) * (2 * step / (len(pieces) * np.sum(taper**2)))
    rounding = 2 * step * (1e-9 * np.abs(pieces).max(axis=(0, 2))) ** 2
    averages = 0.375 * len(pieces)  # each sample is in four windows
    return Spectrum(np.fft.rfftfreq(size, step), power, averages, rounding)


def noise_and_gain(spectrum: Spectrum, joint: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the white noise power N of each channel, (k,), and the smoother of each alone or of all jointly."""
    power = spectrum.channel_power
    floor = np.array([_noise_floor(spectrum.frequency, each, spectrum.averages) for each in power.T])
    floor = np.where(floor > spectrum.rounding, floor, 0.0)
    return floor, (_joint_gain if joint else _single_gain)(spectrum, floor)


def _single_gain(spectrum: Spectrum, floor: np.ndarray) -> np.ndarray:
    """Return the smoother of each channel alone, (m, k)."""
    steady = np.exp(ndimage.gaussian_filter1d(np.log(spectrum.channel_power + 1e-300), 1.0, axis=0, mode="nearest"))
    gain = np.where(floor > 0, np.clip(1 - floor / steady, 0, 1), 1.0)
    gain[0] = 1.0  # the mean of a channel is signal
    return gain * _falling(gain)


def _joint_gain(spectrum: Spectrum, floor: np.ndarray) -> np.ndarray:
    """Return the smoother of each channel from all, (m, k, k); the row of a noise-free channel is the identity.

    In units of noise, P has eigenvalues 1 where there is no signal, spread by sampling up to the edge of Marchenko
    and Pastur (1967); only those beyond it are signal.
    """
    power, k = spectrum.channel_power, len(floor)
    # The root of the noise power; of something small where there is no noise.
    unit = np.sqrt(np.where(floor > 0, floor, 1e-2 * power.min(axis=0) + 1e-12 * power.max(axis=0) + 1e-300))
    size, axes = np.linalg.eigh(spectrum.power / (unit[:, None] * unit))
    edge = (1 + np.sqrt(k / spectrum.averages)) ** 2
    kept = np.where(size > edge, 1 - 1 / np.maximum(size, edge), 0.0)
    gain = np.einsum("mik,mk,mjk->mij", axes, kept, axes.conj()) * (unit[:, None] / unit)
    gain[0] = np.eye(k)
    seen = np.einsum("mik,mk->mi", np.abs(axes) ** 2, kept * size)  # signal found, in units of noise
    seen[0] = np.inf
    falling = _falling(1 / (1 + 1 / np.maximum(seen, 1e-12)))
    return np.where((floor > 0)[:, None], gain * falling[:, :, None], np.eye(k))


def expected_error(spectrum: Spectrum, floor: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return the mean squared error that remains, (k,): the integral of (1-H) S (1-H)* + H N H*, S = P - N.

    S is an estimate that may be negative; the second part, the noise that passes, bounds the sum from below.
    """
    k = len(floor)
    full = gain if gain.ndim == 3 else gain[:, :, None] * np.eye(k)
    missed = np.eye(k) - full
    lost = np.einsum("mij,mjl,mil->mi", missed, spectrum.power - np.diag(floor), missed.conj()).real
    passed = np.abs(full) ** 2 @ floor
    lost, passed = np.trapezoid([lost[1:], passed[1:]], spectrum.frequency[1:], axis=1)
    return passed + np.maximum(lost, 0)


def impulse_response(gain: np.ndarray) -> np.ndarray:
    """Return impulse responses of gains, (2 m - 3, ...), Hann-tapered; what is constant passes unchanged."""
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
    each = [signal.oaconvolve(padded, part, mode="valid", axes=0).sum(axis=1) for part in np.moveaxis(response, 1, 0)]
    return np.stack(each, axis=1)


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


def _fit_shares(shapes: np.ndarray, observed: np.ndarray) -> tuple[np.ndarray, float]:
    """Return non-negative shares of the shapes, and minus Whittle's log likelihood of one periodogram."""
    fitted = observed
    for _ in range(4):
        share, _ = optimize.nnls(shapes / fitted[:, None], observed / fitted)
        fitted = shapes @ share
    return share, np.sum(np.log(fitted) + observed / fitted)
