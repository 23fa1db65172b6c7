"""The classical fourth-order Runge-Kutta method, for any array-valued state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["rk4", "rk4_step"]


def rk4_step(
    derivative: Callable[[float, np.ndarray], np.ndarray], t: float, state: np.ndarray, dt: float | np.ndarray
) -> np.ndarray:
    """Return the state one step ``dt`` [s] after ``t``, of d state / dt = derivative(t, state).

    The derivative is taken at t, twice at t + dt/2 and at t + dt; the error of a step is of order dt^5.

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
        The state at t + dt.
    """
    k1 = derivative(t, state)
    k2 = derivative(t + 0.5 * dt, state + 0.5 * dt * k1)
    k3 = derivative(t + 0.5 * dt, state + 0.5 * dt * k2)
    k4 = derivative(t + dt, state + dt * k3)
    return state + (dt / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)


def rk4(derivative: Callable[[float, np.ndarray], np.ndarray], state0: ArrayLike, times: ArrayLike) -> np.ndarray:
    """Return the states at ``times`` [s], one step from each time to the next, starting from ``state0``.

    Parameters
    ----------
    derivative : callable
        ``derivative(t, state)``, of the state's shape.
    state0 : array-like of shape (...)
        State at ``times[0]``; leading axes hold independent cases integrated together.
    times : array-like of shape (n_times,)
        Steps need not be equal.

    Returns
    -------
    numpy.ndarray of shape (n_times, ...)

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
