"""Inputs that excite an aircraft, as functions of time: steps, multisines, and sequences."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.fft import irfft
from scipy.optimize import minimize, newton

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Array, Vector
from skdgp._flight.checks import as_floats, check_names, check_number

EDGE = 1e-5  # a sample this little before a step counts as after it [s]: clocks are rounded
ROUNDING = 1e-9  # relative excess over a limit that is rounding
RMS_SAMPLES = 10_000  # samples of a signal for its root mean square
MOST_PERIODS = 5000  # periods of a multisine: 100 s at 50 Hz
POWERS = (4, 8, 16, 32, 64, 128, 256)  # norms that approach the peak in the search for phases
SEARCH_SAMPLES = 32  # samples per period of the highest harmonic in the search for phases
PEAK_SAMPLES = 200  # samples per period of the highest harmonic for a peak
MOST_STEPS = 200  # steps of the search for phases at each norm
LEAST_COVERAGE = (
    0.7  # fraction of a band that evenly spaced harmonics cover, or else they are uneven
)
MOST_ROWS = 1_000_000  # of a table: five hours at 50 Hz
SAMPLES_PER_PERIOD = (
    10  # in the shortest period: held for one, a signal is late by a twentieth of it
)
AXES = (
    "elevator", "aileron", "rudder", "throttle", "elevon_left", "elevon_right", "propeller_speed", "thrust",
)  # fmt: skip
AnySignal = TypeVar("AnySignal", bound="Signal")


class Signal(ABC):
    """Deviation of one control from trim as a function of the time since its start [s], zero before it and after it."""

    duration: float  #: How long it lasts [s]

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
    """Largest deviation of an axis from trim, and its largest rate; raises ValueError if one is not > 0.

    Parameters
    ----------
    amplitude : float
        [rad, or 1 of the throttle].
    rate : float, default=inf
        [1/s]. Steps become ramps of this rate.

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

    def __post_init__(self) -> None:
        for name in ("amplitude", "rate"):
            value = as_floats(getattr(self, name))
            if value.shape != () or not value > 0:
                raise ValueError(
                    f"Got a limit {name}={getattr(self, name)!r}, which forbids every input, but "
                    f"expected a number > 0."
                )

    def check(self, signal: AnySignal, axis: str = "") -> AnySignal:
        """Return an input, or raise ValueError if it exceeds a limit; ``axis`` is its name in the error."""
        pairs = {"peak": (signal.peak, self.amplitude), "rate": (signal.speed, self.rate)}
        for name, (value, limit) in pairs.items():
            if value > limit * (1.0 + ROUNDING):
                remedy = "give its steps ramps" if np.isinf(value) else "make it smaller"
                raise ValueError(
                    f"Got an input{axis and ' of the ' + axis} with a {name} of {value:.4g}, but "
                    f"the limit is {limit:g}: {remedy} or raise the limit."
                )
        return signal

    def largest(self, signal: AnySignal) -> AnySignal:
        """Return an input scaled to the limits; raise ValueError if it is zero, or its steps are no ramps."""
        if not signal.peak > 0:
            raise ValueError("Got an input that is zero, but expected one to scale.")
        by_rate = self.rate / signal.speed if np.isfinite(signal.speed) else np.inf
        return self.check(signal.scaled(min(self.amplitude / signal.peak, by_rate)))


UNLIMITED = Limits(np.inf)


def as_limits(limit: Limits | float) -> Limits:
    """Return limits; a number is the amplitude."""
    return limit if isinstance(limit, Limits) else Limits(limit)


@dataclass(frozen=True)
class Steps(Signal):
    r"""Levels, deviations from trim, that are held one after another for ``durations`` [s], as `doublet` makes them.

    With a finite ``rate`` [1/s] the steps are ramps, each centred on its edge, so that the mean is
    unchanged; the first begins at time 0, and the input lasts :math:`(|l_1| + |l_n|) / 2r`
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
        if not self.levels or len(self.levels) != len(self.durations):
            raise ValueError(
                f"Got durations {self.durations} of levels {self.levels}, but expected one finite "
                f"level for each."
            )
        numbers = np.array([*self.durations, *self.levels])
        if not (np.isfinite(numbers).all() and min(*self.durations, self.rate) > 0):
            raise ValueError(
                f"Got durations {self.durations} [s], levels {self.levels} and rate {self.rate}, "
                f"but expected finite levels, and all others > 0."
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

    def scaled(self, factor: float) -> Self:
        """Return it multiplied by a factor, the rate of its ramps too."""
        levels = [factor * level for level in self.levels]
        return replace(self, levels=levels, rate=abs(factor) * self.rate)


def doublet(width: float, amplitude: float, *, limits: Limits | None = None) -> Steps:
    """Return a doublet: a pulse up and one down, each ``width`` seconds long; down first if the amplitude is < 0.

    Its spectrum peaks at 2.33 / width [rad/s]. The rate of ``limits`` is the rate of its ramps.
    Raises ValueError if a limit is exceeded, or the ramps do not fit into the width.

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


def freeze(signal: Signal, kind: Callable, *names: str) -> None:
    """Make the sequences of a frozen signal tuples, so that it compares and pickles by value."""
    for name in names:
        object.__setattr__(signal, name, tuple(map(kind, getattr(signal, name))))


@dataclass(frozen=True)
class Multisine(Signal):
    r"""Sum of sines whose frequencies are harmonics of one period: :math:`\sum_k a_k \sin(2\pi h_k t / T + \phi_k)`.

    Multisines of the same duration T without common harmonics are orthogonal over it, and so are
    the responses of a linear aircraft to them (Morelli, AIAA 2003-5700; Klein & Morelli, Aircraft
    System Identification, 2006, chapter 9).

    The duration, T [s], is the period; phases are in radians. Raises ValueError if harmonics are
    not distinct integers > 0, there are more than 5000 periods, the numbers of harmonics,
    amplitudes and phases differ, or one is not finite.

    Examples
    --------
    >>> from skdgp.design import multisine
    >>> signal = multisine(10.0, range(2, 12), rms=0.03)
    >>> best = signal.optimized()
    >>> print(f"{signal.relative_peak_factor:.1f} {best.relative_peak_factor:.1f}, from {abs(best(0.0)):.3f}")
    1.3 1.1, from 0.000
    """

    duration: float
    harmonics: Sequence[int]
    amplitudes: Sequence[float]
    phases: Sequence[float]

    def __post_init__(self) -> None:
        harmonics = np.asarray(self.harmonics)
        is_whole = len(harmonics) > 0 and bool((harmonics == harmonics.astype(int)).all())
        if not (is_whole and harmonics.min() > 0 and harmonics.max() <= MOST_PERIODS):
            raise ValueError(
                f"Got harmonics {list(self.harmonics)}, but expected integers from 1 to "
                f"{MOST_PERIODS}: choose a shorter signal or lower frequencies."
            )
        numbers = np.array([self.duration, *self.amplitudes, *self.phases])
        n = len({*harmonics})
        is_complete = n == len(harmonics) == len(self.amplitudes) == len(self.phases)
        if not (is_complete and np.isfinite(numbers).all() and self.duration > 0):
            raise ValueError(
                f"Got duration {self.duration}, amplitudes {self.amplitudes} and phases "
                f"{self.phases} of {n} distinct harmonics, but expected a duration > 0 and a finite "
                f"amplitude and phase for each."
            )
        freeze(self, int, "harmonics")
        freeze(self, float, "amplitudes", "phases")

    def __call__(self, time: ArrayLike) -> Array:
        x = np.asarray(time, dtype=float) / self.duration
        angles = 2.0 * np.pi * np.multiply.outer(x, self.harmonics) + self.phases
        return (np.sin(angles) @ self.amplitudes) * ((x >= 0) & (x < 1))

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

    def optimized(self) -> Multisine:
        r"""Return it with phases of a low relative peak factor, beginning and ending at zero.

        The range of the signal is the limit of :math:`\|s_+\|_p + \|s_-\|_p`, which is smooth; p
        grows step by step, from Schroeder's phases (Guillaume, Schoukens, Pintelon & Kollar, IEEE
        Trans. Instrum. Meas. 40, 1991). Then time is shifted to a zero.
        """
        power = np.square(self.amplitudes)
        with one_blas_thread():
            phases = _flattest(self.harmonics, np.sqrt(power / power.sum()), _schroeder(power))
        turn = 2.0 * np.pi * np.array(self.harmonics)

        # to the zero crossing of least slope
        signal = _sampled(self.harmonics, self.amplitudes, phases, PEAK_SAMPLES)
        following = np.roll(signal, -1)
        is_crossing = (signal > 0) != (following > 0)
        k = int(np.argmin(np.where(is_crossing, np.abs(following - signal), np.inf)))
        shift = newton(
            lambda shift: np.sin(turn * shift + phases) @ self.amplitudes,
            k / len(signal),
            lambda shift: (turn * np.cos(turn * shift + phases)) @ self.amplitudes,
        )
        return replace(self, phases=np.mod(phases + turn * shift, 2.0 * np.pi).tolist())


def multisine(
    duration: float, harmonics: Sequence[int], *, rms: float, limits: Limits | None = None
) -> Multisine:
    r"""Return a multisine of equal amplitudes with Schroeder's phases, which keep the peaks low.

    With the fractions :math:`p_l` of the power, :math:`\phi_k = -2\pi \sum_{l<k} (k - l) p_l` (IEEE
    Trans. Inf. Theory 16, 1970). `Multisine.optimized` finds better ones. Raises ValueError as of
    `Multisine`, if the rms is not > 0, or a limit is exceeded.

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
    amplitude = check_number("rms", rms) * float(np.sqrt(2.0 / len(harmonics)))
    amplitudes = [amplitude] * len(harmonics)
    phases = _schroeder(np.ones(len(harmonics))).tolist()
    return (limits or UNLIMITED).check(Multisine(duration, harmonics, amplitudes, phases))


def orthogonal_multisines(
    limits: Mapping[str, Limits | float],
    duration: float,
    band: tuple[float, float],
    *,
    n_tones: int | None = None,
) -> dict[str, Multisine]:
    """Return multisines for several axes at once: orthogonal, as large as the limits allow, with low peaks.

    The harmonics of the band are dealt out to the axes in turn, so that each covers the band
    (Morelli, AIAA 2003-5700); the harmonics of an axis are evenly spaced where this covers most of
    the
    band, since peaks are then lower. Phases are as of `Multisine.optimized`: each input begins
    and ends at zero. Raises ValueError if the band is none, has fewer harmonics than tones, or
    there is no axis.

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
    low, high = map(float, band)
    if not (limits and 0 < low < high and 0 < high * duration <= MOST_PERIODS):
        raise ValueError(
            f"Got {len(limits)} axes, {duration:g} s and a band of {low:g} to {high:g} Hz, but "
            f"expected an axis, 0 < lowest < highest and at most {MOST_PERIODS} periods."
        )
    first = int(np.ceil(low * duration - ROUNDING))
    available = np.arange(first, int(np.floor(high * duration + ROUNDING)) + 1)
    n_each = len(available) // len(limits) if n_tones is None else n_tones
    if n_each < 1 or n_each * len(limits) > len(available):
        raise ValueError(
            f"Got {len(limits)} axes with {n_tones or 'at least 1'} tones each, but there are "
            f"{len(available)} harmonics of {1.0 / duration:.3g} Hz between {low:g} and {high:g} Hz: "
            f"fly longer, widen the band or use fewer tones."
        )
    inputs = {}
    for axis, harmonics in zip(limits, _dealt(available, len(limits), n_each), strict=True):
        signal = multisine(duration, harmonics.tolist(), rms=1.0).optimized()
        inputs[axis] = as_limits(limits[axis]).largest(signal)
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
    fractions = power / power.sum()
    order = [np.arange(k, 0, -1) @ fractions[:k] for k in range(len(fractions))]
    return -2.0 * np.pi * np.array(order)


def _flattest(harmonics: Sequence[int], weights: Vector, phases: Vector) -> Vector:
    """Return the phases of a local minimum of the range of a multisine with amplitudes ``weights``."""

    def size(phases: Vector, p: int) -> float:
        """Return the sum of the p-norms of the positive and the negative part."""
        signal = _sampled(harmonics, weights, phases, SEARCH_SAMPLES)
        parts = np.maximum([signal, -signal], 0.0)
        peaks = parts.max(axis=1)
        return float(peaks @ np.mean((parts / peaks[:, None]) ** p, axis=1) ** (1.0 / p))

    for p in POWERS:
        phases = minimize(size, phases, (p,), "L-BFGS-B", options={"maxiter": MOST_STEPS}).x
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
        kinds = (
            ("inputs", Mapping, "{start: signal}"),
            ("limits", Limits, "Limits(amplitude, rate)"),
        )
        for name, kind, expected in kinds:
            for axis, value in getattr(self, name).items():
                if not isinstance(value, kind):
                    raise ValueError(
                        f"Got {value!r} as {name} of the {axis}, but expected {expected}."
                    )
        for axis, start, signal in self.events():
            check_number(f"start of an input of the {axis}", start, is_open=False, unit="s")
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

    Each manoeuvre is a mapping of axes to inputs, which begin together. A ``pause`` [s] before
    each lets the modes decay. Raises ValueError if a manoeuvre has no input, or as of
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
