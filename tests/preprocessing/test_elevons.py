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


def test_parity_by_hand():
    out = ElevonSplitter().fit_transform(ELEVONS)
    assert_allclose(out.elevator, (ELEVONS.elevon_left + ELEVONS.elevon_right) / 2)
    assert_allclose(out.aileron, (ELEVONS.elevon_left - ELEVONS.elevon_right) / 2)


def test_more_surfaces_than_controls():
    surfaces = ("a_left", "a_right", "tail_left", "tail_right")
    mixing = [[0.5, -0.5, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 0.5, -0.5]]
    splitter = ElevonSplitter(
        surfaces=surfaces, controls=("aileron", "elevator", "rudder"), mixing=mixing
    )
    table = pd.DataFrame(RNG.normal(size=(8, 4)), columns=surfaces).assign(airspeed=30.0)
    out = splitter.fit_transform(table)
    assert_allclose(
        out[["aileron", "elevator", "rudder"]],
        table[list(surfaces)].to_numpy() @ np.transpose(mixing),
    )


def test_conventional_aircraft_passes_through():
    table = pd.DataFrame({"elevator": [0.1], "aileron": [0.2], "alpha": [0.05]})
    assert_frame_equal(ElevonSplitter().fit_transform(table), table)
    fitted = ElevonSplitter().fit(ELEVONS)
    assert_frame_equal(fitted.transform(table), table)
    without = table[["alpha"]]
    assert_frame_equal(ElevonSplitter().fit_transform(without), without)


def test_logged_controls_yield_to_the_surfaces():
    both = ELEVONS.assign(elevator=ELEVONS.mean(axis=1), aileron=7.0)
    out = ElevonSplitter().fit_transform(both)
    assert_allclose(out.aileron, (ELEVONS.elevon_left - ELEVONS.elevon_right) / 2)
    assert list(out.columns) == list(both.columns)


def test_neither_surfaces_nor_controls():
    with pytest.raises(ValueError, match=r"'elevon_left' \(nearest: 'elevon_l'\)"):
        ElevonSplitter().fit(pd.DataFrame({"elevon_l": [0.1], "elevon_r": [0.1], "alpha": [0.0]}))
    with pytest.raises(ValueError, match="elevon_right"):
        ElevonSplitter().fit(ELEVONS[["elevon_left"]])


def test_mixing_of_the_wrong_shape():
    with pytest.raises(ValueError, match=r"expected \(n_controls, n_surfaces\) = \(2, 2\)"):
        ElevonSplitter(mixing=[[1.0, 1.0, 0.0]]).fit(ELEVONS)
    with pytest.raises(ValueError, match=r"expected \(n_controls, n_surfaces\) = \(2, 3\)"):
        ElevonSplitter(surfaces=("a", "b", "c")).fit(ELEVONS)
