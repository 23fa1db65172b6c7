"""Checks of physics: channels of a flight that contradict each other, and the most probable cause.

A relation is a pair of signals y and x that are equal by kinematics. Their agreement is

    2 sum(x y) / (sum(x^2) + sum(y^2)) * min(s, 1 / s),   s^2 = sum(y^2) / sum(x^2),

the concordance of Lin (1989) about zero, times the ratio of scales: 1 if they are equal, -1 if one
has the wrong sign, near 0 if one is in another unit. Other relations are the sign of a slope in
least squares: lift grows with alpha, a positive aileron rolls right. Their agreement is t /
sqrt(t^2 + 16), with the t value of the slope. The t values allow for errors that are correlated in
time. Slopes of moments are those at the lag of the surfaces that explains most: under feedback a
servo that is late turns the sign of the slope at lag zero.

A cause is named only if its correction makes signals agree that contradict each other, beyond
chance, and no other relation worse. Of several causes the one with the largest sum of agreements is
named, and its correction is the start of the search for the next. Noise, wind and missing channels
therefore cause no finding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.statistics import autocorrelation_time
from skdgp._flight.atmosphere import STANDARD_GRAVITY as G
from skdgp._flight.channels import (
    ALL_SURFACES,
    BODY_VELOCITY,
    CHANNELS,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    MIXED,
    POSITION,
    RATES,
    SPECIFIC_FORCE,
    SURFACES,
    VANES,
)
from skdgp._flight.clock import flight_rows, flight_segments
from skdgp._flight.frames import air_velocity, euler_to_matrix

RATE = 20.0  # rows are averaged to about this rate [Hz]
LONG, SHORT = (
    1.0,
    0.1,
)  # windows [s] over which kinematics, and effects of angles and surfaces, are integrated
IMPROVEMENT, WORSE = (
    0.5,
    0.3,
)  # least improvement of an agreement by a correction, and most that another may lose
AGREES, LEAST_T = (
    0.3,
    4.0,
)  # least agreement and t value after a correction; below, and at t < -4, signals contradict
PARALLEL, MULTIPLE = (
    0.9,
    1.5,
)  # signals of this cosine contradict each other if one is so many times the other
EXTRA_CHANNEL, TIE = (
    0.02,
    0.01,
)  # agreement that a correction's next channel must gain; nearer causes are as probable
CONTROL = ("Cl", "Cm", "Cn")  # may get worse by a correction: surfaces are judged after the axes
LAGS = (0.0, -0.15, -0.1, -0.05, 0.05, 0.1)  # of the surfaces [s], positive where late
# a lag is possible that leaves less than 1.5 times the least variance unexplained, and explains more
# than 0.75 of the largest variance
UNEXPLAINED, EXPLAINED = 1.5, 0.75
ENOUGH = 40  # least number of windows
LONG_FLIGHT = 30.0  # shorter flights [s] are only judged together with others
MOST = 8  # most findings of one table
FLYING = 0.5  # rows slower than this share of the median airspeed do not count

CONTROLS = frozenset(ALL_SURFACES)
INERTIAL = frozenset((*EULER, *BODY_VELOCITY, *POSITION, "altitude", "v_north", "v_east"))
"""Channels that only slopes, and only equalities, depend on."""
MOTION = (
    *VANES,
    *RATES,
    *SPECIFIC_FORCE,
    *EULER,
    *EARTH_VELOCITY,
    *BODY_VELOCITY,
    *POSITION,
    "altitude",
)
SIGNED = (*MOTION, *SURFACES)
USED = ("airspeed", *SIGNED, *ELEVONS, "throttle")
SIGNS = {
    "q r": "the gyro's axes are y left, z up",
    "ay az": "the accelerometer's axes are y left, z up",
    "q r ay az": "the axes of gyro and accelerometer are y left, z up",
    "ax ay az": "the accelerometer's signs are reversed",
    "p q r": "the gyro's signs are reversed",
    "theta psi": "the attitude is of axes y left, z up",
    "q r theta psi": "gyro and attitude are of axes y left, z up",
    "q r ay az theta psi": "gyro, accelerometer and attitude are of axes y left, z up",
    "v w": "u, v, w are along axes y left, z up",
    "v_east v_down": "the velocity is north, west, up",
    "v_east v_down east down": "velocity and position are north, west, up",
    "v_down down": "velocity and position are positive up",
    "q r ay az theta psi v w v_east v_down east down": "all axes are y left, z up and north, "
    "west, up",
}
"""Channels whose signs are changed together, and the cause."""
UNITS = {
    "degrees": (
        np.pi / 180,
        ("alpha", "beta", "alpha beta", *RATES, "p q r", *EULER, "phi theta psi"),
    ),
    "degrees per second and degrees": (
        np.pi / 180,
        ("phi theta psi p q r", "alpha beta phi theta psi p q r"),
    ),
    "g": (G, ("ax ay az",)),
    "feet": (0.3048, ("altitude", "down", "north east down")),
    "feet per second": (0.3048, ("airspeed", "v_down", "v_north v_east v_down", "u v w")),
    "knots": (0.514444, ("airspeed", "v_north v_east v_down", "u v w")),
    "km/h": (1 / 3.6, ("airspeed", "v_north v_east v_down", "u v w")),
}
"""Factor to SI, and channels that are in this unit together."""

Signals = dict[str, np.ndarray]


class Contradiction(NamedTuple):
    """Channels with a probable fault, and one sentence: cause, remedy, figures. ``flight`` is None for all flights."""

    flight: object
    channels: tuple[str, ...]
    message: str
    is_sign: bool = False
    """Whether it is the sign of the channels, and no other cause is as probable."""

    def __str__(self) -> str:
        return self.message if self.flight is None else f"flight {self.flight}: {self.message}"


class Cause(NamedTuple):
    """A possible fault: its channels, what is probable, what to do, and the correction of signals."""

    channels: tuple[str, ...]
    words: str
    remedy: str
    correct: Callable[[Signals], Signals]
    keeps_equalities: bool = False
    """Whether equal signals stay equal, so that only slopes show the fault."""


class Relation(NamedTuple):
    """Two signals that are equal (``pair``), or a slope with a known sign and its ``t`` value (pair None)."""

    words: str
    agreement: float
    contradicts: bool = False
    t: float = 0.0
    pair: tuple[np.ndarray, np.ndarray] | None = None
    explained: float = 0.0
    """Explained fraction of the variance of a slope's response."""

    @property
    def t_value(self) -> float:
        """Return the t value of the slope of y over x."""
        if self.pair is None:
            return self.t
        y, x = self.pair
        return _t_value(x @ y, x * (y - x @ y / (x @ x) * x))

    @property
    def agrees(self) -> bool:
        """Whether the signals agree beyond chance."""
        return not self.contradicts and self.agreement >= AGREES and self.t_value >= LEAST_T


def find_contradictions(table: pd.DataFrame) -> list[Contradiction]:
    """Return the channels of a flight table that contradict each other, with the most probable cause of each.

    All flights are judged together, and each of at least 30 s by itself if nothing is found in all.
    Raises ValueError if time does not increase within a flight.
    """
    found = _of_flights(table, None)
    rows = flight_rows(table["flight"]) if "flight" in table and not found else {}
    if len(rows) > 1:
        time = table["time"].to_numpy(float)
        long = {name: here for name, here in rows.items() if np.ptp(time[here]) >= LONG_FLIGHT}
        found = [
            each for name, here in long.items() for each in _of_flights(table.iloc[here], name)
        ]
    return found


def reversed_surfaces(table: pd.DataFrame) -> list[str]:
    """Return the surfaces whose signs all flights of a table contradict, where nothing else is as probable a cause."""
    found = [each for each in find_contradictions(table) if each.flight is None and each.is_sign]
    return [name for each in found for name in each.channels if name in CONTROLS]


def _of_flights(table: pd.DataFrame, flight: object) -> list[Contradiction]:
    found = [Contradiction(flight, *each) for each in _magnitudes(table)]
    windows, signals = _reduced(table)
    while len(signals) and len(found) < MOST:
        best = _most_probable(windows, signals)
        if best is None:
            break
        cause, message, is_sign = best
        found.append(Contradiction(flight, cause.channels, message, is_sign))
        signals = cause.correct(signals)
    return found


def _magnitudes(table: pd.DataFrame) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield controls that are too large for radians, or for a share."""
    for name in (*SURFACES, *ELEVONS, "throttle"):
        if name in table and pd.api.types.is_numeric_dtype(table[name]):
            most, unit = (1.5, "percent") if name == "throttle" else (np.pi / 2, "degrees")
            values = np.abs(table[name].to_numpy(float, na_value=np.nan))
            large = float(np.nanquantile(values, 0.95)) if np.isfinite(values).any() else 0.0
            if large > most:
                words = f"{name} is probably in {unit}: convert it; 5 % of its values are beyond {large:.3g}"
                yield (name,), f"{words} ({CHANNELS[name].unit or 'a share'} at most {most:.3g})"


class Windows(NamedTuple):
    """Windows within segments: first and last rows, rows of a segment, and the step of the clock [s]."""

    segment: np.ndarray
    step: float
    flying: np.ndarray

    def ends(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        """Return first and last row of each window."""
        length = max(2, round(seconds / self.step))
        first = np.arange(0, len(self.segment) - length, max(1, length // 4))
        inside = (self.segment[first] == self.segment[first + length]) & self.flying[first]
        return first[inside], first[inside] + length

    def change(self, values: np.ndarray, seconds: float = LONG) -> np.ndarray:
        """Return by how much values (n, ...) grow in each window."""
        first, last = self.ends(seconds)
        return values[last] - values[first]

    def integral(self, values: np.ndarray, seconds: float = LONG) -> np.ndarray:
        """Return the integrals of values (n, ...) by the trapezoidal rule, NaN where a value is missing."""
        first, last = self.ends(seconds)
        parts = 0.5 * self.step * (values[1:] + values[:-1])
        missing = ~np.isfinite(parts)
        start = np.zeros((1, *values.shape[1:]))
        total = np.concatenate([start, np.cumsum(np.where(missing, 0.0, parts), axis=0)])
        integral = total[last] - total[first]
        if missing.any():
            count = np.concatenate([start, np.cumsum(missing, axis=0)])
            integral[count[last] > count[first]] = np.nan
        return integral


def _reduced(table: pd.DataFrame) -> tuple[Windows, Signals]:
    """Return windows and signals at about 20 Hz, interpolated between samples; angles without jumps."""
    time = table["time"].to_numpy(float)
    runs = [run for run in flight_segments(time, table.get("flight")) if run.stop - run.start > 1]
    if not runs:
        return Windows(np.empty(0, int), 1.0, np.empty(0, bool)), {}
    step = float(np.median(np.concatenate([np.diff(time[run]) for run in runs])))
    size = max(1, int(1 / step // RATE))
    names = [name for name in USED if name in table and pd.api.types.is_numeric_dtype(table[name])]
    columns = {name: table[name].to_numpy(float, na_value=np.nan) for name in names}
    signals = {
        name: np.concatenate(
            [block_means(_continuous(name, values[run], time[run]), size) for run in runs]
        )
        for name, values in columns.items()
        if np.isfinite(values).any()
    }
    lengths = [(run.stop - run.start) // size for run in runs]
    segment = np.repeat(np.arange(len(runs)), lengths)
    airspeed = signals.get("airspeed", np.ones(len(segment)))
    flying = ~(airspeed < FLYING * np.nanmedian(airspeed)) if len(segment) else np.empty(0, bool)
    return Windows(segment, size * step, flying), signals


def _continuous(name: str, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    if not known.any():
        return values
    part = values[known]
    if name in EULER:
        part = np.unwrap(part, period=360.0 if np.abs(part).max() > 2.1 * np.pi else 2 * np.pi)
    return np.interp(time, time[known], part, left=np.nan, right=np.nan)


def block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Return the means of ``size`` rows each; what is left over at the end does not count."""
    return values[: len(values) // size * size].reshape(-1, size, *values.shape[1:]).mean(axis=1)


def _relations(
    windows: Windows, signals: Signals, changed: Iterable[str] = SIGNED
) -> dict[str, Relation]:
    """Return the relations between the channels that there are: those that depend on the changed ones."""
    found: dict[str, Relation] = {}
    with np.errstate(all="ignore"):
        if not CONTROLS.issuperset(changed):
            for name, words, y, x in _kinematics(windows, signals):
                found[name] = _agreement(words, y, x, 0.01 if name in (*EULER, *VANES) else 0.1)
        if not INERTIAL.issuperset(changed):
            found |= _slopes(windows, signals)
    return found


def _kinematics(windows: Windows, signals: Signals) -> Iterator[tuple]:
    """Yield name, words, y and x of signals that are equal."""
    change, integral = windows.change, windows.integral

    def get(*names):
        return [signals[name] for name in names] if all(name in signals for name in names) else None

    attitude = get(*EULER)
    if attitude and get(*RATES):
        phi, theta, psi = attitude
        p, q, r = get(*RATES)
        equal = "the change of {} and the integral of {}".format
        turn = integral((q * np.sin(phi) + r * np.cos(phi)) * np.tan(theta))
        yield "phi", equal("phi", "p"), change(phi) - turn, integral(p)
        yield (
            "theta",
            equal("theta", "q"),
            change(theta) + integral(r * np.sin(phi)),
            integral(q * np.cos(phi)),
        )
        turn = change(psi) - integral(q * np.sin(phi) / np.cos(theta))
        yield "psi", equal("psi", "r"), turn, integral(r * np.cos(phi) / np.cos(theta))
    for place, rate in zip((*POSITION, "altitude"), (*EARTH_VELOCITY, "v_down"), strict=True):
        if get(place, rate):
            sign = -1.0 if place == "altitude" else 1.0
            words = f"the change of {place} and the integral of {rate}"
            yield place, words, sign * change(signals[place]), integral(signals[rate])
    force = np.stack(get(*SPECIFIC_FORCE), axis=-1) if get(*SPECIFIC_FORCE) else None
    earth, body = get(*EARTH_VELOCITY), get(*BODY_VELOCITY)
    if attitude is None or not (earth or body):
        if force is not None:
            yield (
                "az",
                "az and the -9.8 m/s^2 of level flight",
                force[:, 2],
                np.full(len(force), -G),
            )
        return
    rotation = euler_to_matrix(*attitude)
    velocity = (
        np.stack(earth, axis=-1)
        if earth
        else np.einsum("nij,nj->ni", rotation, np.stack(body, axis=-1))
    )
    if earth and body:
        along = np.einsum("nji,nj->ni", rotation, velocity)
        for k, name in enumerate(BODY_VELOCITY):
            yield name, f"{name} and the velocity over the earth", along[:, k], signals[name]
    if force is not None:
        parts = [integral(rotation[:, :, k] * force[:, k : k + 1]) for k in range(3)]
        rest = change(velocity) - np.array([0.0, 0.0, G]) * LONG
        for k, name in enumerate(SPECIFIC_FORCE):
            words = f"the integral of {name} and the change of the velocity over the earth"
            yield name, words, rest - sum(parts[j] for j in range(3) if j != k), parts[k]
    if get("airspeed"):
        zero = np.zeros(len(rotation))
        alpha, beta = signals.get("alpha", zero), signals.get("beta", zero)
        air = np.einsum("nij,nj->ni", rotation, air_velocity(signals["airspeed"], alpha, beta))
        wind = np.nanmean(velocity - air, axis=0) * [1.0, 1.0, 0.0]
        yield (
            "airspeed",
            "the velocities through the air and over the earth",
            (velocity - wind)[:, :2],
            air[:, :2],
        )
        u, v, w = np.einsum("nji,nj->ni", rotation, velocity - wind).T
        for name, angle in {
            "alpha": np.arctan2(w, u),
            "beta": np.arctan2(v, np.hypot(u, w)),
        }.items():
            if name in signals:
                yield (
                    name,
                    f"{name} and the velocity over the earth in body axes",
                    signals[name],
                    angle,
                )


def _slopes(windows: Windows, signals: Signals) -> dict[str, Relation]:
    """Return the slopes of known sign, those of moments at the lag of the surfaces that explains most.

    Where another possible lag gives a slope of the other sign, its agreement is NaN.
    """
    found = {name: _slope_sign(*each) for name, *each in _aerodynamics(windows, signals)}
    candidates: dict[str, list[Relation]] = {
        name: [found[name]] for name in CONTROL if name in found
    }
    for lag in LAGS[1:]:
        shifted = _without_lag(windows, signals, lag)
        for name, *each in _aerodynamics(windows, shifted, list(candidates)):
            candidates[name].append(_slope_sign(*each))
    for name, slopes in candidates.items():
        best = max(slopes, key=lambda each: each.explained)
        lag_decides = any(
            each.t * best.t < 0
            and 1 - each.explained < UNEXPLAINED * (1 - best.explained)
            and each.explained > EXPLAINED * best.explained
            for each in slopes
        )
        found[name] = Relation(best.words, np.nan) if lag_decides else best
    return found


def _without_lag(windows: Windows, signals: Signals, lag: float) -> Signals:
    """Return signals with surfaces corrected for a lag [s], NaN where a segment ends before."""
    rows = np.arange(len(windows.segment))
    place = rows + lag / windows.step
    ends = np.clip([np.floor(place), np.ceil(place)], 0, rows[-1]).astype(int)
    inside = (windows.segment[ends] == windows.segment).all(axis=0)
    inside &= (place >= 0) & (place <= rows[-1])
    return signals | {
        name: np.where(inside, np.interp(place, rows, signals[name]), np.nan)
        for name in ALL_SURFACES
        if name in signals
    }


def _aerodynamics(
    windows: Windows, signals: Signals, wanted: Iterable[str] | None = None
) -> Iterator[tuple]:
    """Yield name, words, change of the response, its regressors, and the expected sign of the first one's slope.

    Only those that are wanted, if given. Responses over V^2 are linear in angles, rates over V and
    surfaces. Both sides are integrated, which needs no derivative of a noisy signal. Without alpha
    or beta, az / V^2 or ay / V^2 stands for it.
    """
    if "airspeed" not in signals:
        return
    speed = signals["airspeed"]
    terms = {
        name: speed**2 * signals[name]
        for name in (*VANES, *SURFACES, "throttle")
        if name in signals
    }
    terms |= {name: speed * signals[name] for name in RATES if name in signals}
    if {*ELEVONS} <= signals.keys():
        left, right = (signals[name] for name in ELEVONS)
        terms |= {
            "elevator": speed**2 * (left + right) / 2,
            "aileron": speed**2 * (left - right) / 2,
        }
    stand_in = {"alpha": "az", "beta": "ay"}
    terms = {angle: signals[force] for angle, force in stand_in.items() if force in signals} | terms
    tables = (
        ("CZ", "az", "alpha q elevator", -1, "lift grows with alpha", windows.integral),
        (
            "CY",
            "ay",
            "beta p r aileron rudder",
            -1,
            "the side force opposes beta",
            windows.integral,
        ),
        ("Cl", "p", "aileron beta p r rudder", 1, "a positive aileron rolls right", windows.change),
        ("Cm", "q", "elevator alpha q", -1, "a positive elevator pitches down", windows.change),
        ("Cn", "r", "rudder beta p r aileron", -1, "a positive rudder yaws left", windows.change),
    )
    for name, response, regressors, sign, words, growth in tables:
        if wanted is not None and name not in wanted:
            continue
        first, *others = regressors.split()
        if response in signals and first in terms and (first not in stand_in or first in signals):
            columns = [
                terms[first],
                speed**2,
                *(terms[other] for other in others if other in terms),
            ]
            X = windows.integral(np.stack(columns, axis=-1), SHORT)
            yield name, words, growth(signals[response], SHORT), X, sign
    if wanted is None and "v_down" in signals and "throttle" in signals:
        drag = [signals["az"] ** 2 / speed**2] if "az" in signals else []
        X = windows.integral(
            np.stack([signals["v_down"] / speed, speed**2, terms["throttle"], *drag], axis=-1),
            SHORT,
        )
        yield (
            "energy",
            "the aircraft gains airspeed in descents",
            windows.change(speed, SHORT),
            X,
            1,
        )


def _agreement(words: str, y: np.ndarray, x: np.ndarray, least: float) -> Relation:
    """Return the agreement of two signals; they contradict if it is low, or if one is a multiple of the other.

    If the root mean squares of both are smaller than ``least`` [rad, m, m/s or m/s^2], it is NaN.
    """
    known = np.isfinite(y) & np.isfinite(x)
    y, x = y[known], x[known]
    size_y, size_x = y @ y, x @ x
    if len(y) < ENOUGH or not (
        size_y > 0 and size_x > 0 and max(size_y, size_x) > len(y) * least**2
    ):
        return Relation(words, np.nan)
    scale = np.sqrt(size_y / size_x)
    cosine = x @ y / np.sqrt(size_y * size_x)
    agreement = float(2 * (x @ y) / (size_x + size_y) * min(scale, 1 / scale))
    multiple = cosine > PARALLEL and max(scale, 1 / scale) > MULTIPLE
    return Relation(words, agreement, bool(agreement < AGREES or multiple), pair=(y, x))


def _slope_sign(words: str, y: np.ndarray, X: np.ndarray, sign: int) -> Relation:
    """Return the agreement of the slope of the first column of X with its expected sign."""
    known = np.isfinite(y) & np.isfinite(X).all(axis=1)
    y, X = y[known], X[known]
    norms = np.sqrt(np.mean(X**2, axis=0)) if len(y) else np.zeros(1)
    if len(y) < ENOUGH or not norms[0] > 0:
        return Relation(words, np.nan)
    X = X[:, norms > 0] / norms[norms > 0]
    covariance = np.linalg.pinv(X.T @ X, rcond=1e-8, hermitian=True)
    own = (
        X[:, 0] - X[:, 1:] @ np.linalg.lstsq(X[:, 1:], X[:, 0], rcond=1e-8)[0]
    )  # what the others do not explain
    if own @ own < 1e-6 * len(own):
        return Relation(words, np.nan)
    residual = y - X @ (covariance @ (X.T @ y))
    t = sign * _t_value(own @ y, own * residual)
    explained = 1 - float(residual @ residual / (y @ y)) if y.any() else 0.0
    return Relation(words, t / np.hypot(t, LEAST_T), t < -LEAST_T, t, explained=explained)


def _t_value(total: float, products: np.ndarray) -> float:
    """Return the t value of a slope: the sum of regressor times response, and the products regressor times residual."""
    error = np.sqrt(autocorrelation_time(products) * (products @ products))
    return float(total / max(error, 1e-9 * abs(total), 1e-300))


def _most_probable(windows: Windows, signals: Signals) -> tuple[Cause, str, bool] | None:
    """Return the cause whose correction makes most relations agree, its message, and whether it is a sign for sure.

    None if none makes them agree clearly.
    """
    before = _relations(windows, signals)
    contradictions = [name for name, each in before.items() if each.contradicts]
    found: list[tuple[float, Cause, Relation, Relation]] = []
    for cause in _causes(signals) if contradictions else ():
        after = before | _relations(windows, cause.correct(signals), cause.channels)
        gain = {
            name: after[name].agreement - each.agreement
            for name, each in before.items()
            if each.pair is None or not cause.keeps_equalities
        }
        gain = {name: value for name, value in gain.items() if np.isfinite(value)}
        total = sum(gain.values()) - EXTRA_CHANNEL * len(cause.channels)
        better = [
            name
            for name in contradictions
            if gain.get(name, 0.0) >= IMPROVEMENT and after[name].agrees
        ]
        if (
            better
            and total > 0
            and all(value > -WORSE for name, value in gain.items() if name not in CONTROL)
        ):
            name = max(better, key=lambda name: gain[name])
            found.append((total, cause, before[name], after[name]))
    if not found:
        return None
    most, cause, now, then = max(found, key=lambda each: each[0])
    rivals = [each.words for total, each, *_ in found if total > most - TIE and each is not cause]
    figures = f"{now.words} agree by {now.agreement:.2f} now, and by {then.agreement:.2f} then (equal: 1, opposite: -1)"
    if now.pair is None:
        figures = f"{now.words} by {now.t:.1f} standard errors now, and by {then.t:.1f} then"
    message = f"{' or '.join([cause.words, *rivals])}: {cause.remedy}; {figures}"
    return cause, message, not rivals and cause.words == _wrong_sign(cause.channels)


def _causes(signals: Signals) -> Iterator[Cause]:
    for name in SIGNED:
        if name in signals and not (name in MIXED and {*ELEVONS} <= signals.keys()):
            remedy = f"change it ({CHANNELS[name].meaning})"
            yield Cause((name,), _wrong_sign((name,)), remedy, _scaled([name], -1.0))
    for words, cause in SIGNS.items():
        names = tuple(name for name in words.split() if name in signals)
        if len(names) > 1:
            remedy = f"change the signs of {', '.join(names)}"
            yield Cause(names, f"probably {cause}", remedy, _scaled(names, -1.0))
    for unit, (factor, groups) in UNITS.items():
        for group in groups:
            names = tuple(group.split())
            if all(name in signals for name in names):
                words = (
                    f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} probably in {unit}"
                )
                yield Cause(names, words, f"multiply by {factor:.5g}", _scaled(names, factor))
    if {*ELEVONS} <= signals.keys():
        for names in (*((name,) for name in ELEVONS), ELEVONS):
            yield Cause(
                names,
                _wrong_sign(names),
                "change it (> 0 trailing edge down)",
                _scaled(names, -1.0),
            )
        sides = _exchanged(ELEVONS)
        yield Cause(ELEVONS, "the elevons are probably exchanged", "exchange left and right", sides)
        words, remedy = (
            "the elevons are probably exchanged and of the wrong sign",
            "exchange them, change their signs",
        )
        yield Cause(ELEVONS, words, remedy, lambda signals: sides(_scaled(ELEVONS, -1.0)(signals)))
    if all(name in signals for name in ("v_north", "v_east")):
        exchanged, turned = (
            _exchanged(("v_north", "v_east")),
            _scaled({"v_down"} & signals.keys(), -1.0),
        )
        words = "v_north and v_east are probably exchanged"
        yield Cause(("v_north", "v_east"), words, "exchange them", exchanged)
        words, remedy = (
            "the velocity is probably east, north, up",
            "exchange v_north and v_east, change v_down's sign",
        )
        yield Cause(EARTH_VELOCITY, words, remedy, lambda signals: turned(exchanged(signals)))
    if "psi" in signals:
        words = "psi is probably measured from east, counter-clockwise"
        yield Cause(("psi",), words, "use pi/2 - psi", lambda s: s | {"psi": np.pi / 2 - s["psi"]})
    if "az" in signals:
        words, remedy = (
            "gravity is probably removed from ax, ay, az",
            "subtract gravity in body axes",
        )
        yield Cause(
            SPECIFIC_FORCE, words, f"{remedy}: an accelerometer reads specific force", _with_gravity
        )
    if all(name in signals for name in (*EULER, *SPECIFIC_FORCE, "v_down")):
        words = "the vertical axis probably points up, in attitude and positions (axes y left, z up; north, west, up)"
        remedy = "change the axes, then compute specific force"
        yield Cause(("theta", "psi", "v_down"), words, remedy, _turned_over, keeps_equalities=True)


def _wrong_sign(names: tuple[str, ...]) -> str:
    return f"the sign of {', '.join(names)} is probably wrong"


def _scaled(names, factor: float) -> Callable[[Signals], Signals]:
    return lambda signals: signals | {name: factor * signals[name] for name in names}


def _exchanged(names) -> Callable[[Signals], Signals]:
    return lambda signals: (
        signals | dict(zip(names, [signals[name] for name in reversed(names)], strict=True))
    )


def _with_gravity(signals: Signals) -> Signals:
    """Return signals with specific force of acceleration: minus gravity, which is along z in level flight."""
    if not all(name in signals for name in (*EULER, *SPECIFIC_FORCE)):
        return signals | {"az": signals["az"] - G}
    gravity = G * euler_to_matrix(*(signals[name] for name in EULER))[:, 2, :]
    return signals | {
        name: signals[name] - part for name, part in zip(SPECIFIC_FORCE, gravity.T, strict=True)
    }


def _turned_over(signals: Signals) -> Signals:
    """Return signals in forward, right, down and north, east, down, whose specific force had gravity upside down."""
    names = "beta alpha q r ay az theta psi v w v_east v_down east down"
    turned = _scaled([name for name in names.split() if name in signals], -1.0)(signals)
    return _with_gravity(_with_gravity(turned))
