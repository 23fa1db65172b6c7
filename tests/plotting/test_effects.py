"""The display of effects draws their curves, bands and what is joint."""

from copy import copy

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.stats import norm

from skdgp import DependentGPRegressor, effects
from skdgp.plotting import EffectsDisplay


@pytest.fixture(scope="module")
def model():
    X = pd.DataFrame(default_rng(0).uniform(-0.2, 0.2, (50, 2)), columns=["alpha", "throttle"])
    Y = pd.DataFrame({"CZ": -4 * X["alpha"], "Cm": np.sin(5 * X["alpha"]) - X["throttle"]})
    return DependentGPRegressor(structure="additive", n_latent=0, optimizer=None).fit(X, Y)


def test_a_row_for_each_output_holds_effects_and_interactions(model):
    display = EffectsDisplay.from_model(model, ax=Figure())
    found = effects(model)
    assert display.axes_.shape == (2, 3)
    assert display.keys[3:] == [("Cm", "alpha"), ("Cm", "throttle"), ("Cm", 0)]
    assert [ax.get_ylabel() for ax in display.axes_[:, 0]] == ["$C_Z$", "$C_m$"]
    assert [ax.get_xlabel() for ax in display.axes_[0, :2]] == [r"$\alpha$ [deg]", "throttle"]
    _, line, _ = display.axes_[1, 0].lines
    curve = found.curves["alpha"]
    assert_allclose(line.get_xdata(), np.rad2deg(curve.at))
    assert_allclose(line.get_ydata(), curve.mean[:, 1])
    upper = display.axes_[1, 0].collections[0].get_paths()[0].vertices[:, 1].max()
    expected = (curve.mean + norm.ppf(0.975) * curve.std)[:, 1].max()
    assert upper == pytest.approx(expected, rel=1e-4)
    for row in display.axes_:
        assert row[0].get_ylim() == row[1].get_ylim()
    of_levels = display.axes_[1, 2].get_legend().texts
    assert len(of_levels) == 2


def test_controls_in_parts_of_their_full_throw_are_shown_so(model):
    parts = copy(model)
    parts.control_units_ = {"alpha": "full throw"}  # as of a pipeline of `identify`
    display = EffectsDisplay.from_model(parts, ax=Figure())
    ax = display.axes_[0, 0]
    assert ax.get_xlabel() == r"$\alpha$ [full throw]"
    assert_allclose(ax.lines[1].get_xdata(), display.curves["alpha"].at)


def test_joint_processes_alone_have_interactions(model):
    X = effects(model).samples
    joint = DependentGPRegressor(trend="constant", n_latent=0, optimizer=None).fit(X, X["alpha"])
    display = EffectsDisplay.from_model(joint, ax=Figure())
    display.figure_.canvas.draw()
    assert display.keys == [("alpha", 0)]


def test_an_interaction_is_what_effects_do_not_add_up_to(model):
    X = pd.DataFrame(default_rng(1).uniform(-0.2, 0.2, (80, 3)), columns=["alpha", "q", "r"])
    Y = pd.DataFrame({"CZ": X["r"] + 20 * X["alpha"] * X["q"], "Cm": np.sin(5 * X["r"])})
    joint = DependentGPRegressor(n_latent=0, max_iter=30, random_state=0).fit(X, Y)
    display = EffectsDisplay.from_model(joint, ax=False)
    found = display.interactions
    strongest = found["CZ"][0]
    assert strongest.regressors == ("alpha", "q")
    products = 20 * (X["alpha"] - X["alpha"].mean()) * (X["q"] - X["q"].mean())
    assert strongest.share == pytest.approx(np.sqrt((products**2).mean()), rel=0.2)
    assert found["Cm"][0].share < 0.05 * np.sin(5 * X["r"]).std()
    # Between the two levels of q the slope by alpha differs by 20 times their distance.
    slopes = np.ptp(strongest.mean, axis=0) / np.ptp(strongest.at) * np.sign(strongest.mean[-1])
    assert np.diff(slopes) == pytest.approx(20 * np.diff(strongest.levels), rel=0.15)
    assert (strongest.std >= 0).all()
    display.draw(ax := Figure().subplots(), ("CZ", 0))
    _, low, high = ax.lines
    assert_allclose(low.get_ydata(), strongest.mean[:, 0])
    assert high.get_label().startswith("$q$ = ")
    assert len(ax.collections) == 2
    assert set(EffectsDisplay.from_model(model, ax=False).interactions) == {"CZ", "Cm"}
