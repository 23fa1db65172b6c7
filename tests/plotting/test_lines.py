"""Few points, the same picture."""

import numpy as np

from skdgp.plotting._display import N_SLICES, band_points, line_points, segment_starts


def noisy_record(n=30_000, seed=0):
    rng = np.random.default_rng(seed)
    return np.arange(n) / 40.0, np.cumsum(rng.normal(size=n)) + rng.normal(size=n)


def test_every_slice_keeps_its_extremes():
    time, values = noisy_record(50 * N_SLICES)
    t, v = line_points(time, values, segment_starts(time))
    for slice_ in values.reshape(N_SLICES, -1):
        assert {slice_.min(), slice_.max()} <= set(v)
    assert len(t) <= 2 * N_SLICES
    assert (np.diff(t) > 0).all()


def test_holes_wide_enough_to_be_seen_break_the_line():
    time = np.arange(3000) / 10.0
    values = np.sin(time)
    values[900:1200] = np.nan
    _, v = line_points(time, values, np.array([0]))
    assert np.count_nonzero(np.isnan(v)) == 1
    assert len(line_points(time, np.full(3000, np.nan), np.array([0]))[1]) == 0


def test_a_band_covers_every_interval():
    time, centre = noisy_record(5000)
    half = 1 + np.abs(np.sin(time))
    t, low, high = band_points(time, centre - half, centre + half, np.array([0]))
    covered_low = np.interp(time, t, low)
    covered_high = np.interp(time, t, high)
    assert len(t) <= 2 * (N_SLICES + 13)
    # Inside a slice the band is the union of its samples' intervals.
    assert (covered_low <= (centre - half) + 1e-12).all()
    assert (covered_high >= (centre + half) - 1e-12).all()
    assert low.min() == (centre - half).min()
    assert high.max() == (centre + half).max()
