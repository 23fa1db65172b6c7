"""Damaged logs: whatever the bytes, a table, or one error; soon, in little memory, with no other warning."""

import time
import tracemalloc
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from numpy.random import default_rng

from skdgp.io import AUTOPILOTS, FlightReadError, inspect_log, read_flight
from skdgp.preprocessing import FlightDataWarning

# Per kind of damage; longer runs go through the same code
ROUNDS = {".ulg": 3, ".bin": 3, ".tlog": 1, ".csv": 6, ".parquet": 6}
# A small file is read within so many seconds, in so many bytes and so many times its own
SECONDS = 5.0
MEMORY = 60e6
GROWTH = 40


DOCUMENTED = (
    "Unknown columns are kept as they are",
    "Infinite values in .* are read",
)
EXTREME = np.array([np.inf, -np.inf, np.nan, 3.4e38, 1e-45, 0.0, -1.0, 1e30])


def places(n, rng):
    """Return mostly few places, seldom many."""
    return rng.integers(0, n, int(2 ** rng.exponential(1.5)))


def bits(raw, rng):
    at = places(len(raw), rng)
    raw[at] ^= (1 << rng.integers(0, 8, len(at))).astype(np.uint8)
    return raw


def cut(raw, rng):
    return raw[: rng.integers(0, len(raw))]


def splice(raw, rng):
    """Leave a part out, or repeat one."""
    end, begin = rng.integers(0, len(raw) + 1, 2)
    return np.concatenate([raw[:end], raw[begin:]])


def numbers(raw, rng):
    extreme = EXTREME.astype(rng.choice(["f4", "f8"])).view(np.uint8).reshape(len(EXTREME), -1)
    for at in places(len(raw) - extreme.shape[1], rng):
        raw[at : at + extreme.shape[1]] = rng.choice(extreme)
    return raw


DAMAGES = (bits, cut, splice, numbers)


def check(table, n_bytes):
    """Assert that a table is sound, and has no more rows than the bytes can tell of."""
    assert list(table.columns[:2]) == ["time", "flight"]
    assert 0 < len(table) <= 20 * n_bytes
    for name in table.columns.difference(["flight"]):
        if name not in table.attrs["unknown_columns"]:
            assert table[name].dtype == np.float64
            assert not np.isinf(table[name]).any()
    time = table["time"].to_numpy()
    flight = table["flight"].to_numpy()
    assert np.isfinite(time).all()
    assert all(isinstance(name, str) for name in flight)
    assert not {"", "nan", "None", "<NA>", "NaT"} & set(flight)
    for name in dict.fromkeys(flight):
        assert (np.diff(time[flight == name]) > 0).all()


def survives(path, n_bytes):
    """Read in every way; return what came of it."""
    with warnings.catch_warnings():
        for message in DOCUMENTED:
            warnings.filterwarnings("ignore", message, UserWarning)
        warnings.simplefilter("ignore", FlightDataWarning)
        try:
            options = {"airborne": False} if path.suffix in AUTOPILOTS else {}
            check(read_flight(path, **options), n_bytes)
            str(inspect_log(path))
        except FlightReadError:  # any other failure fails the test
            return "refused"
        return "read"


@pytest.fixture(scope="module")
def logs(tmp_path_factory, px4, ardupilot, tlog):
    """Return the bytes of a small log of each format."""
    folder = tmp_path_factory.mktemp("logs")
    t = np.arange(300) * 0.02
    columns = {"time": t, "alpha [deg]": np.sin(t).round(4), "q": np.cos(t).round(4)}
    table = pd.DataFrame(columns).to_csv(index=False)
    noted = pd.DataFrame(columns).assign(flight="a", note=np.tile(["x", None, "z"], 100))
    noted.to_parquet(folder / "log.parquet")
    raw = {".ulg": px4, ".bin": ardupilot, ".tlog": b"".join(tlog), ".csv": table.encode()}
    raw[".parquet"] = (folder / "log.parquet").read_bytes()
    return {suffix: np.frombuffer(content, np.uint8)[:30_000] for suffix, content in raw.items()}


@pytest.mark.parametrize("suffix", ROUNDS)
def test_damaged_logs(logs, tmp_path, suffix):
    """Some are read and some refused; a damaged log of an autopilot is mostly a good one, telemetry always."""
    path = tmp_path / f"log{suffix}"
    outcomes = []
    for kind, damage in enumerate(DAMAGES):
        rng = default_rng([len(suffix), kind])
        for _ in range(ROUNDS[suffix]):
            content = damage(logs[suffix].copy(), rng).tobytes()
            path.write_bytes(content)
            began = time.process_time()
            outcomes.append(survives(path, len(content)))
            assert time.process_time() - began < 2 * SECONDS
    assert set(outcomes) == {"read"} | (set() if suffix == ".tlog" else {"refused"})
    assert suffix not in AUTOPILOTS or outcomes.count("read") > 0.7 * len(outcomes)


# A head, flags, and a definition of letters alone
LETTERS = b"ULog\x01\x12\x35\x01" + bytes(8) + b"\x28\x00B" + bytes(40)
LETTERS += b"\x2f\x75F" + b"F" * 29_999


def wide(n):
    return ("time," + ",".join(f"c{i}" for i in range(n - 1)) + "\n").encode()


# Files of which a few bytes ask for all memory or for hours: what they are called, and why they are
# refused.
BOMBS = {
    "blanks": (
        "log.csv",
        lambda: b"time," + b" " * 50_000 + b"x" + b" " * 50_000 + b"y\n0,1,2\n",
        "unequal length",
    ),
    "wide header": (
        "log.csv",
        lambda: wide(100_000) + b"0\n",
        "Too many columns specified: expected 100000",
    ),
    "short rows": (
        "log.csv",
        lambda: wide(9_000) + b"0\n" * 50_000,
        "line 2 has 1 cells, the header has 9000",
    ),
    "remarks": ("log.csv", lambda: b"#\n" * 100_000, "is empty"),
    "letters": ("log.ulg", lambda: LETTERS, "without any data"),
    "marks": ("log.bin", lambda: b"\xa3\x95" * 50_000, "no message has a TimeUS"),
}


@pytest.mark.parametrize(("name", "content", "message"), BOMBS.values(), ids=BOMBS)
def test_small_files_take_little(tmp_path, name, content, message):
    content = content()
    (tmp_path / name).write_bytes(content)
    before = pa.total_allocated_bytes()
    began = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(FlightReadError, match=message):
            read_flight(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 2 * MEMORY + GROWTH * len(content)
    finally:
        tracemalloc.stop()
    assert pa.total_allocated_bytes() - before < MEMORY
    assert time.process_time() - began < SECONDS
