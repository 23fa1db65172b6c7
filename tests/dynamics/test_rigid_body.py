"""The rigid body against Newton and Euler."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from skdgp.dynamics import quaternion_to_matrix, rigid_body_derivative

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
