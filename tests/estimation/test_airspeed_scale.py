"""Error of the airspeed by legs of several headings in wind."""

import numpy as np
import pandas as pd
import pytest
from made_flights import circling, rms
from numpy.testing import assert_allclose
from scipy.stats import norm

from skdgp.estimation import (
    AIR_SENSOR_ERRORS,
    AirspeedScale,
    airspeed_scale,
)


@pytest.mark.parametrize("heading_error", [0.0, 0.1])
@pytest.mark.parametrize("scale", [-0.03, 0.02])
def test_a_steady_wind_shows_the_error(scale, heading_error):
    got = airspeed_scale(circling(scale, heading_error))
    assert_allclose(got.value, scale, rtol=0, atol=1e-9)
    assert got.removable() == got.value
    assert_allclose(got.left(), 0.0, atol=1e-9)


def test_each_flight_has_its_own_wind():
    other = circling(0.02).eval("time = time + 500\nv_north = v_north + 9")
    flights = pd.concat([circling(0.02).assign(flight="a"), other.assign(flight="b")])
    assert_allclose(airspeed_scale(flights.reset_index(drop=True)).value, 0.02, rtol=0, atol=1e-9)


def test_the_standard_deviation_is_that_of_the_errors():
    """Over gusts of 60 flights; an airspeed that is half too large shows in which unit it is."""
    found = [airspeed_scale(circling(0.5, gust=1.5, seed=seed)) for seed in range(60)]
    errors = np.array([(scale.value - 0.5) / scale.std for scale in found])
    assert abs(errors.mean()) < 4 / np.sqrt(60)
    assert 0.8 < rms(errors) < 1.25


def test_what_is_left_is_the_posterior_of_prior_and_band():
    """Root mean square, by quadrature of Bayes' rule; nothing, where the flights do not narrow the prior."""
    _, prior = AIR_SENSOR_ERRORS["airspeed_scale"]
    error, step = np.linspace(-8 * prior, 8 * prior, 20001, retstep=True)
    for value, std in ((0.01, 0.02), (-0.03, 0.025)):
        density = norm.pdf(error, 0.0, prior) * norm.pdf(value, error, std)
        density /= density.sum() * step
        expected = np.sqrt(np.sum(density * error**2) * step)
        assert_allclose(AirspeedScale(value, std).left(), expected, rtol=1e-6)
    assert AirspeedScale(0.01, 1.01 * prior).left() == 0.0


def test_what_is_left_of_an_error_is_that_of_its_estimate_where_it_is_removed():
    _, prior = AIR_SENSOR_ERRORS["airspeed_scale"]
    small, large = AirspeedScale(prior, prior), AirspeedScale(10 * prior, prior)
    assert small.removable() == 0.0
    assert_allclose(small.left(), np.sqrt(prior**2 / 4 + prior**2 / 2))  # of two equal variances
    assert large.removable() == large.value
    assert large.left() == prior


def test_one_heading_shows_nothing():
    straight = circling(0.02, gust=1.0, turns=0.0)
    got = airspeed_scale(straight)
    assert got.removable() == got.left() == 0.0
    assert airspeed_scale(straight.drop(columns="v_north")).left() == 0.0
