"""The display of effects draws their curves, bands in the units of the axes."""

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


def test_a_row_for_each_output_holds_its_effects(model):
    display, found = EffectsDisplay.from_model(model, ax=Figure()), effects(model)
    assert display.axes_.shape == (2, 2)
    assert display.keys[2:] == [("Cm", "alpha"), ("Cm", "throttle")]
    assert [ax.get_ylabel() for ax in display.axes_[:, 0]] == ["$C_Z$", "$C_m$"]
    assert [ax.get_xlabel() for ax in display.axes_[0]] == [r"$\alpha$ [deg]", "throttle"]
    _, line, _ = display.axes_[1, 0].lines
    curve = found.curves["alpha"]
    np.testing.assert_allclose(line.get_xdata(), np.rad2deg(curve.at))
    np.testing.assert_allclose(line.get_ydata(), curve.mean[:, 1])
    upper = display.axes_[1, 0].collections[0].get_paths()[0].vertices[:, 1].max()
    expected = (curve.mean + norm.ppf(0.975) * curve.std)[:, 1].max()
    assert upper == pytest.approx(expected, rel=1e-4)
    for row in display.axes_:
        assert row[0].get_ylim() == row[1].get_ylim()


def test_controls_in_parts_of_their_full_throw_are_shown_so(model):
    parts = copy(model)
    parts.control_units_ = {"alpha": "full throw"}  # as of a pipeline of `identify`
    display = EffectsDisplay.from_model(parts, ax=Figure(), keys=[("CZ", "alpha")])
    (ax,) = display.axes_.flat
    assert ax.get_xlabel() == r"$\alpha$ [full throw]"
    np.testing.assert_allclose(ax.lines[1].get_xdata(), display.curves["alpha"].at)
