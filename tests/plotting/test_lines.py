"""Few points, the same picture."""

import numpy as np
from matplotlib.figure import Figure
from numpy.random import default_rng
from scipy.stats import norm

from skdgp.plotting import TimeHistoryDisplay

N_SLICES = 300  # of a long record, each drawn with its lowest and its highest sample


def noisy_record(n):
    rng = default_rng(0)
    return np.arange(n) / 40.0, np.cumsum(rng.normal(size=n)) + rng.normal(size=n)


def drawn(time, values, std=None):
    """Return the panel of one output, whose estimate is the values."""
    display = TimeHistoryDisplay.from_predictions(time, values, values, std, ax=Figure())
    return display.axes_[0, 0]


def line(time, values):
    return drawn(time, values).lines[0].get_data()


def test_every_slice_keeps_its_extremes():
    time, values = noisy_record(50 * N_SLICES)
    t, v = line(time, values)
    for slice_ in values.reshape(N_SLICES, -1):
        assert {slice_.min(), slice_.max()} <= set(v)
    assert len(t) <= 2 * N_SLICES
    assert (np.diff(t) > 0).all()


def test_holes_wide_enough_to_be_seen_break_the_line():
    time = np.arange(3000) / 10.0
    values = np.sin(time)
    values[900:1200] = np.nan
    _, v = line(time, values)
    assert np.count_nonzero(np.isnan(v)) == 1
    _, nothing = line(time, np.full(3000, np.nan))
    assert len(nothing) == 0


def test_a_band_covers_every_interval():
    time, centre = noisy_record(5000)
    std = 1 + np.abs(np.sin(time))
    half = norm.ppf(0.975) * std
    (area,) = drawn(time, centre, std).collections
    corners = area.get_paths()[0].vertices
    top = len(corners) // 2
    assert top <= 2 * (N_SLICES + 13) + 1
    # Inside a slice the band is the union of its samples' intervals.
    lower = corners[:top]
    upper = corners[top:][::-1]
    low = centre - half
    high = centre + half
    assert (np.interp(time, *lower[np.argsort(lower[:, 0], kind="stable")].T) <= low + 1e-12).all()
    assert (np.interp(time, *upper[np.argsort(upper[:, 0], kind="stable")].T) >= high - 1e-12).all()
    assert corners[:, 1].min() == low.min()
    assert corners[:, 1].max() == high.max()
