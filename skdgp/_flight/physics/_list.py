"""All laws, with the channels that each compares, and the mistakes that break several."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from skdgp._flight.channels import (
    ALL_SURFACES,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    RATES,
    SPECIFIC_FORCE,
    VANES,
)
from skdgp._flight.physics import _equations as equations
from skdgp._flight.physics._laws import EQUAL, Interval, Law, Mistake
from skdgp._flight.physics._signals import PHYSICS

# of gyros, velocities, north, east, down and the lateral force: 0.94 to 1.06 in 230 sound flights, but 0.89 in a
# simulator whose clock is slow
SAME = Interval(1 / 1.15, 1.15, "1")
# gusts move the air past the aircraft, which follows them
GUSTY = Interval(-0.5, 1.5, "0 to 1")
# of alpha by the lift: gusts change both, with a negative slope of any size where an aircraft hardly moves
SMALL = Interval(-np.inf, 1.5, "at most 1")
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
# of the airspeed over the ground velocity, the later less the earlier one: -0.1 ± 0.1 at least in 232 sound flights
# whose velocity varies; -1 where the airspeed stands still
MOVING = Interval(-0.3, np.inf, "no less than -0.3")
FOOT = 0.3048  # [m]
# units of airspeed [m/s]
SPEED_UNITS = {"kt": 1852 / 3600, "ft/s": FOOT, "km/h": 1 / 3.6}
POSITIVE = Interval(0.0, np.inf, "a positive one")
NEGATIVE = Interval(-np.inf, 0.0, "a negative one")
# of one accelerometer, whose part is small beside errors of the attitude; in g it has 9.8
AT_MOST_THREE = Interval(0.0, 3.0, "a positive one, at most 3")
# of signals of different origin
UNALIKE = Interval(0.0, 0.0, "signals that differ")


def _lags(first: float, last: float, step: float) -> tuple[float, ...]:
    """Return lags that are tried [s], from zero outward, positive where y is late against x."""
    grid = step * np.arange(round(first / step), round(last / step) + 1)
    return tuple(sorted(grid.round(2).tolist(), key=abs))


KINEMATIC_LAGS = _lags(-1.0, 1.0, 0.2)
# gusts reach the airspeed before the aircraft follows
AIRSPEED_LAGS = _lags(-3.0, 3.0, 0.2)
# of responses to angles of the flow, which vanes measure late
VANE_LAGS = _lags(-0.8, 0.2, 0.1)
# of responses to surfaces, whose servos are late
SURFACE_LAGS = _lags(-0.5, 0.15, 0.05)

FORCE_CHANNELS = (*EULER, *EARTH_VELOCITY, *SPECIFIC_FORCE)
LATERAL_EFFECTS = ("p", "r", "aileron", "rudder")


# -- equalities, by kinematics; noise of angles [rad], positions [m], velocities [m/s]


def _equality(**options: Any) -> Law:
    """Return a law of kinematics, by which y and x are equal at a lag of no more than usual."""
    # LagCorrector corrects 0.3 s, and holds of a slow GPS add to it
    usual = (-0.5, 0.5)
    defaults: dict[str, Any] = {"admissible": EQUAL, "lags": KINEMATIC_LAGS, "usual_lags": usual}
    return Law(**(defaults | options), least_explained=0.0, is_equality=True)


def _integral(
    name: str, rate: str, regression: Callable, *, uses: tuple[str, ...] = (), **options: Any
) -> Law:
    """Return the equality of the change of a channel and the integral of its rate."""
    return _equality(
        channels=(name, rate),
        uses=uses,
        y=f"the change of {name}",
        x=f"the integral of {rate}",
        regression=regression,
        **options,
    )


def _attitude(axis: int, others: tuple[int, ...], uses: tuple[str, ...]) -> Law:
    """Return the equality of an angle of the attitude with its rate, beside the rates of other axes."""
    regression = partial(equations.attitude, axis=axis, others=others)
    name, rate = EULER[axis], RATES[axis]
    return _integral(
        name,
        rate,
        regression,
        uses=uses,
        noise=0.008,
        admissible=SAME,
        # of one clock in 232 sound flights
        usual_lags=(-0.15, 0.15),
    )


def _position(name: str, velocity: str, admissible: Interval = SAME) -> Law:
    """Return the equality of a coordinate with its velocity."""
    regression = partial(equations.position, name=name, velocity=velocity)
    return _integral(name, velocity, regression, noise=0.3, admissible=admissible)


def _level_force(channels: tuple[str, ...], axis: int) -> Law:
    """Return the equality of a level component of the specific force with the ground velocity."""
    return _equality(
        channels=channels,
        uses=FORCE_CHANNELS,
        y="the change of velocity",
        x="the integral of specific force and gravity",
        regression=partial(equations.level_force, axis=axis),
        noise=0.5,
        vibrates=True,
        admissible=SAME if axis == 1 else EQUAL,
    )


ROLL = _attitude(0, (1, 2), ("q", "r", "theta"))
PITCH = _attitude(1, (2,), ("r", "phi"))
YAW = _attitude(2, (1,), ("q", "phi", "theta"))
NORTH = _position("north", "v_north")
EAST = _position("east", "v_east")
AIRSPEED = _equality(
    channels=("airspeed", "psi", "v_north", "v_east"),
    uses=(*EULER, *EARTH_VELOCITY),
    y="the ground velocity less a steady wind",
    x="airspeed",
    regression=equations.velocity_along,
    slope_by_cause={f"an airspeed in {unit}": factor for unit, factor in SPEED_UNITS.items()},
    noise=3.0,
    lags=AIRSPEED_LAGS,
    # gusts reach it before the aircraft follows, which makes lags up to 1.0 s (25 simulated flights); beyond, none
    # had a t above zero, and 2 s had 3.7 to 10
    usual_lags=(-1.0, 1.0),
    least_lag_t=4.0,
)
# of a vane with the motion of the aircraft, which follows gusts later
OF_VANES: dict[str, Any] = {"noise": 0.008, "admissible": GUSTY, "lags": (0.0,)}
FLOW = ("q", "az", "airspeed", "phi", "theta")
ALPHA = _equality(
    **OF_VANES,
    channels=("alpha",),
    uses=FLOW,
    y="the change of alpha",
    x="the integral of q + (az + g) / V",
    regression=equations.alpha_by_motion,
)
BETA = _equality(
    **OF_VANES,
    channels=("beta",),
    uses=("r", "p", "alpha", "ay", "airspeed", "phi", "theta"),
    y="the change of beta",
    x="the integral of p alpha - r + (ay + g) / V",
    regression=equations.beta_by_motion,
)
# without lags: gravity hardly varies, and the vertical force tells them
GRAVITY = _equality(
    channels=("az",),
    uses=FORCE_CHANNELS,
    y="the integral of specific force",
    x="the change of velocity less gravity",
    regression=equations.gravity,
    slope_by_cause={"an acceleration without gravity": 0.0},
    noise=0.5,
    lags=(0.0,),
)
FALLING = _level_force(("v_down", "az"), axis=2)
EQUALITIES = (
    ROLL,
    PITCH,
    YAW,
    NORTH,
    EAST,
    _position("down", "v_down"),
    _position("altitude", "v_down", EQUAL),  # cold air shrinks a pressure altitude
    AIRSPEED,
    ALPHA,
    BETA,
    GRAVITY,
    _level_force(("theta", "psi", "v_north", "v_east", "ax", "az"), axis=0),
    _level_force(("phi", "psi", "v_north", "v_east", "ay", "az"), axis=1),
    FALLING,
)


# -- copies and changes, judged first, as other contradictions follow from them


def _copy(name: str, other: str, uses: tuple[str, ...], regression: Callable) -> Law:
    """Return the law that a channel is no copy of another signal."""
    return Law(
        channels=(name,),
        uses=uses,
        y=name,
        x=other,
        regression=regression,
        causes=(f"a copy of {other}",),
        admissible=UNALIKE,
        least_explained=1e6,  # rounding and means of samples remain (guess)
    )


def _blocked(begin: float) -> Law:
    """Return the law that an airspeed follows the ground velocity after a part of the flight as before."""
    return Law(
        channels=("airspeed",),
        uses=(*EULER, *EARTH_VELOCITY),
        y="airspeed",
        x=f"the ground velocity after {100 * begin:g} % of the time, beside all of it",
        regression=partial(equations.ground_velocity_later, begin=begin),
        causes=("a blocked pitot tube",),
        admissible=MOVING,
        noise=0.15,
        least_t=4.0,
        # the part before is not explained by it
        least_explained=0.0,
    )


JUDGED_FIRST = (
    _copy("alpha", "theta", ("theta",), equations.alpha_by_attitude),
    _copy("psi", "the course over the ground", EARTH_VELOCITY[:2], equations.heading_by_course),
    _copy(
        "airspeed",
        "the speed over the ground",
        ("beta", *EULER, *EARTH_VELOCITY),
        equations.airspeed_by_ground_speed,
    ),
    Law(
        channels=("airspeed",),
        uses=(*EULER, *EARTH_VELOCITY),
        y="the airspeed less the ground velocity and a steady wind",
        x="the airspeed of the second half",
        regression=equations.airspeed_later,
        causes=("water or ice in the pitot tube",),
        admissible=STEADY,
        noise=2.0,
    ),
    *map(_blocked, (0.5, 0.25, 0.75)),
)


# -- signs, by aerodynamics


def _response(name: str, effects: tuple[str, ...], admissible: Interval) -> Law:
    """Return the law of the sign of the first of several effects on a rate or specific force."""
    x = effects[0]
    vanes = tuple(effect for effect in effects if effect in VANES)
    is_cause = x in ALL_SURFACES
    return Law(
        channels=(x, name),
        uses=("airspeed",),
        y=f"the change of {name}" if name in RATES else name,
        x=x,
        regression=partial(equations.response, name=name, effects=effects),
        beside=tuple(vane for vane in vanes if vane != x),
        unit="1/m^2" if name in RATES else "1/m",
        admissible=admissible,
        lags=SURFACE_LAGS if is_cause else VANE_LAGS,
        # a response is hardly earlier than its cause; filters of recorders differ. The largest t beyond was 5.5
        # in 64 sound flights, and surfaces late by 0.3 s had 10 and more: set on the flights that judge it. Vanes
        # had 2.1 in 232 sound flights, in gusts too, and 6.7 to 26 late by 0.2 s
        usual_lags=(-0.15, np.inf),
        least_lag_t=10.0 if is_cause else PHYSICS.least_t,
        is_cause=is_cause,
        angle=next(iter(vanes), None),
    )


def _accelerometer(name: str, axis: int) -> Law:
    """Return the law of the sign of one accelerometer, by the ground velocity."""
    return Law(
        channels=(name,),
        uses=FORCE_CHANNELS,
        y="the change of velocity less the other forces",
        x=f"the integral of {name}",
        regression=partial(equations.force_of_one_sensor, axis=axis),
        admissible=AT_MOST_THREE,
        # of an accelerometer in g, too
        noise=0.008,
    )


def drive_of(name: str, unit: str, noise: float = 0.0) -> Law:
    """Return the law of the sign of the axial force by what drives the aircraft forward."""
    return Law(
        channels=(name, "ax"),
        uses=("airspeed", "az"),
        y="ax",
        x=name,
        regression=partial(equations.thrust, name=name),
        unit=unit,
        admissible=POSITIVE,
        noise=noise,
    )


TURNING = Law(
    channels=("q", "theta"),
    uses=("phi", "psi"),
    y="the integral of q",
    x="the change of psi sin phi cos theta",
    regression=equations.turning,
    admissible=POSITIVE,
    noise=0.002,
)
FALL = Law(
    channels=("airspeed",),
    uses=("alpha", *FLOW),
    y="the change of alpha",
    x="the integral of (az + g) / V",
    regression=equations.fall_through_the_air,
    causes=("another unit of airspeed",),
    admissible=SMALL,
    noise=0.003,
)
WEIGHT = Law(
    channels=("az",),
    uses=("phi", "theta"),
    y="az",
    x="cos theta cos phi",
    regression=equations.weight,
    unit="m/s^2",
    admissible=NEGATIVE,
)
LIFT = _response("az", ("alpha", "q", "elevator"), NEGATIVE)
SIDEFORCE = replace(
    _response("ay", ("beta", *LATERAL_EFFECTS), NEGATIVE),
    uses=("airspeed", "r"),
    witness=_response("r", ("beta", *LATERAL_EFFECTS), POSITIVE),
)
BY_AILERON = _response("p", ("aileron", "beta", "p", "r", "rudder"), POSITIVE)
BY_ELEVATOR = _response("q", ("elevator", "alpha", "q"), NEGATIVE)
BY_RUDDER = _response("r", ("rudder", "beta", "p", "r", "aileron"), NEGATIVE)
DRIVES = {name: drive_of(name, "1/kg") for name in ("thrust", "thrust_x")}
SIGNS = (
    TURNING,
    FALL,
    WEIGHT,
    _accelerometer("ax", axis=0),
    _accelerometer("ay", axis=1),
    LIFT,
    SIDEFORCE,
    BY_AILERON,
    BY_ELEVATOR,
    BY_RUDDER,
    drive_of("throttle", "m/s^2", noise=0.01),
    *DRIVES.values(),
)


# -- scales and zeros, judged last, as a small error of one explains no wrong sign


def _scale_of_vane(law: Law) -> Law:
    """Return the law of the scale of a vane, where gusts are small."""
    return replace(
        law,
        lags=(0.0,),
        causes=("the flow about the vane", "another unit"),
        admissible=SMOOTH,
        is_equality=False,
        # a correlation of 0.9 (guess)
        least_explained=4.3,
        least_t=4.0,
    )


OFFSETS = (
    # a magnetic heading, or one of another zero, turns the velocity
    Law(
        channels=("psi",),
        uses=("phi", "theta", *EARTH_VELOCITY, "airspeed"),
        y="the velocity through the air to the right of the heading",
        x="airspeed",
        regression=equations.course_through_the_air,
        causes=("a magnetic heading", "a constant sideslip"),
        admissible=AHEAD,
        noise=3.0,
    ),
    Law(
        channels=("alpha",),
        uses=(*EULER, *EARTH_VELOCITY, "airspeed"),
        y="V alpha less the normal ground velocity",
        x="airspeed",
        regression=equations.incidence_through_the_air,
        causes=("a constant error of alpha, or of theta",),
        admissible=LEVEL,
        noise=3.0,
    ),
    replace(
        AIRSPEED,
        channels=("airspeed",),
        lags=(0.0,),
        causes=("indicated in place of true airspeed", "the calibration of the pitot tube"),
        admissible=CALIBRATED,
        is_equality=False,
        least_explained=PHYSICS.least_explained,
    ),
    _scale_of_vane(ALPHA),
    _scale_of_vane(BETA),
)

LAWS = (JUDGED_FIRST, EQUALITIES, SIGNS, OFFSETS)
"""Groups of laws in the order of their judgement."""
CHANNELS = sorted({*ALL_SURFACES, "throttle"}.union(*[law.needs for laws in LAWS for law in laws]))
"""Channels that the laws use."""


# -- exchanged channels

HORIZONTAL = (("v_north", "v_east"), ("north", "east"))
EARTH_UP = Mistake(exchanged=HORIZONTAL, turned=("v_down", "down"), axes="east, north, up")
BY_ELEVONS = (
    _response("p", ("aileron", "elevator", "beta", "p", "r", "rudder"), POSITIVE),
    _response("q", ("elevator", "aileron", "alpha", "q"), NEGATIVE),
)


def _exchange(first: str, second: str, *laws: Law) -> Mistake:
    """Return the mistake of two channels that stand for each other, which laws show."""
    return Mistake(exchanged=((first, second),), laws=laws)


EXCHANGES = (
    *[Mistake(turned=(name,), laws=BY_ELEVONS) for name in ELEVONS],
    _exchange("p", "q", ROLL, PITCH),
    _exchange("p", "r", ROLL, YAW),
    _exchange("q", "r", PITCH, YAW),
    _exchange("phi", "theta", ROLL, PITCH),
    _exchange("ax", "az", GRAVITY, FALLING),
    _exchange("ay", "az", GRAVITY, FALLING),
    _exchange("v_north", "v_east", NORTH, EAST),
    replace(EARTH_UP, exchanged=HORIZONTAL[:1], turned=("v_down",), laws=(NORTH, EAST)),
    _exchange("elevator", "aileron", *BY_ELEVONS),
    _exchange("aileron", "rudder", BY_AILERON, BY_RUDDER),
    _exchange(
        "beta",
        "alpha",
        _response("az", ("alpha", "beta", "q", "elevator"), NEGATIVE),
        _response("ay", ("beta", "alpha", *LATERAL_EFFECTS), NEGATIVE),
    ),
)

# surfaces that may be stuck, and the response to each
RESPONSES = {
    "aileron": BY_AILERON,
    "elevator": BY_ELEVATOR,
    "rudder": BY_RUDDER,
    "elevon_left": BY_AILERON,
    "elevon_right": BY_AILERON,
}


# -- mistakes of several channels at once

LEFT_UP = "forward, left, up (ROS)"
BODY_TURNED = ("q", "r", "ay", "az")
ATTITUDE_TURNED = (*BODY_TURNED, "theta", "psi")
NAVIGATION_TURNED = ("v_east", "v_down", "east", "down")
MISTAKES = (
    Mistake(turned=("q", "theta")),
    Mistake(turned=("p", "phi")),
    Mistake(turned=("r", "psi")),
    Mistake(exchanged=HORIZONTAL[:1]),
    Mistake(late=EARTH_VELOCITY),
    Mistake(late=RATES),
    Mistake(late=EULER),
    Mistake(late=ALL_SURFACES),
    EARTH_UP,
    Mistake(turned=BODY_TURNED, axes=LEFT_UP),
    Mistake(turned=ATTITUDE_TURNED, axes=LEFT_UP),
    Mistake(turned=(*ATTITUDE_TURNED, "beta"), axes=LEFT_UP),
    Mistake(turned=ATTITUDE_TURNED, axes=LEFT_UP, from_east=True),
    Mistake(turned=(*ATTITUDE_TURNED, *NAVIGATION_TURNED), axes=LEFT_UP),
    Mistake(turned=(*ATTITUDE_TURNED, "beta", *NAVIGATION_TURNED), axes=LEFT_UP),
)
