"""What holds of the pipeline for every flight table: finite numbers or one error; dtypes and order decide nothing."""

import functools
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft

AIRCRAFT = Aircraft(
    name="delta", mass=12.0, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55
)
SURFACES = ["rudder", "elevon_left", "elevon_right"]
MOVING = ["airspeed", "alpha", "beta", "p", "q", "r", "throttle", *SURFACES]


def flights(n=120):
    """Return two flights and two coefficients that depend on what they hold."""
    rng = default_rng(0)
    tables = []
    for k, name in enumerate(["monday", "tuesday"]):
        t = np.arange(n) * 0.05 + 7.0 * k
        table = pd.DataFrame({"time": t, "flight": name, "airspeed": 20 + 2 * np.sin(0.3 * t + k)})
        for j, column in enumerate(["alpha", "beta", "p", "q", "r", *SURFACES]):
            table[column] = 0.1 * np.sin((0.7 + 0.31 * j) * t + k + j) + 0.002 * rng.normal(size=n)
        tables.append(table.assign(throttle=0.5 + 0.1 * np.sin(t)))
    table = pd.concat(tables, ignore_index=True)
    Y = pd.DataFrame(
        {"CZ": -0.1 - 4 * table["alpha"], "Cm": -0.5 * table["alpha"] - 0.6 * table["elevon_left"]}
    )
    return table, Y + rng.normal(0, [0.01, 0.003], Y.shape)


def pipeline():
    """Hyperparameters that a fit starts from are enough to see what comes through."""
    return make_identification_pipeline(
        AIRCRAFT,
        cutoff=3.0,
        regressor=DependentGPRegressor(n_latent=1, optimizer=None, random_state=0),
    )


@functools.cache
def fitted():
    """Return a model of the table as it is."""
    return pipeline().fit(*flights())


@functools.cache
def plain():
    """Return the predictions for the table as it is."""
    return fitted().predict(flights()[0], return_std=True)


# -- the same numbers in other clothes
# ---------------------------------------------------------------------

CLOTHES = {
    "columns in another order": lambda table, rng: table[list(rng.permutation(table.columns))],
    "an index of times": lambda table, rng: table.set_index(
        pd.to_datetime(table["time"], unit="s")
    ),
    "an index with repeats": lambda table, rng: table.set_index(np.zeros(len(table), int)),
    "an index backwards": lambda table, rng: table.set_index(np.arange(len(table))[::-1]),
    "nullable floats": lambda table, rng: table.astype(dict.fromkeys(MOVING, "Float64")),
    "objects": lambda table, rng: table.astype(dict.fromkeys(MOVING, object)),
    "flights as categories": lambda table, rng: table.astype({"flight": "category"}),
    "flights as objects": lambda table, rng: table.astype({"flight": object}),
    "flights as strings of pandas": lambda table, rng: table.astype({"flight": "string"}),
    "flights as strings of Arrow": lambda table, rng: table.astype({"flight": "string[pyarrow]"}),
    "flights as numbers": lambda table, rng: table.assign(
        flight=(table["flight"] == "tuesday").astype(int) + 3
    ),
    "numbers of Arrow": lambda table, rng: table.astype(dict.fromkeys(MOVING, "double[pyarrow]")),
    "columns that nobody knows": lambda table, rng: table.assign(pilot="Amelia", comment=np.nan),
    "memory in another order": lambda table, rng: pd.DataFrame(
        {name: np.asfortranarray(column) for name, column in table.items()}
    ),
}


@pytest.mark.parametrize("clothes", CLOTHES)
def test_dtypes_index_and_order_of_columns_decide_nothing(clothes):
    table, Y = flights()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "The indices of X and y differ", UserWarning)
        dressed = CLOTHES[clothes](table.copy(), default_rng(0))
        got = pipeline().fit(dressed, Y).predict(dressed, return_std=True)
    for values, expected in zip(got, plain(), strict=True):
        assert_allclose(values, expected, rtol=1e-9)


def test_the_order_of_flights_decides_nothing():
    """Of so few rows that no blocks of them are held out."""
    table, Y = flights(90)
    rows = np.r_[90:180, 0:90]
    plain = pipeline().fit(table, Y).predict(table, return_std=True)
    got = pipeline().fit(table.iloc[rows], Y.iloc[rows]).predict(table.iloc[rows], return_std=True)
    for values, expected in zip(got, plain, strict=True):
        assert_allclose(values, expected[rows], rtol=1e-6)


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


def two_columns_are_one(table, rng):
    one, other = rng.choice(MOVING, 2, replace=False)
    return table.assign(**{str(one): table[str(other)]})


def rows_are_lost(table, rng):
    return table.drop(index=table.index[rows_of(rng, table)])


def rows_stand_twice(table, rng):
    return pd.concat([table, table.iloc[rows_of(rng, table)]])


def rows_are_shuffled(table, rng):
    return table.iloc[rng.permutation(len(table))]


def is_short(table, rng):
    return table.iloc[: int(rng.integers(0, 12))]


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
    two_columns_are_one,
    flight_is_empty,
    rows_are_lost,
    rows_stand_twice,
    rows_are_shuffled,
    is_short,
    has_words,
    lacks_a_column,
    columns_of_one_name,
]


@settings(max_examples=60)
@given(
    st.integers(0, 2**20),
    st.sets(st.integers(0, len(FAULTS) - 1), min_size=1, max_size=3),
    st.booleans(),
)
def test_a_faulty_table_gives_finite_numbers_or_one_error(seed, faults, of_training):
    """Faults of the flights learned from, or of those asked about; warnings are of the documented kind alone."""
    rng = default_rng(seed)
    table, Y = flights()
    faulty = table
    for number in sorted(faults):
        faulty = FAULTS[number](faulty.copy(), rng) if len(faulty) else faulty
    targets = Y.loc[faulty.index]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", UserWarning)
        try:
            if of_training:
                model, asked = pipeline().fit(faulty, targets), table
            else:
                model, asked = fitted(), faulty
            mean, std = model.predict(asked, return_std=True)
        except ValueError:  # TypeError, IndexError, LinAlgError ... fail the test
            return
    assert mean.shape == std.shape == (len(asked), 2)
    assert np.isfinite(mean).all()
    assert np.isfinite(std).all()
    assert (std >= 0).all()
