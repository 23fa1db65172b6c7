"""The drift of errors along a flight, as residuals show it: neighbours in time err alike."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp.inference import residual_drift


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
    """The fit is that of white noise, and its residuals show the drift."""

    step, memory, tau2, sigma2 = 0.05, 0.5, 0.09, 0.01

    @pytest.fixture
    def log(self):
        """Four flights, each with its own clock from zero and its own drift."""
        rng = default_rng(5)
        time = np.tile(self.step * np.arange(300), 4)
        x = np.sin(2 * np.pi * 0.1 * time + np.repeat([0, 1, 2, 3], 300)) + 0.1 * rng.normal(
            size=1200
        )
        drift = [ornstein_uhlenbeck(rng, 300, self.step, self.memory, self.tau2) for _ in range(4)]
        Y = 2 * x + np.concatenate(drift) + rng.normal(0, np.sqrt(self.sigma2), 1200)
        Y = np.column_stack([Y, rng.normal(0, 0.3, 1200) - x])  # the second output has white noise
        return x[:, None], Y, time, np.repeat(["a", "b", "c", "d"], 300)

    @pytest.mark.parametrize("inference", ["exact", "sparse"])
    def test_show_tau_and_T_and_change_nothing_else(self, log, inference):
        """Another clock has another drift, and the same posterior."""
        X, Y, time, flight = log
        Y = Y.copy()
        Y[:400:2, 0] = np.nan
        Y[600:, 0][::3] = np.nan
        if inference == "exact":
            Y[::2, 1] = np.nan
            Y[1::4, 1] = np.nan
        model = DependentGPRegressor(
            structure="trend", inference=inference, n_inducing=10, random_state=0
        )
        other = clone(model).fit(X, Y, time=np.arange(len(X)))
        model.fit(X, Y, time=time, flight=flight)
        assert model.drift_variance_[0] == pytest.approx(self.tau2, rel=0.3)
        for horizon in (0.5, 2.0, 5.0):  # what a simulated flight integrates
            found = integral_variance(model.drift_variance_[0], model.drift_memory_[0], horizon)
            assert found == pytest.approx(
                integral_variance(self.tau2, self.memory, horizon), rel=0.4
            )
        after_a_second = model.drift_variance_ * np.exp(-1.0 / model.drift_memory_)
        assert after_a_second[1] < 0.05 * 0.3**2
        for found, expected in zip(
            *(m.posterior_.posterior.predict(X[:9], True) for m in (model, other)), strict=True
        ):
            assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
        totals = [m.noise_variance_ + m.misfit_variance_ for m in (model, other)]
        assert_allclose(*totals, rtol=1e-6)
        assert_array_equal(clone(model).set_params(max_iter=1).fit(X, Y).drift_variance_, 0.0)

    def test_flights_are_independent(self, log):
        """Any order of the flights has the same likelihood."""
        _, Y, time, _ = log
        Y, flight = Y - Y.mean(axis=0), np.repeat(np.arange(4), 300)
        orders = [
            np.concatenate([np.arange(300) + 300 * k for k in order])
            for order in ([0, 1, 2, 3], [2, 0, 3, 1])
        ]
        first, second = (
            residual_drift(Nothing(), Y[rows], Y[rows], np.column_stack([time[rows], flight[rows]]))
            for rows in orders
        )
        assert_allclose(first, second, rtol=1e-3)  # the optimiser stops there

    def test_the_end_of_a_flight_tells_nothing_of_the_next(self):
        """Errors that only change from flight to flight last as long as a flight can show."""
        offset, white = (
            default_rng(0).choice([-1.0, 1.0], 40),
            default_rng(1).normal(0, 0.1, 800),
        )
        Y, time = (np.repeat(offset, 20) + white)[:, None], 0.1 * np.arange(800)
        apart = residual_drift(
            Nothing(), Y, Y, np.column_stack([time, np.repeat(np.arange(40), 20)])
        )
        assert apart[2, 0] == pytest.approx(1.9, rel=0.01)

    @pytest.mark.parametrize(
        "flight", [np.arange(60), np.arange(60) // 2], ids=["alone", "in pairs"]
    )
    def test_rows_that_show_no_drift_have_none(self, flight):
        Y = default_rng(0).normal(size=(60, 1))
        white, variance, _ = residual_drift(
            Nothing(), Y, Y, np.column_stack([0.1 * np.arange(60), flight])
        )
        assert white == pytest.approx(np.mean(Y**2))
        assert variance < 1e-6 * white


class Nothing:
    """A posterior whose mean is zero."""

    def predict(self, X):
        return np.zeros_like(X)


@pytest.mark.parametrize(
    ("clock", "words"),
    [
        ({"flight": np.zeros(50)}, "flight without time"),
        ({"time": np.arange(49.0)}, r"\(49,\).*\(50,\)"),
        ({"time": np.arange(50.0), "flight": ["a"] * 48 + [None, None]}, "2 rows without a flight"),
        ({"time": np.full(50, np.nan)}, "NaN"),
        (
            {"time": np.datetime64("2026-01-01", "ms") + np.arange(50)},
            r"datetime64.*expected seconds",
        ),
    ],
)
def test_rows_must_say_when_they_were(clock, words):
    X = default_rng(0).normal(size=(50, 1))
    with pytest.raises(ValueError, match=words):
        DependentGPRegressor(structure="trend").fit(X, X[:, 0], **clock)
