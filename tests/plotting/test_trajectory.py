"""The display of simulated flights: its band holds the paths, the flown one is on the same turn."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from skdgp.plotting import TimeHistoryDisplay

TIME = np.arange(0, 4, 0.02)


def ensemble(n_paths=20):
    rng = default_rng(0)
    speed = rng.normal(0, 0.5, n_paths)
    turn = rng.normal(0, 0.05, n_paths)
    parts = [
        pd.DataFrame({"start": 0, "path": k, "time": TIME + 7, "airspeed": 30 + speed[k] * TIME,
                      "psi": np.angle(np.exp(1j * (3.0 + (0.3 + turn[k]) * TIME))), "beyond": "", "ended": ""})
        for k in range(n_paths)
    ]  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def lines_of(display):
    found = []
    for ax in display.axes_.T.flat:
        found.append({line.get_label(): line.get_ydata() for line in ax.lines})
    return found


def test_the_band_holds_95_of_100_paths_and_headings_do_not_tear():
    paths = ensemble()
    display = TimeHistoryDisplay.from_trajectories(paths, columns=["airspeed", "psi"], ax=Figure())
    end = paths[paths["time"] == TIME[-1] + 7]["airspeed"]
    band = display.axes_[0, 0].collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((end.quantile(0.025), end.quantile(0.975)))
    assert np.abs(np.diff(lines_of(display)[1]["median of the paths"])).max() < 2.0


def test_the_line_is_the_trajectory_of_the_mean():
    """On the turn of the paths; without it the line is called what it is, the median of the paths."""
    paths = ensemble()
    turned = 3.0 + 0.28 * TIME
    mean = pd.DataFrame({"time": TIME + 7, "airspeed": 31.0, "psi": np.angle(np.exp(1j * turned))})
    columns = ["psi", "airspeed"]
    display = TimeHistoryDisplay.from_trajectories(paths, mean=mean, ax=False, columns=columns)
    assert_allclose(display.mean[:, 0], turned, atol=1e-9)
    assert (display.mean[:, 1] == 31.0).all()
    of_paths = TimeHistoryDisplay.from_trajectories(paths, columns=columns, ax=False)
    assert (display.estimate, of_paths.estimate) == ("simulated", "median of the paths")
    assert_allclose(display.upper - display.lower, of_paths.upper - of_paths.lower)


@pytest.mark.parametrize("turns", [-1, 1])
def test_line_and_band_are_on_one_turn_where_the_first_angles_are_on_either_side_of_it(turns):
    paths = ensemble()
    away = 0.02 * (np.arange(20) - 8.5) + np.pi  # most of the paths start beyond half a turn
    psi = turns * np.add.outer(away, 0.3 * TIME)
    paths["psi"] = np.angle(np.exp(1j * psi.ravel()))
    for start in (3.1, 3.2):
        heading = np.angle(np.exp(1j * turns * (start + 0.3 * TIME)))
        mean = pd.DataFrame({"time": TIME + 7, "psi": heading})
        for each in (paths, paths.assign(path=19 - paths["path"]).sort_values(["path", "time"])):
            display = TimeHistoryDisplay.from_trajectories(
                each.reset_index(drop=True), mean, mean=mean, columns=["psi"], ax=False
            )
            assert (display.lower < display.mean).all()
            assert (display.mean < display.upper).all()
            assert_allclose(display.measured, display.mean, atol=1e-9)


def test_the_flown_heading_is_on_the_turn_of_the_simulation():
    flown = pd.DataFrame({"time": TIME + 7, "psi": np.mod(3.0 + 0.3 * TIME, 2 * np.pi)})
    display = TimeHistoryDisplay.from_trajectories(ensemble(), flown, columns=["psi"], ax=False)
    assert_allclose(display.measured[:, 0], 3.0 + 0.3 * TIME, atol=1e-9)
    assert np.abs(display.measured - display.mean).max() < 0.35


def test_marks_where_paths_were_beyond_what_was_learned_from():
    paths = ensemble(3)
    paths.loc[(paths["path"] == 1) & (paths["time"] > 9), "beyond"] = "alpha"
    display = TimeHistoryDisplay.from_trajectories(paths, columns=["airspeed"], ax=Figure())
    marked = np.isfinite(lines_of(display)[0]["outside the training data"])
    assert_array_equal(marked, TIME + 7 > 9)


def test_mistakes_are_told():
    with pytest.raises(ValueError, match="lacks the columns 'phi'"):
        TimeHistoryDisplay.from_trajectories(ensemble(), columns=["phi"], ax=Figure())
    two = pd.concat([ensemble(), ensemble().assign(start=1)])
    with pytest.raises(ValueError, match="trajectories of 2 starts"):
        TimeHistoryDisplay.from_trajectories(two, columns=["psi"], ax=Figure())
