"""Variances of kernel and noise are unbiased, unless they are given."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp.inference import unbiased_factor
from skdgp.kernels import ConvolvedGaussian, LinearTrend

SMOOTH = {"structure": "joint", "trend": "constant", "n_latent": 0, "random_state": 0}


def waves(n=30):
    rng = default_rng(0)
    X = rng.uniform(-2, 2, (n, 1))
    return X, 5 * np.sin(2 * X[:, 0]) + rng.normal(size=n)


def test_an_output_of_n_values_has_lost_one_for_each_hyperparameter():
    """n / (n - p): slopes and noise; widths and amplitude; at most half of the values."""
    Y = np.ones((40, 2))
    Y[:16, 1] = np.nan
    slopes = LinearTrend(np.ones(2), np.ones((2, 3)), np.zeros(3))
    process = ConvolvedGaussian(0, amplitude=np.eye(2), length_scale=np.ones((2, 2, 3)))
    assert_allclose(unbiased_factor(slopes, Y), [40 / 36, 24 / 20])
    assert_allclose(unbiased_factor(slopes + process, Y), [40 / 32, 24 / 16])
    assert_allclose(unbiased_factor(slopes + process, Y[:20, :1]), [20 / 12])
    assert_allclose(unbiased_factor(slopes + process, Y[:12, :1]), [2.0])


def test_the_noise_of_a_line_is_that_of_least_squares_in_the_mean():
    variances = []
    for seed in range(40):
        rng = default_rng(seed)
        X = rng.normal(size=(15, 1))
        y = 3 * X[:, 0] + rng.normal(size=15)
        variances.append(DependentGPRegressor(structure="trend").fit(X, y).noise_variance_[0])
    assert np.mean(variances) == pytest.approx(1.0, abs=3 * np.sqrt(2 / 13 / 40))


def test_a_variance_that_is_given_stays():
    X, y = waves()
    given = DependentGPRegressor(noise_variance=1.3, **SMOOTH).fit(X, y)
    assert given.noise_variance_ == pytest.approx(1.3)
    bounded = {"noise_variance": 0.5, "noise_variance_bounds": (0.1, 0.5)}
    assert DependentGPRegressor(**bounded, **SMOOTH).fit(X, y).noise_variance_ < 0.5001
    kernel = ConvolvedGaussian(0, amplitude=[[4.0]], parameter_bounds={"amplitude": "fixed"})
    options = SMOOTH | {"n_latent": None}
    model = DependentGPRegressor(kernel, **options).fit(X, y)
    assert_allclose(model.kernel_.diag(X[:1]), 16.0)


def test_the_likelihood_is_largest_at_smaller_variances():
    """By n / (n - p) all in all: the mean function stays."""
    X, y = waves()
    model = DependentGPRegressor(**SMOOTH).fit(X, y)
    factor = len(X) / (len(X) - 4)
    best = DependentGPRegressor(
        model.kernel_.rescaled([factor**-0.5]),
        noise_variance=model.noise_variance_ / factor,
        **SMOOTH | {"optimizer": None, "n_latent": None},
    ).fit(X, y)
    gain = best.log_marginal_likelihood_value_ - model.log_marginal_likelihood_value_
    assert gain == pytest.approx(0.5 * len(X) * (np.log(factor) - 1 + 1 / factor), rel=0.05)
    assert_allclose(best.predict(X), model.predict(X), rtol=1e-6)
