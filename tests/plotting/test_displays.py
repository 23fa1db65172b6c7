"""Displays: what is drawn is what was given, wherever it is drawn, and nothing breaks on poor data."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from skdgp.plotting import TimeHistoryDisplay


def outputs(n=200, n_outputs=6):
    """Return time, measured, mean and std of outputs whose intervals are honest."""
    time = np.arange(n) / 40.0
    mean = np.sin(time[:, None] * np.arange(1, n_outputs + 1))
    std = np.full((n, n_outputs), 0.2)
    return time, mean + std * default_rng(0).normal(size=mean.shape), mean, std


def flight(n=400):
    t = np.arange(n) / 10.0
    controls = {"throttle": 0.6, "elevator": 0.05 * np.sin(t), "rudder": 0.1 * np.cos(t)}
    return pd.DataFrame({"time": t, **controls})


def coefficients(n, ax, corrupt=lambda values: values):
    time, measured, mean, std = outputs(n)
    return TimeHistoryDisplay.from_predictions(
        time, corrupt(measured), mean, std, truth=mean, ax=ax
    )


def inputs(n, ax, corrupt=lambda values: values):
    table = flight(n)
    table[["elevator"]] = corrupt(table[["elevator"]].to_numpy())
    return TimeHistoryDisplay.from_inputs(table, ax=ax)


DISPLAYS = [coefficients, inputs]


def holes(values):
    values = values.copy()
    values[: len(values) // 2 + 1] = np.nan
    return values


def labels(display):
    display.figure_.draw_without_rendering()
    panels = [ax for ax in display.axes_.flat if ax.get_visible()]
    assert np.isfinite([[*ax.get_xlim(), *ax.get_ylim()] for ax in panels]).all()
    return [(ax.get_xlabel(), ax.get_ylabel()) for ax in panels]


def line(display, key, label):
    """Return the line of a label in the panel of a key."""
    cells = display.axes_.T if display.by_column else display.axes_
    ax = cells.flat[display.keys.index(key)]
    return {one.get_label(): one for one in ax.lines}[label]


def band(ax):
    """Return the corners of the only band of a panel."""
    (area,) = ax.collections
    return area.get_paths()[0].vertices


@pytest.mark.parametrize("make", DISPLAYS)
class TestEveryDisplay:
    def test_draws_into_a_given_figure_or_a_new_one_of_pyplot(self, make):
        before = set(plt.get_fignums())
        figure = Figure()
        assert make(200, figure).figure_ is figure
        assert set(plt.get_fignums()) == before
        figure.canvas.draw()
        new = make(50, None)
        assert {new.figure_.number} == set(plt.get_fignums()) - before
        plt.close(new.figure_)

    def test_poor_data_leave_labelled_panels(self, make):
        full = labels(make(50, Figure()))
        for corrupt in (holes, lambda values: np.full_like(values, np.nan), np.zeros_like):
            assert labels(make(50, Figure(), corrupt)) == full


class TestCoefficients:
    def test_lines_and_bands_are_the_data(self):
        time, measured, mean, std = outputs()
        display = TimeHistoryDisplay.from_predictions(
            time, measured, mean, std, truth=2 * mean, ax=Figure()
        )
        assert display.keys == list(COEFFICIENTS)
        drawn = {"measured": measured, "estimated": mean, "truth": 2 * mean}
        for label, values in drawn.items():
            assert_array_equal(line(display, "Cm", label).get_ydata(), values[:, 4])
        assert_array_equal(line(display, "Cm", "truth").get_xdata(), time)
        corners = {tuple(row) for row in band(display.axes_[1, 0]).round(5)}
        half = norm.ppf(0.975) * std[:, 1]
        for edge in (mean[:, 1] - half, mean[:, 1] + half):
            assert {tuple(row) for row in np.column_stack([time, edge]).round(5)} <= corners


def test_states_are_in_degrees_and_no_line_crosses_a_gap():
    time, _, mean, _ = outputs(100, 2)
    time = time + np.where(np.arange(100) < 50, 0.0, 60.0)
    display = TimeHistoryDisplay(time=time, names=("v_east", "p"), mean=mean).plot(Figure())
    shown = line(display, "p", "estimated").get_ydata()
    assert np.isnan(shown).sum() == 1
    assert_allclose(shown[~np.isnan(shown)], np.rad2deg(mean[:, 1]))
    assert_array_equal(line(display, "v_east", "estimated").get_ydata()[:50], mean[:50, 0])
