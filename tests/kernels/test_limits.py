"""Special cases whose answers are known."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.gaussian_process.kernels import RBF

from skdgp.kernels import ConvolvedGaussian


@pytest.fixture
def rng():
    return default_rng(0)


def test_tied_without_shift_is_the_linear_model_of_coregionalisation(rng):
    W, lengths = rng.normal(size=(2, 3)), rng.uniform(0.5, 2, (2, 1, 2))
    kernel = ConvolvedGaussian(
        2,
        private_latents=False,
        covariance_type="tied",
        amplitude=W,
        length_scale=np.repeat(lengths, 3, axis=1),
    )
    X = rng.normal(size=(5, 2))
    expected = sum(
        np.kron(np.outer(w, w), RBF(length[0])(X)) for w, length in zip(W, lengths, strict=True)
    )
    assert_allclose(kernel(X), expected, rtol=1e-12)
