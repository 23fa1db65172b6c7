"""Errors of the function that a posterior does not hold, and predictions, samples and slopes with them."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp import DependentGPRegressor
from skdgp.inference import (
    function_errors,
)

N_DRAWN = 700
# Relative error of a standard deviation of so many draws, five of its own
WITHIN = 5 / np.sqrt(2 * N_DRAWN)


@pytest.fixture(scope="module")
def series(wandering):
    """Return a flight with lasting noise and a kink: regressors, two outputs, time."""
    rng = default_rng(0)
    X = np.column_stack([wandering(rng, 240, 8), 5 * wandering(rng, 240, 5)])
    noise = 0.1 * np.column_stack([wandering(rng, 240, 3), wandering(rng, 240, 3)])
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
    std = std.T.ravel()
    assert_allclose(np.diag(cov), std**2, rtol=1e-9)
    drawn = model.sample_y(X, N_DRAWN, random_state=1, **switches)
    if not noise and input_noise is False:
        assert_array_equal(np.moveaxis(drawn, -1, 0), model.sample_paths(N_DRAWN, 1)(X))
    off = (drawn - mean[..., None]).transpose(2, 1, 0).reshape(N_DRAWN, -1) / std
    assert np.abs(off.mean(axis=0)).max() < 5 / np.sqrt(N_DRAWN)
    assert_allclose(np.cov(off.T), cov / np.outer(std, std), atol=2 * WITHIN)


def test_discrepancy_is_in_the_units_of_the_outputs(series):
    X, Y, time = series
    model = DependentGPRegressor(structure="trend", random_state=0).fit(X, Y, time=time)
    assert model.misfit_variance_[0] > 0  # the kink
    errors = model.function_errors()
    assert_allclose(errors.discrepancy, model.misfit_variance_)
    linear = np.sum(errors.linear(X[:3]) ** 2, axis=0)
    assert_allclose(errors.variance(X[:3]), linear + model.misfit_variance_)


def line_of(x, Y, noise_variance=1.0, **options):
    """Return a model of a linear function with known noise, and the errors of the function."""
    model = DependentGPRegressor(structure="trend", optimizer=None, noise_variance=noise_variance)
    posterior = model.fit(x, Y).posterior_
    return model, function_errors(posterior, np.zeros(Y.shape[1]), **options)


@pytest.mark.parametrize("memory", [0.01, 4.0])
def test_slopes_of_a_line_err_as_stated(wandering, memory):
    """White and lasting noise: errors over deviations have a root mean square near one."""
    truth = [1.0, -0.5, 0.3, 0.0]
    model = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
    ratios = []
    for seed in range(4):
        rng = default_rng(seed)
        x = np.column_stack([wandering(rng, 700, 10) for _ in truth])
        model.fit(x, x @ truth + 0.5 * wandering(rng, 700, memory), time=np.arange(700.0))
        spread = model.sample_paths(200, random_state=0).gradient(x[:1])[:, 0].std(axis=0)
        ratios.append((model.predict_gradient(x[:1])[0] - truth) / spread)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4


def flown_in_gusts(wandering, memory):
    """Return rate and stick, and a load of -1 times the rate, the stick and a gust, (9000, 2) and (9000, 1).

    The load turns the rate, so its lasting error is in the rate, and least squares finds too little
    damping.
    """
    rng = default_rng(3)
    gust, stick, rate = wandering(rng, 9000, memory), wandering(rng, 9000, 20), np.zeros(9000)
    for t in range(1, 9000):
        rate[t] = 0.7 * rate[t - 1] + 0.3 * stick[t - 1] + 0.3 * gust[t - 1]
    return np.column_stack([rate, stick]), (-rate + stick + gust)[:, None]


@pytest.mark.parametrize("memory", [1.5, 3.0])
def test_errors_by_method_hold_what_gusts_take_from_the_damping(wandering, memory):
    x, load = flown_in_gusts(wandering, memory)
    model, errors = line_of(x, load)
    missing = abs(model.predict_gradient(x[:1])[0, 0, 0] + 1)
    by_method = np.abs(errors.slopes()[1][0, 0, 0]) * model.scale_[0]
    assert missing > 0.1
    assert 0.4 * missing < by_method < 1.5 * missing


def test_noise_of_a_regressor_flattens_by_its_part_of_the_variance():
    """Slope 2 by the truth, 40 % of the variance is noise: least squares finds 1.2 (Fuller 1987)."""
    rng = default_rng(6)
    truth, error = rng.normal(size=(2, 20000, 1)) * np.sqrt([[[0.6]], [[0.4]]])
    x, y = truth + error, 2 * truth
    model, errors = line_of(x, y, 0.1, input_std=np.sqrt([0.4]))
    slope = model.predict_gradient(x[:1])[0, 0, 0]
    attenuation = errors.slopes()[1][0, 0, 1] * model.scale_[0]
    assert slope == pytest.approx(1.2, rel=0.05)
    # to first order in the noise
    assert attenuation == pytest.approx(0.4 * slope, rel=0.05)
