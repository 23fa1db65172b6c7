"""Regressors that are noisy: what the estimator and the identification pipeline make of them."""

import numpy as np
import pandas as pd
import pytest
from made_flights import GLIDER
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.identification import flight_regressors

SIGMA = 0.08  # of the regressor


def waves(n=200, sigma=SIGMA, seed=0):
    """Two functions of x, of which a noisy x is seen."""
    rng = default_rng(seed)
    x = rng.uniform(-2, 2, (n, 1))
    truth = np.hstack([np.sin(3 * x), np.cos(3 * x)])
    return x + rng.normal(0, sigma, x.shape), truth + rng.normal(0, 0.02, truth.shape), x, truth


def fitted(input_noise):
    X, Y, *_ = waves()
    options = {"structure": "joint", "n_latent": 1, "max_iter": 25, "random_state": 0}
    return DependentGPRegressor(input_noise=input_noise, **options).fit(X, Y)


@pytest.fixture(scope="module")
def learned():
    return fitted("learned")


@pytest.fixture(scope="module")
def naive():
    """Return a model to which the regressors are exact."""
    return fitted(None)


def test_bands_hold_the_truth_at_noisy_regressors(learned, naive):
    """The function at the true regressor is off by what the seen one is off, which exact regressors cannot know."""
    X, _, _, truth = waves(seed=1)
    mean, std = learned.predict(X, return_std=True, include_input_noise=True)
    assert 0.85 < np.mean(np.abs(truth - mean) < 1.96 * std) <= 1.0
    _, too_small = naive.predict(X, return_std=True)
    assert np.mean(np.abs(truth - mean) < 1.96 * too_small) < 0.5


@pytest.mark.parametrize("times", [0.0, 4.0, np.repeat([[1.0], [0.0]], [10, 20], axis=0)])
def test_the_wider_part_goes_with_the_slope(learned, times):
    """By a number for all rows, or one for each."""
    X = waves(seed=1)[0][:30]
    exact, noisy = (
        learned.predict(X, return_std=True, include_input_noise=noise)[1]
        for noise in (False, np.ravel(times) if np.ndim(times) else times)
    )
    slope = learned.predict_gradient(X)[..., 0]
    carried = slope**2 * learned.input_covariance_[0, 0]
    assert_allclose(noisy**2 - exact**2, times * carried, rtol=1e-6, atol=1e-12)


def test_nonsense_is_refused(learned):
    with pytest.raises(
        ValueError, match=r"Got include_input_noise of shape \(2,\), but expected a bool"
    ):
        learned.predict([[0.0]], return_std=True, include_input_noise=[1.0, 1.0])


def test_without_reconstruction_regressors_are_as_noisy_as_those_of_the_fit():
    t = np.arange(0, 20, 0.1)
    wave = {"alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t)}
    flight = pd.DataFrame({"time": t, "airspeed": 12.0, **wave})
    model = make_identification_pipeline(GLIDER, regressors=["alpha"], cutoff=None)
    model.fit(flight, pd.DataFrame({"CZ": -4 * flight["alpha"]}))
    assert model["flightpathreconstruction"].missing_[0] == "p"
    assert_array_equal(flight_regressors(model, flight)[1], np.ones(len(t)))
