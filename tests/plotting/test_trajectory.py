"""The display of simulated flights: its band holds the paths, its truth is on the same turn."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from skdgp.plotting import TrajectoryDisplay

TIME = np.arange(0, 4, 0.02)


def ensemble(n_paths=20):
    rng = np.random.default_rng(0)
    speed, turn = rng.normal(0, 0.5, n_paths), rng.normal(0, 0.05, n_paths)
    parts = [
        pd.DataFrame({"start": 0, "path": k, "time": TIME + 7, "airspeed": 30 + speed[k] * TIME,
                      "psi": np.angle(np.exp(1j * (3.0 + (0.3 + turn[k]) * TIME))), "beyond": "", "ended": ""})
        for k in range(n_paths)
    ]  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def test_the_band_holds_its_share_of_the_paths_and_headings_do_not_tear():
    paths = ensemble()
    display = TrajectoryDisplay.from_trajectories(
        paths, columns=["airspeed", "psi"], level=0.9, ax=Figure()
    )
    low, high = (
        display.bands_[0].get_paths()[0].vertices[:, 1].min(),
        display.bands_[0].get_paths()[0].vertices[:, 1].max(),
    )
    end = paths[paths["time"] == TIME[-1] + 7]["airspeed"]
    assert (low, high) == pytest.approx((end.quantile(0.05), end.quantile(0.95)))
    heading = display.lines_[1].get_ydata()
    assert np.abs(np.diff(heading)).max() < 2.0
    assert [ax.get_ylabel() for ax in display.axes_.flat] == ["$V$ [m/s]", r"$\psi$ [deg]"]


def test_the_line_is_the_trajectory_of_the_mean():
    """On the turn of the paths; without it the line is called what it is, the median of the paths."""
    paths, turned = ensemble(), 3.0 + 0.28 * TIME
    mean = pd.DataFrame({"time": TIME + 7, "airspeed": 31.0, "psi": np.angle(np.exp(1j * turned))})
    display = TrajectoryDisplay.from_trajectories(
        paths, mean=mean, columns=["psi", "airspeed"], ax=Figure()
    )
    np.testing.assert_allclose(display.lines_[0].get_ydata(), np.rad2deg(turned), atol=1e-9)
    assert (display.lines_[1].get_ydata() == 31.0).all()
    of_paths = TrajectoryDisplay.from_trajectories(paths, columns=["psi"], ax=Figure())
    assert [one.lines_[0].get_label() for one in (display, of_paths)] == [
        "simulated",
        "median of the paths",
    ]
    low, high = (np.ptp(one.bands_[0].get_paths()[0].vertices[:, 1]) for one in (display, of_paths))
    assert low == pytest.approx(high)
    with pytest.raises(ValueError, match="a mean of 3 rows, but expected the 200 of each path"):
        TrajectoryDisplay.from_trajectories(paths, mean=mean[:3], columns=["psi"], ax=Figure())


def test_truth_is_drawn_on_the_turn_of_the_simulation():
    truth = pd.DataFrame(
        {"time": TIME + 7, "psi": np.mod(3.0 + 0.3 * TIME, 2 * np.pi), "airspeed": 30.0}
    )
    display = TrajectoryDisplay.from_trajectories(ensemble(), truth, columns=["psi"], ax=Figure())
    np.testing.assert_allclose(
        display.truth_[0].get_ydata(), np.rad2deg(3.0 + 0.3 * TIME), atol=1e-9
    )
    assert np.abs(display.truth_[0].get_ydata() - display.lines_[0].get_ydata()).max() < 20


def test_one_trajectory_has_the_band_of_its_deviations():
    flown = pd.DataFrame({"time": TIME, "phi": 0.1, "phi_std": 0.01 * TIME})
    display = TrajectoryDisplay.from_trajectories(flown, columns=["phi"], ax=Figure())
    top = display.bands_[0].get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx(np.rad2deg(0.1 + 1.959964 * 0.01 * TIME[-1]), rel=1e-6)
    bare = TrajectoryDisplay.from_trajectories(
        flown.drop(columns="phi_std"), columns=["phi"], ax=Figure()
    )
    assert bare.bands_ == [None]


def test_marks_where_paths_were_beyond_what_was_learned_from():
    paths = ensemble(3)
    paths.loc[(paths["path"] == 1) & (paths["time"] > 9), "beyond"] = "alpha"
    display = TrajectoryDisplay.from_trajectories(paths, columns=["airspeed"], ax=Figure())
    marked = np.isfinite(display.beyond_[0].get_ydata())
    np.testing.assert_array_equal(marked, TIME + 7 > 9)


def test_mistakes_are_told():
    with pytest.raises(ValueError, match="lacks the columns 'phi'"):
        TrajectoryDisplay.from_trajectories(ensemble(), columns=["phi"], ax=Figure())
    with pytest.raises(ValueError, match="Got start=4"):
        TrajectoryDisplay.from_trajectories(ensemble(), start=4, columns=["psi"], ax=Figure())
