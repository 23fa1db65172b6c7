"""Parity of surfaces: mixing, and what happens when a table has both or neither."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from skdgp.preprocessing import ElevonSplitter

RNG = default_rng(0)
ELEVONS = pd.DataFrame(RNG.uniform(-0.3, 0.3, (20, 2)), columns=["elevon_left", "elevon_right"])


def test_more_surfaces_than_controls():
    mixing = {
        "aileron": {"a_left": 0.5, "a_right": -0.5},
        "elevator": {"tail_left": 0.5, "tail_right": 0.5},
        "rudder": {"tail_left": 0.5, "tail_right": -0.5},
    }
    surfaces = ["a_left", "a_right", "tail_left", "tail_right"]
    table = pd.DataFrame(RNG.normal(size=(8, 4)), columns=surfaces).assign(airspeed=30.0)
    out = ElevonSplitter(mixing).fit_transform(table)
    for control, factors in mixing.items():
        assert_allclose(out[control], sum(factors[name] * table[name] for name in factors))


def test_conventional_aircraft_passes_through():
    table = pd.DataFrame({"elevator": [0.1], "aileron": [0.2], "alpha": [0.05]})
    assert_frame_equal(ElevonSplitter().fit_transform(table), table)
    assert ElevonSplitter().fit(table).in_simulation() == {}
    fitted = ElevonSplitter().fit(ELEVONS)
    assert fitted.in_simulation()["mixing"].surfaces == ("elevon_left", "elevon_right")
    assert list(fitted.get_feature_names_out()) == list(fitted.transform(ELEVONS))
    assert_frame_equal(fitted.transform(table), table)
    without = table[["alpha"]]
    assert_frame_equal(ElevonSplitter().fit_transform(without), without)


def test_logged_controls_yield_to_the_surfaces():
    both = ELEVONS.assign(elevator=-7.0, aileron=7.0)
    out = ElevonSplitter().fit_transform(both)
    assert_allclose(out.elevator, (ELEVONS.elevon_left + ELEVONS.elevon_right) / 2)
    assert_allclose(out.aileron, (ELEVONS.elevon_left - ELEVONS.elevon_right) / 2)
    assert list(out.columns) == list(both.columns)


def test_neither_surfaces_nor_controls():
    with pytest.raises(ValueError, match=r"'elevon_left' \(nearest: 'elevon_l'\)"):
        ElevonSplitter().fit(pd.DataFrame({"elevon_l": [0.1], "elevon_r": [0.1], "alpha": [0.0]}))
    with pytest.raises(ValueError, match="elevon_right"):
        ElevonSplitter().fit(ELEVONS[["elevon_left"]])


@pytest.mark.parametrize(
    "mixing",
    [{}, {"elevator": {}}, {"elevator": [0.5, 0.5]}, {"elevator": {"elevon_left": np.nan}}],
)
def test_what_is_no_mixing(mixing):
    with pytest.raises(ValueError, match="expected for each control the surfaces that move it"):
        ElevonSplitter(mixing).fit(ELEVONS)
