"""Contracts of scikit-learn's kernels, beside the mathematics of test_contract.py."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    CompoundKernel,
    ConstantKernel,
    Matern,
    WhiteKernel,
)

from skdgp.kernels import (
    ConvolvedGaussian,
    Coregionalized,
    as_multi_output,
)

X = default_rng(0).normal(size=(5, 2))


def convolved(**parameters):
    values = {"amplitude": np.array([[1.0, 2.0]]), "length_scale": np.ones((1, 2, 2))}
    return ConvolvedGaussian(1, private_latents=False, **(values | parameters))


class TestCoregionalized:
    @pytest.mark.parametrize(
        "inner", [RBF([0.8, 1.5]), ConstantKernel(2.0) * Matern(0.7), RBF(0.6)]
    )
    def test_is_the_kronecker_product(self, inner):
        W = default_rng(1).normal(size=(2, 3))
        kernel = Coregionalized(inner, 2, private_latents=False, amplitude=W)
        assert_allclose(kernel(X), np.kron(W.T @ W, inner(X)), rtol=1e-12)
        assert_allclose(kernel(X, X[:2]), np.kron(W.T @ W, inner(X, X[:2])), rtol=1e-12)

    def test_takes_amplitudes_from_the_data(self):
        Y = default_rng(2).normal(size=(5, 3)) * [1.0, 10.0, 1e-3]
        kernel = Coregionalized(RBF()).initialize(X, Y, 0)
        assert (kernel.n_outputs, kernel.n_features) == (3, None)
        variance = kernel.diag(X[:1]) / Y.var(axis=0)
        assert ((variance > 0.5) & (variance < 5)).all()
        with pytest.raises(ValueError, match="no values yet: give amplitude"):
            Coregionalized(RBF())(X)
        with pytest.raises(ValueError, match=r"2 regressors, but expected 3"):
            Coregionalized(RBF([1.0, 2.0, 3.0])).initialize(X, Y, 0)

    @pytest.mark.parametrize(
        "inner", [RBF() + WhiteKernel(), CompoundKernel([RBF()]), 1.0, convolved()]
    )
    def test_refuses_what_is_no_kernel_of_one_function(self, inner):
        with pytest.raises(TypeError, match="but expected"):
            Coregionalized(inner, amplitude=[[1.0]])(X)


def test_sums_with_kernels_of_scikit_learn():
    kernel = convolved()
    expected = kernel + Coregionalized(RBF())
    assert kernel + RBF() == expected
    assert as_multi_output(RBF() + kernel) == Coregionalized(RBF()) + kernel
    assert as_multi_output(kernel) is kernel


def test_one_output_fits_scikit_learns_regressor():
    y = np.sin(2 * X[:, 0])
    one = ConvolvedGaussian(0, amplitude=[[1.0]], length_scale=[[[1.0, 1.0]]])
    one.parameter_bounds = {"length_scale": "fixed"}
    mine = GaussianProcessRegressor(one, alpha=0.1).fit(X, y)
    theirs = GaussianProcessRegressor(ConstantKernel() * RBF([1.0, 1.0], "fixed"), alpha=0.1).fit(
        X, y
    )
    assert mine.kernel_.amplitude.item() ** 2 == pytest.approx(
        theirs.kernel_.k1.constant_value, rel=1e-3
    )
