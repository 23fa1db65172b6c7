"""Fuzz of ``read_flight``: whatever the bytes, a sound table or FlightReadError.

Small logs of each format are made, or the first bytes of real ones taken, and spoiled: bits and bytes, stretches moved,
numbers replaced by extreme ones, and, of tables of text, cells, lines and separators; of MATLAB files also what is
compressed inside. A table is sound if its columns of the vocabulary are finite or NaN, each row belongs to a flight by
name, time increases strictly within each flight, and it has no more rows than the bytes can tell of.
"""

import importlib.util
import io
import os
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _fuzzing import Campaign, Difference, only
from scipy.io import savemat

from skdgp.io import AUTOPILOTS, FlightReadError, read_flight
from skdgp.io._read import CHANNELS, base_name
from skdgp.preprocessing import FlightDataWarning

DOCUMENTED = (
    "Unknown columns are kept as they are",
    "Infinite values in .* are read as missing",
    ".* rows repeat the row before them exactly",
)
WRITERS = Path(__file__).resolve().parents[1] / "io" / "conftest.py"
REAL_BYTES, REAL_SHARE = 60_000, 0.01  # of a real log, and of the cases, where there are real ones
TOKENS = "nan NaN NA null None inf -inf 1e308 -1e308 1e400 1e-320 0x1F 1_000 1,5 - + . e 1e 99999999999999999999 true"
TOKENS = (*TOKENS.split(), "", " ", '"', "'", "٣", "\0", "\ufeff", "2020-01-01", "deg", "[deg]", "#", "12:30:00", "½")
WORDS = ("time", "flight", "alpha", "q", "ax", "psi", "time [ms]", "alpha [deg]", "q (rad/s)", "q [furlong]", "Time")
EXTREME = [np.inf, -np.inf, np.nan, 3.4e38, 1e-45, 0.0, -1.0, 1e30]


class Seed(NamedTuple):
    """A log to spoil."""

    suffix: str
    raw: np.ndarray  # of bytes
    spoil: tuple


class Prepared(NamedTuple):
    """What a worker needs: logs, those of the shared data, and where copies are written."""

    seeds: list[Seed]
    real: list[Seed]
    folder: Path


# -- ways to spoil bytes ---------------------------------------------------------------------------------


def _some(rng):
    """Return a number of places: mostly few, seldom many."""
    return int(2 ** rng.exponential(1.5))


def bits(raw, rng):
    copy = raw.copy()
    at = rng.integers(0, len(raw), _some(rng))
    copy[at] ^= (1 << rng.integers(0, 8, len(at))).astype(np.uint8)
    return copy


def some_bytes(raw, rng):
    copy = raw.copy()
    at = rng.integers(0, len(raw), _some(rng))
    copy[at] = rng.integers(0, 256, len(at))
    return copy


def first_bytes(raw, rng):
    copy = raw.copy()
    at = rng.integers(0, min(700, len(raw)), rng.integers(1, 6))
    copy[at] = rng.choice([0, 1, 0x7F, 0x80, 0xFF, *rng.integers(0, 256, 5)], len(at))
    return copy


def cut(raw, rng):
    return raw[: rng.integers(0, len(raw))]


def splice(raw, rng):
    a, b, c = np.sort(rng.integers(0, len(raw) + 1, 3))
    return np.concatenate(
        [raw[:a], raw[b:c], raw[a:b], raw[c:]][: rng.integers(2, 5)] + [raw[b:c]] * rng.integers(0, 2)
    )


def numbers(raw, rng):
    copy = raw.copy()
    if len(raw) < 9:
        return copy
    kind = np.float32 if rng.random() < 0.5 else np.float64
    with np.errstate(over="ignore"):
        extreme = np.array([*EXTREME, rng.normal() * 10.0 ** rng.integers(-40, 41)], np.float64).astype(kind)
    extreme = extreme.view(np.uint8).reshape(len(EXTREME) + 1, -1)
    for at in rng.integers(0, len(raw) - extreme.shape[1], _some(rng)):
        copy[at : at + extreme.shape[1]] = rng.choice(extreme)
    return copy


def integers(raw, rng):
    """Lengths, counts and numbers of four bytes, on their boundaries."""
    copy = raw[: len(raw) // 4 * 4].copy()
    words = copy.view("<u4")
    if len(words):
        at = rng.integers(0, len(words), rng.integers(1, 8))
        words[at] = rng.choice([0, 1, 2, 7, 2**16, 2**31 - 1, 2**31, 2**32 - 1, *rng.integers(0, 300, 4)], len(at))
    return copy


BYTES = (bits, some_bytes, first_bytes, cut, splice, numbers)


def inside(raw, rng):
    """What a MATLAB file holds compressed is spoiled, and compressed again."""
    head, packed = raw[:128].tobytes(), raw[136:].tobytes()
    try:
        content = np.frombuffer(zlib.decompress(packed), np.uint8)
    except zlib.error:
        return bits(raw, rng)
    change = (*BYTES, integers)[rng.integers(len(BYTES) + 1)]
    content = zlib.compress(change(content, rng), 1)
    return np.frombuffer(head + struct.pack("<II", 15, len(content)) + content, np.uint8)


# -- ways to spoil tables of text ------------------------------------------------------------------------


def of_text(change):
    """Return a way to spoil bytes of one that changes lines."""

    def spoil(raw, rng):
        text = raw.tobytes().decode("utf-8", "replace")
        lines = change(text.split("\n"), rng)
        ending = rng.choice(["\n"] * 8 + ["\r\n", "\r", "\n\n", "\v"])
        return np.frombuffer(ending.join(lines).encode("utf-8", "replace"), np.uint8)

    spoil.__name__ = change.__name__
    return spoil


def _separator(lines):
    return max(",;\t", key=lines[0].count)


def _cells(lines, rng, change):
    mark = _separator(lines)
    for _ in range(_some(rng)):
        row = rng.integers(len(lines))
        cells = lines[row].split(mark)
        change(cells, rng.integers(len(cells)))
        lines[row] = mark.join(cells)
    return lines


def tokens(lines, rng):
    def replace(cells, k):
        cells[k] = rng.choice(TOKENS)

    return _cells(lines, rng, replace)


def same_token_in_a_column(lines, rng):
    mark, token = _separator(lines), rng.choice(TOKENS)
    k = rng.integers(lines[0].count(mark) + 1)
    rows = range(1, len(lines)) if rng.random() < 0.5 else rng.integers(0, len(lines), 5)
    for row in rows:
        cells = lines[row].split(mark)
        cells[min(k, len(cells) - 1)] = token
        lines[row] = mark.join(cells)
    return lines


def quotes(lines, rng):
    def quote(cells, k):
        cells[k] = rng.choice(['"', '""', '"x', f'"{cells[k]}"', "'"])

    return _cells(lines, rng, quote)


def separators(lines, rng):
    old, new = rng.choice(list(",;\t. "), 2)
    more = str(new) * int(rng.integers(0, 3))
    for row in [rng.integers(len(lines))] if rng.random() < 0.5 else range(len(lines)):
        lines[row] = lines[row].replace(old, new) + more
    return lines


def moved_lines(lines, rng):
    a, b = rng.integers(0, len(lines), 2)
    way = rng.integers(4)
    if way == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif way == 1:
        lines.insert(a, lines[b])
    elif way == 2:
        lines = lines[:a] + lines[b:]
    else:
        lines.insert(a, rng.choice(["", " ", "#", lines[0], ",,,", ";", "[s],[rad],[-]"]))
    return lines or [""]


def headings(lines, rng):
    mark = _separator(lines)
    cells = lines[0].split(mark)
    cells[rng.integers(len(cells))] = rng.choice([*WORDS, *TOKENS])
    if rng.random() < 0.3:
        cells.insert(rng.integers(len(cells) + 1), rng.choice(WORDS))
    lines[0] = mark.join(cells)
    return lines


def units(lines, rng):
    mark = _separator(lines)
    row = [rng.choice(["s", "ms", "deg", "rad", "rad/s", "", "-", "m/s^2", "g", "?"]) for _ in lines[0].split(mark)]
    return [lines[0], mark.join(row), *lines[1:]]


def coding(raw, rng):
    """Another coding of the letters."""
    text = raw.tobytes().decode("utf-8", "replace")
    name = rng.choice(["utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp1252", "cp037"])
    return np.frombuffer(text.encode(str(name), "replace"), np.uint8)


LINES = (tokens, same_token_in_a_column, quotes, separators, moved_lines, headings, units)
TEXT = (*map(of_text, LINES), *map(of_text, LINES), coding, *BYTES)


# -- logs to spoil ---------------------------------------------------------------------------------------


def prepare(folder, seed) -> Prepared:
    own = Path(folder) / f"logs-{os.getpid()}"
    own.mkdir(exist_ok=True)
    real = Path(folder) / "real"
    return Prepared(seeds(own), real_ones(real), own)


def real_ones(folder):
    """Return the beginnings of real logs, where there are some."""
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        found.append(Seed(path.suffix.lower(), np.frombuffer(path.read_bytes(), np.uint8)[:REAL_BYTES], BYTES))
    return found


def seeds(folder) -> list[Seed]:
    """Return small logs of each format."""
    writers = _writers()
    t = np.arange(12) * 0.1
    table = {"time": t, "alpha": 0.1 * np.sin(t), "q": np.cos(t), "az": -9.8 + t, "note": 3 * t}
    found = [Seed(".csv", _bytes(text), TEXT) for text in _csv(t)]
    for options in ({}, {"compression": None}):
        buffer = io.BytesIO()
        pd.DataFrame(table | {"flight": ["a"] * 6 + ["b"] * 6}).to_parquet(buffer, **options)
        found.append(Seed(".parquet", _bytes(buffer.getvalue()), (*BYTES, integers)))
    for content, compressed in ((table, False), ({"data": table | {"flight": ["a", "b"] * 6}}, False), (table, True)):
        path = folder / "log.mat"
        content = {"data": content} if compressed else content
        savemat(path, content, do_compression=compressed)
        ways = (inside, inside, inside, *BYTES) if compressed else (*BYTES, integers, integers)
        found.append(Seed(".mat", _bytes(path.read_bytes()), ways))
    found += [Seed(".ulg", _bytes(bytes(_px4(writers))), BYTES), Seed(".bin", _bytes(bytes(_plane(writers))), BYTES)]
    return found


def _bytes(content):
    return np.frombuffer(content.encode() if isinstance(content, str) else content, np.uint8)


def _writers():
    spec = importlib.util.spec_from_file_location("_log_writers", WRITERS)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _csv(t):
    """Yield one table in several dialects."""
    rows = [(x, 0.1 * np.sin(x), np.cos(x), "ab"[int(x > 0.5)]) for x in t]
    yield "time,alpha,q,flight\n" + "".join(f"{a:.2f},{b:.4f},{c:.4f},{d}\n" for a, b, c, d in rows)
    yield "time [ms],alpha [deg],q\n" + "".join(f"{1e3 * a:.0f},{10 * b:.4f},{c:.4f}\n" for a, b, c, _ in rows)
    german = "".join(f"{a:.2f};{b:.4f};{c:.4f};{d}\n" for a, b, c, d in rows).replace(".", ",")
    yield "time;alpha;q;flight\n" + german
    yield "time\talpha\tq\ns\tdeg\trad/s\n" + "".join(f"{a:.2f}\t{b:.4f}\t{c:.4f}\n" for a, b, c, _ in rows)
    yield '\ufeff"time","alpha","mode"\r\n' + "".join(f'{a:.2f},"{b:.4f}","{d}"\r\n' for a, b, _, d in rows)


def _px4(writers):
    w, t = writers.ULogWriter(MAV_TYPE=1, FW_AIRSPD_MIN=4.0), np.arange(0, 7, 0.25)
    one, two = np.sin(t), np.cos(t)
    w.topic("vehicle_angular_velocity", t, xyz=("float[3]", np.column_stack([one, two, one])))
    w.topic("vehicle_acceleration", t + 0.01, xyz=("float[3]", np.column_stack([one, two, one - 9.8])))
    w.topic("vehicle_attitude", t, q=("float[4]", np.column_stack([two, one, 0 * t, 0 * t])))
    w.topic("airspeed", t[::2], true_airspeed_m_s=("float", 15 + one[::2]))
    w.topic("vehicle_land_detected", t[::8], landed=("bool", 0 * t[::8]))
    return w


def _plane(writers):
    w, t = writers.DataFlashWriter("ArduPlane V4.5.1 (abcdef01)", AIRSPEED_MIN=4.0), np.arange(0, 7, 0.25)
    one, two = np.sin(t), np.cos(t)
    sensors = {f"Gyr{k}": ("f", one) for k in "XYZ"} | {f"Acc{k}": ("f", two - 9 * (k == "Z")) for k in "XYZ"}
    w.topic("IMU", t, I=("B", 0), **sensors)
    w.topic("ATT", t, Roll=("c", 10 * one), Pitch=("c", two), Yaw=("C", 90 + one))
    w.topic("ARSP", t[::2], I=("B", 0), Airspeed=("f", 15 + one[::2]), H=("B", 1))
    w.topic("BARO", t[::4], I=("B", 0), Press=("f", 1e5 + one[::4]))
    return w


# -- one case --------------------------------------------------------------------------------------------


def case(prepared, rng):
    """Return "read" or "refused"."""
    real = prepared.real and rng.random() < REAL_SHARE
    chosen = prepared.real if real else prepared.seeds
    seed = chosen[rng.integers(len(chosen))]
    raw, story = seed.raw, []
    for _ in range(rng.choice([1, 1, 1, 1, 2, 3])):
        spoil = seed.spoil[rng.integers(len(seed.spoil))]
        if len(raw):
            raw = spoil(raw, rng)
            story.append(spoil.__name__)
    path = prepared.folder / f"log{seed.suffix}"
    path.write_bytes(raw.tobytes())
    options = {}
    if seed.suffix in AUTOPILOTS:
        position = [0.1, 0.0, -0.2] if rng.random() < 0.3 else None
        options = {"airborne": bool(rng.random() < 0.5), "imu_position": position}
    try:
        with only(*DOCUMENTED, others=(FlightDataWarning,)):
            table = read_flight(path, **options)
        check(table, len(raw))
    except FlightReadError:
        return "refused"
    except (Exception, Warning) as error:
        error.add_note(f"{seed.suffix}, {len(raw)} bytes, {', '.join(story)}, {options}\n{raw.tobytes()[:600]!r}")
        raise
    return "read"


def check(table, n_bytes):
    """Raise Difference where a table is not sound."""
    if not isinstance(table, pd.DataFrame) or list(table.columns[:2]) != ["time", "flight"]:
        raise Difference(f"table of the wrong kind: {type(table).__name__}")
    if not 0 < len(table) <= 20 * n_bytes:
        raise Difference(f"table of {len(table)} rows from {n_bytes} bytes")
    for name in table.columns:
        if name != "flight" and base_name(name) in CHANNELS:
            values = table[name].to_numpy()
            if values.dtype != np.float64:
                raise Difference(f"column {name} of type {values.dtype}")
            if np.isinf(values).any():
                raise Difference(f"column {name} holds infinities")
    time, flight = table["time"].to_numpy(), table["flight"].to_numpy()
    if not np.isfinite(time).all():
        raise Difference("time is not finite")
    if not all(isinstance(name, str) for name in flight):
        raise Difference("flight that is no text")
    lost = {"", "nan", "None", "<NA>", "NaT"} & set(flight)
    if lost:
        raise Difference(f"rows without a flight are of one called {lost.pop()!r}")
    for name in dict.fromkeys(flight):
        if not (np.diff(time[flight == name]) > 0).all():
            raise Difference("time does not increase within a flight")


LOGS = Campaign("logs", 100_000, 0.4, "read", prepare, case)
