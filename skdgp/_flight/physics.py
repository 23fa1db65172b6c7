"""Checks of physics: relations between channels that hold in every flight, and the flights that contradict them.

A check is a regression of one signal y on another, x. Kinematics make both equal, so the slope is
1; or aerodynamics give its sign: lift grows with alpha, a positive aileron rolls right. Other
regressors, such as an intercept, a steady wind and further effects, are removed from both signals
first (Frisch & Waugh, 1933). With the residual e, the slope and its standard deviation are

    slope = x.y / x.x,   e = y - slope x,   std = sqrt(tau sum (x e)^2) / x.x.

Neighbouring samples are dependent: n samples count as n / tau, where tau is the autocorrelation
time of the products x e, 1 + 2 sum rho_x rho_e (Bartlett, 1946). A slope contradicts its relation
if it is outside of the admissible interval by 5 standard deviations.

Signals are changes and integrals over windows, so no noisy signal is differentiated. The checks
report: they never change a flight.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from skdgp._compute.findings import Code, Finding
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    MIXED,
    RATES,
    SPECIFIC_FORCE,
)
from skdgp._flight.clock import flight_rows, flight_segments
from skdgp._flight.frames import STANDARD_GRAVITY, euler_to_matrix


@dataclass(frozen=True)
class PhysicsSettings:
    """Settings of the checks of physics."""

    # rows are averaged to about this rate [Hz], above the frequencies of flight dynamics
    rate: float = 20.0
    # window of kinematics [s], longer than the usual lags
    kinematic_window: float = 1.0
    # window of forces and moments [s], shorter than the time constant of roll
    response_window: float = 0.1
    # rows slower than this fraction of the median airspeed are on the ground
    flying: float = 0.5
    # fewer rows, or fewer effective samples, decide nothing
    least_rows: int = 40
    least_samples: float = 10.0
    # least distance of a slope from its admissible interval, in standard deviations
    least_t: float = 5.0
    # least partial correlation of an effect of wrong sign: feedback, lags and gusts cause weaker
    # ones
    least_correlation: float = 0.3
    # a longer lag [s] is a contradiction: LagCorrector corrects 0.3 s, holds of slow GPS add to it
    usual_lag: float = 0.5
    # a lag is possible if the ratio of explained to unexplained variance is this fraction of the best
    possible_lag: float = 1 / 3
    # flights shorter than this [s] are judged together with others only
    long_flight: float = 30.0


DEFAULT = PhysicsSettings()


class Slope(NamedTuple):
    """A slope of a regression, with its standard deviation and partial correlation."""

    value: float
    std: float
    # partial correlation
    correlation: float
    n_effective: float
    # root mean square of x without the other regressors
    size: float

    @property
    def explained(self) -> float:
        """Ratio of explained to unexplained variance."""
        return self.correlation**2 / max(1 - self.correlation**2, 1e-12)

    def t(self, least: float, most: float) -> float:
        """Return how far the slope is outside of an interval, in standard deviations, 0 inside."""
        nearest = np.clip(self.value, least, most)
        return float(self.value - nearest) / max(self.std, 1e-9 * abs(self.value))


class Contradiction(NamedTuple):
    """A check that flights contradict, and its numbers. ``flight`` is None for all flights together."""

    flight: object
    check: str
    # channels that may be wrong
    channels: tuple[str, ...]
    # "slope", or "lag" [s]; ``slope`` has the value of either
    quantity: str
    slope: float
    std: float
    # distance from the admissible values, in standard deviations
    t: float
    correlation: float
    n_effective: float

    @property
    def finding(self) -> Finding:
        """The finding of the compared signals, y over x, and the numbers."""
        check = CHECKS[self.check]
        numbers = {
            "channels": list(self.channels),
            "y": check.y,
            "x": check.x,
            "expected": check.expected,
            self.quantity: self.slope,
            "std": self.std,
            "t": self.t,
            "correlation": self.correlation,
            "effective_samples": self.n_effective,
        }
        return Finding(Code.CONTRADICTION, self.flight, numbers=numbers)


@dataclass(frozen=True)
class Signals:
    """Channels of flights at one rate, and the segment of each row. A missing value is NaN."""

    channels: dict[str, Vector]
    segment: np.ndarray
    step: float
    settings: PhysicsSettings = DEFAULT

    def __getitem__(self, name: str) -> Vector:
        return self.channels[name]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def ones(self) -> Vector:
        """The regressor of an intercept."""
        return np.ones(len(self.segment))

    @property
    def rotation(self) -> Array:
        """Rotation matrices from body to earth axes (n, 3, 3)."""
        return euler_to_matrix(self["phi"], self["theta"], self["psi"])

    def vector(self, names: tuple[str, ...]) -> Matrix:
        """Return channels as vectors (n, k)."""
        return np.column_stack([self[name] for name in names])

    def window_rows(self, seconds: float | None = None) -> int:
        """Return the steps of a window, at least one."""
        seconds = self.settings.kinematic_window if seconds is None else seconds
        return max(round(seconds / self.step), 1)

    def change(self, values: Array, seconds: float | None = None) -> Array:
        """Return the changes of values (n, ...) over windows that begin at each row, NaN at a segment's end."""
        length = self.window_rows(seconds)
        inside = self.segment[length:] == self.segment[:-length]
        change = np.full(values.shape, np.nan)
        change[:-length][inside] = (values[length:] - values[:-length])[inside]
        return change

    def integral(self, values: Array, seconds: float | None = None) -> Array:
        """Return the integrals over these windows by the trapezoidal rule, NaN where a value is missing."""
        missing = ~np.isfinite(values)
        filled = np.where(missing, 0.0, values)
        total = np.cumsum(filled, axis=0) - filled / 2
        integral = self.step * self.change(total, seconds)
        n_missing = self.change(np.cumsum(missing, axis=0, dtype=float), seconds)
        integral[missing | (n_missing > 0)] = np.nan
        return integral

    def ahead(self, values: Vector, seconds: float) -> Vector:
        """Return the value of each row ``seconds`` later, NaN beyond its segment."""
        rows = np.arange(len(values))
        place = rows + seconds / self.step
        ahead = np.interp(place, rows, values, left=np.nan, right=np.nan)
        for end in (np.floor(place), np.ceil(place)):
            row = np.clip(end, 0, len(rows) - 1).astype(int)
            ahead[self.segment[row] != self.segment] = np.nan
        return ahead


class Regression(NamedTuple):
    """A response y, the regressor x whose slope is judged, and the other regressors, (n,) each."""

    y: Vector
    x: Vector
    others: list[Vector]


# -- kinematics: equal signals


def roll(flight: Signals) -> Regression:
    """Return the terms of phi_dot = p + (q sin phi + r cos phi) tan theta."""
    phi = flight["phi"]
    turn = flight["q"] * np.sin(phi) + flight["r"] * np.cos(phi)
    coupling = flight.integral(turn * np.tan(flight["theta"]))
    y = flight.change(phi) - coupling
    return Regression(y, flight.integral(flight["p"]), [flight.ones])


def pitch(flight: Signals) -> Regression:
    """Return the terms of theta_dot = q cos phi - r sin phi."""
    phi = flight["phi"]
    coupling = flight.integral(flight["r"] * np.sin(phi))
    y = flight.change(flight["theta"]) + coupling
    return Regression(y, flight.integral(flight["q"] * np.cos(phi)), [flight.ones])


def yaw(flight: Signals) -> Regression:
    """Return the terms of psi_dot = (q sin phi + r cos phi) / cos theta."""
    phi = flight["phi"]
    cosine = np.cos(flight["theta"])
    coupling = flight.integral(flight["q"] * np.sin(phi) / cosine)
    y = flight.change(flight["psi"]) - coupling
    return Regression(y, flight.integral(flight["r"] * np.cos(phi) / cosine), [flight.ones])


def position(flight: Signals, name: str, velocity: str) -> Regression:
    """Return the change of a coordinate and the integral of its velocity."""
    sign = -1.0 if name == "altitude" else 1.0
    y = sign * flight.change(flight[name])
    return Regression(y, flight.integral(flight[velocity]), [flight.ones])


def relative_velocity(flight: Signals, axis: int) -> Regression:
    """Return the terms of a component of R^T v_ground = v_air + R^T wind, at a steady horizontal wind.

    Along x the air velocity is V, across it about V beta and V alpha. Gusts move these only, so they
    are the response there.
    """
    rotation = flight.rotation
    airspeed = flight["airspeed"]
    ground = np.einsum("nij,ni->nj", rotation, flight.vector(EARTH_VELOCITY))[:, axis]
    wind = [rotation[:, 0, axis], rotation[:, 1, axis]]
    if axis == 0:
        return Regression(ground, airspeed, wind)
    angle = flight["beta"] if axis == 1 else flight["alpha"]
    return Regression(airspeed * angle, ground, [*wind, airspeed])


def level_force(flight: Signals, axis: int) -> Regression:
    """Return the terms of v_dot = R f + g along axes forward, right and down: changes and impulses.

    Forward and right are level, by the heading at the middle of the window.
    """
    change = flight.change(flight.vector(EARTH_VELOCITY))
    force = np.einsum("nij,nj->ni", flight.rotation, flight.vector(SPECIFIC_FORCE))
    impulse = flight.integral(force)
    if axis == 2:
        return Regression(change[:, 2], impulse[:, 2], [flight.ones])
    middle = flight.settings.kinematic_window / 2
    heading = flight.ahead(flight["psi"], middle) + axis * np.pi / 2
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    y = np.sum(direction * change[:, :2], axis=1)
    x = np.sum(direction * impulse[:, :2], axis=1)
    return Regression(y, x, [flight.ones])


def gravity(flight: Signals) -> Regression:
    """Return the terms of (R f)_down = v_down_dot - g, without an intercept.

    The force is the response: without gravity in it, it hardly varies with x.
    """
    change, impulse, _ = level_force(flight, axis=2)
    window = flight.step * flight.window_rows()
    return Regression(impulse, change - STANDARD_GRAVITY * window, [])


# -- aerodynamics: slopes of a known sign


def response(flight: Signals, name: str, effects: tuple[str, ...]) -> Regression:
    """Return a rate or specific force, and its effects.

    Responses over V^2 are linear in angles, rates over V and surfaces. A specific force stands for an
    angle that was not measured.
    """
    window = flight.settings.response_window
    airspeed = flight["airspeed"]
    columns = []
    for effect in effects:
        stand_in = STAND_INS.get(effect, "")
        if effect in RATES and effect in flight:
            columns.append(airspeed * flight[effect])
        elif effect in flight:
            columns.append(airspeed**2 * flight[effect])
        elif stand_in in flight:
            columns.append(flight[stand_in])
    columns.append(airspeed**2)
    x, *others = [flight.integral(column, window) for column in columns]
    grows = flight.change if name in RATES else flight.integral
    return Regression(grows(flight[name], window), x, others)


def thrust(flight: Signals) -> Regression:
    """Return the terms of ax = thrust - parasitic and induced drag."""
    squared = flight["airspeed"] ** 2
    az = flight["az"]
    others = [flight.integral(drag) for drag in (squared, az, az**2 / squared)]
    x = flight.integral(flight["throttle"])
    return Regression(flight.integral(flight["ax"]), x, [flight.ones, *others])


# -- the table of checks

Interval = tuple[float, float]
EQUAL: Interval = (1 / 1.5, 1.5)
# gusts move the air past the aircraft, which follows them
GUSTY: Interval = (-0.5, 1.5)
POSITIVE: Interval = (0.0, np.inf)
NEGATIVE: Interval = (-np.inf, 0.0)
EXPECTED = {EQUAL: "1", GUSTY: "0 to 1", POSITIVE: "a positive one", NEGATIVE: "a negative one"}
# specific forces that grow with the angles
STAND_INS = {"alpha": "az", "beta": "ay"}
# lags that are tried [s], > 0 where y is late against x
KINEMATIC_LAGS = (0.0, -1.0, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 1.0)
SURFACE_LAGS = (0.0, -0.1, -0.05, 0.05, 0.1, 0.15)


class Check(NamedTuple):
    """A relation of y with x: the compared channels, its signals, and the admissible slopes."""

    channels: tuple[str, ...]
    y: str
    x: str
    regression: Callable[[Signals], Regression]
    slopes: Interval
    # error of x [unit of x]: a signal of no larger root mean square decides nothing
    noise: float
    lags: tuple[float, ...]
    # other channels that it needs
    uses: tuple[str, ...]

    @property
    def expected(self) -> str:
        """The expected slope."""
        return EXPECTED[self.slopes]


def _rate(angle: str, rate: str, regression: Callable, uses: tuple[str, ...]) -> Check:
    y, x = f"the change of {angle}", f"the integral of {rate}"
    return Check((angle, rate), y, x, regression, EQUAL, 0.02, KINEMATIC_LAGS, uses)


def _position(name: str, velocity: str) -> Check:
    regression = partial(position, name=name, velocity=velocity)
    return _rate(name, velocity, regression, ())._replace(noise=0.3)


def _velocity(name: str, y: str, x: str, axis: int) -> Check:
    regression = partial(relative_velocity, axis=axis)
    uses = (*EULER, *EARTH_VELOCITY, "airspeed")
    return Check((name,), y, x, regression, GUSTY, 0.5, (0.0,), uses)


def _force(channels: tuple[str, ...], regression: Callable) -> Check:
    y, x = "the change of velocity", "the integral of specific force and gravity"
    uses = (*EULER, *EARTH_VELOCITY, *SPECIFIC_FORCE)
    return Check(channels, y, x, regression, EQUAL, 0.5, KINEMATIC_LAGS, uses)


def _effect(name: str, effects: tuple[str, ...], slopes: Interval) -> Check:
    y = f"the change of {name}" if name in RATES else name
    regression = partial(response, name=name, effects=effects)
    lags = SURFACE_LAGS if effects[0] in ALL_SURFACES else (0.0,)
    channels = (effects[0], name)
    return Check(channels, y, effects[0], regression, slopes, 0.0, lags, ("airspeed",))


# In this order: a check is left out if it uses a channel that an earlier one has found wrong.
CHECKS: dict[str, Check] = {
    "roll": _rate("phi", "p", roll, ("q", "r", "theta")),
    "pitch": _rate("theta", "q", pitch, ("r", "phi")),
    "yaw": _rate("psi", "r", yaw, ("q", "phi", "theta")),
    "north": _position("north", "v_north"),
    "east": _position("east", "v_east"),
    "down": _position("down", "v_down"),
    "altitude": _position("altitude", "v_down"),
    "airspeed": _velocity(
        "airspeed", "the ground velocity less a steady wind", "airspeed", axis=0
    )._replace(
        channels=("airspeed", "psi", "v_north", "v_east"),
        slopes=EQUAL,
        noise=3.0,
        lags=KINEMATIC_LAGS,
        uses=(*EULER, *EARTH_VELOCITY),
    ),
    "sideslip": _velocity("beta", "V beta", "the lateral ground velocity less a wind", axis=1),
    "angle of attack": _velocity(
        "alpha", "V alpha", "the normal ground velocity less a wind", axis=2
    ),
    # without lags: gravity hardly varies, and the vertical force below tells them
    "gravity": _force(("az",), gravity)._replace(
        y="the integral of specific force", x="the change of velocity less gravity", lags=(0.0,)
    ),
    "forward force": _force(("theta", "psi", "v_north", "v_east"), partial(level_force, axis=0)),
    "sideward force": _force(("phi", "psi", "v_north", "v_east"), partial(level_force, axis=1)),
    "vertical force": _force(("v_down", "az"), partial(level_force, axis=2)),
    "lift": _effect("az", ("alpha", "q", "elevator"), NEGATIVE),
    "side force": _effect("ay", ("beta", "p", "r", "aileron", "rudder"), NEGATIVE),
    "roll moment": _effect("p", ("aileron", "beta", "p", "r", "rudder"), POSITIVE),
    "pitch moment": _effect("q", ("elevator", "alpha", "q"), NEGATIVE),
    "yaw moment": _effect("r", ("rudder", "beta", "p", "r", "aileron"), NEGATIVE),
    "thrust": Check(
        ("throttle", "ax"), "ax", "throttle", thrust, POSITIVE, 0.01, (0.0,), ("airspeed", "az")
    ),
}

# Channels of the checks. Of the commanded ones a repeated value is a new sample.
COMMANDED = (*ALL_SURFACES, "throttle")
USED = sorted({*COMMANDED}.union(*((*check.channels, *check.uses) for check in CHECKS.values())))
# larger angles [rad] are in degrees
LARGEST_RADIANS = 2.1 * np.pi


# -- decisions


def find_contradictions(
    table: pd.DataFrame, settings: PhysicsSettings = DEFAULT
) -> list[Contradiction]:
    """Return the checks that the flights of a table contradict.

    All flights are judged together, and each of at least 30 s by itself if nothing is found in all.
    Raises ValueError if time does not increase within a flight.
    """
    contradictions = _of_flights(table, None, settings)
    flights = flight_rows(table["flight"]) if "flight" in table else {}
    if contradictions or len(flights) < 2:
        return contradictions
    time = table["time"].to_numpy(float)
    for name, rows in flights.items():
        if np.ptp(time[rows]) >= settings.long_flight:
            contradictions += _of_flights(table.iloc[rows], name, settings)
    return contradictions


def _of_flights(
    table: pd.DataFrame, flight: object, settings: PhysicsSettings
) -> list[Contradiction]:
    """Return the contradictions of all rows of a table."""
    signals = flight_signals(table, settings)
    contradictions: list[Contradiction] = []
    confirmed: set[str] = set()
    for name, check in CHECKS.items():
        if set(signals.channels).issuperset(check.channels + check.uses):
            contradiction, agrees = _judged(name, check, signals)
            if contradiction is not None:
                contradictions.append(contradiction._replace(flight=flight))
            elif agrees:
                confirmed.update(check.channels)
    has_elevons = {*ELEVONS} <= {*table.columns}
    results = []
    for reduced in _with_suspects(contradictions, confirmed):
        is_mixed = has_elevons and reduced.channels[0] in MIXED
        channels = (*ELEVONS, *reduced.channels[1:]) if is_mixed else reduced.channels
        results.append(reduced._replace(channels=channels))
    return results


def _with_suspects(contradictions: list[Contradiction], confirmed: set[str]) -> list[Contradiction]:
    """Return contradictions with only the channels that may be wrong, without those that follow from others.

    No other check of equal signals confirms these channels; of several, the most often contradicted
    ones remain.
    """
    counts = Counter(name for contradiction in contradictions for name in contradiction.channels)
    doubtful: set[str] = set()
    remaining = []
    for contradiction in contradictions:
        names = contradiction.channels
        # of two signals with a lag either may be late
        if contradiction.quantity == "slope" and not confirmed.issuperset(names):
            names = tuple(name for name in names if name not in confirmed)
        most = max(counts[name] for name in names)
        suspects = tuple(name for name in names if counts[name] == most)
        follows = doubtful.intersection(CHECKS[contradiction.check].uses)
        if not follows and not doubtful.issuperset(suspects):
            doubtful.update(suspects)
            remaining.append(contradiction._replace(channels=suspects))
    return remaining


def _judged(name: str, check: Check, signals: Signals) -> tuple[Contradiction | None, bool]:
    """Return the contradiction of a check, None if there is none, and whether its signals are equal.

    Signals are equal if they are at the best lag. A sign is wrong if it is so at all lags that
    explain y about as well as the best one. Under feedback a late servo turns the sign at lag zero.
    """
    settings = signals.settings
    slopes = slopes_by_lag(check, signals)
    if not slopes:
        return None, False
    best = max(slopes.values(), key=lambda slope: slope.explained)
    if best.size <= check.noise or best.n_effective < settings.least_samples:
        return None, False
    least, most = check.slopes
    if check.slopes == EQUAL:
        margin = min(best.value - least, most - best.value)
        if margin > settings.least_t * best.std:
            return _late(name, check, slopes, settings)
        # the error of x attenuates the slope (Fuller 1987, section 1.1)
        least *= 1 - (check.noise / best.size) ** 2
        slope = slopes[0.0]
    else:
        enough = settings.possible_lag * best.explained
        possible = [slope for slope in slopes.values() if slope.explained >= enough]
        slope = min(possible, key=lambda slope: abs(slope.t(least, most)))
    is_weak = check.slopes != EQUAL and abs(slope.correlation) < settings.least_correlation
    t = slope.t(least, most)
    if is_weak or abs(t) < settings.least_t:
        return None, False
    return _contradiction(name, check, "slope", slope, t), False


def _late(
    name: str, check: Check, slopes: dict[float, Slope], settings: PhysicsSettings
) -> tuple[Contradiction | None, bool]:
    """Return a contradiction if the best lag is longer than usual, by a likelihood ratio."""
    lag, best = max(slopes.items(), key=lambda item: item[1].explained)
    usual = max(slopes[late].explained for late in slopes if abs(late) <= settings.usual_lag)
    # t^2 = n log of the ratio of unexplained variances
    t = np.sqrt(best.n_effective * np.log((1 + best.explained) / (1 + usual)))
    if abs(lag) <= settings.usual_lag or t < settings.least_t:
        return None, True
    spacing = KINEMATIC_LAGS[-1] - KINEMATIC_LAGS[-2]
    late = best._replace(value=lag, std=spacing / np.sqrt(12))
    return _contradiction(name, check, "lag", late, float(t)), False


def _contradiction(name: str, check: Check, quantity: str, slope: Slope, t: float) -> Contradiction:
    """Return the record of a contradiction."""
    return Contradiction(
        None,
        name,
        check.channels,
        quantity,
        slope.value,
        slope.std,
        t,
        slope.correlation,
        slope.n_effective,
    )


def slopes_by_lag(check: Check, signals: Signals) -> dict[float, Slope]:
    """Return the slopes at the lags of a check that the rows determine."""
    y, x, others = check.regression(signals)
    slopes: dict[float, Slope] = {}
    for lag in check.lags:
        regression = Regression(y, signals.ahead(x, -lag), others)
        slope = estimated_slope(regression, signals.settings)
        if slope is not None:
            slopes[lag] = slope
    return slopes


def estimated_slope(regression: Regression, settings: PhysicsSettings = DEFAULT) -> Slope | None:
    """Return the slope of y over x beside the other regressors, None if undetermined by the rows."""
    Z = np.column_stack([*regression.others, regression.x, regression.y])
    Z = Z[np.isfinite(Z).all(axis=1)]
    if len(Z) < settings.least_rows:
        return None
    scale = np.sqrt(np.mean(Z[:, :-2] ** 2, axis=0))
    others = Z[:, :-2][:, scale > 0] / scale[scale > 0]
    xy = Z[:, -2:]
    if others.size:
        xy = xy - others @ np.linalg.lstsq(others, xy, rcond=1e-8)[0]
    x, y = xy.T
    x_size, y_size = np.linalg.norm(xy, axis=0)
    if not (x_size > 1e-3 * np.linalg.norm(Z[:, -2]) and y_size > 0):
        return None
    slope = x @ y / x_size**2
    products = x * (y - slope * x)
    tau = autocorrelation_time(products)
    return Slope(
        value=float(slope),
        std=float(np.sqrt(tau) * np.linalg.norm(products) / x_size**2),
        correlation=float(x @ y / (x_size * y_size)),
        n_effective=len(x) / tau,
        size=float(x_size / np.sqrt(len(x))),
    )


# -- signals of a table


def flight_signals(table: pd.DataFrame, settings: PhysicsSettings = DEFAULT) -> Signals:
    """Return the channels of a flight table at about 20 Hz, without the rows on the ground."""
    time = table["time"].to_numpy(float)
    segments = flight_segments(time, table.get("flight"))
    runs = [run for run in segments if run.stop - run.start > 1]
    if not runs:
        return Signals({}, np.empty(0, int), 1.0, settings)
    usual = np.median(np.concatenate([np.diff(time[run]) for run in runs]))
    step = float(usual) * max(1, int(1 / usual // settings.rate))
    clocks = [_block_clock(time[run], step) for run in runs]
    segment = np.repeat(np.arange(len(runs)), [len(clock) for clock in clocks])
    channels = {}
    for name in USED:
        if name in table and pd.api.types.is_numeric_dtype(table[name]):
            values = table[name].to_numpy(float, na_value=np.nan)
            parts = []
            for run, clock in zip(runs, clocks, strict=True):
                parts.append(_averaged(name, time[run], values[run], clock))
            channels[name] = np.concatenate(parts)
    if set(ELEVONS) <= channels.keys():
        left, right = (channels[name] for name in ELEVONS)
        channels["elevator"] = (left + right) / 2
        channels["aileron"] = (left - right) / 2
    channels = {name: values for name, values in channels.items() if np.isfinite(values).any()}
    if "airspeed" in channels:
        airspeed = channels["airspeed"]
        on_ground = airspeed < settings.flying * np.nanmedian(airspeed)
        channels = {name: np.where(on_ground, np.nan, values) for name, values in channels.items()}
    return Signals(channels, segment, step, settings)


def _block_clock(time: Vector, step: float) -> Matrix:
    """Return the times of whole blocks (n, k) of ``step`` [s] each, k the samples of a block at the run's own rate."""
    size = max(1, round(step / np.median(np.diff(time))))
    spacing = step / size
    # the tolerance is of rounded clocks
    n = 1 + int((time[-1] - time[0]) / spacing + 1e-3)
    points = time[0] + spacing * np.arange(n // size * size)
    return np.minimum(points, time[-1]).reshape(-1, size)


def _averaged(name: str, time: Vector, values: Vector, clock: Matrix) -> Vector:
    """Return means over the blocks of a clock (n, k), linear between samples.

    A sensor that repeats its value holds it: only the first is a sample, as the others are late.
    """
    rows = np.flatnonzero(np.isfinite(values))
    if rows.size:
        if name not in COMMANDED:
            is_first = np.diff(values[rows], prepend=np.nan) != 0
            is_first[-1] = True
            rows = rows[is_first]
        samples = values[rows]
        if name in EULER:
            period = 360.0 if np.abs(samples).max() > LARGEST_RADIANS else 2 * np.pi
            samples = np.unwrap(samples, period=period)
        values = np.interp(clock, time[rows], samples, left=np.nan, right=np.nan)
        return values.mean(axis=1)
    return np.full(len(clock), np.nan)
