"""Slopes by earlier controls, of regressors with noise, against the slopes that were put in."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_less
from scipy.signal import lfilter
from sklearn.linear_model import LinearRegression

from skdgp._flight.clock import Clock
from skdgp.identification._instruments import by_instruments

STEP = 0.02
SLOPES = np.array([[-0.4, 0.2], [0.05, -0.3]])  # of two outputs by rate and aileron


def flown(seed, gust, n=5000, split=None):
    """Return rate and aileron, and two outputs of the rate relative to air that rolls by ``gust`` times as much.

    The rate follows steps of the aileron with a lag of 0.2 s, and the air as far as that lets it.
    """
    rng = default_rng(seed)
    aileron = np.repeat(rng.normal(size=n // 25), 25)
    air = gust * lfilter([1], [1, -0.8], rng.normal(size=n))
    decay = np.exp(-STEP / 0.2)
    rate = lfilter([0, 1 - decay], [1, -decay], aileron + air)
    regressors = pd.DataFrame({"p": rate, "aileron": aileron})
    felt = np.column_stack([rate - air, aileron])
    Y = felt @ SLOPES.T + 0.01 * rng.normal(size=(n, 2))
    flight = None if split is None else np.arange(n) // split
    return regressors, Y, Clock.of(STEP * np.arange(n), flight)


def found_by(regressors, Y, clock):
    """Return the slopes of the function that least squares learns."""
    learned = LinearRegression().fit(regressors, Y).predict(regressors)
    return by_instruments(regressors, Y, learned, clock)


@pytest.mark.parametrize("split", [None, 1000])
def test_noise_flattens_slopes_by_least_squares_and_not_by_instruments(split):
    regressors, Y, clock = flown(0, 0.3, split=split)
    found = found_by(regressors, Y, clock)
    rows = clock.elapsed > 1.5
    X = np.column_stack([np.ones(rows.sum()), regressors[rows]])
    by_all = np.linalg.lstsq(X, Y[rows], rcond=None)[0][1:].T
    assert abs(by_all[0, 0] / SLOPES[0, 0]) < 0.8
    std = np.linalg.norm(found.errors, axis=-1)
    assert_array_less(np.abs(found.value - SLOPES), 3 * std + 0.003)


def test_without_noise_slopes_are_those_by_least_squares_half_of_the_time():
    """The statistic T has the mean k, below which nothing is added."""
    is_same = []
    for seed in range(20):
        regressors, Y, clock = flown(seed, 0.0)
        found = found_by(regressors, Y, clock)
        by_all = LinearRegression().fit(regressors, Y).coef_
        is_same += np.isclose(found.value, by_all, rtol=1e-9).all(axis=1).tolist()
    assert np.mean(is_same) > 0.4


def test_an_effect_that_regressors_lack_makes_slopes_by_instruments_less_certain():
    """A flow that follows the aileron 0.2 s later is no noise of the rate."""
    regressors, Y, clock = flown(0, 0.0)
    later = Y + 0.1 * np.outer(np.roll(regressors["aileron"], 10), SLOPES[:, 1])
    found = found_by(regressors, later, clock)
    assert_allclose(found.value, LinearRegression().fit(regressors, later).coef_, rtol=1e-9)
    errors = [np.linalg.norm(found_by(regressors, y, clock).errors) for y in (Y, later)]
    assert errors[1] > 5 * errors[0]


def test_a_function_that_lacks_nothing_keeps_its_slopes():
    """Of outputs that are not linear instruments tell other slopes than least squares, too, less certainly."""
    regressors, Y, clock = flown(0, 0.3)
    curved = Y + 2.0 * regressors.to_numpy() ** 2
    found = by_instruments(regressors, curved, curved, clock)
    assert np.linalg.norm(found.errors) > 2 * np.linalg.norm(found_by(regressors, Y, clock).errors)
    assert_allclose(found.value, LinearRegression().fit(regressors, curved).coef_, rtol=1e-9)


def test_errors_of_different_outputs_are_independent():
    errors = found_by(*flown(0, 0.3)).errors
    assert (np.linalg.norm(errors, axis=-1) > 0).all()
    assert_allclose(errors[0] @ errors[1].T, 0.0, atol=1e-15)


def test_a_control_and_enough_rows_are_needed():
    regressors, Y, clock = flown(0, 0.3, n=175)
    assert found_by(regressors, Y, clock) is None
    regressors, Y, clock = flown(0, 0.3)
    for name in regressors:
        assert found_by(regressors[[name]], Y, clock) is None
