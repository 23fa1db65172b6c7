"""Equation 16 typed from the paper, with the kernel's published v, A and mu."""

import numpy as np
import pytest
from made_kernels import convolved
from numpy.random import default_rng


@pytest.mark.parametrize("d", [1, 2, 4])
@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_covariance_is_equation_16(covariance_type, d):
    kernel = convolved(2, 3, d, covariance_type, seed=d, shift=True)
    x, z = default_rng(9).normal(size=(2, d))
    v, mu = kernel.v, kernel.mu
    for i, j in np.ndindex(3, 3):
        expected = 0.0
        for m in range(len(v)):
            first, second = np.diag(kernel.A[m, i]), np.diag(kernel.A[m, j])
            S = first @ np.linalg.inv(first + second) @ second
            away = x - z - (mu[m, i] - mu[m, j])
            size = (2 * np.pi) ** (d / 2) * v[m, i] * v[m, j]
            size /= np.sqrt(np.linalg.det(first + second))
            expected += size * np.exp(-0.5 * away @ S @ away)
        assert kernel.block(i, j, x[None], z[None]).item() == pytest.approx(expected, rel=1e-10)


def test_curvature_by_equal_widths_is_the_second_derivative_of_the_variance(central_difference):
    """At one sample a covariance depends on widths by the factor alone, of which the slope is zero."""
    kernel = convolved(2, 3, 2, "diag", seed=4)
    kernel = kernel.set_params(length_scale=np.ones((5, 3, 2)), amplitude=np.abs(kernel.amplitude))
    x = np.zeros((1, 2))

    def slopes(theta):
        return kernel.clone_with_theta(theta).block_gradient(0, 1, x, x, np.ones((1, 1)))

    of_widths = kernel.theta_places()["length_scale"][:2, :2].ravel()
    assert slopes(kernel.theta)[of_widths] == pytest.approx(0.0, abs=1e-15)
    found = np.zeros((kernel.n_dims,) * 2)
    kernel.add_curvature(found, {(0, 1): -slopes(kernel.theta)})
    exact = -central_difference(slopes, kernel.theta)
    places = np.ix_(of_widths, of_widths)
    assert found[places] == pytest.approx(exact[places], abs=1e-9)
    found[places] = 0.0
    assert not found.any()
