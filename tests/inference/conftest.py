"""A problem small enough for naive references: three outputs, each observed at samples of its own."""

from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from made_kernels import convolved, trend
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.inference import Data


def stacked_covariances(features, arrays):
    """Return Kfu of all outputs, (N, K), zero where a feature is not felt."""
    K = np.zeros((sum(map(len, arrays)), features.size))
    row = 0
    for i, x in enumerate(arrays):
        K[row : row + len(x), features.columns(i)] = features.Kfu(i, x)
        row += len(x)
    return K


@pytest.fixture(scope="session")
def stacked():
    return stacked_covariances


@pytest.fixture(scope="session")
def assert_gradient(central_difference):
    """Return a check of a gradient along random directions: a wrong entry shows in every one of them."""

    def check(gradient, function, x, *, rtol, atol):
        assert gradient.shape == np.shape(x)
        for direction in default_rng(0).choice([-1.0, 1.0], (8, len(x))):
            slope = central_difference(lambda t, way=direction: function(x + t[0] * way), [0.0])[0]
            assert_allclose(gradient @ direction, slope, rtol=rtol, atol=atol)

    return check


@pytest.fixture(scope="session")
def information():
    """Return the average information, half of the products dK alpha (n, N) in K^-1, and the kernel's curvature."""

    def expected(kernel, data, K, y, products):
        inverse = np.linalg.inv(K)
        alpha = inverse @ y
        found = 0.5 * products @ inverse @ products.T
        W = np.multiply.outer(alpha, alpha) - inverse
        ends = np.cumsum([0, *map(len, data.X)])
        rows = [slice(*pair) for pair in pairwise(ends)]
        slopes = {}
        for i, j in combinations(range(len(rows)), 2):
            of_outputs = -W[rows[i], rows[j]]
            slopes[i, j] = kernel.block_gradient(i, j, data.X[i], data.X[j], of_outputs)
        kernel.add_curvature(found[: kernel.n_dims, : kernel.n_dims], slopes)
        return found

    return expected


def noise_covariance(Y, noise, loading=None):
    """Return the noise covariance of the stacked values, entry by entry.

    ``loading`` (n, P, r) multiplies errors that the outputs of a sample share.
    """
    outputs, samples = np.nonzero(np.isfinite(Y.T))
    S = np.diag(noise[outputs])
    if loading is not None:
        G = loading[samples, outputs]
        S += np.where(samples[:, None] == samples, G @ G.T, 0.0)
    return S


@pytest.fixture(scope="session")
def noise_of():
    return noise_covariance


def make_problem(kind="diag", n_latent=2, with_trend=True, common_noise=False):
    rng = default_rng(0)
    n, P, d = 14, 3, 2
    kernel = convolved(n_latent, P, d, kind, shift=True)
    if with_trend:
        kernel = trend(P, d) + kernel
    X, Y = rng.normal(size=(n, d)), rng.normal(size=(n, P))
    Y[rng.random(Y.shape) < 0.35] = np.nan  # some outputs are not observed here and there
    loading = default_rng(1).normal(0, 0.4, (n, P, 2)) if common_noise else None
    data = Data.from_table(X, Y)
    if common_noise:
        data = data._replace(noise=[loading[rows, i] for i, rows in enumerate(np.isfinite(Y).T)])
    noise = rng.uniform(0.05, 0.3, P)
    S = noise_covariance(Y, noise, loading)
    return SimpleNamespace(
        kernel=kernel,
        noise=noise,
        loading=loading,
        data=data,
        X=X,
        Y=Y,
        S=S,
        K=kernel(data.X) + S,
        y=np.concatenate(data.y),
    )


PROBLEMS = {
    "diag": {},
    "tied": {"kind": "tied"},
    "without trend": {"with_trend": False},
    "independent outputs": {"n_latent": 0},
    "common noise": {"common_noise": True},
}


@pytest.fixture(params=PROBLEMS)
def problem(request):
    return make_problem(**PROBLEMS[request.param])


@pytest.fixture
def one_problem():
    return make_problem()


@pytest.fixture
def noisy_problem():
    """Return the problem with noise that two regressors add to all outputs of a sample."""
    return make_problem(common_noise=True)
