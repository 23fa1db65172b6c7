"""Noise that is known, starts a search, or is bounded, and exact refits with it."""

import numpy as np
import pytest
from made_flights import lasting
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian


@pytest.fixture(scope="module")
def data():
    rng = default_rng(0)
    X = rng.uniform(-3, 3, (60, 1))
    return X, np.sin(2 * X[:, 0]) + 0.01 * rng.normal(size=60)


def varying(X):
    return 0.05 + 0.4 / (1 + np.exp(-3 * X[:, 0]))


@pytest.mark.parametrize("inference", ["exact", "sparse"])
def test_noise_that_is_not_given_is_estimated_for_the_kernel(data, inference):
    options = {
        "structure": "joint",
        "trend": "constant",
        "inference": inference,
        "n_inducing": 40,
        "random_state": 0,
    }
    model = DependentGPRegressor(n_latent=0, **options).fit(*data)
    again = DependentGPRegressor(model.kernel_, optimizer=None, **options).fit(*data)
    # the fit that learned its kernel states more, as variances of few values are too small
    assert_allclose(again.noise_variance_, model.noise_variance_, rtol=0.15)
    gain = again.log_marginal_likelihood_value_ - model.log_marginal_likelihood_value_
    assert -0.01 < gain < 0.3
    assert_allclose(again.predict(data[0]), model.predict(data[0]), atol=1e-3)


@pytest.mark.parametrize("inference", ["exact", "sparse"])
def test_noise_of_each_value_is_the_alpha_of_scikit_learn(inference):
    rng = default_rng(1)
    X = rng.uniform(-3, 3, (100, 1))
    T = np.linspace(-2.5, 2.5, 20)[:, None]
    y = np.sin(2 * X[:, 0]) + varying(X) * rng.normal(size=100)
    kernel = ConvolvedGaussian(0, amplitude=[[1.0]], length_scale=[[[0.8]]])
    model = DependentGPRegressor(
        kernel, structure="joint", trend=None, optimizer=None, inference=inference,
        n_inducing=100, noise_variance=varying(X) ** 2,
    ).fit(X, y)  # fmt: skip
    peer = GaussianProcessRegressor(
        ConstantKernel(1.0) * RBF(0.8), alpha=varying(X) ** 2, optimizer=None
    )
    expected = peer.fit(X, y).predict(T, return_std=True)
    assert_allclose(model.predict(T, return_std=True), expected, atol=1e-4)
    assert model.noise_variance_[0] == pytest.approx(np.mean(varying(X) ** 2))


@pytest.mark.parametrize("inference", ["exact", "sparse"])
def test_lasting_errors_widen_bands_by_noise_of_each_value_as_by_common_noise(inference):
    """One of 300 values that is ten times as precise is nearly no news."""
    rng = default_rng(0)
    X = lasting(rng, (300, 2), 9.5)
    y = X @ [1.0, -0.5] + 0.3 * lasting(rng, 300, 4.5)
    variance = np.full(300, 0.09)
    variance[150] = 0.0009
    stds = []
    for noise in (0.09, variance):
        model = DependentGPRegressor(
            structure="trend", input_noise=None, inference=inference, noise_variance=noise
        ).fit(X, y, time=np.arange(300.0))
        stds.append(model.predict(X[:5], return_std=True)[1])
    assert_allclose(stds[1], stds[0], rtol=0.1)


@pytest.mark.parametrize("log", [False, True])
def test_bounds_hold_a_learned_variance(data, log):
    X, y = data
    time = {"time": np.arange(60.0)} if log else {}
    model = DependentGPRegressor(
        noise_variance=0.01, noise_variance_bounds=(0.005, 0.02), random_state=0
    ).fit(X, y, **time)
    assert 0.005 <= model.noise_variance_[0] <= 0.02


def test_known_noise_of_regressors_is_kept(data):
    X, y = data
    time = np.arange(60.0)
    options = {"structure": "joint", "max_iter": 15, "random_state": 0}
    model, exact, none = (
        DependentGPRegressor(input_noise=std, **options).fit(X, y, time=time)
        for std in ([0.03], [0.0], None)
    )
    assert_allclose(model.input_covariance_, [[0.03**2]])
    assert_allclose(exact.predict(X), none.predict(X), atol=2e-3)


def test_outputs_with_gaps_have_noise_of_their_own(data):
    X, y = data
    Y = np.column_stack([y, -y])
    Y[::3, 0] = np.nan
    variance = np.column_stack([np.full(60, 1e-4), 1e-4 * (1 + np.arange(60))])
    model = DependentGPRegressor(noise_variance=variance, random_state=0, max_iter=5).fit(X, Y)
    assert_allclose(model.noise_variance_, [1e-4, variance[:, 1].mean()])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise_variance": [1.0, 2.0, 3.0]}, r"Got noise_variance of shape \(3,\), but expected"),
        ({"noise_variance": np.zeros(60)}, "not positive and finite"),
        ({"noise_variance_bounds": (2.0, 1.0)}, "0 < lower <= upper"),
        ({"noise_variance_bounds": (0.0, 1.0)}, "0 < lower <= upper"),
        ({"noise_variance": np.ones(60), "noise_variance_bounds": (0.1, 1.0)}, "one of them"),
        ({"noise_variance": np.ones(60), "input_noise": "learned"}, "one of them"),
        ({"input_noise": [0.1, 0.2]}, "for each of the 1 regressors"),
        ({"input_noise": [-0.1]}, "at least zero"),
        ({"input_noise": "learned", "optimizer": None}, "learns nothing"),
    ],
)
def test_bad_noise_is_refused(data, options, message):
    with pytest.raises(ValueError, match=message):
        DependentGPRegressor(**options).fit(*data)
