"""Special cases whose answers are known."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.gaussian_process.kernels import RBF

from skdgp.kernels import ConvolvedGaussian, LinearTrend


@pytest.fixture
def rng():
    return default_rng(0)


def correlation(kernel, delta, i=0, j=1):
    origin = np.zeros((1, len(delta)))
    size = np.sqrt(kernel.block_diag(i, origin) * kernel.block_diag(j, origin))
    return (kernel.block(i, j, np.asarray(delta)[None], origin)[0] / size).item()


class TestNothingShared:
    """Private latents alone are independent Gaussian processes: scikit-learn's."""

    amplitude = np.array([0.8, -1.5, 2.0])
    lengths = np.array([[0.7, 1.3], [1.0, 0.5], [2.0, 0.9]])

    @property
    def kernel(self):
        private = np.repeat(self.lengths[None], 3, axis=0)
        return ConvolvedGaussian(0, amplitude=np.diag(self.amplitude), length_scale=private)

    def test_kernel(self, rng):
        X = rng.normal(size=(6, 2))
        K = self.kernel(X)
        for i in range(3):
            for j in range(3):
                block = K[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
                expected = self.amplitude[i] ** 2 * RBF(self.lengths[i])(X) if i == j else 0.0
                assert_allclose(block, np.broadcast_to(expected, (6, 6)), rtol=1e-12)


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


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("covariance_type", ["diag", "tied"])
def test_one_latent_through_equal_filters_correlates_fully(covariance_type, sign, rng):
    kernel = ConvolvedGaussian(
        1,
        private_latents=False,
        covariance_type=covariance_type,
        amplitude=[[2.0, 0.3 * sign]],
        length_scale=np.full((1, 2, 2), 0.8),
    )
    assert correlation(kernel, [0.0, 0.0]) == pytest.approx(sign)


def test_outputs_are_most_alike_at_the_difference_of_their_shifts():
    shift = np.array([[[0.0, 0.0], [0.7, -0.4]]])
    kernel = ConvolvedGaussian(
        1,
        private_latents=False,
        amplitude=[[1.0, 1.0]],
        length_scale=np.ones((1, 2, 2)),
        shift=shift,
    )
    # Output 0 at s - shift says what output 1 says at s: its filter answers later.
    assert correlation(kernel, shift[0, 0] - shift[0, 1]) == pytest.approx(1.0)
    assert correlation(kernel, shift[0, 1] - shift[0, 0]) < 0.8


def test_tied_widths_are_equal_ones(rng):
    w, X = rng.normal(size=(1, 2)), rng.normal(size=(4, 3))
    shift = rng.normal(size=(1, 2, 3)) * [[[0], [1]]]

    def matrix(covariance_type, lengths):
        return ConvolvedGaussian(
            1,
            private_latents=False,
            covariance_type=covariance_type,
            amplitude=w,
            length_scale=lengths,
            shift=shift,
        )(X)

    tied = np.broadcast_to(rng.uniform(0.5, 2, (1, 1, 3)), (1, 2, 3))
    assert_allclose(matrix("tied", tied), matrix("diag", tied), rtol=1e-12)


def test_trend_is_a_bayesian_linear_model(rng):
    """Phi diag(tau^2) Phi^T of each output, nothing between outputs."""
    intercept, slope, center = rng.uniform(1, 2, 2), rng.uniform(1, 2, (2, 3)), rng.normal(size=3)
    X = rng.normal(size=(4, 3))
    Phi = np.column_stack([np.ones(4), X - center])
    K = LinearTrend(intercept, slope, center)(X)
    for i in range(2):
        prior = np.diag(np.r_[intercept[i], slope[i]] ** 2)
        assert_allclose(K[4 * i : 4 * i + 4, 4 * i : 4 * i + 4], Phi @ prior @ Phi.T, rtol=1e-12)
    assert (K[:4, 4:] == 0).all()


def test_a_sum_of_processes_of_single_regressors_has_no_interactions(rng):
    """Cov of f(a, b) - f(a', b) - f(a, b') + f(a', b'), zero for every function g(a) + h(b)."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    signs = np.array([1.0, -1.0, -1.0, 1.0])
    X, Y = rng.normal(size=(60, 2)), rng.normal(size=(60, 2))
    one, other, both = (
        ConvolvedGaussian(0, regressors=columns).initialize(X, Y, 0)
        for columns in ([0], [1], [0, 1])
    )
    additive = one + other
    assert signs @ additive.block(0, 0, square, square) @ signs == pytest.approx(0.0, abs=1e-8)
    assert signs @ both.block(0, 0, square, square) @ signs > 1e-3
