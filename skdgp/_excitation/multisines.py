"""Multisines: sums of harmonics, orthogonal between axes, with phases of low peaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, rfft
from scipy.optimize import brentq, minimize
from sklearn.utils import check_random_state

from skdgp._compute.threads import one_blas_thread
from skdgp._compute.typing import Array, Seed, Vector
from skdgp._excitation.signals import (
    ROUNDING,
    UNLIMITED,
    Limits,
    Signal,
    as_limits,
    check_duration,
    checked_band,
    freeze,
)

POWERS = (4, 8, 16, 32, 64, 128, 256)  # powers p of the norms that approach the peak in the search for phases
SEARCH_SAMPLES, PEAK_SAMPLES = 32, 200
"""Samples per period of the highest harmonic: in the search for phases, and for a peak."""
MOST_STEPS, MOST_SAMPLES, MOST_STARTS = 200, 30_000_000, 1000
"""Steps of a search for one norm, samples in all its steps together (some seconds), searches for one signal."""
LEAST_COVERAGE = 0.7  # share of a band that evenly spaced harmonics must cover; else they are spread over it unevenly


@dataclass(frozen=True)
class Multisine(Signal):
    r"""Sum of sines whose frequencies are harmonics of one period: :math:`\sum_k a_k \sin(2\pi h_k t / T + \phi_k)`.

    Multisines of the same duration T without common harmonics are orthogonal over it, and so are the responses of a
    linear aircraft to them (Morelli, AIAA 2003-5700; Klein & Morelli, Aircraft System Identification, 2006, chapter 9).

    The duration, T [s], is the period; phases are in radians. Raises ValueError if harmonics are not distinct integers
    > 0, the numbers of harmonics, amplitudes and phases differ, or one is not finite.

    Examples
    --------
    >>> from skdgp.design import multisine
    >>> signal = multisine(10.0, range(2, 12), rms=0.03)
    >>> best = signal.optimized()
    >>> print(f"{signal.relative_peak_factor:.1f} {best.relative_peak_factor:.1f}, from {abs(best(0.0)):.3f}")
    1.3 1.0, from 0.000
    """

    duration: float
    harmonics: Sequence[int]
    amplitudes: Sequence[float]
    phases: Sequence[float]

    def __post_init__(self) -> None:
        given = np.asarray(self.harmonics)
        if not (len(given) and (given == given.astype(int)).all() and given.min() > 0 and len({*given}) == len(given)):
            raise ValueError(f"Got harmonics {list(self.harmonics)}, but expected distinct integers > 0.")
        check_duration(self.duration, int(given.max()))
        if not len(given) == len(self.amplitudes) == len(self.phases):
            raise ValueError(
                f"Got {len(self.amplitudes)} amplitudes and {len(self.phases)} phases of {len(given)} harmonics, but "
                "expected one for each."
            )
        if not np.isfinite([*self.amplitudes, *self.phases]).all():
            raise ValueError("Got amplitudes or phases that are NaN or infinite, but expected finite numbers.")
        freeze(self, int, "harmonics")
        freeze(self, float, "amplitudes", "phases")

    def __call__(self, time: ArrayLike) -> Array:
        x = np.asarray(time, dtype=float) / self.duration
        total = np.zeros(x.shape)
        for k, amplitude, phase in zip(self.harmonics, self.amplitudes, self.phases, strict=True):  # for memory
            total += amplitude * np.sin(2.0 * np.pi * k * x + phase)
        return total * ((x >= 0) & (x < 1))

    @property
    def rms(self) -> float:
        return float(np.linalg.norm(self.amplitudes) / np.sqrt(2.0))

    @property
    def peak(self) -> float:
        return _bound(self.harmonics, self.amplitudes, self.phases)

    @property
    def speed(self) -> float:
        rates = 2.0 * np.pi / self.duration * np.multiply(self.harmonics, self.amplitudes)
        return _bound(self.harmonics, rates, np.add(self.phases, 0.5 * np.pi))

    @property
    def period(self) -> float:
        return self.duration / max(self.harmonics)

    @property
    def relative_peak_factor(self) -> float:
        r""":math:`(\max s - \min s) / (2\sqrt 2\,\mathrm{rms})`, which is 1 for a single sine."""
        signal = _sampled(self.harmonics, self.amplitudes, self.phases, PEAK_SAMPLES)
        return float(np.ptp(signal) / (2.0 * np.linalg.norm(self.amplitudes)))

    def scaled(self, factor: float) -> Self:
        return replace(self, amplitudes=[factor * amplitude for amplitude in self.amplitudes])

    def optimized(self, *, n_starts: int = 8, random_state: Seed = 0) -> Multisine:
        r"""Return it with the phases of the lowest relative peak factor that is found, beginning and ending at zero.

        The range of the signal is the limit of :math:`\|s_+\|_p + \|s_-\|_p`, which is smooth; p grows step by step
        (Guillaume, Schoukens, Pintelon & Kollar, IEEE Trans. Instrum. Meas. 40, 1991). Then time is shifted to a zero.
        One of ``n_starts`` searches, 1 to 1000, begins at Schroeder's phases, the others at random ones. Long signals
        of high frequencies get fewer steps in each, so that all take some seconds at most.
        """
        if not (isinstance(n_starts, Integral) and 1 <= n_starts <= MOST_STARTS):
            raise ValueError(f"Got n_starts={n_starts!r}, but expected a whole number from 1 to {MOST_STARTS}.")
        amplitudes = np.array(self.amplitudes)
        random = check_random_state(random_state)
        steps = MOST_SAMPLES // (SEARCH_SAMPLES * max(self.harmonics) * len(POWERS) * n_starts)
        steps = min(max(steps, 1), MOST_STEPS)
        others = random.uniform(0.0, 2.0 * np.pi, (n_starts - 1, len(amplitudes)))
        with one_blas_thread():
            found = [
                replace(self, phases=_flattest(self.harmonics, amplitudes, start, steps).tolist())
                for start in (_schroeder(amplitudes**2), *others)
            ]
        return min(found, key=lambda one: one.relative_peak_factor)._from_zero()

    def _from_zero(self) -> Multisine:
        """Return it shifted in time to the zero crossing of least slope, so that it begins and ends at zero."""
        harmonics, amplitudes = np.array(self.harmonics), np.array(self.amplitudes)

        def value(x: float) -> float:
            return float(np.sin(2.0 * np.pi * x * harmonics + self.phases) @ amplitudes)

        signal = _sampled(self.harmonics, amplitudes, self.phases, PEAK_SAMPLES)
        following = np.roll(signal, -1)
        crossings = np.flatnonzero(signal * following <= 0)
        k = int(crossings[np.argmin(np.abs(following - signal)[crossings])])
        low, high = k / len(signal), k / len(signal) + 1.0 / len(signal)
        crosses = value(low) * value(high) < 0  # else one of them is the zero
        at = brentq(value, low, high, xtol=1e-16) if crosses else min(low, high, key=lambda x: abs(value(x)))
        phases = np.mod(self.phases + 2.0 * np.pi * harmonics * at, 2.0 * np.pi)
        return replace(self, phases=phases.tolist())


def multisine(duration: float, harmonics: Sequence[int], *, rms: float, limits: Limits | None = None) -> Multisine:
    r"""Return a multisine of equal amplitudes with Schroeder's phases, which keep the peaks low.

    With the shares :math:`p_l` of the power, :math:`\phi_k = -2\pi \sum_{l<k} (k - l) p_l` (IEEE Trans. Inf. Theory 16,
    1970). `Multisine.optimized` finds better ones. Raises ValueError if harmonics are not distinct integers > 0, the
    rms is not > 0, or a limit is exceeded.

    Parameters
    ----------
    duration : float
        T [s], the period.
    harmonics : sequence of int
        Its frequencies are these over T.
    rms : float
        Root mean square.
    limits : Limits, optional

    Returns
    -------
    Multisine

    Examples
    --------
    >>> from skdgp.design import multisine
    >>> round(multisine(10.0, [2, 3, 5], rms=0.02).rms, 6)
    0.02
    """
    if not 0 < rms < np.inf:
        raise ValueError(f"Got rms={rms!r}, but expected a number > 0.")
    amplitudes = [rms * float(np.sqrt(2.0 / len(harmonics))) for _ in harmonics]
    signal = Multisine(duration, harmonics, amplitudes, _schroeder(np.ones(len(harmonics))).tolist())
    return (limits or UNLIMITED).check(signal)


def orthogonal_multisines(
    limits: Mapping[str, Limits | float], duration: float, band: tuple[float, float], *, n_tones: int | None = None,
    n_starts: int = 8, random_state: Seed = 0,
) -> dict[str, Multisine]:  # fmt: skip
    """Return multisines for several axes at once: orthogonal, as large as the limits allow, with low peaks.

    The harmonics of the band are dealt out to the axes in turn, so that each covers the band (Morelli, AIAA 2003-5700);
    those of an axis are evenly spaced where that covers most of the band, since peaks are then lower.
    Phases are those of `Multisine.optimized`: each input begins and ends at zero. Raises ValueError if there are fewer
    harmonics in the band than tones, or no axis.

    Parameters
    ----------
    limits : mapping of str to Limits or float
        Of each axis; a float is the amplitude.
    duration : float
        [s].
    band : tuple of float
        Lowest and highest frequency [Hz].
    n_tones : int, optional
        Of each axis, spread over the band; by default all there are.
    n_starts, random_state
        As of `Multisine.optimized`.

    Returns
    -------
    dict of str to Multisine

    Examples
    --------
    >>> from skdgp.design import orthogonal_multisines
    >>> inputs = orthogonal_multisines({"aileron": 0.1, "rudder": 0.2}, 20.0, (0.2, 1.5), n_tones=6)
    >>> inputs["aileron"].harmonics, inputs["rudder"].harmonics
    ((4, 8, 12, 16, 20, 24), (6, 10, 14, 18, 22, 26))
    """
    low, high = checked_band(band, duration)
    if not limits:
        raise ValueError("Got no axis, but expected limits of at least one, such as {'elevator': 0.05}.")
    found = np.arange(int(np.ceil(low * duration - ROUNDING)), int(np.floor(high * duration + ROUNDING)) + 1)
    each = len(found) // len(limits) if n_tones is None else n_tones
    if each < 1 or each * len(limits) > len(found):
        raise ValueError(
            f"Got {len(limits)} axes with {n_tones or 'at least 1'} tones each, but there are {len(found)} harmonics "
            f"of {1.0 / duration:.3g} Hz between {low:g} and {high:g} Hz: fly longer, widen the band or use fewer "
            "tones."
        )
    inputs = {}
    for (axis, limit), harmonics in zip(limits.items(), _dealt(found, len(limits), each), strict=True):
        signal = multisine(duration, harmonics.tolist(), rms=1.0)
        best = signal.optimized(n_starts=n_starts, random_state=random_state)
        inputs[axis] = as_limits(limit).largest(best)
    return inputs


def _dealt(harmonics: np.ndarray, m: int, n: int) -> list[np.ndarray]:
    """Return n of the harmonics for each of m axes, evenly spaced if they then cover most of the band: peaks are lower.

    With a spacing d for each axis, the axes begin d // m apart.
    """
    last = len(harmonics) - 1
    reach = {d: d * (n - 1) + d // m * (m - 1) for d in range(m, last + 2)}
    d = max(d for d in reach if reach[d] <= last)
    if reach[d] >= LEAST_COVERAGE * last:
        return [harmonics[k * (d // m) :: d][:n] for k in range(m)]
    spread = harmonics[np.linspace(0, last, n * m).round().astype(int)]
    return [spread[k::m] for k in range(m)]


def _sampled(harmonics: Sequence[int], amplitudes: ArrayLike, phases: ArrayLike, samples: int) -> Vector:
    """Return a multisine over its period, at ``samples`` per period of the highest harmonic."""
    n = samples * max(harmonics)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[list(harmonics)] = -0.5j * n * np.asarray(amplitudes) * np.exp(1j * np.asarray(phases))
    return irfft(spectrum, n)


def _bound(harmonics: Sequence[int], amplitudes: ArrayLike, phases: ArrayLike) -> float:
    """Return a bound of a multisine: the largest sample, and what a curve can rise between two, step^2 / 8 |s''|."""
    signal = _sampled(harmonics, amplitudes, phases, PEAK_SAMPLES)
    step = 2.0 * np.pi * np.array(harmonics) / len(signal)
    return float(np.abs(signal).max() + step**2 @ np.abs(np.asarray(amplitudes, dtype=float)) / 8.0)


def _schroeder(power: Vector) -> Vector:
    """Return Schroeder's phases."""
    shares = power / power.sum()
    return -2.0 * np.pi * np.array([np.arange(k, 0, -1) @ shares[:k] for k in range(len(shares))])


def _flattest(harmonics: Sequence[int], amplitudes: Vector, phases: Vector, most: int) -> Vector:
    """Return the phases of a local minimum of the range of a multisine, found in ``most`` steps for each norm."""
    weights = amplitudes / np.linalg.norm(amplitudes)

    def size(phases: Vector, p: int) -> tuple[float, Vector]:
        """Return the sum of the p-norms of the positive and the negative part, and its gradient."""
        signal = _sampled(harmonics, weights, phases, SEARCH_SAMPLES)
        total, by_signal = 0.0, np.zeros_like(signal)
        for sign in (1.0, -1.0):
            part = np.maximum(sign * signal, 0.0)
            ratio = part / part.max()
            mean = np.mean(ratio**p)
            total += part.max() * mean ** (1.0 / p)
            by_signal += sign * mean ** (1.0 / p - 1.0) * ratio ** (p - 1) / len(signal)
        return total, weights * np.real(np.exp(1j * phases) * np.conj(rfft(by_signal)[list(harmonics)]))

    for p in POWERS:
        phases = minimize(
            size, phases, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": most, "maxfun": 2 * most}
        ).x
    return phases
