"""The prior on length scales: its density, its gradient, and what it does where the data say nothing."""

import numpy as np
import pytest
from scipy.stats import norm

from skdgp import DependentGPRegressor
from skdgp.inference import Data, log_likelihood
from skdgp.inference._objective import Objective
from skdgp.kernels import ConvolvedGaussian, LinearTrend

PRIOR = [[2.0, 0.7], [5.0, 1.3]]
KINDS = ("spherical", "tied", "diag", "full")


def kernel_of(kind, **parameters):
    rng = np.random.default_rng(0)
    X, Y = rng.normal(size=(30, 2)), rng.normal(size=(30, 3))
    return ConvolvedGaussian(1, covariance_type=kind, length_scale_prior=PRIOR, **parameters).initialize(X, Y, 0)


class TestDensity:
    @pytest.mark.parametrize("kind", KINDS)
    def test_gradient_is_the_derivative_with_respect_to_theta(self, kind):
        kernel = LinearTrend([1.0] * 3, np.ones((3, 2)), [0.0]) + kernel_of(kind)
        value, gradient = kernel.log_prior(eval_gradient=True)
        assert value == pytest.approx(kernel.log_prior())
        step = 1e-5
        for k, unit in enumerate(step * np.eye(kernel.n_dims)):
            there, back = (kernel.clone_with_theta(kernel.theta + s * unit).log_prior() for s in (1, -1))
            np.testing.assert_allclose((there - back) / (2 * step), gradient[k], atol=1e-7)

    def test_is_that_of_a_normal_for_each_free_logarithm(self):
        kernel = kernel_of("diag")
        lengths = np.concatenate([kernel.length_scale[0], kernel.length_scale[[1, 2, 3], [0, 1, 2]]])
        expected = norm.logpdf(np.log(lengths), np.log([2.0, 5.0]), [0.7, 1.3]).sum()
        np.testing.assert_allclose(kernel.log_prior(), expected)

    def test_of_widths_that_are_tied_each_counts_once(self):
        kernel = kernel_of("tied")
        expected = norm.logpdf(np.log(kernel.length_scale[:, 0]), np.log([2.0, 5.0]), [0.7, 1.3])
        np.testing.assert_allclose(kernel.log_prior(), expected.sum())

    def test_of_fixed_widths_and_of_none_is_zero(self):
        for kernel in (kernel_of("diag", length_scale_bounds="fixed"), LinearTrend([1.0], [[1.0]])):
            value, gradient = kernel.log_prior(eval_gradient=True)
            assert value == 0
            np.testing.assert_array_equal(gradient, np.zeros(kernel.n_dims))

    def test_follows_the_units_of_the_regressors(self):
        rng = np.random.default_rng(1)
        X, Y = rng.uniform(0, 1, (200, 4)), rng.normal(size=(200, 1))
        median, spread = ConvolvedGaussian(length_scale_prior="auto").initialize(X * 50, Y, 0).length_scale_prior.T
        np.testing.assert_allclose(median, 50 * np.exp(np.sqrt(2)) * np.sqrt(4), rtol=0.1)  # of the unit cube
        np.testing.assert_allclose(spread, np.sqrt(3))

    @pytest.mark.parametrize("prior", ["wide", (1.0,), (1.0, 0.0), (-1.0, 1.0), [[1.0, 1.0]] * 3, "auto "])
    def test_nonsense_is_refused(self, prior):
        with pytest.raises(ValueError, match=r"length_scale_prior=.*expected None, 'auto'"):
            ConvolvedGaussian(length_scale_prior=prior).initialize(np.eye(2), np.eye(2), 0)


class TestFit:
    @pytest.fixture
    def data(self):
        """Sixty samples of a function of the first of three regressors."""
        rng = np.random.default_rng(2)
        X = rng.normal(size=(60, 3))
        return X, np.sin(2 * X[:, 0]) + rng.normal(0, 0.1, 60)

    def test_what_is_maximised_is_likelihood_and_prior(self, data):
        X, y = data
        kernel = kernel_of("diag", length_scale_bounds=(1e-2, 1e2))
        values = Data.from_table(X[:, :2], np.column_stack([y, -y, X[:, 2]]))
        noise = np.array([0.1, 0.2, 0.3])
        value, gradient = log_likelihood(kernel, noise, values, eval_gradient=True)
        prior, slope = kernel.log_prior(eval_gradient=True)
        got, got_gradient = Objective(kernel, values, 3)(np.concatenate([kernel.theta, np.log(noise)]))
        np.testing.assert_allclose(got, value + prior)
        np.testing.assert_allclose(got_gradient, gradient + np.concatenate([slope, np.zeros(3)]))

    @pytest.mark.filterwarnings("ignore:The regressors .* are constant")
    def test_widths_that_the_data_leave_open_go_to_the_median(self, data):
        X, y = data
        X = np.column_stack([X[:, 0], np.full(60, 4.0), X[:, 2]])  # nothing varies with the second regressor
        kernel = ConvolvedGaussian(0, length_scale_prior=(7.0, 0.3))
        fitted = DependentGPRegressor(kernel, trend="constant", random_state=0, max_iter=200).fit(X, y)
        relevant, idle, useless = fitted.kernel_.length_scale[0, 0]
        np.testing.assert_allclose(idle, 7.0, rtol=0.02)
        assert relevant < 3.0 < useless

    def test_likelihood_is_reported_without_the_prior(self, data):
        kernels = ConvolvedGaussian(2, length_scale_prior=(7.0, 0.3)), ConvolvedGaussian(2)
        model, free = (DependentGPRegressor(k, random_state=0, max_iter=20).fit(*data) for k in kernels)
        np.testing.assert_allclose(model.log_marginal_likelihood(), model.log_marginal_likelihood_value_)
        assert free.log_marginal_likelihood_value_ > model.log_marginal_likelihood_value_
