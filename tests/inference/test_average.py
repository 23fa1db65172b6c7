"""The average of posteriors: moments and samples of a mixture, and weights by what its members predict."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import softmax

from skdgp import DependentGPRegressor
from skdgp.inference import (
    Data,
    ExactPosterior,
    Posterior,
    SearchOptions,
    average,
    fit_exact,
    fit_sparse,
    held_out,
    search,
    stacked,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend

N, D, P = 60, 2, 2
WEIGHTS = np.array([[0.7, 0.4], [0.3, 0.6]])
AT = default_rng(5).uniform(-2.5, 2.5, (7, D))


def kernel_of_all_terms():
    """Return a trend, processes of each output and processes that outputs share, with given values."""
    kernel = LinearTrend(np.full(P, 0.5), np.full((P, D), 0.4), np.zeros(D))
    for k in range(D):
        widths = np.full((P, P, D), 1.0 + k)
        kernel = kernel + ConvolvedGaussian(0, amplitude=np.diag([0.5, 0.4]), length_scale=widths)
    amplitude = np.array([[0.6, -0.4], [0.3, 0.0], [0.0, 0.3]])
    widths = default_rng(3).uniform(0.8, 1.5, (1 + P, P, D))
    return kernel + ConvolvedGaussian(1, amplitude=amplitude, length_scale=widths)


@pytest.fixture(scope="module")
def data():
    rng = default_rng(0)
    X = rng.uniform(-2, 2, (N, D))
    a, b = X.T
    Y = np.column_stack([np.sin(a + b) + 0.3 * b, a - np.cos(b)])
    Y += rng.normal(0, 0.2, Y.shape)
    Y[rng.random(N) < 0.3, 1] = np.nan
    return X, Y


def fit_of(inference, X, Y, kernel=None):
    kernel = kernel or kernel_of_all_terms()
    (learned,) = search([kernel], X, Y, SearchOptions(optimizer=None, max_iter=5, random_state=0))
    if inference == "sparse":
        return fit_sparse(learned, Data.from_table(X, Y), n_inducing=15)
    return fit_exact(learned, Data.from_table(X, Y))


@pytest.fixture(scope="module", params=["exact", "sparse"])
def fit(request, data):
    return fit_of(request.param, *data)


@pytest.fixture(scope="module")
def mixture(fit, data):
    """An average with weights that differ between outputs."""
    return Posterior(average(fit, *data).posterior.members, WEIGHTS)


class TestMixture:
    def test_members_have_fewer_and_fewer_terms_of_one_kernel(self, mixture):
        """All, and the trend; with the same hyperparameters."""
        kernels = [member.kernel for member in mixture.members]
        terms = kernels[0].summands()
        for kernel, n_terms in zip(kernels, (4, 1), strict=True):
            assert_array_equal(kernel.theta, kernels[0].theta[: kernel.n_dims])
            expected = sum(term(AT) for term in terms[:n_terms])
            assert_allclose(kernel(AT), expected, rtol=1e-12, atol=1e-12)

    def test_moments(self, mixture):
        parts = [member.predict(AT, True) for member in mixture.members]
        means, variances = np.array(parts).swapaxes(0, 1)
        weights = WEIGHTS[:, None]
        mean = np.sum(weights * means, axis=0)
        variance = np.sum(weights * (variances + (means - mean) ** 2), axis=0)
        found = mixture.predict(AT, return_variance=True)
        assert_allclose(found, [mean, variance], rtol=1e-10, atol=1e-12)
        assert_allclose(mixture.predict(AT), mean, rtol=1e-10, atol=1e-12)
        # a single row has a path of its own
        rows = [mixture.predict(x[None]) for x in AT]
        assert_allclose(np.concatenate(rows), mean, rtol=1e-10, atol=1e-12)

    def test_of_equal_weights_for_all_outputs_is_one_mixture(self, mixture):
        """Then all outputs have the same member: the covariance is the weighted sum of whole ones, and of scatter."""
        w = np.array([0.2, 0.8])
        same = Posterior(mixture.members, np.repeat(w[:, None], P, axis=1))
        means = np.array([member.predict(AT).T.ravel() for member in mixture.members])
        off = means - w @ means
        expected = np.einsum("k,ki,kj->ij", w, off, off)
        for weight, member in zip(w, mixture.members, strict=True):
            expected += weight * member.covariance(AT)
        assert_allclose(same.covariance(AT), expected, rtol=1e-9, atol=1e-12)


def test_a_trend_of_weights_is_the_exact_posterior(data):
    """The trend of an exact average needs no factor of all values."""
    fit = average(fit_of("exact", *data), *data)
    trend = fit.posterior.members[-1]
    assert not isinstance(trend, ExactPosterior)
    dense = ExactPosterior(trend.kernel, trend.noise, trend.data)
    assert_allclose(trend.predict(AT, True), dense.predict(AT, True), rtol=1e-6)


def test_a_kernel_without_a_trend_is_no_average(data):
    fit = fit_of("exact", *data, ConvolvedGaussian(1).initialize(*data, 0))
    assert average(fit, *data) is fit


class TestStacking:
    """The weights are the mean of their posterior, with a uniform prior from 0 to 1."""

    @pytest.mark.parametrize("repeats", [1, 25])
    @pytest.mark.parametrize("cost", [0.0, 5.0])
    @pytest.mark.parametrize("scale", [0.05, 0.3, 3.0])
    def test_are_the_posterior_mean(self, scale, cost, repeats):
        """Rows of a time series that repeat count once, and the cost as often as they."""
        rng = default_rng(0)
        difference, noise = rng.normal(size=(2, 40))
        trend = noise + 0.8 * scale * difference
        errors = np.array([trend - scale * difference, trend])
        found = stacked(errors.repeat(repeats, axis=1), repeats * cost, ordered=repeats > 1)
        assert found.sum() == pytest.approx(1.0)

        w = np.linspace(0.0, 1.0, 20001)[:, None]
        slope, *_ = np.linalg.lstsq(scale * difference[:, None], trend, rcond=None)
        variance = np.mean((trend - slope * scale * difference) ** 2)
        squares = np.sum((w * errors[0] + (1 - w) * errors[1]) ** 2, axis=1)
        density = softmax(-squares / (2 * variance) - cost * w[:, 0])
        # the autocorrelation time of repeated rows is found from the rows
        assert found[0] == pytest.approx(density @ w[:, 0], abs=1e-3 if repeats == 1 else 0.05)

    @pytest.mark.parametrize("best", [-50.0, 0.0, 1.0, 50.0])
    def test_without_doubt_one_has_all(self, best):
        difference = default_rng(0).normal(size=50)
        errors = np.array([(best - 1.0) * difference, best * difference])
        assert stacked(errors, 10.0)[0] == pytest.approx(np.clip(best, 0.0, 1.0), abs=1e-5)

    def test_without_rows_the_trend_has_all(self):
        assert_array_equal(stacked(np.empty((2, 0)), 10.0), [0.0, 1.0])


def predictions(fit, X, Y):
    """Return mean and variance of every value, predicted from other blocks."""
    return held_out(fit.posterior.members[0], fit.learned.noise, X, Y)


def changed(Y, row, output):
    Y = Y.copy()
    Y[row, output] += 100.0
    return Y


class TestHeldOut:
    def test_a_value_does_not_predict_itself(self, fit, data):
        X, Y = data
        mean, variance = predictions(fit, X, Y)
        known = np.isfinite(Y)
        assert_array_equal(np.isfinite(mean), known)
        late = np.flatnonzero(known[:, 1])[18]
        for value in [(4, 0), (59, 0), (late, 1)]:
            again, same = predictions(fit, X, changed(Y, *value))
            assert again[value] == pytest.approx(mean[value], rel=1e-9, abs=1e-9)
            assert np.nanmax(np.abs(again - mean)) > 0.01  # others feel it
            assert_allclose(same, variance, rtol=1e-9)
        # the other output of that row feels it, too, as one of them has gaps
        assert abs(again[late, 0] - mean[late, 0]) > 0.01

    def test_between_distant_rows_correlated_errors_count_as_white(self, data):
        """Of every second row, where two neighbours had one error in common."""
        X, Y = data[0][:-1], data[1][:-1]
        fit = fit_of("exact", X, Y)
        posterior, noise = fit.posterior.members[0], fit.learned.noise
        correlated = ExactPosterior(posterior.kernel, 2 * noise, posterior.data)
        every_second = held_out(correlated, noise, X, Y, step=2)
        assert_allclose(every_second, held_out(posterior, noise, X[::2], Y[::2]), rtol=1e-9)


class TestWeights:
    @pytest.mark.parametrize("function", [np.prod, np.sum])
    def test_are_of_the_terms_that_a_function_needs(self, function):
        """A line is none of the two."""
        rng = default_rng(0)
        X = rng.uniform(-2, 2, (150, 2))
        y = function(np.sin(2.5 * X), axis=1) + 0.1 * rng.normal(size=150)
        model = DependentGPRegressor(n_latent=0, input_noise=None, random_state=0, max_iter=30)
        weights = model.fit(X, y, time=np.arange(150.0)).weights_
        assert weights["joint"][0] > 0.85


class TestRegressor:
    def test_noise_is_that_of_the_mixture(self, data):
        model = DependentGPRegressor(n_latent=1, random_state=0, max_iter=10).fit(*data)
        members = np.array([member.noise for member in model.posterior_.members])
        weights = model.posterior_.mixture
        assert_allclose(model.noise_variance_ / model.scale_**2, np.sum(weights * members, axis=0))
