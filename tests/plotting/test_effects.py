"""Slices of a model along each regressor: values, bands and the panels that draw them."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.plotting import EffectsDisplay

NAMES = ["alpha", "q", "throttle", "beta", "elevator"]
NOISE = 0.02


def truth(X):
    """Return outputs of which one is a product, the other a sum."""
    lift = X["throttle"] + 20 * X["alpha"] * X["q"]
    return pd.DataFrame({"CZ": lift, "Cm": np.sin(5 * X["alpha"]) - X["elevator"]})


@pytest.fixture(scope="module")
def samples():
    return pd.DataFrame(default_rng(0).uniform(-0.2, 0.2, (150, 5)), columns=NAMES)


@pytest.fixture(scope="module")
def model(samples):
    Y = truth(samples) + default_rng(1).normal(0, NOISE, (150, 2))
    regressor = DependentGPRegressor(n_latent=0, max_iter=20, random_state=0)
    return make_pipeline(StandardScaler(), regressor).fit(samples, Y)


@pytest.mark.parametrize("at", [None, {"alpha": 0.1, "q": -0.15}])
def test_slices_are_the_function_along_each_regressor(model, samples, at):
    """Through the means, or through the given point, where the slope by alpha is 20 q."""
    display = EffectsDisplay.from_estimator(model, samples, at, ax=False)
    point = samples.mean().to_dict() | (at or {})
    for i, name in enumerate(NAMES):
        values = display.values[name]
        assert_allclose(values.iloc[[0, -1]], samples[name].quantile([0.01, 0.99]))
        expected = truth(pd.DataFrame({**point, name: values}))
        error = np.abs(display.mean[i] - expected)
        assert (error < 4 * display.std[i] + NOISE).all(axis=None)
        assert np.sqrt((error**2).mean(axis=None)) < 2 * NOISE


def test_a_row_for_each_output_holds_the_largest_effects_on_one_scale(model, samples):
    display = EffectsDisplay.from_estimator(model, samples, {"q": 0.1}, ax=Figure())
    assert display.axes_.shape == (2, 4)
    assert set(display.keys[4:6]) == {("Cm", "alpha"), ("Cm", "elevator")}
    assert {ax.get_ylabel() for ax in display.axes_[1]} == {"$C_m$"}
    assert len({ax.get_ylim() for ax in display.axes_[1]}) == 1
    ax = display.axes_.ravel()[display.keys.index(("Cm", "alpha"))]
    assert ax.get_xlabel() == r"$\alpha$ [deg]"
    assert_allclose(ax.lines[0].get_xdata()[0], np.rad2deg(samples["alpha"].mean()))
