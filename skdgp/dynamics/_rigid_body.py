"""The rigid body, Newton and Euler in body axes over a flat earth and their integration in time, and its loads.

Loads are computed from coefficients, a flight table, or controls. The state has a last axis of
length 13, named in `STATE_NAMES`: position NED [m], velocity relative to the ground in body axes
[m/s], quaternion body to NED, scalar first, rates [rad/s].
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._flight.channels import THRUST_FORCES, THRUST_MOMENTS
from skdgp._flight.frames import (
    STANDARD_GRAVITY,
    components,
    cross,
    empty_vectors,
    product,
    rotation_rows,
    vector_of,
)
from skdgp._flight.tables import check_choice
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._propeller import Propeller

STATE_NAMES = ("north", "east", "down", "u", "v", "w", "q0", "q1", "q2", "q3", "p", "q", "r")
POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 10)
RATES = slice(10, 13)


def rigid_body_derivative(
    state: ArrayLike,
    force: ArrayLike,
    moment: ArrayLike,
    aircraft: Aircraft,
    gravity: ArrayLike = STANDARD_GRAVITY,
) -> Array:
    """Return d state / dt of a rigid aircraft under ``force`` and ``moment``.

    position_dot = R v;  v_dot = force / m + R^T (0, 0, g) - omega x v;
    quaternion_dot = 1/2 quaternion * omega;  omega_dot = I^-1 (moment - omega x (I omega)),
    R the rotation body to NED (Stevens, Lewis & Johnson 2016, section 1.7), for quaternions of any
    length.

    Parameters
    ----------
    state : array-like of shape (..., 13)
        Position NED [m], ground velocity in body axes [m/s], quaternion, rates [rad/s]: see
        `STATE_NAMES`.
    force, moment : array-like of shape (..., 3)
        All loads but gravity, about the centre of gravity, in body axes [N], [N m].
    aircraft : Aircraft
        Its ``mass`` and ``inertia`` are used.
    gravity : float or array-like of shape (...)
        Acceleration of gravity [m/s^2], down.

    Returns
    -------
    numpy.ndarray of shape (..., 13)

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aircraft, rigid_body_derivative
    >>> aircraft = Aircraft(mass=2.0, inertia=np.diag([1.0, 2.0, 2.5]), wing_area=0.5, span=1.6, chord=0.3)
    >>> level = np.array([0, 0, -100, 15, 0, 0, 1, 0, 0, 0, 0, 0, 0], dtype=float)
    >>> lift = np.array([0, 0, -2.0 * 9.80665])
    >>> rigid_body_derivative(level, lift, np.zeros(3), aircraft)[:6]
    array([15., 0., 0., 0., 0., 0.])
    """
    state = np.asarray(state, dtype=float)
    force = np.asarray(force, dtype=float)
    moment = np.asarray(moment, dtype=float)
    velocity, rates = state[..., VELOCITY], state[..., RATES]
    q0, e1, e2, e3 = components(state[..., ATTITUDE])
    p, q, r = components(0.5 * rates)
    rows = rotation_rows(q0, e1, e2, e3)
    weight = np.asarray(gravity)[..., None] * vector_of(*rows[2])
    shape = np.broadcast(state[..., 0], force[..., 0], moment[..., 0]).shape
    derivative = empty_vectors(shape, len(STATE_NAMES))
    derivative[..., POSITION] = product(rows, velocity)
    derivative[..., VELOCITY] = force / aircraft.mass + weight - cross(rates, velocity)
    derivative[..., 6] = -(e1 * p + e2 * q + e3 * r)
    derivative[..., 7] = q0 * p + e2 * r - e3 * q
    derivative[..., 8] = q0 * q + e3 * p - e1 * r
    derivative[..., 9] = q0 * r + e1 * q - e2 * p
    net_moment = moment - gyroscopic_moment(rates, aircraft)
    derivative[..., RATES] = net_moment @ aircraft.inertia_inverse
    return derivative


def gyroscopic_moment(rates: Array, aircraft: Aircraft) -> Array:
    """Return omega x (I omega), (..., 3) [N m], of body rates (..., 3) [rad/s]."""
    return cross(rates, rates @ aircraft.inertia)


def rk4_step(
    derivative: Callable[[Any, Array], Array], t: Any, state: Array, dt: float | Array
) -> Array:
    """Return the state one step ``dt`` [s] after ``t``, of d state / dt = derivative(t, state), by Runge and Kutta.

    The derivative is evaluated at t, twice at t + dt/2 and at t + dt; the error of a step is of
    order dt^5.

    Parameters
    ----------
    derivative : callable
        ``derivative(t, state)``, of the state's shape.
    t : float
        Time [s].
    state : ndarray (...)
        Leading axes hold independent cases.
    dt : float or ndarray
        Step [s].

    Returns
    -------
    ndarray (...)
    """
    k1 = derivative(t, state)
    k2 = derivative(t + 0.5 * dt, state + 0.5 * dt * k1)
    k3 = derivative(t + 0.5 * dt, state + 0.5 * dt * k2)
    k4 = derivative(t + dt, state + dt * k3)
    return state + (dt / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


def aerodynamic_loads(
    coefficients: ArrayLike, airspeed: ArrayLike, density: ArrayLike, aircraft: Aircraft
) -> tuple[Array, Array]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of coefficients (..., 6).

    F_A = qbar S (CX, CY, CZ),  M_A = qbar S (b Cl, c Cm, b Cn),  qbar = rho V^2 / 2, in body axes about the centre of
    gravity.

    Parameters
    ----------
    coefficients : array-like (..., 6)
        CX CY CZ Cl Cm Cn.
    airspeed, density : array-like (...)
        V [m/s] and rho [kg/m^3].
    aircraft : Aircraft

    Returns
    -------
    force, moment : ndarray (..., 3)

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aircraft, aerodynamic_loads
    >>> aircraft = Aircraft(mass=2, inertia=np.eye(3), wing_area=0.5, span=2, chord=0.25)
    >>> force, moment = aerodynamic_loads([-0.05, 0, -0.4, 0, 0.01, 0], 20.0, 1.2, aircraft)
    >>> force.round(3).tolist(), moment.round(3).tolist()
    ([-6.0, 0.0, -48.0], [0.0, 0.3, 0.0])
    """
    coefficients = np.asarray(coefficients, dtype=float)
    scale = dynamic_pressure(airspeed, density)[..., None] * aircraft.wing_area
    return scale * coefficients[..., :3], scale * aircraft.moment_lengths * coefficients[..., 3:]


def dynamic_pressure(airspeed: ArrayLike, density: ArrayLike) -> Array:
    """Return qbar = rho V^2 / 2 [Pa]."""
    return 0.5 * np.asarray(density, dtype=float) * np.square(np.asarray(airspeed, dtype=float))


def propeller_loads(
    aircraft: Aircraft, propeller_speed: ArrayLike, airspeed: ArrayLike, density: ArrayLike
) -> tuple[Array, Array]:
    """Return force (..., 3) [N] and moment (..., 3) [N m] of the aircraft's propeller, about the centre of gravity.

    Equation 7 of Hemakumara & Sukkarieh (2011): F_T = T(Omega, V) d,  M_T = r_T x F_T + Q d. Raises ValueError if the
    aircraft has no propeller.

    Parameters
    ----------
    aircraft : Aircraft
    propeller_speed, airspeed, density : array-like (...)
        Omega [rad/s], V [m/s], rho [kg/m^3].

    Returns
    -------
    force, moment : ndarray (..., 3)
        In body axes.
    """
    propeller = aircraft.propeller
    if propeller is None:
        raise ValueError(
            f"{aircraft!r} has no propeller: give propeller=Propeller.from_size(diameter, pitch) to "
            "Aircraft."
        )
    thrust = propeller.thrust(propeller_speed, airspeed, density)
    torque = propeller.torque(propeller_speed, airspeed, density)
    return aircraft.engine_line.loads(thrust, torque)


def propulsive_loads(
    values: Mapping | pd.DataFrame, aircraft: Aircraft, thrust: str | None = "auto"
) -> tuple[Array, Array]:
    """Return the propulsive force (..., 3) [N] and moment (..., 3) [N m], in body axes about the CG.

    ``values`` are a flight table, or controls with ``airspeed`` and ``density`` by name, (...).
    ``thrust`` "auto": ``thrust_x`` ... ``thrust_z``, absent ones zero, and ``thrust_l`` ...
    ``thrust_n``, or without any of these r_T x F_T at the thrust line's position; else ``thrust``
    [N] along the thrust line; else the propeller of the aircraft at ``propeller_speed`` or, where
    its ``speed_range`` is given, at ``throttle``. None: zero, for a glider, or for an unknown
    thrust as part of the coefficients. Raises ValueError if nothing gives the thrust.
    """
    airspeed = np.asarray(values["airspeed"], dtype=float)
    shape = airspeed.shape
    if thrust is None:
        return np.zeros((*shape, 3)), np.zeros((*shape, 3))
    check_choice("thrust", thrust, ("auto", None))
    line = aircraft.engine_line
    if any(name in values for name in THRUST_FORCES):
        force = stacked(values, THRUST_FORCES, shape)
        if any(name in values for name in THRUST_MOMENTS):
            return force, stacked(values, THRUST_MOMENTS, shape)
        return force, cross(line.position, force)
    if "thrust" in values:
        return line.loads(values["thrust"])
    speed = propeller_speed_of(aircraft.propeller, values)
    if speed is None:
        lacking = "no propeller_speed [rad/s]" if aircraft.propeller else "no propeller"
        raise ValueError(
            "The thrust is unknown: there is neither thrust_x, thrust_y, thrust_z nor thrust [N], and "
            f"{lacking}. Add them, or Propeller.from_size(diameter, pitch) (--propeller 10x5) to the aircraft and "
            "propeller_speed, or throttle with speed_range=(idle, full); or say thrust=None "
            "(--thrust none) for a glider, or to leave an unknown thrust in the coefficients."
        )
    return propeller_loads(aircraft, speed, airspeed, values["density"])


def propeller_speed_of(propeller: Propeller | None, values: Mapping | pd.DataFrame) -> Array | None:
    """Return the propeller speed [rad/s] of a flight or of controls, by the throttle if need be; None if unknown."""
    if propeller is None:
        return None
    if "propeller_speed" in values:
        return np.asarray(values["propeller_speed"], dtype=float)
    if propeller.speed_range is None or "throttle" not in values:
        return None
    return propeller.speed_at(values["throttle"])


def thrust_control(aircraft: Aircraft, thrust: str | None) -> str | None:
    """Return the control that sets the thrust of an aircraft in trim; None without thrust."""
    if thrust is None:
        return None
    if aircraft.propeller is None:
        return "thrust"
    return "propeller_speed" if aircraft.propeller.speed_range is None else "throttle"


def stacked(values: Mapping | pd.DataFrame, names: Iterable[str], shape: tuple[int, ...]) -> Array:
    """Return values by name as (..., 3), zero where one is absent."""
    columns = [np.asarray(values[name], dtype=float) if name in values else 0.0 for name in names]
    return np.stack([np.broadcast_to(column, shape) for column in columns], axis=-1)
