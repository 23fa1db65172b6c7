"""Where the stages of a search start."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.inference import KnownNoise, single_output, starting_kernel
from skdgp.kernels import ConvolvedGaussian, LinearTrend


def test_what_outputs_found_alone_is_adopted(uneven):
    X, Y = uneven
    kernel = LinearTrend() + ConvolvedGaussian(0)
    singles = []
    for i in range(3):
        single = starting_kernel(single_output(kernel), X, Y[:, [i]])
        singles.append(single.clone_with_theta(single.theta - 0.3))
    start = starting_kernel(kernel, X, Y, singles)
    for i, single in enumerate(singles):
        assert_allclose(start.block_diag(i, X), single.block_diag(0, X), rtol=1e-6)


@pytest.mark.parametrize(("bounds", "widest"), [(None, 10.0), ((1e-3, 1e5), 500.0)])
def test_a_search_does_not_start_where_the_likelihood_is_flat(bounds, widest, uneven):
    X, Y = uneven
    kernel = ConvolvedGaussian(1, parameter_bounds={"length_scale": bounds})
    scale = X.std(axis=0)
    alone = starting_kernel(single_output(kernel), X, Y[:, :1])
    wide = [alone.set_params(length_scale=500.0 * scale)] * 3
    start = starting_kernel(kernel, X, Y, wide)
    assert_allclose(np.max(start.length_scale / scale), widest)


@pytest.mark.parametrize(("n_rows", "least"), [(1, 0.3), (4, 0.15), (100, 1e-6)])
def test_noise_starts_at_a_fifth_of_the_residual(n_rows, least):
    """Bounds are relative to the variance of the output; one row shows no noise, twice the weights of a plane do."""
    X = np.random.default_rng(0).normal(size=(n_rows, 2))
    residual = np.resize([3.0, -3.0], (n_rows, 1))
    variance, bounds = KnownNoise().start(residual, np.array([10.0]), X)
    assert_allclose(bounds, [[100.0 * least, 1e4]])
    assert_allclose(variance, max(0.2 * residual.var(), 100.0 * least))
