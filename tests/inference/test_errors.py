"""Errors of the function that a posterior does not hold, and predictions, samples and slopes with them."""

import numpy as np
import pytest
from made_flights import lasting
from made_kernels import assert_covariance
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import DependentGPRegressor
from skdgp.inference import FunctionErrors, attenuation, linear_weights

N_DRAWN = 300
# Relative error of a standard deviation of so many draws, five of its own
WITHIN = 5 / np.sqrt(2 * N_DRAWN)


@pytest.fixture(scope="module")
def series():
    """Return a flight with lasting noise and a kink: regressors, two outputs, time."""
    rng = default_rng(0)
    X = lasting(rng, (240, 2), 7) * [1, 5]
    noise = 0.1 * lasting(rng, (240, 2), 3)
    Y = np.column_stack([X[:, 0] + np.abs(X[:, 0]), 0.3 * X[:, 1] - X[:, 0]]) + noise
    return X, 10.0 * Y, np.arange(240.0)


@pytest.fixture(scope="module", params=["exact", "sparse", "without time"])
def model(request, series, cut_short):
    X, Y, time = series
    options = {"max_iter": 8, "n_latent": 1, "n_inducing": 20, "random_state": 0}
    if request.param == "exact":  # the others are averages
        options["structure"] = "joint"
    with cut_short():
        if request.param == "without time":
            return DependentGPRegressor(**options, input_noise="learned").fit(X, Y)
        return DependentGPRegressor(**options, inference=request.param).fit(X, Y, time=time)


@pytest.mark.parametrize(("noise", "input_noise"), [(False, False), (False, True), (True, 2.0)])
def test_deviations_covariances_and_samples_are_of_one_distribution(
    model, series, noise, input_noise
):
    switches = {"include_noise": noise, "include_input_noise": input_noise}
    X = series[0][:80:20]
    mean, std = model.predict(X, return_std=True, **switches)
    again, cov = model.predict(X, return_cov=True, **switches)
    assert_allclose(again, mean)
    assert_allclose(np.diag(cov), std.T.ravel() ** 2, rtol=1e-9)
    assert_allclose(cov, cov.T)
    assert np.linalg.eigvalsh(cov).min() > -1e-9 * cov.max()
    samples = model.sample_y(X, N_DRAWN, random_state=1, **switches)
    assert_array_equal(model.sample_y(X, N_DRAWN, random_state=1, **switches), samples)
    draws = [np.moveaxis(samples, -1, 0)]
    if not noise and input_noise is False:
        draws.append(model.sample_paths(N_DRAWN, 1)(X))
    for drawn in draws:
        assert_covariance((drawn - mean).transpose(0, 2, 1).reshape(N_DRAWN, -1), cov)


def test_further_errors_add_to_the_covariance_and_the_paths_in_units_of_the_outputs(series):
    """About any centre, of a time series and of other samples."""
    X, Y, time = series
    weights = default_rng(1).normal(size=(3, 3, 2)) * [1.0, 10.0]
    further = FunctionErrors(weights, np.array([0.3, -2.0]))
    for clock in ({}, {"time": time}):
        model = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
        before = model.fit(X, Y, **clock).predict(X[:3], return_cov=True)[1]
        after = model.fit(X, Y, **clock, errors=further).predict(X[:3], return_cov=True)[1]
        assert_allclose(after - before, further.covariance(X[:3]), rtol=1e-6)
        assert_allclose(model.function_errors().variance(X), further.variance(X))
        drawn = model.sample_paths(N_DRAWN, random_state=0)(X[:1]).std(axis=0)[0]
        assert_allclose(drawn, np.sqrt(np.diag(after)[::3]), rtol=WITHIN)


def test_errors_in_other_units_are_those_of_the_same_function():
    rng = default_rng(2)
    errors = FunctionErrors(rng.normal(size=(3, 3, 2)), np.array([0.3, -2.0]))
    shift, scale, outputs = np.array([1.0, -3.0]), np.array([0.1, 20.0]), np.array([5.0, 0.2])
    X = rng.normal(size=(4, 2))
    found = errors.in_units(shift, scale, outputs).variance(shift + scale * X)
    assert_allclose(found, outputs**2 * errors.variance(X))


@pytest.mark.parametrize("truth", [[-0.4, 0.2], [1.0, 0.0], [-0.4, 0.8]])
@pytest.mark.parametrize("common", [0.0, 0.3])
def test_errors_by_noise_of_a_regressor_hold_what_it_takes_from_slopes(truth, common):
    """It flattens the slope of its regressor and moves those of others, with which it is correlated, or they are."""
    rng = default_rng(0)
    exact = rng.normal(size=(200_000, 2)) @ [[1.0, 0.8], [0.0, 0.6]]
    X = exact.copy()
    X[:, 0] += 0.5 * rng.normal(size=len(X)) + common * exact[:, 1]
    found = np.linalg.lstsq(X, exact @ truth)[0]
    # of the noise with both regressors
    covariance = np.zeros((2, 2))
    covariance[:, 0] = 0.5**2 + common * (common + 0.8), common
    errors = attenuation(X, covariance, found)
    assert_allclose(found + errors.sum(axis=1), truth, atol=0.01)
    large = attenuation(X, np.diag([100.0, 0.0]), found)
    assert_allclose(large[0, 0], found[0])


def test_a_regressor_that_is_constant_where_an_output_is_known_has_no_slope():
    rng = default_rng(0)
    x = rng.normal(size=40)
    is_known = np.arange(40) < 20
    y = np.where(is_known, 5 + 2 * x, np.nan)
    X = np.column_stack([x, is_known])
    assert_allclose(linear_weights(X, np.column_stack([y, x]))[:, 0], [5, 2, 0], atol=1e-12)


@pytest.mark.parametrize("memory", [0.01, 4.0])
def test_slopes_of_a_line_err_as_stated(memory):
    """White and lasting noise: errors over deviations have a root mean square near one."""
    truth = [1.0, -0.5, 0.3, 0.0]
    model = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
    ratios = []
    for seed in range(4):
        rng = default_rng(seed)
        x = lasting(rng, (700, 4), 10)
        model.fit(x, x @ truth + 0.5 * lasting(rng, 700, memory), time=np.arange(700.0))
        spread = model.sample_paths(200, random_state=0).gradient(x[:1])[:, 0].std(axis=0)
        ratios.append((model.predict_gradient(x[:1])[0] - truth) / spread)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4
