"""Paths of the posterior: their moments are the posterior's, and they pass through what is known."""

import numpy as np
import pytest
from made_kernels import assert_covariance
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.inference import (
    Data,
    ExactPosterior,
    PosteriorSettings,
    SparsePosterior,
)
from skdgp.kernels import inducing_features

N_PATHS = 4000
Z = default_rng(6).normal(size=(7, 2))


def exact(problem):
    return ExactPosterior(problem.kernel, problem.noise, problem.data)


def sparse(problem):
    features = inducing_features(problem.kernel, Z)
    return SparsePosterior(problem.kernel, features, problem.noise, problem.data)


def points(problem):
    """Observed samples, points between them, and one far from all."""
    return np.concatenate([problem.X[:2], Z[:2], [[9.0, -9.0]]])


def assert_moments(posterior, X):
    """Mean and joint covariance over paths, within what so many of them allow."""
    values = posterior.paths(N_PATHS, 0).values(X[None]).swapaxes(1, 2).reshape(N_PATHS, -1)
    assert_covariance(values - posterior.predict(X).T.ravel(), posterior.covariance(X))


@pytest.fixture(params=[exact, sparse])
def make(request):
    """Return a function of a problem: its posterior with few waves in a path, on which moments do not depend."""

    def made(problem):
        posterior = request.param(problem)
        posterior.settings = PosteriorSettings(frequencies=6)
        return posterior

    return made


def test_mean_and_covariance_are_the_posteriors(problem, make):
    assert_moments(make(problem), points(problem))


def test_slopes_have_the_posteriors_moments(one_problem, make, slope_std):
    posterior, X = make(one_problem), points(one_problem)
    slopes = posterior.paths(N_PATHS, 1).slopes(X[None])
    mean = posterior.gradient(X)
    variance = np.stack([slope_std(posterior.covariance, x) for x in X]) ** 2
    assert (np.abs(slopes.mean(axis=0) - mean) < 5 * np.sqrt(variance / N_PATHS)).all()
    spread = np.mean((slopes - mean) ** 2, axis=0)
    assert_allclose(spread / variance, 1.0, atol=5 * np.sqrt(2 / N_PATHS))


def test_an_output_that_was_never_observed(one_problem, make):
    one_problem.Y[:, 1] = np.nan
    one_problem.data = Data.from_table(one_problem.X, one_problem.Y)
    assert_moments(make(one_problem), points(one_problem))
