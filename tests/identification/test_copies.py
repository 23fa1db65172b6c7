"""A flight that is given twice teaches nothing the second time, and tells nothing as a test."""

import warnings
from contextlib import suppress

import numpy as np
import pytest

from skdgp import listening
from skdgp.datasets import load_example_flights
from skdgp.identification import identify

EXAMPLE = load_example_flights(duration=20.0)
NAMES = ("lateral", "latlon")
TRAIN = {
    name: EXAMPLE.train[EXAMPLE.train["flight"] == name].drop(columns="flight") for name in NAMES
}
TEST = EXAMPLE.test.drop(columns="flight")
LATER = TRAIN["latlon"].assign(time=TRAIN["latlon"]["time"] + 1000.0)
SENSORS = ["p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi"]


class Stopped(Exception):
    """Raised where the flights are read and checked."""


def stop(stage, *_):
    if stage == "coefficients":
        raise Stopped


def said_of(train, test):
    """Return what identify says of flights before it learns anything."""
    with warnings.catch_warnings(record=True) as shown, listening(stop), suppress(Stopped):
        warnings.simplefilter("always")
        identify(train, EXAMPLE.aircraft, test=test)
    return " ".join(str(warning.message) for warning in shown)


def part(rows):
    return LATER.iloc[rows].reset_index(drop=True)


def telemetry():
    """Other samples, at a fifth of the rate, with noise of their own; the clock is the vehicle's."""
    slow = TRAIN["latlon"].iloc[3:900:5].reset_index(drop=True)
    slow[SENSORS] += np.random.default_rng(0).normal(0.0, 0.01, (len(slow), len(SENSORS)))
    return slow


def test_other_flights_are_no_copies():
    assert "has the rows" not in said_of(TRAIN, {"test": TEST})


@pytest.mark.parametrize("copy", [part(slice(100, 600)), part(slice(None, None, 2)), telemetry()])
def test_a_copied_test_flight_beside_another_is_left_out(copy):
    said = said_of(TRAIN, {"again": copy, "test": TEST})
    assert "'again' has the rows of training flight 'latlon', and is left out" in said


def test_a_training_flight_that_comes_twice_counts_once():
    said = said_of({**TRAIN, "again": LATER}, {"test": TEST})
    assert "'latlon' has the rows of flight 'again'" in said


def test_a_copy_alone_is_told():
    said = said_of(TRAIN, {"again": LATER})
    assert "'again' has the rows of training flight 'latlon'" in said
    assert "left out" not in said
