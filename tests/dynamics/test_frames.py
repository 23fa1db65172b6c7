"""Frames against SciPy's rotations, against each other, and against what the words mean."""

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


def test_matrix_is_scipys_intrinsic_yaw_pitch_roll():
    expected = Rotation.from_euler("ZYX", EULER[:, ::-1]).as_matrix()
    assert_allclose(euler_to_matrix(*EULER.T), expected, atol=1e-14)


@pytest.mark.parametrize("scale", [1.0, -1.0, 0.4, 7.0])
def test_length_and_sign_of_a_quaternion_do_not_matter(scale):
    quaternion, vector = euler_to_quaternion(*EULER.T), RNG.normal(size=(50, 3))
    assert_allclose(
        quaternion_to_matrix(scale * quaternion), quaternion_to_matrix(quaternion), atol=1e-14
    )
    assert_allclose(quaternion_to_euler(scale * quaternion), EULER, atol=1e-12)
    assert_allclose(
        body_to_ned(scale * quaternion, vector), body_to_ned(quaternion, vector), atol=1e-14
    )


def test_turning_a_vector_is_the_matrix_product_and_its_inverse():
    quaternion, vector = euler_to_quaternion(*EULER.T), RNG.normal(size=(50, 3))
    turned = np.einsum("nij,nj->ni", quaternion_to_matrix(quaternion), vector)
    assert_allclose(body_to_ned(quaternion, vector), turned, atol=1e-14)
    assert_allclose(ned_to_body(quaternion, turned), vector, atol=1e-14)


def test_signs_mean_what_pilots_mean():
    nose, right = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    assert_allclose(body_to_ned(euler_to_quaternion(0, 0, np.pi / 2), nose), [0, 1, 0], atol=1e-15)
    assert body_to_ned(euler_to_quaternion(0, 0.2, 0.7), nose)[2] < 0, "pitch > 0 raises the nose"
    assert body_to_ned(euler_to_quaternion(0.2, 0.1, 0.7), right)[2] > 0, (
        "roll > 0 lowers the right wing"
    )


def test_air_data_round_trip():
    airspeed, alpha, beta = RNG.uniform([5, -0.5, -0.6], [60, 0.5, 0.6], (40, 3)).T
    for got, expected in zip(
        air_data(air_velocity(airspeed, alpha, beta)), (airspeed, alpha, beta), strict=True
    ):
        assert_allclose(got, expected, atol=1e-12)
