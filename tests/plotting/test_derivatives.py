"""The display of derivatives draws what the table says, where it says."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import norm

from skdgp.dynamics import Aerodynamics, Aircraft, air_velocity, stability_derivatives
from skdgp.plotting import DerivativeDisplay

ALPHAS = np.array([0.15, 0.0, 0.1, 0.05])


def sampler(n_paths, random_state):
    errors = 1 + 0.1 * np.random.default_rng(random_state).normal(size=(n_paths, 1, 1))
    return lambda X: errors * coefficients(X), lambda X: errors[..., None] * slopes(X)


def coefficients(X):
    return (
        np.stack([0.4 * X[..., 0] ** 2, *(0 * X[..., 0],) * 5], axis=-1)
        - 4.5 * X[..., :1] * np.eye(6)[2]
    )


def slopes(X):
    found = np.zeros((*X.shape[:-1], 6, 2))
    found[..., 0, 0], found[..., 2, 0] = 0.8 * X[..., 0], -4.5
    return found


@pytest.fixture
def sweep():
    aircraft = Aircraft(
        mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.5
    )
    states = np.zeros((4, 13))
    states[:, 3:6], states[:, 6] = air_velocity(20.0, ALPHAS, 0.0), 1.0
    model = Aerodynamics(coefficients, ["alpha", "elevon_left"], slopes=slopes, sampler=sampler)
    return stability_derivatives(model, aircraft, states, {"elevon_left": 0.0, "thrust": 0.0})


def test_lines_and_bands_are_those_of_the_table_in_order(sweep):
    display = DerivativeDisplay.from_sweep(
        sweep, over="alpha", derivatives=["CX_alpha"], ax=Figure()
    )
    x, y = display.axes_[0, 0].lines[0].get_data()
    assert x == pytest.approx(np.rad2deg(np.sort(ALPHAS)))
    assert y == pytest.approx(0.8 * np.sort(ALPHAS))
    std = sweep.xs("CX_alpha", level=1)["std"].to_numpy()[np.argsort(ALPHAS)]
    drawn = display.axes_[0, 0].collections[0].get_paths()[0].vertices
    assert drawn[:, 1].max() == pytest.approx((y + norm.ppf(0.975) * std).max(), rel=1e-4)
    assert display.axes_[0, 0].get_ylabel() == r"$C_{X_{\alpha}}$"


def test_draws_the_best_known_by_default_and_any_name(sweep):
    display = DerivativeDisplay.from_sweep(sweep, over="alpha", ax=Figure())
    assert display.names == ("CL_alpha", "CD_alpha", "Cm_alpha")
    display = DerivativeDisplay.from_sweep(
        sweep, over="alpha", derivatives=["Cn_elevon_left", "CL"], ax=Figure()
    )
    display.figure_.canvas.draw()
    labels = [ax.get_ylabel() for ax in display.axes_.flat]
    assert labels == [r"$C_{n_{\mathrm{elevon\_left}}}$", "$C_{L}$"]


def test_says_what_it_needs(sweep):
    with pytest.raises(ValueError, match="single point"):
        DerivativeDisplay.from_sweep(sweep.loc[0])
    with pytest.raises(ValueError, match="over='mach'"):
        DerivativeDisplay.from_sweep(sweep, over="mach")
    with pytest.raises(ValueError, match="CZ_flap"):
        DerivativeDisplay.from_sweep(sweep, derivatives=["CZ_flap"])
