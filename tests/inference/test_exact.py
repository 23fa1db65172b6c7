"""Equations 17 to 20 against references typed from them."""

import tracemalloc

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal
from threadpoolctl import threadpool_limits

from skdgp._compute import parallel
from skdgp.inference import (
    Data,
    ExactPosterior,
    PosteriorSettings,
    SinglePosterior,
    TileSettings,
    log_likelihood,
)
from skdgp.kernels import ConvolvedGaussian, LinearTrend

NEW = default_rng(5).normal(size=(6, 2))


def at(problem, theta):
    """The likelihood as a function of [theta, log noise]."""
    n = problem.kernel.n_dims
    return log_likelihood(
        problem.kernel.clone_with_theta(theta[:n]), np.exp(theta[n:]), problem.data
    )


def posterior_of(problem):
    return ExactPosterior(problem.kernel, problem.noise, problem.data)


def cross(problem, Xs):
    """Covariance of all outputs at Xs, output-major, with the observed values."""
    return problem.kernel([Xs] * problem.kernel.n_outputs, problem.data.X)


class TestLikelihood:
    def test_is_the_density_of_the_observed_values(self, problem):
        expected = multivariate_normal(cov=problem.K).logpdf(problem.y)
        assert log_likelihood(problem.kernel, problem.noise, problem.data) == pytest.approx(
            expected, rel=1e-10
        )
        assert posterior_of(problem).log_marginal_likelihood == pytest.approx(expected, rel=1e-10)

    def test_gradient(self, problem, assert_gradient):
        value, gradient = log_likelihood(
            problem.kernel, problem.noise, problem.data, eval_gradient=True
        )
        theta = np.concatenate([problem.kernel.theta, np.log(problem.noise)])
        assert value == pytest.approx(at(problem, theta))
        assert_gradient(gradient, lambda t: at(problem, t), theta, rtol=1e-7, atol=1e-7)

    @pytest.mark.parametrize("silent", [0, 1, 2])
    def test_an_output_without_values_has_no_gradient_by_its_noise(self, one_problem, silent):
        X = [x[:0] if i == silent else x for i, x in enumerate(one_problem.data.X)]
        y = [v[:0] if i == silent else v for i, v in enumerate(one_problem.data.y)]
        everything = log_likelihood(
            one_problem.kernel, one_problem.noise, one_problem.data, eval_gradient=True
        )[1]
        _, gradient = log_likelihood(
            one_problem.kernel, one_problem.noise, Data(X, y), eval_gradient=True
        )
        assert (gradient[-3:] == 0).tolist() == [i == silent for i in range(3)]
        assert np.isfinite(gradient).all()
        assert everything[-3:].all()

    def test_of_outputs_that_are_not_coupled_adds_up(self, one_problem):
        rng = default_rng(7)
        kernel = LinearTrend(np.ones(3), np.ones((3, 2)), np.zeros(2)) + ConvolvedGaussian(
            0, amplitude=np.diag([0.5, 1.0, 2.0]), length_scale=rng.uniform(0.5, 1.5, (3, 3, 2))
        )
        Y = one_problem.Y.copy()
        Y[:, 1] = np.nan  # an output without values
        data = Data.from_table(one_problem.X, Y)
        expected = log_likelihood(kernel, one_problem.noise, data, eval_gradient=True)
        parts = [
            log_likelihood(kernel, one_problem.noise, part, eval_gradient=True)
            for part in data.by_output()
        ]
        assert len(parts) == 2
        assert sum(value for value, _ in parts) == pytest.approx(expected[0], rel=1e-10)
        assert_allclose(sum(slope for _, slope in parts), expected[1], rtol=1e-8, atol=1e-10)


class TestPosterior:
    def test_mean_is_equation_17(self, problem):
        expected = cross(problem, NEW) @ np.linalg.solve(problem.K, problem.y)
        assert_allclose(
            posterior_of(problem).predict(NEW), expected.reshape(-1, len(NEW)).T, rtol=1e-9
        )

    def test_covariance_is_equation_18(self, problem):
        Ks = cross(problem, NEW)
        expected = problem.kernel(NEW) - Ks @ np.linalg.solve(problem.K, Ks.T)
        posterior = posterior_of(problem)
        assert_allclose(posterior.covariance(NEW), expected, rtol=1e-8, atol=1e-10)
        mean, variance = posterior.predict(NEW, return_variance=True)
        assert_allclose(variance, np.diag(expected).reshape(-1, len(NEW)).T, rtol=1e-8)
        assert_allclose(mean, posterior.predict(NEW), rtol=1e-12)


class TestTrendIntegratedOut:
    """Rasmussen & Williams (2006), equations 2.41 to 2.43 with a prior N(0, B) on the weights."""

    @pytest.fixture
    def parts(self, one_problem):
        trend, dependent = one_problem.kernel.k1, one_problem.kernel.k2

        def basis(arrays):
            """Stacked design matrix of all outputs, block-diagonal."""
            designs = [np.column_stack([np.ones(len(x)), x - trend.center]) for x in arrays]
            width = designs[0].shape[1]
            out = np.zeros((sum(map(len, arrays)), 3 * width))
            row = 0
            for i, design in enumerate(designs):
                out[row : row + len(design), i * width : (i + 1) * width] = design
                row += len(design)
            return out

        B = np.diag(np.column_stack([trend.intercept_scale, trend.slope_scale]).ravel() ** 2)
        sizes = [len(y) for y in one_problem.data.y]
        Ky = dependent(one_problem.data.X) + np.diag(np.repeat(one_problem.noise, sizes))
        H = basis(one_problem.data.X)
        precision = np.linalg.inv(B) + H.T @ np.linalg.solve(Ky, H)
        return dependent, basis, B, Ky, H, precision

    def test_prediction(self, one_problem, parts):
        dependent, basis, _, Ky, H, precision = parts
        y = one_problem.y
        weights = np.linalg.solve(precision, H.T @ np.linalg.solve(Ky, y))
        Ks = dependent([NEW] * 3, one_problem.data.X)
        R = basis([NEW] * 3) - Ks @ np.linalg.solve(Ky, H)
        mean = Ks @ np.linalg.solve(Ky, y) + R @ weights
        cov = dependent(NEW) - Ks @ np.linalg.solve(Ky, Ks.T) + R @ np.linalg.solve(precision, R.T)
        posterior = posterior_of(one_problem)
        assert_allclose(posterior.predict(NEW), mean.reshape(3, -1).T, rtol=1e-8)
        assert_allclose(posterior.covariance(NEW), cov, rtol=1e-8, atol=1e-9)

    def test_likelihood(self, one_problem, parts):
        _, _, B, Ky, H, _ = parts
        expected = multivariate_normal(cov=Ky + H @ B @ H.T).logpdf(one_problem.y)
        assert posterior_of(one_problem).log_marginal_likelihood == pytest.approx(expected)


class TestTiles:
    """How the matrix is cut is nobody's business."""

    @pytest.mark.parametrize(("tile", "threads"), [(1, 2), (3, 1)])
    def test_do_not_change_the_results(self, problem, tile, threads, monkeypatch):
        value, gradient = log_likelihood(
            problem.kernel, problem.noise, problem.data, eval_gradient=True
        )
        posterior = posterior_of(problem)
        expected = (
            posterior.predict(NEW, True),
            posterior.covariance(NEW),
            posterior.gradient(NEW),
        )
        monkeypatch.setattr(SinglePosterior, "settings", PosteriorSettings(chunk_bytes=100))
        monkeypatch.setattr(parallel, "SMALL", 0)
        with threadpool_limits(threads, user_api="blas"):
            tiles = TileSettings(tile, 2)
            again, again_gradient = log_likelihood(
                problem.kernel, problem.noise, problem.data, eval_gradient=True, tiles=tiles
            )
            one_value = log_likelihood(problem.kernel, problem.noise, problem.data, tiles=tiles)
            posterior = posterior_of(problem)
            got = (
                posterior.predict(NEW, True),
                posterior.covariance(NEW),
                posterior.gradient(NEW),
            )
        assert again == pytest.approx(value, rel=1e-12)
        assert one_value == pytest.approx(value, rel=1e-12)
        assert_allclose(again_gradient, gradient, rtol=1e-9, atol=1e-10)
        for a, b in zip((*got[0], *got[1:]), (*expected[0], *expected[1:]), strict=True):
            assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def peak_memory(function):
    """Bytes that NumPy held at most while the function ran."""
    tracemalloc.start()
    try:
        function()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def large():
    rng = default_rng(0)
    X, Y = rng.normal(size=(500, 4)), rng.normal(size=(500, 3))
    kernel = LinearTrend() + ConvolvedGaussian(1)
    return kernel.initialize(X, Y, 0), np.full(3, 0.3), Data.from_table(X, Y)


class TestMemory:
    def test_of_one_evaluation_is_below_three_matrices(self, large):
        matrix = 8 * large[2].n_values ** 2
        used = peak_memory(lambda: log_likelihood(*large, eval_gradient=True))
        assert matrix <= used < 3 * matrix

    def test_of_predictions_does_not_grow_with_their_number(self, large, monkeypatch):
        settings = PosteriorSettings(chunk_bytes=2**19)
        monkeypatch.setattr(SinglePosterior, "settings", settings)
        kernel, noise, data = large
        few_data = Data([x[:80] for x in data.X], [y[:80] for y in data.y])
        posterior = ExactPosterior(kernel, noise, few_data)
        posterior.predict(np.zeros((2, 4)), True)
        few, many = np.zeros((300, 4)), np.zeros((3000, 4))
        results = 2 * 8 * 3 * 2700
        calls = (lambda X: posterior.predict(X, True), 1), (posterior.gradient, 4)
        for call, times in calls:
            grown = peak_memory(lambda call=call: call(many)) - peak_memory(
                lambda call=call: call(few)
            )
            assert (
                grown < 2 * times * results + settings.chunk_bytes
            )  # which threads need not hold at the same time
