"""A flight that is given twice teaches nothing the second time, and tells nothing as a test."""

import numpy as np
import pytest

from skdgp._compute.messages import FindingWarning
from skdgp._flight.channels import EULER, RATES, SPECIFIC_FORCE
from skdgp.datasets import load_example_flights
from skdgp.identification._flights import copies, named_flights
from skdgp.identification._prepare import prepare

EXAMPLE = load_example_flights(duration=20.0)
NAMES = ("lateral", "latlon")
TRAIN = {
    name: EXAMPLE.train[EXAMPLE.train["flight"] == name].drop(columns="flight") for name in NAMES
}
TEST = EXAMPLE.test.drop(columns="flight")
LATER = TRAIN["latlon"].assign(time=TRAIN["latlon"]["time"] + 1000.0)


def prepared(flights, test):
    return prepare(flights, test, EXAMPLE.aircraft, regressors="quasi-steady", reading={})


def test_other_flights_are_no_copies():
    flights = named_flights(TRAIN)
    assert copies(flights, flights) == copies(named_flights({"test": TEST}), flights) == {}


@pytest.mark.parametrize("rows", [slice(None), slice(100, 600), slice(None, None, 2)])
def test_a_part_at_another_time_is_a_copy(rows):
    part = LATER.iloc[rows].reset_index(drop=True)
    assert copies(named_flights({"again": part}), named_flights(TRAIN)) == {"again": "latlon"}


def test_telemetry_of_a_flight_is_a_copy():
    """Its samples are others, at a fifth of the rate, with noise of their own; the clock is the vehicle's."""
    slow = TRAIN["latlon"].iloc[3:900:5].reset_index(drop=True)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (len(slow), 9))
    slow[[*RATES, *SPECIFIC_FORCE, *EULER]] += noise
    telemetry = named_flights({"telemetry": slow})
    assert copies(telemetry, named_flights(TRAIN)) == {"telemetry": "latlon"}


def test_a_training_flight_that_comes_twice_counts_once():
    with pytest.warns(FindingWarning, match="'latlon' has the rows of flight 'again'"):
        flights = prepared({**TRAIN, "again": LATER}, {"test": TEST})
    assert [*flights.train] == ["lateral", "again"]


def test_a_copied_test_flight_beside_another_is_left_out():
    with pytest.warns(
        FindingWarning, match="'again' has the rows of training flight 'latlon', and is left out"
    ):
        flights = prepared(TRAIN, {"again": LATER, "test": TEST})
    assert [*flights.test] == ["test"]


def test_a_copy_alone_is_told():
    with pytest.warns(FindingWarning, match="'again' has the rows of training flight 'latlon'"):
        assert [*prepared(TRAIN, {"again": LATER}).test] == ["again"]
