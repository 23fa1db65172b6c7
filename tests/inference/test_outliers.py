"""Single rows far from their neighbours."""

import numpy as np
import pytest
from numpy.random import default_rng

from skdgp import DependentGPRegressor


def function(X):
    return np.sin(2 * X[:, 0]) + 0.5 * X[:, 1]


def table(seed, n=100, n_outliers=0):
    rng = default_rng(seed)
    X = rng.uniform(-2, 2, (n, 2))
    noise = 0.1 * rng.normal(size=n)
    noise[rng.choice(n, n_outliers, replace=False)] = 10.0
    return X, function(X) + noise


def error_of(model):
    X = default_rng(9).uniform(-2, 2, (400, 2))
    return np.sqrt(np.mean((model.predict(X) - function(X)) ** 2))


@pytest.mark.parametrize("n_outliers", [2, 5])
@pytest.mark.parametrize("seed", [0, 1])
def test_of_100_deviations_in_some_of_100_rows_hardly_change_the_function(seed, n_outliers):
    clean = error_of(DependentGPRegressor(random_state=0).fit(*table(seed)))
    X, y = table(seed, n_outliers=n_outliers)
    outlying = [f"y0 of row {row}" for row in 2 + np.flatnonzero(y > 5)]
    X, y = np.vstack([X[:2], X]), np.append([np.nan, np.nan], y)  # two without a target
    with pytest.warns(UserWarning, match="outliers") as caught:
        model = DependentGPRegressor(random_state=0).fit(X, y)
    (finding,) = [warning.message.finding for warning in caught]
    assert finding.numbers == {"count": n_outliers, "outliers": outlying}
    assert error_of(model) < 1.3 * clean
    # a new measurement is an outlier as often
    assert model.noise_variance_[0] == pytest.approx(0.01 * n_outliers * 10.0**2, rel=0.5)


def test_normal_noise_is_taken_as_normal():
    for seed in range(3):
        X, y = table(seed, n=60)
        noise = DependentGPRegressor(random_state=0).fit(X, y).noise_variance_[0]
        assert noise == pytest.approx(0.01, rel=0.5)


@pytest.mark.filterwarnings("ignore:Got 4 rows")
def test_a_table_of_fewer_rows_than_neighbours_is_fitted():
    X, y = table(0, n=4)
    assert np.isfinite(DependentGPRegressor(random_state=0).fit(X, y).predict(X)).all()
