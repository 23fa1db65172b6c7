"""The rigid body against Newton and Euler in vector form, conservation laws and closed solutions."""

import numpy as np

from skdgp.dynamics import (
    STATE_NAMES,
    quaternion_rate,
    quaternion_to_matrix,
    rigid_body_derivative,
)

RNG = np.random.default_rng(5)


def random_states(n):
    return np.hstack([RNG.normal(size=(n, 6)) * 20, RNG.normal(size=(n, 4)), RNG.normal(size=(n, 3))])


def test_derivative_is_newton_and_euler(aircraft):
    states, force, moment = random_states(20), RNG.normal(size=(20, 3)) * 50, RNG.normal(size=(20, 3)) * 9
    got = rigid_body_derivative(states, force, moment, aircraft, 9.7)
    for state, f, m, derivative in zip(states, force, moment, got, strict=True):
        rotation, velocity, rates = quaternion_to_matrix(state[6:10]), state[3:6], state[10:]
        np.testing.assert_allclose(derivative[:3], rotation @ velocity, atol=1e-12)
        newton = f / aircraft.mass + rotation.T @ [0, 0, 9.7] - np.cross(rates, velocity)
        np.testing.assert_allclose(derivative[3:6], newton, atol=1e-12)
        np.testing.assert_allclose(derivative[6:10], quaternion_rate(state[6:10], rates), atol=1e-12)
        euler = np.linalg.solve(aircraft.inertia, m - np.cross(rates, aircraft.inertia @ rates))
        np.testing.assert_allclose(derivative[10:], euler, atol=1e-12)


def test_leading_axes_broadcast(aircraft):
    states = random_states(6).reshape(2, 3, 13)
    one = rigid_body_derivative(states[1, 2], np.ones(3), np.ones(3), aircraft)
    assert one.shape == (len(STATE_NAMES),)
    many = rigid_body_derivative(states, np.ones(3), np.ones((3, 3)), aircraft)
    np.testing.assert_allclose(many[1, 2], one, atol=1e-12)
