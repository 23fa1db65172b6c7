"""Inputs of one axis: steps and sweeps, and the limits of the axis."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from skdgp._compute.typing import Array, Vector

EDGE = 1e-5  # time by which a sample may lie before a step and yet count as after it [s]: clocks are rounded
ROUNDING = 1e-9  # relative excess of a limit that is rounding
RMS_SAMPLES = 10_000  # samples of a signal, for its root mean square
RATE_SAMPLES, MOST_RATE_SAMPLES = 2000, 4_000_000
"""For the bound of the rate of a sweep: samples in a period of its highest frequency, and samples at most."""
MOST_PERIODS = RMS_SAMPLES // 2
"""Largest number of periods of a signal, with two samples in each: 100 s at 50 Hz, ten minutes at 8 Hz."""
AnySignal = TypeVar("AnySignal", bound="Signal")


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
        return float(np.sqrt(np.mean(self(np.linspace(0.0, self.duration, RMS_SAMPLES, endpoint=False)) ** 2)))


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
        Time constant of the servo [s]: `plan` flies surfaces that follow the inputs with a first-order lag.

    Examples
    --------
    >>> from skdgp.design import Limits, doublet
    >>> Limits(amplitude=0.05, rate=0.5).check(doublet(0.5, 0.1), "elevator")
    Traceback (most recent call last):
    ...
    ValueError: Got an input of the elevator with a peak of 0.1, but the limit is 0.05: make it smaller or raise the
    limit.
    """

    amplitude: float
    rate: float = np.inf
    rms: float = np.inf
    lag: float = 0.0

    def __post_init__(self) -> None:
        for name in ("amplitude", "rate", "rms"):
            if not (isinstance(value := getattr(self, name), Real) and float(value) > 0):
                raise ValueError(f"Got a limit {name}={value!r}, which forbids every input, but expected a number > 0.")
        if not (isinstance(self.lag, Real) and 0 <= self.lag < np.inf):
            raise ValueError(f"Got lag={self.lag!r}, but expected the time constant of the servo [s], 0 or more.")

    def check(self, signal: AnySignal, axis: str = "") -> AnySignal:
        """Return an input, or raise ValueError if it exceeds a limit; ``axis`` is its name in the error."""
        for what, name, limit in (
            ("peak", "peak", self.amplitude), ("rate", "speed", self.rate), ("rms", "rms", self.rms)
        ):  # fmt: skip
            if np.isfinite(limit) and (has := getattr(signal, name)) > limit * (1.0 + ROUNDING):
                remedy = "give its steps ramps (limits=...)" if np.isinf(has) else "make it smaller"
                raise ValueError(
                    f"Got an input{axis and ' of the ' + axis} with a {what} of {has:.4g}, but the limit is {limit:g}: "
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
        return self.check(signal.scaled(min(self.amplitude / signal.peak, self.rms / signal.rms, by_rate)))


UNLIMITED = Limits(np.inf)


def as_limits(limit: Limits | float) -> Limits:
    """Return limits; a number is the amplitude."""
    return limit if isinstance(limit, Limits) else Limits(limit)


@dataclass(frozen=True)
class Steps(Signal):
    r"""Levels, deviations from trim, that are held one after another for ``durations`` [s], as `doublet` makes them.

    With a finite ``rate`` [1/s] the steps are ramps, each centred on its edge, so that the mean stays what it was; the
    first begins at time 0, and the input lasts :math:`(|l_1| + |l_n|) / 2r` longer. Raises ValueError if there is no
    level, a duration is not > 0, or the ramps do not fit into the durations.

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
        if not self.levels or len(self.levels) != len(self.durations) or not np.isfinite(self.levels).all():
            raise ValueError(
                f"Got durations {self.durations} of levels {self.levels}, but expected one finite level for each."
            )
        if not (min(self.durations) > 0 and np.isfinite(self.durations).all() and self.rate > 0):
            raise ValueError(f"Got durations {self.durations} [s] and rate {self.rate}, but expected all > 0.")
        needed = 0.5 * (self.ramps[:-1] + self.ramps[1:])
        if (needed > np.array(self.durations) * (1.0 + ROUNDING)).any():
            k = int(np.argmax(needed - self.durations))
            raise ValueError(
                f"Got a level of {self.levels[k]:g} held for {self.durations[k]:g} s, but at a rate of {self.rate:g} "
                f"1/s its ramps need {needed[k]:.3g} s: choose a longer duration, a smaller level or a higher rate."
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

    Its spectrum peaks at 2.33 / width [rad/s]; see `input_bands`. The rate of ``limits`` is that of its ramps. Raises
    ValueError if a limit is exceeded, or the ramps do not fit into the width.

    Examples
    --------
    >>> from skdgp.design import doublet
    >>> doublet(0.5, 0.1)([0.0, 0.25, 0.75, 1.0])
    array([ 0.1,  0.1, -0.1,  0. ])
    """
    return _pulses((1, 1), width, amplitude, limits)


def three_two_one_one(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    It excites a wider band than a doublet (Jategaonkar, Flight Vehicle System Identification, 2nd edition, 2015,
    section 2.3). Its mean is not zero. Amplitude, limits and errors are as of `doublet`.

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

    The frequency is :math:`f_0 (f_1 / f_0)^{t/T}`, the same time in each octave, or linear in time (Klein & Morelli,
    Aircraft System Identification, 2006, chapter 9; Tischler & Remple, Aircraft and Rotorcraft System Identification,
    2012, chapter 5). Raises ValueError if the duration is too short for the band, or a limit is exceeded.

    Parameters
    ----------
    duration : float
        T [s], at least a period of the lowest frequency.
    band : tuple of float
        First and last frequency f0, f1 [Hz].
    amplitude : float
    spacing : {"logarithmic", "linear"}
    fade : float, default=0.1
        Share of the duration over which the amplitude rises, and falls again, as sin^2; at most 0.5.
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
            f"Got a sweep of {duration:g} s, but a period of {low:g} Hz lasts {1.0 / low:.3g} s: fly longer."
        )
    if spacing not in ("logarithmic", "linear") or not (0 < fade <= 0.5 and np.isfinite(amplitude)):
        raise ValueError(
            f"Got amplitude={amplitude!r}, spacing={spacing!r}, fade={fade!r}, but expected a number, 'logarithmic' or "
            "'linear', and a share in (0, 0.5]."
        )
    signal = Chirp(float(duration), (low, high), float(amplitude), spacing == "logarithmic", float(fade))
    return (limits or UNLIMITED).check(signal)


def freeze(signal: Signal, kind: Callable, *names: str) -> None:
    """Make the sequences of a frozen signal tuples, so that it compares and pickles by value."""
    for name in names:
        object.__setattr__(signal, name, tuple(map(kind, getattr(signal, name))))


def checked_band(band: tuple[float, float], duration: float) -> tuple[float, float]:
    """Return lowest and highest frequency [Hz]; raise ValueError if they are no band, or as of `check_duration`."""
    low, high = map(float, band)
    if not 0 < low < high < np.inf:
        raise ValueError(f"Got a band of {low:g} to {high:g} Hz, but expected 0 < lowest < highest.")
    check_duration(duration, high * duration)
    return low, high


def check_duration(duration: float, periods: float) -> None:
    """Raise ValueError if a duration [s] is none, or has more than `MOST_PERIODS` of the highest frequency."""
    if not 0 < duration < np.inf:
        raise ValueError(f"Got a duration of {duration} s, but expected one > 0.")
    if periods > MOST_PERIODS:
        high = periods / duration
        raise ValueError(
            f"Got {duration:g} s of up to {high:g} Hz, {periods:.3g} periods, but expected at most {MOST_PERIODS}: at "
            f"most {MOST_PERIODS / high:.3g} s, or up to {MOST_PERIODS / duration:.3g} Hz."
        )
