"""Missing measurements from the other outputs of their row."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.linear_model import BayesianRidge

from skdgp import DependentGPRegressor

HIDDEN = slice(20, 40)


@pytest.fixture(scope="module")
def rows():
    """Return inputs, outputs that share white noise of each row, the same with a gap, and a fit to these."""
    rng = default_rng(0)
    x = np.linspace(0, 6, 80)[:, None]
    shared = rng.normal(size=(80, 2))
    mixing = np.array([[1.0, 0.5, -0.8], [0.2, -1.0, 0.7]])
    truth = np.sin(x) + shared @ mixing + 0.05 * rng.normal(size=(80, 3))
    Y = truth.copy()
    Y[HIDDEN, 2] = np.nan
    model = DependentGPRegressor(max_iter=10, random_state=0).fit(x, Y)
    return x, truth, Y, model


def test_what_a_row_shares_is_known_from_its_other_outputs(rows):
    # No function of x knows it; where x tells nothing else, this is a regression on the others.
    x, truth, Y, model = rows
    value, std = (part[HIDDEN, 2] for part in model.impute(x, Y, return_std=True))
    hidden = truth[HIDDEN, 2]
    error = value - hidden
    observed = np.isfinite(Y[:, 2])
    ridge = BayesianRidge().fit(Y[observed, :2], Y[observed, 2]).predict(Y[HIDDEN, :2])
    assert np.std(error) < 1.3 * np.std(ridge - hidden)
    assert np.std(error) < 0.3 * np.std(model.predict(x)[HIDDEN, 2] - hidden)
    assert np.mean(np.abs(error) < 1.96 * std) >= 0.85
    assert np.median(std) < 3 * np.std(error)


def test_observed_values_are_kept(rows):
    x, _, Y, model = rows
    value, std = model.impute(x, Y, return_std=True)
    assert_array_equal(value[np.isfinite(Y)], Y[np.isfinite(Y)])
    assert_array_equal(std > 0, np.isnan(Y))
    assert_array_equal(model.impute(x, Y), value)


def test_rows_that_the_fit_has_not_seen_are_completed(rows):
    x, truth, Y, _ = rows
    seen = np.isfinite(Y[:, 2])
    model = DependentGPRegressor(max_iter=10, random_state=0).fit(x[seen], Y[seen])
    error = model.impute(x, Y)[HIDDEN, 2] - truth[HIDDEN, 2]
    assert np.std(error) < 0.3 * np.std(truth[HIDDEN, 2])


def test_a_row_without_outputs_has_the_prediction(rows):
    x, _, Y, model = rows
    Y = Y.copy()
    Y[70] = np.nan
    value, std = model.impute(x, Y, return_std=True)
    predicted = model.predict(x[70:71], return_std=True, include_noise=True)
    assert_allclose([value[[70]], std[[70]]], predicted)


def test_positive_outputs_that_are_log_normal_have_medians():
    rng = default_rng(1)
    x = rng.uniform(size=(120, 1))
    z = rng.normal(size=120)
    truth = np.exp(np.column_stack([z, 1.5 * z + 0.1 * rng.normal(size=120)]))
    Y = truth.copy()
    Y[90:, 1] = np.nan
    value, std = DependentGPRegressor(max_iter=5, random_state=0).fit(x, Y).impute(x, Y, True)
    ratio = np.log(value[90:, 1] / truth[90:, 1])
    assert np.std(ratio) < 0.15
    assert_allclose(std[90:, 1] / value[90:, 1], 0.1, rtol=0.4)


def test_an_output_alone_is_predicted():
    x = np.linspace(0, 1, 20)[:, None]
    y = np.where(np.arange(20) == 7, np.nan, x[:, 0])
    model = DependentGPRegressor(structure="trend").fit(x, y)
    value = model.impute(x, y)
    assert value.shape == (20,)
    assert_allclose(value[7], model.predict(x)[7])


def test_a_table_of_another_shape_is_refused(rows):
    x, _, Y, model = rows
    with pytest.raises(ValueError, match=r"Got y of shape \(80, 2\), but expected \(80, 3\)"):
        model.impute(x, Y[:, :2])
