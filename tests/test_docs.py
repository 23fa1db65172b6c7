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
# Pages of which it matters little what their models learned, and the seconds of flight that do
UNJUDGED = {"README.md": 7.0, "ten_minutes.md": 20.0}
# Pages that use a minute of flights, 40 s of it in calm air
MINUTE = {"preprocessing.md", "simulation.md", "after.md"}
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


RUN_HERE = []
for page in PAGES:
    if "\n```python\n" in page.read_text("utf-8") and page.name not in RUN_ELSEWHERE:
        marks = [pytest.mark.slow] if page.name in MINUTE else []
        RUN_HERE.append(pytest.param(page, id=page.name, marks=marks))


@pytest.mark.parametrize("page", RUN_HERE)
def test_code_of_the_page_runs_from_top_to_bottom(page, blocks_of, tmp_path, monkeypatch, request):
    """In one namespace, in an empty folder; what a page writes, it writes there."""
    if page.name in UNJUDGED:
        request.getfixturevalue("hasty_fits")
        request.getfixturevalue("no_mechanics")
        defaults = datasets.load_example_flights.__wrapped__.__kwdefaults__
        monkeypatch.setitem(defaults, "duration", UNJUDGED[page.name])
    if page.name == "after.md":
        request.getfixturevalue("few_manoeuvres")
    if page.name in MINUTE:
        first_minute = request.getfixturevalue("first_minute")
        calm = partial(load_example_flights, duration=40.0)
        monkeypatch.setattr(
            datasets,
            "load_example_flights",
            lambda **options: calm(**options) if options else first_minute(),
        )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {}
    for number, block in enumerate(blocks_of(page), start=1):
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    if "matplotlib" in page.read_text(encoding="utf-8"):
        pytest.importorskip("matplotlib.pyplot").close("all")


def test_code_of_every_page_runs_somewhere():
    assert len(RUN_HERE) >= 7
    for page, runner in RUN_ELSEWHERE.items():
        assert page in (ROOT / "tests" / runner).read_text(encoding="utf-8")


def test_files_of_the_architecture_page_exist():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:\w+/)*\w+\.py)`", page))
    assert len(named) > 25
    files = [*(ROOT / "skdgp").rglob("*.py"), *(ROOT / "tests").rglob("*.py")]
    listing = "".join(f"{path.as_posix()}\n" for path in files)
    assert [name for name in named if f"/{name}\n" not in listing] == []
