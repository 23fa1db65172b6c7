"""Equations of flight as regressions: y, x and the other regressors, from the signals of flights.

Kinematics are integrated over a window, so that y is a change and x an integral. Forces and moments
are linear in angles, rates and surfaces.
"""

from __future__ import annotations

import numpy as np

from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import EARTH_VELOCITY, EULER, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.frames import STANDARD_GRAVITY, euler_per_rotation, wrapped
from skdgp._flight.physics._regression import Regression
from skdgp._flight.physics._signals import PHYSICS, Signals

# -- attitude and position


def attitude(flight: Signals, axis: int, others: tuple[int, ...]) -> Regression:
    """Return the terms of a rate of roll, pitch or heading: by the body rate of its axis, and by others.

    phi_dot = p + (q sin phi + r cos phi) tan theta, theta_dot = q cos phi - r sin phi, and
    psi_dot = (q sin phi + r cos phi) / cos theta.
    """
    slopes = euler_per_rotation(flight["phi"], flight["theta"])[:, axis]
    own = slopes[:, axis] * flight[RATES[axis]]
    by_others = [slopes[:, other] * flight[RATES[other]] for other in others]
    return _integrated(flight, flight[EULER[axis]], own, np.sum(by_others, axis=0))


def turning(flight: Signals) -> Regression:
    """Return the terms of q = psi_dot sin phi cos theta + theta_dot cos phi: positive in turns to either side.

    Products with a change over a window take the mean over it.
    """
    window = flight.step * flight.window_rows(PHYSICS.kinematic_window)
    phi = flight["phi"]
    of_turn = flight.integral(np.sin(phi) * np.cos(flight["theta"])) / window
    of_pitch = flight.integral(np.cos(phi)) / window
    x = flight.change(flight["psi"]) * of_turn
    return Regression.with_intercept(
        flight.integral(flight["q"]), x, flight.change(flight["theta"]) * of_pitch
    )


def position(flight: Signals, name: str, velocity: str) -> Regression:
    """Return the change of a coordinate and the integral of its velocity."""
    sign = -1.0 if name == "altitude" else 1.0
    return _integrated(flight, sign * flight[name], flight[velocity])


def _integrated(flight: Signals, y: Vector, rate: Vector, *others: Vector) -> Regression:
    """Return the terms of dy / dt = rate + others: the change, and the integrals."""
    change = flight.change(y)
    integral = flight.integral(rate)
    return Regression.with_intercept(change, integral, *map(flight.integral, others))


# -- velocity through the air: R^T v_ground = v_air + R^T wind, in a steady horizontal wind


def velocity_along(flight: Signals) -> Regression:
    """Return the terms of the component along x, where the air velocity is about V."""
    ground, wind = _velocity_terms(flight, 0)
    return Regression(ground, flight["airspeed"], wind)


def airspeed_later(flight: Signals) -> Regression:
    """Return V less the component along x, and V in the second half of each segment, beside V and a steady wind."""
    ground, airspeed, wind = velocity_along(flight)
    return Regression(airspeed - ground, _is_later(flight, 0.5) * airspeed, [airspeed, *wind])


def ground_velocity_later(flight: Signals, begin: float) -> Regression:
    """Return V and the component along x in the later part of each segment, beside it and another wind in each part.

    Where V stands still, its slope over the component is that of the first part less. A V that is held follows gusts:
    no row counts unless the later V is white noise.
    """
    ground, airspeed, wind = velocity_along(flight)
    later = _is_later(flight, begin)
    of_later = airspeed[np.isfinite(airspeed) & (later > 0)]
    # correlated for 2.4 samples and more where it is held, at 1 to 20 Hz, for 1.6 at most in a blocked tube
    if not of_later.size or autocorrelation_time(of_later) > 2:
        airspeed = np.full_like(airspeed, np.nan)
    constant = np.ones_like(airspeed)
    others = [constant, *wind]
    return Regression(
        airspeed, later * ground, [ground, *others, *(later * other for other in others)]
    )


def _is_later(flight: Signals, begin: float) -> Vector:
    """Return 1 after a part of each segment, else 0."""
    first = np.searchsorted(flight.segment, flight.segment)
    number = np.arange(len(first)) - first
    size = np.bincount(flight.segment)[flight.segment]
    return (number >= begin * size).astype(float)


def course_through_the_air(flight: Signals) -> Regression:
    """Return the terms of the component along y, V sin(beta - e) in a heading that is too large by e.

    The other regressors are a steady wind with an updraft, and a ground velocity that is late in turns.
    Without turns a crosswind that changes with the airspeed looks the same, so no row counts.
    """
    airspeed = flight["airspeed"]
    direction = flight.rotation[:, :, 1]
    ground, wind = _velocity_terms(flight, 1)
    if "beta" in flight:
        ground = ground - airspeed * np.sin(flight["beta"])
    late = airspeed * flight.change(flight["psi"])
    ahead = np.exp(1j * flight["psi"][np.isfinite(flight["psi"])])
    # the mean of the unit vectors ahead is 1 of one heading, 0 of a circle (guess)
    if abs(ahead.sum()) >= 0.8 * len(ahead):
        ground = np.full_like(ground, np.nan)
    return Regression(ground, airspeed, [*wind, direction[:, 2], late])


def incidence_through_the_air(flight: Signals) -> Regression:
    """Return V alpha less the ground velocity along z in a steady wind, which a constant error of alpha makes."""
    ground, wind = _velocity_terms(flight, 2)
    return Regression(flight["airspeed"] * flight["alpha"] - ground, flight["airspeed"], wind)


def alpha_by_attitude(flight: Signals) -> Regression:
    """Return alpha and theta, which differ by the flight-path angle."""
    return Regression.with_intercept(flight["alpha"], flight["theta"])


def heading_by_course(flight: Signals) -> Regression:
    """Return the changes of the heading and of the course over the ground, which differ by wind and sideslip."""
    course = np.arctan2(flight["v_east"], flight["v_north"])
    change = wrapped(flight.change(course))
    return Regression.with_intercept(flight.change(flight["psi"]), change)


def airspeed_by_ground_speed(flight: Signals) -> Regression:
    """Return the airspeed and the speed over the ground, which differ where the wind is across the heading.

    A twentieth of the airspeed tells (guess).
    """
    ground, _ = _velocity_terms(flight, 1)
    airspeed = flight["airspeed"]
    across = np.abs(ground / airspeed - np.sin(flight["beta"]))
    ground_speed = np.hypot(flight["v_north"], flight["v_east"])
    in_wind = np.where(across > 0.05, ground_speed, np.nan)
    return Regression.with_intercept(airspeed, in_wind)


def _velocity_terms(flight: Signals, axis: int) -> tuple[Vector, list[Vector]]:
    """Return the ground velocity along a body axis, and its slopes by wind north and east."""
    direction = flight.rotation[:, :, axis]  # of the axis, in earth axes
    ground = np.sum(direction * flight.vector(EARTH_VELOCITY), axis=1)
    north, east, _ = direction.T
    return ground, [north, east]


# -- angles of the flow by the motion: alpha_dot = q + (az + g_z) / V, beta_dot = p alpha - r + (ay + g_y) / V


def alpha_by_motion(flight: Signals) -> Regression:
    """Return the change of alpha and the integral of the motion."""
    return _integrated(flight, flight["alpha"], flight["q"] + _falling(flight))


def beta_by_motion(flight: Signals) -> Regression:
    """Return the change of beta and the integral of the motion."""
    sliding = flight["ay"] + STANDARD_GRAVITY * np.cos(flight["theta"]) * np.sin(flight["phi"])
    turning = flight["p"] * np.nanmean(flight["alpha"]) - flight["r"]
    return _integrated(flight, flight["beta"], turning + sliding / flight["airspeed"])


def fall_through_the_air(flight: Signals) -> Regression:
    """Return the change of alpha and the integral of (az + g_z) / V, whose slope is the scale of V."""
    return _integrated(flight, flight["alpha"], _falling(flight), flight["q"])


def _falling(flight: Signals) -> Vector:
    """Return (az + g_z) / V."""
    return (flight["az"] + STANDARD_GRAVITY * _down(flight)) / flight["airspeed"]


def _down(flight: Signals) -> Vector:
    """Return the component of a vector down along the z axis, cos theta cos phi."""
    return np.cos(flight["theta"]) * np.cos(flight["phi"])


# -- forces: v_dot = R f + g


def level_force(flight: Signals, axis: int) -> Regression:
    """Return the terms along forward, right or down: changes of velocity and impulses."""
    force = flight.vector(SPECIFIC_FORCE)
    return Regression.with_intercept(*_level_terms(flight, axis, force))


def force_of_one_sensor(flight: Signals, axis: int) -> Regression:
    """Return the terms along a level axis that one accelerometer has a part in.

    Its impulse is x, and y the change of velocity less the impulse of the others.
    """
    force = flight.vector(SPECIFIC_FORCE)
    of_sensor = np.zeros_like(force)
    of_sensor[:, axis] = force[:, axis]
    change, x = _level_terms(flight, axis, of_sensor)
    _, others = _level_terms(flight, axis, force - of_sensor)
    return Regression.with_intercept(change - others, x)


def weight(flight: Signals) -> Regression:
    """Return az and cos theta cos phi, whose slope is -g on average."""
    return Regression(flight["az"], _down(flight), [])


def gravity(flight: Signals) -> Regression:
    """Return the terms of (R f)_down = v_down_dot - g, without an intercept.

    The force is the response: without gravity in it, it hardly varies with x.
    """
    change, impulse = _level_terms(flight, 2, flight.vector(SPECIFIC_FORCE))
    window = flight.step * flight.window_rows(PHYSICS.kinematic_window)
    return Regression(impulse, change - STANDARD_GRAVITY * window, [])


def _level_terms(flight: Signals, axis: int, force: Matrix) -> tuple[Vector, Vector]:
    """Return the change of velocity and the impulse of a force (n, 3), body axes, along forward, right or down.

    Forward and right are level, by the heading at the middle of the window.
    """
    change = flight.change(flight.vector(EARTH_VELOCITY))
    in_earth_axes = np.einsum("nij,nj->ni", flight.rotation, force)
    impulse = flight.integral(in_earth_axes)
    if axis == 2:
        return change[:, 2], impulse[:, 2]
    middle = PHYSICS.kinematic_window / 2
    heading = flight.ahead(flight["psi"], middle) + axis * np.pi / 2
    direction = np.column_stack([np.cos(heading), np.sin(heading)])
    return np.sum(direction * change[:, :2], axis=1), np.sum(direction * impulse[:, :2], axis=1)


# -- aerodynamics and thrust


def response(flight: Signals, name: str, effects: tuple[str, ...]) -> Regression:
    """Return a rate or specific force, and its effects, of which the first is x.

    Responses over V^2 are linear in angles, rates over V and surfaces. Where an angle was not
    measured, all are changes from one window to the next, in which it hardly moves. A specific force
    would not stand for it: ahead of the centre of gravity it holds the angular acceleration.
    """
    window = 0.1  # [s], shorter than the time constant of roll
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


def thrust(flight: Signals, name: str) -> Regression:
    """Return the terms of ax = thrust - parasitic and induced drag, the thrust by a channel."""
    squared = flight["airspeed"] ** 2
    az = flight["az"]
    drags = [squared, az, az**2 / squared]
    y = flight.integral(flight["ax"])
    x = flight.integral(flight[name])
    return Regression.with_intercept(y, x, *map(flight.integral, drags))
