"""A flight that is given twice teaches nothing the second time, and tells nothing as a test."""

import pandas as pd
import pytest


@pytest.fixture(scope="module")
def data(first_minute):
    """Return 16 s of the example flights, and one of them by a later clock."""
    data = first_minute()
    data.train = data.train[data.train["time"] < 16.0]
    data.test = data.test[data.test["time"] < 16.0]
    latlon = data.train[data.train["flight"] == "latlon"]
    data.again = latlon.assign(time=latlon["time"] + 1000.0, flight="again")
    return data


def test_a_copied_test_flight_beside_another_is_left_out(data, said_of):
    said = said_of(data.train, data.aircraft, test=pd.concat([data.again, data.test]))
    assert said.count("its rows or its attitude") == 1  # the other flights are no copies
    assert (
        "'again' repeats training flight 'latlon' (its rows or its attitude), and is left out"
        in said
    )


def test_a_training_flight_that_comes_twice_counts_once(data, said_of):
    said = said_of(pd.concat([data.train, data.again]), data.aircraft, test=data.test)
    assert "'again' repeats flight 'latlon' (its rows or its attitude)" in said


def test_a_copy_alone_is_told(data, said_of):
    said = said_of(data.train, data.aircraft, test=data.again)
    assert "'again' repeats training flight 'latlon' (its rows or its attitude)" in said
    assert "left out" not in said
