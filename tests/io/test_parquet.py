"""Parquet files: columns of every type, and what other programs write."""

import datetime as dt
from decimal import Decimal

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skdgp.io import FlightReadError, inspect_log, read_flight

TIME = [0.0, 0.5, 1.0]
ALPHA = [0.25, 0.5, 0.25]
NOON = dt.datetime(2024, 5, 1, 12)
TABLE = pa.table({"time": TIME, "alpha": ALPHA})
SECONDS = [dt.timedelta(seconds=second) for second in TIME]


@pytest.fixture
def read(tmp_path):
    """Write columns, read them."""

    def of(table=None, **columns):
        if table is None:
            table = pa.table({"time": TIME, "alpha": ALPHA} | columns)
        pq.write_table(table, tmp_path / "log.parquet")
        return read_flight(tmp_path / "log.parquet")

    return of


TEXTS = [str(value) for value in ALPHA]
STAMPS = [NOON + second for second in SECONDS]
READ = {
    "float32": ("alpha", pa.array(ALPHA, pa.float32())),
    "decimal": ("alpha", pa.array([Decimal(text) for text in TEXTS])),
    "text": ("alpha", pa.array(TEXTS)),
    "whole numbers": ("north", pa.array([1, 0, 1], pa.uint16())),
    "truth values": ("north", pa.array([True, False, True])),
    "dictionary of texts": ("alpha", pa.array(TEXTS).dictionary_encode()),
    "timestamp": ("time", pa.array(STAMPS, pa.timestamp("us"))),
    "time zone": ("time", pa.array(STAMPS, pa.timestamp("ns", "Europe/Berlin"))),
    "duration": ("time", pa.array(SECONDS)),
    "dictionary of flights": ("flight", pa.array(["a", "a", "b"]).dictionary_encode()),
    "blanks": ("flight", pa.array([" a", "a ", "b"])),
}
EXPECTED = {"alpha": ALPHA, "north": [1.0, 0.0, 1.0], "time": TIME, "flight": ["a", "a", "b"]}


@pytest.mark.parametrize(("name", "values"), READ.values(), ids=READ)
def test_types_that_are_read(read, name, values):
    assert read(**{name: values})[name].tolist() == EXPECTED[name]


@pytest.mark.parametrize("kind", [pa.int64(), pa.float64()])
def test_flights_that_are_numbers(read, kind):
    assert read(flight=pa.array([1, 1, 12], kind)).flight.tolist() == ["1", "1", "12"]


NO_NUMBER = r"in column 'alpha' at row 0 \(3 rows are not numbers\)"
REFUSED = {
    "timestamp": ("alpha", pa.array([NOON] * 3), NO_NUMBER),
    "text": ("alpha", pa.array(["high"] * 3), NO_NUMBER),
}
NESTED = {
    "list": pa.array([[1.0, 2.0]] * 3),
    "record": pa.array([{"x": 1.0}] * 3),
    "map": pa.array([[("x", 1)]] * 3, pa.map_(pa.string(), pa.int64())),
}


@pytest.mark.parametrize(("name", "values", "message"), REFUSED.values(), ids=REFUSED)
def test_types_that_are_refused(read, name, values, message):
    with pytest.raises(FlightReadError, match=message):
        read(**{name: values})


@pytest.mark.parametrize("name", ["alpha", "time", "flight", "of_no_flight_table"])
@pytest.mark.parametrize("values", NESTED.values(), ids=NESTED)
def test_cells_of_several_values_are_refused(read, name, values):
    message = rf"lists or records, .*'{name}': .{str(values.type)[:4]}.*a column for each element"
    with pytest.raises(FlightReadError, match=message):
        read(**{name: values})


@pytest.mark.parametrize("table", [pa.table({}), TABLE.slice(0, 0)])
def test_nothing(read, table):
    with pytest.raises(FlightReadError, match=r"no rows|no column 'time'"):
        read(table)


def test_an_index_that_pandas_wrote(tmp_path):
    frame = pd.DataFrame({"alpha": ALPHA}, index=pd.Index(TIME, name="time"))
    frame.to_parquet(tmp_path / "log.parquet")
    assert read_flight(tmp_path / "log.parquet").time.tolist() == TIME
    frame.reset_index()[::-1].to_parquet(tmp_path / "log.parquet")
    with pytest.raises(
        FlightReadError, match="expected time to increase"
    ):  # rows stay in their order
        read_flight(tmp_path / "log.parquet")


@pytest.mark.parametrize("name", ["alpha", " alpha"])
def test_a_name_twice(read, name):
    columns = [TABLE["time"], TABLE["alpha"], TABLE["alpha"]]
    with pytest.raises(FlightReadError, match=r"columns \['alpha'\] repeated"):
        read(pa.Table.from_arrays(columns, names=["time", "alpha", name]))


def test_the_damage_that_pyarrow_tells_in_its_own_words(tmp_path):
    pq.write_table(TABLE, tmp_path / "log.parquet")
    raw = (tmp_path / "log.parquet").read_bytes()
    for content in (
        b"",
        b"time,alpha\n0,0.1\n",
        b"PAR1",
        b"PAR1PAR1",
        raw[:-5] + b"\xffPAR1",
        raw.replace(b"time", b"\xff\xfeme"),
    ):
        (tmp_path / "log.parquet").write_bytes(content)
        for reader in (read_flight, inspect_log):
            with pytest.raises(FlightReadError, match="not a whole parquet file"):
                reader(tmp_path / "log.parquet")
