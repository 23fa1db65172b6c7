"""How much of a damaged log comes back: the readers here beside pyulog and pymavlink.

    python tests/benchmarks/damage.py ../shared/data [--out FOLDER]

Copies of a log, each with n bytes at random places replaced by random ones. Counted are messages with a time. Seconds
are those of the processor for one log without damage.
"""

import contextlib
import os
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _common import finish, parsed, parser_of

from skdgp.io import FlightReadError
from skdgp.io._autopilot.dataflash import DEFINITIONS, read_dataflash
from skdgp.io._autopilot.ulog import read_ulog

LOGS = {
    "ULog": ("pyulog_sample_log_small_vtol_bench.ulg", read_ulog),
    "DataFlash": ("pyflightcoach_elevator_bench.BIN", read_dataflash),
}


def ours(read):
    """Return a function that counts the messages of a file; None where it is refused."""

    def count(path):
        try:
            return sum(map(len, read(path).topics.values()))
        except FlightReadError:
            return None

    return count


def pyulog(path):
    """The same of pyulog, whatever it raises."""
    from pyulog import ULog

    try:
        return sum(len(data.data["timestamp"]) for data in ULog(str(path)).data_list)
    except Exception:
        return None


def pymavlink(path):
    """The same of pymavlink."""
    from pymavlink.DFReader import DFReader_binary

    try:
        count = 0
        with DFReader_binary(str(path), zero_time_base=True) as reader:
            while (message := reader.recv_msg()) is not None:
                count += "TimeUS" in message.get_fieldnames() and message.get_type() not in DEFINITIONS
        return count
    except Exception:
        return None


@contextlib.contextmanager
def silence():
    """Take away what is printed, also by compiled code."""
    kept = [os.dup(1), os.dup(2)]
    with open(os.devnull, "w") as nowhere:
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
        try:
            yield
        finally:
            sys.stdout.flush()
            for stream, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, stream)
                os.close(copy)


def damaged(raw, n, seed):
    """Return a copy with n bytes replaced."""
    rng, copy = np.random.default_rng([n, seed]), raw.copy()
    copy[rng.integers(0, len(raw), n)] = rng.integers(0, 256, n)
    return copy.tobytes()


def shares(raw, suffix, readers, n, copies):
    """Return one row for each reader: share of messages that came back, and how often there was none at all."""
    with tempfile.TemporaryDirectory() as folder, silence():
        path = Path(folder) / f"log{suffix}"
        path.write_bytes(raw.tobytes())
        whole = {name: read(path) for name, read in readers.items()}
        counts = {name: [] for name in readers}
        for seed in range(copies):
            path.write_bytes(damaged(raw, n, seed))
            for name, read in readers.items():
                counts[name].append((read(path) or 0) / whole[name])
    return [
        {"reader": name, "bytes": n, "median": np.median(found), "least": min(found), "nothing": found.count(0.0)}
        for name, found in counts.items()
    ]


def seconds(raw, suffix, readers):
    """Return the time of the processor for the whole log, the shortest of three."""
    rows = []
    with tempfile.TemporaryDirectory() as folder, silence():
        path = Path(folder) / f"log{suffix}"
        path.write_bytes(raw.tobytes())
        for name, read in readers.items():
            taken = []
            for _ in range(3):
                began = time.process_time()
                read(path)
                taken.append(time.process_time() - began)
            rows.append({"reader": name, "MB": len(raw) / 1e6, "seconds": min(taken)})
    return rows


def toy():
    """Return a small ULog."""

    def message(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    parts = [message("F", b"tick:uint64_t timestamp;float x;"), message("A", b"\0\0\0tick")]
    parts += [message("D", struct.pack("<HQf", 0, 1000 * k, k)) for k in range(500)]
    return np.frombuffer(b"ULog\x01\x12\x35\x01" + bytes(8) + b"".join(parts), np.uint8)


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--copies", type=int, default=20)
    options = parsed(parser, words)
    came_back, times = [], []
    for kind, (name, read) in LOGS.items():
        peers = {} if options.no_peers else {"ULog": {"pyulog": pyulog}, "DataFlash": {"pymavlink": pymavlink}}[kind]
        readers = {f"skdgp, {kind}": ours(read)} | peers
        if options.smoke and kind != "ULog":
            continue
        raw = toy() if options.smoke else np.frombuffer((options.data / "logs" / name).read_bytes(), np.uint8)
        for n in (1, 10, 100) if options.smoke else (1, 10, 100, 1000):
            came_back += shares(raw, Path(name).suffix.lower(), readers, n, 3 if options.smoke else options.copies)
        times += seconds(raw, Path(name).suffix.lower(), readers)
    finish(options, "damage", came_back=came_back, time_of_a_whole_log=times)


if __name__ == "__main__":
    main()
