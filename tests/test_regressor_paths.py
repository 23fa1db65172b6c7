"""Samples of the posterior that are functions, as the estimator gives them."""

import pickle

import numpy as np
import pytest
from made_outputs import in_units
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor


def fitted(inference, **options):
    options = {
        "n_latent": 1,
        "n_inducing": 12,
        "max_iter": 10,
        "optimizer": None,
        "random_state": 0,
    } | options
    return DependentGPRegressor(inference=inference, **options).fit(*in_units(30))


@pytest.fixture(scope="module", params=["exact", "sparse"])
def model(request):
    return fitted(request.param)


def test_shapes_and_the_ways_to_ask_agree(model):
    paths = model.sample_paths(7, random_state=1)
    X = default_rng(2).normal(size=(7, 5, 2))
    every = paths.each(X)
    assert every.shape == (7, 5, 2)
    for k, points in enumerate(X):
        assert_allclose(paths(points)[k], every[k], rtol=1e-9)
        slopes = paths.gradient(points)[k]
        assert_allclose(slopes, paths.gradient(X)[k], rtol=1e-9, atol=1e-12)
    assert paths.gradient(X[0]).shape == (7, 5, 2, 2)


def test_the_same_seed_gives_the_same_functions_in_any_process(model):
    X = in_units(30)[0]
    paths = model.sample_paths(4, random_state=5)
    assert_allclose(model.sample_paths(4, random_state=5)(X), paths(X), rtol=1e-9, atol=1e-10)
    assert_allclose(pickle.loads(pickle.dumps(paths))(X), paths(X), rtol=1e-9, atol=1e-10)
    assert not np.allclose(model.sample_paths(4, random_state=6)(X), paths(X))


def test_bad_input_is_refused(model):
    for wrong in (0, -1, 1.5, True, "3"):
        with pytest.raises(ValueError, match=r"n_paths=.*expected a number of paths from 1 on"):
            model.sample_paths(wrong)
    paths = model.sample_paths(3)
    with pytest.raises(ValueError, match=r"X of shape \(4, 5\), but expected \(n, 2\)"):
        paths(np.zeros((4, 5)))
    with pytest.raises(ValueError, match=r"X of shape \(2, 4, 2\), but expected \(3, n, 2\)"):
        paths.each(np.zeros((2, 4, 2)))
    with pytest.raises(ValueError, match=r"X of shape \(2,\), but expected \(n, 2\)"):
        paths(np.zeros(2))
