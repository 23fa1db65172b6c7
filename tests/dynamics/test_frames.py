"""Frames against SciPy's rotations, and against each other."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from skdgp.dynamics import (
    air_data,
    air_velocity,
    body_to_ned,
    euler_to_matrix,
    euler_to_quaternion,
    ned_to_body,
    quaternion_to_euler,
    quaternion_to_matrix,
)

RNG = default_rng(3)
EULER = RNG.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], (50, 3))


@pytest.mark.parametrize("scale", [1.0, -1.0, 0.4, 7.0])
def test_rotations_are_scipys_intrinsic_yaw_pitch_roll(scale):
    """Length and sign of a quaternion do not matter."""
    matrix = Rotation.from_euler("ZYX", EULER[:, ::-1]).as_matrix()
    assert_allclose(euler_to_matrix(*EULER.T), matrix, atol=1e-14)
    quaternion = scale * euler_to_quaternion(*EULER.T)
    assert_allclose(quaternion_to_matrix(quaternion), matrix, atol=1e-14)
    assert_allclose(quaternion_to_euler(quaternion), EULER, atol=1e-12)
    vector = RNG.normal(size=(50, 3))
    turned = np.einsum("nij,nj->ni", matrix, vector)
    assert_allclose(body_to_ned(quaternion, vector), turned, atol=1e-14)
    assert_allclose(ned_to_body(quaternion, turned), vector, atol=1e-14)


def test_air_data_round_trip():
    air = RNG.uniform([5, -0.5, -0.6], [60, 0.5, 0.6], (40, 3)).T
    assert_allclose(air_data(air_velocity(*air)), air, atol=1e-12)
