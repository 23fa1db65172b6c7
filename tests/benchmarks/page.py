"""Measure the results page: every script here with its default arguments, on one commit.

    python tests/benchmarks/page.py ../shared/data REPOSITORY PUBLISHED --out OUT

REPOSITORY is what pairs.py needs, PUBLISHED what published.py and tabular.py need. Results are kept in OUT, and
what is there is not measured again. Machine, versions, commit and tables are then written to
docs/results.md, and to other pages with marked tables, between ``<!-- NAME:TABLE -->`` and ``<!--
end -->``. It takes a day on two cores.
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

from _common import machine, markdown

HERE = Path(__file__).parent
PAGES = HERE.parents[1] / "docs"


def commands(data, repository, published):
    """Return the arguments of every script."""
    return {
        "comparison": [data, "--seeds", *range(6)],
        "pairs": [repository, data, "--seeds", *range(3)],
        "published": [published],
        "tabular": [published],
        "freeflight_air": [],
        "little_told": [data],
        "derivatives": [],
        "likelihood": [],
        "small_uav": [],
    }


def filled(page, results):
    """Return the page with the marked tables of the results; what has no results stays as it is."""

    def replaced(match):
        content = results.get(match["name"], {}).get(match["table"])
        if not content:
            return match[0]
        return f"<!-- {match['name']}:{match['table']} -->\n{markdown(content)}\n<!-- end -->"

    marked = r"<!-- (?P<name>\w+):(?P<table>\w+) -->\n.*?<!-- end -->"
    return re.sub(marked, replaced, page, flags=re.DOTALL)


def described():
    """Return machine, versions and commit as a table."""
    words = machine()
    words["versions"] = ", ".join(f"{name} {v}" for name, v in words["versions"].items())
    return [words]


def main(words=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("data", "repository", "published"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    options = parser.parse_args(words)
    results = {"page": {"machine": described()}}
    options.out.mkdir(parents=True, exist_ok=True)
    for name, arguments in commands(options.data, options.repository, options.published).items():
        path = options.out / f"{name}.json"
        if not path.exists():
            command = [sys.executable, HERE / f"{name}.py", *arguments, "--out", options.out]
            with (options.out / f"{name}.txt").open("w") as log:
                subprocess.run([*map(str, command)], stdout=log, check=True)
        if path.exists():
            results[name] = json.loads(path.read_text())
    commit = results["page"]["machine"][0]["commit"]
    old = [
        name
        for name, each in results.items()
        if name != "page" and each["machine"]["commit"] != commit
    ]
    if old:
        raise SystemExit(f"Got {old} of another commit than {commit}: empty {options.out}.")
    for page in PAGES.glob("*.md"):
        page.write_text(filled(page.read_text(encoding="utf-8"), results), encoding="utf-8")


if __name__ == "__main__":
    main()
