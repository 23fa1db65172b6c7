"""Kernels whose every hyperparameter is different."""

import numpy as np
from numpy.random import default_rng

from skdgp.kernels import ConvolvedGaussian, LinearTrend


def convolved(
    n_latent=2, P=3, d=2, covariance_type="diag", private=True, seed=0, shift=False, **bounds
):
    """A kernel whose every amplitude, width and, on request, shift is different."""
    rng = default_rng(seed)
    M = n_latent + P * private
    widths = {"tied": (M, 1, d)}.get(covariance_type, (M, P, d))
    feeds = np.concatenate([np.ones((n_latent, P)), np.eye(P) * private])[:M]
    mu = np.zeros((M, P, d))
    if shift:
        mu[:n_latent, 1:] = rng.normal(0, 0.6, (n_latent, P - 1, d))
    return ConvolvedGaussian(
        n_latent,
        private_latents=private,
        covariance_type=covariance_type,
        amplitude=rng.normal(0, 1.0, (M, P)) * feeds,
        length_scale=np.broadcast_to(rng.uniform(0.6, 1.8, widths), (M, P, d)),
        shift=mu,
        **({"parameter_bounds": {"shift": (-3.0, 3.0)}} if shift else {}),
        **bounds,
    )


def trend(P=3, d=2):
    rng = default_rng(1)
    return LinearTrend(
        rng.uniform(0.5, 2, P), rng.uniform(0.5, 2, (P, d)), center=rng.normal(size=d)
    )


def assert_covariance(draws, K):
    """Assert that draws (n, N) have mean zero and this covariance, within what so many of them allow."""
    n = len(draws)
    variance = np.diag(K)
    assert (np.abs(draws.mean(axis=0)) < 4.5 * np.sqrt(variance / n)).all()
    error = np.sqrt((np.outer(variance, variance) + K**2) / n)
    assert (np.abs(draws.T @ draws / n - K) < 5 * error).all()
