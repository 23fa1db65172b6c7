"""A convolved Gaussian of few regressors is the kernel of these columns alone."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.kernels import ConvolvedGaussian, inducing_features


@pytest.fixture
def rng():
    return default_rng(0)


@pytest.fixture(scope="module")
def data():
    rng = default_rng(1)
    X = rng.uniform(-1, 1, (80, 3)) * [1.0, 50.0, 1e-3]
    Y = np.column_stack([np.sin(3 * X[:, 0]), X[:, 0] ** 2 + X[:, 1] / 50]) + rng.normal(
        0, 0.05, (80, 2)
    )
    return X, Y


def pair(columns, rng, d=3, P=2):
    """Return a kernel of few of d regressors, and one of an array of these columns."""
    lengths, amplitude = rng.uniform(0.5, 2, (1 + P, P, d)), rng.normal(size=(1 + P, P))
    of_few = ConvolvedGaussian(1, regressors=columns, amplitude=amplitude, length_scale=lengths)
    return of_few, ConvolvedGaussian(1, amplitude=amplitude, length_scale=lengths[..., columns])


def test_matrix_and_slopes_are_those_of_the_columns(rng):
    X, (of_few, alone) = rng.normal(size=(7, 3)), pair([0, 2], rng)
    few = X[:, [0, 2]]
    assert_allclose(of_few(X), alone(few), rtol=1e-9, atol=1e-9)
    slopes = of_few.block_derivative(0, 1, X, X)
    assert_allclose(slopes[[0, 2]], alone.block_derivative(0, 1, few, few), rtol=1e-9, atol=1e-9)
    assert_allclose(slopes[1], 0.0, atol=1e-9)


@pytest.mark.parametrize("given", [None, 0.7])
def test_initialize_fixes_the_others_in_their_units(given, data):
    X, Y = data
    kernel = ConvolvedGaussian(1, regressors=[0], length_scale=given).initialize(X, Y, 0)
    assert (kernel.length_scale[..., 1:] >= 0.9e6 * X.std(axis=0)[1:]).all()
    assert given is None or (kernel.length_scale[..., 0] == given).all()
    assert kernel.n_dims == 4 + 4  # amplitudes and widths of the shared and the private latents
    K = kernel(X)
    assert_allclose(K, kernel(X * [1, 0, 0]), atol=1e-9 * K.max())


def test_functions_of_one_regressor_need_few_inducing_inputs(rng):
    """However many are given; they hold all of its variance within the range of the given ones."""
    Z = rng.uniform(-1, 1, (600, 3))
    kernel, both = (
        ConvolvedGaussian(0, regressors=columns, amplitude=[[1.0]], length_scale=0.5 + np.zeros(3))
        for columns in ([1], [0, 1])
    )
    few, many, more = (inducing_features(kernel, Z[:n]) for n in (7, 300, 600))
    assert few.size == 7
    assert many.size == more.size < 100
    assert inducing_features(both, Z).size == 600
    X = rng.uniform(-0.9, 0.9, (20, 3))
    Kfu = more.Kfu(0, X)
    held = np.einsum("nk,nk->n", Kfu, np.linalg.solve(more.Kuu(), Kfu.T).T)
    assert_allclose(held, kernel.diag(X), rtol=1e-4)


@pytest.mark.parametrize("regressors", [[3], [], [0.5], ["alpha"]])
def test_wrong_columns(regressors, data):
    with pytest.raises(ValueError, match="expected columns of X from 0 to 2"):
        ConvolvedGaussian(1, regressors=regressors).initialize(*data, 0)
