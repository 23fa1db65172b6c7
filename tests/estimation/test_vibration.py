"""Directions in which an oscillation shakes the six inertial sensors."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_less

from skdgp.estimation import vibration_covariance

NOISE = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])  # [m/s^2], [rad/s]
SIZES = [2.0, 1.5, 2.5, 0.03, 0.05, 0.02]
PHASES = [0.3, 1.9, -2.5, 0.8, -1.2, 2.9]
MIRROR = [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
STEP, N_ROWS, RATE = 0.02, 4000, 50.0


def oscillation(frequency, sizes=SIZES):
    """Return readings (n, 6) of an oscillation [Hz]."""
    turn = 2 * np.pi * frequency * STEP * np.arange(N_ROWS)
    return sizes * np.sin(turn[:, None] + PHASES)


def covariance_of(shake, seen_by_path=0.0):
    """Return what is found in noisy readings of an oscillation, of which the path sees a part."""
    readings = shake + default_rng(0).normal(0.0, NOISE, shake.shape)
    return vibration_covariance(readings, -seen_by_path * readings, RATE)


@pytest.mark.parametrize(("frequency", "seen_by_path"), [(11.3, 0.0), (88.0, 0.0), (1.7, 0.5)])
def test_noise_of_its_two_directions(frequency, seen_by_path):
    """Fast ones are seen in the readings alone, 88 Hz as 12 Hz; slow ones by the path over the ground."""
    shake = oscillation(frequency)
    found = covariance_of(shake, seen_by_path) / np.outer(NOISE, NOISE)
    variances, directions = np.linalg.eigh(found)
    assert_allclose(variances[:4], 0.0, atol=1e-9 * variances[-1])
    left = (shake / NOISE) @ directions[:, :4]
    assert_array_less(left.std(axis=0), 0.5)  # of the noise; the oscillation has 20
    within = (shake / NOISE) @ directions[:, 4:]
    assert_array_less(0.9 * within.var(axis=0).sum(), variances[-2:].sum())


def test_of_a_mirrored_flight():
    shake = oscillation(8.0)
    direct = vibration_covariance(shake, 0.0 * shake, RATE)
    mirrored = vibration_covariance(MIRROR * shake, 0.0 * shake, RATE)
    assert_allclose(mirrored, np.outer(MIRROR, MIRROR) * direct, atol=1e-12)


def test_none_of_noise_motion_and_errors_of_the_attitude():
    rng = default_rng(1)
    noise = rng.normal(0.0, NOISE, (N_ROWS, 6))
    one_axis = oscillation(9.0, sizes=[0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    attitude = rng.normal(0.0, 10 * NOISE, (N_ROWS, 6)) * [0, 0, 0, 1, 1, 1]
    two_noisy = rng.normal(0.0, NOISE, (N_ROWS, 6)) * [1, 10, 10, 1, 1, 1]
    still = np.zeros_like(noise)
    for readings, off_path in (
        (noise, noise),
        (one_axis + noise, noise),
        (noise, attitude),
        (two_noisy, noise),
        (still, still),
    ):
        assert not vibration_covariance(readings, off_path, RATE).any()


def test_slow_logs_do_not_tell_it_from_motion():
    shake = oscillation(8.0)
    assert vibration_covariance(shake, shake, RATE).any()
    assert not vibration_covariance(shake, shake, 25.0).any()
