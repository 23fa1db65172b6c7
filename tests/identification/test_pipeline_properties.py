"""What holds of the pipeline for every flight table: dtypes, index and order decide nothing."""

import warnings

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone

from skdgp import DependentGPRegressor, make_identification_pipeline

SURFACES = ["rudder", "elevon_left", "elevon_right"]
MOVING = ["airspeed", "alpha", "beta", "p", "q", "r", "throttle", *SURFACES]


@pytest.fixture(scope="module")
def learning(flights):
    """Return a table, and two coefficients that depend on it."""
    return flights(120)


@pytest.fixture(scope="module")
def pipeline(delta):
    """Hyperparameters that a fit starts from are enough to see what comes through."""
    options = {"structure": "joint", "n_latent": 1, "optimizer": None, "random_state": 0}
    regressor = DependentGPRegressor(**options)
    return make_identification_pipeline(delta, cutoff=3.0, regressor=regressor)


@pytest.fixture(scope="module")
def plain(pipeline, learning):
    """Return the predictions for the table as it is."""
    return clone(pipeline).fit(*learning).predict(learning[0], return_std=True)


# -- the same numbers in other clothes
# ---------------------------------------------------------------------

CLOTHES = {
    "columns in another order": lambda table, rng: table[list(rng.permutation(table.columns))],
    "an index of times": lambda table, rng: table.set_index(
        pd.to_datetime(table["time"], unit="s")
    ),
    "an index backwards": lambda table, rng: table.set_index(np.arange(len(table))[::-1]),
    "nullable floats": lambda table, rng: table.astype(dict.fromkeys(MOVING, "Float64")),
    "flights as categories": lambda table, rng: table.astype({"flight": "category"}),
    "flights as numbers": lambda table, rng: table.assign(
        flight=(table["flight"] == "latlon").astype(int) + 3
    ),
    "numbers of Arrow": lambda table, rng: table.astype(dict.fromkeys(MOVING, "double[pyarrow]")),
    "columns that nobody knows": lambda table, rng: table.assign(pilot="Amelia", comment=np.nan),
}


@pytest.mark.parametrize("clothes", CLOTHES)
def test_dtypes_index_and_order_of_columns_decide_nothing(clothes, learning, pipeline, plain):
    table, Y = learning
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "The indices of X and y differ", UserWarning)
        dressed = CLOTHES[clothes](table.copy(), default_rng(0))
        got = clone(pipeline).fit(dressed, Y).predict(dressed, return_std=True)
    assert_allclose(got, plain, rtol=1e-9)


def test_the_order_of_flights_decides_nothing(learning, pipeline, plain):
    table, Y = learning
    rows = np.r_[120:240, 0:120]
    turned = table.iloc[rows]
    model = clone(pipeline)
    got = model.fit(turned, Y.iloc[rows]).predict(turned, return_std=True)
    assert_allclose(got, np.stack(plain)[:, rows], rtol=1e-6)
