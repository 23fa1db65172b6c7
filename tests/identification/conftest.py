"""Flights of a delta wing with a throttle and two elevons."""

import warnings
from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from skdgp import listening
from skdgp.dynamics import Aircraft
from skdgp.identification import identify

INERTIA = np.diag([1.1, 2.3, 3.1])


@pytest.fixture(scope="session")
def delta():
    """Return the aircraft."""
    return Aircraft(name="delta", mass=12, inertia=INERTIA, wing_area=1.3, span=2.6, chord=0.55)


SURFACES = ["rudder", "elevon_left", "elevon_right"]


@pytest.fixture(scope="session")
def flights(delta):
    """Return a function to two flights of n samples each, and two coefficients that depend on their regressors."""

    def flights(n=300):
        rng = default_rng(0)
        t = np.arange(n) * 0.05
        columns = ["alpha", "beta", "p", "q", "r", *SURFACES]
        tables = []
        for k, name in enumerate("ab"):
            j = np.arange(len(columns))
            waves = 0.1 * np.sin(np.outer(t, 0.7 + 0.31 * j) + k + j)
            table = pd.DataFrame(waves + 0.002 * rng.normal(size=waves.shape), columns=columns)
            forces = {"ax": 0.5 + 0.1 * np.sin(1.3 * t), "ay": 0.1 * np.cos(t)}
            speed = {"airspeed": 20 + 2 * np.sin(0.3 * t + k), "throttle": 0.5 + 0.1 * np.sin(t)}
            down = -9.8 + 0.5 * np.sin(0.7 * t)
            tables.append(table.assign(time=t, flight=name, az=down, **forces, **speed))
        table = pd.concat(tables, ignore_index=True)
        alpha = table["alpha"]
        elevator = (table["elevon_left"] + table["elevon_right"]) / 2
        q_hat = table["q"] * delta.chord / (2 * table["airspeed"])
        CZ = -0.1 - 4 * alpha
        Cm = 0.02 - 0.5 * alpha - 8 * q_hat - 0.6 * elevator
        return table, pd.DataFrame({"CZ": CZ, "Cm": Cm}) + rng.normal(0, [0.01, 0.003], (2 * n, 2))

    return flights


class Stopped(Exception):
    """Raised where the flights are read and checked."""


@pytest.fixture(scope="session")
def said_of():
    """Return a function to what identify says of flights before it learns anything."""

    def stop(stage, *_):
        if stage == "coefficients":
            raise Stopped

    def said_of(*flights, **options):
        with warnings.catch_warnings(record=True) as shown, listening(stop), suppress(Stopped):
            warnings.simplefilter("always")
            identify(*flights, **options)
        return " ".join(str(warning.message) for warning in shown)

    return said_of
