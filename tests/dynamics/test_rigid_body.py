"""The rigid body against Newton and Euler, conservation laws and closed solutions, and its integration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skdgp.dynamics import (
    euler_to_quaternion,
    quaternion_to_matrix,
    rigid_body_derivative,
    rk4,
)

RNG = np.random.default_rng(5)


def random_states(n):
    return np.hstack(
        [RNG.normal(size=(n, 6)) * 20, RNG.normal(size=(n, 4)), RNG.normal(size=(n, 3))]
    )


def test_derivative_is_newton_and_euler(aircraft):
    states, force, moment = (
        random_states(20),
        RNG.normal(size=(20, 3)) * 50,
        RNG.normal(size=(20, 3)) * 9,
    )
    got = rigid_body_derivative(states, force, moment, aircraft, 9.7)
    for state, f, m, derivative in zip(states, force, moment, got, strict=True):
        rotation, velocity, rates = quaternion_to_matrix(state[6:10]), state[3:6], state[10:]
        np.testing.assert_allclose(derivative[:3], rotation @ velocity, atol=1e-12)
        newton = f / aircraft.mass + rotation.T @ [0, 0, 9.7] - np.cross(rates, velocity)
        np.testing.assert_allclose(derivative[3:6], newton, atol=1e-12)
        size, attitude = np.linalg.norm(state[6:10]), Rotation.from_quat(np.roll(state[6:10], -1))
        ahead, behind = (
            (attitude * Rotation.from_rotvec(rates * t)).as_quat(scalar_first=True)
            for t in (1e-5, -1e-5)
        )
        turning = size * (ahead - behind) / 2e-5
        sign = np.sign(ahead @ state[6:10])  # q and -q are one attitude
        np.testing.assert_allclose(derivative[6:10], sign * turning, atol=1e-7)
        euler = np.linalg.solve(aircraft.inertia, m - np.cross(rates, aircraft.inertia @ rates))
        np.testing.assert_allclose(derivative[10:], euler, atol=1e-12)


@pytest.mark.parametrize("theta", [0.0, np.pi / 2, 2.0])
def test_nothing_is_singular_at_any_attitude(aircraft, theta):
    state = np.concatenate(
        [np.zeros(3), [15.0, 1.0, 2.0], euler_to_quaternion(0.4, theta, 0.3), [0.5, 0.4, -0.2]]
    )
    assert np.isfinite(rigid_body_derivative(state, np.ones(3), np.ones(3), aircraft)).all()


def pendulum(t, y):
    return np.stack([y[..., 1], -np.sin(y[..., 0]) + 0.3 * np.cos(2 * t)], axis=-1)


def test_rk4_converges_with_fourth_order():
    start, steps = np.array([1.0, 0.2]), 10 * 2 ** np.arange(5)
    exact = rk4(pendulum, start, np.linspace(0, 3, 20001))[-1]
    errors = [
        np.abs(rk4(pendulum, start, np.linspace(0, 3, n + 1))[-1] - exact).max() for n in steps
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders[-2:], 4.0, atol=0.15)
