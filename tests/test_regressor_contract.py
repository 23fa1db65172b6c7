"""What a fit promises whatever the data: refused, it changes nothing; rows, units and masks mean what they say."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from skdgp import DependentGPRegressor
from skdgp.kernels import ConvolvedGaussian


def waves(n=40, seed=0):
    rng = default_rng(seed)
    X = rng.normal(size=(n, 2))
    return X, np.sin(X) + 0.1 * rng.normal(size=(n, 2))


def quick(**options):
    short = {"structure": "joint", "max_iter": 10, "random_state": 0}
    return DependentGPRegressor(**short | options)


class TestRefusedFit:
    @pytest.mark.parametrize(
        ("options", "change"),
        [
            ({"structure": "trend", "trend": "constant"}, lambda X, Y: (X, 1000 * Y + 7)),
            ({"kernel": ConvolvedGaussian(1, regressors=[5])}, lambda X, Y: (X[:, :1], Y[:, 0])),
            ({}, lambda X, Y: (X[:, :1], Y[:3])),
        ],
    )
    def test_changes_nothing(self, options, change):
        X, Y = waves()
        model = quick().fit(X, Y)
        before = dict(vars(model))
        expected = model.predict(X, return_std=True)
        parameters = model.get_params()
        model.set_params(**options)
        with pytest.raises((ValueError, TypeError)):
            model.fit(*change(X, Y))
        model.set_params(**parameters)
        assert vars(model).keys() == before.keys()
        assert_array_equal(model.predict(X, return_std=True), expected)

    def test_of_a_new_estimator_leaves_it_unfitted(self):
        model = quick()
        with pytest.raises(ValueError, match="fewer than two"):
            model.fit(np.eye(3), [np.nan, np.nan, 1.0])
        assert not [name for name in vars(model) if name.endswith("_")]


@pytest.mark.parametrize("frequency", [20, 200])
def test_a_sine_of_many_periods_is_learned_from_one_output(frequency):
    rng = default_rng(0)
    X = rng.uniform(size=(300, 1))
    new = rng.uniform(0.02, 0.98, size=(100, 1))
    y = np.sin(frequency * X[:, 0]) + 0.1 * rng.normal(size=300)
    model = DependentGPRegressor(random_state=0).fit(X, y)
    assert np.sqrt(np.mean((model.predict(new) - np.sin(frequency * new[:, 0])) ** 2)) < 0.2


class TestMasks:
    def test_masked_targets_are_not_observed(self):
        X, Y = waves()
        hidden = default_rng(1).random(Y.shape) < 0.3
        masked = np.ma.masked_array(np.where(hidden, 1e3, Y), mask=hidden)
        expected = quick().fit(X, np.where(hidden, np.nan, Y)).predict(X)
        assert_array_equal(quick().fit(X, masked).predict(X), expected)

    def test_masked_regressors_are_refused(self):
        X, Y = waves()
        masked = np.ma.masked_greater(X, 1.0)
        with pytest.raises(ValueError, match=r"Got X with \d+ masked values, but expected all"):
            quick().fit(masked, Y)
        with pytest.raises(ValueError, match=r"Got X with \d+ masked values"):
            quick().fit(X, Y).predict(masked)
