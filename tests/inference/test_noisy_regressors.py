"""Values whose noise is shared by the outputs of a sample: exact and sparse, against dense references."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from skdgp.inference import (
    Data,
    ExactPosterior,
    SparsePosterior,
    input_noise_information,
    log_likelihood,
)
from skdgp.kernels import inducing_features

NEW = default_rng(5).normal(size=(6, 2))
Z = default_rng(6).normal(size=(7, 2))


@pytest.fixture
def noisy(one_problem):
    """The problem, with noise that two regressors carry into all outputs; S is the noise of the stacked values."""
    loading = default_rng(1).normal(0, 0.4, (*one_problem.Y.shape, 2))
    one_problem.loading = loading
    one_problem.data = Data.from_table(one_problem.X, one_problem.Y, loading)
    return one_problem


def noise_of(problem, scale=(1.0, 1.0)):
    """The noise covariance of the stacked values, entry by entry."""
    outputs, samples = np.nonzero(np.isfinite(problem.Y.T))
    same = samples[:, None] == samples
    G = problem.loading[samples, outputs]
    return np.where(same, (G * scale) @ G.T, 0.0) + np.diag(problem.noise[outputs])


def dense(problem, *scale):
    return problem.kernel(problem.data.X) + noise_of(problem, *scale)


def sparse(problem):
    features = inducing_features(problem.kernel, Z)
    return SparsePosterior(problem.kernel, features, problem.noise, problem.data)


def test_every_second_value_keeps_its_own_noise(noisy):
    some, (samples, loading) = noisy.data.every(2), noisy.data.sample_noise
    for i, x in enumerate(noisy.data.X):
        assert_array_equal(some.X[i], x[::2])
        assert_array_equal(some.sample_noise.sample[i], samples[i][::2])
        assert_array_equal(some.sample_noise.loading[i], loading[i][::2])


class TestSlopes:
    """Noise that the slopes of a function carry into the outputs."""

    STD = np.array([[0.2, 0.5], [0.1, 0.3], [0.4, 0.0]])  # by output and regressor

    @pytest.fixture
    def carried(self, one_problem, central_difference):
        """The problem with the noise that its mean carries, whose slopes are differences here."""
        posterior = ExactPosterior(one_problem.kernel, one_problem.noise, one_problem.data)
        slopes = [
            central_difference(lambda x: posterior.predict(x[None])[0], x) for x in one_problem.X
        ]
        one_problem.loading = np.array(slopes) * self.STD
        one_problem.data = one_problem.data.with_slopes(posterior.mean_function, self.STD)
        return one_problem

    def test_loadings_are_slopes_times_deviations(self, carried):
        for i, loading in enumerate(carried.data.sample_noise.loading):
            rows = np.isfinite(carried.Y[:, i])
            assert_allclose(loading, carried.loading[rows, i], atol=1e-6)


def test_outputs_of_the_same_rows_share_their_inputs():
    X, Y = np.arange(8.0).reshape(4, 2), np.ones((4, 4))
    Y[1, 2:] = np.nan
    data = Data.from_table(X, Y)
    assert data.X[0] is data.X[1] is X
    assert data.X[2] is data.X[3]
    assert_array_equal(data.X[2], X[[0, 2, 3]])
    assert_array_equal(data.sample[2], [0, 2, 3])


class TestExact:
    def test_likelihood_of_learned_variances_and_its_gradient(self, noisy, assert_gradient):
        n, scale = noisy.kernel.n_dims, np.array([0.3, 2.0])
        variances = np.concatenate([noisy.noise, scale])
        theta = np.concatenate([noisy.kernel.theta, np.log(variances)])

        def at(theta):
            kernel = noisy.kernel.clone_with_theta(theta[:n])
            return log_likelihood(kernel, np.exp(theta[n:]), noisy.data)

        expected = multivariate_normal(cov=dense(noisy, scale)).logpdf(noisy.y)
        value, gradient = log_likelihood(noisy.kernel, variances, noisy.data, eval_gradient=True)
        assert value == pytest.approx(expected, rel=1e-10)
        assert at(theta) == pytest.approx(expected, rel=1e-10)
        assert_gradient(gradient, at, theta, rtol=1e-7, atol=1e-7)

    def test_posterior(self, noisy):
        mean, variance = ExactPosterior(noisy.kernel, noisy.noise, noisy.data).predict(NEW, True)
        cross = noisy.kernel([NEW] * 3, noisy.data.X)
        expected = cross @ np.linalg.solve(dense(noisy), noisy.y)
        left = noisy.kernel(NEW) - cross @ np.linalg.solve(dense(noisy), cross.T)
        assert_allclose(mean.T.ravel(), expected, rtol=1e-8, atol=1e-10)
        assert_allclose(variance.T.ravel(), np.diag(left), rtol=1e-7, atol=1e-10)


class TestSparse:
    def test_bound_is_titsias_with_that_noise(self, noisy, stacked):
        features, S = inducing_features(noisy.kernel, Z), noise_of(noisy)
        Kfu = stacked(features, noisy.data.X)
        Qff = Kfu @ np.linalg.solve(features.Kuu(), Kfu.T)
        missing = np.trace(np.linalg.solve(S, noisy.kernel(noisy.data.X) - Qff))
        expected = multivariate_normal(cov=Qff + S).logpdf(noisy.y) - 0.5 * missing
        assert sparse(noisy).log_marginal_likelihood == pytest.approx(expected, rel=1e-8)

    def test_posterior(self, noisy, stacked):
        features, S = inducing_features(noisy.kernel, Z), noise_of(noisy)
        Kfu, Ksu = stacked(features, noisy.data.X), stacked(features, [NEW] * 3)
        B = features.Kuu() + Kfu.T @ np.linalg.solve(S, Kfu)
        expected = Ksu @ np.linalg.solve(B, Kfu.T @ np.linalg.solve(S, noisy.y))
        assert_allclose(sparse(noisy).predict(NEW).T.ravel(), expected, rtol=1e-7, atol=1e-9)


def test_information_on_the_noise_of_regressors_is_the_curvature_of_the_expected_likelihood():
    rng = default_rng(8)
    slopes = rng.normal(size=(30, 2, 3))
    noise = np.array([0.3, 0.6])
    input_std = np.array([0.4, 0.2, 0.7])

    def variance(log_factor):
        squared = slopes**2 * input_std**2 * np.exp(log_factor)
        return noise + squared.sum(axis=2)

    def expected(log_factor):
        """Expected negative log density of values that have the variance at zero."""
        v = variance(log_factor)
        return 0.5 * np.sum(np.log(v) + variance(np.zeros(3)) / v)

    step = 1e-3 * np.eye(3)
    level = expected(np.zeros(3))
    curvature = [(expected(d) - 2 * level + expected(-d)) / 1e-6 for d in step]
    assert_allclose(input_noise_information(slopes, noise, input_std), curvature, rtol=1e-5)


def test_of_a_regressor_without_effect_nothing_is_known():
    slopes = np.ones((50, 2, 2)) * [1.0, 0.0]
    information = input_noise_information(slopes, np.array([0.1, 0.1]), np.array([0.5, 0.5]))
    assert information[0] > 1
    assert information[1] == 0
