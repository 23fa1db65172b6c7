"""Values whose noise is shared by the outputs of a sample: what of it is learned, and from which slopes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from skdgp.inference import (
    ExactPosterior,
    log_likelihood,
)


def test_loadings_are_slopes_times_deviations(one_problem, central_difference):
    """Of a function whose slopes propagate the noise of regressors; the slopes are differences here."""
    std = np.array([[0.2, 0.5], [0.1, 0.3], [0.4, 0.0]])  # by output and regressor
    posterior = ExactPosterior(one_problem.kernel, one_problem.noise, one_problem.data)
    slopes = []
    for x in one_problem.X:
        slopes.append(central_difference(lambda x: posterior.predict(x[None])[0], x))
    data = one_problem.data.with_slopes(posterior.mean_function, std)
    for i, loading in enumerate(data.loadings()):
        rows = np.isfinite(one_problem.Y[:, i])
        assert_allclose(loading, (slopes * std)[rows, i], atol=1e-6)


def test_likelihood_of_learned_variances_and_its_derivatives(
    noisy_problem, noise_of, assert_gradient, central_difference, information
):
    """By the kernel, the noise of outputs and the variance of each regressor's noise."""
    kernel, noise, data = noisy_problem.kernel, noisy_problem.noise, noisy_problem.data
    scale = np.array([0.3, 2.0])
    variances = np.concatenate([noise, scale])
    theta = np.concatenate([kernel.theta, np.log(variances)])

    def at(theta):
        moved = kernel.clone_with_theta(theta[: kernel.n_dims])
        return log_likelihood(moved, np.exp(theta[kernel.n_dims :]), data)

    def covariance_at(theta):
        noise, scale = np.split(np.exp(theta[kernel.n_dims :]), [3])
        S = noise_of(noisy_problem.Y, noise, noisy_problem.loading * np.sqrt(scale))
        return kernel.clone_with_theta(theta[: kernel.n_dims])(data.X) + S

    K = covariance_at(theta)
    expected = multivariate_normal(cov=K).logpdf(noisy_problem.y)
    found = log_likelihood(kernel, variances, data, eval_gradient=True)
    assert found.value == pytest.approx(expected, rel=1e-10)
    assert at(theta) == pytest.approx(expected, rel=1e-10)
    assert_gradient(found.gradient, at, theta, rtol=1e-7, atol=1e-7)
    products = central_difference(
        lambda theta: covariance_at(theta) @ np.linalg.solve(K, noisy_problem.y), theta
    )
    expected = information(kernel, data, K, noisy_problem.y, products.T)
    assert_allclose(found.information, expected, rtol=1e-6, atol=1e-7)
