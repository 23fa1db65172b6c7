"""The display of effects draws their curves, bands and what is joint."""

from copy import copy

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.stats import norm

from skdgp import DependentGPRegressor, effects
from skdgp._effects import interactions
from skdgp.plotting import EffectsDisplay


@pytest.fixture(scope="module")
def model():
    X = pd.DataFrame(
        np.random.default_rng(0).uniform(-0.2, 0.2, (50, 2)), columns=["alpha", "throttle"]
    )
    Y = pd.DataFrame({"CZ": -4 * X["alpha"], "Cm": np.sin(5 * X["alpha"]) - X["throttle"]})
    return DependentGPRegressor(structure="additive", n_latent=0, optimizer=None).fit(X, Y)


def test_draws_a_row_for_each_output_and_a_column_for_each_regressor(model):
    display, found = EffectsDisplay.from_model(model, ax=Figure(), level=0.9), effects(model)
    assert display.axes_.shape == (2, 3)
    assert [ax.get_ylabel() for ax in display.axes_[:, 0]] == ["$C_Z$", "$C_m$"]
    assert [ax.get_xlabel() for ax in display.axes_[-1]] == ["$\\alpha$\n[deg]", "throttle", ""]
    x, y = display.lines_[3].get_data()
    np.testing.assert_allclose(x, np.rad2deg(found.curves["alpha"].at))
    np.testing.assert_allclose(y, found.curves["alpha"].mean[:, 1])
    upper = display.bands_[3].get_paths()[0].vertices[:, 1].max()
    assert upper == pytest.approx((y + norm.ppf(0.95) * found.curves["alpha"].std[:, 1]).max())
    (bar,) = display.bars_[2]
    assert bar.get_height() == pytest.approx(
        2 * norm.ppf(0.95) * found.importance.loc["joint", "CZ"]
    )
    for row in display.axes_:
        assert len({ax.get_ylim() for ax in row}) == 1


def test_controls_in_parts_of_their_full_throw_are_shown_so(model):
    parts = copy(model)
    parts.control_units_ = {"alpha": "full throw"}  # as of a pipeline of `identify`
    display = EffectsDisplay.from_model(parts, ax=Figure())
    assert display.axes_[-1, 0].get_xlabel() == "$\\alpha$\n[full throw]"
    np.testing.assert_allclose(display.lines_[0].get_xdata(), display.curves["alpha"].at)


def test_draws_what_is_wanted(model):
    display = EffectsDisplay.compute(model, n_grid=5)
    display.plot(Figure(), outputs="Cm", legend=False)
    assert display.axes_.shape == (1, 3)
    assert len(display.lines_[0].get_xdata()) == 5
    assert display.figure_.legends == []
    with pytest.raises(ValueError, match=r"Got the outputs \['CX'\]"):
        display.plot(Figure(), outputs="CX")


def test_joint_processes_alone_have_no_curves(model):
    X = effects(model).samples
    joint = DependentGPRegressor(trend="constant", n_latent=0, optimizer=None).fit(X, X["alpha"])
    display = EffectsDisplay.from_model(joint, ax=Figure())
    display.figure_.canvas.draw()
    assert display.axes_.shape == (1, 1)
    assert [label.get_text() for label in display.axes_[0, 0].get_xticklabels()] == ["joint"]


def test_an_interaction_is_what_effects_do_not_add_up_to(model):
    X = pd.DataFrame(
        np.random.default_rng(1).uniform(-0.2, 0.2, (80, 3)), columns=["alpha", "q", "r"]
    )
    Y = pd.DataFrame({"CZ": X["r"] + 20 * X["alpha"] * X["q"], "Cm": np.sin(5 * X["r"])})
    joint = DependentGPRegressor(n_latent=0, max_iter=30, random_state=0).fit(X, Y)
    found = interactions(joint, n_grid=5)
    strongest = found["CZ"][0]
    assert strongest.regressors == ("alpha", "q")
    products = 20 * (X["alpha"] - X["alpha"].mean()) * (X["q"] - X["q"].mean())
    assert strongest.share == pytest.approx(np.sqrt((products**2).mean()), rel=0.2)
    assert found["Cm"][0].share < 0.05 * np.sin(5 * X["r"]).std()
    # Between the two levels of q the slope by alpha differs by 20 times their distance.
    slopes = np.ptp(strongest.mean, axis=0) / np.ptp(strongest.at) * np.sign(strongest.mean[-1])
    assert np.diff(slopes) == pytest.approx(20 * np.diff(strongest.levels), rel=0.15)
    assert (strongest.std >= 0).all()
    display = EffectsDisplay.compute(joint)
    (low, band), (high, _) = display.draw_interaction(Figure().subplots(), "CZ", 0)
    np.testing.assert_allclose(low.get_ydata(), display.interactions["CZ"][0].mean[:, 0])
    assert high.get_label().startswith("$q$ = ")
    assert band is not None
    sums = interactions(model)  # of functions of single regressors, but for the joint process
    assert set(sums) == {"CZ", "Cm"}
