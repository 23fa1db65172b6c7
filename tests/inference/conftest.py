"""A problem small enough for naive references: three outputs, each observed at samples of its own."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.inference import Data
from skdgp.kernels import ConvolvedGaussian, LinearTrend


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

    def check(gradient, function, x, *, rtol, atol, n_directions=8):
        assert gradient.shape == np.shape(x)
        for direction in default_rng(0).choice([-1.0, 1.0], (n_directions, len(x))):
            slope = central_difference(lambda t, way=direction: function(x + t[0] * way), [0.0])[0]
            assert_allclose(gradient @ direction, slope, rtol=rtol, atol=atol)

    return check


def make_problem(kind="diag", with_trend=True, n=14, P=3, d=2, seed=0):
    rng = default_rng(seed)
    widths = {"tied": (2 + P, 1, d)}.get(kind, (2 + P, P, d))
    kernel = ConvolvedGaussian(
        2,
        covariance_type=kind,
        amplitude=rng.normal(size=(2 + P, P)) * np.r_[np.ones((2, P)), np.eye(P)],
        length_scale=np.broadcast_to(rng.uniform(0.7, 1.6, widths), (2 + P, P, d)),
        shift=rng.normal(0, 0.3, (2 + P, P, d))
        * (np.arange(2 + P) < 2)[:, None, None]
        * (np.arange(P) > 0)[:, None],
        parameter_bounds={"shift": (-2.0, 2.0)},
    )
    if with_trend:
        kernel = (
            LinearTrend(rng.uniform(0.5, 1, P), rng.uniform(0.5, 1, (P, d)), rng.normal(size=d))
            + kernel
        )
    X, Y = rng.normal(size=(n, d)), rng.normal(size=(n, P))
    Y[rng.random(Y.shape) < 0.35] = np.nan  # some outputs are not observed here and there
    data = Data.from_table(X, Y)
    noise = rng.uniform(0.05, 0.3, P)
    K = kernel(data.X) + np.diag(np.repeat(noise, [len(y) for y in data.y]))
    return SimpleNamespace(
        kernel=kernel, noise=noise, data=data, X=X, Y=Y, K=K, y=np.concatenate(data.y)
    )


@pytest.fixture(params=["diag", "tied", "diag without trend"])
def problem(request):
    return make_problem(request.param.split()[0], "without" not in request.param)


@pytest.fixture
def one_problem():
    return make_problem()
