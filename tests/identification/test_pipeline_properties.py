"""What holds of the pipeline for every flight table: finite numbers or one error; dtypes and order decide nothing."""

import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
def fitted(pipeline, learning):
    """Return a model of the table as it is."""
    return clone(pipeline).fit(*learning)


@pytest.fixture(scope="module")
def plain(fitted, learning):
    """Return the predictions for the table as it is."""
    return fitted.predict(learning[0], return_std=True)


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
    with warnings.catch_warnings(action="error"):
        warnings.filterwarnings("ignore", "The indices of X and y differ", UserWarning)
        dressed = CLOTHES[clothes](table.copy(), default_rng(0))
        got = clone(pipeline).fit(dressed, Y).predict(dressed, return_std=True)
    assert_allclose(got, plain, rtol=1e-9)


VALUES = [np.nan, np.inf, 0.0, 1e300, -1e-300, 5.0]


def change_values(table, name, rows, rng):
    return table.assign(**{name: table[name].mask(rows, rng.choice(VALUES))})


# What is wrong with a column or with some rows; values first, then rows, then columns
FAULTS = [
    change_values,
    lambda table, name, rows, rng: table.assign(**{name: float(rng.normal())}),
    lambda table, name, rows, rng: table.assign(
        **{name: table[name] * 10.0 ** rng.integers(-9, 9)}
    ),
    lambda table, name, rows, rng: table.assign(flight=table["flight"].astype(object).mask(rows)),
    lambda table, name, rows, rng: table.assign(
        **{name: table[name].astype(object).mask(rows, "n/a")}
    ),
    lambda table, name, rows, rng: table[~rows],
    lambda table, name, rows, rng: pd.concat([table, table[rows]]),
    lambda table, name, rows, rng: table[::-1],
    lambda table, name, rows, rng: table[: rng.integers(0, 12)],
    lambda table, name, rows, rng: pd.concat([table, table[[name]]], axis=1),
    lambda table, name, rows, rng: table.drop(columns=name),
]


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**20),
    numbers=st.sets(st.integers(0, len(FAULTS) - 1), min_size=1, max_size=3),
    of_training=st.booleans(),
)
def test_a_faulty_table_gives_finite_numbers_or_one_error(
    learning, pipeline, fitted, seed, numbers, of_training
):
    """Faults of the flights learned from, or of those asked about; warnings are of the documented kind alone."""
    rng = default_rng(seed)
    table, Y = learning
    faulty = table
    for number in sorted(numbers):
        name = rng.choice([*MOVING, "time"])
        faulty = FAULTS[number](
            faulty, name, rng.random(len(faulty)) < rng.choice([0.01, 0.5, 1.0]), rng
        )
    with warnings.catch_warnings(action="error"):
        warnings.simplefilter("ignore", UserWarning)
        try:
            model = clone(pipeline).fit(faulty, Y.loc[faulty.index]) if of_training else fitted
            predicted = model.predict(table if of_training else faulty, return_std=True)
        except ValueError:  # other errors fail the test
            return
    assert np.isfinite(predicted).all()
    assert (predicted[1] >= 0).all()


@pytest.mark.parametrize(
    ("rows", "airspeed", "words"),
    [(0, 20.0, "no rows"), (240, "n/a", "type {'airspeed': .*numbers")],
)
def test_what_is_wrong_is_said(learning, pipeline, fitted, rows, airspeed, words):
    table, Y = learning
    wrong = table[:rows].assign(airspeed=airspeed)
    for use in (lambda: clone(pipeline).fit(wrong, Y[:rows]), lambda: fitted.predict(wrong)):
        with pytest.raises(ValueError, match=words):
            use()
