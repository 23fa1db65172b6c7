"""Equations 14 to 16 typed from the paper, with the kernel's published v, A and mu."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import trapezoid

from skdgp.kernels import ConvolvedGaussian


def kernel_of(covariance_type, d, n_latent=2, P=2, seed=0):
    rng = default_rng(seed)
    M = n_latent + P
    widths = {"tied": (M, 1, d)}.get(covariance_type, (M, P, d))
    shift = rng.normal(0, 0.5, (M, P, d)) * (np.arange(M) < n_latent)[:, None, None]
    return ConvolvedGaussian(
        n_latent,
        covariance_type=covariance_type,
        amplitude=rng.normal(size=(M, P)) * np.r_[np.ones((n_latent, P)), np.eye(P)],
        length_scale=np.broadcast_to(rng.uniform(0.6, 1.6, widths), (M, P, d)),
        shift=shift,
    )


def matrices(kernel):
    """The precisions as matrices, (M, P, d, d)."""
    return kernel.A[..., None] * np.eye(kernel.n_features)


def smoothing(kernel, m, i, s):
    """Equation 15's impulse response h_mi at s, (..., d)."""
    away = s - kernel.mu[m, i]
    return kernel.v[m, i] * np.exp(
        -0.5 * np.einsum("...k,kl,...l->...", away, matrices(kernel)[m, i], away)
    )


@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_covariance_is_the_integral_of_the_filters(covariance_type):
    kernel = kernel_of(covariance_type, 2, seed=3)
    delta = np.array([0.4, -0.3])
    axis = np.linspace(-10, 10, 301)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    for i in range(2):
        for j in range(2):
            product = sum(
                smoothing(kernel, m, i, grid) * smoothing(kernel, m, j, grid - delta)
                for m in range(4)
            )
            total = trapezoid(
                trapezoid(product, axis), axis
            )  # of spectral order: the Gaussians vanish at the ends
            got = kernel.block(i, j, delta[None], np.zeros((1, 2)))[0, 0]
            assert got == pytest.approx(total, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("d", [1, 2, 4])
@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_covariance_is_equation_16(covariance_type, d):
    kernel = kernel_of(covariance_type, d, P=3, seed=d)
    rng = default_rng(9)
    X, Z = rng.normal(size=(3, d)), rng.normal(size=(2, d))
    A, v, mu = matrices(kernel), kernel.v, kernel.mu
    for i in range(3):
        for j in range(3):
            for a, x in enumerate(X):
                for b, z in enumerate(Z):
                    expected = 0.0
                    for m in range(len(v)):
                        both = A[m, i] + A[m, j]
                        S = A[m, i] @ np.linalg.inv(both) @ A[m, j]
                        away = x - z - (mu[m, i] - mu[m, j])
                        size = (
                            (2 * np.pi) ** (d / 2)
                            * v[m, i]
                            * v[m, j]
                            / np.sqrt(np.linalg.det(both))
                        )
                        expected += size * np.exp(-0.5 * away @ S @ away)
                    assert kernel.block(i, j, X, Z)[a, b] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_published_parameters(covariance_type):
    kernel = kernel_of(covariance_type, 3, n_latent=2, P=2, seed=6)
    assert kernel.v.shape == (4, 2)
    assert kernel.mu.shape == (4, 2, 3)
    assert kernel.A.shape == (4, 2, 3)
    # Shared latents first, then one for each output, which feeds that output alone.
    assert_array_equal(kernel.v[2:] != 0, np.eye(2, dtype=bool))
    assert (np.linalg.eigvalsh(matrices(kernel)) > 0).all()
    # w = v pi^(d/4) |A|^(-1/4): the variance is the sum of squared amplitudes.
    w = kernel.v * np.pi**0.75 / np.linalg.det(matrices(kernel)) ** 0.25
    assert_allclose(w, kernel.amplitude, rtol=1e-12)
    for i in range(2):
        assert_allclose(kernel.block_diag(i, np.zeros((1, 3))), (w[:, i] ** 2).sum())
