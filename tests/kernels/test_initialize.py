"""Kernels without values take them from the data; values that were given stay."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.gaussian_process.kernels import RBF

from skdgp.kernels import ConvolvedGaussian, Coregionalized, LinearTrend

KINDS = ("diag", "tied")
OPEN = {
    **{kind: ConvolvedGaussian(2, covariance_type=kind) for kind in KINDS},
    "shifts free": ConvolvedGaussian(2, parameter_bounds={"shift": (-1e2, 1e2)}),
    "shared alone": ConvolvedGaussian(2, private_latents=False),
    "more shared than outputs": ConvolvedGaussian(5, private_latents=False),
    "private alone": ConvolvedGaussian(0),
    "trend": LinearTrend(),
    "trend + dependent": LinearTrend() + ConvolvedGaussian(1),
}


@pytest.mark.parametrize("kernel", OPEN.values(), ids=OPEN.keys())
class TestOpenKernels:
    def test_values_lie_within_their_bounds(self, kernel, uneven):
        found = clone(kernel).initialize(*uneven, 0)
        assert found.n_outputs == 3
        low, high = found.bounds.T
        assert (low < found.theta).all()
        assert (found.theta < high).all()

    def test_variances_are_of_the_size_of_the_outputs(self, kernel, uneven):
        X, Y = uneven
        variances = clone(kernel).initialize(X, Y, 0).diag(X).reshape(3, -1).mean(axis=1)
        ratio = variances / np.nanvar(Y, axis=0)
        assert (ratio > 0.05).all()
        assert (ratio < 10).all()

    def test_starts_are_the_same_in_other_units(self, kernel, uneven):
        X, Y = uneven
        here, there = (clone(kernel).initialize(k * X, Y / k, 0) for k in (1.0, 1024.0))
        assert_allclose(there(1024.0 * X[:5]) * 1024.0**2, here(X[:5]), rtol=1e-9)

    @pytest.mark.parametrize("what", ["regressor", "output"])
    def test_constant_columns_give_finite_values(self, kernel, uneven, what):
        X, Y = (array.copy() for array in uneven)
        (X if what == "regressor" else Y)[:, 1] = 7.0
        found = kernel.initialize(X, Y, 0)
        assert np.isfinite(found.theta).all()
        assert np.isfinite(found(X[:4])).all()


def test_outputs_that_go_together_start_with_half_of_their_variance_shared():
    """Also with opposite signs and other sizes; the shared latent is wider than those of one output."""
    x = default_rng(0).normal(size=(200, 1))
    kernel = ConvolvedGaussian(1).initialize(x, np.sin(x) * [1.0, -3.0], 0)
    assert_allclose(kernel(x[:1]) / kernel.diag([x[:1], x[:1]])[0], [[1.0, -1.5], [-1.5, 9.0]])
    assert kernel.length_scale[0].min() > kernel.length_scale[1:].max()


class TestGivenValues:
    def test_stay(self, uneven):
        amplitude = [[1.0, 2.0, 3.0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
        for kernel, given in (
            (ConvolvedGaussian, {"amplitude": amplitude}),
            (ConvolvedGaussian, {"length_scale": np.full((4, 3, 3), 2.5)}),
            (LinearTrend, {"slope_scale": np.full((3, 3), 2.0), "center": [1.0, 2.0, 3.0]}),
        ):
            found = kernel(**given).initialize(*uneven, 0)
            for name, value in given.items():
                assert_array_equal(getattr(found, name), value)


@pytest.mark.parametrize(
    ("n", "d", "least"),
    [(1000, 1, 1.0), (1000, 3, 1 / 9), (10, 9, 0.3), (60, 9, 0.1), (1000, 9, 0.05)],
)
def test_slopes_of_a_trend_are_not_nearly_certain_to_be_zero(n, d, least):
    """Of few rows n at least 6 / n, at most 0.3, of few regressors d^-2, in deviations of output and regressor."""
    rng = default_rng(0)
    X, Y = rng.normal(size=(n, d)), rng.normal(size=(n, 1))
    bounds = LinearTrend().initialize(X / X.std(axis=0), Y / Y.std(), 0).parameter_bounds
    assert_allclose(bounds["slope_scale"][0, 0], [least, 100.0])


@pytest.mark.parametrize(("n", "is_removed"), [(6, False), (7, True)])
def test_a_line_through_few_values_is_left_in_them(n, is_removed):
    """Two values for each of its three weights tell too little of it."""
    X = default_rng(0).normal(size=(n, 2))
    Y = 1.0 + X @ [[2.0], [3.0]]
    assert_allclose(LinearTrend().residual(X, Y), 0.0 if is_removed else Y, atol=1e-12)


class TestRefused:
    @pytest.mark.parametrize(
        ("parameters", "message"),
        [
            ({"amplitude": None}, "no values yet: give amplitude and length_scale"),
            ({"length_scale": -1.0}, "length_scale that is not positive"),
            ({"length_scale": np.ones((2, 2, 1))}, r"length_scale of shape \(2, 2, 1\)"),
            ({"amplitude": np.ones((4, 2))}, r"amplitude of shape \(4, 2\).*expected \(1, 2\)"),
            ({"covariance_type": "fully"}, "fully.*diag"),
            ({"n_latent": 0}, "at least one latent"),
        ],
        ids=lambda p: " ".join(p) if isinstance(p, dict) else "",
    )
    def test_impossible_parameters(self, parameters, message):
        given = {"private_latents": False, "amplitude": [[1.0]], "length_scale": 1.0}
        with pytest.raises(ValueError, match=message):
            ConvolvedGaussian(**given | parameters)(np.zeros((2, 1)))

    def test_values_that_contradict_the_type(self):
        """A matrix that a round trip of theta would change is not one to start from."""
        values = {"amplitude": [[1.0, 1.0]], "length_scale": np.array([[[1.0, 2.0], [3.0, 4.0]]])}
        kernel = ConvolvedGaussian(private_latents=False, covariance_type="tied", **values)
        with pytest.raises(ValueError, match=r"length scales that differ.*tied"):
            kernel(np.zeros((2, 2)))


class TestBounds:
    kernel = ConvolvedGaussian(
        private_latents=False,
        amplitude=[[1.0, 2.0]],
        length_scale=1.0,
        parameter_bounds={"amplitude": "fixed", "length_scale": np.array([0.5, 2.0])},
    )

    def test_are_of_the_parameters_that_they_name(self):
        assert_allclose(self.kernel.bounds, np.log([[0.5, 2.0]] * 2))
        assert [h.name for h in self.kernel.hyperparameters if not h.fixed] == ["length_scale"]
        fixed = clone(self.kernel).set_params(parameter_bounds={"length_scale": "fixed"})
        assert [h.name for h in fixed.hyperparameters if not h.fixed] == ["amplitude"]

    def test_of_given_values_are_far_from_any_data(self):
        """Amplitudes have a sign, widths and deviations are free in their logarithms."""
        widths = ConvolvedGaussian(
            1, private_latents=False, amplitude=[[1.0]], length_scale=[[[1.0]]]
        )
        assert_allclose(widths.bounds, [[-1e3, 1e3], np.log([1e-3, 1e3])])
        assert_allclose(LinearTrend([1.0], [[1.0]]).bounds, np.log([[1e-5, 1e5]] * 2))
        amplitudes = Coregionalized(RBF(), private_latents=False, amplitude=[[1.0]])
        assert_allclose(amplitudes.bounds[0], [-1e3, 1e3])

    def test_from_the_data_are_in_its_deviations(self, uneven):
        """Widths of 0.05 to 1000, amplitudes up to 30; where outputs have gaps, private ones from 0.2 on."""
        X, Y = uneven
        Y = (Y - np.nanmean(Y, axis=0)) / np.nanstd(Y, axis=0)
        bounds = ConvolvedGaussian(1).initialize(X / X.std(axis=0), Y, 0).parameter_bounds
        assert_allclose(bounds["length_scale"][0, 0], [[0.05, 1e3]] * 3)
        assert_allclose(bounds["amplitude"][:2, 0], [[-30.0, 30.0], [0.2, 30.0]])

    @pytest.mark.parametrize(
        ("bounds", "error", "message"),
        [
            ({"amplitud": "fixed"}, ValueError, "'amplitud'.*did you mean amplitude"),
            (
                (0.1, 1.0),
                TypeError,
                r"parameter_bounds=\(0.1, 1.0\), but expected bounds by the name",
            ),
        ],
    )
    def test_of_what_is_no_parameter(self, bounds, error, message, uneven):
        kernel = clone(self.kernel).set_params(parameter_bounds=bounds)
        for use in (
            lambda: kernel.theta,
            lambda: kernel.initialize(uneven[0], uneven[1][:, :2], 0),
        ):
            with pytest.raises(error, match=message):
                use()


class TestSums:
    """What a scikit-learn user would write, and cannot mean."""

    kernel = ConvolvedGaussian(1, amplitude=np.ones((3, 2)), length_scale=np.ones((3, 2, 1)))

    @pytest.mark.parametrize("other", [1, 0.5, "RBF"])
    def test_with_what_is_no_kernel(self, other):
        with pytest.raises(TypeError, match="multi-output kernel"):
            self.kernel + other
        with pytest.raises(TypeError):
            other + self.kernel

    def test_of_kernels_with_different_outputs(self):
        with pytest.raises(ValueError, match=r"outputs|broadcast"):
            (LinearTrend(np.ones(3), np.ones((3, 1)), [0.0]) + self.kernel)(np.zeros((2, 1)))
