"""Inputs that excite an aircraft, as functions of time; `skdgp.design` shows them to users.

Steps and sweeps of one axis and its limits; multisines: sums of harmonics, orthogonal between axes,
with phases of low peaks; wavetrains: inputs of several axes in a sequence, as tables that
autopilots and simulations fly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Literal, Self, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.fft import irfft, rfft
from scipy.optimize import brentq, minimize
from scipy.signal import lfilter
from sklearn.utils import check_random_state

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Array, Seed, Vector
from skdgp._flight.checks import check_names

# time by which a sample may lie before a step and yet count as after it [s]: clocks are rounded
EDGE = 1e-5
ROUNDING = 1e-9  # relative excess of a limit that is rounding
RMS_SAMPLES = 10_000  # samples of a signal, for its root mean square
RATE_SAMPLES, MOST_RATE_SAMPLES = 2000, 4_000_000
"""For the bound of the rate of a sweep: samples in a period of its highest frequency, and samples
at most.
"""
MOST_PERIODS = RMS_SAMPLES // 2
"""Largest number of periods of a signal, with two samples in each: 100 s at 50 Hz, ten minutes at 8
Hz.
"""
AnySignal = TypeVar("AnySignal", bound="Signal")
POWERS = (
    4,
    8,
    16,
    32,
    64,
    128,
    256,
)  # powers p of the norms that approach the peak in the search for phases
SEARCH_SAMPLES, PEAK_SAMPLES = 32, 200
"""Samples per period of the highest harmonic: in the search for phases, and for a peak."""
MOST_STEPS, MOST_SAMPLES, MOST_STARTS = 200, 30_000_000, 1000
"""Steps of a search for one norm, samples in all its steps together (some seconds), searches for
one signal.
"""
# share of a band that evenly spaced harmonics must cover; else they are spread over it unevenly
LEAST_COVERAGE = 0.7
AXES = (
    "elevator",
    "aileron",
    "rudder",
    "throttle",
    "elevon_left",
    "elevon_right",
    "propeller_speed",
    "thrust",
)
MOST_ROWS = 1_000_000  # largest number of rows of a table: five hours at 50 Hz
SAMPLES_PER_PERIOD = 10
"""Least number of samples in the shortest period of a signal: held for one, it is late by a
twentieth of it.
"""


class Signal(ABC):
    """Deviation of one control from trim as a function of the time since its start [s], zero before it and after it."""

    duration: float
    """How long it lasts [s]."""

    @abstractmethod
    def __call__(self, time: ArrayLike) -> Array:
        """Return the deviation at times of any shape."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """Bound of the deviation, the smallest that is known."""

    @property
    @abstractmethod
    def speed(self) -> float:
        """Bound of the rate of change [1/s], the smallest that is known."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Shortest period of a sine, or of a pulse and the one after it [s]."""

    @abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return it multiplied by a factor."""

    @property
    def rms(self) -> float:
        """Root mean square over its duration; its square is the power."""
        return float(
            np.sqrt(
                np.mean(self(np.linspace(0.0, self.duration, RMS_SAMPLES, endpoint=False)) ** 2)
            )
        )


@dataclass(frozen=True)
class Limits:
    """What an axis allows around its trim; raises ValueError if a limit is not > 0, or the lag is negative or infinite.

    Parameters
    ----------
    amplitude : float
        Largest deviation [rad, or 1 of the throttle].
    rate : float
        Largest rate of change [1/s]. Steps become ramps of this rate.
    rms : float
        Largest root mean square of one input, the limit of its power.
    lag : float
        Time constant of the servo [s]: `plan` flies surfaces that follow the inputs with a
        first-order lag.

    Examples
    --------
    >>> from skdgp.design import Limits, doublet
    >>> Limits(amplitude=0.05, rate=0.5).check(doublet(0.5, 0.1), "elevator")
    Traceback (most recent call last):
    ...
    ValueError: Got an input of the elevator with a peak of 0.1, but the limit is 0.05: make it
    smaller or raise the limit.
    """

    amplitude: float
    rate: float = np.inf
    rms: float = np.inf
    lag: float = 0.0

    def __post_init__(self) -> None:
        for name in ("amplitude", "rate", "rms"):
            if not (isinstance(value := getattr(self, name), Real) and float(value) > 0):
                raise ValueError(
                    f"Got a limit {name}={value!r}, which forbids every input, but expected a "
                    f"number > 0."
                )
        if not (isinstance(self.lag, Real) and 0 <= self.lag < np.inf):
            raise ValueError(
                f"Got lag={self.lag!r}, but expected the time constant of the servo [s], 0 or more."
            )

    def check(self, signal: AnySignal, axis: str = "") -> AnySignal:
        """Return an input, or raise ValueError if it exceeds a limit; ``axis`` is its name in the error."""
        for what, name, limit in (
            ("peak", "peak", self.amplitude), ("rate", "speed", self.rate), ("rms", "rms", self.rms)
        ):  # fmt: skip
            if np.isfinite(limit) and (has := getattr(signal, name)) > limit * (1.0 + ROUNDING):
                remedy = "give its steps ramps (limits=...)" if np.isinf(has) else "make it smaller"
                raise ValueError(
                    f"Got an input{axis and ' of the ' + axis} with a {what} of {has:.4g}, but "
                    f"the limit is {limit:g}: "
                    f"{remedy} or raise the limit."
                )
        return signal

    def followed(self, values: Vector, step: float) -> Vector:
        """Return what the servo makes of deviations from trim that are set every ``step`` seconds."""
        if not self.lag:
            return values
        kept = np.exp(-step / self.lag)
        return np.asarray(lfilter([0.0, 1.0 - kept], [1.0, -kept], values))

    def largest(self, signal: AnySignal) -> AnySignal:
        """Return an input scaled to the largest that the limits allow; raise ValueError if its steps are no ramps."""
        if not signal.peak > 0:
            raise ValueError("Got an input that is zero, but expected one to scale.")
        by_rate = self.rate / signal.speed if np.isfinite(signal.speed) else np.inf
        return self.check(
            signal.scaled(min(self.amplitude / signal.peak, self.rms / signal.rms, by_rate))
        )


UNLIMITED = Limits(np.inf)


def as_limits(limit: Limits | float) -> Limits:
    """Return limits; a number is the amplitude."""
    return limit if isinstance(limit, Limits) else Limits(limit)


@dataclass(frozen=True)
class Steps(Signal):
    r"""Levels, deviations from trim, that are held one after another for ``durations`` [s], as `doublet` makes them.

    With a finite ``rate`` [1/s] the steps are ramps, each centred on its edge, so that the mean
    stays what it was; the first begins at time 0, and the input lasts :math:`(|l_1| + |l_n|) / 2r`
    longer. Raises ValueError if there is no level, a duration is not > 0, or the ramps do not fit
    into the durations.

    Examples
    --------
    >>> from skdgp.design import Steps
    >>> Steps([1.0, 2.0], [0.1, -0.1], rate=1.0)([0.05, 0.5, 1.0, 2.0, 4.0])
    array([ 0.05,  0.1 ,  0.05, -0.1 ,  0.  ])
    """

    durations: Sequence[float]
    levels: Sequence[float]
    rate: float = np.inf
    duration: float = field(init=False)

    def __post_init__(self) -> None:
        freeze(self, float, "durations", "levels")
        if (
            not self.levels
            or len(self.levels) != len(self.durations)
            or not np.isfinite(self.levels).all()
        ):
            raise ValueError(
                f"Got durations {self.durations} of levels {self.levels}, but expected one finite "
                f"level for each."
            )
        if not (min(self.durations) > 0 and np.isfinite(self.durations).all() and self.rate > 0):
            raise ValueError(
                f"Got durations {self.durations} [s] and rate {self.rate}, but expected all > 0."
            )
        needed = 0.5 * (self.ramps[:-1] + self.ramps[1:])
        if (needed > np.array(self.durations) * (1.0 + ROUNDING)).any():
            k = int(np.argmax(needed - self.durations))
            raise ValueError(
                f"Got a level of {self.levels[k]:g} held for {self.durations[k]:g} s, but at a "
                f"rate of {self.rate:g} "
                f"1/s its ramps need {needed[k]:.3g} s: choose a longer duration, a smaller level "
                f"or a higher rate."
            )
        object.__setattr__(self, "duration", float(self.edges[-1] + 0.5 * self.ramps[-1]))

    def __call__(self, time: ArrayLike) -> Array:
        since = np.asarray(time, dtype=float)
        held = np.array([0.0, *self.levels, 0.0])
        if np.isinf(self.rate):
            return held[np.searchsorted(self.edges, since + EDGE, side="right")]
        corners = np.stack([self.edges - 0.5 * self.ramps, self.edges + 0.5 * self.ramps], axis=-1)
        return np.interp(since, corners.ravel(), np.stack([held[:-1], held[1:]], axis=-1).ravel())

    @property
    def swings(self) -> Vector:
        """Change of the deviation at each edge."""
        return np.diff([0.0, *self.levels, 0.0])

    @property
    def ramps(self) -> Vector:
        """How long each change takes [s]."""
        return np.abs(self.swings) / self.rate

    @property
    def edges(self) -> Vector:
        """Middle of each change [s]."""
        return np.cumsum([0.5 * self.ramps[0], *self.durations])

    @property
    def peak(self) -> float:
        return max(map(abs, self.levels))

    @property
    def speed(self) -> float:
        return self.rate

    @property
    def period(self) -> float:
        return 2.0 * min(self.durations)

    def levels_in(self, detent: float) -> list[float]:
        """Return the levels, each as the next smaller multiple of a detent."""
        return (detent * np.trunc(np.divide(self.levels, detent) * (1.0 + ROUNDING))).tolist()

    def scaled(self, factor: float) -> Self:
        """Return it multiplied by a factor, the rate of its ramps too."""
        levels = [factor * level for level in self.levels]
        return replace(self, levels=levels, rate=abs(factor) * self.rate)


@dataclass(frozen=True)
class Chirp(Signal):
    """Sine of a frequency that moves through a band: see `chirp`, which makes it."""

    duration: float
    band: tuple[float, float]
    amplitude: float
    logarithmic: bool
    fade: float

    def __call__(self, time: ArrayLike) -> Array:
        since = np.asarray(time, dtype=float)
        x = np.clip(since / self.duration, 0.0, 1.0)
        low, high = self.band
        if self.logarithmic:
            ratio = np.log(high / low)
            cycles = low * self.duration * np.expm1(ratio * x) / ratio
        else:
            cycles = self.duration * (low * x + 0.5 * (high - low) * x**2)
        envelope = np.sin(0.5 * np.pi * np.minimum(1.0, np.minimum(x, 1.0 - x) / self.fade)) ** 2
        return self.amplitude * envelope * np.sin(2.0 * np.pi * cycles)

    @property
    def peak(self) -> float:
        return abs(self.amplitude)

    @property
    def speed(self) -> float:
        n = min(int(RATE_SAMPLES * self.duration * self.band[1]) + 1, MOST_RATE_SAMPLES)
        values, step = self(np.linspace(0.0, self.duration, n + 1)), self.duration / n
        fastest = np.pi * (2.0 * self.band[1] + 0.5 / (self.fade * self.duration))
        return float(np.abs(np.diff(values)).max() / step + 0.5 * step * self.peak * fastest**2)

    @property
    def period(self) -> float:
        return 1.0 / self.band[1]

    def scaled(self, factor: float) -> Self:
        return replace(self, amplitude=factor * self.amplitude)


def doublet(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a doublet: a pulse up and one down, each ``width`` seconds long; down first if the amplitude is < 0.

    Its spectrum peaks at 2.33 / width [rad/s]; see `input_bands`. The rate of ``limits`` is that of
    its ramps. Raises ValueError if a limit is exceeded, or the ramps do not fit into the width.

    Examples
    --------
    >>> from skdgp.design import doublet
    >>> doublet(0.5, 0.1)([0.0, 0.25, 0.75, 1.0])
    array([ 0.1,  0.1, -0.1,  0. ])
    """
    return _pulses((1, 1), width, amplitude, limits)


def three_two_one_one(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    It excites a wider band than a doublet (Jategaonkar, Flight Vehicle System Identification, 2nd
    edition, 2015, section 2.3). Its mean is not zero. Amplitude, limits and errors are as of
    `doublet`.

    Examples
    --------
    >>> from skdgp.design import Limits, three_two_one_one
    >>> round(three_two_one_one(0.5, 0.1, limits=Limits(0.1, rate=1.0)).duration, 9)
    3.6
    """
    return _pulses((3, 2, 1, 1), width, amplitude, limits)


def _pulses(units: Sequence[int], width: float, amplitude: float, limits: Limits | None) -> Steps:
    """Return pulses of alternating sign, of ``units`` times the width."""
    allowed = limits or UNLIMITED
    levels = [amplitude * (-1) ** k for k in range(len(units))]
    return allowed.check(Steps([unit * width for unit in units], levels, allowed.rate))


def chirp(
    duration: float, band: tuple[float, float], amplitude: float, *,
    spacing: Literal["logarithmic", "linear"] = "logarithmic", fade: float = 0.1, limits: Limits | None = None,
) -> Chirp:  # fmt: skip
    r"""Return a frequency sweep: a sine whose frequency moves through a band, fading in and out.

    The frequency is :math:`f_0 (f_1 / f_0)^{t/T}`, the same time in each octave, or linear in time
    (Klein & Morelli, Aircraft System Identification, 2006, chapter 9; Tischler & Remple, Aircraft
    and Rotorcraft System Identification, 2012, chapter 5). Raises ValueError if the duration is too
    short for the band, or a limit is exceeded.

    Parameters
    ----------
    duration : float
        T [s], at least a period of the lowest frequency.
    band : tuple of float
        First and last frequency f0, f1 [Hz].
    amplitude : float
    spacing : {"logarithmic", "linear"}
    fade : float, default=0.1
        Share of the duration over which the amplitude rises, and falls again, as sin^2; at most
        0.5.
    limits : Limits, optional

    Returns
    -------
    Chirp

    Examples
    --------
    >>> from skdgp.design import chirp
    >>> signal = chirp(20.0, (0.2, 2.0), 0.05)
    >>> signal([0.0, 5.0, 8.0]).round(4)
    array([ 0.    ,  0.0401, -0.0357])
    """
    low, high = checked_band(band, duration)
    if not duration * low >= 1.0 - ROUNDING:
        raise ValueError(
            f"Got a sweep of {duration:g} s, but a period of {low:g} Hz lasts {1.0 / low:.3g} s: "
            f"fly longer."
        )
    if spacing not in ("logarithmic", "linear") or not (0 < fade <= 0.5 and np.isfinite(amplitude)):
        raise ValueError(
            f"Got amplitude={amplitude!r}, spacing={spacing!r}, fade={fade!r}, but expected a "
            f"number, 'logarithmic' or "
            "'linear', and a share in (0, 0.5]."
        )
    signal = Chirp(
        float(duration), (low, high), float(amplitude), spacing == "logarithmic", float(fade)
    )
    return (limits or UNLIMITED).check(signal)


def freeze(signal: Signal, kind: Callable, *names: str) -> None:
    """Make the sequences of a frozen signal tuples, so that it compares and pickles by value."""
    for name in names:
        object.__setattr__(signal, name, tuple(map(kind, getattr(signal, name))))


def checked_band(band: tuple[float, float], duration: float) -> tuple[float, float]:
    """Return lowest and highest frequency [Hz]; raise ValueError if they are no band, or as of `check_duration`."""
    low, high = map(float, band)
    if not 0 < low < high < np.inf:
        raise ValueError(
            f"Got a band of {low:g} to {high:g} Hz, but expected 0 < lowest < highest."
        )
    check_duration(duration, high * duration)
    return low, high


def check_duration(duration: float, periods: float) -> None:
    """Raise ValueError if a duration [s] is none, or has more than `MOST_PERIODS` of the highest frequency."""
    if not 0 < duration < np.inf:
        raise ValueError(f"Got a duration of {duration} s, but expected one > 0.")
    if periods > MOST_PERIODS:
        high = periods / duration
        raise ValueError(
            f"Got {duration:g} s of up to {high:g} Hz, {periods:.3g} periods, but expected at "
            f"most {MOST_PERIODS}: at "
            f"most {MOST_PERIODS / high:.3g} s, or up to {MOST_PERIODS / duration:.3g} Hz."
        )


@dataclass(frozen=True)
class Multisine(Signal):
    r"""Sum of sines whose frequencies are harmonics of one period: :math:`\sum_k a_k \sin(2\pi h_k t / T + \phi_k)`.

    Multisines of the same duration T without common harmonics are orthogonal over it, and so are
    the responses of a linear aircraft to them (Morelli, AIAA 2003-5700; Klein & Morelli, Aircraft
    System Identification, 2006, chapter 9).

    The duration, T [s], is the period; phases are in radians. Raises ValueError if harmonics are
    not distinct integers > 0, the numbers of harmonics, amplitudes and phases differ, or one is not
    finite.

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
        if not (
            len(given)
            and (given == given.astype(int)).all()
            and given.min() > 0
            and len({*given}) == len(given)
        ):
            raise ValueError(
                f"Got harmonics {list(self.harmonics)}, but expected distinct integers > 0."
            )
        check_duration(self.duration, int(given.max()))
        if not len(given) == len(self.amplitudes) == len(self.phases):
            raise ValueError(
                f"Got {len(self.amplitudes)} amplitudes and {len(self.phases)} phases of "
                f"{len(given)} harmonics, but "
                "expected one for each."
            )
        if not np.isfinite([*self.amplitudes, *self.phases]).all():
            raise ValueError(
                "Got amplitudes or phases that are NaN or infinite, but expected finite numbers."
            )
        freeze(self, int, "harmonics")
        freeze(self, float, "amplitudes", "phases")

    def __call__(self, time: ArrayLike) -> Array:
        x = np.asarray(time, dtype=float) / self.duration
        total = np.zeros(x.shape)
        for k, amplitude, phase in zip(
            self.harmonics, self.amplitudes, self.phases, strict=True
        ):  # for memory
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

        The range of the signal is the limit of :math:`\|s_+\|_p + \|s_-\|_p`, which is smooth; p
        grows step by step (Guillaume, Schoukens, Pintelon & Kollar, IEEE Trans. Instrum. Meas. 40,
        1991). Then time is shifted to a zero. One of ``n_starts`` searches, 1 to 1000, begins at
        Schroeder's phases, the others at random ones. Long signals of high frequencies get fewer
        steps in each, so that all take some seconds at most.
        """
        if not (isinstance(n_starts, Integral) and 1 <= n_starts <= MOST_STARTS):
            raise ValueError(
                f"Got n_starts={n_starts!r}, but expected a whole number from 1 to {MOST_STARTS}."
            )
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
        at = (
            brentq(value, low, high, xtol=1e-16)
            if crosses
            else min(low, high, key=lambda x: abs(value(x)))
        )
        phases = np.mod(self.phases + 2.0 * np.pi * harmonics * at, 2.0 * np.pi)
        return replace(self, phases=phases.tolist())


def multisine(
    duration: float, harmonics: Sequence[int], *, rms: float, limits: Limits | None = None
) -> Multisine:
    r"""Return a multisine of equal amplitudes with Schroeder's phases, which keep the peaks low.

    With the shares :math:`p_l` of the power, :math:`\phi_k = -2\pi \sum_{l<k} (k - l) p_l` (IEEE
    Trans. Inf. Theory 16, 1970). `Multisine.optimized` finds better ones. Raises ValueError if
    harmonics are not distinct integers > 0, the rms is not > 0, or a limit is exceeded.

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
    signal = Multisine(
        duration, harmonics, amplitudes, _schroeder(np.ones(len(harmonics))).tolist()
    )
    return (limits or UNLIMITED).check(signal)


def orthogonal_multisines(
    limits: Mapping[str, Limits | float], duration: float, band: tuple[float, float], *, n_tones: int | None = None,
    n_starts: int = 8, random_state: Seed = 0,
) -> dict[str, Multisine]:  # fmt: skip
    """Return multisines for several axes at once: orthogonal, as large as the limits allow, with low peaks.

    The harmonics of the band are dealt out to the axes in turn, so that each covers the band
    (Morelli, AIAA 2003-5700); those of an axis are evenly spaced where that covers most of the
    band, since peaks are then lower. Phases are those of `Multisine.optimized`: each input begins
    and ends at zero. Raises ValueError if there are fewer harmonics in the band than tones, or no
    axis.

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
        raise ValueError(
            "Got no axis, but expected limits of at least one, such as {'elevator': 0.05}."
        )
    found = np.arange(
        int(np.ceil(low * duration - ROUNDING)), int(np.floor(high * duration + ROUNDING)) + 1
    )
    each = len(found) // len(limits) if n_tones is None else n_tones
    if each < 1 or each * len(limits) > len(found):
        raise ValueError(
            f"Got {len(limits)} axes with {n_tones or 'at least 1'} tones each, but there are "
            f"{len(found)} harmonics "
            f"of {1.0 / duration:.3g} Hz between {low:g} and {high:g} Hz: fly longer, widen the "
            f"band or use fewer "
            "tones."
        )
    inputs = {}
    for (axis, limit), harmonics in zip(
        limits.items(), _dealt(found, len(limits), each), strict=True
    ):
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


def _sampled(
    harmonics: Sequence[int], amplitudes: ArrayLike, phases: ArrayLike, samples: int
) -> Vector:
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
        return total, weights * np.real(
            np.exp(1j * phases) * np.conj(rfft(by_signal)[list(harmonics)])
        )

    for p in POWERS:
        phases = minimize(
            size,
            phases,
            args=(p,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": most, "maxfun": 2 * most},
        ).x
    return phases


@dataclass(frozen=True, eq=False)
class Wavetrain:
    """Inputs of several axes, each at its time: for each axis a mapping of start [s] to `Signal`.

    The axes are elevator, aileron, rudder, elevons [rad], throttle, propeller_speed [rad/s] and
    thrust [N]. Every input is checked against ``limits``, `Limits` by axis, and so is every row of
    `table`. Raises ValueError if an axis is unknown, an input has no time or begins before time 0,
    or a limit is no `Limits` or exceeded.

    Examples
    --------
    >>> from skdgp.design import Wavetrain, doublet
    >>> train = Wavetrain({"elevator": {1.0: doublet(0.5, 0.05)}, "rudder": {3.0: doublet(0.5, 0.1)}})
    >>> train.duration
    4.0
    >>> train.table(rate=50.0).iloc[60]
    time        1.20
    elevator    0.05
    rudder      0.00
    Name: 60, dtype: float64
    """

    inputs: Mapping[str, Mapping[float, Signal]]
    limits: Mapping[str, Limits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_names([*self.inputs, *self.limits], AXES, "axes")
        for axis, signals in self.inputs.items():
            if not isinstance(signals, Mapping):
                raise ValueError(
                    f"Got {signals!r} as inputs of the {axis}, but expected {{start: signal}}."
                )
        for axis, limit in self.limits.items():
            if not isinstance(limit, Limits):
                raise ValueError(
                    f"Got {limit!r} as limits of the {axis}, but expected Limits(amplitude, rate, "
                    f"rms)."
                )
        for axis, start, signal in self.events():
            if not 0 <= start < np.inf:
                raise ValueError(
                    f"Got an input of the {axis} at {start:g} s, but expected a time >= 0."
                )
            self.limits.get(axis, UNLIMITED).check(signal, axis)

    def __call__(self, axis: str, time: ArrayLike) -> Array:
        """Return the deviation of an axis from trim at times [s]; zero of an axis without inputs."""
        time = np.asarray(time, dtype=float)
        total = np.zeros(time.shape)
        for start, signal in self.inputs.get(axis, {}).items():
            total += signal(time - start)
        return total

    @property
    def axes(self) -> list[str]:
        """Names of the axes that have inputs."""
        return list(self.inputs)

    @property
    def duration(self) -> float:
        """When the last input ends [s]."""
        return max((start + signal.duration for _, start, signal in self.events()), default=0.0)

    def events(self) -> Iterator[tuple[str, float, Signal]]:
        """Yield axis, start [s] and signal of each input, axis by axis."""
        for axis, signals in self.inputs.items():
            for start, signal in signals.items():
                yield axis, start, signal

    def table(
        self, rate: float, *, trim: Mapping[str, float] | None = None, pause: float = 0.0
    ) -> pd.DataFrame:
        """Return a table of ``time`` [s] and the axes at the rate [Hz] at which an autopilot sets them.

        It ends a ``pause`` [s] after the last input. By default it holds deviations from trim. With
        the controls of trimmed flight, such as ``Trim.controls``, it holds their sums, and controls
        without inputs: it is then what :func:`skdgp.dynamics.simulate` flies. Raises ValueError if
        the rate is too low for an input, there would be more than a million rows, the pause is
        negative, inputs that overlap exceed a limit of their axis, or ``trim`` lacks an axis.

        Examples
        --------
        >>> from skdgp.design import Wavetrain, doublet
        >>> Wavetrain({"elevator": {0.0: doublet(0.1, 0.05)}}).table(rate=10.0)
        Traceback (most recent call last):
        ...
        ValueError: Got a rate of 10 Hz, but an input of the elevator has periods of 0.2 s: expected
        at least 50 Hz, or a lower band or longer pulses.
        """
        if not (0 < rate < np.inf and 0 <= pause < np.inf):
            raise ValueError(
                f"Got rate={rate} Hz and pause={pause} s, but expected a rate > 0 and a pause "
                f"from 0 on."
            )
        for axis, _, signal in self.events():
            if not rate * signal.period >= SAMPLES_PER_PERIOD * (1.0 - ROUNDING):
                raise ValueError(
                    f"Got a rate of {rate:g} Hz, but an input of the {axis} has periods of "
                    f"{signal.period:.3g} s: "
                    f"expected at least {SAMPLES_PER_PERIOD / signal.period:.3g} Hz, or a lower "
                    f"band or longer pulses."
                )
        if (length := self.duration + pause) * rate > MOST_ROWS:
            raise ValueError(
                f"Got {length:g} s at {rate:g} Hz, {length * rate:.3g} rows, but expected at most "
                f"{MOST_ROWS}: at most "
                f"{MOST_ROWS / length:.3g} Hz, or {MOST_ROWS / rate:.3g} s."
            )
        time = np.arange(round(np.ceil(length * rate - ROUNDING)) + 1) / rate
        columns = {axis: self(axis, time) for axis in self.axes}
        for axis, values in columns.items():
            limit = self.limits.get(axis, UNLIMITED)
            peak, speed = np.abs(values).max(), np.abs(np.diff(values, prepend=0.0)).max() * rate
            if peak > limit.amplitude * (1.0 + ROUNDING) or speed > limit.rate * (1.0 + ROUNDING):
                raise ValueError(
                    f"Got inputs of the {axis} that overlap with a peak of {peak:.4g} and a rate "
                    f"of {speed:.4g}, but "
                    f"the limits are {limit.amplitude:g} and {limit.rate:g}: let one begin after "
                    f"the other."
                )
        if trim is not None:
            check_names(columns, trim, "controls of the trim")
            columns = {name: trim[name] + columns.get(name, np.zeros(len(time))) for name in trim}
        return pd.DataFrame({"time": time, **columns})


def wavetrain(
    manoeuvres: Sequence[Mapping[str, Signal]],
    *,
    pause: float = 5.0,
    limits: Mapping[str, Limits] | None = None,
) -> Wavetrain:
    """Return manoeuvres one after another, with flight at trim before, between and after them.

    Each manoeuvre is a mapping of axes to inputs, which begin together. Before each is a ``pause``
    [s] in which the modes decay. Raises ValueError if a manoeuvre has no input, or as of
    `Wavetrain`, whose ``limits`` are these.

    Examples
    --------
    >>> from skdgp.design import doublet, three_two_one_one, wavetrain
    >>> train = wavetrain([{"elevator": three_two_one_one(0.5, 0.05)}, {"aileron": doublet(0.5, 0.1)}], pause=4.0)
    >>> [(axis, start) for axis, start, _ in train.events()]
    [('elevator', 4.0), ('aileron', 11.5)]
    """
    inputs: dict[str, dict[float, Signal]] = {}
    start = float(pause)
    for manoeuvre in manoeuvres:
        if not (isinstance(manoeuvre, Mapping) and manoeuvre):
            raise ValueError(
                f"Got {manoeuvre!r} as a manoeuvre, but expected a list of mappings "
                f"{{axis: signal}}."
            )
        for axis, signal in manoeuvre.items():
            inputs.setdefault(axis, {})[start] = signal
        start += max(signal.duration for signal in manoeuvre.values()) + pause
    return Wavetrain(inputs, limits or {})
