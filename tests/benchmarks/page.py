"""Measure the results page: every script here with its default arguments, on one commit.

Of small_uav.py, which takes hours, an even sixth is flown.

    python tests/benchmarks/page.py ../shared/data REPOSITORY PUBLISHED --out OUT

REPOSITORY is what pairs.py needs, PUBLISHED what published.py and tabular.py need. Stopped and
started again, it goes on after the last run that was finished: OUT holds the runs. Machine,
versions, commit and tables are then written to docs/results.md, and to other pages with marked
tables, between ``<!-- NAME:TABLE -->`` and ``<!-- end -->``. It takes some four hours of processor
time.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from _common import ROOT, commit, machine, markdown, parser_of

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def measured(name, arguments, out):
    """Run a script on one thread if its results are not there; return them."""
    path = out / f"{name}.json"
    if not path.exists():
        script = ROOT / "tests" / "benchmarks" / f"{name}.py"
        command = [sys.executable, script, *arguments, "--out", out]
        environment = os.environ | dict.fromkeys(THREADS, "1") | {"PYTHONPATH": str(ROOT)}
        subprocess.run([*map(str, command)], env=environment, check=True)
    results = json.loads(path.read_text())
    if results["machine"]["commit"] != commit():
        raise SystemExit(f"Got {name} of another commit than {commit()}: empty {out}.")
    return results


def filled(page, results):
    """Return the page with the marked tables of the results."""

    def replaced(match):
        content = markdown(results[match["name"]][match["table"]])
        return f"<!-- {match['name']}:{match['table']} -->\n{content}\n<!-- end -->"

    marked = r"<!-- (?P<name>\w+):(?P<table>\w+) -->\n.*?<!-- end -->"
    return re.sub(marked, replaced, page, flags=re.DOTALL)


def main(words=None):
    parser = parser_of(__doc__, data=True)
    for name in ("repository", "published"):
        parser.add_argument(name, type=Path)
    options = parser.parse_args(words)
    scripts = {  # those of flights first
        "comparison": [options.data],
        "pairs": [options.repository, options.data],
        "little_told": [],
        "freeflight_air": [],
        "ablation": [],
        "small_uav": ["--every", 6],
        "derivatives": [],
        "bands": [],
        "dependence": [],
        "tabular": [options.published],
        "published": [options.published],
    }
    results = {name: measured(name, words, options.out) for name, words in scripts.items()}
    about = machine() | {"threads": "1"}
    about["versions"] = ", ".join(f"{name} {v}" for name, v in about["versions"].items())
    results["page"] = {"machine": [about]}
    for page in (ROOT / "docs").glob("*.md"):
        page.write_text(filled(page.read_text(encoding="utf-8"), results), encoding="utf-8")


if __name__ == "__main__":
    main()
