"""Slopes over a perturbation: expectations of local slopes, by quadrature, for every posterior and its paths."""

import warnings

import numpy as np
import pytest
from made_outputs import slopes_over
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.gaussian_process.kernels import RationalQuadratic

from skdgp import DependentGPRegressor

SPREAD = np.array([0.4, 0.15])
POINT = np.array([[0.2, -0.1]])
SWITCHES = {
    "average": {},
    "joint": {"structure": "joint"},
    "joint, sparse": {"structure": "joint", "inference": "sparse", "n_inducing": 20},
    "sparse in time": {"inference": "sparse", "n_inducing": 20, "time": True},
    "trend in time": {"structure": "trend", "time": True},
    "no trend": {"structure": "joint", "trend": None},
}


def data():
    rng = default_rng(3)
    X = rng.uniform(-1, 1, (80, 2))
    Y = np.stack([np.sin(3 * X[:, 0]) + X[:, 1], X[:, 0] * X[:, 1] - X[:, 0] ** 2], axis=1)
    return X, Y + 0.05 * rng.normal(size=Y.shape)


def fitted(time=False, **settings):
    X, Y = data()
    model = DependentGPRegressor(n_latent=1, random_state=0, max_iter=5, **settings)
    return model.fit(X, Y, time=np.arange(len(X)) * 0.1 if time else None)


def expected(slopes):
    return slopes_over(slopes, POINT, SPREAD)


@pytest.fixture(scope="module", params=SWITCHES)
def model(request):
    with warnings.catch_warnings(action="ignore"):
        return fitted(**SWITCHES[request.param])


def test_of_the_mean_are_expectations(model):
    reference = expected(model.predict_gradient)
    assert_allclose(model.predict_gradient(POINT, SPREAD), reference, rtol=1e-6, atol=1e-8)
    local = model.predict_gradient(POINT)
    assert_allclose(model.predict_gradient(POINT, [0.0, 0.0]), local, rtol=1e-9, atol=1e-12)


def test_of_paths_are_expectations_around_those_of_the_mean(model):
    paths = model.sample_paths(300, random_state=1)
    averaged = paths.gradient(POINT, SPREAD)[:, 0]
    few = model.sample_paths(4, random_state=1)
    assert_allclose(few.gradient(POINT, SPREAD), expected(few.gradient), atol=1e-6)
    error = averaged.std(axis=0) / np.sqrt(len(averaged))
    mean = model.predict_gradient(POINT, SPREAD)[0]
    assert (np.abs(averaged.mean(axis=0) - mean) < 4.5 * error + 1e-12).all()


def test_of_a_kernel_without_a_formula_are_expectations_too():
    X, Y = data()
    model = DependentGPRegressor(RationalQuadratic(), optimizer=None, structure="joint").fit(X, Y)
    reference = expected(model.predict_gradient)
    assert_allclose(model.predict_gradient(POINT, SPREAD), reference, atol=1e-4)
