"""The rigid body against Newton and Euler, and a top whose motion is known."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from skdgp.dynamics import (
    Aircraft,
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


def test_a_symmetric_top_precesses_at_its_closed_rate():
    """p + i q turns at (Izz - Ixx) / Ixx r while r stays (Goldstein, Poole & Safko 2002, section 5.6).

    The idea is that of case 2 of Jackson et al. (NASA/TM-2015-218675).
    """
    sizes = {"mass": 2.0, "wing_area": 0.02, "span": 0.1, "chord": 0.2}
    top = Aircraft(inertia=np.diag([0.5, 0.5, 0.8]), **sizes)
    nothing, times = np.zeros(3), np.linspace(0, 10, 1001)
    start = np.concatenate([np.zeros(6), [1.0, 0.0, 0.0, 0.0], [0.6, -0.2, 1.5]])

    def rate(t, state):
        return rigid_body_derivative(state, nothing, nothing, top, 0.0)

    states = solve_ivp(rate, (0, 10), start, "DOP853", times, rtol=1e-12, atol=1e-12).y
    p, q, r = states[10:]
    assert_allclose(p + 1j * q, (0.6 - 0.2j) * np.exp(0.9j * times), atol=1e-9)
    assert_allclose(r, 1.5, rtol=1e-12)
