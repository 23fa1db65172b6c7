"""The three kinds of checks: equality, sign and exchange, and how the slopes of each are judged.

A slope contradicts a relation if it is outside of the admissible interval by 5 standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from skdgp._flight.channels import ELEVONS, by_elevons
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics._regression import Regression, Slope, estimated_slope
from skdgp._flight.physics._signals import PHYSICS, Signals


class Interval(NamedTuple):
    """Admissible slopes, and their text in a finding."""

    least: float
    most: float
    text: str


EQUAL = Interval(1 / 1.5, 1.5, "1")
# of gyros, velocities, north, east, down and the lateral force: 0.94 to 1.06 in 230 sound flights, but 0.89 in a
# simulator whose clock is slow
SAME = Interval(1 / 1.15, 1.15, "1")
# gusts move the air past the aircraft, which follows them
GUSTY = Interval(-0.5, 1.5, "0 to 1")
# of a calibrated pitot tube: 0.988 to 1.000 in 66 sound flights, on which it was set; indicated airspeed at 2000 m
# has 1.1
CALIBRATED = Interval(0.97, 1.03, "0.97 to 1.03")
# of the sine of the angle from heading to course through the air; a sideslip that stays is smaller
AHEAD = Interval(-0.15, 0.15, "-0.15 to 0.15")
# of the angle of attack less that by the ground velocity; mean updrafts are smaller parts of V (guess)
LEVEL = Interval(-0.05, 0.05, "-0.05 to 0.05")
# of vanes where gusts, which attenuate the slope, are small: 0.85 to 1.07 in 230 sound flights
SMOOTH = Interval(0.75, 1.1, "0.75 to 1.1")
# of the later less the earlier airspeed, over the airspeed: 0.03 at most in 122 sound flights
STEADY = Interval(-0.2, 0.2, "-0.2 to 0.2")
POSITIVE = Interval(0.0, np.inf, "a positive one")
NEGATIVE = Interval(-np.inf, 0.0, "a negative one")
NONE = Interval(0.0, 0.0, "0")
# of signals of different origin
UNALIKE = Interval(0.0, 0.0, "signals that differ")


@dataclass(frozen=True, kw_only=True)
class Relation:
    """Signals y and x of a flight, and the channels that they are computed from."""

    #: Channels that are compared: one of them is wrong where the relation fails
    channels: tuple[str, ...]
    #: Further channels
    uses: tuple[str, ...]
    y: str
    x: str
    regression: Callable[[Signals], Regression]
    #: Vanes that are used where the flights have them
    beside: tuple[str, ...] = ()
    #: Lags that are tried [s]
    lags: tuple[float, ...] = (0.0,)
    #: Usual causes of a contradiction
    causes: tuple[str, ...] = ()
    #: Unit of the slope
    unit: str = ""

    @property
    def needs(self) -> set[str]:
        """All channels."""
        return {*self.channels, *self.uses}

    def slopes(self, signals: Signals) -> dict[float, Slope]:
        """Return the slopes by lag [s], where the rows determine them; empty where a channel is missing."""
        if not self.needs <= signals.channels.keys():
            return {}
        y, x, others = self.regression(signals)
        slopes: dict[float, Slope] = {}
        for lag in self.lags:
            regression = Regression(y, signals.ahead(x, -lag), others)
            slope = estimated_slope(regression)
            if slope is not None:
                slopes[lag] = slope
        return slopes


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """A relation that flights contradict, and the numbers."""

    relation: Relation
    #: Channels that may be wrong
    channels: tuple[str, ...]
    admissible: Interval
    slope: Slope
    #: Distance from the admissible values, in standard deviations
    t: float
    #: Lag that contradicts the relation, in place of the slope [s], and its standard deviation
    lag: tuple[float, float] | None = None
    #: None for all flights together
    flight: Any = None

    @property
    def finding(self) -> Finding:
        """The finding of the compared signals, y over x, and the numbers."""
        quantity, (value, std) = "slope", self.slope[:2]
        if self.lag is not None:
            quantity, (value, std) = "lag", self.lag
        unit = self.relation.unit
        sign = np.sign(self.admissible.least + self.admissible.most)
        explains_most = self.slope.explained > 1
        numbers = {
            "channels": list(self.channels),
            "y": self.relation.y,
            "x": self.relation.x,
            "expected": f"{self.admissible.text} [{unit}]" if unit else self.admissible.text,
            quantity: value,
            "std": std,
            "t": self.t,
            "correlation": self.slope.correlation,
            "effective_samples": self.slope.n_effective,
            "causes": list(self.relation.causes),
            "is_turned": bool(self.lag is None and sign * value < 0 and explains_most),
        }
        return Finding(Code.CONTRADICTION, self.flight, numbers=numbers)


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
    #: None for all flights together
    flight: Any = None

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
        for first, second in self.exchanged:
            signals = signals.exchanged(first, second)
        channels = signals.channels | {name: -signals[name] for name in self.turned}
        channels |= {name: signals.ahead(signals[name], self.lag) for name in self.late}
        if {*ELEVONS} <= channels.keys() and not {*ELEVONS}.isdisjoint(self.turned):
            channels |= by_elevons(channels)
        if self.from_east and "psi" in channels:
            channels["psi"] = np.pi / 2 + channels["psi"]
        return replace(signals, channels=channels)

    @property
    def finding(self) -> Finding:
        """The finding of the channels."""
        numbers = {
            "channels": list(self.channels),
            "turned": list(self.turned) or None,
            "exchanged": [" and ".join(pair) for pair in self.exchanged] or None,
            "late": list(self.late) or None,
            "lag": self.lag,
            "is_late": bool(self.late),
            "is_frame": not {*self.turned} <= {*ELEVONS},
            "axes": self.axes,
            "from_east": self.from_east,
        }
        return Finding(Code.CHANNELS_TOGETHER, self.flight, numbers=numbers)


@dataclass(frozen=True, kw_only=True)
class WrongClock:
    """Times that are too long or too short by a factor."""

    #: True seconds per second of the clock
    factor: float
    #: Rate of the rows by the clock [Hz]
    rate: float
    #: None for all flights together
    flight: Any = None

    def undone(self, signals: Signals) -> Signals:
        """Return the signals by the true time."""
        return replace(signals, step=self.factor * signals.step)

    @property
    def finding(self) -> Finding:
        """The finding of the time."""
        rates = {"rate": self.rate, "true_rate": self.rate / self.factor}
        return Finding(Code.WRONG_CLOCK, self.flight, numbers=rates)


@dataclass(frozen=True, kw_only=True)
class Equality:
    """Kinematics make y and x equal: the slope is 1, at a lag of no more than usual."""

    relation: Relation
    #: Error of x [unit of x]: a signal of no larger root mean square decides nothing
    noise: float
    #: Whether x is of accelerometers, whose noise has no bound: engines shake them
    vibrates: bool = False
    #: Admissible slopes
    admissible: Interval = EQUAL
    #: Longest lag that is no contradiction [s], and the least t of one
    usual_lag: float = PHYSICS.usual_lag
    least_t: float = PHYSICS.least_t

    def judge(self, signals: Signals) -> Contradiction | Relation | None:
        """Return the contradiction of flights, or the relation that they confirm, None if they decide nothing."""
        slopes = self.relation.slopes(signals)
        best = _best(slopes, self.noise)
        if best is None or 0.0 not in slopes:
            return None
        distance_inside = min(best.value - EQUAL.least, EQUAL.most - best.value)
        is_equal = distance_inside > PHYSICS.least_t * best.std
        usual = (-self.usual_lag, self.usual_lag)
        late = _of_unusual_lag(self.relation, self.admissible, slopes, usual, self.least_t)
        if late is not None and (is_equal or best.correlation > PHYSICS.lagged_correlation):
            return late
        if is_equal and abs(best.t(*self.admissible[:2])) < PHYSICS.least_t:
            return self.relation
        return self._of_wrong_scale(slopes[0.0], best.size, signals)

    def _of_wrong_scale(self, slope: Slope, size: float, signals: Signals) -> Contradiction | None:
        """Return the contradiction of a slope at lag zero, for x of root mean square ``size``, if it is one."""
        # the error of x attenuates the slope (Fuller 1987, section 1.1)
        least = self.admissible.least * (1 - (self.noise / size) ** 2)
        t = slope.t(least, self.admissible.most)
        if abs(t) < PHYSICS.least_t:
            return None
        is_attenuated = self.vibrates and 0 < slope.value < least
        if is_attenuated and self._is_reverse_equal(signals):
            return None
        return _of_slope(self.relation, self.admissible, slope, t)

    def _is_reverse_equal(self, signals: Signals) -> bool:
        """Return whether x over y has an admissible slope: equal signals, of which x alone is noisy.

        Noise of x attenuates the slope of y over x, not this one (Frisch 1934); a wrong scale
        changes both.
        """
        y, x, others = self.relation.regression(signals)
        reverse = estimated_slope(Regression(x, y, others))
        if reverse is None or reverse.std > PHYSICS.reverse_std:
            return False
        return abs(reverse.t(EQUAL.least, EQUAL.most)) < PHYSICS.reverse_t


@dataclass(frozen=True, kw_only=True)
class Sign:
    """The slope has a sign by aerodynamics, or is zero between signals of different origin."""

    relation: Relation
    admissible: Interval
    #: As of `Equality`
    noise: float = 0.0
    #: Angle of the flow that the response depends on, if one
    angle: str | None = None
    #: Whether x causes y, which then is not earlier
    is_cause: bool = False
    #: Least ratio of explained to unexplained variance of a contradiction
    least_explained: float = 0.0
    least_t: float = PHYSICS.least_t
    #: Another sign that must be wrong, too. Accelerometers ahead of the centre of gravity feel the
    #: yawing by beta, so the sign of ay alone tells nothing.
    witness: Sign | None = None

    def judge(self, signals: Signals) -> Contradiction | None:
        """Return the contradiction of a wrong sign, if it is one."""
        slopes = self.relation.slopes(signals)
        best = _best(slopes, self.noise)
        if best is None:
            return None
        if self.is_cause and self._has_right_sign(best):
            usual = (-PHYSICS.usual_lead, np.inf)
            late = _of_unusual_lag(
                self.relation, self.admissible, slopes, usual, PHYSICS.least_lead_t
            )
            if late is not None:
                return late
        slope = self._judged_slope(slopes, signals)
        t = slope.t(self.admissible.least, self.admissible.most)
        if _is_weak(slope, t, self.least_t) or slope.explained < self.least_explained:
            return None
        if self.witness is not None and self.witness.judge(signals) is None:
            return None
        return _of_slope(self.relation, self.admissible, slope, t)

    def _has_right_sign(self, slope: Slope) -> bool:
        """Return whether a slope is admissible and strong."""
        is_admissible = slope.t(self.admissible.least, self.admissible.most) == 0
        return is_admissible and abs(slope.correlation) > PHYSICS.lagged_correlation

    def _judged_slope(self, slopes: dict[float, Slope], signals: Signals) -> Slope:
        """Return the slope nearest to its expected sign, of the lags that explain y about as well as the best.

        Under feedback a late servo turns the sign at lag zero.
        """
        best = max(slope.explained for slope in slopes.values())
        enough = PHYSICS.possible_lag * best
        lags = [lag for lag, slope in slopes.items() if slope.explained >= enough]
        if self.angle is not None and self.angle not in signals:
            lags = [lag for lag in lags if lag < 0] + _lags_before_angle(slopes, best)
        least, most, _ = self.admissible
        return min((slopes[lag] for lag in lags), key=lambda slope: abs(slope.t(least, most)))


def _lags_before_angle(slopes: dict[float, Slope], best: float) -> list[float]:
    """Return the lags from zero to the first that explains y, if the best lag explains ``best``.

    Later, an angle that was not measured answers to the surface, with the other sign. Before zero, the
    surface answers to the response, with the sign of an autopilot.
    """
    fraction = PHYSICS.possible_lag_without_angle
    lags = [lag for lag in sorted(slopes) if lag >= 0]
    first = next((lag for lag in lags if slopes[lag].explained >= fraction * best), 0.0)
    # of the ratio of total to unexplained variance
    least = fraction * (1 + best)
    return [lag for lag in lags if lag <= first and 1 + slopes[lag].explained >= least]


@dataclass(frozen=True, kw_only=True)
class Stuck:
    """A surface that stands still while the response to it goes on."""

    channels: tuple[str, ...]
    #: The response
    y: str
    #: Rows without motion [%], and the residual of the response in them over that in the others
    percent: float
    ratio: float
    #: None for all flights together
    flight: Any = None

    @property
    def finding(self) -> Finding:
        """The finding of the surface."""
        numbers = {
            "channels": list(self.channels),
            "y": self.y,
            "percent": self.percent,
            "ratio": self.ratio,
        }
        return Finding(Code.STUCK_SURFACE, self.flight, numbers=numbers)


class StuckCheck(NamedTuple):
    """Where a surface stands still, the regression of the other rows explains the response as well.

    Without vanes the angles that they measure would explain it.
    """

    name: str
    relation: Relation

    def judge(self, signals: Signals) -> Stuck | None:
        """Return the surface if it is probably stuck."""
        slopes = self.relation.slopes(signals)
        if not slopes or not {self.name, *self.relation.beside} <= signals.channels.keys():
            return None
        moves = np.abs(np.diff(signals[self.name], prepend=np.nan)) > PHYSICS.still
        n_moves = signals.change(np.cumsum(moves, dtype=float), PHYSICS.still_window)
        lag = max(slopes, key=lambda lag: slopes[lag].explained)
        y, x, others = self.relation.regression(signals)
        terms = np.column_stack([*others, signals.ahead(x, -lag), y])
        is_whole = np.isfinite(terms).all(axis=1)
        size = np.sqrt(np.mean(terms[is_whole] ** 2, axis=0))
        terms = terms[is_whole] / np.where(size > 0, size, 1.0)
        is_still = n_moves[is_whole] == 0
        if min(is_still.sum(), (~is_still).sum()) < PHYSICS.least_rows:
            return None
        # effects that hardly vary while the surface moves are not known from these rows
        spreads = [terms[rows, :-1].std(axis=0) for rows in (is_still, ~is_still)]
        if (spreads[0] > PHYSICS.still_spread * spreads[1]).any():
            return None
        coefficients = np.linalg.lstsq(terms[~is_still, :-1], terms[~is_still, -1], rcond=1e-8)[0]
        squared = (terms[:, -1] - terms[:, :-1] @ coefficients) ** 2
        ratio = float(np.sqrt(squared[is_still].mean() / squared[~is_still].mean()))
        if ratio < PHYSICS.still_ratio:
            return None
        percent = 100 * float(is_still.mean())
        return Stuck(channels=(self.name,), y=self.relation.y, percent=percent, ratio=ratio)


class Exchange(NamedTuple):
    """A mistake of channels that stand for each other: without it, each relation explains its response better."""

    mistake: Mistake
    relations: tuple[Relation, ...]

    def judge(self, signals: Signals) -> Mistake | None:
        """Return the mistake, if all relations show it."""
        if not {*self.mistake.channels} <= signals.channels.keys():
            return None
        undone = self.mistake.undone(signals)
        for relation in self.relations:
            slopes = relation.slopes(undone)
            if not slopes:
                return None
            best = _most_explained(slopes)
            t = best.t(NONE.least, NONE.most)
            others = [slope.explained for slope in relation.slopes(signals).values()]
            if _is_weak(best, t) or best.explained <= max(others, default=0.0):
                return None
        return self.mistake


def _most_explained(slopes: dict[float, Slope]) -> Slope:
    """Return the slope at the lag that explains y best."""
    return max(slopes.values(), key=lambda slope: slope.explained)


def _best(slopes: dict[float, Slope], noise: float) -> Slope | None:
    """Return the slope at the best lag, None if x hardly moves or too few samples are independent."""
    if not slopes:
        return None
    best = _most_explained(slopes)
    if best.size <= noise or best.n_effective < PHYSICS.least_samples:
        return None
    return best


def _of_unusual_lag(
    relation: Relation,
    admissible: Interval,
    slopes: dict[float, Slope],
    usual: tuple[float, float],
    least_t: float,
) -> Contradiction | None:
    """Return the contradiction of a best lag outside of the usual ones, if it is."""
    best_lag, best = max(slopes.items(), key=lambda item: item[1].explained)
    first, last = usual
    if first <= best_lag <= last:
        return None
    of_usual = [slope.explained for lag, slope in slopes.items() if first <= lag <= last]
    explained = max(of_usual, default=0.0)
    # likelihood ratio: t^2 = n log of the ratio of unexplained variances
    ratio = (1 + best.explained) / (1 + explained)
    t = float(np.sqrt(best.n_effective * np.log(ratio)))
    if t < least_t:
        return None
    # a uniform distribution between the lags that are tried, where they are farthest apart
    std = float(np.diff(sorted(slopes)).max(initial=0.0) / np.sqrt(12))
    return replace(_of_slope(relation, admissible, best, t), lag=(best_lag, std))


def _is_weak(slope: Slope, t: float, least_t: float = PHYSICS.least_t) -> bool:
    """Return whether a slope outside of its interval by t is too weak an effect, or not surely outside."""
    return abs(slope.correlation) < PHYSICS.least_correlation or abs(t) < least_t


def _of_slope(relation: Relation, admissible: Interval, slope: Slope, t: float) -> Contradiction:
    """Return the contradiction of a slope."""
    return Contradiction(
        relation=relation, channels=relation.channels, admissible=admissible, slope=slope, t=t
    )
