"""The rigid body: Newton and Euler in body axes over a flat earth, and their integration in time.

The state has a last axis of length 13, named in `STATE_NAMES`: position NED [m], velocity relative
to the ground in body axes [m/s], quaternion body to NED, scalar first, rates [rad/s].
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.frames import cross
from skdgp.dynamics._aircraft import Aircraft

STATE_NAMES = ("north", "east", "down", "u", "v", "w", "q0", "q1", "q2", "q3", "p", "q", "r")
POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)


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
    state, force, moment = (np.asarray(x, dtype=float) for x in (state, force, moment))
    # Of one aircraft as plain numbers, which are several times faster than arrays without axes.
    single = state.ndim == force.ndim == moment.ndim == 1
    u, v, w, q0, e1, e2, e3, p, q, r = (
        state[3:].tolist() if single else (state[..., k] for k in range(3, 13))
    )
    fx, fy, fz = force.tolist() if single else (force[..., k] for k in range(3))
    # Rows of R from one shared set of products: this runs four times in every step of every
    # simulation.
    s = 2.0 / (q0 * q0 + e1 * e1 + e2 * e2 + e3 * e3)
    s1, s2, s3 = s * e1, s * e2, s * e3
    x1, x2, x3 = s1 * q0, s2 * q0, s3 * q0
    y11, y12, y13, y22, y23, y33 = s1 * e1, s1 * e2, s1 * e3, s2 * e2, s2 * e3, s3 * e3
    down_x, down_y, down_z = y13 - x2, y23 + x1, 1.0 - y11 - y22
    derivative = np.empty(
        (
            *np.broadcast_shapes(state.shape[:-1], force.shape[:-1], moment.shape[:-1]),
            len(STATE_NAMES),
        )
    )
    derivative[..., 0] = (1.0 - y22 - y33) * u + (y12 - x3) * v + (y13 + x2) * w
    derivative[..., 1] = (y12 + x3) * u + (1.0 - y11 - y33) * v + (y23 - x1) * w
    derivative[..., 2] = down_x * u + down_y * v + down_z * w
    derivative[..., 3] = fx / aircraft.mass + gravity * down_x - q * w + r * v
    derivative[..., 4] = fy / aircraft.mass + gravity * down_y - r * u + p * w
    derivative[..., 5] = fz / aircraft.mass + gravity * down_z - p * v + q * u
    derivative[..., 6] = -0.5 * (e1 * p + e2 * q + e3 * r)
    derivative[..., 7] = 0.5 * (q0 * p + e2 * r - e3 * q)
    derivative[..., 8] = 0.5 * (q0 * q + e3 * p - e1 * r)
    derivative[..., 9] = 0.5 * (q0 * r + e1 * q - e2 * p)
    derivative[..., RATES] = (
        moment - gyroscopic_moment(state[..., RATES], aircraft)
    ) @ aircraft.inertia_inverse
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


def rk4(derivative: Callable[[float, Array], Array], state0: ArrayLike, times: ArrayLike) -> Array:
    """Return the states at ``times`` [s] (n_times,), (n_times, ...), by `rk4_step` from each time to the next.

    ``state0`` (...) is the state at the first time; its leading axes hold independent cases.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import rk4
    >>> rk4(lambda t, y: -y, np.array([1.0, 2.0]), np.linspace(0, 1, 11))[-1].round(5)
    array([0.36788, 0.73576])
    """
    times = np.asarray(times, dtype=float)
    states = np.empty(times.shape + np.shape(state0))
    states[0] = state0
    for k in range(len(times) - 1):
        states[k + 1] = rk4_step(derivative, times[k], states[k], times[k + 1] - times[k])
    return states
