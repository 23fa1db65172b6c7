"""Few points, the same picture."""

import numpy as np
import pytest

from skdgp.plotting._display import band_points, isolated, line_points, segment_starts


def noisy_record(n=30_000, seed=0):
    rng = np.random.default_rng(seed)
    return np.arange(n) / 40.0, np.cumsum(rng.normal(size=n)) + rng.normal(size=n)


def test_every_slice_keeps_its_extremes():
    time, values = noisy_record(3000)
    t, v = line_points(time, values, n_bins=50)
    for slice_ in values.reshape(50, -1):
        assert {slice_.min(), slice_.max()} <= set(v)
    assert len(t) <= 2 * 51 + 2
    assert (np.diff(t) > 0).all()


def test_lines_break_at_gaps_and_where_time_goes_back():
    time = np.array([0.0, 1, 2, 3, 100, 101, 102, 0, 1, 2])
    np.testing.assert_array_equal(segment_starts(time), [0, 4, 7])
    t, v = line_points(time, np.ones(10), n_bins=1000)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(v)), [4, 8])
    assert len(t) == 12


def test_holes_wide_enough_to_be_seen_break_the_line():
    time = np.arange(1000) / 10.0
    values = np.sin(time)
    values[300:400] = np.nan
    _, v = line_points(time, values, n_bins=100)
    assert np.count_nonzero(np.isnan(v)) == 1
    assert np.isnan(line_points(time, np.full(1000, np.nan), n_bins=100)[1]).sum() == 0


def test_a_band_covers_every_interval():
    time, centre = noisy_record(5000)
    half = 1 + np.abs(np.sin(time))
    t, low, high = band_points(time, centre - half, centre + half, n_bins=80)
    covered_low = np.interp(time, t, low)
    covered_high = np.interp(time, t, high)
    assert len(t) <= 2 * 82
    # Inside a slice the band is the union of its samples' intervals.
    assert (covered_low <= (centre - half) + 1e-12).all()
    assert (covered_high >= (centre + half) - 1e-12).all()
    assert low.min() == (centre - half).min()
    assert high.max() == (centre + half).max()


@pytest.mark.parametrize(
    ("values", "alone"),
    [
        ([1.0, np.nan, 2, 3], [0]),
        ([np.nan, 1, np.nan], [1]),
        ([1.0], [0]),
        ([1.0, 2], []),
        ([np.nan], []),
    ],
)
def test_isolated_values(values, alone):
    np.testing.assert_array_equal(isolated(np.array(values)), alone)
