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
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.statistics import autocorrelation_time
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
from skdgp._flight.frames import STANDARD_GRAVITY as G
from skdgp._flight.frames import air_data, air_velocity, euler_to_matrix

RATE = 20.0  # rows are averaged to about this rate [Hz]
LONG = 1.0  # window [s] over which kinematics are integrated
SHORT = 0.1  # window [s] over which effects of angles and surfaces are integrated
IMPROVEMENT = 0.5  # least improvement of an agreement by a correction
WORSE = 0.3  # most that another agreement may lose by it
AGREES = 0.3  # least agreement after a correction; below, signals contradict each other
LEAST_T = 4.0  # least t value after a correction; slopes of t < -4 contradict
LEAST_CLIMB = 0.1  # least standard deviation of v_down [m/s] to judge its sign by the airspeed
PARALLEL = 0.9  # signals of this cosine contradict each other
MULTIPLE = 1.5  # if the larger is so many times the other
EXTRA_CHANNEL = 0.02  # agreement that a correction must gain by each further channel
TIE = 0.01  # causes of agreements that are nearer are as probable
CONTROL = ("Cl", "Cm", "Cn")  # may get worse by a correction: surfaces are judged after the axes
LAGS = (0.0, -0.15, -0.1, -0.05, 0.05, 0.1)  # of the surfaces [s], positive where late
UNEXPLAINED = 1.5  # a lag is possible that leaves less than so many times the least variance
EXPLAINED = 0.75  # unexplained, and explains more than this fraction of the largest variance
ENOUGH = 40  # least number of windows
LONG_FLIGHT = 30.0  # shorter flights [s] are only judged together with others
MOST = 8  # most findings of one table
FLYING = 0.5  # rows slower than this fraction of the median airspeed do not count

CONTROLS = frozenset(ALL_SURFACES)
# Channels that only slopes, and only equalities, depend on
INERTIAL = frozenset((*EULER, *BODY_VELOCITY, *POSITION, "altitude", "v_north", "v_east"))
MOTION = (*VANES, *RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, *BODY_VELOCITY, *POSITION)
SIGNED = (*MOTION, "altitude", *SURFACES)
USED = ("airspeed", *SIGNED, *ELEVONS, "throttle")
# Channels whose signs are changed together, and the cause
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
# Factor to SI, and channels that are in this unit together
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
# Positions by velocities, which they integrate
CLIMBS = {
    **dict(zip(POSITION, EARTH_VELOCITY, strict=True)),
    "altitude": "v_down",
}
# Response, its regressors, and the expected sign of the slope of the first of these
SLOPES = {
    "CZ": ("az", "alpha q elevator", -1, "lift grows with alpha"),
    "CY": ("ay", "beta p r aileron rudder", -1, "the side force opposes beta"),
    "Cl": ("p", "aileron beta p r rudder", 1, "a positive aileron rolls right"),
    "Cm": ("q", "elevator alpha q", -1, "a positive elevator pitches down"),
    "Cn": ("r", "rudder beta p r aileron", -1, "a positive rudder yaws left"),
    "energy": ("airspeed", "sink throttle induced", 1, "the aircraft gains airspeed in descents"),
}
STAND_INS = {"alpha": "az", "beta": "ay"}  # specific forces, which grow with the angles

Signals = dict[str, np.ndarray]
Equality = tuple[str, str, np.ndarray, np.ndarray]  # name, words, y, x


class Contradiction(NamedTuple):
    """Channels with a probable fault, and one sentence: cause, remedy, figures. ``flight`` is None for all flights."""

    flight: object
    channels: tuple[str, ...]
    message: str
    # Whether it is the sign of the channels, and no other cause is as probable
    is_sign: bool = False

    def __str__(self) -> str:
        return self.message if self.flight is None else f"flight {self.flight}: {self.message}"


class Cause(NamedTuple):
    """A possible fault: its channels, the finding, the remedy, and the correction of signals."""

    channels: tuple[str, ...]
    words: str
    remedy: str
    correct: Callable[[Signals], Signals]
    needs: tuple[str, ...] = ()  # Channels that it is looked for in


class Relation(NamedTuple):
    """Two signals that are equal (``pair``), or a slope with a known sign and its ``t`` value (pair None)."""

    words: str
    agreement: float
    contradicts: bool = False
    t: float = 0.0
    pair: tuple[np.ndarray, np.ndarray] | None = None
    explained: float = 0.0  # Explained fraction of the variance of a slope's response

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
    contradictions = _of_flights(table, None)
    flights = flight_rows(table["flight"]) if "flight" in table else {}
    if contradictions or len(flights) < 2:
        return contradictions
    time = table["time"].to_numpy(float)
    return [
        contradiction
        for name, rows in flights.items()
        if np.ptp(time[rows]) >= LONG_FLIGHT
        for contradiction in _of_flights(table.iloc[rows], name)
    ]


def reversed_surfaces(table: pd.DataFrame) -> list[str]:
    """Return the surfaces whose signs all flights of a table contradict, where nothing else is as probable a cause."""
    return [
        name
        for contradiction in find_contradictions(table)
        if contradiction.flight is None and contradiction.is_sign
        for name in contradiction.channels
        if name in CONTROLS
    ]


def _of_flights(table: pd.DataFrame, flight: object) -> list[Contradiction]:
    contradictions: list[Contradiction] = []
    windows, signals = _reduced(table)
    while signals and len(contradictions) < MOST and (best := _most_probable(windows, signals)):
        cause, message, is_sign = best
        contradictions.append(Contradiction(flight, cause.channels, message, is_sign))
        signals = cause.correct(signals)
    return contradictions


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
        name: np.concatenate([_averaged(name, values[run], time[run], size) for run in runs])
        for name, values in columns.items()
        if np.isfinite(values).any()
    }
    segment = np.repeat(np.arange(len(runs)), [(run.stop - run.start) // size for run in runs])
    airspeed = signals.get("airspeed", np.ones(len(segment)))
    flying = ~(airspeed < FLYING * np.nanmedian(airspeed)) if len(segment) else np.empty(0, bool)
    return Windows(segment, size * step, flying), signals


def _averaged(name: str, values: np.ndarray, time: np.ndarray, size: int) -> np.ndarray:
    """Return the means of ``size`` rows each, between samples, without an incomplete block at the end."""
    sampled = np.isfinite(values)
    if sampled.any():
        part = values[sampled]
        if name in EULER:
            part = np.unwrap(part, period=360.0 if np.abs(part).max() > 2.1 * np.pi else 2 * np.pi)
        values = np.interp(time, time[sampled], part, left=np.nan, right=np.nan)
    return values[: len(values) // size * size].reshape(-1, size).mean(axis=1)


def _equal(
    windows: Windows, signals: Signals, changed: Iterable[str] = SIGNED
) -> dict[str, Relation]:
    """Return the pairs of signals that are equal, where they depend on the changed channels."""
    if CONTROLS.issuperset(changed):
        return {}
    with np.errstate(all="ignore"):
        return {
            name: _agreement(statement, y, x, 0.01 if name in (*EULER, *VANES) else 0.1)
            for name, statement, y, x in _kinematics(windows, signals)
        }


def _kinematics(windows: Windows, signals: Signals) -> list[Equality]:
    """Return name, words, y and x of signals that are equal."""
    equalities: list[Equality] = [
        (
            place,
            f"the change of {place} and the integral of {rate}",
            (-1.0 if place == "altitude" else 1.0) * windows.change(signals[place]),
            windows.integral(signals[rate]),
        )
        for place, rate in CLIMBS.items()
        if {place, rate} <= signals.keys()
    ]
    if {*EULER, *RATES} <= signals.keys():
        equalities += _turns(windows, *(signals[name] for name in (*EULER, *RATES)))
    moves = {*EARTH_VELOCITY} <= signals.keys() or {*BODY_VELOCITY} <= signals.keys()
    if {*EULER} <= signals.keys() and moves:
        return equalities + _motion(windows, signals)
    if {*SPECIFIC_FORCE} <= signals.keys():
        level = np.full(len(signals["az"]), -G)
        equalities.append(("az", "az and the -9.8 m/s^2 of level flight", signals["az"], level))
    return equalities


def _turns(windows: Windows, phi, theta, psi, p, q, r) -> list[Equality]:
    """Return the changes of attitude and the integrals of rates."""
    change, integral = windows.change, windows.integral
    statement = "the change of {} and the integral of {}".format
    roll = integral((q * np.sin(phi) + r * np.cos(phi)) * np.tan(theta))
    yaw = integral(q * np.sin(phi) / np.cos(theta))
    pitch = integral(r * np.sin(phi))
    return [
        ("phi", statement("phi", "p"), change(phi) - roll, integral(p)),
        ("theta", statement("theta", "q"), change(theta) + pitch, integral(q * np.cos(phi))),
        (
            "psi",
            statement("psi", "r"),
            change(psi) - yaw,
            integral(r * np.cos(phi) / np.cos(theta)),
        ),
    ]


def _motion(windows: Windows, signals: Signals) -> list[Equality]:
    """Return velocities, forces and air data that are equal at an attitude."""
    equalities: list[Equality] = []
    rotation = euler_to_matrix(*(signals[name] for name in EULER))
    has = {
        names: {*names} <= signals.keys()
        for names in (EARTH_VELOCITY, BODY_VELOCITY, SPECIFIC_FORCE)
    }

    def stacked(names):
        return np.stack([signals[name] for name in names], axis=-1)

    if has[EARTH_VELOCITY]:
        velocity = stacked(EARTH_VELOCITY)
    else:
        velocity = np.einsum("nij,nj->ni", rotation, stacked(BODY_VELOCITY))
    if has[EARTH_VELOCITY] and has[BODY_VELOCITY]:
        along = np.einsum("nji,nj->ni", rotation, velocity).T
        equalities += [
            (name, f"{name} and the velocity over the earth", y, signals[name])
            for name, y in zip(BODY_VELOCITY, along, strict=True)
        ]
    if has[SPECIFIC_FORCE]:
        force = stacked(SPECIFIC_FORCE)
        parts = [windows.integral(rotation[:, :, k] * force[:, k : k + 1]) for k in range(3)]
        missing = windows.change(velocity) - np.array([0.0, 0.0, G]) * LONG - sum(parts)
        equalities += [
            (
                name,
                f"the integral of {name} and the change of the velocity over the earth",
                missing + part,
                part,
            )
            for name, part in zip(SPECIFIC_FORCE, parts, strict=True)
        ]
    if "airspeed" in signals:
        zero = np.zeros(len(rotation))
        alpha, beta = signals.get("alpha", zero), signals.get("beta", zero)
        air = np.einsum("nij,nj->ni", rotation, air_velocity(signals["airspeed"], alpha, beta))
        wind = np.nanmean(velocity - air, axis=0) * [1.0, 1.0, 0.0]
        statement = "the velocities through the air and over the earth"
        equalities.append(("airspeed", statement, (velocity - wind)[:, :2], air[:, :2]))
        _, *angles = air_data(np.einsum("nji,nj->ni", rotation, velocity - wind))
        equalities += [
            (name, f"{name} and the velocity over the earth in body axes", signals[name], angle)
            for name, angle in zip(VANES, angles, strict=True)
            if name in signals
        ]
    return equalities


@np.errstate(all="ignore")
def _slopes(
    windows: Windows, signals: Signals, changed: Iterable[str] = SIGNED
) -> dict[str, Relation]:
    """Return the slopes of known sign, where they depend on the changed channels.

    Slopes of moments are at the lag of the surfaces that explains most. Where another possible lag
    gives a slope of the other sign, its agreement is NaN.
    """
    if INERTIAL.issuperset(changed):
        return {}
    slopes = {name: _slope_sign(*terms) for name, *terms in _aerodynamics(windows, signals)}
    candidates = {name: [slopes[name]] for name in CONTROL if name in slopes}
    for lag in LAGS[1:]:
        shifted = _without_lag(windows, signals, lag)
        for name, *terms in _aerodynamics(windows, shifted, candidates):
            candidates[name].append(_slope_sign(*terms))
    for name, lagged in candidates.items():
        best = max(lagged, key=lambda slope: slope.explained)
        lag_decides = any(
            slope.t * best.t < 0
            and 1 - slope.explained < UNEXPLAINED * (1 - best.explained)
            and slope.explained > EXPLAINED * best.explained
            for slope in lagged
        )
        slopes[name] = Relation(best.words, np.nan) if lag_decides else best
    return slopes


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
    windows: Windows, signals: Signals, names: Iterable[str] = SLOPES
) -> Iterator[tuple]:
    """Yield name, words, change of the response, its regressors, and the expected sign of the first one's slope.

    Responses over V^2 are linear in angles, rates over V and surfaces. Both sides are integrated,
    which needs no derivative of a noisy signal. Without alpha or beta, az / V^2 or ay / V^2 stands
    for it.
    """
    if "airspeed" not in signals:
        return
    speed = signals["airspeed"]
    scaled = signals | {name: signals[name] / speed for name in RATES if name in signals}
    if {*ELEVONS} <= signals.keys():
        left_elevon, right_elevon = (signals[name] for name in ELEVONS)
        scaled |= {
            "elevator": (left_elevon + right_elevon) / 2,
            "aileron": (left_elevon - right_elevon) / 2,
        }
    scaled = {
        angle: signals[f] / speed**2 for angle, f in STAND_INS.items() if f in signals
    } | scaled
    if {"v_down", "throttle"} <= signals.keys() and np.nanstd(signals["v_down"]) > LEAST_CLIMB:
        scaled["sink"] = signals["v_down"] / speed**3
    if "az" in signals:
        scaled["induced"] = (signals["az"] / speed**2) ** 2
    integrals = {"": windows.integral(speed**2, SHORT)}
    for name in names:
        response, regressors, sign, statement = SLOPES[name]
        first, *further = regressors.split()
        measured = first in scaled and (first not in STAND_INS or first in signals)
        if response in signals and measured:
            growth = windows.integral if response in SPECIFIC_FORCE else windows.change
            columns = [first, "", *(regressor for regressor in further if regressor in scaled)]
            integrals |= {
                column: windows.integral(speed**2 * scaled[column], SHORT)
                for column in columns
                if column not in integrals
            }
            X = np.stack([integrals[column] for column in columns], axis=-1)
            yield name, statement, growth(signals[response], SHORT), X, sign


def _agreement(statement: str, y: np.ndarray, x: np.ndarray, least: float) -> Relation:
    """Return the agreement of two signals; they contradict if it is low, or if one is a multiple of the other.

    If the root mean squares of both are smaller than ``least`` [rad, m, m/s or m/s^2], it is NaN.
    """
    sampled = np.isfinite(y) & np.isfinite(x)
    y, x = y[sampled], x[sampled]
    size_y, size_x = y @ y, x @ x
    if len(y) < ENOUGH or not (
        size_y > 0 and size_x > 0 and max(size_y, size_x) > len(y) * least**2
    ):
        return Relation(statement, np.nan)
    scale = np.sqrt(size_y / size_x)
    cosine = x @ y / np.sqrt(size_y * size_x)
    agreement = float(2 * (x @ y) / (size_x + size_y) * min(scale, 1 / scale))
    multiple = cosine > PARALLEL and max(scale, 1 / scale) > MULTIPLE
    return Relation(statement, agreement, bool(agreement < AGREES or multiple), pair=(y, x))


def _slope_sign(statement: str, y: np.ndarray, X: np.ndarray, sign: int) -> Relation:
    """Return the agreement of the slope of the first column of X with its expected sign."""
    sampled = np.isfinite(y) & np.isfinite(X).all(axis=1)
    y, X = y[sampled], X[sampled]
    norms = np.sqrt(np.mean(X**2, axis=0)) if len(y) else np.zeros(1)
    if len(y) < ENOUGH or not norms[0] > 0:
        return Relation(statement, np.nan)
    X = X[:, norms > 0] / norms[norms > 0]
    covariance = np.linalg.pinv(X.T @ X, rcond=1e-8, hermitian=True)
    # the part of the first regressor that the others do not explain
    x = X[:, 0] - X[:, 1:] @ np.linalg.lstsq(X[:, 1:], X[:, 0], rcond=1e-8)[0]
    if x @ x < 1e-6 * len(x):
        return Relation(statement, np.nan)
    residual = y - X @ (covariance @ (X.T @ y))
    t = sign * _t_value(x @ y, x * residual)
    explained = 1 - float(residual @ residual / (y @ y)) if y.any() else 0.0
    return Relation(statement, t / np.hypot(t, LEAST_T), t < -LEAST_T, t, explained=explained)


def _t_value(total: float, products: np.ndarray) -> float:
    """Return the t value of a slope: the sum of regressor times response, and the products regressor times residual."""
    error = np.sqrt(autocorrelation_time(products) * (products @ products))
    return float(total / max(error, 1e-9 * abs(total), 1e-300))


def _most_probable(windows: Windows, signals: Signals) -> tuple[Cause, str, bool] | None:
    """Return the cause whose correction makes most relations agree, its message, and whether it is a sign for sure.

    None if none makes them agree clearly.
    """
    before = _equal(windows, signals) | _slopes(windows, signals)
    contradictions = [name for name, relation in before.items() if relation.contradicts]
    probable: list[tuple[float, Cause, Relation, Relation]] = []
    for cause in _causes(signals) if contradictions else ():
        corrected = cause.correct(signals)
        after = before | _equal(windows, corrected, cause.channels)
        if any(name in SLOPES or after[name].agrees for name in contradictions):
            after |= _slopes(windows, corrected, cause.channels)
        gains = {
            name: after[name].agreement - relation.agreement for name, relation in before.items()
        }
        gains = {name: gain for name, gain in gains.items() if np.isfinite(gain)}
        total = sum(gains.values()) - EXTRA_CHANNEL * len(cause.channels)
        better = [
            name
            for name in contradictions
            if gains.get(name, 0.0) >= IMPROVEMENT and after[name].agrees
        ]
        harms = any(gain <= -WORSE for name, gain in gains.items() if name not in CONTROL)
        if better and total > 0 and not harms:
            name = max(better, key=lambda name: gains[name])
            probable.append((total, cause, before[name], after[name]))
    if not probable:
        return None
    most, cause, now, then = max(probable, key=itemgetter(0))
    rivals = [
        rival.words for total, rival, *_ in probable if total > most - TIE and rival is not cause
    ]
    figures = f"{now.words} agree by {now.agreement:.2f} now, and by {then.agreement:.2f} then (equal: 1, opposite: -1)"
    if now.pair is None:
        figures = f'"{now.words}" has a t value of {now.t:.1f} now, and of {then.t:.1f} then'
    message = f"{' or '.join([cause.words, *rivals])}: {cause.remedy}; {figures}"
    return cause, message, not rivals and cause.words == _wrong_sign(cause.channels)


def _causes(signals: Signals) -> Iterator[Cause]:
    """Yield the possible faults of the channels that there are."""
    judged = MIXED if {*ELEVONS} <= signals.keys() else ELEVONS
    for name in (*SIGNED, *ELEVONS):
        if name in signals and name not in judged:
            remedy = f"change it ({CHANNELS[name].meaning})"
            yield Cause((name,), _wrong_sign((name,)), remedy, _scaled((name,), -1.0))
    for fault, cause in SIGNS.items():
        names = tuple(name for name in fault.split() if name in signals)
        if len(names) > 1:
            remedy = f"change the signs of {', '.join(names)}"
            yield Cause(names, f"probably {cause}", remedy, _scaled(names, -1.0))
    for unit, (factor, groups) in UNITS.items():
        for names in (tuple(group.split()) for group in groups):
            if {*names} <= signals.keys():
                fault = f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} probably in {unit}"
                yield Cause(names, fault, f"multiply by {factor:.5g}", _scaled(names, factor))
    yield from (cause for cause in OTHERS if {*cause.needs} <= signals.keys())


def _wrong_sign(names: tuple[str, ...]) -> str:
    return f"the sign of {', '.join(names)} is probably wrong"


def _scaled(names, factor: float) -> Callable[[Signals], Signals]:
    return lambda signals: (
        signals | {name: factor * signals[name] for name in names if name in signals}
    )


def _exchanged(first: str, second: str, factor: float = 1.0) -> Callable[[Signals], Signals]:
    return lambda signals: (
        signals | {first: factor * signals[second], second: factor * signals[first]}
    )


def _east_north_up(signals: Signals) -> Signals:
    """Return signals with a velocity of east, north, up in the order of north, east, down."""
    return _scaled(("v_down",), -1.0)(_exchanged("v_north", "v_east")(signals))


def _with_gravity(signals: Signals) -> Signals:
    """Return signals with specific force of acceleration: minus gravity, which is along z in level flight."""
    if not {*EULER, *SPECIFIC_FORCE} <= signals.keys():
        return signals | {"az": signals["az"] - G}
    gravity = G * euler_to_matrix(*(signals[name] for name in EULER))[:, 2, :]
    return signals | {
        name: signals[name] - part for name, part in zip(SPECIFIC_FORCE, gravity.T, strict=True)
    }


# Possible faults beside signs and units
OTHERS = (
    Cause(
        ELEVONS,
        _wrong_sign(ELEVONS),
        "change it (> 0 trailing edge down)",
        _scaled(ELEVONS, -1.0),
        ELEVONS,
    ),
    Cause(
        ELEVONS,
        "the elevons are probably exchanged",
        "exchange left and right",
        _exchanged(*ELEVONS),
        ELEVONS,
    ),
    Cause(
        ELEVONS,
        "the elevons are probably exchanged and of the wrong sign",
        "exchange them, change their signs",
        _exchanged(*ELEVONS, -1.0),
        ELEVONS,
    ),
    Cause(
        ("v_north", "v_east"),
        "v_north and v_east are probably exchanged",
        "exchange them",
        _exchanged("v_north", "v_east"),
        ("v_north", "v_east"),
    ),
    Cause(
        EARTH_VELOCITY,
        "the velocity is probably east, north, up",
        "exchange v_north and v_east, change v_down's sign",
        _east_north_up,
        ("v_north", "v_east"),
    ),
    Cause(
        ("psi",),
        "psi is probably measured from east, counter-clockwise",
        "use pi/2 - psi",
        lambda signals: signals | {"psi": np.pi / 2 - signals["psi"]},
        ("psi",),
    ),
    Cause(
        SPECIFIC_FORCE,
        "gravity is probably removed from ax, ay, az",
        "subtract gravity in body axes: an accelerometer reads specific force",
        _with_gravity,
        ("az",),
    ),
)
