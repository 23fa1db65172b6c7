"""Where the stages of a search start."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.inference import narrowed, single_output, starting_kernel
from skdgp.kernels import ConvolvedGaussian, LinearTrend

KERNELS = {
    "diag": ConvolvedGaussian(2),
    "tied": ConvolvedGaussian(2, covariance_type="tied"),
    "private alone": ConvolvedGaussian(0),
    "trend": LinearTrend(),
    "trend + dependent": LinearTrend() + ConvolvedGaussian(1),
}


def singles_of(kernel, X, Y):
    alone = single_output(kernel)
    return [starting_kernel(alone, X, Y[:, [i]]) for i in range(Y.shape[1])]


@pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)
def test_what_outputs_found_alone_is_adopted(kernel, uneven):
    """The joint kernel starts from it, and stays a covariance."""
    X, Y = uneven
    singles = singles_of(kernel, X, Y)
    assert [single.n_outputs for single in singles] == [1, 1, 1]
    start = starting_kernel(kernel, X, Y, singles)
    assert start.n_dims == kernel.initialize(X, Y, 0).n_dims
    for i, single in enumerate(singles):
        assert_allclose(start.block_diag(i, X), single.block_diag(0, X), rtol=1e-6)
    assert np.linalg.eigvalsh(start(X[:8])).min() > -1e-9 * start.diag(X[:8]).max()


@pytest.mark.parametrize(("bounds", "widest"), [(None, 10.0), ("spacing", 500.0)])
def test_a_search_does_not_start_where_the_likelihood_is_flat(bounds, widest, uneven):
    X, Y = uneven
    kernel = ConvolvedGaussian(1, parameter_bounds={"length_scale": bounds})
    scale = X.std(axis=0)
    wide = [single.set_params(length_scale=500.0 * scale) for single in singles_of(kernel, X, Y)]
    start = starting_kernel(kernel, X, Y, wide)
    assert_allclose(np.max(start.length_scale / scale), widest)


def test_a_narrowed_start_has_narrower_widths(uneven):
    X, Y = uneven
    kernel = LinearTrend() + ConvolvedGaussian(1)
    start = starting_kernel(kernel, X, Y)
    ratio = narrowed(kernel, start, 0.1).k2.length_scale / start.k2.length_scale
    assert_allclose(ratio, np.full(ratio.shape, 0.1))
