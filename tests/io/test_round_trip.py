"""Whatever a table is written as, the same numbers are read."""

import csv
import io

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skdgp.io import read_flight

FEW = settings(max_examples=30)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)
FLIGHTS = ["=1+1", "-1", "a", "007", "1e3", "Höhe 3", "a, b", "x;y", 'the "last"']
STRANGE = ["wind, left", 'a "b"', "two\nlines", "x;y", "plain", "tab\there", "[deg]"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


@st.composite
def tables(draw):
    """Times that increase in each flight, numbers of any size, cells that are missing, columns in any order."""
    n = draw(st.integers(2, 8))
    column = st.lists(NUMBERS, min_size=n, max_size=n)
    columns = {name: draw(column) for name in ("north", "east")} | {
        draw(st.sampled_from(STRANGE)): draw(column)
    }
    table = pd.DataFrame(columns).assign(
        time=0.02 * np.cumsum(draw(st.lists(st.integers(1, 50), min_size=n, max_size=n)))
    )
    missing = draw(st.lists(st.booleans(), min_size=n, max_size=n))
    table["north"] = table["north"].mask(missing)
    if draw(st.booleans()):
        first, second = draw(st.permutations(FLIGHTS))[:2]
        table["flight"] = [first] * (n // 2) + [second] * (n - n // 2)
    return table[draw(st.permutations(list(table.columns)))]


def same(found, table, **tolerance):
    """Compare what was read with what was written, by name."""
    for name in table:
        if name == "flight":
            assert found[name].tolist() == table[name].tolist()
        else:
            assert_allclose(found[name], table[name].to_numpy(float), err_msg=name, **tolerance)
    assert set(found) == {"flight", *table}


@FEW
@given(
    table=tables(),
    separator=st.sampled_from(",;\t"),
    comma=st.booleans(),
    quoting=st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONNUMERIC]),
    end=st.sampled_from(["\n", "\r\n"]),
    mark=st.booleans(),
    units=st.booleans(),
)
def test_csv(folder, table, separator, comma, quoting, end, mark, units):
    def written(value):
        text = value if isinstance(value, str) else "" if np.isnan(value) else repr(float(value))
        decimal = comma and separator != "," and not isinstance(value, str)
        return text.replace(".", ",") if decimal else text

    unit = {"time": "ms", "east": "ft"}
    heads = [f"{name} [{unit[name]}]" if units and name in unit else name for name in table]
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, quoting=quoting, lineterminator=end)
    writer.writerow(heads)
    logged = table.assign(time=table["time"] * 1e3) if units else table
    for row in logged.itertuples(index=False):
        writer.writerow([written(value) for value in row])
    path = folder / "log.csv"
    path.write_bytes((("\ufeff" if mark else "") + text.getvalue()).encode())
    expected = table.assign(east=table["east"] * 0.3048) if units else table
    same(read_flight(path), expected, rtol=4e-16 if not units else 1e-15)


WHOLE = ["uint16", "Int32", "boolean"]
NAMED = ["int64", "float64", "Int64"]


@pytest.mark.parametrize(
    ("name", "kind", "values", "expected"),
    [
        *(("north", kind, [1, 0, 1], [1.0, 0.0, 1.0]) for kind in WHOLE),
        *(("flight", kind, [1, 1, 12], ["1", "1", "12"]) for kind in NAMED),
    ],
)
def test_whole_numbers(folder, name, kind, values, expected):
    """Of a channel, and as names of flights."""
    column = pd.Series(values).astype("int64").astype(kind)
    pd.DataFrame({"time": [0.0, 0.02, 0.04], name: column}).to_parquet(folder / "log.parquet")
    assert read_flight(folder / "log.parquet")[name].tolist() == expected
