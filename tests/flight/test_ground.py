"""The rows of a table on the ground are found by an airspeed that carries no wing, and left out."""

import warnings

import numpy as np
import pandas as pd
import pytest

from skdgp.io import read_flight

STEP = 0.1


def taxi_and_flight(seconds_on_ground):
    """Return a table that stands at 3 m/s, accelerates within 8 s and flies at 30 to 40 m/s."""
    time = np.arange(-seconds_on_ground, 60.0, STEP)
    rolling = 3.0 + 27.0 * (time + 8.0) / 8.0
    flown = 35.0 + 5.0 * np.sin(time)
    airspeed = np.select([time < -8.0, time < 0.0], [3.0 + 0.5 * np.sin(7 * time), rolling], flown)
    return pd.DataFrame({"time": time, "airspeed": airspeed})


@pytest.fixture
def read(tmp_path):
    """Return a function from a table to its rows in the air, and those left out."""
    path = tmp_path / "sortie.csv"

    def read(table):
        table.to_csv(path, index=False)
        with warnings.catch_warnings(action="ignore"):
            flown = read_flight(path)["time"]
        return flown, np.setdiff1d(table["time"].round(6), flown.round(6))

    return read


@pytest.mark.parametrize("seconds", [20.0, 300.0])
def test_standing_and_rolling_rows_are_left_out(seconds, read):
    """However many rows stand; the roll counts up to half of the fast airspeed."""
    flown, left_out = read(taxi_and_flight(seconds))
    assert -3.4 < left_out.max() < flown.min() < -2.8


def flown_at(slow, fast):
    time = np.arange(0.0, 60.0, STEP)
    return pd.DataFrame({"time": time, "airspeed": slow + (fast - slow) * np.sin(0.1 * time) ** 2})


def with_dropout():
    table = taxi_and_flight(0.0)
    table.loc[100:108, "airspeed"] = 0.1
    return table


@pytest.mark.parametrize("table", [flown_at(10.5, 40.0), flown_at(10.0, 20.0), with_dropout()])
def test_many_speeds_and_a_dropout_are_no_ground(table, read):
    _, left_out = read(table)
    assert len(left_out) == 0
