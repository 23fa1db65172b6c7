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
