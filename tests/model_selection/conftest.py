"""Flights whose coefficients are known, and a pipeline that learns them quickly."""

import numpy as np
import pandas as pd
import pytest

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft

AIRCRAFT = Aircraft(
    name="delta", mass=12.0, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55
)


def make_flights(names=("a", "b"), n=300, seed=0):
    """Flights at 20 Hz, and two coefficients that depend on their regressors."""
    rng = np.random.default_rng(seed)
    tables = []
    for k, name in enumerate(names):
        t = np.arange(n) * 0.05
        table = pd.DataFrame({"time": t, "flight": name, "airspeed": 20.0})
        for j, column in enumerate(["alpha", "q", "elevator"]):
            table[column] = 0.1 * np.sin((0.7 + 0.31 * j) * t + k + j) + 0.002 * rng.normal(size=n)
        tables.append(table)
    table = pd.concat(tables, ignore_index=True)
    Y = pd.DataFrame(
        {"CZ": -0.1 - 4 * table["alpha"], "Cm": -0.5 * table["alpha"] - 0.6 * table["elevator"]}
    )
    return table, Y + rng.normal(0, [0.01, 0.003], Y.shape)


@pytest.fixture
def flights():
    return make_flights


@pytest.fixture
def model():
    return make_identification_pipeline(
        AIRCRAFT,
        regressors=["alpha", "q_hat", "alpha_dot_hat", "elevator"],
        cutoff=3.0,
        mixer="passthrough",
        regressor=DependentGPRegressor(n_latent=1, optimizer=None, random_state=0),
    )
