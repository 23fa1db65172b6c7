"""The code on the pages runs, and their links lead somewhere."""

import re
from functools import partial
from pathlib import Path

import pytest

from skdgp._flight.channels import CHANNELS
from skdgp.datasets import _example_flights
from skdgp.datasets._brumby import REGRESSORS, brumby_coefficients, brumby_derivatives
from skdgp.dynamics import Aerodynamics, stability_derivatives

ROOT = Path(__file__).resolve().parents[1]
KNOWN = Aerodynamics(
    brumby_coefficients,
    [name if CHANNELS[name].unit == "rad" else f"{name}_hat" for name in REGRESSORS],
    gradient=brumby_derivatives,
)
"""The example aircraft as it is."""
RUN_ELSEWHERE = {
    "README.md": "test_docs.py",  # its code is judged below
    # its code needs jsbsim, or a model: export/test_command.py
    "export.md": "export/test_jsbsim.py",
    "identification.md": "cli/test_identify.py",  # its code reads logs, which that test lays ready
    "logs.md": "io/test_page.py",  # its code reads a log, which that test lays ready
    "scaling.md": "compute/test_dask.py",  # its code needs dask.distributed
}
UNJUDGED = {"ten_minutes.md"}  # what their models learned matters little: short fits do
SHORT = {"ten_minutes.md"}  # and short flights
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
        made = partial(_example_flights._flights, duration=SECONDS[page.name])
        monkeypatch.setattr(_example_flights, "_flights", made)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {}
    for number, block in enumerate(blocks(page), start=1):
        exec(compile(block, f"{page.name}, block {number}", "exec"), names)
    if "matplotlib" in page.read_text(encoding="utf-8"):
        plt = pytest.importorskip("matplotlib.pyplot")
        plt.close("all")


@pytest.mark.usefixtures("short_flights", "hasty_fits")
@pytest.mark.parametrize(("short_flights", "hasty_fits"), [(800, 6)], indirect=True)
def test_front_page_shows_the_known_derivatives(capsys):
    """What its code prints, of the first 20 s of each flight, and what its text says that it prints."""
    page, names = ROOT / "README.md", {}
    (code,) = blocks(page)
    exec(compile(code, page.name, "exec"), names)
    printed = re.findall(r"^(C\w+_\w+) +(\S+) +(\S+)$", capsys.readouterr().out, re.MULTILINE)
    known = stability_derivatives(KNOWN, names["aircraft"], names["point"])["value"]
    assert len(printed) == 3
    for name, value, std in printed:
        assert abs(float(value) - known[name]) < 2 * float(std) < 0.4 * abs(known[name]), name
    (text,) = re.findall(
        r"^The known derivatives .*$", page.read_text(encoding="utf-8"), re.MULTILINE
    )
    known_words, found_words = text.split("The model finds")
    stated = [float(word) for word in re.findall(r"-?\.\d+", known_words)]
    assert stated == pytest.approx([known[name] for name, *_ in printed], rel=0.03)
    found = [
        (float(value), float(std)) for value, std in re.findall(r"(-?\.\d+) ± (\.\d+)", found_words)
    ]
    for truth, (value, std) in zip(stated, found, strict=True):
        assert abs(value - truth) < 2 * std < 0.4 * abs(truth)


def test_code_of_every_page_runs_somewhere():
    assert len(RUN_HERE) >= 7
    for page, runner in RUN_ELSEWHERE.items():
        assert page in (ROOT / "tests" / runner).read_text(encoding="utf-8")


def found_on_pages(pattern):
    """Return (page, match) of every match of a pattern."""
    return [
        (page, found)
        for page in PAGES
        for found in set(re.findall(pattern, page.read_text(encoding="utf-8")))
    ]


def test_links_between_pages_lead_somewhere():
    links = found_on_pages(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
    inside = [
        (page, target)
        for page, target in links
        if "://" not in target and not target.startswith("mailto:")
    ]
    assert [
        (page.name, target) for page, target in inside if not (page.parent / target).exists()
    ] == []


class TestNotation:
    page = ROOT / "docs" / "notation.md"

    @pytest.fixture
    def rows(self):
        """Cells of each table row, by heading."""
        found, heading = {}, None
        for line in self.page.read_text(encoding="utf-8").splitlines():
            if line.startswith("## "):
                heading = line[3:]
            elif line.startswith("|") and not set(line) <= set("|-: "):
                found.setdefault(heading, []).append(
                    [c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]]
                )
        return {heading: cells[1:] for heading, cells in found.items()}

    def test_columns_of_a_flight_table_are_the_vocabulary_with_unit_and_meaning(self, rows):
        expected = [
            [f"`{name}`", channel.unit or "-", channel.meaning]
            for name, channel in CHANNELS.items()
        ]
        assert [row[:3] for row in rows["Columns of a flight table"]] == expected
