"""DependentGPRegressor with a given kernel: units, terms, kernels of scikit-learn and of five methods."""

import warnings

import numpy as np
import pytest
from made_kernels import assert_covariance
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from skdgp import DependentGPRegressor
from skdgp.kernels import (
    ConvolvedGaussian,
    Coregionalized,
    LinearTrend,
)

FAR = [[1e4]]  # where a posterior is the prior


# With values, in the units of `waves`
GIVEN = [
    ConvolvedGaussian(
        1,
        private_latents=False,
        amplitude=[[30.0, -3e-3]],
        length_scale=1.5 + np.zeros((1, 2, 1)),
        parameter_bounds={"amplitude": np.array([[-100.0, 100.0], [-0.01, 0.01]])},
    ),
    Coregionalized(Matern(), amplitude=[[30.0, -3e-3], [1.0, 0.0], [0.0, 1e-4]]),
]


@pytest.fixture(params=["convolved", "coregionalized", "of the page"])
def given(request, kernel_of_the_page):
    """Return a kernel with values."""
    kernels = [*GIVEN, kernel_of_the_page([30.0, -3e-3], [1.5])]
    return kernels[request.param_index]


def waves(seed=0, n=40):
    """Two outputs of opposite sign of one regressor, in the units of a force and of a coefficient."""
    rng = default_rng(seed)
    X = np.linspace(0, 10, n)[:, None]
    Y = np.sin(X) * [50.0, -2e-3]
    return X, Y + rng.normal(size=Y.shape) * [2.0, 1e-4]


def quick(kernel, **more):
    return DependentGPRegressor(kernel, **({"structure": "joint", "random_state": 0} | more))


class TestUnits:
    """Values and bounds of a given kernel, and kernel_, are in the units of the outputs."""

    @pytest.mark.parametrize("trend", [None, "constant"])
    def test_far_from_the_samples_the_deviation_is_that_of_the_kernel(self, given, trend):
        X, Y = waves()
        model = quick(given, trend=trend, optimizer=None).fit(X, Y)
        _, std = model.predict(FAR, return_std=True)
        assert_allclose(std[0] ** 2, given.diag(FAR))
        assert_allclose(model.kernel_.diag(FAR), given.diag(FAR))

    def test_a_kernel_of_five_methods_comes_back_with_its_learned_values(self, kernel_of_the_page):
        X, Y = waves()
        given = kernel_of_the_page([30.0, -3e-3], [1.5])
        model = quick(given, trend="constant", max_iter=40).fit(X, Y)
        assert type(model.kernel_) is kernel_of_the_page
        assert model.kernel_.amplitude[0] / model.kernel_.amplitude[1] == pytest.approx(
            -25e3, rel=0.05
        )
        assert (given.amplitude, given.length_scale) == ([30.0, -3e-3], [1.5])
        with pytest.raises(ValueError, match=r"data of 1 outputs, but expected 2.*SharedMatern"):
            quick(given).fit(X, Y[:, 0])


def test_a_search_that_ends_where_all_is_noise_says_so():
    """From a length scale of 3 the waves of sin(8 x) look like noise; restarts find them."""
    rng = default_rng(0)
    X = rng.uniform(-2, 2, (100, 1))
    y = np.sin(8 * X[:, 0]) + 0.1 * rng.normal(size=100)
    model = DependentGPRegressor(RBF(3.0), trend="constant", random_state=0)
    with pytest.warns(ConvergenceWarning, match="explains nothing of the outputs"):
        noise = model.fit(X, y).log_marginal_likelihood_value_
    model.set_params(n_restarts_optimizer=10).fit(X, y)
    assert model.log_marginal_likelihood_value_ > noise + 100


class TestBounds:
    @pytest.mark.parametrize(
        ("kernel", "told"),
        [
            (
                ConvolvedGaussian(
                    1, private_latents=False, parameter_bounds={"amplitude": (-20.0, 20.0)}
                ),
                r"of the kernel: amplitude\[0, 0\] = -?20 \((lower|upper) bound -?20\)\. Widen",
            ),
            (
                LinearTrend(parameter_bounds={"slope_scale": (9.0, 90.0)}),
                r"slope_scale\[0, 0\] = 9 \(lower bound 9\)",
            ),
            (
                Coregionalized(RBF(0.3, (0.1, 0.5))),
                r"kernel__length_scale\[0\] = 0.5 \(upper bound 0.5\)",
            ),
        ],
    )
    def test_of_every_hyperparameter_are_told_in_the_unit_of_the_output(self, kernel, told):
        X, Y = waves()
        with pytest.warns(ConvergenceWarning, match=told) as caught:
            quick(kernel, trend="constant").fit(X, Y[:, 0] + X[:, 0])
        caught = [warning for warning in caught if issubclass(warning.category, ConvergenceWarning)]
        assert len(caught) == 1

    @pytest.mark.parametrize(
        ("bounds", "shift"),
        [
            ((-2.0, 2.0), -1.0),
            (np.broadcast_to([-2.0, 2.0], (1, 2, 1, 2)), -1.0),
            ((0.0, 2.0), 0.0),
            (np.array([[[[0.0, 0.0]], [[0.0, 2.0]]]]), 0.0),
        ],
    )
    def test_of_shifts_are_of_differences_or_of_each_output(self, bounds, shift):
        x = np.linspace(0, 12, 40)[:, None]
        Y = np.hstack([np.sin(x), np.sin(x + 1)]) + default_rng(0).normal(0, 0.05, (40, 2))
        kernel = ConvolvedGaussian(
            1, private_latents=False, parameter_bounds={"shift": bounds, "length_scale": (1, 3)}
        )
        with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
            learned = quick(kernel, trend=None).fit(x, Y).kernel_.value("shift")[0, :, 0]
        assert learned[1] - learned[0] == pytest.approx(shift, abs=0.1)

    def test_from_the_data_are_not_told_nor_those_where_a_refit_starts(self):
        X, Y = waves()
        level = np.column_stack([Y[:, 0], 0.3 * X[:, 0]])  # a line needs no width
        with warnings.catch_warnings(action="error"):
            model = quick(ConvolvedGaussian(1), trend="constant").fit(X, level)
            quick(model.kernel_, trend="constant").fit(X, level)


class TestKernelsOfScikitLearn:
    @pytest.mark.parametrize(
        "kernel", [ConstantKernel() * RBF([1.0]), RBF() + Matern(), RBF(2.0, "fixed")]
    )
    def test_several_outputs_share_what_they_have_in_common(self, kernel):
        X, Y = waves()
        truth = -2e-3 * np.sin(X[:, 0])
        Y[12:28, 1] = np.nan
        model = quick(kernel).fit(X, Y)
        gap = slice(12, 28)
        assert np.abs(model.predict(X)[gap, 1] - truth[gap]).max() < 5e-4
        assert type(model.kernel_.k2) is Coregionalized
        assert clone(model).get_params()["kernel"] == kernel  # which is left alone

    @pytest.mark.parametrize(
        ("kernel", "told"),
        [
            (RBF() + WhiteKernel(), r"without WhiteKernel\. Leave out measurement noise"),
            (RBF() * ConvolvedGaussian(), r"product or power.*can only be added"),
            (ConstantKernel() + RBF() * LinearTrend(), r"product or power.*inside Coregionalized"),
        ],
    )
    def test_what_cannot_be_meant_is_refused(self, kernel, told):
        with pytest.raises(TypeError, match=told):
            quick(kernel).fit(*waves())


class TestSamples:
    """Of a kernel without sample paths."""

    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_have_the_moments_of_the_posterior(self, inference):
        X, Y = waves()
        model = quick(RBF(), inference=inference, n_inducing=15, max_iter=10).fit(X, Y)
        at = np.array([[2.2], [2.4], [15.0]])
        samples = model.sample_y(at, 20000, random_state=1)
        assert samples.shape == (3, 2, 20000)
        mean, cov = model.predict(at, return_cov=True)
        assert_covariance(samples.T.reshape(20000, -1) - mean.T.ravel(), cov)
        assert_array_equal(model.sample_y(at, 20000, random_state=1), samples)
