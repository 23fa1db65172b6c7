"""The filter and the smoother of the filter-error method against the joint normal distribution."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

from skdgp.estimation._kalman import (
    Linearization,
    Noise,
    filtered,
    innovation_slopes,
    innovations,
    smoothed,
)


def linear_system(rng, n=7, N=3, m=2):
    """A filter that is linear, with predictions of a sample by way of the predicted state alone."""
    Phi = 0.5 * rng.standard_normal((n - 1, N, N))
    H = rng.standard_normal((n - 1, m, N))
    y = rng.standard_normal((n - 1, m))
    zero = np.zeros((n - 1, 0, 0))
    linear = Linearization(
        states=np.zeros((n, N)),
        predicted=np.zeros((n - 1, N)),
        transition=Phi,
        transition_slopes=zero,
        innovation=y,
        innovation_states=H @ Phi,
        innovation_noise=H,
        innovation_slopes=zero,
        residual=y,
        residual_states=H,
        residual_slopes=zero,
        step=rng.uniform(0.1, 0.2, n - 1),
        surface_noise=np.zeros((n - 1, N, N)),
        weight=np.ones((n - 1, m)),
        response=zero,
    )
    noises = Noise(
        rate=rng.uniform(1, 2, (1, N)),
        decay=np.zeros((1, N)),
        surface=np.zeros(1),
        sensor=rng.uniform(1, 2, (1, m)),
        start=rng.uniform(1, 2, (1, N)),
    )
    return linear, noises


def test_linear_filter_and_smoother_equal_the_joint_gaussian_distribution():
    linear, noises = linear_system(default_rng(0))
    run = filtered(linear, noises)
    (n, N), m = linear.states.shape, linear.innovation.shape[1]
    # x = M (x_0, w_1, ...), y = H x + v; the noise of a step by Simpson's rule
    M = np.zeros((n, N, n * N))
    M[0, :, :N] = np.eye(N)
    Q = [np.diag(noises.start[0])]
    for k in range(1, n):
        Phi = linear.transition[k - 1]
        M[k] = Phi @ M[k - 1]
        M[k, :, k * N : (k + 1) * N] += np.eye(N)
        half, rate = 0.5 * (np.eye(N) + Phi), np.diag(noises.rate[0] * linear.step[k - 1])
        Q.append((rate + 4 * half @ rate @ half.T + Phi @ rate @ Phi.T) / 6)
    M = M.reshape(n * N, n * N)
    X = M @ block_diag(*Q) @ M.T
    H = np.hstack([np.zeros(((n - 1) * m, N)), block_diag(*linear.residual_states)])
    S = H @ X @ H.T + np.diag(np.tile(noises.sensor[0], n - 1))
    y = linear.innovation.ravel()
    for k in range(n - 1):
        past, now = slice(0, k * m), slice(k * m, (k + 1) * m)
        gain = S[now, past] @ np.linalg.inv(S[past, past])
        assert_allclose(run.innovations.values[k], y[now] - gain @ y[past], atol=1e-10)
        assert_allclose(
            run.innovations.covariance[k], S[now, now] - gain @ S[past, now], atol=1e-10
        )
    states, covariance = smoothed(linear, run)
    gain = X @ H.T @ np.linalg.inv(S)
    assert_allclose(states.ravel(), gain @ y, atol=1e-10)
    P = X - gain @ H @ X
    for k in range(n):
        at = slice(k * N, (k + 1) * N)
        assert_allclose(covariance[k], P[at, at], atol=1e-10)


def test_sets_of_noises_are_filtered_as_one_by_one():
    linear, noises = linear_system(default_rng(1))
    sets = Noise(*(np.concatenate([part, 2 * part]) for part in noises))
    together = innovations(linear, sets)
    for k in range(2):
        alone = filtered(linear, Noise(*(part[k : k + 1] for part in sets))).innovations
        assert_allclose(together.values[:, k], alone.values)
        assert_allclose(together.covariance[:, k], alone.covariance)


def test_slopes_of_innovations_are_those_of_a_filter_with_the_same_gains():
    linear, noises = linear_system(default_rng(3))
    (n, N), m = linear.states.shape, linear.innovation.shape[1]
    slopes = default_rng(4).standard_normal((n - 1, N, 1))
    linear = linear._replace(
        transition_slopes=slopes,
        innovation_slopes=linear.residual_states @ slopes,
        residual_slopes=np.zeros((n - 1, m, 1)),
    )
    run = filtered(linear, noises)
    push = 1e-6 * linear.residual_states @ slopes
    moved = linear._replace(
        predicted=linear.predicted + 1e-6 * slopes[..., 0],
        innovation=linear.innovation - push[..., 0],
        residual=linear.residual - push[..., 0],
    )
    change = (filtered(moved, noises).innovations.values - run.innovations.values) / 1e-6
    assert_allclose(innovation_slopes(linear, run)[..., 0], change, atol=1e-6)
