"""Inputs that excite an aircraft, as functions of time: steps, multisines, and sequences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.fft import irfft
from scipy.optimize import newton

from skdgp._compute.typing import Array, Vector
from skdgp._flight.tables import check_names, check_number, check_numbers

# Relative excess over a limit that is rounding
ROUNDING = 1e-9
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


@dataclass(frozen=True)
class Steps:
    """Levels, deviations from trim, that are held one after another for ``durations`` [s], as `doublet` makes them.

    Called with the time since their start, they return the deviation, zero before it and after it.

    Raises ValueError if there is no level, or a duration is not > 0.

    Examples
    --------
    >>> from skdgp.design import Steps
    >>> Steps([1.0, 2.0], [0.1, -0.1])([0.5, 1.0, 2.0, 4.0])
    array([ 0.1, -0.1, -0.1,  0. ])
    """

    durations: Sequence[float]
    levels: Sequence[float]
    #: A sample this little before a step counts as after it [s]: clocks are rounded
    edge: ClassVar[float] = 1e-5

    def __post_init__(self) -> None:
        durations = [check_number("duration", duration, unit="s") for duration in self.durations]
        if not durations:
            raise ValueError("Got no durations of steps, but expected one for each level.")
        levels = check_numbers("levels", self.levels, len(durations))
        object.__setattr__(self, "durations", tuple(durations))
        object.__setattr__(self, "levels", tuple(levels.tolist()))

    def __call__(self, time: ArrayLike) -> Array:
        held = np.array([0.0, *self.levels, 0.0])
        since = np.asarray(time, dtype=float) + self.edge
        return held[np.searchsorted(self.edges, since, side="right")]

    @property
    def edges(self) -> Vector:
        """When each level begins, and when the last one ends [s]."""
        return np.cumsum([0.0, *self.durations])

    @property
    def duration(self) -> float:
        """How long it lasts [s]."""
        return float(self.edges[-1])

    @property
    def peak(self) -> float:
        """Largest deviation, to either side."""
        return float(np.abs(self.levels).max())

    @property
    def period(self) -> float:
        """Shortest period, of a pulse and the one after it [s]."""
        return 2.0 * min(self.durations)

    def scaled(self, factor: float) -> Self:
        """Return it multiplied by a factor."""
        return replace(self, levels=[factor * level for level in self.levels])


def doublet(width: float, amplitude: float) -> Steps:
    """Return a doublet: a pulse up and one down, each ``width`` seconds long; down first if the amplitude is < 0.

    Its spectrum peaks at 2.33 / width [rad/s].

    Examples
    --------
    >>> from skdgp.design import doublet
    >>> doublet(0.5, 0.1)([0.0, 0.25, 0.75, 1.0])
    array([ 0.1,  0.1, -0.1,  0. ])
    """
    return Steps([width, width], [amplitude, -amplitude])


def three_two_one_one(width: float, amplitude: float) -> Steps:
    """Return a 3-2-1-1: pulses up, down, up, down of 3, 2, 1 and 1 times ``width`` seconds.

    It excites a wider band than a doublet (Jategaonkar, Flight Vehicle System Identification, 2nd
    edition, 2015, section 2.3). Its mean is not zero.

    Examples
    --------
    >>> from skdgp.design import three_two_one_one
    >>> three_two_one_one(0.5, 0.1).duration
    3.5
    """
    levels = [amplitude, -amplitude, amplitude, -amplitude]
    return Steps([3 * width, 2 * width, width, width], levels)


@dataclass(frozen=True)
class Multisine:
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
    >>> print(f"{signal.peak / signal.rms:.1f}")
    1.9
    """

    duration: float
    harmonics: Sequence[int]
    amplitudes: Sequence[float]
    phases: Sequence[float]
    #: Largest number of periods: 100 s at 50 Hz
    most_periods: ClassVar[int] = 5000
    #: Samples per period of the highest harmonic, for the peak
    samples_per_period: ClassVar[int] = 200

    def __post_init__(self) -> None:
        check_number("duration", self.duration, unit="s")
        orders = np.asarray(self.harmonics)
        n = len(orders)
        is_whole = orders.dtype.kind in "iu" and len({*orders.tolist()}) == n
        if not (n and is_whole and 0 < orders.min() <= orders.max() <= self.most_periods):
            raise ValueError(
                f"Got harmonics {orders.tolist()}, but expected distinct integers from 1 to {self.most_periods}."
            )
        object.__setattr__(self, "harmonics", tuple(map(int, orders)))
        for name in ("amplitudes", "phases"):
            numbers = check_numbers(name, getattr(self, name), n)
            object.__setattr__(self, name, tuple(numbers.tolist()))

    def __call__(self, time: ArrayLike) -> Array:
        x = np.asarray(time, dtype=float) / self.duration
        return self._periodic(x) * ((x >= 0) & (x < 1))

    def _periodic(self, x: Any) -> Any:
        """Return the deviation at times in units of the period, without end."""
        angles = 2.0 * np.pi * np.multiply.outer(x, self.harmonics) + self.phases
        return np.sin(angles) @ self.amplitudes

    @property
    def rms(self) -> float:
        """Root mean square over the period."""
        return float(np.linalg.norm(self.amplitudes) / np.sqrt(2.0))

    @property
    def peak(self) -> float:
        """Bound of the deviation, to either side."""
        # The largest sample, and how far a curve can rise between two, step^2 / 8 |s''|
        signal = self._sampled()
        step = 2.0 * np.pi * np.array(self.harmonics) / len(signal)
        rise = step**2 @ np.abs(self.amplitudes) / 8.0
        return float(np.abs(signal).max() + rise)

    @property
    def period(self) -> float:
        """Shortest period of a sine [s]."""
        return self.duration / max(self.harmonics)

    def scaled(self, factor: float) -> Self:
        """Return it multiplied by a factor."""
        return replace(self, amplitudes=[factor * amplitude for amplitude in self.amplitudes])

    def from_zero(self) -> Self:
        """Return it shifted in time to its zero of least slope, so that it begins and ends at zero."""
        signal = self._sampled()
        n = len(signal)
        following = np.roll(signal, -1)
        is_crossing = (signal > 0) != (following > 0)
        rise = np.where(is_crossing, np.abs(following - signal), np.inf)
        before = int(np.argmin(rise))
        zero = newton(self._periodic, before / n, x1=(before + 1) / n)
        phases = self.phases + 2.0 * np.pi * zero * np.array(self.harmonics)
        return replace(self, phases=np.mod(phases, 2.0 * np.pi).tolist())

    def _sampled(self) -> Vector:
        """Return it over one period."""
        n = self.samples_per_period * max(self.harmonics)
        spectrum = np.zeros(n // 2 + 1, dtype=complex)
        waves = np.multiply(self.amplitudes, np.exp(1j * np.asarray(self.phases)))
        spectrum[[*self.harmonics]] = -0.5j * n * waves
        return irfft(spectrum, n)


def multisine(duration: float, harmonics: Sequence[int], *, rms: float) -> Multisine:
    r"""Return a multisine of equal amplitudes with Schroeder's phases, which keep the peaks low.

    They are :math:`\phi_k = -\pi k (k + 1) / n`, k from 0 to n - 1 (IEEE Trans. Inf. Theory 16, 1970).
    Raises ValueError as of `Multisine`, or if the rms is not > 0.

    Parameters
    ----------
    duration : float
        T [s], the period.
    harmonics : sequence of int
        Its frequencies are these over T.
    rms : float
        Root mean square.

    Returns
    -------
    Multisine

    Examples
    --------
    >>> from skdgp.design import multisine
    >>> round(multisine(10.0, [2, 3, 5], rms=0.02).rms, 6)
    0.02
    """
    n = len(harmonics)
    amplitude = check_number("rms", rms) * float(np.sqrt(2.0 / n))
    order = np.arange(n)
    phases = -np.pi * order * (order + 1) / n
    return Multisine(duration, harmonics, [amplitude] * n, phases.tolist())


def orthogonal_multisines(
    limits: Mapping[str, float],
    duration: float,
    band: tuple[float, float],
    *,
    n_tones: int | None = None,
) -> dict[str, Multisine]:
    """Return multisines for several axes at once: orthogonal, and as large as the limits allow.

    The harmonics of the band are dealt out to the m axes in turn, n to each, so that each covers the
    band (Morelli, AIAA 2003-5700). Those of an axis are evenly spaced, since peaks are then lower.
    Phases are as of `multisine`, and each input begins and ends at zero. Raises ValueError if the
    band is none, has fewer harmonics than tones, or there is no axis.

    Parameters
    ----------
    limits : mapping of str to float
        Largest deviation of each axis [rad, or 1 of the throttle].
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
    >>> limits = {"aileron": 0.1, "rudder": 0.2}
    >>> inputs = orthogonal_multisines(limits, 20.0, (0.2, 1.5), n_tones=6)
    >>> inputs["aileron"].harmonics, inputs["rudder"].harmonics
    ((4, 8, 12, 16, 20, 24), (6, 10, 14, 18, 22, 26))
    """
    low, high = map(float, band)
    most = Multisine.most_periods
    if not (0 < low < high and 0 < high * duration <= most):
        raise ValueError(
            f"Got {duration} s and a band {band} Hz, but expected 0 < lowest < highest and at most {most} periods."
        )
    first = int(np.ceil(low * duration - ROUNDING))
    available = np.arange(first, int(high * duration + ROUNDING) + 1)
    n_axes = len(limits)
    n_each = len(available) // max(n_axes, 1) if n_tones is None else n_tones
    if not 0 < n_each * n_axes <= len(available):
        raise ValueError(
            f"Got {n_axes} axes with {n_each} tones each, but there are {len(available)} harmonics in the band "
            f"{band} Hz: give an axis, fly longer, widen the band or use fewer tones."
        )
    # d, as wide as d (n - 1) + d // m (m - 1) fits into the band
    spacing = n_axes * (len(available) - 1) // max(n_axes * n_each - 1, 1) or 1
    offset = spacing // n_axes
    inputs = {}
    for number, axis in enumerate(limits):
        harmonics = available[number * offset :: spacing][:n_each]
        limit = check_number(f"limit of the {axis}", limits[axis])
        signal = multisine(duration, harmonics.tolist(), rms=1.0).from_zero()
        inputs[axis] = signal.scaled(limit / signal.peak)
    return inputs


Signal: TypeAlias = Steps | Multisine


@dataclass(frozen=True, eq=False)
class Wavetrain:
    """Inputs of several axes, each at its time: for each axis a mapping of start [s] to `Signal`.

    The axes are elevator, aileron, rudder, elevons [rad], throttle, propeller_speed [rad/s] and
    thrust [N]. Every input is checked against ``limits``, the largest deviations by axis, and so is
    every row of `table`. Raises ValueError if an axis is unknown, an input has no time or begins
    before time 0, or a limit is not > 0 or exceeded.

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
    limits: Mapping[str, float] = field(default_factory=dict)
    #: Samples in the shortest period: a signal held for one is late by a twentieth of the period
    samples_per_period: ClassVar[int] = 10

    def __post_init__(self) -> None:
        check_names([*self.inputs, *self.limits], AXES, "axes")
        for axis, limit in self.limits.items():
            check_number(f"limit of the {axis}", limit)
        for axis, signals in self.inputs.items():
            if not isinstance(signals, Mapping):
                raise ValueError(
                    f"Got {signals!r} as inputs of the {axis}, but expected {{start: signal}}."
                )
            for start, signal in signals.items():
                check_number(f"start of an input of the {axis}", start, is_open=False, unit="s")
                self._check_peak(f"an input of the {axis}", axis, signal.peak)

    def _check_peak(self, what: str, axis: str, peak: float) -> None:
        """Raise ValueError if a peak exceeds the limit of its axis."""
        limit = self.limits.get(axis, np.inf)
        if peak > limit * (1.0 + ROUNDING):
            raise ValueError(
                f"Got {what} with a peak of {peak:.4g}, but the limit is {limit:g}: make it "
                f"smaller, let one input begin after the other, or raise the limit."
            )

    def __call__(self, axis: str, time: ArrayLike) -> Array:
        """Return the deviation of an axis from trim at times [s]; zero of an axis without inputs."""
        time = np.asarray(time, dtype=float)
        total = np.zeros(time.shape)
        for start, signal in self.inputs.get(axis, {}).items():
            total += signal(time - start)
        return total

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
        the rate is too low for an input, the pause is negative, inputs that overlap exceed a limit of
        their axis, or ``trim`` lacks an axis.

        Examples
        --------
        >>> from skdgp.design import Wavetrain, doublet
        >>> Wavetrain({"elevator": {0.0: doublet(0.1, 0.05)}}).table(rate=10.0)
        Traceback (most recent call last):
        ...
        ValueError: Got a rate of 10 Hz, but an input of the elevator has periods of 0.2 s: expected
        at least 50 Hz, or a lower band or longer pulses.
        """
        self._check_rate(rate, pause)
        n_steps = int(np.ceil((self.duration + pause) * rate - ROUNDING))
        table = pd.DataFrame({"time": np.arange(n_steps + 1) / rate})
        for axis in self.inputs:
            table[axis] = self(axis, table["time"])
            self._check_peak(f"overlapping inputs of the {axis}", axis, table[axis].abs().max())
        if trim is None:
            return table
        check_names(self.inputs, trim, "controls of the trim")
        controls = table.reindex(columns=[*trim], fill_value=0.0) + pd.Series(trim)
        return table[["time"]].join(controls)

    def _check_rate(self, rate: float, pause: float) -> None:
        """Raise ValueError if the rate [Hz] is too low for an input, or the pause [s] is none."""
        check_number("rate", rate, unit="Hz")
        check_number("pause", pause, is_open=False, unit="s")
        for axis, _, signal in self.events():
            lowest = self.samples_per_period / signal.period
            if rate < lowest * (1.0 - ROUNDING):
                raise ValueError(
                    f"Got a rate of {rate:g} Hz, but an input of the {axis} has periods of "
                    f"{signal.period:.3g} s: expected at least {lowest:.3g} Hz, or a lower band or "
                    f"longer pulses."
                )


def wavetrain(
    manoeuvres: Sequence[Mapping[str, Signal]],
    *,
    pause: float = 5.0,
    limits: Mapping[str, float] | None = None,
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
                f"Got {manoeuvre!r} as a manoeuvre, but expected mappings {{axis: signal}}."
            )
        for axis, signal in manoeuvre.items():
            inputs.setdefault(axis, {})[start] = signal
        start += max(signal.duration for signal in manoeuvre.values()) + pause
    return Wavetrain(inputs, limits or {})
