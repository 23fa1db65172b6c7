"""A flight that is given twice teaches nothing the second time, and tells nothing as a test."""

import pytest
from flight_columns import EULER, FORCES, RATES
from numpy.random import default_rng
from sklearn.utils import Bunch

SENSORS = [*RATES, *FORCES, *EULER]


@pytest.fixture(scope="module")
def flights(first_minute):
    """Return the aircraft, two training flights, one of them also by a later clock, and a test flight, of 16 s."""
    data = first_minute()
    train = data.train[data.train["time"] < 16.0]
    tables = {name: table.drop(columns="flight") for name, table in train.groupby("flight")}
    lateral, latlon = (tables[name].reset_index(drop=True) for name in ("lateral", "latlon"))
    return Bunch(
        aircraft=data.aircraft,
        train={"lateral": lateral, "latlon": latlon},
        test=data.test[data.test["time"] < 16.0].drop(columns="flight"),
        later=latlon.assign(time=latlon["time"] + 1000.0),
    )


def telemetry(flights):
    """Other samples, at a fifth of the rate, with noise of their own; the clock is the vehicle's."""
    slow = flights.train["latlon"].iloc[3:640:5].reset_index(drop=True)
    slow[SENSORS] += default_rng(0).normal(0.0, 0.01, (len(slow), len(SENSORS)))
    return slow


def test_a_copied_test_flight_beside_another_is_left_out(flights, said_of):
    test = {"again": telemetry(flights), "test": flights.test}
    said = said_of(flights.train, flights.aircraft, test=test)
    assert said.count("its rows or its attitude") == 1  # the other flights are no copies
    assert (
        "'again' repeats training flight 'latlon' (its rows or its attitude), and is left out"
        in said
    )


def test_a_training_flight_that_comes_twice_counts_once(flights, said_of):
    train = {**flights.train, "again": flights.later}
    said = said_of(train, flights.aircraft, test={"test": flights.test})
    assert "'again' repeats flight 'latlon' (its rows or its attitude)" in said
