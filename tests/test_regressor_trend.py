"""The linear trend is Bayesian linear regression; structures of a trend and processes."""

import numpy as np
import pytest
from made_outputs import little_overlap
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.linear_model import BayesianRidge

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian


@pytest.mark.parametrize(
    "options", [{"kernel": ConvolvedGaussian(1)}, {"trend": "constant"}, {"trend": None}]
)
def test_a_trend_alone_needs_a_trend(options):
    X = default_rng(0).uniform(-2, 2, (60, 4))
    with pytest.raises(ValueError, match="structure='trend'"):
        DependentGPRegressor(structure="trend", **options).fit(X, X[:, 0])


def bayesian_line(X, y, at, noise, slope_std):
    """Return mean and standard deviation of a line at points (Rasmussen & Williams 2006, equation 2.9).

    The prior of the intercept has the standard deviation of y.
    """
    centre = X.mean(axis=0)
    A, B = (np.column_stack([np.ones(len(x)), x - centre]) for x in (X, at))
    prior = np.diag(1 / np.append(y.std(), slope_std) ** 2)
    covariance = np.linalg.inv(prior + A.T @ A / noise)
    mean = y.mean() + B @ covariance @ A.T @ (y - y.mean()) / noise
    return mean, np.sqrt(np.einsum("ij,jk,ik->i", B, covariance, B))


def test_bands_are_those_of_bayesian_linear_regression():
    rng = default_rng(0)
    X = rng.normal(1.0, 2.0, (40, 3))
    y = X.sum(axis=1) + rng.normal(size=40)
    model = DependentGPRegressor(structure="trend", random_state=0).fit(X, y)
    slopes = model.kernel_.value("slope_scale").ravel()
    expected = bayesian_line(X, y, 2 * X, model.noise_variance_[0], slopes)
    assert_allclose(model.predict(2 * X, return_std=True), expected, rtol=1e-5)


def test_more_regressors_than_rows_are_a_ridge_regression():
    rng = default_rng(0)
    X = rng.normal(size=(50, 60)) * rng.uniform(0.1, 10, 60)
    Z = (X - X.mean(axis=0)) / X.std(axis=0)
    y = Z @ rng.normal(size=60) + rng.normal(size=50)
    model = DependentGPRegressor(random_state=0).fit(X, y)
    assert list(model.weights_) == ["trend"]
    slope_std = np.full(60, BayesianRidge().fit(Z, y).lambda_ ** -0.5)
    expected = bayesian_line(Z, y, 2 * Z, model.noise_variance_[0], slope_std)
    found = model.predict(X.mean(axis=0) + 2 * X.std(axis=0) * Z, return_std=True)
    assert_allclose(found, expected, rtol=0.02, atol=0.01 * y.std())


def test_bands_hold_where_only_another_output_was_observed():
    X, Y, points, truth = little_overlap(default_rng(22))
    model = DependentGPRegressor(random_state=0).fit(X, Y)
    mean, std = model.predict(points, return_std=True)
    unseen = np.isfinite(truth[:, 1])
    error = np.abs(mean - truth)[unseen, 1]
    assert np.mean(error < 1.96 * std[unseen, 1]) > 0.85
