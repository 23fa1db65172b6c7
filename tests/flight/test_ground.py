"""The rows of a table on the ground are found by an airspeed that carries no wing, and left out."""

import numpy as np
import pandas as pd
import pytest

from skdgp._compute.messages import FindingWarning
from skdgp._flight.ground import flying_airspeed, on_ground
from skdgp._flight.tables import FlightTable
from skdgp.io import read_flight

STEP = 0.1


def taxi_and_flight(seconds_on_ground, seconds_in_flight=60.0):
    """Return a table that stands at 3 m/s, accelerates within 8 s and flies at 30 to 40 m/s."""
    time = np.arange(-seconds_on_ground, seconds_in_flight, STEP)
    rolling = 3.0 + 27.0 * (time + 8.0) / 8.0
    flown = 35.0 + 5.0 * np.sin(time)
    airspeed = np.select([time < -8.0, time < 0.0], [3.0 + 0.5 * np.sin(7 * time), rolling], flown)
    return pd.DataFrame({"time": time, "airspeed": airspeed})


@pytest.mark.parametrize("seconds", [20.0, 60.0, 300.0])
def test_standing_and_rolling_rows(seconds):
    """However many rows stand; the roll counts up to half of the fast airspeed."""
    table = taxi_and_flight(seconds)
    ground = on_ground(FlightTable.of(table))
    assert ground[table["time"] < -6.0].all()
    assert not ground[table["time"] > -2.0].any()
    assert flying_airspeed(table["airspeed"].to_numpy()) == pytest.approx(35.0, abs=2.0)


@pytest.mark.parametrize("speeds", [(14.0, 33.0), (10.0, 20.0)])
def test_a_flight_at_many_speeds_has_no_ground(speeds):
    time = np.arange(0.0, 60.0, STEP)
    airspeed = np.mean(speeds) + np.ptp(speeds) / 2 * np.sin(0.2 * time)
    assert not on_ground(FlightTable.of(pd.DataFrame({"time": time, "airspeed": airspeed}))).any()


def test_a_dropout_of_a_second_is_no_ground():
    table = taxi_and_flight(0.0)
    table.loc[100:108, "airspeed"] = 0.1
    assert not on_ground(FlightTable.of(table)).any()


def test_a_table_is_read_without_its_ground(tmp_path):
    path = tmp_path / "sortie.csv"
    taxi_and_flight(60.0).to_csv(path, index=False)
    with pytest.warns(FindingWarning, match=r"'sortie.csv' 4\d % of the rows stand on the ground"):
        flown = read_flight(path)
    assert flown["airspeed"].min() > 15.0
    assert len(read_flight(path, airborne=False)) == 1200
