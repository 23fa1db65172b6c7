"""Error of the airspeed by legs of several headings in wind."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.estimation import AirspeedScale, PathSettings, airspeed_scale

SPEED = 22.0


def circling(scale=0.0, heading_error=0.0, gust=0.0, turns=2.0):
    """Return a level flight of some turns in wind and gusts, whose nose points into its motion through the air."""
    time = np.arange(0, 120, 0.1)
    psi = 2 * np.pi * turns * time / time[-1]
    gusts = gust * default_rng(3).standard_normal((2, len(time)))
    return pd.DataFrame(
        {
            "time": time,
            "airspeed": (1 + scale) * SPEED,
            "alpha": 0.05,
            "beta": 0.0,
            "phi": 0.0,
            "theta": 0.05,
            "psi": psi + heading_error,
            "v_north": SPEED * np.cos(psi) + 6.0 + gusts[0],
            "v_east": SPEED * np.sin(psi) - 3.0 + gusts[1],
            "v_down": 0.0,
        }
    )


@pytest.mark.parametrize("heading_error", [0.0, 0.1])
@pytest.mark.parametrize("scale", [-0.03, 0.02])
def test_a_steady_wind_shows_the_error(scale, heading_error):
    got = airspeed_scale(circling(scale, heading_error))
    assert got.value == pytest.approx(scale, abs=1e-9)
    assert got.removable() == got.value
    assert_allclose(got.left(), 0.0, atol=1e-9)


def test_each_flight_has_its_own_wind():
    other = circling(0.02).eval("time = time + 500\nv_north = v_north + 9")
    flights = pd.concat([circling(0.02).assign(flight="a"), other.assign(flight="b")])
    assert airspeed_scale(flights.reset_index(drop=True)).value == pytest.approx(0.02, abs=1e-9)


def test_gusts_make_a_band_that_holds_the_error():
    got = airspeed_scale(circling(0.02, gust=1.5))
    assert 0 < got.std < 0.01
    assert abs(got.value - 0.02) < 3 * got.std


def test_what_is_left_of_an_error_is_that_of_its_estimate_where_it_is_removed():
    prior = PathSettings().airspeed_scale
    small, large = AirspeedScale(prior, prior), AirspeedScale(10 * prior, prior)
    assert small.removable() == 0.0
    assert small.left() == pytest.approx(
        np.sqrt(prior**2 / 4 + prior**2 / 2)
    )  # of two equal variances
    assert large.removable() == large.value
    assert large.left() == prior


def test_one_heading_shows_nothing():
    straight = circling(0.02, gust=1.0, turns=0.0)
    got = airspeed_scale(straight)
    assert got.removable() == got.left() == 0.0
    assert airspeed_scale(straight.drop(columns="v_north")).left() == 0.0
