"""Covariances of errors: limit cases with known answers."""

import numpy as np
import pytest

from skdgp.dynamics._error_covariance import (
    error_covariances,
    standard_deviations,
)


def integrated(correlation_time, n=400, step=0.01):
    """Deviation of the integral of a unit error, at every sample."""
    sample = np.zeros((12, 12)), np.eye(12)[:, 3:4]
    covariances = error_covariances(
        [sample] * n, [step] * (n - 1), np.zeros((12, 0)), correlation_time
    )
    return np.sqrt([covariance[3, 3] for covariance in covariances]), step * np.arange(n)


@pytest.mark.parametrize("tau", [0.2, 1.0])
def test_an_error_that_decorrelates_integrates_to_a_random_walk(tau):
    std, time = integrated(tau)
    exact = np.sqrt(2 * tau * (time - tau * (1 - np.exp(-time / tau))))
    np.testing.assert_allclose(std[1:], exact[1:], rtol=5e-3)


def test_a_variance_that_rounding_carried_below_zero_is_none():
    np.testing.assert_array_equal(
        standard_deviations(np.diag([-1e-22, 4.0]), np.eye(2)), [0.0, 2.0]
    )
