"""Which rows are of which flight: one rule, whatever holds the names, and no row without one."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import EULER, RATES, VELOCITY
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.dynamics import aerodynamic_coefficients
from skdgp.estimation import flights_of
from skdgp.identification import named_flights
from skdgp.io import FlightReadError, inspect_log, read_flight
from skdgp.preprocessing import (
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
    inspect_flight,
)

MISSING = [None, np.nan, pd.NA, pd.NaT, "", "  "]
DTYPES = ["string", "category", *["str"] * (int(pd.__version__.split(".")[0]) > 2)]
N = 60
NAMES = ["alpha", "beta", "ax", "ay", *RATES, *EULER, *VELOCITY]


def table(flight):
    """Two flights of 60 samples, every channel that something asks for."""
    noise = default_rng(0).normal(0, 0.01, (2 * N, len(NAMES)))
    time = np.tile(0.02 * np.arange(N), 2)
    others = {"airspeed": 20 + noise[:, 0], "az": -9.8, "density": 1.2}
    return pd.DataFrame(noise, columns=NAMES).assign(time=time, flight=flight, **others)


def holed(missing):
    return np.array([missing] * N + ["b"] * N, dtype=object)


# What asks for the flight of each row. A new one has a line here.
ASKING = {
    "aerodynamic_coefficients": lambda flights: aerodynamic_coefficients(flights, None),
    "inspect_flight": inspect_flight,
    "FlightCheck": FlightCheck().fit_transform,
    "FlightSmoother": FlightSmoother(cutoff=2.0).fit_transform,
    "LagCorrector": LagCorrector().fit,
    "FlightPathReconstruction": FlightPathReconstruction().fit,
    "state estimation": flights_of,
    "identify": named_flights,
}


@pytest.mark.parametrize("asking", ASKING.values(), ids=ASKING)
def test_rows_without_a_flight_are_refused(asking):
    words = r"Got 60 of 120 rows without a flight \(the first is row 0\), but expect"
    with pytest.raises(ValueError, match=words):
        asking(table(holed(None)))


@pytest.mark.parametrize(
    ("missing", "dtype"),
    [*((missing, object) for missing in MISSING), *((None, dtype) for dtype in DTYPES)],
    ids=repr,
)
def test_what_is_no_name(missing, dtype):
    with pytest.raises(ValueError, match="fill in these cells, or drop these rows"):
        inspect_flight(table(pd.Series(holed(missing)).astype(dtype)))


def test_rows_of_flights_that_take_turns_are_refused():
    """They have no rate."""
    flights = table(np.repeat(["b", "a"], N)).sort_values("time", ignore_index=True)
    with pytest.raises(ValueError, match=r"2 flights that alternate, .* sort by flight, then by"):
        flights_of(flights)
    assert [flight.name for flight in flights_of(flights.sort_values(["flight", "time"]))] == [
        "a",
        "b",
    ]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("read", [read_flight, inspect_log])
def test_files_with_rows_without_a_flight(tmp_path, suffix, read):
    path = tmp_path / f"log.{suffix}"
    flights = table(holed(None))
    flights.to_csv(path, index=False) if suffix == "csv" else flights.to_parquet(path)
    with pytest.raises(FlightReadError, match="60 of 120 rows without a flight"):
        read(path)


def test_time_that_goes_back_within_a_flight_whose_rows_stand_apart_is_told(tmp_path):
    """Neighbours of different flights say nothing of it."""
    table = pd.DataFrame({"time": [0.0, 1.0, 0.0, 0.5, 1.0], "flight": list("aabab"), "alpha": 0.1})
    words = r"Got time 0\.5 s after 1 s at row 3"
    with pytest.raises(ValueError, match=words):
        inspect_flight(table)
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(FlightReadError, match=words):
        read_flight(tmp_path / "log.csv")


def test_rows_that_a_shuffled_kfold_left_out_are_named_as_such():
    rows = np.sort(default_rng(0).permutation(400)[:320])
    flight = pd.DataFrame({"time": 0.02 * rows, "alpha": 0.1})
    with pytest.raises(ValueError, match="shuffled KFold: hold out whole flights"):
        FlightSmoother(cutoff=2.0).fit_transform(flight)


@pytest.mark.parametrize(
    ("every", "late", "refused"), [(9, 0.49, False), (9, 0.51, True), (11, 0.51, False)]
)
def test_a_tenth_of_the_steps_may_be_uneven_by_half(every, late, refused):
    steps = np.full(400, 0.02)
    steps[::every] *= 1 + late
    flight = pd.DataFrame({"time": np.cumsum(steps), "alpha": 0.1})
    smoother = FlightSmoother(cutoff=2.0).fit(flight)
    if refused:
        with pytest.raises(ValueError, match=r"nearly constant rate .*one uniform clock"):
            smoother.transform(flight)
    else:
        assert_allclose(smoother.transform(flight).alpha, 0.1)
