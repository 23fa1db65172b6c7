"""Steps of the covariance of the parameters, by their definitions."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.estimation._air_covariance import (
    add_model_error,
    add_scale_error,
    correlated_scatter,
    inflate_for_misfit,
    misfit_of,
    mix_with_prior,
    sandwich,
    widen,
    without_estimate,
)

ROOT = default_rng(0).standard_normal((3, 3))
COVARIANCE = ROOT @ ROOT.T
PRIOR_STD = np.array([1.0, 2.0, 3.0])


def test_sandwich_of_a_regression_is_the_covariance_of_its_coefficients():
    """Least squares with weights that are wrong: (X^T W X)^-1 X^T W S W X (X^T W X)^-1."""
    rng = default_rng(1)
    X = rng.standard_normal((20, 3))
    weights, variances = rng.uniform(1, 2, (2, 20))
    coefficients = np.linalg.solve(X.T @ (weights[:, None] * X), X.T * weights)  # by y
    scatter = X.T @ ((weights**2 * variances)[:, None] * X)
    expected = coefficients @ np.diag(variances) @ coefficients.T
    assert_allclose(sandwich(X.T @ (weights[:, None] * X), scatter), expected)


def test_scatter_of_blocks_counts_neighbours_half():
    blocks = default_rng(2).standard_normal((5, 2))
    expected = sum(np.outer(b, b) for b in blocks)
    for before, after in pairwise(blocks):
        expected = expected + 0.5 * (np.outer(before, after) + np.outer(after, before))
    assert_allclose(correlated_scatter(blocks), expected)


def test_widened_variances_are_the_larger_ones_and_correlations_stay():
    other = np.diag(np.diag(COVARIANCE) * [4.0, 0.25, 1.0])
    wide = widen(COVARIANCE, other)
    assert_allclose(np.diag(wide) / np.diag(COVARIANCE), [4.0, 1.0, 1.0])
    assert_allclose(wide[0, 1:], 2.0 * COVARIANCE[0, 1:])


def test_misfit_is_at_least_one():
    assert misfit_of(np.array([0.1, -0.2, 0.3]), PRIOR_STD) == 1.0
    assert misfit_of(2.5 * PRIOR_STD, PRIOR_STD) == pytest.approx(2.5)
    assert_allclose(inflate_for_misfit(COVARIANCE, 2.5), 6.25 * COVARIANCE)


def test_errors_of_the_model_are_independent_and_those_of_an_angle_are_common():
    derivatives = np.array([2.0, -3.0])
    error = np.zeros((3, 3))
    error[:2, :2] = np.diag([0.04, 0.09])
    assert_allclose(add_model_error(COVARIANCE, derivatives, 0.1) - COVARIANCE, error)
    error[:2, :2] = [[0.04, -0.06], [-0.06, 0.09]]
    assert_allclose(add_scale_error(COVARIANCE, derivatives, 0.1) - COVARIANCE, error)


def test_parameters_without_evidence_have_the_variance_of_their_prior():
    mixed = mix_with_prior(COVARIANCE, PRIOR_STD, np.array([0.0, 1.0, 0.6]))
    assert_allclose(mixed[0, :2], [COVARIANCE[0, 0], 0.0])
    assert_allclose(mixed[1], [0.0, 4.0, 0.0])
    assert_allclose(mixed[2, 2], 0.64 * COVARIANCE[2, 2] + 0.36 * 9.0)


def test_without_an_estimate_the_distance_from_the_prior_counts():
    offset = np.array([0.5, 0.0, -1.0])
    expected = np.diag([1.25, 4.0, 10.0])
    expected[0, 2] = expected[2, 0] = -0.5
    assert_allclose(without_estimate(offset, PRIOR_STD), expected)
