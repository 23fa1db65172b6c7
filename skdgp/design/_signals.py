"""Inputs that excite an aircraft: steps, sweeps, multisines; and what an axis allows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize
from sklearn.utils import check_random_state

from skdgp._compute.threads import one_blas_thread
from skdgp._compute.typing import Array, Seed, Vector

EDGE = 1e-5
"""By which a sample may lie before a step and yet count as after it [s]: clocks are rounded."""
ROUNDING = 1e-9
"""By which a limit may be exceeded, relative to it."""
POWERS = (4, 8, 16, 32, 64, 128, 256)
"""Of the norms that approach the peak in the search for phases."""
SEARCH_SAMPLES, PEAK_SAMPLES, RATE_SAMPLES = 32, 200, 2000
"""Samples per period of the highest frequency: in the search for phases, for a peak, for the rate of a sweep."""
RMS_SAMPLES = 10_000
LEAST_COVERAGE = 0.8
"""Share of a band that evenly spaced harmonics must cover; else they are spread over it unevenly."""
AnySignal = TypeVar("AnySignal", bound="Signal")


class Signal(ABC):
    """Deviation of one control from trim as a function of time, from zero to zero.

    ``signal(time)`` returns the deviation at times [s] since its start, of any shape, zero before and after it.
    """

    duration: float
    """How long it lasts [s]."""

    @abstractmethod
    def __call__(self, time: ArrayLike) -> Array:
        """Return the deviation at times since the start [s]."""

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
    """What an axis allows around its trim.

    Parameters
    ----------
    amplitude : float
        Largest deviation [rad, or 1 of the throttle].
    rate : float
        Largest rate of change [1/s]. Steps become ramps of this rate.
    rms : float
        Largest root mean square of one input, the limit of its power.

    Raises
    ------
    ValueError
        If a limit is not > 0: it would forbid every input.

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

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"Got a limit {name}={value!r}, which forbids every input, but expected one > 0.")

    def check(self, signal: Signal, axis: str = "") -> None:
        """Raise ValueError if an input exceeds a limit; ``axis`` is its name in the error."""
        for what, has, limit in (
            ("peak", signal.peak, self.amplitude), ("rate", signal.speed, self.rate), ("rms", signal.rms, self.rms)
        ):  # fmt: skip
            if has > limit * (1.0 + ROUNDING):
                remedy = "give its steps ramps (limits=...)" if np.isinf(has) else "make it smaller"
                raise ValueError(
                    f"Got an input{axis and ' of the ' + axis} with a {what} of {has:.4g}, but the limit is {limit:g}: "
                    f"{remedy} or raise the limit."
                )

    def largest(self, signal: AnySignal) -> AnySignal:
        """Return an input scaled to the largest that the limits allow; raise ValueError if its steps are no ramps."""
        factors = [self.amplitude / signal.peak, self.rms / signal.rms]
        found = signal.scaled(min([*factors, self.rate / signal.speed] if np.isfinite(signal.speed) else factors))
        self.check(found)
        return found


@dataclass(frozen=True)
class Steps(Signal):
    r"""Levels that are held one after another; `doublet` and `three_two_one_one` are steps.

    With a finite rate the steps are ramps, each centred on its edge, so that the mean stays what it was; the first
    begins at time 0, and the input lasts :math:`(|l_1| + |l_n|) / 2r` longer.

    Parameters
    ----------
    durations : sequence of float
        How long each level is held [s].
    levels : sequence of float
        Deviations from trim.
    rate : float, default=inf
        Of the ramps between levels [1/s].

    Raises
    ------
    ValueError
        If there is no level, a duration is not > 0, or the ramps do not fit into the durations.

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
        _freeze(self, float, "durations", "levels")
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
        n = int(RATE_SAMPLES * self.duration * self.band[1]) + 1
        values, step = self(np.linspace(0.0, self.duration, n + 1)), self.duration / n
        fastest = np.pi * (2.0 * self.band[1] + 0.5 / (self.fade * self.duration))
        return float(np.abs(np.diff(values)).max() / step + 0.5 * step * self.peak * fastest**2)

    @property
    def period(self) -> float:
        return 1.0 / self.band[1]

    def scaled(self, factor: float) -> Self:
        return replace(self, amplitude=factor * self.amplitude)


@dataclass(frozen=True)
class Multisine(Signal):
    r"""Sum of sines whose frequencies are harmonics of one period: :math:`\sum_k a_k \sin(2\pi h_k t / T + \phi_k)`.

    Multisines of the same duration T without common harmonics are orthogonal over it, and so are the responses of a
    linear aircraft to them (Morelli, AIAA 2003-5700; Klein & Morelli, Aircraft System Identification, 2006, chapter 9).

    Parameters
    ----------
    duration : float
        T [s], the period.
    harmonics : sequence of int
        h.
    amplitudes, phases : sequence of float
        a, and phi [rad].

    Raises
    ------
    ValueError
        If harmonics are not distinct integers > 0, or the numbers of harmonics, amplitudes and phases differ.

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
        if not 0 < self.duration < np.inf:
            raise ValueError(f"Got a duration of {self.duration} s, but expected one > 0.")
        if not len(given) == len(self.amplitudes) == len(self.phases):
            raise ValueError(
                f"Got {len(self.amplitudes)} amplitudes and {len(self.phases)} phases of {len(given)} harmonics, but "
                "expected one for each."
            )
        _freeze(self, int, "harmonics")
        _freeze(self, float, "amplitudes", "phases")

    def __call__(self, time: ArrayLike) -> Array:
        x = np.asarray(time, dtype=float) / self.duration
        inside = (x >= 0) & (x < 1)
        return _waves(x, self.harmonics, self.phases) @ np.array(self.amplitudes) * inside

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
        signal = _waves(_grid(self.harmonics, PEAK_SAMPLES), self.harmonics, self.phases) @ np.array(self.amplitudes)
        return float(np.ptp(signal) / (2.0 * np.linalg.norm(self.amplitudes)))

    def scaled(self, factor: float) -> Self:
        return replace(self, amplitudes=[factor * amplitude for amplitude in self.amplitudes])

    def optimized(self, *, n_starts: int = 8, random_state: Seed = 0) -> Multisine:
        r"""Return it with the phases of the lowest relative peak factor that is found, beginning and ending at zero.

        The range of the signal is the limit of :math:`\|s_+\|_p + \|s_-\|_p`, which is smooth; p grows step by step
        (Guillaume, Schoukens, Pintelon & Kollar, IEEE Trans. Instrum. Meas. 40, 1991). Then time is shifted to a zero.

        Parameters
        ----------
        n_starts : int, default=8
            Number of searches: one from Schroeder's phases, the others from random ones.
        random_state : int, RandomState instance or None
            Of the random phases.

        Returns
        -------
        Multisine
        """
        amplitudes = np.array(self.amplitudes)
        random = check_random_state(random_state)
        starts = [_schroeder(amplitudes**2)] + [
            random.uniform(0.0, 2.0 * np.pi, len(amplitudes)) for _ in range(n_starts - 1)
        ]
        with one_blas_thread():
            found = [replace(self, phases=_flattest(self.harmonics, amplitudes, start).tolist()) for start in starts]
        return min(found, key=lambda one: one.relative_peak_factor)._from_zero()

    def _from_zero(self) -> Multisine:
        """Return it shifted in time to the zero crossing of least slope, so that it begins and ends at zero."""
        x = _grid(self.harmonics, PEAK_SAMPLES)
        amplitudes = np.array(self.amplitudes)

        def value(x: float) -> float:
            return float(_waves(np.array(x), self.harmonics, self.phases) @ amplitudes)

        signal = _waves(x, self.harmonics, self.phases) @ amplitudes
        following = np.roll(signal, -1)
        crossings = np.flatnonzero(signal * following <= 0)
        k = crossings[np.argmin(np.abs(following - signal)[crossings])]
        at = x[k] if signal[k] == 0 else brentq(value, x[k], x[k] + 1.0 / len(x), xtol=1e-16)
        phases = np.mod(self.phases + 2.0 * np.pi * np.array(self.harmonics) * at, 2.0 * np.pi)
        return replace(self, phases=phases.tolist())


def doublet(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a doublet: a pulse up and one down, each ``width`` seconds long.

    Its spectrum peaks at 2.33 / width [rad/s]; see `input_bands`.

    Parameters
    ----------
    width : float
        [s].
    amplitude : float
        Deviation from trim, < 0 for down first.
    limits : Limits, optional
        Of its axis; their rate is that of the ramps.

    Returns
    -------
    Steps

    Raises
    ------
    ValueError
        If a limit is exceeded, or the ramps do not fit into the width.

    Examples
    --------
    >>> from skdgp.design import doublet
    >>> doublet(0.5, 0.1)([0.0, 0.25, 0.75, 1.0])
    array([ 0.1,  0.1, -0.1,  0. ])
    """
    return _steps((1, 1), width, amplitude, limits)


def three_two_one_one(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    It excites a wider band than a doublet (Jategaonkar, Flight Vehicle System Identification, 2nd edition, 2015,
    section 2.3). Its mean is not zero.

    Parameters
    ----------
    width : float
        Of the shortest pulse [s].
    amplitude : float
        Deviation from trim, < 0 for down first.
    limits : Limits, optional
        Of its axis; their rate is that of the ramps.

    Returns
    -------
    Steps

    Raises
    ------
    ValueError
        If a limit is exceeded, or the ramps do not fit into the width.

    Examples
    --------
    >>> from skdgp.design import Limits, three_two_one_one
    >>> round(three_two_one_one(0.5, 0.1, limits=Limits(0.1, rate=1.0)).duration, 9)
    3.6
    """
    return _steps((3, 2, 1, 1), width, amplitude, limits)


def chirp(
    duration: float,
    band: tuple[float, float],
    amplitude: float,
    *,
    spacing: Literal["logarithmic", "linear"] = "logarithmic",
    fade: float = 0.1,
    limits: Limits | None = None,
) -> Chirp:
    r"""Return a frequency sweep: a sine whose frequency moves through a band, fading in and out.

    The frequency is :math:`f_0 (f_1 / f_0)^{t/T}`, the same time in each octave, or linear in time (Klein & Morelli,
    Aircraft System Identification, 2006, chapter 9; Tischler & Remple, Aircraft and Rotorcraft System Identification,
    2012, chapter 5).

    Parameters
    ----------
    duration : float
        T [s], at least a period of the lowest frequency.
    band : tuple of float
        First and last frequency f0, f1 [Hz].
    amplitude : float
        Deviation from trim.
    spacing : {"logarithmic", "linear"}
    fade : float, default=0.1
        Share of the duration over which the amplitude rises, and falls again, as sin^2; at most 0.5.
    limits : Limits, optional
        Of its axis.

    Returns
    -------
    Chirp

    Raises
    ------
    ValueError
        If the band is not increasing, the duration is too short for it, ``spacing`` or ``fade`` is not one of these, or
        a limit is exceeded.

    Examples
    --------
    >>> from skdgp.design import chirp
    >>> signal = chirp(20.0, (0.2, 2.0), 0.05)
    >>> signal([0.0, 5.0, 8.0]).round(4)
    array([ 0.    ,  0.0401, -0.0357])
    """
    low, high = _checked_band(band)
    if not duration * low >= 1.0 - ROUNDING:
        raise ValueError(
            f"Got a sweep of {duration:g} s, but a period of {low:g} Hz lasts {1.0 / low:.3g} s: fly longer."
        )
    if spacing not in ("logarithmic", "linear") or not 0 < fade <= 0.5:
        raise ValueError(
            f"Got spacing={spacing!r}, fade={fade!r}, but expected 'logarithmic' or 'linear', and a share in (0, 0.5]."
        )
    signal = Chirp(float(duration), (low, high), float(amplitude), spacing == "logarithmic", float(fade))
    if limits is not None:
        limits.check(signal)
    return signal


def multisine(
    duration: float,
    harmonics: Sequence[int],
    *,
    rms: float,
    power: ArrayLike | None = None,
    limits: Limits | None = None,
) -> Multisine:
    r"""Return a multisine with Schroeder's phases, which keep the peaks low (IEEE Trans. Inf. Theory 16, 1970).

    With the shares :math:`p_l` of the power, :math:`\phi_k = -2\pi \sum_{l<k} (k - l) p_l`. `Multisine.optimized`
    finds better ones.

    Parameters
    ----------
    duration : float
        T [s], the period.
    harmonics : sequence of int
        Its frequencies are these over T.
    rms : float
        Root mean square.
    power : array-like of shape (n,), optional
        Relative power of each harmonic; by default all have the same.
    limits : Limits, optional
        Of its axis.

    Returns
    -------
    Multisine

    Raises
    ------
    ValueError
        If harmonics are not distinct integers > 0, a power is not > 0, or a limit is exceeded.

    Examples
    --------
    >>> from skdgp.design import multisine
    >>> round(multisine(10.0, [2, 3, 5], rms=0.02).rms, 6)
    0.02
    """
    shares = np.ones(len(harmonics)) if power is None else np.array(power, dtype=float)
    if len(shares) != len(harmonics) or not (shares > 0).all():
        raise ValueError(f"Got power {power!r} of {len(harmonics)} harmonics, but expected a number > 0 for each.")
    amplitudes = rms * np.sqrt(2.0 * shares / shares.sum())
    signal = Multisine(duration, harmonics, amplitudes.tolist(), _schroeder(shares).tolist())
    if limits is not None:
        limits.check(signal)
    return signal


def orthogonal_multisines(
    limits: Mapping[str, Limits | float],
    duration: float,
    band: tuple[float, float],
    *,
    n_tones: int | None = None,
    power: Callable[[Array], ArrayLike] | None = None,
    n_starts: int = 8,
    random_state: Seed = 0,
) -> dict[str, Multisine]:
    """Return multisines for several axes at once: orthogonal, as large as the limits allow, with low peaks.

    The harmonics of the band are dealt out to the axes in turn, so that each covers the band (Morelli, AIAA 2003-5700).
    Phases are those of `Multisine.optimized`: each input begins and ends at zero.

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
    power : callable, optional
        Frequencies [Hz] to their relative power; by default the same for all.
    n_starts : int, default=8
        Number of searches for phases of each input.
    random_state : int, RandomState instance or None, default=0
        Of the searches.

    Returns
    -------
    dict of str to Multisine

    Raises
    ------
    ValueError
        If there are fewer harmonics in the band than tones, or no axis.

    Examples
    --------
    >>> from skdgp.design import orthogonal_multisines
    >>> inputs = orthogonal_multisines({"aileron": 0.1, "rudder": 0.2}, 20.0, (0.2, 1.5), n_tones=6)
    >>> inputs["aileron"].harmonics, inputs["rudder"].harmonics
    ((4, 8, 12, 16, 20, 24), (6, 10, 14, 18, 22, 26))
    """
    low, high = _checked_band(band)
    found = np.arange(int(np.ceil(low * duration - ROUNDING)), int(np.floor(high * duration + ROUNDING)) + 1)
    each = len(found) // max(1, len(limits)) if n_tones is None else n_tones
    if not limits or each < 1 or each * len(limits) > len(found):
        raise ValueError(
            f"Got {len(limits)} axes with {n_tones or 'at least 1'} tones each, but there are {len(found)} harmonics "
            f"of {1.0 / duration:.3g} Hz between {low:g} and {high:g} Hz: fly longer, widen the band or use fewer "
            "tones."
        )
    chosen = _spread(found, each * len(limits))
    inputs = {}
    for k, (axis, limit) in enumerate(limits.items()):
        harmonics = chosen[k :: len(limits)]
        shares = None if power is None else np.broadcast_to(power(harmonics / duration), len(harmonics))
        best = multisine(duration, harmonics.tolist(), rms=1.0, power=shares).optimized(
            n_starts=n_starts, random_state=random_state
        )
        allowed = limit if isinstance(limit, Limits) else Limits(limit)
        inputs[axis] = allowed.largest(best)
    return inputs


def _spread(harmonics: np.ndarray, n: int) -> np.ndarray:
    """Return n of the harmonics, evenly spaced if they then cover most of the band: peaks are lower."""
    last = len(harmonics) - 1
    stride = last // max(1, n - 1)
    if stride * (n - 1) >= LEAST_COVERAGE * last:
        return harmonics[: stride * (n - 1) + 1 : stride]
    return harmonics[np.linspace(0, last, n).round().astype(int)]


def _steps(units: Sequence[int], width: float, amplitude: float, limits: Limits | None) -> Steps:
    """Return pulses of alternating sign, of ``units`` times the width."""
    levels = [amplitude * (-1) ** k for k in range(len(units))]
    signal = Steps([unit * width for unit in units], levels, np.inf if limits is None else limits.rate)
    if limits is not None:
        limits.check(signal)
    return signal


def _freeze(signal: Signal, kind: Callable, *names: str) -> None:
    """Make the sequences of a frozen signal tuples, so that it compares and pickles by value."""
    for name in names:
        object.__setattr__(signal, name, tuple(map(kind, getattr(signal, name))))


def _checked_band(band: tuple[float, float]) -> tuple[float, float]:
    low, high = map(float, band)
    if not 0 < low < high < np.inf:
        raise ValueError(f"Got a band of {low:g} to {high:g} Hz, but expected 0 < lowest < highest.")
    return low, high


def _grid(harmonics: Sequence[int], samples: int) -> Vector:
    """Return a period in [0, 1) at ``samples`` per period of the highest harmonic."""
    n = samples * max(harmonics)
    return np.arange(n) / n


def _waves(x: Array, harmonics: Sequence[int], phases: ArrayLike) -> Array:
    """Return the sines at parts x (...) of the period, (..., n)."""
    return np.sin(2.0 * np.pi * x[..., None] * np.array(harmonics, dtype=float) + np.array(phases))


def _bound(harmonics: Sequence[int], amplitudes: ArrayLike, phases: ArrayLike) -> float:
    """Return a bound of a multisine: the largest sample, and what a curve can rise between two, step^2 / 8 |s''|."""
    weights = np.asarray(amplitudes, dtype=float)
    signal = _waves(_grid(harmonics, PEAK_SAMPLES), harmonics, phases) @ weights
    step = 2.0 * np.pi * np.array(harmonics) / (PEAK_SAMPLES * max(harmonics))
    return float(np.abs(signal).max() + step**2 @ np.abs(weights) / 8.0)


def _schroeder(power: Vector) -> Vector:
    """Return Schroeder's phases."""
    shares = power / power.sum()
    return -2.0 * np.pi * np.array([np.arange(k, 0, -1) @ shares[:k] for k in range(len(shares))])


def _flattest(harmonics: Sequence[int], amplitudes: Vector, phases: Vector) -> Vector:
    """Return the phases of a local minimum of the range of a multisine."""
    angles = 2.0 * np.pi * _grid(harmonics, SEARCH_SAMPLES)[:, None] * np.array(harmonics)
    sines, cosines = np.sin(angles), np.cos(angles)
    weights = amplitudes / np.linalg.norm(amplitudes)

    def size(phases: Vector, p: int) -> tuple[float, Vector]:
        """Return the sum of the p-norms of the positive and the negative part, and its gradient."""
        sine, cosine = weights * np.sin(phases), weights * np.cos(phases)
        signal = sines @ cosine + cosines @ sine
        total, by_signal = 0.0, np.zeros_like(signal)
        for sign in (1.0, -1.0):
            part = np.maximum(sign * signal, 0.0)
            ratio = part / part.max()
            mean = np.mean(ratio**p)
            total += part.max() * mean ** (1.0 / p)
            by_signal += sign * mean ** (1.0 / p - 1.0) * ratio ** (p - 1) / len(signal)
        return total, cosine * (by_signal @ cosines) - sine * (by_signal @ sines)

    for p in POWERS:
        phases = minimize(size, phases, args=(p,), jac=True, method="L-BFGS-B", options={"maxiter": 200}).x
    return phases
