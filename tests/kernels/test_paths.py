"""Samples of the prior that are functions: how Gaussian they are, and points far from each other."""

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import kstest

from skdgp.kernels import (
    ConvolvedGaussian,
    inducing_features,
    prior_paths,
)


def test_where_the_filters_of_a_latent_are_alike_values_are_gaussian():
    """One wave is enough: its amplitude is of Rayleigh, its phase uniform."""
    kernel = ConvolvedGaussian(
        2, covariance_type="tied", amplitude=np.ones((4, 2)), length_scale=[[[0.5, 2.0]]]
    )
    point = np.array([[[0.3, -0.5]]])
    paths = prior_paths(kernel, 5000, 1, np.random.RandomState(0)).values(point)
    for values in paths[:, 0].T / np.sqrt(3.0):
        assert kstest(values, "norm").pvalue > 0.01


def test_inducing_inputs_far_from_each_other_lose_no_digits():
    """In length scales; squares of such distances, expanded, would cancel."""
    widths = default_rng(0).uniform(0.6, 1.8, (3, 2, 2))
    amplitude = [[1.0, -0.5], [0.5, 0.0], [0.0, 2.0]]
    kernel = ConvolvedGaussian(1, amplitude=amplitude, length_scale=widths)
    Z = np.array([[0.0, 0.0], [1e8, -1e8]])
    features, X = inducing_features(kernel, Z), Z + 0.3
    values = features.paths(np.eye(features.size)).values(X[None])
    for i in range(kernel.n_outputs):
        of_output = values[features.columns(i), :, i].T
        assert_allclose(of_output, features.Kfu(i, X), rtol=1e-6, atol=1e-9)
