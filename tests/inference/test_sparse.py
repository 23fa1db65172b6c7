"""The collapsed bound against its definition, and against what it bounds."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal
from threadpoolctl import threadpool_limits

from skdgp.inference import (
    PosteriorSettings,
    SparsePosterior,
)
from skdgp.kernels import inducing_features

NEW = default_rng(5).normal(size=(6, 2))
Z = default_rng(6).normal(size=(7, 2))


def sparse(problem, data=None):
    return SparsePosterior(
        problem.kernel,
        inducing_features(problem.kernel, Z),
        problem.noise,
        data or problem.data,
    )


def independent(problem):
    """Return the noise covariance without that of different outputs, which sparse inference neglects."""
    return np.diag(np.diag(problem.S))


@pytest.fixture
def reference(problem, stacked):
    """Kuu, Kfu and Qff of Titsias (2009)."""
    features = inducing_features(problem.kernel, Z)
    Kuu, Kfu = features.Kuu(), stacked(features, problem.data.X)
    return features, Kuu, Kfu, Kfu @ np.linalg.solve(Kuu, Kfu.T)


class TestBound:
    def test_is_titsias(self, problem, reference):
        *_, Qff = reference
        S = independent(problem)
        missing = np.linalg.solve(S, problem.kernel(problem.data.X) - Qff)
        density = multivariate_normal(cov=Qff + S).logpdf(problem.y)
        expected = density - 0.5 * np.trace(missing)
        assert sparse(problem).log_marginal_likelihood == pytest.approx(expected, rel=1e-9)


class TestPosterior:
    def test_mean_and_covariance(self, problem, reference, stacked):
        features, Kuu, Kfu, _ = reference
        S = independent(problem)
        B = Kuu + Kfu.T @ np.linalg.solve(S, Kfu)
        Ks = stacked(features, [NEW] * 3)
        mean = Ks @ np.linalg.solve(B, Kfu.T @ np.linalg.solve(S, problem.y))
        cov = problem.kernel(NEW) - Ks @ (np.linalg.inv(Kuu) - np.linalg.inv(B)) @ Ks.T
        posterior = sparse(problem)
        assert_allclose(posterior.covariance(NEW), cov, rtol=1e-6, atol=1e-8)
        found, variance = posterior.predict(NEW, True)
        assert_allclose(found, mean.reshape(3, -1).T, rtol=1e-7, atol=1e-9)
        assert_allclose(variance, np.diag(cov).reshape(3, -1).T, rtol=1e-6)
        assert_allclose(posterior.predict(NEW), found)


class TestRows:
    def test_how_samples_are_cut_does_not_matter(self, problem, monkeypatch):
        """By as many threads as BLAS may use; also of so many points that threads share them."""
        posterior = sparse(problem)
        many = np.tile(NEW, (450, 1))
        settings = PosteriorSettings(chunk_bytes=2**14, rows=3)
        monkeypatch.setattr(SparsePosterior, "settings", settings)
        with threadpool_limits(2, user_api="blas"):
            again = sparse(problem)
            value = again.log_marginal_likelihood
            found = again.predict(many, True)
        assert_allclose(value, posterior.log_marginal_likelihood, rtol=1e-6, atol=1e-7)
        expected = np.tile(posterior.predict(NEW, True), (1, 450, 1))
        assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
