"""Shared by the benchmarks: arguments, turns on the clock, and the results that are kept."""

import argparse
import contextlib
import json
import os
import platform
import subprocess
import time
from importlib.metadata import distributions
from pathlib import Path

PACKAGES = ("numpy", "scipy", "scikit-learn", "torch", "gpytorch", "jsbsim")


def parser_of(description, *, data=False, smoke=False):
    """Return a parser of the command line of all benchmarks; ``data``, ``smoke``: of some."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for the results, as NAME.json")
    if data:
        parser.add_argument("data", type=Path, nargs="?", help="folder of the data")
    if smoke:
        parser.add_argument("--smoke", action="store_true", help="tiny sizes: does the script run?")
    return parser


def parsed(parser, words):
    """Return the options; the folder of the data may be missing with ``--smoke`` alone."""
    options = parser.parse_args(words)
    if options.data is None and not getattr(options, "smoke", False):
        parser.error("the folder of the data is needed")
    return options


SLOW = 15.0  # s, after which a function has had turns enough
PAUSE = 0.1  # s: idle threads of BLAS hold the cores for a while


def interleaved(functions, repeats):
    """Return the shortest time of each function, in turns: whatever slows the machine slows all of them."""
    times = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            if sum(times[name]) < SLOW:
                time.sleep(PAUSE)
                start = time.perf_counter()
                function()
                times[name].append(time.perf_counter() - start)
    return {name: min(taken) for name, taken in times.items()}


def machine():
    """Return processor, threads, versions and the commit of the package."""
    from threadpoolctl import threadpool_info

    processor = platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(": ")[1] for line in lines if line.startswith("model name"))
    git = ("git", "-C", Path(__file__).parent, "describe", "--always", "--dirty")
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    installed = {one.name.lower(): one.version for one in distributions()}
    return {
        "commit": commit,
        "date": time.strftime("%Y-%m-%d"),
        "processor": processor,
        "cores": os.cpu_count(),
        "threads": max((library["num_threads"] for library in threadpool_info()), default=1),
        "python": platform.python_version(),
        "versions": {name: installed[name] for name in PACKAGES if name in installed},
    }


class Kept:
    """Results of runs in a folder, or in memory alone where there is none."""

    def __init__(self, folder, name):
        self.folder = folder and folder / name
        paths = sorted(self.folder.glob("*.json")) if self.folder else ()
        self.memory = {path.stem: json.loads(path.read_text()) for path in paths}

    def __contains__(self, name):
        return name in self.memory

    def keep(self, name, result):
        self.memory[name] = result
        if self.folder:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n")


def cell(value):
    """Return a number with three significant digits."""
    if value is None:
        return "-"
    return f"{value:#.3g}".rstrip(".") if isinstance(value, float) else str(value)


def markdown(rows):
    """Return rows, dicts of the same keys, as a table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(map(cell, row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def finish(options, name, **tables):
    """Print the tables and, with --out, keep them beside a description of the machine."""
    tables = {title: rows for title, rows in tables.items() if rows}
    for title, rows in tables.items():
        print(f"\n{title.replace('_', ' ')}\n{markdown(rows)}", flush=True)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"machine": machine(), **tables}, indent=1)
        (options.out / f"{name}.json").write_text(f"{text}\n")
