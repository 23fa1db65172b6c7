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
        flight=(table["flight"] == "b").astype(int) + 3
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


# -- whatever is wrong with a table: finite numbers, or an error that says what
# ----------------------------


def rows_of(rng, table):
    """Return a stretch of rows, short or long."""
    a = int(rng.integers(0, len(table)))
    return slice(a, a + int(rng.choice([1, 3, 30, 200])))


def one_of(rng, table, *more):
    """Return the name of a column that is there."""
    return str(rng.choice([name for name in (*more, *MOVING) if name in table]))


def put(value):
    """Return a fault that writes a value over a stretch of a column, or over all of it."""

    def fault(table, rng):
        name = one_of(rng, table, "time")
        where = slice(None) if rng.random() < 0.3 else rows_of(rng, table)
        table.iloc[where, table.columns.get_loc(name)] = value
        return table

    return fault


def stands_still(table, rng):
    name = one_of(rng, table)
    return table.assign(**{name: float(np.round(rng.normal(), 2))})


def in_other_units(table, rng):
    name = one_of(rng, table, "time")
    return table.assign(**{name: table[name] * 10.0 ** rng.integers(-12, 13)})


def lacks_a_column(table, rng):
    return table.drop(columns=one_of(rng, table, "time", "flight"))


def rows_are_lost(table, rng):
    return table.drop(index=table.index[rows_of(rng, table)])


def rows_stand_twice(table, rng):
    return pd.concat([table, table.iloc[rows_of(rng, table)]])


def rows_are_shuffled(table, rng):
    return table.iloc[rng.permutation(len(table))]


def has_words(table, rng):
    name = one_of(rng, table)
    return table.assign(**{name: table[name].astype(str).where(table.index != 3, "n/a")})


def flight_is_empty(table, rng):
    table["flight"] = table["flight"].astype(object)
    table.iloc[rows_of(rng, table), table.columns.get_loc("flight")] = [None, np.nan, pd.NA, ""][
        rng.integers(4)
    ]
    return table


def columns_of_one_name(table, rng):
    return pd.concat([table, table[[one_of(rng, table)]]], axis=1)


FAULTS = [  # in this order: values first, then rows, then columns
    *map(put, [np.nan, np.inf, -np.inf, 0.0, 1e300, -1e-300, 1e18, 5.0]),
    stands_still,
    in_other_units,
    flight_is_empty,
    rows_are_lost,
    rows_stand_twice,
    rows_are_shuffled,
    has_words,
    lacks_a_column,
    columns_of_one_name,
]


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**20),
    faults=st.sets(st.integers(0, len(FAULTS) - 1), min_size=1, max_size=3),
    of_training=st.booleans(),
)
def test_a_faulty_table_gives_finite_numbers_or_one_error(
    learning, pipeline, fitted, seed, faults, of_training
):
    """Faults of the flights learned from, or of those asked about; warnings are of the documented kind alone."""
    rng = default_rng(seed)
    table, Y = learning
    faulty = table
    for number in sorted(faults):
        faulty = FAULTS[number](faulty.copy(), rng) if len(faulty) else faulty
    targets = Y.loc[faulty.index]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UserWarning)
        try:
            if of_training:
                model = clone(pipeline).fit(faulty, targets)
                asked = table
            else:
                model = fitted
                asked = faulty
            mean, std = model.predict(asked, return_std=True)
        except ValueError:  # TypeError, IndexError, LinAlgError ... fail the test
            return
    assert mean.shape == std.shape == (len(asked), 2)
    assert np.isfinite(mean).all()
    assert np.isfinite(std).all()
    assert (std >= 0).all()


def test_the_order_of_flights_decides_nothing(learning, pipeline, plain):
    table, Y = learning
    rows = np.r_[120:240, 0:120]
    turned = table.iloc[rows]
    model = clone(pipeline)
    got = model.fit(turned, Y.iloc[rows]).predict(turned, return_std=True)
    assert_allclose(got, np.stack(plain)[:, rows], rtol=1e-6)
