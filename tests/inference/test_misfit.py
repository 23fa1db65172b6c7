"""Misfit: errors of the function that residuals show where a log comes back to the same regressors."""

import numpy as np
import pytest
from made_flights import lasting
from numpy.random import default_rng
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp.inference import misfit_variance

NOISE = 0.3


def log_of(function, n=2000):
    """Return regressors (n, 1), noisy values (n, 1) and true ones of a log of one sample a second."""
    rng = default_rng(0)
    x = rng.uniform(-1, 1, (n, 1))
    truth = function(x)
    return x, truth + rng.normal(0, NOISE, x.shape), truth


class Given:
    """A posterior whose mean is a given function."""

    def __init__(self, function):
        self.predict = function


def variance_of(function, x, y, scale=1.0, flight=0):
    """Return the misfit of a function, of samples ``scale`` seconds apart."""
    clock = np.column_stack([scale * np.arange(len(x)), np.broadcast_to(flight, len(x))])
    return misfit_variance(Given(function), x, y, clock)


class TestVariance:
    @pytest.mark.parametrize("memory", [0.01, 4.5])
    def test_is_the_mean_square_of_the_error_of_the_function(self, memory):
        """Of a wrong function; of the true one it is a small part of the noise, white or lasting."""
        x, _, truth = log_of(np.abs, 8000)
        y = truth + NOISE * lasting(default_rng(1), (8000, 1), memory)
        found = variance_of(lambda x: 0.5 * x + 0.4, x, y)
        assert found[0] == pytest.approx(np.mean((truth - 0.5 * x - 0.4) ** 2), rel=0.15)
        assert variance_of(np.abs, x, y)[0] < 0.02 * NOISE**2

    def test_units_of_regressors_do_not_matter(self):
        X = default_rng(0).uniform(-1, 1, (2000, 2))
        y = np.abs(X[:, :1]) + X[:, 1:]
        found, expected = (
            variance_of(lambda x: 0 * x[:, :1], X * [1.0, unit], y) for unit in (1e3, 1.0)
        )
        assert found == pytest.approx(expected)

    def test_does_not_count_neighbours_in_time(self):
        """All samples of a log of 8 s are near in time, so nothing is known; of two flights something is."""
        x, y, _ = log_of(np.abs)
        assert variance_of(np.zeros_like, x, y, 1 / 250)[0] == 0
        two = variance_of(np.zeros_like, x, y, 1 / 250, np.arange(2000) // 1000)
        assert two[0] == pytest.approx(1 / 3, rel=0.1)

    def test_of_each_output_is_that_of_its_own_values(self):
        x, y, _ = log_of(np.abs, 4000)
        Y = y * [1.0, 2.0, np.nan]
        Y[::3, 1] = np.nan
        first, second, unseen = variance_of(lambda x: np.zeros((len(x), 3)), x, Y)
        assert second == pytest.approx(4 * first, rel=0.1)
        assert unseen == 0


@pytest.fixture(scope="module")
def kinked():
    """Return the log of a function with a kink, and a trend of it."""
    x, y, truth = log_of(np.abs)
    model = DependentGPRegressor(structure="trend", inference="sparse", random_state=0)
    return x, y, truth, model.fit(x, y, time=np.arange(len(x)))


class TestBand:
    def test_of_a_trend_holds_a_function_with_a_kink(self, kinked):
        x, y, truth, timed = kinked
        held = []
        for model in (clone(timed).fit(x, y), timed):
            mean, std = model.predict(x, return_std=True)
            held.append(np.mean(np.abs(truth - mean) < 2 * std))
        assert held[0] <= 0.3
        assert held[1] >= 0.9
