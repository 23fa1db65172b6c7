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
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from skdgp._compute.findings import Code, Finding
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import (
    ALL_SURFACES,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    MIXED,
    RATES,
    SPECIFIC_FORCE,
    VANES,
    by_elevons,
)
from skdgp._flight.clock import median_step, n_rows
from skdgp._flight.frames import STANDARD_GRAVITY, euler_to_matrix
from skdgp._flight.tables import FlightTable


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
    # larger angles [rad] are in degrees
    largest_radians: float = 2.1 * np.pi
    # fewer rows, or fewer effective samples, decide nothing
    least_rows: int = 40
    least_samples: float = 10.0
    # least distance of a slope from its admissible interval, in standard deviations
    least_t: float = 5.0
    # the same of the reverse slope, which tells noise of x from a wrong scale, and its largest
    # standard deviation that tells anything (guesses)
    reverse_t: float = 1.5
    reverse_std: float = 0.5
    # least partial correlation of an effect of wrong sign: feedback, lags and gusts cause weaker
    # ones
    least_correlation: float = 0.3
    # a longer lag [s] is a contradiction: LagCorrector corrects 0.3 s, holds of slow GPS add to it
    usual_lag: float = 0.5
    # the same of the airspeed [s], and its least t: gusts reach it before the aircraft follows, which
    # makes lags up to 1.0 s (25 simulated flights); beyond, none had a t above zero, and 2 s had 3.7
    # to 10
    usual_airspeed_lag: float = 1.0
    least_airspeed_t: float = 4.0
    # least correlation at a lag that is a contradiction, whatever the slope (guess)
    lagged_correlation: float = 0.5
    # lags that are tried [s], > 0 where y is late against x
    kinematic_lags: tuple[float, ...] = (0.0, -1.0, -0.8, -0.6, -0.4, -0.2, 0.2, 0.4, 0.6, 0.8, 1.0)
    # further ones of the airspeed
    airspeed_lags: tuple[float, ...] = (-1.4, 1.4, -1.8, 1.8, -2.2, 2.2, -2.6, 2.6, -3.0, 3.0)
    # those of surfaces, whose servos are late
    surface_lags: tuple[float, ...] = (0.0, -0.1, -0.05, 0.05, 0.1, 0.15)
    # a lag is possible if the ratio of explained to unexplained variance is this fraction of the best
    possible_lag: float = 1 / 3
    # the same where the angle that a surface turns the aircraft to was not measured
    possible_lag_without_angle: float = 1 / 8
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
        squared = self.correlation**2
        return squared / max(1 - squared, 1e-12)

    def t(self, least: float, most: float) -> float:
        """Return how far the slope is outside of an interval, in standard deviations, 0 inside."""
        outside = self.value - np.clip(self.value, least, most)
        return outside / max(self.std, 1e-9 * abs(self.value))


@dataclass(frozen=True)
class Signals:
    """Channels of flights at one rate, and the segment of each row. A missing value is NaN."""

    channels: dict[str, Vector]
    segment: Indices
    step: float
    settings: PhysicsSettings = DEFAULT

    def __getitem__(self, name: str) -> Vector:
        return self.channels[name]

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    @property
    def rotation(self) -> Array:
        """Rotation matrices from body to earth axes (n, 3, 3)."""
        return euler_to_matrix(self["phi"], self["theta"], self["psi"])

    def with_channels(self, changed: dict[str, Vector]) -> Signals:
        """Return the signals with other channels."""
        return replace(self, channels=self.channels | changed)

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
        is_inside = self.segment[length:] == self.segment[:-length]
        difference = values[length:] - values[:-length]
        change = np.full(values.shape, np.nan)
        change[:-length][is_inside] = difference[is_inside]
        return change

    def integral(self, values: Array, seconds: float | None = None) -> Array:
        """Return the integrals over these windows by the trapezoidal rule, NaN where a value is missing."""
        is_missing = ~np.isfinite(values)
        filled = np.where(is_missing, 0.0, values)
        total = np.cumsum(filled, axis=0) - filled / 2
        integral = self.step * self.change(total, seconds)
        n_missing = self.change(np.cumsum(is_missing, axis=0, dtype=float), seconds)
        integral[is_missing | (n_missing > 0)] = np.nan
        return integral

    def integrated(self, angle: Vector, rate: Vector, *others: Vector) -> Regression:
        """Return the terms of d angle / dt = rate + others: the change, and the integrals of the rates."""
        y = self.change(angle)
        x = self.integral(rate)
        return Regression.with_intercept(y, x, *map(self.integral, others))

    def ahead(self, values: Vector, seconds: float) -> Vector:
        """Return the value of each row ``seconds`` later, NaN beyond its segment."""
        rows = np.arange(len(values))
        place = rows + seconds / self.step
        ahead = np.interp(place, rows, values, left=np.nan, right=np.nan)
        for end in (np.floor(place), np.ceil(place)):
            row = np.clip(end, 0, len(rows) - 1).astype(int)
            is_outside = self.segment[row] != self.segment
            ahead[is_outside] = np.nan
        return ahead


class Regression(NamedTuple):
    """A response y, the regressor x whose slope is judged, and the other regressors, (n,) each."""

    y: Vector
    x: Vector
    others: list[Vector]

    @classmethod
    def with_intercept(cls, y: Vector, x: Vector, *others: Vector) -> Regression:
        """Return the regression with an intercept and other regressors."""
        return cls(y, x, [np.ones(len(y)), *others])


# -- kinematics: equal signals


def roll(flight: Signals) -> Regression:
    """Return the terms of phi_dot = p + (q sin phi + r cos phi) tan theta."""
    phi = flight["phi"]
    by_pitch = flight["q"] * np.sin(phi)
    by_yaw = flight["r"] * np.cos(phi)
    return flight.integrated(phi, flight["p"], (by_pitch + by_yaw) * np.tan(flight["theta"]))


def pitch(flight: Signals) -> Regression:
    """Return the terms of theta_dot = q cos phi - r sin phi."""
    phi = flight["phi"]
    return flight.integrated(flight["theta"], flight["q"] * np.cos(phi), flight["r"] * np.sin(phi))


def yaw(flight: Signals) -> Regression:
    """Return the terms of psi_dot = (q sin phi + r cos phi) / cos theta."""
    phi = flight["phi"]
    cosine = np.cos(flight["theta"])
    coupling = flight["q"] * np.sin(phi) / cosine
    turn = flight["r"] * np.cos(phi) / cosine
    return flight.integrated(flight["psi"], turn, coupling)


def position(flight: Signals, name: str, velocity: str) -> Regression:
    """Return the change of a coordinate and the integral of its velocity."""
    sign = -1.0 if name == "altitude" else 1.0
    return flight.integrated(sign * flight[name], flight[velocity])


def relative_velocity(flight: Signals, axis: int) -> Regression:
    """Return the terms of a component of R^T v_ground = v_air + R^T wind, at a steady horizontal wind.

    Along x the air velocity is V, across it about V beta and V alpha. Gusts move these only, so they
    are the response there.
    """
    airspeed = flight["airspeed"]
    # of the axis, in earth axes
    direction = flight.rotation[:, :, axis]
    ground = np.sum(direction * flight.vector(EARTH_VELOCITY), axis=1)
    north, east, _ = direction.T
    if axis == 0:
        return Regression(ground, airspeed, [north, east])
    angle = flight["beta"] if axis == 1 else flight["alpha"]
    return Regression(airspeed * angle, ground, [north, east, airspeed])


def level_terms(flight: Signals, axis: int, force: Matrix) -> tuple[Vector, Vector]:
    """Return the change of velocity and the impulse of a force (n, 3), body axes, along forward, right or down.

    Forward and right are level, by the heading at the middle of the window.
    """
    change = flight.change(flight.vector(EARTH_VELOCITY))
    impulse = flight.integral(np.einsum("nij,nj->ni", flight.rotation, force))
    if axis == 2:
        return change[:, 2], impulse[:, 2]
    middle = flight.settings.kinematic_window / 2
    heading = flight.ahead(flight["psi"], middle) + axis * np.pi / 2
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    return np.sum(direction * change[:, :2], axis=1), np.sum(direction * impulse[:, :2], axis=1)


def level_force(flight: Signals, axis: int) -> Regression:
    """Return the terms of v_dot = R f + g along axes forward, right and down: changes and impulses."""
    return Regression.with_intercept(*level_terms(flight, axis, flight.vector(SPECIFIC_FORCE)))


def own_force(flight: Signals, axis: int) -> Regression:
    """Return the terms of a level component of v_dot = R f + g that one accelerometer has a part in.

    Its impulse is x, and y the change of velocity less the impulse of the others.
    """
    force = flight.vector(SPECIFIC_FORCE)
    own = np.zeros_like(force)
    own[:, axis] = force[:, axis]
    change, x = level_terms(flight, axis, own)
    _, others = level_terms(flight, axis, force - own)
    return Regression.with_intercept(change - others, x)


def horizontal_force(flight: Signals, axis: int, in_earth_axes: bool = False) -> Regression:
    """Return the terms of v_dot = R f along north or east, or of v_dot = f, as if f were in earth axes."""
    change = flight.change(flight.vector(EARTH_VELOCITY))
    force = flight.vector(SPECIFIC_FORCE)
    if not in_earth_axes:
        force = np.einsum("nij,nj->ni", flight.rotation, force)
    impulse = flight.integral(force)
    return Regression.with_intercept(change[:, axis], impulse[:, axis])


def gravity(flight: Signals) -> Regression:
    """Return the terms of (R f)_down = v_down_dot - g, without an intercept.

    The force is the response: without gravity in it, it hardly varies with x.
    """
    change, impulse = level_terms(flight, 2, flight.vector(SPECIFIC_FORCE))
    window = flight.step * flight.window_rows()
    return Regression(impulse, change - STANDARD_GRAVITY * window, [])


# -- aerodynamics: slopes of a known sign


def response(flight: Signals, name: str, effects: tuple[str, ...]) -> Regression:
    """Return a rate or specific force, and its effects.

    Responses over V^2 are linear in angles, rates over V and surfaces. Where an angle was not
    measured, all are changes from one window to the next, in which it hardly moves. A specific force
    would not stand for it: ahead of the centre of gravity it holds the angular acceleration.
    """
    window = flight.settings.response_window
    airspeed = flight["airspeed"]
    columns = []
    for effect in effects:
        if effect in RATES and effect in flight:
            columns.append(airspeed * flight[effect])
        elif effect in flight:
            columns.append(airspeed**2 * flight[effect])
    columns.append(airspeed**2)
    grows = flight.change if name in RATES else flight.integral
    signals = [grows(flight[name], window)]
    signals += [flight.integral(column, window) for column in columns]
    if any(effect in VANES and effect not in flight for effect in effects):
        signals = [flight.change(signal, window) for signal in signals]
    y, x, *others = signals
    return Regression(y, x, others)


def thrust(flight: Signals) -> Regression:
    """Return the terms of ax = thrust - parasitic and induced drag."""
    squared = flight["airspeed"] ** 2
    az = flight["az"]
    drags = [squared, az, az**2 / squared]
    y = flight.integral(flight["ax"])
    x = flight.integral(flight["throttle"])
    return Regression.with_intercept(y, x, *map(flight.integral, drags))


# -- the table of checks

Interval = tuple[float, float]
EQUAL: Interval = (1 / 1.5, 1.5)
# gusts move the air past the aircraft, which follows them
GUSTY: Interval = (-0.5, 1.5)
POSITIVE: Interval = (0.0, np.inf)
NEGATIVE: Interval = (-np.inf, 0.0)
NONE: Interval = (0.0, 0.0)
EXPECTED = {
    NONE: "0",
    EQUAL: "1",
    GUSTY: "0 to 1",
    POSITIVE: "a positive one",
    NEGATIVE: "a negative one",
}


@dataclass(frozen=True)
class Check:
    """A relation of y with x: the compared channels, its signals, and the admissible slopes."""

    channels: tuple[str, ...]
    y: str
    x: str
    regression: Callable[[Signals], Regression]
    slopes: Interval
    # other channels that it needs
    uses: tuple[str, ...]
    # error of x [unit of x]: a signal of no larger root mean square decides nothing
    noise: float = 0.0
    # lags that are tried [s]
    lags: tuple[float, ...] = (0.0,)
    # of a sign, a check that must fail too: accelerometers ahead of the centre of gravity feel the
    # yawing by beta, so the sign of ay alone tells nothing; of an exchange, the response by its own
    # channel, which must explain less
    witness: Check | None = None
    # x is of accelerometers, whose noise has no bound: engines shake them
    vibrates: bool = False
    # angle of the flow that the response depends on, if one
    angle: str | None = None
    # x holds gusts, which y follows
    gusts_lead: bool = False

    @property
    def needs(self) -> set[str]:
        """All channels of the check."""
        return {*self.channels, *self.uses}


def _integral(
    name: str, rate: str, regression: Callable, uses: tuple[str, ...] = (), noise: float = 0.008
) -> Check:
    y = f"the change of {name}"
    x = f"the integral of {rate}"
    return Check((name, rate), y, x, regression, EQUAL, uses, noise, DEFAULT.kinematic_lags)


def _position(name: str, velocity: str) -> Check:
    regression = partial(position, name=name, velocity=velocity)
    return _integral(name, velocity, regression, noise=0.3)


def _gust(name: str, y: str, x: str, axis: int) -> Check:
    regression = partial(relative_velocity, axis=axis)
    uses = (*EULER, *EARTH_VELOCITY, "airspeed")
    return Check((name,), y, x, regression, GUSTY, uses, noise=0.5)


def _force(channels: tuple[str, ...], axis: int) -> Check:
    y = "the change of velocity"
    x = "the integral of specific force and gravity"
    return Check(
        channels=channels,
        y=y,
        x=x,
        regression=partial(level_force, axis=axis),
        slopes=EQUAL,
        uses=FORCE_CHANNELS,
        noise=0.5,
        lags=DEFAULT.kinematic_lags,
        vibrates=True,
    )


def _effect(
    name: str,
    effects: tuple[str, ...],
    slopes: Interval,
    witness: tuple[str, Interval] | None = None,
) -> Check:
    y = f"the change of {name}" if name in RATES else name
    x = effects[0]
    regression = partial(response, name=name, effects=effects)
    lags = DEFAULT.surface_lags if x in ALL_SURFACES else (0.0,)
    uses = ("airspeed",)
    angle = next((effect for effect in effects if effect in VANES), None)
    check = Check((x, name), y, x, regression, slopes, uses, lags=lags, angle=angle)
    if witness is None:
        return check
    response_of_witness, slopes_of_witness = witness
    other = _effect(response_of_witness, effects, slopes_of_witness)
    return replace(check, uses=(*uses, response_of_witness), witness=other)


def _own_force(name: str, axis: int) -> Check:
    y = "the change of velocity less the other forces"
    x = f"the integral of {name}"
    regression = partial(own_force, axis=axis)
    lags = DEFAULT.kinematic_lags
    return Check((name,), y, x, regression, POSITIVE, FORCE_CHANNELS, 0.05, lags)


LATERAL_EFFECTS = ("p", "r", "aileron", "rudder")
FORCE_CHANNELS = (*EULER, *EARTH_VELOCITY, *SPECIFIC_FORCE)
PITCH = _integral("theta", "q", pitch, ("r", "phi"))
YAW = _integral("psi", "r", yaw, ("q", "phi", "theta"))
NORTH = _position("north", "v_north")
EAST = _position("east", "v_east")
# A check is left out if it uses a channel that a clearer one has found wrong.
CHECKS = (
    _integral("phi", "p", roll, ("q", "r", "theta")),
    PITCH,
    YAW,
    NORTH,
    EAST,
    _position("down", "v_down"),
    _position("altitude", "v_down"),
    Check(
        channels=("airspeed", "psi", "v_north", "v_east"),
        y="the ground velocity less a steady wind",
        x="airspeed",
        regression=partial(relative_velocity, axis=0),
        slopes=EQUAL,
        uses=(*EULER, *EARTH_VELOCITY),
        noise=3.0,
        lags=(*DEFAULT.kinematic_lags, *DEFAULT.airspeed_lags),
        gusts_lead=True,
    ),
    _gust("beta", "V beta", "the lateral ground velocity less a wind", axis=1),
    _gust("alpha", "V alpha", "the normal ground velocity less a wind", axis=2),
    # without lags: gravity hardly varies, and the vertical force below tells them
    Check(
        channels=("az",),
        y="the integral of specific force",
        x="the change of velocity less gravity",
        regression=gravity,
        slopes=EQUAL,
        uses=FORCE_CHANNELS,
        noise=0.5,
    ),
    _force(("theta", "psi", "v_north", "v_east", "ax", "az"), axis=0),
    _force(("phi", "psi", "v_north", "v_east", "ay", "az"), axis=1),
    _force(("v_down", "az"), axis=2),
    _own_force("ax", axis=0),
    _own_force("ay", axis=1),
    _effect("az", ("alpha", "q", "elevator"), NEGATIVE),
    _effect("ay", ("beta", *LATERAL_EFFECTS), NEGATIVE, witness=("r", POSITIVE)),
    _effect("p", ("aileron", "beta", "p", "r", "rudder"), POSITIVE),
    _effect("q", ("elevator", "alpha", "q"), NEGATIVE),
    _effect("r", ("rudder", "beta", "p", "r", "aileron"), NEGATIVE),
    Check(("throttle", "ax"), "ax", "throttle", thrust, POSITIVE, ("airspeed", "az"), 0.01),
)


def _crossed(responses: tuple[str, str], wrong: str, right: str, others: tuple[str, ...]) -> Check:
    """Return the check of the first response by the channel of another axis, beside its own one."""
    name, _ = responses
    check = _effect(name, (wrong, right, *others), NONE)
    proper = _effect(name, (right, wrong, *others), NONE)
    return replace(check, channels=(wrong, right), uses=(*responses, "airspeed"), witness=proper)


def _swapped(check: Check, first: str, second: str) -> Check:
    """Return an integral as if two channels were exchanged, beside the one as they are."""

    def regression(flight: Signals) -> Regression:
        exchanged = {first: flight[second], second: flight[first]}
        return check.regression(flight.with_channels(exchanged))

    response, own = check.channels
    other = second if own == first else first
    x = f"the integral of {other}"
    uses = (response, *check.uses)
    return replace(
        check,
        channels=(own, other),
        x=x,
        uses=uses,
        regression=regression,
        slopes=NONE,
        witness=check,
    )


def _in_earth_axes(axis: int) -> Check:
    """Return the check of a change of velocity by an accelerometer in earth axes, beside the one in body axes."""
    velocity = EARTH_VELOCITY[axis]
    own = SPECIFIC_FORCE[axis]
    in_body_axes = partial(horizontal_force, axis=axis)
    proper = Check(
        ("ax", "ay"), f"the change of {velocity}", "", in_body_axes, NONE, FORCE_CHANNELS
    )
    regression = partial(horizontal_force, axis=axis, in_earth_axes=True)
    return replace(
        proper,
        x=f"the integral of {own} taken in earth axes",
        regression=regression,
        witness=proper,
    )


# Accelerometers in earth axes, from which other contradictions follow
EARTH_AXES = ((_in_earth_axes(0), _in_earth_axes(1)),)
# Pairs of channels, each of which is judged by the responses of both axes
EXCHANGES = (
    (_swapped(PITCH, "q", "r"), _swapped(YAW, "q", "r")),
    (_swapped(NORTH, "v_north", "v_east"), _swapped(EAST, "v_north", "v_east")),
    (
        _crossed(("p", "q"), "elevator", "aileron", ("beta", "p", "r", "rudder")),
        _crossed(("q", "p"), "aileron", "elevator", ("alpha", "q")),
    ),
    (
        _crossed(("az", "ay"), "beta", "alpha", ("q", "elevator")),
        _crossed(("ay", "az"), "alpha", "beta", LATERAL_EFFECTS),
    ),
)

# Channels of the checks. Of the commanded ones a repeated value is a new sample.
COMMANDED = (*ALL_SURFACES, "throttle")
USED = sorted({*COMMANDED}.union(*(check.needs for check in CHECKS)))


# -- decisions


class Judgement(NamedTuple):
    """A check of flights that is decided, and its numbers. ``flight`` is None for all flights together."""

    check: Check
    # channels that may be wrong
    channels: tuple[str, ...]
    # "slope", or "lag" [s], with its standard deviation
    quantity: str
    value: float
    std: float
    # distance from the admissible values, in standard deviations; 0 where the signals are equal
    t: float
    slope: Slope
    flight: object = None

    @classmethod
    def of_slope(cls, check: Check, slope: Slope, t: float) -> Judgement:
        """Return the judgement of a slope."""
        return cls(check, check.channels, "slope", slope.value, slope.std, t, slope)

    @property
    def is_contradiction(self) -> bool:
        """Whether the value is not admissible; otherwise the check confirms its channels."""
        return self.t != 0.0

    @property
    def finding(self) -> Finding:
        """The finding of the compared signals, y over x, and the numbers."""
        numbers = {
            "channels": list(self.channels),
            "y": self.check.y,
            "x": self.check.x,
            "expected": EXPECTED[self.check.slopes],
            self.quantity: self.value,
            "std": self.std,
            "t": self.t,
            "correlation": self.slope.correlation,
            "effective_samples": self.slope.n_effective,
        }
        return Finding(Code.CONTRADICTION, self.flight, numbers=numbers)


def find_contradictions(
    flights: FlightTable, settings: PhysicsSettings = DEFAULT
) -> list[Judgement]:
    """Return the checks that flights contradict.

    All flights are judged together, and each of at least 30 s by itself if nothing is found in all.
    """
    contradictions = _contradictions_of(flights, settings)
    if contradictions or len(flights.clock.names) < 2:
        return contradictions
    for name, flight in flights.flights.items():
        if np.ptp(flight.time) >= settings.long_flight:
            for contradiction in _contradictions_of(flight, settings):
                contradictions.append(contradiction._replace(flight=name))
    return contradictions


def _contradictions_of(flights: FlightTable, settings: PhysicsSettings) -> list[Judgement]:
    """Return the contradictions of all rows together."""
    signals = flight_signals(flights, settings)
    contradictions: list[Judgement] = []
    confirmed: set[str] = set()
    for check in CHECKS:
        if not check.needs <= signals.channels.keys():
            continue
        judgement = _judged(check, signals)
        if judgement is None:
            continue
        if judgement.is_contradiction:
            contradictions.append(judgement)
        else:
            confirmed.update(check.channels)
    # the clearest first, of which others may be consequences
    contradictions.sort(key=_clearness, reverse=True)
    contradictions = [
        *_exchanges(signals, EARTH_AXES),
        *contradictions,
        *_exchanges(signals, EXCHANGES),
    ]
    suspects = _with_suspects(contradictions, confirmed)
    if not {*ELEVONS} <= {*flights.table.columns}:
        return suspects
    return [_of_elevons(contradiction) for contradiction in suspects]


def _clearness(judgement: Judgement) -> tuple[bool, float]:
    """Return the order of contradictions: equal signals before signs, then by correlation."""
    return judgement.check.slopes == EQUAL, abs(judgement.slope.correlation)


def _of_elevons(contradiction: Judgement) -> Judgement:
    """Return a contradiction with the elevons in place of the elevator or aileron that they make."""
    first, *others = contradiction.channels
    channels = (*ELEVONS, *others) if first in MIXED else contradiction.channels
    return contradiction._replace(channels=channels)


def _with_suspects(contradictions: list[Judgement], confirmed: set[str]) -> list[Judgement]:
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
        follows = doubtful.intersection(contradiction.check.uses)
        if not follows and not doubtful.issuperset(suspects):
            doubtful.update(suspects)
            remaining.append(contradiction._replace(channels=suspects))
    return remaining


def _judged(check: Check, signals: Signals) -> Judgement | None:
    """Return the judgement of a check, None if it is undecided.

    Signals are equal if they are at the best lag. A sign is wrong if it is so at all lags that
    explain y about as well as the best one. Under feedback a late servo turns the sign at lag zero.
    """
    settings = signals.settings
    slopes = slopes_by_lag(check, signals)
    if not slopes:
        return None
    best = max(slopes.values(), key=lambda slope: slope.explained)
    if best.size <= check.noise or best.n_effective < settings.least_samples:
        return None
    least, most = check.slopes
    if check.slopes == EQUAL:
        lagged = _judged_equal(check, slopes, settings)
        is_late = lagged.t > 0.0 and best.correlation > settings.lagged_correlation
        margin = min(best.value - least, most - best.value)
        if is_late or margin > settings.least_t * best.std:
            return lagged
        # the error of x attenuates the slope (Fuller 1987, section 1.1)
        least *= 1 - (check.noise / best.size) ** 2
        slope = slopes[0.0]
        is_attenuated = check.vibrates and 0 < slope.value < least
        if is_attenuated and _is_reverse_admissible(check, signals):
            return None
    else:
        slope = _slope_of_response(check, slopes, signals)
        if abs(slope.correlation) < settings.least_correlation:
            return None
    t = slope.t(least, most)
    if abs(t) < settings.least_t:
        return None
    if check.witness is not None and _judged(check.witness, signals) is None:
        return None
    return Judgement.of_slope(check, slope, t)


def _is_reverse_admissible(check: Check, signals: Signals) -> bool:
    """Return whether x over y has an admissible slope: equal signals, of which x alone is noisy.

    Noise of x attenuates the slope of y over x, not this one (Frisch 1934); a wrong scale changes
    both.
    """
    y, x, others = check.regression(signals)
    reverse = estimated_slope(Regression(x, y, others), signals.settings)
    settings = signals.settings
    if reverse is None or reverse.std > settings.reverse_std:
        return False
    return abs(reverse.t(*check.slopes)) < settings.reverse_t


def _slope_of_response(check: Check, slopes: dict[float, Slope], signals: Signals) -> Slope:
    """Return the slope that the sign is judged by: of all possible lags the one nearest to its expected sign.

    Where the angle was not measured, the earliest one: it answers to a surface, with the other sign.
    """
    settings = signals.settings
    best = max(slope.explained for slope in slopes.values())
    if check.angle is not None and check.angle not in signals:
        enough = settings.possible_lag_without_angle * best
        return slopes[min(lag for lag, slope in slopes.items() if slope.explained >= enough)]
    possible = [s for s in slopes.values() if s.explained >= settings.possible_lag * best]
    return min(possible, key=lambda slope: abs(slope.t(*check.slopes)))


def _judged_equal(check: Check, slopes: dict[float, Slope], settings: PhysicsSettings) -> Judgement:
    """Return the judgement of equal signals: contradicted if the best lag is longer than usual, else confirmed."""
    usual_lag = settings.usual_lag
    least_t = settings.least_t
    if check.gusts_lead:
        usual_lag = settings.usual_airspeed_lag
        least_t = settings.least_airspeed_t
    lag, best = max(slopes.items(), key=lambda item: item[1].explained)
    usual = 0.0
    for late, slope in slopes.items():
        if abs(late) <= usual_lag:
            usual = max(usual, slope.explained)
    # likelihood ratio: t^2 = n log of the ratio of unexplained variances
    ratio = (1 + best.explained) / (1 + usual)
    t = float(np.sqrt(best.n_effective * np.log(ratio)))
    if abs(lag) <= usual_lag or t < least_t:
        t = 0.0
    # a uniform distribution between the lags that are tried, where they are farthest apart
    std = float(np.diff(sorted(slopes)).max(initial=0.0) / np.sqrt(12))
    return Judgement(check, check.channels, "lag", lag, std, t, best)


def _exchanges(signals: Signals, pairs: Iterable[tuple[Check, Check]]) -> list[Judgement]:
    """Return the pairs of channels that are exchanged: each explains the other's response better."""
    found = []
    for exchange in pairs:
        judgements = []
        for check in exchange:
            if check.needs <= signals.channels.keys():
                judgements.append(_judged_exchange(check, signals))
        exchanged = [judgement for judgement in judgements if judgement is not None]
        if len(exchanged) == len(exchange):
            found.append(exchanged[0])
    return found


def _judged_exchange(check: Check, signals: Signals) -> Judgement | None:
    """Return the judgement of a response by the wrong channel, None if the right one explains more."""
    slopes = slopes_by_lag(check, signals)
    if not slopes or check.witness is None:
        return None
    best = max(slopes.values(), key=lambda slope: slope.explained)
    proper = slopes_by_lag(check.witness, signals)
    explained = max((slope.explained for slope in proper.values()), default=0.0)
    settings = signals.settings
    t = best.t(0.0, 0.0)
    is_weak = abs(best.correlation) < settings.least_correlation or abs(t) < settings.least_t
    if is_weak or best.explained <= explained:
        return None
    return Judgement.of_slope(check, best, t)


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
    n = len(Z)
    if n < settings.least_rows:
        return None
    others = Z[:, :-2]
    xy = Z[:, -2:]
    scale = np.sqrt(np.mean(others**2, axis=0))
    others = others / np.where(scale > 0, scale, 1.0)
    xy = xy - others @ np.linalg.lstsq(others, xy, rcond=1e-8)[0]
    x, y = xy.T
    x_size, y_size = np.linalg.norm(xy, axis=0)
    is_determined = x_size > 1e-3 * np.linalg.norm(Z[:, -2])
    if not is_determined or not y_size > 0:
        return None
    slope = x @ y / x_size**2
    products = x * (y - slope * x)
    tau = autocorrelation_time(products)
    std = np.sqrt(tau) * np.linalg.norm(products) / x_size**2
    correlation = x @ y / (x_size * y_size)
    size = x_size / np.sqrt(n)
    return Slope(float(slope), float(std), float(correlation), n / tau, float(size))


# -- signals of a table


def flight_signals(flights: FlightTable, settings: PhysicsSettings = DEFAULT) -> Signals:
    """Return the channels of flights at about 20 Hz, without the rows on the ground."""
    time = flights.time
    runs = [run for run in flights.segments if n_rows(run) > 1]
    if not runs:
        return Signals({}, np.empty(0, int), 1.0, settings)
    usual = median_step(time, runs)
    n_averaged = max(1, int(1 / usual // settings.rate))
    step = usual * n_averaged
    clocks = [_block_clock(time[run], step) for run in runs]
    lengths = [len(clock) for clock in clocks]
    segment = np.repeat(np.arange(len(runs)), lengths)
    channels = {}
    for name, values in flights.numeric_channels(USED).items():
        parts = []
        for run, clock in zip(runs, clocks, strict=True):
            parts.append(_averaged(name, time[run], values[run], clock, settings))
        channel = np.concatenate(parts)
        if np.isfinite(channel).any():
            channels[name] = channel
    channels = _in_flight(_mixed(channels), settings)
    return Signals(channels, segment, step, settings)


def _mixed(channels: dict[str, Vector]) -> dict[str, Vector]:
    """Return the channels with elevator and aileron of the elevons."""
    if not {*ELEVONS} <= channels.keys():
        return channels
    return channels | by_elevons(channels)


def _in_flight(channels: dict[str, Vector], settings: PhysicsSettings) -> dict[str, Vector]:
    """Return the channels without rows on the ground."""
    if "airspeed" not in channels:
        return channels
    airspeed = channels["airspeed"]
    on_ground = airspeed < settings.flying * np.nanmedian(airspeed)
    return {name: np.where(on_ground, np.nan, values) for name, values in channels.items()}


def _block_clock(time: Vector, step: float) -> Matrix:
    """Return the times of whole blocks (n, k) of ``step`` [s] each, k the samples of a block at the run's own rate."""
    n_samples = round(step / np.median(np.diff(time)))
    size = max(1, n_samples)
    spacing = step / size
    # the tolerance is of rounded clocks
    n = 1 + int(np.ptp(time) / spacing + 1e-3)
    n_blocks = n // size
    points = time[0] + spacing * np.arange(n_blocks * size)
    return np.minimum(points, time[-1]).reshape(-1, size)


def _averaged(
    name: str, time: Vector, values: Vector, clock: Matrix, settings: PhysicsSettings
) -> Vector:
    """Return means over the blocks of a clock (n, k), linear between samples.

    A sensor that repeats its value holds it: only the first is a sample, as the others are late.
    """
    rows = np.flatnonzero(np.isfinite(values))
    if not rows.size:
        return np.full(len(clock), np.nan)
    if name not in COMMANDED:
        is_first = np.diff(values[rows], prepend=np.nan) != 0
        is_first[-1] = True
        rows = rows[is_first]
    samples = values[rows]
    if name in EULER:
        is_degrees = np.abs(samples).max() > settings.largest_radians
        samples = np.unwrap(samples, period=360.0 if is_degrees else 2 * np.pi)
    sampled = np.interp(clock, time[rows], samples, left=np.nan, right=np.nan)
    return sampled.mean(axis=1)
