"""Where the data are, and where the model knows nothing: against the definitions."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.plotting import EnvelopeDisplay
from skdgp.preprocessing import RegressorSelector

NAMES = ["alpha", "beta", "q_hat", "elevator"]


def flown(n=80, seed=0, spread=0.05):
    table = pd.DataFrame(spread * np.random.default_rng(seed).normal(size=(n, 4)), columns=NAMES)
    return table.assign(q_hat=0.1 * table["q_hat"], time=np.arange(n) / 10.0)


def targets(table):
    return np.column_stack([np.sin(10 * table["alpha"]), np.cos(10 * table["beta"]) + table["elevator"]])


@pytest.fixture(scope="module")
def model():
    # No trend, so that far away nothing is known but the prior.
    regressor = DependentGPRegressor(n_latent=1, trend="constant", max_iter=5, random_state=0)
    pipeline = make_pipeline(RegressorSelector(NAMES), StandardScaler(), regressor)
    return pipeline.fit(flown(), targets(flown()))


@pytest.fixture(scope="module")
def display(model):
    return EnvelopeDisplay.from_estimator(model, flown(), flight=flown(4000, 1, 0.08), n_grid=5, ax=Figure((9, 6)))


def test_relative_to_what_is_known_far_away(model, display):
    far = pd.DataFrame([dict.fromkeys(NAMES, 1e3)]).assign(time=0.0)
    nothing = model.predict(far, return_std=True)[1][0]
    medians = flown()[NAMES].median()
    for k, (right, up) in enumerate(display.pairs):
        for i, j in ((0, 0), (2, 2), (1, 4)):
            point = medians.copy()
            point[right], point[up] = display.points[k][0][j], display.points[k][1][i]
            std = model.predict(point.to_frame().T.assign(time=0.0), return_std=True)[1][0]
            for output in (0, 1):
                relative = display.relative_std(display.output_names[output])[k, i, j]
                assert relative == pytest.approx(std[output] / nothing[output], rel=1e-6)


def test_it_is_known_in_the_middle_and_not_at_the_corners(display):
    rho = display.relative_std()
    assert (rho[:, 2, 2] < rho[:, [0, 0, -1, -1], [0, -1, 0, -1]].min(axis=1)).all()
    assert rho.min() > 0
    assert rho.max() < 1 + 1e-9


def test_the_usual_pairs_and_units_of_flight(display):
    assert display.pairs == [("alpha", "beta"), ("alpha", "elevator"), ("alpha", "q_hat")]
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in display.axes_.flat]
    assert labels == [(r"$\alpha$ [deg]", y) for y in (r"$\beta$ [deg]", "elevator [deg]", r"$\hat{q}$")]
    for ax, points in zip(display.axes_.flat, display.points, strict=True):
        np.testing.assert_allclose(ax.get_xlim(), np.rad2deg(points[0][[0, -1]]))


def test_panels_reach_beyond_everything_flown(display):
    for (right, up), points in zip(display.pairs, display.points, strict=True):
        for name, axis in zip((right, up), points, strict=True):
            for table in (display.flown, display.path):
                assert axis[0] < table[name].min()
                assert axis[-1] > table[name].max()


def test_grey_areas_hold_their_shares_of_the_samples(model):
    table = flown(20_000, 2)
    display = EnvelopeDisplay.from_estimator(model, table, pairs=[("alpha", "beta")], n_grid=4, ax=Figure((4, 4)))
    # The light area is drawn around the dark one; a point within the latter is within the outline of the former.
    points = np.rad2deg(table[["alpha", "beta"]])
    inside = [area.contains_points(points).mean() for area in display.density_[0].get_paths()]
    assert inside == pytest.approx([0.95, 0.5], abs=0.03)


def test_no_excursion_of_the_other_flight_is_lost(display):
    for (right, up), line in zip(display.pairs, display.paths_, strict=True):
        rows = display.path[[right, up]].to_numpy()
        dots = line.get_xydata() / [np.rad2deg(1), np.rad2deg(1) if up != "q_hat" else 1]
        assert len(dots) < len(rows)
        cell = (line.axes.get_xlim()[1] - line.axes.get_xlim()[0]) / np.rad2deg(1) / 60
        for extreme in (rows[:, 0].argmin(), rows[:, 0].argmax()):
            assert np.abs(dots[:, 0] - rows[extreme, 0]).min() < cell
        assert {tuple(dot) for dot in dots.round(12)} <= {tuple(row) for row in rows.round(12)}


def test_draws_again_what_it_computed(display):
    again = EnvelopeDisplay(**{name: getattr(display, name) for name in vars(display) if not name.endswith("_")})
    again.plot(Figure((4, 4)), pairs=[("alpha", "elevator")], outputs=display.output_names[0], legend=False)
    assert again.axes_.shape == (1, 1)
    assert again.legend_ is None


def test_pyplot_makes_room_for_the_legend(display):
    import matplotlib.pyplot as plt

    again = EnvelopeDisplay(**{name: getattr(display, name) for name in vars(display) if not name.endswith("_")}).plot()
    again.figure_.draw_without_rendering()
    below = again.legend_.get_window_extent().y0
    assert all(ax.get_window_extent().y1 <= below for ax in again.axes_.flat)
    plt.close(again.figure_)


def test_other_regressors_are_told_their_prior():
    X = flown()[NAMES[:2]]
    process = GaussianProcessRegressor(optimizer=None).fit(X, np.sin(10 * X["alpha"]))
    display = EnvelopeDisplay.compute(process, X, prior_std=1.0, n_grid=4)  # the prior of its kernel, RBF(1)
    assert display.pairs == [("alpha", "beta")]
    assert display.variance.shape == (1, 4, 4, 1)
    grid = np.stack(np.meshgrid(*display.points[0]), axis=-1).reshape(-1, 2)
    std = process.predict(pd.DataFrame(grid, columns=X.columns), return_std=True)[1]
    np.testing.assert_allclose(display.relative_std()[0].ravel(), std)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pairs": [("alpha", "gamma")]}, r"The regressors of the model lack 'gamma'"),
        ({"pairs": [("alpha", "alpha")]}, "two different regressors"),
        ({"X": np.zeros((3, 4))}, "names"),
    ],
)
def test_says_what_is_wrong(model, change, message):
    given = {"X": flown(), **change}
    with pytest.raises((ValueError, TypeError), match=message):
        EnvelopeDisplay.compute(model[-2:] if "X" in change else model, **given)


def test_asks_for_a_prior_and_for_pairs_that_it_has(display):
    X = flown()[NAMES]
    with pytest.raises(ValueError, match="give prior_std"):
        EnvelopeDisplay.compute(LinearRegression().fit(X, X["alpha"]), X)
    with pytest.raises(ValueError, match="expected some of"):
        display.plot(Figure(), pairs=[("beta", "elevator")])
