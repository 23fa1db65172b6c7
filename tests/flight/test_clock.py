"""Which rows are of which flight: one rule, whatever holds the names, and no row without one."""

import numpy as np
import pandas as pd
import pytest

from skdgp._flight.clock import Clock, flight_codes, true_runs
from skdgp._flight.tables import FlightTable
from skdgp._flight.units import check_flight
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification._flights import flights_of
from skdgp.io import FlightReadError, inspect_log, read_flight
from skdgp.preprocessing import (
    FlightCheck,
    FlightPathReconstruction,
    FlightSmoother,
    LagCorrector,
    inspect_flight,
)

MISSING = [None, np.nan, pd.NA, pd.NaT, "", "  "]
DTYPES = ["object", "string", "category", *["str"] * (int(pd.__version__.split(".")[0]) > 2)]
N = 60


def table(flight):
    """Two flights of 60 samples, every channel that something asks for."""
    time, noise = (
        np.tile(0.02 * np.arange(N), 2),
        np.random.default_rng(0).normal(0, 0.01, (2 * N, 13)),
    )
    names = [
        "alpha",
        "beta",
        "p",
        "q",
        "r",
        "ax",
        "ay",
        "phi",
        "theta",
        "psi",
        "v_north",
        "v_east",
        "v_down",
    ]
    columns = dict(zip(names, noise.T, strict=True))
    return pd.DataFrame(
        {"time": time, "airspeed": 20 + noise[:, 0], "az": -9.8, "density": 1.2, **columns}
    ).assign(flight=flight)


def holed(missing):
    return np.array([missing] * N + ["b"] * N, dtype=object)


# What asks for the flight of each row. A new one has a line here.
ASKING = {
    "Clock": lambda flights: Clock.of(flights["time"], flights["flight"]),
    "FlightTable": FlightTable.of,
    "check_flight": lambda flights: check_flight(flights, []),
    "aerodynamic_coefficients": lambda flights: aerodynamic_coefficients(flights, None),
    "inspect_flight": inspect_flight,
    "FlightCheck": lambda flights: FlightCheck().fit_transform(flights),
    "FlightSmoother": lambda flights: FlightSmoother(cutoff=2.0).fit_transform(flights),
    "LagCorrector": lambda flights: LagCorrector().fit(flights),
    "FlightPathReconstruction": lambda flights: FlightPathReconstruction().fit(flights),
    "identify": flights_of,
}


@pytest.mark.parametrize("asking", ASKING.values(), ids=ASKING)
def test_rows_without_a_flight_are_refused(asking):
    for dtype in DTYPES:
        with pytest.raises(
            ValueError,
            match=r"Got 60 of 120 rows without a flight \(the first is row 0\), but expect",
        ):
            asking(table(pd.Series(holed(None)).astype(dtype)))


@pytest.mark.parametrize("missing", MISSING, ids=repr)
def test_what_is_no_name(missing):
    with pytest.raises(ValueError, match="fill in these cells, or drop these rows"):
        flight_codes(holed(missing))


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("read", [read_flight, inspect_log])
def test_files_with_rows_without_a_flight(tmp_path, suffix, read):
    path, flights = tmp_path / f"log.{suffix}", table(holed(None))
    flights.to_csv(path, index=False) if suffix == "csv" else flights.to_parquet(path)
    with pytest.raises(
        FlightReadError, match=r"60 of 120 rows .* read_flight\(path, flight='name'\) names all"
    ):
        read(path)


def test_rows_of_flights_that_take_turns():
    clock = Clock.of([0.0, 0.0, 1.0, 1.0], ["b", "a", "b", "a"])
    rows = {name: part.tolist() for name, part in clock.rows.items()}
    assert rows == {"b": [0, 2], "a": [1, 3]}
    assert clock.part([1, 3]).names == ["a"]
    assert Clock.of([], []).rows == {}


def test_time_that_goes_back_within_a_flight_whose_rows_stand_apart_is_told(tmp_path):
    """Neighbours of different flights say nothing of it."""
    table = pd.DataFrame({"time": [0.0, 1.0, 0.0, 0.5, 1.0], "flight": list("aabab"), "alpha": 0.1})
    with pytest.raises(ValueError, match=r"Got time 0\.5 s after 1 s at row 3"):
        Clock.of(table["time"], table["flight"])
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(FlightReadError, match=r"Got time 0\.5 s after 1 s at row 3"):
        read_flight(tmp_path / "log.csv")


def test_runs_of_good_rows():
    good = np.array([1, 1, 0, 1, 1, 1, 0, 0, 1], dtype=bool)
    assert true_runs(good) == [slice(0, 2), slice(3, 6), slice(8, 9)]
    assert true_runs(good[:0]) == []


def test_rows_that_a_shuffled_kfold_left_out_are_named_as_such():
    rows = np.sort(np.random.default_rng(0).permutation(400)[:320])
    with pytest.raises(ValueError, match="shuffled KFold: hold out whole flights"):
        Clock.of(0.02 * rows).segments  # noqa: B018
