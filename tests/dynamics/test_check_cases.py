"""Check cases of the equations of motion: flights whose course is known without this package.

The ideas and the bodies are those of Jackson et al., Check-cases for verification of
6-degree-of-freedom flight vehicle simulations (NASA/TM-2015-218675), brought to a flat Earth where
the answer is a formula, or an independent integrator's at tight tolerances. Each class says what it
verifies.
"""

import numpy as np
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from skdgp.dynamics import (
    Aircraft,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_euler,
    quaternion_to_matrix,
    rigid_body_derivative,
)

G = 9.80665
NOTHING = np.zeros(3)
BRICK = np.diag([2.568, 8.421, 9.754]) * 1e-3  # kg m^2, of NASA's cases 2 and 3, a standard brick


def body(inertia=BRICK, mass=2.267, wing_area=0.0206, span=0.1016, chord=0.2032):
    return Aircraft(
        name="body", mass=mass, inertia=inertia, wing_area=wing_area, span=span, chord=chord
    )


def state_of(position=NOTHING, velocity=NOTHING, angles=NOTHING, rates=NOTHING):
    """A state from a velocity in NED axes [m/s] and Euler angles [rad]."""
    quaternion = euler_to_quaternion(*angles)
    return np.concatenate([position, ned_to_body(quaternion, velocity), quaternion, rates])


def flown(start, aircraft, times, loads=lambda t, state: (NOTHING, NOTHING), gravity=G):
    def rate(t, state):
        return rigid_body_derivative(state, *loads(t, state), aircraft, gravity)

    ends = times[[0, -1]]
    return solve_ivp(rate, ends, start, "DOP853", times, rtol=1e-12, atol=1e-12).y.T


HALF_A_MINUTE = np.linspace(0, 30, 3001)


class TestTumblingTop:
    """NASA's case 2. Verifies: Euler's equations, by the closed solution of a spinning top."""

    def test_a_symmetric_top_precesses_at_its_closed_rate(self):
        """p + i q turns at (Izz - Ixx) / Ixx r while r stays (Goldstein, Poole & Safko 2002, section 5.6)."""
        top, times = body(np.diag([0.5, 0.5, 0.8])), HALF_A_MINUTE[:1001]
        p, q, r = flown(state_of(rates=[0.6, -0.2, 1.5]), top, times, gravity=0.0)[:, 10:].T
        expected = (0.6 - 0.2j) * np.exp(1j * (0.8 - 0.5) / 0.5 * 1.5 * times)
        assert_allclose(p + 1j * q, expected, atol=1e-9)
        assert_allclose(r, 1.5, rtol=1e-12)


class TestLoop:
    """Verifies: nothing happens at theta = 90 degrees, where Euler angles end."""

    def test_a_loop_comes_back_to_its_start(self):
        """A centripetal force m V q on a body that pitches at constant q: a circle in the vertical plane."""
        V, q, aircraft = 30.0, 0.8, body()
        times = np.linspace(0, 2 * np.pi / q, 1001)
        loads = (np.array([0.0, 0.0, -aircraft.mass * V * q]), NOTHING)
        start = state_of(
            velocity=[V * np.cos(0.7), V * np.sin(0.7), 0.0],
            angles=(0.0, 0.0, 0.7),
            rates=[0.0, q, 0.0],
        )
        states = flown(start, aircraft, times, lambda t, state: loads, gravity=0.0)
        assert_allclose(states[-1, :6], start[:6], atol=1e-7)
        assert_allclose(
            -states[-1, 6:10], start[6:10], atol=1e-9
        )  # a full turn is minus the quaternion
        rotation = quaternion_to_matrix(states[:, 6:10])
        assert_allclose(rotation @ rotation.swapaxes(1, 2) - np.eye(3), 0.0, atol=1e-14)
        assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
        assert_allclose(states[:, 2], -V / q * (1 - np.cos(q * times)), atol=1e-7)
        pitch = quaternion_to_euler(states[:, 6:10])[:, 1]
        assert_allclose(np.abs(pitch).max(), np.pi / 2, atol=4e-3)
