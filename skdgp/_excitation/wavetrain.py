"""Inputs of several axes in a sequence, as tables that autopilots and simulations fly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._excitation.signals import ROUNDING, UNLIMITED, Limits, Signal
from skdgp._flight.checks import check_names

AXES = ("elevator", "aileron", "rudder", "throttle", "elevon_left", "elevon_right", "propeller_speed", "thrust")
MOST_ROWS = 1_000_000  # largest number of rows of a table: five hours at 50 Hz
SAMPLES_PER_PERIOD = 10
"""Least number of samples in the shortest period of a signal: held for one, it is late by a twentieth of it."""


@dataclass(frozen=True, eq=False)
class Wavetrain:
    """Inputs of several axes, each at its time: for each axis a mapping of start [s] to `Signal`.

    The axes are elevator, aileron, rudder, elevons [rad], throttle, propeller_speed [rad/s] and thrust [N]. Every input
    is checked against ``limits``, `Limits` by axis, and so is every row of `table`. Raises ValueError if an axis is
    unknown, an input has no time or begins before time 0, or a limit is no `Limits` or exceeded.

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
                raise ValueError(f"Got {signals!r} as inputs of the {axis}, but expected {{start: signal}}.")
        for axis, limit in self.limits.items():
            if not isinstance(limit, Limits):
                raise ValueError(f"Got {limit!r} as limits of the {axis}, but expected Limits(amplitude, rate, rms).")
        for axis, start, signal in self.events():
            if not 0 <= start < np.inf:
                raise ValueError(f"Got an input of the {axis} at {start:g} s, but expected a time >= 0.")
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

    def table(self, rate: float, *, trim: Mapping[str, float] | None = None, pause: float = 0.0) -> pd.DataFrame:
        """Return a table of ``time`` [s] and the axes at the rate [Hz] at which an autopilot sets them.

        It ends a ``pause`` [s] after the last input. By default it holds deviations from trim. With the controls of
        trimmed flight, such as ``Trim.controls``, it holds their sums, and controls without inputs: it is then what
        :func:`skdgp.dynamics.simulate` flies. Raises ValueError if the rate is too low for an input, there would be
        more than a million rows, the pause is negative, inputs that overlap exceed a limit of their axis, or ``trim``
        lacks an axis.

        Examples
        --------
        >>> from skdgp.design import Wavetrain, doublet
        >>> Wavetrain({"elevator": {0.0: doublet(0.1, 0.05)}}).table(rate=10.0)
        Traceback (most recent call last):
        ...
        ValueError: Got a rate of 10 Hz, but an input of the elevator has periods of 0.2 s: expected at least 50 Hz, or
        a lower band or longer pulses.
        """
        if not (0 < rate < np.inf and 0 <= pause < np.inf):
            raise ValueError(f"Got rate={rate} Hz and pause={pause} s, but expected a rate > 0 and a pause from 0 on.")
        for axis, _, signal in self.events():
            if not rate * signal.period >= SAMPLES_PER_PERIOD * (1.0 - ROUNDING):
                raise ValueError(
                    f"Got a rate of {rate:g} Hz, but an input of the {axis} has periods of {signal.period:.3g} s: "
                    f"expected at least {SAMPLES_PER_PERIOD / signal.period:.3g} Hz, or a lower band or longer pulses."
                )
        if (length := self.duration + pause) * rate > MOST_ROWS:
            raise ValueError(
                f"Got {length:g} s at {rate:g} Hz, {length * rate:.3g} rows, but expected at most {MOST_ROWS}: at most "
                f"{MOST_ROWS / length:.3g} Hz, or {MOST_ROWS / rate:.3g} s."
            )
        time = np.arange(round(np.ceil(length * rate - ROUNDING)) + 1) / rate
        columns = {axis: self(axis, time) for axis in self.axes}
        for axis, values in columns.items():
            limit = self.limits.get(axis, UNLIMITED)
            peak, speed = np.abs(values).max(), np.abs(np.diff(values, prepend=0.0)).max() * rate
            if peak > limit.amplitude * (1.0 + ROUNDING) or speed > limit.rate * (1.0 + ROUNDING):
                raise ValueError(
                    f"Got inputs of the {axis} that overlap with a peak of {peak:.4g} and a rate of {speed:.4g}, but "
                    f"the limits are {limit.amplitude:g} and {limit.rate:g}: let one begin after the other."
                )
        if trim is not None:
            check_names(columns, trim, "controls of the trim")
            columns = {name: trim[name] + columns.get(name, np.zeros(len(time))) for name in trim}
        return pd.DataFrame({"time": time, **columns})


def wavetrain(
    manoeuvres: Sequence[Mapping[str, Signal]], *, pause: float = 5.0, limits: Mapping[str, Limits] | None = None
) -> Wavetrain:
    """Return manoeuvres one after another, with flight at trim before, between and after them.

    Each manoeuvre is a mapping of axes to inputs, which begin together. Before each is a ``pause`` [s] in which the
    modes decay. Raises ValueError if a manoeuvre has no input, or as of `Wavetrain`, whose ``limits`` are these.

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
            raise ValueError(f"Got {manoeuvre!r} as a manoeuvre, but expected a list of mappings {{axis: signal}}.")
        for axis, signal in manoeuvre.items():
            inputs.setdefault(axis, {})[start] = signal
        start += max(signal.duration for signal in manoeuvre.values()) + pause
    return Wavetrain(inputs, limits or {})
