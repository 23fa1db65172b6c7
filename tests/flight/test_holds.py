"""Channels that repeat their samples: their clock, and the rows that are no samples."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicSpline

from skdgp._flight.holds import (
    error_between_samples,
    find_holds,
    interpolated_rows,
)
from skdgp._flight.tables import FlightTable

STEP, PERIOD, N = 0.02, 5, 2000  # 10 Hz in a log of 50 Hz
TIME = 30.0 + STEP * np.arange(N)


def held(period=PERIOD):
    """Return flights of a channel sampled every ``period`` rows, which begins and ends steadily, and of noise."""
    fresh = np.arange(2, N, period)
    rows = np.maximum(np.searchsorted(fresh, np.arange(N), side="right") - 1, 0)
    samples = np.sin(2.0 * TIME[fresh])
    samples[:3], samples[-3:] = samples[3], samples[-4]
    slow = samples[rows]
    table = pd.DataFrame({"time": TIME, "elevator": slow, "p": default_rng(0).normal(size=N)})
    return FlightTable.of(table), fresh


def test_rate_and_rows_of_a_held_channel():
    """Also of samples that are equal: between changes the clock goes on."""
    flights, fresh = held()
    (hold,) = find_holds(flights, [("elevator",), ("p",)])
    assert hold.names == ["elevator"]
    assert hold.rate == pytest.approx(1 / (PERIOD * STEP), rel=0.02)
    assert_array_equal(np.flatnonzero(~hold.repeated), fresh)


def test_a_channel_that_changes_less_than_once_a_second_is_not_sampled_slowly():
    flights, _ = held(period=60)  # of 1.2 s
    assert not find_holds(flights, [("elevator",)])


def test_error_of_the_curve_is_half_of_the_curvature_between_samples():
    """And a parabola: of a channel x^2, whose second differences are 2."""
    samples = np.arange(0, 41, 4)
    number = np.arange(41) / 4
    error = error_between_samples(TIME[:41], number**2, samples)
    fraction = number % 1
    expected = 1.0 - (2 * fraction - 1) ** 2
    assert_allclose(error[8:-8], expected[8:-8], atol=1e-12)
    assert_allclose(error[samples], 0.0, atol=1e-12)


def test_a_channel_of_splines_shows_its_samples():
    knots = np.arange(1, N, PERIOD)
    values = default_rng(1).normal(size=len(knots))
    rows = np.arange(knots[0], knots[-1] + 1)
    curve = CubicSpline(TIME[knots], values)(TIME[rows])
    found = interpolated_rows(TIME[rows], curve)
    assert_array_equal(found, knots - knots[0])
    assert interpolated_rows(TIME, default_rng(2).normal(size=N)) is None
