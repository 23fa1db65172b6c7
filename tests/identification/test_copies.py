"""A flight that is given twice teaches nothing the second time, and tells nothing as a test."""

import numpy as np
import pandas as pd
import pytest
from sklearn.utils import Bunch

from skdgp._flight.copies import copies
from skdgp._flight.tables import FlightTable

SENSORS = ["p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi"]


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


def part(rows):
    return lambda flights: flights.later.iloc[rows].reset_index(drop=True)


def telemetry(flights):
    """Other samples, at a fifth of the rate, with noise of their own; the clock is the vehicle's."""
    slow = flights.train["latlon"].iloc[3:640:5].reset_index(drop=True)
    slow[SENSORS] += np.random.default_rng(0).normal(0.0, 0.01, (len(slow), len(SENSORS)))
    return slow


ANGLES = {"elevator": "theta", "aileron": "phi", "rudder": "psi"}


@pytest.fixture
def doublets():
    """Return flights about one trim, by the surface whose doublet at 2 s decays in one angle."""
    time = np.arange(0.0, 20.0, 0.02)
    since = np.clip(time - 2.0, 0.0, None)
    response = 0.15 * np.exp(-since / 2.0) * np.sin(2.0 * since)
    flights = {}
    for seed, (surface, angle) in enumerate(ANGLES.items()):
        noise = np.random.default_rng(seed).normal(0.0, 0.001, (len(time), len(SENSORS)))
        table = pd.DataFrame(noise, columns=SENSORS).assign(time=time)
        table[angle] += response
        flights[surface] = table
    return flights


def test_doublets_of_different_surfaces_at_one_trim_are_no_copies(doublets):
    flights = {name: FlightTable.of(table) for name, table in doublets.items()}
    assert copies(flights, flights) == {}


def test_telemetry_of_a_doublet_is_a_copy(doublets):
    for name, table in doublets.items():
        sent = table.iloc[3::10].reset_index(drop=True)
        sent[SENSORS] += np.random.default_rng(3).normal(0.0, 0.001, (len(sent), len(SENSORS)))
        flights = {surface: FlightTable.of(flight) for surface, flight in doublets.items()}
        assert copies({"sent": FlightTable.of(sent)}, flights) == {"sent": name}


CHAINS = {
    "a log and its halves": ([(0, 1000), (0, 550), (450, 1000)], ["1", "2"]),
    "halves and their log": ([(0, 550), (450, 1000), (0, 1000)], ["2"]),
    "each overlaps the next": ([(0, 500), (200, 700), (400, 900)], ["1"]),
    "three of one": ([(0, 500), (0, 500), (0, 500)], ["2"]),
}


@pytest.mark.parametrize(("ranges", "kept"), CHAINS.values(), ids=CHAINS)
def test_of_a_chain_of_copies_what_was_copied_is_kept(ranges, kept, doublets):
    table = doublets["elevator"]
    flights = {}
    for name, (begin, end) in enumerate(ranges):
        flights[str(name)] = FlightTable.of(table.iloc[begin:end].reset_index(drop=True))
    found = copies(flights, flights)
    assert [name for name in flights if name not in found] == kept
    assert {*found.values()} <= {*kept}


@pytest.mark.parametrize("copy", [part(slice(100, 600)), part(slice(None, None, 2)), telemetry])
def test_a_copied_test_flight_beside_another_is_left_out(flights, copy, said_of):
    test = {"again": copy(flights), "test": flights.test}
    said = said_of(flights.train, flights.aircraft, test=test)
    assert said.count("its rows or its attitude") == 1  # the other flights are no copies
    assert (
        "'again' repeats training flight 'latlon' (its rows or its attitude), and is left out"
        in said
    )


def test_a_training_flight_that_comes_twice_counts_once(flights, said_of):
    train = {**flights.train, "again": flights.later}
    said = said_of(train, flights.aircraft, test={"test": flights.test})
    assert "'latlon' repeats flight 'again' (its rows or its attitude)" in said


def test_a_copy_alone_is_told(flights, said_of):
    said = said_of(flights.train, flights.aircraft, test={"again": flights.later})
    assert "'again' repeats training flight 'latlon' (its rows or its attitude)" in said
    assert "left out" not in said
