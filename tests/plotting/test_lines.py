"""Lines with gaps, and long records as pictures."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from skdgp.plotting import TimeHistoryDisplay

TIME = np.arange(3000) / 10.0


def drawn(values, std=None, time=TIME):
    """Return the panel of one output, whose estimate is the values."""
    display = TimeHistoryDisplay.from_predictions(time, values, values, std, ax=Figure())
    return display.axes_[0, 0]


@pytest.mark.parametrize(("rows", "n_gaps"), [(slice(900, 1200), 1), (slice(None, None, 2), 0)])
def test_only_holes_wide_enough_to_be_seen_break_the_line(rows, n_gaps):
    values = np.sin(TIME)
    values[rows] = np.nan
    t, v = drawn(values).lines[0].get_data()
    assert np.count_nonzero(np.isnan(v)) == n_gaps
    assert_allclose(v[~np.isnan(v)], values[~np.isnan(values)])
    assert (np.diff(t[~np.isnan(t)]) > 0).all()


def test_nothing_known_is_no_line():
    x, _ = drawn(np.full(3000, np.nan)).lines[0].get_data()
    assert len(x) == 0


@pytest.mark.parametrize(("n", "is_picture"), [(3000, True), (900, False)])
def test_long_records_are_pictures(n, is_picture):
    values = np.sin(TIME[:n])
    ax = drawn(values, 0.1 + 0 * values, TIME[:n])
    assert {bool(artist.get_rasterized()) for artist in [*ax.lines, *ax.collections]} == {
        is_picture
    }
