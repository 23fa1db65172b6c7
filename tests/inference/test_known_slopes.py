"""Slopes that another source knows: the samples do not change them, nor their errors."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor
from skdgp.inference import KnownSlopes
from skdgp.kernels import LinearTrend

NAN = np.nan


def samples():
    rng = default_rng(0)
    X = rng.standard_normal((200, 3)) @ [[1.0, 0.3, 0.0], [0.0, 1.0, 0.2], [0.0, 0.0, 1.0]]
    Y = X @ [[2.0, 0.0], [1.0, -3.0], [0.5, 1.0]] + 0.1 * rng.standard_normal((200, 2))
    return X, Y


KNOWN = KnownSlopes(
    np.array([[1.5, NAN, 0.7], [NAN, -2.5, NAN]]),
    default_rng(1).standard_normal((2, 3, 4)),
)


def test_least_squares_has_the_known_slopes_with_what_it_lacks():
    X, Y = samples()
    lacking = KNOWN.function_errors(X, Y).mean_path().each(X)[0]
    found = LinearRegression().fit(X, Y + lacking)
    assert_allclose(found.coef_[KNOWN.known[..., 0]], [1.5, 0.7, -2.5])
    free = LinearRegression().fit(X[:, [1]], Y[:, 0] - X[:, [0, 2]] @ [1.5, 0.7])
    assert_allclose(found.coef_[0, 1], free.coef_[0])
    assert_allclose(found.intercept_[0], free.intercept_)
    assert_allclose(lacking.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize(("log", "trend"), [(True, "linear"), (False, None)])
def test_model_has_the_known_slopes_and_their_errors(log, trend):
    X, Y = samples()
    time = {"time": np.arange(float(len(X)))} if log else {}
    options = {"structure": "trend"}
    if trend is None:
        options = {"trend": None, "kernel": LinearTrend(), "structure": "joint"}
    model = DependentGPRegressor(**options).fit(X, Y, **time, slopes=KNOWN)
    known = KNOWN.known[..., 0]
    assert_allclose(model.predict_gradient(X[:1])[0][known], [1.5, 0.7, -2.5], atol=0.01)
    least = np.linalg.norm(KNOWN.errors, axis=-1)[known]
    assert_allclose(np.linalg.norm(model.function_errors().slopes(), axis=-1)[known], least)
    # in every form of the mean
    mean, _ = model.predict(X[:5], return_std=True)
    assert_allclose(model.predict(X[:5]), mean)
    assert_allclose(model.mean_path()(X[:5])[0], mean)
    paths = model.sample_paths(1500, random_state=0)
    spread = paths(X[:5]).std(axis=0) / np.sqrt(1500)
    assert np.all(np.abs(paths(X[:5]).mean(axis=0) - mean) < 5 * spread)
    drawn = paths.gradient(X[:1])
    assert np.all(drawn[:, 0].std(axis=0)[known] > 0.92 * least)


def test_slopes_of_samples_leave_missing_values_out():
    """On a plane least squares is exact, and errors have the given standard deviations."""
    rng = default_rng(0)
    X, slopes = rng.normal(size=(40, 2)), np.array([[1.0, -2.0], [0.5, 3.0]])
    Y = X @ slopes.T + [4.0, -1.0]
    X[3, 0], Y[7, 1] = np.nan, np.nan
    deviations = np.array([[0.1, np.nan], [0.2, 0.3]])
    known = KnownSlopes.of_samples(X, Y, deviations)
    assert_allclose(known.value, np.where(np.isnan(deviations), np.nan, slopes))
    std = np.sqrt((known.errors**2).sum(axis=-1))
    assert_allclose(std, np.nan_to_num(deviations))
