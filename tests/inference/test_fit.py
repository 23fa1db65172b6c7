"""From data to hyperparameters."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.inference import (
    Data,
    ExactPosterior,
    SearchOptions,
    blocks_of_rows,
    fit_exact,
    fit_sparse,
    log_likelihood,
    search,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend

OPTIONS = {"optimizer": "fmin_l_bfgs_b", "max_iter": 200, "random_state": 0}


def exact(kernel, X, Y, **options):
    (learned,) = search([kernel], X, Y, SearchOptions(**options))
    return fit_exact(learned, Data.from_table(X, Y))


def sparse(kernel, X, Y, **options):
    (learned,) = search([kernel], X, Y, SearchOptions(**options))
    return fit_sparse(learned, Data.from_table(X, Y), n_inducing=40)


FITS = {"exact": exact, "sparse": sparse}


@pytest.fixture(scope="module")
def drawn():
    """Two dependent outputs drawn from a known prior: length scale .8, noise variances .01 and .09."""
    rng = default_rng(1)
    X = np.sort(rng.uniform(-9, 9, (110, 1)), axis=0)
    amplitude = [[1.0, -0.9], [0.3, 0], [0, 0.3]]
    kernel = ConvolvedGaussian(1, amplitude=amplitude, length_scale=np.full((3, 2, 1), 0.8))
    noise = np.array([0.01, 0.09])
    K = kernel(X) + np.diag(np.repeat(noise, 110))
    Y = (np.linalg.cholesky(K) @ rng.normal(size=220)).reshape(2, 110).T
    Y[rng.random(Y.shape) < 0.2] = np.nan
    return X, Y, kernel, noise


@pytest.fixture(scope="module", params=FITS)
def fit(request, drawn):
    """Return a function of a kernel: its fit to the drawn data."""

    def fitted(kernel, every=1, **options):
        X, Y, *_ = drawn
        return FITS[request.param](kernel, X[::every], Y[::every], **OPTIONS | options)

    return fitted


@pytest.fixture(scope="module")
def found(fit):
    return fit(ConvolvedGaussian(1)).posterior


class TestFit:
    def test_is_better_than_the_truth_that_drew_the_data(self, found, drawn):
        """More hyperparameters than the truth has: the maximum is above it. The bound may lie a little below."""
        X, Y, kernel, noise = drawn
        truth = log_likelihood(kernel, noise, Data.from_table(X, Y))
        below = 0.0 if isinstance(found, ExactPosterior) else 1.0
        assert found.log_marginal_likelihood > truth - below

    def test_recovers_noise_and_coupling(self, found, drawn):
        assert_allclose(found.noise, drawn[-1], rtol=0.5)
        K = found.kernel(np.zeros((1, 1)))
        assert K[0, 1] / np.sqrt(K[0, 0] * K[1, 1]) < -0.7


class TestGivenKernel:
    """What a user says of a kernel holds."""

    lengths = np.array([[[0.7], [0.9]], [[0.6], [1.0]], [[1.0], [0.8]]])
    amplitude = np.array([[1.0, -0.7], [0.4, 0.0], [0.0, 0.5]])

    def test_fixed_values_stay(self, fit):
        scales = {"intercept_scale": "fixed", "slope_scale": "fixed"}
        trend = LinearTrend([1.0, 2.0], [[0.5], [0.6]], [0.0], parameter_bounds=scales)
        widths = {"length_scale": "fixed"}
        process = ConvolvedGaussian(1, length_scale=self.lengths, parameter_bounds=widths)
        found = fit(trend + process, max_iter=5).posterior.kernel
        assert_array_equal(found.k1.intercept_scale, [1.0, 2.0])
        assert_array_equal(found.k1.slope_scale, [[0.5], [0.6]])
        assert_allclose(found.k2.length_scale, self.lengths, rtol=1e-9, atol=1e-10)


class TestRows:
    """Rows that a search learns from."""

    def test_of_many_are_some_from_everywhere_with_neighbours(self):
        X = default_rng(0).uniform(size=(20_000, 1))
        (rows,) = blocks_of_rows(X, X)
        assert 1400 <= len(rows) <= 1500
        assert np.diff(np.sort(X[rows, 0])).max() < 0.2
        assert np.median(np.diff(np.sort(X[rows, 0]))) < 3 / 20_000

    @pytest.mark.parametrize("n", [800, 1501, 2999, 6001])
    def test_more_rows_are_not_fewer(self, n):
        X = default_rng(0).normal(size=(n, 2))
        (rows,) = blocks_of_rows(X, X[:, :1])
        assert len(rows) >= 0.95 * min(n, 1500)

    @pytest.mark.parametrize("signs", [[1, 1, 1], [1, -1, -1]])
    def test_the_order_of_rows_and_signs_of_regressors_do_not_matter(self, signs):
        X = default_rng(0).normal(size=(2000, 3))
        order = default_rng(1).permutation(2000)
        (rows,) = blocks_of_rows(X, X[:, :2])
        (shuffled,) = blocks_of_rows(signs * X[order], X[order, :2])
        assert_array_equal(np.sort(order[shuffled]), rows)

    def test_of_a_time_series_are_evenly_spaced_in_three_blocks_of_a_thousand_values(self):
        Y = np.zeros((5000, 2))
        blocks = blocks_of_rows(Y, Y, time_series=True)
        assert len(np.unique(np.concatenate(blocks))) == 1500
        for rows in blocks:
            assert_array_equal(np.diff(rows), 10)


def test_gradient_vanishes_at_the_end_or_points_out_of_the_bounds(drawn):
    X, Y, *_ = drawn
    kernel = ConvolvedGaussian(1, covariance_type="tied")
    fitted = exact(kernel, X, Y, **OPTIONS)
    found = fitted.posterior
    end = log_likelihood(found.kernel, found.noise, found.data, eval_gradient=True)
    of_errors = end.gradient / np.sqrt(np.diag(end.information) + 1.0)
    theta, (low, high) = found.kernel.theta, found.kernel.bounds.T
    inside = (theta > low + 1e-6) & (theta < high - 1e-6)
    assert fitted.learned.converged
    assert np.abs(of_errors[: len(theta)][inside]).max() < 2e-3


def test_restarts_find_a_higher_maximum_and_never_a_lower_one():
    """From a start that explains everything as noise the likelihood has no way up."""
    x = np.linspace(0, 6, 60)[:, None]
    y = np.sin(8 * x) + 0.05 * default_rng(0).normal(size=x.shape)
    kernel = ConvolvedGaussian(0, amplitude=[[1e-3]], length_scale=[[[50.0]]])
    likelihoods = []
    for n_restarts in (0, 3, 10):
        options = SearchOptions(n_restarts=n_restarts, **OPTIONS)
        likelihoods.append(search([kernel], x, y, options)[0].log_likelihood)
    assert likelihoods[0] <= likelihoods[1] <= likelihoods[2]
    assert likelihoods[2] > likelihoods[0] + 50.0
