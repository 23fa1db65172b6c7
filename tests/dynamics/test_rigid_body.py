"""The rigid body against Newton and Euler, and flights whose course is a formula."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from skdgp.dynamics import (
    Aircraft,
    euler_to_quaternion,
    quaternion_to_matrix,
    rigid_body_derivative,
)

RNG = default_rng(5)


def test_derivative_is_newton_and_euler(aircraft):
    states = RNG.normal(size=(20, 13)) * np.repeat([20.0, 1.0], [6, 7])
    force, moment = RNG.normal(size=(20, 3)) * 50, RNG.normal(size=(20, 3)) * 9
    found = rigid_body_derivative(states, force, moment, aircraft, 9.7)
    for state, f, m, derivative in zip(states, force, moment, found, strict=True):
        _, velocity, quaternion, rates = np.split(state, [3, 6, 10])
        rotation = quaternion_to_matrix(quaternion)
        assert_allclose(derivative[:3], rotation @ velocity, atol=1e-12)
        newton = f / aircraft.mass + rotation.T @ [0, 0, 9.7] - np.cross(rates, velocity)
        assert_allclose(derivative[3:6], newton, atol=1e-12)
        attitude = Rotation.from_quat(quaternion, scalar_first=True)
        ahead, behind = (
            (attitude * Rotation.from_rotvec(rates * t)).as_quat(scalar_first=True)
            for t in (1e-5, -1e-5)
        )
        turning = np.linalg.norm(quaternion) * (ahead - behind) / 2e-5
        sign = np.sign(ahead @ quaternion)  # q and -q are one attitude
        assert_allclose(derivative[6:10], sign * turning, atol=1e-7)
        euler = np.linalg.solve(aircraft.inertia, m - np.cross(rates, aircraft.inertia @ rates))
        assert_allclose(derivative[10:], euler, atol=1e-12)


def test_one_state_under_many_loads(aircraft):
    state = RNG.normal(size=13)
    force, moment = RNG.normal(size=(5, 3)), RNG.normal(size=(5, 3))
    found = rigid_body_derivative(state, force, moment, aircraft)
    each = [
        rigid_body_derivative(state, *loads, aircraft) for loads in zip(force, moment, strict=True)
    ]
    assert_allclose(found, each, rtol=1e-12)


SIZES = {"wing_area": 0.0182, "span": 0.152, "chord": 0.152}


def test_a_loop_passes_theta_of_90_degrees_and_comes_back():
    """A centripetal force m V q on a body that pitches at q; a full turn is minus the quaternion."""
    V, q, mass = 30.0, 0.8, 2.0
    body = Aircraft(mass=mass, inertia=np.diag([0.5, 0.6, 0.8]), **SIZES)
    loads = np.array([0.0, 0.0, -mass * V * q]), np.zeros(3)

    def rate(t, state):
        return rigid_body_derivative(state, *loads, body, 0.0)

    start = np.concatenate([[0, 0, 0, V, 0, 0], euler_to_quaternion(0.0, 0.0, 0.7), [0, q, 0]])
    times = np.linspace(0, 2 * np.pi / q, 101)
    states = solve_ivp(rate, times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-12).y
    assert_allclose(states[2], -V / q * (1 - np.cos(q * times)), atol=1e-7)
    assert_allclose(states[:6, -1], start[:6], atol=1e-7)
    assert_allclose(states[6:10, -1], -start[6:10], atol=1e-9)
