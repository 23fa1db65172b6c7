"""Neighbours in a time series that repeat each other."""

import numpy as np
import pytest
from made_flights import lasting
from numpy.random import default_rng
from scipy.signal import lfilter

from skdgp import DependentGPRegressor
from skdgp.inference import Data, SearchOptions, autocorrelation_time, fit_sparse, search
from skdgp.kernels import ConvolvedGaussian


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.95])
def test_of_an_autoregression_is_the_known_one(rho):
    noise = lfilter([1.0], [1.0, -rho], default_rng(0).normal(size=200_000))
    assert autocorrelation_time(noise) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


@pytest.mark.parametrize("values", [np.zeros(10), np.ones(1), np.tile([1.0, -1.0], 50)])
def test_is_never_less_than_one(values):
    assert autocorrelation_time(values) == 1.0


X = np.linspace(0, 8, 3000)[:, None]
TRUTH = np.sin(2 * X)
# Lasting noise of variance 0.09
NOISE = 0.3 * lasting(default_rng(3), (3000, 4), 9.5)


def fitted(X, Y):
    options = SearchOptions("fmin_l_bfgs_b", max_iter=30, random_state=0, time_series=True)
    (learned,) = search([ConvolvedGaussian(0)], X, Y, options)
    data = Data.from_table(X, Y)
    return fit_sparse(learned, data, n_inducing=15, ordered=True)


class TestSparseFit:
    """Samples taken so fast that neighbours share their noise teach no more than the noise lets them."""

    def test_deviations_are_as_large_as_errors(self):
        """Counted as independent, errors are about four deviations."""
        fit = fitted(X, TRUTH + NOISE)
        mean, variance = fit.posterior.predict(X, True)
        z = (mean - TRUTH) / np.sqrt(variance)
        assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5
        assert fit.learned.noise.mean() == pytest.approx(0.09, rel=0.25)  # of a measurement

    def test_noise_is_at_least_what_residuals_show(self):
        """Few inducing inputs cannot follow the function: what they miss is no certainty."""
        x = X[::10]
        truth = np.sin(9 * x)
        model = DependentGPRegressor(
            structure="joint", inference="sparse", n_inducing=4, input_noise=None, max_iter=10
        ).fit(x, truth + 0.01 * NOISE[::10, :1], time=x[:, 0])
        squares = np.mean((truth - model.predict(x)) ** 2)
        assert squares > 0.01
        assert model.noise_variance_ >= 0.9 * squares

    def test_noise_of_an_output_with_gaps_is_of_its_own_rows(self):
        """Where an output was not observed its function is unknown, not noisy."""
        x = X[::5]
        y = np.hstack([np.sin(9 * x), np.cos(9 * x)])
        y += default_rng(0).normal(0.0, 0.05, y.shape)
        y[60:, 1] = np.nan
        model = DependentGPRegressor(structure="joint", input_noise=None, max_iter=60)
        model.fit(x, y, time=x[:, 0])
        assert model.noise_variance_ == pytest.approx([0.0025, 0.0025], rel=0.5)

    def test_noise_expects_what_the_posterior_does_not_know(self):
        """Sixty rows of noise, which a narrow process follows: their residuals alone are too small."""
        x = np.linspace(0.0, 8.0, 60)[:, None]
        noise = 0.3 * default_rng(1).standard_normal((60, 1))
        model = DependentGPRegressor(
            ConvolvedGaussian(0, amplitude=[[1.0]], length_scale=[[[0.1]]]),
            structure="joint", trend="constant", noise_variance=0.01,
            noise_variance_bounds=(0.009, 1.0), optimizer=None,
        ).fit(x, noise, time=x[:, 0])  # fmt: skip
        squares = np.mean((noise[:, 0] - model.predict(x)[:, 0]) ** 2)
        assert model.noise_variance_[0] > 1.2 * squares

    def test_shuffled_rows_are_independent_evidence(self):
        order = default_rng(4).permutation(len(X))
        fit = fitted(X[order], (TRUTH + NOISE)[order, :1])
        assert fit.posterior.noise == pytest.approx(fit.learned.noise, rel=0.3)
