"""The display of effects draws their curves, bands and what is joint."""

from copy import copy

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.stats import norm

from skdgp import DependentGPRegressor, effects
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
