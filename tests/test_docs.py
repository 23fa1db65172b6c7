"""The code on the pages runs, and their links lead somewhere."""

import re
from functools import partial
from pathlib import Path

import pytest

from skdgp import datasets
from skdgp.datasets import load_example_flights

ROOT = Path(__file__).resolve().parents[1]
RUN_ELSEWHERE = {
    # its code needs jsbsim, or a model: export/test_command.py
    "export.md": "export/test_jsbsim.py",
    "identification.md": "cli/test_options.py",  # its code reads logs, which that test lays ready
    "logs.md": "io/test_servos.py",  # its code reads a log, which that test lays ready
    "inference.md": "compute/test_dask.py",  # its code needs dask.distributed
}
UNJUDGED = {
    "README.md",
    "ten_minutes.md",
}  # what their models learned matters little: short fits do
SHORT = {"README.md", "ten_minutes.md"}  # and short flights
SECONDS = {
    "preprocessing.md": 40.0,
    "simulation.md": 90.0,
    "design.md": 60.0,
}  # of flights, as far as pages use them
PAGES = [
    path for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) if path.is_file()
]


def blocks(page, language="python"):
    return re.findall(
        rf"^```{language}\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL | re.MULTILINE,
    )


RUN_HERE = [page for page in PAGES if blocks(page) and page.name not in RUN_ELSEWHERE]


@pytest.mark.parametrize("page", RUN_HERE, ids=lambda page: page.name)
def test_code_of_the_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, request):
    """In one namespace, in an empty folder; what a page writes, it writes there."""
    if page.name in UNJUDGED:
        request.getfixturevalue("hasty_fits")
        request.getfixturevalue("no_mechanics")
    if page.name in SHORT:
        request.getfixturevalue("short_flights")
    if page.name == "design.md":
        request.getfixturevalue("few_manoeuvres")
    if page.name in SECONDS:
        short = partial(load_example_flights, duration=SECONDS[page.name])
        monkeypatch.setattr(datasets, "load_example_flights", short)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {}
    for number, block in enumerate(blocks(page), start=1):
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    if "matplotlib" in page.read_text(encoding="utf-8"):
        plt = pytest.importorskip("matplotlib.pyplot")
        plt.close("all")


def test_code_of_every_page_runs_somewhere():
    assert len(RUN_HERE) >= 7
    for page, runner in RUN_ELSEWHERE.items():
        assert page in (ROOT / "tests" / runner).read_text(encoding="utf-8")


def test_files_of_the_architecture_page_exist():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:\w+/)*\w+\.py)`", page))
    assert len(named) > 25
    files = [
        path.as_posix() for folder in ("skdgp", "tests") for path in (ROOT / folder).rglob("*.py")
    ]
    assert [
        name for name in named if not any(f"/{file}".endswith(f"/{name}") for file in files)
    ] == []
