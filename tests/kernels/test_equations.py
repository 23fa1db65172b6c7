"""Equation 16 typed from the paper, with the kernel's published v, A and mu."""

import numpy as np
import pytest
from numpy.random import default_rng

from skdgp.kernels import ConvolvedGaussian


def kernel_of(covariance_type, d):
    """Return two shared latents and one for each of three outputs, all different and shifted."""
    rng = default_rng(d)
    widths = {"tied": (5, 1, d)}.get(covariance_type, (5, 3, d))
    return ConvolvedGaussian(
        2,
        covariance_type=covariance_type,
        amplitude=rng.normal(size=(5, 3)) * np.r_[np.ones((2, 3)), np.eye(3)],
        length_scale=np.broadcast_to(rng.uniform(0.6, 1.6, widths), (5, 3, d)),
        shift=rng.normal(0, 0.5, (5, 3, d)),
    )


@pytest.mark.parametrize("d", [1, 2, 4])
@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_covariance_is_equation_16(covariance_type, d):
    kernel = kernel_of(covariance_type, d)
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
