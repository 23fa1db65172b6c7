"""Equations 17 to 20 against references typed from them."""

import tracemalloc

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal
from threadpoolctl import threadpool_limits

from skdgp.inference import (
    Data,
    ExactPosterior,
    PosteriorSettings,
    log_likelihood,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend

NEW = default_rng(5).normal(size=(6, 2))


TILES = pytest.mark.parametrize("side", [256, 1, 3])


def likelihood(problem, **options):
    return log_likelihood(problem.kernel, problem.noise, problem.data, **options)


def posterior_of(problem):
    return ExactPosterior(problem.kernel, problem.noise, problem.data)


def cross(problem, Xs):
    """Covariance of all outputs at Xs, output-major, with the observed values."""
    return problem.kernel([Xs] * problem.kernel.n_outputs, problem.data.X)


class TestLikelihood:
    @TILES
    def test_is_the_density_of_the_observed_values(self, problem, side):
        expected = multivariate_normal(cov=problem.K).logpdf(problem.y)
        assert likelihood(problem, side=side) == pytest.approx(expected, rel=1e-10)
        assert posterior_of(problem).log_marginal_likelihood == pytest.approx(expected, rel=1e-10)

    @TILES
    def test_gradient(self, problem, side, assert_gradient):
        """By the hyperparameters, then by the logarithms of the noise."""
        n = problem.kernel.n_dims
        theta = np.concatenate([problem.kernel.theta, np.log(problem.noise)])

        def at(theta):
            kernel = problem.kernel.clone_with_theta(theta[:n])
            return log_likelihood(kernel, np.exp(theta[n:]), problem.data)

        found = likelihood(problem, eval_gradient=True, side=side)
        assert found.value == pytest.approx(at(theta))
        assert_gradient(found.gradient, at, theta, rtol=1e-7, atol=1e-7)

    @TILES
    def test_information(self, problem, side, information):
        """Half of alpha^T dK_k K^-1 dK_l alpha, by the kernel and by the logarithms of the noise, and curvature."""
        alpha = np.linalg.solve(problem.K, problem.y)
        _, slopes = problem.kernel(problem.data.X, eval_gradient=True)
        products = [slopes[..., k] @ alpha for k in range(problem.kernel.n_dims)]
        outputs = np.repeat(np.arange(len(problem.data.y)), [len(y) for y in problem.data.y])
        for i, variance in enumerate(problem.noise):
            products.append(np.where(outputs == i, variance * alpha, 0.0))
        products = np.array(products)
        expected = information(problem.kernel, problem.data, problem.K, problem.y, products)
        found = likelihood(problem, eval_gradient=True, side=side).information
        assert_allclose(found, expected, rtol=1e-7, atol=1e-9)

    @pytest.mark.parametrize("silent", [0, 1, 2])
    def test_an_output_without_values_has_no_gradient_by_its_noise(self, one_problem, silent):
        by_noise = likelihood(one_problem, eval_gradient=True).gradient[-3:]
        assert by_noise.all()
        one_problem.Y[:, silent] = np.nan
        one_problem.data = Data.from_table(one_problem.X, one_problem.Y)
        gradient = likelihood(one_problem, eval_gradient=True).gradient
        assert_array_equal(gradient[-3:] == 0, np.arange(3) == silent)
        assert np.isfinite(gradient).all()


@pytest.mark.parametrize("chunk_bytes", [PosteriorSettings().chunk_bytes, 100])
def test_posterior_is_equations_17_and_18(problem, chunk_bytes):
    Ks = cross(problem, NEW)
    expected = Ks @ np.linalg.solve(problem.K, problem.y)
    covariance = problem.kernel(NEW) - Ks @ np.linalg.solve(problem.K, Ks.T)
    posterior = posterior_of(problem)
    posterior.settings = PosteriorSettings(chunk_bytes=chunk_bytes)
    assert_allclose(posterior.covariance(NEW), covariance, rtol=1e-8, atol=1e-10)
    mean, variance = posterior.predict(NEW, return_variance=True)
    assert_allclose(mean.T.ravel(), expected, rtol=1e-9)
    assert_allclose(variance.T.ravel(), np.diag(covariance), rtol=1e-8)
    assert_allclose(posterior.predict(NEW), mean, rtol=1e-12)


def peak_memory(function, *arguments, **options):
    """Bytes that NumPy held at most while the function ran."""
    tracemalloc.start()
    try:
        function(*arguments, **options)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def large():
    rng = default_rng(0)
    X, Y = rng.normal(size=(500, 4)), rng.normal(size=(500, 3))
    kernel = LinearTrend() + ConvolvedGaussian(1)
    return kernel.initialize(X, Y, 0), np.full(3, 0.3), Data.from_table(X, Y)


def test_the_number_of_threads_does_not_change_the_likelihood(large):
    results = []
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            results.append(log_likelihood(*large, eval_gradient=True, side=100))
    once, again = results
    assert again.value == pytest.approx(once.value, rel=1e-12)
    assert_allclose(again.gradient, once.gradient, rtol=1e-9, atol=1e-10)


class TestMemory:
    def test_of_one_evaluation_is_below_three_matrices(self, large):
        matrix = 8 * large[2].n_values ** 2
        assert matrix <= peak_memory(log_likelihood, *large, eval_gradient=True) < 3 * matrix
