"""Where the data are, and where the model knows nothing: against the definitions."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.plotting import EnvelopeDisplay

NAMES = ["alpha", "beta", "q_hat", "elevator"]


def flown(n=80, seed=0, spread=0.05):
    table = pd.DataFrame(spread * np.random.default_rng(seed).normal(size=(n, 4)), columns=NAMES)
    return table.assign(q_hat=0.1 * table["q_hat"])


def targets(table):
    """Two outputs with noise: without it their deviations are small differences of large variances."""
    noise = 0.01 * np.random.default_rng(9).normal(size=(len(table), 2))
    return noise + np.column_stack(
        [np.sin(10 * table["alpha"]), np.cos(10 * table["beta"]) + table["elevator"]]
    )


@pytest.fixture(scope="module")
def model():
    regressor = DependentGPRegressor(n_latent=1, max_iter=5, random_state=0)
    return make_pipeline(StandardScaler(), regressor).fit(flown(), targets(flown()))


@pytest.fixture(scope="module")
def display(model):
    return EnvelopeDisplay.from_estimator(
        model, flown(), flight=flown(4000, 1, 0.08), n_grid=5, ax=Figure((9, 6))
    )


def test_against_the_definition(model, display):
    mean, std = model.predict(flown(), return_std=True)
    as_flown = mean.var(axis=0) + (std**2).mean(axis=0)
    medians = flown().median()
    for k, (right, up) in enumerate(display.pairs):
        for i, j in ((0, 0), (2, 2), (1, 4)):
            point = medians.copy()
            point[right], point[up] = display.points[k][0][j], display.points[k][1][i]
            std = model.predict(point.to_frame().T, return_std=True)[1][0]
            both = np.sqrt(np.mean(std**2 / as_flown))
            assert display.relative_std[k, i, j] == pytest.approx(both, rel=1e-6)


def test_the_usual_pairs_and_units_of_flight(display):
    assert display.pairs == [("alpha", "beta"), ("alpha", "elevator"), ("alpha", "q_hat")]
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in display.axes_.flat]
    assert labels == [
        (r"$\alpha$ [deg]", y) for y in (r"$\beta$ [deg]", "elevator [deg]", r"$\hat{q}$")
    ]
    for ax, points in zip(display.axes_.flat, display.points, strict=True):
        np.testing.assert_allclose(ax.get_xlim(), np.rad2deg(points[0][[0, -1]]))


def test_no_excursion_of_the_other_flight_is_lost(display):
    for (right, up), ax in zip(display.pairs, display.axes_.flat, strict=True):
        line = ax.lines[1]
        rows = display.path[[right, up]].to_numpy()
        dots = line.get_xydata() / [np.rad2deg(1), np.rad2deg(1) if up != "q_hat" else 1]
        assert len(dots) < len(rows)
        cell = (line.axes.get_xlim()[1] - line.axes.get_xlim()[0]) / np.rad2deg(1) / 60
        for extreme in (rows[:, 0].argmin(), rows[:, 0].argmax()):
            assert np.abs(dots[:, 0] - rows[extreme, 0]).min() < cell
        assert {tuple(dot) for dot in dots.round(12)} <= {tuple(row) for row in rows.round(12)}


def test_other_regressors():
    X = flown()[NAMES[:2]]
    process = GaussianProcessRegressor(optimizer=None).fit(X, np.sin(10 * X["alpha"]))
    display = EnvelopeDisplay.from_estimator(process, X, n_grid=4, ax=False)
    assert display.pairs == [("alpha", "beta")]
    grid = np.stack(np.meshgrid(*display.points[0]), axis=-1).reshape(-1, 2)
    std = process.predict(pd.DataFrame(grid, columns=X.columns), return_std=True)[1]
    mean, known = process.predict(X, return_std=True)
    expected = std / np.sqrt(mean.var() + np.mean(known**2))
    np.testing.assert_allclose(display.relative_std.ravel(), expected, atol=1e-6)


def test_regressors_need_names(model):
    with pytest.raises(ValueError, match="without names"):
        EnvelopeDisplay.from_estimator(model, np.zeros((3, 4)), ax=False)
