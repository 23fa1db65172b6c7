"""Shared by the benchmarks: arguments, turns on the clock, and the results that are kept."""

import argparse
import json
import os
import platform
import re
import signal
import subprocess
import sys
import time
import warnings
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).parents[2]
# Makers of flights and outputs, shared with the tests
sys.path[:0] = [str(ROOT / "tests" / "flights"), str(ROOT / "tests" / "kernels")]
OTHERS = Path(__file__).with_name("others")  # runs of methods that do not depend on the package
PACKAGES = ("numpy", "scipy", "scikit-learn", "torch", "gpytorch", "gpar", "jsbsim")
LIMIT = 1200  # s of processor time of a run


def parser_of(description, *, data=False, smoke=False):
    """Return a parser of the command line of all benchmarks; ``data``, ``smoke``: of some."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    if data:
        parser.add_argument("data", type=Path, help="folder of the data")
    if smoke:
        parser.add_argument("--smoke", action="store_true", help="tiny sizes: does the script run?")
    return parser


@cache
def commit():
    """Return the last commit of the package and of the benchmarks; pages may have later ones."""

    def git(*words):
        command = ("git", "-C", ROOT, *words, "--", "skdgp", "tests/benchmarks", "tests/flights")
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()

    return git("log", "-1", "--format=%h") + "-dirty" * bool(git("status", "--porcelain"))


def machine():
    """Return processor, threads, versions and the commit of the package."""
    from threadpoolctl import threadpool_info

    processors = [platform.processor()]
    with suppress(OSError):
        processors += re.findall(r"model name\s+: (.*)", Path("/proc/cpuinfo").read_text())
    return {
        "commit": commit(),
        "date": time.strftime("%Y-%m-%d"),
        "processor": processors[-1],
        "cores": os.cpu_count(),
        "threads": max((library["num_threads"] for library in threadpool_info()), default=1),
        "python": platform.python_version(),
        "versions": versions(),
    }


@cache
def versions():
    """Return the versions of the packages that are compared."""
    installed = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            installed[name] = version(name)
    return installed


class Kept:
    """Results of single runs, a line each in OUT/NAME.runs: what is there is not run again.

    A run that takes longer than the limit [s], or ends by a numerical error, has no result but its seconds.
    Runs of ``others``, methods that do not depend on the package, are in OUT/NAME.others, or where these files
    are kept, in ``OTHERS``: remove a line there to run it again.
    """

    def __init__(self, options, name, limit=LIMIT, others=()):
        self.limit = limit
        self.others = others
        options.out.mkdir(parents=True, exist_ok=True)
        self.own_path = options.out / f"{name}.runs"
        self.other_path = options.out / f"{name}.others"
        own = lines_of(self.own_path)
        if any(run["commit"] != commit() for run in own):
            raise SystemExit(f"Got runs of another commit than {commit()}: remove {self.own_path}.")
        kept = [*lines_of(OTHERS / f"{name}.others"), *lines_of(self.other_path)]
        outdated = {run["method"] for run in kept if run["versions"].items() - versions().items()}
        if outdated:
            print(f"Kept runs are of other versions than installed: {outdated}", file=sys.stderr)
        self.memory = {run["name"]: run for run in [*own, *kept]}
        self.asked = {}

    @property
    def table(self):
        """A row for each run that was asked for."""
        return pd.DataFrame([*self.asked.values()])

    def run(self, key, function, *arguments):
        """Return key, seconds and result, a dict, of a function."""
        name = ", ".join(map(str, key.values()))
        if name not in self.memory:
            start = time.process_time()
            result = limited(self.limit, function, *arguments) | {
                "seconds": time.process_time() - start
            }
            if key.get("method") in self.others:
                path = self.other_path
                origin = {"versions": versions()}
            else:
                path = self.own_path
                origin = {"commit": commit()}
            self.memory[name] = {"name": name, **origin, **key, **result}
            line = json.dumps(self.memory[name])
            print(line[:300], file=sys.stderr, flush=True)
            with path.open("a") as file:
                file.write(f"{line}\n")
        self.asked[name] = self.memory[name]
        return self.memory[name]


def lines_of(path):
    """Return the runs of a file, none if it is missing."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


def limited(limit, function, *arguments):
    """Return the result of a function, without its warnings, or why there is none."""

    def stop(*_):
        raise TimeoutError(f"more than {limit} s")

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        with warnings.catch_warnings(action="ignore"):
            return function(*arguments)
    except (TimeoutError, RuntimeError, np.linalg.LinAlgError) as error:
        return {"failed": repr(error)}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def cell(value):
    """Return a number with three significant digits."""
    if pd.isna(value):
        return "-"
    return f"{value:#.3g}".rstrip(".") if isinstance(value, float) else str(value)


def winners(errors, notes=None, missing="-"):
    """Return a column of errors as cells, the smallest in bold, with notes in brackets."""
    best = cell(errors.min())
    shown = {}
    for name, error in errors.items():
        shown[name] = missing if pd.isna(error) else cell(float(error))
        if shown[name] == best:
            shown[name] = f"**{best}**"
        if name in (notes or {}):
            shown[name] += f" ({notes[name]})"
    return shown


def contest(runs, by, limit=LIMIT):
    """Return a row of cells for each method, a column for each case, means of its runs; and seconds of CPU.

    Cells have the error and, where they are known, the percentage in bands and the log density.
    """
    columns = [name for name in ("error", "held", "density", "seconds") if name in runs]
    means = runs.groupby([by, "method"], sort=False)[columns].mean()
    cells = {}
    for case, scores in means.groupby(by, sort=False):
        scores = scores.droplevel(by)
        notes = scores.get("held", scores["error"][:0]).dropna().map("{:.0f} %".format)
        if "density" in scores:
            notes += scores["density"].loc[notes.index].map(", {:.2f}".format)
        cells[case] = winners(scores["error"], notes.to_dict(), f"none in {limit} s")
    seconds = means["seconds"].where(means["error"].notna()).groupby("method", sort=False)
    texts = [f"{cell(some.min())} to {cell(some.max())}" for _, some in seconds]
    return pd.DataFrame(cells).assign(**{"CPU s": pd.Series(texts, [name for name, _ in seconds])})


def markdown(rows):
    """Return rows, dicts of the same keys, as a table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(map(cell, row.values()) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def finish(options, name, **tables):
    """Print the tables and keep them beside a description of the machine, as NAME.json."""
    for title, rows in tables.items():
        if rows:
            print(f"\n{title.replace('_', ' ')}\n{markdown(rows)}", flush=True)
    text = json.dumps({"machine": machine(), **tables}, indent=1)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / f"{name}.json").write_text(f"{text}\n")
