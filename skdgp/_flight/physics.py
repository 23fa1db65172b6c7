"""Checks of physics: relations between channels that hold in every flight, and the flights that contradict them.

A check is a regression of one signal y on another, x. Kinematics make both equal, so the slope is
1; or aerodynamics give its sign: lift grows with alpha, a positive aileron rolls right. Other
regressors, such as an intercept, a steady wind and further effects, are removed from both signals
first (Frisch & Waugh, 1933). With the residual e, the slope and its standard deviation are

    slope = x.y / x.x,   e = y - slope x,   std = sqrt(tau sum (x e)^2) / x.x.

Neighbouring samples are dependent: n of them are worth n / tau, where tau is the autocorrelation
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
    # standard deviations by which a slope is outside of its admissible interval
    least_t: float = 5.0
    # weaker effects of a wrong sign come from feedback, lags and gusts as well
    least_correlation: float = 0.3
    # lags that are no contradiction [s]: LagCorrector corrects them
    usual_lags: tuple[float, float] = (-0.3, 0.3)
    # lags that are tried where signals are not equal [s]
    lags: tuple[float, ...] = (-1.0, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 1.0)
    # lags of the surfaces [s], > 0 where logged late: servos, and commands
    surface_lags: tuple[float, ...] = (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1)
    # least ratio of explained to unexplained variance of a possible lag, over the best lag's
    possible_lag: float = 1 / 3
    # flights shorter than this [s] are judged together with others only
    long_flight: float = 30.0


DEFAULT = PhysicsSettings()


class Slope(NamedTuple):
    """A slope, its standard deviation, the partial correlation, and the effective number of samples."""

    value: float
    std: float
    correlation: float
    n_effective: float
    # root mean square of x without the other regressors
    size: float

    @property
    def explained(self) -> float:
        """Ratio of explained to unexplained variance."""
        return self.correlation**2 / max(1 - self.correlation**2, 1e-12)

    def beyond(self, least: float, most: float) -> float:
        """Return how far the slope is outside of an interval, in standard deviations, 0 inside."""
        std = max(self.std, 1e-9 * abs(self.value))
        if self.value < least:
            return (self.value - least) / std
        return max(self.value - most, 0.0) / std


class Contradiction(NamedTuple):
    """A check that flights contradict, and its numbers. ``flight`` is None for all flights together."""

    flight: object
    check: str
    # channels that may be wrong
    channels: tuple[str, ...]
    # "slope", or "lag" [s], of which ``slope`` is the value
    quantity: str
    slope: float
    std: float
    # distance of the slope from the admissible ones, in standard deviations
    t: float
    correlation: float
    n_effective: float

    @property
    def message(self) -> str:
        """One sentence of the channels and the numbers."""
        check = CHECKS_BY_NAME[self.check]
        names = " or ".join(self.channels)
        numbers = (
            f"(t = {self.t:.1f}, correlation {self.correlation:.2f}, "
            f"{self.n_effective:.0f} effective samples)"
        )
        if self.quantity == "lag":
            direction = "late" if self.slope > 0 else "early"
            return (
                f"{names} is probably wrong: {check.y} is {abs(self.slope):.2f} ± {self.std:.2f} s "
                f"{direction} against {check.x} {numbers}"
            )
        return (
            f"{names} is probably wrong: the slope of {check.y} over {check.x} is "
            f"{self.slope:.3g} ± {self.std:.2g}, but expected {check.expected} {numbers}"
            f"{usual_cause(self.slope, check)}"
        )

    def __str__(self) -> str:
        return self.message if self.flight is None else f"flight {self.flight}: {self.message}"


@dataclass(frozen=True)
class Signals:
    """Channels of flights at one rate, and the segment of each row. A missing value is NaN."""

    channels: dict[str, Vector]
    segment: Array
    step: float
    settings: PhysicsSettings = DEFAULT

    def __getitem__(self, name: str) -> Vector:
        return self.channels[name]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def vector(self, names: tuple[str, ...]) -> Matrix:
        """Return channels as vectors (n, k)."""
        return np.column_stack([self[name] for name in names])

    @property
    def intercept(self) -> Vector:
        """Ones (n,)."""
        return np.ones(len(self.segment))

    @property
    def rotation(self) -> Array:
        """Rotation matrices from body to earth axes (n, 3, 3)."""
        return euler_to_matrix(self["phi"], self["theta"], self["psi"])

    def change(self, values: Array, seconds: float) -> Array:
        """Return the changes of values (n, ...) over the windows that begin at each row, NaN at a segment's end."""
        length = max(round(seconds / self.step), 1)
        inside = self.segment[length:] == self.segment[:-length]
        change = np.full(values.shape, np.nan)
        change[:-length][inside] = (values[length:] - values[:-length])[inside]
        return change

    def integral(self, values: Array, seconds: float) -> Array:
        """Return the integrals over these windows by the trapezoidal rule, NaN where a value is missing."""
        missing = ~np.isfinite(values)
        known = np.where(missing, 0.0, values)
        total = np.cumsum(known, axis=0) - known / 2
        integral = self.step * self.change(total, seconds)
        n_missing = self.change(np.cumsum(missing, axis=0, dtype=float), seconds)
        integral[missing | (n_missing > 0)] = np.nan
        return integral

    def mean(self, values: Array, seconds: float) -> Array:
        """Return the means over these windows."""
        return self.integral(values, seconds) / seconds

    def ahead(self, values: Vector, seconds: float) -> Vector:
        """Return the value of each row ``seconds`` later, NaN beyond its segment."""
        rows = np.arange(len(values))
        place = rows + seconds / self.step
        ahead = np.interp(place, rows, values, left=np.nan, right=np.nan)
        for end in (np.floor(place), np.ceil(place)):
            row = np.clip(end, 0, len(rows) - 1).astype(int)
            ahead[self.segment[row] != self.segment] = np.nan
        return ahead

    def rate_of_change(self, values: Vector) -> Vector:
        """Return the rate of change over a quarter of a second to either side."""
        side = max(0.25, self.step)
        return (self.ahead(values, side) - self.ahead(values, -side)) / (2 * side)


class Regression(NamedTuple):
    """A response y, the regressor x whose slope is judged, and the other regressors, (n,) each."""

    y: Vector
    x: Vector
    others: list[Vector]


# -- kinematics: equal signals


def roll(flight: Signals) -> Regression:
    """Return the terms of phi_dot = p + (q sin phi + r cos phi) tan theta."""
    phi = flight["phi"]
    window = flight.settings.kinematic_window
    turn = flight["q"] * np.sin(phi) + flight["r"] * np.cos(phi)
    coupling = flight.integral(turn * np.tan(flight["theta"]), window)
    y = flight.change(phi, window) - coupling
    x = flight.integral(flight["p"], window)
    return Regression(y, x, [flight.intercept])


def pitch(flight: Signals) -> Regression:
    """Return the terms of theta_dot = q cos phi - r sin phi."""
    phi = flight["phi"]
    window = flight.settings.kinematic_window
    coupling = flight.integral(flight["r"] * np.sin(phi), window)
    y = flight.change(flight["theta"], window) + coupling
    x = flight.integral(flight["q"] * np.cos(phi), window)
    return Regression(y, x, [flight.intercept])


def yaw(flight: Signals) -> Regression:
    """Return the terms of psi_dot = (q sin phi + r cos phi) / cos theta."""
    phi = flight["phi"]
    cosine = np.cos(flight["theta"])
    window = flight.settings.kinematic_window
    coupling = flight.integral(flight["q"] * np.sin(phi) / cosine, window)
    y = flight.change(flight["psi"], window) - coupling
    x = flight.integral(flight["r"] * np.cos(phi) / cosine, window)
    return Regression(y, x, [flight.intercept])


def position(flight: Signals, name: str, velocity: str, sign: float = 1.0) -> Regression:
    """Return the change of a coordinate and the integral of its velocity."""
    window = flight.settings.kinematic_window
    y = sign * flight.change(flight[name], window)
    x = flight.integral(flight[velocity], window)
    return Regression(y, x, [flight.intercept])


def relative_velocity(flight: Signals, axis: int) -> Regression:
    """Return the terms of a component of R^T v_ground = v_air + R^T wind, at a steady horizontal wind.

    Along x the air velocity is V, across it about V beta and V alpha. Gusts move these only, so
    they are the response there.
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
    """Return both sides of v_dot - g = R f, means over windows, along axes forward, right and down.

    Forward and right are level, by the heading at the middle of the window.
    """
    window = flight.settings.kinematic_window
    acceleration = flight.change(flight.vector(EARTH_VELOCITY), window) / window
    force = np.einsum("nij,nj->ni", flight.rotation, flight.vector(SPECIFIC_FORCE))
    mean_force = flight.mean(force, window)
    if axis == 2:
        return Regression(acceleration[:, 2], mean_force[:, 2], [flight.intercept])
    heading = flight.ahead(flight["psi"], window / 2) + axis * np.pi / 2
    y = np.cos(heading) * acceleration[:, 0] + np.sin(heading) * acceleration[:, 1]
    x = np.cos(heading) * mean_force[:, 0] + np.sin(heading) * mean_force[:, 1]
    return Regression(y, x, [flight.intercept])


def body_force(flight: Signals, axis: int) -> Regression:
    """Return both sides of R^T (v_dot - g) = f along a body axis, R of v_dot at the middle of the window."""
    window = flight.settings.kinematic_window
    acceleration = flight.change(flight.vector(EARTH_VELOCITY), window) / window
    rotation = flight.rotation
    y = -STANDARD_GRAVITY * flight.mean(rotation[:, 2, axis], window)
    for k in range(3):
        y += flight.ahead(rotation[:, k, axis], window / 2) * acceleration[:, k]
    x = flight.mean(flight[SPECIFIC_FORCE[axis]], window)
    return Regression(y, x, [flight.intercept])


def gravity(flight: Signals) -> Regression:
    """Return az and its value by motion, which is near -g: without an intercept."""
    needed, az, _ = body_force(flight, axis=2)
    return Regression(az, needed, [])


# -- aerodynamics: slopes of a known sign


def aerodynamic_response(flight: Signals, response: str, effects: tuple[str, ...]) -> Regression:
    """Return a rate or specific force, and its effects.

    Responses over V^2 are linear in angles, rates over V and surfaces. A specific force stands for an
    angle that was not measured.
    """
    airspeed = flight["airspeed"]
    window = flight.settings.response_window
    columns = []
    for name in effects:
        stand_in = STAND_INS.get(name, "")
        if name in RATES and name in flight:
            columns.append(airspeed * flight[name])
        elif name in flight:
            columns.append(airspeed**2 * flight[name])
        elif stand_in in flight:
            columns.append(flight[stand_in])
    grows = flight.change if response in RATES else flight.integral
    x, *others = (flight.integral(column, window) for column in [*columns, airspeed**2])
    return Regression(grows(flight[response], window), x, others)


def drag_terms(flight: Signals) -> list[Vector]:
    """Return means of V^2 and of lift over V, squared: parasitic and induced drag."""
    window = flight.settings.kinematic_window
    airspeed = flight["airspeed"]
    terms = [flight.intercept, flight.mean(airspeed**2, window)]
    if "az" in flight:
        terms.append(flight.mean((flight["az"] / airspeed) ** 2, window))
    return terms


def thrust(flight: Signals) -> Regression:
    """Return the terms of ax = thrust - drag."""
    window = flight.settings.kinematic_window
    others = drag_terms(flight)
    if "az" in flight:
        others.append(flight.mean(flight["az"], window))
    y = flight.mean(flight["ax"], window)
    return Regression(y, flight.mean(flight["throttle"], window), others)


def energy(flight: Signals) -> Regression:
    """Return the terms of V_dot = g v_down / V + thrust - drag, times the mean airspeed."""
    window = flight.settings.kinematic_window
    others = [*drag_terms(flight), flight.mean(flight["throttle"], window)]
    y = flight.change(flight["airspeed"], window)
    return Regression(y, flight.mean(flight["v_down"], window), others)


# -- the table of checks

EQUAL = (1 / 1.5, 1.5)
# gusts move the air past the aircraft, and the aircraft follows them
GUSTY = (-0.5, 1.5)
POSITIVE = (0.0, np.inf)
NEGATIVE = (-np.inf, 0.0)
# specific forces that grow with the angles
STAND_INS = {"alpha": "az", "beta": "ay"}


class Check(NamedTuple):
    """A relation: the compared channels, others that it uses, its signals, and the admissible slopes."""

    name: str
    channels: tuple[str, ...]
    uses: tuple[str, ...]
    y: str
    x: str
    regression: Callable[[Signals], Regression]
    slopes: tuple[float, float]
    # error of x [unit of x]: the slope over a signal of no larger root mean square decides nothing
    noise: float = 0.0

    @property
    def is_sign(self) -> bool:
        """Whether only the sign of the slope is known."""
        return self.slopes in (POSITIVE, NEGATIVE)

    @property
    def expected(self) -> str:
        """The slope that is expected."""
        if self.slopes == POSITIVE:
            return "a positive one"
        return "a negative one" if self.slopes == NEGATIVE else "1"


def _rate_check(name, angle, rate, uses, regression) -> Check:
    y, x = f"the change of {angle}", f"the integral of {rate}"
    return Check(name, (angle, rate), uses, y, x, regression, EQUAL, noise=0.02)


def _position_check(name: str, velocity: str, sign: float = 1.0) -> Check:
    y, x = f"the change of {name}", f"the integral of {velocity}"
    regression = partial(position, name=name, velocity=velocity, sign=sign)
    return Check(name, (name, velocity), (), y, x, regression, EQUAL, noise=0.3)


def _response_check(name, response, effects, y, slopes) -> Check:
    regression = partial(aerodynamic_response, response=response, effects=effects)
    channels = (effects[0], response)
    return Check(name, channels, ("airspeed",), y, effects[0], regression, slopes)


HORIZONTAL_VELOCITY = EARTH_VELOCITY[:2]
MOTION = (*EULER, *EARTH_VELOCITY)
LATERAL_EFFECTS = ("beta", "p", "r", "aileron", "rudder")

# In this order: a check is left out if it uses a channel that an earlier one has found wrong.
CHECKS = (
    _rate_check("roll", "phi", "p", ("q", "r", "theta"), roll),
    _rate_check("pitch", "theta", "q", ("r", "phi"), pitch),
    _rate_check("yaw", "psi", "r", ("q", "phi", "theta"), yaw),
    _position_check("north", "v_north"),
    _position_check("east", "v_east"),
    _position_check("down", "v_down"),
    _position_check("altitude", "v_down", sign=-1.0),
    Check(
        "airspeed", ("airspeed", "psi", *HORIZONTAL_VELOCITY), MOTION,
        "the ground velocity less a steady wind", "the airspeed",
        partial(relative_velocity, axis=0), EQUAL, noise=3.0,
    ),
    Check(
        "sideslip", ("beta",), ("airspeed", *MOTION),
        "V beta", "the ground velocity along y less a steady wind",
        partial(relative_velocity, axis=1), GUSTY, noise=0.5,
    ),
    Check(
        "angle of attack", ("alpha",), ("airspeed", *MOTION),
        "V alpha", "the ground velocity along z less a steady wind",
        partial(relative_velocity, axis=2), GUSTY, noise=0.5,
    ),
    Check(
        "gravity", ("az",), MOTION,
        "az", "the acceleration less gravity along z",
        gravity, EQUAL, noise=0.5,
    ),
    Check(
        "forward force", ("theta", "psi", *HORIZONTAL_VELOCITY), (*MOTION, *SPECIFIC_FORCE),
        "the forward acceleration", "the specific force forward in level axes",
        partial(level_force, axis=0), EQUAL, noise=0.5,
    ),
    Check(
        "sideward force", ("phi", "psi", *HORIZONTAL_VELOCITY), (*MOTION, *SPECIFIC_FORCE),
        "the acceleration to the right", "the specific force to the right in level axes",
        partial(level_force, axis=1), EQUAL, noise=0.5,
    ),
    Check(
        "vertical force", ("v_down", "az"), (*MOTION, *SPECIFIC_FORCE),
        "the acceleration downward", "the specific force downward",
        partial(level_force, axis=2), EQUAL, noise=0.5,
    ),
    Check(
        "longitudinal force", ("ax",), MOTION,
        "the acceleration less gravity along x", "ax",
        partial(body_force, axis=0), EQUAL, noise=0.5,
    ),
    Check(
        "lateral force", ("ay",), MOTION,
        "the acceleration less gravity along y", "ay",
        partial(body_force, axis=1), EQUAL, noise=0.5,
    ),
    _response_check("lift", "az", ("alpha", "q", "elevator"), "az", NEGATIVE),
    _response_check("side force", "ay", LATERAL_EFFECTS, "ay", NEGATIVE),
    _response_check(
        "roll moment", "p", ("aileron", "beta", "p", "r", "rudder"), "the change of p", POSITIVE
    ),
    _response_check(
        "pitch moment", "q", ("elevator", "alpha", "q"), "the change of q", NEGATIVE
    ),
    _response_check(
        "yaw moment", "r", ("rudder", "beta", "p", "r", "aileron"), "the change of r", NEGATIVE
    ),
    Check(
        "thrust", ("throttle", "ax"), ("airspeed",),
        "ax", "the throttle", thrust, POSITIVE, noise=0.01,
    ),
    Check(
        "energy", ("v_down", "airspeed"), ("throttle",),
        "the change of airspeed", "v_down", energy, POSITIVE, noise=0.1,
    ),
)  # fmt: skip
CHECKS_BY_NAME: dict[str, Check] = {check.name: check for check in CHECKS}

# Channels of the checks. Of the commanded ones a repeated value is a new sample.
COMMANDED = (*ALL_SURFACES, "throttle")
USED = sorted({name for check in CHECKS for name in (*check.channels, *check.uses)})
USED += [*ELEVONS, *(name for name in COMMANDED if name not in USED)]
# larger angles [rad] are in degrees
LARGEST_RADIANS = 2.1 * np.pi

# Slopes of usual faults, or their inverse
USUAL_CAUSES = {
    "a wrong sign": -1.0,
    "degrees": 180 / np.pi,
    "g": STANDARD_GRAVITY,
    "km/h": 3.6,
    "feet": 1 / 0.3048,
    "knots": 1 / 0.514444,
}


def usual_cause(slope: float, check: Check) -> str:
    """Return the fault that usually has a slope of two signals that should be equal; empty if there is none."""
    if check.slopes == EQUAL:
        for cause, factor in USUAL_CAUSES.items():
            ratio = slope / factor
            if 0.9 < ratio < 1.1 or 0.9 < ratio * factor**2 < 1.1:
                return f", as by {cause}"
    return ""


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
    if signals.segment.size:
        with np.errstate(all="ignore"):
            for check in CHECKS:
                if not all(name in signals for name in (*check.channels, *check.uses)):
                    continue
                contradiction, agrees = _judged(check, signals)
                if contradiction is not None:
                    contradictions.append(contradiction._replace(flight=flight))
                elif agrees:
                    confirmed.update(check.channels)
    suspected = _with_suspects(contradictions, confirmed)
    return [found._replace(channels=_measured(found.channels, table)) for found in suspected]


def _with_suspects(contradictions: list[Contradiction], confirmed: set[str]) -> list[Contradiction]:
    """Return contradictions with only the channels that may be wrong, without those that follow from others.

    These are channels that no other check of equal signals confirms, and of them those that most
    checks contradict.
    """
    counts = Counter(name for found in contradictions for name in found.channels)
    doubtful: set[str] = set()
    remaining = []
    for found in contradictions:
        open_names = found.channels
        # of two signals with a lag either may be late
        if found.quantity == "slope" and not confirmed.issuperset(open_names):
            open_names = tuple(name for name in open_names if name not in confirmed)
        most = max(counts[name] for name in open_names)
        suspects = tuple(name for name in open_names if counts[name] == most)
        follows = doubtful.intersection(CHECKS_BY_NAME[found.check].uses)
        if not follows and not doubtful.issuperset(suspects):
            doubtful.update(suspects)
            remaining.append(found._replace(channels=suspects))
    return remaining


def _measured(names: tuple[str, ...], table: pd.DataFrame) -> tuple[str, ...]:
    """Return names of channels, of which elevons stand for elevator and aileron."""
    measured: list[str] = []
    for name in names:
        is_mixed = name in MIXED and set(ELEVONS) <= set(table.columns)
        measured += ELEVONS if is_mixed else [name]
    return tuple(measured)


def _judged(check: Check, signals: Signals) -> tuple[Contradiction | None, bool]:
    """Return the contradiction of a check, None if there is none, and whether signals are equal for sure."""
    settings = signals.settings
    if check.channels[0] in ALL_SURFACES:
        slopes = _slopes_at_possible_lags(check, signals)
        slope = min(slopes, key=lambda slope: abs(slope.beyond(*check.slopes)), default=None)
        return _contradiction(check, slope, settings), False
    regression = check.regression(signals)
    if check.slopes != EQUAL:
        return _contradiction(check, estimated_slope(regression, settings), settings), False
    slope, lag = _slope_and_lag(regression, signals, 0.0)
    if slope is None or lag is None:
        return None, False
    if not _agrees(slope, settings):
        for late in settings.lags:
            other_slope, other_lag = _slope_and_lag(regression, signals, late)
            if other_slope is None or other_lag is None or not _agrees(other_slope, settings):
                continue
            if other_slope.explained > slope.explained:
                slope, lag = other_slope, other_lag
    agrees = _agrees(slope, settings)
    is_late = abs(lag.beyond(*settings.usual_lags)) > settings.least_t
    if agrees and is_late and slope.size > check.noise:
        return _record(check, "lag", lag, settings.usual_lags), False
    return _contradiction(check, slope, settings), agrees


def _slope_and_lag(
    regression: Regression, signals: Signals, late: float
) -> tuple[Slope | None, Slope | None]:
    """Return the slope of y over x, and the lag of y [s], near a lag.

    Near it, y(t + late) = x(t - (lag - late)) = x - (lag - late) x_dot.
    """
    y = signals.ahead(regression.y, late)
    x = regression.x
    minus_x_dot = -signals.rate_of_change(x)
    others = regression.others
    slope = estimated_slope(Regression(y, x, [*others, minus_x_dot]), signals.settings)
    lag = estimated_slope(Regression(y, minus_x_dot, [*others, x]), signals.settings)
    if lag is not None:
        lag = lag._replace(value=lag.value + late)
    return slope, lag


def _agrees(slope: Slope, settings: PhysicsSettings) -> bool:
    """Return whether a slope is surely near 1."""
    least, most = EQUAL
    margin = min(slope.value - least, most - slope.value)
    return margin > settings.least_t * slope.std


def _contradiction(
    check: Check, slope: Slope | None, settings: PhysicsSettings
) -> Contradiction | None:
    """Return the contradiction of a slope outside of the admissible interval, None if there is none."""
    if slope is None or slope.size <= check.noise or slope.n_effective < settings.least_samples:
        return None
    least, most = check.slopes
    # The error of x attenuates the slope (Fuller 1987, section 1.1)
    if least > 0:
        least *= 1 - (check.noise / slope.size) ** 2
    is_weak = check.is_sign and abs(slope.correlation) < settings.least_correlation
    if is_weak or abs(slope.beyond(least, most)) < settings.least_t:
        return None
    return _record(check, "slope", slope, (least, most))


def _record(
    check: Check, quantity: str, slope: Slope, admissible: tuple[float, float]
) -> Contradiction:
    return Contradiction(
        flight=None,
        check=check.name,
        channels=check.channels,
        quantity=quantity,
        slope=slope.value,
        std=slope.std,
        t=slope.beyond(*admissible),
        correlation=slope.correlation,
        n_effective=slope.n_effective,
    )


def _slopes_at_possible_lags(check: Check, signals: Signals) -> list[Slope]:
    """Return the slopes at the lags of the surfaces that explain the response about as well as the best one.

    Under feedback a servo that is late turns the sign of the slope at lag zero.
    """
    slopes = []
    for lag in signals.settings.surface_lags:
        channels = dict(signals.channels)
        for name in ALL_SURFACES:
            if name in signals:
                channels[name] = signals.ahead(signals[name], lag)
        shifted = Signals(channels, signals.segment, signals.step, signals.settings)
        slope = estimated_slope(check.regression(shifted), signals.settings)
        if slope is not None:
            slopes.append(slope)
    best = max((slope.explained for slope in slopes), default=0.0)
    least = signals.settings.possible_lag * best
    return [slope for slope in slopes if slope.explained >= least]


def estimated_slope(regression: Regression, settings: PhysicsSettings = DEFAULT) -> Slope | None:
    """Return the slope of y over x beside the other regressors, None where the rows do not tell it."""
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
    step = np.median(np.concatenate([np.diff(time[run]) for run in runs]))
    size = max(1, int(1 / step // settings.rate))
    segment = np.repeat(np.arange(len(runs)), [(run.stop - run.start) // size for run in runs])
    channels = {}
    for name in USED:
        if name in table and pd.api.types.is_numeric_dtype(table[name]):
            values = table[name].to_numpy(float, na_value=np.nan)
            parts = [_averaged(name, time[run], values[run], size) for run in runs]
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
    return Signals(channels, segment, size * float(step), settings)


def _averaged(name: str, time: Vector, values: Vector, size: int) -> Vector:
    """Return means of ``size`` rows each, linear between samples, without an incomplete block at the end.

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
        values = np.interp(time, time[rows], samples, left=np.nan, right=np.nan)
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size).mean(axis=1)
