"""Which rows are of which flight: one rule, whatever holds the names, and no row without one."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_array_equal

from skdgp.dynamics import aerodynamic_coefficients
from skdgp.estimation import flights_of
from skdgp.identification import named_flights
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
NAMES = [
    *("alpha", "beta", "p", "q", "r", "ax", "ay"),
    *("phi", "theta", "psi", "v_north", "v_east", "v_down"),
]


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


def test_rows_of_flights_that_take_turns():
    flights = table(np.repeat(["b", "a"], N)).sort_values("time", ignore_index=True)
    rows = {flight.name: flight.rows for flight in flights_of(flights)}
    assert list(rows) == list(dict.fromkeys(flights["flight"]))
    for name, expected in rows.items():
        assert_array_equal(np.flatnonzero(flights["flight"] == name), expected)
