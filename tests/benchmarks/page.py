"""Measure the results page: every script here with its default arguments, on one commit.

Of small_uav.py, which takes hours, an even sixth is flown.

    python tests/benchmarks/page.py ../shared/data REPOSITORY PUBLISHED --out OUT

REPOSITORY is what pairs.py needs, PUBLISHED what published.py and tabular.py need. Two scripts run
at a time, on one thread each. Stopped and started again, it
goes on after the last run that was finished: OUT holds the runs. Machine, versions, commit and
tables are then written to docs/results.md, and to other pages with marked tables, between
``<!-- NAME:TABLE -->`` and ``<!-- end -->``. It takes some four hours of processor time.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from _common import ROOT, commit, machine, markdown

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def measured(name, arguments, out):
    """Run a script if its results are not there; return them, None if there are none."""
    path = out / f"{name}.json"
    start = time.monotonic()
    if not path.exists():
        command = [sys.executable, ROOT / "tests" / "benchmarks" / f"{name}.py", *arguments]
        with (out / f"{name}.txt").open("a") as log:
            subprocess.run(
                [*map(str, command), "--out", str(out)],
                stdout=log,
                stderr=log,
                env=os.environ | dict.fromkeys(THREADS, "1") | {"PYTHONPATH": str(ROOT)},
                check=False,
            )
    seconds = time.monotonic() - start
    results = None
    if path.exists():
        results = json.loads(path.read_text())
    print(f"{name}: {'measured' if results else 'NOT MEASURED'} after {seconds:.0f} s", flush=True)
    if results and results["machine"]["commit"] != commit():
        raise SystemExit(f"Got {name} of another commit than {commit()}: empty {out}.")
    return results


def filled(page, results):
    """Return the page with the marked tables of the results; what has no results stays as it is."""

    def replaced(match):
        content = results.get(match["name"], {}).get(match["table"])
        if not content:
            return match[0]
        return f"<!-- {match['name']}:{match['table']} -->\n{markdown(content)}\n<!-- end -->"

    marked = r"<!-- (?P<name>\w+):(?P<table>\w+) -->\n.*?<!-- end -->"
    return re.sub(marked, replaced, page, flags=re.DOTALL)


def main(words=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("data", "repository", "published"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    scripts = {  # those of flights first
        "comparison": [options.data],
        "pairs": [options.repository, options.data],
        "little_told": [],
        "freeflight_air": [],
        "ablation": [options.data],
        "small_uav": ["--every", 6],
        "derivatives": [],
        "bands": [],
        "dependence": [],
        "tabular": [options.published],
        "published": [options.published],
    }
    run = partial(measured, out=options.out.absolute())
    with ThreadPoolExecutor(2) as pool:
        found = pool.map(run, scripts.keys(), scripts.values())
        results = dict(zip(scripts, found, strict=True))
    results = {name: each for name, each in results.items() if each}
    failed = [name for name in scripts if name not in results]
    words = machine() | {"threads": "1 of each script"}
    words["versions"] = ", ".join(f"{name} {v}" for name, v in words["versions"].items())
    results["page"] = {"machine": [words | {"not measured": ", ".join(failed) or None}]}
    for page in (ROOT / "docs").glob("*.md"):
        page.write_text(filled(page.read_text(encoding="utf-8"), results), encoding="utf-8")
    if failed:
        raise SystemExit(f"Not measured: {failed}; see their .txt in {options.out}.")


if __name__ == "__main__":
    main()
