"""What the benchmarks share: arguments, turns taken on the clock, memory of a process, and where results are kept."""

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

VERSIONS = (
    "skdgp",
    "numpy",
    "scipy",
    "scikit-learn",
    "torch",
    "gpytorch",
    "gpy",
    "mogptk",
    "jsbsim",
)


def parser_of(description, *, data=False, redo=False, smoke=False):
    """Return a parser of the command line of all benchmarks; ``data``, ``redo``, ``smoke``: of some."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, help="folder for the results, as NAME.json; page.py reads them there"
    )
    parser.add_argument(
        "--repeats", type=int, default=3, help="of each measurement; the shortest counts"
    )
    parser.add_argument("--no-peers", action="store_true", help="leave out what other packages do")
    if smoke:
        parser.add_argument("--smoke", action="store_true", help="tiny sizes: does the script run?")
    if data:
        parser.add_argument(
            "data", type=Path, nargs="?", help="folder of the shared data, which holds flights/"
        )
    if redo:
        parser.add_argument("--redo", action="store_true", help="run again what OUT has already")
    return parser


def parsed(parser, words):
    """Return the options, of which ``data``, the folder of the shared data, is needed but for ``--smoke``."""
    options = parser.parse_args(words)
    if options.data is None and not getattr(options, "smoke", False):
        parser.error("the folder of the shared data is needed")
    return options


SLOW = 15.0  # s, after which a function has had turns enough
# s: threads of BLAS go on waiting for work for a while, on cores that the next in turn needs
PAUSE = 0.1


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


def extra_memory(function):
    """Return by how many bytes the process grew at its peak while the function ran (Linux)."""
    import resource

    resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # forget earlier peaks
    function()
    peak = (
        _field("/proc/self/status", "VmHWM")
        or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    )
    return max(0, peak - resident)


def in_own_process(script, *words, environment=None):
    """Run a script of this folder and return what it printed last, as JSON; None where it failed."""
    command, variables = (
        [sys.executable, str(script), *map(str, words)],
        os.environ | (environment or {}),
    )
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
    if done.returncode:
        print(
            f"  {' '.join(map(str, words))}: "
            f"{(done.stderr.strip().splitlines() or ['killed'])[-1]}",
            file=sys.stderr,
        )
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])


def available_memory():
    """Return the bytes that may still be allocated (Linux; elsewhere no limit is known)."""
    return _field("/proc/meminfo", "MemAvailable") or float("inf")


def _field(path, name):
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return None
    return next(
        (int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{name}:")), None
    )


def use_torch_threads(threads=None):
    """Give torch so many threads, by default as many as BLAS has."""
    import torch

    from skdgp._compute.parallel import n_threads

    torch.set_num_threads(threads or n_threads())


def machine():
    """Return processor, threads, load and versions."""
    from threadpoolctl import threadpool_info

    blas = [library for library in threadpool_info() if library["user_api"] == "blas"]
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": max((library["num_threads"] for library in blas), default=1),
        "blas": ", ".join(
            sorted({f"{library['internal_api']} {library['version']}" for library in blas})
        ),
        "load": round(os.getloadavg()[0], 1),
        "python": platform.python_version(),
        "versions": dict(filter(None, map(_version, VERSIONS))),
        "date": time.strftime("%Y-%m-%d"),
    }


def _processor():
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor()


def _version(name):
    try:
        return name, version(name)
    except PackageNotFoundError:
        return None


def show(rows):
    """Print rows, dicts of the same keys, as a table."""
    if not rows:
        return
    cells = [[_cell(value) for value in row.values()] for row in rows]
    widths = [
        max(len(str(text)) for text in column) for column in zip(rows[0], *cells, strict=True)
    ]
    for line in (list(rows[0]), *cells):
        print(
            "  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True)),
            flush=True,
        )


def _cell(value):
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) and abs(value) < 100 else str(value)


def finish(options, name, **tables):
    """Print the tables and, with --out, keep them beside a description of the machine."""
    for title, rows in tables.items():
        print(f"\n{title.replace('_', ' ')}")
        show(rows)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / f"{name}.json").write_text(
            json.dumps({"machine": machine(), **tables}, indent=1) + "\n"
        )
