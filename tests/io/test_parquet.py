"""Parquet files: columns of every type, and what other programs write."""

import datetime as dt
import tracemalloc
from decimal import Decimal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skdgp.io import FlightReadError, inspect_log, read_flight

TIME, ALPHA = [0.0, 0.5, 1.0], [0.25, 0.5, 0.25]
NOON = dt.datetime(2024, 5, 1, 12)
TABLE = pa.table({"time": TIME, "alpha": ALPHA})
SECONDS = [dt.timedelta(seconds=second) for second in TIME]


@pytest.fixture
def read(tmp_path):
    """Write columns, read them."""

    def of(table=None, **columns):
        arrays = {**{name: TABLE[name] for name in TABLE.column_names}, **columns}
        pq.write_table(pa.table(arrays) if table is None else table, tmp_path / "log.parquet")
        return read_flight(tmp_path / "log.parquet")

    return of


NUMBERS = {
    "float16": pa.array(np.array(ALPHA, np.float16)),
    "float32": pa.array(ALPHA, pa.float32()),
    "decimal": pa.array([Decimal(str(value)) for value in ALPHA]),
    "wide decimal": pa.array([Decimal(str(value)) for value in ALPHA], pa.decimal256(50, 4)),
    "text": pa.array([str(value) for value in ALPHA]),
    "dictionary of numbers": pa.array(ALPHA).dictionary_encode(),
    "dictionary of texts": pa.array([str(value) for value in ALPHA]).dictionary_encode(),
}


@pytest.mark.parametrize("values", NUMBERS.values(), ids=NUMBERS)
def test_numbers(read, values):
    assert read(alpha=values).alpha.tolist() == ALPHA


TIMES = {
    "timestamp": pa.array([NOON + second for second in SECONDS], pa.timestamp("us")),
    "time zone": pa.array(
        [NOON + second for second in SECONDS], pa.timestamp("ns", "Europe/Berlin")
    ),
    "far away": pa.array([10**15 + int(1000 * second) for second in TIME], pa.timestamp("ms")),
    "duration": pa.array(SECONDS),
    "decimal": pa.array([Decimal(str(second)) for second in TIME]),
}


@pytest.mark.parametrize("values", TIMES.values(), ids=TIMES)
def test_times(read, values):
    assert read(time=values).time.tolist() == TIME


FLIGHTS = {
    "dictionary": pa.array(["a", "a", "b"]).dictionary_encode(),
    "large string": pa.array(["a", "a", "b"], pa.large_string()),
    "blanks": pa.array([" a", "a ", "b"]),
}


@pytest.mark.parametrize("values", FLIGHTS.values(), ids=FLIGHTS)
def test_flights(read, values):
    assert read(flight=values).flight.tolist() == ["a", "a", "b"]


NO_NUMBERS = {
    "timestamp": pa.array([NOON] * 3),
    "duration": pa.array(SECONDS),
    "date": pa.array([NOON.date()] * 3),
    "time of day": pa.array([NOON.time()] * 3),
    "text": pa.array(["high"] * 3),
}


@pytest.mark.parametrize("values", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_what_is_no_number(read, values):
    with pytest.raises(
        FlightReadError, match=r"in column 'alpha' at row 0 \(3 rows are not numbers\)"
    ):
        read(alpha=values)


NESTED = {
    "list": pa.array([[1.0, 2.0]] * 3),
    "struct": pa.array([{"lat": 47.0}] * 3),
    "map": pa.array([[("a", 1)]] * 3, pa.map_(pa.string(), pa.int64())),
    "bytes": pa.array([b"\xff\xfe"] * 3),
    **(
        {"extension": pa.array([b"0123456789abcdef"] * 3, pa.uuid())} if hasattr(pa, "uuid") else {}
    ),  # from 18 on
}


@pytest.mark.parametrize("values", NESTED.values(), ids=NESTED)
def test_nested_columns(read, values):
    with pytest.raises(FlightReadError, match=r"types {'my_sensor': .*one value in each row"):
        read(my_sensor=values)


@pytest.mark.parametrize("name", ["alpha", " alpha"])
def test_a_name_twice(read, name):
    with pytest.raises(FlightReadError, match=r"columns \['alpha'\] repeated"):
        read(
            pa.Table.from_arrays(
                [TABLE["time"], TABLE["alpha"], TABLE["alpha"]], names=["time", "alpha", name]
            )
        )


@pytest.mark.parametrize("table", [pa.table({}), TABLE.slice(0, 0)])
def test_nothing(read, table):
    with pytest.raises(FlightReadError, match=r"no rows|no column 'time'"):
        read(table)


def test_nothing_in_a_column(read):
    assert read(beta=pa.nulls(3)).beta.isna().all()


def test_an_index_that_pandas_wrote(tmp_path):
    frame = pd.DataFrame({"alpha": ALPHA}, index=pd.Index(TIME, name="time"))
    frame.to_parquet(tmp_path / "log.parquet")
    assert read_flight(tmp_path / "log.parquet").time.tolist() == TIME
    frame.reset_index()[::-1].to_parquet(tmp_path / "log.parquet")
    with pytest.raises(
        FlightReadError, match="expected time to increase"
    ):  # rows stay in their order
        read_flight(tmp_path / "log.parquet")


@pytest.mark.parametrize(
    "words", ["{}", "{x", '{"index_columns": ["none"], "columns": [], "column_indexes": []}']
)
def test_what_pandas_is_told_does_not_matter(read, words):
    assert read(TABLE.replace_schema_metadata({"pandas": words})).alpha.tolist() == ALPHA


def test_the_damage_that_pyarrow_tells_in_its_own_words(tmp_path):
    pq.write_table(TABLE, tmp_path / "log.parquet")
    raw = (tmp_path / "log.parquet").read_bytes()
    for content in (
        b"PAR1",
        b"PAR1PAR1",
        raw[:-5] + b"\xffPAR1",
        raw.replace(b"time", b"\xff\xfeme"),
    ):
        (tmp_path / "log.parquet").write_bytes(content)
        for reader in (read_flight, inspect_log):
            with pytest.raises(FlightReadError, match="not a whole parquet file"):
                reader(tmp_path / "log.parquet")


def test_a_long_text_that_repeats_takes_memory_once(tmp_path):
    """20,000 rows of one text of 20,000 letters are 381 MiB when written out."""
    note = pa.array(["x" * 20_000]).take([0] * 20_000)
    table = pa.table({"time": np.arange(20_000) * 0.02, "note": note})
    pq.write_table(table, tmp_path / "log.parquet")
    tracemalloc.start()
    try:
        flight = read_flight(tmp_path / "log.parquet")
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()
    assert flight["note"].str.len().eq(20_000).all()
