"""Damaged logs: whatever the bytes, a table, or one error; soon, in little memory, with no other warning."""

import time
import tracemalloc
import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from skdgp.io import AUTOPILOTS, FlightReadError, inspect_log, read_flight
from skdgp.preprocessing import FlightDataWarning

ROUNDS = 40
"""Per kind of damage; longer runs go through the same code."""


def scattered(raw, rng):
    """Some bytes are others."""
    damaged = raw.copy()
    at = rng.integers(0, len(raw), 10 ** int(rng.integers(0, 4)))
    damaged[at] = rng.integers(0, 256, len(at))
    return damaged


def in_the_definitions(raw, rng):
    """Some of the first bytes are others, where formats and lengths stand."""
    damaged = raw.copy()
    at = rng.integers(0, min(3000, len(raw)), int(rng.integers(1, 6)))
    damaged[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, *rng.integers(0, 256, 5)], len(at))
    return damaged


def moved(raw, rng):
    """Stretches are cut out, doubled, or put elsewhere."""
    a, b, c = np.sort(rng.integers(0, len(raw), 3))
    return np.concatenate(
        [raw[:a], raw[b:c], raw[a:b], raw[c:]][: rng.integers(2, 5)] + [raw[b:c]] * rng.integers(0, 2)
    )


def with_extreme_numbers(raw, rng):
    """Infinities, NaN, largest and denormal numbers are written over values."""
    damaged = raw.copy()
    numbers = np.array([np.inf, -np.inf, np.nan, 3.4e38, 1e-45], np.float32).view(np.uint8).reshape(-1, 4)
    for at in rng.integers(0, len(raw) - 4, int(rng.integers(1, 300))):
        damaged[at : at + 4] = rng.choice(numbers)
    return damaged


def cut(raw, rng):
    """The end is missing."""
    return raw[: rng.integers(0, len(raw))]


DAMAGE = [scattered, in_the_definitions, moved, with_extreme_numbers, cut]


def survives(path, n_bytes):
    """Read in every way; return what came of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", FlightDataWarning)
        warnings.filterwarnings("ignore", "Unknown columns|Infinite values", UserWarning)  # said of what was damaged
        try:
            options = {"airborne": False, "imu_position": [0.1, 0.0, -0.2]}
            table = read_flight(path, **(options if path.suffix in AUTOPILOTS else {}))
        except FlightReadError:  # any other failure fails the test
            return "refused"
        assert isinstance(table, pd.DataFrame)
        assert len(table) <= 20 * n_bytes
        assert not np.isinf(table.select_dtypes("number").to_numpy()).any()
        for _, part in table.groupby("flight"):
            assert (np.diff(part.time) > 0).all()
        try:
            str(inspect_log(path))
        except FlightReadError:  # magnitudes of a table are looked at again
            return "refused"
        return "read"


@pytest.fixture(scope="module")
def logs(tmp_path_factory, px4, ardupilot):
    """Return the bytes of a small log of each format."""
    folder = tmp_path_factory.mktemp("mat")
    t = np.arange(300) * 0.02
    savemat(folder / "log.mat", {"data": {"time": t, "alpha": 0.1 * np.sin(t), "q": np.cos(t)}}, do_compression=False)
    table = "time,alpha [deg],q\n" + "".join(f"{x:.2f},{np.sin(x):.4f},{np.cos(x):.4f}\n" for x in t)
    raw = {".ulg": px4, ".bin": ardupilot, ".mat": (folder / "log.mat").read_bytes(), ".csv": table.encode()}
    return {suffix: np.frombuffer(content, np.uint8)[:60_000] for suffix, content in raw.items()}


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize("suffix", [".ulg", ".bin"])
def test_damaged_logs(logs, tmp_path, suffix, damage):
    rng = np.random.default_rng([len(suffix), DAMAGE.index(damage)])
    path, outcomes = tmp_path / f"log{suffix}", []
    for _ in range(ROUNDS // 4):
        content = damage(logs[suffix], rng).tobytes()
        path.write_bytes(content)
        began = time.monotonic()
        outcomes.append(survives(path, len(content)))
        assert time.monotonic() - began < 10
    assert "read" in outcomes  # a damaged log is mostly a good one


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda damage: damage.__name__)
def test_damaged_matlab_files(logs, tmp_path, damage):
    rng = np.random.default_rng(DAMAGE.index(damage))
    for _ in range(ROUNDS):
        content = damage(logs[".mat"], rng).tobytes()
        (tmp_path / "log.mat").write_bytes(content)
        survives(tmp_path / "log.mat", len(content))


@pytest.mark.parametrize("suffix", [".ulg", ".bin"])
def test_noise_after_the_first_bytes(tmp_path, suffix):
    """A file that begins as a log and goes on as noise, however long."""
    head = {".ulg": b"ULog\x01\x12\x35\x01" + bytes(8), ".bin": b"\xa3\x95"}[suffix]
    (tmp_path / f"log{suffix}").write_bytes(head + np.random.default_rng(0).bytes(2_000_000))
    began = time.monotonic()
    with pytest.raises(FlightReadError):
        read_flight(tmp_path / f"log{suffix}")
    assert time.monotonic() - began < 10


@pytest.mark.parametrize("suffix", [".ulg", ".bin"])
def test_memory_is_bounded_by_the_size_of_the_file(logs, tmp_path, suffix):
    rng = np.random.default_rng(0)
    for damage in (scattered, in_the_definitions, moved):
        content = damage(logs[suffix], rng).tobytes()
        (tmp_path / f"log{suffix}").write_bytes(content)
        tracemalloc.start()
        try:
            survives(tmp_path / f"log{suffix}", len(content))
            assert tracemalloc.get_traced_memory()[1] < 60e6 + 40 * len(content)
        finally:
            tracemalloc.stop()


@pytest.mark.shared
def test_damaged_shared_logs(shared_data, tmp_path):
    rng = np.random.default_rng(1)
    for path in sorted((shared_data / "logs").iterdir()):
        raw = np.frombuffer(path.read_bytes(), np.uint8)[:500_000]
        for damage in DAMAGE:
            copy = tmp_path / f"log{path.suffix.lower()}"
            content = damage(raw, rng).tobytes()
            copy.write_bytes(content)
            survives(copy, len(content))
