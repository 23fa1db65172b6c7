"""Noise that drifts: neighbours in time err alike, within a flight."""

import pickle

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp.inference import (
    Data,
    ExactPosterior,
    SparsePosterior,
    _rows,
    compact,
    log_likelihood,
    residual_drift,
    shares_of,
)

VARIANCE, MEMORY = np.array([0.5, 0.2, 1.0]), np.array([0.1, 0.5, 2.0])
NEW = np.random.default_rng(9).normal(size=(6, 2))


@pytest.fixture
def clock(one_problem):
    """Irregular times in two flights."""
    n = len(one_problem.X)
    return np.column_stack([np.sort(np.random.default_rng(3).uniform(0, 3, n)), np.arange(n) >= n // 2])


@pytest.fixture(params=["outputs apart", "regressors noisy"])
def data(request, one_problem, clock):
    loading = None
    if request.param == "regressors noisy":
        loading = np.random.default_rng(4).normal(0, 0.3, (*one_problem.Y.shape, 2))
    return Data.from_table(one_problem.X, one_problem.Y, loading, clock, (VARIANCE, MEMORY))


def noise_covariance(noise, data):
    """The covariance of the noise of the stacked values, entry by entry from its definition."""
    values = [(i, k) for i, y in enumerate(data.y) for k in range(len(y))]
    C = np.zeros((len(values),) * 2)
    for a, (i, k) in enumerate(values):
        for b, (j, m) in enumerate(values):
            (t, flight), (u, other) = data.drift.clock[i][k], data.drift.clock[j][m]
            if i == j and flight == other:
                C[a, b] += VARIANCE[i] * np.exp(-abs(t - u) / MEMORY[i])
            C[a, b] += noise[i] * (a == b)
            if data.sample_noise is not None and data.sample_noise.sample[i][k] == data.sample_noise.sample[j][m]:
                C[a, b] += data.sample_noise.loading[i][k] @ data.sample_noise.loading[j][m]
    return C


def test_the_likelihood_is_that_of_the_joint_normal(one_problem, data):
    K = one_problem.kernel(data.X) + noise_covariance(one_problem.noise, data)
    expected = multivariate_normal(cov=K).logpdf(np.concatenate(data.y))
    posterior = ExactPosterior(one_problem.kernel, one_problem.noise, data)
    np.testing.assert_allclose(posterior.log_marginal_likelihood, expected, rtol=1e-10)


def test_gradient_by_variance_and_memory(one_problem, data, assert_gradient):
    free = data._replace(drift=data.drift._replace(variance=None, memory=None))
    noise = np.concatenate([one_problem.noise, VARIANCE, MEMORY])

    def at(log_noise):
        return log_likelihood(one_problem.kernel, np.exp(log_noise), free)

    value, gradient = log_likelihood(one_problem.kernel, noise, free, eval_gradient=True)
    np.testing.assert_allclose(value, log_likelihood(one_problem.kernel, one_problem.noise, data), rtol=1e-12)
    assert_gradient(gradient[one_problem.kernel.n_dims :], at, np.log(noise), rtol=1e-7, atol=1e-7)


def test_sparse_sums_are_exact_where_features_are(one_problem, data):
    """The weights of a trend leave nothing out, so the sums by recursion must equal the dense solution."""
    trend = one_problem.kernel.k1
    exact = ExactPosterior(trend, one_problem.noise, data)
    sparse = SparsePosterior(trend, trend.features(None), one_problem.noise, shares_of(data))
    np.testing.assert_allclose(sparse.log_marginal_likelihood, exact.log_marginal_likelihood, rtol=1e-9)
    for found, expected in zip(sparse.predict(NEW, True), exact.predict(NEW, True), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)


def test_the_bound_is_one(one_problem, data):
    kernel = one_problem.kernel
    exact = ExactPosterior(kernel, one_problem.noise, data).log_marginal_likelihood
    for n in (2, 5, len(one_problem.X)):
        features = kernel.features(one_problem.X[:n])
        sparse = SparsePosterior(kernel, features, one_problem.noise, shares_of(data))
        assert sparse.log_marginal_likelihood < exact


@pytest.mark.parametrize("kind", ["exact", "sparse"])
def test_later_samples_of_other_flights_change_nothing_else(one_problem, clock, kind):
    kernel, noise = one_problem.kernel, one_problem.noise
    first = clock[:, 1] == 0

    def data_of(rows):
        return Data.from_table(one_problem.X[rows], one_problem.Y[rows], None, clock[rows], (VARIANCE, MEMORY))

    def make(data):
        if kind == "exact":
            return ExactPosterior(kernel, noise, data)
        return SparsePosterior(kernel, kernel.features(one_problem.X), noise, shares_of(data))

    grown = pickle.loads(pickle.dumps(make(data_of(first)))).updated(data_of(~first))
    whole = make(data_of(slice(None)))
    for found, expected in zip(grown.predict(NEW, True), whole.predict(NEW, True), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(grown.log_marginal_likelihood, whole.log_marginal_likelihood, rtol=1e-7)


def test_compacting_keeps_what_was_known(one_problem, data):
    posterior = ExactPosterior(one_problem.kernel, one_problem.noise, data)
    small, change = compact(posterior, 400, None, 1, 0, lambda size: None)
    assert change.change < 0.01
    np.testing.assert_allclose(small.predict(NEW), posterior.predict(NEW), atol=0.02)


def ornstein_uhlenbeck(rng, n, step, memory, variance):
    """n values of a process with the covariance variance * exp(-|t - t'| / memory), ``step`` apart."""
    rho = np.exp(-step / memory)
    values = rng.normal(0, np.sqrt(variance), n)
    for k in range(1, n):
        values[k] = rho * values[k - 1] + np.sqrt(1 - rho**2) * values[k]
    return values


def integral_variance(variance, memory, time):
    """Variance of the integral of such a process, by quadrature of its covariance."""
    times = np.linspace(0, time, 801)
    return time**2 * np.mean(variance * np.exp(-np.abs(np.subtract.outer(times, times)) / memory))


class TestResiduals:
    """The default: the fit is that of white noise, and its residuals show the drift."""

    step, memory, tau2, sigma2 = 0.05, 0.5, 0.09, 0.01

    @pytest.fixture
    def log(self):
        """Four flights, each with its own clock from zero and its own drift."""
        rng = np.random.default_rng(5)
        time = np.tile(self.step * np.arange(300), 4)
        x = np.sin(2 * np.pi * 0.1 * time + np.repeat([0, 1, 2, 3], 300)) + 0.1 * rng.normal(size=1200)
        drift = [ornstein_uhlenbeck(rng, 300, self.step, self.memory, self.tau2) for _ in range(4)]
        Y = 2 * x + np.concatenate(drift) + rng.normal(0, np.sqrt(self.sigma2), 1200)
        Y = np.column_stack([Y, rng.normal(0, 0.3, 1200) - x])  # the second output has white noise
        return x[:, None], Y, time, np.repeat(["a", "b", "c", "d"], 300)

    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_show_tau_and_T_and_change_nothing_else(self, log, inference):
        X, Y, time, flight = log
        Y = Y.copy()
        Y[:400:2, 0] = np.nan
        Y[600:, 0][::3] = np.nan
        if inference == "exact":
            Y[::2, 1] = np.nan
            Y[1::4, 1] = np.nan
        model = DependentGPRegressor(structure="trend", inference=inference, n_inducing=10, random_state=0)
        white = clone(model).fit(X, Y)
        model.fit(X, Y, time=time, flight=flight)
        assert model.drift_variance_[0] == pytest.approx(self.tau2, rel=0.3)
        for horizon in (0.5, 2.0, 5.0):  # what a simulated flight integrates
            found = integral_variance(model.drift_variance_[0], model.drift_memory_[0], horizon)
            assert found == pytest.approx(integral_variance(self.tau2, self.memory, horizon), rel=0.4)
        after_a_second = model.drift_variance_ * np.exp(-1.0 / model.drift_memory_)
        assert after_a_second[1] < 0.05 * 0.3**2
        for found, expected in zip(*(m.posterior_.predict(X[:9], True) for m in (model, white)), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(model.noise_variance_ + model.misfit_variance_, white.noise_variance_)
        np.testing.assert_array_equal(white.drift_variance_, 0.0)

    def test_flights_are_independent(self, log):
        """Any order of the flights has the same likelihood."""
        _, Y, time, _ = log
        Y, flight = Y - Y.mean(axis=0), np.repeat(np.arange(4), 300)
        orders = [np.concatenate([np.arange(300) + 300 * k for k in order]) for order in ([0, 1, 2, 3], [2, 0, 3, 1])]
        first, second = (
            residual_drift(Nothing(), Y[rows], Y[rows], np.column_stack([time[rows], flight[rows]])) for rows in orders
        )
        np.testing.assert_allclose(first, second, rtol=1e-3)  # the optimiser stops there

    def test_the_end_of_a_flight_tells_nothing_of_the_next(self):
        """Errors that only change from flight to flight last as long as a flight can show."""
        offset, white = np.random.default_rng(0).choice([-1.0, 1.0], 40), np.random.default_rng(1).normal(0, 0.1, 800)
        Y, time = (np.repeat(offset, 20) + white)[:, None], 0.1 * np.arange(800)
        apart = residual_drift(Nothing(), Y, Y, np.column_stack([time, np.repeat(np.arange(40), 20)]))
        assert apart[2, 0] == pytest.approx(1.9, rel=0.01)

    def test_rows_in_any_order_and_of_one_time(self):
        rng = np.random.default_rng(3)
        Y = ornstein_uhlenbeck(rng, 400, 0.05, 0.5, 0.09)[:, None]
        clock, mixed = np.column_stack([0.05 * np.arange(400), np.zeros(400)]), rng.permutation(400)
        expected = residual_drift(Nothing(), Y, Y, clock)
        np.testing.assert_allclose(
            residual_drift(Nothing(), Y[mixed], Y[mixed], clock[mixed]), expected, rtol=1e-6, atol=1e-9
        )
        twice = np.repeat(np.arange(400), 2)
        found = residual_drift(Nothing(), Y[twice], Y[twice], clock[twice])
        np.testing.assert_allclose(found[1:], expected[1:], rtol=0.1)

    @pytest.mark.parametrize("flight", [np.arange(60), np.arange(60) // 2], ids=["alone", "in pairs"])
    def test_rows_that_show_no_drift_have_none(self, flight):
        Y = np.random.default_rng(0).normal(size=(60, 1))
        white, variance, _ = residual_drift(Nothing(), Y, Y, np.column_stack([0.1 * np.arange(60), flight]))
        assert white == pytest.approx(np.mean(Y**2))
        assert variance < 1e-6 * white


class Nothing:
    """A posterior whose mean is zero."""

    def predict(self, X):
        return np.zeros_like(X)


class TestRegressor:
    """A straight line under noise that drifts: what its slope is known to is a textbook formula."""

    n, step, memory, tau2, sigma2 = 4000, 0.05, 0.5, 0.09, 0.01

    @pytest.fixture
    def line(self):
        rng = np.random.default_rng(1)
        time = self.step * np.arange(self.n)
        x = np.sin(2 * np.pi * 0.1 * time) + 0.3 * np.sin(2 * np.pi * 0.23 * time + 1)
        drift = ornstein_uhlenbeck(rng, self.n, self.step, self.memory, self.tau2)
        y = 2 * x + drift + rng.normal(0, np.sqrt(self.sigma2), self.n)
        return time, x[:, None], y

    @pytest.fixture(autouse=True)
    def _few_values_to_learn_from(self, monkeypatch):
        monkeypatch.setattr(_rows, "SEARCH_VALUES", 500)

    def truth(self, time, x):
        """The standard deviation of the slope by generalised least squares with the true covariance."""
        apart = np.abs(np.subtract.outer(time, time))
        N = self.tau2 * np.exp(-apart / self.memory) + self.sigma2 * np.eye(len(time))
        A = np.column_stack([np.ones(len(time)), x])
        return np.sqrt(np.linalg.inv(A.T @ np.linalg.solve(N, A))[1, 1])

    def model(self, **options):
        return DependentGPRegressor(structure="trend", drift="likelihood", random_state=0, **options)

    def test_the_band_of_a_slope_is_right(self, line):
        time, x, y = line
        model = self.model(inference="sparse").fit(x, y, time=time)
        slope, std = model.predict_gradient(x[:1], return_std=True)
        truth = self.truth(time, x[:, 0])
        assert std[0, 0] == pytest.approx(truth, rel=0.05)
        assert abs(slope[0, 0] - 2) < 3 * truth
        assert model.drift_memory_[0] == pytest.approx(self.memory, rel=0.25)
        assert model.drift_variance_[0] == pytest.approx(self.tau2, rel=0.25)
        assert model.noise_variance_[0] == pytest.approx(self.tau2 + self.sigma2, rel=0.2)

    def test_white_noise_would_claim_too_much(self, line):
        """By the factor that the spectrum of the drift has over its mean, at the frequencies of the regressor."""
        time, x, y = line
        model = self.model(inference="exact").fit(x[::4], y[::4])  # exact inference counts every sample as new
        _, std = model.predict_gradient(x[:1], return_std=True)
        white = np.sqrt((self.tau2 + self.sigma2) / len(y[::4])) / x.std()
        assert std[0, 0] == pytest.approx(white, rel=0.1)
        assert self.truth(time, x[:, 0]) > 1.5 * std[0, 0]

    def test_white_residuals_change_nothing(self, line):
        time, x, _ = line
        y = 2 * x[:, 0] + np.random.default_rng(2).normal(0, 0.3, self.n)
        white, timed = self.model(inference="sparse").fit(x, y), self.model(inference="sparse").fit(x, y, time=time)
        _, expected = white.predict_gradient(x[:1], return_std=True)
        _, std = timed.predict_gradient(x[:1], return_std=True)
        np.testing.assert_allclose(timed.predict(x[:50]), white.predict(x[:50]), atol=0.02 * expected[0, 0])
        assert std[0, 0] == pytest.approx(expected[0, 0], rel=0.05)

    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_after_the_fit(self, line, inference):
        time, x, y = line
        rows, later = slice(0, 300), slice(300, 360)
        model = DependentGPRegressor(n_latent=0, inference=inference, n_inducing=10, max_iter=10, random_state=0)
        model.fit(x[rows], y[rows], time=time[rows], flight=np.arange(300) // 100)
        paths = model.sample_paths(200)(x[:5])
        mean, std = model.predict(x[:5], return_std=True)
        assert (np.abs(paths.mean(axis=0) - mean) < 5 * std / np.sqrt(200)).all()
        again = pickle.loads(pickle.dumps(model))
        np.testing.assert_allclose(again.predict(x[:5]), mean, rtol=1e-8)
        model.partial_fit(x[later], y[later], time=time[later])
        assert (model.predict(x[:5], return_std=True)[1] <= std * (1 + 1e-9)).all()
        model.partial_fit(x[400:402], y[400:402])
        assert np.isfinite(model.log_marginal_likelihood(model.theta_))

    def test_rows_must_say_when_they_were(self, line):
        time, x, y = line
        with pytest.raises(ValueError, match="flight without time"):
            self.model().fit(x[:50], y[:50], flight=np.zeros(50))
        with pytest.raises(ValueError, match=r"\(49,\).*\(50,\)"):
            self.model().fit(x[:50], y[:50], time=time[:49])
        with pytest.raises(ValueError, match="2 rows without a flight"):
            self.model().fit(x[:50], y[:50], time=time[:50], flight=["a"] * 48 + [None, None])
        with pytest.raises(ValueError, match="NaN"):
            self.model().fit(x[:50], y[:50], time=np.full(50, np.nan))
        with pytest.raises(ValueError, match=r"datetime64.*expected seconds"):
            self.model().fit(x[:50], y[:50], time=np.datetime64("2026-01-01", "ms") + np.arange(50))
