"""Laws of flight, and how measured signals are judged by them.

By a law the slope of a signal y over another, x, lies within an interval. Signals contradict it if
the slope is outside by 5 standard deviations (4 for the scale of vanes).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from skdgp._flight.channels import ALL_SURFACES, ELEVONS, VANES, by_elevons
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics._regression import Regression, Slope, estimated_slope
from skdgp._flight.physics._signals import PHYSICS, Signals


class Interval(NamedTuple):
    """Admissible slopes, and their text in a finding."""

    least: float
    most: float
    text: str

    @property
    def sign(self) -> float:
        """Sign of the admissible slopes, 0 where slopes of both signs are admissible."""
        return float(np.sign(np.clip(self[:2], -1.0, 1.0).sum()))


EQUAL = Interval(1 / 1.5, 1.5, "1")


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """Signals y and x of a flight, and the admissible slopes of y over x."""

    #: Channels that are compared: one of them is wrong where the law is broken
    channels: tuple[str, ...]
    #: Further channels
    uses: tuple[str, ...]
    y: str
    x: str
    regression: Callable[[Signals], Regression]
    admissible: Interval
    #: Vanes that are used where the flights have them
    beside: tuple[str, ...] = ()
    #: Usual causes of a contradiction
    causes: tuple[str, ...] = ()
    #: The slope that each of further causes gives
    slope_by_cause: Mapping[str, float] = field(default_factory=dict)
    #: Unit of the slope
    unit: str = ""
    #: Error of x [unit of x]: a signal of no larger root mean square decides nothing
    noise: float = 0.0
    #: Whether y and x are equal but for this error, which attenuates the slope
    is_equality: bool = False
    #: Whether x is of accelerometers, whose noise has no bound: engines shake them
    vibrates: bool = False
    #: Lags that are tried, and the first and last that are no contradiction [s]
    lags: tuple[float, ...] = (0.0,)
    usual_lags: tuple[float, float] = (-np.inf, np.inf)
    #: Whether x is a surface, which causes y and may answer to it
    is_cause: bool = False
    #: Angle of the flow that the response depends on, if one
    angle: str | None = None
    #: Least t of a slope and of a lag, and least ratio of explained to unexplained variance, of a contradiction
    least_t: float = PHYSICS.least_t
    least_lag_t: float = PHYSICS.least_t
    least_explained: float = PHYSICS.least_explained
    #: Another law that must be broken, too. Accelerometers ahead of the centre of gravity feel the
    #: yawing by beta, so the sign of ay alone tells nothing.
    witness: Law | None = None

    @property
    def needs(self) -> set[str]:
        """All channels."""
        return {*self.channels, *self.uses}

    def slopes(self, signals: Signals) -> dict[float, Slope]:
        """Return the slopes by lag [s], where the rows determine them; empty of slow rows and missing channels."""
        if signals.rate < PHYSICS.slowest or not self.needs <= signals.channels.keys():
            return {}
        y, x, others = self.regression(signals)
        slopes: dict[float, Slope] = {}
        for lag in self.lags:
            slope = estimated_slope(Regression(y, signals.ahead(x, -lag), others))
            if slope is not None:
                slopes[lag] = slope
        return slopes

    def judge(self, signals: Signals) -> tuple[Contradiction | None, bool]:
        """Return the contradiction of flights that break the law, and whether its slope is surely near 1."""
        slopes = self.slopes(signals)
        best = most_explained(slopes)
        if best is None or best.size <= self.noise or best.n_effective < PHYSICS.least_samples:
            return None, False
        distance_inside = min(best.value - EQUAL.least, EQUAL.most - best.value)
        is_equal = self.is_equality and distance_inside > self.least_t * best.std
        late = self._unusual_lag(slopes, best, is_equal)
        if late is not None:
            return late, False
        least, most, _ = self.admissible
        if is_equal and abs(best.t(least, most)) < self.least_t:
            # errors of x attenuate a slope by the squared correlation at most (Frisch 1934)
            return None, best.value < EQUAL.most * best.correlation**2
        if self.is_equality:  # Fuller 1987, section 1.1
            least *= 1 - (self.noise / best.size) ** 2
        if self.is_cause:
            candidates = self._slopes_of_cause(slopes, best, signals)
        else:
            usual = most_explained(self._of_usual_lags(slopes)) or best
            candidates = [slopes.get(0.0, usual), usual]
        slope = min(candidates, key=lambda slope: abs(slope.t(least, most)))
        t = slope.t(least, most)
        if abs(t) < self.least_t or slope.explained < self.least_explained:
            return None, False
        is_smaller = 0 < slope.value < least
        if self.vibrates and is_smaller and self._is_reverse_equal(signals):
            return None, False
        if self.witness is not None and self.witness.judge(signals)[0] is None:
            return None, False
        return Contradiction(law=self, channels=self.channels, slope=slope, t=t), False

    def _unusual_lag(
        self, slopes: dict[float, Slope], best: Slope, is_equal: bool
    ) -> Contradiction | None:
        """Return the contradiction of a best lag outside of the usual ones, if it is one."""
        best_lag = next(lag for lag, slope in slopes.items() if slope is best)
        is_clear = self.admissible.sign * best.correlation > PHYSICS.clear_correlation
        is_clear |= is_equal
        usual = self._of_usual_lags(slopes)
        if best_lag in usual or not is_clear:
            return None
        t = best.t_over(usual.values())
        if t < self.least_lag_t:
            return None
        # a uniform distribution between the lags that are tried, where they are farthest apart
        std = float(np.diff(sorted(slopes)).max(initial=0.0) / np.sqrt(12))
        lag = (best_lag, std)
        # accelerometers are of the inertial unit, whose clock counts
        vanes = tuple(name for name in self.channels if name in VANES)
        return Contradiction(law=self, channels=vanes or self.channels, slope=best, t=t, lag=lag)

    def _of_usual_lags(self, slopes: dict[float, Slope]) -> dict[float, Slope]:
        """Return the slopes at lags that are no contradiction."""
        first, last = self.usual_lags
        return {lag: slope for lag, slope in slopes.items() if first <= lag <= last}

    def _slopes_of_cause(
        self, slopes: dict[float, Slope], best: Slope, signals: Signals
    ) -> list[Slope]:
        """Return the slopes at lags that explain y as well as the best, by a likelihood ratio.

        Under feedback a late servo turns the sign at lag zero.
        """
        lags = [lag for lag, slope in slopes.items() if best.t_over([slope]) < self.least_t]
        if self.angle is not None and self.angle not in signals:
            lags = [lag for lag in lags if lag < 0] + _lags_before_angle(slopes, best)
        return [slopes[lag] for lag in lags]

    def _is_reverse_equal(self, signals: Signals) -> bool:
        """Return whether x over y has an admissible slope: equal signals, of which x alone is noisy.

        Noise of x attenuates the slope of y over x, not this one (Frisch 1934); a wrong scale
        changes both.
        """
        y, x, others = self.regression(signals)
        reverse = estimated_slope(Regression(x, y, others))
        # guesses
        if reverse is None or reverse.std > 0.5:
            return False
        return abs(reverse.t(*EQUAL[:2])) < 1.5


def most_explained(slopes: dict[float, Slope]) -> Slope | None:
    """Return the slope at the lag that explains y best, None if there are none."""
    return max(slopes.values(), key=lambda slope: slope.explained, default=None)


def _lags_before_angle(slopes: dict[float, Slope], best: Slope) -> list[float]:
    """Return the lags from zero to the first that explains y.

    Later, an angle that was not measured answers to the surface, with the other sign. Before zero, the
    surface answers to the response, with the sign of an autopilot.
    """
    fraction = 1 / 8
    lags = [lag for lag in sorted(slopes) if lag >= 0]
    first = next((lag for lag in lags if slopes[lag].explained >= fraction * best.explained), 0.0)
    # of the ratio of total to unexplained variance
    least = fraction * (1 + best.explained)
    return [lag for lag in lags if lag <= first and 1 + slopes[lag].explained >= least]


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A law that flights break, and the numbers."""

    law: Law
    #: Channels that may be wrong
    channels: tuple[str, ...]
    slope: Slope
    #: Distance from the admissible values, in standard deviations
    t: float
    #: Lag that breaks the law, in place of the slope [s], and its standard deviation
    lag: tuple[float, float] | None = None

    @property
    def finding(self) -> Finding:
        """The finding of the compared signals, y over x, and the numbers."""
        quantity, (value, std) = "slope", self.slope[:2]
        later, earlier = self.law.y, self.law.x
        if self.lag is not None:
            quantity, (value, std) = "lag", self.lag
            if value < 0:
                value = -value
                later, earlier = earlier, later
        causes = [*self.law.causes]
        for cause, slope in self.law.slope_by_cause.items():
            if np.isclose(self.slope.value, slope, rtol=0.05, atol=2 * self.slope.std):
                causes.append(cause)
        expected = self.law.admissible.text
        unit = self.law.unit
        is_opposite = self.law.admissible.sign * value < 0
        is_turned = bool(self.lag is None and is_opposite and self.slope.explained > 1)
        return Finding(
            Code.CONTRADICTION,
            channels=list(self.channels),
            y=later,
            x=earlier,
            expected=f"{expected} [{unit}]" if unit else expected,
            **{quantity: value},
            std=std,
            t=self.t,
            correlation=self.slope.correlation,
            effective_samples=self.slope.n_effective,
            causes=causes,
            is_turned=is_turned,
            is_surface=is_turned and not {*ALL_SURFACES}.isdisjoint(self.channels),
        )


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """A mistake that several contradictions may follow from, as channels hide each other."""

    #: Channels that have the other sign
    turned: tuple[str, ...] = ()
    #: Pairs of channels that stand for each other
    exchanged: tuple[tuple[str, str], ...] = ()
    #: Channels that are late, and by how much [s]
    late: tuple[str, ...] = ()
    lag: float = 0.0
    #: Axes of the channels, empty if they are not known
    axes: str = ""
    #: Whether the heading counts from east
    from_east: bool = False
    #: Laws that show the mistake of channels that stand for each other
    laws: tuple[Law, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """All channels."""
        return (*self.turned, *sum(self.exchanged, ()), *self.late)

    def of(self, signals: Signals) -> Mistake:
        """Return the mistake of the channels that the signals have."""
        turned = tuple(name for name in self.turned if name in signals)
        late = tuple(name for name in self.late if name in signals)
        exchanged = tuple(pair for pair in self.exchanged if {*pair} <= signals.channels.keys())
        return replace(self, turned=turned, exchanged=exchanged, late=late)

    def undone(self, signals: Signals) -> Signals:
        """Return the signals without the mistake."""
        channels = dict(signals.channels)
        for first, second in self.exchanged:
            channels[first], channels[second] = channels[second], channels[first]
        for name in self.turned:
            channels[name] = -channels[name]
        for name in self.late:
            channels[name] = signals.ahead(channels[name], self.lag)
        if {*ELEVONS} & {*self.turned} and {*ELEVONS} <= channels.keys():
            channels |= by_elevons(channels)
        if self.from_east and "psi" in channels:
            channels["psi"] = np.pi / 2 + channels["psi"]
        return replace(signals, channels=channels)

    def is_shown(self, signals: Signals) -> bool:
        """Return whether without the mistake each of its laws explains its response better."""
        if not {*self.channels} <= signals.channels.keys():
            return False
        undone = self.undone(signals)
        return all(_is_clearer(law.slopes(undone), law.slopes(signals)) for law in self.laws)

    @property
    def finding(self) -> Finding:
        """The finding of the channels."""
        return Finding(
            Code.CHANNELS_TOGETHER,
            channels=list(self.channels),
            turned=list(self.turned) or None,
            exchanged=[" and ".join(pair) for pair in self.exchanged] or None,
            late=list(self.late) or None,
            lag=self.lag,
            is_frame=not {*self.turned} <= {*ELEVONS},
            axes=self.axes,
            from_east=self.from_east,
        )


def _is_clearer(slopes: dict[float, Slope], others: dict[float, Slope]) -> bool:
    """Return whether the best of some slopes surely explains more than the best of others."""
    best = most_explained(slopes)
    if best is None or best.explained <= PHYSICS.least_explained:
        return False
    return best.t_over(others.values()) >= PHYSICS.least_t


def stuck_surface(name: str, law: Law, signals: Signals) -> Finding | None:
    """Return the finding of a surface that stands still for 0.5 s while the response to it, by a law, goes on.

    The response in these rows differs from what explains it where the surface moves. Without vanes
    the angles that they measure would explain it. The ratio of the residuals is 1.1 at most in 30 sound
    flights, 2.1 to 7 where a surface is stuck, and 1.7 to 2.5 where it is clipped.
    """
    slopes = law.slopes(signals)
    if not slopes or not {name, *law.beside} <= signals.channels.keys():
        return None
    lag = max(slopes, key=lambda lag: slopes[lag].explained)
    y, x, others = law.regression(signals)
    terms = np.column_stack([*others, signals.ahead(x, -lag)])
    is_whole = np.isfinite(terms).all(axis=1) & np.isfinite(y)
    is_still = np.abs(signals.change(signals[name], 0.5)) < 1e-9
    still = is_whole & is_still
    moving = is_whole & ~is_still
    if min(still.sum(), moving.sum()) < PHYSICS.least_rows:
        return None
    # effects that hardly vary while the surface moves are not known from these rows: their spread is 2.4 times as
    # large in the others where a surface is stuck, 20 and more where surfaces move one after another
    if (terms[still].std(axis=0) > 5 * terms[moving].std(axis=0)).any():
        return None
    by_moving = np.linalg.lstsq(terms[moving], y[moving])[0]
    squared = (y - terms @ by_moving) ** 2
    variance = squared[moving].mean()
    ratio = float(np.sqrt(squared[still].mean() / variance))
    by_still = np.linalg.lstsq(terms[still], y[still])[0]
    # what other terms explain by themselves lacks no surface: 0.04 in a sound flight whose rudder moves in 5 % of the
    # rows, 0.6 and more where a surface is stuck
    lacking = np.var(y[still] - terms[still] @ by_still)
    if ratio < 2 or lacking < variance / 2:
        return None
    percent = 100 * float(is_still[is_whole].mean())
    return Finding(Code.STUCK_SURFACE, channels=[name], y=law.y, percent=percent, ratio=ratio)
