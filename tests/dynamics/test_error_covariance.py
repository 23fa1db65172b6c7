"""Covariances of errors: limit cases with known answers."""

import numpy as np
import pytest

from skdgp.dynamics import euler_to_quaternion
from skdgp.dynamics._error_covariance import (
    STATES,
    error_covariances,
    standard_deviations,
    state_deviations,
)

STATE = np.r_[
    10.0, -20.0, -300.0, 25.0, -1.0, 2.0, euler_to_quaternion(0.5, 0.2, 2.0), 0.3, 0.1, -0.2
]


def integrated(correlation_time, n=400, step=0.01):
    """Deviation of the integral of a unit error, at every sample."""
    sample = np.zeros((12, 12)), np.eye(12)[:, 3:4]
    covariances = error_covariances(
        [sample] * n, [step] * (n - 1), np.zeros((12, 0)), correlation_time
    )
    return np.sqrt([covariance[3, 3] for covariance in covariances]), step * np.arange(n)


def test_a_constant_error_integrates_to_a_line():
    std, time = integrated(np.inf)
    np.testing.assert_allclose(std, time, atol=1e-12)


@pytest.mark.parametrize("tau", [0.2, 1.0])
def test_an_error_that_decorrelates_integrates_to_a_random_walk(tau):
    std, time = integrated(tau)
    exact = np.sqrt(2 * tau * (time - tau * (1 - np.exp(-time / tau))))
    np.testing.assert_allclose(std[1:], exact[1:], rtol=5e-3)


def test_a_start_follows_the_exponential_of_the_motion():
    rates = np.random.default_rng(0).normal(0, 0.5, (12, 12))
    start, step, n = np.eye(12)[:, :2], 0.02, 51
    *_, last = error_covariances([(rates, np.zeros((12, 1)))] * n, [step] * (n - 1), start)
    values, vectors = np.linalg.eig(rates)
    moved = ((vectors * np.exp(values * step * (n - 1))) @ np.linalg.inv(vectors)).real @ start
    np.testing.assert_allclose(last, moved @ moved.T, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", STATES)
def test_the_deviation_of_a_start_is_read_out_as_it_was_given(name):
    sample = np.zeros((12, 12)), np.zeros((12, 1))
    (found,) = state_deviations([sample], [], {name: 0.02}, STATE[None])
    std = dict(zip(STATES, found, strict=True))
    assert std[name] == pytest.approx(0.02)
    ground = [std[one] for one in ("v_north", "v_east", "v_down")]
    if name in ("phi", "theta", "psi"):  # an error of attitude leaves the velocity over the ground
        np.testing.assert_allclose(ground, 0.0, atol=1e-8)


def test_a_variance_that_rounding_carried_below_zero_is_none():
    np.testing.assert_array_equal(
        standard_deviations(np.diag([-1e-22, 4.0]), np.eye(2)), [0.0, 2.0]
    )
