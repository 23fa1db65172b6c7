"""All checks, with the channels that each compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from skdgp._flight.channels import (
    ALL_SURFACES,
    EARTH_VELOCITY,
    EULER,
    RATES,
    SPECIFIC_FORCE,
    VANES,
)
from skdgp._flight.physics import _equations as equations
from skdgp._flight.physics._checks import (
    AHEAD,
    CALIBRATED,
    EQUAL,
    GUSTY,
    LEVEL,
    NEGATIVE,
    POSITIVE,
    SAME,
    SMOOTH,
    STEADY,
    UNALIKE,
    Equality,
    Exchange,
    Interval,
    Mistake,
    Relation,
    Sign,
    StuckCheck,
)
from skdgp._flight.physics._signals import (
    AIRSPEED_LAGS,
    KINEMATIC_LAGS,
    PHYSICS,
    SURFACE_LAGS,
    VANE_LAGS,
)

FORCE_CHANNELS = (*EULER, *EARTH_VELOCITY, *SPECIFIC_FORCE)
LATERAL_EFFECTS = ("p", "r", "aileron", "rudder")


# -- equalities


def _relation_of_integral(
    name: str, rate: str, regression: Callable, uses: tuple[str, ...] = ()
) -> Relation:
    """Return the relation of the change of a channel with the integral of its rate."""
    return Relation(
        channels=(name, rate),
        uses=uses,
        y=f"the change of {name}",
        x=f"the integral of {rate}",
        regression=regression,
        lags=KINEMATIC_LAGS,
    )


def _relation_of_attitude(axis: int, others: tuple[int, ...], uses: tuple[str, ...]) -> Relation:
    """Return the relation of an angle of the attitude with its rate, beside the rates of other axes."""
    regression = partial(equations.attitude, axis=axis, others=others)
    return _relation_of_integral(EULER[axis], RATES[axis], regression, uses)


def _relation_of_position(name: str, velocity: str) -> Relation:
    """Return the relation of a coordinate with its velocity."""
    regression = partial(equations.position, name=name, velocity=velocity)
    return _relation_of_integral(name, velocity, regression)


def _equality_of_level_force(channels: tuple[str, ...], axis: int) -> Equality:
    """Return the check of a level component of the specific force by the ground velocity."""
    relation = Relation(
        channels=channels,
        uses=FORCE_CHANNELS,
        y="the change of velocity",
        x="the integral of specific force and gravity",
        regression=partial(equations.level_force, axis=axis),
        lags=KINEMATIC_LAGS,
    )
    admissible = SAME if axis == 1 else EQUAL
    return Equality(relation=relation, noise=0.5, vibrates=True, admissible=admissible)


ROLL = _relation_of_attitude(0, (1, 2), ("q", "r", "theta"))
PITCH = _relation_of_attitude(1, (2,), ("r", "phi"))
YAW = _relation_of_attitude(2, (1,), ("q", "phi", "theta"))
TURNING = Relation(
    channels=("q", "theta"),
    uses=("phi", "psi"),
    y="the integral of q",
    x="the change of psi sin phi cos theta",
    regression=equations.turning,
)
FLOW = ("q", "az", "airspeed", "phi", "theta")
ALPHA = Relation(
    channels=("alpha",),
    uses=FLOW,
    y="the change of alpha",
    x="the integral of q + (az + g) / V",
    regression=equations.alpha_by_motion,
    lags=VANE_LAGS,
)
BETA = Relation(
    channels=("beta",),
    uses=("r", "p", "alpha", "ay", "airspeed", "phi", "theta"),
    y="the change of beta",
    x="the integral of p alpha - r + (ay + g) / V",
    regression=equations.beta_by_motion,
    lags=VANE_LAGS,
)
FALL = Relation(
    channels=("airspeed",),
    uses=("alpha", *FLOW),
    y="the change of alpha",
    x="the integral of (az + g) / V",
    regression=equations.fall_through_the_air,
    causes=("another unit of airspeed",),
)
NORTH = _relation_of_position("north", "v_north")
EAST = _relation_of_position("east", "v_east")
DOWN = _relation_of_position("down", "v_down")
ALTITUDE = _relation_of_position("altitude", "v_down")
AIRSPEED = Relation(
    channels=("airspeed", "psi", "v_north", "v_east"),
    uses=(*EULER, *EARTH_VELOCITY),
    y="the ground velocity less a steady wind",
    x="airspeed",
    regression=equations.velocity_along,
    lags=(*KINEMATIC_LAGS, *AIRSPEED_LAGS),
)
AIRSPEED_CHANGE = Relation(
    channels=("airspeed",),
    uses=(*EULER, *EARTH_VELOCITY),
    y="the airspeed less the ground velocity and a steady wind",
    x="the airspeed of the second half",
    regression=equations.airspeed_later,
    causes=("water or ice in the pitot tube",),
)
# a magnetic heading, or one of another zero, turns the velocity
COURSE = Relation(
    channels=("psi",),
    uses=("phi", "theta", *EARTH_VELOCITY, "airspeed"),
    y="the velocity through the air to the right of the heading",
    x="airspeed",
    regression=equations.course_through_the_air,
    causes=("a magnetic heading", "a constant sideslip"),
)
INCIDENCE = Relation(
    channels=("alpha",),
    uses=(*EULER, *EARTH_VELOCITY, "airspeed"),
    y="V alpha less the normal ground velocity",
    x="airspeed",
    regression=equations.incidence_through_the_air,
    causes=("a constant error of alpha, or of theta",),
)
# without lags: gravity hardly varies, and the vertical force tells them
GRAVITY = Relation(
    channels=("az",),
    uses=FORCE_CHANNELS,
    y="the integral of specific force",
    x="the change of velocity less gravity",
    regression=equations.gravity,
)


def _equality_of_vane(relation: Relation) -> Equality:
    """Return the check of a vane by the motion of the aircraft, which gusts attenuate."""
    return Equality(
        relation=relation,
        noise=0.008,
        admissible=GUSTY,
        usual_lag=PHYSICS.usual_vane_lag,
        least_t=PHYSICS.least_vane_t,
    )


FALLING = _equality_of_level_force(("v_down", "az"), axis=2)
# noise: angles [rad], positions [m], velocities [m/s]
EQUALITIES = (
    Equality(relation=ROLL, noise=0.008, admissible=SAME),
    Equality(relation=PITCH, noise=0.008, admissible=SAME),
    Equality(relation=YAW, noise=0.008, admissible=SAME),
    Equality(relation=NORTH, noise=0.3, admissible=SAME),
    Equality(relation=EAST, noise=0.3, admissible=SAME),
    Equality(relation=DOWN, noise=0.3, admissible=SAME),
    Equality(relation=ALTITUDE, noise=0.3),  # cold air shrinks a pressure altitude
    Equality(
        relation=AIRSPEED,
        noise=3.0,
        usual_lag=PHYSICS.usual_airspeed_lag,
        least_t=PHYSICS.least_airspeed_t,
    ),
    _equality_of_vane(ALPHA),
    _equality_of_vane(BETA),
    Equality(relation=GRAVITY, noise=0.5),
    _equality_of_level_force(("theta", "psi", "v_north", "v_east", "ax", "az"), axis=0),
    _equality_of_level_force(("phi", "psi", "v_north", "v_east", "ay", "az"), axis=1),
    FALLING,
)


# -- signs


def _sign_of_accelerometer(name: str, axis: int) -> Sign:
    """Return the check of one accelerometer by the ground velocity."""
    relation = Relation(
        channels=(name,),
        uses=FORCE_CHANNELS,
        y="the change of velocity less the other forces",
        x=f"the integral of {name}",
        regression=partial(equations.force_of_one_sensor, axis=axis),
        lags=KINEMATIC_LAGS,
    )
    return Sign(relation=relation, admissible=POSITIVE, noise=0.05)


def _relation_of_response(name: str, effects: tuple[str, ...]) -> Relation:
    """Return the relation of a rate or specific force with the first of its effects."""
    x = effects[0]
    return Relation(
        channels=(x, name),
        uses=("airspeed",),
        y=f"the change of {name}" if name in RATES else name,
        x=x,
        regression=partial(equations.response, name=name, effects=effects),
        beside=tuple(effect for effect in effects[1:] if effect in VANES),
        lags=SURFACE_LAGS if x in ALL_SURFACES else (0.0,),
        unit="1/m^2" if name in RATES else "1/m",
    )


def _sign_of_effect(name: str, effects: tuple[str, ...], admissible: Interval) -> Sign:
    """Return the check of the sign of the first effect on a rate or specific force."""
    angle = next((effect for effect in effects if effect in VANES), None)
    return Sign(
        relation=_relation_of_response(name, effects),
        admissible=admissible,
        angle=angle,
        is_cause=effects[0] in ALL_SURFACES,
    )


LIFT = _relation_of_response("az", ("alpha", "q", "elevator"))
SIDEFORCE = _relation_of_response("ay", ("beta", *LATERAL_EFFECTS))
BY_AILERON = _sign_of_effect("p", ("aileron", "beta", "p", "r", "rudder"), POSITIVE)
BY_RUDDER = _sign_of_effect("r", ("rudder", "beta", "p", "r", "aileron"), NEGATIVE)
BY_ELEVATOR = _sign_of_effect("q", ("elevator", "alpha", "q"), NEGATIVE)
WEATHERCOCK = _sign_of_effect("r", ("beta", *LATERAL_EFFECTS), POSITIVE)


def _relation_of_drive(name: str, unit: str) -> Relation:
    """Return the relation of the axial force with what drives the aircraft forward."""
    return Relation(
        channels=(name, "ax"),
        uses=("airspeed", "az"),
        y="ax",
        x=name,
        regression=partial(equations.thrust, name=name),
        unit=unit,
    )


DRIVES = {name: _relation_of_drive(name, "1/kg") for name in ("thrust", "thrust_x")}


def _copy(name: str, other: str, uses: tuple[str, ...], regression: Callable) -> Sign:
    """Return the check that a channel is no copy of another signal."""
    relation = Relation(
        channels=(name,),
        uses=uses,
        y=name,
        x=other,
        regression=regression,
        causes=(f"a copy of {other}",),
    )
    return Sign(relation=relation, admissible=UNALIKE, least_explained=PHYSICS.copied)


JUDGED_FIRST = (
    _copy("alpha", "theta", ("theta",), equations.alpha_by_attitude),
    _copy("psi", "the course over the ground", EARTH_VELOCITY[:2], equations.heading_by_course),
    _copy(
        "airspeed",
        "the speed over the ground",
        ("beta", *EULER, *EARTH_VELOCITY),
        equations.airspeed_by_ground_speed,
    ),
    Sign(relation=AIRSPEED_CHANGE, admissible=STEADY, noise=2.0),
)
"""Judged first, as other contradictions follow from them."""
SIGNS = (
    Sign(relation=TURNING, admissible=POSITIVE, noise=0.002),
    Sign(relation=FALL, admissible=GUSTY, noise=0.003),
    _sign_of_accelerometer("ax", axis=0),
    _sign_of_accelerometer("ay", axis=1),
    Sign(relation=LIFT, admissible=NEGATIVE, angle="alpha"),
    Sign(
        relation=replace(SIDEFORCE, uses=(*SIDEFORCE.uses, "r")),
        admissible=NEGATIVE,
        angle="beta",
        witness=WEATHERCOCK,
    ),
    BY_AILERON,
    BY_ELEVATOR,
    BY_RUDDER,
    Sign(relation=_relation_of_drive("throttle", "m/s^2"), admissible=POSITIVE, noise=0.01),
    Sign(relation=DRIVES["thrust"], admissible=POSITIVE),
    Sign(relation=DRIVES["thrust_x"], admissible=POSITIVE),
)

SCALE = replace(
    AIRSPEED,
    channels=("airspeed",),
    uses=(*EULER, *EARTH_VELOCITY),
    lags=(0.0,),
    causes=("indicated in place of true airspeed", "the calibration of the pitot tube"),
)


def _scale_of_vane(relation: Relation) -> Sign:
    """Return the check of the scale of a vane by the motion of the aircraft, where gusts are small."""
    return Sign(
        relation=replace(relation, lags=(0.0,), causes=("the flow about the vane", "another unit")),
        admissible=SMOOTH,
        noise=0.008,
        least_explained=PHYSICS.smooth,
        least_t=PHYSICS.least_scale_t,
    )


OFFSETS = (
    Sign(relation=COURSE, admissible=AHEAD, noise=3.0),
    Sign(relation=INCIDENCE, admissible=LEVEL, noise=3.0),
    Sign(relation=SCALE, admissible=CALIBRATED, noise=3.0),
    _scale_of_vane(ALPHA),
    _scale_of_vane(BETA),
)
"""Judged last, as a small error of a scale or of an angle's zero explains no wrong sign."""


# -- exchanges


ROLL_BY_AILERON = _relation_of_response("p", ("aileron", "elevator", "beta", "p", "r", "rudder"))
PITCH_BY_ELEVATOR = _relation_of_response("q", ("elevator", "aileron", "alpha", "q"))
BY_ELEVONS = (ROLL_BY_AILERON, PITCH_BY_ELEVATOR)
LIFT_BY_ALPHA = _relation_of_response("az", ("alpha", "beta", "q", "elevator"))
SIDEFORCE_BY_BETA = _relation_of_response("ay", ("beta", "alpha", *LATERAL_EFFECTS))


HORIZONTAL = (("v_north", "v_east"), ("north", "east"))
EARTH_UP = Mistake(exchanged=HORIZONTAL, turned=("v_down", "down"), axes="east, north, up")


def _exchange(first: str, second: str, *relations: Relation) -> Exchange:
    """Return the check that two channels do not stand for each other."""
    return Exchange(Mistake(exchanged=((first, second),)), relations)


EXCHANGES = (
    Exchange(Mistake(turned=("elevon_left",)), BY_ELEVONS),
    Exchange(Mistake(turned=("elevon_right",)), BY_ELEVONS),
    _exchange("p", "q", ROLL, PITCH),
    _exchange("p", "r", ROLL, YAW),
    _exchange("q", "r", PITCH, YAW),
    _exchange("phi", "theta", ROLL, PITCH),
    _exchange("ax", "az", GRAVITY, FALLING.relation),
    _exchange("ay", "az", GRAVITY, FALLING.relation),
    _exchange("v_north", "v_east", NORTH, EAST),
    Exchange(replace(EARTH_UP, exchanged=HORIZONTAL[:1], turned=("v_down",)), (NORTH, EAST)),
    _exchange("elevator", "aileron", *BY_ELEVONS),
    _exchange("aileron", "rudder", BY_AILERON.relation, BY_RUDDER.relation),
    _exchange("beta", "alpha", LIFT_BY_ALPHA, SIDEFORCE_BY_BETA),
)


STUCK_CHECKS = (
    StuckCheck("aileron", BY_AILERON.relation),
    StuckCheck("elevator", BY_ELEVATOR.relation),
    StuckCheck("rudder", BY_RUDDER.relation),
    StuckCheck("elevon_left", BY_AILERON.relation),
    StuckCheck("elevon_right", BY_AILERON.relation),
)


# -- mistakes of several channels at once

BODY_TURNED = ("q", "r", "ay", "az")
NAVIGATION_TURNED = ("v_east", "v_down", "east", "down")
LEFT_UP = "forward, left, up (ROS)"
MISTAKES = (
    Mistake(turned=("q", "theta")),
    Mistake(turned=("p", "phi")),
    Mistake(turned=("r", "psi")),
    Mistake(late=EARTH_VELOCITY),
    Mistake(late=ALL_SURFACES),
    EARTH_UP,
    Mistake(turned=BODY_TURNED, axes=LEFT_UP),
    Mistake(turned=(*BODY_TURNED, "theta", "psi"), axes=LEFT_UP),
    Mistake(turned=(*BODY_TURNED, "theta", "psi", "beta"), axes=LEFT_UP),
    Mistake(turned=(*BODY_TURNED, "theta", "psi"), axes=LEFT_UP, from_east=True),
    Mistake(turned=(*BODY_TURNED, "theta", "psi", *NAVIGATION_TURNED), axes=LEFT_UP),
    Mistake(turned=(*BODY_TURNED, "theta", "psi", "beta", *NAVIGATION_TURNED), axes=LEFT_UP),
)

CHECKS: list[Equality | Sign] = [*JUDGED_FIRST, *EQUALITIES, *SIGNS, *OFFSETS]
RELATIONS = [check.relation for check in CHECKS]
CHANNELS = sorted({*ALL_SURFACES, "throttle"}.union(*[relation.needs for relation in RELATIONS]))
"""Channels that the checks use."""
