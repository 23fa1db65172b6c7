"""Flights of a delta wing with a throttle and two elevons."""

import warnings
from contextlib import suppress

import pytest
from flight_columns import AIR, FORCES, RATES

from skdgp import listening
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import identify

MEASURED = ["time", "flight", *AIR, *RATES, *FORCES]
MEASURED += ["throttle", "rudder", "elevon_left", "elevon_right"]


@pytest.fixture(scope="session")
def delta(first_minute):
    """Return the aircraft."""
    return first_minute().aircraft


@pytest.fixture(scope="session")
def flights(first_minute):
    """Return a function to n rows of two flights, without attitude and thrust, and two measured coefficients."""

    def flights(n=300):
        data = first_minute()
        train = data.train.groupby("flight", observed=True).nth(range(1000, 1000 + n))
        train = train.reset_index(drop=True)
        return train[MEASURED], aerodynamic_coefficients(train, data.aircraft, cutoff=3.0)[
            ["CZ", "Cm"]
        ]

    return flights


class Stopped(Exception):
    """Raised where the flights are read and checked."""


@pytest.fixture(scope="session")
def said_of():
    """Return a function to what identify says of flights before it learns anything."""

    def stop(stage, *_):
        if stage == "transforming":
            raise Stopped

    def said_of(*flights, **options):
        with warnings.catch_warnings(record=True) as shown, listening(stop), suppress(Stopped):
            warnings.simplefilter("always")
            identify(*flights, **options)
        return " ".join(str(warning.message) for warning in shown)

    return said_of
