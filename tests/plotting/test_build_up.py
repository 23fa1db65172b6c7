"""The display of a build-up draws effects with bands and maps with contours."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scipy.stats import norm

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import build_up
from skdgp.kernels import ConvolvedGaussian
from skdgp.plotting import BuildUpDisplay

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]


@pytest.fixture(scope="module")
def build():
    X = pd.DataFrame(
        np.random.default_rng(0).uniform(-0.2, 0.2, (50, 2)), columns=["alpha", "throttle"]
    )
    Y = pd.DataFrame({name: np.sin(5 * X["alpha"]) - X["throttle"] for name in COEFFICIENTS})
    Y["Cm"] += 20 * X["alpha"] * X["throttle"]
    model = DependentGPRegressor(ConvolvedGaussian(1, private_latents=False), optimizer=None).fit(
        X, Y
    )
    aircraft = Aircraft(
        mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25
    )
    return build_up(model, aircraft, max_loss=np.inf)


def test_draws_effects_and_maps(build):
    display = BuildUpDisplay.from_build_up(
        build, ax=Figure(), level=0.9, n_grid=9, outputs=["CZ", "Cm"]
    )
    assert display.axes_.shape == (2, 3)
    assert [ax.get_ylabel() for ax in display.axes_[:, 0]] == ["$C_Z$", "$C_m$"]
    assert [ax.get_xlabel() for ax in display.axes_[-1, :2]] == ["$\\alpha$\n[deg]", "throttle"]
    x, y = display.lines_[3].get_data()
    mean, std = build.effects("Cm")(("alpha",), np.deg2rad(x)[:, None])
    np.testing.assert_allclose(y, mean)
    upper = display.bands_[3].get_paths()[0].vertices[:, 1].max()
    assert upper == pytest.approx((mean + norm.ppf(0.95) * std).max())
    (pair, rows, columns, cells, _), mesh = display.maps["Cm"][0], display.meshes_[5]
    assert pair == ("alpha", "throttle")
    np.testing.assert_allclose(mesh.get_array().reshape(9, 9), cells)
    assert len(rows) == len(columns) == 9
    assert cells[0, 0] + cells[-1, -1] > cells[0, -1] + cells[-1, 0]
    display.figure_.canvas.draw()


def test_bad_input(build):
    with pytest.raises(ValueError, match=r"Got the outputs \['CT'\]"):
        BuildUpDisplay.from_build_up(build, ax=Figure(), n_grid=3, outputs="CT")
    with pytest.raises(ValueError, match="expected at least 2"):
        BuildUpDisplay.from_build_up(build, ax=Figure(), n_grid=1)
