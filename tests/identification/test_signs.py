"""Surfaces that move the other way than the autopilot's parameters say: the flights show it."""

import pytest

from skdgp.datasets import load_example_flights
from skdgp.identification._assumed import control_units, with_signs_of_flights
from skdgp.io import FULL_THROW
from skdgp.preprocessing import FlightDataWarning


@pytest.fixture(scope="module")
def flights():
    """45 s with all controls moving, without elevons, and a second flight."""
    train = load_example_flights().train
    flight = train[(train["flight"] == "latlon") & (train["time"] < 45)].reset_index(drop=True)
    left, right = flight.pop("elevon_left"), flight.pop("elevon_right")
    flight = flight.assign(elevator=(left + right) / 2 / 0.4, aileron=(left - right) / 2 / 0.4)
    return {"one": flight}, {"other": flight.iloc[:100]}


def test_right_signs_stay(flights):
    servos, *same = with_signs_of_flights(FULL_THROW, *flights)
    assert servos == FULL_THROW
    assert same[0]["one"] is flights[0]["one"]


@pytest.mark.parametrize("names", [["aileron"], ["elevator", "rudder"]])
def test_wrong_signs_are_turned_in_all_flights_and_kept(flights, names):
    wrong = [
        {k: t.assign(**{name: -t[name] for name in names}) for k, t in part.items()}
        for part in flights
    ]
    with pytest.warns(
        FlightDataWarning, match="move the other way than the autopilot's parameters say"
    ):
        servos, *turned = with_signs_of_flights(FULL_THROW, *wrong)
    assert sorted(servos.removeprefix("full throw, reversed ").split()) == names
    for part, right in zip(turned, flights, strict=True):
        for key, table in part.items():
            assert table.equals(right[key])
    assert control_units(servos)["rudder"] == FULL_THROW
    assert with_signs_of_flights(servos, *turned)[0] == servos  # what is told is believed
    assert with_signs_of_flights("servo.toml", *wrong)[0] == "servo.toml"
